"""NumPy archives, never pickled."""

import math
import pathlib
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._errors import input_error
from .._memory import check_memory
from ._container import Attributes, Leaf, Unreadable, Variable, text

KIND = "a NumPy archive"

_MAGIC = b"\x93NUMPY"
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
    with zipfile.ZipFile(path) as members:
        check_memory(str(path), sum(x.file_size for x in members.infolist()), "Split the record into several files.")
        for info in members.infolist():
            _check_header(path, members, info)
    with np.load(path, allow_pickle=False) as archive:
        return {name: _leaf(archive, name) for name in archive.files}


def size(path: pathlib.Path) -> int:
    """Bytes of its arrays in memory."""
    with zipfile.ZipFile(path) as members:
        return sum(x.file_size for x in members.infolist())


def save(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    contents: dict[str, Any] = {name: v.value for name, v in variables.items()} | dict(attributes)
    np.savez(path, **contents)


def _check_header(path: pathlib.Path, members: zipfile.ZipFile, info: zipfile.ZipInfo) -> None:
    """NumPy asks for the memory that a header states before it looks whether as much follows."""
    with members.open(info) as member:
        if member.read(len(_MAGIC)) != _MAGIC:
            return
        version = tuple(member.read(2))
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(member)
    stated = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or stated > info.file_size:
        raise input_error(
            f"{path}: {info.filename.removesuffix('.npy')}",
            f"a header that states the shape {shape}, and {info.file_size} bytes",
            f"{stated} bytes for this shape",
            "The file is damaged: export or copy it again.",
        )


def _leaf(archive, name: str) -> Leaf:
    try:
        value = archive[name]
    except ValueError as error:
        if "pickle" in str(error):
            return Unreadable("a pickled object array")
        raise
    return text(value) if value.dtype.kind in "US" and value.size == 1 else value
