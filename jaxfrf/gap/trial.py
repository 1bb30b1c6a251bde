"""An effect added to a robot, simulated, and corrected together with the robot's own numbers while that helps."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from .._errors import InputError
from ..effects import AbstractEffect
from ..robot import Robot
from ..trajectory.measured import Measured
from .knobs import pinned, turned
from .refine import Refined, beside, refine
from .stage import Stage, look_again, look_closely, mean_square

MOST_CORRECTIONS = 5
CLOSE = 1.2  # misfit beyond which the columns of another robot may mislead
_HELPS = 0.97  # of the misfit: more after a correction, and it was of no use


class Setting(eqx.Module):
    """What stays the same in a search: the robot as it was given, the record, and the positions that are fitted."""

    given: Robot
    record: Measured
    opened: Bool[np.ndarray, "pos"]


class Fitted(eqx.Module):
    """An effect with its parameters, their standard deviations, and the robot that has it."""

    effect: AbstractEffect
    std: tuple[float, ...] = eqx.field(static=True)
    stage: Stage


def corrected(setting: Setting, fitted: Fitted, like: Stage, visible: float, before, most=MOST_CORRECTIONS) -> Fitted:
    """Parameters and the base's numbers after at most so many more simulations, while they help.

    **Arguments:** `like`: a stage without the effect, which weighs the lines. `visible`: as for `refine`. `before`:
    effects that the robot has besides.
    """
    effect, std, after = fitted.effect, fitted.std, fitted.stage
    for _ in range(most):
        far = after.misfit > CLOSE
        if far:
            after = look_closely(after, setting.opened)
        again = refine(after, effect, visible, effect)
        std = again.std or std
        if not far and not _moves(effect, again):
            break
        better = with_effect(setting, after, again.effect, before, effect)
        if better is None or not _helps(better, after, like):
            break
        after, effect = better, again.effect
    return Fitted(effect, std, after)


def _helps(better: Stage, after: Stage, like: Stage) -> bool:
    usual = usual_misfit(better, like) < _HELPS * usual_misfit(after, like)
    return usual or better.misfit < _HELPS * after.misfit


def _moves(effect, again: Refined) -> bool:
    values = ((float(getattr(again.effect, n)), float(getattr(effect, n))) for n in again.names)
    return any(abs(new - old) > 0.02 * abs(old) for new, old in values)


def with_effect(setting: Setting, stage: Stage, effect, before=(), simulated=None) -> Stage | None:
    """The robot with one more effect, its own numbers adjusted beside it, simulated; `None` where it cannot be.

    **Arguments:** `before`: effects that it has besides. `simulated`: the effect as the stage's robot already has it.
    """
    these = pinned(stage.knobs, effect)
    turns = together(stage.turns, _base_beside(stage, effect, simulated))
    turns = np.where([knob.tolerance > 0 for knob in these], turns, 0.0)
    try:
        robot = turned(setting.given, these, turns).with_effects(*before, effect)
        return look_again(stage, robot, setting.record, turns, setting.opened, these)
    except InputError:  # beyond a robot that stands, or that its controller holds
        return None


def _base_beside(stage: Stage, effect, simulated) -> Float[np.ndarray, "knob"]:
    """Changes of the knobs where this effect is there, or has this value in the place of the simulated one."""
    return beside(stage, effect, simulated)[: len(stage.knobs)]


def together(turns, more):
    """Relative changes, one after the other."""
    return (1.0 + turns) * (1.0 + more) - 1.0


def usual_misfit(this: Stage, like: Stage) -> float:
    """Mean square of what a stage leaves on the fitted positions, weighed as in another: no few lines rule."""
    left = this.left
    runs = np.reshape(this.fit.runs, left.shape[:2])
    return mean_square(left[runs] / like.evidence.floor)
