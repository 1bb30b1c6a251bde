"""From solved regressions to G and the covariance of vec(G): directly, or as the ratio of two responses.

On the host, in NumPy: what is left to do is small, and the inverses of a compiled function would be batched LAPACK
calls, which can wait for each other for ever when XLA runs two of them at the same time.
"""

import numpy as np

from .inverse import inverse
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
    n_in = solution.G.shape[-1]
    W = inverse(solution.G[..., -n_in:, :]).mT
    G = solution.G[..., :-n_in, :] @ W.mT
    eye = np.broadcast_to(np.eye(G.shape[-2], dtype=G.dtype), (*G.shape[:-1], G.shape[-2]))
    effects = _split(np.concat([eye, -G], axis=-1), of_target, solution)
    turned = W[..., None, None, :, :]
    return G, _covariance(turned @ solution.S @ turned.conj().mT, effects, solution.E, dof)


def _split(effect, of_target, solution: Solution):
    """(*batch, eq, out, target): the columns of each equation, zero elsewhere."""
    own = np.arange(solution.S.shape[-3])[:, None, None] == np.asarray(of_target)
    return effect[..., None, :, :] * own


def _covariance(S, effects, E, dof):
    """sum_tu S_tu (x) (M_t E M_u^H) / dof; NaN without degrees of freedom."""
    right = effects[..., :, None, :, :] @ (E[..., None, None, :, :] @ effects.conj().mT[..., None, :, :, :])
    dof = np.asarray(dof)[..., None, None, None, None]
    with np.errstate(invalid="ignore"):
        right = right / np.where(dof > 0, dof, np.nan)
    terms = KroneckerSum(*(x.reshape(*x.shape[:-4], -1, *x.shape[-2:]) for x in (_hermitian(S), _hermitian(right))))
    return terms if terms.left.shape[-3] <= _MANY else terms.dense()


def _hermitian(x):
    """Without the rounding by which blocks (t, u) and (u, t) are not each other's adjoint: (*batch, t, u, i, j)."""
    return (x + x.conj().swapaxes(-4, -3).mT) / 2
