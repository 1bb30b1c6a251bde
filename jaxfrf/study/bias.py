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
from ..graybox.slow_motion import response_at, response_in_motion
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


def true_response(
    robot: Robot, data: Experiment, frequency, amplitude=SLOW_AMPLITUDE
) -> Float[np.ndarray, "pos freq out in"]:
    """What a record would show of this robot without noise, distortion, ripple and finite length: the linearised robot
    at its true parameters with the describing gain of its friction, springs as stiff as over the motion, and the mean
    over the places to which the slow sine turns the arm (`jaxfrf.graybox.slow_motion`).

    **Arguments:** `frequency`: (freq,), Hz. `amplitude`: of the slow sine, motor side, (axis,), rad/s."""
    model, values = _linear(robot, amplitude)
    return response_in_motion(model, values, frequency, data)


def response_at_rest(robot: Robot, data: Experiment, frequency) -> Float[np.ndarray, "pos freq out in"]:
    """The same as if the arm were still, springs under gravity alone."""
    model, values = _linear(robot, SLOW_AMPLITUDE)
    return response_at(model, values, frequency, still(robot_points(robot, data)))


def _linear(robot: Robot, amplitude) -> tuple[RobotModel, dict[str, float]]:
    """The model whose response is the robot's, and its parameters."""
    amplitude = np.asarray(amplitude, float)
    friction = np.asarray(describing_friction(robot, amplitude))
    # Ripple has no linear response; without it the compiled response of the fits serves here, too.
    plain = tuple(e for e in robot.effects if not isinstance(e, TorqueRipple | ResolverRipple))
    model = RobotModel(dataclasses.replace(robot, effects=plain), slow_amplitude=amplitude)
    values = Coordinates(model.parameters).values(Coordinates(model.parameters).start())
    return model, values | {f"{axis}.effective_friction": f for axis, f in zip(robot.axis_names, friction, strict=True)}


def still(points: RobotPoint) -> RobotPoint:
    """The same operating points without motion, in the same shape, so that nothing is compiled anew."""
    return RobotPoint(points.q, np.zeros_like(points.deflections))


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
    """Table I at every position of a record, against the robot as the record moved it and at rest, as plain numbers."""
    found = estimates(data, settings)
    frequency = next(iter(found[settings.experiments[0]].values())).frequency
    truths = {
        "in motion": true_response(robot, data, frequency),
        "at rest": response_at_rest(robot, data, frequency),
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
