"""The FRF of a single drive against that of a rigid inertia, as log(measured/model).

The inertia is free in units of u, so that neither a wrong torque constant nor a wrong inertia can be taken for an
effect, nor be found.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float, Int

from ..._errors import input_error
from ...effects import AbstractActuator, AbstractArmTorque, AbstractStructure
from ...experiment import QUANTITIES
from ...frf import FRF, LRM, estimate
from ...robot import Robot
from ...spectra import dft
from ...trajectory.rigid_motion import check_rigid
from ..result import Cell
from ..settings import ALIKE_RESPONSES, AT_BOUND, RESPONSE
from .channel import Outcome, Rows, makes_sense
from .lines import AbstractLines, DriveNumbers, drive_response, folds, one_drive, parts, rigid_drive

_BANDS = 10  # that are told


class ResponseChannel(AbstractLines):
    """Real and imaginary part of log(G/model), weighed by its error: noise, and `RESPONSE` that no model is asked to
    beat. Each candidate is fitted in full, a mode from several starts.

    It fails where nonlinear distortion is as large as the effect: FRFs of other realisations, held out, show it.

    **Fields:** `numbers`: of the robot; `G`: (line,); `variance`: of log G. `order`: 0 position, 1 speed, 2
    acceleration. `sample`: of the record, s; `None` of an FRF.
    """

    compared: ClassVar = "the FRF of a single drive against the model's, log(measured/model)"
    quantity: ClassVar = "log FRF residual"
    unit: ClassVar = "1"
    tolerance: ClassVar = ALIKE_RESPONSES
    linear: ClassVar = False
    tie: ClassVar = 0.0

    robot: Robot
    numbers: DriveNumbers
    G: Complex[np.ndarray, "line"]
    variance: Float[np.ndarray, "line"]
    frequency: Float[np.ndarray, "line"]
    measured: Rows
    group: Int[np.ndarray, "row"]
    fold: Int[np.ndarray, "row"]
    order: int = eqx.field(static=True)
    sample: float | None = eqx.field(static=True)

    @classmethod
    def takes(cls, robot: Robot | None, data: Sequence[Any]) -> bool:
        """FRFs, or records of one drive of which nothing is known."""
        return all(isinstance(x, FRF) or (robot is None and one_drive(x)) for x in data)

    @classmethod
    def opened(cls, robot, data):
        first, *more = data
        if more:
            raise input_error("FRFs", f"{len(data)}", "one to fit and at most one held out", "Leave the others away.")
        frf = first if isinstance(first, FRF) else estimate(dft(first), LRM(order=2))
        if (frf.n_pos, frf.n_out, frf.n_in) != (1, 1, 1):
            found = f"{frf.n_pos} positions of {frf.n_out} x {frf.n_in}"
            raise input_error("frf", found, "one position of one drive", "Pick one channel, or diagnose the records.")
        if robot is not None:
            if robot.n_axes != 1:
                raise input_error("robot", f"{robot.n_axes} axes", "one, as the FRF has", "Leave the robot out.")
            check_rigid(robot)
        order, f, G = QUANTITIES[frf.y_quantity], np.asarray(frf.frequency), np.asarray(frf.G)[0, :, 0, 0]
        variance = np.nan_to_num(np.asarray(frf.std)[0, :, 0, 0] ** 2 / np.abs(G) ** 2)
        robot = (
            rigid_drive(1.0 / float(np.median(np.abs(G * (2j * np.pi * f) ** (2 - order))))) if robot is None else robot
        )
        weight = 1.0 / np.sqrt(RESPONSE**2 + variance)
        numbers, n = DriveNumbers.of(robot), len(f)
        start = np.log(G / drive_response(numbers, robot.effects, f, order)) * weight
        rows = {"measured": parts(start), "group": np.zeros(2 * n, int), "fold": folds(n)}
        sample = None if isinstance(first, FRF) else 1.0 / first.fs
        common = {"variance": variance, "frequency": f, "order": order, "sample": sample}
        return cls(robot=robot, numbers=numbers, G=G, **common, **rows)

    def of(self, data):
        return ResponseChannel.opened(self.robot, data)

    @property
    def weight(self) -> Float[np.ndarray, "line"]:
        return 1.0 / np.sqrt(RESPONSE**2 + self.variance)

    def own(self):
        return {f"{self.robot.axis_names[0]}.motor_inertia": float(self.robot.drives.motor_inertia[0])}

    def tried(self, kind, joint):
        return kind.over_band(self.robot, joint, float(self.frequency[0]), float(self.frequency[-1]))

    def sensible(self, candidate, values):
        effect, inside = candidate.make(np.asarray(values)), (self.frequency[0], self.frequency[-1])
        frequencies = [float(getattr(effect, name)) for name, unit in effect.units.items() if unit == "Hz"]
        held = all(inside[0] < f < inside[1] for f in frequencies)
        low, high = np.array(candidate.low) + AT_BOUND, np.array(candidate.high) - AT_BOUND
        free = not candidate.start or bool(np.all((low < values) & (values < high)))
        return held and free and makes_sense(self.robot, candidate, values, np.inf, bounded=False)

    def residual(self, state):
        effects = [candidate.make(np.array(values)) for candidate, values in state.chosen]
        numbers, acting = self.numbers, (*state.given.effects, *effects)
        if state.given is not self.robot or any(isinstance(e, AbstractStructure | AbstractArmTorque) for e in effects):
            numbers = DriveNumbers.of(state.given.with_effects(*effects))
        more = sum(state.own.values()) - sum(self.own().values())
        numbers = DriveNumbers(numbers.inertia + more, numbers.friction, numbers.stiffness)
        G = drive_response(numbers, acting, self.frequency, self.order)
        return parts(np.log(self.G / G) * self.weight)

    def predicted(self, state):
        return self.measured - self.residual(state)

    def floor(self, residual):
        return np.repeat(np.sqrt(0.5 * self.variance) * self.weight, 2)

    def plain(self, rows):
        return rows / np.repeat(self.weight, 2) * np.sqrt(2.0)

    def where(self, outcome: Outcome, cells):
        """Error of the base model by bands, worst first."""
        error = outcome.before.reshape(-1, 2) @ np.array([1.0, 1.0j])
        edges = np.geomspace(self.frequency[0], self.frequency[-1] * (1 + 1e-9), _BANDS + 1)
        found = []
        for low, high in itertools.pairwise(edges):
            here = (self.frequency >= low) & (self.frequency < high)
            if here.any():
                mean = np.mean(error[here] / self.weight[here])
                level, phase = 20 / np.log(10) * mean.real, np.rad2deg(mean.imag)
                differs = f"{level:+.1f} dB and {phase:+.0f} degrees"
                says = f"{low:.3g} to {high:.3g} Hz: the measured response differs by {differs}."
                z = float(np.sqrt(np.mean(np.abs(error[here]) ** 2)))
                found.append(Cell(None, self.robot.axis_names[0], (float(low), float(high)), z, says))
        return tuple(sorted(found, key=lambda c: -c.z))

    def joined(self, found):
        """With a word on delays: a torque that is held from sample to sample, which no FRF tells from one that is
        measured, has one."""
        acting = (e.effect for e in found.effects if isinstance(e.effect, AbstractActuator))
        delay = sum(float(e.dead_time()) for e in acting)
        if delay <= 0.0:
            return found
        here = "" if self.sample is None else f" ({500.0 * self.sample:.3g} ms here)"
        says = (
            f"{found.says} A torque that is commanded and held to the next sample acts half a sample late{here}: that "
            "much of a delay is not missing, and simulations of the written robot, which hold it too, would have it "
            "twice."
        )
        return dataclasses.replace(found, says=says)
