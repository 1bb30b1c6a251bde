"""One door to every file format: load named variables from a file, save them to one, whole or not at all.

`_formats.RECORDS` lists the modules that do it.
"""

import contextlib
import dataclasses
import importlib
import math
import os
import pathlib
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from .._errors import InputError, input_error
from .._files import check_readable, replacing
from ._formats import RECORDS, SAVED


@dataclasses.dataclass(frozen=True)
class Unreadable:
    """Stands for a variable that is neither numbers nor text: `kind` says what it is (a cell array), `error` what to
    tell who asks for it, where its reader knows that better."""

    kind: str
    error: str = ""


@dataclasses.dataclass(frozen=True)
class Later:
    """Shape and type of an array whose numbers come block by block."""

    shape: tuple[int, ...]
    dtype: np.dtype = np.dtype(float)

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


@dataclasses.dataclass(frozen=True)
class Variable:
    """An array to be saved, with the name of every axis, its unit, and what else NetCDF keeps of it."""

    dims: tuple[str, ...]
    value: np.ndarray | Later
    unit: str = ""
    attributes: Mapping[str, object] = dataclasses.field(default_factory=dict)


Put = Callable[[str, int, np.ndarray], None]  # name, first position, numbers of some positions


Leaf = np.ndarray | str | Unreadable


class Variables(dict[str, Leaf]):
    """Variables by name, with the units (as the file writes them) of those that have one, and other names for some of
    them (`speed` for `speed [deg/s]`)."""

    def __init__(
        self,
        variables: Mapping[str, Leaf],
        units: Mapping[str, str] | None = None,
        aliases: Mapping[str, str] | None = None,
    ):
        super().__init__(variables)
        self.aliases = dict(aliases or {})
        self.units = {name: unit for name, unit in (units or {}).items() if unit}
        self.units |= {alias: self.units[name] for alias, name in self.aliases.items() if name in self.units}

    def __contains__(self, name) -> bool:
        return super().__contains__(name) or name in self.aliases

    def __missing__(self, name: str) -> Leaf:
        return self[self.aliases[name]]


Attributes = Mapping[str, float | int | str]


def positions_in(path: str | os.PathLike) -> int | None:
    """How many positions a file holds that can be read one by one; `None` where it cannot be."""
    path = pathlib.Path(path)
    reader = _format(path, tuple(RECORDS), "read")
    if not hasattr(reader, "positions"):
        return None
    check_file(path)
    try:
        return reader.positions(path)
    except (InputError, ImportError):
        raise
    except Exception:  # of a broken file, of which reading it says what is wrong
        return None


def size_in(path: str | os.PathLike) -> float:
    """Bytes of the arrays in a file as its header states them; of other formats, and of a broken file, those on the
    disk."""
    path = pathlib.Path(path)
    reader = _format(path, tuple(RECORDS), "read")
    check_file(path)
    if hasattr(reader, "size"):
        with contextlib.suppress(Exception):  # reading it says what is wrong
            return reader.size(path)
    return path.stat().st_size


def load(path: str | os.PathLike, part: slice | None = None, without: str | None = None) -> dict[str, Leaf]:
    """All variables of a file by name, fields of structs as `rec.vel`; see `_formats` for its kinds.

    `part`: at these positions alone, of files with `positions_in`; `without`: but for arrays that have this axis.

    **Raises:** `jaxfrf.InputError` naming the file if it is missing, empty, truncated or of no known kind.
    """
    path = pathlib.Path(path)
    reader = _format(path, tuple(RECORDS), "read")
    check_file(path)
    try:
        found = reader.load(path) if part is None else reader.load(path, part, without)
    except (InputError, ImportError):
        raise
    except MemoryError as error:
        raise input_error(
            str(path),
            f"more than fits into memory ({_first_line(error)})",
            "a record that fits",
            "Split it, or cut it.",
        ) from error
    except Exception as error:  # parsers of broken files raise anything, from zlib.error to IndexError
        raise input_error(
            str(path),
            f"{reader.KIND} that cannot be read ({type(error).__name__}: {_first_line(error)})",
            "a whole file of the kind that its extension says",
            "It may be truncated, still being written, or have the wrong extension: copy or export it again.",
        ) from error
    if not found:
        raise input_error(str(path), "no variables", "named arrays", "Export or copy it again.")
    return found


def check_file(path: pathlib.Path) -> None:
    """Refuse what is no file, or an empty one."""
    check_readable(path, "a measurement file")
    if path.is_file() and path.stat().st_size == 0:
        raise input_error(str(path), "an empty file (0 bytes)", "a measurement file", "Export or copy it again.")


def save(path: str | os.PathLike, variables: Mapping[str, Variable], attributes: Attributes) -> None:
    """Write arrays and scalars (numbers or text) to one of the formats of `_formats.SAVED`, whole or not at all.

    **Raises:** `jaxfrf.InputError` if the folder does not exist or the extension is not known; nothing is
    written then.
    """
    path = pathlib.Path(path)
    writer = _format(path, SAVED, "written")
    with replacing(path) as temporary:
        writer.save(temporary, variables, attributes)


def _allocated(value: np.ndarray | Later) -> np.ndarray:
    return np.empty(value.shape, value.dtype) if isinstance(value, Later) else value


@contextlib.contextmanager
def save_blocks(path: str | os.PathLike, variables: Mapping[str, Variable], attributes: Attributes) -> Iterator[Put]:
    """As `save`, with arrays that come position by position (`Later`): `put(name, first, numbers)` in the block.

    NetCDF and Zarr go to the disk as they come, other formats at the end.
    """
    path = pathlib.Path(path)
    writer = _format(path, SAVED, "written")
    with replacing(path) as temporary:
        if hasattr(writer, "blocks"):
            with writer.blocks(temporary, variables, attributes) as put:
                yield put
            return
        arrays = {name: _allocated(v.value) for name, v in variables.items()}
        whole = {name: dataclasses.replace(v, value=arrays[name]) for name, v in variables.items()}

        def put(name: str, first: int, value: np.ndarray) -> None:
            arrays[name][first : first + len(value)] = value

        yield put
        writer.save(temporary, whole, attributes)


def text(value) -> str:
    """Text from what a file holds for it: str, bytes, or an array of one of them."""
    value = np.asarray(value)
    item = value.item() if value.size == 1 else "".join(str(x) for x in value.ravel())
    return item.decode(errors="replace") if isinstance(item, bytes) else str(item)


def _format(path: pathlib.Path, known: tuple[str, ...], action: str):
    suffix = path.suffix.lower()
    if suffix not in known:
        raise input_error(
            str(path),
            f"the extension {suffix!r}" if suffix else "no extension",
            f"a file that can be {action}: {', '.join(known)}",
            "Convert the file, or give it the extension that it should have.",
        )
    return importlib.import_module(f".{RECORDS[suffix]}", __package__)


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else "no further message"
