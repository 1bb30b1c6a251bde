"""Least squares from products alone: the base within its tolerances, and what one more effect would explain."""

import dataclasses

import equinox as eqx
import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.stats
from jaxtyping import Bool, Float, Int

from ..trajectory.evidence import Gram

_NULL_MODE, _NULL_SCALE = 0.004, 0.002  # of the largest part where nothing is missing
_HONEST = 400  # independent numbers that a record is worth: what limits an estimate is the model, set on simulated ones
_HELD = 1e-8  # between bounds: such a column is held where it is, whatever a solver says of its bounds
_OWN = 1e-4  # of a column's square must be its own, beside the base
_RIDGE = 1e-7  # of a column's square: products are made in single precision


class Limits(eqx.Module):
    """What is known of coefficients before the experiment.

    **Fields:** `low`, `high`: bounds, (column,). `expected`: (column,). `weight`: cost of a unit's square away from
    what is expected, over the squares of the floor, (column,).
    """

    low: Float[np.ndarray, "column"]
    high: Float[np.ndarray, "column"]
    expected: Float[np.ndarray, "column"]
    weight: Float[np.ndarray, "column"]

    @classmethod
    def between(cls, low, high) -> "Limits":
        """Bounds, and no more."""
        low, high = np.asarray(low, float), np.asarray(high, float)
        return cls(low, high, np.zeros_like(low), np.zeros_like(low))

    def __len__(self):
        return len(self.low)

    def __getitem__(self, columns) -> "Limits":
        return Limits(self.low[columns], self.high[columns], self.expected[columns], self.weight[columns])


class BaseFit(eqx.Module):
    """The base fitted to the residual of some runs.

    **Fields:** `columns`: those of the base, in the products. `limits`: of their coefficients. `x`: (column,).
    `inside`: not at a bound. `misfit`: mean square of what is left, over the floor's; `before`: of the residual itself.
    `squares`: sum of what is left, with what the coefficients cost that are not as expected. `runs`: that were fitted.
    """

    columns: Int[np.ndarray, "column"]
    limits: Limits
    x: Float[np.ndarray, "column"]
    inside: Bool[np.ndarray, "column"]
    misfit: float
    before: float
    squares: float
    runs: Bool[np.ndarray, "run"]


def fit_base(gram: Gram, columns, limits: Limits, runs) -> BaseFit:
    """Least squares of these columns within their limits, on these runs."""
    columns, runs = np.asarray(columns, int), np.asarray(runs)
    A, b, rr = sums(gram, columns, limits, runs)
    S, right = A[np.ix_(columns, columns)], b[columns]
    x, inside = _bounded(S, right, limits.low, limits.high)
    left = float(rr - 2 * right @ x + x @ S @ x)
    n = gram.count * int(np.sum(runs))
    cost = n * float(np.sum(limits.weight * (x - limits.expected) ** 2))
    return BaseFit(columns, limits, x, inside, (left - cost) / n, float(gram.rr[runs].sum()) / n, left, runs)


def fit_beside(gram: Gram, base: BaseFit, row: int) -> BaseFit:
    """The base where the column `row` is there with the coefficient one: what imitated it moves off its bounds."""
    columns = base.columns
    A, b, _ = sums(gram, columns, base.limits, base.runs)
    S, right = A[np.ix_(columns, columns)], b[columns] - A[columns, row]
    x, inside = _bounded(S, right, base.limits.low, base.limits.high)
    return dataclasses.replace(base, x=x, inside=inside)


def sums(gram: Gram, columns, limits: Limits, runs):
    """Products of all columns over these runs, with what is known of some of them as if it had been measured, too."""
    A, b, rr = gram.A[runs].sum(axis=0), gram.b[runs].sum(axis=0), float(gram.rr[runs].sum())
    weight = limits.weight * gram.count * int(np.sum(runs))
    A[columns, columns] += weight
    b[columns] += weight * limits.expected
    return A, b, rr + float(weight @ limits.expected**2)


def _bounded(A, b, low, high):
    scale = np.sqrt(np.maximum(np.diag(A), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    A, b = A / np.outer(scale, scale), b / scale
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, _RIDGE)
    root = np.sqrt(values)[:, None] * vectors.T
    found = scipy.optimize.lsq_linear(
        root, (vectors.T @ b) / np.sqrt(values), (low * scale, high * scale), method="bvls"
    )
    return np.clip(found.x / scale, low, high), (found.active_mask == 0) & (high - low > _HELD)


def variance(gram: Gram, fit: BaseFit) -> float:
    """Of a unit of the products' inverse: with the misfit that is left, which repeats from run to run and from line to
    line, as errors of a model do, so that many more lines do not make an estimate better."""
    return max(fit.misfit, 1.0) * max(gram.count * int(np.sum(fit.runs)) / _HONEST, 1.0)


def deviations(gram: Gram, fit: BaseFit) -> Float[np.ndarray, "column"]:
    """Standard deviations of the coefficients of a fit, with what the others share counted."""
    A = sums(gram, fit.columns, fit.limits, fit.runs)[0][np.ix_(fit.columns, fit.columns)]
    size = np.sqrt(np.maximum(np.diag(A), 0.0))
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(A / np.outer(size, size) + 1e-9 * np.eye(len(A))) / np.outer(size, size)
    return np.sqrt(np.maximum(np.diag(inverse) * variance(gram, fit), 0.0))


class Drop(eqx.Module):
    """What more columns take off the misfit beside a base that gives way within its bounds.

    **Fields:** `x`: coefficients within their bounds. `drop`: decrease of the weighted squares. `t`: of the
    score along them, with the scatter between runs (which are not independent where a model error repeats).
    """

    x: Float[np.ndarray, "row"]
    drop: float
    t: float


def projected(gram: Gram, base: BaseFit, rows):
    """Products of the columns `rows` with themselves and with the residual, beside the base."""
    return _projected(gram, base, np.asarray(rows, int))[:2]


def _projected(gram: Gram, base: BaseFit, rows):
    A, b, _ = sums(gram, base.columns, base.limits, base.runs)
    own, stuck = base.columns[base.inside], base.columns[~base.inside]
    b = b - A[:, stuck] @ base.x[~base.inside]
    S = A[np.ix_(own, own)]
    size = np.diag(S)
    S = S + np.diag(np.where(size > 0, _RIDGE * size, 1.0))
    share = _solved(S, np.column_stack([A[np.ix_(own, rows)], b[own]]))
    a = A[np.ix_(rows, rows)] - A[np.ix_(rows, own)] @ share[:, :-1]
    p = b[rows] - A[np.ix_(rows, own)] @ share[:, -1]
    return a, p, share, np.diag(A)[rows]


def _solved(S, right):
    """S^-1 right of products that should be positive definite, even where single precision made them less than that:
    columns that say the same, as many of the links' of a small robot do."""
    try:
        return scipy.linalg.solve(S, right, assume_a="pos")
    except np.linalg.LinAlgError:
        size = np.sqrt(np.diag(S))
        values, vectors = np.linalg.eigh(S / np.outer(size, size))
        inverse = vectors / np.maximum(values, _RIDGE) @ vectors.T
        return inverse @ (right / size[:, None]) / size[:, None]


def drop(gram: Gram, base: BaseFit, rows, low, high) -> Drop:
    """Score of the columns `rows`."""
    rows = np.asarray(rows, int)
    a, p, share, own = _projected(gram, base, rows)
    if np.any(np.diag(a) < _OWN * own):
        return Drop(np.zeros(len(rows)), 0.0, 0.0)
    x, _ = _bounded(a, p, np.asarray(low), np.asarray(high))
    along = x if np.any(x) else np.eye(len(rows))[0]
    t = _scatter(gram, base, rows, along, share)
    return Drop(x, float(2 * x @ p - x @ a @ x), t)


def _scatter(gram: Gram, base: BaseFit, rows, along, share) -> float:
    """t of the score along a combination of columns, from its mean and its scatter over the runs."""
    own, stuck, runs = base.columns[base.inside], base.columns[~base.inside], base.runs
    A, b = gram.A[runs], gram.b[runs]
    b = b - A[:, :, stuck] @ base.x[~base.inside]
    left = b[:, own] - A[:, own][:, :, own] @ share[:, -1]
    score = (b[:, rows] - A[:, rows][:, :, own] @ share[:, -1] - left @ share[:, :-1]) @ along
    return float(np.mean(score) * np.sqrt(len(score)) / max(np.std(score, ddof=1), 1e-300))


def family_wise(part: float, t: float, runs: int, tests: int) -> float:
    """p-value of a candidate against the largest of all where nothing is missing.

    By the smaller of two: a Gumbel distribution of the largest part of the misfit that any candidate explains, set on
    simulated records in which nothing was hidden (two simulators, parameters within their tolerances, ripple); and the
    t of its scatter over the runs, by Bonferroni.
    """
    by_part = -np.expm1(-np.exp(-(part - _NULL_MODE) / _NULL_SCALE))
    by_scatter = 2 * tests * scipy.stats.t.sf(abs(t), max(runs - 1, 1))
    return float(min(1.0, by_part, by_scatter if part > _NULL_MODE / 2 else 1.0))
