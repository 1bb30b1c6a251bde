"""Least squares of a window: from its Gram matrix, fast, or from its rows where the fast way is not accurate enough.

A window is described by one or several *equations*. Each regresses some targets z on columns K, the last of which are
the *top* columns x^0 s, whose coefficients are the response at the centre of the window:

    z = K Theta + e,   G = Theta_top^T,   Cov(G_ia, G_jb) = S_ab C_ij,
    S = A_t A_u^H  with  A_t = [(K_t^H K_t)^-1 K_t^H]_top,   C_ij = sum_rows e_i conj(e_j) / dof,

where i belongs to equation t and j to equation u. A full matrix fraction is one equation, MISO parametrisations have
one for every output, the joint input-output approach has one for y and one for u.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.lax import linalg
from jaxtyping import Complex, Float

from .._types import Array
from .window import Columns, Windows

PIVOT = 1e-7
"""Smallest accepted pivot, relative to its column. A Gram matrix squares the condition number: the relative error of
G was found to be at most 1e-16/pivot (6 axes, one and six experiments, signal-to-noise ratios of 20 to 120 dB)."""

RESIDUAL = 1e-9
"""Smallest accepted residual power, relative to the target's: C has a relative error of about 1e-16/residual."""


class Equation(eqx.Module):
    """Which columns are regressed on which: indices into `Columns`; the last `n_top` regressors are the top."""

    regressors: tuple[int, ...] = eqx.field(static=True)
    targets: tuple[int, ...] = eqx.field(static=True)
    n_top: int = eqx.field(static=True)


class Solution(eqx.Module):
    """Solved windows, leading axes (*batch).

    - `G`: responses of all targets, in the order of the equations. `S`: of every pair of equations.
    - `E`: dof times C, of all targets.
    - `power`: of every target, summed over the rows.
    - `pivot`: smallest relative pivot (0: singular, NaN: not factorised). `residual`: smallest relative residual power.
    """

    G: Complex[Array, "*batch target top"]
    S: Complex[Array, "*batch eq eq top top"]
    E: Complex[Array, "*batch target target"]
    power: Float[Array, "*batch target"]
    pivot: Float[Array, "*batch"]
    residual: Float[Array, "*batch"]


def solve_gram(A: Complex[Array, "*batch col col"], equations: tuple[Equation, ...]) -> Solution:
    """All equations of a window from the Gram matrix of its columns."""
    return _solve_one(A, equations[0]) if len(equations) == 1 else _solve_several(A, equations)


def equation_of_target(equations) -> np.ndarray:
    """The number of the equation that each target belongs to."""
    return np.repeat(np.arange(len(equations)), [len(eq.targets) for eq in equations])


def _solve_one(A, equation: Equation) -> Solution:
    """One equation: with the top next to last and the targets last, the last block of one Cholesky factor holds G,
    S and the residual covariance; the nuisance coefficients are never computed.

    The targets' block is singular when there are fewer degrees of freedom than targets; doubling its diagonal for the
    factorisation mends that and is subtracted afterwards.
    """
    top, target = equation.n_top, len(equation.targets)
    A = _part(A, equation.regressors + equation.targets, equation.regressors + equation.targets)
    power = jnp.diagonal(A, axis1=-2, axis2=-1).real
    is_target = np.arange(A.shape[-1]) >= len(equation.regressors)
    L = linalg.cholesky(A + jnp.where(is_target, power, 0.0)[..., None] * np.eye(A.shape[-1]), symmetrize_input=False)
    pivot = jnp.diagonal(L, axis1=-2, axis2=-1).real ** 2 / power
    block = L[..., -(top + target) :, -(top + target) :]
    V = _inverse_of_lower(block[..., :top, :top])
    rest = block[..., top:, top:]
    E = (rest @ rest.conj().mT).conj() - power[..., -target:, None] * np.eye(target)
    residual = jnp.diagonal(E, axis1=-2, axis2=-1).real / power[..., -target:]
    return Solution(
        G=(block[..., top:, :top] @ V).conj(),
        S=(V.conj().mT @ V)[..., None, None, :, :],
        E=E,
        power=power[..., -target:],
        pivot=jnp.min(pivot[..., : len(equation.regressors)], axis=-1),
        residual=jnp.min(residual, axis=-1),
    )


def _solve_several(A, equations) -> Solution:
    """Several equations as one batch: coefficients of each, then all products between them from the one Gram matrix.

    One batched factorisation, not one per equation: XLA would run those at the same time, and batched LAPACK calls
    that share its thread pool can wait for each other for ever. Equations with fewer regressors are filled up with
    columns that are orthogonal to everything.
    """
    n_column, n_top = A.shape[-1], equations[0].n_top
    regressors, targets, slots = _index_arrays(equations, n_column)
    n_spare = max(regressors.max() + 1 - n_column, 0)
    spare = [(0, 0)] * (A.ndim - 2) + [(0, n_spare)] * 2
    wide = jnp.pad(A, spare) + np.diag(np.arange(n_column + n_spare) >= n_column)
    L = linalg.cholesky(wide[..., regressors[:, :, None], regressors[:, None, :]], symmetrize_input=False)
    pivot = jnp.diagonal(L, axis1=-2, axis2=-1).real ** 2 / jnp.diagonal(wide, axis1=-2, axis2=-1).real[..., regressors]
    units = np.broadcast_to(np.eye(L.shape[-1])[:, -n_top:], (*L.shape[:-1], n_top))
    right = jnp.concatenate([-wide[..., regressors[:, :, None], targets[:, None, :]], units.astype(L.dtype)], axis=-1)
    half = linalg.triangular_solve(L, right, left_side=True, lower=True)
    found = linalg.triangular_solve(L, half, left_side=True, lower=True, transpose_a=True, conjugate_a=True)
    among_all = _embedded(found, regressors, n_column)
    order = np.concatenate([eq.targets for eq in equations]).astype(int)
    error = jnp.moveaxis(among_all[..., equation_of_target(equations), :, slots], 0, -1) + np.eye(n_column)[:, order]
    top = jnp.moveaxis(among_all[..., targets.shape[1] :], -3, -2).reshape(*A.shape[:-1], -1)
    E = (error.conj().mT @ (A @ error)).conj()
    S = (top.conj().mT @ (A @ top)).reshape(*A.shape[:-2], len(equations), n_top, len(equations), n_top)
    power = jnp.diagonal(A, axis1=-2, axis2=-1).real[..., order]
    return Solution(
        G=-error[..., list(equations[0].regressors[-n_top:]), :].mT,
        S=jnp.swapaxes(S, -3, -2),
        E=E,
        power=power,
        pivot=jnp.min(pivot, axis=(-2, -1)),
        residual=jnp.min(jnp.diagonal(E, axis1=-2, axis2=-1).real / power, axis=-1),
    )


def _index_arrays(equations, n_column: int):
    """Regressors (equation, most) filled up in front with spare columns; targets (equation, most) filled up by repeats;
    and for each target its slot in its equation."""
    n_regressor = max(len(eq.regressors) for eq in equations)
    n_target = max(len(eq.targets) for eq in equations)
    regressors = [[*range(n_column, n_column + n_regressor - len(eq.regressors)), *eq.regressors] for eq in equations]
    targets = [[*eq.targets, *[eq.targets[0]] * (n_target - len(eq.targets))] for eq in equations]
    slots = np.concatenate([np.arange(len(eq.targets)) for eq in equations])
    return np.asarray(regressors), np.asarray(targets), slots


def _embedded(x, regressors, n_column: int):
    """Rows of x (*batch, equation, regressor, ...) put where the regressors stand among all columns, zero elsewhere."""
    n_equation, n_regressor = regressors.shape
    place = np.full((n_equation, n_column), n_regressor)
    for row, columns in zip(place, regressors, strict=True):
        real = columns < n_column
        row[columns[real]] = np.flatnonzero(real)
    filled = jnp.pad(x, [(0, 0)] * (x.ndim - 2) + [(0, 1), (0, 0)])
    return filled[..., np.arange(n_equation)[:, None], place, :]


def _part(A, rows, columns):
    """A[rows, columns] for static index tuples."""
    if rows == columns == tuple(range(A.shape[-1])):
        return A
    return A[..., np.asarray(rows)[:, None], np.asarray(columns)]


def _inverse_of_lower(L):
    eye = jnp.broadcast_to(jnp.eye(L.shape[-1], dtype=L.dtype), L.shape)
    return linalg.triangular_solve(L, eye, left_side=True, lower=True)


def solve_rows(
    signals: Complex[np.ndarray, "exp freq sig"], windows: Windows, columns: Columns, equations, lines
) -> tuple[Solution, np.ndarray]:
    """The equations of the windows around `lines` from their rows, by singular value decomposition of the scaled
    regressor; also how much rank is missing in the worst equation (then the minimum-norm solution is taken)."""
    rows = _rows(signals, windows, columns, lines)
    solved = [_solve_svd(rows[..., eq.regressors], rows[..., eq.targets], eq.n_top) for eq in equations]
    influence = np.stack([a for _, a, _, _ in solved], axis=-3)
    residual = np.concatenate([e for _, _, e, _ in solved], axis=-1)
    solution = Solution(
        G=np.concatenate([G for G, _, _, _ in solved], axis=-2),
        S=influence[..., :, None, :, :] @ _h(influence)[..., None, :, :, :],
        E=residual.swapaxes(-1, -2) @ residual.conj(),
        power=np.sum(np.abs(rows[..., np.concatenate([eq.targets for eq in equations]).astype(int)]) ** 2, axis=-2),
        pivot=np.ones(len(lines)),
        residual=np.ones(len(lines)),
    )
    missing = [len(eq.regressors) - rank for eq, (_, _, _, rank) in zip(equations, solved, strict=True)]
    return solution, np.max(missing, axis=0)


def _rows(signals, windows: Windows, columns: Columns, lines) -> np.ndarray:
    """Columns written out: (window, exp*width, column)."""
    inside = np.asarray(windows.start)[lines][:, None] + np.arange(windows.width)
    x = windows.coordinate[inside] - windows.coordinate[lines][:, None]
    x = x / np.maximum(np.abs(x).max(axis=1, keepdims=True), 1e-300)
    part = np.moveaxis(signals[:, inside], 0, 1)[..., np.asarray(columns.signal)]
    rows = x[:, None, :, None] ** np.asarray(columns.power) * part
    return rows.reshape(len(lines), -1, len(columns.power))


def _solve_svd(K, Z, n_top: int):
    """G (window, target, top), A_top (window, top, row), residuals (window, row, target), rank of K (window,)."""
    scale = np.linalg.norm(K, axis=-2, keepdims=True)
    scale = np.where(scale > 0, scale, 1.0)
    q, r = np.linalg.qr(K / scale)
    u, s, vh = np.linalg.svd(r, full_matrices=False)
    kept = s > s[:, :1] * np.finfo(float).eps * max(K.shape[-2:])
    inverse = np.where(kept, 1 / np.where(kept, s, 1.0), 0.0)
    pseudo_inverse = (_h(vh) * inverse[:, None]) @ _h(q @ u) / scale.swapaxes(-1, -2)
    theta = pseudo_inverse @ Z
    return theta[:, -n_top:].swapaxes(-1, -2), pseudo_inverse[:, -n_top:], Z - K @ theta, kept.sum(axis=-1)


def _h(x):
    return x.conj().swapaxes(-1, -2)
