"""TOML files as nested dictionaries, or one message."""

import pathlib
import tomllib
from typing import Any

from .._errors import input_error
from .._text import number

_LARGEST = 20_000_000  # bytes; a robot of 100 joints takes 50 kB


def read_toml(path: pathlib.Path, what: str, see: str) -> dict[str, Any]:
    """The tables of a TOML file. `what` it should be, and what to `see`, for messages.

    **Raises:** `jaxfrf.InputError` naming the file. `OSError` if it cannot be opened.
    """
    if path.is_file() and path.stat().st_size > _LARGEST:
        raise input_error(
            path.name, f"{number(path.stat().st_size / 1e6)} MB", f"{what} of at most {_LARGEST / 1e6:g} MB", see
        )
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except tomllib.TOMLDecodeError as error:
        raise input_error(path.name, f"no valid TOML ({error})", what, f"Correct that line. {see}") from error
    except UnicodeDecodeError as error:
        raise input_error(path.name, f"no text in UTF-8 ({error})", what, "Save it as UTF-8.") from error
    except RecursionError as error:
        raise input_error(path.name, "brackets within brackets, too deep to read", what, see) from error
    except ValueError as error:  # Python's limit on the digits of a whole number
        raise input_error(path.name, "a number of more than 4300 digits", what, see) from error
