"""The reference robot R3X."""

import importlib.resources
import tomllib

from .robot import Robot
from .schema import robot_from_table


def r3x() -> Robot:
    """R3X: a Manutec r3 with flexible drives, a tilting bearing, a twisting upper arm and 10 kg payload.

    Links, motors, gears, friction and the stiffness of axes 1-3 are published measurements (Otter & Tuerk,
    The DFVLR models 1 and 2 of the Manutec r3 robot, 1988; Modelica library, RobotR3); stiffness of axes 4-6,
    elasticity across the transmissions, damping, spring shape and payload are proposed values.
    """
    text = importlib.resources.files(__package__).joinpath("r3x.toml").read_text(encoding="utf-8")
    return robot_from_table(tomllib.loads(text), "r3x.toml")
