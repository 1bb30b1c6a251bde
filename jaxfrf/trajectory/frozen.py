"""Small motions about the positions of an experiment: what a force anywhere in the robot asks of its motors."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from ..effects import AbstractActuator
from ..effects._place import axis_of
from ..robot import (
    Robot,
    deflections,
    describing_friction,
    linearise,
    motor_directions,
    motor_values,
    operating_point,
)
from ..simulation import Motion

_SAMPLES = 192  # samples of the motion that stand for it where a spring's mean stiffness is taken


class Frozen(eqx.Module):
    """The robot linearised at one position, with its motors following a given motion.

    A force d on the coordinates z then asks the motors for `to_torque` d more torque; another motion of the motors,
    delta, for `impedance` delta.

    **Fields:** `to_torque`: (line, axis, dof). `impedance`: (line, axis, axis), N m/rad, motor side. `compliance`:
    (line, dof, dof), rad/(N m), motion of the coordinates under a force while the motors stand. `command`:
    (line, axis), what becomes of a commanded torque on its way to the motor: the hold between samples, the robot's
    actuators. `q`: (axis,), rad. `friction`: describing coefficient, (axis,). `deflection`: of the springs about
    rest over a period, (sample, spring).
    """

    to_torque: Complex[np.ndarray, "line axis dof"]
    impedance: Complex[np.ndarray, "line axis axis"]
    compliance: Complex[np.ndarray, "line dof dof"]
    command: Complex[np.ndarray, "line axis"]
    frequency: Float[np.ndarray, "line"]
    q: Float[np.ndarray, "axis"]
    friction: Float[np.ndarray, "axis"]
    deflection: Float[np.ndarray, "sample spring"]


def frozen(robot: Robot, motion: Motion, q, frequency: Float[np.ndarray, "line"], torque_rate: float) -> list[Frozen]:
    """The robot linearised at every position, friction and nonlinear springs by their mean over the motion there;
    `torque_rate`: at which commands change, Hz."""
    command = torque_path(robot, frequency, torque_rate)
    result = []
    for pos in range(len(motion.z)):
        friction, deflection = _means(robot, motion, np.asarray(q)[pos], pos)
        result.append(_frozen(robot, np.asarray(q)[pos], friction, deflection, np.asarray(frequency), command))
    return result


def other_impedance(robot: Robot, still: Frozen, names: tuple[str, ...]) -> Complex[np.ndarray, "line axis axis"]:
    """Of another robot at the same place and in the same motion; `names` of the springs of `still.deflection`."""
    deflection = np.zeros((len(still.deflection), len(robot.spring_names)))
    for i, name in enumerate(robot.spring_names):
        if name in names:
            deflection[:, i] = still.deflection[:, names.index(name)]
    return _frozen(robot, still.q, still.friction, deflection, still.frequency, still.command).impedance


def _frozen(robot: Robot, q, friction, deflection, frequency, command) -> Frozen:
    passive = tuple(e for e in robot.effects if not isinstance(e, AbstractActuator))  # `command` has the others
    model = linearise(dataclasses.replace(robot, effects=passive), operating_point(robot, q), friction, deflection)
    M, D, K = (np.asarray(x) for x in (model.mass, model.damping, model.stiffness))
    B, s = np.asarray(motor_directions(robot)), 2j * np.pi * frequency
    motors = np.argmax(np.abs(B), axis=0)  # every motor turns with one coordinate
    gain = B[motors, np.arange(robot.n_axes)]
    others = np.setdiff1d(np.arange(robot.dof), motors)
    Z = s[:, None, None] ** 2 * M + s[:, None, None] * D + K
    part = lambda rows, columns: Z[:, rows[:, None], columns]
    compliance = np.zeros((len(s), robot.dof, robot.dof), complex)
    compliance[:, others[:, None], others] = np.linalg.inv(part(others, others))
    through = part(motors, others) @ compliance[:, others[:, None], others]
    to_torque = np.zeros((len(s), robot.n_axes, robot.dof), complex)
    to_torque[:, :, others] = through / gain[:, None]
    to_torque[:, np.arange(robot.n_axes), motors] = -1.0 / gain
    impedance = (part(motors, motors) - through @ part(others, motors)) / (gain[:, None] * gain)
    return Frozen(to_torque, impedance, compliance, command, frequency, np.asarray(q), friction, deflection)


def _means(robot: Robot, motion: Motion, q, pos: int):
    point = operating_point(robot, q)
    z = motion.z[pos].reshape(-1, robot.dof)
    some = z[np.linspace(0, len(z) - 1, _SAMPLES).astype(int)]
    deflection = np.asarray(deflections(robot, some)) - np.asarray(point.deflection)
    travel = np.asarray(motor_values(robot, motion.z[pos]))
    speed = motion.fs * np.diff(travel, axis=1)
    amplitude = np.sqrt(2.0) * np.maximum(np.sqrt(np.mean(speed**2, axis=(0, 1))), 1e-3)
    return np.asarray(describing_friction(robot, amplitude, point.torque)), deflection


def torque_path(robot: Robot, frequency, rate: float) -> Complex[np.ndarray, "line axis"]:
    """What becomes of a torque command on its way to the motor: held between samples of this rate, Hz, then through
    the robot's actuators."""
    s = 2j * np.pi * np.asarray(frequency)
    half = s / (2 * rate)
    hold = np.exp(-half) * np.sinc(half.imag / np.pi)
    factor = np.tile(hold[:, None], (1, robot.n_axes))
    for effect in robot.effects:
        if isinstance(effect, AbstractActuator):
            axis = axis_of(robot, effect.joint)
            factor[:, axis] *= np.asarray(effect.response(s)) * np.exp(-s * float(effect.dead_time()))
    return factor
