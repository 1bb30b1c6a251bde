"""How far the springs of a robot move in an experiment, from its records."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._arguments import expect
from .._errors import input_error
from ..experiment import Experiment
from ..robot import Robot, operating_point
from ..robot.quantity import derivatives
from ..spectra import known_lines
from .model import RobotPoint

_SAMPLES = 192  # of the motion that the mean is taken over
_BEYOND = 1.5  # times the highest line


def robot_points(robot: Robot, data: Experiment) -> RobotPoint:
    """The operating points of an experiment, with what every nonlinear spring did there.

    The torque in a gear is what the motor does not keep for itself, n (u - J_m q_m'' - friction), so it is measured;
    its part about the mean is added to gravity's torque and put through the inverse spring law of `robot`. Springs
    across the transmission get none (they are taken as linear).

    **Arguments:** `robot`: with its springs' law. `data`: periodic records with arm configurations q.

    **Returns:** the points, one for each position: arm angles, and samples of the springs' deflections, rad.

    **Raises:** `jaxfrf.InputError` for a record without a period, without q, or of another number of axes.

    **Source:** the motor's equation of motion, above, and Newton's method on the springs' law: this project's own.
    """
    return points_under(robot, np.asarray(data.q), varying_gear_torque(robot, data))


def points_under(
    robot: Robot, q: Float[np.ndarray, "pos axis"], torque: Float[np.ndarray, "pos sample gear"]
) -> RobotPoint:
    """Operating points at which the torque in the gears goes by these samples about gravity's."""
    return RobotPoint(np.asarray(q), deflections_about_rest(robot, q, torque))


def varying_gear_torque(robot: Robot, data: Experiment) -> Float[np.ndarray, "pos sample gear"]:
    """Samples of the torque in every flexible transmission about its mean, arm side, N m.

    From the part of one mean period up to 1.5 times the highest line, where the excitation and its slow sine are:
    beyond, ripple and noise differentiated twice would rule."""
    check_axes(robot, data)
    found = []
    for pos in range(data.n_pos):
        every = gear_torque(robot, motion(data, pos)).reshape(-1, len(robot.flexible_axes))
        found.append(every[np.linspace(0, len(every) - 1, _SAMPLES).astype(int)])
    return np.stack(found)


def check_axes(robot: Robot, data: Experiment) -> None:
    """Refuse records that are not of all motors of the robot, at known arm angles."""
    expect("robot", robot, Robot)
    expect("data", data, Experiment)
    if data.q is None or data.q.shape[-1] != robot.n_axes:
        raise input_error(
            "q of the records",
            "none" if data.q is None else f"{data.q.shape[-1]} angles",
            f"the {robot.n_axes} arm angles of {robot.name} at every position",
            "Store q with the records.",
        )
    channels = data.u.shape[-1], data.y.shape[-1]
    if channels != (robot.n_axes, robot.n_axes):
        raise input_error(
            "record",
            f"{channels[0]} inputs and {channels[1]} outputs",
            f"{robot.n_axes} of both, the motors of {robot.name}",
            "Read the channels of all its axes, in the robot's order.",
        )


class MeanMotion(eqx.Module):
    """One mean period of every experiment up to 1.5 times the highest line, coarsely sampled: torque command (N m),
    motor `angle` about its mean (rad), `speed` and `acceleration`, (exp, time, axis); `step`: between spectral lines,
    Hz."""

    torque: Float[np.ndarray, "exp time axis"]
    angle: Float[np.ndarray, "exp time axis"]
    speed: Float[np.ndarray, "exp time axis"]
    acceleration: Float[np.ndarray, "exp time axis"]
    step: float


def motion(data: Experiment, pos: int) -> MeanMotion:
    """The motion at a position, from periodic records.

    **Raises:** `jaxfrf.InputError` for a record without a period."""
    if not data.period:
        raise input_error("record", "no period", "a periodic record", "Say its period (--set period=N).")
    steady = slice(data.transient_periods * data.period, (data.transient_periods + data.n_periods) * data.period)
    mean = lambda x: np.asarray(x)[pos, :, steady].reshape(data.n_exp, data.n_periods, data.period, -1).mean(axis=1)
    step = data.fs / data.period
    count = min(int(_BEYOND * max(known_lines(data))) + 1, data.period // 2)
    U, Y = (np.fft.rfft(mean(x), axis=1)[:, :count] / data.period for x in (data.u, data.y))
    s = 2j * np.pi * np.arange(count)[:, None] * step
    per = s ** derivatives(data.y_quantity)
    angle = np.divide(Y, per, out=np.zeros_like(Y), where=s != 0)
    back = lambda X: np.fft.irfft(X, 2 * count, axis=1) * 2 * count
    return MeanMotion(back(U), back(angle), back(s * angle), back(s**2 * angle), step)


def gear_torque(robot: Robot, moved: MeanMotion) -> Float[np.ndarray, "exp time gear"]:
    """Torque in every flexible transmission about its mean, arm side, N m: what the motors do not keep for
    themselves."""
    gear, inertia = (np.asarray(x) for x in (robot.drives.gear_ratio, robot.drives.motor_inertia))
    rubbing = np.asarray(robot.drives.friction.torque(jnp.asarray(moved.speed)))
    in_gear = (gear * (moved.torque - inertia * moved.acceleration - rubbing))[..., list(robot.flexible_axes)]
    return in_gear - in_gear.mean(axis=1, keepdims=True)


def deflections_about_rest(
    robot: Robot, q: Float[np.ndarray, "pos axis"], torque: Float[np.ndarray, "pos sample gear"]
) -> Float[np.ndarray, "pos sample spring"]:
    """Deflections about the point of rest that a torque in the gears (about gravity's) makes, rad."""
    point = operating_point(robot, np.asarray(q))
    held = np.asarray(robot.springs.torque(point.deflection, jnp.zeros_like(point.deflection)))
    return deflections(robot, held, torque) - np.asarray(point.deflection)[..., None, :]


def deflections(
    robot: Robot, held: Float[np.ndarray, "*pos spring"], torque: Float[np.ndarray, "*pos sample gear"]
) -> Float[np.ndarray, "*pos sample spring"]:
    """Deflections of the springs, rad, under the torque `held` in them and this one in the gears beside it."""
    none = np.zeros((*torque.shape[:-1], held.shape[-1] - torque.shape[-1]))  # in springs across the transmission
    total = held[..., None, :] + np.concatenate([torque, none], axis=-1)
    x = total / np.asarray(robot.springs.stiffness)
    # Newton's method; a stiffening spring is convex on either side, so that it never turns back.
    for _ in range(12):
        force = np.asarray(robot.springs.torque(jnp.asarray(x), jnp.zeros_like(x)))
        x = x - (force - total) / np.asarray(robot.springs.tangent(jnp.asarray(x)))
    return x
