"""Counters that overflow: values that leave one end of a range and come in at the other."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.ndimage
import scipy.signal

from .._text import number
from .finding import Finding, Severity
from .record import Channel, of_channels

_RANGE = 0.5  # of the range, that a wrapped signal jumps by in one sample ...
_NEAR = 0.25  # ... from this near one end to this near the other, ...
_USUAL = 2.0  # ... by more than this many times 99 % of the other steps ...
_MIDDLE = 0.2  # ... though this part of its samples stands in the middle half, as that of a square wave does not
_OFTEN = 0.05  # of the steps: more jumps are how the signal moves
_REACHES = 1.0  # such steps, by which a jump may be short of the range, as that of a square wave beside lines is
_SAW = 3  # jumps in one direction, evenly apart: a saw-tooth, as are straight lines ...
_STRAIGHT = 0.1  # ... within this part of a jump

# A broadband signal jumps by half of its range anyway. Folded ones keep a hump and its tails, cut at both ends.
_HUMP = 0.4  # of the samples stand in the middle half; .5 of evenly spread ones, less of signals of few levels
_MOVES = 0.015  # median step over the range: slower ones are of the first kind
_LOOK, _SHORTEST = 20_000, 320  # samples are enough; fewer are not
_HALF_FILTER = 128  # samples on either side that tell the one between
_FLOOR = 1e-8  # of the largest spectral density
_ROUNDS = 40
_SLOWLY = 101  # samples, over which the number of turns of a signal without offset is zero
_GAIN = 0.1  # by which the log of the power that the neighbours do not tell falls; .06 on clean records, where ...
_CLEAR = 5.0  # ... half the range is so many standard deviations of that power, which bounded white noise stays below
_LEFT = 0.2, 0.33  # of the range, that median and 90 % of the samples turned back stand off their neighbours by
_FEW = 2  # samples
_SHARE = 0.2  # of the samples turned back: more are two levels exchanged
_EDGE = 0.15  # of the range: beside either end stand ...
_BESIDE = 0.6  # ... so many turned back for each of the others at most, as tails thin out

# What so much better tells the samples by their neighbours needs neither tails nor few of them: a range of half the
# signal's. Designed signals (several levels, chirps, limits) gain .43 with that hump, tanh(3 x) .7 with one of .15.
_MUCH = 0.8  # log of power
_WIDE = 0.25  # of the samples in the middle half: two levels have 0
_EXACT = 0.08, 0.16  # as _LEFT; two levels reach .02 and .11

_FAR = 0.25  # of the range: differences of two periods that are neither near 0 nor near a whole turn ...
_FAR_SHARE = 0.1  # ... are this many of those that are a turn
_FEW_DIFFER = 3  # differences that are a turn
_SCATTER = 0.05  # of the range: standard deviation of the others
_NEAR_TURN = 6.0  # such standard deviations


@of_channels("uyr")
def wrapped(c: Channel) -> Iterator[Finding]:
    """A counter that overflows: jumps from one end of the range to the other; samples that their neighbours tell once
    the range is added or taken; the same place of two periods at opposite ends.

    What cannot be told from a clean record: a signal without hump (white and evenly spread, of two levels), a
    saw-tooth, one that is white up to half the sampling frequency and repeats exactly, one most of which is noise.
    """
    size, (low, high) = c.steps, c.ends
    if np.any(size > _RANGE * (high - low)):
        yield from _jumping(c) or _folded(c) or _differing(c)


def _says(c: Channel, turn: float, at: np.ndarray, seen: str, severity: Severity, mend: str) -> list[Finding]:
    return [
        c.finding(
            "wrapped",
            severity,
            turn,
            f"{seen}: a counter that overflowed. {mend}",
            samples=(int(at[0]), int(at[-1]) + 2),
        )
    ]


def _jumping(c: Channel) -> list[Finding]:
    """Jumps that its usual steps do not come near."""
    size, (low, high) = c.steps, c.ends
    jumps = np.flatnonzero(size > _RANGE * (high - low))
    jumps = jumps[(jumps > 1) & (jumps < len(size) - 2)]
    if not jumps.size or jumps.size > _OFTEN * len(size) or _is_saw(c, jumps):
        return []
    near = _NEAR * (high - low)
    before, after = c.x[jumps], c.x[jumps + 1]
    across = ((before > high - near) & (after < low + near)) | ((before < low + near) & (after > high - near))
    middle = np.mean(np.abs(c.x - (high + low) / 2) < (high - low) / 4)
    turn = float(np.median(size[jumps]))
    usual = np.quantile(size, 0.99 - min(jumps.size / len(size), _OFTEN))
    if across.mean() <= 0.8 or middle <= _MIDDLE or size[jumps].min() <= _USUAL * usual:
        return []
    if turn < high - low - _REACHES * usual:
        return []
    turn = _without_steps(c.x, jumps, high - low)
    return _says(
        c,
        turn,
        jumps,
        f"jumps {jumps.size} times by {number(turn, 6)} from one end of its range to the other, first at sample "
        f"{int(jumps[0]) + 1}, and goes on as before",
        Severity.REFUSED,
        f"Unwrap it before it is used (numpy.unwrap(x, period={number(turn, 6)})).",
    )


def _without_steps(x: np.ndarray, jumps: np.ndarray, reach: float) -> float:
    """The turn of jumps, what they are more than the steps around them; no less than the range that x reaches."""
    apart = np.diff(jumps, prepend=-2, append=len(x) + 2) > 1
    at = jumps[apart[:-1] & apart[1:]]  # not there and back in two samples
    if not at.size:
        return reach
    by, around = x[at + 1] - x[at], (x[at] - x[at - 1] + x[at + 2] - x[at + 1]) / 2
    return max(float(np.median(np.abs(by - around))), reach)


def _is_saw(c: Channel, jumps: np.ndarray) -> bool:
    """Jumps in one direction, evenly apart or with straight lines between them, are a saw-tooth, of all but a position
    that turns at one speed."""
    if c.signal == "y" and c.record.data.y_quantity == "position":
        return False
    by = c.x[jumps + 1] - c.x[jumps]
    if np.any(np.sign(by) != np.sign(by[0])):
        return False
    if jumps.size >= _SAW and np.ptp(np.diff(jumps)) <= 2:
        return True
    time = np.arange(len(c.x))
    whole = c.x - np.median(by) * np.searchsorted(jumps, time)
    off = whole - np.polyval(np.polyfit(time, whole, 1), time)
    return bool(off.std() < _STRAIGHT * abs(np.median(by)))


@dataclasses.dataclass(frozen=True)
class _Unfolded:
    turns: np.ndarray  # added to every sample
    off: np.ndarray  # of every sample from what its neighbours tell
    unknown: float  # log of the power that the samples before do not tell


def _folded(c: Channel) -> list[Finding]:
    """Samples that stand about the range away from what their neighbours on both sides tell, near its ends."""
    low, high = c.ends
    first, x = _stretch(c)
    turn = (high - low) * (1 + 1 / len(c.x))
    hump = np.mean(np.abs(x - (low + high) / 2) < (high - low) / 4)
    if len(x) < _SHORTEST or hump <= _WIDE or np.median(np.abs(np.diff(x))) < _MOVES * turn:
        return []
    plain = _between(x)[1]
    best = min((_unfolded(x, turn, start) for start in (np.zeros(len(x)), _by_steps(x, turn))), key=lambda z: z.unknown)
    moved = best.turns != 0
    gain = plain - best.unknown
    if moved.sum() < _FEW or gain < _GAIN or turn < 2 * _CLEAR * 1.4826 * np.median(np.abs(best.off[~moved])):
        return []
    few = hump > _HUMP and moved.mean() <= _SHARE and _within(best, turn, _LEFT) and _in_tails(x, moved, turn)
    if not few and not (gain > _MUCH and _within(best, turn, _EXACT)):
        return []
    at = first + np.flatnonzero(moved)
    return _says(
        c,
        float(turn),
        at,
        f"holds {at.size} samples{f' of {len(x)}' if len(x) < len(c.x) else ''}, the first at {at[0]}, that stand near "
        f"one end of its range of {number(turn, 4)} where their neighbours tell the other",
        Severity.WARNED,
        "The FRF means little: log it with a wider range, or take that of the range from these samples.",
    )


def _within(found: _Unfolded, turn: float, parts: tuple[float, float]) -> bool:
    """Median and 90 % of the samples turned back stand within these parts of a turn of what their neighbours tell."""
    left = np.quantile(np.abs(found.off[found.turns != 0]), (0.5, 0.9)) / turn
    return bool(left[0] <= parts[0] and left[1] <= parts[1])


def _in_tails(x: np.ndarray, moved: np.ndarray, turn: float) -> bool:
    """Beside either end fewer samples come from beyond it than stand there, as tails thin out."""
    return all(
        np.count_nonzero(end & moved) <= _BESIDE * np.count_nonzero(end & ~moved)
        for end in (x > x.max() - _EDGE * turn, x < x.min() + _EDGE * turn)
    )


def _stretch(c: Channel) -> tuple[int, np.ndarray]:
    """The samples that are looked at, around the middle one of the jumps."""
    low, high = c.ends
    jumps = np.flatnonzero(c.steps > _RANGE * (high - low))
    first = int(np.clip(jumps[len(jumps) // 2] - _LOOK // 2, 0, max(len(c.x) - _LOOK, 0)))
    return first, c.x[first : first + _LOOK]


def _between(z: np.ndarray) -> tuple[np.ndarray, float]:
    """How far every sample is from what those on both sides tell, and the log of the power that those before it do not
    tell.

    **Source:** Wiener's interpolation, of power 1/mean(1/S); Kolmogorov's of prediction, exp(mean(log S)).
    """
    n = min(_HALF_FILTER, len(z) // 8)
    S = scipy.signal.welch(z, nperseg=2 * n)[1]
    S = np.maximum(S, max(_FLOOR * S.max(), 1e-300))
    S[0] = max(S[0], S[1])
    w = np.fft.irfft(1 / S)
    off = scipy.signal.oaconvolve(z - z.mean(), np.fft.fftshift(w) / w[0])[n : n + len(z)]
    off[:n] = off[-n:] = 0.0
    return off, float(np.mean(np.log(S[1:])))


def _by_steps(x: np.ndarray, turn: float) -> np.ndarray:
    """Turns by the shortest steps, of one turn at most, as the signal comes back to where it was."""
    turns = np.round((np.unwrap(x, period=turn) - x) / turn)
    return np.clip(turns - scipy.ndimage.median_filter(turns, _SLOWLY), -1, 1)


def _unfolded(x: np.ndarray, turn: float, turns: np.ndarray) -> _Unfolded:
    """Samples are moved by a turn, the farthest first, until all are within half a turn of what their neighbours tell.

    Only samples of the lower half come from above the range, and of the upper half from below.
    """
    above = x > (x.min() + x.max()) / 2
    for _ in range(_ROUNDS):
        off, unknown = _between(x + turn * turns)
        size = np.abs(off)
        worst = (size > max(turn / 2, 0.7 * size.max())) & (size >= scipy.ndimage.maximum_filter1d(size, 3))
        up = worst & (off < 0) & (turns < 1) & (~above | (turns < 0))
        down = worst & (off > 0) & (turns > -1) & (above | (turns > 0))
        if not (up.any() or down.any()):
            break
        turns = turns + up - down
    return _Unfolded(turns, off, unknown)


def _differing(c: Channel) -> list[Finding]:
    """Periods that are alike but for places where one stands at one end of the range and the next at the other."""
    if c.n_periods < 2:
        return []
    low, high = c.ends
    turn = high - low
    x = c.steady
    difference = np.diff(x, axis=0)
    turned = np.abs(difference) > turn / 2
    near = np.abs(difference) - turn * turned
    scatter = 1.4826 * float(np.median(np.abs(near)))
    at = np.flatnonzero(turned)
    ends = np.minimum(np.abs(x[:-1] - low), np.abs(x[:-1] - high))[turned]
    hump = np.mean(np.abs(x - (low + high) / 2) < turn / 4)
    if at.size < _FEW_DIFFER or hump <= _HUMP or scatter > _SCATTER * turn:
        return []
    far = np.count_nonzero(np.abs(near) > _FAR * turn)
    close = np.abs(near[turned]) <= _NEAR_TURN * scatter + turn / len(c.x)
    if far > _FAR_SHARE * at.size or close.mean() < 1 - _FAR_SHARE or ends.max() > _FAR * turn:
        return []
    at = c.first + at
    return _says(
        c,
        float(turn),
        at,
        f"stands at opposite ends of its range of {number(turn, 4)} in two periods at {at.size} places, the first at "
        f"sample {at[0]}, and differs little elsewhere",
        Severity.WARNED,
        "The FRF means little: log it with a wider range.",
    )
