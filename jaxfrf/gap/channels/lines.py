"""Channels whose rows are lines of a single drive's spectra: real and imaginary part of each."""

import dataclasses
from collections.abc import Iterable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from ...effects import AbstractActuator, AbstractArmTorque, AbstractEffect
from ...experiment import Experiment
from ...robot import Robot, arm_inertia, robot_from_table
from ..settings import FOLDS, LINE_BLOCKS
from .channel import AbstractChannel, Rows


class AbstractLines(AbstractChannel):
    """Rows are (line, part). **Fields:** `frequency`: Hz, (line,)."""

    frequency: eqx.AbstractVar[Float[np.ndarray, "line"]]

    @property
    def n_lines(self) -> int:
        return len(self.measured) // 2

    def blocks(self, residual):
        count = min(LINE_BLOCKS, self.n_lines)
        return np.repeat(np.arange(self.n_lines) * count // self.n_lines, 2)

    def spectra(self, rows):
        power = 0.5 * np.sum(rows.reshape(-1, 2) ** 2, axis=1, keepdims=True)
        return [(self.frequency, power / len(power))]


def one_drive(x) -> bool:
    """Whether these are periodic records of one motor at one position."""
    return isinstance(x, Experiment) and (x.n_in, x.n_out, x.n_pos) == (1, 1, 1) and bool(x.period)


def parts(values: Complex[np.ndarray, "line"]) -> Rows:
    return np.stack([values.real, values.imag], axis=1).ravel()


def folds(n: int) -> np.ndarray:
    """Of rows: lines in turn."""
    return np.repeat(np.arange(n) % FOLDS, 2)


class DriveNumbers(eqx.Module):
    """What a robot of one axis with a rigid transmission is to its motor, in small motion: `inertia`, kg m^2, its
    viscous `friction`, N m s/rad, and the `stiffness` of torques on the arm, N m/rad."""

    inertia: float
    friction: float
    stiffness: float

    @classmethod
    def of(cls, robot: Robot) -> "DriveNumbers":
        square = float(robot.drives.gear_ratio[0]) ** 2
        inertia = float(arm_inertia(dataclasses.replace(robot, effects=()), np.zeros(1))[0, 0])
        friction, stiffness, still, step = 0.0, 0.0, jnp.zeros(()), jnp.asarray(1e-6)
        for effect in robot.effects:
            if isinstance(effect, AbstractArmTorque):
                rest = float(effect.torque(still, still))
                friction += (float(effect.torque(still, step)) - rest) / 1e-6
                stiffness += (float(effect.torque(step, still)) - rest) / 1e-6
        return cls(inertia / square, float(robot.drives.friction.viscous[0]) + friction / square, stiffness / square)


def drive_response(
    numbers: DriveNumbers, effects: Iterable[AbstractEffect], frequency: Float[np.ndarray, "line"], order: int
) -> Complex[np.ndarray, "line"]:
    """G of a drive and what the `effects` make of its command, continuous in time; `order`: 0 position, 1 speed, 2
    acceleration of the motor."""
    s = 2j * np.pi * np.asarray(frequency)
    G = s**order / (numbers.inertia * s**2 + numbers.friction * s + numbers.stiffness)
    for effect in effects:
        if isinstance(effect, AbstractActuator):
            G = G * on_the_way(effect, s)
    return G


def on_the_way(effect: AbstractActuator, s: Complex[np.ndarray, "line"]) -> Complex[np.ndarray, "line"]:
    """What becomes of a torque between command and motor, its delay included."""
    return np.asarray(effect.response(s)) * np.exp(-s * float(effect.dead_time()))  # of NumPy: nothing is compiled


def rigid_drive(inertia: float) -> Robot:
    """One motor of which nothing is known but its inertia, in units of u: the torque constant is one with it."""
    joint: dict[str, object] = {
        "name": "drive",
        "type": "driven",
        "axis": [0.0, 0.0, 1.0],
        "offset": [0.0] * 3,
        "com": [0.0] * 3,
    }
    joint |= {"mass": 0.0, "inertia": [0.0] * 6, "gear_ratio": 1.0, "motor_inertia": inertia, "damping": 0.0}
    return robot_from_table({"name": "drive", "gravity": [0.0] * 3, "joint": [joint | {"stiffness": float("inf")}]})
