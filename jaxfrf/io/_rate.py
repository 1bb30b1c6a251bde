"""The sampling frequency of a record, from what the file, the caller and the time vector say."""

import dataclasses
import re

import numpy as np

from .._errors import InputError
from .._text import counted, number
from ._container import Unreadable
from ._select import column, time_like
from ._variables import File, numbers, scalar, scaled

_RATE = 1e-3  # relative difference of fs and the time vector that counts as a contradiction
_UNIFORM = 0.05  # sample intervals that a time stamp may stand off the uniform grid
_UNITS_OF_TIME = (1.0, 1e-3, 1e-6, 1e-9)  # s
_SELDOM, _NEAR_WHOLE = 0.01, 0.3  # of all steps, that are gaps; intervals that a step may be off a whole number of them
_ROUNDED = 1.5  # of a step of the stamps' clock that they may be off
_LIKELY_WHOLE = 1e-5  # as the next, of a slope through stamps that scatter
_WHOLE = 1e-6  # a rate this close to a whole number of Hz is that number (time stamps are rounded)


def sampling_frequency(file: File, n_time: int) -> tuple[float, list[str]]:
    """fs from the file, the caller or the time vector, and remarks on it; all that is known must agree."""
    fs = scalar(file, "fs", None)
    file = _with_time(file, n_time) if fs is None else file
    named = "t" in file.given.names
    time = None if fs is not None and not named and _is_closed(file, "t") else file.get("t")
    if fs is not None and not named and not _is_time(time, n_time):
        return fs, _contradictions(file, fs, n_time)
    if time is None or (not named and np.size(time) == 1):
        raise _no_rate(file, n_time)
    stamps = scaled(file, "t", column(numbers(file, "t", time)))
    rate, deviation = _rate(file, stamps, n_time)
    if fs is None:
        if deviation > _UNIFORM:
            raise file.error("t", *_unevenness(stamps.ravel().astype(np.float64), deviation))
        return rate, []
    if fs > 0 and abs(rate / fs - 1) > _RATE:
        raise file.error(
            "fs",
            f"{fs:g} Hz against {rate:g} Hz by the time vector {file.label('t')}",
            "the same rate by both",
            _rate_advice(rate / fs, rate),
        )
    if deviation > _UNIFORM:
        return fs, [
            f"the time stamps {file.label('t')} stand up to {number(deviation, 2)} sample intervals off a uniform "
            "grid: samples may be missing or late."
        ]
    return fs, []


def _with_time(file: File, n_time: int) -> File:
    """A column called `time` is `t`, where nothing else is and no rate is said."""
    alike = [name for name in time_like(file.variables, n_time) if name.lower() == "time"]
    if len(alike) != 1 or "t" in {*file.given.names, *file.given.values, *file.variables}:
        return file
    return dataclasses.replace(file, given=dataclasses.replace(file.given, names={**file.given.names, "t": alike[0]}))


def _is_closed(file: File, name: str) -> bool:
    """Whether a variable is there and no numbers: times of day, which nobody needs where the rate is known."""
    return name in file.variables and isinstance(file.variables[name], Unreadable)


def _contradictions(file: File, fs: float, n_time: int) -> list[str]:
    """Remarks on columns that sound like time, go in even steps, and whose steps are the interval of this rate in no
    unit from s to ns."""
    found = []
    for name in time_like(file.variables, n_time):
        stamps = np.asarray(file.variables[name])
        if not _is_time(stamps, n_time):
            continue
        rate, deviation = _grid(stamps.ravel().astype(np.float64))
        if deviation <= _UNIFORM and all(abs(fs * unit / rate - 1) > _RATE for unit in _UNITS_OF_TIME):
            found.append(
                f"fs is said to be {fs:g} Hz, but {name} goes in steps of {number(1 / rate, 6)}: one of them is wrong. "
                f"--map {_argument(name)} instead of fs takes the rate from there."
            )
    return found


def _is_time(value, n_time: int) -> bool:
    """Whether a variable that happens to be called `t` is a time vector of the record."""
    t = np.asarray(value)
    return t.size == n_time and t.dtype.kind in "biuf" and bool(t.flat[-1] > t.flat[0])


def _rate(file: File, time: np.ndarray, n_time: int) -> tuple[float, float]:
    """Mean rate of a time vector, Hz, and how far stamps stand off the uniform grid, in sample intervals."""
    if time.size != n_time or time.shape[-1] != 1 or n_time < 2:
        raise file.error(
            "t",
            f"shape {time.shape}",
            f"one time stamp for each of the {n_time} samples",
            "Name another time vector.",
        )
    t = time.ravel().astype(np.float64)
    span = t[-1] - t[0]
    if not (np.isfinite(t).all() and span > 0):
        raise file.error("t", f"times from {t[0]:g} to {t[-1]:g}", "finite, increasing times in s", "Correct it.")
    rate, deviation = _grid(t)
    whole = round(rate)
    return float(whole) if abs(rate - whole) <= _WHOLE * rate else rate, deviation


def _grid(t: np.ndarray) -> tuple[float, float]:
    """Mean rate of increasing time stamps, and how far they stand off it, in sample intervals."""
    rate = (len(t) - 1) / (t[-1] - t[0])
    return float(rate), float(np.max(np.abs((t - t[0]) * rate - np.arange(len(t)))))


def _unevenness(t: np.ndarray, deviation: float) -> tuple[str, str, str]:
    """What is wrong with time stamps that stand off the uniform grid: found, expected, what to do."""
    steps = np.diff(t)
    usual = float(np.median(steps))
    missing = np.round(steps / usual).astype(int) - 1 if usual > 0 else np.zeros(len(steps), int)
    gaps = np.flatnonzero(missing > 0)
    if usual > 0 and 0 < len(gaps) < _SELDOM * len(t) and np.all(np.abs(steps / usual - missing - 1) < _NEAR_WHOLE):
        parts = np.concatenate([[0], gaps + 1, [len(t)]])
        longest = int(np.argmax(np.diff(parts)))
        kept = f"samples={parts[longest]}:{parts[longest + 1]}"
        return (
            f"{counted(int(missing[gaps].sum()), 'sample')} missing in {counted(len(gaps), 'place')}, the first behind "
            f"sample {gaps[0]}",
            "every sample",
            f"Take the longest part without a gap: --set fs={number(1.0 / usual, 6)},{kept}; or fill the gaps.",
        )
    rate = 1.0 / float(np.polyfit(np.arange(len(t)), t, 1)[0])
    rate = float(round(rate)) if abs(rate - round(rate)) <= _LIKELY_WHOLE * rate else rate
    resolution = float(np.min(steps[steps > 0]))
    off = np.abs(t - t[0] - np.arange(len(t)) / rate)
    if np.any(steps == 0) and np.max(off) <= _ROUNDED * resolution:
        return (
            f"time stamps in steps of {number(resolution)} s, which is coarser than the samples",
            "a time of each sample's own",
            f"Say the rate instead: --set fs={number(rate, 6)} by their slope.",
        )
    return (
        f"time stamps up to {number(deviation, 2)} sample intervals off a uniform grid",
        "uniform sampling",
        f"Resample the record, or, if only the stamps jitter, say the rate: --set fs={number(rate, 6)}.",
    )


def _rate_advice(ratio: float, rate: float) -> str:
    for unit, factor in (("ms", 1e-3), ("microseconds", 1e-6), ("ns", 1e-9)):
        if abs(ratio / factor - 1) < _RATE:
            return f"The time vector looks like {unit}: --factor t={factor:g}."
    return f"Correct one of them, e.g. --set fs={number(rate, 6)}."


def _argument(name: str) -> str:
    """t=NAME as a shell takes it."""
    return f"t={name}" if re.fullmatch(r"[\w.]+", name) else f'"t={name}"'


_RATES = ("fs", "f_s", "rate", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "sampling_frequency")


_INTERVALS = ("ts", "dt", "t_s", "tsample", "sample_time", "sampletime", "sampling_time", "sampling_interval")


def _no_rate(file: File, n_time: int) -> InputError:
    like = time_like(file.variables, n_time)
    for n, v in file.variables.items():
        if not isinstance(v, np.ndarray | str) or np.size(v) != 1:
            continue
        last = n.split(".")[-1].lower()
        if last in _RATES:
            return file.error("fs", "no such variable", "the sampling frequency fs (Hz)", f"Is it {n}? --map fs={n}.")
        if last in _INTERVALS and isinstance(v, np.ndarray) and v.dtype.kind in "fiu" and v.item() > 0:
            rate = number(1 / v.item(), 6)
            return file.error(
                "fs", "no such variable", "the sampling frequency fs (Hz)", f"Is {n} the interval? --set fs={rate}."
            )
    if not like:
        return file.error(
            "fs",
            "neither fs nor a time vector",
            "the sampling frequency fs (Hz)",
            "Set it, e.g. --set fs=2000, or name it, or a column of times: --map fs=NAME or t=NAME.",
        )
    return file.error(
        "fs",
        "no such variable",
        "the sampling frequency fs (Hz), or a time vector t (s)",
        f"Set it, e.g. --set fs=2000, or name the time vector: --map {_argument(like[0])} (--factor t=1e-6 if it is "
        "in microseconds).",
    )
