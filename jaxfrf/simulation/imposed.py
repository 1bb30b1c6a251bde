"""A robot whose motors are moved along given courses, and the torque that this takes: many runs at once.

No controller is needed, and none stands between a motion and the friction that turns over in it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree

from .._compile import program
from .._types import Array
from ..effects import AbstractSensor
from ..effects.acting import Group, groups
from ..robot import OperatingPoint, Robot
from .closed_loop import Runs, readings
from .plant import Columns, Lead, Plant, Slow, inverse_columns, product

_LOOKS = 3  # at a sensor's error, to find the angle behind a reading: errors are some 1e-3 of an order's turn
_STEPS = 3  # Runge-Kutta steps in a sample: springs alone are integrated, friction is not


class ImposedState(eqx.Module):
    """Everything that a run carries from sample to sample; `torque`: that the motors needed last."""

    z: Columns
    rate: Columns
    before: Columns  # rate one sample ago, to extrapolate by
    torque: Columns
    gears: tuple[PyTree, ...]


class Imposed(eqx.Module):
    """Motors go from sample to sample on cubics through the angles and speeds that a reference gives; arm and elastic
    joints follow over their springs, integrated as in `ClosedLoop`. The torque of a sample is the mean of what the
    motors needed in it, before any actuator.
    """

    plant: Plant
    sensors: tuple[Group[AbstractSensor], ...]
    steps: int = eqx.field(static=True)
    fs: float = eqx.field(static=True)

    @classmethod
    def of(cls, robot: Robot, steps: int = _STEPS) -> "Imposed":
        return cls(Plant.of(robot), groups(robot, AbstractSensor), steps, robot.sampling_frequency)

    def at_rest(self, point: OperatingPoint) -> ImposedState:
        """Equilibria as the states of runs, one for each; `point` has one batch axis."""
        z = point.z.T
        gears = self.plant.at_rest(point.deflection.T) if self.plant.remembering else ()
        rest = jnp.zeros_like(z)
        return ImposedState(z, rest, rest, point.torque.T, gears)

    def measured(self, angle: Columns) -> Columns:
        """Motor angles as the sensors see them."""
        return readings(self.sensors, angle)

    def behind(self, reading: Columns, speed: Columns) -> tuple[Columns, Columns]:
        """Angles and speeds of motors whose sensors show these."""
        if not self.sensors:
            return reading, speed
        angle = reading
        for _ in range(_LOOKS):
            angle = angle + reading - self.measured(angle)
        _, slope = jax.jvp(self.measured, (angle,), (jnp.ones_like(angle),))
        return angle, speed / slope

    def sample(self, state: ImposedState, reference, runs: Runs):
        """From the angles that the motors have to those of the reference, a sample later: torque, and the reading at
        its start. `reference` = (speed, position), each (axis, run)."""
        plant, T = self.plant, 1.0 / self.fs
        speed, position = reference
        angle, speed = self.behind(self.measured(runs.rest) + position, speed)
        now, rate = plant.motor(state.z), plant.motor(state.rate)
        first = 6.0 * (angle - now) / T**2 - (4.0 * rate + 2.0 * speed) / T
        slope = 6.0 * (rate + speed) / T**2 - 12.0 * (angle - now) / T**3
        middle = state.z + 0.5 * T * state.rate
        slow = plant.slow(middle, state.rate + 0.5 * (state.rate - state.before))
        start = (state.z, state.rate, state.torque, state.gears)
        stretch = lambda carry, i: self._fine(carry, i, slow, first, slope, T / self.steps)
        (z, v, torque, gears), torques = jax.lax.scan(stretch, start, jnp.arange(self.steps))
        reading = self.measured(now)
        return ImposedState(z, v, state.rate, torque, gears), (torques.mean(axis=0), reading)

    def _fine(self, carry, i, slow: Slow, first, slope, step: float):
        """One Runge-Kutta step, and the mean torque in it."""
        plant = self.plant
        z, v, torque, memory = carry
        ripple: Array | float = 0.0
        if plant.rippling:
            ripple = plant.ripple(plant.motor(z) + 0.5 * step * plant.motor(v), jnp.zeros_like(torque))
        lead = plant.lead(z + 0.5 * step * v) if plant.erring else None

        def f(z, v, elapsed, torque):
            wanted = first + slope * (i * step + elapsed)
            return self._moved(slow, z, v, wanted, torque, lead, memory, elapsed)

        a1, u1 = f(z, v, 0.0, torque)
        v2 = v + 0.5 * step * a1
        a2, u2 = f(z + 0.5 * step * v, v2, 0.5 * step, u1)
        v3 = v + 0.5 * step * a2
        a3, u3 = f(z + 0.5 * step * v2, v3, 0.5 * step, u2)
        v4 = v + step * a3
        a4, u4 = f(z + step * v3, v4, step, u3)
        z, v = z + step / 6 * (v + 2 * v2 + 2 * v3 + v4), v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        if plant.remembering:
            memory = plant.remember(memory, plant.led(lead, z, plant.deflection(z)), step)[1]
        return (z, v, u4, memory), (u1 + 2 * u2 + 2 * u3 + u4) / 6 - ripple

    def _moved(self, slow: Slow, z, v, wanted, torque, lead: Lead | None, memory, elapsed):
        """z'' with motors accelerated as `wanted`, (axis, run), and the torque that acts on them then.

        z'' is linear in the torque; two looks where friction may depend on the torque of a rigid transmission.
        """
        for _ in range(2 if self.plant.wiring.rigid else 1):
            found = self.plant.acceleration(slow, z, v, torque, lead, memory, elapsed)
            missing = wanted - self.plant.motor(found)
            torque, more = self._asked(slow, missing, torque)
        return found + more, torque

    def _asked(self, slow: Slow, missing, torque) -> tuple[Columns, Columns]:
        """Torque that accelerates the motors by `missing` more, added, and what it does to z''."""
        plant, w = self.plant, self.plant.wiring
        row = lambda x, which: x[np.array(which, int)]
        free = row(missing, w.flexible)
        extra = w.interleave(row(plant.inertia, w.flexible) * free, jnp.zeros((len(w.rigid), missing.shape[1])))
        arm = jnp.zeros_like(slow.bias)
        if w.rigid:
            axes = np.array(w.rigid, int)
            gear = plant.gear[axes]
            felt = gear[:, None] * slow.inverse[axes[:, None], axes] * gear
            by_axis = product(inverse_columns(felt), row(missing, w.rigid))
            extra = extra.at[axes].add(by_axis)
            arm = product(slow.inverse[:, axes], gear * by_axis)
        return torque + extra, jnp.concatenate([free, arm])


@program
def impose(loop: Imposed, state: ImposedState, runs: Runs, start, references: Float[Array, "time 2 axis track"]):
    """Move the motors along a stretch of the references: the last state, torques, readings and coordinates at every
    sample, (time, row, run). As `closed_loop.play`; a reference is that of the *end* of its sample."""

    def step(state, reference):
        after, (torque, reading) = loop.sample(state, reference[:, :, runs.track], runs)
        return after, (torque, reading, state.z)

    state, (torque, reading, z) = jax.lax.scan(step, state, references)
    return state, torque, reading, z
