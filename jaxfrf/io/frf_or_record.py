"""Whether a file holds FRFs or records, and several FRF files as one."""

import dataclasses
import os
import pathlib
import zipfile

import numpy as np

from .._errors import InputError, input_error
from ..frf import FRF, concatenate_positions
from ._container import load
from ._formats import SAVED, UNIVERSAL
from .responses import read_frf


def holds_frf(path: str | os.PathLike) -> bool:
    """Whether a file holds `G` and `frequency`, as `write_frf` writes them. What cannot be read holds none: reading it
    as a record says why."""
    path = pathlib.Path(path)
    if path.suffix.lower() in UNIVERSAL:
        return True
    if path.suffix.lower() not in SAVED:
        return False
    try:
        if path.suffix.lower() == ".npz":
            with zipfile.ZipFile(path) as archive:
                names = {name.removesuffix(".npy") for name in archive.namelist()}
        elif path.suffix.lower() == ".zarr":
            names = {x.name for x in path.iterdir()}
        else:
            names = set(load(path))
    except (InputError, ImportError, OSError, zipfile.BadZipFile):
        return False
    return {"G", "frequency"} <= names


def read_frfs(*paths: str | os.PathLike) -> FRF:
    """FRF files of different operating points as one FRF.

    **Raises:** `jaxfrf.InputError` naming the file whose lines, channels or quantity are others.
    """
    frfs = [read_frf(path) for path in paths]
    first = frfs[0]
    for path, other in zip(paths[1:], frfs[1:], strict=True):
        for what, a, b in (
            ("lines", first.frequency, other.frequency),
            ("outputs and inputs", np.shape(first.G)[2:], np.shape(other.G)[2:]),
            ("y_quantity", first.y_quantity, other.y_quantity),
        ):
            if not np.array_equal(a, b):
                raise input_error(
                    f"{path}: {what}",
                    "others than in the first file" if what == "lines" else f"{b}",
                    f"those of {pathlib.Path(paths[0]).name}" if what == "lines" else f"{a}",
                    "Fit files of one experiment design together, others by themselves.",
                )
    if len(frfs) == 1:
        return first
    sources = tuple(dict.fromkeys(s for frf in frfs for s in frf.sources))
    return dataclasses.replace(concatenate_positions(frfs), sources=sources)
