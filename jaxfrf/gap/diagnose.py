"""Find where a model and its measurement disagree, name what is missing, add it, and see the gap shrink."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from .._arguments import expect, expect_each, expect_whole
from .._errors import input_error
from .._threads import one_blas_thread
from .._types import require_x64
from ..calibration.alignment import aligned
from ..effects import AbstractEffect, library
from ..effects.catalogue import check_own
from ..experiment import Experiment
from ..frf import FRF
from ..parts import Parts
from ..robot import Robot
from ..trajectory.joined import joined
from ..trajectory.measured import fewer, measured
from ..trajectory.rigid_motion import check_rigid
from ..trajectory.standing import misplaced
from .channels import AbstractChannel, channel_of
from .channels.conclude import concluded
from .result import Diagnosis
from .settings import EXPERIMENTS, JUDGING
from .simulated.assemble import assembled
from .simulated.fitted import Say
from .simulated.records import split
from .simulated.selection import select_effects

_ELSEWHERE = (
    "Springs that harden, friction and play beside a model of your own: `jaxfrf.machine`, howto/machine.md in the book."
)


@one_blas_thread
def diagnose(
    robot: Robot | None,
    data: Experiment | FRF | Sequence[Experiment | FRF],
    *,
    own: Sequence[type[AbstractEffect]] = (),
    heldout_count: int | None = None,
    say: Say | None = None,
    progress: Callable[[float], None] | None = None,
    parts: Parts | None = None,
) -> Diagnosis:
    """Which effect a robot's model lacks, from periodic records at several positions.

    A comparison of robots. First all numbers of the robot that are not exactly known are fitted, as `jaxfrf.calibrate`
    does, each within what is known of it: where they explain the record, nothing is missing, and those that are off
    are told. Otherwise every effect of the library on every joint is scored beside these numbers by what its law,
    evaluated along the simulated motion, takes off the residual (torque, at every line from 0 to the highest excited
    one, unexcited ones and the slow motion included); those that promise most become robots in which the effect's
    parameters are numbers of which nothing is known, and all numbers are fitted again. The one that costs least is
    taken if it is better, simulated as it would be written, on positions that chose nothing, and this repeats with the
    effect in the robot. The held-out positions are opened once, at the end: an effect with which their gap does not
    shrink is taken back.

    A number that the robot has, with a tolerance, may be what is wrong: it is set free like an effect, and told to be a
    number. Thresholds stand in `settings`. Wrong where several effects of a similar signature act at once, and where an
    effect that the library does not hold looks like one that it does: then the remaining misfit tells, and nothing is
    named.

    Signals that stand late in the log (u behind y, y or r behind the others) are taken back first, and `says` tells so:
    the controller's law and the torque of the measured motion tell them from a delay of the robot's.

    Data that need no simulation are compared as they are (`jaxfrf.gap.CHANNELS`): the torque that a rigid robot needs
    for a motion of any kind; link-side against motor-side positions; the FRF of a single drive, and its distortion.

    **Arguments:**

    - `robot`: nominal; `None` for a single drive (a rigid one of unknown inertia then) and for deflections. Where its
      controller or the references are not known, where the record contradicts the controller's law, or where it runs at
      another rate than the log, its motors are moved as they were measured, which compares torques only.
    - `data`: one or several records (other amplitudes, payload as given) of the same period and lines, with `q`. Or
      records of any motion of a rigid robot; records whose y are the positions of all motors, then of all links; FRFs
      or periodic records of one drive.
    - `own`: effects of your own, classes like those of `jaxfrf.effects`.
    - `heldout_count`: positions that are kept for the end; a third of them by default, none where there are less than
      three.
      Of FRFs and records that are not periodic: so many of the last, none by default.
    - `say`: called with a line of progress. `progress`: with the part that is done.
    - `parts`: keeps finished rounds (`jaxfrf.Parts`, begun); a run that finds some goes on behind them.

    **Returns:** a `Diagnosis`: verdict, named effects with their numbers in SI units, the gap before and after, maps.

    **Raises:** `jaxfrf.InputError` for records without period or arm configurations, and for a robot that does not fit.

    **Source:** score tests beside nuisance parameters are textbook statistics; the workflow is this project's own.
    """
    if robot is not None:
        expect("robot", robot, Robot)
    if not isinstance(data, Experiment | FRF):
        expect_each("data", data, Experiment, FRF)
    check_own(own)
    if heldout_count is not None:
        expect_whole("heldout_count", heldout_count)
    records: list[Any] = [data] if isinstance(data, Experiment | FRF) else list(data)
    channel = channel_of(robot, records)
    if channel is not None:
        return _by_channel(channel, robot, records, own, heldout_count or 0, say or (lambda text: None))
    if robot is None:
        raise input_error("robot", "no robot", "one, for these records", "Name it (--robot robot.toml).")
    for one in records:
        expect("data", one, Experiment)
        if not one.period:
            check_rigid(robot)
    require_x64("A diagnosis")
    record, say = joined([x for x in records if isinstance(x, Experiment)]), say or (lambda text: None)
    divided = lambda x: split(measured(fewer(x, EXPERIMENTS)), measured(fewer(x, JUDGING)), heldout_count)
    log = aligned(record, robot, divided, lambda parts: parts.whole.at(parts.opened))
    shown, parts_of = log.shown, log.parts
    if log.late:
        say(f"in the log {log.late}: taken back")
    if shown.says():
        say(f"controller: {shown.says()}")
    found = select_effects(shown.robot, parts_of, tuple(own), say, progress or (lambda part: None), parts)
    result = assembled(found, parts_of, robot, log.compared())
    base, extended = (shown.restored(x) for x in (result.base, result.extended))
    says = result.says + log.sentence() + "".join(f" {text[0].upper()}{text[1:]}" for text in misplaced(robot, record))
    return dataclasses.replace(result, base=base, extended=extended, says=says)


def _by_channel(
    kind: type[AbstractChannel],
    robot: Robot | None,
    data: Sequence[Any],
    own: Sequence[type[AbstractEffect]],
    heldout_count: int,
    say: Say,
) -> Diagnosis:
    """One comparison without a simulation: the last so many of the data are held out."""
    if not heldout_count < len(data):
        raise input_error(
            "held-out records", f"{heldout_count}", f"0 to {len(data) - 1} of {len(data)}", "Leave some to fit."
        )
    fitted, judge = data[: len(data) - heldout_count], data[len(data) - heldout_count :]
    say(f"compared: {kind.compared}")
    channel = kind.opened(robot, fitted)
    sources = tuple(source for x in fitted for source in x.sources)
    found = concluded(channel, channel.of(judge) if judge else None, (*library().values(), *own), sources)
    if robot is None and found.verdict == "unexplained":
        return dataclasses.replace(found, says=f"{found.says} {_ELSEWHERE}")
    return found
