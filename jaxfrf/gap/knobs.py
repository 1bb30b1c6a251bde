"""What the base model may change of itself before an effect is called missing."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..robot import Robot
from ..robot.drive import Friction, Spring
from ..robot.tolerances import Tolerance

_UNKNOWN = 2.0  # relative: what is not known at all may be three times as large


class Knob(eqx.Module):
    """One number of the robot as a relative change x, zero where the robot is as given.

    **Fields:** `name`: `joint1.stiffness`. `tolerance`: standard deviation of x before the experiment. `free`: whether
    it is a parameter of the base model, which the experiment shall give; others are only known to their tolerance.
    """

    name: str = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)
    free: bool = eqx.field(static=True)
    kind: str = eqx.field(static=True)
    row: int = eqx.field(static=True)

    def turned(self, robot: Robot, x: float) -> Robot:
        """The robot with this number (1 + x) times as large."""
        where = _PLACES[self.kind]
        rows = jnp.asarray(where(robot))
        if self.row < 0:
            return eqx.tree_at(where, robot, rows * (1.0 + x))
        return eqx.tree_at(where, robot, rows.at[self.row].multiply(1.0 + x))


_PLACES = {
    "stiffness": lambda r: r.springs.stiffness,
    "damping": lambda r: r.springs.damping,
    "motor_inertia": lambda r: r.drives.motor_inertia,
    "viscous_friction": lambda r: r.drives.friction.viscous,
    "coulomb_friction": lambda r: r.drives.friction.coulomb,
    "smoothing": lambda r: r.drives.friction.smoothing,
    "mass": lambda r: r.chain.mass,
    "com": lambda r: r.chain.com,
    "inertia": lambda r: r.chain.inertia,
}


def knobs(robot: Robot) -> tuple[Knob, ...]:
    """Stiffness and damping of every spring, which are free; friction, motors and links to the robot's tolerances."""
    found = []

    def add(kind, names, free=False):
        values = np.asarray(_PLACES[kind](robot))
        for row, name in enumerate(names):
            tolerance = _relative(robot.tolerances.of(f"{name}.{kind}"), values[row])
            if tolerance > 0 and np.any(values[row] != 0.0) and np.all(np.isfinite(values[row])):
                found.append(Knob(f"{name}.{kind}", tolerance, free, kind, row))

    if isinstance(robot.springs, Spring):
        add("stiffness", robot.spring_names, True)
        add("damping", robot.spring_names, True)
    add("motor_inertia", robot.axis_names)
    if isinstance(robot.drives.friction, Friction):
        add("viscous_friction", robot.axis_names)
        add("coulomb_friction", robot.axis_names)
        corner = robot.tolerances.of("friction.smoothing")
        if np.any(np.asarray(robot.drives.friction.coulomb) != 0.0) and not corner.exact:
            tolerance = _relative(corner, np.asarray(robot.drives.friction.smoothing))
            found.append(Knob("friction.smoothing", tolerance, False, "smoothing", -1))
    for kind in ("mass", "com", "inertia"):
        add(kind, robot.joint_names)
    return tuple(found)


def _relative(tolerance: Tolerance, value) -> float:
    """Standard deviation of the relative change of a number, or of all elements of a vector together."""
    if tolerance.unknown:
        return _UNKNOWN
    size = float(np.linalg.norm(value))
    return tolerance.std if tolerance.relative else (tolerance.std / size if size > 0 else 0.0)


def pinned(knobs: tuple[Knob, ...], effect) -> tuple[Knob, ...]:
    """The same knobs, but those held where they are that do what the effect does: it would share its size with them."""
    kinds = _SAME.get(effect.name, ())
    last = knobs_of_last_link(knobs) if effect.name == "payload" else ()

    def one(knob: Knob) -> Knob:
        joint, _, kind = knob.name.rpartition(".")
        same = (kind in kinds and joint == effect.joint) or knob.name in last
        return dataclasses.replace(knob, tolerance=0.0) if same else knob

    return tuple(one(knob) for knob in knobs)


def knobs_of_last_link(knobs: tuple[Knob, ...]) -> tuple[str, ...]:
    """Mass, centre and inertia of the last link that has a mass."""
    masses = [knob.name.rpartition(".")[0] for knob in knobs if knob.kind == "mass"]
    return tuple(f"{masses[-1]}.{kind}" for kind in ("mass", "com", "inertia")) if masses else ()


_SAME = {
    "coulomb_friction": ("coulomb_friction",),
    "viscous_friction": ("viscous_friction",),
    "motor_inertia": ("motor_inertia",),
}


def turned(robot: Robot, knobs: tuple[Knob, ...], x) -> Robot:
    """The robot with all of these changes."""
    for knob, value in zip(knobs, x, strict=True):
        robot = knob.turned(robot, float(value))
    return robot
