"""From solved regressions to G and the covariance of vec(G): directly, or as the ratio of two responses.

Both work on JAX arrays (inside a compiled function) and on NumPy arrays alike.
"""

import numpy as np

from .method import KroneckerSum
from .regression import Solution

_MANY = 8  # terms; above this the factors take more room than the covariance


def direct(solution: Solution, of_target: tuple[int, ...], dof) -> tuple:
    """G and Cov(vec G) when the regressors are the inputs themselves.

    `of_target` says to which equation each target belongs; `dof` has the batch's axes or none.
    """
    effects = _split(np.eye(len(of_target)), of_target, solution)
    return solution.G, _covariance(solution.S, effects, solution.E, dof)


def through_ratio(solution: Solution, of_target: tuple[int, ...], dof) -> tuple:
    """G = G_ry G_ru^-1 and Cov(vec G) from targets that are first y, then u.

    To first order dG = (dG_ry - G dG_ru) G_ru^-1, so with W = G_ru^-T every pair (t, u) of equations adds
    (W S_tu W^H) (x) (M_t C M_u^H), M_t = [I, -G] in the columns of equation t and zero elsewhere.
    """
    xp = _namespace(solution)
    n_in = solution.G.shape[-1]
    W = xp.linalg.inv(solution.G[..., -n_in:, :]).mT
    G = solution.G[..., :-n_in, :] @ W.mT
    eye = xp.broadcast_to(xp.eye(G.shape[-2], dtype=G.dtype), (*G.shape[:-1], G.shape[-2]))
    effects = _split(xp.concat([eye, -G], axis=-1), of_target, solution)
    turned = W[..., None, None, :, :]
    return G, _covariance(turned @ solution.S @ turned.conj().mT, effects, solution.E, dof)


def _split(effect, of_target, solution: Solution):
    """(*batch, eq, out, target): the columns of each equation, zero elsewhere."""
    own = np.arange(solution.S.shape[-3])[:, None, None] == np.asarray(of_target)
    return effect[..., None, :, :] * own


def _covariance(S, effects, E, dof):
    """sum_tu S_tu (x) (M_t E M_u^H) / dof; NaN without degrees of freedom."""
    xp = S.__array_namespace__()
    right = effects[..., :, None, :, :] @ (E[..., None, None, :, :] @ effects.conj().mT[..., None, :, :, :])
    dof = xp.asarray(dof)[..., None, None, None]
    right = right.reshape(*right.shape[:-4], -1, *right.shape[-2:]) / xp.where(dof > 0, dof, xp.nan)
    terms = KroneckerSum(left=S.reshape(*S.shape[:-4], -1, *S.shape[-2:]), right=right)
    return terms if terms.left.shape[-3] <= _MANY else terms.dense()


def _namespace(solution: Solution):
    return solution.G.__array_namespace__()
