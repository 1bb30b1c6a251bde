"""Data sets of xarray as variables: what NetCDF files and Zarr folders share."""

import pathlib

import numpy as np

from .._memory import check_memory
from ._container import Leaf, Variables, text
from ._optional import require

_LEADING = ("position", "experiment", "time")  # the order of axes in memory; what is left is the channel
_AS_STORED = {"decode_times": False, "decode_timedelta": False}  # decoding would turn seconds into timedelta64


def load_dataset(
    path: pathlib.Path, part: slice | None = None, without: str | None = None, **options
) -> dict[str, Leaf]:
    """Variables and attributes; arrays that name `position`, `experiment`, `time` get them in this order.

    `part`: these positions only, of what has such an axis. `without`: only what has no such axis. `options`: of
    `xarray.open_dataset`.
    """
    with require("xarray", "io").open_dataset(path, **_AS_STORED, **options) as dataset:
        if part is not None:
            dataset = dataset.isel(position=part)
        if without is not None:
            dataset = dataset.drop_dims(without, errors="ignore")
        check_memory(str(path), dataset.nbytes, "Split the record into several files.")
        attributes = {str(name): plain_value(np.asarray(value)) for name, value in dataset.attrs.items()}
        arrays = {str(name): ordered(variable) for name, variable in dataset.variables.items()}
        units = {str(name): str(x.attrs.get("units", "")) for name, x in dataset.variables.items()}
        return Variables(attributes | arrays, units)


def ordered(variable) -> Leaf:
    """An array of xarray with its leading axes in order, those that are missing among them of length one."""
    dims = variable.dims
    known = [d for d in _LEADING if d in dims]
    others = [d for d in dims if d not in _LEADING]
    value = plain_value(variable.transpose(*known, *others).values)
    if not isinstance(value, np.ndarray) or "time" not in dims or len(dims) == 1 or len(others) > 1:
        return value
    channel = value if others else value[..., None]
    missing = tuple(i for i, d in enumerate(_LEADING) if d not in dims)
    return np.expand_dims(channel, missing)


def plain_value(value: np.ndarray) -> Leaf:
    """An array, or the text that it is."""
    return text(value) if value.dtype.kind in "USO" and value.size == 1 else value
