"""Whether the parameters of effects that were rightly named are what is true, and whether their intervals say so."""

import numpy as np
from _hidden_effects import MAIN


def errors(true: dict, named: dict) -> list[tuple[float, bool | None]]:
    """Relative error of every main parameter, and whether its 95 % interval holds the truth (`None`: there is none).

    What is true of a number of the robot is its whole difference from the given robot. Of waves the amplitudes of those
    orders are compared that were found at all.
    """
    return [_error(value, estimate) for value, estimate in _pairs(true, named.get("parameters") or {})]


def _pairs(true: dict, said: dict) -> list[tuple[float, dict]]:
    main, hidden = MAIN[true["name"]], true["parameters"]
    values = np.ravel(np.asarray(true.get("true", hidden.get(main)), float))
    if "order" not in hidden:
        return [(float(values[0]), said[main])] if (said.get(main) or {}).get("value") is not None else []
    found = {order: said[name.replace("order", main)] for name, order in _orders(said).items()}
    pairs = []
    for order, value in zip(np.ravel(hidden["order"]), values, strict=True):
        order = float(order) * float(hidden.get("teeth", 1.0))
        match = next((estimate for other, estimate in found.items() if abs(other - order) < 0.01 * order), None)
        if match is not None and match["value"] is not None:
            pairs.append((float(value), match))
    return pairs


def _orders(said: dict) -> dict[str, float]:
    """Of the waves that are told, by the name under which their order stands: order, order_1, order_2."""
    teeth = float((said.get("teeth") or {"value": 1.0})["value"])
    return {name: teeth * float(e["value"]) for name, e in said.items() if name.partition("_")[0] == "order"}


def _error(value: float, estimate: dict) -> tuple[float, bool | None]:
    interval = estimate.get("interval95")
    held = None if interval is None else bool(interval[0] <= value <= interval[1])
    return abs(float(estimate["value"]) - value) / abs(value), held
