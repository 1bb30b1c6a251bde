"""Why the robot's tables come out as they do: the same experiment with one disturbance taken away at a time."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.random as jr
import numpy as np

from ..experiment import concatenate
from ..graybox import RobotModel
from ..graybox.in_motion import fit_in_motion
from ..graybox.indirect import default_method, measured_frf
from ..robot import Robot, parameters, r3x, with_parameters
from ..simulation import simulate
from .bias import bias_at
from .parameters import candidates, fit_positions, row, start_robot
from .settings import SLOW_AMPLITUDE, Settings, design, truth

POSITIONS = 2  # of the fit positions, for the FRFs


def _without(robot: Robot, kind: str, value: float) -> Robot:
    return with_parameters(robot, dict.fromkeys(parameters(robot, (kind,)), value))


def _linear() -> Robot:
    return _without(_without(r3x(), "stiffness_ratio", 1.0), "coulomb_friction", 0.0)


class Variant(eqx.Module):
    """An experiment with something taken away: `text`, the `robot`, position `noise` (rad), and whether the `slow` sine
    is played."""

    text: str = eqx.field(static=True)
    robot: Callable[[], Robot] = eqx.field(static=True)
    noise: float = eqx.field(static=True, default=5e-5)
    slow: bool = eqx.field(static=True, default=True)


VARIANTS: dict[str, Variant] = {
    "everything": Variant("everything switched on", truth),
    "no-ripple": Variant("without ripple", r3x),
    "linear-springs": Variant("with linear springs", lambda: _without(truth(), "stiffness_ratio", 1.0)),
    "no-coulomb": Variant("without Coulomb friction", lambda: _without(truth(), "coulomb_friction", 0.0)),
    "noise-only": Variant("linear robot: noise alone", _linear),
    "noise-free": Variant("linear robot, no noise", _linear, noise=0.0),
    "no-slow-sine": Variant("linear robot, no noise, no slow sine", _linear, noise=0.0, slow=False),
}


def variant_row(settings: Settings, name: str) -> dict:
    """A variant: FRF bias at a few positions from six experiments and one, and the direct fit to all fit positions."""
    variant = VARIANTS[name]
    robot, records, seed = variant.robot(), [], settings.seeds[0]
    plan = design(1, seed, variant.slow)
    for number in fit_positions(settings):
        key = jr.fold_in(jr.key(1000 + seed), number)
        q = candidates(settings)[number][None]
        records.append(simulate(robot, plan, q, key=key, noise=variant.noise, chunk=3))
    one_block = dataclasses.replace(settings, blocks=1)
    found = [bias for data in records[:POSITIONS] for bias in bias_at(robot, data, one_block)]
    mean = lambda measure, count, method: float(
        np.mean([np.mean(p[measure]["in motion"][count][method]) for p in found])
    )
    levels = {
        measure: {
            count: {method: mean(measure, count, method) for method in found[0][measure]["in motion"][count]}
            for count in ("6", "1")
        }
        for measure in ("bias", "level_db")
    }
    return {"text": variant.text, **levels, "parameters": _fitted(settings, robot, concatenate(records))}


def _fitted(settings: Settings, robot: Robot, data) -> dict:
    """The direct fit of the variant's own linear model, from the start that all fits have."""
    seed = settings.seeds[0]
    known = {n: float(v) for n, v in parameters(start_robot(seed)).items()}
    own = with_parameters(dataclasses.replace(robot, effects=()), known)
    model = RobotModel(own, slow_amplitude=np.array(SLOW_AMPLITUDE))
    frf = measured_frf(data, default_method(), model.quantity)
    fitted = fit_in_motion(model, data, frf, starts=settings.starts, key=jr.key(seed))
    return row(fitted, 6, "direct, LRM, JIO stacked", seed)
