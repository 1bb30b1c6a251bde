"""What stands of a selection once the held-out positions are opened: verdict, words, effects, the robot to write."""

import itertools
from collections.abc import Collection, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._threads import lapack_threads, shared
from ...calibration.numbers import Number
from ...calibration.result import DATA_SHARE
from ...effects import AbstractEffect, library
from ...effects._place import axis_of
from ...robot import Robot
from ...trajectory.measured import Measured
from ...trajectory.wiring import LOST, miswired
from ..result import EstimatedValue, Named, WrongNumber
from ..settings import (
    FAR_LEFT,
    FINAL_ROUNDS,
    HOPELESS,
    INTERVAL,
    LEAST_SIZE,
    LEVEL,
    MISSED,
    OFF,
    OUT_OF_TOLERANCE,
    TOLERANCE,
    UNEXPLAINED,
    WORSE,
)
from ..verdict import verdict_of
from .fitted import Fitted, further
from .hypothesis import one_class, visible_size
from .judge import (
    Written,
    against_it,
    compared,
    relative_torque,
    simulated,
    written,
)
from .loud_ripple import loud_ripple, stated_waves, without_ripple
from .one_round import Step, holds_none, said
from .quantised import resolution
from .records import Records
from .selection import Selection


class Conclusion(eqx.Module):
    """What is said. `base`, `extended`: robots that are written, without and with the effects that stand, where the
    result is judged. `records`: with the positions that were held out in the end."""

    verdict: str = eqx.field(static=True)
    says: str = eqx.field(static=True)
    effects: tuple[Named, ...]
    base: Written
    extended: Written
    last: Fitted
    steps: tuple[Step, ...]
    records: Records
    wrong: tuple[WrongNumber, ...]


def concluded(found: Selection, records: Records, given: Robot) -> Conclusion:
    """The verdict: effects stand as far as the robot written with each makes the gap on the held-out positions smaller
    than that of the one before."""
    judged, deciding = records.every.at(records.judged), records.deciding
    opened = _opened(found, judged, deciding)
    steps, refused = _standing(found, opened, judged)
    last, before = found.last, opened.before[0] if steps else None
    extended, there = opened.after[-1], opened.there
    if len(steps) < len(found.steps):
        last = steps[-1].found if steps else found.base
        extended, there = _each_there([(last.written(), judged), (last.written(), deciding)])
    extended = extended or simulated(given, judged)
    louder = loud_ripple(last, extended, there, deciding, judged)
    effects, counts = (*(_named(step, last, given) for step in steps), *louder), counting(records.whole, given)
    base = (before if steps else without_ripple(last, louder, extended, judged)) or extended
    worst, everywhere = _worst(last, extended, there), ""
    again = _at_all_positions(last, records) if worst > UNEXPLAINED and not effects else None
    if again is not None:
        records, last, extended, worst = again
        base, judged, everywhere = extended, records.every, _EVERYWHERE
    looked_for, heldout = bool(found.refused or found.steps), bool(len(records.heldout))
    verdict, says = _verdict(base, looked_for, steps, effects, counts, last, extended, judged, worst, heldout)
    if verdict == "unexplained":
        last, effects, steps = found.base, (), ()
        base = extended = written(found.base.written(), judged) or base
        says += _hints(base, judged)
    elif counts:
        effects, extended = (*effects, *counts), _with_effects(extended, counts)
    if verdict not in ("named", "ambiguous"):
        taken_back = "".join(f" {text[0].upper() + text[1:]}." for text in (*refused, found.refused) if text)
        says += taken_back + everywhere
    if steps and np.array_equal(records.select, records.fit):
        says += " With so few positions those that were fitted decided, too: p-values are too small."
    wrong: tuple[WrongNumber, ...] = ()
    if verdict != "unexplained":  # else numbers imitate what is missing
        wrong = wrong_numbers(last, redefined(steps, given))
    says += _wrong_numbers(wrong, given)
    return Conclusion(verdict, says, effects, base, extended, last, steps, records, wrong)


def _hints(base: Written, judged: Measured) -> str:
    """What could be wrong with the record where most of a torque is missed."""
    if np.max(relative_torque(judged, base.residual)) < LOST:
        return ""
    hints = miswired(base.evidence.robot, judged.U[:, :, 1:], base.evidence.U[:, :, 1:])
    return "".join(f" {text[0].upper()}{text[1:]}" for text in hints)


def _worst(last: Fitted, extended: Written, there: Written | None) -> float:
    """Mean square over the floor that is left of one axis: where it was fitted, or at one position that chose
    nothing, where what is missing may show alone. `there`: on positions that decide."""
    sides = [x for x in (there, extended) if x is not None]
    each = [0.5 * np.mean(np.abs(x.residual / x.evidence.plain) ** 2, axis=(1, 2)) for x in sides]
    return max(float(np.max(last.of_axes)), *(float(np.max(x)) for x in each))


_EVERYWHERE = " The held-out positions were fitted, too: the others did not tell the numbers that they need."


def _at_all_positions(last: Fitted, records: Records) -> tuple[Records, Fitted, Written, float] | None:
    """The robot fitted to all positions, none being held out then, as it would be written, and the worst that it leaves
    at any: whether numbers explain a position is told by a fit to it, not by those of other positions, which may not
    tell them all. `None` where they do not."""
    nowhere = records.heldout[:0]
    records = Records(records.whole, records.every, np.union1d(records.opened, records.heldout), nowhere, nowhere)
    fit = further(last, records.final, lambda text: None, FINAL_ROUNDS).found
    there = written(fit.written(), records.every)
    worst = np.inf if there is None else _worst(fit, there, None)
    return (records, fit, there, worst) if there is not None and worst <= UNEXPLAINED else None


class _Opened(eqx.Module):
    """Robots as they would be written, where the held-out positions are opened: `before` and `after` every effect, the
    last of these with what was fitted last; `there`: that one on positions that decide. `None` where one cannot be
    simulated."""

    before: tuple[Written | None, ...]
    after: tuple[Written | None, ...]
    there: Written | None


def _opened(found: Selection, judged: Measured, deciding: Measured) -> _Opened:
    end, steps = found.last.written(), found.steps
    before = [step.without for step in steps]
    after = [*(step.found.written() for step in steps[:-1]), end]
    played = _each_there([*((robot, judged) for robot in (*before, *after)), (end, deciding)])
    return _Opened(tuple(played[: len(before)]), tuple(played[len(before) : -1]), played[-1])


def _each_there(pairs: Sequence[tuple[Robot, Measured]]) -> list[Written | None]:
    """Each robot as it would be written on its record; the cores share them."""
    return shared(lambda pair: written(*pair), pairs, lapack_threads())


def _standing(found: Selection, opened: _Opened, judged: Measured) -> tuple[tuple[Step, ...], list[str]]:
    """Effects that stand, and what speaks against others."""
    steps, last = found.steps, found.last
    kept, refused = 0, []
    for count, (step, before, after) in enumerate(zip(steps, opened.before, opened.after, strict=False), 1):
        against = "it cannot be simulated there" if after is None else ""
        if before is None and after is not None:
            against = "the robot without it cannot be simulated there"
        if before is not None and after is not None:
            against = against_it(judged, before, after, step.key[1]) or holds_none(step.hypothesis, last)
        if against:
            refused.append((count, f"{said(step.key)} was taken back: {against}"))
        else:
            kept = count
    return tuple(steps[:kept]), [text for count, text in refused if count > kept]


def _verdict(
    base: Written,
    looked_for: bool,
    steps,
    effects,
    counts: Sequence[Named],
    last: Fitted,
    extended: Written,
    judged: Measured,
    worst: float,
    heldout: bool,
) -> tuple[str, str]:
    explained = compared(base.residual, extended.residual, base.evidence.plain, judged.frequency).gain
    met, rivals = relative_torque(judged, extended.residual), close_rivals(steps)
    sufficient = bool(np.all(met < TOLERANCE) and np.all(np.abs(last.x) < HOPELESS))
    stands = bool(effects or counts)
    alike = stand_for_each_other(effects) if worst > UNEXPLAINED else ()
    verdict = verdict_of(
        stands=stands,
        rivals=bool(rivals or alike),
        explained=explained if effects else 0.0,
        systematic=worst > UNEXPLAINED,
        met=sufficient,
    )
    stand_in = bool(effects) and worst > FAR_LEFT and bool(np.max(met) > MISSED)
    if stand_in:
        verdict = "unexplained"
    if stands and verdict != "unexplained":
        on = "the held-out positions" if heldout else "the fitted positions, none being held out"
        words = _named_words(effects, counts, rivals, base, extended, on)
        missed = relative_torque(judged, base.residual)
        return verdict, f"{words}{worse_words(last.robot.axis_names, missed, met)}{_left_words(alike, worst)}"
    why = "no effect explains more of the rest on the positions that decide"
    if not looked_for:
        why = "what is left is nowhere beyond its floor, so that no effect was looked for"
    return verdict, {
        "unexplained": (
            f"In one axis the misfit is {worst:.3g} times the floor's, everywhere or at one position, whatever the "
            "robot's numbers are, and no effect of the library mends that: something is missing that it does not hold. "
            f"The maps show where.{_nearest(effects) if stand_in else ''}"
        ),
        "sufficient": (
            f"Nothing is missing that these data show: the torque is met within {100 * met.max():.1f} % (rms, worst "
            f"axis), and {why}."
        ),
        "inconclusive": "No effect stands out, but the gap is not bounded below the tolerance either.",
    }[verdict]


def _nearest(effects: Sequence[Named]) -> str:
    names = " and ".join(f"{e.name.replace('_', ' ')} on {e.joint}" for e in effects)
    return f" The nearest that it holds is {names}: it stands for something else, or beside it."


def stand_for_each_other(effects: Sequence[Named]) -> tuple[Named, ...]:
    """Two of the effects that are on one joint and may be taken for each other; none where there are no such."""
    for one, other in itertools.combinations(effects, 2):
        alike = other.effect.name in one.effect.confusable or one.effect.name in other.effect.confusable
        if one.joint == other.joint and alike:
            return one, other
    return ()


def worse_words(names: Sequence[str], before: Float[np.ndarray, "axis"], after: Float[np.ndarray, "axis"]) -> str:
    """Axes that the written robot misses by more than the one before it."""
    told = [
        f" The torque of {name} is missed by {100 * a:.2g} % there, {100 * b:.2g} % before."
        for name, b, a in zip(names, before, after, strict=True)
        if a > WORSE * b
    ]
    return "".join(told)


def _left_words(alike: Sequence[Named], worst: float) -> str:
    """What is to be said of what the effects leave, beyond what an honest model does."""
    if worst <= UNEXPLAINED:
        return ""
    left = f"in one axis the misfit is still {worst:.3g} times the floor's: "
    if alike:
        one, other = (said((e.name, e.joint)) for e in alike)
        return (
            f" But {one} and {other} may stand for each other, and {left}what is missing may be one of them alone, "
            "or a law between them."
        )
    return f" I{left[1:]}something else is missing, too, which the intervals do not count."


def _named_words(
    effects, counts: Sequence[Named], rivals: Sequence[tuple[str, str]], base: Written, extended: Written, on: str
) -> str:
    names = lambda some: " and ".join(said((e.name, e.joint)).replace(" of ", " on ") for e in some)
    if rivals:
        others, text = ", ".join(said(key).replace(" of ", " on ") for key in rivals), names(effects)
        return f"{text[0].upper() + text[1:]} explains the gap; {others} does so nearly as well."
    before, after = (float(np.mean(np.abs(x.residual / base.evidence.plain) ** 2)) for x in (base, extended))
    left = 100 * float(np.clip(after / max(before, 1e-12), 0.0, 1.0))
    every = (*effects, *counts)
    missing, wrong = names(e for e in every if not e.is_number), names(e for e in every if e.is_number)
    texts = [f"Missing: {missing}."] if missing else []
    texts += [f"A number of the robot is wrong: {wrong}."] if wrong else []
    kind = "it" if len(every) == 1 else "them"
    if effects:
        texts.append(f"The robot that is written with {kind} leaves {left:.0f} % of the misfit on {on}.")
    if counts:
        texts.append("That encoders count so coarsely is seen in their readings, whatever torque is missed.")
    return " ".join(texts)


def close_rivals(steps: Sequence[Step]) -> list[tuple[str, str]]:
    """Fitted candidates that were hardly worse than the effect taken, but for those of its class and those named
    too."""
    named = {step.key for step in steps}
    return [
        rival.key
        for step in steps[:1]
        for rival in step.rivals
        if rival.near and rival.key not in named and not one_class(step.hypothesis.effect, step.key, rival.key)
    ]


def _with_effects(robot: Written, effects: Sequence[Named]) -> Written:
    """The same with effects that are seen in the readings and leave its residual as it is."""
    return Written(robot.robot.with_effects(*(x.effect for x in effects)), robot.evidence)


def _named(step: Step, last: Fitted, given: Robot) -> Named:
    effect, joint = step.hypothesis.effect_in(last), step.hypothesis.joint
    estimates = step.hypothesis.estimates(last)
    near = (r.key[0] for r in step.rivals if r.near and r.key[0] != effect.name)
    equivalent = tuple(dict.fromkeys([*effect.same_law, *near]))
    return Named(
        effect=effect,
        joint=joint,
        parameters={n: EstimatedValue(float(v), float(s), _unit(effect, n)) for n, (v, s) in estimates.items()}
        or stated_waves(effect),
        p_value=step.on_select.p_value,
        equivalent=equivalent,
        separating_experiment="; ".join(f"{o}: {how}" for o, how in effect.confusable.items() if o in equivalent),
        explains=float(np.clip(step.on_select.gain, 0.0, 1.0)),
        visible=visible_size(effect, given, joint) or step.scored.size,
        is_number=step.hypothesis.is_number,
    )


def _unit(effect: AbstractEffect, name: str) -> str:
    """Of a parameter, or of one entry of it: `amplitude_2`."""
    return effect.units.get(name) or effect.units[name.rpartition("_")[0]]


def counting(record: Measured, robot: Robot) -> tuple[Named, ...]:
    """Encoders that count so coarsely that it shows, seen in the readings themselves, but for those that the robot
    states."""
    data, found = record.data, []
    if data.y_quantity != "position":
        return ()
    kinds = [kind for kind in library().values() if kind.of_readings(0, 1.0) is not None]
    stated = {axis_of(robot, e.joint) for e in robot.effects if type(e) in kinds}
    for axis, joint in enumerate(robot.axis_names):
        count = 0.0 if axis in stated else resolution(np.asarray(data.y[0, :, :, axis]), 0.0)
        for kind in kinds:
            effect = kind.of_readings(joint, count)
            visible = 0.0 if effect is None else visible_size(effect, robot, joint)
            if effect is not None and visible >= LEAST_SIZE:
                value = {next(iter(kind.units)): EstimatedValue(count, 1e-3 * count, "rad")}
                found.append(Named(effect, joint, value, 0.0, (), "", 1.0, visible))
    return tuple(found)


def redefined(steps: Sequence[Step], given: Robot) -> set[str]:
    """Numbers of the robot that mean something else beside the effects that were found."""
    return {name for step in steps for name in step.hypothesis.effect.redefines(given)}


def wrong_numbers(last: Fitted, but: Collection[str] = ()) -> tuple[WrongNumber, ...]:
    """Numbers that are further off than their tolerance, by the record: those that stand out among all numbers, by
    their p-value or beside the others, and those that the data tell. `but`: these are not looked at."""
    data_share, out_of_tolerance = last.iterate.posterior.data_share, last.out_of_tolerance
    p_values = last.tolerance_p_values
    skipped = {*but, *dict(last.unknown.stated)}  # the latter are effects' own, or set free with one
    sure = lambda n, i: n.prior > 0 and n.kind != "smoothing" and n.positive and data_share[i] > DATA_SHARE
    told = lambda n, i: sure(n, i) or p_values[i] < OUT_OF_TOLERANCE
    apart = lambda n, x: abs(n.value(x) - n.given) > INTERVAL * last.deviation(n.name)  # as its interval says
    return tuple(
        WrongNumber(
            name=n.name,
            value=n.value(x),
            std=last.deviation(n.name),
            unit=n.unit,
            given=n.given,
            change=_change(n, x),
            p_value=float(p_values[i]),
        )
        for i, (n, x) in enumerate(zip(last.numbers, map(float, last.x), strict=True))
        if n.name not in skipped and (i in out_of_tolerance or (told(n, i) and abs(x) > OFF)) and apart(n, x)
    )


def _change(number: Number, x: float) -> str:
    if number.positive:
        return f"{100 * (number.value(x) / number.given - 1.0):+.0f} %"
    change = number.value(x) - number.given
    return f"{100 * change:+.0f} %" if number.unit == "1" else f"{change:+.2g} {number.unit}"


def _wrong_numbers(wrong: Sequence[WrongNumber], given: Robot) -> str:
    if not wrong:
        return ""
    chance = lambda p: f"p = {p:.2g}" if p < LEVEL else "as one of so many may be"
    changes = [f"{number.name} by {number.change} ({chance(number.p_value)})" for number in wrong]
    questions = "".join(f" {text}" for text in untold({number.name for number in wrong}, given))
    return f" Numbers of the robot that are off by more than is known of them: {', '.join(changes)}.{questions}"


def untold(wrong: Collection[str], robot: Robot) -> list[str]:
    """What to ask where these numbers are wrong: what somebody may have forgotten to state."""
    kinds = [kind for kind in library().values() if kind.untold]
    own = lambda kind: {n.number for n in kind.typical(robot, "").own_numbers(robot)}
    return [kind.untold for kind in kinds if own(kind) & set(wrong)]


def next_experiment(verdict: str, effects: Sequence[Named]) -> str:
    if verdict == "ambiguous":
        how = [e.separating_experiment for e in effects if e.separating_experiment]
        if how:
            return "To separate them: " + "; ".join(how) + "."
        return (
            "Measure at another amplitude of the slow motion and with another payload, and diagnose the files together."
        )
    if verdict == "named":
        kinds = library()
        how = [
            f"{other}: {what}"
            for e in effects
            for other, what in (kinds[e.name].confusable.items() if e.name in kinds else ())
        ]
        text = "Measure once more at another amplitude or payload, and see the gap stay closed"
        return f"{text}. What could look alike: {'; '.join(how)}." if how else f"{text}."
    if verdict == "unexplained":
        return (
            "Repeat the experiment at another amplitude of the slow motion and with another payload: how the map "
            "changes tells friction from springs and drives. Then write the effect as a class of your own (--effects)."
        )
    if verdict == "inconclusive":
        return "More experiments at these positions, or a larger excitation, would bound the gap."
    return "None needed for this model at these amplitudes."
