"""What the controllers play: speed references and the positions that belong to them, from a design or a record."""

import math

import equinox as eqx
import numpy as np
import scipy.fft
import scipy.interpolate
from jaxtyping import Float, Int

from .._errors import input_error
from .._text import number
from ..excitation import Multisine, reference
from ..excitation.multisine import reference_spectra
from ..excitation.signals import one_period
from ..experiment import Experiment
from ..robot import Robot

_FADED = 0.6  # part of the run-in over which the motion fades in
_LONGEST = 1e8  # samples of a run-in: hours of computing
_DRIFT = 0.01  # rad on the arm side in a period: what a speed reference may drift by before its mean is an error

Signals = Float[np.ndarray, "track time axis"]


class References(eqx.Module):
    """References of the runs, one track for each that is different: run number i plays track i % n_tracks.

    **Fields:**

    - `velocity`, `position`: rad/s, and rad about the motor position at rest; motor side. They are repeated
      periodically for as long as a run lasts.
    - `fs`: Hz. `run_in`, `recorded`: samples played before the first recorded one, and from there on.
    """

    velocity: Signals
    position: Signals
    fs: float = eqx.field(static=True)
    run_in: int = eqx.field(static=True)
    recorded: int = eqx.field(static=True)

    @property
    def n_tracks(self) -> int:
        return len(self.velocity)

    @property
    def n_time(self) -> int:
        """Samples that a run lasts, run-in included."""
        return self.run_in + self.recorded

    def tracks(self, runs: Int[np.ndarray, "run"]) -> tuple[np.ndarray, np.ndarray]:
        """Tracks that a block of runs needs, and which of them each run plays; as many for blocks of one size."""
        wanted = runs % self.n_tracks
        every = self.n_tracks <= len(runs)
        return (np.arange(self.n_tracks), wanted) if every else (wanted, np.arange(len(runs)))

    def stretch(self, start: int, length: int, tracks: Int[np.ndarray, "track"]) -> Float[np.ndarray, "time 2 axis t"]:
        """Speed and position of some tracks, `length` samples from number `start` (0 = first of the run-in) on."""
        time = np.arange(start, start + length)
        index = np.ix_(tracks, (time - self.run_in) % self.velocity.shape[1])
        velocity, position = self.velocity[index], self.position[index]
        faded = int(_FADED * self.run_in)
        if start < faded:
            velocity, position = _fade_in(velocity, position, time[:, None] / faded, faded / self.fs)
        return np.stack([velocity, position]).transpose(2, 0, 3, 1)


def _fade_in(velocity: Signals, position: Signals, x, duration: float) -> tuple[Signals, Signals]:
    """From rest: q -> w q, v -> w' q + w v, w a quintic of x = time/duration."""
    x = np.minimum(x, 1.0)
    weight, rate = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration
    return rate * position + weight * velocity, weight * position


def references_of_design(design: Multisine, run_in: float | None) -> References:
    """Steady periods after `run_in` seconds of them; or, where that is `None`, the design from rest on."""
    if run_in is None:
        made = reference(design)
        return References(made.r, made.position, design.fs, 0, made.n_time)
    periods = [one_period(design, X) for X in reference_spectra(design)]
    velocity, position = (np.stack(x) for x in zip(*periods, strict=True))
    return References(velocity, position, design.fs, _samples(run_in, design.fs), design.periods * design.period)


def references_of_record(robot: Robot, data: Experiment, run_in: float) -> References:
    """One mean steady period after `run_in` seconds of it; a record that is not periodic, from rest once.

    **Raises:** `jaxfrf.InputError` for accelerations, and where a speed drifts away with every period.
    """
    if data.r_quantity == "acceleration":
        raise input_error(
            "r_quantity", "acceleration", "velocity or position", "A joint controller plays one of these."
        )
    run_in = _samples(run_in, data.fs)
    r = _distinct(np.asarray(data.r))
    if not data.period:
        velocity, position = _once(r, data.fs, data.r_quantity)
        return References(velocity, position, data.fs, 0, data.n_time)
    steady = r[:, data.transient_periods * data.period :]
    period = steady.reshape(len(r), data.n_periods, data.period, -1).mean(axis=1)
    mean = period.mean(axis=1, keepdims=True)
    if data.r_quantity == "velocity":
        _check_drift(robot, data, mean[:, 0])
    period -= mean
    other = _filtered(period, data.fs, -1 if data.r_quantity == "velocity" else 1)
    velocity, position = (period, other) if data.r_quantity == "velocity" else (other, period)
    return References(velocity, position, data.fs, run_in, data.period)


def _distinct(r: Float[np.ndarray, "pos exp time axis"]) -> Signals:
    """Those of the first position only, where all positions share them."""
    shared = r.strides[0] == 0 or all(np.array_equal(r[0], other) for other in r[1:])
    return r[0] if shared else r.reshape(-1, *r.shape[2:])


def _filtered(x: Signals, fs: float, times: int) -> Signals:
    """Zero-mean periodic signals times (j omega)^times: their periodic derivative or integral."""
    X = scipy.fft.rfft(x, axis=1, workers=-1)
    X[:, 0] = 0.0
    X[:, 1:] *= ((2j * np.pi * fs / x.shape[1] * np.arange(1, X.shape[1])) ** times)[:, None]
    return scipy.fft.irfft(X, n=x.shape[1], axis=1, workers=-1)


def _once(r: Signals, fs: float, quantity: str) -> tuple[Signals, Signals]:
    """Speed and position of a record that starts at rest, by the cubic spline through its samples."""
    time = np.arange(r.shape[1]) / fs
    spline = scipy.interpolate.CubicSpline(time, r, axis=1)
    if quantity == "velocity":
        return r, spline.antiderivative()(time)
    return spline.derivative()(time), r - r[:, :1]


def _check_drift(robot: Robot, data: Experiment, mean: Float[np.ndarray, "track axis"]) -> None:
    drift = np.abs(mean) * data.period / data.fs
    arm = drift / np.abs(np.asarray(robot.drives.gear_ratio))
    track, axis = (int(i) for i in np.unravel_index(np.argmax(arm), arm.shape))
    if arm[track, axis] > _DRIFT:
        raise input_error(
            "r",
            f"a mean of {number(mean[track, axis])} rad/s at position {track // data.n_exp}, experiment "
            f"{track % data.n_exp}, channel {axis}: "
            f"{robot.axis_names[axis]} drifts by {number(arm[track, axis])} rad (arm side) with every period",
            f"at most {_DRIFT:g} rad: a periodic motion returns to where it was",
            "Check the unit and the period of r, or remove its mean.",
        )


def _samples(run_in: float, fs: float) -> int:
    if not (math.isfinite(run_in) and run_in >= 0):
        raise input_error("run_in", f"{run_in}", "seconds, 0 or more", "E.g. run_in=5.0, or None.")
    if run_in * fs > _LONGEST:
        raise input_error("run_in", f"{run_in:g} s", f"at most {number(_LONGEST / fs)} s", "E.g. run_in=5.0, or None.")
    return math.ceil(run_in * fs)
