"""All coordinates of a simulated robot while it plays the references of a record, not only what its sensors see."""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Bool, Float

from .._compile import program
from .._types import arrays
from ..experiment import Experiment
from ..robot import Robot
from .checks import check_positions, equilibria
from .closed_loop import ClosedLoop, LoopState, Runs
from .experiment import study_of_record
from .imposed import Imposed, impose
from .references import References
from .runs import Player, Progress, Records, Study, record

# Run-ins, s: a longer one at positions where after the one before a period does not end as it began.
_IN_LOOP = (2.9, 8.0)  # controllers damp
_IMPOSED = (10.0, 30.0, 90.0)  # an arm on motors that are held swings for as long as its gears let it
_COMPARED = 0.1  # s, of the beginning of a period with that of the next
_SETTLED = 2e-5  # of an axis' torque, rms: by such a transient lines are off by some 1e-4 of theirs, rms


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
    run_in: float | None = None,
    steps: int | None = None,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Motion:
    """As `replay` without noise, and the coordinates of motors, arm and elastic joints with it.

    They take (dof + 2 axis)/(2 axis) times the memory of a record.

    **Arguments:** `robot`, `data`, `steps`, `chunk`, `progress`: as of `jaxfrf.replay`. `run_in`: s, as there; by
    default 2.9, and 8 at positions where a period then does not end as it began.

    **Returns:** a `Motion`: u in N m, y and z in rad, each (pos, exp, time, channel).

    **Raises:** as `jaxfrf.replay`.

    **Source:** as of `jaxfrf.replay`.
    """
    study = study_of_record(robot, data, None, 0.0, run_in or 0.0, steps)
    lengths = _IN_LOOP if run_in is None and data.period else ()
    u, y, z = _settled(study, lengths, chunk, progress, _play_with_coordinates)
    return Motion(u, y, z, data.fs)


def _settled(
    study: Study, run_ins: Sequence[float], chunk: int, progress: Progress | None, player: Player
) -> tuple[Records, ...]:
    """A period that begins as the next one, after the first of these run-ins, s, that is long enough at its position;
    where there are none, as the study has it."""
    if not run_ins:
        return record(study, chunk, progress, player)
    references, fs = study.references, study.loop.fs
    period, more = references.recorded, math.ceil(_COMPARED * fs)
    positions = range(len(study.point.z))
    found: tuple[Records, ...] = ()
    for length in run_ins:
        lasting = dataclasses.replace(references, run_in=math.ceil(length * fs), recorded=period + more)
        played = record(dataclasses.replace(study, references=lasting), chunk, progress, player, positions)
        steady = tuple(x[:, :, :period] for x in played)
        for whole, part in zip(found, steady, strict=False):  # none yet after the first run-in
            whole[positions.start : positions.stop] = part
        found = found or steady
        late = positions.start + np.flatnonzero(~_are_settled(played[0], more))
        if not len(late):
            break
        positions, progress = range(late[0], late[-1] + 1), None
    return found


def _are_settled(u: Float[np.ndarray, "pos exp time axis"], more: int) -> Bool[np.ndarray, "pos"]:
    """At which positions a period begins as the next one, of which `more` samples follow it."""
    off = np.sqrt(np.mean((u[:, :, :more] - u[:, :, -more:]) ** 2, axis=2))
    return np.all(off <= _SETTLED * np.sqrt(np.mean(np.var(u, axis=2), axis=(0, 1))), axis=(1, 2))


def imposed_motion(
    robot: Robot,
    speed: Float[np.ndarray, "run time axis"],
    angle: Float[np.ndarray, "run time axis"],
    data: Experiment,
    *,
    run_in: float | None = None,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Motion:
    """What a robot's motors need to move on given periodic courses, and what else moves with them.

    No controller takes part, and no torque limit. Motors are on their courses at every sample, by cubics between;
    `u` is the mean of the torque that acts on them from a sample to the next (of a torque T(omega): T times
    e^{j omega/2fs} sinc(omega/2fs)).

    **Arguments:** `robot`: without its controller. `speed`, `angle`: of the motors as their sensors show them, rad/s
    and rad about rest, one period, for run number position * n_exp + experiment; sampled at the robot's
    `sampling_frequency`. `data`: arm configurations, and how many experiments there are. `run_in`: s; by
    default 10, and up to 90 at positions where a period then does not end as it began. `chunk`, `progress`: as of
    `jaxfrf.simulate`.

    **Returns:** a `Motion`: u in N m, y and z in rad, each (pos, exp, time, channel).

    **Raises:** `jaxfrf.InputError` where the robot has no equilibrium, or where the arm diverges.

    **Source:** inverse dynamics of motors whose motion is given, the arm by Runge-Kutta steps: this project's own.
    """
    robot = arrays(robot)
    point = equilibria(robot, check_positions(robot, data.q), limited=False)
    fs, ahead = robot.sampling_frequency, lambda x: np.roll(x, -1, axis=1)  # a sample ends on its reference
    references = References(ahead(speed), ahead(angle), fs, math.ceil((run_in or 0.0) * fs), angle.shape[1])
    study = Study(Imposed.of(robot), references, point, jr.key(0), data.n_exp)
    u, y, z = _settled(study, _IMPOSED if run_in is None else (), chunk, progress, impose)
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
