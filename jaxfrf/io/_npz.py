"""NumPy archives, never pickled."""

import pathlib
import zipfile
from collections.abc import Mapping

import numpy as np

from .._errors import input_error
from ._container import Attributes, Leaf, Unreadable, Variable, text

KIND = "a NumPy archive"

_PICKLE = b"\x80"  # how a pickle begins, from protocol 2 on


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """Every array of the archive; object arrays are pickles (code that would run) and stay closed."""
    with path.open("rb") as file:
        if file.read(1) == _PICKLE:
            raise input_error(
                str(path),
                "a Python pickle",
                "a NumPy archive of plain arrays",
                "Loading a pickle runs the code in it: save with numpy.savez(path, r=r, u=u, y=y, fs=fs).",
            )
    if not zipfile.is_zipfile(path):
        raise ValueError("no complete zip archive")
    with np.load(path, allow_pickle=False) as archive:
        return {name: _leaf(archive, name) for name in archive.files}


def save(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    np.savez(path, **{k: v.value for k, v in variables.items()}, **attributes)


def _leaf(archive, name: str) -> Leaf:
    try:
        value = archive[name]
    except ValueError as error:
        if "pickle" in str(error):
            return Unreadable("a pickled object array")
        raise
    return text(value) if value.dtype.kind in "US" and value.size == 1 else value
