"""What an effect of the library is at a place of a machine: a force against its motion."""

from typing import ClassVar

import equinox as eqx
from jaxtyping import Float

from .._types import Array
from ..effects import AbstractArmTorque, AbstractEffect, Swing

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

    @classmethod
    def of_swing(cls, place: str, swing: Swing):
        return cls(place, swing.force / swing.deflection**3) if swing.sprung else None

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
    return effect.against(x, v, stiffness, smoothing)
