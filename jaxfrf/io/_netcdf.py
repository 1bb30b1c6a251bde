"""NetCDF-4 through xarray and h5netcdf: axes are told by their names, whatever their order in the file."""

import pathlib
from collections.abc import Mapping

import numpy as np

from ._container import Attributes, Leaf, Variable, text
from ._optional import require

KIND = "a NetCDF-4 file"

_LEADING = ("position", "experiment", "time")  # the order of axes in memory; what is left is the channel


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """Variables and attributes; arrays that name `position`, `experiment`, `time` get them in this order."""
    require("h5netcdf", "io")
    # Times stay numbers: decoding would turn seconds into timedelta64.
    options = {"engine": "h5netcdf", "decode_times": False, "decode_timedelta": False}
    with require("xarray", "io").open_dataset(path, **options) as dataset:
        attributes = {str(name): _value(np.asarray(value)) for name, value in dataset.attrs.items()}
        return attributes | {str(name): _ordered(variable) for name, variable in dataset.variables.items()}


def save(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    require("h5netcdf", "io")
    xarray = require("xarray", "io")
    dataset = xarray.Dataset(
        {name: (v.dims, v.value, {"units": v.unit} if v.unit else {}) for name, v in variables.items()},
        attrs=dict(attributes),
    )
    # No fill value: it would make every reader copy the array to mask it.
    encoding = {name: {"_FillValue": None} for name in variables}
    dataset.to_netcdf(path, engine="h5netcdf", encoding=encoding)


def _ordered(variable) -> Leaf:
    dims = variable.dims
    known = [d for d in _LEADING if d in dims]
    others = [d for d in dims if d not in _LEADING]
    value = _value(variable.transpose(*known, *others).values)
    if "time" not in dims or len(dims) == 1 or len(others) > 1:
        return value
    channel = value if others else value[..., None]
    missing = tuple(i for i, d in enumerate(_LEADING) if d not in dims)
    return np.expand_dims(channel, missing)


def _value(value: np.ndarray) -> Leaf:
    return text(value) if value.dtype.kind in "USO" and value.size == 1 else value
