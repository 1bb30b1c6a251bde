"""What columns leave of a residual, and how lines are weighed by it."""

import numpy as np
from jaxtyping import Complex, Float

from .evidence import Evidence, Weighed, by_band

_AROUND = 21  # lines over which a remainder's size is smoothed


def remainder(evidence: Evidence, weighed: Weighed, change, columns=None) -> Complex[np.ndarray, "pos exp line axis"]:
    """Residual less the columns taken so often, the first ones where `columns` does not say which; N m."""
    change = np.asarray(change, np.float32)
    columns = slice(len(change)) if columns is None else columns
    shape, left = evidence.residual.shape[1:], []
    for part in weighed.parts:
        rest = part[:, -1] - change @ part[:, columns]
        half = rest.shape[1] // 2
        left.append((rest[:, :half] + 1j * rest[:, half:]).reshape(shape) * evidence.floor)
    return np.stack(left)


def excess(left, plain, frequency) -> float:
    """Mean square over the plain floor where most of a remainder is: of one axis in one band, over the positions. An
    honest model leaves less than 1 everywhere."""
    return float(np.max(np.mean(by_band(left, plain, frequency), axis=(0, 1))))


def usual_size(left, noise) -> Float[np.ndarray, "line axis"]:
    """rms of the real part of a remainder around every line, not below the measured noise; of the steady torque its
    own, but not below that of its neighbours. Windows at an end of the band are shifted inwards: a line that counted
    more than once, as a slow sine on the first one may, would lose its weight to what it leaves itself."""
    power = 0.5 * np.mean(np.abs(left) ** 2, axis=(0, 1))
    count = len(power) - 1
    width = min(_AROUND, count)
    first = np.clip(np.arange(count) - width // 2, 0, count - width)
    smooth = np.lib.stride_tricks.sliding_window_view(power[1:], width, axis=0).mean(axis=-1)[first]
    steady = np.maximum(2.0 * power[:1], smooth[:1])
    return np.sqrt(np.maximum(np.concatenate([steady, smooth]), 0.5 * noise**2))


def steady_seen(evidence: Evidence) -> Float[np.ndarray, "line axis"]:
    """The floor with the steady torque's as that of the lines beside it: its own follows what is left of it, and a
    torque that is missing at all times would not be seen."""
    floor = evidence.floor.copy()
    floor[0] = np.minimum(floor[0], np.maximum(evidence.plain[0], floor[1]))
    return floor
