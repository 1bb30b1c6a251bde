"""Whether one robot is better than another on positions that neither was fitted to."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Complex, Float

from ..._errors import InputError
from ..._threads import lapack_threads, shared
from ...robot import Robot
from ...trajectory.alike import alike_as_written
from ...trajectory.evidence import Evidence, band_edges
from ...trajectory.measured import Measured
from ..settings import COMBED, CONFIDENCE, FEWEST, FLOOR, LEAST_SHARE, LEVEL, NEAR, PRICE, RISES, TOOTH
from ..significance import flipped


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
        return simulated(robot, record)
    except InputError:
        return None


def each_written(robots: Sequence[Robot], record: Measured) -> list[Written | None]:
    """The same of each of them; the cores share them."""
    return shared(lambda robot: written(robot, record), robots, lapack_threads())


def simulated(robot: Robot, record: Measured) -> Written:
    """**Raises:** `jaxfrf.InputError` where it cannot be."""
    return Written(robot, Evidence(alike_as_written(robot), record))


class Comparison(eqx.Module):
    """Two robots on the same records, by what they leave beyond the floor.

    **Fields:** `before`, `after`: mean square over the floor that is beyond it. `gain`: part of the first that the
    second takes away. `least`, `most`: of its interval over blocks. `p_value`: of the gain, where the two were equal:
    signs of the blocks flipped; `finest`: the least that the blocks in which there is anything can tell.
    """

    before: float = eqx.field(static=True)
    after: float = eqx.field(static=True)
    gain: float = eqx.field(static=True)
    least: float = eqx.field(static=True)
    most: float = eqx.field(static=True)
    p_value: float = eqx.field(static=True)
    finest: float = eqx.field(static=True)


COMPARED = ("before", "after", "gain", "least", "most", "p_value", "finest")


def compared(before, after, floor, frequency) -> Comparison:
    """Of what two robots leave, (pos, exp, line, axis), over the same floor."""
    one, two = (beyond(x, floor, frequency) for x in (before, after))
    if not np.any(one):
        return Comparison(0.0, float(two.mean()), 0.0, -np.inf, np.inf, 1.0, 1.0)
    drop, count = one - two, len(one)
    gain = float(drop.sum() / one.sum())
    finest = 2.0 ** -float(np.count_nonzero(drop))
    if count < 2:
        return Comparison(float(one.mean()), float(two.mean()), gain, -np.inf, np.inf, 1.0, finest)
    apart = drop - gain * one  # of a ratio of sums: Cochran, Sampling Techniques, 1977, chapter 6
    std = float(np.sqrt(count / (count - 1) * np.sum(apart**2)) / one.sum())
    half = float(scipy.stats.t.ppf(CONFIDENCE, count - 1)) * std
    return Comparison(float(one.mean()), float(two.mean()), gain, gain - half, gain + half, flipped(drop), finest)


def beyond(left, floor, frequency) -> Float[np.ndarray, "block"]:
    """Mean square over the floor that is beyond it, of every axis and band, in blocks: runs, or combs of their lines
    where there are few, so that each block sees all bands."""
    n_pos, n_exp, n_line, n_axis = left.shape
    squares = 0.5 * np.abs(left / floor).reshape(n_pos * n_exp, n_line, n_axis) ** 2
    combs = min(-(-COMBED // len(squares)), -(-n_line // TOOTH))
    comb = np.arange(n_line) // TOOTH % combs
    band = np.searchsorted(band_edges(frequency)[1:-1], frequency, side="right")
    blocks = []
    for c in range(combs):
        cells = [squares[:, (comb == c) & (band == b)] for b in np.unique(band)]
        more = [np.maximum(x.sum(axis=1) - FLOOR * x.shape[1], 0.0).sum(axis=1) for x in cells]
        blocks.append(np.sum(more, axis=0) / (np.sum(comb == c) * n_axis))
    return np.concatenate(blocks)


def shows_nothing(result: Comparison, least: float = LEAST_SHARE, own: float = 0.0, fewest: int = FEWEST) -> str:
    """Why a comparison does not speak for an effect that must take away so much, of all or of its `own` axis' part, in
    words; empty where it does. `fewest`: blocks that are enough where all of them speak for it."""
    if not result.before:
        return "on the positions that decide the misfit is nowhere beyond its floor without it"
    if (
        result.p_value <= max(LEVEL, min(result.finest, 2.0**-fewest))
        and max(result.gain, own) >= least
        and result.least > 0.0
    ):
        return ""
    return (
        f"on the positions that decide it takes away {result.gain:.0%} of what is beyond the floor, p = "
        f"{result.p_value:.2g}"
    )


def against_it(judged: Measured, before: Written, after: Written, joint: str) -> str:
    """What positions that were opened last say against an effect on this joint, "" for all of them; empty where
    nothing."""
    floor, names = before.evidence.plain, before.robot.axis_names
    result = compared(before.residual, after.residual, floor, judged.frequency)
    nothing = shows_nothing(result, fewest=0)  # it was decided elsewhere, and must not be contradicted
    if nothing:
        return nothing
    old, new = (over_floor(x.residual, floor) for x in (before, after))
    rise, gain = np.maximum(new**2 - np.maximum(old**2, FLOOR), 0.0), np.maximum(old**2 - new**2, 0.0)
    worst = int(np.argmax(rise))
    if np.sum(rise) > PRICE * np.sum(gain):
        return f"with it the gap of {names[worst]} rises from {old[worst]:.3g} to {new[worst]:.3g} times the floor"
    if joint not in names:
        return ""
    own = names.index(joint)
    missed = tuple(relative_torque(judged, x.residual)[own] for x in (before, after))
    if new[own] > max(old[own], FLOOR) or (missed[1] > RISES * missed[0] and new[own] > FLOOR / 2):
        return f"with it the torque of {joint} itself is missed by {missed[1]:.2%}, by {missed[0]:.2%} without"
    return ""


def is_near(result: Comparison, before: float) -> bool:
    """Whether a rival leaves hardly more than the best candidate, where the positions that decide are asked."""
    return result.p_value > LEVEL or result.before - result.after < NEAR * before


def over_floor(left, floor) -> Float[np.ndarray, "axis"]:
    """rms over the floor of every axis."""
    return np.sqrt(0.5 * np.mean(np.abs(left / floor) ** 2, axis=(0, 1, 2)))


def relative_torque(record: Measured, left) -> Float[np.ndarray, "axis"]:
    """rms residual over rms torque about its mean, per axis."""
    squares = lambda x: np.sum(np.abs(x) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(left) / squares(record.U[:, :, 1:]))
