"""Which effects are missing, as a comparison of robots whose numbers were fitted.

The robot as it was given, its numbers fitted, stands first. Candidates that promise most, to first order, become robots
whose effect's parameters are numbers of which nothing is known; all their numbers are fitted from where those before
stood. The one that costs least must be better on positions that chose nothing, and takes the place of the robot before;
and so on, until nothing is beyond the floor or nothing is better.
"""

import dataclasses
from collections.abc import Collection, Sequence

import equinox as eqx
import numpy as np

from .._errors import InputError
from .._threads import lapack_threads, shared
from ..calibration.numbers import with_numbers
from ..effects import AbstractEffect
from ..parts import Parts
from ..robot import Robot, Tolerances
from ..trajectory.evidence import by_band
from ..trajectory.measured import Measured
from .fitted import Fitted, RobotFit, Say, as_given, at, fitted, further, with_link_errors
from .hypothesis import Hypothesis, hypothesis, one_class
from .judge import (
    COMPARED,
    Comparison,
    Written,
    compared,
    each_written,
    is_near,
    over_floor,
    shows_nothing,
    written,
)
from .rank import Scored, ranked
from .records import Records
from .rounds import KeptRound, keep_round, read_round
from .settings import (
    DOUBTFUL,
    EXPLAINED,
    FINAL_ROUNDS,
    FIRST_ROUNDS,
    FLOOR,
    KEPT_WITHIN,
    MORE_ROUNDS,
    MOST,
    MUCH,
)
from .shortlist import Had, chosen, confused, imitated


class Rival(eqx.Module):
    """A candidate that was fitted, too. `cost`: over that of the robot before. `near`: whether the positions that chose
    nothing do not tell it from the best candidate."""

    key: tuple[str, str] = eqx.field(static=True)
    cost: float = eqx.field(static=True)
    near: bool = eqx.field(static=True)


class Step(eqx.Module):
    """An effect that was found. `found`: the robot with it. `without`: the last of those that it had to beat
    (`to_beat`). `on_select`: against that. `cost`: over the cost before."""

    hypothesis: Hypothesis
    scored: Scored
    found: Fitted
    without: Robot
    on_select: Comparison
    cost: float = eqx.field(static=True)
    rivals: tuple[Rival, ...]

    @property
    def key(self) -> tuple[str, str]:
        return self.hypothesis.key

    def without_columns(self) -> "Step":
        """The same, its robot without them (`Fitted.without_columns`)."""
        return dataclasses.replace(self, found=self.found.without_columns())


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
    last = with_link_errors(_on_all(steps[-1].found, records, say)) if steps else base
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
        (misses, there), out_of_tolerance = _misses(now, records, say), _out_of_tolerance(now)
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
            round = _Round(now, records, own, misses, there, say)
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


def _out_of_tolerance(now: Fitted) -> list[str]:
    return [now.numbers[i].name for i in now.out_of_tolerance]


def _on_all(now: Fitted, records: Records, say: Say) -> Fitted:
    """The same, fitted to the positions that decided, too."""
    if len(records.opened) == len(records.fit):
        return now
    say("fits it to all positions that are not held out")
    return further(now, records.whole.at(records.opened), say, FINAL_ROUNDS)


def _base(robot: Robot, record: Measured, say: Say, parts) -> tuple[Fitted, Fitted | None]:
    kept = read_round(parts, 0)
    if kept is not None:
        return _again(kept, robot, Tolerances(), record, say), None
    base, given = fitted(robot, record, say)
    keep_round(parts, 0, KeptRound.of(base))
    return base, given


def _again(kept: KeptRound, robot: Robot, unknown: Tolerances, record: Measured, say: Say) -> Fitted:
    return at(robot, unknown, record, kept.values, kept.orders, kept.floor, kept.near, kept.inside, say)


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
    without = to_beat(now, start, found, misses)[-1]
    return Step(start, scored, found, without, Comparison(*details["on_select"]), details["cost"], rivals)


def to_beat(now: Fitted, hypothesis: Hypothesis, found: Fitted, misses: bool) -> list[Robot]:
    """The robots that an effect must beat: the one before, where something of it is beyond the floor, else the one
    before with numbers that nobody believes as given; the same robot without it, where the effect is the error of a
    number: the one before had most of that error already."""
    if hypothesis.is_number:
        return [found.written(given=[o.number for o in hypothesis.own])]
    return [now.written() if misses else now.written(given=_out_of_tolerance(now))]


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """An effect that is a candidate, and the fit of the robot with it."""

    scored: Scored
    hypothesis: Hypothesis
    fit: RobotFit

    @property
    def found(self) -> Fitted:
        return self.fit.found


class _Round:
    """One round: candidates for the place of the robot that stands, which `misses` something beyond the floor, or
    whose numbers are off by what is not believed. `there`: that robot on positions that decide, where it was
    simulated."""

    def __init__(self, now: Fitted, records: Records, own, misses: bool, there: Written | None, say: Say):
        self.now, self.records, self.own, self.misses, self.there, self.say = now, records, own, misses, there, say
        self.record, self.deciding = records.fitted, records.deciding
        self.scored: tuple[Scored, ...] = ()  # from the first view

    def best(self, views: Sequence[Fitted], had: Had) -> tuple[Step | None, str]:
        candidates = self._screened(views, had)
        if not candidates:
            return None, "no candidate explains more than chance"
        costs = _costs([*(r.found for r in candidates), self.now])[:-1]
        candidates = [r for r, cost in zip(candidates, costs, strict=True) if cost <= KEPT_WITHIN * min(costs)]
        shared(self._finish, candidates, lapack_threads())
        candidates, costs, before = self._in_order(candidates)
        after = each_written([r.found.written() for r in candidates], self.deciding)
        simulated = [(r, c / before, w) for r, c, w in zip(candidates, costs, after, strict=True) if w is not None]
        if not simulated:
            return None, "no robot with more can be simulated"
        return self._judged(simulated)

    def _judged(self, simulated) -> tuple[Step | None, str]:
        simulated = self._of_one_class(simulated)
        best, cost, its = simulated[0]
        name = said(best.hypothesis.key)
        others = to_beat(self.now, best.hypothesis, best.found, self.misses)
        is_now = self.misses and not best.hypothesis.is_number  # what it must beat, as `to_beat` has it
        before = [self.there] if is_now and self.there else each_written(others, self.deciding)
        floor, frequency = its.evidence.plain, self.deciding.frequency
        versus = lambda one, two: compared(one.residual, two.residual, floor, frequency)
        results = [versus(one, its) for one in before if one is not None]
        for result in results:
            self.say(
                f"  {name}: {result.before:.3g} -> {result.after:.3g} beyond the floor on positions that decide, gain "
                f"{result.gain:.1%} (from {result.least:.1%}), p = {result.p_value:.2g}"
            )
        against = _against(best, results, self._gain_on_its_axis(best, before, its)) or self._uncertain(best)
        if against:
            return None, f"{name} was not taken: {against}"
        near = lambda w: is_near(versus(w, its), results[-1].before)
        rivals = tuple(Rival(r.hypothesis.key, c, near(w)) for r, c, w in simulated[1:])
        return Step(best.hypothesis, best.scored, best.found, others[-1], results[-1], cost, rivals), ""

    def _uncertain(self, best: _Candidate) -> str:
        """What its interval says against an effect; where few positions tell how much there is of it, those that
        decided are asked, too."""
        against = _holds_none(best.hypothesis, best.found)
        if not against or len(self.records.opened) == len(self.records.fit):
            return against
        return _holds_none(best.hypothesis, _on_all(best.found, self.records, self.say))

    def _gain_on_its_axis(self, best: _Candidate, before: Sequence[Written | None], its: Written) -> float:
        """Part of what is beyond the floor on the effect's own axis that it takes away, least of those it must beat."""
        if best.hypothesis.joint not in self.now.robot.axis_names:
            return 0.0
        axis = self.now.robot.axis_names.index(best.hypothesis.joint)
        floor, frequency = its.evidence.plain[:, [axis]], self.deciding.frequency
        own = lambda one: compared(one.residual[..., [axis]], its.residual[..., [axis]], floor, frequency)
        gains = [own(one).gain for one in before if one is not None]
        return min(gains, default=0.0)

    def _of_one_class(self, simulated):
        """The same, the first of them that of its class that leaves least on positions that decide: what the fit tells
        hardly apart, other positions may."""
        first, floor = simulated[0][0].hypothesis, simulated[0][2].evidence.plain
        left = [float(np.sum(over_floor(w.residual, floor) ** 2)) for _, _, w in simulated]
        alike = [i for i, (r, *_) in enumerate(simulated) if one_class(first.effect, first.key, r.hypothesis.key)]
        best = min(alike, key=lambda i: left[i])
        return [simulated[best], *(x for i, x in enumerate(simulated) if i != best)]

    def _screened(self, views: Sequence[Fitted], had: Had) -> list[_Candidate]:
        """Candidates of one view after the other, and those that numbers imitate, until one takes much away; beside it,
        or beside a number whose tolerance is not believed, those that it is confused with."""
        found: list[_Candidate] = []
        seen = []
        for view in views:
            scored = ranked(view, self.record, self.own, self.misses)
            self.scored = self.scored or tuple(scored)
            seen.append((view, scored))
            takes_much = self._run(view, chosen(scored, had), found)
            best = found[int(np.argmin(_costs([r.found for r in found])))].hypothesis if found else None
            if best is not None and (takes_much or best.is_number):
                self._run(view, confused(scored, best.effect, best.key, had, view.robot), found)
            if takes_much:
                return found
        most = max((s.part for _, scored in seen for s in scored[:1]), default=0.0)
        doubtful = most < DOUBTFUL and np.max(self.now.of_axes) > FLOOR
        joints = {self.now.robot.axis_names[int(np.argmax(self.now.of_axes))]} if doubtful else set()
        for view, scored in seen:
            self._run(view, imitated(scored, joints, _out_of_tolerance(self.now), had), found)
        return found

    def _run(self, view: Fitted, some: Sequence[Scored], found: list[_Candidate]) -> bool:
        """Fit candidates for some rounds; whether one of all takes much away."""
        starts: dict[tuple[str, str], tuple[Scored, Hypothesis]] = {}
        for this in some:
            start = hypothesis(view, this.effect, this.joint)
            if start is not None and start.key not in {r.hypothesis.key for r in found}:
                starts.setdefault(start.key, (this, start))
        candidates = shared(lambda each: self._start(view, *each), starts.values(), lapack_threads())
        found += [candidate for candidate in candidates if candidate is not None]
        *costs, before = _costs([*(r.found for r in found), self.now])
        return bool(costs) and min(costs) < MUCH * before

    def _start(self, view: Fitted, this: Scored, start: Hypothesis) -> "_Candidate | None":
        """A candidate after its first rounds, from that of its starts that leaves least behind one step."""
        self.say(f"  tries {said(this.key)}, which promises {this.part:.1%}")
        starts: list[tuple[Hypothesis, tuple[str, ...]]] = [(start, ())]
        fitted = with_numbers(view.robot, view.numbers, view.x)
        for effect in this.effect.starts(view.robot, fitted, this.joint):
            other = hypothesis(view, effect, this.joint)
            starts += [] if other is None else [(other, other.imitated_by)]
        begun = [(one, fit) for one, anew in starts if (fit := self._beside(view, one, anew)) is not None]
        if not begun:
            return None
        costs = _costs([fit.found for _, fit in begun])
        best, fit = begun[int(np.argmin(costs))]
        fit.go_on(FIRST_ROUNDS - 1)
        return _Candidate(this, best, fit)

    def _beside(self, view: Fitted, start: Hypothesis, anew: Collection[str]) -> RobotFit | None:
        try:
            return RobotFit.beside(view, start.robot, start.unknown, self.record, self.say, anew)
        except InputError:
            return None

    def _finish(self, candidate: _Candidate) -> None:
        candidate.fit.finish(MORE_ROUNDS)
        estimates = candidate.hypothesis.estimates(candidate.found)
        values = ", ".join(f"{name} {value:.4g} +- {1.96 * std:.2g}" for name, (value, std) in estimates.items())
        self.say(f"  {said(candidate.hypothesis.key)}: {values}")

    def _in_order(self, candidates: Sequence[_Candidate]) -> tuple[list[_Candidate], list[float], float]:
        """Each effect once, the cheapest first, with their costs and that of the robot before."""
        *costs, before = _costs([*(r.found for r in candidates), self.now])
        best: dict = {}
        for cost, candidate in sorted(zip(costs, candidates, strict=True), key=lambda pair: pair[0]):
            best.setdefault(candidate.hypothesis.key, (candidate, cost))
        return [r for r, _ in best.values()], [c for _, c in best.values()], before


def said(key) -> str:
    return key[0].replace("_", " ") + (f" of {key[1]}" if key[1] else "")


def _costs(robots: Sequence[Fitted]) -> list[float]:
    """Squares of what is left over one floor for all, so many counting as one, and those of the tolerances.

    The floor is the highest of theirs: it is a part of the simulated torque, of which some robots have next to none at
    lines where others have much. How many count as one is told by the robot in which they are fewest: what an effect
    leaves that is not there repeats from line to line, and would make its robot look as if little were known."""
    effect = min(found.iterate.posterior.effect for found in robots)
    floor = np.max([found.iterate.evidence.plain for found in robots], axis=0)
    return [float(np.sum(np.abs(found.left / floor) ** 2)) / effect + found.prior_cost for found in robots]


def _holds_none(start: Hypothesis, found: Fitted) -> str:
    """That an effect's interval holds none of it, in words; empty where it does not."""
    name, (value, std) = next(iter(start.estimates(found).items()), ("", (np.inf, 0.0)))
    if abs(value - start.effect.nothing) < 1.96 * std:
        return f"its {name} is {value:.3g} +- {1.96 * std:.2g}, which holds none of it"
    return ""


def _against(best: _Candidate, results: Sequence[Comparison], on_its_axis: float) -> str:
    """What the positions that decide say against an effect, in words; empty where nothing does. `on_its_axis`: part of
    what is beyond the floor there that it takes away: little of all of it where another effect is louder, on another
    axis."""
    if not results:
        return "the robot without it cannot be simulated where it is decided"
    number = best.hypothesis.is_number
    each = (shows_nothing(r, EXPLAINED) if number else shows_nothing(r, own=on_its_axis) for r in results)
    return next((text for text in each if text), "")
