"""Friction of motors and joints."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Float

from .._errors import input_error
from .._text import number
from .._types import Array
from ._place import axis_of, changed, coulomb, own
from .effect import Candidate, Joint, OwnNumber, Reach, Swing
from .insertion import AbstractArmTorque, AbstractFriction, AbstractStructure

if TYPE_CHECKING:
    from ..robot import Robot

Number = Float[Array, ""] | float

_SMOOTHING = 0.2  # rad/s, where nothing says which
_WIDTHS = (2.0, 5.0)  # rad/s, of Stribeck's hump, that are tried
_STICKING = ((2.0, 1.5), (2.0, 4.0), (6.0, 1.5), (6.0, 4.0))  # times just visible, rad/s: where fits of loud ones begin
_SAME_TURN = 1.5  # times the width over which the robot's friction turns: within it so does the hump
_HUMP, _SPEEDS = 4.0, 200  # widths up to which two humps are compared, speeds
_PARTS = (0.02, 0.05, 0.1, 0.2)  # of the largest speed of a measured motion: widths that are tried along it
_TURN = 0.02  # of that speed: within it friction has changed its sign, whatever the units


def _own_smoothing(robot: "Robot", otherwise: float) -> float:
    """Over which the robot's own friction changes its sign, rad/s."""
    return float(getattr(robot.drives.friction, "smoothing", otherwise))


def _along_motion(robot: "Robot", reach: Reach) -> float:
    """The same of friction along a measured motion."""
    return min(_own_smoothing(robot, math.inf), _TURN * reach.speed)


def _turning(typical: Any, robot: "Robot", reach: Reach) -> tuple[Candidate, ...]:
    """Friction with a smoothing of its own, which follows the speed of a measured motion."""
    effect = eqx.tree_at(lambda e: e.smoothing, typical, _along_motion(robot, reach))
    return (effect.candidate(*effect.plausible(robot, effect.joint)),)


class CoulombFriction(AbstractStructure):
    """More (or less) Coulomb friction of a motor, tau = level tanh(v/eps); eps is the robot's smoothing.

    **Arguments:** `joint`: a driven joint, name or number. `level`: N m, motor side, added to the robot's own; 0.2 Fc
    is visible, -Fc to 2 Fc plausible.

    In data: the torque residual steps with the sign of the speed; damping in G falls with amplitude, 2 level/(pi A)
    on a slow sine of speed A; odd distortion. In the linearised robot: by that gain, see
    `jaxfrf.robot.describing_friction`.

    **Raises:** (in `with_effects`) `jaxfrf.InputError` where the robot's friction is a law without a Coulomb part.

    **Source:** Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138, where the sign is not
    smoothed.
    """

    name: ClassVar = "coulomb_friction"
    units: ClassVar = {"level": "N m"}
    bounds: ClassVar = {"level": (-1.0, 2.0)}
    signature: ClassVar = "the torque residual steps with the sign of the speed; odd distortion"
    confusable: ClassVar = {"viscous_friction": "another amplitude of the slow motion"}
    is_error: ClassVar = True

    joint: Joint = eqx.field(static=True)
    level: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.2 * own(robot, joint, coulomb(robot), 0.1))

    @classmethod
    def plausible(cls, robot: "Robot", joint: Joint):
        """As far below as the robot's own friction, where it states some."""
        stated = getattr(robot.drives.friction, "coulomb", None)
        least = cls.bounds["level"][0] if stated is None else -float(stated[axis_of(robot, joint)])
        return least, cls.bounds["level"][1]

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        axis = axis_of(robot, self.joint)
        return (OwnNumber(f"{robot.axis_names[axis]}.{self.name}", "level", float(coulomb(robot)[axis])),)

    def apply(self, robot: "Robot"):
        axis = axis_of(robot, self.joint)
        if not hasattr(robot.drives.friction, "coulomb"):
            law = type(robot.drives.friction).__name__
            raise input_error(
                f"friction of {robot.name}", law, "a law with Coulomb friction", "Use jaxfrf.robot.Friction."
            )
        return changed(robot, lambda r: r.drives.friction.coulomb, lambda x: x.at[axis].add(self.level))

    @classmethod
    def of_swing(cls, place: str, swing: Swing) -> Self | None:
        return cls(place, swing.force)

    def against(self, x, v, stiffness, smoothing):
        return self.level * jnp.tanh(v / smoothing)


class ViscousFriction(AbstractStructure):
    """More (or less) viscous friction of a motor, tau = coefficient v.

    **Arguments:** `joint`: a driven joint, name or number. `coefficient`: N m s/rad, motor side, added to the robot's
    own; 0.5 Fv is visible, up to 10 Fv plausible.

    In data: a torque residual that is linear in the speed. In the linearised robot: exactly.

    **Source:** Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138.
    """

    name: ClassVar = "viscous_friction"
    units: ClassVar = {"coefficient": "N m s/rad"}
    bounds: ClassVar = {"coefficient": (0.0, 2e-2)}
    signature: ClassVar = "a torque residual linear in the motor's speed"
    confusable: ClassVar = {
        "arm_viscous_friction": "depth of the antiresonances; more positions",
        "coulomb_friction": "another amplitude of the slow motion",
    }
    is_error: ClassVar = True

    joint: Joint = eqx.field(static=True)
    coefficient: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.5 * own(robot, joint, robot.drives.friction.viscous, 1e-3))

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        axis = axis_of(robot, self.joint)
        own = float(robot.drives.friction.viscous[axis])
        return (OwnNumber(f"{robot.axis_names[axis]}.{self.name}", "coefficient", own),)

    def apply(self, robot: "Robot"):
        axis = axis_of(robot, self.joint)
        return changed(robot, lambda r: r.drives.friction.viscous, lambda x: x.at[axis].add(self.coefficient))

    def against(self, x, v, stiffness, smoothing):
        return self.coefficient * v


class ArmViscousFriction(AbstractArmTorque):
    """Viscous friction of the arm's bearing, tau = coefficient q_a'.

    **Arguments:** `joint`: a driven joint, name or number. `coefficient`: N m s/rad, arm side, 0 or more; 0.5 Fv n^2 is
    visible.

    In data: antiresonances fill up. In the linearised robot: exactly.

    **Source:** a definition, the viscous term of Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994)
    1083-1138, on the arm side.
    """

    name: ClassVar = "arm_viscous_friction"
    units: ClassVar = {"coefficient": "N m s/rad"}
    bounds: ClassVar = {"coefficient": (0.0, 200.0)}
    signature: ClassVar = "antiresonances fill up"
    confusable: ClassVar = {
        "viscous_friction": "depth of the antiresonances; more positions",
        "structural_damping": "positions with other mode frequencies",
    }
    imitated_by: ClassVar = ("viscous_friction", "damping")

    joint: Joint = eqx.field(static=True)
    coefficient: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        gear = robot.drives.gear_ratio[axis_of(robot, joint)]
        return cls(joint, 0.5 * own(robot, joint, robot.drives.friction.viscous, 1e-3) * gear**2)

    @classmethod
    def starts(cls, robot: "Robot", fitted: "Robot", joint: Joint) -> tuple[Self, ...]:
        """What the motor's viscous friction was raised by in its place, referred to the arm."""
        axis = axis_of(robot, joint)
        now, given = (float(r.drives.friction.viscous[axis]) for r in (fitted, robot))
        gear = float(robot.drives.gear_ratio[axis])
        return (cls(joint, (now - given) * gear**2) if now > given else cls.typical(robot, joint),)

    @classmethod
    def over_band(cls, robot: "Robot", joint: Joint, low: float, high: float) -> tuple[Candidate, ...]:
        """None behind a rigid transmission: there it is one with the motor's."""
        if axis_of(robot, joint) not in robot.flexible_axes:
            return ()
        return super().over_band(robot, joint, low, high)

    def torque(self, angle, rate):
        return self.coefficient * rate


class StribeckFriction(AbstractFriction):
    """Friction that rises at low speed, tau = level exp(-(v/width)^2) tanh(v/smoothing); level = Fs - Fc.

    **Arguments:** `joint`: a driven joint, name or number. `level`: N m, motor side, 0 or more; 0.3 Fc is visible.
    `width`: v_s, 1-10 rad/s. `smoothing`: eps, rad/s.

    In data: a hump of the torque residual near zero speed. In the linearised robot: by the describing gain, which
    vanishes for slow sines much faster than `width` (rise and fall cancel).

    **Source:** Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138, the law with exponent 2,
    smoothed.
    """

    name: ClassVar = "stribeck_friction"
    units: ClassVar = {"level": "N m", "width": "rad/s", "smoothing": "rad/s"}
    bounds: ClassVar = {"level": (0.0, 1.0), "width": (1.0, 10.0), "smoothing": (0.01, 1.0)}
    signature: ClassVar = "a hump of the torque residual near zero speed"
    confusable: ClassVar = {"coulomb_friction": "slow runs", "gear_hysteresis": "slow runs"}
    imitated_by: ClassVar = ("viscous_friction", "coulomb_friction")

    joint: Joint = eqx.field(static=True)
    level: Number
    width: Number = 2.0
    smoothing: Number = _SMOOTHING

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        level = 0.3 * own(robot, joint, coulomb(robot), 0.1)
        return cls(joint, level, smoothing=_own_smoothing(robot, _SMOOTHING))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        typical, bounds = cls.typical(robot, joint), cls.plausible(robot, joint)
        these = [eqx.tree_at(lambda e: e.width, typical, width) for width in _WIDTHS]
        return tuple(e.candidate(*bounds, f"width {e.width:g} rad/s") for e in these)

    @classmethod
    def starts(cls, robot: "Robot", fitted: "Robot", joint: Joint) -> tuple[Self, ...]:
        """So much that the motor sticks, which no small amount of it shows."""
        typical = cls.typical(robot, joint)
        return tuple(cls(joint, times * typical.level, width, typical.smoothing) for times, width in _STICKING)

    def elsewhere(self, robot: "Robot") -> tuple[Self, ...]:
        """The same hump, as nearly as there is one, that turns where the robot's own friction does: level and width
        are not told well apart from how fast it turns."""
        turn, own = float(self.smoothing), _own_smoothing(robot, _SMOOTHING)
        if float(self.level) <= 0.0 or max(turn / own, own / turn) < _SAME_TURN:
            return ()
        speed = np.linspace(0.0, _HUMP * float(self.width), _SPEEDS)
        hump = lambda x, smoothing: np.exp(x[0] - np.square(speed / np.exp(x[1]))) * np.tanh(speed / smoothing)
        start = np.log([float(self.level), float(self.width)])
        found = scipy.optimize.least_squares(lambda x: (hump(x, own) - hump(start, turn)) / float(self.level), start)
        level, width = map(float, np.exp(found.x))
        return (type(self)(self.joint, level, width, own),)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        level, smoothing, bounds = (
            cls.typical(robot, joint).level,
            _along_motion(robot, reach),
            cls.plausible(robot, joint),
        )
        these = [cls(joint, level, part * reach.speed, smoothing) for part in _PARTS]
        return tuple(e.candidate(*bounds, f"width {number(e.width)} rad/s") for e in these)

    def torque(self, speed, load):
        return self.level * jnp.exp(-jnp.square(speed / self.width)) * jnp.tanh(speed / self.smoothing)

    @classmethod
    def of_swing(cls, place: str, swing: Swing) -> Self | None:
        return cls(place, swing.force, 0.2 * swing.speed, swing.turn)


class FrictionAsymmetry(AbstractFriction):
    """Friction that differs by direction, tau = offset + level tanh(v/smoothing).

    Forward it is level + offset, backward level - offset. An offset of the drive's torque, or of its measurement, is
    the same law: no motion tells which.

    **Arguments:** `joint`: a driven joint, name or number. `offset`: N m, motor side, either sign; 0.1 Fc is visible.
    `level`: N m. `smoothing`: rad/s.

    In data: a constant torque residual and *even* distortion. In the linearised robot: by the describing gain, to
    which the offset adds nothing.

    **Source:** a definition: Coulomb friction of its own in each direction, written as mean and half of the difference,
    the sign smoothed. The offset is that of Janot, Gautier & Brunot, Data Set and Reference Models of EMPS, 2019.
    """

    name: ClassVar = "friction_asymmetry"
    units: ClassVar = {"offset": "N m", "level": "N m", "smoothing": "rad/s"}
    bounds: ClassVar = {"offset": (-0.5, 0.5), "level": (-0.5, 0.5), "smoothing": (0.01, 1.0)}
    signature: ClassVar = "a constant torque residual, as an offset of the torque or its measurement; even distortion"
    confusable: ClassVar = {"counterbalance": "positions: gravity varies with the arm angle"}
    shapes: ClassVar = ("level", "smoothing")
    drive_number: ClassVar = "torque_offset"

    joint: Joint = eqx.field(static=True)
    offset: Number
    level: Number = 0.0
    smoothing: Number = _SMOOTHING

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        offset = 0.1 * own(robot, joint, coulomb(robot), 0.1)
        return cls(joint, offset, smoothing=_own_smoothing(robot, _SMOOTHING))

    @classmethod
    def in_drive(cls, joint: Joint, value: float, had: Sequence[Self]) -> Self | None:
        return None if value == 0.0 else cls(joint, value, sum(float(e.level) for e in had))

    @classmethod
    def of_swing(cls, place: str, swing: Swing) -> Self | None:
        return cls(place, 0.5 * swing.force, 0.0, swing.turn)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        return _turning(cls.typical(robot, joint), robot, reach)

    def torque(self, speed, load):
        return self.offset + self.level * jnp.tanh(speed / self.smoothing)


class LoadDependentFriction(AbstractFriction):
    """Friction that grows with the gear's load, tau = coefficient |tau_g|/n tanh(v/smoothing).

    **Arguments:** `joint`: a driven joint, name or number. `coefficient`: mu, 0-0.15; 0.02 is visible. `smoothing`:
    rad/s.

    In data: the torque residual's step at zero speed grows with the gear torque. In the linearised robot: by the
    describing gain at the load of gravity. With a rigid transmission the motor torque stands for the load.

    **Source:** Hamon, Gautier & Garrec, Dynamic identification of robots with a dry friction model depending on load
    and velocity, IROS 2010: the term in proportion to the load, alike in both directions of power, the sign smoothed.
    """

    name: ClassVar = "load_dependent_friction"
    units: ClassVar = {"coefficient": "1", "smoothing": "rad/s"}
    bounds: ClassVar = {"coefficient": (0.0, 0.15), "smoothing": (0.01, 1.0)}
    signature: ClassVar = "the step of the torque residual at zero speed grows with the gear torque"
    confusable: ClassVar = {"coulomb_friction": "regress the step on |gear torque|: positions with other loads"}

    joint: Joint = eqx.field(static=True)
    coefficient: Number
    smoothing: Number = _SMOOTHING

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.02, _own_smoothing(robot, _SMOOTHING))

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        return _turning(cls.typical(robot, joint), robot, reach)

    def torque(self, speed, load):
        return self.coefficient * jnp.abs(load) * jnp.tanh(speed / self.smoothing)
