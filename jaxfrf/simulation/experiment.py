"""From a design, or from what a record says was played, to the record of a simulated experiment."""

import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._arguments import as_key, expect
from .._errors import input_error
from .._types import Array, require_x64
from ..excitation import Multisine
from ..experiment import Experiment
from ..robot import Robot
from .checks import at_limits, check_fit, check_noise, check_positions, check_runs, loop_at_rest, soft_springs
from .references import references_of_design, references_of_record
from .runs import Progress, Study, record


def simulate(
    robot: Robot,
    design: Multisine,
    positions: Float[Array, "pos axis"],
    *,
    key: PRNGKeyArray,
    run_in: float | None = 5.0,
    noise: float = 5e-5,
    steps: int | None = None,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Experiment:
    """Play a design on a simulated robot at every position, in closed loop, and record it.

    `r` is the speed reference, `u` the torque command at its sample, held until the next, `y` the measured
    motor *position* (what a resolver gives, ripple and noise included): states differentiate it in frequency,
    `jaxfrf.with_output_quantity(jaxfrf.dft(data), "acceleration")`, which is exact. The motor turns about its
    position at rest in the arm configuration. Reference and phases come from `design.seed`, noise from `key`;
    a run's noise depends on its position's and experiment's number only, not on `chunk`.

    **Arguments:**

    - `robot`: with a controller and the sampling frequency of `design`, a `Multisine`.
    - `positions`: arm angles at rest, (pos, axis), rad.
    - `run_in`: seconds of the periodic motion before the first recorded sample, faded in from rest; the record
      then holds steady periods only. `None`: the transient periods of the design are played and recorded.
    - `noise`: standard deviation of white noise on the measured motor position, rad.
    - `steps`: Runge-Kutta steps in a control sample; as many as `fine_steps` finds necessary by default.
    - `chunk`: runs that are computed together on one core; it changes speed and memory, not the result.
    - `progress`: called with the part that is done, from 0 to 1.

    What the record is not good for (motors at their limits, springs that give way) stands in its `warnings`.

    **Returns:** the record, an `Experiment` with `u` (N m), `y` (rad) and `r` (rad/s), each (pos, exp, time, axis).

    **Raises:** `jaxfrf.InputError` where robot, design and positions do not fit together, and where runs
    diverge: it names positions and experiments, and nothing is recorded then.

    **Source:** the paper (Zimmermann & Moberg), section III.A (equations of motion) and IV.A (controller, ripple,
    noise); classical Runge-Kutta steps; the arm's inertia, which is held over a control sample, is this project's own
    short cut.
    """
    study = study_of_design(robot, design, positions, key, run_in, noise, steps)
    check_runs(design, len(positions))
    u, y = record(study, chunk, progress)
    return Experiment(
        warnings=(*soft_springs(robot, study.point, design), *at_limits(robot, u)),
        u=u,
        y=y,
        r=_at_every_position(played(study), u),
        q=np.asarray(positions, float),
        fs=design.fs,
        period=design.period,
        lines=design.lines,
        transient_periods=design.transient_periods if run_in is None else 0,
        y_quantity="position",
    )


def study_of_design(
    robot: Robot, design: Multisine, positions, key: PRNGKeyArray, run_in: float | None, noise: float, steps: int | None
) -> Study:
    """The runs that play a design at every position, as in `simulate`."""
    expect("robot", robot, Robot)
    expect("design", design, Multisine)
    require_x64("A simulation")
    check_fit(robot, design.fs, design.n_in, "design")
    positions = check_positions(robot, positions)
    check_noise(noise)
    loop, point = loop_at_rest(robot, positions, noise, steps)
    return Study(loop, references_of_design(design, run_in), point, as_key("key", key), design.n_exp)


def played(study: Study) -> Float[np.ndarray, "exp time axis"]:
    """The speed references of one position for as long as a record lasts."""
    velocity = study.references.velocity
    return np.tile(velocity, (1, study.references.recorded // velocity.shape[1], 1))


def replay(
    robot: Robot,
    data: Experiment,
    *,
    key: PRNGKeyArray | None = None,
    noise: float = 0.0,
    run_in: float = 5.0,
    steps: int | None = None,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Experiment:
    """Play the references of a record, measured or simulated, on a simulated robot in closed loop.

    What the robot should have answered to the same experiment. Of a periodic record the mean of the steady
    periods of `r` is played, periodically and faded in from rest as in `simulate`; the result holds one steady
    period. The position reference is the zero-mean periodic integral of `r`, exact below half the sampling
    frequency, about the motor position at rest in `data.q`. A mean of `r` below .01 rad (arm side) in a period
    is an offset of the recording and removed; where `r` is a position, its mean *is* the position at rest.

    A record that is not periodic (`period` 0) is played once, from rest at `data.q` at its first sample, whole
    and without run-in: the position is the integral of the cubic spline through `r` (or the speed its derivative,
    where `r` is a position): within 3e-5 up to a twenty-fifth of the sampling frequency, but for the derivative in
    the first and last samples.

    Without noise the result is deterministic. Robots that differ in the values of their parameters only share
    what is compiled; say `steps` where these values could change what `fine_steps` finds.

    **Arguments:**

    - `robot`: with a controller and the sampling frequency of the record.
    - `data`: with `r`, (pos, exp, time, axis), as velocity or position, and `q`, (pos, axis); its `u` and `y`
      are not used. References may differ from position to position.
    - `key`, `noise`: white noise on the measured motor position, standard deviation in rad; as in `simulate`.
    - `run_in`: seconds of the periodic motion before the first recorded sample.
    - `steps`, `chunk`, `progress`: as in `simulate`.

    **Returns:** the record: `u` the torque command, `y` the measured motor *position* (`y_quantity`
    "position"), `r` as played, in the quantity of `data.r`; `q`, `lines`, `fs` and `period` those of `data`.

    **Raises:** `jaxfrf.InputError` without `r` or `q`, where the record does not fit the robot, where `r` has a
    mean that lets the motors drift away, and where runs diverge.

    **Source:** `jaxfrf.simulate`, with the references of a record; a workflow of this project.
    """
    expect("robot", robot, Robot)
    expect("data", data, Experiment)
    check_noise(noise)
    if noise and key is None:
        raise input_error("key", "none", f"a key for a noise of {noise:g} rad", "Give key=jax.random.key(0).")
    study = study_of_record(robot, data, key, noise, run_in, steps)
    u, y = record(study, chunk, progress)
    reference = study.references.velocity if data.r_quantity == "velocity" else study.references.position
    return Experiment(
        warnings=at_limits(robot, u),
        u=u,
        y=y,
        r=_at_every_position(reference, u),
        q=np.asarray(data.q, float),
        fs=data.fs,
        period=data.period,
        lines=data.lines,
        r_quantity=data.r_quantity,
        y_quantity="position",
    )


def study_of_record(
    robot: Robot, data: Experiment, key: PRNGKeyArray | None, noise: float, run_in: float, steps: int | None
) -> Study:
    """The runs that play the references of a record, as in `replay`."""
    require_x64("A simulation")
    _check_record(data)
    check_fit(robot, data.fs, np.asarray(data.r).shape[3], "record")
    positions = check_positions(robot, data.q)
    references = references_of_record(robot, data, run_in)
    loop, point = loop_at_rest(robot, positions, noise, steps)
    return Study(loop, references, point, as_key("key", 0 if key is None else key), data.n_exp)


def _check_record(data: Experiment) -> None:
    for name, what in (("r", "the references that were played"), ("q", "the arm configuration of every position")):
        if getattr(data, name) is None:
            raise input_error(name, "none", f"{what} to the robot", "Record it, or name its variable in --map.")


def _at_every_position(tracks: Float[np.ndarray, "track time axis"], like: np.ndarray) -> np.ndarray:
    """(pos, exp, time, axis) as `like`; without copies where all positions share the tracks."""
    return np.broadcast_to(tracks.reshape(-1, *like.shape[1:]), like.shape)
