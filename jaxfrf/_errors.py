"""What jaxfrf says when the input is wrong."""


class InputError(ValueError):
    """The input cannot be used. The message says what was found, what was expected and what to do."""


class OutputError(InputError):
    """The place where a result should go cannot be used. The data are not at fault."""


def input_error(what: str, found: str, expected: str, do: str) -> InputError:
    """The one shape of an error message: `WHAT: found F; expected E. Do D.`"""
    return InputError(_message(what, found, expected, do))


def output_error(what: str, found: str, expected: str, do: str) -> OutputError:
    """The same about a place to write to."""
    return OutputError(_message(what, found, expected, do))


def _message(what: str, found: str, expected: str, do: str) -> str:
    return f"{what}: found {found}; expected {expected}. {do}"
