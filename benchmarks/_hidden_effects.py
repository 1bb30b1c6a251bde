"""What is hidden in a case: an effect of the library, or one outside it, at a multiple of its just visible level.

One times is `Effect.typical(robot, joint)`, n times is n times its main parameter (`MAIN`), within the effect's
bounds. Where that has no plain meaning one times is

| effect | 1x | n times |
|---|---|---|
| stiffness_hardening | stiffness ratio .6 | .6^n |
| extra_flexibility | a quarter of the compliance of the joint's own transmission, the same d/k | n quarters |
| torque_saturation | .8 of the largest torque of the machine's run without it | .8^n, n up to 3 |
| counterbalance | 1.5 % of the torque limit at 1 rad | n |
| coulomb_friction, viscous_friction | half of the motor's own, as much as is believed of it anyway | n |
| motor_inertia | 5 % of it, as much as is believed of it anyway | n |
| dress_pack | 2 % of the torque limit at 1 rad (the typical 50 N m/rad stall the wrist's motors), at most typical | n |
| transmission_error | the typical amplitude at the first order, half of it at the second (if any) | n |
| presliding_friction | .1 rad | n |
| gain_drift | 6 % from begin to end | n |
| bumper | at its deepest the motor's Coulomb friction | n |

Friction of the motors, their inertia, a payload and a torque constant are *numbers* that a robot's file states and that
its user does not trust: one times is about the tolerance that he has by default, and what is true of them is told by
the whole difference from the robot that the diagnosis is given (`NUMBERS`).

Everything else about an effect (orders, phases, widths, points of rest, signs) is drawn; orders of ripple and numbers
of teeth lie outside the effects' own start values.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from _outside_effects import OUTSIDE

from jaxfrf.effects import AbstractEffect, library
from jaxfrf.effects._place import axis_of, spring_of
from jaxfrf.robot import parameters

MAIN = {
    "coulomb_friction": "level",
    "viscous_friction": "coefficient",
    "arm_viscous_friction": "coefficient",
    "stribeck_friction": "level",
    "friction_asymmetry": "offset",
    "load_dependent_friction": "coefficient",
    "torque_ripple": "amplitude",
    "resolver_ripple": "amplitude",
    "transmission_error": "amplitude",
    "torque_delay": "delay",
    "current_loop_lag": "time_constant",
    "backlash": "gap",
    "stiffness_hardening": "ratio",
    "structural_damping": "loss",
    "gear_hysteresis": "torque",
    "torque_constant": "error",
    "motor_inertia": "increase",
    "payload": "mass",
    "counterbalance": "stiffness",
    "extra_flexibility": "stiffness",
    "wrist_coupling": "ratio",
    "torque_saturation": "limit",
    "encoder_quantisation": "resolution",
    "dress_pack": "stiffness",
}
"""Effects of the library that the benchmark hides, and the parameter that says how strong each is.

One that does not stand here is tried by every diagnosis and never hidden: the benchmark's figures say nothing of it."""

NUMBERS = {
    "coulomb_friction": "coulomb_friction",
    "viscous_friction": "viscous_friction",
    "motor_inertia": "motor_inertia",
    "payload": "mass",
}
"""Effects that are the error of a number that the robot has and that was drawn wrong, with the kind of that number."""

_EITHER_SIGN = ("friction_asymmetry", "torque_constant", "motor_inertia", "payload", "wrist_coupling")
_TOLERATED = {"coulomb_friction": 0.5, "viscous_friction": 0.5, "motor_inertia": 0.05}  # of the number: 1x
_ORDERS = {"torque_ripple": (3, 4, 5, 8, 9, 10, 12, 24), "resolver_ripple": (3, 4, 5, 6, 8)}
_LEAST_COULOMB = 0.9  # part of the motor's own friction that a negative one may take away
_MOST_SATURATED = 3.0  # times; more would keep the motor from following
_BALANCED = 0.015  # of the torque limit at 1 rad
_KNEE = (0.02, 0.09)  # of the deflection at the torque limit
_DEPTH = 0.7  # of the slow motion's amplitude, into the bumper


@dataclasses.dataclass(frozen=True)
class Hidden:
    """Which effect, on which joint ("" where it has none), at how many times its just visible level."""

    name: str
    joint: str
    level: float


@dataclasses.dataclass(frozen=True)
class Circumstances:
    """What a hidden effect is fitted to: the arm configurations, (pos, axis), the amplitude of the slow motion of every
    arm joint, rad, beginning and length of the record in a run, s, the largest torque of the machine's own run without
    it, (axis,), N m, for which somebody has to simulate, the axis of an extra flexibility and the rest positions of
    counterbalances, rad."""

    positions: np.ndarray
    swing: np.ndarray
    begin: float
    length: float
    largest_torque: Callable[[], np.ndarray]
    hinge: tuple[float, float, float] = (0.0, 0.0, 1.0)
    rest: dict[str, float] = dataclasses.field(default_factory=dict)


def hidden_effect(robot, hidden: Hidden, around: Circumstances, rng) -> tuple[AbstractEffect, float]:
    """The effect on this machine, and the level that its bounds leave. The same number of draws at any level."""
    name, joint, level = hidden.name, hidden.joint, hidden.level
    draw = _Draws(rng)
    special = _SPECIAL.get(name)
    if special is not None:
        return special(robot, joint, level, around, draw)
    sign = draw.sign if name in _EITHER_SIGN else 1.0
    if name in _TOLERATED:
        unit = _TOLERATED[name] * _own(robot, name, joint)
        return _scaled(robot, name, joint, level, sign, unit)
    others = {"width": draw.between(1.5, 6.0)} if name == "stribeck_friction" else {}
    return _scaled(robot, name, joint, level, sign, **others)


class _Draws:
    """Numbers for every need, drawn whether they are needed or not."""

    def __init__(self, rng):
        self.sign = float(rng.choice([-1.0, 1.0]))
        self._uniform = rng.uniform(size=4)
        self._next = iter(self._uniform)
        self.phase = rng.uniform(-math.pi, math.pi, 2)
        self.order = rng.permutation(100)
        self.count = int(rng.integers(1, 3))

    def between(self, low: float, high: float) -> float:
        """Log-uniform."""
        return float(low * (high / low) ** next(self._next))

    def within(self, low: float, high: float) -> float:
        return float(low + (high - low) * next(self._next))

    def orders(self, known) -> list[int]:
        place = [i for i in self.order.tolist() if i < len(known)]
        return sorted(known[i] for i in place[: self.count])


def kind_of(name: str) -> type[AbstractEffect]:
    return (library() | OUTSIDE)[name]


def _own(robot, name: str, joint: str) -> float:
    """The number of the robot that the effect is an error of."""
    return float(parameters(robot, [NUMBERS[name]])[f"{joint}.{NUMBERS[name]}"])


def _clipped(kind, main: str, value: float) -> float:
    low, high = kind.bounds[main]
    return float(np.clip(value, low, high))


def _scaled(robot, name, joint, level, sign=1.0, unit=None, **others):
    """`level` times the main parameter of the typical effect, or times `unit`, within the bounds."""
    kind, main = kind_of(name), MAIN.get(name) or next(iter(kind_of(name).units))
    if unit is None:
        unit = float(np.ravel(getattr(kind.typical(robot, joint), main))[0])
    value = _clipped(kind, main, sign * level * unit)
    return kind(joint=joint, **{main: value}, **others), abs(value / unit)


def _coulomb(robot, joint, level, around, draw):
    unit = _TOLERATED["coulomb_friction"] * _own(robot, "coulomb_friction", joint)
    least = level * _TOLERATED["coulomb_friction"] <= _LEAST_COULOMB
    return _scaled(robot, "coulomb_friction", joint, level, draw.sign if least else 1.0, unit)


def _ripple(name):
    def make(robot, joint, level, around, draw):
        kind, orders = kind_of(name), draw.orders(_ORDERS[name])
        unit = float(kind.typical(robot, joint).amplitude[0]) / math.sqrt(len(orders))
        value = _clipped(kind, "amplitude", level * unit)
        effect = kind(joint, np.full(len(orders), value), tuple(orders), draw.phase[: len(orders)])
        return effect, value / unit

    return make


def _transmission_error(robot, joint, level, around, draw):
    """.3 to .9 of the typical number of teeth with one order, or 1.1 to 2.5 of it with two."""
    kind = kind_of("transmission_error")
    typical = kind.typical(robot, joint)
    share = draw.within(0.3, 0.9) if draw.count == 1 else draw.within(1.1, 2.5)
    teeth = float(round(float(typical.teeth) * share))
    unit = float(np.ravel(typical.amplitude)[0])
    value = _clipped(kind, "amplitude", level * unit)
    orders = tuple(range(1, draw.count + 1))
    amplitude = value / np.array(orders, float)
    return kind(joint, amplitude, teeth, orders, draw.phase[: draw.count]), value / unit


def _hysteresis(robot, joint, level, around, draw):
    """It yields so late that it is not stiffer than the spring beside it."""
    kind = kind_of("gear_hysteresis")
    effect, level = _scaled(robot, kind.name, joint, level)
    own = float(robot.springs.stiffness[spring_of(robot, joint)])
    slip = _clipped(kind, "slip", max(draw.between(1e-4, 4e-4), effect.torque / own))
    return dataclasses.replace(effect, slip=slip), level


def _hardening(robot, joint, level, around, draw):
    kind, axis = kind_of("stiffness_hardening"), axis_of(robot, joint)
    ratio = _clipped(kind, "ratio", 0.6**level)
    most = float(robot.drives.torque_limit[axis] * robot.drives.gear_ratio[axis])
    knee = draw.between(*_KNEE) * most / float(robot.springs.stiffness[spring_of(robot, joint)])
    return kind(joint, ratio, _clipped(kind, "knee", knee)), math.log(ratio) / math.log(0.6)


def _flexibility(robot, joint, level, around, draw):
    kind, spring = kind_of("extra_flexibility"), spring_of(robot, joint)
    own, damping = (float(x[spring]) for x in (robot.springs.stiffness, robot.springs.damping))
    stiffness = _clipped(kind, "stiffness", 4.0 * own / level)
    return kind(joint, np.array(around.hinge), stiffness, damping * stiffness / own), 4.0 * own / stiffness


def _saturation(robot, joint, level, around, draw):
    largest = float(around.largest_torque()[axis_of(robot, joint)])
    level = min(level, _MOST_SATURATED)
    return kind_of("torque_saturation")(joint, largest * 0.8**level), level


def _counterbalance(robot, joint, level, around, draw):
    axis = axis_of(robot, joint)
    unit = _BALANCED * float(robot.drives.torque_limit[axis] * robot.drives.gear_ratio[axis])
    rest = around.rest[joint] + draw.within(-0.5, 0.5)
    return _scaled(robot, "counterbalance", joint, level, draw.sign, unit, rest=rest)


def _dress_pack(robot, joint, level, around, draw):
    axis, kind = axis_of(robot, joint), kind_of("dress_pack")
    attainable = 0.02 * float(robot.drives.torque_limit[axis] * robot.drives.gear_ratio[axis])
    unit = min(float(kind.typical(robot, joint).stiffness), attainable)
    rest, damping = draw.within(-0.5, 0.5), level * unit * draw.within(0.0, 0.1)
    return _scaled(robot, "dress_pack", joint, level, unit=unit, rest=rest, damping=_clipped(kind, "damping", damping))


def _drift(robot, joint, level, around, draw):
    return _scaled(robot, "gain_drift", joint, level, draw.sign, begin=around.begin, length=around.length)


def _bumper(robot, joint, level, around, draw):
    """At the outermost position, where the slow motion has covered .3 of its amplitude."""
    axis, side = axis_of(robot, joint), draw.sign
    swing = float(around.swing[axis])
    outermost = side * np.max(side * around.positions[:, axis])
    friction = float(robot.drives.friction.coulomb[axis] * robot.drives.gear_ratio[axis])
    stiffness = level * friction / (_DEPTH * swing)
    return kind_of("bumper")(joint, float(outermost + side * (1.0 - _DEPTH) * swing), side, stiffness), level


_SPECIAL = {
    "coulomb_friction": _coulomb,
    "torque_ripple": _ripple("torque_ripple"),
    "resolver_ripple": _ripple("resolver_ripple"),
    "transmission_error": _transmission_error,
    "gear_hysteresis": _hysteresis,
    "stiffness_hardening": _hardening,
    "extra_flexibility": _flexibility,
    "torque_saturation": _saturation,
    "counterbalance": _counterbalance,
    "dress_pack": _dress_pack,
    "gain_drift": _drift,
    "bumper": _bumper,
}
