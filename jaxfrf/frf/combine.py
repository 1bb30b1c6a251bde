"""From a solved window to G and the covariance of vec(G): directly, or as the ratio of two responses.

Of one window, or of several side by side: what is returned then has their axis in front.
"""

import jax.numpy as jnp
import numpy as np

from .covariance import KroneckerSum
from .matrices import AbstractMatrices, each_window
from .regression import Solution

_FEW = 2  # equations; between more of them the factors take more room than the covariance


def direct(solution: Solution, of_target: np.ndarray, dof) -> tuple:
    """G and Cov(vec G) when the regressors are the inputs themselves; `of_target`: the equation of each target."""
    return solution.G.by_window, _covariance(solution.S, None, _noise(solution, dof), of_target)


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
    return G.by_window, _covariance(S, G, _noise(solution, dof), of_target)


def _noise(solution: Solution, dof) -> AbstractMatrices:
    """C; NaN without degrees of freedom."""
    return solution.E * (1.0 / jnp.where(dof > 0, dof, jnp.nan))


def _in_parts(G, C) -> list:
    """M C M^H, M = [I, -G], as four terms: of the errors of y, of both in either order, of those of u."""
    n_out = G.shape[0]
    of_u = C[:, n_out:].times_adjoint(G)
    both = of_u[:n_out, :] * -1.0
    return [C[:n_out, :n_out], both, both.adjoint, G.times(of_u[n_out:, :])]


def _covariance(S, G, C, of_target: np.ndarray):
    """sum_tu S_tu (x) (M_t C M_u^H), M = [I, -G], or the identity where no G is given."""
    n_in = S.shape[0]
    count = S.batch[0]
    if count == 1:
        parts = None if G is None else _in_parts(G, C)
        right = C if parts is None else parts[0] + parts[1] + parts[2] + parts[3]
        return KroneckerSum(S.reshaped(1, n_in, n_in).by_window, right.reshaped(1, *right.shape).by_window)
    if G is not None and count <= _FEW:  # y has the first equation and u the second: M_0 = [I, 0], M_1 = [0, -G]
        right = type(C).stacked(_in_parts(G, C))
        return KroneckerSum(S.reshaped(-1, n_in, n_in).by_window, right.by_window)
    if G is None:
        return each_window(lambda S, C: _written_out(_each_pair(S, C, of_target)), S, C)
    return each_window(lambda S, C, G: _written_out(_turned(G, _each_pair(S, C, of_target))), S, C, G)


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
