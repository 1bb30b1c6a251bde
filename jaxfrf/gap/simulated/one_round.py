"""One round of a selection: candidates are fitted, and the best of them is judged on positions that chose nothing."""

import dataclasses
from collections.abc import Collection, Sequence

import equinox as eqx
import numpy as np

from ..._errors import InputError
from ..._text import NORMAL_95
from ..._threads import lapack_threads, shared
from ...calibration.numbers import with_numbers
from ...robot import Robot
from ..settings import (
    DOUBTFUL,
    EXPLAINED,
    FINAL_ROUNDS,
    FIRST_ROUNDS,
    FLOOR,
    KEPT_WITHIN,
    LATE_ROUNDS,
    LEAST_FITTED,
    LIKELY,
    MORE_ROUNDS,
    MUCH,
)
from .fitted import Fitted, RobotFit, Say, further, or_at
from .hypothesis import Hypothesis, hypothesis, one_class, visible_size
from .judge import (
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
from .shortlist import Had, chosen, confused, imitated


class Rival(eqx.Module):
    """A candidate that was fitted, too. `cost`: over that of the robot before. `near`: whether the positions that chose
    nothing do not tell it from the best candidate."""

    key: tuple[str, str] = eqx.field(static=True)
    cost: float = eqx.field(static=True)
    near: bool = eqx.field(static=True)


class Step(eqx.Module):
    """An effect that was found. `found`: the robot with it. `without`: the one that it had to beat (`to_beat`).
    `on_select`: against that. `cost`: over the cost before."""

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


def on_all(now: Fitted, records: Records, say: Say) -> Fitted:
    """The same, fitted to the positions that decided, too, and from there to more experiments."""
    if len(records.opened) > len(records.fit):
        say("fits it to all positions that are not held out")
        now = _wherever_least(further(now, records.whole.at(records.opened), say, FINAL_ROUNDS))
    record = records.final
    if record.data.n_exp > records.whole.data.n_exp:
        say("fits it to more experiments")
        now = further(now, record, say, FINAL_ROUNDS).found
    return now


def _wherever_least(fit: RobotFit) -> Fitted:
    """Where a fit that has ended, or one that began elsewhere where an effect has several minima, leaves least; as
    uncertain as those have it that cost hardly more."""
    others = fit.elsewhere()
    for other in others:
        other.go_on(MORE_ROUNDS)
    ends = [one.found for one in (fit, *others)]
    costs = costs_of(ends)
    best = int(np.argmin(costs))
    found = ends[best]
    for k, end in enumerate(ends):
        if k != best and costs[k] - costs[best] < LIKELY:
            found = or_at(found, end)
    return found


def out_of_tolerance_names(now: Fitted) -> list[str]:
    return [now.numbers[i].name for i in now.out_of_tolerance]


def to_beat(now: Fitted, hypothesis: Hypothesis, found: Fitted, misses: bool) -> Robot:
    """The robot that an effect must beat: the one before, where something of it is beyond the floor, else the one
    before with numbers that nobody believes as given; the same robot without it, where the effect is the error of a
    number: the one before had most of that error already."""
    if hypothesis.is_number:
        return found.written(given=[o.number for o in hypothesis.own])
    return now.written() if misses else now.written(given=out_of_tolerance_names(now))


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """An effect that is a candidate, and the fit of the robot with it; `end`: of all rounds, once they are done."""

    scored: Scored
    hypothesis: Hypothesis
    fit: RobotFit
    end: Fitted | None = None

    @property
    def found(self) -> Fitted:
        return self.fit.found if self.end is None else self.end


class Round:
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
        costs = costs_of([*(r.found for r in candidates), self.now])[:-1]
        candidates = [r for r, cost in zip(candidates, costs, strict=True) if cost <= KEPT_WITHIN * min(costs)]
        candidates = shared(self._finish, candidates, lapack_threads())
        sized = [(self._size(r), r) for r in candidates]
        candidates = [r for size, r in sized if not 0.0 < size < LEAST_FITTED or self._takes_most(r)]
        if not candidates:
            size, largest = max(sized, key=lambda pair: pair[0])
            return None, f"{said(largest.hypothesis.key)} is fitted at {size:.2g} of what is visible"
        candidates, costs, before = self._in_order(candidates)
        after = each_written([r.found.written() for r in candidates], self.deciding)
        simulated = [(r, c / before, w) for r, c, w in zip(candidates, costs, after, strict=True) if w is not None]
        if not simulated:
            return None, "no robot with more can be simulated"
        simulated = self._of_one_class(simulated)
        step, against = self._judged(simulated)
        first = simulated[0][0].hypothesis
        numbers = [x for x in simulated[1:] if is_number_confused_with(x[0].hypothesis, first)]
        if step is None and numbers:  # what was tried for it is not in its way
            step, _ = self._judged(numbers)
        return step, against

    def _judged(self, simulated) -> tuple[Step | None, str]:
        best, cost, its = simulated[0]
        name = said(best.hypothesis.key)
        robot, before = self._to_beat(best)
        floor, frequency = its.evidence.plain, self.deciding.frequency
        versus = lambda one: compared(one.residual, its.residual, floor, frequency)
        if before is None:
            return None, f"{name} was not taken: the robot without it cannot be simulated where it is decided"
        result = versus(before)
        self.say(
            f"  {name}: {result.before:.3g} -> {result.after:.3g} beyond the floor on positions that decide, gain "
            f"{result.gain:.1%} (from {result.least:.1%}), p = {result.p_value:.2g}"
        )
        against = self._against(best, result, before, its) or self._uncertain(best)
        if against:
            return None, f"{name} was not taken: {against}"
        rivals = tuple(Rival(r.hypothesis.key, c, is_near(versus(w), result.before)) for r, c, w in simulated[1:])
        return Step(best.hypothesis, best.scored, best.found, robot, result, cost, rivals), ""

    def _to_beat(self, best: _Candidate) -> tuple[Robot, Written | None]:
        """The robot that a candidate must beat, and what it leaves on positions that decide."""
        if self.there is not None and self.misses and not best.hypothesis.is_number:  # the one before, simulated there
            return self.there.robot, self.there
        robot = to_beat(self.now, best.hypothesis, best.found, self.misses)
        return robot, written(robot, self.deciding)

    def _against(self, best: _Candidate, result: Comparison, before: Written, its: Written) -> str:
        """What the positions that decide say against an effect, in words; empty where nothing does. It may take away
        little of all that is beyond the floor where another effect is louder, on another axis."""
        if best.hypothesis.is_number:
            return shows_nothing(result, EXPLAINED)
        return shows_nothing(result, own=self._gain_on_its_axis(best, before, its))

    def _uncertain(self, best: _Candidate) -> str:
        """What its interval says against an effect; where few positions tell how much there is of it, those that
        decided are asked, too."""
        against = holds_none(best.hypothesis, best.found)
        if not against or len(self.records.opened) == len(self.records.fit):
            return against
        return holds_none(best.hypothesis, on_all(best.found, self.records, self.say))

    def _gain_on_its_axis(self, best: _Candidate, before: Written, its: Written) -> float:
        """Part of what is beyond the floor on the effect's own axis that it takes away."""
        if best.hypothesis.joint not in self.now.robot.axis_names:
            return 0.0
        axis = self.now.robot.axis_names.index(best.hypothesis.joint)
        floor, frequency = its.evidence.plain[:, [axis]], self.deciding.frequency
        return compared(before.residual[..., [axis]], its.residual[..., [axis]], floor, frequency).gain

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
            best = found[int(np.argmin(costs_of([r.found for r in found])))].hypothesis if found else None
            if best is not None and (takes_much or best.is_number):
                self._run(view, confused(scored, best.effect, best.key, had, view.robot), found)
            if takes_much:
                return found
        most = max((s.part for _, scored in seen for s in scored[:1]), default=0.0)
        doubtful = most < DOUBTFUL and np.max(self.now.of_axes) > FLOOR
        joints = {self.now.robot.axis_names[int(np.argmax(self.now.of_axes))]} if doubtful else set()
        for view, scored in seen:
            self._run(view, imitated(scored, joints, out_of_tolerance_names(self.now), had), found)
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
        *costs, before = costs_of([*(r.found for r in found), self.now])
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
        costs = costs_of([fit.found for _, fit in begun])
        best, fit = begun[int(np.argmin(costs))]
        fit.go_on(FIRST_ROUNDS - 1)
        return _Candidate(this, best, fit)

    def _beside(self, view: Fitted, start: Hypothesis, anew: Collection[str]) -> RobotFit | None:
        try:
            return RobotFit.beside(view, start.robot, start.unknown, self.record, self.say, anew)
        except InputError:
            return None

    def _finish(self, candidate: _Candidate) -> _Candidate:
        candidate.fit.go_on(MORE_ROUNDS, LATE_ROUNDS)
        candidate = dataclasses.replace(candidate, end=_wherever_least(candidate.fit))
        estimates = candidate.hypothesis.estimates(candidate.found)
        values = ", ".join(f"{name} {value:.4g} +- {NORMAL_95 * std:.2g}" for name, (value, std) in estimates.items())
        self.say(f"  {said(candidate.hypothesis.key)}: {values}")
        return candidate

    def _size(self, candidate: _Candidate) -> float:
        """Of a fitted effect over the just visible one; 0 of a number, and where it says nothing."""
        this = candidate.hypothesis
        return 0.0 if this.is_number else visible_size(this.effect_in(candidate.found), self.now.robot, this.joint)

    def _takes_most(self, candidate: _Candidate) -> bool:
        """Whether it leaves less than half of the cost before: what is thought to be visible then counts for little."""
        cost, before = costs_of([candidate.found, self.now])
        return cost < (1.0 - EXPLAINED) * before

    def _in_order(self, candidates: Sequence[_Candidate]) -> tuple[list[_Candidate], list[float], float]:
        """Each effect once, the cheapest first, with their costs and that of the robot before."""
        *costs, before = costs_of([*(r.found for r in candidates), self.now])
        best: dict = {}
        for cost, candidate in sorted(zip(costs, candidates, strict=True), key=lambda pair: pair[0]):
            best.setdefault(candidate.hypothesis.key, (candidate, cost))
        return [r for r, _ in best.values()], [c for _, c in best.values()], before


def is_number_confused_with(this: Hypothesis, other: Hypothesis) -> bool:
    """Whether this is the error of a number that the other effect of its joint is confused with."""
    return this.is_number and this.joint == other.joint and other.key[0] in this.effect.confusable


def said(key) -> str:
    return key[0].replace("_", " ") + (f" of {key[1]}" if key[1] else "")


def costs_of(robots: Sequence[Fitted]) -> list[float]:
    """Squares of what is left over one floor for all, so many counting as one, and those of the tolerances.

    The floor is the highest of theirs: it is a part of the simulated torque, of which some robots have next to none at
    lines where others have much. How many count as one is told by the robot in which they are fewest: what an effect
    leaves that is not there repeats from line to line, and would make its robot look as if little were known."""
    effect = min(found.iterate.posterior.effect for found in robots)
    floor = np.max([found.iterate.evidence.plain for found in robots], axis=0)
    return [float(np.sum(np.abs(found.left / floor) ** 2)) / effect + found.prior_cost for found in robots]


def holds_none(start: Hypothesis, found: Fitted) -> str:
    """That an effect's interval holds none of it, in words; empty where it does not."""
    name, (value, std) = next(iter(start.estimates(found).items()), ("", (np.inf, 0.0)))
    if abs(value - start.effect.nothing) < NORMAL_95 * std:
        return f"its {name} is {value:.3g} +- {NORMAL_95 * std:.2g}, which holds none of it"
    return ""
