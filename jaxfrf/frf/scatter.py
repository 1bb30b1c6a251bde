"""Noise of a response that comes without its covariance: how far its lines scatter about a fraction through a few."""

import numpy as np
import scipy.ndimage
import scipy.optimize
from jaxtyping import Complex, Float

_WIDTH, _ORDER = 11, 2  # lines of a window; order of numerator and denominator, which take a resonance and its rest
_ROUNDS = 5  # of weights that follow the shape of the noise
_MUCH = 2.0  # times what is expected of a window: as much and more counts less
_SINGULAR = 1e-12  # of the largest entry: columns that depend on each other tell no denominator
_BLOCK = 200_000  # entries of windows that are solved together


def scatter(frequency: Float[np.ndarray, "freq"], G: Complex[np.ndarray, "freq *element"]) -> Float[np.ndarray, "..."]:
    """Standard deviation of G, (freq, ...), from how its lines scatter, element by element; NaN where G is.

    A fraction B(r)/A(r) of second order goes through every eleven lines, r the distance from the middle one; what it
    leaves of A G is noise, which A weighs, averaged over as many windows: of the shape a + b |G|^2, as noise of the
    output and of the input or the gain are. A little too small for white noise, some of which the fraction takes, and
    for errors of lines that share data; too large where a resonance has but a line or two. Of fewer lines, how far
    each is off the straight line between its neighbours, which takes a resonance for noise; 0 for fewer than three.

    **Source:** the local rational window (McKelvey & Guerin, SYSID 2012), of G itself.
    """
    g = G.reshape(len(G), -1)
    found = np.full(g.shape, np.nan)
    finite, alike = np.unique(np.isfinite(g), axis=1, return_inverse=True)
    for k, lines in enumerate(finite.T):
        if lines.any():
            at = np.ix_(lines, np.ravel(alike) == k)
            found[at] = (_of_windows if lines.sum() >= _WIDTH else _of_neighbours)(frequency[lines], g[at])
    return found.reshape(G.shape)


def _of_windows(frequency, g) -> Float[np.ndarray, "freq element"]:
    n = len(g)
    first = np.clip(np.arange(n) - _WIDTH // 2, 0, n - _WIDTH)
    size = max(1, _BLOCK // (_WIDTH * (2 * _ORDER + 1) * g.shape[1]))
    parts = [_left(frequency, g, first[k : k + size], k, _WIDTH) for k in range(0, n, size)]
    left, plain, growing = (np.concatenate(x) for x in zip(*parts, strict=True))
    power = np.abs(g) ** 2
    shapes = map(_shape, left.T, plain.T, growing.T, power.T)
    shape, usual = (np.stack(x, axis=1) for x in zip(*shapes, strict=True))
    level = scipy.ndimage.uniform_filter1d(left / usual, _WIDTH, axis=0, mode="reflect")
    return np.sqrt(np.maximum(level, 0.0) * shape)


def _of_neighbours(frequency, g) -> Float[np.ndarray, "freq element"]:
    if len(g) < 3:
        return np.zeros(g.shape)
    share = ((frequency[2:] - frequency[1:-1]) / (frequency[2:] - frequency[:-2]))[:, None]
    off = np.abs(g[1:-1] - share * g[:-2] - (1 - share) * g[2:]) ** 2 / (1 + share**2 + (1 - share) ** 2)
    return np.sqrt(np.broadcast_to(np.mean(off, axis=0), g.shape))


def _shape(left, plain, growing, power) -> tuple[Float[np.ndarray, "freq"], Float[np.ndarray, "freq"]]:
    """a + b |G|^2 of the lines of one element, and what windows leave of it (`plain` of 1, `growing` of |G|^2), by
    nonnegative least squares, each window weighed by what is expected of it."""
    usual, units = np.median(left), np.array([np.median(plain), np.median(growing)])
    if not (usual > 0 and units.min() > 0):  # a dead output: nothing to tell a shape by
        return np.ones_like(left), np.ones_like(left)
    columns = usual * np.stack([plain, growing], axis=1) / units
    found = np.array([1.0, 0.0])
    for _ in range(_ROUNDS):
        expected = np.maximum(columns @ found, 1e-300)
        weight = 1.0 / np.maximum(expected, left / _MUCH)  # a resonance that the fractions miss is no noise
        found = scipy.optimize.nnls(columns * weight[:, None], left * weight)[0]
    a, b = usual * found / units
    return a + b * power, np.maximum(columns @ found, 1e-300)


def _left(frequency, g, first, centre: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Power that the fractions leave of the windows that begin at `first`, the first of them around `centre`, and what
    they leave of noise of power 1 and of |G|^2: (window, element) each."""
    lines = first[:, None] + np.arange(width)
    r = frequency[lines] - frequency[centre : centre + len(first), None]
    r = (r / np.abs(r).max(axis=1, keepdims=True))[:, None, :, None]
    target = np.moveaxis(g[lines], 1, 2)[..., None]  # (window, element, line, 1)
    numerator = np.broadcast_to(r ** np.arange(_ORDER + 1), (*target.shape[:-1], _ORDER + 1))
    columns = np.concatenate([numerator, target * r ** np.arange(1, _ORDER + 1)], axis=-1)
    Q, R = np.linalg.qr(columns)
    along = Q.conj().mT @ target
    left = target - Q @ along
    some = _SINGULAR * np.abs(R).max(axis=(-2, -1), keepdims=True) + 1e-300
    found = np.linalg.solve(R + some * np.eye(R.shape[-1]), along)[..., -_ORDER:, :]
    A = 1.0 - (r ** np.arange(1, _ORDER + 1)) @ found
    weight = np.abs(A[..., 0]) ** 2
    power = np.sum(np.abs(left[..., 0]) ** 2, axis=-1) / (width - columns.shape[-1])
    return power, weight.mean(axis=-1), np.mean(weight * np.abs(target[..., 0]) ** 2, axis=-1)
