"""A step of all numbers at once, beside ripple, with what is known beforehand; and how sure it is.

Errors of a model repeat from line to line, so that the lines of a record are far fewer independent numbers than there
are lines. How many is seen from the scatter of the positions: the score of each should vanish, and what is left of it
says what an estimate may be off by (the cluster-robust covariance of Liang & Zeger, Biometrika 73, 1986, in the
delete-one form of Bell & McCaffrey, Survey Methodology 28, 2002).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from .._threads import shared
from ..trajectory.evidence import Gram, Weighed
from .numbers import Number

_RIDGE = 1e-9  # of a column's square: products are made in single precision
_OWN = 1e-6  # of the largest eigenvalue of scaled products: less is no direction that the data know
_FAINT = 1e-4  # what x^2 costs where nothing is known at all: a hundred tolerances, or logarithms
_ROUNDS = 5  # of the design effect, which depends on the step and the step on it


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Where the numbers are after one linear step.

    **Fields:** `change`: of every column's coefficient, numbers first. `effect`: the design effect: so many lines count
    as one. `normal`: the normal matrix A/effect + P. `by_cluster`: estimates of the change without each cluster,
    (cluster, column). `prior`: P's diagonal. `left`: squares that are left behind the step, over the effect. `scores`:
    of every position and band of lines, (pos, band, column), where they are known: an error of the model that is the
    same at all positions shows between bands only. `blind`: covariance of combinations that neither the data know nor
    anybody before: the step leaves them where they are. `beyond`: covariance beside all this, `with_column_errors`.
    """

    change: Float[np.ndarray, "column"]
    effect: float
    normal: Float[np.ndarray, "column column"]
    by_cluster: Float[np.ndarray, "cluster column"]
    prior: Float[np.ndarray, "column"]
    left: float = np.inf
    scores: Float[np.ndarray, "pos band column"] | None = None
    blind: Float[np.ndarray, "column column"] | float = 0.0
    beyond: Float[np.ndarray, "column column"] | float = 0.0

    @property
    def covariance(self) -> Float[np.ndarray, "column column"]:
        """Of the estimates: of what the data say, from the scatter of the clusters, and of what was known before, so
        far as the estimates lean on it."""
        return self._from_data + np.diag(self._from_bands) + self._from_prior + self.blind + self.beyond

    @property
    def _from_data(self):
        count = len(self.by_cluster)
        apart = self.by_cluster - self.by_cluster.mean(axis=0)
        return (count - 1) / count * apart.T @ apart

    @property
    def _from_bands(self):
        """Variance that bands show beyond what positions do: clusters of two kinds at once (Cameron, Gelbach & Miller,
        J. Business & Economic Statistics 29, 2011)."""
        if self.scores is None:
            return np.zeros(len(self.prior))
        inverse = np.linalg.inv(self.normal)

        def variance(scores):
            moved = (scores - scores.mean(axis=0)) @ inverse
            return len(scores) / (len(scores) - 1) * np.sum(moved**2, axis=0)

        every = self.scores.reshape(-1, self.scores.shape[-1])
        return np.maximum(variance(self.scores.sum(axis=0)) - variance(every), 0.0)

    @property
    def _from_prior(self):
        inverse = np.linalg.inv(self.normal)
        return inverse @ (self.prior[:, None] * inverse)

    def half_width(self, level: float = 0.95) -> Float[np.ndarray, "column"]:
        """Half of a confidence interval: the scatter of few clusters is known with their degrees of freedom only."""
        t = scipy.stats.t.ppf(0.5 + level / 2, len(self.by_cluster) - 1)
        z = scipy.stats.norm.ppf(0.5 + level / 2)
        bands = 0.0 if self.scores is None else scipy.stats.t.ppf(0.5 + level / 2, self.scores.shape[1] - 1) ** 2
        told = t**2 * np.diag(self._from_data) + bands * self._from_bands
        return np.sqrt(told + z**2 * np.diag(self._from_prior + self.blind + self.beyond))

    @property
    def data_share(self) -> Float[np.ndarray, "column"]:
        """Part of a number that the data determine, the rest being known before: 1 - posterior/prior variance."""
        return 1.0 - self.prior * np.diag(np.linalg.inv(self.normal))


def clusters(gram: Gram) -> Int[np.ndarray, "run"]:
    """The cluster of each run: its position, or itself where there are less than three positions."""
    if len(np.unique(gram.position)) >= 3:
        return gram.position
    return np.arange(len(gram.position))


def solve(gram: Gram, numbers: Sequence[Number], x: Float[np.ndarray, "number"]) -> Posterior:
    """The step of the numbers from x, and the coefficients of all columns behind theirs, which have no prior.

    Minimises |r - J dx|^2/effect + sum prior (x + dx)^2.
    """
    count = gram.b.shape[1]
    prior = np.concatenate([[n.prior for n in numbers], np.zeros(count - len(numbers))])
    at = np.concatenate([np.asarray(x, float), np.zeros(count - len(numbers))])
    which = clusters(gram)
    A = np.stack([gram.A[which == c].sum(axis=0) for c in np.unique(which)])
    b = np.stack([gram.b[which == c].sum(axis=0) for c in np.unique(which)])
    whole, right = _information(A.sum(axis=0)), b.sum(axis=0)

    def change_by(information, score, effect):
        return np.linalg.solve(information / effect + np.diag(prior), score / effect - prior * at)

    effect, known = 1.0, _known_directions(whole)
    for _ in range(_ROUNDS):
        effect = max(_design_effect(A, b, known, change_by(whole, right, effect)), 1.0)
    normal, change = whole / effect + np.diag(prior), change_by(whole, right, effect)
    without = [change]  # of one cluster alone: nothing is left without it
    if len(A) > 1:
        without = [change_by(_information(whole - a), right - c, effect) for a, c in zip(A, b, strict=True)]
    left = float(gram.rr.sum() - 2.0 * right @ change + change @ whole @ change) / effect
    return Posterior(change, effect, normal, np.array(without), prior, left, blind=_blind(A.sum(axis=0), normal, prior))


def with_bands(posterior: Posterior, weighed: Weighed, bands: int) -> Posterior:
    """The same, with the scores of every position in so many bands of lines."""

    def one(X):
        X = X.astype(float)
        left = X[:, -1] - posterior.change @ X[:, :-1]
        halves, rest = X[:, :-1].reshape(*X[:, :-1].shape[:2], 2, -1), left.reshape(len(left), 2, -1)
        cuts = np.array_split(np.arange(rest.shape[-1]), bands)
        return np.stack([np.einsum("ejhn,ehn->j", halves[..., cut], rest[..., cut]) for cut in cuts])

    scores = np.stack(shared(one, weighed.parts)) / posterior.effect
    return dataclasses.replace(posterior, scores=scores)


def with_column_errors(posterior: Posterior, gram: Gram, errors: Float[np.ndarray, "column"]) -> Posterior:
    """The same, where each column has an error of its own, up to this part of its size: a difference of columns that is
    smaller tells nothing (errors in variables: Fuller, Measurement Error Models, 1987, 1.2)."""
    A = gram.A.sum(axis=0)
    deflated = _information(A, errors) / posterior.effect + np.diag(posterior.prior)
    known = np.linalg.inv(posterior.normal)
    beyond = _without_negative(np.linalg.inv(deflated) - known, np.diag(known))
    return dataclasses.replace(posterior, beyond=posterior.beyond + beyond)


def with_another(posterior: Posterior, apart: Float[np.ndarray, "number"], other: Posterior) -> Posterior:
    """The same, where the numbers may as well be so far `apart`, at another minimum of the cost: its intervals are
    reached by those of this one, too."""
    mine, its = (x.half_width()[: len(apart)] for x in (posterior, other))
    further = np.zeros(len(posterior.change))
    reach = np.sqrt(np.maximum((np.abs(apart) + its) ** 2 - mine**2, 0.0))
    further[: len(apart)] = np.where(apart < 0.0, -reach, reach)
    beyond = np.outer(further, further) / scipy.stats.norm.ppf(0.975) ** 2
    return dataclasses.replace(posterior, beyond=posterior.beyond + beyond)


def _without_negative(covariance, like):
    """A difference of covariances that can only be positive, its directions that rounding made negative left out;
    `like`: variances of the same columns, which say what is small."""
    size = np.sqrt(np.maximum(like, 1e-300))
    scaled = covariance / np.outer(size, size)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0)) * size[:, None]
    return root @ root.T


def _information(A, errors: Float[np.ndarray, "column"] | float = 0.0):
    """Products of columns as a matrix that has an inverse beside any prior: those made in single precision may have
    slightly negative eigenvalues, and a column that is nothing has none. `errors`: of `with_column_errors`."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    values, vectors = np.linalg.eigh(A / np.outer(size, size) - np.diag(np.broadcast_to(errors, len(A)) ** 2))
    root = vectors * np.sqrt(np.maximum(values, _RIDGE))
    whole = (root @ root.T) * np.outer(size, size)
    return whole + np.diag(np.where(np.diag(A) > 0, 0.0, 1e-12))


def _known_directions(whole) -> Float[np.ndarray, "column direction"]:
    """Directions that the data know of, as long as one standard deviation of independent lines of the floor's size."""
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    values, vectors = np.linalg.eigh(whole / np.outer(size, size))
    known = values > _OWN * values[-1]
    return vectors[:, known] / size[:, None] / np.sqrt(values[known])


def _blind(A, normal, prior) -> Float[np.ndarray, "column column"]:
    """Covariance of combinations that the data do not know, beyond what the estimates lean on the prior: products that
    rounding made, and those that stand for none (`_information`), are no knowledge."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-12))
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    unknown = np.linalg.qr(vectors[:, values <= _OWN * values[-1]] / size[:, None])[0]
    faint, known = _FAINT * np.eye(unknown.shape[1]), unknown.T @ (prior[:, None] * unknown)
    leaning = np.linalg.inv(unknown.T @ normal @ unknown + faint)
    return unknown @ (np.linalg.inv(known + faint) - leaning @ known @ leaning) @ unknown.T


def _design_effect(A, b, directions, change) -> float:
    """Mean over the directions that the data know of: variance of the score between clusters over what independent
    lines of the floor's size would have."""
    if len(A) < 2:
        return 1.0
    score = b - A @ change
    score = (score - score.mean(axis=0)) @ directions
    return float(np.mean(np.sum(score**2, axis=0)) * len(A) / (len(A) - 1))
