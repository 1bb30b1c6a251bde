"""The response of an arm that moves slowly while it is measured."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._arguments import expect
from .._errors import input_error
from .._types import Array
from ..experiment import Experiment
from ..robot import Robot, operating_point
from ..robot.quantity import derivatives
from .deflections import check_axes, deflections, gear_torque, motion, robot_points
from .model import AbstractModel, RobotModel, RobotPoint

_PLACES = 89  # of the slow motion: a number of Fibonacci's, with which the golden section is even
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_SAMPLES = 144  # of the fast motion
_STILL = 1e-3  # rad: an arm that moves less has one response


class SlowMotion(eqx.Module):
    """Where an arm was while it was measured, in places that follow each other evenly in time.

    **Fields:** `q`: arm angles, (pos, place, axis), rad. `torque`: in the flexible transmissions about its mean, slow
    part, (pos, place, gear), N m. `fast`: samples of the rest of it, (pos, sample, gear), N m.
    """

    q: Float[np.ndarray, "pos place axis"]
    torque: Float[np.ndarray, "pos place gear"]
    fast: Float[np.ndarray, "pos sample gear"]


def slow_motion(robot: Robot, data: Experiment, below: float) -> SlowMotion | None:
    """The slow motion in periodic records; `None` where the arm stays within a milliradian.

    From the mean period, every line of which up to `below` counts. Robots whose axes turn each other through their
    gears are taken as if they did not: the motion is small.

    **Arguments:** `robot`: whose motors moved. `data`: periodic records of them, with arm angles `q`, rad. `below`: the
    highest frequency that counts as slow, Hz.

    **Returns:** a `SlowMotion`: arm angles in rad, torques in the gears in N m.

    **Raises:** `jaxfrf.InputError` for records without a period, without q, or of another number of axes.

    **Source:** this project's own: the lines below `below` of the mean period, integrated.
    """
    check_axes(robot, data)
    gear = np.asarray(robot.drives.gear_ratio)
    q, torque, fast = [], [], []
    for pos in range(data.n_pos):
        moved = motion(data, pos)
        in_gear = gear_torque(robot, moved)
        slow, angle = (_below(x, moved.step, below) for x in (in_gear, moved.angle))
        at = _spread(_PLACES, *angle.shape[:2])
        q.append(np.asarray(data.q)[pos] + angle[at] / gear)
        torque.append(slow[at])
        fast.append((in_gear - slow)[_spread(_SAMPLES, *angle.shape[:2])])
    found = SlowMotion(np.stack(q), np.stack(torque), np.stack(fast))
    still = np.abs(found.q - np.asarray(data.q)[:, None]).max() < _STILL
    return None if still else found


def _spread(count: int, n_exp: int, n_time: int) -> tuple[np.ndarray, np.ndarray]:
    """Experiments and samples to take: by the golden section, which no line of the motion keeps step with."""
    i = np.arange(count)
    return i % n_exp, (n_time * ((i + 0.5) * _GOLDEN % 1.0)).astype(int)


def _below(x: Float[np.ndarray, "exp time channel"], step: float, frequency: float) -> np.ndarray:
    """The part of periodic signals at lines up to a frequency."""
    X = np.fft.rfft(x, axis=1)
    X[:, int(frequency / step) + 1 :] = 0
    return np.fft.irfft(X, x.shape[1], axis=1)


def moving_response(
    model: RobotModel,
    values: dict,
    frequency: Float[Array, "freq"],
    q: Float[Array, "pos axis"],
    slow: SlowMotion,
) -> Complex[np.ndarray, "pos freq out in"]:
    """The FRF that an estimator finds of a robot in slow motion.

    With the arm at place p it answers by G_p, and in closed loop its torque by W_p = (I + C G_p)^-1 times something
    that is the same everywhere. What the two joint spectra have in common with the reference are their means, so that
    the estimate is <G W> <W>^-1: places where the loop lets torque through count more. Without controller: <G>.

    Biased where the motion is not slow against the width of resonances: it counts the places, not the way between them.

    **Arguments:** `model`: of the robot. `values`: {name: value} of all its parameters, in their units. `frequency`:
    (freq,), Hz. `q`: arm angles at rest, (pos, axis), rad. `slow`: where the arm was, of `slow_motion`.

    **Returns:** (pos, freq, out, in), in the quantity of the model.

    **Raises:** `jaxfrf.InputError` where q or the motion have another number of axes than the robot.

    **Source:** the equations above, this project's own.
    """
    expect("model", model, RobotModel)
    for name, angles in (("q", q), ("q of the slow motion", slow.q)):
        if np.shape(angles)[-1:] != (model.robot.n_axes,):
            raise input_error(
                name, f"shape {np.shape(angles)}", f"{model.robot.n_axes} arm angles in the last axis", "Check q."
            )
    robot = model.at(values)
    at_rest = operating_point(robot, np.asarray(q)).deflection
    held = np.asarray(robot.springs.torque(at_rest, jnp.zeros_like(at_rest)))
    x = deflections(robot, held[:, None], slow.torque[:, :, None] + slow.fast[:, None])
    rest = np.asarray(operating_point(robot, slow.q).deflection)
    points = RobotPoint(slow.q, x - rest[:, :, None])
    feedback = _feedback(robot, np.asarray(frequency), model.quantity)
    return np.asarray(_mean_response(model, _arrays(values), jnp.asarray(frequency), feedback, points))


def response_in_motion(
    model: RobotModel, values: dict, frequency: Float[Array, "freq"], data: Experiment
) -> Complex[np.ndarray, "pos freq out in"]:
    """The FRF that these periodic records would show of a robot with these parameters, without simulating them.

    See `moving_response` for what it leaves out.

    **Arguments:** `model`: of the robot. `values`: {name: value} of its parameters, in their units. `frequency`:
    (freq,), Hz. `data`: periodic records with `q` (rad).

    **Returns:** (pos, freq, out, in), in the quantity of the model.

    **Raises:** `jaxfrf.InputError` for records without a period, without q, or of another number of axes.

    **Source:** as of `moving_response`; that of the linear model where the arm stays still.
    """
    expect("model", model, RobotModel)
    slow = slow_motion(model.robot, data, slow_limit(frequency))
    if slow is not None:
        return moving_response(model, values, frequency, np.asarray(data.q), slow)
    return response_at(model, values, frequency, robot_points(model.at(values), data))


def response_at(
    model: AbstractModel, values: dict, frequency: Float[Array, "freq"], points: RobotPoint
) -> Complex[np.ndarray, "pos freq out in"]:
    """The linear response at operating points."""
    return np.asarray(_response(model, _arrays(values), jnp.asarray(frequency), points))


def _arrays(values: dict) -> dict:
    """The same as arrays: for other values nothing is compiled again."""
    return {name: jnp.asarray(value, float) for name, value in values.items()}


def slow_limit(frequency: Float[Array, "freq"]) -> float:
    """The highest frequency that counts as slow beside an FRF at these lines, Hz."""
    return 0.5 * float(np.min(frequency))


@eqx.filter_jit
def _response(model: AbstractModel, values, frequency, points: RobotPoint):
    return jax.lax.map(lambda point: model.response(frequency, values, point), points)


def _feedback(robot: Robot, frequency, quantity: str):
    """Torque per motor motion in this quantity that the controller takes back, (freq, axis); 0 without controller."""
    if robot.controller is None:
        return np.zeros((len(frequency), robot.n_axes), complex)
    s = 2j * np.pi * frequency[:, None]
    return robot.controller.feedback(frequency, robot.sampling_frequency) / s ** derivatives(quantity)


@eqx.filter_jit
def _mean_response(model: RobotModel, values, frequency, feedback, points: RobotPoint):
    eye = jnp.eye(feedback.shape[-1])

    def at(place):
        G = model.response(frequency, values, place)
        W = jnp.linalg.inv(eye + feedback[:, :, None] * G)
        return G @ W, W

    def mean(places):
        GW, W = jax.lax.map(at, places)
        return GW.mean(axis=0) @ jnp.linalg.inv(W.mean(axis=0))

    return jax.lax.map(mean, points)
