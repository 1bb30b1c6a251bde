"""The reference robot R3X."""

import importlib.resources
import tomllib

import numpy as np

from ..effects import AbstractEffect, ResolverRipple, TorqueRipple
from .robot import Robot
from .schema import robot_from_table


def r3x() -> Robot:
    """R3X: a Manutec r3 with flexible drives, a tilting bearing, a twisting upper arm and 10 kg payload.

    Links, motors, gears, friction and the stiffness of axes 1-3 are published measurements (Otter & Tuerk,
    The DFVLR models 1 and 2 of the Manutec r3 robot, 1988; Modelica library, RobotR3); stiffness of axes 4-6,
    elasticity across the transmissions, damping, spring shape and payload are proposed values.

    **Returns:** the robot, in SI units, with its controller.

    **Source:** Otter & Tuerk, The DFVLR models 1 and 2 of the Manutec r3 robot, 1988; what they do not state is this
    project's own.
    """
    text = importlib.resources.files(__package__).joinpath("r3x.toml").read_text(encoding="utf-8")
    return robot_from_table(tomllib.loads(text), "r3x.toml")


_RIPPLE = (0.03, 0.02, 0.05, 0.03)  # N m, orders 1, 2, 6, 18 of the motor angle
_RIPPLE_SCALE = (1.0, 1.0, 1.0, 0.2, 0.2, 0.07)
_RESOLVER = (5e-4, 1e-3)  # rad, orders 1 and 2


def r3x_ripple() -> tuple[AbstractEffect, ...]:
    """Torque ripple and resolver ripple of R3X, for `r3x().with_effects(*r3x_ripple())`.

    **Returns:** effects: torque ripple, N m, of orders 1, 2, 6 and 18 of the motor's angle, and resolver ripple, rad,
    of orders 1 and 2.

    **Source:** proposed values, this project's own.
    """
    torque = (TorqueRipple(axis, scale * np.array(_RIPPLE)) for axis, scale in enumerate(_RIPPLE_SCALE))
    resolver = (ResolverRipple(axis, list(_RESOLVER)) for axis in range(len(_RIPPLE_SCALE)))
    return (*torque, *resolver)
