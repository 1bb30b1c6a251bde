"""What a drive's linear model leaves at unexcited lines, and whether an effect explains it.

D = Y - G U at detection lines,   D = -G DFT{what the effect asks of the motor along the measured motion}
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float, Int

from ..._errors import InputError, input_error
from ...effects import AbstractActuator, Reach, library
from ...experiment import Experiment
from ...robot import Robot
from ...spectra import dft, unexcited_spectra
from ...trajectory.needed_torque import needed_torque
from ...trajectory.rigid_motion import MeasuredMotion
from ..result import Cell, Diagnosis
from ..settings import BANDS, CLEAR, CLEARLY, DISTORTION
from .channel import Rows, makes_sense
from .conclude import concluded
from .lines import AbstractLines, DriveNumbers, drive_response, folds, on_the_way, one_drive, parts
from .response import ResponseChannel

_ORDER = ("unexplained", "ambiguous", "named", "inconclusive", "sufficient")  # the first of two verdicts counts
_LINEAR = 1e-6  # of a torque: less at detection lines is rounding, the law is linear


class DistortionChannel(AbstractLines):
    """Fourier coefficients at detection lines in bands where they stand clear of the noise between periods, over their
    rms.

    The drive's linear model is found first, from the FRF of the same records (`ResponseChannel`), with what it says of
    the torque's way to the motor; effects act along the measured motion with that taken off. Blind without detection
    lines, and wrong for laws whose effect on the excited lines is large.

    **Fields:** `drive`: the diagnosis of the FRF. `clear`: of `lines`, those that are compared. `size`: of D there, in
    units of y. `noise`: variance of D at all lines. `all_lines`, `D`, `Y`: what was measured. `motion`.
    """

    compared: ClassVar = "the FRF of a single drive, and what is left of its motion at unexcited lines"
    quantity: ClassVar = "distortion"
    unit: ClassVar = "of the distortion"
    tolerance: ClassVar = DISTORTION

    robot: Robot
    drive: Diagnosis
    motion: MeasuredMotion
    lines: Int[np.ndarray, "line"]
    frequency: Float[np.ndarray, "line"]
    D: Complex[np.ndarray, "line"]
    Y: Complex[np.ndarray, "line"]
    noise: Float[np.ndarray, "line"]
    clear: Int[np.ndarray, "clear"]
    size: float
    measured: Rows
    group: Int[np.ndarray, "row"]
    fold: Int[np.ndarray, "row"]
    order: int = eqx.field(static=True)

    @classmethod
    def takes(cls, robot: Robot | None, data: Sequence[Any]) -> bool:
        """Records of one drive of which nothing is known, of two periods and more, with lines left unexcited."""
        return robot is None and all(one_drive(x) and _detects(x) for x in data)

    @classmethod
    def opened(cls, robot, data):
        response = ResponseChannel.opened(robot, data)
        drive = concluded(response, None, tuple(library().values()), data[0].sources)
        return cls._compared(drive, data[0], response.order)

    def of(self, data):
        if len(data) > 1:
            raise input_error("held-out records of a drive", f"{len(data)}", "at most one", "Leave the others away.")
        return self._compared(self.drive, data[0], self.order)

    @classmethod
    def _compared(cls, drive: Diagnosis, record: Experiment, order: int) -> "DistortionChannel":
        rest = unexcited_spectra(record)
        f, U, Y = np.asarray(rest.frequency), np.mean(rest.U[0], axis=0)[:, 0], np.mean(rest.Y[0], axis=0)[:, 0]
        assert rest.noise is not None  # there are two periods
        G = _response(drive.extended, f, order)
        D, noise = Y - G * U, _noise(np.asarray(rest.noise[0]), G)
        bands = _bands(f, rest.lines, D, Y, noise)
        clear = np.concatenate([np.flatnonzero(b.here) for b in bands if b.clear] or [np.arange(len(f))])
        rms = lambda x: float(np.sqrt(np.mean(x)))
        size = max(rms(np.abs(D[clear]) ** 2), 10 ** (CLEAR / 20) * rms(noise[clear]), 1e-300)
        n = len(clear)
        return cls(
            robot=drive.extended,
            drive=drive,
            motion=_motion(record, drive.extended, order),
            lines=np.asarray(rest.lines),
            frequency=f[clear],
            D=D,
            Y=Y,
            noise=noise,
            clear=clear,
            size=size,
            measured=parts(D[clear]) / size * np.sqrt(2.0),
            group=np.zeros(2 * n, int),
            fold=folds(n),
            order=order,
        )

    def own(self):
        return {}

    def tried(self, kind, joint):
        if issubclass(kind, AbstractActuator):
            raise input_error(kind.name, "a linear effect, or one without inverse", "what distorts", "See the FRF.")
        reach = lambda x: float(np.max(np.abs(x)))
        m = self.motion
        return kind.along_motion(self.robot, joint, Reach(reach(m.speed), float(np.ptp(m.angle)), reach(m.torque)))

    def sensible(self, candidate, values):
        return makes_sense(self.robot, candidate, values, np.inf, bounded=False)

    def predicted(self, state):
        needs = lambda robot: needed_torque(_mechanics(robot), self.motion)[:, 0]
        torque = needs(state.robot()) - needs(self.robot)
        spectrum = np.fft.rfft(torque) / len(torque)
        seen = spectrum[self.lines[self.clear]]
        if np.linalg.norm(seen) < _LINEAR * np.linalg.norm(spectrum):
            return np.zeros_like(self.measured)
        return -parts(_response(self.robot, self.frequency, self.order) * seen) / self.size * np.sqrt(2.0)

    def floor(self, residual):
        return np.repeat(np.sqrt(self.noise[self.clear]) / self.size, 2)

    def where(self, outcome, cells):
        """Odd and even levels by bands."""
        f = self.lines * self.motion.fs / len(self.motion.angle)
        bands = _bands(f, self.lines, self.D, self.Y, self.noise)
        return tuple(
            Cell(None, self.robot.axis_names[0], (b.low, b.high), 10 ** ((b.level - b.noise) / 20), b.says)
            for b in bands
        )

    def joined(self, found):
        """Beside the diagnosis of the FRF: the more serious verdict counts."""
        drive, clear = self.drive, any(c.z > 10 ** (CLEAR / 20) for c in found.where)
        verdict = min(drive.verdict, found.verdict, key=_ORDER.index)
        says = f"FRF: {drive.says} Distortion: {found.says if clear else 'none stands clear of the noise.'}"
        return dataclasses.replace(
            drive,
            verdict=verdict,
            says=says,
            effects=drive.effects + found.effects,
            ranking=drive.ranking + found.ranking,
            where=drive.where + found.where,
            extended=found.extended,
            compared=self.compared,
            next_experiment="; ".join(x for x in (drive.next_experiment, found.next_experiment) if x),
            settings=drive.settings | {"distortion": {"verdict": found.verdict, **found.settings}},
        )


class _Band(eqx.Module):
    """Levels in dB of one unit of y: of D (`level`), of Y at odd and even lines, of the noise."""

    low: float
    high: float
    here: np.ndarray
    level: float
    odd: float
    even: float
    noise: float

    @property
    def clear(self) -> bool:
        return self.level > self.noise + CLEAR

    @property
    def says(self) -> str:
        apart = self.odd - self.even
        kind = "odd, as friction makes it" if apart > CLEARLY else "even" if apart < -CLEARLY else "odd and even"
        levels = f"odd lines {self.odd:.0f} dB, even {self.even:.0f} dB, noise {self.noise:.0f} dB"
        what = f"distortion, {kind}" if self.clear else "no distortion clear of the noise"
        return (
            f"{self.low:.3g} to {self.high:.3g} Hz: {what}: {levels} (without the reaction of u {self.level:.0f} dB)."
        )


def _bands(f, lines, D, Y, noise) -> list[_Band]:
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), BANDS + 1)
    db = lambda power: float(10 * np.log10(max(float(np.mean(power)), 1e-300))) if len(power) else float("nan")
    found = []
    for low, high in itertools.pairwise(edges):
        here = (f >= low) & (f < high)
        if here.any():
            of = lambda k, here=here: db(np.abs(Y[here & (lines % 2 == k)]) ** 2)
            found.append(_Band(float(low), float(high), here, db(np.abs(D[here]) ** 2), of(1), of(0), db(noise[here])))
    return found


def _detects(record: Experiment) -> bool:
    try:
        return record.n_periods > 1 and len(unexcited_spectra(record).lines) >= 2 * BANDS
    except InputError:
        return False


def _noise(covariance, G) -> Float[np.ndarray, "line"]:
    """Variance of D by that of [Y, U], (exp, line, 2, 2), over the mean of the experiments: in closed loop that of Y
    alone is what the loop leaves of it."""
    own = np.stack([np.ones_like(G), -G], axis=-1)
    return np.einsum("li,elij,lj->l", own, covariance, own.conj()).real / len(covariance) ** 2


def _response(robot: Robot, f, order: int):
    return drive_response(DriveNumbers.of(robot), robot.effects, f, order)


def _mechanics(robot: Robot) -> Robot:
    """The robot without what happens to its command."""
    return dataclasses.replace(robot, effects=tuple(e for e in robot.effects if not isinstance(e, AbstractActuator)))


def _motion(record: Experiment, robot: Robot, order: int) -> MeasuredMotion:
    """One period of the motion at the excited lines, what is late taken off: there a linear law makes no distortion."""
    excited, n = dft(record), record.period
    s = 2j * np.pi * np.asarray(excited.frequency)
    late = np.ones_like(s)
    for e in robot.effects:
        if isinstance(e, AbstractActuator) and not e.is_mechanical:
            late = late * on_the_way(e, s)
    moved, driven = (np.mean(X[0], axis=0)[:, 0] for X in (excited.Y / late[:, None], excited.U))

    def back(values):
        X = np.zeros(n // 2 + 1, complex)
        X[excited.lines] = values
        return np.fft.irfft(X * n, n)[:, None]

    angle, speed, acceleration = (back(moved * s ** (k - order)) for k in range(3))
    return MeasuredMotion(angle, speed, acceleration, torque=back(driven), fs=record.fs, cutoff=0.4 * record.fs)
