"""One record whose channels stand in several files: `u=currents.csv:tau1,y=angles.csv:q1`."""

import dataclasses
import pathlib
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import input_error
from .._text import number
from ..units import known_unit
from ._container import Leaf, Variables, load
from ._select import TIME, signals_of, sounds_like
from .record_arguments import MAPPED, SIGNALS, split

_LATE = 0.5  # sample intervals that the clocks of two files may differ by
_UNIT = 1e-3  # powers of 1000: steps that differ by one to within .7 % are in another unit


def part_of(expression: str, files: Sequence[pathlib.Path]) -> pathlib.Path | None:
    """The file that an expression names, or the first of several in brackets."""
    inner = expression.strip().lstrip("[")
    return next((f for f in files if inner.startswith((f"{f.name}:", f"{f}:"))), None)


def expanded(names: Mapping[str, str], files: Sequence[pathlib.Path]) -> dict[str, str]:
    """`a.csv:[x;y]` as `[a.csv:x;a.csv:y]`, files by their names alone.

    **Raises:** `jaxfrf.InputError` where a signal does not say its file, or two files have one name.
    """
    short = [f.name for f in files]
    if len(set(short)) < len(short):
        raise input_error("files", "two of one name", "different names", "Rename one of them.")
    return {key: _expanded(key, name.strip(), files) for key, name in names.items()}


def propose_joined(files: Sequence[pathlib.Path]) -> str | None:
    """A `--map` that takes u and y from two files, unless one sounds as if it held both."""
    if len(files) != 2 or files[0].name == files[1].name:
        return None
    names = [signals_of(load(file)) for file in files]
    if not all(names) or _may_be_whole(names[0]) or _may_be_whole(names[1]):
        return None
    swapped = _likeness("y", files[0], names[0]) + _likeness("u", files[1], names[1])
    plain = _likeness("u", files[0], names[0]) + _likeness("y", files[1], names[1])
    order = zip(("y", "u") if swapped > plain else ("u", "y"), files, names, strict=True)
    return ",".join(f"{key}={file.name}:{_channels(own)}" for key, file, own in sorted(order, key=lambda x: x[0]))


def _may_be_whole(names: Sequence[str]) -> bool:
    return all(any(sounds_like(key, name) for name in names) for key in ("u", "y"))


def _likeness(key: str, file: pathlib.Path, names: Sequence[str]) -> int:
    return sum(sounds_like(key, name) for name in names) + sounds_like(key, file.stem)


def _channels(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"[{';'.join(names)}]"


def _expanded(key: str, name: str, files: Sequence[pathlib.Path]) -> str:
    if name.startswith("[") and name.endswith("]"):
        return f"[{';'.join(_expanded(key, part, files) for part in split(name[1:-1], ';'))}]"
    file = part_of(name, files)
    if file is None and key in SIGNALS:
        raise input_error(
            f"--map {key}",
            repr(name),
            f"FILE:NAME with one of {', '.join(f.name for f in files)}, as the other signals",
            f"Write e.g. {key}={files[0].name}:{name}.",
        )
    if file is None:
        return name
    rest = name.removeprefix(f"{file}:").removeprefix(f"{file.name}:")
    if rest.startswith("[") and rest.endswith("]"):
        return f"[{';'.join(f'{file.name}:{part}' for part in split(rest[1:-1], ';'))}]"
    return f"{file.name}:{rest}"


def joined(files: Mapping[pathlib.Path, Mapping[str, Leaf]], anyway: bool = False) -> Variables:
    """The variables of all files as `FILE:NAME`, and what is no signal (time, fs, period) under its own name, too.

    **Raises:** `jaxfrf.InputError` where the files say different rates, periods or, unless `anyway`, times.
    """
    found: dict[str, Leaf] = {}
    units: dict[str, str] = {}
    for path, variables in files.items():
        said = getattr(variables, "units", {})
        aliases = getattr(variables, "aliases", {})
        for name, value in {**variables, **{alias: variables[name] for alias, name in aliases.items()}}.items():
            found[f"{path.name}:{name}"] = value
            units[f"{path.name}:{name}"] = said.get(name, "")
            if name in MAPPED and name not in SIGNALS:
                if name != "t":
                    _check_same(path, name, found.get(name), value)
                units.setdefault(name, said.get(name, ""))
                found.setdefault(name, value)
    if not anyway:
        _check_clocks(files)
    return Variables(found, units)


def _check_same(path: pathlib.Path, name: str, first: Leaf | None, other: Leaf) -> None:
    if first is None or isinstance(first, str) or isinstance(other, str):
        return
    a, b = np.ravel(np.asarray(first)), np.ravel(np.asarray(other))
    if a.dtype.kind in "biuf" and b.dtype.kind in "biuf" and not np.array_equal(a, b):
        raise input_error(
            f"{path}: {name}",
            f"another {name} than in the file before it",
            f"one {name} for all files of a record",
            f"Correct one of them, or set it: --set {name}=VALUE.",
        )


@dataclasses.dataclass(frozen=True)
class _Clock:
    path: pathlib.Path
    name: str
    time: np.ndarray  # (time,)

    @property
    def step(self) -> float:
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)


def _check_clocks(files: Mapping[pathlib.Path, Mapping[str, Leaf]]) -> None:
    """**Raises:** `jaxfrf.InputError` where two files have time columns that are different times."""
    clocks = [clock for path, variables in files.items() if (clock := _clock(path, variables)) is not None]
    for clock in clocks[1:]:
        if (found := _differs(clocks[0], clock)) is not None:
            raise input_error(
                f"{clock.path}: {clock.name}",
                f"{found} by {clocks[0].name} of {clocks[0].path.name}",
                "one time for all files of a record",
                "Resample them to one time vector, or cut them to their common part; --anyway takes them sample by "
                "sample as they are.",
            )


def _clock(path: pathlib.Path, variables: Mapping[str, Leaf]) -> _Clock | None:
    """The time column of a file, in s where its unit is known: one that sounds like time and increases."""
    units = getattr(variables, "units", {})
    aliases = {name: alias for alias, name in getattr(variables, "aliases", {}).items()}
    for name, value in variables.items():
        if not TIME.fullmatch(aliases.get(name, name).split(".")[-1].lower()) or isinstance(value, str):
            continue
        time = np.ravel(np.asarray(value))
        if time.size > 2 and time.dtype.kind in "iuf" and np.isfinite(time).all() and np.all(np.diff(time) >= 0):
            if time[-1] > time[0]:
                known = known_unit(units.get(name, ""))
                return _Clock(path, name, time.astype(np.float64) * (known[1] if known else 1.0))
    return None


def _differs(first: _Clock, other: _Clock) -> str | None:
    """What is different about another clock; `None` if nothing is. Where only one says that it is in ms, the other one
    is taken to be in what makes the rates the same."""
    power = np.log10(other.step / first.step) / 3
    unit = 1e3 ** round(power) if abs(power - round(power)) < _UNIT else 1.0
    time, step = other.time / unit, other.step / unit
    if abs(step / first.step - 1) * min(len(time), len(first.time)) > _LATE:
        return f"steps of {number(step, 4)} s, which are {number(first.step, 4)} s"
    late = float(time[0] - first.time[0])
    if abs(late) > _LATE * first.step:
        return f"a beginning at {number(time[0], 6)} s, which is {number(first.time[0], 6)} s"
    if len(time) != len(first.time):
        return f"{len(time)} samples, which are {len(first.time)}"
    if np.any(np.abs(time - first.time) > _LATE * first.step):
        return "times that are others"
    return None
