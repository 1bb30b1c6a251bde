"""Changes of the robot itself: masses, joints, and torques on the arm."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from .._types import Array
from ._place import arm_torque_limit, axis_of, changed, spring_of
from .effect import Candidate, Joint, OwnNumber, Reach
from .insertion import AbstractArmTorque, AbstractStructure

if TYPE_CHECKING:
    from ..robot import Robot

Number = Float[Array, ""] | float

# What is tried of shapes that enter nonlinearly:
_HINGES = (0.5, 1.25, 3.0, 7.5)  # times the stiffness of the joint's transmission
_LASTING = 5000.0  # 1/s, stiffness over damping of a hinge
_STIFF = 5e5  # N m/rad, where no transmission bends
_VISIBLE = 0.02  # of the torque limit, that a spring takes over a radian where it is just visible


class MotorInertia(AbstractStructure):
    """An error of the motor's inertia.

    **Arguments:** `joint`: a driven joint, name or number. `increase`: kg m^2, motor side, either sign; 3 % is visible.

    In data: gain at high frequency on the motor's own diagonal. In the linearised robot: exactly.

    **Source:** a definition: one diagonal element of M_m in the paper, section III.A, the rotor of Spong, J. Dynamic
    Systems, Measurement, and Control 109 (1987) 310-319.
    """

    name: ClassVar = "motor_inertia"
    units: ClassVar = {"increase": "kg m^2"}
    bounds: ClassVar = {"increase": (-1e-3, 1e-2)}
    signature: ClassVar = "gain at high frequency on one diagonal element"
    confusable: ClassVar = {"torque_constant": "high against low frequencies"}
    is_error: ClassVar = True

    joint: Joint = eqx.field(static=True)
    increase: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.03 * robot.drives.motor_inertia[axis_of(robot, joint)])

    @classmethod
    def plausible(cls, robot: "Robot", joint: Joint):
        """Half to twice the robot's own, or more where motors are small."""
        own = float(robot.drives.motor_inertia[axis_of(robot, joint)])
        return -0.5 * own, max(cls.bounds["increase"][1], own)

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        axis = axis_of(robot, self.joint)
        own = float(robot.drives.motor_inertia[axis])
        return (OwnNumber(f"{robot.axis_names[axis]}.{self.name}", "increase", own),)

    def apply(self, robot: "Robot"):
        axis = axis_of(robot, self.joint)
        return changed(robot, lambda r: r.drives.motor_inertia, lambda x: x.at[axis].add(self.increase))


class Payload(AbstractStructure):
    """A mass that is fixed to a link: the last one, or the one after `joint`.

    A point mass: mass, centre of mass and inertia of the link follow together.

    **Arguments:** `mass`: kg, either sign; 5 % of the payload is visible. `place`: in the link's frame, (3,), m; the
    link's own centre of mass where it is `None`. `joint`: any joint's name or number in the chain; "" = the last.

    In data: coherent over axes and positions; static torque. In the linearised robot: exactly.

    **Source:** closed form (masses add, tensors by the parallel-axis theorem). Loads as inertial parameters of the last
    link: Atkeson, An & Hollerbach, Int. J. Robotics Research 5 (1986) 101-119.
    """

    name: ClassVar = "payload"
    units: ClassVar = {"mass": "kg", "place": "m"}
    bounds: ClassVar = {"mass": (-20.0, 50.0), "place": (-1.0, 1.0)}
    signature: ClassVar = "coherent over axes and positions; static torque"
    confusable: ClassVar = {"payload": "mass against centre of mass: several positions"}
    is_error: ClassVar = True
    untold: ClassVar = (
        "Was it carrying a load that nobody told? State it (a `payload`, or identify's --payload) and ask again: as "
        "the link's own it stays short, and others make up for it."
    )

    mass: Number  # type: ignore[misc]  # equinox orders fields as they stand here
    place: Float[Array, "3"] | None = None
    joint: Joint = eqx.field(static=True, default="")

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint = "") -> Self:
        return cls(mass=0.05 * jnp.maximum(robot.chain.mass[-1], 1.0), joint=joint)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """One of a robot, on its last link."""
        if axis_of(robot, joint) != robot.n_axes - 1:
            return ()
        low, high = cls.bounds["mass"]
        low = max(low, -_OF_A_LINK * float(robot.chain.mass[-1]))
        visible = float(cls.typical(robot).mass)
        return (Candidate(cls.name, "", (cls(mass=1.0),), _carried, (low,), (high,), visible),)

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        link = _link_of(robot, self.joint)
        return (OwnNumber(f"{robot.joint_names[link]}.mass", "mass", float(robot.chain.mass[link])),)

    def unknown_beside(self, robot: "Robot") -> dict[str, float]:
        """Where it sits, and how far it reaches from there."""
        name = robot.joint_names[_link_of(robot, self.joint)]
        return {f"{name}.com": math.inf, f"{name}.inertia": _AROUND}

    def fitted_beside(self, robot: "Robot", values: Mapping[str, float]) -> Self:
        """Where it must be for the centre of its link to be where it was found."""
        link = _link_of(robot, self.joint)
        given, mass, more = np.asarray(robot.chain.com[link], float), float(robot.chain.mass[link]), float(self.mass)
        if abs(more) <= 1e-9:
            return dataclasses.replace(self, place=None)
        names = (f"{robot.joint_names[link]}.com.{element}" for element in "xyz")
        centre = np.array([values.get(name, at) for name, at in zip(names, given, strict=True)])
        return dataclasses.replace(self, place=jnp.asarray(given + (centre - given) * (mass + more) / more))

    def apply(self, robot: "Robot"):
        chain = robot.chain
        link = _link_of(robot, self.joint)
        mass, com, inertia = (jnp.asarray(x) for x in (chain.mass, chain.com, chain.inertia))
        place = com[link] if self.place is None else jnp.asarray(self.place)
        total = mass[link] + self.mass
        centre = (mass[link] * com[link] + self.mass * place) / total
        more = mass[link] * _about(com[link] - centre) + self.mass * _about(place - centre)
        values = mass.at[link].set(total), com.at[link].set(centre), inertia.at[link].add(more)
        return eqx.tree_at(lambda r: (r.chain.mass, r.chain.com, r.chain.inertia), robot, values)


_OF_A_LINK = 0.9  # that a payload may take away
_AROUND = 0.3  # of the tensor of the link that carries it, by its own extent


def _carried(c):
    return Payload(float(c[0]))


def _link_of(robot: "Robot", joint: Joint) -> int:
    if joint == "":
        return robot.chain.n_joints - 1
    if isinstance(joint, str) and joint in robot.joint_names:
        return robot.joint_names.index(joint)
    return robot.driven_joints[axis_of(robot, joint)]


def _about(v):
    """Inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz of a unit point mass at v."""
    x, y, z = v
    return jnp.stack([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z])


class ExtraFlexibility(AbstractStructure):
    """Another elastic joint, across a transmission: the link before `joint` bends or twists about `axis`.

    The joint sits at the origin of `joint`'s frame, just before it; it adds a coordinate q_e. There is no mass between
    the two: its axis must not be parallel to the joint's own, or the inertia is singular.

    **Arguments:** `axis`: of the new joint, (3,), in the frame of `joint` at zero. `stiffness`: N m/rad, above 0.
    `damping`: N m s/rad.

    In data: one more pair of antiresonance and resonance in a narrow band. In the linearised robot: exactly.

    **Raises:** (in `with_effects`) `jaxfrf.InputError` for an axis along the joint's own or of no length, and where the
    joint has such a flexibility already.

    **Source:** Moberg, Wernholt, Hanssen & Brogårdh, J. Dynamic Systems, Measurement, and Control 136 (2014) 031005,
    the extended flexible joint model; q_e of the paper, section III.A. The spring and damper are linear.
    """

    name: ClassVar = "extra_flexibility"
    units: ClassVar = {"axis": "1", "stiffness": "N m/rad", "damping": "N m s/rad"}
    bounds: ClassVar = {"axis": (-1.0, 1.0), "stiffness": (1.0, 1e9), "damping": (0.0, 1e6)}
    signature: ClassVar = "one more pair of antiresonance and resonance in a narrow band"
    confusable: ClassVar = {"stiffness error": "number of modes"}

    joint: Joint = eqx.field(static=True)
    axis: Float[Array, "3"]
    stiffness: Number
    damping: Number = 50.0

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        across = np.roll(np.abs(np.round(np.asarray(robot.chain.axis[robot.driven_joints[axis_of(robot, joint)]]))), 1)
        stiffness = 2.0 * _usual_stiffness(robot, joint)
        return cls(joint, across, stiffness, stiffness / _LASTING)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """About the axes of the joint's frame that are across its own, at some stiffnesses: as compliances."""
        robot.with_effects(cls.typical(robot, joint))
        own = np.asarray(robot.chain.axis)[robot.driven_joints[axis_of(robot, joint)]]
        found = []
        for axis in np.eye(3):
            if np.linalg.norm(np.cross(axis, own)) < 0.5:
                continue
            for stiffness in np.array(_HINGES) * _usual_stiffness(robot, joint):
                basis = cls(joint, axis, stiffness, stiffness / _LASTING)
                make = functools.partial(_hinged, joint, tuple(axis), stiffness)
                label = f"axis {np.round(axis).astype(int).tolist()}, {stiffness:g} N m/rad"
                found.append(Candidate(cls.name, str(joint), (basis,), make, (0.3,), (2.0,), 0.3, label))
        return tuple(found)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        raise input_error(cls.name, "a measured motion", "a simulated one: links are rigid here", "Use other records.")

    @classmethod
    def over_band(cls, robot: "Robot", joint: Joint, low: float, high: float) -> tuple[Candidate, ...]:
        raise input_error(cls.name, "a single drive", "a robot: it bends across the axis", "See `ElasticLoad`.")

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        name = f"{robot.joint_names[robot.driven_joints[axis_of(robot, self.joint)]]}_flexibility"
        return OwnNumber(f"{name}.stiffness", "stiffness"), OwnNumber(f"{name}.damping", "damping")

    def apply(self, robot: "Robot"):
        at = robot.driven_joints[axis_of(robot, self.joint)]
        name = f"{robot.joint_names[at]}_flexibility"
        if name in robot.joint_names:
            raise input_error(f"{robot.name}", f"an elastic joint {name!r} already", "one", "Change that one.")
        chain, axis = robot.chain, jnp.asarray(self.axis, float)
        _check_across(axis, chain.axis[at], robot.joint_names[at])
        chain = chain.with_hinge(at, axis)
        before = sum(1 for joint in robot.elastic_joints if joint < at)
        spring = robot.n_motors + before
        springs, add = robot.springs, lambda x, v: jnp.insert(jnp.asarray(x), spring, v)
        springs = dataclasses.replace(
            springs,
            stiffness=add(springs.stiffness, self.stiffness),
            damping=add(springs.damping, self.damping),
            stiffness_ratio=add(springs.stiffness_ratio, 1.0),
            stiffness_knee=add(springs.stiffness_knee, 2.9e-4),
            backlash=None if springs.backlash is None else add(springs.backlash, 0.0),
        )
        put = lambda x, value: (*x[:at], value, *x[at:])
        return dataclasses.replace(
            robot,
            chain=chain,
            springs=springs,
            joint_names=put(robot.joint_names, name),
            driven=put(robot.driven, False),
            stiff=put(robot.stiff, False),
        )


def _usual_stiffness(robot: "Robot", joint: Joint) -> float:
    """Of the transmission of a joint, N m/rad; where it is rigid, that of the others."""
    springs = np.asarray(robot.springs.stiffness, float)
    if axis_of(robot, joint) in robot.flexible_axes:
        return float(springs[spring_of(robot, joint)])
    return float(np.median(springs)) if len(springs) else _STIFF


def _hinged(joint, axis, stiffness, c):
    k = stiffness / float(c[0])
    return ExtraFlexibility(joint, axis, k, k / _LASTING)


def _check_across(axis, own, name: str) -> None:
    """Refuse an axis along the joint's own, where the values are known (they are not while being differentiated)."""
    if isinstance(axis, jax.core.Tracer) or isinstance(own, jax.core.Tracer):
        return
    across = np.linalg.norm(np.cross(np.asarray(axis), np.asarray(own)))
    if not across > 1e-3 * np.linalg.norm(axis):
        raise input_error(
            "extra_flexibility: axis",
            f"{np.asarray(axis).tolist()}, along the axis of {name} or zero",
            "an axis across it",
            "There is no mass between the two joints; along its own axis change the joint's stiffness.",
        )


class Counterbalance(AbstractArmTorque):
    """A spring that carries part of the arm's weight, tau = stiffness (q_a - rest).

    **Arguments:** `joint`: a driven joint, name or number. `stiffness`: N m/rad, arm side. `rest`: rad.

    In data: static torque against position, little change of G. In the linearised robot: exactly.

    **Source:** a definition, a linear spring.
    """

    name: ClassVar = "counterbalance"
    units: ClassVar = {"stiffness": "N m/rad", "rest": "rad"}
    bounds: ClassVar = {"stiffness": (-500.0, 2000.0), "rest": (-math.pi, math.pi)}
    signature: ClassVar = "static torque against position, little change of G"
    confusable: ClassVar = {"friction_asymmetry": "positions", "dress_pack": "which joints"}
    same_law: ClassVar = ("dress_pack",)

    joint: Joint = eqx.field(static=True)
    stiffness: Number
    rest: Number = 0.0

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, _visible_spring(robot, joint, 20.0))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """Where gravity acts: on the other axes the same law is that of hoses."""
        return _springs(cls, robot, joint) if _carries_weight(robot, joint) else ()

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        """On every joint, at rest somewhere."""
        return _springs(cls, robot, joint)[1:]

    def torque(self, angle, rate):
        return self.stiffness * (angle - self.rest)


class DressPack(AbstractArmTorque):
    """Hoses and cables along a joint, tau = stiffness (q_a - rest) + damping q_a'.

    **Arguments:** `joint`: a driven joint, name or number. `stiffness`: N m/rad, arm side, 0 or more; 50 is visible,
    on a small joint what takes a fiftieth of its torque limit over a radian. `rest`: rad. `damping`: N m s/rad.

    In data: static torque that is linear in the angles of joints 1, 4 and 6. In the linearised robot: exactly.

    **Source:** a definition, a linear spring and damper.
    """

    name: ClassVar = "dress_pack"
    units: ClassVar = {"stiffness": "N m/rad", "rest": "rad", "damping": "N m s/rad"}
    bounds: ClassVar = {"stiffness": (0.0, 500.0), "rest": (-math.pi, math.pi), "damping": (0.0, 100.0)}
    signature: ClassVar = "static torque linear in the angles of joints 1, 4 and 6"
    confusable: ClassVar = {"counterbalance": "which joints; a damping of its own"}
    same_law: ClassVar = ("counterbalance",)

    joint: Joint = eqx.field(static=True)
    stiffness: Number
    rest: Number = 0.0
    damping: Number = 0.0

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, _visible_spring(robot, joint, 50.0))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """Where gravity does not act: on the other axes the same law is that of a counterbalance."""
        return () if _carries_weight(robot, joint) else _springs(cls, robot, joint)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        """On every joint, at rest somewhere."""
        return _springs(cls, robot, joint)[1:]

    def torque(self, angle, rate):
        return self.stiffness * (angle - self.rest) + self.damping * rate


class _Constant(AbstractArmTorque):
    """A constant torque against a joint: what the rest position of a spring adds."""

    name: ClassVar = "constant"
    units: ClassVar = {}
    bounds: ClassVar = {}
    signature: ClassVar = ""
    confusable: ClassVar = {}
    joint: Joint = eqx.field(static=True)

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint)

    def torque(self, angle, rate):
        return 1.0 + 0.0 * angle


def _visible_spring(robot: "Robot", joint: Joint, most: float) -> float:
    """N m/rad: what takes a part of the motor's torque over a radian, so that it is one of a wrist, too."""
    return min(most, _VISIBLE * (arm_torque_limit(robot, joint) or math.inf))


def _springs(kind, robot: "Robot", joint) -> tuple[Candidate, ...]:
    """A spring between the arm and the ground, at rest in zero and somewhere."""
    low, high = kind.bounds["stiffness"]
    visible = float(kind.typical(robot, joint).stiffness)
    make, unit, name = functools.partial(_at_rest, kind, joint), kind(joint, 1.0), kind.name
    return (
        Candidate(name, joint, (unit,), make, (low,), (high,), visible, "rest 0"),
        Candidate(
            name, joint, (unit, _Constant(joint)), make, (low, -math.inf), (high, math.inf), visible, "rest free"
        ),
    )


def _at_rest(kind, joint, c):
    stiffness = float(c[0])
    rest = -float(c[1]) / stiffness if len(c) > 1 and stiffness != 0.0 else 0.0
    return kind(joint, stiffness, float(np.clip(rest, -np.pi, np.pi)))


def _carries_weight(robot: "Robot", joint: Joint) -> bool:
    """Whether the axis, in the robot's zero position, is across gravity, and not one of the wrist."""
    axis = axis_of(robot, joint)
    direction = np.asarray(robot.chain.axis)[robot.driven_joints[axis]]
    gravity = np.asarray(robot.chain.gravity)
    across = np.linalg.norm(np.cross(direction, gravity)) > 0.5 * np.linalg.norm(gravity)
    return bool(across and axis < 3)
