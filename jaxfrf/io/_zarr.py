"""Zarr folders, read and written as `_netcdf` does files: every chunk is a file of its own, at one position."""

import contextlib
import pathlib
from collections.abc import Iterator, Mapping

import numpy as np

from ._container import Attributes, Later, Leaf, Put, Variable
from ._netcdf import chunks
from ._optional import require
from ._xarray import load_dataset

KIND = "a Zarr folder"


def load(path: pathlib.Path, part: slice | None = None, without: str | None = None) -> dict[str, Leaf]:
    """As `_xarray.load_dataset`."""
    require("zarr", "zarr")
    return load_dataset(path, part, without, engine="zarr", consolidated=False, chunks=None)


def save(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    with blocks(path, variables, attributes):
        pass


@contextlib.contextmanager
def blocks(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> Iterator[Put]:
    """As `_netcdf.blocks`."""
    group = require("zarr", "zarr").open_group(str(path), mode="w", zarr_format=3)
    group.attrs.update({name: _plain(x) for name, x in attributes.items()})
    for name, v in variables.items():
        value = v.value if isinstance(v.value, Later) else np.asarray(v.value)
        made = group.create_array(
            name,
            shape=value.shape,
            dtype=value.dtype,
            chunks=chunks(value.shape, value.dtype) or "auto",
            dimension_names=v.dims,
        )
        made.attrs.update(({"units": v.unit} if v.unit else {}) | {k: _plain(x) for k, x in v.attributes.items()})
        if not isinstance(value, Later):
            made[...] = value

    def put(name: str, first: int, value: np.ndarray) -> None:
        group[name][first : first + len(value)] = value

    yield put


def positions(path: pathlib.Path) -> int | None:
    """As `_netcdf.positions`."""
    group = require("zarr", "zarr").open_group(str(path), mode="r")
    for name in group.array_keys():
        dims = group[name].metadata.dimension_names or group[name].attrs.get("_ARRAY_DIMENSIONS", ())
        if "position" in dims:
            return group[name].shape[list(dims).index("position")]
    return None


def size(path: pathlib.Path) -> int:
    """As `_netcdf.size`."""
    return sum(x.nbytes for _, x in require("zarr", "zarr").open_group(str(path), mode="r").arrays())


def _plain(x):
    """As JSON has it."""
    return x.tolist() if isinstance(x, np.generic | np.ndarray) else x
