"""MATLAB files: v5 (and v4) through SciPy, v7.3 (HDF5) through h5py.

v7.3 stores arrays column by column, so HDF5 shows their axes reversed. The rule: a dataset that carries the
attribute `MATLAB_class` was written the MATLAB way and is turned round; one without (plain HDF5 under the
name `.mat`) is taken as it is.
"""

import math
import pathlib
import re
import warnings
from collections.abc import Mapping

import numpy as np
import scipy  # scipy.io and scipy.sparse load when a file needs them

from .._files import check_room
from .._memory import check_memory
from ._apart import load_apart
from ._container import Attributes, Leaf, Unreadable, Variable, text
from ._hdf5 import surviving
from ._mat5 import check_whole
from ._optional import require

KIND = "a MATLAB file"

NAMELESS = "?"  # stands for objects whose names cannot be told; MATLAB strings ("...") are among them
_V5_BYTES = 2**31 - 2**16  # v5 counts the bytes of a variable in 32 bits; some go to its header
_HDF5 = b"\x89HDF\r\n\x1a\n"
_MOST_ELEMENTS = 1000  # of an array of structs or a cell array that is opened
_NAMES = ("Name", "name", "label", "Label", "blockName", "BlockName")
_DATA = ("Data", "data", "Values", "values")
_ELEMENT = re.compile(rf"(?P<rec>.+)(?P<at>\(\d+\))\.(?:{'|'.join(_DATA)})")
_NUMERIC = (
    "double",
    "single",
    "logical",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
)
_HEADER = b"MATLAB 7.3 MAT-file, Platform: jaxfrf, Created on: -, HDF5 schema 1.00 ."


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """Every variable: fields of structs as `rec.field`, elements of arrays of structs as `rec.Y(2).Data` (from 1) and,
    where a field beside it names it (dSPACE, Simulink), as `rec.Y.NAME` too, those of cell arrays as `log{2}`; records
    of a time series as (time, channel). Objects and functions stay closed.
    """
    if _is_hdf5(path):
        require("h5py", "io")
        found = load_apart(path, _load_v73)
    else:
        check_whole(path)
        found = _load_v5(path)
    return found | _by_name(found) | _time_first(found)


def _by_name(found: Mapping[str, Leaf]) -> dict[str, Leaf]:
    """`rec.Y(2).Data` as `rec.Y.speed`, where `rec.Y(2).Name` says so: dSPACE, Simulink's structures with time."""
    named: dict[str, list[Leaf]] = {}
    for path, value in found.items():
        element = _ELEMENT.fullmatch(path)
        if element is None or not isinstance(value, np.ndarray):
            continue
        texts = [found.get(f"{element['rec']}{element['at']}.{key}") for key in _NAMES]
        name = next((x for x in texts if isinstance(x, str) and x.strip()), None)
        if name is not None:
            short = re.sub(r"\W+", "_", name.strip().split("/")[-1]).strip("_")
            named.setdefault(f"{element['rec']}.{short}", []).append(value)
    return {path: values[0] for path, values in named.items() if len(values) == 1 and path not in found}


def _time_first(found: Mapping[str, Leaf]) -> dict[str, Leaf]:
    """Data of a time series whose time is the last axis of three, as Simulink logs vectors: (time, channel)."""
    turned: dict[str, Leaf] = {}
    for path, value in found.items():
        rec, _, field = path.rpartition(".")
        if field not in _DATA or not isinstance(value, np.ndarray) or value.ndim != 3:
            continue
        times = [found.get(f"{rec}.{key}") for key in ("Time", "time")]
        n_times = [t.size for t in times if isinstance(t, np.ndarray)]
        if n_times and value.shape[2] == n_times[0] > 1:
            turned[path] = np.moveaxis(value, 2, 0).reshape(n_times[0], -1)
    return turned


def save(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    """v5, the version that everything reads; v7.3 where an array is too large for it."""
    large = any(8 * math.prod(v.value.shape) > _V5_BYTES for v in variables.values())
    (save_v73 if large else save_v5)(path, variables, attributes)


def save_v5(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    # Everything as double: integer classes do not mix in MATLAB's arithmetic.
    numbers = {name: np.asarray(v.value, np.float64) for name, v in variables.items()}
    scalars = {name: x if isinstance(x, str) else float(x) for name, x in attributes.items()}
    with path.open("wb") as file:
        scipy.io.savemat(file, numbers | scalars, oned_as="row")


def save_v73(path: pathlib.Path, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    """HDF5 behind MATLAB's 512-byte header; position by position, without a second copy of an array."""
    check_room(path, sum(8 * math.prod(v.value.shape) for v in variables.values()) + 2**20)
    with surviving(path) as disk, require("h5py", "io").File(disk, "w", userblock_size=512) as file:
        for name, variable in variables.items():
            _store_array(file, name, np.atleast_2d(np.asarray(variable.value)))
        for name, x in attributes.items():
            if isinstance(x, str):
                dataset = file.create_dataset(name, data=np.array([[ord(c)] for c in x], np.uint16))
                dataset.attrs["MATLAB_class"] = np.bytes_("char")
                dataset.attrs["MATLAB_int_decode"] = np.int32(2)
            else:
                _store_array(file, name, np.full((1, 1), float(x)))
    with path.open("r+b") as file:
        file.write(_HEADER.ljust(116) + bytes(8) + b"\x00\x02IM")


def _store_array(file, name: str, x: np.ndarray) -> None:
    chunks = (*x.shape[:1:-1], 1, 1) if x.ndim == 4 else None  # one experiment a chunk
    dataset = file.create_dataset(name, x.shape[::-1], np.float64, chunks=chunks)
    dataset.attrs["MATLAB_class"] = np.bytes_("double")
    for i, part in enumerate(x):
        dataset[..., i] = part.T


def _is_hdf5(path: pathlib.Path) -> bool:
    with path.open("rb") as file:
        start = file.read(520)
    return start.startswith(_HDF5) or start[512:] == _HDF5


def _load_v5(path: pathlib.Path) -> dict[str, Leaf]:
    with warnings.catch_warnings(record=True) as caught, path.open("rb") as file:
        warnings.simplefilter("always")
        found = scipy.io.loadmat(file)
    # SciPy calls every object "None" and keeps the last of them, which holds its true name.
    last = found.pop("None", None)
    flat = dict(pair for name in found if not name.startswith("__") for pair in _flat_v5(name, found[name]))
    if last is not None:
        flat[last["s0"].item().decode()] = Unreadable("a MATLAB object")
    if any("Duplicate variable name" in str(warning.message) for warning in caught):
        flat[NAMELESS] = Unreadable("MATLAB objects")
    return flat


def _flat_v5(name: str, x):
    if isinstance(x, scipy.io.matlab.MatlabOpaque):
        yield name, Unreadable("a MATLAB object")
    elif isinstance(x, scipy.io.matlab.MatlabFunction):
        yield name, Unreadable("a MATLAB function")
    elif scipy.sparse.issparse(x):
        yield name, x.toarray()
    elif x.dtype.names and x.size == 1:
        for field in x.dtype.names:
            yield from _flat_v5(f"{name}.{field}", x.item()[x.dtype.names.index(field)])
    elif x.dtype.names and 0 < x.size <= _MOST_ELEMENTS:
        yield name, Unreadable(f"a MATLAB struct array of {x.size}, {name}(1).{x.dtype.names[0]} and so on")
        for i, element in enumerate(x.ravel(order="F"), 1):
            for field in x.dtype.names:
                yield from _flat_v5(f"{name}({i}).{field}", element[field])
    elif x.dtype.names:
        yield name, Unreadable(f"a MATLAB struct array {x.shape}")
    elif x.dtype == object and 0 < x.size <= _MOST_ELEMENTS:
        yield name, Unreadable(f"a MATLAB cell array of {x.size}, {name}{{1}} and so on")
        for i, element in enumerate(x.ravel(order="F"), 1):
            yield from _flat_v5(f"{name}{{{i}}}", element)
    elif x.dtype == object:
        yield name, Unreadable(f"a MATLAB cell array {x.shape}")
    elif x.dtype.kind == "U":
        yield name, text(x) if x.size == 1 else x
    else:
        yield name, x


def _load_v73(path: pathlib.Path) -> dict[str, Leaf]:
    h5py = require("h5py", "io")
    with h5py.File(path, "r") as file:
        check_memory(str(path), _stored(h5py, file), "Split the record into several files.")
        return dict(pair for name in file if not name.startswith("#") for pair in _flat_v73(h5py, name, file[name]))


def _stored(h5py, group) -> int:
    """Bytes of all arrays of a file that is not followed in circles: `visititems` sees every object once."""
    total = 0

    def add(name, node):
        nonlocal total
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "biufcV" and node.shape is not None:
            total += math.prod(node.shape) * node.dtype.itemsize

    group.visititems(add)
    return total


def _flat_v73(h5py, name: str, node):
    kind = text(node.attrs["MATLAB_class"]) if "MATLAB_class" in node.attrs else ""
    if isinstance(node, h5py.Group):
        if kind not in ("", "struct"):
            yield name, Unreadable(f"a MATLAB object or sparse array ({kind})")
            return
        for field in node:
            yield from _field_v73(h5py, name, field, node[field])
    elif "MATLAB_empty" in node.attrs:
        yield name, np.empty(0)
    elif node.dtype == object or node.dtype.kind == "O":
        yield name, Unreadable(f"a MATLAB {kind or 'reference'} array {node.shape[::-1]}")
    elif kind == "char":
        yield name, "".join(chr(c) for c in node[()].ravel())
    elif kind in _NUMERIC:
        yield name, _complex(node[()]).T
    elif kind:
        yield name, Unreadable(f"a MATLAB {kind}")
    else:
        yield name, _complex(node[()])


def _field_v73(h5py, name: str, field: str, node):
    """A field of a struct; of an array of structs it is a list of references, one for each."""
    plain = isinstance(node, h5py.Dataset) and "MATLAB_class" not in node.attrs and node.dtype.kind == "O"
    if not plain or not 0 < node.size <= _MOST_ELEMENTS:
        yield from _flat_v73(h5py, f"{name}.{field}", node)
        return
    for i, reference in enumerate(node[()].ravel(), 1):
        element = node.file[reference]
        if isinstance(element, h5py.Dataset):  # groups could lead back here
            yield from _flat_v73(h5py, f"{name}({i}).{field}", element)


def _complex(x: np.ndarray) -> np.ndarray:
    return x["real"] + 1j * x["imag"] if x.dtype.names == ("real", "imag") else x
