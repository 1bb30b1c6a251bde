"""Which effects are missing, as a comparison of robots whose numbers were fitted.

The robot as it was given, its numbers fitted, stands first. Candidates that promise most, to first order, become robots
whose effect's parameters are numbers of which nothing is known; all their numbers are fitted from where those before
stood. The one that costs least must be better on positions that chose nothing, and takes the place of the robot before;
and so on, until nothing is beyond the floor or nothing is better.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from ...effects import AbstractEffect
from ...parts import Parts
from ...robot import Robot, Tolerances
from ...trajectory.evidence import by_band
from ...trajectory.measured import Measured
from ..settings import (
    FLOOR,
    MOST,
)
from .fitted import Fitted, RobotFit, Say, as_given, fitted, start_of, with_link_errors
from .hypothesis import hypothesis
from .judge import (
    COMPARED,
    Comparison,
    Written,
    written,
)
from .one_round import Rival, Round, Step, on_all, out_of_tolerance_names, to_beat
from .rank import Scored, ranked
from .records import Records
from .rounds import KeptRound, keep_round, read_round


class Selection(eqx.Module):
    """The effects that were selected.

    **Fields:** `base`: the robot with its numbers fitted. `steps`: effects. `last`: the robot with them, fitted to all
    positions that are not held out. `scored`: the first ranking, empty where nothing was looked for. `refused`: in
    words, why the best candidate of the last round was not taken.
    """

    base: Fitted
    steps: tuple[Step, ...]
    last: Fitted
    scored: tuple[Scored, ...]
    refused: str = eqx.field(static=True)


def select_effects(
    robot: Robot,
    records: Records,
    own: Sequence[type[AbstractEffect]],
    say: Say,
    done,
    parts: Parts | None,
) -> Selection:
    """The effects that a robot lacks, on the positions that are not held out."""
    base, steps, first, refused = _rounds(robot, records, own, say, done, parts)
    last = with_link_errors(on_all(steps[-1].found, records, say)) if steps else base
    return Selection(base, steps, last, first, refused)


def _rounds(
    robot: Robot, records: Records, own, say: Say, done, parts
) -> tuple[Fitted, tuple[Step, ...], tuple[Scored, ...], str]:
    """Base, steps, first ranking and refusal as of `Selection`, robots without their columns."""
    say("fits the robot's own numbers")
    fit = records.fitted
    base, given = _base(robot, fit, say, parts)
    done(0.3)
    now, refused = base, ""
    steps: list[Step] = []
    first: tuple[Scored, ...] = ()
    while len(steps) < MOST:
        (misses, there), out_of_tolerance = _misses(now, records, say), out_of_tolerance_names(now)
        if out_of_tolerance:
            say(f"{', '.join(out_of_tolerance)}: off by more than is known")
        if not misses and not out_of_tolerance:
            break
        kept = read_round(parts, len(steps) + 1)
        if kept is not None:
            first = first or tuple(ranked(now, fit, own, misses))
        if kept is not None and kept.effect is None:
            refused = kept.refused
            break
        if kept is not None:
            step = _remembered(kept, now, records, misses, say)
        else:
            also_given = not steps and now.iterate.left > FLOOR
            views = [now, given or as_given(robot, fit, say)] if also_given else [now]
            round = Round(now, records, own, misses, there, say)
            step, refused = round.best(views, [(step.hypothesis.effect, step.key) for step in steps])
            first = first or round.scored
            if not keep_round(parts, len(steps) + 1, _kept_round(step, refused)):
                parts = None  # rounds behind one that is found again would be those of another robot
        if step is None:
            say(refused)
            break
        base, given, now = base.without_columns(), None, step.found
        steps = [*(x.without_columns() for x in steps), step]
        done(0.3 + 0.6 * len(steps) / MOST)
    return base.without_columns(), tuple(x.without_columns() for x in steps), first, refused


def _misses(now: Fitted, records: Records, say: Say) -> tuple[bool, Written | None]:
    """Whether one axis in one band is beyond the floor, on the fitted positions and on those that decide; the robot on
    the latter, where it was simulated."""
    frequency = records.whole.frequency
    cells = np.mean(by_band(now.left, now.iterate.evidence.plain, frequency), axis=(0, 1))
    say(f"at most {cells.max():.3g} times the floor is left")
    if cells.max() <= FLOOR:
        return False, None
    its = written(now.written(), records.deciding)
    if its is None:
        return True, None
    there = np.mean(by_band(its.residual, its.evidence.plain, frequency), axis=(0, 1))
    say(f"at most {np.max(there[cells > FLOOR]):.3g} times there, on positions that decide")
    return bool(np.any(there[cells > FLOOR] > FLOOR)), its


def _base(robot: Robot, record: Measured, say: Say, parts) -> tuple[Fitted, Fitted | None]:
    kept = read_round(parts, 0)
    if kept is not None:
        return _again(kept, robot, Tolerances(), record, say), None
    base, given = fitted(robot, record, say)
    keep_round(parts, 0, KeptRound.of(base))
    return base, given


def _again(kept: KeptRound, robot: Robot, unknown: Tolerances, record: Measured, say: Say) -> Fitted:
    start = start_of(np.zeros(0), kept.orders, kept.floor, kept.near, kept.inside)
    return RobotFit.at(robot, unknown, record, kept.values, start, say).found


def _kept_round(step: Step | None, refused: str) -> KeptRound:
    if step is None:
        return KeptRound(refused=refused)
    details = {
        "cost": step.cost,
        "scored": [step.scored.part, step.scored.t, step.scored.size],
        "on_select": [getattr(step.on_select, n) for n in COMPARED],
        "rivals": [[*r.key, r.cost, r.near] for r in step.rivals],
    }
    return KeptRound.of(step.found, step.hypothesis.effect.stated(), step.hypothesis.joint, details)


def _remembered(kept: KeptRound, now: Fitted, records: Records, misses: bool, say: Say) -> Step | None:
    """The step of a round that an earlier run had finished."""
    start = None if kept.effect is None else hypothesis(now, kept.effect, kept.joint)
    if start is None:
        return None
    found = _again(kept, start.robot, start.unknown, records.fitted, say)
    details = kept.details
    rivals = tuple(Rival((name, joint), cost, near) for name, joint, cost, near in details["rivals"])
    scored = Scored(start.effect, start.joint, *details["scored"])
    without = to_beat(now, start, found, misses)
    return Step(start, scored, found, without, Comparison(*details["on_select"]), details["cost"], rivals)
