"""From the commanded torque to the motor's."""

import functools
import math
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from .._types import Array
from ._harmonics import checked, harmonics
from ._place import axis_of
from .effect import AbstractActuator, AbstractMotorTorque, AbstractStatelessActuator, Candidate, Joint, OwnNumber

if TYPE_CHECKING:
    from ..robot import Robot

Number = Float[Array, ""] | float


class TorqueDelay(AbstractActuator):
    """The torque comes late, u(t - delay): e^{-s delay}.

    Any delay from 0 to `longest`, not only whole samples; exact on the fine steps of the simulation, between them
    the mean torque of a step is.

    **Arguments:** `delay`: s; 0.3 ms is visible. `longest`: s, how much of the past is kept.

    In data: phase -omega delay in the motor's column of G. In the linearised robot: exactly.
    """

    name: ClassVar = "torque_delay"
    units: ClassVar = {"delay": "s"}
    bounds: ClassVar = {"delay": (0.0, 2e-3)}
    signature: ClassVar = "phase -omega delay in one column of G"
    confusable: ClassVar = {"current_loop_lag": "above 300 Hz, or a step of torque; one class in 4-80 Hz"}
    alike: ClassVar = ("current_loop_lag",)

    joint: Joint = eqx.field(static=True)
    delay: Number
    longest: float = eqx.field(static=True, default=2e-3)

    def __check_init__(self):
        if isinstance(self.delay, int | float | np.ndarray) and not 0.0 <= float(self.delay) <= self.longest:
            raise input_error(
                "torque_delay: delay", f"{self.delay} s", f"0 to longest = {self.longest:g} s", "Raise longest."
            )

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 3e-4)

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        return (OwnNumber(f"{robot.axis_names[axis_of(robot, self.joint)]}.delay", "delay"),)

    def start(self, torque, step):
        kept = math.ceil(self.longest / step) + 1
        return jnp.broadcast_to(torque, (kept, *torque.shape))

    def advance(self, state, torque, step):
        line = jnp.concatenate([state, torque])
        whole = jnp.clip(jnp.floor(self.delay / step + 1e-9), 0, state.shape[0] - 1)
        part = self.delay / step - whole
        first = state.shape[0] - 1 - whole.astype(int)
        late = jax.lax.dynamic_slice_in_dim(line, first, torque.shape[0] + 1)
        return (1.0 - part) * late[1:] + part * late[:-1], line[torque.shape[0] :]

    def response(self, s):
        return jnp.ones_like(s)

    def dead_time(self):
        return self.delay


class CurrentLoopLag(AbstractActuator):
    """The current loop follows with a first-order lag, 1/(1 + s time_constant).

    **Arguments:** `time_constant`: s, above 0; 0.3 ms is visible.

    In data: as a delay. In the linearised robot: exactly but for the aliases of a held torque, of which it damps
    none (some 1e-4 of G).
    """

    name: ClassVar = "current_loop_lag"
    units: ClassVar = {"time_constant": "s"}
    bounds: ClassVar = {"time_constant": (0.0, 2e-3)}
    signature: ClassVar = "phase -omega time_constant in one column of G"
    confusable: ClassVar = {"torque_delay": "above 300 Hz, or a step of torque; one class in 4-80 Hz"}
    alike: ClassVar = ("torque_delay",)

    joint: Joint = eqx.field(static=True)
    time_constant: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 3e-4)

    def start(self, torque, step):
        return torque

    def advance(self, state, torque, step):
        left = jnp.exp(-step / self.time_constant)
        mean = self.time_constant / step * (1.0 - left)

        def fine(old, new):
            return new + (old - new) * left, new + (old - new) * mean

        state, out = jax.lax.scan(fine, state, torque)
        return out, state

    def response(self, s):
        return 1.0 / (1.0 + s * self.time_constant)


class TorqueConstant(AbstractStatelessActuator):
    """An error of the torque constant: the motor gives (1 + error) u.

    **Arguments:** `error`: +-0.1; 0.02 is visible.

    In data: a flat gain of the motor's column of G, no phase. In the linearised robot: exactly.
    """

    name: ClassVar = "torque_constant"
    units: ClassVar = {"error": "1"}
    bounds: ClassVar = {"error": (-0.1, 0.1)}
    signature: ClassVar = "a flat gain of one column of G, without phase"
    confusable: ClassVar = {"motor_inertia": "high against low frequencies"}
    is_error: ClassVar = True

    joint: Joint = eqx.field(static=True)
    error: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.02)

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        return (OwnNumber(f"{robot.axis_names[axis_of(robot, self.joint)]}.{self.name}", "error"),)

    def drive(self, torque):
        return (1.0 + self.error) * torque

    def response(self, s):
        return (1.0 + self.error) * jnp.ones_like(s)


_CLIPPED = (0.9, 0.8, 0.65, 0.5, 0.4)  # of the largest command, where a drive is tried to clip


def _as_it_is(effect, c):
    return effect


class TorqueSaturation(AbstractStatelessActuator):
    """The drive clips the torque, clip(u, -limit, limit), below the limit that the controller knows.

    **Arguments:** `limit`: N m, motor side; 0.8 of the largest torque is visible.

    In data: at high amplitude only, flat tops of the motor's acceleration. In the linearised robot: not at all, it
    is linear below the limit.
    """

    name: ClassVar = "torque_saturation"
    units: ClassVar = {"limit": "N m"}
    bounds: ClassVar = {"limit": (0.0, math.inf)}
    signature: ClassVar = "at high amplitude only: flat tops"
    confusable: ClassVar = {"backlash": "another amplitude"}
    grows: ClassVar = False

    joint: Joint = eqx.field(static=True)
    limit: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.5 * robot.drives.torque_limit[axis_of(robot, joint)])

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """At parts of the largest command: whatever it is clipped at, its torque is that of the limit."""
        these = [cls(joint, part * largest) for part in _CLIPPED]
        label = "limit {:.3g} N m".format
        return tuple(
            Candidate(cls.name, str(joint), (e,), functools.partial(_as_it_is, e), (0.3,), (3.0,), 0.3, label(e.limit))
            for e in these
        )

    def drive(self, torque):
        return jnp.clip(torque, -self.limit, self.limit)

    def response(self, s):
        return jnp.ones_like(s)


class TorqueRipple(AbstractMotorTorque):
    """Torque that depends on the motor's angle, sum_h amplitude_h sin(order_h theta + phase_h).

    **Arguments:** `amplitude`: (order,), N m, motor side; 0.01 of the torque limit is visible. `order`: per motor
    turn, whole numbers, 1-50. `phase`: (order,), rad; 0 by default.

    In data: lines at orders of the motor's angle, of an amplitude that does not depend on the speed. It repeats
    with the period, so more periods do not average it out. In the linearised robot: not at all.
    """

    name: ClassVar = "torque_ripple"
    units: ClassVar = {"amplitude": "N m", "order": "1", "phase": "rad"}
    bounds: ClassVar = {"amplitude": (0.0, 0.5), "order": (1.0, 50.0), "phase": (-math.pi, math.pi)}
    signature: ClassVar = "orders of the motor's angle, amplitude independent of speed"
    confusable: ClassVar = {"resolver_ripple": "amplitude against speed", "transmission_error": "whole orders"}

    joint: Joint = eqx.field(static=True)
    amplitude: Float[Array, "order"]
    order: tuple[int, ...] = eqx.field(static=True)
    phase: Float[Array, "order"]

    def __init__(self, joint: Joint, amplitude, order=(1, 2, 6, 18), phase=None):
        self.joint = joint
        self.amplitude, self.order, self.phase = checked(self.name, amplitude, order, phase)

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        limit = robot.drives.torque_limit[axis_of(robot, joint)]
        return cls(joint, 0.01 * jnp.where(jnp.isfinite(limit), limit, 1.0)[None], (6,))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None: the orders are found in the data."""
        return ()

    def torque(self, angle):
        return harmonics(self.amplitude, self.order, self.phase, angle)
