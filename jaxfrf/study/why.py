"""Why the robot's tables come out as they do: the same experiment with one disturbance taken away at a time."""

from collections.abc import Callable

import jax.random as jr
import numpy as np

from ..robot import Robot, parameters, r3x, r3x_ripple, with_parameters
from ..simulation import simulate
from .bias import bias_at
from .parameters import candidates, fit_positions
from .settings import Settings, design

POSITIONS = 2  # of the fit positions


def _without(robot: Robot, kind: str, value: float) -> Robot:
    return with_parameters(robot, dict.fromkeys(parameters(robot, (kind,)), value))


def _everything() -> Robot:
    return r3x().with_effects(*r3x_ripple())


VARIANTS: dict[str, tuple[str, Callable[[], Robot], float]] = {
    "everything": ("everything switched on", _everything, 5e-5),
    "no-ripple": ("without ripple", r3x, 5e-5),
    "linear-springs": ("with linear springs", lambda: _without(_everything(), "stiffness_ratio", 1.0), 5e-5),
    "no-coulomb": ("without Coulomb friction", lambda: _without(_everything(), "coulomb_friction", 0.0), 5e-5),
    "noise-only": (
        "linear: noise only",
        lambda: _without(_without(r3x(), "stiffness_ratio", 1.0), "coulomb_friction", 0.0),
        5e-5,
    ),
    "noise-free": (
        "linear, no noise: bias of the estimators alone",
        lambda: _without(_without(r3x(), "stiffness_ratio", 1.0), "coulomb_friction", 0.0),
        0.0,
    ),
}
"""Name: what it is, the robot, and the position noise (rad)."""


def variant_row(settings: Settings, name: str) -> dict:
    """Table I (six experiments and one) of a variant, mean over a few positions."""
    text, robot, noise = VARIANTS[name]
    robot, found = robot(), []
    for number in fit_positions(settings)[:POSITIONS]:
        data = simulate(
            robot,
            design(1, settings.seeds[0]),
            candidates(settings)[number][None],
            key=jr.fold_in(jr.key(1000 + settings.seeds[0]), number),
            noise=noise,
        )
        found.append(bias_at(robot, data, (6, 1)))
    mean = lambda measure, count, method: float(
        np.mean([np.mean(p[measure]["in motion"][count][method]) for p in found])
    )
    return {
        "text": text,
        **{
            measure: {
                count: {method: mean(measure, count, method) for method in found[0][measure]["in motion"][count]}
                for count in ("6", "1")
            }
            for measure in ("bias", "level_db")
        },
    }
