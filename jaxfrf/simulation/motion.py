"""All coordinates of a simulated robot while it plays the references of a record, not only what its sensors see."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Float

from .._compile import program
from .._types import arrays
from ..experiment import Experiment
from ..robot import Robot
from .checks import check_positions, equilibria
from .closed_loop import ClosedLoop, LoopState, Runs
from .experiment import study_of_record
from .imposed import Imposed, impose
from .references import References
from .runs import Progress, Study, record


class Motion(eqx.Module):
    """A simulated experiment with what moved inside.

    **Fields:** `u`: torque command, N m, and `y`: measured motor position, rad, each (pos, exp, time, axis); `z`:
    coordinates [q_m, q_a, q_e] at the sample instants, (pos, exp, time, dof), rad; `fs`: Hz. One steady period where
    the record is periodic.
    """

    u: Float[np.ndarray, "pos exp time axis"]
    y: Float[np.ndarray, "pos exp time axis"]
    z: Float[np.ndarray, "pos exp time dof"]
    fs: float = eqx.field(static=True)


def replay_motion(
    robot: Robot,
    data: Experiment,
    *,
    run_in: float = 5.0,
    steps: int | None = None,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Motion:
    """As `replay` without noise, and the coordinates of motors, arm and elastic joints with it.

    They take (dof + 2 axis)/(2 axis) times the memory of a record.

    **Arguments:** `robot`, `data`, `run_in` (s), `steps`, `chunk`, `progress`: as of `jaxfrf.replay`.

    **Returns:** a `Motion`: u in N m, y and z in rad, each (pos, exp, time, channel).

    **Raises:** as `jaxfrf.replay`.

    **Source:** as of `jaxfrf.replay`.
    """
    study = study_of_record(robot, data, None, 0.0, run_in, steps)
    u, y, z = record(study, chunk, progress, _play_with_coordinates)
    return Motion(u, y, z, data.fs)


def imposed_motion(
    robot: Robot,
    speed: Float[np.ndarray, "run time axis"],
    angle: Float[np.ndarray, "run time axis"],
    data: Experiment,
    *,
    run_in: float = 5.0,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Motion:
    """What a robot's motors need to move on given periodic courses, and what else moves with them.

    No controller takes part, and no torque limit. Motors are on their courses at every sample, by cubics between;
    `u` is the mean of the torque that acts on them from a sample to the next (of a torque T(omega): T times
    e^{j omega/2fs} sinc(omega/2fs)).

    **Arguments:** `robot`: without its controller. `speed`, `angle`: of the motors as their sensors show them, rad/s
    and rad about rest, one period, for run number position * n_exp + experiment; sampled at the robot's
    `sampling_frequency`. `data`: arm configurations, and how many experiments there are. `run_in`: s. `chunk`,
    `progress`: as of `jaxfrf.simulate`.

    **Returns:** a `Motion`: u in N m, y and z in rad, each (pos, exp, time, channel).

    **Raises:** `jaxfrf.InputError` where the robot has no equilibrium, or where the arm diverges.

    **Source:** inverse dynamics of motors whose motion is given, the arm by Runge-Kutta steps: this project's own.
    """
    robot = arrays(robot)
    point = equilibria(robot, check_positions(robot, data.q), limited=False)
    fs, ahead = robot.sampling_frequency, lambda x: np.roll(x, -1, axis=1)  # a sample ends on its reference
    references = References(ahead(speed), ahead(angle), fs, math.ceil(run_in * fs), angle.shape[1])
    study = Study(Imposed.of(robot), references, point, jr.key(0), data.n_exp)
    u, y, z = record(study, chunk, progress, impose)
    return Motion(u, y, z, fs)


@program
def _play_with_coordinates(loop: ClosedLoop, state: LoopState, runs: Runs, start, references):
    """As `closed_loop.play`, with the coordinates at every sample, (time, dof, run)."""

    def step(state, now):
        time, reference = now
        after, (torque, reading) = loop.sample(state, time, reference[:, :, runs.track], runs)
        return after, (torque, reading, state.z)

    times = start + jnp.arange(references.shape[0])
    state, (torque, reading, z) = jax.lax.scan(step, state, (times, references))
    return state, torque, reading, z
