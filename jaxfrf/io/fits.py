"""fit.json: what a fit found and what is known of it, as plain data.

    parameters     {name: {value, std, unit, start, identifiable, interval95, nuisance}}, names as `joint1.stiffness`;
                   std in the unit of the value, null where the response does not depend on the parameter
    fixed          {name: value} of the parameters that were held
    cost, expected_cost, misfit
    starts         {number, within_1_percent, best_cost, costs, paths}: the cost of every start, and after every step
    result         unimodal, multimodal, at a bound or not identifiable; `explanation` says it in sentences
    correlations   [{between: [name, name], value}], those above .9 in size
    heldout        what the fit is worth at positions that were not fitted; null where there were none

The other fields are those of `jaxfrf.Identification`. Standard JSON: what is not finite is null.
"""

import json
import os
import pathlib
from collections.abc import Mapping
from typing import Any

from .._arguments import expect_path
from .._errors import input_error
from ..graybox import AbstractModel, Fit
from ._json import plain_data as plain_data, write_json

_INDIRECT_BEFORE = "through the experiment"  # as the kind was called at first


def write_fit(path: str | os.PathLike, contents: Mapping[str, Any]) -> None:
    """Write plain data (numbers, texts, arrays, lists, dictionaries) as JSON, whole or not at all.

    **Arguments:** `path`: of the file, `fit.json` by habit. `contents`: fields by name; what is not finite becomes
    null.

    **Raises:** `jaxfrf.InputError` if the folder is not there.
    """
    expect_path("path", path)
    write_json(path, contents)


def read_fit(path: str | os.PathLike) -> dict[str, Any]:
    """What `write_fit` wrote: dictionaries, lists, numbers, texts and `None`; `kind` as it is called now.

    **Arguments:** `path`: of a fit.json.

    **Returns:** its fields by name, numbers in the units that stand beside them.

    **Raises:** `jaxfrf.InputError` if the file is missing, no JSON, or holds no fit.
    """
    expect_path("path", path)
    path = pathlib.Path(path)
    if not path.is_file():
        raise input_error(str(path), "no such file", "a fit.json", "Check the name and the folder.")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise input_error(str(path), f"no JSON ({error})", "a fit.json", "Write it again.") from error
    if not isinstance(found, dict) or "parameters" not in found:
        raise input_error(str(path), "JSON without parameters", "what `jaxfrf identify` writes", "Name that file.")
    return found | {"kind": "indirect"} if found.get("kind") == _INDIRECT_BEFORE else found


def fit_contents(fitted: Fit, begun: AbstractModel) -> dict[str, Any]:
    """Parameters, cost, verdict and correlations of a fit as they stand in fit.json; `begun`: the model as given."""
    return {
        "parameters": _parameters(fitted, begun),
        "fixed": {n: fitted.values[n] for n, p in begun.parameters.items() if not p.free and p.same_as is None},
        "cost": fitted.cost,
        "expected_cost": fitted.uncertainty.expected_cost,
        "misfit": fitted.uncertainty.misfit,
        "result": fitted.verdict,
        "explanation": fitted.explain(),
        "correlations": [
            {"between": list(pair), "value": rho} for pair, rho in fitted.uncertainty.correlations().items()
        ],
    }


def starts_contents(fitted: Fit) -> dict[str, Any]:
    """What became of every start."""
    return {
        "number": len(fitted.starts),
        "within_1_percent": fitted.close_starts,
        "best_cost": min(s.cost for s in fitted.starts),
        "costs": [s.cost for s in fitted.starts],
        "polished": [s.polished for s in fitted.starts],
        "paths": [s.path_cost for s in fitted.starts],
    }


def _parameters(fitted: Fit, begun: AbstractModel) -> dict[str, dict[str, Any]]:
    std, interval, values = fitted.std, fitted.interval(), fitted.values
    known = dict(zip(fitted.coordinates.names, fitted.uncertainty.identifiable, strict=True))
    at_bound = fitted.coordinates.at_bound(fitted.x)
    found = {}
    for name, p in begun.parameters.items():
        own = p.same_as or name  # a shared parameter knows what its owner knows
        if not begun.parameters[own].free:
            continue
        found[name] = {
            "value": values[name],
            "std": std.get(own),
            "unit": p.unit,
            "start": float(begun.parameters[own].start),
            "identifiable": bool(known.get(own, False)),
            "interval95": interval.get(own),
            "at_bound": own in at_bound,
            "nuisance": p.nuisance,
            **({"same_as": p.same_as} if p.same_as else {}),
        }
    return found
