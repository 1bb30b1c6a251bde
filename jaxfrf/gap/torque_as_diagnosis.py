"""A diagnosis by inverse dynamics in the shape of `jaxfrf.gap.Diagnosis`: the same files and pages for both."""

import itertools
from collections.abc import Sequence

import numpy as np

from ..experiment import Experiment
from ..robot import Robot, parameters
from ..trajectory.rigid_motion import COMPARED, Motion, measured_motions, thinned
from .result import Cell, Diagnosis, Estimate, Gap, Maps, Named, Ranked
from .torque_model import needed_torque
from .torque_result import TorqueDiagnosis, Value

_BANDS = 6
_BINS = 24
COMPARED_BY = "torque that the model needs for the measured motion (inverse dynamics): the weaker comparison"


def as_diagnosis(found: TorqueDiagnosis, data: Experiment | Sequence[Experiment]) -> Diagnosis:
    """`found` with maps from `data`, the records that are to be shown (records stand for positions)."""
    records = (data,) if isinstance(data, Experiment) else tuple(data)
    motions = [m for x in records for m in measured_motions(found.given, x, found.cutoff)]
    maps = _maps(found, motions)
    gap = found.gap
    return Diagnosis(
        verdict=found.verdict,
        says=found.says,
        effects=tuple(_named(e, found.given) for e in found.effects),
        ranking=tuple(Ranked(x.name, x.joint, x.score, x.p_value, {}, float("nan"), "") for x in found.ranking),
        where=_cells(maps, found.given.axis_names)
        + tuple(Cell(None, x.joint, (0.0, COMPARED * found.cutoff), float("nan"), x.says) for x in found.where),
        gap=Gap(gap.before, gap.after, gap.floor, gap.shrink, "1", gap.on, gap.axis_before, gap.axis_after),
        maps=maps,
        parameters={name: _estimate(x) for name, x in found.parameters.items()},
        changed=_changed(found),
        given=found.given,
        base=found.base,
        extended=found.robot,
        compared=COMPARED_BY,
        fitted=tuple(range(len(motions))),
        sealed=(),
        frf=None,
        next_experiment="; ".join(e.separating_experiment for e in found.effects if e.separating_experiment),
        sources=tuple(s for x in records for s in x.sources),
        settings={"cutoff_hz": found.cutoff, "remarks": list(found.remarks), "left_out": dict(found.left_out)},
    )


def _estimate(x: Value) -> Estimate:
    return Estimate(float(x.value), float(x.std), x.unit)


def _named(e, robot: Robot) -> Named:
    return Named(
        e.effect,
        e.joint,
        {name: _estimate(x) for name, x in e.parameters.items()},
        e.p_value,
        e.equivalent,
        e.separating_experiment,
        e.share,
        _visible(e, robot),
    )


def _visible(e, robot: Robot) -> float:
    """Size of the effect's first parameter over that of a just visible one; NaN for a robot of another size, which has
    the value outside the effect's bounds."""
    name = next(iter(e.parameters))
    value, (low, high) = e.parameters[name].value, type(e.effect).bounds[name]
    typical = np.max(np.abs(np.asarray(getattr(type(e.effect).typical(robot, e.joint), name), float)))
    return float(abs(value) / typical) if typical > 0 and low <= value <= high else float("nan")


def _changed(found: TorqueDiagnosis) -> dict[str, float]:
    begun = parameters(found.given, {name.rpartition(".")[2] for name in found.parameters})
    start = {name: float(begun[name]) for name in found.parameters}
    return {n: x.value / start[n] - 1.0 if start[n] else float("nan") for n, x in found.parameters.items()}


def _left(robot: Robot, motion: Motion) -> np.ndarray:
    return thinned(motion, motion.torque - needed_torque(robot, motion))


def _maps(found: TorqueDiagnosis, motions: list[Motion]) -> Maps:
    top, low = COMPARED * found.cutoff, min(1.0 / (len(m.torque) / m.fs) for m in motions)
    edges = np.geomspace(max(2.0 * low, 1e-3 * top), top, _BANDS + 1)
    edges[0] = 0.0
    sides = [[_left(robot, m) for m in motions] for robot in (found.base, found.robot)]
    bands = [np.stack([_spectrum(m, x, edges) for m, x in zip(motions, side, strict=True)]) for side in sides]
    floor = found.gap.floor * np.sqrt(np.mean([np.mean(thinned(m, m.torque) ** 2, axis=0) for m in motions], axis=0))
    floor = np.maximum(floor / np.sqrt(_BANDS), 1e-300)[None, :, None]
    return Maps(bands[0] / floor, bands[1] / floor, edges, _courses(found.robot, motions, *sides))


def _spectrum(motion: Motion, left, edges) -> np.ndarray:
    """Rms of a residual in every band, (axis, band)."""
    X = np.fft.rfft(left, axis=0) / len(left)
    f = np.arange(len(X)) / len(X) * COMPARED * motion.cutoff / 0.8  # thinned to .4 fs' = the compared band
    power = 2.0 * np.abs(X) ** 2
    power[0] *= 0.5
    inside = [(f >= a) & (f < b) for a, b in itertools.pairwise(edges)]
    return np.sqrt(np.stack([power[i].sum(axis=0) for i in inside], axis=1))


def _courses(robot: Robot, motions, before, after):
    gear = np.asarray(robot.drives.gear_ratio)
    signals = {
        "speed": [thinned(m, m.speed) for m in motions],
        "angle": [thinned(m, m.angle / gear) for m in motions],
        "load": [thinned(m, m.torque) for m in motions],
    }
    before, after = np.concatenate(before), np.concatenate(after)
    return {name: _course(np.concatenate(x), before, after) for name, x in signals.items()}


def _course(signal, before, after):
    """Means in bins of equally many samples, (axis, bin) each."""
    order = np.argsort(signal, axis=0)
    means = lambda x: np.stack(
        [p.mean(axis=0) for p in np.array_split(np.take_along_axis(x, order, axis=0), _BINS)], axis=1
    )
    return means(signal), means(before), means(after)


def _cells(maps: Maps, axes) -> tuple[Cell, ...]:
    found = []
    for axis, name in enumerate(axes):
        for band in range(maps.before.shape[2]):
            z = float(np.sqrt(np.mean(maps.before[:, axis, band] ** 2)))
            low, high = (float(x) for x in maps.bands[band : band + 2])
            says = f"torque of {name}, {low:.3g} to {high:.3g} Hz: {z:.1f} times the floor."
            found.append(Cell(None, name, (low, high), z, says))
    return tuple(sorted(found, key=lambda c: -c.z)[:3])
