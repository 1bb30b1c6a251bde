"""Designs of experiments in TOML.

Every key, by example:

    name = "wrist, small"            # optional
    fs = 2000.0                      # Hz
    period = 56000                   # samples
    inputs = 6                       # optional where a list below tells it
    blocks = 4                       # realisations of `inputs` experiments each; default 1
    seed = 0                         # of the random phases and lines; default 0
    periods = 1                      # steady periods to record; default 1
    transient_periods = 1            # leading periods to drop; default 0
    ramp = 3.0                       # s, fade-in from rest within the transient periods; default 0: a step
    velocity_limit = [400.0, ...]    # rad/s, highest |reference|, one number or one per input; optional
    travel_limit = 20.0              # rad, farthest from rest, and
    acceleration_limit = 3e4         # rad/s^2, likewise

    [lines]                          # the excited DFT lines
    grid = "log-odd"                 # "full", "odd", "random-odd", "log-odd" or "list"
    band = [4.0, 80.0]               # Hz; every grid but "list"
    points = 366                     # "log-odd": points on the logarithmic axis before rounding
    group = 4                        # "random-odd": one line in every group is left out; default 4
    list = [113, 115, ...]           # "list"

    [multisine]
    rms = [2.0, 2.0, 2.0, 4.0, 4.0, 6.0]   # rad/s, one number or one per input; default 1
    phases = "random"                # "random" (default), "schroeder" or "crest-optimised"

    [multisine.spectrum]             # optional, flat by default; straight between these on logarithmic axes
    frequency = [4.0, 20.0, 80.0]    # Hz
    amplitude = [1.0, 1.0, 0.5]      # for all inputs, or one list per input: peak of the sine at each
                                     # line, rad/s; only the shape counts if `rms` is given

    [slow_sine]                      # optional: keeps the joints moving, below the band
    lines = [21, 23, 25, 27, 29, 31] # one DFT line per input
    amplitude = [30.0, 30.0, 30.0, 40.0, 40.0, 40.0]   # rad/s
"""

import difflib
import os
import pathlib
from collections.abc import Callable, Iterable, Mapping

import jax.random as jr
import numpy as np

from .. import excitation
from .._arguments import expect_path
from .._errors import InputError, input_error
from ..excitation import LIMITS, PHASES, Multisine, SlowSine
from ._toml import read_toml

_RECORD = ("fs", "period", "blocks", "seed", "periods", "transient_periods", "ramp", *LIMITS)
_TOP = ("name", "inputs", *_RECORD, "lines", "multisine", "slow_sine")
_LINES_STREAM = 0x6C696E65  # keeps the draw of the lines apart from those of the blocks, which count from 0


def read_design(path: str | os.PathLike) -> Multisine:
    """Read a DESIGN.toml; the page *Keys of robots and designs* of the book shows every key.

    **Arguments:** `path`: of the file.

    **Returns:** the design, with frequencies in Hz and amplitudes in rad/s.

    **Raises:** `jaxfrf.InputError` naming the file, the key, what was found and what was expected; an
    unknown key is an error that names the nearest known one.
    """
    expect_path("path", path)
    path = pathlib.Path(path)
    if not path.is_file():
        raise input_error(str(path), "no such file", "a design in TOML", "Check the name and the folder.")
    table = read_toml(path, "a design in TOML", "The page keys.md of the book shows every key.")
    try:
        return design_from_table(table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def design_from_table(table: Mapping) -> Multisine:
    """The design that a parsed DESIGN.toml describes.

    **Arguments:** `table`: what `tomllib.load` gives; its keys are those of the file, frequencies in Hz, amplitudes in
    rad/s.

    **Returns:** the design.

    **Raises:** `jaxfrf.InputError` naming the key: unknown (with the nearest known one), missing, or with a value that
    no design can have.
    """
    _check_keys("design", table, required=("fs", "period", "lines"))
    record = {name: table[name] for name in _RECORD if name in table}
    signal = _section(table, "multisine")
    _check_keys("[multisine]", signal)
    excited = _section(table, "lines")
    _check_lines_table(excited)
    # The rate and the length must be sound before a band in Hz can be turned into lines.
    probe = Multisine(table["fs"], table["period"], [1], seed=table.get("seed", 0))
    lines = _lines(excited, probe)
    return Multisine(
        lines=lines,
        n_in=table.get("inputs"),
        rms=signal.get("rms"),
        amplitude=_spectrum(signal, np.asarray(lines) * probe.fs / probe.period),
        phases=_phases(signal.get("phases", "random")),
        slow=_slow_sine(table),
        **record,
    )


def _full(table, band, seed):
    return excitation.full_lines(*band)


def _odd(table, band, seed):
    return excitation.odd_lines(*band)


def _random_odd(table, band, seed):
    group = _whole(table, "group", 4)
    return excitation.random_odd_lines(*band, group=group, key=jr.fold_in(jr.key(seed), _LINES_STREAM))


def _log_odd(table, band, seed):
    return excitation.log_odd_lines(*band, _whole(table, "points"))


def _list(table, band, seed):
    return table["list"]


# What each grid needs beside `grid`, what it may have, and how it is made.
_GRIDS: dict[str, tuple[tuple[str, ...], tuple[str, ...], Callable]] = {
    "full": (("band",), (), _full),
    "odd": (("band",), (), _odd),
    "random-odd": (("band",), ("group",), _random_odd),
    "log-odd": (("band", "points"), (), _log_odd),
    "list": (("list",), (), _list),
}
_LINE_KEYS = ("grid", *dict.fromkeys(key for needs, may, _ in _GRIDS.values() for key in needs + may))

_KEYS: dict[str, tuple[str, ...]] = {
    "design": _TOP,
    "[lines]": _LINE_KEYS,
    "[multisine]": ("rms", "phases", "spectrum"),
    "[multisine.spectrum]": ("frequency", "amplitude"),
    "[slow_sine]": ("lines", "amplitude"),
}
_AT_THE_TOP = "at the top, before every table"


def _check_lines_table(table: Mapping) -> None:
    _check_keys("[lines]", table, required=("grid",))
    needs, may, _ = _choice("[lines] grid", table["grid"], _GRIDS)
    _check_these(f"[lines] with grid {table['grid']!r}", table, ("grid", *needs, *may), required=needs)


def _lines(table: Mapping, probe: Multisine):
    *_, make = _GRIDS[table["grid"]]
    band = None
    if "band" in table:
        low, high = _pair("[lines] band", table["band"])
        band = excitation.band_lines(low, high, probe.fs, probe.period)
    return make(table, band, probe.seed)


def _spectrum(signal: Mapping, frequency):
    if "spectrum" not in signal:
        return None
    table = _section(signal, "spectrum")
    _check_keys("[multisine.spectrum]", table, required=_KEYS["[multisine.spectrum]"])
    return excitation.shaped_amplitude(frequency, table["frequency"], table["amplitude"])


def _slow_sine(table: Mapping) -> SlowSine | None:
    if "slow_sine" not in table:
        return None
    slow = _section(table, "slow_sine")
    _check_keys("[slow_sine]", slow, required=_KEYS["[slow_sine]"])
    return SlowSine(slow["lines"], slow["amplitude"])


def _phases(name):
    return _choice("[multisine] phases", name, PHASES)()


def _section(table: Mapping, name: str) -> Mapping:
    section = table.get(name, {})
    if not isinstance(section, Mapping):
        raise input_error(name, f"{section!r}", f"a table [{name}]", "See the example design.")
    return section


def _check_keys(where: str, table: Mapping, required: Iterable[str] = ()) -> None:
    """Refuse keys that a table of this name does not have, and one that lacks some."""
    _check_these(where, table, _KEYS[where], required)


def _check_these(where: str, table: Mapping, known: Iterable[str], required: Iterable[str] = ()) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            raise input_error(
                where, f"the key {key!r}", f"one of {', '.join(known)}", _misplaced(where, key) or _advice(key, known)
            )
    for key in required:
        if key not in table:
            raise input_error(where, f"no {key!r}", "this key", "Add it.")


def _choice(where: str, name, choices: Mapping):
    if not isinstance(name, str) or name not in choices:
        raise input_error(where, repr(name), f"one of {', '.join(choices)}", _advice(str(name), choices))
    return choices[name]


def _misplaced(where: str, key: str) -> str:
    """Where a key stands that is known in another table; empty for others."""
    places = [place for place, keys in _KEYS.items() if key in keys and not where.startswith(place)]
    named = " or ".join(_AT_THE_TOP if place == "design" else f"in {place}" for place in places)
    return f"It stands {named}." if places else ""


def _advice(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"Did you mean {close[0]!r}?" if close else "Remove it, or see the example design."


def _pair(where: str, value) -> tuple[float, float]:
    numbers = isinstance(value, list) and all(type(x) in (int, float) for x in value)
    if not numbers or len(value) != 2:
        raise input_error(where, f"{value!r}", "two numbers [low, high], Hz", "E.g. band = [4.0, 80.0].")
    return value[0], value[1]


def _whole(table: Mapping, key: str, default: int | None = None) -> int:
    value = table.get(key, default)
    if type(value) is not int:
        raise input_error(f"[lines] {key}", f"{value!r}", "a whole number", f"E.g. {key} = 4.")
    return value
