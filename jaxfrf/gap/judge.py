"""Whether one robot is better than another on positions that neither was fitted to."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Complex, Float

from .._errors import InputError
from ..robot import Robot
from ..trajectory.evidence import Evidence, by_band
from ..trajectory.measured import Measured
from .settings import BLOCKS, POSITIONS

_FLIPS = 4095  # of signs; all of them, where there are fewer
_LEVEL = 0.95  # one-sided, of an interval


class Written(eqx.Module):
    """A robot as it would be written, simulated through the experiment: `residual` is what it leaves of a record, which
    nothing has corrected, N m, referred to the motors' commands."""

    robot: Robot
    evidence: Evidence = eqx.field(static=True)

    @property
    def residual(self) -> Complex[np.ndarray, "pos exp line axis"]:
        return self.evidence.residual


def written(robot: Robot, record: Measured) -> Written | None:
    """`None` where the robot cannot be simulated."""
    try:
        return Written(robot, Evidence(jax.tree.map(jnp.asarray, robot), record))
    except InputError:
        return None


class Comparison(eqx.Module):
    """Two robots on the same records.

    **Fields:** `before`, `after`: mean square over the floor. `gain`: part of the first that the second takes away.
    `least`, `most`: of its interval over blocks. `p_value`: of the gain, where the two were equal: signs of the blocks
    flipped; not below what so many blocks can tell.
    """

    before: float = eqx.field(static=True)
    after: float = eqx.field(static=True)
    gain: float = eqx.field(static=True)
    least: float = eqx.field(static=True)
    most: float = eqx.field(static=True)
    p_value: float = eqx.field(static=True)


COMPARED = ("before", "after", "gain", "least", "most", "p_value")


def compared(before, after, floor, frequency) -> Comparison:
    """Of what two robots leave, (pos, exp, line, axis), over the same floor."""
    one, two = (_blocks(x, floor, frequency) for x in (before, after))
    drop = (one - two) / one.sum()
    count = len(drop)
    half = float(scipy.stats.t.ppf(_LEVEL, count - 1) * drop.std(ddof=1) * np.sqrt(count)) if count > 1 else np.inf
    mean = lambda x: 0.5 * float(np.mean(np.abs(x / floor) ** 2))
    gain = float(drop.sum())
    return Comparison(mean(before), mean(after), gain, gain - half, gain + half, _p_value(drop))


def _blocks(left, floor, frequency) -> Float[np.ndarray, "block"]:
    """Squares over the floor by positions; by positions and bands of lines, where there are few."""
    squares = np.sum(np.abs(left / floor) ** 2, axis=(1, 3))
    if len(squares) >= POSITIONS:
        return squares.sum(axis=1)
    return np.concatenate([part.sum(axis=1) for part in np.array_split(squares, BLOCKS, axis=1)])


def _p_value(drop) -> float:
    count = len(drop)
    if 2**count <= _FLIPS:
        signs = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
        return float(np.mean(signs @ drop >= drop.sum() * (1 - 1e-12)))
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (_FLIPS, count))
    return float((1 + np.sum(signs @ drop >= drop.sum())) / (_FLIPS + 1))


def over_floor(left, floor, positions=slice(None)) -> Float[np.ndarray, "axis"]:
    """rms over the floor of every axis."""
    return np.sqrt(0.5 * np.mean(np.abs(left[positions] / floor) ** 2, axis=(0, 1, 2)))


def relative_torque(record: Measured, left, positions=slice(None)) -> Float[np.ndarray, "axis"]:
    """rms residual over rms torque about its mean, per axis."""
    squares = lambda x: np.sum(np.abs(x) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(left[positions]) / squares(record.U[positions][:, :, 1:]))


def rms_by_band(left, floor, frequency) -> Float[np.ndarray, "pos axis band"]:
    return np.sqrt(np.mean(by_band(left, floor, frequency), axis=1))
