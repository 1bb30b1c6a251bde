"""The places where an effect can act: its base class is its point of insertion, which also settles how it appears
in the linearised robot:

| base class | acts on | in the linearised robot |
|---|---|---|
| `AbstractStructure` | the robot's own numbers and joints | exactly: it is part of the robot then |
| `AbstractArmTorque` | torque on a driven joint, arm side | exactly: stiffness and damping by derivative |
| `AbstractFriction` | torque against the motor | by a describing gain, a viscous coefficient |
| `AbstractActuator` | torque from command to motor | exactly where linear, as a factor of a column of G |
| `AbstractMotorTorque` | torque on the motor, by its angle | not at all: it is a disturbance |
| `AbstractSensor` | the measured motor position | not at all: it is a disturbance |
| `AbstractLinkSensor` | the measured link position, where a record holds it | not at all: its outputs are the motors |
| `AbstractGearCoupling` | the ratio of a gear to the axis before | exactly |
| `AbstractGearError` | the deflection of a gear, by the motor's angle | not at all: it is a disturbance |
| `AbstractGearTorque` | torque beside a gear's spring, with a memory | exactly where linear, as a complex stiffness |

The laws see one joint and the signals of all runs, (run,), and return the same; they are traced, so that parameters
can be differentiated.
"""

import abc
from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Complex, Float, PyTree

from .._types import Array
from ._place import own_spring, spring_of
from .effect import AbstractEffect, Candidate, Joint, OwnNumber, Signal

if TYPE_CHECKING:
    from ..robot import Robot

_PHASES = 4096  # of one period of the slow sine; exact for a smoothing down to a hundredth of the amplitude


class AbstractStructure(AbstractEffect):
    """An effect that changes the robot's own numbers or joints; each says which (`own_numbers`)."""

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        return ()

    @abc.abstractmethod
    def apply(self, robot: "Robot"):
        """The robot with the effect in it."""


class AbstractArmTorque(AbstractEffect):
    """A torque on a driven joint, on the arm side, that depends on its angle and rate."""

    @abc.abstractmethod
    def torque(self, angle: Signal, rate: Signal) -> Signal:
        """Torque against the joint, rad and rad/s; N m."""

    def against(self, x, v, stiffness, smoothing):
        return self.torque(x, v)


class AbstractFriction(AbstractEffect):
    """A torque against the motor, on the motor side, that depends on its speed and on the gear's load."""

    @abc.abstractmethod
    def torque(self, speed: Signal, load: Signal) -> Signal:
        """Torque against the motor at this speed, rad/s, and load (gear torque on the motor side, N m); N m."""

    def against(self, x, v, stiffness, smoothing):
        return self.torque(v, jnp.zeros_like(v))

    def gain(self, amplitude: Float[Array, ""] | float, load: Float[Array, ""] | float = 0.0) -> Float[Array, ""]:
        """Describing gain, N m s/rad: the mean slope of the torque over a slow sine of this speed amplitude, rad/s,
        which is what a small motion on top of it feels. It fails where the small motion is not small."""
        speed = amplitude * jnp.sin(2.0 * jnp.pi * (jnp.arange(_PHASES) + 0.5) / _PHASES)
        slope = jax.vmap(jax.grad(lambda v: self.torque(v, jnp.asarray(load, speed.dtype))))(speed)
        return jnp.mean(slope)


class AbstractMotorTorque(AbstractEffect):
    """A torque on the motor that depends on its angle."""

    @abc.abstractmethod
    def torque(self, angle: Signal) -> Signal:
        """Torque that drives the motor, motor side, at this motor angle, rad; N m."""

    def against(self, x, v, stiffness, smoothing):
        return -self.torque(x)


class AbstractActuator(AbstractEffect):
    """What becomes of the commanded torque on its way to the motor.

    A control sample is cut into fine steps; torques are (step, run), constant within a step. `is_linear`: whether it
    does the same before a gain and behind it. `is_mechanical`: whether it is a part of the machine, no drive.
    """

    is_linear: ClassVar[bool] = False
    is_mechanical: ClassVar[bool] = False

    @abc.abstractmethod
    def start(self, torque: Signal, step: float) -> PyTree:
        """The state after a torque that has been constant for ever; `step` is the length of a fine step, s."""

    @abc.abstractmethod
    def advance(self, state: PyTree, torque: Float[Array, "step *run"], step: float):
        """Torque in the fine steps of one control sample, and the next state."""

    @abc.abstractmethod
    def response(self, s: Complex[Array, "*freq"]) -> Complex[Array, "*freq"]:
        """Factor of the motor's column of G at s = j omega, without its `dead_time`."""

    def dead_time(self) -> Float[Array, ""] | float:
        """Pure delay, s: kept apart, for the FRF between samples treats it exactly."""
        return 0.0


class AbstractStatelessActuator(AbstractActuator):
    """An actuator without memory: `drive` says all."""

    @abc.abstractmethod
    def drive(self, torque: Signal) -> Signal:
        """Motor torque of a commanded torque, N m."""

    def start(self, torque, step):
        return ()

    def advance(self, state, torque, step):
        return self.drive(torque), state


class AbstractSensor(AbstractEffect):
    """What the measured motor position is of the true one."""

    @abc.abstractmethod
    def measured(self, angle: Signal) -> Signal:
        """Measured motor position of a true one, rad."""


class AbstractLinkSensor(AbstractEffect):
    """What the measured link position is of the true one, in records that hold it beside the motor's."""

    @abc.abstractmethod
    def error(self, angle: Signal, rate: Signal) -> Signal:
        """Measured less true position of the link at this angle and rate, rad and rad/s; rad."""


class AbstractGear(AbstractEffect):
    """An effect inside a flexible transmission, whose spring is deflected by x = q_m/n - q_a (arm side, rad)."""

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        spring_of(robot, joint)
        return super().candidates(robot, joint, largest)

    def check(self, robot: "Robot") -> None:
        spring_of(robot, self.joint)


class AbstractGearCoupling(AbstractGear):
    """A gear that the axis before its own turns too: x = q_m/n - q_a - ratio q_(a, before).

    The torque of its spring, tau on its own axis, is ratio tau on the axis before.
    """

    ratio: eqx.AbstractVar[Float[Array, ""] | float]


class AbstractGearError(AbstractGear):
    """A gear whose output leads by an angle that depends on the motor's, x = q_m/n + lead(q_m/n) - q_a.

    Power is kept: the motor feels tau (1 + slope)/n of the spring's torque tau.
    """

    @classmethod
    def candidates_at(cls, robot: "Robot", joint: Joint, orders: Iterable[float]) -> tuple[Candidate, ...]:
        """What is tried where a residual goes by these orders of the motor's turn; by default nothing."""
        return ()

    @abc.abstractmethod
    def lead(self, angle: Signal) -> Signal:
        """Lead of the output, rad, arm side, at this motor angle on the arm side, q_m/n, rad."""

    def slope(self, angle: Signal) -> Signal:
        """d lead / d angle."""
        return jax.jvp(self.lead, (angle,), (jnp.ones_like(angle),))[1]

    def along(
        self,
        robot,
        deflection: Float[Array, "time *run"],
        rate: Float[Array, "time *run"],
        angle: Float[Array, "time *run"],
        step: float,
    ) -> Float[Array, "time *run"]:
        """What the effect adds to the transmission's torque along a motion without it; (time, run), N m, arm side.

        The motor feels this, and slope(angle) times the whole torque, over n.

        **Arguments:** `deflection`, `rate`: of the spring of `joint` of `robot`, arm side, rad and rad/s. `angle`: of
        the motor on the arm side, q_m/n, rad. `step`: between the samples, s.
        """
        spring = own_spring(robot, self.joint)
        lead = self.lead(angle)
        leading = jnp.asarray(jnp.gradient(lead, step, axis=0))
        return spring.torque(deflection + lead, rate + leading) - spring.torque(deflection, rate)


class AbstractGearTorque(AbstractGear):
    """A torque beside the spring of a transmission, that remembers its deflection.

    The laws see the deflection x, rad, and `tension`, the torque of the transmission's own spring there (without its
    damper), N m, both arm side; their torque adds to the spring's. Between two instants both move in a straight line.
    """

    @abc.abstractmethod
    def start(self, deflection: Signal, tension: Signal) -> PyTree:
        """The state after a deflection that has been constant for ever."""

    @abc.abstractmethod
    def advance(self, state: PyTree, deflection: Signal, tension: Signal, elapsed: Float[Array, ""] | float):
        """Torque, N m, and state after the deflection has moved from the state's to this one in `elapsed`, s (0: the
        torque of the state itself)."""

    @abc.abstractmethod
    def response(self, s: Complex[Array, "*freq"]) -> Complex[Array, "*freq"]:
        """Torque over the spring's in small motion, at s = j omega; 0 gives what is left of it at rest."""

    @abc.abstractmethod
    def stiffness(self, tangent: Signal) -> Signal:
        """Stiffness that it adds to one of `tangent` in fast small motion, N m/rad."""

    def along(
        self,
        robot,
        deflection: Float[Array, "time *run"],
        rate: Float[Array, "time *run"],
        angle: Float[Array, "time *run"],
        step: float,
    ) -> Float[Array, "time *run"]:
        """What the effect adds to the transmission's torque along a motion; (time, run), N m, arm side.

        It starts as at rest at the first sample: of a periodic motion give two periods and keep the second.

        **Arguments:** as of `AbstractGearError.along`; `rate` and `angle` are not used.
        """
        deflection = jnp.asarray(deflection)
        tension = own_spring(robot, self.joint).torque(deflection, jnp.zeros_like(deflection))

        def proceed(state, now):
            torque, state = self.advance(state, *now, step)
            return state, torque

        state = self.start(deflection[0], tension[0])
        first, _ = self.advance(state, deflection[0], tension[0], 0.0)
        _, torque = jax.lax.scan(proceed, state, (deflection[1:], tension[1:]))
        return jnp.concatenate([first[None], torque])
