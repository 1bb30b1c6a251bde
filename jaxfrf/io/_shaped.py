"""Numbers of a file in the shape that they must have."""

import numpy as np

from .._errors import input_error
from ._container import Unreadable


def numbers(value, where: str) -> np.ndarray:
    x = np.asarray(value)
    if x.dtype.kind not in "fciu":
        found = value.kind if isinstance(value, Unreadable) else f"{x.dtype} data"
        raise input_error(where, found, "numbers", "Save the array itself, not text or objects.")
    return x


def as_complex(x: np.ndarray) -> np.ndarray:
    return x.astype(np.result_type(x.dtype, np.complex64), copy=False)


def shaped(value, shape: tuple[int, ...], where: str) -> np.ndarray:
    """`value` in `shape`; only axes of length one may have been lost or added."""
    value = numbers(value, where)
    if [n for n in value.shape if n != 1] != [n for n in shape if n != 1]:
        raise input_error(where, f"shape {value.shape}", f"shape {shape}, as G has it", "Check the order of axes.")
    return value.reshape(shape)
