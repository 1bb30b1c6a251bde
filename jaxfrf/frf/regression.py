"""Least squares of one window: from its Gram matrix, fast, or from its rows where the fast way is not accurate enough.

A window is described by one or several *equations*. Each regresses some targets z on columns K, among them the *top*
columns x^0 s, whose coefficients are the response at the centre of the window (Zimmermann & Moberg, Eqs. (DFT_1b) to
(cov), and (DFT_3) with a denominator):

    z = K Theta + v,   Theta = (K^H K)^-1 K^H z,   G = Theta_top^T,   Cov(G_ia, G_jb) = S_ab C_ij,
    S = A_t A_u^H  with  A_t = [(K_t^H K_t)^-1 K_t^H]_top,   C_ij = sum_rows v_i conj(v_j) / q,

where i belongs to equation t and j to equation u. A full matrix fraction is one equation, MISO parametrisations have
one for every output, the joint input-output approach one for y and one for u. Equations share the numerator's columns
K_0 and differ in those of their denominators, Q_t: K_t = [K_0, Q_t].

Everything here is of one window, which `jax.vmap` takes over lines, or of some neighbours side by side (`lanes`): the
kind of the matrices decides.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from .._compile import after
from .._types import Array
from .gram import AbstractGram
from .inverse import adjoint
from .matrices import AbstractMatrices, Whole
from .residuals import AbstractResiduals, Residuals, Unexplained

PIVOT = 1e-8
"""Smallest accepted pivot, relative to its column. A Gram matrix squares the condition number: the relative error of
G was found to be at most 1e-16/pivot (6 axes, one and six experiments, signal-to-noise ratios of 20 to 120 dB), and
3e-10 in windows of seven lines with pivots from 1e-8 to 1e-7."""

RESIDUAL = 1e-9
"""Smallest accepted residual power, relative to the target's: C has a relative error of about 1e-16/residual."""


class Equations(eqx.Module):
    """Which columns explain which. Columns stand in this order: `n_common` regressors of all equations, the last
    `n_top` of which are the top; then for each equation `n_own` regressors and its targets, filled up with columns of
    zeros to the same number for all.

    `targets`: for each equation, the numbers of its targets among all targets. `n_own`: for each equation.
    """

    n_common: int = eqx.field(static=True)
    n_top: int = eqx.field(static=True)
    n_own: tuple[int, ...] = eqx.field(static=True)
    targets: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    @property
    def of_target(self) -> np.ndarray:
        """The number of the equation that each target belongs to."""
        found = np.zeros(sum(len(x) for x in self.targets), int)
        for number, own in enumerate(self.targets):
            found[list(own)] = number
        return found

    @property
    def slots(self) -> np.ndarray:
        """The place of each target among all places for targets."""
        most = max(len(x) for x in self.targets)
        found = np.zeros(sum(len(x) for x in self.targets), int)
        for number, own in enumerate(self.targets):
            found[list(own)] = number * most + np.arange(len(own))
        return found

    @property
    def n_regressor(self) -> int:
        """Unknowns of a target, in the equation with most of them."""
        return self.n_common + max(self.n_own)


class Solution(eqx.Module):
    """A solved window, or several side by side, whose axis stands behind all others of numbers that are real.

    - `G`: responses of all targets, (target, top). `S`: of every pair of equations, (eq, eq, top, top). `E`: products
      of residuals of all targets, q times C.
    - `power`: of every target, summed over the rows.
    - `pivot`: smallest relative pivot (0: singular, NaN: not factorised). `residual`: smallest relative residual power.
    - `missing`: rank that the regressors of the worst equation lack.
    """

    G: AbstractMatrices
    S: AbstractMatrices
    E: AbstractResiduals
    power: Float[Array, "target *window"]
    pivot: Float[Array, "*window"]
    residual: Float[Array, "*window"]
    missing: Int[Array, ""]


def solve_gram(A: AbstractGram, equations: Equations) -> Solution:
    """All equations of a window from the Gram matrix of its columns.

    The common columns are eliminated first, W being what they leave of the products of all others; each equation then
    solves for its own columns in W (Frisch & Waugh 1933).
    """
    n, top = equations.n_common, equations.n_top
    power = A.power
    every = np.arange(len(power))
    common = A.block(every, every[:n]).eliminated(unit=top)
    B, end = common.rows, common.end
    T = end.times_adjoint(B[:, n - top :])  # top coefficients of every other column regressed on the common ones
    S = end.times_adjoint(end).hermitian
    pivot = jnp.min(common.pivot / power[:n], axis=0)
    targets = _target_columns(equations)
    if max(equations.n_own) == 0:
        G, S = T.transpose, S.reshaped(1, 1, top, top)
        E: AbstractResiduals = Unexplained(A.block(every[n:], every[n:]), B)
    else:
        each = _each_equation(A, B, T, power[n:], equations)
        pivot = jnp.minimum(pivot, each.pivot)
        join = _two_equations if len(equations.n_own) == 2 else _several_equations
        G, (whole, S), slots = each.G.reshaped(-1, top), join(A, B, S, each, equations), equations.slots
        if not np.array_equal(slots, np.arange(whole.shape[0])):
            G, whole = G[slots, :], whole[slots, slots]
        E = Residuals(whole.hermitian.conjugate)
    power = power[n:][targets]
    return Solution(
        G=G,
        S=S,
        E=E,
        power=power,
        pivot=pivot,
        residual=jnp.min(E.power / power, axis=0),
        missing=jnp.zeros((), int),
    )


class _Each(eqx.Module):
    """Every equation solved for its own columns, along an axis of equations.

    `G`: (eq, target, top). `E`: products of its residuals. `added`: what its own columns add to S. `D`, `F`: its
    residuals are what the common columns leave of its targets less D^T of its own, and F is what its own columns add to
    the influence of the rows on G. `pivot`: the smallest one."""

    G: AbstractMatrices
    E: AbstractMatrices
    added: AbstractMatrices
    D: AbstractMatrices
    F: AbstractMatrices
    pivot: Float[Array, "*window"]


def _each_equation(A: AbstractGram, B, T, power, equations: Equations) -> _Each:
    """From what the common columns leave of the products A of each equation's own columns and targets, where these
    explain B B^H, and from the top coefficients T of all of them."""
    count, own, top = len(equations.n_own), max(equations.n_own), equations.n_top
    each = len(power) // count
    n_target = each - own
    column = equations.n_common + np.arange(len(power)).reshape(count, each)
    B = B.reshaped(count, each, B.shape[1])
    W = A.block(column, column[:, :own]) - B.times_adjoint(B[:own, :])
    of_targets = A.block(column[:, own:], column[:, own:]) - B[own:, :].times_adjoint(B[own:, :])
    spare = np.arange(own) >= np.asarray(equations.n_own)[:, None]
    W = W.plus_diagonal(spare.astype(float)) if spare.any() else W
    T = T.reshaped(top, count, each).moved(-2, -3)
    found = type(W).joined([W, T[:, :own]], -2).eliminated()
    half = found.rows
    left, influence = half[:n_target, :], half[n_target:, :]
    solved = found.back(half.adjoint)
    power = power.reshape(count, each, *power.shape[1:])[:, :own]
    pivots = found.pivot / jnp.where(spare.reshape(*spare.shape, *[1] * (power.ndim - 2)), 1.0, power)
    return _Each(
        G=(T[:, own:] - influence.times_adjoint(left)).transpose,
        E=of_targets - left.times_adjoint(left),
        added=influence.times_adjoint(influence).hermitian,
        D=solved[:, :n_target],
        F=solved[:, n_target:],
        pivot=jnp.min(pivots, axis=(0, 1)),
    )


def _two_equations(A: AbstractGram, B, S, each: _Each, equations: Equations):
    """E and S of both equations."""
    kind, own, count = type(B), each.D.shape[0], B.shape[0] // 2
    column = equations.n_common + np.arange(2 * count)
    between = A.block(column[:count], column[count:]) - B[:count, :].times_adjoint(B[count:, :])
    right = between[:, own:] - between[:, :own].times(each.D.at(1))
    E_01 = right[own:, :] - each.D.at(0).adjoint_times(right[:own, :])
    S_01 = S + each.F.at(0).adjoint_times(between[:own, :own].times(each.F.at(1)))
    E, S = each.E, S + each.added
    E = kind.joined([kind.joined([E.at(0), E_01], -1), kind.joined([E_01.adjoint, E.at(1)], -1)], -2)
    return E, kind.stacked([kind.stacked([S.at(0), S_01]), kind.stacked([S_01.adjoint, S.at(1)])])


def _several_equations(A: AbstractGram, B, S, each: _Each, equations: Equations):
    """The same of any number of equations, small ones: of all pairs at once."""
    count, own = len(equations.n_own), each.D.shape[0]
    column = equations.n_common + np.arange(B.shape[0])
    W = A.block(column, column) - B.times_adjoint(B)
    size = W.shape[0] // count
    W = W.reshaped(count, size, count, size).moved(-2, -3)  # (eq, eq, row, col)
    D, F = ([x.reshaped(*axes, *x.shape) for axes in ((count, 1), (1, count))] for x in (each.D, each.F))
    right = W[:, own:] - W[:, :own].times(D[1])
    E = right[own:, :] - D[0].adjoint_times(right[:own, :])
    added = F[0].adjoint_times(W[:own, :own].times(F[1]))
    n_target = count * (size - own)
    added = (added + added.moved(-3, -4).adjoint) * 0.5  # pairs (t, u) and (u, t) are each other's adjoint
    return E.moved(-2, -3).reshaped(n_target, n_target), S + added


def solve_rows(K: Complex[Array, "row col"], equations: Equations) -> Solution:
    """All equations of a window from its rows, by singular values of the scaled regressors; the minimum-norm solution
    where they lack rank."""
    n, top, own = equations.n_common, equations.n_top, max(equations.n_own)
    count = len(equations.n_own)
    each = jnp.moveaxis(K[:, n:].reshape(K.shape[0], count, -1), 1, 0)

    def one_equation(part):
        influence, rank = _pseudo_inverse(jnp.concatenate([K[:, : n - top], part[:, :own], K[:, n - top : n]], axis=1))
        theta = influence @ part[:, own:]
        fitted = (
            K[:, : n - top] @ theta[: n - top]
            + part[:, :own] @ theta[n - top : -top]
            + K[:, n - top : n] @ theta[-top:]
        )
        return theta[-top:].T, influence[-top:], part[:, own:] - fitted, rank

    G, A, V, rank = jax.vmap(one_equation)(each)
    S = jax.vmap(lambda A_t: jax.vmap(lambda A_u: A_t @ adjoint(A_u))(A))(A)
    S = (S + adjoint(S.swapaxes(0, 1))) / 2  # blocks (t, u) and (u, t) are each other's adjoint
    slots, targets = equations.slots, _target_columns(equations)
    V = jnp.moveaxis(V, 0, 1).reshape(K.shape[0], -1)[:, slots]
    return Solution(
        G=Whole(G.reshape(-1, top)[slots]),
        S=Whole(S),
        E=Residuals(Whole(V.T @ V.conj()).hermitian),
        power=jnp.sum(jnp.abs(K[:, n:][:, targets]) ** 2, axis=0),
        pivot=jnp.ones(()),
        residual=jnp.ones(()),
        missing=jnp.max(n + np.asarray(equations.n_own) - rank),
    )


def _pseudo_inverse(K):
    """K^+ and the rank of K: QR first, so that the singular values are those of a small matrix."""
    scale = jnp.linalg.norm(K, axis=0)
    scale = jnp.where(scale > 0, scale, 1.0)
    Q, R = jnp.linalg.qr(K / scale)
    U, s, Vh = jnp.linalg.svd(after(R, Q), full_matrices=False)
    kept = s > s[0] * np.finfo(float).eps * max(K.shape)
    inverse = jnp.where(kept, 1 / jnp.where(kept, s, 1.0), 0.0)
    return (adjoint(Vh) * inverse) @ adjoint(Q @ U) / scale[:, None], jnp.sum(kept)


def _target_columns(equations: Equations) -> np.ndarray:
    """The column of each target, behind the common ones."""
    most, own = max(len(x) for x in equations.targets), max(equations.n_own)
    number, place = np.divmod(equations.slots, most)
    return number * (own + most) + own + place
