"""From a selection of effects to what a person reads: verdict, effects, where, gap, maps."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..._errors import InputError
from ...experiment import Experiment
from ...frf import LRM
from ...graybox.indirect import default_method, measured_frf
from ...robot import Robot
from ...trajectory.following import why_followed
from ..result import Diagnosis, EstimatedValue, Gap, Maps, Ranked
from ..settings import AT_MOST, FLOOR, LEAST_SIZE, NOTHING, SHOWN
from .conclude import Conclusion, concluded, next_experiment, redefined
from .judge import Written, each_written, over_floor, relative_torque
from .maps import largest_cells, maps_of
from .records import Records
from .selection import Selection


def assembled(found: Selection, records: Records, given: Robot, compared: str) -> Diagnosis:
    """The result: of the robots that would be written, judged on the held-out positions."""
    end = concluded(found, records, given)
    records = end.records
    values, changed = _parameters(end, given)
    maps = _maps(records, end)
    return Diagnosis(
        verdict=end.verdict,
        says=end.says + _of_standing_motors(end.verdict, given, records),
        effects=end.effects,
        ranking=_ranking(found, end),
        where=largest_cells(given.axis_names, maps),
        gap=gap_between(records, end.base, end.extended),
        maps=maps,
        parameters=values,
        changed=changed,
        given=given,
        base=_stated(end.base.robot),
        extended=_stated(end.extended.robot),
        compared=compared,
        fitted=tuple(int(i) for i in records.opened),
        heldout=tuple(int(i) for i in records.heldout),
        frf=_responses(records, (end.base, end.extended)),
        next_experiment=next_experiment(end.verdict, end.effects),
        sources=tuple(records.whole.data.sources),
        settings={"lines": len(records.whole.frequency), "highest_hz": float(records.whole.frequency[-1])},
        wrong_numbers=end.wrong,
    )


def _of_standing_motors(verdict: str, given: Robot, records: Records) -> str:
    """What else may be the matter where motors are moved as measured."""
    if verdict != "unexplained" or not why_followed(given, records.whole.data):
        return ""
    return (
        " Motors were moved as they were measured: the torque of one that sticks is not in its motion. State the "
        "controller, record the reference and diagnose again before you look for more."
    )


def _stated(robot: Robot) -> Robot:
    """The robot with its effects as a file states them."""
    return dataclasses.replace(robot, effects=tuple(e.stated() for e in robot.effects))


def _maps(records: Records, end: Conclusion) -> Maps:
    """Of all positions."""
    ends = [end.base] if end.extended is end.base else [end.base, end.extended]
    found = each_written([x.robot for x in ends], records.whole)
    base = found[0] or end.base
    return maps_of(records.whole, base, found[-1] or base)


def gap_between(records: Records, base: Written, extended: Written) -> Gap:
    """Of robots that were simulated where the result is told."""
    judged, floor = records.every.at(records.judged), base.evidence.plain
    b, a = (float(np.sqrt(np.mean(over_floor(x.residual, floor) ** 2))) for x in (base, extended))
    low = min(np.sqrt(FLOOR), AT_MOST * b)
    shrink = float(np.clip(1.0 - (a - low) / max(b - low, NOTHING), -9.0, 1.0))
    on = "held-out positions" if len(records.heldout) else "the fitted positions (none were held out)"
    before, after = (relative_torque(judged, x.residual) for x in (base, extended))
    return Gap(b, a, float(low), shrink, "1", on, before, after)


def _parameters(end: Conclusion, given: Robot):
    """Stiffnesses and dampings of the robot that is written, and their changes where they mean what they did."""
    values, changed, last = {}, {}, end.last
    other = redefined(end.steps, given)
    for number in last.numbers:
        if number.kind in ("stiffness", "damping") and number.joint in given.joint_names:
            value = last.value(number.name)
            values[number.name] = EstimatedValue(value, last.deviation(number.name), number.unit)
            changed[number.name] = float("nan") if number.name in other else value / number.given - 1.0
    return values, changed


def _ranking(found: Selection, end: Conclusion) -> tuple[Ranked, ...]:
    taken = {step.key: i for i, step in enumerate(end.steps)}
    taken_back = {step.key for step in found.steps} - set(taken)
    fitted = {
        r.key: f"fitted: costs {r.cost:.1%} of what was before, the one taken {s.cost:.1%}"
        for s in found.steps
        for r in s.rivals
    }
    p_value = {step.key: step.on_select.p_value for step in found.steps}
    result: dict = {}
    for scored in found.scored:
        if scored.key in result:
            continue
        if scored.key in taken:
            why = "taken" if taken[scored.key] == 0 else "taken after the first"
        elif scored.key in taken_back:
            why = "taken back"
        elif scored.key in fitted:
            why = fitted[scored.key]
        elif scored.size < LEAST_SIZE:
            why = f"{scored.size:.2g} of what is visible"
        else:
            why = "promises less than the one taken" if taken else "explains too little"
        first = next(iter(scored.effect.units))
        expected = {first: float(np.ravel(np.asarray(getattr(scored.effect, first)))[0])}
        p = p_value.get(scored.key, float("nan"))
        result[scored.key] = Ranked(*scored.key, scored.part, p, expected, scored.size, why)
        if len(result) == SHOWN:
            break
    return tuple(result.values())


def _responses(records: Records, models: Sequence[Written]):
    """FRFs of measurement, base and extended model on the held-out positions, estimated alike; `None` where there are
    none, or too few experiments or lines for an FRF."""
    if not len(records.heldout):
        return None
    try:
        return _estimated(records, models)
    except InputError:
        return None


def _estimated(records: Records, models: Sequence[Written]):
    data = records.every.at(records.heldout).data
    method = LRM() if data.r is None else default_method()
    found = [measured_frf(data, method, "acceleration")]
    for model in models:
        found.append(measured_frf(_played(data, model), method, "acceleration"))
    return tuple(found)


def _played(data: Experiment, model: Written) -> Experiment:
    scenes = model.evidence.scenes
    first = data.transient_periods * data.period
    return dataclasses.replace(
        data,
        u=np.stack([s.u for s in scenes]),
        y=np.stack([s.y for s in scenes]),
        r=None if data.r is None else np.asarray(data.r)[:, :, first : first + data.period],
        y_quantity="position",
        transient_periods=0,
    )
