"""A record as the diagnosis uses it: lines of torque and motion of every run, and their noise."""

import dataclasses

import equinox as eqx
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float

from .._errors import input_error
from ..experiment import Experiment
from ..robot.quantity import derivatives

_HIGHEST = 80.0  # Hz, where the excitation says nothing else
_QUIET = (0.25, 0.475)  # of the sampling frequency: beyond what moves


class Measured(eqx.Module):
    """Lines from 0 to the highest excited one of the mean steady period, all of them.

    **Fields:** `data`: the record. `U`: N m, `Y`: rad, (pos, exp, line, axis), amplitudes of one period; the mean motor
    position is left out. `noise`: rms amplitude of noise in a line of `Y`, (axis,). `frequency`: (line,), Hz.
    """

    data: Experiment
    U: Complex[np.ndarray, "pos exp line axis"]
    Y: Complex[np.ndarray, "pos exp line axis"]
    noise: Float[np.ndarray, "axis"]
    frequency: Float[np.ndarray, "line"]

    def at(self, positions) -> "Measured":
        """Some of the positions."""
        positions = np.asarray(positions, int)
        d = self.data
        data = eqx.tree_at(
            lambda x: (x.u, x.y, x.r, x.q), d, tuple(np.asarray(x)[positions] for x in (d.u, d.y, d.r, d.q))
        )
        return Measured(data, self.U[positions], self.Y[positions], self.noise, self.frequency)


def measured(data: Experiment) -> Measured:
    """Lines of a periodic record.

    **Raises:** `jaxfrf.InputError` for a record without period.
    """
    if not data.period:
        raise input_error(
            "record",
            "no period",
            "a periodic record, whose lines can be compared",
            "Say its period (--set period=N), or compare torques of the measured motion (`diagnose_torque`).",
        )
    highest = _HIGHEST if data.lines is None or not len(data.lines) else max(data.lines) * data.fs / data.period
    count = int(np.floor(highest * data.period / data.fs)) + 1
    U, Y = (lines_of(x, data, count) for x in (data.u, data.y))
    frequency = np.arange(count) * data.fs / data.period
    s = 2j * np.pi * frequency[:, None]
    order = derivatives(data.y_quantity)
    Y[..., 1:, :] /= s[1:] ** order
    Y[..., 0, :] = 0.0
    return Measured(data, U, Y, _noise(data, order), frequency)


def fewer(data: Experiment, most: int) -> Experiment:
    """Some experiments of every position, spread over those that there are."""
    if data.n_exp <= most:
        return data
    some = np.linspace(0, data.n_exp - 1, most).round().astype(int)
    pick = lambda x: None if x is None else np.asarray(x)[:, some]
    return dataclasses.replace(data, u=pick(data.u), y=pick(data.y), r=pick(data.r))


def mean_period(data: Experiment, pos: int, signal=None) -> Float[np.ndarray, "exp time channel"]:
    """Mean steady period of a signal, the torque command if not given, at one position."""
    steady = slice(data.transient_periods * data.period, (data.transient_periods + data.n_periods) * data.period)
    x = np.asarray((data.u if signal is None else signal)[pos, :, steady])
    return x.reshape(data.n_exp, data.n_periods, data.period, -1).mean(axis=1)


def lines_of(signal, data: Experiment, count: int) -> Complex[np.ndarray, "pos exp line axis"]:
    """Leading lines of the mean steady period, position by position."""
    result = np.empty((data.n_pos, data.n_exp, count, signal.shape[-1]), complex)
    for pos in range(data.n_pos):
        result[pos] = scipy.fft.rfft(mean_period(data, pos, signal), axis=1)[:, :count] / data.period
    return result


def _noise(data: Experiment, order: int):
    """Of a line of the position, from the part of the record beyond what moves, where it is white as measured."""
    low, high = (int(x * data.period) for x in _QUIET)
    power = []
    for pos in range(data.n_pos):
        lines = scipy.fft.rfft(mean_period(data, pos, data.y), axis=1)[:, low:high] / data.period
        power.append(np.median(np.abs(lines) ** 2, axis=1))
    level = np.median(np.concatenate(power), axis=0) / np.log(2.0)
    return np.sqrt(level)
