"""NetCDF-4 through xarray and h5netcdf: axes are told by their names, whatever their order in the file."""

import contextlib
import pathlib
from collections.abc import Iterator, Mapping

import numpy as np

from .._files import check_room
from ._apart import check_walkable, load_apart
from ._container import Attributes, Later, Leaf, Put, Variable
from ._hdf5 import surviving
from ._optional import require
from ._xarray import load_dataset

KIND = "a NetCDF-4 file"

_OVERHEAD = 2**20  # bytes of names, attributes and tables
_CHUNK = 2**26  # bytes that are read and checked at once


def load(path: pathlib.Path, part: slice | None = None, without: str | None = None) -> dict[str, Leaf]:
    """As `_xarray.load_dataset`."""
    require("h5netcdf", "io")
    return load_apart(path, _load) if part is None else _load(path, part, without)


def _load(path: pathlib.Path, part: slice | None = None, without: str | None = None) -> dict[str, Leaf]:
    return load_dataset(path, part, without, engine="h5netcdf")


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


def size(path: pathlib.Path) -> int:
    """Bytes of its arrays in memory."""
    require("h5netcdf", "io")
    check_walkable(path)
    with require("h5netcdf", "io").File(path, "r") as file:
        return sum(x.dtype.itemsize * int(np.prod(x.shape)) for x in file.variables.values())


def _stored(shape: tuple[int, ...], dtype: np.dtype) -> dict:
    found = chunks(shape, dtype)
    return {"fletcher32": True, "chunksizes": found} if found else {}


def chunks(shape: tuple[int, ...], dtype: np.dtype) -> tuple[int, ...]:
    """One experiment, or one position, a chunk, as long as the library takes it; none of a scalar."""
    if not shape or not np.prod(shape):
        return ()
    leading = max(len(shape) - 2, 0) if len(shape) < 5 else 1  # factors of a line are far too small for one
    found = [1] * leading + list(shape[leading:])
    row = max(dtype.itemsize * int(np.prod(found[leading + 1 :])), 1)
    found[leading] = max(min(found[leading], _CHUNK // row), 1)
    return tuple(found)
