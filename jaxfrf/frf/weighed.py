"""Experiments of unequal noise, each divided by its own.

Methods that put experiments side by side take the noise of all for of one size. That of quantisation by the range, of a
gain, of friction that turns grows with the amplitude: the loudest experiment then decides on G, and the others' small
residuals on how well it is known.
"""

import dataclasses

import numpy as np
from jaxtyping import Complex, Float

from .._text import number
from ..spectra import Spectra
from .aperiodic import uses_reference
from .average import AbstractAverage
from .causes import running_mean
from .method import AbstractMethod
from .select import Auto

_LINES = 256  # of an operating point, spread over the band, that residuals are taken at
_FEW_LINES, _TOLD_BY = 48, 288  # the same, of a first look, which costs little beside any estimate; lines times outputs
# that are enough for it
_ALIKE = 1.5  # ratio of two experiments' noise power in that look, up to which they are taken for alike
_SHOWN = 0.1  # of an experiment's noise, that its residuals must show for that
_NEAR = 4  # lines on either side, over which the noise of a line is averaged
_ROUNDS, _SETTLED = 60, 0.25  # at most; relative change of the variances in the last: as much is chance
_FAR = 100.0  # times a variance, that it moves in a round
_LEAST = 1e-9  # of all degrees of freedom: as few are none
_UNEQUAL = 1.5  # ratio of two experiments' noise, from which on they are weighed
_SURE = 5.0  # standard deviations of its logarithm, that this ratio is from 1
_LOUDER = 2.0  # ratio of two experiments' amplitudes, from which on it is said that nothing tells their noise
_TOLD = 1.0  # standard deviation of a logarithm of two variances' ratio, up to which residuals tell it
_ROUNDING = 1e-10  # of the output: residuals as small say nothing of noise


def weighed(spectra: Spectra, method: AbstractMethod) -> tuple[Spectra, tuple[str, ...]]:
    """The spectra whose experiments are of one noise, and what to say of it.

    Every experiment's U, Y and R are divided by one number, which changes no ratio of theirs: G of a single experiment,
    and of a block of as many as inputs, stays. The numbers come from what experiments leave of a common G at every
    line (of the responses of y and u to r, where the method goes through these); where that cannot tell (experiments
    not more than inputs, or one so loud that G follows it) from the scatter between periods. As they are where
    experiments are averaged, have transients, or do not differ for sure by a half, and where nothing tells.
    """
    averages = isinstance(method, AbstractAverage) or spectra.n_exp <= method.block_size(spectra)
    if averages or spectra.leaks or spectra.segments:
        return spectra, ()
    through = uses_reference(method) or (isinstance(method, Auto) and method.through_reference(spectra))
    told = [_level(spectra, pos, through) for pos in range(spectra.n_pos)]
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
        few = min(_FEW_LINES, max(_TOLD_BY // pair[1].shape[-1], 1))
        if _look_alike(*(_spread(X, few) for X in pair)):
            return np.ones(spectra.n_exp)
        told = _by_residuals(*map(_spread, pair))
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
        power = _power(Q, left)
        power = np.clip(power / np.median(power), 1 / _FAR, _FAR)
        level = level * np.sqrt(power)
        if np.abs(np.log(power)).max() < _SETTLED:
            break
    n = len(level)
    curvature = np.sum(np.abs(np.eye(n) - Q @ Q.conj().swapaxes(1, 2)) ** 2, axis=0)  # of the likelihood
    cov = np.linalg.inv(curvature + _LEAST * np.trace(curvature) * np.eye(n))  # what is not told varies without end
    spread = np.sqrt(np.maximum(np.add.outer(np.diag(cov), np.diag(cov)) - 2 * cov, 0.0))
    return (level, spread) if spread.max() < _TOLD else None


def _look_alike(U, Y) -> bool:
    """Whether experiments do, none being so loud that G follows it and hides its noise."""
    Q, left = _left(U, Y)
    shown = 1 - np.mean(np.sum(np.abs(Q) ** 2, axis=2), axis=0)
    power = _power(Q, left)
    return bool(shown.min() > _SHOWN and 0.0 < power.max() < _ALIKE * power.min())


def _power(Q, left) -> Float[np.ndarray, "exp"]:
    """Power that experiments leave over their share of the degrees of freedom, in units of what lines around leave."""
    usual = running_mean(left.mean(axis=2)[None], _NEAR)[0]
    power = np.sum(np.mean(left / np.where(usual > 0, usual, 1.0)[..., None], axis=1), axis=0)
    return power / np.maximum(np.sum(1 - np.sum(np.abs(Q) ** 2, axis=2), axis=0), _LEAST * len(Q))


def _left(U, Y) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal columns that the experiments' inputs span at every line, and the power that they leave of Y."""
    Q = np.linalg.qr(U.conj().swapaxes(1, 2))[0]
    return Q, np.abs(Y - Y @ Q @ Q.conj().swapaxes(1, 2)) ** 2


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


def _spread(X: Complex[np.ndarray, "exp freq channel"], most: int = _LINES) -> Complex[np.ndarray, "line channel exp"]:
    """Some lines, those that are not finite as 0."""
    lines = np.unique(np.linspace(0, X.shape[1] - 1, most).astype(int))
    X = np.moveaxis(X[:, lines], 0, -1)
    return np.where(np.isfinite(X), X, 0.0)
