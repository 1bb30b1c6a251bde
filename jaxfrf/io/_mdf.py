"""Measurement files of vehicles and test benches (MDF 3 and 4, `.mf4`, `.mdf`, `.dat`) through asammdf."""

import pathlib

import numpy as np

from .._memory import check_memory
from ._container import Leaf, Unreadable, Variables
from ._optional import require

KIND = "an MDF file"

_UNIFORM = 1e-3  # sample intervals between two time vectors that are one


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """Every channel by name, with its unit, and a time vector `t` (s) where all channels share one; channels of other
    groups have their time vector as `NAME.t`. A name that stands in several groups is `NAME@GROUP`, from 1.
    """
    with require("asammdf", "mdf").MDF(path) as file:
        groups = [(i, group.channel_group.cycles_nr, len(group.channels)) for i, group in enumerate(file.groups)]
        check_memory(str(path), 16.0 * sum(n * m for _, n, m in groups), "Cut the file to what is needed.")
        signals = [(i + 1, x) for i, n, _ in groups if n for x in _signals(file, i)]
    names = [x.name for _, x in signals]
    found: dict[str, Leaf] = {}
    units = {}
    times = [np.asarray(x.timestamps) for _, x in signals]
    shared = bool(times) and all(_same(times[0], t) for t in times)
    for group, x in signals:
        name = x.name if names.count(x.name) == 1 else f"{x.name}@{group}"
        value = np.asarray(x.samples)
        found[name] = value if value.dtype.kind in "biuf" else Unreadable(f"a channel of {value.dtype}")
        units[name] = x.unit or ""
        if not shared:
            found[f"{name}.t"] = np.asarray(x.timestamps)
    if shared and "t" not in found:
        found["t"] = times[0]
    return Variables(found, units)


def _signals(file, group: int):
    """The channels of a group but its time master."""
    master = file.masters_db.get(group)
    wanted = [(None, group, i) for i in range(len(file.groups[group].channels)) if i != master]
    return file.select(wanted, copy_master=False) if wanted else []


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    if len(a) != len(b):
        return False
    step = abs(a[-1] - a[0]) / max(len(a) - 1, 1)
    return bool(np.all(np.abs(a - b) <= _UNIFORM * step)) if len(a) else True
