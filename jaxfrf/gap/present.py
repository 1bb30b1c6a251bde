"""From a search to what a person reads: verdict, effects, where, gap, maps."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.fft

from ..effects import library
from ..experiment import Experiment
from ..frf import LRM
from ..graybox.indirect import default_method, measured_frf
from ..robot import Robot, parameter_unit, parameters
from ..trajectory.evidence import band_edges, by_band, weigh
from ..trajectory.remainder import remainder
from ..trajectory.signature import signature
from .refine import refine
from .result import Cell, Diagnosis, EstimatedValue, Gap, Maps, Named, Ranked
from .score import deviations, family_wise, fit_beside
from .search import CLASSES, FLOOR, Search, Step, passes
from .stage import Stage, mean_square
from .trial import Fitted, corrected, usual_misfit, with_effect
from .verify import Verified, Written, judged_positions, relative_torque, verified, written

_BINS = 24
_FAR_OFF, _UNEXPLAINED = 2.0, 0.25  # misfit, and part of the reducible one, that must not be left
_TOLERANCE = 0.06  # of the torque: half a decibel
_SHOWN = 12
_AT_MOST = 0.9  # of the gap is floor: a steady torque alone hardly lifts the rms of all lines


def present(search: Search, compared: str) -> Diagnosis:
    """The result of a search: of the robots that would be written, judged on the sealed positions."""
    stands = verified(search)
    verdict, says, effects, extended = _verdict(search, stands)
    gap = _gap(search, stands.base, extended)
    last = stands.steps[-1].stage if extended is not stands.base else search.base
    values, changed = _parameters(search, last, extended.robot)
    maps = _maps(search, stands.base, extended)
    sealed = np.flatnonzero(~search.opened)
    return Diagnosis(
        verdict=verdict,
        says=says,
        effects=effects,
        ranking=_ranking(search, stands),
        where=_where(search, maps),
        gap=gap,
        maps=maps,
        parameters=values,
        changed=changed,
        given=search.given,
        base=stands.base.robot,
        extended=extended.robot,
        compared=compared,
        fitted=tuple(int(i) for i in np.flatnonzero(search.opened)),
        sealed=tuple(int(i) for i in sealed),
        frf=_responses(search, (stands.base, extended), sealed) if len(sealed) else None,
        next_experiment=_next(verdict, effects, search),
        sources=tuple(search.record.data.sources),
        settings={"lines": len(search.record.frequency), "highest_hz": float(search.record.frequency[-1])},
    )


def _verdict(search: Search, stands: Verified):
    """Verdict, a sentence or two, the effects that are named, and the robot that has them."""
    before, steps = search.base.misfit, stands.steps
    taken_back = "".join(f" {text[0].upper() + text[1:]}." for text in stands.refused)
    if not steps:
        counted = _counting(search)
        if counted:
            names = ", ".join(f"{n.effect.name} on {n.joint}" for n in counted)
            return "named", f"The readings move in whole counts: {names}.", counted, stands.base
        if before > _FAR_OFF:
            return "unexplained", _tell_unexplained(search, 1.0) + taken_back, (), stands.base
        relative = relative_torque(search, stands.base.residual, np.ones_like(search.opened))
        if np.all(relative < _TOLERANCE):
            says = (
                f"Nothing is missing that these data show: the torque is met within {100 * relative.max():.1f} % (rms, "
                "worst axis)"
            )
            return "sufficient", f"{says}, and {_nothing_more(search)}.{taken_back}", (), stands.base
        says = "No effect stands out, but the gap is not bounded below the tolerance either."
        return "inconclusive", says + taken_back, (), stands.base
    left = _part_left(search, steps[-1].stage)
    if steps[-1].stage.misfit > _FAR_OFF and left > _UNEXPLAINED:
        return "unexplained", _tell_unexplained(search, left) + taken_back, (), stands.base
    effects = tuple(_named(search, steps, step) for step in steps) + _counting(search)
    names = " and ".join(f"{e.name.replace('_', ' ')}" + (f" on {e.joint}" if e.joint else "") for e in effects)
    rivals = _close_rivals(steps, steps[0])
    if rivals:
        others = ", ".join(f"{k[0].replace('_', ' ')} on {k[1]}" for k in rivals)
        says = f"{names[0].upper() + names[1:]} explains the gap; {others} does so nearly as well."
        return "ambiguous", says + taken_back, effects, stands.extended
    part = 100 * (1 - max(left, 0.0))
    says = f"Missing: {names}. It explains {part:.0f} % of what the refitted model left above the floor."
    return "named", says + taken_back, effects, stands.extended


def _nothing_more(search: Search) -> str:
    if search.scored:
        return "no effect explains more of the rest than chance"
    return "what is left is nowhere beyond its floor, so that no effect was looked for"


def _part_left(search: Search, last: Stage) -> float:
    """Of what the base leaves above its floor."""
    least = float(np.mean((search.base.evidence.plain / search.base.evidence.floor) ** 2))
    usual = [usual_misfit(stage, search.base) - least for stage in (search.base, last)]
    return usual[1] / max(usual[0], 1e-9)


def _tell_unexplained(search: Search, left: float) -> str:
    return (
        f"The misfit is {search.base.misfit:.3g} times the floor's, and the best effects leave {100 * left:.0f} % of "
        "it: something is missing that the library does not hold. The maps show where."
    )


def _close_rivals(steps: Sequence[Step], step: Step) -> list[tuple[str, str]]:
    """Options that were hardly worse than the one taken, but for its own class and what is named besides."""
    named = {other.option.key for other in steps}

    def one_class(key):
        return key[1] == step.option.key[1] and any({step.effect.name, key[0]} <= c for c in CLASSES)

    keys = [rival.option.key for rival in step.rivals if rival.near]
    return [key for key in keys if key not in named and not one_class(key)]


def _equivalent(steps: Sequence[Step], step: Step) -> tuple[str, ...]:
    names = [n for c in CLASSES if step.effect.name in c for n in sorted(c - {step.effect.name})]
    return tuple(dict.fromkeys(names + [k[0] for k in _close_rivals(steps, step) if k[0] != step.effect.name]))


def _named(search: Search, steps: Sequence[Step], step: Step) -> Named:
    effect, runs = step.effect, int(np.sum(search.base.fit.runs))
    first = step.option.scored
    equivalent = _equivalent(steps, step)
    confusable = [f"{other}: {how}" for other, how in effect.confusable.items() if other in equivalent]
    return Named(
        effect=effect,
        joint=step.option.key[1],
        parameters=_effect_parameters(step),
        p_value=family_wise(first.part, first.found.t, runs, len(search.scored)),
        equivalent=equivalent,
        separating_experiment="; ".join(confusable),
        explains=float(np.clip((step.before - step.after) / max(step.before, 1e-9), 0, 1)),
        visible=first.size,
    )


def _effect_parameters(step: Step) -> dict[str, EstimatedValue]:
    effect, names = step.effect, step.option.refined.names
    if names:
        return {
            n: EstimatedValue(float(getattr(effect, n)), float(s), effect.units[n])
            for n, s in zip(names, step.std, strict=True)
        }
    found = {}
    for name, unit in effect.units.items():
        value = (
            np.ravel(np.asarray(getattr(effect, name), float)) if getattr(effect, name) is not None else np.array([])
        )
        for i, v in enumerate(value):
            found[name if len(value) == 1 else f"{name}_{i + 1}"] = EstimatedValue(float(v), float("nan"), unit)
    return found


def _counting(search: Search) -> tuple[Named, ...]:
    """Encoders that count, seen in the readings themselves."""
    from ..effects import EncoderQuantisation
    from .quantised import resolution

    data = search.record.data
    if data.y_quantity != "position":
        return ()
    found = []
    for axis, joint in enumerate(search.given.axis_names):
        count = resolution(np.asarray(data.y[0, :, :, axis]), 0.0)
        if count > 0:
            effect = EncoderQuantisation(joint, count)
            visible = count / float(EncoderQuantisation.typical(search.given, joint).resolution)
            value = {"resolution": EstimatedValue(count, 1e-3 * count, "rad")}
            found.append(Named(effect, joint, value, 0.0, (), "", 1.0, visible))
    return tuple(found)


def _ranking(search: Search, stands: Verified) -> tuple[Ranked, ...]:
    seen, found = set(), []
    runs = int(np.sum(search.base.fit.runs))
    taken = {step.option.key: i for i, step in enumerate(stands.steps)}
    taken_back = {step.option.key for step in search.steps[len(stands.steps) :]}
    simulated = {
        r.option.key: f"simulated: leaves {r.misfit / s.before:.0%}, the one taken {s.after / s.before:.0%}"
        for s in search.steps
        for r in s.rivals
        if r.misfit is not None
    }
    for scored in search.scored:
        if scored.candidate.key in seen:
            continue
        seen.add(scored.candidate.key)
        effect = scored.effect()
        first = next(iter(effect.units))
        expected = {first: float(np.ravel(np.asarray(getattr(effect, first)))[0])}
        if scored.candidate.key in taken:
            why = "taken" if taken[scored.candidate.key] == 0 else "taken after the first"
        elif scored.candidate.key in taken_back:
            why = "taken back: the held-out positions speak against it"
        elif scored.candidate.key in simulated:
            why = simulated[scored.candidate.key]
        elif scored.size < 0.5:
            why = f"{scored.size:.2g} of what is visible"
        elif passes(scored, len(search.scored), runs):
            why = "explains less than the one taken"
        else:
            why = "explains too little"
        p = family_wise(scored.part, scored.found.t, runs, len(search.scored))
        found.append(Ranked(*scored.candidate.key, scored.part, p, expected, scored.size, why))
        if len(found) == _SHOWN:
            break
    return tuple(found)


def _gap(search: Search, base: Written, extended: Written) -> Gap:
    return _gap_between(search, base.residual, extended.residual, extended.evidence.plain)


def _gap_between(search: Search, before, after, floor) -> Gap:
    where = judged_positions(search)
    b, a = (np.sqrt(mean_square(x[where] / floor)) for x in (before, after))
    low = min(np.sqrt(FLOOR), _AT_MOST * b)
    shrink = float(np.clip(1.0 - (a - low) / (b - low), -9.0, 1.0))
    on = "held-out positions" if not search.opened.all() else "the fitted positions (none were held out)"
    torque = (relative_torque(search, x, where) for x in (before, after))
    return Gap(float(b), float(a), float(low), shrink, "1", on, *torque)


def shrink_with(search: Search, effects) -> float | None:
    """Shrink of the gap on the sealed positions with these effects instead, fitted from these values and simulated,
    from the robot as it was given."""
    end = _end_with(search, search.views[-1], effects)
    if end is None:
        return None
    stage, fitted = end
    return _gap(search, written(search.setting, search.base, ()), written(search.setting, stage, fitted)).shrink


def _end_with(search: Search, stage: Stage, effects) -> tuple[Stage, list] | None:
    """The last stage and the effects with their fitted parameters."""
    before = []
    for effect in effects:
        first = with_effect(search.setting, stage, effect, before)
        if first is None:
            return None
        fitted = corrected(search.setting, Fitted(effect, (), first), stage, _visible_of(effect), before)
        stage = fitted.stage
        before.append(fitted.effect)
    return stage, before


def linear_shrink(search: Search, effects) -> float:
    """As `shrink_with`, to first order in the effects, without a simulation."""
    stage = search.base
    found = [refine(stage, effect, _visible_of(effect)).effect for effect in effects]
    weighed = weigh(stage.evidence, [lambda s: sum(signature(e, s) for e in found)], stage.weighed)
    row = stage.weighed.gram.b.shape[1]
    columns = stage.fit.columns
    x = fit_beside(weighed.gram, stage.fit, row).x
    left = remainder(stage.evidence, weighed, np.append(x, 1.0), np.append(columns, row))
    base = written(search.setting, stage, ())
    after = base.residual + left - stage.left
    return _gap_between(search, base.residual, after, stage.evidence.plain).shrink


def _visible_of(effect) -> float:
    value = np.ravel(np.asarray(getattr(effect, next(iter(effect.units)))))
    return float(np.max(np.abs(value)))


def _parameters(search: Search, stage: Stage, robot: Robot):
    """Stiffnesses and dampings of the robot that is written, with their standard deviations from its stage."""
    std = deviations(stage.weighed.gram, stage.fit)
    own, given = parameters(robot), parameters(search.given)
    values, changed = {}, {}
    for i, knob in enumerate(search.knobs):
        if knob.free:
            value = float(own[knob.name])
            values[knob.name] = EstimatedValue(
                value, value * float(std[i]), parameter_unit(robot, *knob.name.rsplit(".", 1))
            )
            changed[knob.name] = value / float(given[knob.name]) - 1.0
    return values, changed


def _maps(search: Search, base: Written, extended: Written) -> Maps:
    frequency, floor = search.record.frequency, search.base.evidence.plain
    rms = lambda left: np.sqrt(np.mean(by_band(left, floor, frequency), axis=1))
    before = rms(base.residual)
    after = before if extended is base else rms(extended.residual)
    return Maps(before, after, band_edges(frequency), _courses(search, base.residual, extended.residual))


def _courses(search: Search, base, after):
    scenes = search.base.evidence.scenes
    count = 1024
    some = np.round(np.arange(count) * scenes[0].period / count).astype(int)
    back = lambda X: scipy.fft.irfft(np.swapaxes(X, 1, 2), n=count, axis=2) * count
    signals = {"speed": [], "angle": [], "load": []}
    for scene in scenes:
        signals["speed"].append(scene.speed[:, some])
        signals["load"].append(scene.load[:, some])
        signals["angle"].append(scene.angle[:, some] / scene.gear)
    courses = [np.concatenate([np.moveaxis(back(x[p]), 1, 2) for p in range(len(x))]) for x in (base, after)]
    result = {}
    for name, signal in signals.items():
        x = np.concatenate(signal)
        rows = [_binned(x[..., a], [c[..., a] for c in courses]) for a in range(x.shape[-1])]
        result[name] = tuple(np.stack([row[i] for row in rows]) for i in range(3))
    return result


def _binned(x, courses):
    edges = np.quantile(x, np.linspace(0, 1, _BINS + 1))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    number = np.maximum(np.bincount(place.ravel(), minlength=_BINS), 1)
    mean = lambda y: np.bincount(place.ravel(), y.ravel(), _BINS) / number
    return mean(x), mean(courses[0]), mean(courses[1])


def _where(search: Search, maps: Maps) -> tuple[Cell, ...]:
    """The largest cells, those that hold at all positions as one."""
    names = search.given.axis_names
    overall = np.median(maps.before, axis=0)
    cells = []
    for axis, band in np.argwhere(overall > 2.0):
        lo, hi = float(maps.bands[band]), float(maps.bands[band + 1])
        z = float(overall[axis, band])
        says = f"torque of {names[axis]}, {lo:g}-{hi:g} Hz, at all positions: {z:.3g} times the floor"
        cells.append(Cell(None, names[axis], (lo, hi), z, says))
    for pos, axis, band in np.argwhere((maps.before > 3.0) & (maps.before > 2.0 * overall)):
        lo, hi = float(maps.bands[band]), float(maps.bands[band + 1])
        z = float(maps.before[pos, axis, band])
        says = f"torque of {names[axis]}, {lo:g}-{hi:g} Hz, at position {pos}: {z:.3g} times the floor"
        cells.append(Cell(int(pos), names[axis], (lo, hi), z, says))
    return tuple(sorted(cells, key=lambda c: -c.z)[:8])


def _responses(search: Search, models: Sequence[Written], sealed):
    """FRFs of measurement, base and extended model, estimated alike."""
    data = search.record.at(sealed).data
    method = LRM() if data.r is None else default_method()
    found = [measured_frf(data, method, "acceleration")]
    for model in models:
        found.append(measured_frf(_played(data, model, sealed), method, "acceleration"))
    return tuple(found)


def _played(data: Experiment, model: Written, sealed) -> Experiment:
    scenes = [model.evidence.scenes[i] for i in sealed]
    first = data.transient_periods * data.period
    return dataclasses.replace(
        data,
        u=np.stack([s.u for s in scenes]),
        y=np.stack([s.y for s in scenes]),
        r=None if data.r is None else np.asarray(data.r)[:, :, first : first + data.period],
        y_quantity="position",
        transient_periods=0,
    )


def _next(verdict: str, effects, search: Search) -> str:
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
