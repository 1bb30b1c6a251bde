"""Noise of a response that comes without its covariance: how far its lines scatter about a fraction through a few."""

import numpy as np
import scipy.ndimage
import scipy.optimize
from jaxtyping import Complex, Float

_WIDTH, _ORDER = 11, 2  # lines of a window; order of numerator and denominator, which take a resonance and its rest
_ROUNDS = 5  # of weights that follow the shape of the noise
_MUCH = 2.0  # times what is expected of a window: as much and more counts less
_BLOCK = 200_000  # entries of windows that are solved together


def scatter(frequency: Float[np.ndarray, "freq"], G: Complex[np.ndarray, "freq *element"]) -> Float[np.ndarray, "..."]:
    """Standard deviation of G, (freq, ...), from how its lines scatter, element by element.

    A fraction B(r)/A(r) of second order goes through every eleven lines, r the distance from the middle one; what it
    leaves, a mean over as many windows, is noise: of the shape a + b |G|^2, as noise of the output and of the input or
    the gain are. Too small (.83 of it) for white noise, some of which the fraction takes, and for errors of lines that
    share data; too large where a resonance has but a line or two.

    **Source:** the local rational window (McKelvey & Guerin, SYSID 2012), of G itself.
    """
    n, width = len(G), min(_WIDTH, len(G))
    g = G.reshape(n, -1)
    first = np.clip(np.arange(n) - width // 2, 0, n - width)
    size = max(1, _BLOCK // (width * (2 * _ORDER + 1) * g.shape[1]))
    left = np.concatenate([_left(frequency, g, first[k : k + size], k, width) for k in range(0, n, size)])
    power = np.abs(g) ** 2
    inside = np.lib.stride_tricks.sliding_window_view(power, width, axis=0).mean(axis=-1)[first]
    shape, usual = (np.stack(x, axis=1) for x in zip(*map(_shape, left.T, inside.T, power.T), strict=True))
    level = scipy.ndimage.uniform_filter1d(left / usual, width, axis=0, mode="reflect")
    return np.sqrt(np.maximum(level, 0.0) * shape).reshape(G.shape)


def _shape(left, inside, power) -> tuple[Float[np.ndarray, "freq"], Float[np.ndarray, "freq"]]:
    """a + b |G|^2 of the lines of one element and its mean over their windows, from what is left of these: nonnegative
    least squares, each window weighed by what is expected of it."""
    usual = np.median(left)
    if not (usual > 0 and np.median(inside) > 0):  # a dead output: nothing to tell a shape by
        return np.ones_like(left), np.ones_like(left)
    part = usual / np.median(inside)
    columns = np.stack([np.full_like(inside, usual), part * inside], axis=1)
    found = np.array([1.0, 0.0])
    for _ in range(_ROUNDS):
        expected = np.maximum(columns @ found, 1e-300)
        weight = 1.0 / np.maximum(expected, left / _MUCH)  # a resonance that the fractions miss is no noise
        found = scipy.optimize.nnls(columns * weight[:, None], left * weight)[0]
    return found[0] * usual + found[1] * part * power, np.maximum(columns @ found, 1e-300)


def _left(frequency, g, first, centre: int, width: int) -> Float[np.ndarray, "window element"]:
    """Variance of what the fractions leave of the windows that begin at `first`, the first of them around `centre`."""
    lines = first[:, None] + np.arange(width)
    r = frequency[lines] - frequency[centre : centre + len(first), None]
    r = (r / np.abs(r).max(axis=1, keepdims=True))[:, None, :, None]
    target = np.moveaxis(g[lines], 1, 2)[..., None]  # (window, element, line, 1)
    numerator = np.broadcast_to(r ** np.arange(_ORDER + 1), (*target.shape[:-1], _ORDER + 1))
    columns = np.concatenate([numerator, target * r ** np.arange(1, _ORDER + 1)], axis=-1)
    Q = np.linalg.qr(columns)[0]
    left = target - Q @ (Q.conj().mT @ target)
    return np.sum(np.abs(left[..., 0]) ** 2, axis=-1) / (width - columns.shape[-1])
