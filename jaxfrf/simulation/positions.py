"""Arm configurations at which a robot is measured."""

import os
import pathlib

import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._arguments import as_key, expect_whole
from .._errors import input_error
from .._text import number
from ..robot import Robot

_LOW = np.array([-150.0, -60.0, 20.0, -150.0, 25.0, -150.0])  # degrees
_TRAVEL = 0.5  # m
_HIGH = np.array([150.0, 60.0, 150.0, 150.0, 100.0, 150.0])


def random_positions(n: int, key: PRNGKeyArray, axes: int = 6) -> Float[np.ndarray, "pos axis"]:
    """Arm angles of a six-axis elbow robot, (n, 6), rad: uniform, within reach of its payload.

    In degrees, 1: +-150, 2: -60..60, 3: 20..150, 4: +-150, 5: +-(25..100), 6: +-150; joint 5 keeps clear of
    zero, where axes 4 and 6 are in line. A robot of another number of axes gets +-90 degrees on all of them.
    A position does not depend on how many are drawn.

    **Arguments:** `n`: how many. `key`: of the draw, `jax.random.key`. `axes`: of the robot.

    **Returns:** (n, `axes`), rad.

    **Raises:** `jaxfrf.InputError` for numbers of positions or axes that are no whole numbers of 1 or more.

    **Source:** this project's own; the paper, section IV.A, has 49 random configurations and does not state their
    ranges.
    """
    expect_whole("n", n, 1)
    expect_whole("axes", axes, 1)
    elbow, key = axes == len(_LOW), as_key("key", key)
    low, high = (_LOW, _HIGH) if elbow else (np.full(axes, -90.0), np.full(axes, 90.0))
    draw = np.array([np.asarray(jr.uniform(jr.fold_in(key, i), (axes + 1,))) for i in range(n)]).reshape(n, axes + 1)
    q = low + (high - low) * draw[:, :axes]
    if elbow:
        q[:, 4] *= np.where(draw[:, axes] < 0.5, -1.0, 1.0)
    return np.deg2rad(q)


def positions_of(
    robot: Robot, n: int, key: PRNGKeyArray, margin: Float[np.ndarray, "axis"] | float = 0.0
) -> Float[np.ndarray, "pos axis"]:
    """`random_positions` of this robot; an axis with limits is drawn between them (of more than a turn, half a turn
    on either side of their middle), one that slides without limits from half a metre on either side of its zero.

    **Arguments:** `n`: how many. `key`: of the draw. `margin`: that limits are kept away from, rad or m.

    **Returns:** (n, axis), rad or m.

    **Raises:** `jaxfrf.InputError` if `n` is no whole number of 1 or more, or limits leave no room within the margin.

    **Source:** this project's own.
    """
    q = random_positions(n, key, robot.n_axes)
    slides, known = np.array(robot.axis_units) == "m", np.isfinite(limits_of(robot)).all(axis=1)
    if not (slides | known).any():
        return q
    low, high = _between(robot, np.broadcast_to(margin, q.shape[1:]))
    drawn = [
        np.asarray(jr.uniform(jr.fold_in(jr.fold_in(as_key("key", key), i), 1), (robot.n_axes,))) for i in range(n)
    ]
    return np.where(slides | known, low + (high - low) * np.array(drawn), q)


def limits_of(robot: Robot) -> Float[np.ndarray, "axis 2"]:
    """Lowest and highest angle of every axis, rad or m, infinite where unknown.

    **Arguments:** `robot`: any.

    **Returns:** (axis, 2).
    """
    return np.array(robot.limits or [(-np.inf, np.inf)] * robot.n_axes, float)


def check_within(name: str, q: Float[np.ndarray, "pos axis"], robot: Robot, margin) -> None:
    """Refuse positions beyond the robot's limits, or nearer to them than the motion takes.

    **Arguments:** `name`: of the positions, for the message. `q`: (pos, axis), rad or m. `margin`: (axis,), rad or m.

    **Raises:** `jaxfrf.InputError` for the first that is.
    """
    limits = limits_of(robot)
    beyond = (q < limits[:, 0] + margin) | (q > limits[:, 1] - margin)
    if beyond.any():
        pos, axis = (int(i) for i in np.argwhere(beyond)[0])
        unit, (low, high) = robot.axis_units[axis], limits[axis]
        room = number(margin[axis], 2)
        raise input_error(
            f"{name}: position {pos}",
            f"{robot.axis_names[axis]} at {number(q[pos, axis], 4)} {unit}",
            f"{number(low, 4)} to {number(high, 4)} {unit} (its limits) with {room} {unit} for the motion",
            "Leave it out, or excite less.",
        )


def _between(robot: Robot, margin) -> tuple[np.ndarray, np.ndarray]:
    """Where axes are drawn between, those without limits that slide included."""
    limits, slides = limits_of(robot), np.array(robot.axis_units) == "m"
    known = np.isfinite(limits).all(axis=1)
    middle = np.where(known, np.where(known[:, None], limits, 0.0).mean(axis=1), 0.0)
    most = np.where(slides, np.where(known, np.inf, _TRAVEL), np.pi)
    low, high = np.maximum(limits[:, 0] + margin, middle - most), np.minimum(limits[:, 1] - margin, middle + most)
    if not (low < high).all():
        axis = int(np.argmin(high - low))
        unit = robot.axis_units[axis]
        raise input_error(
            f"limits of {robot.axis_names[axis]}",
            f"{number(limits[axis, 0], 4)} to {number(limits[axis, 1], 4)} {unit}",
            f"more than the {number(margin[axis], 2)} {unit} that the motion takes to either side",
            "Excite less, or correct the limits.",
        )
    return low, high


def read_positions(path: str | os.PathLike, axes: int) -> Float[np.ndarray, "pos axis"]:
    """Arm angles from a text file, one row of rad for each position, separated by commas or blanks; # comments.

    **Arguments:** `path`: UTF-8 text. `axes`: numbers in a row, those of the robot.

    **Returns:** (pos, axis), rad.

    **Raises:** `jaxfrf.InputError` naming the file and what is wrong with it. `OSError` if it cannot be opened.
    """
    try:
        text = pathlib.Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise input_error(f"{path}", "no text in UTF-8", "rows of numbers", "Save it as plain text.") from None
    rows = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
    rows = [row for row in rows if row]
    try:
        q = np.array([[float(x) for x in row] for row in rows])
    except ValueError as error:
        raise input_error(
            f"{path}", f"{error}", "numbers", "Write one row of angles, rad, for each position."
        ) from None
    if q.ndim != 2 or q.shape[1] != axes or not np.isfinite(q).all():
        raise input_error(
            f"{path}", f"numbers of shape {q.shape}", f"(position, {axes}), finite", "Write one row for each position."
        )
    return q
