"""Which effects may be missing: what their classes offer on every joint of a robot."""

from collections.abc import Iterable

import numpy as np

from ... import effects as fx
from ...effects import AbstractEffect, Candidate as Candidate
from ...robot import Robot


def candidates(robot: Robot, largest: np.ndarray, more: Iterable[type[AbstractEffect]] = ()) -> tuple[Candidate, ...]:
    """Every effect of the library on every joint that it can act on, and `more` of the user's own.

    Ripple and the errors of gears, whose orders are found in the data, and quantisation are not among them.

    **Arguments:** `largest`: command of every motor in the record, (axis,), N m.
    """
    found: list[Candidate] = []
    for kind in (*fx.library().values(), *more):
        for joint, most in zip(robot.axis_names, largest, strict=True):
            try:
                found += kind.candidates(robot, joint, float(most))
            except ValueError:
                continue  # the joint cannot have it
    return tuple(found)
