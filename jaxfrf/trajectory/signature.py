"""What an effect asks of the motors along a motion: its signature, the same law that simulates it."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import (
    AbstractActuator,
    AbstractArmTorque,
    AbstractEffect,
    AbstractFriction,
    AbstractGearCoupling,
    AbstractGearError,
    AbstractGearTorque,
    AbstractMotorTorque,
    AbstractSensor,
    AbstractStatelessActuator,
    AbstractStructure,
    ExtraFlexibility,
)
from ..effects._place import axis_of, spring_of
from .frozen import other_impedance
from .scene import Scene, Signature


@functools.singledispatch
def signature(effect: AbstractEffect, scene: Scene) -> Signature:
    """More torque that the motors of `scene` would have to give with this effect, (exp, line, axis), N m of command.

    To first order: the motion of the motors is kept. An effect that changes the robot's coordinates is compared by the
    frozen linear robots.

    **Arguments:** `effect`: on a joint of the scene's robot. `scene`: one position, of `Evidence.scenes`.

    **Returns:** (exp, line, axis), N m, amplitudes of one period.

    **Raises:** `NotImplementedError` for an effect of a kind that acts nowhere.

    **Source:** the effect's own law along the motion, by the DFT: this project's own.
    """
    raise NotImplementedError(f"{type(effect).__name__} acts nowhere that is known here.")


@signature.register
def _(effect: AbstractFriction, scene: Scene) -> Signature:
    axis = axis_of(scene.robot, effect.joint)
    return scene.by_motor(axis, _law(effect, "torque", scene.speed[..., axis], scene.load[..., axis]))


@signature.register
def _(effect: AbstractArmTorque, scene: Scene) -> Signature:
    axis = axis_of(scene.robot, effect.joint)
    return scene.by_arm(axis, _law(effect, "torque", scene.arm_angle[..., axis], scene.arm_rate[..., axis]))


@signature.register
def _(effect: AbstractMotorTorque, scene: Scene) -> Signature:
    axis = axis_of(scene.robot, effect.joint)
    # Over the angle as it was read, as columns of ripple are: else all of a robot, made heavier by one part, would not
    # ask what stronger motors give.
    return scene.by_motor(axis, -_law(effect, "torque", scene.reading[..., axis]))


@signature.register
def _(effect: AbstractSensor, scene: Scene) -> Signature:
    axis = axis_of(scene.robot, effect.joint)
    angle = scene.angle[..., axis]
    return scene.by_sensor(axis, _law(effect, "measured", angle) - angle)


@signature.register
def _(effect: AbstractStatelessActuator, scene: Scene) -> Signature:
    axis = axis_of(scene.robot, effect.joint)
    command = scene.command[..., axis]
    return scene.by_command(axis, scene.spectrum(command - _law(effect, "drive", command)))


@signature.register
def _(effect: AbstractActuator, scene: Scene) -> Signature:
    axis = axis_of(scene.robot, effect.joint)
    s = 2j * np.pi * np.arange(scene.lines) * scene.fs / scene.period
    response = np.asarray(effect.response(s)) * np.exp(-s * float(effect.dead_time()))
    return scene.by_command(axis, scene.spectrum(scene.command[..., axis]) * (1.0 - response))


@signature.register
def _(effect: AbstractStructure, scene: Scene) -> Signature:
    changed = scene.robot.with_effects(effect)
    if changed.dof == scene.robot.dof:
        return scene.by_robot(changed)
    return scene.by_impedance(other_impedance(changed, scene.still, scene.robot.spring_names))


@eqx.filter_jit
def _along(effect, robot, *signals):
    return effect.along(robot, *signals)


@signature.register
def _(effect: AbstractGearTorque, scene: Scene) -> Signature:
    spring = spring_of(scene.robot, effect.joint)
    twice = np.concatenate([scene.deflection[..., spring].T] * 2)  # the second period is a steady one
    torque = _along(_arrays(effect), scene.robot, twice, twice, twice, scene.period / scene.fs / scene.coarse)
    return scene.by_spring(spring, np.asarray(torque)[scene.coarse :].T)


@signature.register
def _(effect: AbstractGearError, scene: Scene) -> Signature:
    spring, axis = spring_of(scene.robot, effect.joint), axis_of(scene.robot, effect.joint)
    angle = scene.angle[..., axis] / scene.gear[axis]
    lead, slope = _law(effect, "lead", angle), _law(effect, "slope", angle)
    return scene.by_shift(spring, lead) + scene.by_motor(axis, slope * scene.load[..., axis])


@signature.register
def _(effect: AbstractGearCoupling, scene: Scene) -> Signature:
    spring, axis = spring_of(scene.robot, effect.joint), axis_of(scene.robot, effect.joint)
    ratio = float(effect.ratio)
    turn = scene.arm_angle[..., axis - 1] - scene.still.q[axis - 1]
    x, v = scene.deflection.copy(), scene.deflection_rate.copy()
    x[..., spring] -= ratio * turn
    v[..., spring] -= ratio * scene.arm_rate[..., axis - 1]
    more = np.asarray(scene.robot.springs.torque(x, v)) - scene.spring_torque
    back = ratio * scene.spring_torque[..., spring]
    return scene.by_spring(spring, more[..., spring]) + scene.by_arm(axis - 1, -back)


@signature.register
def _(effect: ExtraFlexibility, scene: Scene) -> Signature:
    robot = scene.robot
    own = f"{robot.joint_names[robot.driven_joints[axis_of(robot, effect.joint)]]}_flexibility"
    if own in robot.spring_names:  # the robot has it: with another spring
        row = robot.spring_names.index(own)
        values = lambda r: (r.springs.stiffness, r.springs.damping)
        k, d = (jnp.asarray(x) for x in values(robot))
        return scene.by_robot(
            eqx.tree_at(values, robot, (k.at[row].set(effect.stiffness), d.at[row].set(effect.damping)))
        )
    axis = axis_of(scene.robot, effect.joint)
    return scene.by_hinge(axis, effect.axis, float(effect.stiffness), float(effect.damping))


def _law(effect, name: str, *signals) -> np.ndarray:
    return np.asarray(_traced(_arrays(effect), name, *signals))


def _arrays(effect):
    """The effect with its numbers as arrays: those of other numbers share what is compiled."""
    return jax.tree.map(np.asarray, effect)


@eqx.filter_jit
def _traced(effect, name: str, *signals):
    return getattr(effect, name)(*signals)
