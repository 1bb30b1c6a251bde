"""The robot between two control samples: what changes slowly once, springs, motors and friction in fine steps.

Arrays are component first and runs last, (dof, run): one instruction then works on many runs.
"""

import dataclasses
import functools
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._types import Array
from ..effects import AbstractArmTorque, AbstractFriction, AbstractGearError, AbstractGearTorque, AbstractMotorTorque
from ..effects.acting import Group, groups
from ..robot import AbstractFrictionLaw, AbstractSpring, Robot, arm_inertia_and_bias_columns
from ..robot.equations import gear_coupling

Columns = Float[Array, "row run"]


def columns(laws):
    """The same module for (joint, run) arrays: a trailing axis on every parameter. Its laws must be element-wise."""
    return jax.tree.map(lambda x: jnp.asarray(x)[..., None] if eqx.is_array_like(x) else x, laws)


class Wiring(eqx.Module):
    """Which motor drives which joint over which spring, as index arrays."""

    motors: int = eqx.field(static=True)
    axes: int = eqx.field(static=True)
    flexible: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, robot: Robot) -> "Wiring":
        return cls(robot.n_motors, robot.n_axes, robot.flexible_axes)

    def interleave(self, flexible, rigid):
        """Rows of the flexible and of the rigid axes in the order of the axes."""
        if self.motors == self.axes:
            return flexible
        order = np.argsort([*self.flexible, *self.rigid])
        return jnp.concatenate([flexible, rigid])[order]

    def pick(self, rows, which: tuple[int, ...]):
        return rows if which == tuple(range(self.axes)) else rows[np.array(which, int)]

    @property
    def rigid(self) -> tuple[int, ...]:
        return tuple(i for i in range(self.axes) if i not in self.flexible)


class Slow(eqx.Module):
    """What is held during one sample: inverse of M_ae, (arm, arm, run), and c_ae + g_ae, (arm, run)."""

    inverse: Float[Array, "arm arm run"]
    bias: Columns


class Lead(eqx.Module):
    """Transmission errors as straight lines about a motor angle: they cost sines, and a fine step is short.

    All (axis, run), on the arm side: `angle` of the motors, and there the gears' `lead` and its `slope`.
    """

    angle: Columns
    lead: Columns
    slope: Columns


class Plant(eqx.Module):
    """A robot made ready for stepping many runs at once; `robot` keeps plain parameters, the laws have columns."""

    robot: Robot
    gear: Columns
    inertia: Columns
    springs: AbstractSpring
    friction: AbstractFrictionLaw
    wiring: Wiring
    rubbing: tuple[Group[AbstractFriction], ...]
    pulling: tuple[Group[AbstractArmTorque], ...]
    rippling: tuple[Group[AbstractMotorTorque], ...]
    erring: tuple[Group[AbstractGearError], ...]
    remembering: tuple[Group[AbstractGearTorque], ...]
    coupling: Columns | None  # of every gear to the axis before

    @classmethod
    def of(cls, robot: Robot) -> "Plant":
        drives, coupling = columns(robot.drives), gear_coupling(robot)
        return cls(
            dataclasses.replace(robot, effects=(), controller=None),
            drives.gear_ratio,
            drives.motor_inertia,
            columns(robot.springs),
            drives.friction,
            Wiring.of(robot),
            groups(robot, AbstractFriction),
            groups(robot, AbstractArmTorque),
            groups(robot, AbstractMotorTorque),
            groups(robot, AbstractGearError),
            groups(robot, AbstractGearTorque),
            None if coupling is None else jnp.concatenate([jnp.zeros(1), jnp.diag(coupling, -1)])[:, None],
        )

    def motor(self, z: Columns) -> Columns:
        """Motor angles of all axes (or speeds, from rates), motor side."""
        w = self.wiring
        if not w.rigid:
            return z[: w.motors]
        arm = z[w.motors : w.motors + w.axes]
        return w.interleave(z[: w.motors], w.pick(self.gear * arm, w.rigid))

    def deflection(self, z: Columns) -> Columns:
        """Of every spring, arm side: q_m/n - q_a, then -q_e; without transmission errors."""
        w = self.wiring
        arm, elastic = z[w.motors : w.motors + w.axes], z[w.motors + w.axes :]
        if self.coupling is not None:
            arm = arm + self.coupling * jnp.concatenate([jnp.zeros_like(arm[:1]), arm[:-1]])
        gears = z[: w.motors] / w.pick(self.gear, w.flexible) - w.pick(arm, w.flexible)
        return jnp.concatenate([gears, -elastic])

    def slow(self, z: Columns, rate: Columns) -> Slow:
        """M_ae^{-1} and c_ae + g_ae at one state."""
        motors = self.wiring.motors
        matrix, bias = arm_inertia_and_bias_columns(self.robot, z[motors:], rate[motors:])
        return Slow(inverse_columns(matrix), bias)

    def acceleration(
        self, slow: Slow, z: Columns, rate: Columns, torque: Columns, lead: Lead | None, memory, elapsed: float
    ) -> Columns:
        """z'' under a motor torque, (axis, run), with the slow part held.

        `lead`: transmission errors, `None` without. `memory`: states of effects with one, `elapsed` s ago.
        """
        w = self.wiring
        deflection, stretching = self.deflection(z), self.deflection(rate)
        if lead is not None:
            deflection, stretching = self.led(lead, z, deflection), stretching + self.leading(lead, rate)
        spring = self.springs.torque(deflection, stretching)
        if self.remembering:
            spring = spring + self.remember(memory, deflection, elapsed)[0]
        speed = self.motor(rate)
        net = torque - self.friction.torque(speed)
        gears = spring[: w.motors]
        if self.rubbing:
            load = w.interleave(gears / w.pick(self.gear, w.flexible), w.pick(torque, w.rigid))
            for group in self.rubbing:
                net = group.added(net, -group(lambda e, v, x: e.torque(v, x), speed, load))
        back = gears if lead is None else gears * (1.0 + w.pick(lead.slope, w.flexible))
        motor = (w.pick(net, w.flexible) - back / w.pick(self.gear, w.flexible)) / w.pick(self.inertia, w.flexible)
        arm = w.interleave(gears, w.pick(self.gear * net, w.rigid))
        if self.coupling is not None:
            pull = self.coupling * arm  # zero on rigid axes
            arm = arm + jnp.concatenate([pull[1:], jnp.zeros_like(pull[:1])])
        for pull_of in self.pulling:
            row = slice(w.motors, w.motors + w.axes)
            arm = pull_of.added(arm, -pull_of(lambda e, q, v: e.torque(q, v), z[row], rate[row]))
        force = jnp.concatenate([arm, spring[w.motors :]]) - slow.bias
        return jnp.concatenate([motor, product(slow.inverse, force)])

    def lead(self, z: Columns) -> Lead | None:
        """The transmission errors about these coordinates."""
        if not self.erring:
            return None
        angle = self.motor(z) / self.gear
        lead, slope = jnp.zeros_like(angle), jnp.zeros_like(angle)
        for group in self.erring:
            value, tangent = group(lambda e, x: jax.jvp(e.lead, (x,), (jnp.ones_like(x),)), angle)
            lead, slope = group.added(lead, value), group.added(slope, tangent)
        return Lead(angle, lead, slope)

    def led(self, lead: Lead | None, z: Columns, deflection: Columns) -> Columns:
        """Deflections with the transmission errors."""
        if lead is None:
            return deflection
        return deflection + self.on_springs(lead.lead + lead.slope * (self.motor(z) / self.gear - lead.angle))

    def leading(self, lead: Lead, rate: Columns) -> Columns:
        """What they add to the rates of the deflections."""
        return self.on_springs(lead.slope * self.motor(rate) / self.gear)

    def on_springs(self, rows: Columns) -> Columns:
        """Rows of the axes as rows of the springs, zero for elastic joints."""
        w = self.wiring
        elastic = len(self.robot.elastic_joints)
        return jnp.concatenate([w.pick(rows, w.flexible), jnp.zeros((elastic, rows.shape[1]), rows.dtype)])

    def remember(self, memory, deflection: Columns, elapsed: float):
        """Torque beside the springs by effects with a memory, and their states after `elapsed` s."""
        rows = self._gear_rows(deflection)
        total, after = jnp.zeros_like(rows[0]), []
        for group, state in zip(self.remembering, memory, strict=True):
            advance_one = lambda e, state, x, tension: e.advance(state, x, tension, elapsed)
            torque, state = jax.vmap(advance_one)(group.effects, state, *(group.pick(x) for x in rows))
            total = group.added(total, torque)
            after.append(state)
        return self.on_springs(total), tuple(after)

    def at_rest(self, deflection: Columns):
        """States of effects with a memory, after these deflections of the springs for ever."""
        rows = self._gear_rows(deflection)
        return tuple(group(lambda e, x, tension: e.start(x, tension), *rows) for group in self.remembering)

    def _gear_rows(self, deflection: Columns) -> tuple[Columns, Columns]:
        """Deflection and torque of the transmissions' springs, (axis, run)."""
        w, tension = self.wiring, self.springs.torque(deflection, jnp.zeros_like(deflection))
        rigid = jnp.zeros((len(w.rigid), deflection.shape[1]), deflection.dtype)
        return w.interleave(deflection[: w.motors], rigid), w.interleave(tension[: w.motors], rigid)

    def ripple(self, angle: Columns, torque: Columns) -> Columns:
        """Motor torque with what depends on the motor's angle."""
        for group in self.rippling:
            torque = group.added(torque, group(lambda e, x: e.torque(x), angle))
        return torque


def product(matrix, vector):
    """Matrix times vector with the runs last: (row, column, run) and (column, run)."""
    return functools.reduce(operator.add, (matrix[:, j] * vector[j] for j in range(vector.shape[0])))


def inverse_columns(matrix: Float[Array, "row row run"]) -> Float[Array, "row row run"]:
    """Inverse of symmetric positive definite matrices with the runs last, by sweeps (Gauss-Jordan, no pivoting).

    Array operations over all runs, no LAPACK: several times faster for many small matrices, and no thread waits.
    """
    index = np.arange(matrix.shape[0])

    def sweep(k, A):
        column = jax.lax.dynamic_index_in_dim(A, k, 0, keepdims=False)
        pivot = jax.lax.dynamic_index_in_dim(column, k, 0, keepdims=False)
        here = (index == k)[:, None]
        scaled = column / pivot
        inside = A - scaled[:, None] * column[None]
        A = jnp.where(here[:, None], scaled[None], jnp.where(here[None], scaled[:, None], inside))
        return jnp.where(here[:, None] & here[None], -1.0 / pivot, A)

    return -jax.lax.fori_loop(0, matrix.shape[0], sweep, matrix)


def advance(plant: Plant, z: Columns, rate: Columns, memory, slow: Slow, torques, step: float):
    """One control sample in as many classical Runge-Kutta steps as `torques`, (fine step, axis, run), has rows.

    Ripple and transmission errors, which cost sines, are evaluated once a step, at the motor angle in its middle.
    `memory`: states of effects with one, advanced once a step; a stage sees them moved on to itself.

    **Returns:** z, rate and memory.
    """

    def fine(state, torque):
        z, v, memory = state
        if plant.rippling:
            torque = plant.ripple(plant.motor(z) + 0.5 * step * plant.motor(v), torque)
        lead = plant.lead(z + 0.5 * step * v) if plant.erring else None
        f = lambda z, v, elapsed: plant.acceleration(slow, z, v, torque, lead, memory, elapsed)
        a1 = f(z, v, 0.0)
        v2 = v + 0.5 * step * a1
        a2 = f(z + 0.5 * step * v, v2, 0.5 * step)
        v3 = v + 0.5 * step * a2
        a3 = f(z + 0.5 * step * v2, v3, 0.5 * step)
        v4 = v + step * a3
        a4 = f(z + step * v3, v4, step)
        z, v = z + step / 6 * (v + 2 * v2 + 2 * v3 + v4), v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        if plant.remembering:
            memory = plant.remember(memory, plant.led(lead, z, plant.deflection(z)), step)[1]
        return (z, v, memory), None

    return jax.lax.scan(fine, (z, rate, memory), torques)[0]
