"""Significance of a gain and, family-wise, of candidates; held-out error; covariances: in coloured residuals.

The evidence of a candidate is a number (or several) for every block of rows, long against the residual's memory, which
is as likely negative as positive where the candidate adds nothing: g_b = p^T r over block b, p its column beside the
free ones; or, of one that is fitted in full, what it takes off the squared error of held-out rows (more likely negative
then, and no evidence where its sum is: one-sided). Flipping the sign of whole blocks gives the null of the largest
statistic of all candidates,

    statistic = (sum_b g_b)^T (sum_b g_b g_b^T)^+ (sum_b g_b).
"""

from collections.abc import Sequence

import numpy as np
import scipy.special
import scipy.stats
from jaxtyping import Float, Int

from .settings import BLOCKS, CONFIDENCE, DRAWS, MEMORY

Rows = Float[np.ndarray, "row"]


def projector(S: Float[np.ndarray, "row free"]):
    """x -> x without what the columns of S explain."""
    if not S.shape[1]:
        return lambda x: x
    size = np.linalg.norm(S, axis=0)
    Q, triangle = np.linalg.qr(S / np.where(size > 0, size, 1.0))
    Q = Q[:, np.abs(np.diag(triangle)) > 1e-10]
    return lambda x: x - Q @ (Q.T @ x)


def held_out(X: Float[np.ndarray, "row free"], r: Rows, fold: Int[np.ndarray, "row"]) -> Rows:
    """What is left of r on every fold by least squares on the others."""
    left = r.copy()
    if not X.shape[1]:
        return left
    size = np.linalg.norm(X, axis=0)
    X = X / np.where(size > 0, size, 1.0)
    parts = [(fold == k, X[fold == k]) for k in np.unique(fold)]
    products = [(x.T @ x, x.T @ r[here]) for here, x in parts]
    G, b = sum(g for g, _ in products), sum(c for _, c in products)
    for (here, x), (g, c) in zip(parts, products, strict=True):
        left[here] -= x @ np.linalg.lstsq(G - g, b - c, rcond=1e-12)[0]
    return left


def mean_squares(rows: Rows, block: Int[np.ndarray, "row"]) -> Float[np.ndarray, "block"]:
    return np.bincount(block, weights=rows**2) / np.bincount(block)


def summed(rows: Float[np.ndarray, "row free"], block: Int[np.ndarray, "row"]) -> Float[np.ndarray, "block free"]:
    total = np.zeros((int(block.max()) + 1, rows.shape[1]))
    np.add.at(total, block, rows)
    return total


def surely_positive(drop: Float[np.ndarray, "block"], level: float = CONFIDENCE) -> bool:
    """Whether the mean of paired drops is above zero, by a one-sided t-test."""
    n = len(drop)
    return bool(np.mean(drop) > scipy.stats.t.ppf(level, n - 1) * np.std(drop, ddof=1) / np.sqrt(n))


def family_wise(
    evidence: Sequence[Float[np.ndarray, "block free"]], draws: int, seed: int, one_sided: bool = False
) -> Float[np.ndarray, "candidate"]:
    """p-value of every candidate against the largest of all under the null; no less than 1/(draws + 1).

    **Arguments:** `one_sided`: a sum below zero is none, of evidence with one number.
    """
    if not evidence:
        return np.ones(0)
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (draws, len(evidence[0])))
    largest, own = np.full(draws, -np.inf), []
    for g in evidence:
        own.append(_strength(g.sum(axis=0), g, one_sided))
        largest = np.maximum(largest, _strength(signs @ g, g, one_sided))
    return (1 + np.sum(largest[:, None] >= np.array(own), axis=0)) / (draws + 1)


def flipped(drop: Float[np.ndarray, "block"]) -> float:
    """p-value of a sum of paired drops, where each were as likely negative: of all sign patterns, or of as many as
    `DRAWS` where there are more."""
    count = len(drop)
    if 2**count <= DRAWS:
        signs = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
        return float(np.mean(signs @ drop >= drop.sum() - 1e-12 * np.abs(drop).sum()))
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (DRAWS, count))
    return float((1 + np.sum(signs @ drop >= drop.sum())) / (DRAWS + 1))


def _strength(total: Float[np.ndarray, "*draw free"], g: Float[np.ndarray, "block free"], one_sided: bool):
    """-log of the chance of a sum of evidence this large, were its blocks normal."""
    inverse = np.linalg.pinv(g.T @ g, rcond=1e-10, hermitian=True)
    size = np.sum((total @ inverse) * total, axis=-1)
    if one_sided:
        size = np.where(total[..., 0] > 0.0, size, 0.0)
    return -np.log(scipy.special.chdtrc(g.shape[1], size))  # a sum of n blocks is n at most: no underflow


def covariance(r: Rows, S: Float[np.ndarray, "row free"], block) -> Float[np.ndarray, "free free"]:
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
    """Rows in a block: twice the lag where the autocorrelation has died down, for as many blocks as `BLOCKS` says."""
    total, (fewest, most) = sum(len(x) for x in residuals), BLOCKS
    longest = max(total // fewest, 1)
    acf = np.zeros(longest + 1)
    for x in residuals:
        centred = x - x.mean(axis=0)
        for lag in range(min(longest + 1, len(x))):
            acf[lag] += np.sum(centred[lag:] * centred[: len(x) - lag])
    small = np.abs(acf) < MEMORY * acf[0]
    lag = int(np.argmax(small)) if small.any() else longest
    return int(np.clip(2 * lag, max(total // most, 1), longest))


def numbered(lengths: list[int], length: int, axes: int) -> Int[np.ndarray, "row"]:
    """Block numbers of all rows of all records, each record in whole blocks, repeated for every axis."""
    number, first = [], 0
    for n in lengths:
        count = max(n // length, 1)
        number.append(first + np.minimum(np.arange(n) // max(length, 1), count - 1))
        first += count
    return np.repeat(np.concatenate(number), axes)
