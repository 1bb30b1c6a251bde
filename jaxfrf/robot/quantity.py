"""The quantities that a motor's motion can be stated as."""

from ..units import QUANTITIES, expect_quantity


def derivatives(quantity: str) -> int:
    """How many times the quantity is the time derivative of a position.

    **Raises:** `jaxfrf.InputError` for another name than position, velocity or acceleration.
    """
    expect_quantity("quantity", quantity)
    return QUANTITIES[quantity]
