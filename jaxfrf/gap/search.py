"""Which effects are missing: scored, refined, simulated, one after the other, until nothing more is found."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Bool

from ..effects import AbstractEffect
from ..parts import Parts
from ..robot import Robot
from ..trajectory.measured import Measured
from ..trajectory.remainder import excess
from .candidates import candidates
from .knobs import Knob, knobs, pinned, turned
from .refine import Refined, absent, names_of, refine
from .rounds import Round, keep_round, read_round
from .score import family_wise, variance
from .stage import (
    FAR,
    Scored,
    Stage,
    Table,
    gear_candidates,
    look,
    look_again,
    look_closely,
    look_for_ripple,
    retold,
    score,
    table,
)
from .trial import CLOSE, MOST_CORRECTIONS, Fitted, Setting, corrected, together, usual_misfit, with_effect

MOST = 2  # effects
_PART, _CLEAR_PART = 0.012, 0.002  # of the misfit that a candidate must explain; with a t beyond _CLEAR_T
# Ripple every motor has, and where one turns little, a resolver's is not told from a torque's; clipping few samples is
# soon explained.
_LOOSE = ("torque_ripple", "resolver_ripple", "transmission_error", "torque_saturation")
_LOOSE_PART = 0.03
_CLEAR_T = 15.0
_SIZE = 0.5  # of the visible one
_SIGNIFICANT = 0.05
_RIVAL = 0.5  # of the best candidate's drop: less is not worth a simulation
_SIMULATED = 2  # candidates in a round
_FIRST_CORRECTIONS = 1
_IN_THE_RACE = 1.3  # times the least misfit of a round: more is not worth more corrections
_REFITS, _CURES = 4, 0.7  # of the base model, each to leave this part of the misfit
_SHORT = 5  # candidates that are refined
_SECOND = 0.05  # of the misfit, or of the floor, that a second effect must promise: what the first left is no effect
_NEAR, _ANY = 0.1, 0.3  # of the misfit that is left, which is at least this: a rival this close is as good
_INTERVAL = 1.96  # standard deviations
_KEPT = 0.3  # of what a candidate promised must be kept by its simulation
FLOOR = 1.0  # misfit of an honest model

CLASSES = (
    frozenset(("torque_delay", "current_loop_lag")),
    frozenset(("counterbalance", "dress_pack")),
)

Say = Callable[[str], None]


class Option(eqx.Module):
    """A candidate after its parameters were refined. `drop`: part of the misfit that it takes."""

    scored: Scored
    refined: Refined
    drop: float

    @property
    def key(self) -> tuple[str, str]:
        return self.scored.candidate.key


class Rival(eqx.Module):
    """Another option of a round. `misfit`: after its own simulation, weighed as before the step; `None` where it was
    not simulated. `near`: whether it then leaves hardly more than the option taken, weighed as that one leaves it."""

    option: Option
    misfit: float | None
    near: bool


class Step(eqx.Module):
    """One effect found. `stage`: the robot with it. `rivals`: other options of the round. `before`, `after`: misfit,
    weighed as before the step."""

    option: Option
    effect: AbstractEffect
    std: tuple[float, ...] = eqx.field(static=True)
    stage: Stage
    rivals: tuple[Rival, ...]
    before: float
    after: float


class Search(eqx.Module):
    """A finished search.

    **Fields:** `views`: the refitted robot, and the given one where that was no cure. `steps`: effects found. `scored`:
    the first ranking, empty where nothing was beyond the floor.
    """

    setting: Setting
    knobs: tuple[Knob, ...]
    views: tuple[Stage, ...]
    steps: tuple[Step, ...]
    scored: tuple[Scored, ...]

    @property
    def given(self) -> Robot:
        return self.setting.given

    @property
    def record(self) -> Measured:
        return self.setting.record

    @property
    def opened(self) -> Bool[np.ndarray, "pos"]:
        return self.setting.opened

    @property
    def base(self) -> Stage:
        return self.views[0]


def search(
    robot: Robot,
    record: Measured,
    opened,
    own: Sequence[type[AbstractEffect]] = (),
    say: Say | None = None,
    progress: Callable[[float], None] | None = None,
    parts: Parts | None = None,
) -> Search:
    """Find what the robot lacks, on the opened positions.

    `parts`: where finished rounds are kept, and looked for.
    """
    say, done = say or (lambda text: None), progress or (lambda part: None)
    these, setting = knobs(robot), Setting(robot, record, np.asarray(opened))
    starts = _views(setting, these, say)
    done(0.3)
    steps, first, columns = [], (), None
    while len(steps) < MOST:
        views = (steps[-1].stage,) if steps else starts
        most = excess(views[0].left[setting.opened], views[0].evidence.plain, record.frequency)
        if most <= FLOOR:
            say(f"nowhere more than {most:.3g} times the floor is left: nothing to look for")
            break
        columns = columns or _table(starts[-1], record, opened, own)
        had = {step.option.key for step in steps}
        ranked = [
            _Ranked(view, tuple(s for s in _scored(view, columns, starts[-1]) if s.candidate.key not in had))
            for view in views
        ]
        first = first or ranked[0].scored
        kept = read_round(parts, len(steps))
        if kept is not None:
            step = _remembered(setting, kept, views[0], ranked[0].scored, steps)
        else:
            step = _best(setting, ranked, steps, say)
            keep_round(parts, len(steps), _round(step, these))
        if step is None:
            break
        step = dataclasses.replace(step, stage=look_for_ripple(step.stage, setting.opened))
        say(f"{step.effect.name} {step.option.key[1]}: misfit {step.before:.3g} -> {step.after:.3g}")
        steps.append(step)
        done(0.3 + 0.6 * len(steps) / MOST)
    done(0.95)
    return Search(setting, these, starts, tuple(steps), first)


class _Ranked(eqx.Module):
    stage: Stage
    scored: tuple[Scored, ...]


def _scored(view: Stage, columns: Table, own: Stage) -> list[Scored]:
    """The ranking of a view. `own`: the stage that the columns were made for."""
    return score(view, columns if view is own else retold(columns, view))


def _views(setting: Setting, these, say: Say) -> tuple[Stage, ...]:
    """The robot with its own numbers refitted, if they need that; and as it was given, where that was no cure.

    A large effect pulls the robot's numbers away from the truth, from where its first order leads nowhere; numbers
    that are far off do the same to a view of the robot as it was given. So candidates are looked at from both.
    """
    robot, record, opened = setting.given, setting.record, setting.opened
    given = look(robot, record, these, np.zeros(len(these)), opened)
    say(f"base model: misfit {given.misfit:.3g} times the floor's")
    if given.misfit <= FAR:
        return (given,)
    base = given
    for _ in range(_REFITS):
        last = base if base is given else look_closely(base, opened)
        turns = together(last.turns, last.fit.x[: len(these)])
        base = look_again(last, turned(robot, these, turns), record, turns, opened, near=False)
        say(f"refitted: misfit {base.misfit:.3g}")
        if base.misfit <= FAR or base.misfit > _CURES * last.misfit:
            break
    return (base, given) if base.misfit > FAR else (base,)


def _table(stage: Stage, record: Measured, opened, own) -> Table:
    largest = np.abs(np.asarray(record.data.u)).max(axis=(0, 1, 2))
    return table(stage, [*candidates(stage.robot, largest, own), *gear_candidates(stage, opened)])


def passes(scored: Scored, tests: int, runs: int) -> bool:
    """Whether a candidate is large and sure enough to be looked at."""
    if scored.size < _SIZE and not _at_its_edge(scored):
        return False
    waves = scored.candidate.name in _LOOSE
    if scored.part >= (_LOOSE_PART if waves else _PART):
        return family_wise(scored.part, scored.found.t, runs, tests) < _SIGNIFICANT
    return not waves and scored.part >= _CLEAR_PART and abs(scored.found.t) > _CLEAR_T


def _at_its_edge(scored: Scored) -> bool:
    """Whether the first order of a finite step says "less", which tells nothing of the size: its refinement does."""
    low, x = scored.candidate.low[0], scored.found.x[0]
    return 0.0 < low and x <= 1.001 * low


def options(stage: Stage, scored: Sequence[Scored]) -> list[Option]:
    """The best candidates, one for each effect and joint, with their parameters refined."""
    runs = int(np.sum(stage.fit.runs))
    found, seen = [], set()
    for this in scored:
        if this.candidate.key in seen or not passes(this, len(scored), runs):
            continue
        if found and (this.part < 0.1 * scored[0].part or len(found) == _SHORT):
            break
        seen.add(this.candidate.key)
        refined = Refined(this.effect(), this.found.drop, (), ())
        if this.candidate.basis and names_of(this.effect()):
            again = refine(stage, this.effect(), _visible(this))
            refined = again if again.drop > 0.9 * this.found.drop else refined
        found.append(Option(this, refined, refined.drop / stage.fit.squares))
    return sorted(found, key=lambda o: -o.drop)


def _visible(scored: Scored) -> float:
    """The first parameter's just visible value."""
    effect, candidate = scored.effect(), scored.candidate
    first = float(np.ravel(np.asarray(getattr(effect, next(iter(effect.units)))))[0])
    return first / max(scored.size, 1e-6) if candidate.visible == 1.0 else candidate.visible


def _best(setting: Setting, ranked: Sequence[_Ranked], steps, say: Say) -> Step | None:
    like, before = ranked[0].stage, [s.effect for s in steps]
    usual = lambda this: usual_misfit(this, like)
    found: list[Option] = []
    tried: list[_Trial] = []
    for view in ranked:
        these = options(view.stage, view.scored)
        if not these or (steps and these[0].drop * min(view.stage.misfit, 1.0) < _SECOND):
            continue
        found += these
        for option in these[:_SIMULATED]:
            if option.drop < _RIVAL * these[0].drop:
                break
            stage = with_effect(setting, view.stage, option.refined.effect, before)
            if stage is None:
                continue
            first = _Trial(option, view.stage, Fitted(option.refined.effect, option.refined.std, stage))
            tried.append(first.further(setting, like, before, _FIRST_CORRECTIONS))
            say(f"  simulated {tried[-1].told(usual)}")
    tried = _in_the_race(tried, usual)
    for i, trial in enumerate(tried):
        if trial.stage.misfit > CLOSE:
            tried[i] = trial.further(setting, like, before)
            say(f"  corrected {tried[i].told(usual)}")
    tried = [trial for trial in tried if trial.keeps(usual) and trial.is_sure(say)]
    if not tried:
        return None
    best = _winner(tried, like)
    rivals, fitted = _rivals(best, found, tried, like), best.fitted
    return Step(best.option, fitted.effect, fitted.std, best.stage, rivals, usual(like), usual(best.stage))


def _in_the_race(tried: Sequence["_Trial"], usual) -> list["_Trial"]:
    """The trials that are worth more corrections: near the least, and of one option the better view."""
    order = sorted(tried, key=lambda trial: usual(trial.stage))
    found = {}
    for trial in order:
        if usual(trial.stage) <= _IN_THE_RACE * usual(order[0].stage):
            found.setdefault(trial.option.key, trial)
    return list(found.values())


def _winner(tried: Sequence["_Trial"], like: Stage) -> "_Trial":
    """The trial that leaves least; weighed as before the step, and once more as that one leaves it: far from the truth
    the weights are coarse."""
    first = min(tried, key=lambda trial: usual_misfit(trial.stage, like))
    return min(tried, key=lambda trial: usual_misfit(trial.stage, first.stage))


def _rivals(best: "_Trial", found: Sequence[Option], tried: Sequence["_Trial"], like: Stage) -> tuple[Rival, ...]:
    """The other options, each once, best first."""
    limit = (1.0 + _NEAR) * usual_misfit(best.stage, best.stage) + _NEAR * _ANY
    others: dict[tuple[str, str], Rival] = {}
    for option in found:
        stages = [trial.stage for trial in tried if trial.option.key == option.key]
        misfit = min((usual_misfit(stage, like) for stage in stages), default=None)
        near = any(usual_misfit(stage, best.stage) < limit for stage in stages)
        others.setdefault(option.key, Rival(option, misfit, near))
    others.pop(best.option.key, None)
    return tuple(others.values())


def _round(step: Step | None, knobs) -> Round:
    if step is None:
        return Round(None, "", (), np.zeros(len(knobs)), ())
    rivals = tuple((*rival.option.key, rival.misfit, rival.near) for rival in step.rivals)
    return Round(step.effect, step.option.key[1], step.std, step.stage.turns, rivals)


def _remembered(setting: Setting, kept: Round, stage: Stage, scored, steps) -> Step | None:
    """The step of a round that an earlier run had finished."""
    if kept.effect is None:
        return None

    def option(name, joint, effect=None, names=()):
        this = next(s for s in scored if s.candidate.key == (name, joint))
        effect = this.effect() if effect is None else effect
        return Option(this, Refined(effect, this.found.drop, names, kept.std), this.part)

    names = names_of(kept.effect) if kept.std else ()
    robot = turned(setting.given, stage.knobs, kept.turns).with_effects(*[s.effect for s in steps], kept.effect)
    after = look_again(stage, robot, setting.record, kept.turns, setting.opened, pinned(stage.knobs, kept.effect))
    if after.misfit > CLOSE:
        after = look_closely(after, setting.opened)
    rivals = tuple(Rival(option(*key), misfit, near) for *key, misfit, near in kept.rivals)
    misfits = usual_misfit(stage, stage), usual_misfit(after, stage)
    return Step(
        option(kept.effect.name, kept.joint, kept.effect, names), kept.effect, kept.std, after, rivals, *misfits
    )


class _Trial(eqx.Module):
    """An option of a view, simulated."""

    option: Option
    view: Stage
    fitted: Fitted

    @property
    def stage(self) -> Stage:
        return self.fitted.stage

    def further(self, setting: Setting, like: Stage, before, most: int = MOST_CORRECTIONS) -> "_Trial":
        """The same, corrected until that is of no use."""
        visible = _visible(self.option.scored)
        return _Trial(self.option, self.view, corrected(setting, self.fitted, like, visible, before, most))

    def keeps(self, usual) -> bool:
        """Whether the simulation keeps what the signature promised."""
        before = usual(self.view)
        return before - usual(self.stage) >= _KEPT * self.option.drop * before

    def is_sure(self, say: Say) -> bool:
        """Whether the 95 % interval of its size does not hold "none of it"."""
        effect, std = self.fitted.effect, self.fitted.std
        if std:
            size = abs(float(getattr(effect, names_of(effect)[0])) - absent(effect, self.view.robot))
            sure = size > _INTERVAL * std[0]
        else:  # waves, whose amplitudes are of no sign
            gram, drop = self.view.weighed.gram, self.option.scored.found.drop
            size = len(self.option.scored.found.x)
            sure = drop > variance(gram, self.view.fit) * scipy.stats.chi2.ppf(0.95, size)
        if not sure:
            name, joint = self.option.key
            say(f"  {name} {joint}: its interval holds none of it")
        return sure

    def told(self, usual) -> str:
        name, joint = self.option.key
        return f"{name} {joint}: misfit {self.stage.misfit:.3g} ({usual(self.stage):.3g})"
