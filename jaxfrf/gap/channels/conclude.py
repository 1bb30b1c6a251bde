"""From a search to a `jaxfrf.gap.Diagnosis`: verdict, effects with intervals, gap on held-out data, maps and words."""

import itertools
from collections.abc import Sequence

import numpy as np
import scipy.stats

from ...effects import AbstractEffect, Candidate
from ...robot import Robot, parameter_unit, parameters
from ...robot.parameters import unit_at
from ..result import Cell, Diagnosis, EstimatedValue, Gap, Maps, Named, Ranked
from ..settings import BANDS, CONFIDENCE, DRAWS, EXPLAINED, LEAST_SHARE, LEVEL, REFITTED, SYSTEMATIC
from ..significance import family_wise, mean_squares, projector, summed
from ..verdict import verdict_of
from .channel import AbstractChannel, Outcome, State
from .select import ChannelSelection, FittedState, TriedCandidate, search, spread


def concluded(
    channel: AbstractChannel,
    heldout: AbstractChannel | None,
    kinds: Sequence[type[AbstractEffect]],
    sources: tuple,
) -> Diagnosis:
    """Search a channel, open the held-out data once, and say what was found."""
    found = search(channel, kinds)
    gap = _judged(channel, heldout, found)
    verdict = _verdict(channel, found, gap if heldout is not None else None)
    final = found.base if verdict == "unexplained" else found.fitted
    if final is found.base:
        gap = _judged(channel, heldout, _nothing(found))
    named, own = _reported(channel, final, found)
    outcome = Outcome(
        found.base.state, final.state, found.base.residual, final.residual, found.trials, _test(channel, final)
    )
    ranking = tuple(_ranked(t) for t in found.trials)
    maps = _maps(channel, final, found, gap.floor)
    begun = _numbers(channel, own)
    remarks = (*_refit_remark(channel, found, final), *_wrong_signs(found), *channel.remarks(outcome))
    diagnosis = Diagnosis(
        verdict=verdict,
        says=_says(channel, verdict, named, gap, ranking),
        effects=named,
        ranking=ranking,
        where=channel.where(outcome, _cells(channel, maps)),
        gap=gap,
        maps=maps,
        parameters=own,
        changed={n: x.value / begun[n] - 1.0 if begun[n] else float("nan") for n, x in own.items()},
        given=channel.robot,
        base=found.base.state.robot(),
        extended=final.state.robot(),
        compared=channel.compared,
        fitted=tuple(range(len(channel.spectra(channel.measured)))),
        heldout=(),
        frf=None,
        next_experiment="; ".join(x.separating_experiment for x in named if x.separating_experiment),
        sources=sources,
        settings={"remarks": list(remarks), "left_out": found.left_out, "alone": _alone(channel, found, final)},
    )
    return channel.joined(diagnosis)


def _nothing(found: ChannelSelection) -> ChannelSelection:
    return ChannelSelection(
        found.base, found.base, (), found.trials, found.refused, found.last_p, found.floor, found.left_out
    )


def _verdict(channel: AbstractChannel, found: ChannelSelection, heldout: Gap | None) -> str:
    before, after = np.mean(found.base.left**2), np.mean(found.fitted.left**2)
    floor = float(np.mean(found.floor**2))
    if found.found:
        explained = (before - after) / (before - floor) if before > floor else 1.0
        grows = heldout is not None and heldout.after >= heldout.before
        rivals = any(x.ambiguous for x in found.found)
        share = 0.0 if grows else float(explained)
        return verdict_of(stands=True, rivals=rivals, explained=share, systematic=True, met=False)
    met = found.last_p > LEVEL and _upper(channel, found.base) < channel.tolerance
    best = max((t.share for t in found.refused), default=0.0)
    predicted = 1.0 - floor / max(before, 1e-300)
    shows = found.last_p <= LEVEL and predicted > SYSTEMATIC and best < EXPLAINED
    systematic = not met and (predicted > EXPLAINED or shows)
    return verdict_of(stands=False, rivals=False, explained=0.0, systematic=systematic, met=met)


def _upper(channel: AbstractChannel, fit: FittedState) -> float:
    """95 % bound of the rms held-out error, in the gap's unit."""
    squares = mean_squares(channel.plain(fit.left), channel.blocks(fit.residual))
    n = len(squares)
    return float(np.sqrt(squares.mean() + scipy.stats.t.ppf(CONFIDENCE, n - 1) * squares.std(ddof=1) / np.sqrt(n)))


def _judged(channel: AbstractChannel, heldout: AbstractChannel | None, found: ChannelSelection) -> Gap:
    """The gap on held-out data, or on folds that were held out in turn."""
    if heldout is None:
        where, before, after, on = channel, found.base.left, found.fitted.left, "held-out parts of the data"
    else:
        where, on = heldout, "held-out records"
        before, after = (heldout.residual(fit.state) for fit in (found.base, found.fitted))
    rms = lambda x: float(np.sqrt(np.mean(x**2)))
    floor = rms(where.plain(where.floor(where.residual(found.fitted.state))))
    sides = [where.plain(x) for x in (before, after)]
    axes = [np.array([rms(x[where.group == k]) for k in np.unique(where.group)]) for x in sides]
    reducible = rms(sides[0]) - floor
    shrink = 1.0 - (rms(sides[1]) - floor) / reducible if reducible > 0 else 0.0
    return Gap(rms(sides[0]), rms(sides[1]), floor, shrink, where.unit, on, axes[0], axes[1], where.quantity)


def _reported(channel: AbstractChannel, fit: FittedState, found: ChannelSelection):
    """Effects and own numbers with standard deviations that respect the residual's colour."""
    state, V = fit.state, spread(channel, fit)
    unit = lambda name: parameter_unit(state.given, *name.rsplit(".", 1))
    own = {n: EstimatedValue(v, float(np.sqrt(V[i, i])), unit(n)) for i, (n, v) in enumerate(state.own.items())}
    named = []
    for i, ((candidate, values), one) in enumerate(zip(state.chosen, found.found, strict=False)):
        here = state.place(i)
        effect = candidate.make(np.array(values))
        numbers = _numbers_of(channel.robot, candidate, values, V[here, here])
        told = [f"{other}: {effect.confusable[other]}" for other in one.equivalent if other in effect.confusable]
        told = told or ["records at other amplitudes and positions"] * bool(one.equivalent)
        named.append(
            Named(
                effect,
                candidate.joint,
                numbers,
                one.trial.p_value,
                one.equivalent,
                "; ".join(told),
                one.trial.share,
                _visible(channel, effect, candidate.joint, numbers),
            )
        )
    return tuple(named), own


def _numbers_of(robot: Robot, candidate: Candidate, values, V) -> dict[str, EstimatedValue]:
    """The effect's parameters, with standard deviations by their slopes in the coefficients."""
    units = candidate.make(np.array(values)).units
    read = lambda e: {k: float(np.ravel(getattr(e, k))[0]) for k in units if getattr(e, k) is not None}
    now = read(candidate.make(np.array(values)))
    slopes: dict[str, list[float]] = {}
    for i, value in enumerate(values):
        step = 1e-6 * abs(value) or 1e-9
        moved = np.array(values)
        moved[i] += step
        then = read(candidate.make(moved))
        for name in now:
            slopes.setdefault(name, []).append((then[name] - now[name]) / step)
    std = {k: float(np.sqrt(max(np.array(s) @ V @ np.array(s), 0.0))) for k, s in slopes.items()}
    unit = lambda k: unit_at(robot, candidate.joint, units[k])
    return {k: EstimatedValue(v, std[k] if np.any(slopes[k]) else float("nan"), unit(k)) for k, v in now.items()}


def _visible(channel: AbstractChannel, effect: AbstractEffect, joint: str, numbers: dict[str, EstimatedValue]) -> float:
    """Size of the effect's first parameter over that of a just visible one; NaN for a robot of another size, which has
    the value outside the effect's bounds."""
    name = next(iter(numbers))
    value, (low, high) = numbers[name].value, effect.bounds[name]
    typical = np.max(np.abs(np.asarray(getattr(type(effect).typical(channel.robot, joint), name), float)))
    return float(abs(value) / typical) if typical > 0 and low <= value <= high else float("nan")


def _ranked(t: TriedCandidate) -> Ranked:
    effect = t.candidate.make(np.array(t.values))
    units = list(effect.units)[:1]
    expected = {k: float(np.ravel(getattr(effect, k))[0]) for k in units}
    return Ranked(t.candidate.name, t.candidate.joint, t.explained, t.p_value, expected, float("nan"), t.why)


def _alone(channel: AbstractChannel, found: ChannelSelection, final: FittedState) -> dict[str, dict[str, list[float]]]:
    """rms left of what was measured, on every fold by a fit to the others: of the base, of the
    result, and with each candidate of the axis by itself; {axis: {name: [fold, ...]}}."""
    sides = {"base": found.base.left, "result": final.left}
    told: dict[str, dict[str, list[float]]] = {}
    folds = np.unique(channel.fold)
    for k in np.unique(channel.group):
        parts = [(channel.group == k) & (channel.fold == fold) for fold in folds]
        size = [np.sqrt(np.mean(channel.measured[here] ** 2)) for here in parts]
        of = lambda x: [float(np.sqrt(np.mean(x[here] ** 2)) / s) for here, s in zip(parts, size, strict=True)]  # noqa: B023
        joint = channel.robot.axis_names[k]
        alone = {t.candidate.name: t.left for t in found.trials if t.candidate.joint in (joint, "")}
        told[joint] = {name: of(x) for name, x in (sides | alone).items()}
    return told


def _test(channel: AbstractChannel, fit: FittedState):
    """A test of columns beside all that is free."""

    def tested(columns):
        r, project, block = fit.residual, projector(fit.slopes), channel.blocks(fit.residual)
        found = []
        for x in columns.T:
            own = project(x)
            value = float(own @ r / max(own @ own, 1e-300))
            found.append((float(1.0 - np.sum((r - own * value) ** 2) / np.sum(r**2)), value, (own * r)[:, None]))
        p = family_wise([summed(evidence, block) for *_, evidence in found], DRAWS, len(found))
        return [(share, value, float(q)) for (share, value, _), q in zip(found, p, strict=True)]

    return tested


def _maps(channel: AbstractChannel, final: FittedState, found: ChannelSelection, floor: float) -> Maps:
    sides = [channel.spectra(channel.plain(fit.residual)) for fit in (found.base, final)]
    f = np.concatenate([frequency for frequency, _ in sides[0]])
    top, low = float(f.max()), float(np.min(f[f > 0]))
    edges = np.geomspace(max(2.0 * low, 1e-3 * top) if f.min() == 0.0 else low, top * (1 + 1e-9), BANDS + 1)
    if f.min() == 0.0:
        edges[0] = 0.0
    before, after = (np.stack([_by_band(*one, edges) for one in side]) for side in sides)
    each = max(floor, 1e-300) / np.sqrt(BANDS)
    return Maps(
        before / each, after / each, edges, channel.courses(final.state.robot(), found.base.residual, final.residual)
    )


def _by_band(frequency, power, edges) -> np.ndarray:
    """Rms in every band, (axis, band)."""
    inside = [(frequency >= a) & (frequency < b) for a, b in itertools.pairwise(edges)]
    return np.sqrt(np.stack([power[i].sum(axis=0) for i in inside], axis=1))


def _cells(channel: AbstractChannel, maps: Maps) -> tuple[Cell, ...]:
    found = []
    for axis, name in enumerate(channel.robot.axis_names):
        for band in range(maps.before.shape[2]):
            z = float(np.sqrt(np.mean(maps.before[:, axis, band] ** 2)))
            low, high = (float(x) for x in maps.bands[band : band + 2])
            says = f"{channel.quantity} of {name}, {low:.3g} to {high:.3g} Hz: {z:.1f} times the floor."
            found.append(Cell(None, name, (low, high), z, says))
    return tuple(sorted(found, key=lambda c: -c.z)[:3])


def _numbers(channel: AbstractChannel, own) -> dict[str, float]:
    begun = parameters(channel.robot, {name.rpartition(".")[2] for name in own})
    return {name: float(begun[name]) for name in own}


def _refit_remark(channel: AbstractChannel, found: ChannelSelection, final: FittedState) -> tuple[str, ...]:
    rms = lambda r: float(np.sqrt(np.mean(channel.plain(r) ** 2)))
    nominal, before = rms(channel.residual(State(channel.robot, channel.own()))), rms(found.base.residual)
    said = []
    if before < REFITTED * nominal:
        said.append(
            f"refitting the robot's own numbers took the {channel.quantity} from {nominal:.3g} to {before:.3g} "
            f"{channel.unit}: that part was wrong numbers, no missing effect."
        )
    return (*said, *(f"{n} came out negative ({v:.3g})." for n, v in final.state.own.items() if v < 0))


def _wrong_signs(found: ChannelSelection) -> tuple[str, ...]:
    """Candidates that would explain much with a sign that they cannot have."""
    telling = [t for t in found.trials if t.p_value <= LEVEL and not t.sensible and t.share >= LEAST_SHARE]
    return tuple(
        f"{t.candidate.name} of {t.candidate.joint} alone would explain {t.explained:.0%}, but with a sign or size "
        "that no such effect has: it stands in for something else."
        for t in telling
    )


def _says(channel: AbstractChannel, verdict: str, named, gap: Gap, ranking) -> str:
    size = lambda x: f"{x:.1%}" if channel.unit.startswith("of") else f"{x:.3g}"
    of, quantity = (f" {channel.unit}" if channel.unit.startswith("of") else ""), channel.quantity
    if named:
        which = ", ".join(f"{x.name} ({x.joint})" for x in named)
        doubt = "; other effects fit as well" if verdict == "ambiguous" else ""
        course = f"the {quantity} falls from {size(gap.before)} to {size(gap.after)}{of} on {gap.on}"
        return f"Missing: {which}{doubt}; {course} (floor {size(gap.floor)})."
    best = f"; best candidate: {ranking[0].name} ({ranking[0].joint}), {ranking[0].score:.0%}" if ranking else ""
    return {
        "sufficient": f"Nothing is missing: the {quantity} is {size(gap.before)}{of} on {gap.on}.",
        "unexplained": f"The {quantity}, {size(gap.before)}{of}, is systematic (floor {size(gap.floor)}), but no "
        f"effect of the library explains it{best}.",
    }.get(verdict, f"Neither named nor ruled out: a {quantity} of {size(gap.before)}{of} on {gap.on}{best}.")
