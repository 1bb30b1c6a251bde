"""A robot as a table (TOML, or any nested dictionary): checked in, written out.

Units are SI; quantities of the motor (inertia, friction, torque limit, velocity gain) on the motor side,
`stiffness` and `damping` on the arm side. A joint that `slides` has m and N for rad and N m, and a gear ratio in rad of
the motor per m. `jaxfrf/robot/r3x.toml` is the schema by example.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._annotated import checked
from .._errors import input_error
from .._text import nearest
from ..effects import AbstractEffect, AbstractStructure, Backlash, effect_from_table, effect_to_table
from ..effects._place import axis_of
from .chain import Chain
from .controller import Controller
from .drive import Drives, Friction, Spring
from .parameters import check_numbers, is_positive_tensor
from .robot import Robot
from .table import Table
from .tolerances import Tolerances, table_of, tolerances_from

_KNEE = 2.9e-4  # rad, one minute of arc: the knee of a linear spring, where it has no effect

_MOST_JOINTS = 100

_ROBOT_KEYS = ("name", "gravity", "sampling_frequency", "joint", "controller", "friction", "effect", "tolerance")
_LINK_KEYS = ("name", "type", "slides", "axis", "offset", "mass", "com", "inertia")
_SPRING_KEYS = ("stiffness", "stiffness_low", "stiffness_knee", "damping")
_DRIVE_KEYS = (
    "gear_ratio",
    "motor_inertia",
    "viscous_friction",
    "coulomb_friction",
    "torque_limit",
    "velocity_gain",
    "zero",
    "limits",
)
_CONTROLLER_KEYS = (
    "position_gain",
    "integral_time",
    "velocity_gain",
    "feedforward",
    "speed_filter",
    "anti_windup",
    "speed_sensor",
)


@checked
def robot_from_table(
    table: Mapping[str, Any], source: str = "robot", own: Sequence[type[AbstractEffect]] = ()
) -> Robot:
    """The robot that a table describes.

    **Arguments:** `table`: what `tomllib.load` gives. `source`: its name in messages, as the file's name. `own`:
    effects of your own that it may name, beside the library's.

    **Raises:** `jaxfrf.InputError` naming the key: unknown (with the nearest known one), missing, of the
    wrong type or size, or with a value that is not physical.
    """
    top = Table(table, source, _ROBOT_KEYS)
    tables = top.tables("joint")
    if not tables:
        raise input_error(
            f"{source}: joint", "none", "at least one [[joint]] table", "Describe the joints, base to tip."
        )
    if len(tables) > _MOST_JOINTS:
        raise input_error(
            f"{source}: joint",
            f"{len(tables)} joints",
            f"at most {_MOST_JOINTS}",
            "Longer chains take too long to compile: join links that hardly move against each other.",
        )
    joints = [
        Table(joint, f"{source}: {_label(joint, i)}", _joint_keys(joint, i, source)) for i, joint in enumerate(tables)
    ]
    names = tuple(joint.text("name", default=f"joint{i + 1}") for i, joint in enumerate(joints))
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise input_error(f"{source}: joint", f"two joints named {twice!r}", "a name for each", "Rename one of them.")
    driven = tuple(joint["type"] == "driven" for joint in joints)
    stiffness = [joint.number("stiffness", positive=True, infinite=True) for joint in joints]
    stiff = tuple(math.isinf(k) for k in stiffness)
    drives = [joint for joint, is_driven in zip(joints, driven, strict=True) if is_driven]
    if not drives:
        raise input_error(f"{source}: joint", "no driven joint", "a motor somewhere", 'Set type = "driven".')
    elastic = [joint for joint, is_driven in zip(joints, driven, strict=True) if not is_driven]
    _check_inertia(joints)
    sprung = [joint for joint in (*drives, *elastic) if not math.isinf(joint["stiffness"])]
    effects = _effects(top, names, own)
    robot = Robot(
        chain=_chain(top, joints),
        drives=_drives(top, drives),
        springs=_springs(sprung),
        joint_names=names,
        driven=driven,
        stiff=stiff,
        controller=_controller(top, drives),
        name=top.text("name", default="robot"),
        sampling_frequency=top.number("sampling_frequency", default=2000.0, positive=True),
        tolerances=_tolerances(top, names),
        limits=tuple(map(_limits, drives)) if any("limits" in joint for joint in drives) else (),
    ).with_effects(*effects)
    if any(isinstance(effect, AbstractStructure) for effect in effects):
        check_numbers(robot, f"{source} with its effects")
    return robot


@checked
def table_from_robot(robot: Robot) -> dict[str, Any]:
    """The table of a robot: `robot_from_table` of it gives the same robot.

    **Arguments:** `robot`: with `Spring` and `Friction`.

    **Returns:** a table of plain numbers, lists and texts, as `tomllib.load` gives it, in SI units.

    **Raises:** `jaxfrf.InputError` for springs or friction that a file cannot state.
    """
    springs, friction = robot.springs, robot.drives.friction
    if not isinstance(springs, Spring) or not isinstance(friction, Friction):
        raise input_error(
            f"{robot.name}: springs and friction",
            f"{type(springs).__name__} and {type(friction).__name__}",
            "Spring and Friction, which a robot's file can state",
            "Write the robot with those, and other laws as effects.",
        )
    table: dict[str, Any] = {
        "name": robot.name,
        "gravity": _plain(robot.chain.gravity),
        "sampling_frequency": robot.sampling_frequency,
        "joint": [_joint_table(robot, springs, friction, i) for i in range(robot.chain.n_joints)],
    }
    if robot.controller is not None:
        table["controller"] = {
            "position_gain": _plain(robot.controller.position_gain),
            "integral_time": _plain(robot.controller.integral_time),
            **({} if robot.controller.feedforward else {"feedforward": False}),
            **(
                {} if robot.controller.speed_filter is None else {"speed_filter": _plain(robot.controller.speed_filter)}
            ),
            **({"anti_windup": True} if robot.controller.anti_windup else {}),
            **({"speed_sensor": True} if robot.controller.speed_sensor else {}),
        }
    table["friction"] = {"smoothing": _plain(friction.smoothing)}
    if robot.tolerances.stated:
        table["tolerance"] = table_of(robot.tolerances)
    acting = (*robot.effects, *_play(robot, springs))
    effects = [effect_to_table(e, robot.axis_names[axis_of(robot, e.joint)]) for e in acting]
    return {**table, **({"effect": effects} if effects else {})}


def _label(joint: Mapping[str, Any], i: int) -> str:
    name = joint.get("name")
    return f"joint {name!r}" if isinstance(name, str) else f"joint {i + 1}"


def _joint_keys(joint: Mapping[str, Any], i: int, source: str) -> tuple[str, ...]:
    where = Table(joint, f"{source}: {_label(joint, i)}", None)
    kind = where.text("type", default=None)
    if kind not in ("driven", "elastic"):
        raise where.error("type", '"driven" or "elastic"', "An elastic joint has a spring and no motor.")
    return (*_LINK_KEYS, *_SPRING_KEYS, *(_DRIVE_KEYS if kind == "driven" else ()))


def _chain(top: Table, joints: list[Table]) -> Chain:
    slides = tuple(joint.flag("slides", False) for joint in joints)
    return Chain(
        axis=jnp.array([_unit_axis(joint) for joint in joints]),
        offset=jnp.array([joint.vector("offset", 3) for joint in joints]),
        mass=jnp.array([joint.number("mass", nonnegative=True) for joint in joints]),
        com=jnp.array([joint.vector("com", 3) for joint in joints]),
        inertia=jnp.array([_physical_inertia(joint) for joint in joints]),
        gravity=jnp.array(top.vector("gravity", 3)),
        slides=slides if any(slides) else (),
    )


def _check_inertia(joints: list[Table]) -> None:
    """A spring needs something behind it that is accelerated."""
    for joint in reversed(joints):
        if joint.number("mass", nonnegative=True) > 0 or any(joint.vector("inertia", 6)):
            return
        if not math.isinf(joint["stiffness"]):
            raise joint.error("mass", "mass or inertia on the link or behind it", "State them, or stiffness = inf.")


def _unit_axis(joint: Table) -> list[float]:
    axis = joint.vector("axis", 3)
    if abs(math.hypot(*axis) - 1.0) > 1e-6:
        raise joint.error("axis", "a vector of length 1", "Divide it by its length.")
    return [x / math.hypot(*axis) for x in axis]


def _physical_inertia(joint: Table) -> list[float]:
    elements = joint.vector("inertia", 6)
    if not is_positive_tensor(np.array(elements)):
        raise joint.error(
            "inertia",
            "[Ixx, Iyy, Izz, Ixy, Ixz, Iyz] of a positive tensor",
            "Check order and signs: products are tensor elements, Ixy = -integral(x y dm).",
        )
    return elements


def _springs(joints: list[Table]) -> Spring:
    ratios, knees = zip(*map(_softness, joints), strict=True) if joints else ((), ())
    return Spring(
        stiffness=jnp.array([joint.number("stiffness", positive=True) for joint in joints], float),
        damping=jnp.array([joint.number("damping", nonnegative=True) for joint in joints], float),
        stiffness_ratio=jnp.array(ratios, float),
        stiffness_knee=jnp.array(knees, float),
    )


def _softness(joint: Table) -> tuple[float, float]:
    """stiffness_low/stiffness and the knee; a linear spring states neither."""
    if "stiffness_low" not in joint and "stiffness_knee" not in joint:
        return 1.0, _KNEE
    low = joint.number("stiffness_low", positive=True)
    return low / joint.number("stiffness", positive=True), joint.number("stiffness_knee", positive=True)


def _drives(top: Table, joints: list[Table]) -> Drives:
    table = top.table("friction", ("smoothing",))
    smoothing = 0.2 if table is None else table.number("smoothing", positive=True)
    for joint in joints:
        if joint.number("gear_ratio") == 0.0:
            raise joint.error("gear_ratio", "motor turns per joint turn, not 0", "1 is a direct drive.")

    def column(key, default=None, **limits):
        return jnp.array([joint.number(key, default, **limits) for joint in joints])

    return Drives(
        motor_inertia=column("motor_inertia", positive=True),
        gear_ratio=column("gear_ratio"),
        torque_limit=column("torque_limit", math.inf, positive=True, infinite=True),
        friction=Friction(
            viscous=column("viscous_friction", 0.0, nonnegative=True),
            coulomb=column("coulomb_friction", 0.0, nonnegative=True),
            smoothing=jnp.asarray(smoothing, float),
        ),
        zero=column("zero", 0.0) if any("zero" in joint for joint in joints) else None,
    )


def _limits(joint: Table) -> tuple[float, float]:
    low, high = joint.vector("limits", 2) if "limits" in joint else (-math.inf, math.inf)
    if not low < high:
        raise joint.error("limits", "[lowest, highest] angle of the joint, rad", "Put the lower one first.")
    return low, high


def _controller(top: Table, joints: list[Table]) -> Controller | None:
    table = top.table("controller", _CONTROLLER_KEYS)
    if table is None:
        return None
    if "velocity_gain" in table:
        gains = table.vector("velocity_gain", len(joints))
    else:
        gains = [joint.number("velocity_gain", nonnegative=True) for joint in joints]
    each = lambda key, *rest, **limits: jnp.asarray(table.number_or_each(key, len(joints), *rest, **limits), float)
    return Controller(
        position_gain=each("position_gain", nonnegative=True),
        integral_time=each("integral_time", math.inf, positive=True, infinite=True),
        velocity_gain=jnp.array(gains),
        feedforward=table.flag("feedforward", True),
        speed_filter=each("speed_filter", positive=True) if "speed_filter" in table else None,
        anti_windup=table.flag("anti_windup", False),
        speed_sensor=table.flag("speed_sensor", False),
    )


def _tolerances(top: Table, names: tuple[str, ...]) -> Tolerances:
    table = top.table("tolerance", None)
    return Tolerances() if table is None else tolerances_from(table.flat(), names, table.where)


def _effects(top: Table, names: tuple[str, ...], own) -> tuple[AbstractEffect, ...]:
    tables = enumerate(top.tables("effect"), 1)
    return tuple(_effect(Table(table, f"{top.where}: effect {i}", None), table, names, own) for i, table in tables)


def _effect(checked: Table, table: Mapping[str, Any], names: tuple[str, ...], own) -> AbstractEffect:
    joint = checked.text("joint", default="")
    if joint and joint not in names:
        raise checked.error("joint", f"one of {', '.join(names)}", f"Did you mean {nearest(joint, names)!r}?")
    return effect_from_table(table, checked.where, own)


def _play(robot: Robot, springs: Spring) -> list[Backlash]:
    """The gears with play: springs have no key for it."""
    if springs.backlash is None:
        return []
    gaps = springs.backlash[: robot.n_motors]
    return [Backlash(axis, gap) for axis, gap in zip(robot.flexible_axes, gaps, strict=True) if gap > 0.0]


def _joint_table(robot: Robot, springs: Spring, friction: Friction, i: int) -> dict[str, Any]:
    chain, name = robot.chain, robot.joint_names[i]
    table = {
        "name": name,
        "type": "driven" if robot.driven[i] else "elastic",
        **({"slides": True} if any(chain.slides) and chain.slides[i] else {}),
        **{key: _plain(getattr(chain, key)[i]) for key in ("axis", "offset", "mass", "com", "inertia")},
    }
    if robot.driven[i]:
        table |= _drive_table(robot, friction, robot.axis_names.index(name))
    if robot.stiff[i]:
        return {**table, "stiffness": math.inf}
    return {**table, **_spring_table(springs, robot.spring_names.index(name))}


def _drive_table(robot: Robot, friction: Friction, axis: int) -> dict[str, Any]:
    drives = robot.drives
    table = {
        "gear_ratio": _plain(drives.gear_ratio[axis]),
        "motor_inertia": _plain(drives.motor_inertia[axis]),
        "viscous_friction": _plain(friction.viscous[axis]),
        "coulomb_friction": _plain(friction.coulomb[axis]),
        "torque_limit": _plain(drives.torque_limit[axis]),
    }
    if drives.zero is not None:
        table["zero"] = _plain(drives.zero[axis])
    if robot.limits and np.isfinite(robot.limits[axis]).all():
        table["limits"] = list(robot.limits[axis])
    if robot.controller is not None:
        table["velocity_gain"] = _plain(robot.controller.velocity_gain[axis])
    return table


def _spring_table(springs: Spring, i: int) -> dict[str, Any]:
    table = {"stiffness": _plain(springs.stiffness[i]), "damping": _plain(springs.damping[i])}
    ratio = float(springs.stiffness_ratio[i])
    if ratio == 1.0:
        return table
    return {
        **table,
        "stiffness_low": ratio * float(springs.stiffness[i]),
        "stiffness_knee": _plain(springs.stiffness_knee[i]),
    }


def _plain(value: Any) -> float | list[float]:
    return np.asarray(value, float).tolist()
