"""Parameters of a robot by name: `joint1.stiffness`, `bearing2.damping`, `joint6.mass`."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._annotated import checked
from .._arguments import said
from .._errors import input_error
from .._text import nearest
from .drive import Friction, Spring
from .robot import Robot
from .sliding import sliding_unit

PARAMETER_UNITS: dict[str, str] = {
    "stiffness": "N m/rad",
    "damping": "N m s/rad",
    "stiffness_ratio": "1",
    "stiffness_knee": "rad",
    "motor_inertia": "kg m^2",
    "gear_ratio": "1",
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "mass": "kg",
    "com": "m",
    "inertia": "kg m^2",
    "offset": "m",
}
"""Every kind of parameter that a joint can have, and its unit where the joint turns."""

_LIMITS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    **dict.fromkeys(
        ("stiffness", "stiffness_ratio", "stiffness_knee", "motor_inertia"), ("a positive number", lambda x: x > 0)
    ),
    **dict.fromkeys(
        ("damping", "viscous_friction", "coulomb_friction", "mass"), ("a number, 0 or more", lambda x: x >= 0)
    ),
    "gear_ratio": ("a number, not 0", lambda x: x != 0),
}
_SIZES = {"com": 3, "offset": 3, "inertia": 6}
_MOTOR_SIDE = ("motor_inertia", "viscous_friction", "coulomb_friction")
_ARM_SIDE = ("stiffness", "damping", "stiffness_knee")


@checked
def parameter_unit(robot: Robot, joint: str, kind: str) -> str:
    """Unit of a kind of parameter of this joint, which may slide. Its motor slides, too, where the gear ratio is 1 (a
    linear motor, or a drive that is referred to the slide); else kinds on the motor's side are those of one that turns.

    **Arguments:** `robot`: whose joint it is. `joint`: its name. `kind`: one of `jaxfrf.robot.PARAMETER_UNITS`.

    **Returns:** the unit as text, e.g. `N m/rad`.

    **Raises:** `ValueError` for a joint that the robot does not have, `KeyError` for an unknown kind.
    """
    unit = PARAMETER_UNITS[kind]
    slides = robot.chain.sliding[robot.joint_names.index(joint)]
    if slides and kind == "gear_ratio":
        return unit if motor_slides(robot, joint) else "rad/m"
    moved = (kind in _ARM_SIDE and slides) or (kind in _MOTOR_SIDE and motor_slides(robot, joint))
    return sliding_unit(unit) if moved else unit


def motor_slides(robot: Robot, joint: str) -> bool:
    """Whether the motor of this joint moves as the joint does, which slides; not so of joints without a motor."""
    if joint not in robot.axis_names or not robot.chain.sliding[robot.joint_names.index(joint)]:
        return False
    return abs(float(robot.drives.gear_ratio[robot.axis_names.index(joint)])) == 1.0


def unit_at(robot: Robot, joint: str, unit: str) -> str:
    """The unit of a number on the motor's side of a joint, or of all motors ("")."""
    joints = (joint,) if joint in robot.axis_names else () if joint else robot.axis_names
    return sliding_unit(unit) if joints and all(motor_slides(robot, name) for name in joints) else unit


@checked
def parameters(robot: Robot, kinds: Iterable[str] = ("stiffness", "damping")) -> dict[str, jax.Array]:
    """The robot's parameters of these kinds as {"joint.kind": value}, kind by kind, base to tip.

    A kind that a joint does not have (the stiffness of a rigid transmission) is left out. `com`, `inertia`
    and `offset` are vectors, everything else numbers.

    **Arguments:** `robot`: whose parameters they are. `kinds`: of `jaxfrf.robot.PARAMETER_UNITS`, which says their
    units; see `parameter_unit` for a joint that slides.

    **Returns:** numbers, or vectors of (3,) (`com`, `offset`, m) and (6,) (`inertia`, kg m^2).

    **Raises:** `jaxfrf.InputError` for an unknown kind.
    """
    return {
        f"{joint}.{kind}": parameter_field(robot, kind)[0](robot)[i]
        for kind in kinds
        for i, joint in enumerate(parameter_field(robot, kind)[1])
    }


@checked
def with_parameters(robot: Robot, values: Mapping[str, jax.Array | float]) -> Robot:
    """The same robot with these parameters changed, in their units (`parameter_unit`); differentiable in the values.

    **Arguments:** `robot`: as it is. `values`: {"joint.kind": value}, as of `parameters`; what is left out stays.

    **Returns:** the robot with these values.

    **Raises:** `jaxfrf.InputError` for a name that the robot does not have, with the nearest one that it has, and for a
    value that is of another shape, not finite, or none that a robot can have (a stiffness below 0); what JAX traces is
    not looked at.
    """
    _check_names(robot, values)
    for name, value in values.items():
        if not isinstance(value, jax.core.Tracer):
            _check_value(f"{name} of {robot.name}", name.rpartition(".")[2], value)
    return with_values(robot, values)


def with_values(robot: Robot, values: Mapping[str, jax.Array | float]) -> Robot:
    """`with_parameters` of a fit on its way, whose numbers may be of no robot: they are not looked at."""
    by_kind: dict[str, dict[str, jax.Array | float]] = {}
    for name, value in values.items():
        joint, _, kind = name.rpartition(".")
        by_kind.setdefault(kind, {})[joint] = value
    for kind, changes in by_kind.items():
        where, joints = parameter_field(robot, kind)
        array = jnp.asarray(where(robot))
        index = jnp.array([joints.index(joint) for joint in changes])
        array = array.at[index].set(jnp.stack([jnp.asarray(x, array.dtype) for x in changes.values()]))
        robot = eqx.tree_at(where, robot, array)
    return robot


def check_numbers(robot: Robot, source: str) -> None:
    """**Raises:** `jaxfrf.InputError` where numbers of the robot, called `source` in messages, are of no robot."""
    for kind in PARAMETER_UNITS:
        where, joints = parameter_field(robot, kind)
        for joint, value in zip(joints, np.asarray(where(robot)) if joints else (), strict=True):
            _check_value(f"{source}: {joint}.{kind}", kind, value)
            if kind == "inertia" and not is_positive_tensor(value):
                raise input_error(f"{source}: {joint}.{kind}", f"{value.tolist()}", "a positive tensor", "Correct it.")


def is_positive_tensor(inertia: Float[np.ndarray, "6"]) -> bool:
    """Whether [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] has no negative moment, but for rounding."""
    xx, yy, zz, xy, xz, yz = inertia
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    rounding = max(1e-9, 100.0 * np.finfo(moments.dtype).eps)
    return bool(moments[0] >= -rounding * abs(moments[2]) - 1e-15)


def _check_value(where: str, kind: str, value: Any) -> None:
    """Refuse a value of a parameter of this kind that no robot has."""
    size = _SIZES.get(kind)
    try:
        x = np.asarray(value)
        plain = x.dtype.kind in "iuf" and x.shape == (() if size is None else (size,)) and bool(np.all(np.isfinite(x)))
    except (TypeError, ValueError):
        plain = False
    expected, holds = _LIMITS.get(kind, (f"{size} finite numbers", lambda x: True))
    if not plain or not holds(x):
        raise input_error(where, said(x[()] if plain else value), expected, "Correct the value or its unit.")


def _check_names(robot: Robot, names: Iterable[str]) -> None:
    for name in names:
        joint, _, kind = name.rpartition(".")
        if kind not in PARAMETER_UNITS or joint not in parameter_field(robot, kind)[1]:
            raise _unknown(name, robot)


def parameter_field(robot: Robot, kind: str) -> tuple[Callable[[Robot], jax.Array], tuple[str, ...]]:
    """Where a robot holds this kind of parameter, and the joints that the rows of that array belong to.

    **Raises:** `jaxfrf.InputError` for an unknown kind.
    """
    springs = robot.spring_names if isinstance(robot.springs, Spring) else ()
    rubbing = robot.axis_names if isinstance(robot.drives.friction, Friction) else ()
    fields = {
        "stiffness": (lambda r: r.springs.stiffness, springs),
        "damping": (lambda r: r.springs.damping, springs),
        "stiffness_ratio": (lambda r: r.springs.stiffness_ratio, springs),
        "stiffness_knee": (lambda r: r.springs.stiffness_knee, springs),
        "motor_inertia": (lambda r: r.drives.motor_inertia, robot.axis_names),
        "gear_ratio": (lambda r: r.drives.gear_ratio, robot.axis_names),
        "viscous_friction": (lambda r: r.drives.friction.viscous, rubbing),
        "coulomb_friction": (lambda r: r.drives.friction.coulomb, rubbing),
        "mass": (lambda r: r.chain.mass, robot.joint_names),
        "com": (lambda r: r.chain.com, robot.joint_names),
        "inertia": (lambda r: r.chain.inertia, robot.joint_names),
        "offset": (lambda r: r.chain.offset, robot.joint_names),
    }
    if kind not in fields:
        raise input_error(
            "kind of parameter", repr(kind), ", ".join(fields), f"Did you mean {nearest(kind, fields)!r}?"
        )
    return fields[kind]


def _unknown(name: str, robot: Robot):
    known = [f"{joint}.{kind}" for kind in PARAMETER_UNITS for joint in parameter_field(robot, kind)[1]]
    return input_error(
        f"parameter of {robot.name}",
        repr(name),
        "the name of a joint and a kind of parameter that it has, as joint1.stiffness",
        f"Did you mean {nearest(name, known)!r}?",
    )
