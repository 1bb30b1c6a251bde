"""The quantities that a motor's motion can be stated as."""

from .._errors import input_error

_DERIVATIVES = {"position": 0, "velocity": 1, "acceleration": 2}


def derivatives(quantity: str) -> int:
    """How many times the quantity is the time derivative of a position.

    **Raises:** `jaxfrf.InputError` for another name than position, velocity or acceleration.
    """
    if quantity not in _DERIVATIVES:
        raise input_error("quantity", repr(quantity), "position, velocity or acceleration", "Choose one of them.")
    return _DERIVATIVES[quantity]
