"""Table II: how far identified parameters are from the truth."""

import equinox as eqx
import jax.random as jr
import numpy as np

from .._text import NORMAL_95
from ..experiment import Experiment, concatenate
from ..frf import AbstractMethod
from ..graybox import (
    Fit,
    RobotModel,
    d_optimal,
    fit_indirectly,
    position_information,
    robot_points,
)
from ..graybox.fit import fit
from ..graybox.in_motion import fit_in_motion
from ..graybox.indirect import default_method, measured_frf
from ..robot import Robot, parameters, r3x, with_parameters
from ..simulation import random_positions
from .bias import first_experiments, measure, still
from .settings import OWN_METHODS, PAPER_METHODS, SLOW_AMPLITUDE, Settings, design, truth

STACKED = "LRM, JIO stacked"  # what indirect fits begin with; with one experiment there is only one
FRF_NOISE = 0.05  # relative, that the choice of positions assumes
STIFFNESS_SPREAD, DAMPING_SPREAD = 0.25, 1.0


AT_REST = {
    "arm as at rest": robot_points,
    "arm and springs as at rest": lambda robot, data: still(robot_points(robot, data)),
}
"""What the direct fit would be without its account of the motion of the experiment."""


class Row(eqx.Module):
    """One entry of Table II: a fit and how far its stiffnesses and dampings are from the truth.

    `errors`: relative, value/truth - 1. `z`: ln(value/truth) over its standard deviation.
    """

    experiments: int
    method: str
    seed: int
    errors: dict[str, float]
    z: dict[str, float]
    verdict: str
    close_starts: int
    misfit: float

    def as_dict(self) -> dict:
        size = {name: abs(e) for name, e in self.errors.items()}
        of = lambda kind: [e for name, e in size.items() if name.endswith(kind)]
        return {
            "experiments": self.experiments,
            "method": self.method,
            "seed": self.seed,
            "mean_bias": float(np.mean(list(size.values()))),
            "stiffness_bias": float(np.mean(of("stiffness"))),
            "damping_bias": float(np.mean(of("damping"))),
            "largest_stiffness_bias": float(np.max(of("stiffness"))),
            "largest_damping_bias": float(np.max(of("damping"))),
            "covered": float(np.mean([abs(z) < NORMAL_95 for z in self.z.values()])),
            "errors": self.errors,
            "verdict": self.verdict,
            "close_starts": self.close_starts,
            "misfit": self.misfit,
        }


def candidates(settings: Settings) -> np.ndarray:
    """All random arm configurations of a study, (pos, axis), rad."""
    return random_positions(settings.positions, jr.key(settings.position_seed))


def fit_positions(settings: Settings) -> tuple[int, ...]:
    """Numbers of the D-optimal positions, from the model as it is known before anything is fitted."""
    if settings.fit_positions >= settings.positions:
        return tuple(range(settings.positions))
    plan = design(1, 0)
    frequency = np.asarray(plan.lines) * plan.fs / plan.period
    before = RobotModel(start_robot(settings.position_seed))
    information = position_information(before, frequency, candidates(settings), FRF_NOISE)
    return d_optimal(information, settings.fit_positions)


def records(settings: Settings, robot: Robot, blocks: int, seed: int) -> Experiment:
    """The records at the fit positions, the same as those of Table I for its seed."""
    q = candidates(settings)
    return concatenate([measure(robot, q[i], i, blocks, seed) for i in fit_positions(settings)])


def start_robot(seed: int) -> Robot:
    """What a user knows before: R3X with stiffness off by 25 % and damping by a factor of e (one sigma of ln)."""
    rng = np.random.default_rng(seed)
    spread = lambda name: STIFFNESS_SPREAD if name.endswith("stiffness") else DAMPING_SPREAD
    known = {name: float(v) for name, v in parameters(r3x()).items()}
    return with_parameters(r3x(), {n: v * np.exp(spread(n) * rng.standard_normal()) for n, v in known.items()})


def start_model(seed: int) -> RobotModel:
    """The gray-box model at its start; spring shapes (ratio, knee), friction and rigid bodies are known."""
    return RobotModel(start_robot(seed), slow_amplitude=np.array(SLOW_AMPLITUDE))


def row(fitted: Fit, experiments: int, method: str, seed: int) -> dict:
    """An entry of Table II as plain numbers."""
    true = {name: float(v) for name, v in parameters(truth()).items()}
    found, std = fitted.values, dict(zip(fitted.coordinates.names, fitted.uncertainty.std, strict=True))
    errors = {n: found[n] / v - 1 for n, v in true.items()}
    z = {n: float(np.log(found[n] / v) / max(std.get(n, np.inf), 1e-300)) for n, v in true.items()}
    about = Row(
        experiments, method, seed, errors, z, fitted.verdict, fitted.close_starts, float(fitted.uncertainty.misfit)
    )
    return about.as_dict()


def direct_rows(settings: Settings, seed: int, data: Experiment, say=None) -> list[dict]:
    """Fits of the linear model to every FRF, at one seed; with the first seed also what is only for comparison."""
    model, rows, first = start_model(seed), [], seed == settings.seeds[0]
    for count in settings.experiments:
        part = first_experiments(data, count)
        for name, method in _fitted_methods(settings, count, extra=first).items():
            frf = measured_frf(part, method, model.quantity)
            fitted = fit_in_motion(model, part, frf, starts=settings.starts, key=jr.key(seed))
            rows.append(row(fitted, count, name, seed))
            if say is not None:
                say(f"{count} experiments, {name}: mean bias {100 * rows[-1]['mean_bias']:.1f} %")
            if name == "LRM, JIO" and first and settings.at_rest:
                for label, points in AT_REST.items():
                    at_rest = fit(
                        model, frf, starts=settings.starts, key=jr.key(seed), points=points(model.robot, part)
                    )
                    rows.append(row(at_rest, count, f"LRM, JIO, {label}", seed))
    return rows


def _fitted_methods(settings: Settings, count: int, extra: bool) -> dict[str, AbstractMethod]:
    """Estimators whose FRFs are fitted at this number of experiments; "auto" only as an extra."""
    every = PAPER_METHODS["many" if count > 1 else "one"] | OWN_METHODS
    wanted = settings.fitted if count > 1 else settings.fitted_single
    return {n: m for n, m in every.items() if n in wanted and (extra or n != "auto")}


def indirect_row(settings: Settings, seed: int, count: int, data: Experiment | None = None, say=None) -> dict:
    """The indirect fit at one seed."""
    if data is None:
        data = first_experiments(records(settings, truth(), 1, seed), count)
    found = fit_indirectly(
        start_model(seed),
        data,
        default_method(),
        starts=settings.starts,
        key=jr.key(seed),
        rounds=settings.rounds,
        say=say,
    )
    return row(found.fit, count, "indirect", seed) | {
        "direct": row(found.direct, count, STACKED if count > 1 else "LRM, JIO", seed),
        "converged": found.converged,
        "gap_db": [c.gap_db for c in found.corrections],
    }
