"""A record as the diagnosis uses it: lines of torque and motion of every run, and their noise."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.fft
import scipy.ndimage
from jaxtyping import Complex, Float, Int

from .._errors import input_error
from .._text import number
from ..effects import Payload
from ..experiment import Experiment
from ..robot.quantity import derivatives
from ..spectra import known_lines

_QUIET = (0.25, 0.475)  # of the sampling frequency: beyond what moves
_BEYOND = 1.25  # times the highest line, where the excitation reaches into that band
_AROUND = 41  # lines over which the scatter between periods is smoothed


class Measured(eqx.Module):
    """Lines from 0 to the highest excited one of the mean steady period, all of them.

    **Fields:** `data`: the record. `U`: N m, `Y`: rad, (pos, exp, line, axis), amplitudes of one period; the mean motor
    position is left out. `noise`: rms amplitude of noise in every line of `Y`, rad, (line, axis), whatever was logged.
    `frequency`: (line,), Hz. `payloads`: what the robot carries at each position beside what it is given with, `None`
    for nothing; empty where that is so everywhere.
    """

    data: Experiment
    U: Complex[np.ndarray, "pos exp line axis"]
    Y: Complex[np.ndarray, "pos exp line axis"]
    noise: Float[np.ndarray, "line axis"]
    frequency: Float[np.ndarray, "line"]
    payloads: tuple[Payload | None, ...] = ()

    def at(self, positions) -> "Measured":
        """Some of the positions."""
        positions = np.asarray(positions, int)
        d = self.data
        some = lambda x: np.asarray(x)[positions]
        r, q = (None if x is None else some(x) for x in (d.r, d.q))
        data = dataclasses.replace(d, u=some(d.u), y=some(d.y), r=r, q=q)
        payloads = tuple(self.payloads[p] for p in positions) if self.payloads else ()
        return Measured(data, self.U[positions], self.Y[positions], self.noise, self.frequency, payloads)

    def fewer(self, most: int) -> "Measured":
        """Some experiments of every position, as `fewer` chooses them; the noise as all show it."""
        some = _spread(self.data.n_exp, most)
        data, U, Y = fewer(self.data, most), self.U[:, some], self.Y[:, some]
        return Measured(data, U, Y, self.noise, self.frequency, self.payloads)

    def by_payload(self) -> list[tuple[Payload | None, np.ndarray]]:
        """Every payload, and the positions at which it is carried."""
        if not self.payloads:
            return [(None, np.arange(self.data.n_pos))]
        found = []
        for payload in dict.fromkeys(map(id, self.payloads)):
            here = np.flatnonzero([id(p) == payload for p in self.payloads])
            found.append((self.payloads[here[0]], here))
        return found


def measured(data: Experiment, payloads: Sequence[Payload | None] = ()) -> Measured:
    """Lines of a periodic record.

    **Arguments:** `data`: of all motors of a robot. `payloads`: of its positions, as in `Measured`.

    **Returns:** `Measured`: torque in N m, motion in rad.

    **Raises:** `jaxfrf.InputError` for a record without period, and for one of a single period whose lines leave no
    band to see its noise in.

    **Source:** the DFT of the mean steady period, integrated by 1/(j omega); the noise of a single period is this
    project's own guess from beyond the excited band.
    """
    if not data.period:
        raise input_error(
            "record",
            "no period",
            "a periodic record, whose lines can be compared",
            "Say its period (--set period=N), or set the transmissions rigid and compare torques (`jaxfrf diagnose`).",
        )
    highest = max(known_lines(data)) * data.fs / data.period
    count = min(int(np.floor(highest * data.period / data.fs)), data.period // 2) + 1
    U, Y = (lines_of(x, data, count) for x in (data.u, data.y))
    frequency = np.arange(count) * data.fs / data.period
    s = 2j * np.pi * frequency[:, None]
    order = derivatives(data.y_quantity)
    Y[..., 1:, :] /= s[1:] ** order
    Y[..., 0, :] = 0.0
    return Measured(data, U, Y, _noise(data, order, frequency), frequency, tuple(payloads))


def turned(record: Measured) -> Float[np.ndarray, "axis"]:
    """How much of a turn each motor goes over, at all positions together; at most 1. Where they overlap, too much."""
    samples = 4 * len(record.frequency)
    course = np.fft.irfft(record.Y, n=samples, axis=2) * samples
    return np.minimum(np.ptp(course, axis=2).max(axis=1).sum(axis=0) / (2 * np.pi), 1.0)


def fewer(data: Experiment, most: int) -> Experiment:
    """Some experiments of every position, spread over those that there are.

    **Arguments:** `data`: the record. `most`: how many experiments are kept at most.

    **Returns:** the record with these.
    """
    if data.n_exp <= most:
        return data
    some = _spread(data.n_exp, most)
    pick = lambda x: np.asarray(x)[:, some]
    return dataclasses.replace(data, u=pick(data.u), y=pick(data.y), r=None if data.r is None else pick(data.r))


def _spread(count: int, most: int) -> Int[np.ndarray, "some"]:
    return np.linspace(0, count - 1, min(count, most)).round().astype(int)


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


def _noise(data: Experiment, order: int, frequency) -> Float[np.ndarray, "line axis"]:
    """rms of the noise in every line of the angle, whose derivative of this order was logged.

    Several periods show it line by line. A single one shows it beyond what moves, from where it is continued: white in
    a log of angles; in one of speeds or accelerations as steep as it is there, but not falling towards high lines (a
    central difference does fall, and its noise is overestimated).
    """
    power = _between_periods(data, len(frequency)) if data.n_periods > 1 else _continued(data, order, frequency)
    s = 2.0 * np.pi * frequency[1:, None]
    return np.concatenate([np.zeros((1, power.shape[1])), np.sqrt(power[1:]) / s**order])


def _between_periods(data: Experiment, count: int):
    """Power of the noise of the mean period, from the scatter of the periods about it, (line, axis)."""
    steady = slice(data.transient_periods * data.period, (data.transient_periods + data.n_periods) * data.period)
    power = []
    for y in data.y:
        x = np.asarray(y[:, steady]).reshape(data.n_exp, data.n_periods, data.period, -1)
        lines = scipy.fft.rfft(x, axis=2)[:, :, :count] / data.period
        power.append(np.mean(np.var(lines, axis=1, ddof=1), axis=0) / data.n_periods)
    return scipy.ndimage.uniform_filter1d(np.mean(power, axis=0), _AROUND, axis=0, mode="nearest")


def _continued(data: Experiment, order: int, frequency):
    """Power of the noise of a single period, from the band beyond what moves, (line, axis)."""
    low, high = max(_QUIET[0] * data.fs, _BEYOND * frequency[-1]), _QUIET[1] * data.fs
    if low > 0.9 * high:
        raise input_error(
            "lines",
            f"lines up to {number(frequency[-1], 4)} Hz in a single period sampled at {data.fs:g} Hz",
            f"lines up to {number(0.9 * high / _BEYOND, 4)} Hz, or two periods",
            "Use two or more steady periods, whose scatter shows the noise, or a faster sampled record.",
        )
    middle = np.sqrt(low * high)
    lower, upper = (_level(data, *band) for band in ((low, middle), (middle, high)))
    at = [np.sqrt(low * middle), np.sqrt(middle * high)]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.log(upper / lower) / np.log(at[1] / at[0])
    slope = np.clip(np.nan_to_num(slope), 0.0, 2.0 * order)
    return np.sqrt(lower * upper) * (frequency[:, None] / middle) ** slope


def _level(data: Experiment, low: float, high: float) -> Float[np.ndarray, "axis"]:
    """Usual power of a line of the log in a band, Hz."""
    band = slice(*(int(x * data.period / data.fs) for x in (low, high)))
    power = []
    for pos in range(data.n_pos):
        lines = scipy.fft.rfft(mean_period(data, pos, data.y), axis=1)[:, band] / data.period
        power.append(np.median(np.abs(lines) ** 2, axis=1))
    return np.median(np.concatenate(power), axis=0) / np.log(2.0)
