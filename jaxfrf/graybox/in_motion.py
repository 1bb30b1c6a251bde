"""The direct fit to the FRF of a record: the linear model, as the motion of the experiment shows it."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import PRNGKeyArray

from .._text import number
from ..experiment import Experiment
from ..frf import FRF
from .corrections import Correction, next_point, settled, updated
from .cost import vec
from .deflections import points_under, varying_gear_torque
from .fit import Fit, fit, fit_target
from .model import RobotModel, starting_at
from .slow_motion import SlowMotion, moving_response, response_at, slow_limit, slow_motion
from .solver import AbstractSolver, LevenbergMarquardt
from .target import Target, Weights, shifted, target

_AGAIN = 6  # fits in motion


def fit_in_motion(
    model: RobotModel,
    data: Experiment,
    measured: FRF,
    *,
    weights: Weights | None = None,
    solver: AbstractSolver | None = None,
    starts: int | Sequence[Mapping[str, float]] = 20,
    key: PRNGKeyArray | None = None,
    say: Callable[[str], None] | None = None,
) -> Fit:
    """Fit a robot's parameters to the FRF of a record, without simulating the record.

    `fit`, for the motion of the experiment: nonlinear springs at their mean stiffness over it, and in place of the
    response of an arm at rest that of an arm in slow motion (`moving_response`: the sine that keeps joints sliding
    turns an arm by degrees, its modes move along, and their mean looks like damping). Both depend on the parameters:
    they are found again at the result, and the fit goes on from there until it converges.

    Biased by what no linear response has: friction that comes and goes with the slow motion counts as a constant
    viscous one, a local estimator smooths sharp resonances. `fit_indirectly` takes that out.

    **Arguments:**

    - `model`: `jaxfrf.RobotModel` of the robot.
    - `data`: periodic records with arm configurations q.
    - `measured`: their FRF, in the quantity of the model.
    - `say`: called with a line of what was found in the motion. `weights`, `solver`, `starts`, `key`: as in
      `jaxfrf.fit`.

    **Returns:** a `Fit`, as of `jaxfrf.fit`.

    **Raises:** `jaxfrf.InputError` as `jaxfrf.fit` does, and for records without period or configurations.

    **Source:** as of `jaxfrf.fit`; the mean response over a slow motion is this project's own.
    """
    weights = Weights() if weights is None else weights
    solver = LevenbergMarquardt() if solver is None else solver
    torque, q = varying_gear_torque(model.robot, data), np.asarray(data.q)
    points = points_under(model.robot, q, torque)
    found = fit(model, measured, weights=weights, solver=solver, starts=starts, key=key, points=points)
    slow = slow_motion(model.robot, data, slow_limit(measured.frequency))
    if slow is not None and say is not None:
        turn = np.rad2deg(np.abs(slow.q - q[:, None]).max())
        say(f"slow motion turns the arm by up to {number(turn, 2)} degrees: fitted is its mean response over the way")
    x, history = np.asarray(found.x), []
    for _ in range(_AGAIN):
        values = {n: float(v) for n, v in found.coordinates.values(x).items()}
        begin = starting_at(model, values)
        tg = target(measured, weights, points_under(begin.at(values), q, torque))
        if slow is not None:
            tg = _as_moving(begin, values, tg, q, slow)
        last = fit_target(begin, tg, solver, 1)
        history.append(Correction(x, updated(found.coordinates, last), 0.0, 0.0))
        if slow is None or settled(history[-1], found.coordinates, last).all():
            break
        x = next_point(history, found.coordinates, last)
    blind = tuple(dict.fromkeys((*found.without_sensitivity, *last.without_sensitivity)))
    return dataclasses.replace(last, starts=found.starts, without_sensitivity=blind)


def _as_moving(model: RobotModel, values: dict, tg: Target, q, slow: SlowMotion) -> Target:
    """The target for a model of the arm at rest, where the arm was in slow motion."""
    moving = moving_response(model, values, tg.frequency, q, slow)
    linear = response_at(model, values, tg.frequency, tg.points)
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.log(np.asarray(vec(moving / linear)))
    return shifted(tg, shift, tg.points)
