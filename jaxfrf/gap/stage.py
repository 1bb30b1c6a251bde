"""A robot simulated through the experiment, its own numbers adjusted, and what is left scored against candidates."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Complex

from ..effects import AbstractEffect, ResolverRipple, TorqueRipple, TransmissionError
from ..robot import Robot
from ..trajectory.evidence import Column, Evidence, Weighed, inflated, rebased, refloored, renewed, weigh
from ..trajectory.measured import Measured
from ..trajectory.remainder import remainder
from ..trajectory.ripple import Order, find_orders, gear_orders, order_columns
from ..trajectory.signature import signature
from .candidates import Candidate
from .knobs import Knob
from .score import BaseFit, Drop, Limits, drop, fit_base

_BOX = 2.5  # tolerances
_KNOWN = 1e-3  # of the floor's squares: the cost of one tolerance, as if the record held a thousand honest numbers
_FREE = {"stiffness": (-0.6, 1.5), "damping": (-0.95, 4.0)}  # relative
_REACH = {"stiffness": (-0.15, 0.2), "damping": (-0.4, 0.7)}  # relative, of one look: columns hold no further
_STEP = 1e-3  # relative, of a knob
_HELD = 1e-9  # relative: bounds of a knob that is held, which the solver wants apart
_KNOWN_TORQUE, _KNOWN_RESOLVER = (1, 2, 6, 18), (1, 2)  # orders of ripple that motors are known for
FAR = 2.0  # misfit from which on a floor alone would leave the word to a few lines
_ROUNDS = 3  # of looking for other orders
_QUIET = 0.33  # of a loud ripple: what is expected, as one tolerance of a knob


class Stage(eqx.Module):
    """One look at a record.

    **Fields:** `robot`: that was simulated. `turns`: relative changes of the knobs so far, (knob,). `weighed`: base
    columns: knobs, two for each of `orders`. `loud`: orders too strong for a background, which count as candidates.
    `fit`: of the base without them. `misfit`: mean square over the floor; where it
    is large, columns are weighed by what is left, too. `near`: whether stiffness and damping change no further in `fit`
    than columns hold.
    """

    robot: Robot
    evidence: Evidence = eqx.field(static=True)
    knobs: tuple[Knob, ...]
    turns: np.ndarray
    orders: tuple[Order, ...]
    loud: tuple[Order, ...]
    weighed: Weighed
    fit: BaseFit
    misfit: float
    near: bool = eqx.field(static=True)

    @property
    def left(self) -> Complex[np.ndarray, "pos exp line axis"]:
        """Residual after the robot's own numbers gave way, N m."""
        return remainder(self.evidence, self.weighed, self.fit.x, self.fit.columns)


def knob_columns(robot: Robot, knobs: Sequence[Knob]) -> list[Column]:
    def column(knob):
        return lambda scene: scene.by_robot(knob.turned(robot, _STEP)) / _STEP

    return [column(knob) for knob in knobs]


def limits(robot: Robot, knobs: Sequence[Knob], turns, orders: Sequence[Order], near: bool) -> Limits:
    """Of further relative changes, so that all of them together stay within their bounds, and near zero; and of
    ripple, which is near what motors have."""
    low, high = [], []
    for knob, done in zip(knobs, turns, strict=True):
        a, b = _FREE[knob.kind] if knob.free else (-_BOX * knob.tolerance, _BOX * knob.tolerance)
        least, most = _REACH[knob.kind] if knob.free and near else (-np.inf, np.inf)
        low.append(min(max((1 + a) / (1 + done) - 1, least), -_HELD))
        high.append(max(min((1 + b) / (1 + done) - 1, most), _HELD))
    tolerance, turns = np.array([knob.tolerance for knob in knobs]), np.asarray(turns, float)
    weight = np.where(tolerance > 0, _KNOWN * ((1 + turns) / np.where(tolerance > 0, tolerance, 1.0)) ** 2, 0.0)
    waves = np.repeat([(_QUIET * order.loud(robot)) ** -2.0 for order in orders], 2)
    return Limits(
        np.concatenate([low, waves - np.inf]),
        np.concatenate([high, waves + np.inf]),
        np.concatenate([1 / (1 + turns) - 1, 0.0 * waves]),
        np.concatenate([weight, _KNOWN * waves]),
    )


def ripple_orders(evidence: Evidence, weighed: Weighed, knobs, turns, opened, runs) -> tuple[tuple, Weighed]:
    """Orders that motors ripple at: those that they are known for, then the strongest others, one after the other."""
    robot = evidence.robot
    scenes = [s for s, o in zip(evidence.scenes, opened, strict=True) if o]
    orders = [Order("torque", a, float(h)) for a in range(robot.n_axes) for h in _KNOWN_TORQUE]
    orders += [Order("resolver", a, float(h)) for a in range(robot.n_axes) for h in _KNOWN_RESOLVER]
    weighed = weigh(evidence, order_columns(orders), weighed)
    for _ in range(_ROUNDS):
        known = limits(robot, knobs, turns, orders, False)
        fit = fit_base(weighed.gram, range(len(known)), known, runs)
        left = remainder(evidence, weighed, fit.x, fit.columns)[opened]
        new = []
        for axis in range(robot.n_axes):
            for kind, tried in (("torque", np.arange(1, 51)), ("resolver", np.arange(1, 13))):
                had = [o.order for o in orders if (o.kind, o.axis) == (kind, axis)]
                new += find_orders(scenes, left, evidence.floor, kind, axis, np.setdiff1d(tried, had), 1)
        orders += new
        weighed = weigh(evidence, order_columns(new), weighed)
    return tuple(orders), weighed


def look(robot: Robot, record: Measured, knobs, turns, opened) -> Stage:
    """Simulate the robot and fit its base; orders that are too strong for a background are set apart."""
    evidence = Evidence(robot, record)
    runs = np.repeat(opened, record.data.n_exp)
    weighed = weigh(evidence, knob_columns(robot, knobs))
    orders, weighed = ripple_orders(evidence, weighed, knobs, turns, opened, runs)
    apart, keep = _set_apart(robot, weighed, knobs, turns, orders, runs)
    return _fitted(robot, evidence, weighed, knobs, turns, orders, apart, keep, opened, runs, False)


def _set_apart(robot: Robot, weighed: Weighed, knobs, turns, orders, runs):
    """Orders that are too strong for a background beside all others, and the columns without them."""
    known = limits(robot, knobs, turns, orders, False)
    fit = fit_base(weighed.gram, range(len(known)), known, runs)
    waves = fit.x[len(knobs) :].reshape(-1, 2)
    loud = [i for i, order in enumerate(orders) if np.hypot(*waves[i]) > order.loud(robot)]
    keep = np.array([i for i in range(len(known)) if i < len(knobs) or (i - len(knobs)) // 2 not in loud])
    return tuple(orders[i] for i in loud), keep


def look_for_ripple(stage: Stage, opened) -> Stage:
    """The same, once more deciding which orders are loud: far from the truth a background looks louder than it is."""
    parts = stage.robot, stage.evidence, stage.weighed, stage.knobs, stage.turns, stage.orders
    apart, keep = _set_apart(stage.robot, stage.weighed, stage.knobs, stage.turns, stage.orders, stage.fit.runs)
    return _fitted(*parts, apart, keep, opened, stage.fit.runs, stage.near)


def look_again(stage: Stage, robot: Robot, record: Measured, turns, opened, knobs=None, near: bool = True) -> Stage:
    """Another robot, not far from that of a stage, beside the same columns: they change little, the residual does.

    `knobs`: the stage's own with other tolerances, if there are."""
    knobs = stage.knobs if knobs is None else knobs
    evidence = Evidence(robot, record)
    evidence.floor, evidence.plain = stage.evidence.floor, stage.evidence.plain
    first = len(stage.knobs)
    # A resolver's error is felt through the robot's impedance, which is another now.
    felt = {
        first + i: column
        for i, column in enumerate(order_columns(stage.orders))
        if stage.orders[i // 2].kind == "resolver"
    }
    weighed = renewed(stage.weighed, evidence, felt)
    return _fitted(
        robot,
        evidence,
        weighed,
        knobs,
        turns,
        stage.orders,
        stage.loud,
        stage.fit.columns,
        opened,
        stage.fit.runs,
        near,
    )


def look_closely(stage: Stage, opened) -> Stage:
    """The same simulation beside columns of its own robot, where `look_again` went far from the first one."""
    evidence, runs = stage.evidence, stage.fit.runs
    weighed = weigh(evidence, knob_columns(stage.robot, stage.knobs) + order_columns(stage.orders))
    parts = stage.robot, evidence, weighed, stage.knobs, stage.turns, stage.orders, stage.loud, stage.fit.columns
    return _fitted(*parts, opened, runs, stage.near)


def _fitted(robot, evidence, weighed, knobs, turns, orders, loud, keep, opened, runs, near) -> Stage:
    known = limits(robot, knobs, turns, orders, near)[keep]
    fit = fit_base(weighed.gram, keep, known, runs)
    left = remainder(evidence, weighed, fit.x, fit.columns)[opened]
    misfit = mean_square(left / evidence.plain)
    floor = inflated(evidence.plain, left) if misfit > FAR else evidence.plain
    if floor is not evidence.floor:
        weighed = refloored(weighed, evidence.floor, floor)
        evidence.floor = floor
        fit = fit_base(weighed.gram, keep, known, runs)
        left = remainder(evidence, weighed, fit.x, fit.columns)[opened]
        misfit = mean_square(left / evidence.plain)
    return Stage(robot, evidence, tuple(knobs), turns, tuple(orders), tuple(loud), weighed, fit, misfit, near)


def mean_square(z) -> float:
    """Of real and imaginary parts alike: 1 where they are at their floor."""
    return 0.5 * float(np.mean(np.abs(z) ** 2))


class Scored(eqx.Module):
    """A candidate with its score: `part` of the base's misfit that it explains, `size` over the visible one."""

    candidate: Candidate
    found: Drop
    part: float
    size: float

    def effect(self) -> AbstractEffect:
        return self.candidate.make(self.found.x)


class Table(eqx.Module):
    """Columns of all candidates behind those of a base, and the candidates."""

    candidates: tuple[Candidate, ...]
    weighed: Weighed
    floor: np.ndarray


def table(stage: Stage, candidates: Sequence[Candidate]) -> Table:
    """The columns of candidates along the motion of a stage."""
    columns = [lambda s, e=e: signature(e, s) for c in candidates for e in c.basis]
    return Table(tuple(candidates), weigh(stage.evidence, columns, stage.weighed), stage.evidence.floor)


def retold(old: Table, stage: Stage) -> Table:
    """The same columns beside the residual and over the floor of another stage."""
    weighed = old.weighed
    if stage.evidence.floor is not old.floor:
        weighed = refloored(weighed, old.floor, stage.evidence.floor)
    return Table(old.candidates, rebased(weighed, stage.weighed), stage.evidence.floor)


def score(stage: Stage, columns: Table) -> list[Scored]:
    """All candidates beside the base of a stage, best first."""
    gram, start = columns.weighed.gram, stage.weighed.gram.b.shape[1]
    found = []
    for candidate in columns.candidates:
        rows = np.arange(start, start + len(candidate.basis))
        start += len(rows)
        found.append(_scored(candidate, drop(gram, stage.fit, rows, candidate.low, candidate.high), stage.fit))
    for candidate, rows in loud_candidates(stage):
        inf = np.full(len(rows), np.inf)
        found.append(_scored(candidate, drop(gram, stage.fit, rows, -inf, inf), stage.fit))
    return sorted(found, key=lambda s: -s.part)


def _scored(candidate: Candidate, got: Drop, fit: BaseFit) -> Scored:
    if candidate.name in ("torque_ripple", "resolver_ripple", "transmission_error"):
        effect = candidate.make(got.x)
        size = float(np.max(np.asarray(effect.amplitude))) / candidate.visible
    else:
        size = abs(float(got.x[0])) / candidate.visible
    return Scored(candidate, got, got.drop / fit.squares, size)


def loud_candidates(stage: Stage) -> list[tuple[Candidate, np.ndarray]]:
    """Ripple of one motor, all of its loud orders together, and where their columns stand."""
    found = []
    for axis in range(stage.robot.n_axes):
        for kind, make in (("torque", TorqueRipple), ("resolver", ResolverRipple)):
            these = [o for o in stage.loud if (o.kind, o.axis) == (kind, axis)]
            if not these:
                continue
            rows = np.concatenate([len(stage.knobs) + 2 * stage.orders.index(o) + np.arange(2) for o in these])
            joint = stage.robot.axis_names[axis]
            visible = float(np.max(np.asarray(make.typical(stage.robot, joint).amplitude)))
            build = _Waves(make, joint, tuple(int(o.order) for o in these))
            wide = (np.inf,) * len(rows)
            candidate = Candidate(
                make.name,
                joint,
                (),
                build,
                tuple(-x for x in wide),
                wide,
                visible,
                "orders " + ", ".join(f"{o.order:g}" for o in these),
            )
            found.append((candidate, rows))
    return found


def waves_of(kind, joint: str, orders: Sequence[int], c) -> AbstractEffect:
    """Ripple from the coefficients of sine and cosine of every order, (order, 2)."""
    c = np.asarray(c)
    return kind(joint, np.hypot(c[:, 0], c[:, 1]), tuple(orders), np.arctan2(c[:, 1], c[:, 0]))


class _Waves:
    """Ripple from the coefficients of sine and cosine."""

    def __init__(self, kind, joint: str, orders: tuple[int, ...], teeth: float | None = None):
        self.kind, self.joint, self.orders, self.teeth = kind, joint, orders, teeth

    def __call__(self, c):
        waves = np.asarray(c).reshape(-1, 2)
        if self.teeth is None:
            return waves_of(self.kind, self.joint, self.orders, waves)
        amplitude, phase = np.hypot(waves[:, 0], waves[:, 1]), np.arctan2(waves[:, 1], waves[:, 0])
        return TransmissionError(self.joint, amplitude, self.teeth, self.orders, phase)


def gear_candidates(stage: Stage, opened) -> list[Candidate]:
    """Errors of the teeth of every gear, at the order that the residual holds most of."""
    evidence, robot = stage.evidence, stage.robot
    scenes = [s for s, o in zip(evidence.scenes, opened, strict=True) if o]
    first = len(stage.knobs)
    found = []
    for axis in robot.flexible_axes:
        # Whole orders of this motor stay in the residual: they would take most of an error at an order nearby.
        own = np.array([c >= first and stage.orders[(c - first) // 2].axis == axis for c in stage.fit.columns])
        left = remainder(evidence, stage.weighed, stage.fit.x[~own], stage.fit.columns[~own])[opened]
        for order in gear_orders(scenes, left, evidence.floor, axis):
            joint = robot.axis_names[axis]
            teeth = order * float(robot.drives.gear_ratio[axis])
            build = _Waves(TransmissionError, joint, (1,), abs(teeth))
            basis = (
                TransmissionError(joint, [1e-5], abs(teeth), (1,)),
                TransmissionError(joint, [1e-5], abs(teeth), (1,), [np.pi / 2]),
            )
            wide = (np.inf, np.inf)
            scale = _Scaled(build, 1e-5)
            found.append(
                Candidate(
                    "transmission_error",
                    joint,
                    basis,
                    scale,
                    (-np.inf, -np.inf),
                    wide,
                    3e-5,
                    f"{abs(teeth):.4g} a turn",
                )
            )
    return found


class _Scaled:
    def __init__(self, build, factor):
        self.build, self.factor = build, factor

    def __call__(self, c):
        return self.build(self.factor * np.asarray(c))
