"""A robot that has one more effect, whose parameters are numbers like its others, of which nothing is known."""

import math
import operator

import equinox as eqx
import numpy as np

from ..._errors import InputError
from ...calibration.numbers import numbers
from ...effects import AbstractEffect, OwnNumber
from ...robot import Robot, Tolerances
from ...robot.tolerances import Tolerance
from ..settings import TIMING
from .fitted import Fitted

_UNKNOWN = Tolerance(math.inf)


class Hypothesis(eqx.Module):
    """An effect that is missing on a joint, where a fit of it begins.

    **Fields:** `robot`: with it. `unknown`: numbers of which nothing is known there. `own`: those of the effect.
    `is_number`: whether it is the error of a number that the robot has.
    """

    effect: AbstractEffect
    joint: str = eqx.field(static=True)
    robot: Robot
    unknown: Tolerances = eqx.field(static=True)
    own: tuple[OwnNumber, ...]
    is_number: bool = eqx.field(static=True)

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.joint

    @property
    def imitated_by(self) -> tuple[str, ...]:
        """Numbers of the robot that imitate the effect."""
        return tuple(f"{self.joint}.{kind}" for kind in self.effect.imitated_by)

    def estimates(self, found: Fitted) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of every parameter of the effect in a robot that was fitted, as it is stated;
        of times, no less than what the sampling leaves open. The first says how much of it there is."""
        own, least = self._fitted_in(found), {"s": TIMING / found.iterate.evidence.scenes[0].fs}
        covariance = found.covariance([o.number for o in own])
        unresolved = [least.get(self.effect.units[o.parameter], 0.0) for o in own]
        moved = self._moved(found)
        return moved.stated_values([o.parameter for o in own], covariance + np.diag(np.square(unresolved)))

    def _fitted_in(self, found: Fitted) -> list[OwnNumber]:
        names = {n.name for n in found.numbers}
        return [o for o in self.own if o.number in names]

    def effect_in(self, found: Fitted) -> AbstractEffect:
        """The effect with the parameters of a robot that was fitted, as it is stated."""
        effect = self._moved(found)
        return effect.fitted_beside(self.robot, {n.name: found.value(n.name) for n in found.numbers}).stated()

    def _moved(self, found: Fitted) -> AbstractEffect:
        effect = self.effect
        for o in self._fitted_in(found):
            effect = eqx.tree_at(operator.attrgetter(o.parameter), effect, found.value(o.number) - o.minus)
        return effect


Key = tuple[str, str]  # an effect's name, and its joint


def one_class(effect: AbstractEffect, own: Key, other: Key) -> bool:
    """Whether another effect is one that most data cannot tell from this one, on the same joint."""
    return own[1] == other[1] and other[0] in (own[0], *effect.alike, *effect.same_law)


def hypothesis(view: Fitted, effect: AbstractEffect, joint: str) -> Hypothesis | None:
    """A robot with an effect as it was scored; `None` where it cannot be, or has nothing that could be fitted.

    A number that the robot has, and that the effect is an error of, is set free instead."""
    robot, had, effect = view.robot, {n.name for n in view.numbers}, effect.in_numbers()
    try:
        own = effect.own_numbers(robot)
        free = effect.is_error and all(o.number in had for o in own)
        changed = robot if free else robot.with_effects(effect)
    except (InputError, ValueError):
        return None
    beside = [(name, Tolerance(std)) for name, std in effect.unknown_beside(robot).items()]
    unknown = Tolerances((*view.unknown.stated, *((o.number, Tolerance(o.known)) for o in own), *beside))
    fitted = {n.name: n for n in numbers(changed.with_tolerances(unknown))}
    if own and not any(o.number in fitted for o in own):
        return None
    signed = [o for o in own if o.number not in fitted or not fitted[o.number].positive]
    limited = [(o.number, _range(effect, o)) for o in signed]
    return Hypothesis(effect, joint, changed, unknown.updated(Tolerances(tuple(limited))), own, free)


def _range(effect: AbstractEffect, own: OwnNumber) -> Tolerance:
    """Of a parameter that may be nothing or negative: what is plausible."""
    low, high = effect.bounds.get(own.parameter, (0.0, math.inf))
    if not math.isfinite(high - low):
        return _UNKNOWN
    return Tolerance(high if low >= 0.0 else 0.5 * (high - low), relative=False)


def visible_size(effect: AbstractEffect, robot: Robot, joint: str) -> float:
    """Size over the just visible one, by the first parameter; 0 where that says nothing."""
    first = next(iter(effect.units))
    try:
        typical = np.asarray(getattr(type(effect).typical(robot, joint), first), float)
    except ValueError:
        return 0.0
    value = np.asarray(getattr(effect, first), float)
    if typical.size != 1 or value.size != 1 or not typical or effect.nothing or not effect.grows:
        return 0.0
    return float(abs(value.item() / typical.item()))
