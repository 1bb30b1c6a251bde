"""What jaxfrf says when the input is wrong."""


class InputError(ValueError):
    """The input cannot be used. The message says what was found, what was expected and what to do."""


def input_error(what: str, found: str, expected: str, do: str) -> InputError:
    """The one shape of an error message: `WHAT: found F; expected E. Do D.`"""
    return InputError(f"{what}: found {found}; expected {expected}. {do}")
