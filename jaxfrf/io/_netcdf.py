"""NetCDF-4 through xarray and h5netcdf: axes are told by their names, whatever their order in the file."""

import contextlib
import pathlib
from collections.abc import Iterator, Mapping

import numpy as np

from .._files import check_room
from .._memory import check_memory
from ._container import Attributes, Later, Leaf, Put, Variable, Variables, text
from ._hdf5 import check_walkable, surviving
from ._optional import require

KIND = "a NetCDF-4 file"

_OVERHEAD = 2**20  # bytes of names, attributes and tables
_CHUNK = 2**26  # bytes that are read and checked at once
_LEADING = ("position", "experiment", "time")  # the order of axes in memory; what is left is the channel


def load(path: pathlib.Path, part: slice | None = None, without: str | None = None) -> dict[str, Leaf]:
    """Variables and attributes; arrays that name `position`, `experiment`, `time` get them in this order.

    `part`: these positions only, of what has such an axis. `without`: only what has no such axis.
    """
    require("h5netcdf", "io")
    if part is None:
        check_walkable(path)
    # Times stay numbers: decoding would turn seconds into timedelta64.
    options = {"engine": "h5netcdf", "decode_times": False, "decode_timedelta": False}
    with require("xarray", "io").open_dataset(path, **options) as dataset:
        if part is not None:
            dataset = dataset.isel(position=part)
        if without is not None:
            dataset = dataset.drop_dims(without, errors="ignore")
        check_memory(str(path), dataset.nbytes, "Split the record into several files.")
        attributes = {str(name): plain_value(np.asarray(value)) for name, value in dataset.attrs.items()}
        arrays = {str(name): ordered(variable) for name, variable in dataset.variables.items()}
        units = {str(name): str(x.attrs.get("units", "")) for name, x in dataset.variables.items()}
        return Variables(attributes | arrays, units)


def save(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    require("h5netcdf", "io")
    xarray = require("xarray", "io")
    dataset = xarray.Dataset(
        {name: (v.dims, v.value, {"units": v.unit} if v.unit else {}) for name, v in variables.items()},
        attrs=dict(attributes),
    )
    write_dataset(path, dataset)


def write_dataset(path: pathlib.Path, dataset) -> None:
    """An xarray dataset to a file whose arrays carry checksums: what was damaged since is noticed when it is read.

    **Raises:** `jaxfrf.InputError` if the disk has no room for it, before the HDF5 library runs into its end (which a
    process need not survive).
    """
    check_room(path, dataset.nbytes + _OVERHEAD)
    # No fill value: it would make every reader copy the array to mask it.
    encoding = {name: {"_FillValue": None, **_stored(x.shape, x.dtype)} for name, x in dataset.variables.items()}
    with _created(path) as file:
        dataset.dump_to_store(require("xarray", "io").backends.H5NetCDFStore(file), encoding=encoding)


@contextlib.contextmanager
def _created(path: pathlib.Path):
    """A new file, open for h5netcdf; a full disk is an `OSError` at the end of the block."""
    h5netcdf = require("h5netcdf", "io")
    with surviving(path) as disk, h5netcdf.File(disk, "w") as file:
        yield file


@contextlib.contextmanager
def blocks(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> Iterator[Put]:
    """A file whose arrays come position by position: `put(name, first, value)`; `variables` hold what is known already,
    or, as `Later`, only shape and type.

    **Raises:** as `write_dataset`.
    """
    check_room(path, sum(v.value.nbytes for v in variables.values()) + _OVERHEAD)
    with _created(path) as file:
        sizes = {dim: n for v in variables.values() for dim, n in zip(v.dims, v.value.shape, strict=True)}
        file.dimensions = sizes
        file.attrs.update(attributes)
        for name, v in variables.items():
            options = _stored(v.value.shape, v.value.dtype)
            options["chunks"] = options.pop("chunksizes", None)
            made = file.create_variable(name, v.dims, v.value.dtype, **options)
            made.attrs.update(({"units": v.unit} if v.unit else {}) | dict(v.attributes))
            if not isinstance(v.value, Later):
                made[...] = v.value

        def put(name: str, first: int, value: np.ndarray) -> None:
            file[name][first : first + len(value)] = value

        yield put


def positions(path: pathlib.Path) -> int | None:
    """How many positions a file holds that can be read one by one; `None` where it has no such axis."""
    require("h5netcdf", "io")
    check_walkable(path)
    with require("h5netcdf", "io").File(path, "r") as file:
        return file.dimensions["position"].size if "position" in file.dimensions else None


def _stored(shape: tuple[int, ...], dtype: np.dtype) -> dict:
    found = chunks(shape, dtype)
    return {"fletcher32": True, "chunksizes": found} if found else {}


def chunks(shape: tuple[int, ...], dtype: np.dtype) -> tuple[int, ...]:
    """One experiment, or one position, a chunk, as long as the library takes it; none of a scalar."""
    if not shape or not np.prod(shape):
        return ()
    leading = max(len(shape) - 2, 0)
    found = [1] * leading + list(shape[leading:])
    row = max(dtype.itemsize * int(np.prod(found[leading + 1 :])), 1)
    found[leading] = max(min(found[leading], _CHUNK // row), 1)
    return tuple(found)


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
