"""The verb: all uncertain numbers of a robot from records, through the experiment."""

import operator
from collections.abc import Callable, Sequence

import numpy as np

from .._arguments import expect, expect_each
from .._errors import input_error
from .._threads import one_blas_thread
from .._types import require_x64
from ..effects import Payload
from ..experiment import Experiment
from ..parts import Parts
from ..robot import Robot
from ..simulation.checks import check_data, check_fit
from ..trajectory.evidence import Evidence
from ..trajectory.following import why_followed
from ..trajectory.joined import joined, together
from ..trajectory.measured import Measured, measured, turned
from ..trajectory.rigid_motion import check_rigid
from ..trajectory.ripple import with_ripple
from ..trajectory.standing import misplaced
from ..trajectory.wiring import LOST, miswired
from .alignment import Aligned, aligned
from .columns import near_rest_columns
from .descent import Descent
from .from_motion import calibrate_from_motion
from .heldout import heldout_numbers
from .numbers import numbers, with_numbers
from .result import Calibration, missed
from .rounds import Rounds

_NOTHING = 1e-12  # tolerances: what rounding moved

Say = Callable[[str], None]


@one_blas_thread
def calibrate(
    robot: Robot,
    data: Experiment | Sequence[Experiment],
    *,
    payloads: Sequence[Payload | None] = (),
    heldout: Sequence[int] = (),
    rounds: int = 12,
    cutoff: float | None = None,
    parts: Parts | None = None,
    say: Say | None = None,
) -> Calibration:
    """Fit everything that is not exactly known of a robot to records.

    **A robot with rigid transmissions**, from any motion, periodic or not: the torque that it needs for the measured
    motion, filtered and thinned as the measured one. No reference and no controller are needed.

    **Any other robot**, from periodic records: the robot plays the references of the record; what its motors give less
    than measured, at every line from the steady torque to the highest excited one, is explained by its numbers and by
    ripple, to first order along the simulated motion, with the robot's tolerances as what is known before. Its
    controller has the gains that the record shows (`trajectory/controller.py`). The robot so found is simulated again,
    until it converges: Gauss-Newton on the maximum a posteriori, lines weighed by what the model leaves around them.
    Without references, without a controller, where the record contradicts its law, or where it runs at another rate
    than the log, the motors are moved as measured instead (`trajectory/following.py`). Signals that stand late in the
    log, by that law and by the motion, are taken back first (`calibration/alignment.py`), which `compared` says.

    Ripple stands beside the robot until its numbers are near. Then it is simulated, too, with the orders that were
    found, and looked for again: friction does not meet motors that turn evenly.

    How friction turns over near standstill is left open (up to four more columns a motor: three widths, as far as they
    are well below its speed, and the moment), so that another law there goes neither into viscous friction nor into
    inertia. The speed over which it does, `friction.smoothing`, is no sharper than the steps of the robot's simulation
    follow; a machine that sticks is fitted beyond that to first order.

    Intervals come from the scatter between positions (between runs, where there are less than three positions; between
    bands of lines, where there are less than four runs) and between bands of lines, so that errors of the model which
    repeat from line to line, or from position to position, count; and from the tolerances. **Biased** where the robot
    lacks an effect: what is alike at all positions and in all bands is not in the intervals; `jaxfrf.gap.diagnose`
    looks for it.

    **Arguments:**

    - `robot`: its `controller` may be unknown (`None`); `robot.tolerances` say how well its numbers are known.
    - `data`: records with arm configurations `q`; `r` may be missing. Several records may differ in their places,
      amplitudes and numbers of experiments.
    - `payloads`: that the robot carries in each of several records beside what it is given with, exactly known, with
      their `place`; `None` for nothing.
    - `heldout`: numbers of positions, from 0 and through all records, that are not fitted, and on which the result is
      judged.
    - `rounds`: of simulation, at most.
    - `cutoff`: of the motion's filter, Hz, of a robot with rigid transmissions.
    - `parts`: keeps finished rounds (`jaxfrf.Parts`), so that an interrupted run goes on where it was.
    - `say`: called with a line of progress.

    **Returns:** a `Calibration`: the robot as found, every number with its interval, what the data tell of it.

    **Raises:** `jaxfrf.InputError` if robot and data do not fit together, if nothing is uncertain, and where the robot
    as given cannot be simulated.

    **Source:** Khalil & Dombre, Modeling, Identification and Control of Robots, 2002 (rigid robots: torque over
    filtered motion); Tarantola, Inverse Problem Theory, 2005 (Gauss-Newton with what is known before); Cameron, Gelbach
    & Miller, J. Business & Economic Statistics 29 (2011) 238-249 (intervals from clusters of two kinds). The rounds
    through the simulated experiment are this project's own.
    """
    expect("robot", robot, Robot)
    require_x64("calibrate")
    if not isinstance(data, Experiment):
        expect_each("data", data, Experiment)
    records = [data] if isinstance(data, Experiment) else list(data)
    say = say or (lambda text: None)
    if not robot.n_motors and not robot.n_elastic:
        return calibrate_from_motion(robot, records, _carried(payloads, records), heldout, 4 * rounds, cutoff, say)
    for record in records:
        _check(robot, record)
    data = joined(records)
    each = [r.n_pos * r.n_exp // together(records) for r in records]
    carried = [p for p, times in zip(_carried(payloads, records), each, strict=True) for _ in range(times)]
    uncertain = numbers(robot)
    if not uncertain:
        raise input_error(
            f"{robot.name}: tolerances", "0 for every number", "something that is not exact", "State a tolerance."
        )
    carried = carried if any(p is not None for p in carried) else []
    log = aligned(data, robot, lambda x: _split(measured(x, carried), heldout), operator.itemgetter(0))
    shown, (fitted, judged) = log.shown, log.parts
    if log.late:
        say(f"in the log {log.late}: taken back")
    if shown.says():
        say(f"controller: {shown.says()}")
    kept = Rounds(parts, shown.robot, uncertain, fitted, heldout)
    descent = Descent(shown.robot, fitted, uncertain, say, near_rest_columns(robot, fitted))
    descent.run(rounds, kept)
    return _result(robot, log, descent, kept, judged)


def _carried(payloads: Sequence[Payload | None], records: Sequence[Experiment]) -> list[Payload | None]:
    """The payload of every record."""
    found = list(payloads) or [None] * len(records)
    if len(found) != len(records):
        raise input_error(
            "payloads", f"{len(found)} of {len(records)} records", "one for each record", "Give None where it is none."
        )
    for payload in found:
        if payload is not None and payload.place is None:
            raise input_error(
                "payloads", "one without a place", "its centre in the link's frame, m", "Give place = [x, y, z]."
            )
    return found


def _check(robot: Robot, data: Experiment) -> None:
    if not data.period:
        check_rigid(robot)
    check_data(robot, data)
    if data.r is not None and not why_followed(robot, data):
        check_fit(robot, data.fs, data.r.shape[3], "record")


def _split(record: Measured, heldout: Sequence[int]) -> tuple[Measured, Measured | None]:
    n, held = record.data.n_pos, heldout_numbers(heldout, record.data.n_pos)
    if not held:
        return record, None
    return record.at([p for p in range(n) if p not in held]), record.at(held)


def _result(given: Robot, log: Aligned, descent: Descent, kept: Rounds, judged: Measured | None) -> Calibration:
    robot, uncertain, iterate, fitted = descent.robot, descent.numbers, descent.iterate, descent.record
    posterior, count = iterate.posterior, len(uncertain)
    x = np.where(np.abs(descent.x) < _NOTHING, 0.0, descent.x)
    waves = descent.found_waves
    found = with_numbers(with_ripple(robot, waves), uncertain, x)
    part = slice(0, count)
    missed_before, missed_after = kept.done[0].missed, missed(Evidence(found, fitted), fitted)
    lost = np.max(missed_before) > LOST and np.max(missed_after) > LOST
    return Calibration(
        given=given,
        robot=log.shown.restored(found),
        numbers=tuple(uncertain),
        x=x,
        covariance=posterior.covariance[part, part],
        half_width=posterior.half_width()[part],
        data_share=posterior.data_share[part],
        dependence=np.linalg.inv(posterior.normal)[part, part],
        orders=tuple(o for o, _ in waves),
        waves=np.array([w for _, w in waves]).reshape(-1, 2),
        rounds=tuple(one.round for one in kept.done),
        converged=descent.settled,
        missed_before=missed_before,
        missed_after=missed_after,
        heldout=None if judged is None else _missed_pair(robot, found, judged),
        compared=log.compared(),
        sources=fitted.data.sources,
        hints=miswired(robot, fitted.U[:, :, 1:], Evidence(robot, fitted).U[:, :, 1:]) if lost else (),
        misplaced=misplaced(given, log.data),
        turned=tuple(turned(fitted).tolist()),
    )


def _missed_pair(before: Robot, after: Robot, record: Measured):
    return tuple(missed(Evidence(robot, record), record) for robot in (before, after))
