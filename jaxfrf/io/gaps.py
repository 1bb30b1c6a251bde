"""gap.json: what a diagnosis found, as plain data.

    verdict, says  one of sufficient, named, ambiguous, unexplained, inconclusive; the same in a sentence or two
    effects        [{name, joint, parameters: {name: {value, std, unit, interval95}}, p_value, equivalent,
                   separating_experiment, explains, visible, kind, equation, signature}], in the order in which they
                   were found; kind: "a term is missing", or "a number is wrong" that the robot has; signature: how it
                   shows in data
    wrong_numbers  [{name, value, std, unit, interval95, given, change, p_value}]: numbers of the robot that are off by
                   more than is known of them; given: as its file states it; change: from there, in words
    ranking        [{name, joint, score, p_value, expected, visible, why}]: candidates by what each explains alone
    where          [{position, channel, band_hz, z, says}], position null: at all
    gap            {before, after, floor, shrink, unit, on, quantity, torque_before, torque_after: {axis: part}}
    parameters     {name: {value, std, unit, start, identifiable, interval95, changed}} of the extended model; start: of
                   the robot as given, changed: relative to it
    compared       how measurement and model were compared
    next_experiment
    positions      {fitted: [...], heldout: [...]}
    maps           {before, after, bands, courses}: residuals over their floor, (position, axis, band), edges of the
                   bands in Hz, and {signal: [values, before, after]}, each (axis, bin)
    robot, axes, ripple  its name, those of its axes, {joint: orders of the ripple that its motors show}
    settings, sources [{name, sha256}], version

Standard JSON: what is not finite is null.
"""

import inspect
import json
import math
import os
import pathlib
from typing import Any

from .. import __version__
from .._arguments import expect_path, said
from .._errors import input_error
from .._text import NORMAL_95
from ..effects import AbstractEffect
from ..robot import PARAMETER_UNITS, Robot, parameters
from ._json import plain_data, write_json

_NEEDED = ("verdict", "effects", "ranking", "where", "gap", "parameters")


def write_gap(path: str | os.PathLike, diagnosis: Any) -> None:
    """Write a `diagnosis`, what `jaxfrf.gap.diagnose` returned, as JSON, whole or not at all.

    **Arguments:** `path`: of the file. `diagnosis`: a `jaxfrf.gap.Diagnosis`.

    **Raises:** `jaxfrf.InputError` if `diagnosis` is none, or the folder is not there.
    """
    expect_path("path", path)
    if not all(hasattr(diagnosis, name) for name in _NEEDED):
        raise input_error("diagnosis", said(diagnosis), "a jaxfrf.gap.Diagnosis", "Make one: jaxfrf.gap.diagnose(...).")
    write_json(path, gap_contents(diagnosis))


def read_gap(path: str | os.PathLike) -> dict[str, Any]:
    """What `write_gap` wrote: dictionaries, lists, numbers, texts and `None`.

    **Arguments:** `path`: of a gap.json.

    **Returns:** its fields by name, numbers in the units that stand beside them.

    **Raises:** `jaxfrf.InputError` if the file is missing, no JSON, or holds no diagnosis.
    """
    expect_path("path", path)
    path = pathlib.Path(path)
    if not path.is_file():
        raise input_error(str(path), "no such file", "a gap.json", "Check the name and the folder.")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise input_error(str(path), f"no JSON ({error})", "a gap.json", "Write it again.") from error
    missing = [name for name in _NEEDED if not isinstance(found, dict) or name not in found]
    if missing:
        lacks = "JSON without " + (missing[0] if len(missing) == 1 else f"{', '.join(missing[:-1])} and {missing[-1]}")
        raise input_error(str(path), lacks, "what `jaxfrf diagnose` writes", "Name that file.")
    positions = found.get("positions", {})
    if "sealed" in positions:  # as they were called at first
        found["positions"] = {"fitted": positions["fitted"], "heldout": positions["sealed"]}
    return found


def gap_contents(diagnosis: Any) -> dict[str, Any]:
    """What `jaxfrf.gap.diagnose` returned as it stands in gap.json (see above): plain data without NaN."""
    d = diagnosis
    contents = {
        "verdict": d.verdict,
        "says": d.says,
        "effects": [_named(x) for x in d.effects],
        "wrong_numbers": [_wrong(x) for x in d.wrong_numbers],
        "ranking": [_ranked(x) for x in d.ranking],
        "where": [_cell(x) for x in d.where],
        "gap": _gap(d.gap, d.axis_names),
        "maps": {name: getattr(d.maps, name) for name in ("before", "after", "bands", "courses")},
        "parameters": _parameters(d),
        "compared": d.compared,
        "next_experiment": d.next_experiment,
        "positions": {"fitted": list(d.fitted), "heldout": list(d.heldout)},
        "robot": d.base.name,
        "axes": list(d.axis_names),
        "ripple": d.ripple,
        "settings": dict(d.settings),
        "sources": [{"name": s.name, "sha256": s.sha256} for s in d.sources],
        "version": __version__,
    }
    return plain_data(contents)


def equation(effect: AbstractEffect) -> str:
    """What an effect is, with its equation: the first paragraph of its docstring, or its signature in data."""
    kind = type(effect)
    text = inspect.cleandoc(kind.__dict__.get("__doc__") or "").split("\n\n")[0]
    if text.startswith(f"{kind.__name__}("):  # what a dataclass without a docstring says
        text = ""
    return " ".join(text.replace("`", "").split()) or effect.signature


def _named(x) -> dict[str, Any]:
    return {
        "name": x.name,
        "joint": x.joint,
        "parameters": {name: _estimate(e) for name, e in x.parameters.items()},
        "p_value": x.p_value,
        "equivalent": list(x.equivalent),
        "separating_experiment": x.separating_experiment,
        "explains": x.explains,
        "visible": x.visible,
        "kind": "a number is wrong" if x.is_number else "a term is missing",
        "equation": equation(x.effect),
        "signature": x.effect.signature,
    }


def _wrong(x) -> dict[str, Any]:
    return {"name": x.name, **_estimate(x), "given": x.given, "change": x.change, "p_value": x.p_value}


def _ranked(x) -> dict[str, Any]:
    names = ("name", "joint", "score", "p_value", "expected", "visible", "why")
    return {name: getattr(x, name) for name in names}


def _cell(x) -> dict[str, Any]:
    return {name: getattr(x, name) for name in ("position", "channel", "band_hz", "z", "says")}


def _gap(gap, axes: tuple[str, ...]) -> dict[str, Any]:
    whole = {name: getattr(gap, name) for name in ("before", "after", "floor", "shrink", "unit", "on", "quantity")}
    each = {name: dict(zip(axes, getattr(gap, name), strict=True)) for name in ("torque_before", "torque_after")}
    return whole | each


def _estimate(x) -> dict[str, Any]:
    known = math.isfinite(x.std)
    interval = [x.value - NORMAL_95 * x.std, x.value + NORMAL_95 * x.std] if known else None
    return {"value": x.value, "std": x.std, "unit": x.unit, "interval95": interval}


def _parameters(d) -> dict[str, dict[str, Any]]:
    begun = _numbers(d.given)
    return {
        name: _estimate(x)
        | {
            "start": begun.get(name, _undone(x.value, d.changed.get(name, math.nan))),
            "identifiable": math.isfinite(x.std),
            "changed": d.changed.get(name),
        }
        for name, x in d.parameters.items()
    }


def _numbers(robot: Robot) -> dict[str, float]:
    """The robot's parameters that are single numbers."""
    found = parameters(robot, PARAMETER_UNITS)
    return {name: float(x) for name, x in found.items() if getattr(x, "ndim", 0) == 0}


def _undone(value: float, change: float) -> float:
    """The value before a relative change."""
    return value / (1.0 + change) if math.isfinite(change) and change != -1.0 else math.nan
