"""From a solved window to G and the covariance of vec(G): directly, or as the ratio of two responses.

Of one window; `jax.vmap` takes it over lines.
"""

import jax.numpy as jnp
import numpy as np

from .covariance import KroneckerSum
from .inverse import adjoint, inverse
from .regression import Solution

_FEW = 2  # equations; between more of them the factors take more room than the covariance


def direct(solution: Solution, of_target: np.ndarray, dof) -> tuple:
    """G and Cov(vec G) when the regressors are the inputs themselves; `of_target`: the equation of each target."""
    return solution.G, _covariance(solution.S, None, _noise(solution, dof), of_target)


def through_ratio(solution: Solution, of_target: np.ndarray, dof) -> tuple:
    """G = G_ry G_ru^-1 and Cov(vec G) from targets that are first y, then u (Zimmermann & Moberg, Section II.C.3).

    To first order dG = (dG_ry - G dG_ru) G_ru^-1, so with W = G_ru^-T every pair (t, u) of equations adds
    (W S_tu W^H) (x) (M_t C M_u^H), M_t = [I, -G] in the columns of equation t and zero elsewhere.
    """
    n_in = solution.G.shape[-1]
    W = inverse(solution.G[-n_in:]).T
    G = solution.G[:-n_in] @ W.T
    M = jnp.concatenate([jnp.eye(G.shape[0], dtype=G.dtype), -G], axis=1)
    return G, _covariance(_on_both_sides(W, solution.S), M, _noise(solution, dof), of_target)


def _on_both_sides(W, S):
    """W S_tu W^H of every pair of equations, as one product of the columns (t, a) and (u, b)."""
    count, n_in = S.shape[0], S.shape[-1]
    columns = (W @ jnp.moveaxis(S, 2, 0).reshape(n_in, -1)).reshape(n_in, count, count, n_in)
    rows = (columns.reshape(-1, n_in) @ adjoint(W)).reshape(n_in, count, count, n_in)
    return jnp.moveaxis(rows, 0, 2)


def _in_parts(M, C):
    """M C M^H, M = [I, -G], as four terms: of the errors of y, of both in either order, of those of u."""
    n_out, minus_G = len(M), M[:, len(M) :]
    turned = C[:, n_out:] @ adjoint(minus_G)
    return jnp.stack([C[:n_out, :n_out], turned[:n_out], adjoint(turned[:n_out]), minus_G @ turned[n_out:]])


def _noise(solution: Solution, dof):
    """C; NaN without degrees of freedom."""
    return solution.E / jnp.where(dof > 0, dof, jnp.nan)


def _covariance(S, M, C, of_target: np.ndarray):
    """sum_tu S_tu (x) (M_t C M_u^H), M the identity where it is not given."""
    count, n_in = S.shape[0], S.shape[-1]
    if count == 1:
        return KroneckerSum(left=S[0], right=C[None] if M is None else _in_parts(M, C).sum(axis=0, keepdims=True))
    if M is not None and count <= _FEW:  # y has the first equation and u the second: M_0 = [I, 0], M_1 = [0, -G]
        return KroneckerSum(left=S.reshape(-1, n_in, n_in), right=_in_parts(M, C))
    each = jnp.moveaxis(
        S[of_target[:, None], of_target] * C[:, :, None, None], (0, 2), (1, 0)
    )  # (in, target, target, in)
    if M is not None:
        each = _turned(M, each)
    n_out = each.shape[1]
    return jnp.moveaxis(each, 3, 2).reshape(n_in * n_out, n_in * n_out)


def _turned(M, each):
    """M (target axes) M^H of (in, target, target, in)."""
    n_in, n_target = each.shape[:2]
    left = (M @ each.reshape(n_in, n_target, -1)).reshape(n_in, -1, n_target, n_in)
    return M.conj() @ left
