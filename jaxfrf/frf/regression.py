"""Least squares of one window: from its Gram matrix, fast, or from its rows where the fast way is not accurate enough.

A window is described by one or several *equations*. Each regresses some targets z on columns K, among them the *top*
columns x^0 s, whose coefficients are the response at the centre of the window (Zimmermann & Moberg, Eqs. (DFT_1b) to
(cov), and (DFT_3) with a denominator):

    z = K Theta + v,   Theta = (K^H K)^-1 K^H z,   G = Theta_top^T,   Cov(G_ia, G_jb) = S_ab C_ij,
    S = A_t A_u^H  with  A_t = [(K_t^H K_t)^-1 K_t^H]_top,   C_ij = sum_rows v_i conj(v_j) / q,

where i belongs to equation t and j to equation u. A full matrix fraction is one equation, MISO parametrisations have
one for every output, the joint input-output approach one for y and one for u. Equations share the numerator's columns
K_0 and differ in those of their denominators, Q_t: K_t = [K_0, Q_t].

Everything here is of one window; `jax.vmap` takes it over lines.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import linalg
from jaxtyping import Complex, Float, Int

from .._compile import after
from .._types import Array
from .inverse import adjoint
from .window import Gram

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
    """A solved window.

    - `G`: responses of all targets. `S`: of every pair of equations. `E`: q times C, of all targets.
    - `power`: of every target, summed over the rows.
    - `pivot`: smallest relative pivot (0: singular, NaN: not factorised). `residual`: smallest relative residual power.
    - `missing`: rank that the regressors of the worst equation lack.
    """

    G: Complex[Array, "target top"]
    S: Complex[Array, "eq eq top top"]
    E: Complex[Array, "target target"]
    power: Float[Array, "target"]
    pivot: Float[Array, ""]
    residual: Float[Array, ""]
    missing: Int[Array, ""]


def solve_gram(A: Gram, equations: Equations) -> Solution:
    """All equations of a window from the Gram matrix of its columns.

    The common columns are eliminated first, W being what they leave of the products of all others; each equation then
    solves for its own columns in W (Frisch & Waugh 1933).
    """
    n, top = equations.n_common, equations.n_top
    power = A.power
    common, others = np.arange(n), np.arange(n, len(power))
    L = linalg.cholesky(A.block(common), symmetrize_input=False)
    B = _times_inverse_adjoint(A.block(others, common), L)
    end = _times_inverse_adjoint(jnp.eye(top, dtype=L.dtype), L[-top:, -top:])  # what is left of the top columns
    T = end @ adjoint(B[:, -top:])  # top coefficients of every other column regressed on the common ones
    S = end @ adjoint(end)
    pivot = jnp.min(jnp.diagonal(L).real ** 2 / power[:n])
    if max(equations.n_own) == 0:
        G, E, own_pivot = T.T, _hermitian(A.block(others) - B @ adjoint(B)), jnp.inf
        S = _hermitian(S)[None, None]
    else:
        solve = _two_equations if len(equations.n_own) == 2 else _several_equations
        G, S, E, own_pivot = solve(A, B, T, S, power[n:], equations)
    slots, targets = equations.slots, _target_columns(equations)
    if not np.array_equal(slots, np.arange(len(E))):
        G, E = G[slots], E[slots[:, None], slots]
    power = power[n:][targets]
    return Solution(
        G=G,
        S=S,
        E=E.conj(),
        power=power,
        pivot=jnp.minimum(pivot, own_pivot),
        residual=jnp.min(jnp.diagonal(E).real / power),
        missing=jnp.zeros((), int),
    )


def _times_inverse_adjoint(X, L):
    """X L^-H, L lower triangular."""
    return linalg.triangular_solve(L, X, left_side=False, lower=True, transpose_a=True, conjugate_a=True)


def _two_equations(A: Gram, B, T, S, power, equations: Equations):
    """G, S, E and the smallest pivot, where of the products A of all but the common columns these explain B B^H: the
    products of each equation, then those between the two."""
    one, other = equations.n_common + np.arange(len(power)).reshape(2, -1)
    B = B.reshape(2, len(one), -1)
    W = [A.block(one) - B[0] @ adjoint(B[0]), A.block(other) - B[1] @ adjoint(B[1])]
    between = A.block(one, other) - B[0] @ adjoint(B[1])
    G, E, added, (X_0, X_1), pivot = _each_equation(jnp.stack(W), T, power, equations)
    own, n_target = max(equations.n_own), E.shape[-1]
    turned = between[:, :own] @ X_1
    left = between[:, own:] + turned[:, :n_target]
    E_01 = left[own:] + adjoint(X_0[:, :n_target]) @ left[:own]
    S_01 = S + adjoint(X_0[:, n_target:]) @ turned[:own, n_target:]
    E, S = _hermitian(E), _hermitian(S + added)
    E = jnp.block([[E[0], E_01], [adjoint(E_01), E[1]]])
    S = jnp.stack([jnp.stack([S[0], S_01]), jnp.stack([adjoint(S_01), S[1]])])
    return G, S, E, pivot


def _several_equations(A: Gram, B, T, S, power, equations: Equations):
    """The same for any number of equations, small ones: the products of all of them at once."""
    count = len(equations.n_own)
    each, own, top = len(power) // count, max(equations.n_own), equations.n_top
    W = A.block(equations.n_common + np.arange(len(power))) - B @ adjoint(B)
    blocks = W.reshape(count, each, count, each).swapaxes(1, 2)
    on_diagonal = np.arange(count)
    G, _, _, X, pivot = _each_equation(blocks[on_diagonal, on_diagonal], T, power, equations)
    itself = np.broadcast_to(np.eye(each - own), (count, each - own, each - own))
    errors = _block_diagonal(jnp.concatenate([X[..., : each - own], itself], axis=1))
    effects = _block_diagonal(X[..., each - own :])
    inner = blocks[:, :, :own, :own].swapaxes(1, 2).reshape(count * own, count * own)
    E = adjoint(errors) @ (W @ errors)
    added = _hermitian(adjoint(effects) @ (inner @ effects)).reshape(count, top, count, top)
    return G, _hermitian(S) + added.swapaxes(1, 2), _hermitian(E), pivot


def _each_equation(W, T, power, equations: Equations):
    """From what the common columns leave of the products of each equation, (eq, col, col): G (target, top); of each
    equation the products of its residuals, what its own columns add to S, and X = [-D, F]: its residuals are its
    columns times [-D; I], and what its own add to the influence of the rows on G is F; the smallest pivot."""
    count, each = W.shape[:2]
    own, top = max(equations.n_own), equations.n_top
    n_target = each - own
    spare = np.arange(own) >= np.asarray(equations.n_own)[:, None]

    def one_equation(W, T, power, spare):
        L = linalg.cholesky(W[:own, :own] + jnp.diag(jnp.where(spare, 1.0, 0.0)), symmetrize_input=False)
        right = jnp.concatenate([-W[:own, own:], adjoint(T[:, :own])], axis=1)
        half = linalg.triangular_solve(L, right, left_side=True, lower=True)
        found = linalg.triangular_solve(L, half, left_side=True, lower=True, transpose_a=True, conjugate_a=True)
        products = adjoint(half) @ half
        G = (T[:, own:] + products[n_target:, :n_target]).T
        E, added = W[own:, own:] - products[:n_target, :n_target], products[n_target:, n_target:]
        pivots = jnp.diagonal(L).real ** 2 / jnp.where(spare, 1.0, power[:own])
        return G, E, added, found, jnp.min(pivots)

    parts = T.reshape(top, count, each).swapaxes(0, 1)
    G, E, added, X, pivot = jax.vmap(one_equation)(W, parts, power.reshape(count, each), spare)
    return G.reshape(-1, top), E, added, X, jnp.min(pivot)


def _block_diagonal(x):
    """(block, row, col) to (block*row, block*col), zero beside the blocks."""
    count, n_row, n_col = x.shape
    wide = jnp.where(np.eye(count, dtype=bool)[:, None, :, None], x[:, :, None, :], 0)
    return wide.reshape(count * n_row, count * n_col)


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
        G=G.reshape(-1, top)[slots],
        S=S,
        E=_hermitian(V.T @ V.conj()),
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


def _hermitian(x):
    """Without the rounding by which a matrix is not its own adjoint."""
    return (x + adjoint(x)) / 2
