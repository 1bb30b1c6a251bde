"""Table I: how far estimated amplitudes are from the truth."""

import dataclasses

import equinox as eqx
import jax.random as jr
import numpy as np
from jaxtyping import Float

from .._types import Array
from ..effects import ResolverRipple, TorqueRipple
from ..experiment import Experiment
from ..frf import FRF, estimate
from ..graybox import Coordinates, RobotModel, RobotPoint, robot_points
from ..graybox.slow_motion import response_at
from ..robot import Robot, describing_friction
from ..simulation import simulate
from ..spectra import dft, with_output_quantity
from .settings import SLOW_AMPLITUDE, Settings, design, methods

OFF_DIAGONAL = 0.2  # weight beside 1 on the diagonal


def weights(n: int) -> Float[np.ndarray, "out in"]:
    """Elementwise weights of the bias: 1 on the diagonal, .2 elsewhere, scaled to a matrix 2-norm of 1."""
    W = np.full((n, n), OFF_DIAGONAL)
    np.fill_diagonal(W, 1.0)
    return W / np.linalg.norm(W, 2)


def amplitude_bias(G: Float[Array, "freq out in"], truth: Float[Array, "freq out in"]) -> float:
    """Mean over the lines of || W o (|G_true| - |G|) ||_2, the paper's bias with elementwise weights (`weights`).

    In units of G: rad/s^2 per N m for accelerations. Lines at which the estimate is not finite are left out.
    """
    difference = np.abs(np.asarray(truth)) - np.abs(np.asarray(G))
    finite = np.isfinite(difference).all(axis=(-1, -2))
    return float(np.mean(np.linalg.norm(weights(G.shape[-1]) * difference[finite], 2, axis=(-2, -1))))


def level_error(G: Float[Array, "freq out in"], truth: Float[Array, "freq out in"]) -> list[float]:
    """Mean over the lines of |20 log10(|G_ii|/|G_true,ii|)| for every diagonal element, dB: in which stiff and light
    axes count alike."""
    diagonal = lambda x: np.abs(np.diagonal(np.asarray(x), axis1=-2, axis2=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.abs(20 * np.log10(diagonal(G) / diagonal(truth)))
    return [float(x) for x in np.nanmean(np.where(np.isfinite(level), level, np.nan), axis=0)]


def true_response(robot: Robot, points: RobotPoint, frequency) -> Float[np.ndarray, "pos freq out in"]:
    """The linearised robot at its true parameters, with the describing gain of its friction.

    Springs as stiff as they are over the motion in `points`."""
    amplitude = np.array(SLOW_AMPLITUDE)
    friction = np.asarray(describing_friction(robot, amplitude))
    # Ripple has no linear response; without it the compiled response of the fits serves here, too.
    plain = tuple(e for e in robot.effects if not isinstance(e, TorqueRipple | ResolverRipple))
    model = RobotModel(dataclasses.replace(robot, effects=plain), slow_amplitude=amplitude)
    values = Coordinates(model.parameters).values(Coordinates(model.parameters).start())
    values |= {f"{axis}.effective_friction": f for axis, f in zip(robot.axis_names, friction, strict=True)}
    return response_at(model, values, frequency, points)


def still(points: RobotPoint) -> RobotPoint:
    """The same operating points without motion, in the same shape, so that nothing is compiled anew."""
    return RobotPoint(points.q, np.zeros_like(points.swing))


def measure(robot: Robot, q: Float[np.ndarray, "axis"], number: int, blocks: int, seed: int) -> Experiment:
    """The record at one position: six experiments for every block; phases from `seed`, noise also from the number of
    the position."""
    key = jr.fold_in(jr.key(1000 + seed), number)
    # Two blocks of runs, one for each core.
    return simulate(robot, design(blocks, seed), np.asarray(q)[None], key=key, chunk=3 * blocks)


def measure_all(robot: Robot, q: Float[np.ndarray, "pos axis"], blocks: int, seed: int) -> Experiment:
    """The record at all positions, simulated together."""
    return simulate(robot, design(blocks, seed), q, key=jr.key(1000 + seed), chunk=6 * blocks)


def first_experiments(data: Experiment, count: int) -> Experiment:
    """The record with its first experiments only."""
    cut = lambda x: x[:, :count]
    return eqx.tree_at(lambda d: (d.u, d.y, d.r), data, (cut(data.u), cut(data.y), cut(data.r)))


def estimates(data: Experiment, settings: Settings) -> dict[int, dict[str, FRF]]:
    """FRFs to acceleration by every method at every number of experiments."""
    found: dict[int, dict[str, FRF]] = {}
    for count in settings.experiments:
        spectra = with_output_quantity(dft(first_experiments(data, count)), "acceleration")
        found[count] = {name: estimate(spectra, method) for name, method in methods(count, settings).items()}
    return found


def bias_at(robot: Robot, data: Experiment, settings: Settings) -> list[dict]:
    """Table I at every position of a record, against the robot at rest and over its motion, as plain numbers."""
    found = estimates(data, settings)
    frequency = next(iter(found[settings.experiments[0]].values())).frequency
    points = robot_points(robot, data)
    truths = {
        "at rest": true_response(robot, still(points), frequency),
        "in motion": true_response(robot, points, frequency),
    }
    measures = {"bias": amplitude_bias, "level_db": level_error}
    return [
        {
            measure: {
                name: {
                    str(count): {method: function(frf.G[pos], G[pos]) for method, frf in by.items()}
                    for count, by in found.items()
                }
                for name, G in truths.items()
            }
            for measure, function in measures.items()
        }
        for pos in range(data.n_pos)
    ]
