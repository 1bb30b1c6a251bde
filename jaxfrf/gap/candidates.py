"""Which effects may be missing, and what a robot with each of them would ask of its motors.

A candidate is an effect on a joint whose unknowns enter the torque linearly: a few basis effects, each a column. What
enters nonlinearly (a knee, a width, a clipping level) is tried at several values, each a candidate of its own.
"""

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar

import equinox as eqx
import numpy as np

from .. import effects as fx
from ..effects import AbstractEffect
from ..effects._place import axis_of, spring_of
from ..robot import Robot
from ..robot.drive import Friction

_WIDTHS = (2.0, 5.0)  # rad/s
_KNEES = (1e-4, 2.9e-4, 8e-4)  # rad
_GAPS = (1e-4, 2.9e-4, 6e-4)  # rad
_SLIPS = (3e-5, 1e-4, 3e-4)  # rad
_CLIPPED = (0.9, 0.8, 0.65, 0.5, 0.4)  # of the largest command
_HINGES = (1e5, 2.5e5, 6e5, 1.5e6)  # N m/rad

Make = Callable[[np.ndarray], AbstractEffect]


class Candidate(eqx.Module):
    """An effect that may be missing.

    **Fields:** `name`, `joint`: of the effect. `basis`: effects whose signatures are the columns. `make`: the effect of
    coefficients, one for each column. `low`, `high`: bounds of the coefficients. `visible`: first coefficient of the
    effect that is just visible. `variant`: what tells it from others of the same effect and joint.
    """

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    basis: tuple[AbstractEffect, ...]
    make: Make = eqx.field(static=True)
    low: tuple[float, ...] = eqx.field(static=True)
    high: tuple[float, ...] = eqx.field(static=True)
    visible: float = eqx.field(static=True, default=1.0)
    variant: str = eqx.field(static=True, default="")

    @property
    def key(self) -> tuple[str, str]:
        return self.name, self.joint


def candidates(robot: Robot, largest: np.ndarray, more: Iterable[type[AbstractEffect]] = ()) -> tuple[Candidate, ...]:
    """Every effect of the library on every joint that it can act on, and `more` of the user's own.

    Those without a table here are tried by the range that their class states. Ripple and the errors of gears, whose
    orders are found in the data, and quantisation are not among them.

    **Arguments:** `largest`: command of every motor in the record, (axis,), N m, for the clipping levels.
    """
    found = []
    for joint in robot.axis_names:
        for table in dict.fromkeys(_TABLES.values()):
            found += table(robot, joint)
        found += _saturation(robot, joint, float(largest[axis_of(robot, joint)]))
    found += _payload(robot)
    for kind in (*_without_table(), *more):
        found += own_kind(kind, robot)
    return tuple(found)


def _without_table() -> list[type[AbstractEffect]]:
    """Effects of the library that only their class describes."""
    return [kind for name, kind in fx.library().items() if name not in _TABLES and name not in _ELSEWHERE]


def own_kind(kind: type[AbstractEffect], robot: Robot) -> list[Candidate]:
    """An effect known by its class alone on every joint that takes it, linear in its first parameter about none of it.

    A class whose first parameter is no single number, or typically zero, has no such direction: it is left out."""
    found = []
    for joint in robot.axis_names:
        try:
            typical = kind.typical(robot, joint)
            robot.with_effects(typical)
        except ValueError:
            continue
        first = next(iter(kind.units))
        value = np.asarray(getattr(typical, first))
        if value.size != 1 or not np.all(value):
            continue
        value = float(value.item())
        low, high = (b / value for b in kind.bounds.get(first, (-np.inf, np.inf)))
        found.append(_scaled(kind.name, joint, typical, first, value, (min(low, high), max(low, high))))
    return found


def _scaled(name, joint, typical, first, value, bounds, variant="") -> Candidate:
    """Linear in one parameter, whose coefficient counts the typical value."""
    make = functools.partial(_with, typical, first, value)
    return Candidate(name, joint, (typical,), make, (bounds[0],), (bounds[1],), 1.0, variant)


def _with(typical, first, value, c):
    return eqx.tree_at(lambda e: getattr(e, first), typical, float(value * c[0]))


def _plain(kind, first):
    """Effects that are linear in one parameter and need nothing else."""

    def table(robot: Robot, joint: str) -> list[Candidate]:
        effect = _fitting(kind, robot, joint)
        if effect is None:
            return []
        value = float(np.asarray(getattr(effect, first)))
        low, high = (b / value for b in _bounds(kind, first, robot, joint))
        return [_scaled(kind.name, joint, effect, first, value, (low, high))]

    return table


def _fitting(kind, robot: Robot, joint: str) -> AbstractEffect | None:
    """The typical effect, or none where the joint cannot have it."""
    try:
        effect = kind.typical(robot, joint)
        robot.with_effects(effect)
        if isinstance(effect, fx.AbstractGear):
            spring_of(robot, joint)
    except ValueError:
        return None
    return effect


def _bounds(kind, first, robot: Robot, joint: str):
    low, high = kind.bounds[first]
    if kind is fx.CoulombFriction and isinstance(robot.drives.friction, Friction):
        low = -float(robot.drives.friction.coulomb[axis_of(robot, joint)])
    if kind is fx.MotorInertia:
        own = float(robot.drives.motor_inertia[axis_of(robot, joint)])
        low, high = -0.5 * own, max(high, own)
    return low, high


def _stribeck(robot: Robot, joint: str) -> list[Candidate]:
    effect = fx.StribeckFriction.typical(robot, joint)
    found = []
    for width in _WIDTHS:
        this = eqx.tree_at(lambda e: e.width, effect, width)
        found.append(
            _scaled(
                "stribeck_friction",
                joint,
                this,
                "level",
                float(this.level),
                (0.0, 1.0 / float(this.level)),
                f"width {width:g} rad/s",
            )
        )
    return found


def _gaps(robot: Robot, joint: str) -> list[Candidate]:
    if _fitting(fx.Backlash, robot, joint) is None:
        return []
    own = robot.springs.backlash
    if own is not None and float(own[robot.flexible_axes.index(axis_of(robot, joint))]) > 0:
        return []
    return [
        _scaled("backlash", joint, fx.Backlash(joint, gap), "gap", gap, (0.2, 3.0), f"gap {gap:g} rad") for gap in _GAPS
    ]


def _hardening(robot: Robot, joint: str) -> list[Candidate]:
    if _fitting(fx.StiffnessHardening, robot, joint) is None:
        return []
    spring = robot.flexible_axes.index(axis_of(robot, joint))
    own, knee = float(robot.springs.stiffness_ratio[spring]), float(robot.springs.stiffness_knee[spring])
    found = []
    for this in _KNEES if own >= 1.0 else (knee,):
        basis = fx.StiffnessHardening(joint, own - 0.4 if own > 0.5 else own - 0.2, this)
        change = float(basis.ratio) - own
        make = functools.partial(_hardened, joint, own, change, this)
        high = (0.1 - own) / change
        found.append(
            Candidate("stiffness_hardening", joint, (basis,), make, (0.0,), (high,), 1.0, f"knee {this:g} rad")
        )
    return found


def _hardened(joint, own, change, knee, c):
    return fx.StiffnessHardening(joint, own + change * float(c[0]), knee)


def _hysteresis(robot: Robot, joint: str) -> list[Candidate]:
    effect = _fitting(fx.GearHysteresis, robot, joint)
    if effect is None:
        return []
    value = float(effect.torque)
    return [
        _scaled(
            "gear_hysteresis",
            joint,
            fx.GearHysteresis(joint, value, slip),
            "torque",
            value,
            (0.0, 20.0),
            f"slip {slip:g} rad",
        )
        for slip in _SLIPS
    ]


def _spring_to_ground(robot: Robot, joint: str) -> list[Candidate]:
    """A counterbalance where gravity acts, hoses where it does not: they obey the same law."""
    heavy = _carries_weight(robot, joint)
    unit = fx.Counterbalance(joint, 1.0, 0.0)
    constant = fx.Counterbalance(joint, 1.0, -1.0)
    constant = eqx.tree_at(lambda e: e.stiffness, constant, 1.0)
    visible = 20.0 if heavy else 50.0
    if heavy:
        low, high = fx.Counterbalance.bounds["stiffness"]
        make = functools.partial(_balanced, joint)
        name = "counterbalance"
    else:
        low, high = fx.DressPack.bounds["stiffness"]
        make = functools.partial(_hosed, joint)
        name = "dress_pack"
    return [
        Candidate(name, joint, (unit,), make, (low,), (high,), visible, "rest 0"),
        Candidate(name, joint, (unit, _Constant(joint)), make, (low, -np.inf), (high, np.inf), visible, "rest free"),
    ]


class _Constant(fx.AbstractArmTorque):
    """A constant torque against a joint: what the rest position of a spring adds."""

    name: ClassVar = "constant"
    units: ClassVar = {}
    bounds: ClassVar = {}
    signature: ClassVar = ""
    confusable: ClassVar = {}
    joint: str = eqx.field(static=True)

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint)

    def torque(self, angle, rate):
        return 1.0 + 0.0 * angle


def _rest(c) -> float:
    rest = -float(c[1]) / float(c[0]) if len(c) > 1 and c[0] != 0 else 0.0
    return float(np.clip(rest, -np.pi, np.pi))


def _balanced(joint, c):
    return fx.Counterbalance(joint, float(c[0]), _rest(c))


def _hosed(joint, c):
    return fx.DressPack(joint, float(c[0]), _rest(c))


def _carries_weight(robot: Robot, joint: str) -> bool:
    """Whether the axis, in the robot's zero position, is across gravity, and not one of the wrist."""
    axis = axis_of(robot, joint)
    direction = np.asarray(robot.chain.axis)[robot.driven_joints[axis]]
    gravity = np.asarray(robot.chain.gravity)
    across = np.linalg.norm(np.cross(direction, gravity)) > 0.5 * np.linalg.norm(gravity)
    return bool(across and axis < 3)


def _flexibility(robot: Robot, joint: str) -> list[Candidate]:
    if _fitting(fx.ExtraFlexibility, robot, joint) is None:
        return []
    own = np.asarray(robot.chain.axis)[robot.driven_joints[axis_of(robot, joint)]]
    found = []
    for direction in np.eye(3):
        if np.linalg.norm(np.cross(direction, own)) < 0.5:
            continue
        for stiffness in _HINGES:
            basis = fx.ExtraFlexibility(joint, direction, stiffness, stiffness / 5000.0)
            make = functools.partial(_hinged, joint, tuple(direction), stiffness)
            label = f"axis {np.round(direction).astype(int).tolist()}, {stiffness:g} N m/rad"
            found.append(Candidate("extra_flexibility", joint, (basis,), make, (0.3,), (2.0,), 0.3, label))
    return found


def _hinged(joint, direction, stiffness, c):
    k = stiffness / float(c[0])
    return fx.ExtraFlexibility(joint, direction, k, k / 5000.0)


def _saturation(robot: Robot, joint: str, largest: float) -> list[Candidate]:
    found = []
    for part in _CLIPPED:
        basis = fx.TorqueSaturation(joint, part * largest)
        make = functools.partial(_clipped, joint, part * largest)
        found.append(
            Candidate(
                "torque_saturation", joint, (basis,), make, (0.3,), (3.0,), 0.3, f"limit {part * largest:.3g} N m"
            )
        )
    return found


def _clipped(joint, limit, c):
    return fx.TorqueSaturation(joint, limit)


def _payload(robot: Robot) -> list[Candidate]:
    centred = fx.Payload(1.0)
    low, high = fx.Payload.bounds["mass"]
    visible = float(fx.Payload.typical(robot).mass)
    return [
        Candidate(
            "payload", "", (centred,), _carried, (max(low, -0.9 * float(robot.chain.mass[-1])),), (high,), visible
        )
    ]


def _carried(c):
    return fx.Payload(float(c[0]))


_TABLES: Mapping[str, Callable[[Robot, str], list[Candidate]]] = {
    "coulomb_friction": _plain(fx.CoulombFriction, "level"),
    "viscous_friction": _plain(fx.ViscousFriction, "coefficient"),
    "arm_viscous_friction": _plain(fx.ArmViscousFriction, "coefficient"),
    "stribeck_friction": _stribeck,
    "friction_asymmetry": _plain(fx.FrictionAsymmetry, "offset"),
    "load_dependent_friction": _plain(fx.LoadDependentFriction, "coefficient"),
    "torque_delay": _plain(fx.TorqueDelay, "delay"),
    "current_loop_lag": _plain(fx.CurrentLoopLag, "time_constant"),
    "backlash": _gaps,
    "stiffness_hardening": _hardening,
    "structural_damping": _plain(fx.StructuralDamping, "loss"),
    "gear_hysteresis": _hysteresis,
    "torque_constant": _plain(fx.TorqueConstant, "error"),
    "motor_inertia": _plain(fx.MotorInertia, "increase"),
    "counterbalance": _spring_to_ground,
    "dress_pack": _spring_to_ground,
    "extra_flexibility": _flexibility,
    "wrist_coupling": _plain(fx.WristCoupling, "ratio"),
}
_ELSEWHERE = frozenset(
    (
        *("torque_saturation", "payload"),  # above: they need more than robot and joint
        *("torque_ripple", "resolver_ripple", "transmission_error"),  # `stage`: their orders are found in the data
        "encoder_quantisation",  # `quantised`: seen in the readings
    )
)
