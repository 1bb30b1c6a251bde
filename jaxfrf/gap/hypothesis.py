"""A robot that has one more effect, whose parameters are numbers like its others, of which nothing is known."""

import dataclasses
import math
from collections.abc import Callable, Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .. import effects as fx
from .._errors import InputError
from ..calibration.numbers import numbers
from ..effects import AbstractEffect, AbstractStructure
from ..effects._place import axis_of
from ..robot import Robot, Tolerances
from ..robot.tolerances import KINDS, Tolerance
from .fitted import Fitted

_UNKNOWN = Tolerance(math.inf)
_AROUND_A_PAYLOAD = Tolerance(0.3)  # of the tensor of the link that carries it


class Own(eqx.Module):
    """A parameter of an effect as a number of the robot: parameter = number - `minus`."""

    number: str = eqx.field(static=True)
    parameter: str = eqx.field(static=True)
    minus: float = eqx.field(static=True, default=0.0)


class Hypothesis(eqx.Module):
    """An effect that is missing on a joint, where a fit of it begins.

    **Fields:** `robot`: with it. `unknown`: numbers of which nothing is known there. `own`: those of the effect.
    """

    effect: AbstractEffect
    joint: str = eqx.field(static=True)
    robot: Robot
    unknown: Tolerances = eqx.field(static=True)
    own: tuple[Own, ...]

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.joint

    def told(self, found: Fitted) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of every parameter of the effect in a robot that was fitted."""
        names = {n.name for n in found.these}
        return {
            o.parameter: (found.value(o.number) - o.minus, found.deviation(o.number))
            for o in self.own
            if o.number in names
        }

    def effect_in(self, found: Fitted) -> AbstractEffect:
        """The effect with the parameters of a robot that was fitted."""
        effect = self.effect
        for name, (value, _) in self.told(found).items():
            effect = eqx.tree_at(lambda e, name=name: getattr(e, name), effect, value)
        if isinstance(effect, fx.Payload):
            effect = dataclasses.replace(effect, place=_place(self.robot, effect, found, self.own[0].minus))
        return effect


def hypothesis(view: Fitted, effect: AbstractEffect, joint: str) -> Hypothesis | None:
    """A robot with an effect as it was scored; `None` where it cannot be, or has nothing that could be fitted.

    A number that the robot has, and that the effect is an error of, is set free instead."""
    robot, had = view.robot, {n.name for n in view.these}
    try:
        own = _own(robot, effect, joint)
        structure = isinstance(effect, AbstractStructure) or effect.name == "torque_constant"
        free = structure and not _moves(effect) and all(o.number in had for o in own)
        changed = robot if free else robot.with_effects(effect)
    except (InputError, ValueError):
        return None
    stated = [(o.number, _tolerance(effect, o)) for o in own]
    if isinstance(effect, fx.Payload):
        last = robot.joint_names[-1]
        stated += [(f"{last}.com", _UNKNOWN), (f"{last}.inertia", _AROUND_A_PAYLOAD)]
    unknown = Tolerances((*view.unknown.stated, *stated))
    fitted = {n.name for n in numbers(changed.with_tolerances(unknown))}
    waves = hasattr(effect, "amplitude")  # taken as it was scored: its size is no single number
    if not waves and not any(o.number in fitted for o in own):
        return None
    return Hypothesis(effect, joint, changed, unknown, own)


def _moves(effect: AbstractEffect) -> bool:
    """Whether the effect changes what numbers are given as, so that their fit begins anew."""
    return effect.name in ("backlash", "stiffness_hardening", "payload")


def _tolerance(effect: AbstractEffect, own: Own) -> Tolerance:
    """Unknown; of what may be negative, the range that is plausible."""
    low, high = effect.bounds.get(own.parameter, (0.0, math.inf))
    if math.isfinite(high - low) and (low < 0.0 or own.parameter == "delay") and own.minus == 0.0:
        return Tolerance(high if low >= 0.0 else 0.5 * (high - low), relative=False)
    return _UNKNOWN


def _own(robot: Robot, effect: AbstractEffect, joint: str) -> tuple[Own, ...]:
    """The numbers of the robot that the parameters of an effect are."""
    if effect.name in _OF_THE_ROBOT:
        return _OF_THE_ROBOT[effect.name](robot, joint)
    if effect.name in KINDS or isinstance(effect, AbstractStructure):
        return ()
    return tuple(
        Own(f"{joint}.{effect.name}.{name}", name)
        for name in effect.units
        if not hasattr(effect, "amplitude")
        and np.ndim(getattr(effect, name)) == 0
        and name not in ("smoothing", "level" * (effect.name == _OFFSET))
    )


_OFFSET = fx.FrictionAsymmetry.name


def _friction(kind: str, parameter: str):
    field = kind.removesuffix("_friction")

    def own(robot: Robot, joint: str):
        level = getattr(robot.drives.friction, field)
        return (Own(f"{joint}.{kind}", parameter, float(np.asarray(level)[axis_of(robot, joint)])),)

    return own


def _hinge(robot: Robot, joint: str):
    name = f"{robot.joint_names[robot.driven_joints[axis_of(robot, joint)]]}_flexibility"
    return Own(f"{name}.stiffness", "stiffness"), Own(f"{name}.damping", "damping")


_OF_THE_ROBOT: Mapping[str, Callable[[Robot, str], tuple[Own, ...]]] = {
    "coulomb_friction": _friction("coulomb_friction", "level"),
    "viscous_friction": _friction("viscous_friction", "coefficient"),
    "motor_inertia": lambda robot, joint: (
        Own(f"{joint}.motor_inertia", "increase", float(robot.drives.motor_inertia[axis_of(robot, joint)])),
    ),
    "torque_constant": lambda robot, joint: (Own(f"{joint}.torque_constant", "error"),),
    "torque_delay": lambda robot, joint: (Own(f"{joint}.delay", "delay"),),
    "backlash": lambda robot, joint: (Own(f"{joint}.backlash", "gap"),),
    "stiffness_hardening": lambda robot, joint: (
        Own(f"{joint}.stiffness_ratio", "ratio"),
        Own(f"{joint}.stiffness_knee", "knee"),
    ),
    "extra_flexibility": _hinge,
    "payload": lambda robot, joint: (Own(f"{robot.joint_names[-1]}.mass", "mass", float(robot.chain.mass[-1])),),
}


def _place(robot: Robot, effect, found: Fitted, mass: float):
    """Where a payload must be for the centre of its link to be where it was found."""
    link = robot.joint_names[-1]
    names = {n.name for n in found.these}
    given = np.asarray(robot.chain.com[-1], float)
    centre = np.array(
        [found.value(n) if (n := f"{link}.com.{e}") in names else at for e, at in zip("xyz", given, strict=True)]
    )
    more = float(effect.mass)
    return jnp.asarray(given + (centre - given) * (mass + more) / more) if abs(more) > 1e-9 else None
