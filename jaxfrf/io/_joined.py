"""One record whose channels stand in several files: `u=currents.csv:tau1,y=angles.csv:q1`."""

import pathlib
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import input_error
from ._container import Leaf, Variables
from .record_arguments import MAPPED, SIGNALS, split

_LATE = 0.5  # sample intervals that the clocks of two files may differ by


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


def joined(files: Mapping[pathlib.Path, Mapping[str, Leaf]]) -> Variables:
    """The variables of all files as `FILE:NAME`, and what is no signal (time, fs, period) under its own name, too.

    **Raises:** `jaxfrf.InputError` where the files' time vectors are different clocks.
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
                _check_same(path, name, found.get(name), value)
                units.setdefault(name, said.get(name, ""))
                found.setdefault(name, value)
    return Variables(found, units)


def _check_same(path: pathlib.Path, name: str, first: Leaf | None, other: Leaf) -> None:
    if first is None or isinstance(first, str) or isinstance(other, str):
        return
    a, b = np.ravel(np.asarray(first)), np.ravel(np.asarray(other))
    numbers = a.dtype.kind in "biuf" and b.dtype.kind in "biuf"
    step = abs(a[-1] - a[0]) / (a.size - 1) if numbers and name == "t" and a.size > 1 else 0.0
    if numbers and (a.shape != b.shape or np.any(np.abs(a - b) > _LATE * step)):
        raise input_error(
            f"{path}: {name}",
            f"another {name} than in the file before it",
            "one clock for all files of a record",
            "Resample them to one time vector, or cut them to their common part.",
        )
