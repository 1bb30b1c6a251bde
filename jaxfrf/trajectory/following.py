"""The motion of a simulated robot in an experiment: it plays the references, or its motors follow the measured motion.

The second needs neither references nor the robot's controller, whatever that is (PID, notches, feed-forward of torque
or gravity), and takes logs at any rate: the motors are moved as they were measured, and the torque that this takes is
compared with the measured one.
"""

import dataclasses
import math

import numpy as np
import scipy.fft
import scipy.ndimage
from jaxtyping import Bool, Complex, Float

from ..effects import AbstractActuator
from ..experiment import Experiment
from ..robot import Robot
from ..robot.equations import friction_effects
from ..robot.quantity import derivatives
from ..simulation import Motion, imposed_motion, replay_motion
from ..simulation.runs import Progress
from .frozen import torque_path
from .measured import mean_period

_BEYOND = 4.0  # times the highest line: up to there the motion is followed, friction that turns over is in it
_PER_CYCLE = 12  # samples of the highest line, at least, in which it is followed
_UNSURE = math.sqrt(1 / 12 + 1 / 12)  # samples, of when friction turns over: within one of the log, within one held
_RUBBING = 5.0  # times the speed over which friction turns over: there it has all of its level
_AROUND = 21  # lines over which the spectrum of standing motors is smoothed
_TOGETHER = 12  # runs: few and many of them share what is compiled


def why_followed(robot: Robot, data: Experiment) -> str:
    """Why the references cannot be played; empty where they can."""
    if data.r is None:
        return "the records hold no reference"
    if robot.controller is None:
        return f"the controller of {robot.name} is not known"
    if data.fs != robot.sampling_frequency:
        return f"the log has {data.fs:g} Hz, the controller of {robot.name} {robot.sampling_frequency:g} Hz"
    return ""


def compared(robot: Robot, data: Experiment) -> str:
    """What of a robot is compared with a record, in words."""
    why = why_followed(robot, data)
    if why:
        return f"by the torque that the model needs for the measured motion: {why}"
    return "through the experiment: the robot plays the record's references under its controller"


def torque_rate(robot: Robot, data: Experiment) -> float:
    """Rate at which torque commands change, Hz: the controller's where it is known, else that of the log."""
    return data.fs if robot.controller is None else robot.sampling_frequency


def moved(
    robot: Robot, data: Experiment, highest: float, steps: int | None = None, progress: Progress | None = None
) -> Motion:
    """What the robot does in an experiment, at the samples of the log; `highest`: line, Hz.

    Where motors follow (`why_followed`), `u` is what the robot's own controller would have had to command.
    """
    if not why_followed(robot, data):
        return replay_motion(robot, data, steps=steps, chunk=_TOGETHER, progress=progress)
    finer = max(1, math.ceil(_PER_CYCLE * highest / data.fs))
    rate = data.fs * finer
    freed = dataclasses.replace(
        robot,
        effects=tuple(e for e in robot.effects if not isinstance(e, AbstractActuator)),
        sampling_frequency=rate,
    )
    speed, angle = courses(data, highest, finer)
    motion = imposed_motion(freed, speed, angle, data, chunk=_TOGETHER, progress=progress)
    frequency = np.arange(data.period // 2 + 1) * data.fs / data.period
    path = mean_ahead(frequency, rate)[:, None] * torque_path(robot, frequency, torque_rate(robot, data))
    log = slice(None, None, finer)
    return Motion(_commanded(motion.u, path, data.period), motion.y[:, :, log], motion.z[:, :, log], data.fs)


def unknown_friction(robot: Robot, data: Experiment, angle: Complex[np.ndarray, "pos exp line axis"]):
    """Noise of the torque, rms amplitude of every line, by friction that a measured motion does not tell.

    Where motors follow, the log tells when one turns over to within a sample, and what its friction changes by in that
    sample, twice its level, counts for that much too long or too short. While one stands, the friction is whatever
    holds it, anything up to its level. Both are pulses whose sign is not known. A motor counts as standing while it is
    slower than where its friction turns over, no faster than it changes by in half a sample. None where references are
    played: there the robot turns over when it does.

    **Arguments:** `angle`: lines of the measured motion, rad, from 0 on.

    **Returns:** (line, axis), N m.
    """
    count = angle.shape[2]
    if not why_followed(robot, data):
        return np.zeros((count, robot.n_axes))
    s = 2j * np.pi * np.arange(count)[:, None] * data.fs / data.period
    speed = data.period * scipy.fft.irfft(angle * s, n=data.period, axis=2).reshape(-1, data.period, robot.n_axes)
    change = np.diff(speed, axis=1)
    gained = 0.5 * np.sqrt(np.mean(change**2, axis=(0, 1)))
    turns = np.count_nonzero(np.diff(np.sign(speed), axis=1), axis=1).mean(axis=0)
    turned = _friction_step(robot, gained) * _UNSURE * np.sqrt(turns) / data.period
    smoothing = float(getattr(robot.drives.friction, "smoothing", 0.0))
    spells = _of_random_sign(np.abs(speed) < np.minimum(smoothing, gained))
    power = np.mean(np.abs(scipy.fft.rfft(spells, axis=1)[:, :count] / data.period) ** 2, axis=0) / 3.0
    held = 0.5 * _friction_step(robot, np.full(robot.n_axes, _RUBBING * smoothing))
    return np.sqrt(turned**2 + held**2 * scipy.ndimage.uniform_filter1d(power, _AROUND, axis=0, mode="nearest"))


def _of_random_sign(true: Bool[np.ndarray, "run time axis"]) -> Float[np.ndarray, "run time axis"]:
    """Each uninterrupted spell as +1 or -1, 0 between them."""
    signs, found = np.random.default_rng(0), np.zeros(true.shape)
    for run, axis in np.ndindex(true.shape[0], true.shape[2]):
        spell, count = scipy.ndimage.label(true[run, :, axis])
        found[run, :, axis] = np.append(0.0, signs.choice([-1.0, 1.0], count))[spell]
    return found


def _friction_step(robot: Robot, speed: Float[np.ndarray, "axis"]) -> Float[np.ndarray, "axis"]:
    """By how much friction without load differs between this speed and its opposite, N m."""
    both = np.stack([speed, -speed])
    torque = robot.drives.friction.torque(both) + friction_effects(robot, both, np.zeros_like(both))
    return np.abs(np.asarray(torque[0] - torque[1]))


def mean_ahead(frequency, rate: float) -> Complex[np.ndarray, "line"]:
    """Of a signal, the mean of a sample from every sample on, as a factor of its lines."""
    half = 1j * np.pi * np.asarray(frequency) / rate
    return np.exp(half) * np.sinc(half.imag / np.pi)


def _commanded(u, path, period: int) -> Float[np.ndarray, "pos exp time axis"]:
    """Periodic torques ahead of this path, in so many samples."""
    found = np.empty((*u.shape[:2], period, u.shape[-1]))
    for pos, runs in enumerate(u):
        lines = scipy.fft.rfft(runs, axis=1)[:, : len(path)] / path
        found[pos] = scipy.fft.irfft(lines, n=period, axis=1) * (period / runs.shape[1])
    return found


def courses(data: Experiment, highest: float, finer: int = 1):
    """Mean period of the measured motion of the motors about its mean, up to `_BEYOND` times the highest line: speed
    and angle, (run, time, axis), rad/s and rad; sampled `finer` times as fast."""
    length = data.period * finer
    angle = np.empty((data.n_pos, data.n_exp, length, data.n_out))
    speed = np.empty_like(angle)
    count = min(int(_BEYOND * highest * data.period / data.fs) + 1, (data.period - 1) // 2 + 1)
    s = 2j * np.pi * np.arange(1, count)[:, None] * data.fs / data.period
    order = derivatives(data.y_quantity)
    for pos in range(data.n_pos):
        Y = np.zeros((data.n_exp, length // 2 + 1, data.n_out), complex)
        found = scipy.fft.rfft(mean_period(data, pos, data.y), axis=1)[:, 1:count] * finer
        for course, times in ((angle, -order), (speed, 1 - order)):
            Y[:, 1:count] = found * s**times
            course[pos] = scipy.fft.irfft(Y, n=length, axis=1)
    flat = lambda x: x.reshape(-1, *x.shape[2:])
    return flat(speed), flat(angle)
