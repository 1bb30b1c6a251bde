"""Poles of all model orders of an FRF, and which of them are modes: those that stay from order to order."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from .._arguments import expect_real
from .._errors import input_error

_NEAR_FREQUENCY = 0.01  # relative: poles of two orders nearer than this are one
_NEAR_DAMPING = 0.2  # relative, beside an absolute half of the next
_NEAR_DAMPING_ABSOLUTE = 0.002
_OFTEN = 0.4  # of the orders above the one where it came up first that a mode is found at
LARGEST_DAMPING = 0.5  # more is no resonance


class Stabilisation(eqx.Module):
    """The poles of all model orders.

    **Fields:** each (pole,): `order` of the model, `frequency`, Hz, `damping`, ratio to the critical one, and `stable`:
    whether the order below had it, too.
    """

    order: Int[np.ndarray, "pole"]
    frequency: Float[np.ndarray, "pole"]
    damping: Float[np.ndarray, "pole"]
    stable: Bool[np.ndarray, "pole"]


def stabilisation(frequency, G, std, most: int) -> Stabilisation:
    """Poles of the orders 2, 3, ..., `most` of G, (freq, out, in), at `frequency`, Hz, weighed by `std` where known."""
    rows, before = [], np.zeros(0, complex)
    for order, poles in _poles_by_order(frequency, G, std, most):
        stable = [_known(pole, before) for pole in poles]
        rows += [(order, abs(p) / 2 / np.pi, -p.real / abs(p), x) for p, x in zip(poles, stable, strict=True)]
        before = poles
    columns = list(zip(*rows, strict=True)) or [(), (), (), ()]
    kinds = (int, float, float, bool)
    return Stabilisation(*(np.array(x, kind) for x, kind in zip(columns, kinds, strict=True)))


def _known(pole: complex, before) -> bool:
    if not len(before):
        return False
    w, other = abs(pole), np.abs(before)
    damping, others = -pole.real / w, -before.real / other
    near = np.abs(other - w) < _NEAR_FREQUENCY * w
    return bool(np.any(near & (np.abs(others - damping) < _NEAR_DAMPING * damping + _NEAR_DAMPING_ABSOLUTE)))


def _poles_by_order(frequency, G, std, most: int):
    """(order, poles in the band with a positive imaginary part, stable ones), by reduced normal equations.

    The equations of an order are a part of those of every higher one: the Gram matrices are made once.
    """
    n_freq, n_out, n_in = G.shape
    first, span = frequency[0], frequency[-1] - frequency[0]
    # The band is moved to begin at zero: only its width asks for orders. It goes once round the circle then, from
    # zero on its upper half stands for all of it.
    shift = 2 * np.pi * max(first - 0.05 * span, 0.0)
    period = 1.0 / (1.1 * span if shift > 0 else 2.2 * span if first > 0 else 2 * frequency[-1])
    z = np.exp(-1j * (2 * np.pi * frequency - shift) * period)
    powers = z[:, None] ** np.arange(most + 1)
    level = np.sqrt(np.mean(np.abs(G) ** 2, axis=0)) + 1e-300
    real = shift == 0.0
    R, S, T = [], [], np.zeros(())
    for out in range(n_out):
        spread = np.abs(G[:, out]) + 1e-2 * level[out] if std is None else std[:, out] + 3e-3 * np.abs(G[:, out])
        weight = 1.0 / np.sqrt(np.mean(spread**2, axis=1))
        X = weight[:, None] * powers
        Y = -(X[:, :, None] * G[:, out][:, None, :]).reshape(n_freq, -1)
        part = np.real if real else np.asarray
        R.append(part(X.conj().T @ X))
        S.append(part(X.conj().T @ Y))
        T = T + part(Y.conj().T @ Y)
    for order in range(2, most + 1):
        n, m = order + 1, (order + 1) * n_in
        M = np.array(T[:m, :m])
        for r, x in zip(R, S, strict=True):
            M -= x[:n, :m].conj().T @ np.linalg.lstsq(r[:n, :n], x[:n, :m], rcond=1e-13)[0]
        # The lowest coefficient is the identity: poles without a mode then are unstable.
        alpha = -np.linalg.lstsq(M[n_in:, n_in:], M[n_in:, :n_in], rcond=1e-13)[0].reshape(order, n_in, n_in)
        yield order, _in_band(_roots(alpha), period, shift, frequency)


def _roots(alpha) -> np.ndarray:
    """Roots z of det(I + sum_r alpha_r z^r) = 0: one over the eigenvalues of the companion matrix."""
    order, n, _ = alpha.shape
    companion = np.zeros((order * n, order * n), alpha.dtype)
    companion[:n] = -alpha.transpose(2, 0, 1).reshape(n, order * n)
    companion[n:, :-n] = np.eye((order - 1) * n)
    values = np.linalg.eigvals(companion)
    return 1.0 / values[np.abs(values) > 1e-12]


def _in_band(z: np.ndarray, period: float, shift: float, frequency) -> np.ndarray:
    low, high = 2 * np.pi * frequency[0], 2 * np.pi * frequency[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        poles = (-np.log(np.abs(z)) + 1j * (-np.angle(z) % (2 * np.pi))) / period + 1j * shift
        w = np.abs(poles)
        damping = -poles.real / w
    wanted = (poles.imag > 0) & (w >= low) & (w <= high) & (damping > 1e-5) & (damping < LARGEST_DAMPING)
    return poles[wanted][np.argsort(w[wanted])]


def clusters(table: Stabilisation) -> np.ndarray:
    """One pole, rad/s, for each run of stable ones: of the highest order that has it, those that came often."""
    left = np.flatnonzero(table.stable)
    found, orders = [], np.unique(table.order)
    while left.size:
        # The densest place first: the pole with the most others near it.
        f, d = table.frequency[left], table.damping[left]
        near = np.abs(f[:, None] - f) < _NEAR_FREQUENCY * f[:, None]
        near &= np.abs(d[:, None] - d) < 2 * _NEAR_DAMPING * d[:, None] + _NEAR_DAMPING_ABSOLUTE
        centre = near[np.argmax(near.sum(axis=1))]
        members = left[centre]
        came = orders[orders >= table.order[members].min()]
        if len(np.unique(table.order[members])) >= max(_OFTEN * len(came), 3):
            found.append(pole(np.median(table.frequency[members]), np.median(table.damping[members])))
        left = left[(np.abs(f - np.median(table.frequency[members])) >= _NEAR_FREQUENCY * f) & ~centre]
    return np.array(sorted(found, key=abs), complex)


def nearest(table: Stabilisation, near: Sequence[float]) -> np.ndarray:
    """One pole, rad/s, for each frequency, Hz."""
    chosen = []
    expect_real("near", near)
    for f in np.atleast_1d(near):
        distance = np.abs(table.frequency - f)
        if not distance.size or distance.min() > 0.05 * f:
            raise input_error(
                "near", f"no pole near {f:g} Hz", "frequencies of poles", "See the stabilisation diagram."
            )
        members = np.flatnonzero(distance < max(1.5 * distance.min(), _NEAR_FREQUENCY * f))
        chosen.append(pole(np.median(table.frequency[members]), np.median(table.damping[members])))
    return np.array(sorted(chosen, key=abs), complex)


def pole(frequency: float, damping: float) -> complex:
    """rad/s, that of the pair with a positive imaginary part."""
    return 2 * np.pi * frequency * complex(-damping, np.sqrt(1 - damping**2))
