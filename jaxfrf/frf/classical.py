"""Classical estimators: H1, H2 and Hv, one line at a time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._errors import input_error
from ..spectra import Spectra
from .covariance import KroneckerSum
from .inverse import adjoint, inverse
from .least_squares import AbstractLeastSquares, check_periodic
from .method import AbstractMethod, Estimate, Signals, flags
from .window import Windows, windows

_DEPENDENT = 1e-9  # singular values this small, relative to the largest, are rounding
_AT_ONCE = 16  # lines whose rank is looked at together


class H1(AbstractLeastSquares):
    """G = Y U^H (U U^H)^-1 over all experiments: least squares with the noise in y.

    Biased low by noise in u; in closed loop biased by the noise that the controller feeds back, however many
    experiments there are. Needs n_exp >= n_in. With n_exp = n_in there is no residual: `cov` is then the
    measurement noise between the periods, and NaN where there is one only (Guillaume 1998; Zimmermann & Moberg,
    Eq. (G_H1)).
    """

    @property
    def polynomial_order(self) -> int:
        return 0

    @property
    def has_denominator(self) -> bool:
        return False

    @property
    def transient_order(self) -> None:
        return None

    def fractions(self, n_target: int):
        return (tuple(range(n_target)),)

    def windows(self, spectra: Spectra | Signals, n_parameters: int) -> Windows:
        check_experiments(spectra, n_parameters)
        return windows(np.arange(len(spectra.frequency)), 1)

    def block_size(self, spectra: Spectra | Signals) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        super().check(spectra)
        check_independent("u", spectra.U)

    def regressed(self, signals: Signals, joint: bool, lines=None) -> Estimate:
        estimate = super().regressed(signals, joint, lines)
        return _with_noise(estimate, signals, signals.R if joint else signals.U, lines)


class H2(AbstractMethod):
    """G = Y Y^H (U Y^H)^-1: least squares with the noise in u. As many outputs as inputs.

    Biased high by noise in y; better than `H1` at resonances, where y is large and u small. The covariance is H1's,
    to first order (Mitchell, J. Mech. Design 104, 1982).
    """

    def block_size(self, spectra: Spectra | Signals) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        check_periodic(spectra, H1())
        check_experiments(spectra, spectra.n_in)
        check_independent("u", spectra.U)
        if spectra.n_out != spectra.n_in:
            raise input_error(
                "H2",
                f"{spectra.n_out} outputs and {spectra.n_in} inputs",
                "as many outputs as inputs",
                "Use h1 or hv, or choose as many outputs as inputs.",
            )

    def residual_dof(self, signals: Signals) -> float:
        return float(signals.n_exp - signals.n_in)

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        def response(U, Y):
            return Y @ adjoint(Y) @ inverse(U @ adjoint(Y))

        return _residual_estimate(signals, response, lines)


class Hv(AbstractMethod):
    """Total least squares, one output at a time: noise in y and in every u, of equal power in the scaled signals.

    Between `H1` and `H2`: G_i from the eigenvector of the smallest eigenvalue of the cross-spectral matrix of [u; y_i],
    each signal scaled to unit power (Rocklin, Crowley & Vold 1985). Without noise all three agree. The covariance is
    H1's, to first order. Biased where noise is not as strong in u as in y, relative to the signals.
    """

    def block_size(self, spectra: Spectra | Signals) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        check_periodic(spectra, H1())
        check_experiments(spectra, spectra.n_in)
        check_independent("u", spectra.U)

    def residual_dof(self, signals: Signals) -> float:
        return float(signals.n_exp - signals.n_in)

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        def response(U, Y):
            return jax.vmap(lambda y: _total_least_squares(U, y))(Y)

        return _residual_estimate(signals, response, lines)


def check_experiments(spectra: Spectra | Signals, needed: int) -> None:
    if spectra.n_exp < needed:
        raise input_error(
            "experiments",
            f"{spectra.n_exp} at each operating point, with {spectra.n_in} inputs",
            f"at least {needed} for a classical estimate",
            "Add experiments, or use a local method (lpm, lrm-mimo, lrm-jio), which can do with one.",
        )


def check_independent(name: str, X) -> None:
    """Raise if the experiments are linearly dependent at every line, as when one record is repeated."""
    X = np.asarray(X)
    n = X.shape[-1]
    worst = np.array([_best_rank(np.moveaxis(x, 0, -1)) for x in X])
    if worst.min() < n:
        pos = int(np.argmin(worst))
        raise input_error(
            name,
            f"{X.shape[1]} experiments of rank {int(worst[pos])} at every line of position {pos}",
            f"rank {n}: experiments with as many independent excitations as inputs",
            "Use other phase realisations, or orthogonal multisines, in every experiment.",
        )


def _best_rank(X) -> int:
    """The largest rank at any line of (freq, channel, exp): looking at the lines only until one has full rank."""
    n, best = X.shape[1], 0
    for first in range(0, len(X), _AT_ONCE):
        singular = np.linalg.svd(X[first : first + _AT_ONCE], compute_uv=False)
        best = max(best, int((singular > _DEPENDENT * singular[..., :1]).sum(axis=-1).max()))
        if best == n:
            break
    return best


def by_line(X) -> np.ndarray:
    """Experiments side by side as columns: (pos, exp, freq, channel) -> (pos, freq, channel, exp)."""
    return np.moveaxis(np.asarray(X), 1, -1)


def _with_noise(estimate: Estimate, signals: Signals, instrument, lines) -> Estimate:
    """Add what the scatter between periods says of the covariance of G = Y Z^H (U Z^H)^-1, Z the instrument."""
    if signals.noise is None:
        return estimate

    def one_line(G, U, Z, noise):
        weight = adjoint(Z) @ inverse(_where_finite(G, U @ adjoint(Z)))
        effect = jnp.concatenate([jnp.eye(G.shape[0], dtype=G.dtype), -G], axis=1)
        left = weight[:, :, None] * weight.conj()[:, None, :]
        return KroneckerSum(left, effect @ noise @ adjoint(effect))

    U, Z, noise = (_at_line(x, lines) for x in (signals.U, instrument, signals.noise))
    cov = jax.vmap(one_line)(estimate.G, U.mT, Z.mT, noise)
    return dataclasses.replace(estimate, cov_noise=cov)


def _at_line(X, lines):
    """(exp, freq, ...) to (freq, exp, ...), at some lines."""
    X = jnp.moveaxis(jnp.asarray(X), 1, 0)
    return X if lines is None else X[lines]


def _residual_estimate(signals: Signals, response, lines) -> Estimate:
    """G by `response(U, Y)` of one line, (channel, exp); its covariance from the residuals, as for H1."""
    dof = signals.n_exp - signals.n_in

    def one_line(U, Y):
        G = response(U, Y)
        residual = Y - G @ U
        C = residual @ adjoint(residual) / (dof if dof > 0 else jnp.nan)
        return G, KroneckerSum(inverse(_where_finite(G, U @ adjoint(U))).T[None], C[None])

    G, cov = jax.vmap(one_line)(_at_line(signals.U, lines).mT, _at_line(signals.Y, lines).mT)
    every = jnp.zeros(G.shape[0])
    estimate = Estimate(
        G=G,
        cov=cov,
        dof=every + dof,
        status=flags(NO_COVARIANCE=every + dof <= 0),
        window=every + 1,
        doubtful=every > 0,
    )
    return _with_noise(estimate, signals, signals.U, lines)


def _where_finite(G, X):
    """X, or NaN where there is no G: what needs an inverse of X then waits for G. Batched LAPACK calls that run at the
    same time can wait for each other for ever."""
    return jnp.where(jnp.isfinite(G).all(), X, jnp.nan)


def _total_least_squares(U, y):
    """One row of G from the inputs (in, exp) and an output (exp,)."""
    scale_u, scale_y = (jnp.sqrt(jnp.mean(jnp.abs(x) ** 2, axis=-1, keepdims=True)) for x in (U, y))
    both = jnp.concatenate([U / scale_u, (y / scale_y)[None]])
    _, vectors = jnp.linalg.eigh(both @ adjoint(both))
    v = vectors[:, 0].conj()
    return -v[:-1] / v[-1] * scale_y / scale_u[:, 0]
