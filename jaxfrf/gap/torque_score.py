"""Scores of candidates after projection on the free parameters; their level respects coloured residuals.

    p = (I - Q Q^T) s,  explained = |p p^+ r|^2 / |r|^2,  statistic = (sum_b g_b)^T (sum_b g_b g_b^T)^+ (sum_b g_b)

g_b is p^T r over block b, long against the residual's memory. Where the candidate adds nothing, the g_b are as likely
negative as positive: flipping the sign of whole blocks gives the null of the largest statistic of all candidates.
"""

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Float, Int

_SAME = 1e-6  # of a column's power: less left of it after projection is one of the free parameters
_MEMORY = 0.2  # autocorrelation of the residual below which blocks may be cut


class Score(eqx.Module):
    """**Fields:** `explained`: share of the residual's power. `change`: expected values of the free parameters.
    `blocks`: g_b, (block, parameter). `same`: it cannot be told from the free parameters."""

    explained: float
    change: Float[np.ndarray, "parameter"]
    blocks: Float[np.ndarray, "block parameter"]
    same: bool


def projector(S: Float[np.ndarray, "row free"]):
    """x -> x without what the columns of S explain."""
    if not S.shape[1]:
        return lambda x: x
    size = np.linalg.norm(S, axis=0)
    Q, triangle = np.linalg.qr(S / np.where(size > 0, size, 1.0))
    Q = Q[:, np.abs(np.diag(triangle)) > 1e-10]
    return lambda x: x - Q @ (Q.T @ x)


def score(r: Float[np.ndarray, "row"], P: Float[np.ndarray, "row parameter"], project, block) -> Score:
    """Score of a candidate with columns P; `r` is projected already, `block`: (row,) block numbers from 0."""
    left = project(P)
    power, kept = np.sum(P**2, axis=0), np.sum(left**2, axis=0)
    n = int(block.max()) + 1
    if np.any(kept <= _SAME * np.maximum(power, 1e-300)):
        return Score(0.0, np.zeros(P.shape[1]), np.zeros((n, P.shape[1])), True)
    size = np.sqrt(kept)
    change = np.linalg.lstsq(left / size, r, rcond=1e-8)[0] / size
    g = np.zeros((n, P.shape[1]))
    np.add.at(g, block, left / size * r[:, None])
    return Score(float(np.sum((left @ change) ** 2) / max(np.sum(r**2), 1e-300)), change, g, False)


def family_wise(scores: list[Score], draws: int, seed: int) -> Float[np.ndarray, "candidate"]:
    """p-value of every candidate against the largest of all under the null; no less than 1/(draws + 1)."""
    told = [i for i, x in enumerate(scores) if not x.same]
    p = np.ones(len(scores))
    if not told:
        return p
    n = len(scores[told[0]].blocks)
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (draws, n))
    largest, own = np.full(draws, -np.inf), {}
    for i in told:
        g = scores[i].blocks
        inverse = np.linalg.pinv(g.T @ g, rcond=1e-10)
        evidence = lambda total, inverse=inverse, k=g.shape[1]: (
            -scipy.stats.chi2.logsf(np.einsum("...i,ij,...j->...", total, inverse, total), k)
        )
        own[i] = evidence(g.sum(axis=0))
        largest = np.maximum(largest, evidence(signs @ g))
    for i, value in own.items():
        p[i] = (1 + np.sum(largest >= value)) / (draws + 1)
    return p


def covariance(r: Float[np.ndarray, "row"], S: Float[np.ndarray, "row free"], block) -> Float[np.ndarray, "free free"]:
    """Covariance of least squares with the residual's colour: B (sum_b S_b^T r_b r_b^T S_b) B, B = (S^T S)^-1."""
    size = np.linalg.norm(S, axis=0)
    size = np.where(size > 0, size, 1.0)
    A = S / size
    bread = np.linalg.pinv(A.T @ A, rcond=1e-12)
    g = np.zeros((int(block.max()) + 1, S.shape[1]))
    np.add.at(g, block, A * r[:, None])
    few = len(g) / max(len(g) - S.shape[1], 1)
    return bread @ (few * g.T @ g) @ bread / np.outer(size, size)


def block_length(residuals: list[Float[np.ndarray, "row axis"]]) -> int:
    """Rows in a block: twice the lag where the autocorrelation has died down, for 16 to 60 blocks in all."""
    total = sum(len(x) for x in residuals)
    longest = max(total // 16, 1)
    acf = np.zeros(longest + 1)
    for x in residuals:
        centred = x - x.mean(axis=0)
        for lag in range(min(longest + 1, len(x))):
            acf[lag] += np.sum(centred[lag:] * centred[: len(x) - lag])
    small = np.abs(acf) < _MEMORY * acf[0]
    lag = int(np.argmax(small)) if small.any() else longest
    return int(np.clip(2 * lag, max(total // 60, 1), longest))


def numbered(lengths: list[int], length: int, axes: int) -> Int[np.ndarray, "row"]:
    """Block numbers of all rows of all records, each record in whole blocks, repeated for every axis."""
    number, first = [], 0
    for n in lengths:
        count = max(n // length, 1)
        number.append(first + np.minimum(np.arange(n) // max(length, 1), count - 1))
        first += count
    return np.repeat(np.concatenate(number), axes)
