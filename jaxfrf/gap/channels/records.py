"""Channels whose rows are samples of records: of every axis, thinned to the band in which they are compared."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from ...effects import Reach
from ...trajectory.rigid_motion import MeasuredMotion
from ..significance import block_length, numbered
from .channel import AbstractChannel, Rows, makes_sense
from .floor import unpredictable


class AbstractRecords(AbstractChannel):
    """Rows are (sample, axis), one record after the other.

    **Fields:** `lengths`: of the records, samples. `rate`: of the samples, Hz. `feature`: what any function of the
    motion may depend on, (sample, feature). `reach`: how far the records move every axis.
    """

    lengths: eqx.AbstractVar[tuple[int, ...]]
    rate: eqx.AbstractVar[float]
    feature: eqx.AbstractVar[Float[np.ndarray, "sample feature"]]
    reach: eqx.AbstractVar[tuple[Reach, ...]]

    @property
    def n_axes(self) -> int:
        return self.robot.n_axes

    def tried(self, kind, joint):
        return kind.along_motion(self.robot, joint, self.reach[self.robot.axis_names.index(joint)])

    def sensible(self, candidate, values):
        joint = candidate.joint or self.robot.axis_names[-1]
        most = self.reach[self.robot.axis_names.index(joint)].torque
        return makes_sense(self.robot, candidate, values, most)

    def blocks(self, residual):
        parts = np.split(residual.reshape(-1, self.n_axes), np.cumsum(self.lengths)[:-1])
        return numbered(list(self.lengths), block_length(parts), self.n_axes)

    def floor(self, residual):
        shaped = residual.reshape(-1, self.n_axes)
        return unpredictable(shaped, self.feature, self.fold[:: self.n_axes]).ravel()

    def spectra(self, rows):
        found = []
        for x in np.split(rows.reshape(-1, self.n_axes), np.cumsum(self.lengths)[:-1]):
            power = 2.0 * np.abs(np.fft.rfft(x, axis=0) / len(x)) ** 2
            power[0] *= 0.5
            found.append((np.fft.rfftfreq(len(x), 1.0 / self.rate), power))
        return found


def reaches(motions: Sequence[MeasuredMotion]) -> tuple[Reach, ...]:
    """How far the motions go, of every axis."""
    speed = np.max([np.max(np.abs(m.speed), axis=0) for m in motions], axis=0)
    travel = np.max([np.ptp(m.angle, axis=0) for m in motions], axis=0)
    torque = np.max([np.max(np.abs(m.torque), axis=0) for m in motions], axis=0)
    return tuple(Reach(*map(float, x)) for x in zip(speed, travel, torque, strict=True))


def stretches(lengths: Sequence[int], each: int) -> Int[np.ndarray, "sample"]:
    """Every record cut into as many stretches, numbered on."""
    return np.concatenate([i * each + np.arange(n) * each // n for i, n in enumerate(lengths)])


def every_record(data: Sequence[Any]):
    """(record, position, experiment) of all."""
    return [(x, pos, exp) for x in data for pos in range(x.n_pos) for exp in range(x.n_exp)]


def rows_of(parts: Sequence[Float[np.ndarray, "sample axis"]], size: Float[np.ndarray, "axis"]) -> Rows:
    """One vector of all records and axes."""
    return (np.concatenate(parts) / size).ravel()
