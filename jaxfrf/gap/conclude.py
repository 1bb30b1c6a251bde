"""What stands of a contest once the sealed positions are opened: verdict, words, effects, and the robot to write."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from ..effects import EncoderQuantisation, TorqueRipple, library
from ..robot import Robot
from ..trajectory.measured import Measured
from ..trajectory.ripple import ripple_effects
from .contest import Contest, Records, Step, incredible, said
from .fitted import Fitted
from .judge import Written, over_floor, relative_torque, written
from .quantised import resolution
from .result import Estimate, Named
from .settings import (
    EXPLAINED,
    FLOOR,
    GAINS,
    HOPELESS,
    LEAST_SIZE,
    OFF,
    PRICE,
    RISES,
    TOLD,
    TOLERANCE,
    UNEXPLAINED,
)

ONE_LAW = (frozenset(("counterbalance", "dress_pack")),)  # told apart by the joint they are on, not by data
ONE_CLASS = (*ONE_LAW, frozenset(("torque_delay", "current_loop_lag")))  # equivalent, where data do not tell them apart


class Conclusion(eqx.Module):
    """What is said. `base`, `extended`: robots that are written, without and with the effects that stand."""

    verdict: str = eqx.field(static=True)
    says: str = eqx.field(static=True)
    effects: tuple[Named, ...]
    base: Written
    extended: Written
    last: Fitted
    steps: tuple[Step, ...]


def concluded(found: Contest, records: Records, given: Robot) -> Conclusion:
    """The verdict: effects stand as far as the robot written with each makes the gap on the sealed positions smaller
    than that of the one before."""
    steps, refused = _standing(found, records)
    last = steps[-1].found if steps else found.base
    louder, extended = _with_loud_ripple(found, steps, last, records)
    counts = _counting(records.whole, given)
    effects = (*(_named(step, last, given) for step in steps), *louder, *counts)
    taken_back = "".join(f" {text[0].upper() + text[1:]}." for text in (*refused, found.refused) if text)
    base = steps[0].without if steps else found.written
    extended = base if extended is found.written else extended
    verdict, says = _verdict(base, found.refused, steps, effects, last, extended, records)
    if verdict == "unexplained":
        effects, base, extended, steps = (), found.written, found.written, ()
    if verdict not in ("named", "ambiguous"):
        says += taken_back
    return Conclusion(verdict, says + _wrong_numbers(last), effects, base, extended, last, steps)


def _standing(found: Contest, records: Records) -> tuple[tuple[Step, ...], list[str]]:
    before, kept, refused = found.written, 0, []
    for count, step in enumerate(found.steps, 1):
        against = against_it(records, step.without if step.is_number else before, step.written, step.key[1])
        if against:
            refused.append((count, f"{said(step.key)} was taken back: {against}"))
        else:
            kept, before = count, step.written
    return found.steps[:kept], [text for count, text in refused if count > kept]


def against_it(records: Records, before: Written, after: Written, joint: str) -> str:
    """What the sealed positions say against an effect on this joint, "" for all of them; empty where nothing."""
    where, floor, names = records.judged, before.evidence.plain, before.robot.axis_names
    old, new = (over_floor(x.residual, floor, where) for x in (before, after))
    rms = lambda x: float(np.sqrt(np.mean(x**2)))
    if rms(new) > GAINS * rms(old) and rms(new) > FLOOR / 2:
        return f"with it the gap is {rms(new):.3g} times the floor, {rms(old):.3g} without"
    rise, gain = np.maximum(new**2 - np.maximum(old**2, FLOOR), 0.0), np.maximum(old**2 - new**2, 0.0)
    worst = int(np.argmax(rise))
    if np.sum(rise) > PRICE * np.sum(gain):
        return f"with it the gap of {names[worst]} rises from {old[worst]:.3g} to {new[worst]:.3g} times the floor"
    if joint not in names:
        return ""
    own = names.index(joint)
    missed = tuple(relative_torque(records.whole, x.residual, where)[own] for x in (before, after))
    if new[own] > max(old[own], FLOOR) or (missed[1] > RISES * missed[0] and new[own] > FLOOR / 2):
        return f"with it the torque of {joint} itself is missed by {missed[1]:.2%}, by {missed[0]:.2%} without"
    return ""


def _verdict(
    base: Written, refused: str, steps, effects, last: Fitted, extended: Written, records: Records
) -> tuple[str, str]:
    floor, where = base.evidence.plain, records.judged
    misfit = lambda x: 0.5 * float(np.mean(np.abs(x.residual[where] / floor) ** 2))
    before, after, most = misfit(base), misfit(extended), last.excess(records.fitted)
    if last.of_worst_axis > UNEXPLAINED and (not effects or after - FLOOR > (1 - EXPLAINED) * (before - FLOOR)):
        return "unexplained", (
            f"In one axis the misfit is {last.of_worst_axis:.3g} times the floor's, whatever the robot's numbers are, "
            "and no effect of the library mends that: something is missing that it does not hold. The maps show where."
        )
    if effects:
        on = "the sealed positions" if len(records.sealed) else "the fitted positions, none being sealed"
        return _told(steps, effects, before, after, on)
    met = relative_torque(records.whole, extended.residual, where)
    looked = "no effect explains more of the rest on positions that chose nothing"
    if most <= FLOOR and not refused:
        looked = "what is left is nowhere beyond its floor, so that no effect was looked for"
    if np.all(met < TOLERANCE) and not incredible(last, HOPELESS):
        return "sufficient", (
            f"Nothing is missing that these data show: the torque is met within {100 * met.max():.1f} % (rms, worst "
            f"axis), and {looked}."
        )
    return "inconclusive", "No effect stands out, but the gap is not bounded below the tolerance either."


def _told(steps: Sequence[Step], effects, before: float, after: float, on: str) -> tuple[str, str]:
    names = lambda some: " and ".join(said((e.name, e.joint)).replace(" of ", " on ") for e in some)
    rivals = close_rivals(steps)
    if rivals:
        others, text = ", ".join(said(key).replace(" of ", " on ") for key in rivals), names(effects)
        return "ambiguous", f"{text[0].upper() + text[1:]} explains the gap; {others} does so nearly as well."
    left = 100 * float(np.clip(after / max(before, 1e-12), 0.0, 1.0))
    missing, wrong = names(e for e in effects if not e.is_number), names(e for e in effects if e.is_number)
    texts = [f"Missing: {missing}."] if missing else []
    texts += [f"A number of the robot is wrong: {wrong}."] if wrong else []
    kind = "it" if len(effects) == 1 else "them"
    texts.append(f"The robot that is written with {kind} leaves {left:.0f} % of the misfit on {on}.")
    return "named", " ".join(texts)


def close_rivals(steps: Sequence[Step]) -> list[tuple[str, str]]:
    """Fitted candidates that were hardly worse than the effect taken, but for those of its law and those named too."""
    named = {step.key for step in steps}
    return [
        rival.key
        for step in steps[:1]
        for rival in step.rivals
        if rival.near and rival.key not in named and not _one_class(step.key, rival.key)
    ]


def _one_class(one, other) -> bool:
    return one[1] == other[1] and any({one[0], other[0]} <= names for names in ONE_CLASS)


def _named(step: Step, last: Fitted, given: Robot) -> Named:
    effect, joint = step.hypothesis.effect_in(last), step.hypothesis.joint
    told = step.hypothesis.told(last)
    equivalent = [n for law in ONE_LAW if effect.name in law for n in sorted(law - {effect.name})]
    equivalent += [r.key[0] for r in step.rivals if r.near and r.key[0] != effect.name]
    equivalent = tuple(dict.fromkeys(equivalent))
    return Named(
        effect=effect,
        joint=joint,
        parameters={n: Estimate(float(v), float(s), effect.units[n]) for n, (v, s) in told.items()} or _waves(effect),
        p_value=step.on_select.p_value,
        equivalent=equivalent,
        separating_experiment="; ".join(f"{o}: {how}" for o, how in effect.confusable.items() if o in equivalent),
        explains=float(np.clip(step.on_select.gain, 0.0, 1.0)),
        visible=_visible(effect, given, joint) or step.scored.size,
        is_number=step.is_number,
    )


def _visible(effect, robot: Robot, joint: str) -> float:
    """Size over the just visible one, by the first parameter; 0 where that says nothing."""
    first = next(iter(effect.units))
    try:
        typical = np.asarray(getattr(type(effect).typical(robot, joint), first), float)
    except ValueError:
        return 0.0
    value = np.asarray(getattr(effect, first), float)
    if (
        typical.size != 1
        or value.size != 1
        or not typical
        or effect.name in ("stiffness_hardening", "torque_saturation")
    ):
        return 0.0
    return float(abs(value.item() / typical.item()))


def _with_loud_ripple(found: Contest, steps, last: Fitted, records: Records) -> tuple[tuple[Named, ...], Written]:
    """Ripple that is more than motors have, where the sealed positions agree, and the robot that has it, too."""
    now = steps[-1].written if steps else found.written
    loud = [(o, w) for o, w in last.waves() if np.hypot(*w) > o.loud(last.robot)]
    if not loud:
        return (), now
    louder = now if steps else written(last.written(), records.whole)
    names = last.robot.axis_names
    effects = ripple_effects(names, [o for o, _ in loud], np.array([w for _, w in loud]))
    beyond = over_floor(found.written.residual, found.written.evidence.plain, records.judged) > FLOOR
    effects = [e for e in effects if beyond[names.index(e.joint)] and _loudness(e, last.robot) >= LEAST_SIZE]
    if not effects:  # what nobody misses is written with the robot, and not named
        return (), now
    if louder is None or (not steps and any(against_it(records, found.written, louder, e.joint) for e in effects)):
        return (), now
    return tuple(_ripple(effect, last) for effect in effects), louder


def _waves(effect) -> dict[str, Estimate]:
    """Amplitudes, orders and phases of ripple, whose intervals are not known."""
    values = {}
    for name in ("amplitude", "teeth", "order", "phase"):
        row = np.ravel(np.asarray(getattr(effect, name, []), float))
        for i, value in enumerate(row):
            place = name if len(row) == 1 else f"{name}_{i + 1}"
            values[place] = Estimate(float(value), float("nan"), effect.units[name])
    return values


def _loudness(effect, robot: Robot) -> float:
    """Largest amplitude over the just visible one."""
    typical = type(effect).typical(robot, effect.joint)
    return float(np.max(np.asarray(effect.amplitude)) / np.max(np.asarray(typical.amplitude)))


def _ripple(effect, last: Fitted) -> Named:
    visible = _loudness(effect, last.robot)
    kind = "torque" if isinstance(effect, TorqueRipple) else "resolver"
    p_value = last.wave_p_value(kind, last.robot.axis_names.index(effect.joint))
    return Named(effect, effect.joint, _waves(effect), p_value, (), "", 1.0, visible)


def _counting(record: Measured, robot: Robot) -> tuple[Named, ...]:
    """Encoders that count, seen in the readings themselves."""
    data, found = record.data, []
    if data.y_quantity != "position":
        return ()
    for axis, joint in enumerate(robot.axis_names):
        count = resolution(np.asarray(data.y[0, :, :, axis]), 0.0)
        if count > 0:
            visible = count / float(EncoderQuantisation.typical(robot, joint).resolution)
            value = {"resolution": Estimate(count, 1e-3 * count, "rad")}
            found.append(Named(EncoderQuantisation(joint, count), joint, value, 0.0, (), "", 1.0, visible))
    return tuple(found)


def wrong_numbers(last: Fitted) -> list[tuple[str, float]]:
    """Numbers that are further off than their tolerance, by the record, with their relative change."""
    told = last.look.posterior.told
    return [
        (n.name, n.value(float(x)) / n.given - 1.0)
        for n, x, part in zip(last.these, last.x, told, strict=False)
        if n.prior > 0 and n.kind != "smoothing" and n.positive and abs(x) > OFF and part > TOLD
    ]


def _wrong_numbers(last: Fitted) -> str:
    wrong = wrong_numbers(last)
    if not wrong:
        return ""
    changes = [f"{name} by {100 * change:+.0f} %" for name, change in wrong]
    return f" Numbers of the robot that are off by more than is known of them: {', '.join(changes)}."


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
