"""Robot, controller and sensors together, one control sample after the other, many runs at once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Float, Int, PRNGKeyArray, PyTree

from .._compile import program
from .._types import Array
from ..effects import AbstractActuator, AbstractSensor
from ..effects.acting import Group, groups
from ..robot import OperatingPoint, Robot
from .controller import Cascade, ControllerState
from .plant import Columns, Plant, advance


class LoopState(eqx.Module):
    """Everything that a run carries from sample to sample."""

    z: Columns
    rate: Columns
    before: Columns  # rate one sample ago, to extrapolate by
    controller: ControllerState
    actuators: tuple[PyTree, ...]
    gears: tuple[PyTree, ...]


class Runs(eqx.Module):
    """What tells runs of a block apart: which of the references each plays, its rest position, its random stream."""

    track: Int[Array, "run"]
    rest: Columns
    key: PRNGKeyArray


def readings(sensors: tuple[Group[AbstractSensor], ...], angle: Columns) -> Columns:
    """Motor angles as the sensors see them."""
    for group in sensors:
        angle = group.replaced(angle, group(lambda e, x: e.measured(x), angle))
    return angle


class ClosedLoop(eqx.Module):
    """A robot under its controller.

    Within a control sample the arm turns by some 1e-4 rad: mass matrix, Coriolis and gravity torques are
    evaluated once, at the middle of the sample extrapolated from its start, and held; springs, motors and
    friction are integrated in `steps` classical Runge-Kutta steps.

    **Arguments:** `noise`: standard deviation of the white noise on the measured motor position, rad; `None`
    draws none, which is faster.
    """

    plant: Plant
    cascade: Cascade
    sensors: tuple[Group[AbstractSensor], ...]
    actuators: tuple[Group[AbstractActuator], ...]
    noise: Float[Array, ""] | float | None
    steps: int = eqx.field(static=True)
    fs: float = eqx.field(static=True)

    @classmethod
    def of(cls, robot: Robot, noise: float | None = 5e-5, steps: int = 3) -> "ClosedLoop":
        return cls(
            Plant.of(robot),
            Cascade.of(robot),
            groups(robot, AbstractSensor),
            groups(robot, AbstractActuator),
            noise or None,
            steps,
            robot.sampling_frequency,
        )

    def at_rest(self, point: OperatingPoint) -> LoopState:
        """Equilibria as the states of runs, one for each; `point` has one batch axis."""
        z, torque = point.z.T, point.torque.T
        rest = jnp.zeros_like(z)
        actuators = tuple(group(lambda e, u: e.start(u, self.step), torque) for group in self.actuators)
        gears = self.plant.at_rest(point.deflection.T) if self.plant.remembering else ()
        return LoopState(z, rest, rest, self.cascade.at_rest(self.measured(z), torque), actuators, gears)

    @property
    def step(self) -> float:
        """Length of a fine step, s."""
        return 1.0 / (self.fs * self.steps)

    def measured(self, z: Columns) -> Columns:
        """Motor positions as the sensors see them, without noise."""
        return readings(self.sensors, self.plant.motor(z))

    def driven(self, states, torque: Columns):
        """Motor torque in the fine steps of a sample, (step, axis, run), and the actuators' next states."""
        torques = jnp.broadcast_to(torque, (self.steps, *torque.shape))
        after = []
        for group, state in zip(self.actuators, states, strict=True):
            by_axis = jnp.moveaxis(torques, 1, 0)
            advance_one = lambda e, u, state: e.advance(state, u, self.step)
            late, state = jax.vmap(advance_one)(group.effects, group.pick(by_axis), state)
            torques = jnp.moveaxis(group.replaced(by_axis, late), 0, 1)
            after.append(state)
        return torques, tuple(after)

    def sample(self, state: LoopState, time, reference, runs: Runs):
        """One control sample: measure, control, move. `reference` = (velocity, position), each (axis, run)."""
        reading = self.measured(state.z)
        if self.noise is not None:
            reading = reading + self.noise * _normal(runs.key, time, runs.rest)
        velocity, position = reference
        speed = self.plant.motor(state.rate)
        torque, controller = self.cascade.torque(state.controller, reading, speed, runs.rest + position, velocity)
        half = 0.5 / self.fs
        middle = state.z + half * state.rate
        slow = self.plant.slow(middle, state.rate + 0.5 * (state.rate - state.before))
        torques, actuators = self.driven(state.actuators, torque)
        z, rate, gears = advance(self.plant, state.z, state.rate, state.gears, slow, torques, self.step)
        return LoopState(z, rate, state.rate, controller, actuators, gears), (torque, reading)


def _normal(key, time, like):
    """White noise, (row, run): the same for a run whatever block it stands in. Single precision is enough."""
    draw = lambda k: jr.normal(jr.fold_in(k, time), like.shape[:1], jnp.float32)
    return jax.vmap(draw, out_axes=-1)(key).astype(like.dtype)


@program
def play(
    loop: ClosedLoop,
    state: LoopState,
    runs: Runs,
    start: Int[Array, ""],
    references: Float[Array, "time 2 axis track"],
) -> tuple[LoopState, Float[Array, "time axis run"], Float[Array, "time axis run"]]:
    """Play a stretch of the references: the last state, torque commands and measured positions.

    **Arguments:** `start`: number of the first sample since the start of the runs.
    """

    def step(state, now):
        time, reference = now
        return loop.sample(state, time, reference[:, :, runs.track], runs)

    times = start + jnp.arange(references.shape[0])
    state, (torque, reading) = jax.lax.scan(step, state, (times, references))
    return state, torque, reading
