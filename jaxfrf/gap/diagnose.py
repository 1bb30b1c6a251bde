"""Find where a model and its measurement disagree, name what is missing, add it, and see the gap shrink."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._arguments import expect
from .._errors import input_error
from .._types import require_x64
from ..effects import AbstractEffect, library
from ..experiment import Experiment
from ..frf import FRF
from ..parts import Parts
from ..robot import Robot, parameters
from ..trajectory.following import compared
from ..trajectory.joined import joined, places
from ..trajectory.measured import fewer, measured
from ..trajectory.rigid_motion import check_rigid
from .channels import AbstractChannel, channel_of
from .channels.conclude import concluded
from .own_numbers import OwnNumbers, own_numbers
from .present import present
from .result import Diagnosis
from .search import Say, Search, search

_EXPERIMENTS = 2  # of a position that are used: what limits the search is the model, not the noise


def diagnose(
    robot: Robot | None,
    data: Experiment | FRF | Sequence[Experiment | FRF],
    *,
    own: Sequence[type[AbstractEffect]] = (),
    sealed: int | None = None,
    say: Say | None = None,
    progress: Callable[[float], None] | None = None,
    parts: Parts | None = None,
) -> Diagnosis:
    """Which effect a robot's model lacks, from periodic records at several positions.

    First all numbers of the robot that are not exactly known are fitted, as `jaxfrf.calibrate` does: where they explain
    the record, each within what is known of it, nothing is missing, and those that are off are told. Otherwise the
    robot is simulated through the experiment; what the measured torque is beyond what the robot would have asked,
    referred to its motors, is the residual, at every line from 0 to the highest excited one, unexcited ones and the
    slow motion included. Its own parameters give way first: stiffness and damping freely, friction, masses and rotors
    near their tolerances, ripple below what is visible. Every effect of the library on every joint is then scored by
    what its law, evaluated along the simulated motion, takes off the residual, where the gap is large from the robot
    as it was given, too; the best are refined, simulated, corrected and compared; this repeats with the effect in the
    model. Positions that are sealed are opened once, at the end.

    Thresholds are those of `search`; they were set on simulated records. Wrong where several effects of a similar
    signature act at once, and where an effect that the library does not hold looks like one that it does: then the
    remaining misfit tells, and nothing is named. Nothing is looked for where all that is left is within its floor, and
    no effect is named whose interval holds none of it, or whose robot, simulated as it would be written, does not make
    the gap on the sealed positions smaller (`verify`).

    Data that need no simulation are compared as they are (`jaxfrf.gap.channels`): the torque that a rigid robot needs
    for a motion of any kind; link-side against motor-side positions; the FRF of a single drive, and its distortion.

    **Arguments:**

    - `robot`: nominal; `None` for a single drive (a rigid one of unknown inertia then) and for deflections. Where its
      controller or the references are not known, or where it runs at another rate than the log, its motors are moved
      as they were measured, which compares torques only.
    - `data`: one or several records (other amplitudes, payload as given) of the same period and lines, with `q`. Or
      records of any motion of a rigid robot; records whose y are the positions of all motors, then of all links; FRFs
      or periodic records of one drive.
    - `own`: effects of your own, classes like those of `jaxfrf.effects`.
    - `sealed`: positions that are kept for the end; a third of them by default, none where there are less than three.
      Of FRFs and records that are not periodic: so many of the last, none by default.
    - `say`: called with a line of progress. `progress`: with the part that is done.
    - `parts`: keeps finished rounds (`jaxfrf.parts.Parts`, begun); a run that finds some goes on behind them.

    **Raises:** `jaxfrf.InputError` for records without period or arm configurations, and for a robot that does not fit.

    Source: score tests beside nuisance parameters are textbook statistics; the workflow is this project's own.
    """
    records: list[Any] = list(data) if isinstance(data, Sequence) else [data]
    channel = channel_of(robot, records)
    if channel is not None:
        return _by_channel(channel, robot, records, own, sealed or 0, say or (lambda text: None))
    if robot is None:
        raise input_error("robot", "no robot", "one, for these records", "Name it (--robot robot.toml).")
    expect("robot", robot, Robot)
    for one in records:
        expect("data", one, Experiment)
        if not one.period:
            check_rigid(robot)
    require_x64("A diagnosis")
    record, say = joined(records), say or (lambda text: None)
    explained = _by_own_numbers(robot, record, sealed, say)
    begin = robot if explained is None else explained.robot
    found = investigate(begin, record, own=own, sealed=sealed, say=say, progress=progress, parts=parts)
    result = present(found, compared(robot, record))
    return result if explained is None else _from(robot, result, explained)


def _by_own_numbers(robot: Robot, record: Experiment, sealed: int | None, say: Say) -> OwnNumbers | None:
    """As `own_numbers`, on the positions that are not sealed."""
    opened = np.flatnonzero(opened_positions(record, sealed))
    return own_numbers(robot, measured(fewer(record, _EXPERIMENTS)).at(opened), say)


def _from(given: Robot, result: Diagnosis, explained: OwnNumbers) -> Diagnosis:
    """A diagnosis of the robot with its numbers fitted, told of the robot that was given."""
    begun = parameters(given)
    changed = {name: x.value / float(begun[name]) - 1.0 for name, x in result.parameters.items()}
    return dataclasses.replace(result, says=result.says + explained.says(), given=given, changed=changed)


def _by_channel(
    kind: type[AbstractChannel],
    robot: Robot | None,
    data: Sequence[Any],
    own: Sequence[type[AbstractEffect]],
    sealed: int,
    say: Say,
) -> Diagnosis:
    """One comparison without a simulation: the last so many of the data are sealed."""
    if not 0 <= sealed < len(data):
        raise input_error("sealed records", f"{sealed}", f"0 to {len(data) - 1} of {len(data)}", "Leave some to fit.")
    fitted, judge = data[: len(data) - sealed], data[len(data) - sealed :]
    say(f"compared: {kind.compared}")
    channel = kind.opened(robot, fitted)
    sources = tuple(source for x in fitted for source in x.sources)
    return concluded(channel, channel.of(judge) if judge else None, (*library().values(), *own), sources)


def investigate(
    robot: Robot,
    record: Experiment,
    *,
    own: Sequence[type[AbstractEffect]] = (),
    sealed: int | None = None,
    say: Say | None = None,
    progress: Callable[[float], None] | None = None,
    parts: Parts | None = None,
) -> Search:
    """The search of `diagnose`, with all that was simulated, on one record with references."""
    require_x64("A diagnosis")
    robot = jax.tree.map(jnp.asarray, robot)
    some = measured(fewer(record, _EXPERIMENTS))
    return search(robot, some, opened_positions(record, sealed), tuple(own), say, progress, parts)


def opened_positions(record: Experiment, sealed: int | None) -> np.ndarray:
    """Which positions are fitted, (pos,): the sealed ones stand between them. Records of one place stay together."""
    place = places(record)
    count = place.max() + 1
    if sealed is None:
        sealed = count // 3 if count >= 3 else 0
    if not 0 <= sealed < count:
        raise input_error(
            "held-out positions", f"{sealed}", f"0 to {count - 1} of {count} positions", "Leave some for the fit."
        )
    order = dict.fromkeys(place.tolist())
    names = list(order)
    chosen = {names[int(i)] for i in np.round((np.arange(sealed) + 1) * count / max(sealed, 1)) - 1}
    return np.array([p not in chosen for p in place])
