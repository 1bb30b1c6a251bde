"""Which DFT lines to excite, and which to leave silent so that nonlinear distortion shows there.

Line k of a period of N samples is k*fs/N Hz. Grids take the first and the last line that may be excited; a
band in Hz becomes these two with `band_lines`: `odd_lines(*band_lines(4.0, 80.0, fs, period))`.
"""

import math

import numpy as np
from jaxtyping import Int, PRNGKeyArray

from .._annotated import checked
from .._arguments import expect_real, expect_whole
from .._errors import input_error
from .._memory import check_memory
from .._text import number
from .._types import Array
from ._draw import uniform

Grid = Int[np.ndarray, "freq"]


@checked
def band_lines(low: float, high: float, fs: float, period: int) -> tuple[int, int]:
    """The first and the last line inside the band from `low` to `high` (Hz, both included).

    **Arguments:** `low`, `high`: Hz. `fs`: Hz. `period`: samples.

    **Returns:** line numbers; line k is k fs/period Hz.

    **Raises:** `jaxfrf.InputError` if no line lies in the band below half the sampling frequency.

    **Source:** a definition.
    """
    expect_real("low", low)
    expect_real("high", high)
    expect_real("fs", fs)
    expect_whole("period", period, 1)
    if fs <= 0:
        raise input_error("fs", f"{fs}", "samples in a second, above 0", "Give it in Hz.")
    resolution = fs / period
    if not (math.isfinite(low) and math.isfinite(high)):
        raise input_error("band", f"{low:g} to {high:g} Hz", "finite frequencies", "E.g. band = [4.0, 80.0].")
    tiny = 1e-9  # 80 Hz * 28 s must be line 2240, not 2239.9999999
    first = max(math.ceil(low / resolution - tiny), 1)
    last = min(math.floor(high / resolution + tiny), (period - 1) // 2)
    if not 0 <= low <= high or first > last:
        raise input_error(
            "band",
            f"{low:g} to {high:g} Hz with lines every {number(resolution, 4)} Hz",
            f"a band that holds at least one line between {number(resolution, 4)} and {fs / 2:g} Hz",
            "Widen the band, or lengthen the period.",
        )
    if high > fs / 2:
        raise input_error(
            "band",
            f"{low:g} to {high:g} Hz sampled at {fs:g} Hz",
            f"a band below {fs / 2:g} Hz, half the sampling frequency",
            "Lower its end, or raise fs.",
        )
    return first, last


def full_lines(first: int, last: int) -> Grid:
    """Every line from `first` to `last`: the finest grid, but no line is left to detect distortion.

    **Arguments:** `first`, `last`: whole numbers, from 1; line k is k fs/period Hz, and `jaxfrf.band_lines` converts a
    band.

    **Returns:** the lines, (freq,), increasing.

    **Raises:** `jaxfrf.InputError` unless 1 <= `first` <= `last`, or for more lines than fit into memory.

    **Source:** a definition.
    """
    expect_whole("first", first)
    expect_whole("last", last)
    first, last = _range(first, last)
    return np.arange(first, last + 1)


def odd_lines(first: int, last: int) -> Grid:
    """Every odd line from `first` to `last`: even distortion falls on even lines and leaves the FRF alone.

    Odd distortion still falls on excited lines; `random_odd_lines` and `log_odd_lines` leave odd lines to
    see it.

    **Arguments:** `first`, `last`: whole numbers, from 1; both may be even.

    **Returns:** the lines, (freq,), increasing.

    **Raises:** `jaxfrf.InputError` unless 1 <= `first` <= `last`, for a range without odd lines, or for more lines than
    fit into memory.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 4.3.
    """
    expect_whole("first", first)
    expect_whole("last", last)
    first, last = _range(first, last)
    return _some(np.arange(first | 1, last + 1, 2), first, last)


def random_odd_lines(first: int, last: int, *, group: int = 4, key: PRNGKeyArray) -> Grid:
    """Odd lines with one left out at random in every group of `group` consecutive odd lines.

    The lines left out detect odd distortion, the even lines even distortion. A last group that is not whole
    keeps all its lines.

    **Arguments:** `first`, `last`: lines; `group`: 2 or more; `key`: `jax.random.key(...)`.

    **Returns:** the lines, (freq,), increasing.

    **Raises:** `jaxfrf.InputError` for a group below 2, or a range without odd lines.

    **Source:** Pintelon & Schoukens, System Identification, 2nd ed. 2012, section 4.3.1.
    """
    expect_whole("first", first)
    expect_whole("last", last)
    expect_whole("group", group, 2)
    lines = odd_lines(first, last)
    whole = len(lines) // group
    left_out = np.arange(whole) * group + np.floor(uniform(key, (whole,)) * group).astype(int)
    return np.delete(lines, left_out)


def log_odd_lines(first: int, last: int, points: int) -> Grid:
    """Odd lines spaced evenly on a logarithmic axis.

        unique(2 floor(g/2) + 1),   g = geomspace(first, last, points)

    Fewer than `points` lines come out: points that round to the same odd line are merged, and what rounds
    beyond `last` is dropped. `log_odd_lines(112, 2240, 366)` are the 336 lines from 4.036 to 79.32 Hz of a
    28 s period.

    **Arguments:** `first`, `last`: lines, whole numbers from 1. `points`: to spread over them, before they are rounded.

    **Returns:** the lines, (freq,), increasing.

    **Raises:** `jaxfrf.InputError` for no points, more than fit into memory, or a range without odd lines.

    **Source:** the grid of Zimmermann & Moberg, section IV.A (336 log-spaced odd frequencies, 4 to 80 Hz, period 28 s);
    the rounding is this project's own.
    """
    expect_whole("first", first)
    expect_whole("last", last)
    expect_whole("points", points)
    first, last = _range(first, last)
    if points < 1:
        raise input_error("points", f"{points}", "1 or more", "Say how many points to spread over the band.")
    check_memory("points", 24.0 * points, "Spread fewer points over the band.")
    lines = np.unique(2 * np.floor(np.geomspace(first, last, points) / 2).astype(int) + 1)
    return _some(lines[lines <= last], first, last)


@checked
def detection_lines(lines: Int[Array, "freq"], first: int | None = None, last: int | None = None) -> tuple[Grid, Grid]:
    """The unexcited lines (odd, even) of the band: odd and even nonlinear distortion show there.

    The band reaches from `first` to `last`; by default from the lowest to the highest excited line.

    **Arguments:** `lines`: the excited ones, (freq,), of a period. `first`, `last`: whole numbers, from 1.

    **Returns:** the odd and the even lines that are not excited, each increasing; either may be empty.

    **Raises:** `jaxfrf.InputError` without lines, and unless 1 <= `first` <= `last`.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 4.3.
    """
    lines = np.asarray(lines)
    if not lines.size:
        raise input_error("lines", "none", "the excited lines, one or more", "Take those of the design.")
    first, last = _range(lines.min() if first is None else first, lines.max() if last is None else last)
    silent = np.setdiff1d(np.arange(first, last + 1), lines)
    return silent[silent % 2 == 1], silent[silent % 2 == 0]


def _range(first, last) -> tuple[int, int]:
    if first != int(first) or last != int(last) or not 1 <= first <= last:
        raise input_error(
            "first and last line",
            f"{first} and {last}",
            "whole numbers with 1 <= first <= last",
            "Line k is k*fs/period Hz; `band_lines` converts a band in Hz.",
        )
    first, last = int(first), int(last)
    check_memory("lines", 8.0 * (last - first), "Shorten the period, or narrow the band.")
    return first, last


def _some(lines: Grid, first: int, last: int) -> Grid:
    if lines.size == 0:
        raise input_error("lines", f"no odd line from {first} to {last}", "at least one", "Widen the band.")
    return lines
