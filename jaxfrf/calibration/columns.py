"""What every number of a robot would add to the torque that its motors need for a motion."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from ..effects import (
    AbstractActuator,
    AbstractEffect,
    AbstractLinkSensor,
    AbstractSensor,
    AbstractStructure,
)
from ..robot import Robot
from ..robot.drive import Friction
from ..robot.regressor import PER_LINK, link_parameters
from ..trajectory.evidence import Column
from ..trajectory.measured import Measured
from ..trajectory.scene import Scene, Signature
from ..trajectory.signature import signature
from .numbers import Number, effect_parameters, of_drives, with_numbers

_STEP = 1e-3  # of a coordinate's size, but at most this change of a logarithm
_LATE = 1e-6  # s
_NEAR_REST = (1.0, 3.5, 12.5)  # times the speed that smooths the friction: within it, friction may be another
_SLOW = 0.3  # of a motor's rms speed: what is as wide as that is not near rest, and stands for viscous friction
OF_LINKS = ("mass", "com", "inertia")
_LAWS = {
    **dict.fromkeys(("stiffness", "damping", "stiffness_ratio", "stiffness_knee", "backlash"), "spring"),
    **dict.fromkeys(("motor_inertia", "viscous_friction", "coulomb_friction"), "motor"),
}


def number_columns(robot: Robot, numbers: Sequence[Number], x: Float[np.ndarray, "number"]) -> list[Column]:
    """Derivatives by x, along a motion of the robot that stands at x.

    `robot`: as given, whose numbers these are.
    """
    x = np.asarray(x, float)
    now = with_numbers(robot, numbers, x)
    links = [i for i, number in enumerate(numbers) if number.kind in OF_LINKS]
    linked = _OnceAScene(_Links(now, [numbers[i] for i in links], x[links]))
    laws = {kind: _OnceAScene(_Law(robot, numbers, x, kind)) for kind in {n.kind for n in numbers} & set(_LAWS)}
    given, columns = _OnceAScene(_given), []
    for i, number in enumerate(numbers):
        if i in links:
            columns.append(_one_of(linked, links.index(i)))
        elif number.kind in laws:
            columns.append(_one_of(laws[number.kind], i))
        else:
            columns.append(_column(robot, numbers, x, i, given))
    return columns


def _column(robot: Robot, numbers, x, i: int, given: "_OnceAScene") -> Column:
    number = numbers[i]
    joint = number.joint
    if number.kind == "torque_constant":
        axis, part = robot.axis_names.index(joint), number.size / (1.0 + number.value(x[i]))
        return lambda scene: scene.by_command(axis, -given(scene)[..., axis]) * part
    if number.kind == "delay":
        late = of_drives()[number.kind].in_drive(joint, _LATE, ())
        assert late is not None
        return lambda scene: signature(late, scene) * (number.size / _LATE)
    step = _step(number)
    if number.of_effect:
        _, name, parameter = number.name.split(".")
        now = next(
            e
            for j, e, p in effect_parameters(with_numbers(robot, numbers, x))
            if (j, e.name, p) == (joint, name, parameter)
        )
        sides = [_with(now, parameter, number.value(x[i] + sign * step)) for sign in (1.0, -1.0)]
        return lambda scene: (signature(sides[0], scene) - signature(sides[1], scene)) / (2 * step)
    moved = x.copy()
    moved[i] += step
    changed = with_numbers(robot, numbers, moved)
    return lambda scene: scene.by_robot(_on_the_links_of(scene, changed)) / _went(number)


def _step(number: Number) -> float:
    return min(_STEP, _STEP / number.size) if number.positive else _STEP


def _went(number: Number) -> float:
    """How far a step of the coordinate takes the number, as a coordinate: of a law that is linear in it, the difference
    over this is the derivative. Over the step itself it would be half a thousandth more, and no longer what motors
    give (`_given`) where all of a robot is heavier by one part: the data would seem to know a scale that they do not.
    """
    step = _step(number)
    return float(np.expm1(number.size * step) / number.size) if number.positive else step


def _on_the_links_of(scene: Scene, robot: Robot) -> Robot:
    """What a scene carries is its own."""
    return dataclasses.replace(robot, chain=scene.robot.chain)


def _with(effect, parameter: str, value: float):
    return eqx.tree_at(lambda e: getattr(e, parameter), effect, value)


def _one_of(columns: Callable[[Scene], Any], place: int) -> Column:
    return lambda scene: columns(scene)[place]


class _Law:
    """Columns of one kind of number of springs or motors, all at once: what each asks depends on its own alone."""

    def __init__(self, robot: Robot, numbers: Sequence[Number], x, kind: str):
        rows = [i for i, number in enumerate(numbers) if number.kind == kind]
        self.went = {i: _went(numbers[i]) for i in rows}
        moved = x.copy()
        moved[rows] += [_step(numbers[i]) for i in rows]
        self.changed = with_numbers(robot, numbers, moved)
        names = robot.spring_names if _LAWS[kind] == "spring" else robot.axis_names
        self.keys = {i: (_LAWS[kind], names.index(numbers[i].joint)) for i in rows}

    def __call__(self, scene: Scene) -> dict[int, Signature]:
        each = scene.by_each(_on_the_links_of(scene, self.changed))
        return {i: each[key] / self.went[i] for i, key in self.keys.items()}


def near_rest_columns(robot: Robot, record: Measured) -> list[Column]:
    """What friction may be near standstill beside the robot's own law, for each motor shapes of up to three widths over
    its speed, and another moment at which it turns over.

    No machine's friction turns over as tanh(v/eps) does: presliding, stiction, the drop of Stribeck. Left out, the
    difference would go into viscous friction, of which it can be many per cent; and friction that follows its speed
    late, as that of lubricated contacts does, would go into the inertia of the motor (Armstrong-Helouvry, Dupont &
    Canudas de Wit, Automatica 30 (1994) 1083-1138, frictional memory)."""
    friction = robot.drives.friction
    if not isinstance(friction, Friction) or not np.any(np.asarray(friction.coulomb)):
        return []
    smoothing, axes = float(friction.smoothing), np.flatnonzero(np.asarray(friction.coulomb)).tolist()
    shape = lambda axis, width: lambda scene: scene.by_motor(axis, _near_rest(scene.speed[..., axis], width))
    widths, speed = np.array(_NEAR_REST) * smoothing, _rms_speed(record)
    shapes = [shape(axis, width) for axis in axes for width in widths[widths < _SLOW * speed[axis]]]
    return shapes + [_later(axis, smoothing) for axis in axes]


def _rms_speed(record: Measured) -> Float[np.ndarray, "axis"]:
    """Of every motor, rad/s."""
    speed = 2.0 * np.pi * record.frequency[:, None] * np.abs(record.Y)
    return np.sqrt(2.0 * np.mean(np.sum(speed**2, axis=2), axis=(0, 1)))


def _later(axis: int, smoothing: float) -> Column:
    """Coulomb friction of one motor a moment later."""

    def column(scene: Scene) -> Signature:
        rate = 2j * np.pi * scene.still.frequency[:, None]
        return -rate * scene.by_motor(axis, np.tanh(scene.speed[..., axis] / smoothing))

    return column


def _near_rest(speed, width: float):
    return np.tanh(speed / (0.2 * width)) * np.exp(-np.abs(speed) / width)


class _OnceAScene:
    """A function of a scene that is asked again and again."""

    def __init__(self, function):
        self.function = function
        self._known: dict[int, object] = {}

    def __call__(self, scene: Scene):
        if id(scene) not in self._known:
            self._known[id(scene)] = self.function(scene)
        return self._known[id(scene)]


def _given(scene: Scene) -> Signature:
    """Torque that motors give without being asked, where their constants are larger than said.

    What the robot and its effects resist with, as the other columns have it: robots that are heavier by one part in
    all, and whose motors are stronger by as much, move alike, and that must not depend on how a signal was sampled. Nor
    is it the measured torque: then all of a misfit could be explained by a robot that is nothing on motors that give
    nothing.
    """
    return sum((signature(effect, scene) for effect in scene.robot.effects if _resists(effect)), scene.resisting())


def _resists(effect: AbstractEffect) -> bool:
    """Whether an effect is a torque beside those of the robot: what changes the robot is in its numbers, and ripple may
    be room for some (`alike`)."""
    elsewhere = isinstance(effect, AbstractStructure | AbstractActuator | AbstractSensor | AbstractLinkSensor)
    return not elsewhere and bool(np.any(np.asarray(getattr(effect, "amplitude", 1.0))))


class _Links:
    """Columns of masses, centres and inertias, all at once: torques are linear in the links' parameters."""

    def __init__(self, now: Robot, numbers: Sequence[Number], x):
        self.slopes = link_slopes(now, numbers, x)

    def __call__(self, scene: Scene) -> Complex[np.ndarray, "number exp line axis"]:
        return scene.by_links(self.slopes)


def link_slopes(now: Robot, numbers: Sequence[Number], x) -> Float[np.ndarray, "number joint parameter"]:
    """Derivatives of the links' parameters (`link_regressor`) by numbers of the links, of a robot that stands at x."""
    values = {kind: np.asarray(getattr(now.chain, kind), float) for kind in OF_LINKS}
    slopes = np.zeros((len(numbers), len(now.joint_names), PER_LINK))
    for slope, number, at in zip(slopes, numbers, x, strict=True):
        joint = now.joint_names.index(number.joint)
        for sign in (1.0, -1.0):
            moved = {kind: np.array(value[joint]) for kind, value in values.items()}
            moved[number.kind][number.element] = number.value(at + sign * _STEP)
            slope[joint] += sign * link_parameters(**moved) / (2 * _STEP)
    return slopes
