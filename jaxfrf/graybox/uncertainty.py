"""What a fit knows of its parameters: covariance, bound, correlations, directions that the data do not show."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._types import Array
from ..frf.overlap import fraction_weights
from .cost import Cost
from .model import AbstractModel
from .parameter import Coordinates
from .target import Target

_BLIND = 1e-10  # information of a direction relative to the largest: the data do not determine it
_ROUNDING = 1e-22  # of a parameter: it has no effect at all; a start ten times off leaves some 1e-10 of it
_NOTHING, _TOLD = 1e-13, 1e-11  # eigenvalues, of ones on the diagonal: what stands for none, and above rounding
_LOOSE = 0.5  # standard deviation in ln beyond which a parameter or a direction is called not identifiable
_CORRELATED = 0.9
_PART = 0.1  # of a direction of length one: a parameter belongs to it


class Uncertainty(eqx.Module):
    """Everything in coordinates x: ln(value) of positive parameters, value/scale of others.

    **Fields:** (parameters in the order of `Coordinates.names`)

    - `cov`: sandwich covariance H^-1 M H^-1 of the estimate, (parameter, parameter). M holds the covariance of the FRF,
      correlation between lines that share a window included; it is widened by `misfit`.
    - `misfit`: mean square residual over what the FRF's covariance predicts, at least 1: above it the model (or the
      estimator) leaves out something, and intervals are widened by its square root. It cannot know a bias that the fit
      absorbed.
    - `crlb`: lower bound of the covariance for any unbiased fit to these FRFs, (parameter, parameter); exact for lines
      that are independent. Zero where the covariance of the FRF is unknown.
    - `information`: Gauss-Newton matrix H of the cost with its weights, (parameter, parameter).
    - `expected_cost`: of a true model under the FRF's covariance.
    - `cost`: reached.
    """

    cov: Float[Array, "parameter parameter"]
    misfit: float
    crlb: Float[Array, "parameter parameter"]
    information: Float[Array, "parameter parameter"]
    expected_cost: float
    cost: float
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of every parameter in x: relative for positive ones, (parameter,)."""
        return np.sqrt(np.maximum(np.diagonal(self.cov), 0))

    @property
    def correlation(self) -> np.ndarray:
        """Of the estimates; of the cost's curvature where the FRF's covariance is unknown: (parameter, parameter)."""
        cov = np.asarray(self.cov) if np.any(self.cov) else _inverse(np.asarray(self.information))
        return np.clip(_correlation(cov), -1.0, 1.0)

    def correlations(self, above: float = _CORRELATED) -> dict[tuple[str, str], float]:
        """Pairs of parameters whose estimates are correlated above this; pairs that `directions` names are left out."""
        rho = np.where(self._loose[:, None] & self._loose, 0.0, self.correlation)
        pairs = zip(*np.nonzero(np.triu(np.abs(rho) > above, 1)), strict=True)
        return {(self.names[i], self.names[j]): float(rho[i, j]) for i, j in pairs}

    @property
    def _loose(self) -> np.ndarray:
        """Which parameters take part in a direction that the data do not determine, (parameter,)."""
        values, vectors = np.linalg.eigh(np.asarray(self.information))
        free = values <= max(1 / _LOOSE**2, _BLIND * values[-1])
        return np.any(np.abs(vectors[:, free]) > _PART, axis=1)

    @property
    def identifiable(self) -> np.ndarray:
        """Whether the data determine each parameter better than a factor of 1.6, (parameter,)."""
        loose = np.sqrt(np.diagonal(_inverse(np.asarray(self.information))))
        return np.maximum(loose, self.std) < _LOOSE

    def directions(self, without: tuple[str, ...] = ()) -> list[str]:
        """Combinations of parameters that the data do not determine, in words, the worst first; parameters `without`
        (at a bound, where they cannot change the response) left aside."""
        seen = np.flatnonzero(~np.isin(self.names, without))
        if not len(seen):
            return []
        values, vectors = np.linalg.eigh(np.asarray(self.information)[np.ix_(seen, seen)])
        names = [self.names[i] for i in seen]
        worst = max(values[-1], 1e-300)
        said = []
        for value, vector in zip(values, vectors.T, strict=True):
            if value > max(1 / _LOOSE**2, _BLIND * worst):
                continue
            order = np.argsort(-np.round(np.abs(vector), 2), kind="stable")  # as it is told: rounding orders no equals
            large = [i for i in order if abs(vector[i]) > _PART]
            vector = vector * np.sign(vector[large[0]])
            parts = [f"{names[i]} {'up' if vector[i] > 0 else 'down'} ({vector[i]:+.2f})" for i in large]
            if len(large) == 1:
                said.append(f"{names[large[0]]} hardly changes the response: the data do not determine it")
            else:
                said.append(f"only together: {', '.join(parts)} leaves the response as it is")
        return said


def uncertainty(model: AbstractModel, coordinates: Coordinates, target: Target, x) -> Uncertainty:
    """Covariance and identifiability at the end of a fit.

    Fails to see a bias of the FRF (a window that smooths a resonance, friction): such a bias shows in `misfit` only
    where the model cannot follow it.
    """
    errors, slopes = (np.asarray(part) for part in Cost(model, coordinates, target).errors(jnp.asarray(x)))
    full = products(target, errors, slopes)
    H, cost = full[:-1, :-1], float(full[-1, -1])
    M, shaped, bound, noise = np.zeros_like(H), np.zeros_like(H), np.zeros_like(H), 0.0
    for pos in range(target.n_pos):
        score, alike, information, power = _position(target, slopes[pos], pos)
        M, shaped, bound, noise = M + score, shaped + alike, bound + information, noise + power
    inverse = _inverse(H)
    expected = max(noise - float(np.trace(inverse @ M)), 0.0)
    misfit = max(1.0, cost / expected) if expected > 0 else 1.0
    return Uncertainty(
        cov=_wider(_sandwich(H, M), _sandwich(H, shaped)) * misfit,
        misfit=misfit,
        crlb=_inverse(bound) if np.any(bound) else np.zeros_like(H),
        information=H,
        expected_cost=expected,
        cost=cost,
        names=coordinates.names,
    )


def products(target: Target, errors, slopes) -> np.ndarray:
    """`Cost.gram` from what `Cost.errors` gives, which is needed anyway: one program less to compile."""
    both = np.concatenate([-slopes, errors[..., None]], axis=-1)
    both = both if target.whitener is None else np.asarray(target.whitener) @ both
    weighted = (np.asarray(target.magnitude)[..., None] * both.real, np.asarray(target.phase)[..., None] * both.imag)
    rows = [part.reshape(-1, both.shape[-1]) for part in weighted]
    return sum(row.T @ row for row in rows)


def _position(target: Target, slope, pos: int):
    """Covariance of the gradient, as parabolas and as fractions make neighbouring lines alike, information and expected
    cost of one position."""
    used = np.asarray(target.used[pos])
    weight = np.asarray(target.magnitude[pos])
    cov, J = np.asarray(target.cov[pos]), np.where(used[..., None], slope, 0)
    floor = 1e-12 * np.maximum(np.real(np.diagonal(cov, axis1=-2, axis2=-1)).max(axis=-1), 1e-300)
    eye = np.eye(used.shape[-1])
    factor = np.linalg.cholesky(cov + eye * np.where(used, floor[:, None], 1.0)[:, None]) * used[:, :, None]
    known = np.real(np.diagonal(cov, axis1=-2, axis2=-1)).max(axis=-1) > 0
    factor = np.where(known[:, None, None], factor, 0)
    seen_J, seen_factor = J, factor
    if target.whitener is not None:
        whitener = np.asarray(target.whitener[pos])
        seen_J, seen_factor = whitener @ J, whitener @ factor
    Q = np.swapaxes(seen_J.conj(), -1, -2) @ (np.square(weight)[..., None] * seen_factor)
    alike = _alike(target, Q, pos)
    T = np.concatenate([Q.real, Q.imag], axis=-1) / np.sqrt(2)  # (freq, parameter, 2 vec)
    flat = T.reshape(len(T), -1)
    rho = None if target.overlap is None else target.overlap[pos]
    flat = flat * np.sqrt(np.asarray(target.scatter[pos])[:, 1:])
    T = flat.reshape(T.shape)
    spread = flat if rho is None else rho @ flat
    M = np.tensordot(spread.reshape(T.shape), T, axes=((0, 2), (0, 2)))
    solved = np.linalg.solve(np.where(known[:, None, None], factor, 0) + eye * ~(used & known[:, None])[:, None], J)
    solved = np.where(known[:, None, None], solved, 0)
    shares = np.ones(len(T)) if rho is None else 1.0 / np.maximum(rho.row_sums(), 1.0)
    shares = shares / np.asarray(target.scatter[pos])[:, 0]
    solved = (np.sqrt(shares)[:, None, None] * solved).reshape(-1, J.shape[-1])
    information = 2 * np.real(solved.conj().T @ solved)
    power = np.square(weight)[..., None] * np.abs(seen_factor) ** 2
    power = float(np.sum(np.asarray(target.scatter[pos])[:, 0] * power.sum(axis=(-1, -2))))
    return M, M if alike is None else alike, information, power


def _alike(target: Target, Q, pos: int) -> np.ndarray | None:
    """Covariance of the gradient where errors of lines that share windows have the shape of the response, as those of
    fractions have; `None` where there are none. `Q`: score of unit errors of every element, (freq, parameter, vec)."""
    rho, n_out = (None if target.overlap is None else target.overlap[pos]), target.fractions
    if rho is None or not n_out or len(rho.lines) != len(rho.width):
        return None
    log_G = np.asarray(target.log_G[pos])
    G, total = np.exp(log_G), np.zeros((Q.shape[1],) * 2)
    # What is left of an error once its phase is that of the response.
    Q = Q * np.exp(-1j * log_G.imag)[:, None, :] * np.sqrt(np.asarray(target.scatter[pos])[:, 1:])[..., None]
    for first in range(0, G.shape[1], n_out):
        of = slice(first, first + n_out)
        F = fraction_weights(rho.width.astype(float), G[:, of], rho.lines)
        score = (F.T @ Q[:, :, of].reshape(len(Q), -1)).reshape(-1, *Q[:, :, of].shape[1:])
        total += 0.5 * np.real(np.einsum("lpk,lqk->pq", score, score.conj(), optimize=True))
    return total


def _wider(cov, other):
    """The first of two covariances, as wide in every parameter as the wider one."""
    own, theirs = (np.maximum(np.diagonal(x), 0.0) for x in (cov, other))
    by = np.sqrt(np.maximum(theirs / np.maximum(own, 1e-300), 1.0))
    return cov * by[:, None] * by


def without_sensitivity(coordinates: Coordinates, hessian) -> tuple[str, ...]:
    """Names of parameters that do not change the response at all, found before a fit."""
    own = np.diagonal(np.asarray(hessian))
    return tuple(n for n, value in zip(coordinates.names, own, strict=True) if not value > _ROUNDING * own.max())


def _inverse(matrix):
    """Inverse of a symmetric matrix by its scaled eigenvalues; directions without information get a large variance."""
    values, vectors, scale = _scaled_eigen(matrix)
    return (vectors / np.maximum(values, _NOTHING)) @ vectors.T / scale[:, None] / scale[None, :]


def _sandwich(H, M):
    """H^-1 M H^-1; a large variance where H has no information, which M says nothing of but rounding."""
    values, vectors, scale = _scaled_eigen(H)
    told = values > _TOLD
    inner = vectors.T @ (M / scale[:, None] / scale[None, :]) @ vectors
    inner = np.where(told[:, None] & told, inner / np.outer(np.where(told, values, 1), np.where(told, values, 1)), 0.0)
    inner[~told, ~told] = 1 / _NOTHING
    return vectors @ inner @ vectors.T / scale[:, None] / scale[None, :]


def _scaled_eigen(matrix):
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    return *np.linalg.eigh(matrix / scale[:, None] / scale[None, :]), scale


def _correlation(cov):
    scale = np.sqrt(np.maximum(np.diagonal(cov), 1e-300))
    return cov / scale[:, None] / scale[None, :]
