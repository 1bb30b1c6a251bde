"""Diagnosis by inverse dynamics: the torque that the model needs for the measured motion, against the measured one.

For records that are no multisine, or whose reference or controller is not known. It sees what changes the *torque*
(friction, static torque, ripple, delay) and nothing of springs; it is the weaker comparison of two, for feedback
carries the noise of the position into the torque.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
import scipy.stats

from .._errors import input_error
from ..effects import library
from ..experiment import Experiment
from ..robot import Robot, parameter_unit, parameters
from ..trajectory.rigid_motion import COMPARED, chosen_cutoff, measured_motions
from .torque_candidates import Candidate, candidates
from .torque_evidence import Evidence, Fitted, State, gathered
from .torque_floor import unpredictable
from .torque_model import check_one_motor_a_joint
from .torque_result import NamedEffect, TorqueDiagnosis, TorqueGap, Value
from .torque_score import covariance
from .torque_search import LEVEL, Search, search
from .torque_where import remainder


def diagnose_torque(
    robot: Robot,
    data: Experiment | Sequence[Experiment],
    sealed: Experiment | Sequence[Experiment] | None = None,
    *,
    effects: Iterable[str] | None = None,
    refit: Iterable[str] | None = None,
    cutoff: float | None = None,
    most: int = 4,
    tolerance: float = 0.05,
    draws: int = 999,
    seed: int = 0,
) -> TorqueDiagnosis:
    """Which effects a robot with rigid transmissions lacks, from the torque that it needs for the measured motion.

    The motion is filtered without phase and differentiated; the robot's own parameters are refitted first; every
    candidate is scored after projection on them, against a family-wise level by sign flips of whole blocks; the best
    are refitted in full and judged on stretches of the records that were held out in turn. An effect is taken where the
    gap falls there with 95 % confidence and by a fifth of what could fall, and its parameters make sense. Forward, one
    backward pass, at most `most`. The sealed records are opened once, at the end.

    It fails where the motion is dominated by flexible modes within the filter's band, and where the torque came from
    feedback of a noisy position (the derivatives' noise then correlates with it).

    **Arguments:**

    - `robot`: rigid transmissions, no compliant elastic joints. `data`, `sealed`: records, periodic or not.
    - `effects`: names of the candidates; all of the library by default.
    - `refit`: names of the robot's parameters (as in `jaxfrf.robot.parameters`) that are fitted first; motor inertia
      and viscous friction of every axis by default. An effect that is one of them cannot be named.
    - `cutoff`: of the motion's filter, Hz; torques are compared up to a fifth of it. By default 2.5 times the band in
      which y stands 10 dB above its noise floor.
    - `tolerance`: a model is sufficient where the residual is surely below this share of the torque.
    - `draws`: of the sign flips; no p-value is below 1/(draws + 1).

    **Raises:** `jaxfrf.InputError` for a robot with springs, and for names that it does not have.
    """
    check_one_motor_a_joint(robot)
    records = _records(data)
    cutoff = min(chosen_cutoff(x) for x in records) if cutoff is None else float(cutoff)
    motions = tuple(m for x in records for m in measured_motions(robot, x, cutoff))
    names = tuple(effects) if effects is not None else tuple(library())
    _check_names(names)
    evidence = gathered(motions)
    start = State(robot, _own_parameters(robot, refit), ())
    base = evidence.refitted(start)
    speed = np.max([np.max(np.abs(m.speed), axis=0) for m in motions], axis=0)
    travel = np.max([np.ptp(m.angle, axis=0) for m in motions], axis=0)
    pool, left_out = candidates(robot, names, speed, travel)
    found = search(evidence, base, pool, most, draws, seed)
    verdict = _verdict(found, evidence, base, tolerance)
    final = base if verdict == "unexplained" else found.fitted
    states = start, base.state, final.state
    fit_gap = _gap(evidence, states, "fitted records")
    if sealed is None:
        gap = dataclasses.replace(fit_gap, before=base.held_out, after=final.held_out, on="held-out stretches")
    else:
        others = tuple(m for x in _records(sealed) for m in measured_motions(robot, x, cutoff))
        gap = _gap(gathered(others), states, "sealed records")
    named, values = _reported(evidence, final, found)
    where = remainder(evidence, final, motions, draws, seed)
    return TorqueDiagnosis(
        verdict=verdict,
        says=_says(verdict, named, gap, found.ranking),
        effects=named,
        ranking=found.ranking,
        gap=gap,
        fit_gap=fit_gap,
        parameters=values,
        where=where,
        given=robot,
        base=base.state.robot(),
        robot=final.state.robot(),
        remarks=_remarks(fit_gap, final.state, cutoff, where),
        left_out=left_out,
        cutoff=cutoff,
    )


def _verdict(found: Search, evidence: Evidence, base: Fitted, tolerance: float) -> str:
    squares = found.fitted.squares
    before, after, floor = np.mean(base.squares), np.mean(squares), evidence.floor(base.residual) ** 2
    if found.found:
        if before - after < 0.5 * (before - floor):
            return "unexplained"
        return "ambiguous" if any(x[2] for x in found.found) else "named"
    best = max((x.share for x in found.refused), default=0.0)
    predicted = 1.0 - floor / before
    if predicted > 0.5 or (found.last_p <= LEVEL and predicted > 0.1 and best < 0.5):
        return "unexplained"
    upper = after + scipy.stats.t.ppf(0.95, len(squares) - 1) * np.std(squares, ddof=1) / np.sqrt(len(squares))
    return "sufficient" if found.last_p > LEVEL and np.sqrt(upper) < tolerance else "inconclusive"


def _gap(evidence: Evidence, states, on: str) -> TorqueGap:
    residuals = {k: evidence.residual(x) for k, x in zip(("nominal", "before", "after"), states, strict=True)}
    shape = evidence.torque.shape
    left = unpredictable(residuals["after"].reshape(shape), evidence.feature, evidence.stretch)
    residuals["floor"] = left.ravel()
    rms = lambda r: float(np.sqrt(np.mean(r**2)))
    newton = {k: rms(r.reshape(shape) * evidence.size) for k, r in residuals.items()}
    axes = {f"axis_{k}": np.sqrt(np.mean(residuals[k].reshape(shape) ** 2, axis=0)) for k in ("before", "after")}
    return TorqueGap(**{k: rms(r) for k, r in residuals.items()}, newton_metres=newton, **axes, on=on)


def _reported(evidence: Evidence, fitted: Fitted, found: Search):
    """Effects and own parameters with standard deviations that respect the residual's colour."""
    final, r = fitted.state, fitted.residual
    cov = covariance(r, fitted.slopes, evidence.blocks(r))
    n = len(final.own)
    given = final.given
    own = {
        name: Value(value, float(np.sqrt(cov[i, i])), parameter_unit(given, *name.rsplit(".", 1)))
        for i, (name, value) in enumerate(final.own.items())
    }
    named = []
    for (candidate, values), (trial, equivalent, _) in zip(final.chosen, found.found, strict=False):
        part = cov[n : n + len(values), n : n + len(values)]
        n += len(values)
        named.append(
            NamedEffect(
                candidate.make(values),
                candidate.name,
                candidate.joint,
                _effect_values(candidate, values, part),
                trial.p_value,
                trial.share,
                equivalent,
                _separating(candidate.name, equivalent),
            )
        )
    return tuple(named), own


def _effect_values(candidate: Candidate, values, cov) -> dict[str, Value]:
    """The effect's parameters from the free values, their standard deviations by the slope of one in the other."""
    first = lambda x: float(np.atleast_1d(np.asarray(x, float))[0])
    read = lambda e: {k: first(getattr(e, k)) for k in e.units if getattr(e, k) is not None}
    now, slopes = read(candidate.make(values)), {}
    for i, value in enumerate(values):
        step = 1e-6 * abs(value) or 1e-9
        moved = list(values)
        moved[i] += step
        then = read(candidate.make(moved))
        for name in now:
            slopes.setdefault(name, []).append((then[name] - now[name]) / step)
    units = library()[candidate.name].units
    std = {k: float(np.sqrt(max(np.array(s) @ cov @ np.array(s), 0.0))) for k, s in slopes.items()}
    return {k: Value(float(v), std[k] if np.any(slopes[k]) else float("nan"), units[k]) for k, v in now.items()}


def _separating(name: str, equivalent: tuple[str, ...]) -> str:
    known = library()[name].confusable
    told = [f"{other}: {known[other]}" for other in equivalent if other in known]
    return "; ".join(told) or ("records at other amplitudes and positions" if equivalent else "")


def _says(verdict: str, named, gap: TorqueGap, ranking) -> str:
    course = f"the torque residual falls from {gap.before:.1%} to {gap.after:.1%} of the torque on {gap.on}"
    if named:
        which = ", ".join(f"{e.name} ({e.joint})" for e in named)
        doubt = "; other effects fit as well" if verdict == "ambiguous" else ""
        return f"Missing: {which}{doubt}; {course} (floor {gap.floor:.1%})."
    best = f"; best candidate: {ranking[0].name} ({ranking[0].joint}), {ranking[0].score:.0%}" if ranking else ""
    return {
        "sufficient": f"Nothing is missing: the torque residual is {gap.before:.1%} of the torque on {gap.on}.",
        "unexplained": f"The torque residual, {gap.before:.1%} of the torque, goes with the motion (floor "
        f"{gap.floor:.1%}), but no effect of the library explains it{best}.",
    }.get(verdict, f"Neither named nor ruled out: a torque residual of {gap.before:.1%} on {gap.on}{best}.")


def _remarks(gap: TorqueGap, final: State, cutoff: float, where) -> tuple[str, ...]:
    said = [f"the motion was filtered at {cutoff:.3g} Hz, torques compared up to {COMPARED * cutoff:.3g} Hz."]
    if gap.before < 0.8 * gap.nominal:
        said.append(
            f"refitting the robot's own parameters took the residual from {gap.nominal:.1%} to {gap.before:.1%} "
            "of the torque: that part was wrong numbers, no missing effect."
        )
    said += [f"{name} came out negative ({v:.3g})." for name, v in final.own.items() if v < 0]
    return tuple(said + [x.says for x in where])


def _records(data) -> tuple[Experiment, ...]:
    return (data,) if isinstance(data, Experiment) else tuple(data)


def _own_parameters(robot: Robot, refit) -> dict[str, float]:
    if refit is not None:
        known = parameters(robot, {str(n).rpartition(".")[2] for n in refit})
        return {name: float(known[name]) for name in refit}
    return {name: float(v) for name, v in parameters(robot, ("motor_inertia", "viscous_friction")).items()}


def _check_names(names: tuple[str, ...]) -> None:
    unknown = [n for n in names if n not in library()]
    if unknown:
        raise input_error("effects", repr(unknown[0]), ", ".join(library()), "Correct the name.")
