"""Measured motion for inverse dynamics: filtered derivatives of records, and the torque that acted meanwhile."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
import scipy.signal
from jaxtyping import Float

from .._errors import input_error
from ..experiment import QUANTITIES, Experiment
from ..robot import Robot, arm_inertia_and_bias
from ..robot.equations import motor_angles

_ABOVE_FLOOR = 10.0  # power over the floor of y, up to which its derivatives are believed
_BEYOND = 2.5  # times that band: friction turns over with the sign of the speed, which a narrow filter would round
COMPARED = 0.2  # of the cut-off: where torques are compared, and noise beyond it is taken off both sides
_ORDER = 4
_CONFIGURATIONS = 4  # that are asked whether torques depend on them
_ROUNDING = 1e-6  # of a torque or inertia; jax may compute in single precision


class MeasuredMotion(eqx.Module):
    """One record as inverse dynamics needs it, motor side, every sample.

    **Fields:** `angle`, `speed`, `acceleration`: (time, axis), rad, rad/s, rad/s^2; the angle is 0 where those of the
    joints are, whatever the log reads there. `torque`: (time, axis), N m, the
    mean of the command around every sample (a command is held until the next sample, so that at a sample half of the
    last and half of the next have acted). `fs`, `cutoff`: Hz.
    """

    angle: Float[np.ndarray, "time axis"]
    speed: Float[np.ndarray, "time axis"]
    acceleration: Float[np.ndarray, "time axis"]
    torque: Float[np.ndarray, "time axis"]
    fs: float = eqx.field(static=True)
    cutoff: float = eqx.field(static=True)


def measured_motions(robot: Robot, data: Experiment, cutoff: float) -> tuple[MeasuredMotion, ...]:
    """Every record of the data, position by position, as a `MeasuredMotion`.

    y goes through a Butterworth filter of order 4 at `cutoff` (Hz), forth and back (no phase); derivatives are central
    differences, integrals trapezoids about the configuration q. Transient periods are dropped. An acceleration is
    integrated as if the speed came back to where it was. A q that is not the joints' mean biases
    what depends on it.

    **Raises:** `jaxfrf.InputError` where the record has other channels than the robot has motors; where angles were
    not logged, there is no q, and the torque depends on them.
    """
    for name, width in (("u", data.n_in), ("y", data.n_out)):
        if width != robot.n_axes:
            raise input_error(
                f"{name} of the records",
                f"{width} channels",
                f"{robot.n_axes}, one for each motor of {robot.name}",
                "Pick them (--map).",
            )
    if data.q is None and QUANTITIES[data.y_quantity] and _asks_for_angles(robot):
        raise input_error(
            "q of the records",
            f"none, and a {data.y_quantity} as y",
            f"the mean angles of the joints: the torque of {robot.name} depends on them, and a {data.y_quantity} tells "
            "them up to a constant",
            'State them (--set "q=0.3;-0.7", rad, arm side), or log positions (--set y_quantity=position).',
        )
    first = data.transient_periods * data.period
    records = [(pos, exp) for pos in range(data.n_pos) for exp in range(data.n_exp)]
    rest = np.zeros((data.n_pos, robot.n_axes)) if data.q is None else np.asarray(data.q)[:, : robot.n_axes]
    rest = np.asarray(motor_angles(robot, jnp.asarray(rest)))
    y = np.asarray(data.y if QUANTITIES[data.y_quantity] else robot.drives.turned(data.y))
    return tuple(
        _motion(data.u[pos, exp, first:], y[pos, exp, first:], data, rest[pos], cutoff) for pos, exp in records
    )


def _asks_for_angles(robot: Robot) -> bool:
    """Whether gravity or inertia are others where all joints stand elsewhere."""
    rng = np.random.default_rng(0)
    arm, rate = rng.uniform(-1.0, 1.0, (2, _CONFIGURATIONS, len(robot.arm_joints)))
    matrix, bias = arm_inertia_and_bias(robot, jnp.asarray(arm), jnp.broadcast_to(jnp.asarray(rate[0]), rate.shape))
    largest = max(float(jnp.abs(x).max()) for x in (matrix, bias))
    return any(float(jnp.ptp(x, axis=0).max()) > _ROUNDING * largest for x in (matrix, bias))


def _motion(u, y, data: Experiment, rest, cutoff: float) -> MeasuredMotion:
    order, fs = QUANTITIES[data.y_quantity], data.fs
    known = smooth(y, fs, cutoff)
    if order == 2:
        known = known - known.mean(axis=0)
    below = [known]
    for _ in range(order):
        below.insert(0, _integral(below[0], fs, rest if len(below) == order else 0.0))
    while len(below) < 3:
        below.append(np.gradient(below[-1], 1.0 / fs, axis=0))
    angle, speed, acceleration = below
    return MeasuredMotion(angle, speed, acceleration, torque=held(np.asarray(u)), fs=fs, cutoff=cutoff)


def held(u: Float[np.ndarray, "time axis"]) -> Float[np.ndarray, "time axis"]:
    """Mean torque about every sample of a command that is held until the next one."""
    return np.concatenate([u[:1], 0.5 * (u[1:] + u[:-1])])


def _integral(x, fs: float, mean):
    total = np.concatenate([np.zeros_like(x[:1]), np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0)]) / fs
    return total - total.mean(axis=0) + mean


def check_rigid(robot: Robot) -> None:
    """Refuse a robot whose arm moves otherwise than its motors do."""
    if robot.n_motors or robot.n_elastic:
        raise input_error(
            f"transmissions of {robot.name}",
            f"springs at {', '.join(robot.spring_names)}, and a record that is not periodic",
            "a periodic record, or rigid transmissions (stiffness = inf): the motors' motion is then the arm's",
            "Say its period (--set period=N), or set the transmissions rigid for a look at the slow motion.",
        )


def smooth(x: Float[np.ndarray, "time ..."], fs: float, cutoff: float) -> Float[np.ndarray, "time ..."]:
    """Low-pass without phase: Butterworth of order 4, forth and back."""
    return scipy.signal.sosfiltfilt(scipy.signal.butter(_ORDER, cutoff, fs=fs, output="sos"), x, axis=0)


def thinned(motion: MeasuredMotion, x: Float[np.ndarray, "time ..."]) -> Float[np.ndarray, "row ..."]:
    """Torques of either side alike: low-pass at a fifth of the motion's cut-off, ends cut, as many samples as it takes.

    What the filter does to the measured torque it does to the model's ("parallel filtering and decimation": Gautier,
    Janot & Vandanjon, IEEE Trans. Control Syst. Technol. 21, 2013), so that it biases neither.
    """
    low = COMPARED * motion.cutoff
    end = int(np.ceil(motion.fs / low))
    return smooth(x, motion.fs, low)[end : len(x) - end : _step(motion)]


def thinned_rate(motion: MeasuredMotion) -> float:
    """Samples of a second of what `thinned` leaves, Hz."""
    return motion.fs / _step(motion)


def _step(motion: MeasuredMotion) -> int:
    return max(int(0.4 * motion.fs / (COMPARED * motion.cutoff)), 1)


def chosen_cutoff(data: Experiment) -> float:
    """Cut-off of the motion's filter, Hz: 2.5 times the band in which y stands 10 dB above its own noise floor, of the
    channel with the narrowest.

    The floor is the median of the power spectral density in the upper quarter of the band, where a mechanical drive
    moves least. The result stays within 2.5 Hz and .4 fs.
    """
    y = np.asarray(data.y)
    f, power = scipy.signal.welch(y, data.fs, nperseg=min(4096, data.n_time), axis=2, detrend="linear")
    power = np.moveaxis(power, 2, -1).reshape(-1, data.n_out, len(f)).mean(axis=0)
    width = max(len(f) // 100, 1)
    level = scipy.ndimage.median_filter(power, size=(1, 2 * width + 1))
    floor = np.median(power[:, f > 0.375 * data.fs], axis=1, keepdims=True)
    below = level < _ABOVE_FLOOR * floor
    first = np.where(below.any(axis=1), f[np.argmax(below, axis=1)], f[-1])
    return float(np.clip(_BEYOND * first.min(), _BEYOND, 0.4 * data.fs))
