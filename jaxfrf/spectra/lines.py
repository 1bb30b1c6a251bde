"""The lines that an experiment excites."""

import numpy as np
from jaxtyping import Int

from .._arguments import expect
from .._errors import input_error
from ..experiment import Experiment
from ..periodic import FoundLines, find_lines
from .fourier import mean_and_variance


def known_lines(data: Experiment) -> Int[np.ndarray, "freq"]:
    """The excited lines that a record lists, or those that are found in it (`excited_lines`)."""
    return excited_lines(data) if data.lines is None else np.asarray(data.lines)


def excited_lines(data: Experiment) -> Int[np.ndarray, "freq"]:
    """The lines that the reference (or, without one, the input) excites, found from its spectrum.

    A line counts when *every* channel is excited there (a slow sine on one axis does not make a line); of zippered
    designs, where each channel has lines of its own, those of all channels count.

    Excited and quiet lines are two levels, smooth in frequency: a line counts that is nearer to the upper one (medians
    over 41 lines), carries more than noise and fits the grid of the others; missing lines of a full grid are filled in.
    `jaxfrf.screen` says how sure that is.

    Fails where there are no two levels, as with noise, sweeps or a spectrum that falls off smoothly: all lines within
    40 dB of the strongest then count. Biased to a regular grid: single lines beside one are left out, and strong
    distortion at unexcited lines may count as excitation where the input stands for a reference. Give `lines` where
    they are known.

    **Arguments:** `data`: periodic, with `r` or without.

    **Returns:** lines of one period, (freq,); line k is k fs/period Hz.

    **Raises:** `jaxfrf.InputError` if the record has no period, or a channel carries no power.

    **Source:** this project's own.
    """
    expect("data", data, Experiment)
    return found_lines(data).lines


def found_lines(data: Experiment) -> FoundLines:
    """`excited_lines` with the design they fit, in words, and a confidence from 0 to 1.

    **Raises:** as `excited_lines`.
    """
    if not data.period:
        raise input_error(
            where(data, "period"), "0", "a periodic record", "Say its period (period=N), or cut it (jaxfrf.segments)."
        )
    k = np.arange(1, (data.period - 1) // 2 + 1)
    power, noise = _power(data, k)
    return lines_in(k, power, noise, data)


def lines_in(k, power, noise, data: Experiment) -> FoundLines:
    """The lines that stand out of power and noise at lines k, as of `added_power`; `data` is named where none do."""
    found = find_lines(k, power, noise)
    if found is None:
        raise input_error(
            where(data, "u" if data.r is None else "r"),
            "no power at any line",
            "an excitation in every channel",
            "Check the names in --map, and that every channel was excited.",
        )
    return found


def _power(data: Experiment, k) -> tuple[np.ndarray, np.ndarray | None]:
    """Power per line and channel of the reference (or input) over all experiments, and what of it is noise as far as
    the scatter between periods shows: (freq, channel). A position counts by its speed."""
    return weighed_power(data, k, *added_power(data, k))


def added_power(data: Experiment, k, power=None, noise=None) -> tuple[np.ndarray, np.ndarray | None]:
    """Power of the experiments, added to that of others, and noise (`None` of single periods): (freq, channel)."""
    x = data.u if data.r is None else data.r
    power = np.zeros((len(k), x.shape[-1])) if power is None else power
    noise = (np.zeros_like(power) if noise is None else noise) if data.n_periods > 1 else None
    for pos in range(data.n_pos):
        for exp in range(data.n_exp):
            mean, variance = mean_and_variance(x[pos, exp], data.period, data.transient_periods, k)
            power += np.abs(mean) ** 2
            if noise is not None:
                noise += variance
    return power, noise


def weighed_power(data: Experiment, k, power, noise) -> tuple[np.ndarray, np.ndarray | None]:
    """The same of speeds, where the reference is a position."""
    weight = np.ones(len(k))
    if data.r is not None and data.r_quantity == "position":
        weight = k.astype(float) ** 2
    return power * weight[:, None], None if noise is None else noise * weight[:, None]


def line_power(data: Experiment) -> np.ndarray:
    """Power of the reference (or input) at lines 1, 2, ... of the period, summed over experiments: (freq, channel)."""
    return _power(data, np.arange(1, (data.period - 1) // 2 + 1))[0]


def strength(data: Experiment, k) -> np.ndarray:
    """Power per line of the weakest channel, each channel in units of its own median-free peak: (freq,)."""
    power, _ = _power(data, k)
    peak = np.sort(power, axis=0)[-min(4, len(k))]
    if np.any(peak <= 0):
        return np.zeros(len(k))
    return np.min(power / peak, axis=1)


def where(data: Experiment, name: str) -> str:
    return f"{data.sources[0].name}: {name}" if data.sources else name
