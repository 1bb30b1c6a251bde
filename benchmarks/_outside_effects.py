"""What machines do and `jaxfrf.effects` does not hold: presliding friction, a gain that drifts, a bumper.

A diagnosis has no name for them, and should say so. They stand on a robot as other effects do
(`robot.with_effects`) and act in MuJoCo's runs (`_mujoco_loop`); the last two in `jaxfrf.simulate` as well.
"""

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxfrf.effects import AbstractActuator, AbstractArmTorque, AbstractEffect
from jaxfrf.effects._place import axis_of

Joint = int | str
Number = Float[Array, ""] | float


class PreslidingFriction(AbstractEffect):
    """LuGre friction in place of the motor's Coulomb friction: bristles that give way over `distance`.

        z' = v - |v| z/distance,   tau = c z/distance + s z',   s = .6 sqrt(c J/distance)

    with the motor's own Coulomb friction c and inertia J; no Stribeck effect, which the library has. In MuJoCo's
    runs only: `jaxfrf.simulate` passes it over.

    **Arguments:** `distance`: rad, motor side; .1 is visible.

    **Source:** Canudas de Wit, Olsson, Astrom & Lischinsky, IEEE Trans. Automatic Control 40 (1995).
    """

    name: ClassVar = "presliding_friction"
    units: ClassVar = {"distance": "rad"}
    bounds: ClassVar = {"distance": (0.0, 2.0)}
    signature: ClassVar = "friction that turns over a distance, not with the speed"
    confusable: ClassVar = {"gear_hysteresis": "a loop over the motor's angle, not over the deflection"}

    joint: Joint = eqx.field(static=True)
    distance: Number

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint, 0.1)


class GainDrift(AbstractActuator):
    """A torque gain that drifts over the record, 1 - swing/2 at its start to 1 + swing/2 at its end.

    **Arguments:** `swing`: either sign; .06 is visible (1.7 % rms). `begin`, `length`: s, of the record in a run.
    """

    name: ClassVar = "gain_drift"
    units: ClassVar = {"swing": "1", "begin": "s", "length": "s"}
    bounds: ClassVar = {"swing": (-0.5, 0.5), "begin": (0.0, math.inf), "length": (0.0, math.inf)}
    signature: ClassVar = "the torque residual grows from one end of the record to the other"
    confusable: ClassVar = {}

    joint: Joint = eqx.field(static=True)
    swing: Number
    begin: Number = 5.0
    length: Number = 8.0

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint, 0.06)

    def start(self, torque, step):
        return jnp.zeros_like(torque)  # time since the start of the run

    def advance(self, state, torque, step):
        gone = jnp.clip((state - self.begin) / self.length, 0.0, 1.0)
        return (1.0 + self.swing * (gone - 0.5)) * torque, state + torque.shape[0] * step

    def response(self, s):
        return jnp.ones_like(s)


class Bumper(AbstractArmTorque):
    """A stiff end stop on one side, tau = stiffness max(side (q_a - stop), 0) side.

    **Arguments:** `stop`: rad. `side`: 1 above, -1 below. `stiffness`: N m/rad, arm side; what lets the motor feel
    as much as its Coulomb friction at a depth of .03 rad is visible.
    """

    name: ClassVar = "bumper"
    units: ClassVar = {"stop": "rad", "side": "1", "stiffness": "N m/rad"}
    bounds: ClassVar = {"stop": (-math.pi, math.pi), "side": (-1.0, 1.0), "stiffness": (0.0, 1e6)}
    signature: ClassVar = "torque at one end of the motion of some positions"
    confusable: ClassVar = {}

    joint: Joint = eqx.field(static=True)
    stop: Number
    side: Number
    stiffness: Number

    @classmethod
    def typical(cls, robot, joint):
        axis = axis_of(robot, joint)
        drives = robot.drives
        return cls(joint, 0.0, 1.0, drives.friction.coulomb[axis] * drives.gear_ratio[axis] / 0.03)

    def torque(self, angle, rate):
        return self.stiffness * self.side * jnp.maximum(self.side * (angle - self.stop), 0.0)


OUTSIDE = {kind.name: kind for kind in (PreslidingFriction, GainDrift, Bumper)}
