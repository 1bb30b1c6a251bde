"""Which effects are missing, as a contest between robots whose numbers were fitted.

The robot as it was given, its numbers fitted, stands first. Candidates that promise most, to first order, become robots
whose effect's parameters are numbers of which nothing is known; all their numbers are fitted from where those before
stood. The one that costs least must be better on positions that chose nothing, and takes the place of the robot before;
and so on, until nothing is beyond the floor or nothing is better.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from .._errors import InputError
from ..effects import AbstractEffect
from ..parts import Parts
from ..robot import Robot, Tolerances
from ..robot.tolerances import Tolerance
from ..trajectory.measured import Measured
from .fitted import Fitted, Say, at, fitted, fitted_from, further
from .hypothesis import Hypothesis, hypothesis
from .judge import COMPARED, Comparison, Written, compared, written
from .rank import Scored, ranked
from .rounds import Round, keep_round, read_round
from .settings import (
    CREDIBLE,
    DOUBTFUL,
    FAR,
    FINALISTS,
    FIRST_HEAT,
    FLOOR,
    IN_THE_RACE,
    LEAST_GAIN,
    LEAST_PART,
    LEAST_SIZE,
    MOST,
    NEAR,
    NO_WORSE,
    ROUNDS,
    SHARE,
    SIGNIFICANT,
)

SPRING_SHAPES = ("backlash", "stiffness_hardening")  # numbers of a spring imitate them to first order


class Rival(eqx.Module):
    """A candidate that was fitted, too. `cost`: over that of the robot before. `near`: whether the positions that chose
    nothing do not tell it from the winner."""

    key: tuple[str, str] = eqx.field(static=True)
    cost: float = eqx.field(static=True)
    near: bool = eqx.field(static=True)


class Step(eqx.Module):
    """An effect that was found. `found`: the robot with it; `written`: on all positions. `without`: the robot before,
    written; of a number that is wrong, which is no missing term, that in which it is held as given. `on_select`:
    against that. `cost`: over the cost before."""

    hypothesis: Hypothesis
    scored: Scored
    found: Fitted
    written: Written
    without: Written
    is_number: bool = eqx.field(static=True)
    on_select: Comparison
    cost: float = eqx.field(static=True)
    rivals: tuple[Rival, ...]

    @property
    def key(self) -> tuple[str, str]:
        return self.hypothesis.key


class Contest(eqx.Module):
    """What was found.

    **Fields:** `base`: the robot with its numbers fitted; `written`: on all positions. `steps`: effects. `scored`: the
    first ranking, empty where nothing was looked for. `refused`: in words, why the last winner was not taken.
    """

    base: Fitted
    written: Written
    steps: tuple[Step, ...]
    scored: tuple[Scored, ...]
    refused: str = eqx.field(static=True)

    @property
    def last(self) -> Fitted:
        return self.steps[-1].found if self.steps else self.base


class Records(eqx.Module):
    """A record, and its positions that are fitted, that decide which effect is taken, and that are sealed."""

    whole: Measured
    fit: np.ndarray
    select: np.ndarray
    sealed: np.ndarray

    @property
    def fitted(self) -> Measured:
        return self.whole.at(self.fit)

    @property
    def judged(self) -> np.ndarray:
        """Where the result is told: the sealed ones, or those that were fitted where none are sealed."""
        return self.sealed if len(self.sealed) else np.union1d(self.fit, self.select)


def contest(
    robot: Robot,
    records: Records,
    own: Sequence[type[AbstractEffect]],
    say: Say,
    done,
    parts: Parts | None,
) -> Contest:
    """The effects that a robot lacks, on the positions that are not sealed."""
    say("fits the robot's own numbers")
    fit = records.fitted
    base, given = _base(robot, fit, say, parts)
    its = first_written = written(base.written(quiet=True), records.whole) or written(robot, records.whole)
    done(0.3)
    now, steps, first, refused = base, [], (), ""
    while len(steps) < MOST:
        most, far = now.excess(fit), incredible(now)
        says = f"at most {most:.3g} times the floor is left"
        say(says + (f"; {', '.join(far)}: off by more than is known" if far else ""))
        if most <= FLOOR and not far:
            break
        kept = read_round(parts, len(steps) + 1)
        if kept is not None and kept.effect is None:
            refused = kept.refused
            break
        views = [now] if given is None or steps or now.look.left <= FLOOR else [now, given]
        rankings = [ranked(view, fit, own) for view in views] if kept is None or not first else []
        first = first or tuple(rankings[0])
        if kept is not None:
            step = _remembered(kept, now, its, records, say)
        else:
            step, refused = _best(now, its, views, rankings, {s.key for s in steps}, records, say)
            keep_round(parts, len(steps) + 1, _round(step, refused))
        if step is None:
            say(refused)
            break
        steps.append(step)
        now, its = step.found, step.written
        done(0.3 + 0.6 * len(steps) / MOST)
    return Contest(base, first_written, tuple(steps), first, refused)


def _base(robot: Robot, record: Measured, say: Say, parts) -> tuple[Fitted, Fitted | None]:
    kept = read_round(parts, 0)
    if kept is not None:
        return at(robot, Tolerances(), record, kept.values, kept.orders, kept.floor, say), None
    base, given = fitted(robot, record, say)
    keep_round(parts, 0, Round.of(base))
    return base, given


def _round(step: Step | None, refused: str) -> Round:
    if step is None:
        return Round(refused=refused)
    told = {
        "cost": step.cost,
        "scored": [step.scored.part, step.scored.t, step.scored.size],
        "on_select": [getattr(step.on_select, n) for n in COMPARED],
        "rivals": [[*r.key, r.cost, r.near] for r in step.rivals],
        "is_number": step.is_number,
    }
    return Round.of(step.found, step.hypothesis.effect, step.hypothesis.joint, told)


def _remembered(kept: Round, now: Fitted, before: Written, records: Records, say: Say) -> Step | None:
    """The step of a round that an earlier run had finished."""
    begun = hypothesis(now, kept.effect, kept.joint)
    found = at(begun.robot, begun.unknown, records.fitted, kept.values, kept.orders, kept.floor, say)
    told = kept.told
    without = _held(now, begun, records, say) if told["is_number"] else None
    rivals = tuple(Rival((name, joint), cost, near) for name, joint, cost, near in told["rivals"])
    return Step(
        begun,
        Scored(kept.effect, kept.joint, *told["scored"]),
        found,
        written(found.written(), records.whole),
        without or before,
        told["is_number"],
        Comparison(*told["on_select"]),
        told["cost"],
        rivals,
    )


def incredible(found: Fitted, far: float = FAR) -> list[str]:
    """Numbers that are further off than is believed."""
    return [
        n.name
        for n, x in zip(found.these, found.x, strict=True)
        if n.prior > 0 and n.kind != "smoothing" and abs(x) > far
    ]


class _Runner(eqx.Module):
    """A candidate in the race."""

    scored: Scored
    hypothesis: Hypothesis
    found: Fitted


def _best(now: Fitted, before: Written, views, rankings, had, records: Records, say: Say) -> tuple[Step | None, str]:
    fit = records.fitted
    runners = _first_heat(now, views, rankings, had, fit, say)
    if not runners:
        return None, "no candidate explains more than chance"
    costs = _costs([r.found for r in runners], now)
    runners = [
        _finished(r, fit, say) for r, cost in zip(runners, costs, strict=True) if cost <= IN_THE_RACE * min(costs)
    ]
    runners, costs, before_cost = _in_order(runners, now)
    after = [written(r.found.written(), records.whole) for r in runners]
    running = [(r, c / before_cost, w) for r, c, w in zip(runners, costs, after, strict=True) if w is not None]
    if not running:
        return None, "no robot with more can be simulated"
    winner, cost, its = running[0]
    floor, frequency, select = before.evidence.plain, records.whole.frequency, records.select
    versus = lambda one, two: compared(one.residual[select], two.residual[select], floor, frequency)
    own = winner.hypothesis.own
    is_number = bool(own) and all(o.number in {n.name for n in now.these} for o in own)
    without = (_held(now, winner.hypothesis, records, say) if is_number else None) or before
    result = versus(without, its)
    name = said(winner.hypothesis.key)
    say(f"  {name}: {result.before:.3g} -> {result.after:.3g} on positions that decide, gain {result.gain:.1%}")
    against = _against(now, winner, result)
    if against:
        return None, f"{name} was not taken: {against}"
    rivals = tuple(Rival(r.hypothesis.key, c, _near(versus(w, its))) for r, c, w in running[1:])
    return Step(winner.hypothesis, winner.scored, winner.found, its, without, is_number, result, cost, rivals), ""


def _held(now: Fitted, free: Hypothesis, records: Records, say: Say) -> Written | None:
    """The robot with its other numbers fitted, where those that an effect is an error of are as given."""
    held = Tolerances(tuple((o.number, Tolerance(0.0)) for o in free.own))
    found = fitted_from(now.robot, now.unknown.updated(held), records.fitted, now, say, ROUNDS)
    return written(found.written(), records.whole)


def said(key) -> str:
    return key[0].replace("_", " ") + (f" of {key[1]}" if key[1] else "")


def _first_heat(now: Fitted, views, rankings, had, record: Measured, say: Say) -> list[_Runner]:
    found = []
    for view, scored in zip(views, rankings, strict=True):
        for this in _chosen(view, scored, had, record):
            begun = hypothesis(view, this.effect, this.joint)
            if begun is None:
                continue
            say(f"  tries {said(this.key)}, which promises {this.part:.1%}")
            try:
                fit = fitted_from(begun.robot, begun.unknown, record, view, say, FIRST_HEAT)
            except InputError:
                continue
            found.append(_Runner(this, begun, fit))
    return found


def _chosen(view: Fitted, scored: Sequence[Scored], had, record: Measured) -> list[Scored]:
    """The candidates of a ranking that are fitted."""
    scored = [s for s in scored if s.key not in had]
    chosen: list[Scored] = []
    for this in scored:
        if len(chosen) == FINALISTS or this.part < max(SHARE * scored[0].part, LEAST_PART):
            break
        if this.size >= LEAST_SIZE and this.key not in [s.key for s in chosen]:
            chosen.append(this)
    if (not chosen or chosen[0].part < DOUBTFUL) and view.excess(record) > FLOOR:
        chosen += _shapes(view, scored, chosen, record)
    return chosen


def _shapes(view: Fitted, scored, chosen, record: Measured) -> list[Scored]:
    """Effects that change the shape of the spring of the axis with most left, beyond first order."""
    left = np.mean(np.abs(view.left / view.look.evidence.plain) ** 2, axis=(0, 1, 2))
    joint = view.robot.axis_names[int(np.argmax(left))]
    best = {}
    for this in scored:
        if this.key[0] in SPRING_SHAPES and this.joint == joint:
            best.setdefault(this.key, this)
    return [this for key, this in best.items() if key not in [s.key for s in chosen]]


def _finished(runner: _Runner, record: Measured, say: Say) -> _Runner:
    found = further(runner.found, record, say, ROUNDS - FIRST_HEAT)
    told = runner.hypothesis.told(found)
    values = ", ".join(f"{name} {value:.4g} +- {1.96 * std:.2g}" for name, (value, std) in told.items())
    say(f"  {said(runner.hypothesis.key)}: {values}")
    return _Runner(runner.scored, runner.hypothesis, found)


def _in_order(runners: Sequence[_Runner], now: Fitted) -> tuple[list[_Runner], list[float], float]:
    """Each effect once, the cheapest first, with their costs and that of the robot before."""
    *costs, before = _costs([*(r.found for r in runners), now], now)
    best: dict = {}
    for cost, runner in sorted(zip(costs, runners, strict=True), key=lambda pair: pair[0]):
        best.setdefault(runner.hypothesis.key, (runner, cost))
    return [r for r, _ in best.values()], [c for _, c in best.values()], before


def _costs(robots: Sequence[Fitted], like: Fitted) -> list[float]:
    """Squares of what is left over the floor of one of them, so many counting as one, and those of the tolerances.

    How many is told by the robot in which they are fewest: what an effect leaves that is not there repeats from line to
    line, and would make its robot look as if little were known."""
    effect = min(found.look.posterior.effect for found in robots)
    over = lambda found: float(np.sum(np.abs(found.left / like.look.evidence.plain) ** 2))
    return [over(found) / effect + found.priced for found in robots]


def _against(now: Fitted, winner: _Runner, result: Comparison) -> str:
    """What speaks against an effect, in words; empty where nothing does."""
    told = winner.hypothesis.told(winner.found)
    name, (value, std) = next(iter(told.items()), ("", (1.0, 0.0)))
    if name != "ratio" and abs(value) < 1.96 * std:
        return f"its {name} is {value:.3g} +- {1.96 * std:.2g}, which holds none of it"
    if result.p_value <= SIGNIFICANT and result.gain > LEAST_GAIN:
        return ""
    saved = now.priced - winner.found.priced
    if saved > CREDIBLE and (result.after <= NO_WORSE * result.before or result.after < FLOOR):
        return ""
    return f"on positions that chose nothing it takes away {result.gain:.1%} of the misfit, p = {result.p_value:.2g}"


def _near(result: Comparison) -> bool:
    """Whether a rival leaves hardly more than the winner, where the positions that decide are asked."""
    return result.p_value > SIGNIFICANT or result.before - result.after < NEAR * FLOOR
