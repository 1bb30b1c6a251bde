"""How far the springs of a robot move in an experiment, from its records."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from ..experiment import Experiment
from ..robot import Robot, operating_point
from ..robot.quantity import derivatives
from .model import RobotPoint

_SAMPLES = 192  # of the motion that the mean is taken over
_HIGHEST = 120.0  # Hz


def robot_points(robot: Robot, data: Experiment) -> RobotPoint:
    """The operating points of an experiment, with what every nonlinear spring did there.

    The torque in a gear is what the motor does not keep for itself, n (u - J_m q_m'' - friction), so it is measured;
    its part about the mean is added to gravity's torque and put through the inverse spring law of `robot`. Springs
    across the transmission get no swing (they are taken as linear).

    **Arguments:** `data`: periodic records with arm configurations q.
    """
    if data.q is None or data.q.shape[-1] != robot.n_axes:
        raise input_error(
            "q of the records",
            "none" if data.q is None else f"{data.q.shape[-1]} angles",
            f"the {robot.n_axes} arm angles of {robot.name} at every position",
            "Store q with the records.",
        )
    torque = gear_torque_swing(robot, data)
    return RobotPoint(np.asarray(data.q), deflection_swing(robot, data.q, torque))


def gear_torque_swing(robot: Robot, data: Experiment) -> Float[np.ndarray, "pos sample gear"]:
    """Samples of the torque in every flexible transmission about its mean, arm side, N m.

    From the part of one mean period below 120 Hz, where the excitation and its slow sine are: beyond, ripple and noise
    differentiated twice would rule."""
    if not data.period:
        raise input_error("record", "no period", "a periodic record", "Say its period (--set period=N).")
    gear, inertia = (np.asarray(x) for x in (robot.drives.gear_ratio, robot.drives.motor_inertia))
    flexible = list(robot.flexible_axes)
    swings = []
    for pos in range(data.n_pos):
        torque, speed, acceleration = _slow_motion(data, pos)
        rubbing = np.asarray(robot.drives.friction.torque(jnp.asarray(speed)))
        in_gear = (gear * (torque - inertia * acceleration - rubbing))[..., flexible]
        in_gear = in_gear - in_gear.mean(axis=1, keepdims=True)
        every = in_gear.reshape(-1, len(flexible))
        swings.append(every[np.linspace(0, len(every) - 1, _SAMPLES).astype(int)])
    return np.stack(swings)


def _slow_motion(data: Experiment, pos: int):
    """Torque, motor speed and acceleration of one mean period below the limit, (exp, time, axis), coarsely sampled."""
    steady = slice(data.transient_periods * data.period, (data.transient_periods + data.n_periods) * data.period)
    mean = lambda x: np.asarray(x)[pos, :, steady].reshape(data.n_exp, data.n_periods, data.period, -1).mean(axis=1)
    count = min(int(_HIGHEST * data.period / data.fs) + 1, data.period // 2)
    U, Y = (np.fft.rfft(mean(x), axis=1)[:, :count] / data.period for x in (data.u, data.y))
    s = 2j * np.pi * np.arange(count)[:, None] * data.fs / data.period
    speed = Y * s ** (1 - derivatives(data.y_quantity)) if derivatives(data.y_quantity) < 2 else _integrated(Y, s)
    n = 2 * count
    back = lambda X: np.fft.irfft(X, n, axis=1) * n
    return back(U), back(speed), back(s * speed)


def _integrated(Y, s):
    return np.divide(Y, s, out=np.zeros_like(Y), where=s != 0)


def deflection_swing(
    robot: Robot, q: Float[np.ndarray, "pos axis"], torque: Float[np.ndarray, "pos sample gear"]
) -> Float[np.ndarray, "pos sample spring"]:
    """Deflections about the point of rest that a torque in the gears (about gravity's) makes, rad."""
    point = operating_point(robot, np.asarray(q))
    rest = np.asarray(point.deflection)
    held = np.asarray(robot.springs.torque(point.deflection, jnp.zeros_like(point.deflection)))
    total = np.repeat(held[:, None], torque.shape[1], axis=1)
    total[..., : torque.shape[-1]] += torque
    x = total / np.asarray(robot.springs.stiffness)
    # Newton's method; a stiffening spring is convex on either side, so that it never turns back.
    for _ in range(12):
        force = np.asarray(robot.springs.torque(jnp.asarray(x), jnp.zeros_like(x)))
        x = x - (force - total) / np.asarray(robot.springs.tangent(jnp.asarray(x)))
    return x - rest[:, None]
