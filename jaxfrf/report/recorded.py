"""Results as their files hold them."""

import contextlib
from collections.abc import Iterator

from .._errors import input_error


@contextlib.contextmanager
def reading(file: str, command: str) -> Iterator[None]:
    """What a file of an earlier version lacks, or a person took out, is one error."""
    try:
        yield
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        lacking = f"no {error.args[0]}" if isinstance(error, KeyError) else f"damaged fields ({error})"
        expected = f"what `jaxfrf {command}` of this version writes"
        raise input_error(file, lacking, expected, "Write it again from its data.") from error


def finite(x: float | None) -> float:
    """A number of a file, in which null stands for what is not finite."""
    return float("nan") if x is None else x
