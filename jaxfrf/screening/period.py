"""Period and lines as they are given, against what the signals show."""

from collections.abc import Iterator

import numpy as np

from .._text import number, percent
from ..experiment import how_to_set
from ..periodic import find_period, mismatch
from .finding import Finding, Severity
from .record import Record

_LOOK = 1e-4  # mismatch after the given period from which another one is looked for
_LOOK_PERIODS, _LOOK_SAMPLES = 4, 2**18  # whichever is more is enough to see a period
_WORSE = 4.0  # mismatch after the given period over that after the found one
_WORSE_BY = 0.15  # the same as a difference, where both are noisy
_CLEAR = 0.3  # mismatch of a period that can be believed against a record of a single one
_BLOCKS = 16  # of a period
_FITS = 0.25  # of them, in which the given period fits as well: it is the period, and samples are missing elsewhere
_PARTS = (2, 3, 5, 7)  # of the given period, after which the record may repeat already
_AS_WELL, _AS_WELL_BY = 3.0, 0.01  # mismatch after such a part over that after the given period, and beside it
_SURE_LINES = 0.9
_QUIET_SHARE = 0.1  # of the given lines, that may be quiet


def contradicted(record: Record) -> Iterator[Finding]:
    """A given period after which the reference (or input) does not repeat though it does after another."""
    data = record.data
    if not data.period:
        return
    name, x = ("u", data.u) if data.r is None else ("r", data.r)
    x = np.asarray(x)[0, 0, : max(_LOOK_PERIODS * data.period, _LOOK_SAMPLES)]
    given = mismatch(x, data.period)
    yield from _several_periods(data, name, x, given)
    if given < _LOOK:
        return
    found = find_period(x)
    if found is None or data.period % found.period == 0 or (found.period % data.period == 0 and given < _CLEAR):
        return
    if _fits_in_places(x, data.period, found.period):
        return
    single = data.n_time < 1.5 * data.period
    found_by = min(found.mismatch, mismatch(x, found.period))
    worse = found_by < _CLEAR if single else given > max(_WORSE * found_by, 0.01) or given > found_by + _WORSE_BY
    if worse:
        after = "" if single else f" (after {data.period} samples {percent(given)} of its power differ)"
        yield Finding(
            "period",
            Severity.REFUSED,
            given,
            f"period: {data.period} samples are given, but {name} repeats every {found.period} samples{after}. "
            f"Nothing estimated with the wrong period means anything: {how_to_set(data.n_time, found.period)}"
            f"{', and leave out or correct the list of lines' if data.lines is not None else ''}."
            f"{_or_lost(data, found.period)}",
            sure=found.sure,
            signal=name,
        )


def _several_periods(data, name: str, x: np.ndarray, given: float) -> Iterator[Finding]:
    """A given period that is several: the lines between are not excited, and are found where there is noise."""
    for part in _PARTS if data.lines is None else ():
        if data.period % part == 0 and mismatch(x, data.period // part) < min(_AS_WELL * given + _AS_WELL_BY, _CLEAR):
            shorter = data.period // part
            yield Finding(
                "period",
                Severity.WARNED,
                1.0 / part,
                f"period: {data.period} samples are given, but {name} repeats every {shorter} samples already: no line "
                f"but every {part}{'nd' if part == 2 else 'rd' if part == 3 else 'th'} one is excited. "
                f"{how_to_set(data.n_time, shorter)[:1].upper()}{how_to_set(data.n_time, shorter)[1:]}.",
                signal=name,
            )
            return


def _or_lost(data, found: int) -> str:
    by = data.period - found
    if data.n_periods > 2 or abs(by) > 0.1 * data.period:
        return ""
    what = "missing from" if by > 0 else "too many in"
    return f" If {data.period} is right, {abs(by)} samples are {what} one of the periods."


def _fits_in_places(x: np.ndarray, given: int, found: int) -> bool:
    """Whether x repeats after the given period as well as after the found one for a good part of the record: then a
    part of it is shifted (samples lost), and the period is right."""
    lag, n = max(given, found), len(x)
    count = (n - lag) // max(min(given, found) // _BLOCKS, 8)
    if count < 4:
        return False
    ends = np.linspace(0, n - lag, count + 1).astype(int)[:-1]
    by_given, by_found = (
        np.add.reduceat(np.sum((x[L : L + n - lag] - x[: n - lag]) ** 2, axis=1), ends) for L in (given, found)
    )
    power = np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1)) * (n - lag) / count
    return bool(np.mean(by_given <= by_found + 1e-5 * power) > _FITS)


def quiet_lines(record: Record) -> Iterator[Finding]:
    """Lines that are said to be excited and are not; lines that were found and are not sure."""
    data, found = record.data, record.found_lines
    if found is None:
        return
    if data.lines is None:
        if found.confidence < _SURE_LINES:
            yield Finding(
                "lines",
                Severity.WARNED,
                1 - found.confidence,
                f"{'u' if data.r is None else 'r'}: excited and quiet lines are not clearly told apart; "
                f"{len(found.lines)} lines from {found.lines[0]} to {found.lines[-1]} are taken (confidence "
                f"{number(found.confidence, 2)}). Say which are excited: --set lines=FIRST:LAST:STEP, or give the "
                "reference.",
            )
        return
    quiet = np.setdiff1d(data.lines, found.lines)
    if found.confidence >= _SURE_LINES and len(quiet) > _QUIET_SHARE * len(data.lines) and _not_weak(record, quiet):
        yield Finding(
            "lines",
            Severity.WARNED,
            len(quiet) / len(data.lines),
            f"lines: {len(quiet)} of the {len(data.lines)} given lines are not excited, the first {quiet[0]}; the "
            f"spectrum shows {len(found.lines)} lines ({found.design}). Correct lines, or the period.",
        )


def _not_weak(record: Record, quiet) -> bool:
    """Whether these lines carry no more than their unlisted neighbours."""
    from ..spectra import line_power

    power = line_power(record.data).sum(axis=1)
    at = np.isin(np.arange(1, len(power) + 1), quiet)
    others = ~np.isin(np.arange(1, len(power) + 1), np.asarray(record.data.lines))
    low, high = quiet.min(), quiet.max()
    near = others & (np.arange(1, len(power) + 1) >= low) & (np.arange(1, len(power) + 1) <= high)
    return not near.any() or bool(np.median(power[at]) < 10 * np.median(power[near]))
