"""Poles and residues by weighted least squares, with their covariance: the residues are eliminated."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from .overlap import Overlap

_STEPS = 60
_ENOUGH = 1e-10  # relative change of the cost
_LEAST, _MOST = 1e-6, 0.9999  # damping ratio
_LAGS = 4  # lines over which what is left may hang together
_LOOSER = 2.0  # times a variance by windows that share data: they differ from line to line, and fractions in noise are
# biased; `pytest -s -m slow tests/frf/test_modal.py -k share_windows` prints how far estimates stand off with it


Errors = Callable[[Complex[np.ndarray, "element freq k"], Float[np.ndarray, "freq element"]], Float[np.ndarray, "k k"]]
"""Covariance of sums over elements and lines, Re sum conj(w) e, of the errors e over the given deviations; w, k columns
of them."""


class PoleFit(NamedTuple):
    """`poles`: rad/s, by frequency. `frequency_std`: Hz. `coefficients`: (element, 2 poles + terms), real: real and
    imaginary part of every residue, then the background; `coefficient_std` likewise. `misfit`: root mean square of the
    residual over its standard deviation. `delay`: s, with its standard deviation, 0 where it was given. `began`: which
    of the given poles each began as. `strength`: residues over their standard deviation at this delay, root mean square
    over the elements: a delay beside a lag is loose, and residues turn with it. `cost`: squares of what is left over
    its standard deviation, of which `unit` is worth 1."""

    poles: Complex[np.ndarray, "pole"]
    damping: Float[np.ndarray, "pole"]
    frequency_std: Float[np.ndarray, "pole"]
    damping_std: Float[np.ndarray, "pole"]
    coefficients: Float[np.ndarray, "element coefficient"]
    coefficient_std: Float[np.ndarray, "element coefficient"]
    misfit: float
    delay: float
    delay_std: float
    began: Int[np.ndarray, "pole"]
    strength: Float[np.ndarray, "pole"]
    cost: float
    unit: float

    @property
    def residues(self) -> tuple[Complex[np.ndarray, "element pole"], Float[np.ndarray, "element pole"]]:
        """Residues, and the standard deviation of their moduli."""
        n, shape = len(self.poles), (len(self.coefficients), len(self.poles), 2)
        c, d = (x[:, : 2 * n].reshape(shape) for x in (self.coefficients, self.coefficient_std))
        return c[..., 0] + 1j * c[..., 1], np.sqrt(np.sum(d**2, axis=-1)) + 1e-300


def mode_basis(s, poles) -> Complex[np.ndarray, "freq 2*pole"]:
    """1/(s - p) + 1/(s - p*), and j/(s - p) - j/(s - p*), for every pole: real coefficients are a residue's parts."""
    a, b = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    return np.stack([a + b, 1j * (a - b)], axis=-1).reshape(len(s), -1)


def fit_poles(
    s: Complex[np.ndarray, "freq"],
    G: Complex[np.ndarray, "freq element"],
    std: Float[np.ndarray, "freq element"],
    poles: Complex[np.ndarray, "pole"],
    background: Complex[np.ndarray, "freq term"],
    *,
    alike: Sequence[Overlap | Complex[np.ndarray, "freq freq"]] = (),
    delay: float | None = 0.0,
    errors: Errors | None = None,
    measured: bool = True,
) -> PoleFit:
    """Gauss-Newton on frequency and damping of every pole, residues and background eliminated (variable projection).

    **Arguments:** `std`: of G. `poles`: where to start. `background`: more basis functions with real coefficients.
    `alike`: correlations that the lines' errors may have, of windows that share data; the one that makes an estimate
    loosest counts. `delay`: s, of all elements alike; `None`: fitted, too. `errors`: of G; `None`: those of `std`,
    independent from element to element. With them the poles' covariance is B M B, B that of independent errors and M
    the variance of the slope of the cost. `measured`: whether `std` was; one that comes from how G scatters goes up and
    down with the misfit, and with how what is left hangs together from line to line.

    **Source:** Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432; White, Econometrica 50 (1982) 1-25 (B M B).
    """
    sigma = np.asarray(std, float)
    middle = float(np.exp(np.mean(np.log(np.abs(s)))))
    x = _coordinates(np.asarray(poles, complex), middle)
    if delay is None:
        x, turned = np.append(x, 0.0), G
    else:
        turned = G * np.exp(s * delay)[:, None]
    project = lambda at: _project(s, turned, sigma, at, background, middle)
    state = project(x)
    lift = 1e-3
    for _ in range(_STEPS):
        if not len(x):
            break
        H, g = state.gram, state.slope
        step = np.linalg.lstsq(H + lift * np.diag(np.diag(H)), g, rcond=None)[0]
        trial = x - np.clip(step, -0.2, 0.2)
        trial_state = project(trial)
        if trial_state.cost < state.cost:
            done = state.cost - trial_state.cost < _ENOUGH * state.cost
            x, state, lift = trial, trial_state, max(lift / 5, 1e-9)
            if done:
                break
        else:
            lift *= 10
            if lift > 1e4:
                break
    meat = None if errors is None or not len(x) else errors(_complex(state.outside), sigma)
    own = 1.0 if measured else _together(state.left)
    return _result(s, x, state, middle, alike, measured=measured, own=own, delay=delay, meat=meat)


class _State(NamedTuple):
    cost: float
    gram: np.ndarray  # of the poles, the residues eliminated
    slope: np.ndarray
    coefficients: np.ndarray
    basis: np.ndarray  # orthonormal, (element, part, coefficient), and the coefficients by their place in it
    inverse: np.ndarray
    change: np.ndarray  # of the coefficients with the poles
    dof: float
    outside: np.ndarray  # columns of the poles beside those of the residues, (element, part, pole)
    left: np.ndarray  # over its standard deviation, (element, part, 1)


def _coordinates(poles, middle: float) -> np.ndarray:
    """ln of frequency over the middle one, and ln of damping, by turns; one real pole is the most damped pair."""
    w = np.abs(poles)
    return np.stack([np.log(w / middle), np.log(np.maximum(-poles.real / w, _LEAST))], axis=1).ravel()


def _poles(x, middle: float) -> np.ndarray:
    """Of the coordinates; one that is left over is the angle that a delay turns the highest line by."""
    pairs = x[: len(x) // 2 * 2]
    w, damping = middle * np.exp(pairs[::2]), np.minimum(np.exp(pairs[1::2]), _MOST)
    return w * (-damping + 1j * np.sqrt(1 - damping**2))


def _project(s, G, sigma, x, background, middle: float) -> _State:
    """Residues and background for these poles, what is left, and its slope by the poles."""
    poles, turn = _poles(x, middle), s / np.abs(s).max()
    if len(x) % 2:
        G = G * np.exp(turn * x[-1])[:, None]
    basis = np.concatenate([mode_basis(s, poles), background], axis=1)
    scale = np.linalg.norm(basis, axis=0)
    slopes = _slopes(s, poles)  # (freq, pole, coordinate, part)
    weight = (np.sqrt(2) / sigma).T  # of real and imaginary part, (element, freq)
    A = _stacked(weight[..., None] * (basis / scale))
    b = _stacked((weight * G.T)[..., None])
    Q, R = np.linalg.qr(A)
    inverse = np.linalg.pinv(R)
    c = inverse @ (Q.mT @ b)
    left = A @ c - b
    coefficients, inverse = c[..., 0] / scale, inverse / scale[:, None]
    parts = coefficients[:, : 2 * len(poles)].reshape(len(b), len(poles), 2)
    J = np.einsum("fpkr,epr->efpk", slopes, parts, optimize=True).reshape(len(b), len(s), 2 * len(poles))
    if len(x) % 2:
        modelled = coefficients @ basis.T  # not G itself, whose noise would pass for something that a delay changes
        J = np.concatenate([J, -(turn * modelled)[..., None]], axis=-1)
    J = _stacked(weight[..., None] * J)
    inside = Q.mT @ J
    outside = J - Q @ inside
    dof = 2 * G.size - coefficients.size - len(x)
    return _State(
        cost=float(np.sum(left**2)),
        gram=np.sum(outside.mT @ outside, axis=0),
        slope=np.sum(outside.mT @ left, axis=0)[:, 0],
        coefficients=coefficients,
        basis=Q,
        inverse=inverse,
        change=-inverse @ inside,
        dof=max(dof, 1),
        outside=outside,
        left=left,
    )


def _stacked(x) -> np.ndarray:
    """Real parts, then imaginary parts, along the last axis but one."""
    return np.concatenate([x.real, x.imag], axis=-2)


def _complex(x) -> Complex[np.ndarray, "element freq k"]:
    """What was stacked."""
    real, imaginary = np.split(x, 2, axis=-2)
    return real + 1j * imaginary


def _slopes(s, poles) -> Complex[np.ndarray, "freq pole 2 2"]:
    """Derivative of both basis functions of a pole by ln of its frequency and ln of its damping."""
    w = np.abs(poles)
    damping = -poles.real / w
    root = np.sqrt(np.maximum(1 - damping**2, 1e-12))
    by_damping = np.where(damping < _MOST, w * damping * (-1 - 1j * damping / root), 0.0)
    by = np.stack([poles, by_damping], axis=-1)  # d pole
    a, b = 1 / (s[:, None] - poles) ** 2, 1 / (s[:, None] - poles.conj()) ** 2
    up, down = a[..., None] * by, b[..., None] * by.conj()
    return np.stack([up + down, 1j * (up - down)], axis=-1)


def _carried(change, covariance):
    """Variances of coefficients that change by so much, never below 0 however little is known of a pole."""
    size, direction = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.sum((change @ (direction * np.sqrt(np.maximum(size, 0.0)))) ** 2, axis=-1)


def _strength(coefficients, variance, n_poles: int) -> Float[np.ndarray, "pole"]:
    size, its = (x[:, : 2 * n_poles].reshape(len(x), n_poles, 2).sum(axis=-1) for x in (coefficients**2, variance))
    return np.sqrt(np.mean(size / (its + 1e-300), axis=0))


def _result(s, x, state: _State, middle: float, alike, *, measured: bool, own: float, delay, meat) -> PoleFit:
    misfit = np.sqrt(state.cost / state.dof)
    widened = own * (max(misfit, 1.0) if measured else misfit) ** 2
    n, each = len(x) // 2 * 2, _if_alike(alike, _complex(state.outside)).sum(axis=0)
    each = each / np.maximum(np.sum(state.outside**2, axis=(0, 1)), 1e-300)
    spread = independent_spread = np.sum(state.inverse**2, axis=-1)  # of the coefficients, for known poles
    if alike:  # by the element that tells most of the poles, as all
        most = int(np.argmax(np.sum(state.outside**2, axis=(1, 2)))) if len(x) else 0
        weights = _complex(state.basis[[most]] @ state.inverse[[most]].mT)
        spread = spread * (_if_alike(alike, weights) / np.maximum(spread[[most]], 1e-300))
    mean = np.sum(spread) / np.sum(independent_spread)
    independent = np.linalg.pinv(state.gram) if len(x) else np.zeros((0, 0))
    covariance = independent if meat is None else independent @ meat @ independent
    covariance = covariance * np.sqrt(each[:, None] * each)
    std = np.sqrt(np.maximum(np.diag(covariance), 0) * widened)
    through = _carried(state.change, covariance)
    change, known_delay = state.change[..., :n], np.linalg.pinv(state.gram[:n, :n])
    if meat is not None:
        known_delay = known_delay @ meat[:n, :n] @ known_delay
    known_delay = known_delay * np.sqrt(each[:n, None] * each[:n])
    at_delay = _carried(change, known_delay)
    poles, top = _poles(x, middle), np.abs(s).max()
    order = np.argsort(np.abs(poles))
    of_poles = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
    columns = np.concatenate([of_poles, np.arange(2 * len(poles), state.coefficients.shape[1])])
    damping = -poles.real / np.maximum(np.abs(poles), 1e-300)
    return PoleFit(
        poles=poles[order],
        damping=damping[order],
        frequency_std=(np.abs(poles) / 2 / np.pi * std[: 2 * len(poles) : 2])[order],
        damping_std=(damping * std[1 : 2 * len(poles) : 2])[order],
        coefficients=state.coefficients[:, columns.astype(int)],
        coefficient_std=np.sqrt((spread + through) * widened)[:, columns.astype(int)],
        misfit=float(misfit),
        delay=float(x[-1] / top) if delay is None else delay,
        delay_std=float(std[-1] / top) if delay is None else 0.0,
        began=order,
        strength=_strength(state.coefficients, (spread + at_delay) * widened, n // 2)[order],
        cost=float(state.cost),
        unit=float(widened * (covariance[-1, -1] / independent[-1, -1] if len(x) > n else mean)),
    )


def _together(left) -> float:
    """How much larger errors of lines that hang together make the variance of a sum over a few lines."""
    e = _complex(left)[..., 0]
    near = [np.sum(e[:, k:] * e[:, : e.shape[1] - k].conj()).real for k in range(1, min(_LAGS + 1, e.shape[1]))]
    return max(1.0, 1.0 + 2.0 * float(np.sum(near)) / max(float(np.sum(np.abs(e) ** 2)), 1e-300))


def _if_alike(alike, weights: Complex[np.ndarray, "element freq k"]) -> Float[np.ndarray, "element k"]:
    """Variances of sums of errors of unit size with these weights over the lines, by that of the correlations that
    makes them largest, with what they leave unsaid; no less than those of independent errors."""
    by_line = np.moveaxis(weights, 1, 0)
    columns = by_line.reshape(len(by_line), -1)

    def told(rho):
        if isinstance(rho, Overlap):
            parts = rho @ np.stack([columns.real, columns.imag], axis=-1)
            rest = parts[..., 0] + 1j * parts[..., 1]
        else:
            rest = rho @ columns
        return np.sum(by_line.conj() * rest.reshape(by_line.shape), axis=0).real

    independent = np.sum(np.abs(weights) ** 2, axis=1)
    return _LOOSER * np.max([independent, *map(told, alike)], axis=0) if alike else independent
