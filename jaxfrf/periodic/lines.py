"""Excited lines, from the structure of a power spectrum: two levels, smooth in frequency, and a grid."""

import dataclasses

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float, Int

from .._types import Array

_DEEPEST_DB = 80.0  # below the strongest line a line is no excitation, gap or not
_ROUNDING = 1e-10  # of the strongest line's power: no excitation spans so much, samples of 16 bits and more round there
_PLAIN_GAP_DB = 40.0  # between neighbours in order of power: no noise leaves that
_NO_GAP_DB = 40.0  # without two levels: lines within this range of the strongest
_APART_DB = 8.0  # excited and quiet lines are two levels if their medians differ by this much
_ROUNDS = 12
_SPAN = 41  # lines over which a level is smoothed
_STEPS = (12, 10, 8, 6, 5, 4, 3, 2, 1)  # grids that are looked for, coarse ones first
_ON_GRID = 0.97  # share of the lines on a grid that is one
_FULL_GRID = 0.93  # share of a grid's lines that are excited where all were meant
_REGULAR = 0.2  # what a full grid counts for, in parts of lines that are clearly told
_CLEAR = 0.9  # score below which a third level is looked for
_BETTER = 0.05  # by which another split must be clearer than the first
_ZIPPED = 0.2  # of a channel's lines, shared with the other channels, below which a design is zippered


@dataclasses.dataclass(frozen=True)
class FoundLines:
    """`lines` that are excited; `confidence` (0 to 1): the part of them that is clearly told from quiet lines;
    `design` in words."""

    lines: Int[np.ndarray, "freq"]
    confidence: float
    design: str


def find_lines(
    lines: Int[np.ndarray, "freq"],
    power: Float[Array, "freq channel"],
    noise: Float[Array, "freq channel"] | None = None,
) -> FoundLines | None:
    """The excited ones of `lines`, in every channel; of zippered designs those that any channel excites.

    **Arguments:** `power`: of each line, summed over experiments; `noise`: what of it the scatter between periods
    explains, in the same unit, where there are several.

    A line is excited if it stands nearer to the level of the excited lines around it than to that of the quiet ones
    (both medians over 41 lines, found in turns, starting from the split of the whole spectrum that separates best), and
    if its power is more than noise. Lines that fit no grid (every, every other, every fourth, ... line) though the
    others do are left out unless they are stronger than those; missing lines of a grid that is otherwise full are
    filled in. Where there are no two levels, the lines within 40 dB of the strongest one count, with confidence 0.

    `None` where no channel, or not every one, carries power.
    """
    power = np.asarray(power, np.float64)
    carries = power > _ROUNDING * power.max(axis=0)
    if np.any(power.max(axis=0) <= 0):
        return None
    weakest = np.minimum(carries.sum(axis=0), 4)  # three may be slow sines, stronger than all others
    peak = np.take_along_axis(np.sort(power, axis=0), -weakest[None], axis=0)[0]
    level = 10 * np.log10(np.maximum(power / peak, 1e-30))
    above = carries if noise is None else carries & (power > 4 * np.asarray(noise))
    each = [_of_channel(lines, level[:, c], above[:, c]) for c in range(power.shape[1])]
    return _together(lines, level, each)


@dataclasses.dataclass(frozen=True)
class _Channel:
    excited: Bool[np.ndarray, "freq"]
    sure: Bool[np.ndarray, "freq"]
    two_levels: bool


def _of_channel(lines, level, above) -> _Channel:
    """The clearest of the splits: of the whole spectrum or by smooth levels; of all lines, or of the upper class once
    more (distortion may make a third level)."""
    plain = _plain_gap(level)
    if plain is not None:
        excited = (level >= max(plain, -_DEEPEST_DB)) & above
        return _Channel(excited, np.ones_like(excited), True)
    split = (level >= max(_best_split(level), -_DEEPEST_DB)) & above
    found = _clearest(lines, level, [split, _by_smooth_levels(level, above, split)])
    if found is None or _score(lines, level, found) < _CLEAR:
        upper = split if found is None else found.excited
        if upper.sum() > 8:
            again = upper & (level >= _best_split(level[upper]))
            found = _clearest(lines, level, [x for x in (again, _by_smooth_levels(level, above, again))], found)
    return _Channel(above, np.zeros_like(above), False) if found is None else found


def _plain_gap(level) -> float | None:
    """The level above a gap so wide that nothing else need be looked at, as in a reference without noise; the three
    strongest lines (slow sines) are on its upper side."""
    order = np.sort(level)[::-1]
    if len(order) < 5:
        return None
    gaps = order[3:-1] - order[4:]
    return float(order[3 + np.argmax(gaps)]) if gaps.max() >= _PLAIN_GAP_DB else None


def _clearest(lines, level, tried, best: _Channel | None = None) -> _Channel | None:
    """The split with the best score, the first of equally good ones; `None` where none leaves two levels."""
    for x in tried:
        x = _judged(level, x) if x.any() else None
        if x is not None and (best is None or _score(lines, level, x) > _score(lines, level, best) + _BETTER):
            best = x
    return best


def _by_smooth_levels(level, above, excited):
    """Every line to the nearer of the levels of the excited and of the quiet lines around it, found in turns."""
    for _ in range(_ROUNDS):
        high, low = _smooth_level(level, excited), _smooth_level(level, ~excited)
        new = (level >= np.maximum((high + low) / 2, high.max() - _DEEPEST_DB)) & above
        if not new.any() or np.array_equal(new, excited):
            break
        excited = new
    return excited


def _judged(level, excited) -> _Channel | None:
    high, low = _smooth_level(level, excited), _smooth_level(level, ~excited)
    quiet = level[~excited]
    apart = np.median(level[excited]) - np.median(quiet) if quiet.size else 0.0
    if apart < _APART_DB or not _has_gap(level, excited, high, low):
        return None
    margin = np.abs(level - (high + low) / 2)
    return _Channel(excited, margin > np.minimum((high - low) / 4, 6.0), True)


def _score(lines, level, x: _Channel) -> float:
    regular = not _grid(lines, x.excited, level)[1].startswith(("irregular", "some"))
    return float(np.mean(x.sure[x.excited])) + (_REGULAR if regular else 0.0)


def _has_gap(level, excited, high, low) -> bool:
    """Two levels leave a valley between them, and a step where an excited line has a quiet neighbour; a spectrum that
    decays smoothly has none."""
    steps = np.abs(np.diff(level))[np.diff(excited)]
    place = (level - low) / np.maximum(high - low, 1e-9)  # 0: quiet, 1: excited
    valley = np.mean((place > 0.4) & (place < 0.65))
    empty = valley < 0.15 * min(np.mean(excited), 0.3)
    return bool(empty and np.median(high - low) >= _APART_DB and np.median(steps) >= _APART_DB)


def _best_split(level) -> float:
    """Otsu's threshold, of levels no lower than 10 dB below the median of the lowest ones (zeros are all alike)."""
    x = np.sort(np.maximum(level, max(np.quantile(level, 0.1) - 10.0, -150.0)))
    n, k = len(x), np.arange(1, len(x))
    sums = np.cumsum(x)
    below, above = sums[:-1] / k, (sums[-1] - sums[:-1]) / (n - k)
    best = int(np.argmax(k * (n - k) * (above - below) ** 2))
    return (x[best] + x[best + 1]) / 2


def _smooth_level(level, members) -> np.ndarray:
    """Median of the members around every line, interpolated where there are none."""
    at = np.flatnonzero(members)
    if not at.size:
        return np.full(len(level), level.min() - 20.0)
    values = np.maximum(level[at], -150.0)
    values = scipy.ndimage.median_filter(values, size=min(_SPAN, len(values)), mode="nearest")
    return np.interp(np.arange(len(level)), at, values)


def _together(lines, level, each: list[_Channel]) -> FoundLines:
    masks = np.stack([c.excited for c in each])
    common = masks.all(axis=0)
    zipped = len(each) > 1 and common.sum() < _ZIPPED * masks.sum(axis=1).min()
    chosen = masks.any(axis=0) if zipped else common
    strength = level.max(axis=1) if zipped else level.min(axis=1)
    told = all(c.two_levels for c in each)
    if not (told and chosen.any()):
        strong = strength >= strength.max() - _NO_GAP_DB
        chosen = chosen & strong if (chosen & strong).any() else strong
    sure = np.stack([c.sure for c in each])
    clear = np.any(sure & masks, axis=0) if zipped else np.all(sure, axis=0)
    on_grid, design = _grid(lines, chosen, strength)
    if design != "irregular" and told:
        clear = np.logical_or(clear, chosen == on_grid)
    confidence = float(np.mean(clear[on_grid])) if told else 0.0
    return FoundLines(lines[on_grid], confidence, ("zippered, " if zipped else "") + design)


def _grid(lines, chosen, strength) -> tuple[np.ndarray, str]:
    """The lines of the coarsest grid that holds nearly all chosen ones; its gaps filled if they are few."""
    k = lines[chosen]
    if k.size < 8:
        return chosen, "irregular"
    usual = np.median(strength[chosen])
    for step in _STEPS:
        counts = np.bincount(k % step, minlength=step)
        offset = int(np.argmax(counts))
        if counts[offset] < _ON_GRID * k.size:
            continue
        member = lines % step == offset
        strong = chosen & (strength > usual + 6.0)  # a slow sine: excited, whatever the grid
        held = chosen & member
        first, last = _band(lines[held], step)
        inside = member & (lines >= first) & (lines <= last)
        name = {1: "every line", 2: "every other line"}.get(step, f"every {step}th line")
        if held[inside].mean() >= _FULL_GRID:
            return inside | strong, f"{name} from {first} to {last}"
        return (held & inside) | strong, {1: "irregular"}.get(step, f"some of {name}")
    return chosen, "irregular"


def _band(k, step: int) -> tuple[int, int]:
    """The first and the last line, but for up to 3 % of them far outside (single false ones among thousands), if what
    is left is a grid without gaps."""
    spare = max(int((1 - _ON_GRID) * k.size), 1)
    ends = [(i, k.size - 1 - j) for i in range(spare + 1) for j in range(spare + 1 - i)]
    full = [(i, j) for i, j in ends if (j - i) * step >= _FULL_GRID * (k[j] - k[i])]
    i, j = min(full, key=lambda e: e[0] + k.size - e[1], default=(0, k.size - 1))
    return int(k[i]), int(k[j])
