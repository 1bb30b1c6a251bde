"""Errors of the measured motor position."""

import math
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from .._errors import input_error
from .._types import Array
from ._harmonics import by_order, checked, harmonics
from .effect import Candidate, Joint, Reach
from .insertion import AbstractLinkSensor, AbstractSensor

if TYPE_CHECKING:
    from ..robot import Robot


_SMALL = 1e-6  # rad: amplitude at which its signature along a measured motion is linear


class ResolverRipple(AbstractSensor):
    """An error of the resolver that repeats with the motor's turn, sum_h amplitude_h sin(order_h theta + phase_h).

    **Arguments:** `joint`: a driven joint, name or number. `amplitude`: (order,), rad, motor side; 5e-4 is visible.
    `order`: per motor turn, whole numbers. `phase`: (order,), rad; 0 by default.

    In data: an apparent acceleration of about amplitude h^2 v^2 at orders of the motor's angle; the controller acts
    on it too. In the linearised robot: not at all.

    **Raises:** `jaxfrf.InputError` unless amplitudes, orders and phases are as many.

    **Source:** a definition, a sum of sines of the motor position as in the paper, section IV.A; where such errors come
    from: Hanselman, IEEE Trans. Industrial Electronics 37 (1990) 556-561.
    """

    name: ClassVar = "resolver_ripple"
    units: ClassVar = {"amplitude": "rad", "order": "1", "phase": "rad"}
    bounds: ClassVar = {"amplitude": (0.0, 5e-3), "order": (1.0, 50.0), "phase": (-math.pi, math.pi)}
    signature: ClassVar = "orders of the motor's angle, an acceleration that grows with the square of the speed"
    confusable: ClassVar = {"torque_ripple": "amplitude against speed"}

    joint: Joint = eqx.field(static=True)
    amplitude: Float[Array, "order"]
    order: tuple[int, ...] = eqx.field(static=True)
    phase: Float[Array, "order"]

    def __init__(self, joint: Joint, amplitude, order=(1, 2), phase=None):
        self.joint = joint
        self.amplitude, self.order, self.phase = checked(self.name, amplitude, order, phase)

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, [5e-4, 1e-3])

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None: the orders are found in the data."""
        return ()

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        return by_order(cls, joint, reach, _SMALL)

    def measured(self, angle):
        return angle + harmonics(self.amplitude, self.order, self.phase, angle)


class EncoderQuantisation(AbstractSensor):
    """The encoder counts, round(theta/resolution) resolution.

    **Arguments:** `joint`: a driven joint, name or number. `resolution`: rad, motor side, above 0; 2 pi/2^13 is
    visible. It has no derivative.

    In data: noise that grows as f^2 in the acceleration, without structure in G. In the linearised robot: not at
    all.

    **Source:** a definition, the uniform quantiser of Widrow & Kollar, Quantization Noise, 2008, who say when its error
    is like white noise.
    """

    name: ClassVar = "encoder_quantisation"
    units: ClassVar = {"resolution": "rad"}
    bounds: ClassVar = {"resolution": (1e-9, 1e-2)}
    signature: ClassVar = "noise that grows as f^2, no structure in G"
    confusable: ClassVar = {"noise": "its distribution at standstill"}
    differentiable: ClassVar = False

    joint: Joint = eqx.field(static=True)
    resolution: Float[Array, ""] | float

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 2 * math.pi / 2**13)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None: it is seen in the readings themselves."""
        return ()

    @classmethod
    def of_readings(cls, joint: Joint, count: float) -> Self | None:
        return cls(joint, count)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        raise input_error(cls.name, "a filtered motion", "raw readings: it is noise here", "See `jaxfrf.screen`.")

    def measured(self, angle):
        return jnp.round(angle / self.resolution) * self.resolution


class SensorDelay(AbstractLinkSensor):
    """The link-side position is logged late, y(t) = q_a(t - delay), to first order -delay q_a'.

    **Arguments:** `joint`: a driven joint, name or number. `delay`: s, 0 or more; 0.3 ms is visible.

    In data: motor side less link side seems to deflect by delay times the speed, whatever the torque; the same delay on
    all joints where it is the log's. In the linearised robot: not at all, its outputs are the motors.

    **Source:** a definition, to first order in the delay.
    """

    name: ClassVar = "sensor_delay"
    units: ClassVar = {"delay": "s"}
    bounds: ClassVar = {"delay": (0.0, 0.02)}
    signature: ClassVar = "a deflection of delay times speed, whatever the torque"
    confusable: ClassVar = {"viscous_friction": "its sign: friction takes from the deflection"}

    joint: Joint = eqx.field(static=True)
    delay: Float[Array, ""] | float

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 3e-4)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None where the motors alone are compared."""
        return ()

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        return (cls.typical(robot, joint).candidate(*cls.plausible(robot, joint)),)

    def error(self, angle, rate):
        return -self.delay * rate
