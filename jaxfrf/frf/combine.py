"""From a solved window to G and the covariance of vec(G): directly, or as the ratio of two responses.

Of one window, or of several side by side: what is returned then has their axis in front.
"""

import jax.numpy as jnp
import numpy as np

from .covariance import KroneckerSum
from .matrices import each_window
from .regression import Solution
from .residuals import AbstractResiduals, in_parts

_FEW = 2  # equations; between more of them the factors take more room than the covariance


def direct(solution: Solution, of_target: np.ndarray, dof) -> tuple:
    """G and Cov(vec G) when the regressors are the inputs themselves; `of_target`: the equation of each target."""
    C = solution.E.whole * _each_dof(dof)
    if solution.S.batch[0] == 1:
        return solution.G.by_window, _product(solution.S, C)
    cov = each_window(lambda S, C: _written_out(_each_pair(S, C, of_target)), solution.S, C)
    return solution.G.by_window, cov


def through_ratio(solution: Solution, of_target: np.ndarray, dof) -> tuple:
    """G = G_ry G_ru^-1 and Cov(vec G) from targets that are first y, then u (Zimmermann & Moberg, Section II.C.3).

    To first order dG = (dG_ry - G dG_ru) G_ru^-1, so with W = G_ru^-T every pair (t, u) of equations adds
    (W S_tu W^H) (x) (M_t C M_u^H), M_t = [I, -G] in the columns of equation t and zero elsewhere.
    """
    n_in = solution.G.shape[1]
    W = solution.G[-n_in:, :].inverse
    G = solution.G[:-n_in, :].times(W)
    W = W.transpose
    S = W.times(solution.S).times_adjoint(W)
    return G.by_window, _of_ratio(S, G, solution.E, _each_dof(dof), of_target)


def _each_dof(dof):
    """By which E is C; NaN without degrees of freedom."""
    return 1.0 / jnp.where(dof > 0, dof, jnp.nan)


def _of_ratio(S, G, E: AbstractResiduals, factor, of_target: np.ndarray):
    """sum_tu S_tu (x) (M_t C M_u^H)."""
    count = S.batch[0]
    if count == 1:
        return _product(S, E.of_ratio(G) * factor)
    C = E.whole * factor
    if count <= _FEW:  # y has the first equation and u the second: M_0 = [I, 0], M_1 = [0, -G]
        return KroneckerSum(S.reshaped(-1, *S.shape).by_window, type(C).stacked(in_parts(G, C)).by_window)
    return each_window(lambda S, C, G: _written_out(_turned(G, _each_pair(S, C, of_target))), S, C, G)


def _product(S, C) -> KroneckerSum:
    """S (x) C of one equation."""
    return KroneckerSum(S.reshaped(1, *S.shape).by_window, C.reshaped(1, *C.shape).by_window)


def _each_pair(S, C, of_target: np.ndarray):
    """S_tu C_ij: (in, target, target, in)."""
    each = S[of_target[:, None], of_target] * C[:, :, None, None]
    return jnp.moveaxis(each, (0, 2), (1, 0))


def _turned(G, each):
    """M (target axes) M^H of (in, target, target, in)."""
    n_in, n_target = each.shape[:2]
    M = jnp.concatenate([jnp.eye(len(G), dtype=G.dtype), -G], axis=1)
    left = (M @ each.reshape(n_in, n_target, -1)).reshape(n_in, -1, n_target, n_in)
    return M.conj() @ left


def _written_out(each):
    """(in, out, out, in) as (vec, vec)."""
    n_in, n_out = each.shape[:2]
    return jnp.moveaxis(each, 3, 2).reshape(n_in * n_out, n_in * n_out)
