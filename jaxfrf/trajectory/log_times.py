"""When the signals of a log were taken: commands and motion may stand in it later than they were."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.fft
from jaxtyping import Float

from .._text import number
from ..experiment import Experiment

_SAME = 0.02  # of a sampling interval: times that differ by less are one, and such a time is none


class LogTimes(eqx.Module):
    """How late signals stand in a log, s, (axis,), behind its references.

    **Fields:** `command`: of u. `motion`: of y. `fs`: of the log, Hz.
    """

    command: Float[np.ndarray, "axis"]
    motion: Float[np.ndarray, "axis"]
    fs: float = eqx.field(static=True)

    @property
    def apart(self) -> Float[np.ndarray, "axis"]:
        """How late u is behind y."""
        return self.command - self.motion

    @property
    def are_together(self) -> bool:
        """Whether u and y were taken at the same time, and the references at another."""
        return bool(np.all(np.abs(self.apart) * self.fs < _SAME))

    def taken_back(self, data: Experiment) -> Experiment:
        """The record with its signals where they were, in their steady periods."""
        if self.are_together:
            return dataclasses.replace(data, r=_earlier(data.r, -self.command, data))
        return dataclasses.replace(data, u=_earlier(data.u, self.command, data), y=_earlier(data.y, self.motion, data))

    def says(self, names: Sequence[str]) -> str:
        """What is late, in words."""
        if self.are_together:
            return self._late("r", -self.command, names)
        both = (self._late("u", self.command, names), self._late("y", self.motion, names))
        return " and ".join(text for text in both if text)

    def _late(self, signal: str, times, names: Sequence[str]) -> str:
        if np.ptp(times) * self.fs < _SAME:
            text = self._of(float(np.mean(times)))
            return f"{signal} is {text}" if text else ""
        told = [f"{signal} of {name} is {text}" for name, t in zip(names, times, strict=True) if (text := self._of(t))]
        return ", ".join(told)

    def _of(self, time: float) -> str:
        samples = abs(time) * self.fs
        if samples < _SAME:
            return ""
        whole = round(samples)
        count = number(samples, 3) if abs(samples - whole) >= _SAME else whole
        way = "late" if time > 0 else "early"
        return f"{number(1e3 * abs(time), 3)} ms {way} ({count} sample{'' if count == 1 else 's'})"


def speeds_of_differences(data: Experiment) -> Experiment:
    """The record with speeds at the samples, of one whose speeds are positions less those a sample before.

    Such a difference is the mean speed since: half a sample late, and less by sin(x)/x of x = omega/(2 fs).
    """
    moved = np.array(data.y)
    steady = slice(data.transient_periods * data.period, (data.transient_periods + data.n_periods) * data.period)
    spectrum = scipy.fft.rfft(moved[:, :, steady], axis=2)
    cycles = np.fft.rfftfreq(data.n_periods * data.period)[:, None]  # of a sample
    back = np.exp(1j * np.pi * cycles) / np.sinc(cycles)
    moved[:, :, steady] = scipy.fft.irfft(spectrum * back, n=data.n_periods * data.period, axis=2)
    return dataclasses.replace(data, y=moved)


def _earlier(signal, times, data: Experiment):
    """Steady periods of a signal by so much earlier, axis by axis; whole samples exactly."""
    moved = np.array(signal)
    steady = slice(data.transient_periods * data.period, (data.transient_periods + data.n_periods) * data.period)
    for axis, time in enumerate(np.broadcast_to(times, moved.shape[-1:])):
        samples = float(time) * data.fs
        course = moved[:, :, steady, axis]
        if abs(samples - round(samples)) < _SAME:
            moved[:, :, steady, axis] = np.roll(course, -round(samples), axis=2)
            continue
        turn = np.exp(2j * np.pi * np.fft.rfftfreq(course.shape[2]) * samples)
        moved[:, :, steady, axis] = scipy.fft.irfft(scipy.fft.rfft(course, axis=2) * turn, n=course.shape[2], axis=2)
    return moved
