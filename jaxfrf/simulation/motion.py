"""All coordinates of a simulated robot while it plays the references of a record, not only what its sensors see."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..experiment import Experiment
from ..robot import Robot
from .closed_loop import ClosedLoop, LoopState, Runs
from .experiment import study_of_record
from .runs import Progress, record


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

    They take (dof + 2 axis)/(2 axis) times the memory of a record. **Raises:** as `replay`.
    """
    study = study_of_record(robot, data, None, 0.0, run_in, steps)
    u, y, z = record(study, chunk, progress, _play_with_coordinates)
    return Motion(u, y, z, data.fs)


@jax.jit
def _play_with_coordinates(loop: ClosedLoop, state: LoopState, runs: Runs, start, references):
    """As `closed_loop.play`, with the coordinates at every sample, (time, dof, run)."""

    def step(state, now):
        time, reference = now
        after, (torque, reading) = loop.sample(state, time, reference[:, :, runs.track], runs)
        return after, (torque, reading, state.z)

    times = start + jnp.arange(references.shape[0])
    state, (torque, reading, z) = jax.lax.scan(step, state, (times, references))
    return state, torque, reading, z
