"""Experiments of unequal noise, each divided by its own.

Methods that put experiments side by side take the noise of all for of one size. That of quantisation by the range, of a
gain, of friction that turns grows with the amplitude: the loudest experiment then decides on G, and the others' small
residuals on how well it is known.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Complex, Float

from .._text import number
from .._types import Array
from ..spectra import Spectra
from .alike import few_lines, looks_alike, power_left, spread_lines
from .aperiodic import uses_reference
from .average import AbstractAverage
from .method import AbstractMethod
from .select import Auto

_LINES = 256  # of an operating point, spread over the band, that residuals are taken at
_ROUNDS, _SETTLED = 60, 0.25  # at most; relative change of the variances in the last: as much is chance
_FAR = 100.0  # times a variance, that it moves in a round
_LEAST = 1e-9  # of all degrees of freedom: as few are none
_UNEQUAL = 1.5  # ratio of two experiments' noise, from which on they are weighed
_SURE = 5.0  # standard deviations of its logarithm, that this ratio is from 1
_LOUDER = 2.0  # ratio of two experiments' amplitudes, from which on it is said that nothing tells their noise
_TOLD = 1.0  # standard deviation of a logarithm of two variances' ratio, up to which residuals tell it
_ROUNDING = 1e-10  # of the output: residuals as small say nothing of noise


def weighed(
    spectra: Spectra, method: AbstractMethod, alike: Bool[Array, "pos"] | None = None
) -> tuple[Spectra, tuple[str, ...]]:
    """The spectra whose experiments are of one noise, and what to say of it.

    Every experiment's U, Y and R are divided by one number, which changes no ratio of theirs: G of a single experiment,
    and of a block of as many as inputs, stays. The numbers come from what experiments leave of a common G at every
    line (of the responses of y and u to r, where the method goes through these); where that cannot tell (experiments
    not more than inputs, or one so loud that G follows it) from the scatter between periods. As they are where
    experiments are averaged, have transients, or do not differ for sure by a half, and where nothing tells.

    `alike`: where an estimate has found them so (`Estimate.alike`).
    """
    if alike is not None and np.all(alike):
        return spectra, ()
    averages = isinstance(method, AbstractAverage) or spectra.n_exp <= method.block_size(spectra)
    if averages or spectra.leaks or spectra.segments:
        return spectra, ()
    through = uses_reference(method) or (isinstance(method, Auto) and method.through_reference(spectra))
    same = np.zeros(spectra.n_pos, bool) if alike is None else np.asarray(alike)
    told = [np.ones(spectra.n_exp) if same[pos] else _level(spectra, pos, through) for pos in range(spectra.n_pos)]
    level = np.stack([np.ones(spectra.n_exp) if x is None else x for x in told])
    unequal = level.max(axis=1) / level.min(axis=1)
    if (unequal == 1).all():
        return spectra, _not_told(spectra, [x is None for x in told])
    pos, others = int(np.argmax(unequal)), int(np.sum(unequal > 1)) - 1
    least, most = int(np.argmin(level[pos])), int(np.argmax(level[pos]))
    said = (
        f"experiments are of unequal noise: at position {pos}{f' and {others} others' if others else ''} that of "
        f"experiment {most} is {number(unequal[pos], 2)} times that of experiment {least}; each is weighed by it",
    )
    part = level[:, :, None, None]
    divided = {n: getattr(spectra, n) / part for n in ("U", "Y", "R") if getattr(spectra, n) is not None}
    noise = None if spectra.noise is None else np.asarray(spectra.noise) / part[..., None] ** 2
    return dataclasses.replace(spectra, **divided, noise=noise), said


def _not_told(spectra: Spectra, where: list[bool]) -> tuple[str, ...]:
    """What to say where experiments of different amplitude do not tell their noise."""
    if not any(where):
        return ()
    size = np.sqrt(np.nanmean(np.abs(np.asarray(spectra.U)) ** 2, axis=(2, 3)))
    times = np.where(where, size.max(axis=1) / np.maximum(size.min(axis=1), _ROUNDING * size.max(axis=1)), 1.0)
    pos = int(np.argmax(times))
    if not times[pos] > _LOUDER:
        return ()
    return (
        f"experiments at position {pos} differ by a factor of {number(times[pos], 2)} in amplitude, and nothing tells "
        "whether their noise does: it is taken as equal, and intervals are too small if it grows with the amplitude. "
        "Record several periods, or take log",
    )


def _level(spectra: Spectra, pos: int, through: bool) -> Float[np.ndarray, "exp"] | None:
    """Standard deviation of each experiment's noise over their geometric mean; ones where they may be alike, `None`
    where nothing tells."""
    U, Y = (np.asarray(X[pos]) for X in (spectra.U, spectra.Y))
    told = None
    if spectra.n_exp > spectra.n_in:
        pair = (U, Y)
        if through and spectra.R is not None:
            pair = (np.asarray(spectra.R[pos]), np.concatenate([Y, U], axis=-1))
        few = few_lines(len(spectra.lines), pair[1].shape[-1])
        Q, left = _left(*(_at(X, few) for X in pair))
        if looks_alike(left, _free(Q)):
            return np.ones(spectra.n_exp)
        told = _by_residuals(*(_at(X, spread_lines(len(spectra.lines), _LINES)) for X in pair))
    if told is None and spectra.noise is not None:
        told = _by_periods(np.asarray(spectra.noise[pos]), Y, spectra.n_periods)
    if told is None:
        return None
    level, spread = told
    ratio = np.abs(np.subtract.outer(np.log(level), np.log(level)))
    if not ((ratio > np.log(_UNEQUAL)) & (2 * ratio > _SURE * spread)).any():
        return np.ones(spectra.n_exp)
    return level / np.exp(np.mean(np.log(level)))


def _by_residuals(U, Y) -> tuple[np.ndarray, np.ndarray] | None:
    """Levels, and the standard deviation of every difference of the logarithms of their squares.

    Restricted maximum likelihood of one variance for each experiment, G of every line being free: the residuals of
    experiments that are divided by these deviations have the power that their leverage leaves them. `None` where they
    do not tell the variances apart."""
    level = np.ones(U.shape[-1])  # from where it moves as far as the data tell: the loudest may hide its own noise
    noisy = np.sum(_left(U, Y)[1], axis=(0, 2)) > _ROUNDING**2 * np.sum(np.abs(Y) ** 2, axis=(0, 2))
    if not noisy.any():
        return level, np.zeros((len(level),) * 2)
    for _ in range(_ROUNDS):
        Q, left = _left(U / level, Y[:, noisy] / level)
        power = power_left(left, _free(Q))
        power = np.clip(power / np.median(power), 1 / _FAR, _FAR)
        level = level * np.sqrt(power)
        if np.abs(np.log(power)).max() < _SETTLED:
            break
    n = len(level)
    curvature = np.sum(np.abs(np.eye(n) - Q @ Q.conj().swapaxes(1, 2)) ** 2, axis=0)  # of the likelihood
    cov = np.linalg.inv(curvature + _LEAST * np.trace(curvature) * np.eye(n))  # what is not told varies without end
    spread = np.sqrt(np.maximum(np.add.outer(np.diag(cov), np.diag(cov)) - 2 * cov, 0.0))
    return (level, spread) if spread.max() < _TOLD else None


def _left(U, Y) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal columns that the experiments' inputs span at every line, and the power that they leave of Y."""
    Q = np.linalg.qr(U.conj().swapaxes(1, 2))[0]
    return Q, np.abs(Y - Y @ Q @ Q.conj().swapaxes(1, 2)) ** 2


def _free(Q) -> Float[np.ndarray, "freq exp"]:
    """Share of every experiment's noise that it leaves."""
    return 1 - np.sum(np.abs(Q) ** 2, axis=2)


def _by_periods(noise, Y, n_periods: int) -> tuple[np.ndarray, np.ndarray] | None:
    """As `_by_residuals`, from the covariance between periods."""
    variance = np.einsum("efoo->feo", noise[..., : Y.shape[-1], : Y.shape[-1]]).real
    if not variance.sum() > _ROUNDING**2 * np.sum(np.abs(Y) ** 2):
        return None
    usual = variance.mean(axis=1, keepdims=True)
    level = np.sqrt(np.mean(variance / np.where(usual > 0, usual, 1.0), axis=(0, 2)))
    if not (level > 0).all():
        return None
    return level, np.full((len(level),) * 2, np.sqrt(2 / (len(variance) * (n_periods - 1))))


def _at(X: Complex[np.ndarray, "exp freq channel"], lines) -> Complex[np.ndarray, "line channel exp"]:
    """At some lines, those that are not finite as 0."""
    X = np.moveaxis(X[:, lines], 0, -1)
    return np.where(np.isfinite(X), X, 0.0)
