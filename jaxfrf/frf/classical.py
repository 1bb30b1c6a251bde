"""Classical estimators: H1, H2 and Hv, one line at a time."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._compile import after
from .._errors import input_error
from .._types import Array
from ..spectra import Spectra
from . import lanes
from .alike import few_lines, looks_alike, spread_lines
from .covariance import KroneckerSum
from .inverse import adjoint, inverse, product, squares
from .least_squares import AbstractLeastSquares, check_steady
from .method import AbstractMethod, Estimate, Signals, flags
from .regression import PIVOT
from .window import Windows, windows

DEPENDENT = 1e-9  # singular values this small, relative to the largest, are rounding
_ELEMENTS = 1728  # of a signal's matrices that go side by side
_AT_ONCE = 16  # lines whose rank is looked at together
_ANY_UNIT = 1e-4  # as large a least singular value needs no common unit of channels
_SCALED_BY = 16  # lines that tell the size of channels


class AbstractLineByLine(AbstractMethod):
    """Estimators that know nothing of a line's neighbours."""

    @property
    def looks(self) -> bool:
        return True

    def block_size(self, spectra: Spectra | Signals) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        check_steady(spectra)
        check_experiments(spectra, spectra.n_in)
        check_independent("u", spectra.U)

    def residual_dof(self, signals: Signals) -> float:
        return float(signals.n_exp - signals.n_in)


class H1(AbstractLineByLine, AbstractLeastSquares):
    """G = Y U^H (U U^H)^-1 over all experiments: least squares with the noise in y.

    Biased low by noise in u; in closed loop biased by the noise that the controller feeds back, however many
    experiments there are. Needs n_exp >= n_in. With n_exp = n_in there is no residual: `cov` is then the
    measurement noise between the periods, and NaN where there is one only (Guillaume 1998; Zimmermann & Moberg,
    Eq. (G_H1)).

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` for fewer experiments than inputs, experiments that depend
    linearly on each other, and records without a period.

    **Source:** Bendat & Piersol, Random Data, 4th ed. 2010; Zimmermann & Moberg, Eq. (G_H1).
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

    def calls_lapack(self, spectra: Spectra, joint: bool = False) -> bool:
        return not lanes.in_registers(spectra.n_in)

    def windows(self, spectra: Spectra | Signals, n_parameters: int) -> Windows:
        check_experiments(spectra, n_parameters)
        return windows(np.arange(len(spectra.frequency)), 1)

    def regressed(self, signals: Signals, joint: bool, lines=None) -> Estimate:
        """Y Z^H (U Z^H)^-1, Z being U or R: for the latter that is the ratio of the two responses from R."""
        instrument = signals.R if joint else None
        if lines is None:
            estimate, condition = _line_by_line(signals, instrument)
            return dataclasses.replace(estimate, doubtful=~(condition * PIVOT < 1))
        return _with_noise(super().regressed(signals, joint, lines), signals, instrument, lines)


class H2(AbstractLineByLine):
    """G = Y Y^H (U Y^H)^-1: least squares with the noise in u. As many outputs as inputs.

    Biased high by noise in y; better than `H1` at resonances, where y is large and u small. The covariance is H1's,
    to first order (Mitchell, J. Mech. Design 104, 1982).

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` unless there are as many outputs as inputs, and for fewer
    experiments than inputs, experiments that depend linearly on each other, and records without a period.

    **Source:** Mitchell, J. Mechanical Design 104 (1982) 277-279.
    """

    def check(self, spectra: Spectra) -> None:
        super().check(spectra)
        if spectra.n_out != spectra.n_in:
            raise input_error(
                "H2",
                f"{spectra.n_out} outputs and {spectra.n_in} inputs",
                "as many outputs as inputs",
                "Use h1 or hv, or choose as many outputs as inputs.",
            )

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        def response(U, Y):
            return Y @ adjoint(Y) @ inverse(U @ adjoint(Y))

        return _line_by_line(signals, None, response, lines)[0]


class Hv(AbstractLineByLine):
    """Total least squares, one output at a time: noise in y and in every u, of equal power in the scaled signals.

    Between `H1` and `H2`: G_i from the eigenvector of the smallest eigenvalue of the cross-spectral matrix of [u; y_i],
    each signal scaled to unit power (Rocklin, Crowley & Vold 1985). Without noise all three agree. The covariance is
    H1's, to first order. Biased where noise is not as strong in u as in y, relative to the signals.

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` for fewer experiments than inputs, experiments that depend
    linearly on each other, and records without a period.

    **Source:** Rocklin, Crowley & Vold, A comparison of H1, H2 and Hv frequency response functions, IMAC 1985.
    """

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        def response(U, Y):
            return jax.vmap(lambda y: _total_least_squares(U, y))(Y)

        return _line_by_line(signals, None, response, lines)[0]


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
    if _begins_independent(X):
        return
    n = X.shape[-1]
    X = X / channel_size(X, (1, 2))  # units do not matter
    worst = np.array([_best_rank(x.transpose(1, 2, 0)) for x in X])
    if worst.min() < n:
        pos = int(np.argmin(worst))
        raise input_error(
            name,
            f"{X.shape[1]} experiments of rank {int(worst[pos])} at every line of position {pos}",
            f"rank {n}: experiments with as many independent excitations as inputs",
            "Use other phase realisations, or orthogonal multisines, in every experiment.",
        )


def _begins_independent(X) -> bool:
    """Whether all positions are of full rank at their first line, which mostly tells: as they are, or with channels
    scaled as below, by some of the lines."""
    first, last = X[:, :, 0], X.shape[-1] - 1
    if not np.isfinite(first).all():
        return False
    if _least_singular(first, last).min(initial=np.inf) > _ANY_UNIT:
        return True
    some = X[:, :, spread_lines(X.shape[2], _SCALED_BY)]
    size = np.sqrt(np.sum(np.abs(some) ** 2, axis=(1, 2)))
    if not (np.isfinite(size).all() and size.all()):
        return False
    return bool(_least_singular(first / size[:, None], last).min(initial=np.inf) > DEPENDENT)


def _least_singular(X, last: int) -> np.ndarray:
    """Over the largest singular value: zero where there are fewer, or none at all."""
    singular = np.linalg.svd(X, compute_uv=False)
    if singular.shape[-1] <= last:
        return np.zeros(len(X))
    return singular[:, last] / np.where(singular[:, 0] > 0, singular[:, 0], 1.0)


def channel_size(X, axes: tuple[int, int]) -> np.ndarray:
    """Norm of what is finite of every channel, over the axes of experiments and lines, which stay; 1 of a dead one."""
    size = np.linalg.norm(np.where(np.isfinite(X), X, 0.0), axis=axes, keepdims=True)
    return np.where(size > 0, size, 1.0)


def _best_rank(X) -> int:
    """The largest rank at any line of (freq, channel, exp): looking at the lines only until one has full rank."""
    n, best, first = X.shape[1], 0, 0
    while best < n and first < len(X):
        last = first + _AT_ONCE
        singular = np.linalg.svd(X[first:last], compute_uv=False)
        best = max(best, int((singular > DEPENDENT * singular[..., :1]).sum(axis=-1).max()))
        first = last
    return best


def by_line(X) -> np.ndarray:
    """Experiments side by side as columns: (pos, exp, freq, channel) -> (pos, freq, channel, exp)."""
    return np.moveaxis(np.asarray(X), 1, -1)


def _line_by_line(signals: Signals, instrument, response=None, lines=None) -> tuple[Estimate, Float[Array, "freq"]]:
    """The estimate by an `instrument`, else U, or by `response(U, Y)` of one line with the covariance of the former;
    and the largest entry of X for signals of unit length, which rounding grows by.

    Of one line, with X = (U Z^H)^-1: G = Y Z^H X, Cov(vec G) = (H^H H)^T (x) C, H = Z^H X being what G makes of an
    experiment, C from the residuals Y - G U, which are orthogonal to Z.
    """
    dof = signals.n_exp - signals.n_in
    looks = lines is None and signals.part is None
    if signals.part is not None and lines is None:
        lines = signals.part.lines(signals.U.shape[1])
    of_U, of_Y, of_Z, noise = _at(lines, signals.U, signals.Y, instrument, signals.noise)
    n_line = of_U.shape[1]
    G = None if response is None else jax.vmap(lambda U, Y: response(U.T, Y.T), in_axes=1)(of_U, of_Y)
    n_lane = lanes.lane_count(n_line, signals.n_exp * signals.n_in, _ELEMENTS)
    U, Y = (lanes.of_signal(x, n_lane) for x in (of_U if G is None else after(of_U, G), of_Y))
    Z = U if of_Z is None else lanes.of_signal(of_Z, n_lane)
    X = lanes.inverse_of_products(U) if Z is U else U.times_adjoint(Z).inverse
    influence = Z.adjoint_times(X)
    in_lanes = Y.times(influence) if G is None else lanes.of_lines(G, n_lane)
    residual = Y - in_lanes.times(U)
    G = lanes.lines(in_lanes, n_line) if G is None else G
    S = lanes.lines(X if Z is U else influence.adjoint_times(influence), n_line)
    C = lanes.lines(residual.times_adjoint(residual), n_line) / (dof if dof > 0 else jnp.nan)
    told = None
    if noise is not None:
        told = jax.vmap(_noise_covariance, in_axes=(0, 0, 1))(G, lanes.lines(influence, n_line), noise)
    every = jnp.zeros(n_line)
    estimate = Estimate(
        G=G,
        cov=KroneckerSum(S.mT[:, None], C[:, None]),
        dof=every + dof,
        status=flags(NO_COVARIANCE=every + dof <= 0),
        window=every + 1,
        doubtful=every > 0,
        cov_noise=told,
        alike=_alike(residual, influence, U, n_line) if looks and dof > 0 else None,
    )
    return estimate, _largest(X, Z, U)[:n_line]


def _largest(X, Z, U) -> Float[Array, "freq"]:
    """The largest entry of X for signals of unit length."""
    size_U = U.power
    size_Z = size_U if Z is U else Z.power
    sizes = squares(X) * size_Z[:, :, None] * size_U[:, None]
    return jnp.sqrt(jnp.max(functools.reduce(jnp.maximum, jnp.moveaxis(sizes, 1, 0)), axis=1).ravel())


def _alike(residual, influence, U, n_line: int):
    """Whether experiments look so, by some of the lines."""
    some = few_lines(n_line, residual.real.shape[1])
    rest, H, U = (lanes.some_lines(A, some) for A in (residual, influence, U))
    free = 1 - jnp.sum(H.mT * U, axis=1).real
    return looks_alike(jnp.real(rest) ** 2 + jnp.imag(rest) ** 2, free)


def _with_noise(estimate: Estimate, signals: Signals, instrument, lines) -> Estimate:
    """Add what the scatter between periods says of the covariance."""
    if signals.noise is None:
        return estimate

    def one_line(U, Z, noise, G):
        U = _where_finite(G, U.T)
        Z = U if Z is None else Z.T
        return _noise_covariance(G, product(adjoint(Z), inverse(product(U, adjoint(Z)))), noise)

    U, Z, noise = _at(lines, signals.U, instrument, signals.noise)
    return dataclasses.replace(estimate, cov_noise=jax.vmap(one_line, in_axes=(1, 1, 1, 0))(U, Z, noise, estimate.G))


def _noise_covariance(G, H, noise) -> KroneckerSum:
    """Cov(vec G) from that of [y; u] in every experiment."""
    effect = jnp.concatenate([jnp.eye(G.shape[0], dtype=G.dtype), -G], axis=1)
    return KroneckerSum(H[:, :, None] * H.conj()[:, None, :], effect @ noise @ adjoint(effect))


def _at(lines, *signals):
    """Signals (exp, freq, ...), as far as there are any, at some lines."""
    return signals if lines is None else jax.tree.map(lambda x: x[:, lines], signals)


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
