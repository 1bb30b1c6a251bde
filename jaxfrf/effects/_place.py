"""Where on a robot an effect acts, and the change of one of its arrays."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp

from .._errors import input_error
from .._text import nearest
from .._types import Array

if TYPE_CHECKING:
    from ..robot import Robot


def axis_of(robot: "Robot", joint: int | str) -> int:
    """The axis (driven joint, counted from 0) that `joint` names.

    **Raises:** `jaxfrf.InputError` for a joint that the robot does not have or that has no motor.
    """
    names = robot.axis_names
    if isinstance(joint, str) and joint in names:
        return names.index(joint)
    if isinstance(joint, int) and not isinstance(joint, bool) and 0 <= joint < len(names):
        return joint
    raise input_error(
        f"joint of an effect on {robot.name}",
        repr(joint),
        f"a driven joint, {', '.join(names)} or 0 to {len(names) - 1}",
        f"Did you mean {nearest(joint, names)!r}?",
    )


def arm_torque_limit(robot: "Robot", joint: int | str) -> float:
    """What the motor of `joint` can give behind its gear, N m; infinite where no limit is stated."""
    axis = axis_of(robot, joint)
    return float(robot.drives.torque_limit[axis] * jnp.abs(robot.drives.gear_ratio[axis]))


def spring_of(robot: "Robot", joint: int | str) -> int:
    """The place in the robot's springs of the transmission of `joint`.

    **Raises:** `jaxfrf.InputError` where the transmission is rigid.
    """
    axis = axis_of(robot, joint)
    if axis not in robot.flexible_axes:
        raise input_error(
            f"{robot.axis_names[axis]} of {robot.name}",
            "a rigid transmission",
            "a flexible one: the effect acts on its spring",
            "Give the joint a finite stiffness, or choose another joint.",
        )
    return robot.flexible_axes.index(axis)


def own_spring(robot: "Robot", joint: int | str):
    """The spring of the transmission of `joint` alone, as a law of signals of any shape."""
    place = spring_of(robot, joint)
    return jax.tree.map(lambda x: jnp.asarray(x)[place], robot.springs)


def stated(robot: "Robot", kind: type, joint: int | str, field: str) -> float:
    """Sum of a number over the effects of a kind that the robot has on a joint."""
    axis = axis_of(robot, joint)
    return sum(
        float(getattr(e, field)) for e in robot.effects if isinstance(e, kind) and axis_of(robot, e.joint) == axis
    )


def changed(robot, where, change):
    """The robot with `change` of the array that `where` picks."""
    return eqx.tree_at(where, robot, change(jnp.asarray(where(robot))))


def own(robot, joint, values, least: float):
    """The joint's own value, or `least` where it is lower: a robot may state no friction at all."""
    return jnp.maximum(values[axis_of(robot, joint)], least)


def coulomb(robot: "Robot") -> Array:
    """Coulomb friction of the motors, N m, (axis,); none where the law has no such part."""
    friction = robot.drives.friction
    return jnp.asarray(getattr(friction, "coulomb", jnp.zeros_like(friction.viscous)))
