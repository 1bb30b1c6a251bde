"""Whether the signals of a log were taken together, by the controller's law and by what the robot needs to move so.

Commands that stand one sample late in a log have a phase that no robot makes: no delay is negative. Left as they are,
they would be sought in masses and dampings, or be called unexplained.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._errors import InputError
from .._text import number
from ..experiment import Experiment
from ..robot import Robot
from ..trajectory.controller import ShownController, law_times, shown_controller
from ..trajectory.evidence import Column
from ..trajectory.log_times import LogTimes, speeds_of_differences
from ..trajectory.measured import Measured, measured
from ..trajectory.scene import Scene
from .columns import near_rest_columns
from .numbers import numbers
from .search import Iterate, Search

_SHIFTS = 3  # times that commands are moved, for times that are no small part of a period
_SETTLED = 0.02  # of a sampling interval, by which commands are moved a last time
_WHOLE = 0.1  # of it: by the motion alone a time is known no better, and loggers are late by whole samples
_POSITIONS = 4  # that are asked, of all: a time is the same at each
_LEAST = 0.3  # of a sampling interval, where the motion alone tells: what a model lacks may look like less
_AGREE = 0.2  # of the time: axes of one log that differ by more were not taken late, they lack something each
_FALLS, _FALLS_ALONE = 0.8, 0.5  # of the misfit behind one step of all numbers, that may be left where the motion alone
# tells: of axes that agree, beside which an effect may be missing; of one
_HALF = 0.1  # of a sampling interval, around half of one, in which speeds are differences of positions
_FLOOR = 1.0  # of that misfit, mean square: below it nothing is asked


class Aligned(eqx.Module):
    """A record whose signals were put where they belong.

    **Fields:** `data`: the record, and its `parts`. `shown`: what it says of the robot's controller. `late`: what was
    late in the log, in words, empty where nothing was. `commands`: how late the controller commands, in words, empty
    where it does as written or follows another law.
    """

    data: Experiment
    parts: Any
    shown: ShownController
    late: str = eqx.field(static=True, default="")
    commands: str = eqx.field(static=True, default="")

    def compared(self) -> str:
        """What of the robot is compared with the record, in words."""
        text = self.shown.compared(self.data)
        text += f"; it does, where {self.commands}" if self.commands else ""
        return text + (f"; in the log {self.late}, which was taken back" if self.late else "")

    def sentence(self) -> str:
        """What was late, behind other sentences."""
        return f" In the log {self.late}: that was taken back before all else. Mend the log." if self.late else ""


def aligned(
    data: Experiment, robot: Robot, divide: Callable[[Experiment], Any], seen: Callable[[Any], Measured]
) -> Aligned:
    """A record with commands, motion and references at the times at which they were taken.

    Where the controller's law does not hold for what was logged, but does once signals are moved in time, that is how
    late they stand in the log, unless the robot's motion denies it: a controller that commands late is told from a log
    of late commands by the torque that the measured motion needs. Where there is no such law, only commands that all
    come late behind the motion are taken back, since that no robot does; motion behind commands is a delay of the
    robot's; but for speeds of several axes that are all half a sample late, as differences of positions are.

    **Arguments:** `data`: periodic. `robot`: as given. `divide`: a record into the parts that fit and judge; `seen`: of
    these, what may be looked at.

    **Returns:** `Aligned`; the record itself where nothing is late.

    **Biased** where a controller's law is not the written one in another way that a shift of some samples imitates to
    2 % of the torque, and the robot's numbers are off by so much that its motion does not deny it; and where all drives
    of a log of speeds without such a law act half a sample late.

    **Source:** this project's own.
    """
    parts = divide(data)
    record = seen(parts)
    shown = shown_controller(robot, record)
    contradicted = bool(np.any(shown.contradicted))
    times = law_times(robot, record, shown.contradicted) if contradicted else None
    by_law = times is not None
    lawless = not np.any(shown.left)
    apart = _beside_motion(robot, record) if times is None and (contradicted or lawless) else None
    if apart is not None:
        times = _behind_motion(robot, record, *apart)
    if times is None:
        differenced = lawless and apart is not None and _differenced(robot, record, apart[1])
        return _of_differences(data, robot, divide, seen) if differenced else Aligned(data, parts, shown)
    late, moved = times.says(robot.axis_names), times.taken_back(data)
    moved_parts = divide(moved)
    if by_law and not times.are_together and not _confirmed(robot, seen(moved_parts), times):
        return Aligned(data, parts, shown, commands=late)
    return Aligned(moved, moved_parts, shown_controller(robot, seen(moved_parts)), late=late)


def _of_differences(data: Experiment, robot: Robot, divide, seen) -> Aligned:
    """A record of speeds that are differences of positions, as if they were speeds."""
    moved = speeds_of_differences(data)
    parts = divide(moved)
    time = number(500.0 / data.fs, 3)
    late = f"y is {time} ms late (half a sample), as a difference of positions is (log these instead)"
    return Aligned(moved, parts, shown_controller(robot, seen(parts)), late=late)


def _beside_motion(robot: Robot, record: Measured) -> tuple[float, Float[np.ndarray, "axis"]] | None:
    """What errors of all numbers leave, mean square over the floor, and how late commands are beside them, s; `None`
    where that is nothing, and where the robot cannot be simulated."""
    before = _left(robot, record)
    times = None if before is None or before <= _FLOOR else _late(robot, record)
    return None if before is None or times is None else (before, times)


def _differenced(robot: Robot, record: Measured, times: Float[np.ndarray, "axis"]) -> bool:
    """Whether logged speeds are differences of positions, by the torque that the motion needs: all axes half a sample
    behind the commands, and together with them once they are taken for that. A single axis may be what it looks like.
    """
    data = record.data
    together = lambda times, at: times is not None and bool(np.all(np.abs(times * data.fs - at) < _HALF))
    if data.y_quantity != "velocity" or robot.n_axes == 1 or not together(times, -0.5):
        return False
    return together(_late(robot, measured(speeds_of_differences(data), record.payloads)), 0.0)


def _confirmed(robot: Robot, moved: Measured, times: LogTimes) -> bool:
    """Whether the torque that the measured motion needs agrees: what is late once signals are taken back is less than
    what was taken back."""
    left = _late(robot, moved)
    return left is not None and bool(np.sum(np.abs(left)) < 0.5 * np.sum(np.abs(times.apart)))


def _behind_motion(robot: Robot, record: Measured, before: float, first: Float[np.ndarray, "axis"]) -> LogTimes | None:
    """How late commands are behind the motion, of all axes alike, by the torque that it needs; `None` where they are
    not. `before`, `first`: of `_beside_motion`."""
    total, apart, moved = 0.0, np.inf, record
    for shift in range(_SHIFTS):
        times = _late(robot, moved) if shift else first
        if times is None:
            return None
        total, apart = total + float(np.median(times)), float(np.ptp(times))
        if total * record.data.fs < _LEAST:
            return None
        moved = _moved(record, total)
        if abs(float(np.median(times))) * record.data.fs < _SETTLED:
            break
    after = _left(robot, moved)
    most = _FALLS if robot.n_axes > 1 else _FALLS_ALONE
    if after is None or after > most * before or apart > _AGREE * total:
        return None
    whole = round(total * record.data.fs)
    if abs(total * record.data.fs - whole) < _WHOLE:
        total = whole / record.data.fs
    none = np.zeros(robot.n_axes)
    return LogTimes(none + total, none, record.data.fs)


def _moved(record: Measured, time: float) -> Measured:
    """Commands so much earlier."""
    none = np.zeros(record.data.n_in)
    return measured(LogTimes(none + time, none, record.data.fs).taken_back(record.data), record.payloads)


def _late(robot: Robot, record: Measured) -> Float[np.ndarray, "axis"] | None:
    """How late commands are beside errors of all numbers, s; `None` where the robot cannot be simulated."""
    step = _step(robot, record, [_late_column(axis) for axis in range(robot.n_axes)])
    return None if step is None else step.posterior.change[-robot.n_axes :]


def _left(robot: Robot, record: Measured) -> float | None:
    """Mean square over the floor that errors of all numbers leave; `None` where the robot cannot be simulated."""
    step = _step(robot, record, [])
    return None if step is None else step.left


def _step(robot: Robot, record: Measured, columns: Sequence[Column]) -> Iterate | None:
    """The step of all numbers of a robot whose motors move as they were measured, beside these columns."""
    robot = dataclasses.replace(robot, controller=None)
    uncertain, last = numbers(robot), record.data.n_pos - 1
    record = record.at(np.unique(np.linspace(0, last, _POSITIONS).round()))
    search = Search(robot, record, uncertain, lambda text: None, [*near_rest_columns(robot, record), *columns])
    try:
        return search.evaluate(np.zeros(len(uncertain)), (), more=False)
    except InputError:
        return None


def _late_column(axis: int) -> Column:
    """What a command that is logged late leaves of it, N m per s."""

    def column(scene: Scene):
        rate = 2j * np.pi * scene.still.frequency
        return scene.by_command(axis, -rate * scene.spectrum(scene.command[..., axis]))

    return column
