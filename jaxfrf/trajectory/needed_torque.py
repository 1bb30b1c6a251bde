"""The torque that a robot with rigid transmissions needs for a measured motion, its effects by their own laws."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from ..effects import (
    AbstractActuator,
    AbstractArmTorque,
    AbstractEffect,
    AbstractFriction,
    AbstractLinkSensor,
    AbstractMotorTorque,
    AbstractSensor,
    AbstractStructure,
)
from ..effects._place import axis_of
from ..robot import Robot, arm_inertia_and_bias
from ..robot.equations import arm_angles, gear_coupling
from .rigid_motion import MeasuredMotion, check_rigid, smooth

Torque = Float[np.ndarray, "time axis"]


def check_one_motor_a_joint(robot: Robot) -> None:
    """Refuse a robot of which a motor turns more than its own joint, or whose arm moves otherwise than its motors."""
    check_rigid(robot)
    if not turned_by_one_motor(robot):
        raise input_error(
            f"transmissions of {robot.name}",
            "a gear that turns with another axis",
            "one motor for each joint",
            "Calibrate it (`jaxfrf identify`, `jaxfrf.calibrate`), which knows such wrists; a diagnosis does not yet.",
        )


def turned_by_one_motor(robot: Robot) -> bool:
    """Whether every joint is turned by its own motor alone."""
    return gear_coupling(robot) is None


def needed_torque(robot: Robot, motion: MeasuredMotion) -> Torque:
    """Torque command for the motion, u = A^{-1}{(M(q) q'' + c + g + arm torques)/n + friction - ripple}, (time, axis).

    A is what the robot's actuator effects make of a command. With a rigid transmission the measured motor torque stands
    for the load of friction that depends on it, as in the simulation. Sensor effects are taken off the motion. It fails
    for effects that have no inverse (saturation, quantisation), and is biased where gears give way: `jaxfrf.calibrate`
    takes flexible ones.

    **Arguments:** `robot`: with its effects. `motion`: of its motors.

    **Returns:** (time, axis), N m, motor side.

    **Source:** the equation above; M, c and g as of `jaxfrf.robot.mass_and_bias`.
    """
    plain = dataclasses.replace(robot, effects=())
    for sensor in (x for x in robot.effects if isinstance(x, AbstractSensor)):
        motion = _true_motion(robot, sensor, motion)
    torque = np.asarray(_inertial(plain, motion.angle, motion.speed, motion.acceleration))
    for kind in (AbstractArmTorque, AbstractFriction, AbstractMotorTorque, AbstractActuator):
        for acting in (x for x in robot.effects if isinstance(x, kind)):
            torque = torque + _contribution(robot, acting, motion, torque)
    return torque


def added_torque(robot: Robot, effect: AbstractEffect, motion: MeasuredMotion, needed: Torque) -> Torque:
    """What `effect` adds to the torque that the robot needs (`needed`), (time, axis).

    To first order where the robot has actuator effects already."""
    if isinstance(effect, AbstractStructure | AbstractSensor):
        return needed_torque(robot.with_effects(effect), motion) - needed
    return _contribution(robot, effect, motion, needed)


@eqx.filter_jit
def _inertial(robot: Robot, angle, speed, acceleration):
    """Torque of masses, gravity and the robot's own friction, motor side."""
    matrix, bias = arm_inertia_and_bias(robot, arm_angles(robot, angle), arm_angles(robot, speed))
    arm = jnp.einsum("...ij,...j->...i", matrix, arm_angles(robot, acceleration)) + bias
    return arm / robot.drives.gear_ratio + robot.drives.friction.torque(speed)


def _contribution(robot: Robot, effect: AbstractEffect, motion: MeasuredMotion, torque: Torque) -> Torque:
    if isinstance(effect, AbstractLinkSensor):
        return np.zeros_like(torque)
    axis = axis_of(robot, effect.joint)
    gear = float(robot.drives.gear_ratio[axis])
    angle, speed = motion.angle[:, axis], motion.speed[:, axis]
    if isinstance(effect, AbstractFriction):
        load = smooth(motion.torque[:, axis], motion.fs, motion.cutoff)
        own = effect.torque(jnp.asarray(speed), jnp.asarray(load))
    elif isinstance(effect, AbstractArmTorque):
        own = effect.torque(jnp.asarray(angle / gear), jnp.asarray(speed / gear)) / gear
    elif isinstance(effect, AbstractMotorTorque):
        own = -effect.torque(jnp.asarray(angle))
    elif isinstance(effect, AbstractActuator):
        own = _commanded(effect, torque[:, axis], motion.fs) - torque[:, axis]
    else:
        raise TypeError(f"{effect.name} adds no torque of its own.")
    added = np.zeros_like(torque)
    added[:, axis] = np.asarray(own)
    return added


def _commanded(effect: AbstractActuator, torque, fs: float):
    """The command whose torque this is: the actuator's response taken off in the frequency domain.

    The record goes on as its own point reflection at both ends, so that it has no jump there."""
    n = len(torque)
    extended = np.concatenate([2 * torque[0] - torque[:0:-1], torque, 2 * torque[-1] - torque[-2::-1]])
    ramp = np.linspace(extended[0], extended[-1], len(extended))
    s = 2j * np.pi * np.fft.rfftfreq(len(extended), 1.0 / fs)
    response = np.asarray(effect.response(jnp.asarray(s)))
    spectrum = np.fft.rfft(extended - ramp) / response * np.exp(s * float(effect.dead_time()))
    late = (float(effect.dead_time()) + _delay_at_rest(effect)) * (ramp[1] - ramp[0]) * fs
    return (np.fft.irfft(spectrum, len(extended)) + (ramp + late) / response[0].real)[n - 1 : 2 * n - 1]


def _delay_at_rest(effect: AbstractActuator) -> float:
    """What a slow ramp is late by, s: minus the slope of the response at s = 0 over its value."""
    step = 1e-3
    low = np.asarray(effect.response(jnp.asarray([0.0, step * 1j])))
    return float(-(low[1] / low[0]).imag / step)


def _true_motion(robot: Robot, effect: AbstractSensor, motion: MeasuredMotion) -> MeasuredMotion:
    """The motion behind the measured one: error(true) is taken as error(measured), and differentiated with it."""
    axis = axis_of(robot, effect.joint)
    error = np.zeros_like(motion.angle)
    error[:, axis] = np.asarray(effect.measured(jnp.asarray(motion.angle[:, axis]))) - motion.angle[:, axis]
    rate = np.gradient(error, 1.0 / motion.fs, axis=0)
    return eqx.tree_at(
        lambda m: (m.angle, m.speed, m.acceleration),
        motion,
        (motion.angle - error, motion.speed - rate, motion.acceleration - np.gradient(rate, 1.0 / motion.fs, axis=0)),
    )
