"""What an effect of the library is at a place of a machine: a force against its motion."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from .._errors import input_error
from .._types import Array
from ..effects import (
    AbstractArmTorque,
    AbstractEffect,
    AbstractFriction,
    AbstractMotorTorque,
    Backlash,
    CoulombFriction,
    StiffnessHardening,
    ViscousFriction,
)

Signal = Float[Array, "*run"]


class CubicSpring(AbstractArmTorque):
    """A spring that stiffens (or softens) with its deflection, beside what the machine has: force = stiffness x^3.

    **Arguments:** `joint`: name of the place where it acts. `stiffness`: N m/rad^3 or N/m^3, either sign.

    In data: resonances move up with the amplitude; odd distortion.

    **Source:** the cubic term of a spring's Taylor series, as in Duffing's equation.
    """

    name: ClassVar = "cubic_spring"
    units: ClassVar = {"stiffness": "N m/rad^3"}
    bounds: ClassVar = {"stiffness": (-1e12, 1e12)}
    signature: ClassVar = "resonances move with the amplitude; odd distortion"
    confusable: ClassVar = {"stiffness_hardening": "another amplitude"}

    joint: int | str = eqx.field(static=True)
    stiffness: Float[Array, ""] | float

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint, 1.0)

    def torque(self, angle, rate):
        return self.stiffness * angle**3


def force(effect: AbstractEffect, x: Signal, v: Signal, stiffness: Signal, smoothing: float) -> Signal:
    """Force of an effect against the motion x, v at its place, beside what the machine's matrices say.

    Biased where a law has a corner: Coulomb friction is smoothed over `smoothing`, so that a mass at rest creeps under
    a force below its level, and play rounds its corners over a tenth of the half gap. Friction that depends on a load
    gets a load of 0. Play and hardening fail where the machine has no spring at the place: they take from it.

    **Arguments:** `effect`: at the place. `x`, `v`: (*run,), rad and rad/s, or m and m/s. `stiffness`: of the machine's
    own spring there, N m/rad, which play and hardening take from. `smoothing`: speed at which Coulomb friction has 76 %
    of its level, rad/s or m/s.

    **Returns:** the force against the motion, (*run,), N m or N.

    **Raises:** `jaxfrf.InputError` for effects that need a robot (gears, sensors, motors with a controller).

    **Source:** as each of the effects says; the smoothing is this project's own.
    """
    if isinstance(effect, CoulombFriction):
        return effect.level * jnp.tanh(v / smoothing)
    if isinstance(effect, ViscousFriction):
        return effect.coefficient * v
    if isinstance(effect, AbstractArmTorque):
        return effect.torque(x, v)
    if isinstance(effect, AbstractFriction):
        return effect.torque(v, jnp.zeros_like(v))
    if isinstance(effect, AbstractMotorTorque):
        return -effect.torque(x)
    if isinstance(effect, StiffnessHardening):
        return -stiffness * (1.0 - effect.ratio) * effect.knee * jnp.tanh(x / effect.knee)
    if isinstance(effect, Backlash):
        # Inside the gap the spring is gone; corners rounded over a tenth of the gap, as in a gear.
        half = 0.5 * effect.gap
        width = 0.1 * half + 1e-300
        corner = width * (jnp.logaddexp(0.0, (x - half) / width) - jnp.logaddexp(0.0, (-x - half) / width))
        return stiffness * (corner - x)
    raise input_error(
        "effects",
        type(effect).__name__,
        "friction, springs, play, or a torque by angle or speed",
        "Effects of gears, sensors and drives need a robot.",
    )
