"""Laws of a transmission's spring that are not linear."""

import functools
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from .._types import Array
from ._place import axis_of, changed, spring_of
from .effect import Candidate, Joint, OwnNumber, Swing
from .insertion import AbstractStructure

if TYPE_CHECKING:
    from ..robot import Robot

Number = Float[Array, ""] | float

# What is tried of shapes that enter nonlinearly:
_KNEES = (1e-4, 2.9e-4, 8e-4)  # rad
_GAPS = (1e-4, 2.9e-4, 6e-4)  # rad
_SPRING = ("stiffness", "stiffness_ratio", "stiffness_knee")  # of the robot's own


class StiffnessHardening(AbstractStructure):
    """A transmission that is softer about zero deflection, tau = k x - k (1 - ratio) knee tanh(x/knee).

    **Arguments:** `joint`: a driven joint, name or number. `ratio`: stiffness at zero over stiffness k at high
    deflection, up to 1; 0.6 is visible. `knee`: rad, arm side. They take the place of the robot's own; k stays.

    In data: mode frequencies rise with load and amplitude. In the linearised robot: exactly, by the tangent at the
    point of rest (or its mean over a `deflections`).

    **Raises:** (in `with_effects`) `jaxfrf.InputError` on a rigid transmission.

    **Source:** a definition of this project; the paper, section III.A, has nonlinear stiffness on joints 1 to 3 and
    does not state its form.
    """

    name: ClassVar = "stiffness_hardening"
    units: ClassVar = {"ratio": "1", "knee": "rad"}
    bounds: ClassVar = {"ratio": (0.1, 1.0), "knee": (3e-5, 3e-3)}
    signature: ClassVar = "mode frequencies rise with load and amplitude"
    confusable: ClassVar = {"backlash": "positions with preload", "payload": "another amplitude"}
    nothing: ClassVar = 1.0
    imitated_by: ClassVar = _SPRING

    joint: Joint = eqx.field(static=True)
    ratio: Number
    knee: Number = 2.9e-4

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.6)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """By how much softer than the robot's own spring is; at its own knee, where that is bent already."""
        robot.with_effects(cls.typical(robot, joint))
        spring = spring_of(robot, joint)
        own, knee = float(robot.springs.stiffness_ratio[spring]), float(robot.springs.stiffness_knee[spring])
        found = []
        for this in _KNEES if own >= 1.0 else (knee,):
            basis = cls(joint, own - 0.4 if own > 0.5 else own - 0.2, this)
            change = float(basis.ratio) - own
            make = functools.partial(_softened, joint, own, change, this)
            most = (cls.bounds["ratio"][0] - own) / change
            found.append(Candidate(cls.name, str(joint), (basis,), make, (0.0,), (most,), 1.0, f"knee {this:g} rad"))
        return tuple(found)

    @classmethod
    def starts(cls, robot: "Robot", fitted: "Robot", joint: Joint) -> tuple[Self, ...]:
        return tuple(cls(joint, 0.2, knee) for knee in (3e-4, 9e-4))

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        joint = robot.axis_names[axis_of(robot, self.joint)]
        return OwnNumber(f"{joint}.stiffness_ratio", "ratio"), OwnNumber(f"{joint}.stiffness_knee", "knee")

    def redefines(self, robot: "Robot") -> tuple[str, ...]:
        """The stiffness of a spring that was straight: it becomes that at high deflection."""
        straight = float(robot.springs.stiffness_ratio[spring_of(robot, self.joint)]) >= 1.0
        return (f"{robot.axis_names[axis_of(robot, self.joint)]}.stiffness",) if straight else ()

    def apply(self, robot: "Robot"):
        spring = spring_of(robot, self.joint)
        robot = changed(robot, lambda r: r.springs.stiffness_ratio, lambda x: x.at[spring].set(self.ratio))
        return changed(robot, lambda r: r.springs.stiffness_knee, lambda x: x.at[spring].set(self.knee))

    @classmethod
    def of_swing(cls, place: str, swing: Swing) -> Self | None:
        return cls(place, 0.8, swing.deflection) if swing.sprung else None

    def against(self, x, v, stiffness, smoothing):
        return -stiffness * (1.0 - self.ratio) * self.knee * jnp.tanh(x / self.knee)


def _softened(joint, own, change, knee, c):
    return StiffnessHardening(joint, own + change * float(c[0]), knee)


class Backlash(AbstractStructure):
    """Play in the gear: no torque while |x| < gap/2, then the spring's from the flank on; corners rounded.

    **Arguments:** `joint`: a driven joint, name or number. `gap`: b, rad, arm side, 0 or more; 1 arc minute (2.9e-4) is
    visible.

    In data: only where the gear carries no load; the resonance falls at low amplitude; odd distortion. In the
    linearised robot: exactly, by the tangent at the point of rest, a thousandth of k inside the gap.

    **Raises:** (in `with_effects`) `jaxfrf.InputError` on a rigid transmission.

    **Source:** Nordin & Gutman, Automatica 38 (2002) 1633-1649: the dead-zone model, here with rounded corners.
    """

    name: ClassVar = "backlash"
    units: ClassVar = {"gap": "rad"}
    bounds: ClassVar = {"gap": (0.0, 9e-4)}
    signature: ClassVar = "unloaded joints and positions only: the resonance falls at low amplitude; odd distortion"
    confusable: ClassVar = {"stiffness_hardening": "positions with preload, where it vanishes"}
    imitated_by: ClassVar = _SPRING

    joint: Joint = eqx.field(static=True)
    gap: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 2.9e-4)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None where the robot states a play of its own."""
        robot.with_effects(cls.typical(robot, joint))
        own = robot.springs.backlash
        if own is not None and float(own[spring_of(robot, joint)]) > 0:
            return ()
        return tuple(cls(joint, gap).candidate(0.2 * gap, 3.0 * gap, f"gap {gap:g} rad") for gap in _GAPS)

    @classmethod
    def starts(cls, robot: "Robot", fitted: "Robot", joint: Joint) -> tuple[Self, ...]:
        return tuple(cls(joint, gap) for gap in (6e-4, 9e-4))

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        return (OwnNumber(f"{robot.axis_names[axis_of(robot, self.joint)]}.backlash", "gap"),)

    def apply(self, robot: "Robot"):
        spring = spring_of(robot, self.joint)
        play = robot.springs.backlash
        play = jnp.zeros_like(robot.springs.stiffness) if play is None else jnp.asarray(play)
        return eqx.tree_at(
            lambda r: r.springs.backlash, robot, play.at[spring].set(self.gap), is_leaf=lambda x: x is None
        )

    @classmethod
    def of_swing(cls, place: str, swing: Swing) -> Self | None:
        return cls(place, 0.2 * swing.deflection) if swing.sprung else None

    def against(self, x, v, stiffness, smoothing):
        """Inside the gap the spring is gone; corners rounded over a tenth of the gap, as in a gear."""
        half = 0.5 * self.gap
        width = 0.1 * half + 1e-300
        corner = width * (jnp.logaddexp(0.0, (x - half) / width) - jnp.logaddexp(0.0, (-x - half) / width))
        return stiffness * (corner - x)
