"""What a diagnosis would write, simulated as it would be written, and whether the sealed positions agree."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Bool, Complex, Float

from .._errors import InputError
from ..effects import AbstractEffect
from ..robot import Robot
from ..trajectory.evidence import Evidence
from ..trajectory.ripple import ripple_effects
from .knobs import turned
from .score import deviations
from .search import Search, Step
from .stage import Stage, mean_square
from .trial import Setting, together

_CHANCE = 1e-3  # of an order of ripple that is written without being there
_SAME = 1e-3  # relative: numbers that move less are as they were simulated
_GAIN = 0.98  # of what was there: more left is no gain
_PRICE = 0.1  # of the squares that some axes gain, which others may lose beyond their floor
_RISE = 1.1  # of the torque that the effect's own joint is missed by


class Written(eqx.Module):
    """A robot with all its numbers as they would be written, simulated through the experiment: `residual` is what it
    leaves of the record, which nothing has corrected."""

    robot: Robot
    evidence: Evidence = eqx.field(static=True)

    @property
    def residual(self) -> Complex[np.ndarray, "pos exp line axis"]:
        """N m, referred to the motors' commands."""
        return self.evidence.residual


def written(setting: Setting, stage: Stage, effects: Sequence[AbstractEffect]) -> Written:
    """The robot of a stage with these effects, what its fit still changes and the ripple that its motors have; or
    without the last two, where the fitted positions are met better so."""
    as_it_is = Written(stage.robot, stage.evidence)
    change, waves = stage.fit.x[: len(stage.knobs)], motors_ripple(stage)
    if np.max(np.abs(change), initial=0.0) < _SAME and not waves:
        return as_it_is
    turns = together(stage.turns, change)
    try:
        robot = turned(setting.given, stage.knobs, turns).with_effects(*effects, *waves)
        found = Written(robot, Evidence(robot, setting.record))
    except InputError:  # beyond a robot that stands, or that its controller holds
        return as_it_is
    floor, opened = stage.evidence.plain, setting.opened
    better = mean_square(found.residual[opened] / floor) < mean_square(as_it_is.residual[opened] / floor)
    return found if better else as_it_is


def motors_ripple(stage: Stage) -> list[AbstractEffect]:
    """Ripple of every motor that the fit of a stage is sure of, one effect for each motor and kind."""
    fit, first = stage.fit, len(stage.knobs)
    std = np.full(first + 2 * len(stage.orders), np.inf)
    value = np.zeros_like(std)
    std[fit.columns], value[fit.columns] = deviations(stage.weighed.gram, fit), fit.x
    c, sure = value[first:].reshape(-1, 2), (value / std)[first:].reshape(-1, 2)
    sure = np.sum(sure**2, axis=1) > scipy.stats.chi2.isf(_CHANCE, 2)
    kept = [order for order, is_sure in zip(stage.orders, sure, strict=True) if is_sure]
    return ripple_effects(stage.robot.axis_names, kept, c[sure])


class Verified(eqx.Module):
    """What stands of a search.

    **Fields:** `base`: the robot without effects. `steps`: the effects that the sealed positions agree with, and
    `extended` the robot that has them, the base where there are none. `refused`: why others were taken back.
    """

    base: Written
    steps: tuple[Step, ...]
    extended: Written
    refused: tuple[str, ...]


def verified(search: Search) -> Verified:
    """The effects that were found, one after the other, as far as the written robot of each makes the gap on the sealed
    positions smaller than that of the one before: in all, on its own joint, and on no other axis at the price of the
    gain; on the fitted positions, where none are sealed."""
    setting = search.setting
    base = extended = written(setting, search.base, ())
    kept, refused = 0, []
    for count in range(1, len(search.steps) + 1):
        steps = search.steps[:count]
        further = written(setting, steps[-1].stage, [s.effect for s in steps])
        against = _against(search, extended, further, steps[-1].option.key[1])
        if against is None:
            kept, extended = count, further
        else:
            refused.append((count, f"{_name(steps[-1])} was taken back: {against}"))
    # What was refused alone stands with what was found beside it.
    return Verified(base, search.steps[:kept], extended, tuple(text for count, text in refused if count > kept))


def _name(step: Step) -> str:
    name, joint = step.option.key
    return name.replace("_", " ") + (f" of {joint}" if joint else "")


def judged_positions(search: Search) -> Bool[np.ndarray, "pos"]:
    """The sealed ones; those of the fit where none are."""
    return search.opened if search.opened.all() else ~search.opened


def over_floor(left, floor, positions) -> Float[np.ndarray, "axis"]:
    """rms over the floor of every axis."""
    return np.sqrt(0.5 * np.mean(np.abs(left[positions] / floor) ** 2, axis=(0, 1, 2)))


def _against(search: Search, before: Written, after: Written, joint: str) -> str | None:
    """What the sealed positions say against an effect on this joint, "" for all of them, from the robots without and
    with it."""
    where, floor, names = judged_positions(search), search.base.evidence.plain, search.given.axis_names
    old, new = (over_floor(x.residual, floor, where) for x in (before, after))
    if _rms(new) > _GAIN * _rms(old):
        return f"with it the gap is {_rms(new):.3g} times the floor, {_rms(old):.3g} without"
    rise, gain = np.maximum(new**2 - np.maximum(old**2, 1.0), 0.0), np.maximum(old**2 - new**2, 0.0)
    worst = int(np.argmax(rise))
    if np.sum(rise) > _PRICE * np.sum(gain):
        return f"with it the gap of {names[worst]} rises from {old[worst]:.3g} to {new[worst]:.3g} times the floor"
    if joint not in names:
        return None
    own = names.index(joint)
    missed = tuple(relative_torque(search, x.residual, where)[own] for x in (before, after))
    if new[own] > max(old[own], 1.0) or missed[1] > _RISE * missed[0]:
        return f"with it the torque of {joint} itself is missed by {missed[1]:.2%}, by {missed[0]:.2%} without"
    return None


def _rms(x) -> float:
    return float(np.sqrt(np.mean(x**2)))


def relative_torque(search: Search, left, positions) -> Float[np.ndarray, "axis"]:
    """rms residual over rms torque about its mean, per axis."""
    U = search.record.U[positions][:, :, 1:]
    squares = lambda x: np.sum(np.abs(x) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(left[positions]) / squares(U))
