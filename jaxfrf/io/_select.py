"""Find in a file what `--map` names: variables, struct fields, stacked, picked or transposed channels."""

import pathlib
import re
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError, input_error
from ._container import Leaf, Unreadable
from .record_arguments import nearest, split

_EXPRESSION = re.compile(r"(?P<name>.+?)(?P<transposed>')?(?:\[(?P<pick>[^\[\]]*)\])?")
_COLUMNS = re.compile(r"(?P<file>(?:.+:)?)(?P<first>\d+):(?P<last>\d+)")  # of one of several files: `a.csv:2:4`
_LISTED = 20  # names in a message
NOT_THERE = "no such variable"

# Parts of names that loggers give to the signals, most telling first; only used for proposals in messages.
_HINTS = {
    "u": ("torque", "tau", "trq", "current", "iq", "input", "force", "volt"),
    "y": ("omega", "speed", "spd", "vel", "acc", "pos", "theta", "angle", "output"),
}
_OF_REFERENCES = ("ref", "des", "set")


def select(path: pathlib.Path, variables: Mapping[str, Leaf], key: str, expression: str) -> np.ndarray | str:
    """What `expression` says, as an array or text.

    **Raises:** `jaxfrf.InputError` with the names that the file has, if one of them is missing or holds no
    numbers.
    """
    expression = expression.strip()
    if expression in variables:
        return _usable(path, key, expression, variables[expression])
    if expression.startswith("[") and expression.endswith("]"):
        parts = [select(path, variables, key, part) for part in split(expression[1:-1], ";")]
        return _stack(path, key, expression, parts)
    columns = _COLUMNS.fullmatch(expression)
    if columns and f"{columns['file']}1" in variables:
        return _columns(path, variables, key, columns)
    match = _EXPRESSION.fullmatch(expression)
    name = match["name"].strip() if match else expression
    if match is None or name not in variables:
        raise missing(path, variables, key, name)
    x = _usable(path, key, name, variables[name])
    if isinstance(x, str):
        return x
    if match["transposed"]:
        x = np.swapaxes(x, -1, -2) if x.ndim > 1 else x
    return x if match["pick"] is None else _pick(path, key, expression, x, match["pick"])


def _columns(path: pathlib.Path, variables: Mapping[str, Leaf], key: str, columns: re.Match[str]) -> np.ndarray:
    """Columns `2:4` of a table without headings: the second to the fourth, as people count."""
    file, first, last = columns["file"], int(columns["first"]), int(columns["last"])
    if not 1 <= first <= last or f"{file}{last}" not in variables:
        count = sum(name.startswith(file) and name.removeprefix(file).isdigit() for name in variables)
        raise input_error(
            f"{path}: {_label(key, columns[0])}",
            f"columns {first}:{last}",
            f"a part of 1:{count}, the last included",
            "Columns of a table without headings are counted from 1.",
        )
    parts = [_usable(path, key, name, variables[name]) for name in (f"{file}{i}" for i in range(first, last + 1))]
    return _stack(path, key, columns[0], parts)


def missing(path: pathlib.Path, variables: Mapping[str, Leaf], key: str, name: str) -> InputError:
    """The error for a name that the file does not have: what it has, and a `--map` that would work."""
    if {"G", "frequency"} <= set(variables):
        return input_error(
            f"{path}",
            "an FRF",
            "a record with u and y",
            f"Look at it: jaxfrf view {path}. Take it to parameters: jaxfrf identify {path}.",
        )
    like = nearest(name, list(variables)) if name != key else None
    do = [f"Did you mean --map {key}={_quoted(like)}?"] if like else []
    if name.isdigit() and "1" in variables:
        do = ["Columns of a table without headings are counted from 1."]
    elif name != key and like is None:
        do = [f"Of another file of the same record: give both, and --map {key}=FILE:NAME."]
    example = propose(variables)
    if example:
        do.append(f'Say which is which, for example --map "{example}".')
    do.append(f"The file has {listing(variables)}.")
    what = f"{path}: {key}" if name == key else f"{path}: {key} ({name})"
    return input_error(what, NOT_THERE, _MEANING.get(key, f"the variable of {key}"), " ".join(do))


_MEANING = {
    "u": "the plant input u",
    "y": "the plant output y",
    "r": "the reference r",
    "fs": "the sampling frequency fs (Hz), or a time vector t (s)",
    "t": "a time vector t (s)",
}


def _size(value: Leaf) -> int:
    return value.size if isinstance(value, np.ndarray) else 1


def listing(variables: Mapping[str, Leaf]) -> str:
    """Names with their shapes, the largest first, for messages."""
    by_size = sorted(variables.items(), key=lambda item: -_size(item[1]))  # records first
    known = [f"{name} {_says(value)}" for name, value in by_size]
    rest = len(known) - _LISTED
    return ", ".join(known[:_LISTED]) + (f" and {rest} more" if rest > 0 else "")


def propose(variables: Mapping[str, Leaf]) -> str | None:
    """A `--map` for u and y that names records of this file, as likely ones as their names can tell."""
    records = _records(variables)
    if len(records) < 2:
        return None
    chosen: dict[str, str] = {}
    for key in ("u", "y"):
        free = [name for name in records if name not in chosen.values()]
        chosen[key] = key if key in free else _likely(key, free)
    return ",".join(f"{key}={name}{_turn(variables[name])}" for key, name in chosen.items())


def signals_of(variables: Mapping[str, Leaf]) -> list[str]:
    """Names of the longest arrays but those of time."""
    sizes = {n: x.size for n, x in variables.items() if isinstance(x, np.ndarray) and x.dtype.kind in "fiu"}
    longest = max(sizes.values(), default=0)
    return [n for n, size in sizes.items() if size == longest > 1 and not TIME.fullmatch(n.split(".")[-1].lower())]


def sounds_like(key: str, name: str) -> bool:
    """Whether a name sounds like that of u or y."""
    last = name.split(".")[-1].lower()
    return last == key or any(hint in last for hint in _HINTS[key])


TIME = re.compile(r"t|t[\W_].*|(tim|zeit|temps|tempo|tiempo|clock).*|.*[\W_](time|zeit)|.*time_?stamp|sec(ond)?s?")
"""Names that sound like time."""


def time_like(variables: Mapping[str, Leaf], samples: int) -> list[str]:
    """Names of vectors of so many samples that sound like time."""
    return [
        name
        for name, x in variables.items()
        if isinstance(x, np.ndarray) and x.size == samples and TIME.fullmatch(name.split(".")[-1].lower())
    ]


def _likely(key: str, names: Sequence[str]) -> str:
    """Prefer names that sound right and sound neither like a reference nor like time; a command may be an
    input, and no output."""
    timeless = [n for n in names if "time" not in n.lower()] or list(names)
    others = (*_OF_REFERENCES, "cmd") if key == "y" else _OF_REFERENCES
    plain = [n for n in timeless if not any(h in n.lower() for h in others)]
    for among in (plain, timeless):
        for hint in _HINTS[key]:
            for name in among:
                if hint in name.split(".")[-1].lower():
                    return name
    return (plain or timeless)[0]


def _records(variables: Mapping[str, Leaf]) -> list[str]:
    """Names of the longest arrays of one length: there are always at least two of them, u and y."""
    lengths = {
        name: max(x.shape)
        for name, x in variables.items()
        if isinstance(x, np.ndarray) and x.dtype.kind in "fiu" and x.size > 1
    }
    found = list(lengths.values())
    longest = max((n for n in found if found.count(n) > 1), default=0)
    return [name for name, length in lengths.items() if length == longest]


def _turn(x: Leaf) -> str:
    return "'" if isinstance(x, np.ndarray) and x.ndim == 2 and 1 < x.shape[0] < x.shape[1] else ""


def _usable(path: pathlib.Path, key: str, name: str, x: Leaf) -> np.ndarray | str:
    if isinstance(x, Unreadable) and x.error:
        raise InputError(x.error)
    if isinstance(x, Unreadable):
        what = f"{path}: {_label(key, name)}"
        if key.endswith("_quantity"):
            do = f"Store a char array (single quotes in MATLAB), or set it: --set {key}=velocity."
            raise input_error(what, x.kind, "text", do)
        do = "Store it as a plain numeric array."
        if "object" in x.kind:  # timeseries, timetable, Simulink's Dataset
            do += " In MATLAB: t = x.Time; y = x.Data; save(file, 't', 'y') (of a Dataset: x = logsout{1}.Values)."
        raise input_error(what, x.kind, "an array of real numbers", do)
    return x


def _stack(path: pathlib.Path, key: str, expression: str, parts: Sequence[np.ndarray | str]) -> np.ndarray:
    columns = [column(np.asarray(part)) for part in parts]
    if len({x.shape[:-1] for x in columns}) > 1:
        raise input_error(
            f"{path}: {_label(key, expression)}",
            f"shapes {', '.join(str(x.shape) for x in columns)}",
            "as many samples in every part",
            "Name records of the same length.",
        )
    return np.concatenate(columns, axis=-1)


def _pick(path: pathlib.Path, key: str, expression: str, x: np.ndarray, pick: str) -> np.ndarray:
    x = column(x)
    try:
        numbers = [int(n) if n.strip() else None for n in pick.split(":")]
        chosen = slice(*numbers) if len(numbers) > 1 else slice(int(pick), int(pick) + 1)
        picked = x[..., chosen] if 1 <= len(numbers) <= 2 else x[..., :0]
    except (ValueError, TypeError):
        picked = x[..., :0]
    if picked.shape[-1] == 0:
        raise input_error(
            f"{path}: {_label(key, expression)}",
            f"no channel [{pick}]",
            f"channels 0 to {x.shape[-1] - 1} of shape {x.shape}",
            "Write NAME[3] or NAME[0:3], counted from 0, the stop not included.",
        )
    return picked


def column(x: np.ndarray) -> np.ndarray:
    """A vector, whichever way it lies, as (time, 1); anything else as it is."""
    return x.reshape(-1, 1) if x.ndim == 1 or (x.ndim == 2 and 1 in x.shape) else x


def _label(key: str, name: str) -> str:
    return key if name == key else f"{key} ({name})"


def _quoted(name: str) -> str:
    return name if re.fullmatch(r"[\w.]+", name) else f'"{name}"'


def _says(value: Leaf) -> str:
    if isinstance(value, Unreadable):
        return f"({value.kind})"
    if isinstance(value, str):
        return "(text)"
    return "(one number)" if value.size == 1 else str(value.shape)
