"""The verb: all uncertain numbers of a robot from records, through the experiment."""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._errors import InputError, input_error
from .._types import require_x64
from ..effects import Payload
from ..experiment import Experiment
from ..identification.model import check_data
from ..parts import Parts
from ..robot import Robot
from ..simulation.checks import check_fit
from ..trajectory.evidence import Evidence, Weighed, placed, precise, refloored, weigh
from ..trajectory.following import compared, why_followed
from ..trajectory.joined import joined, places, together
from ..trajectory.measured import Measured, measured
from ..trajectory.ripple import Order, order_columns, ripple_effects
from .columns import near_rest_columns, number_columns
from .from_motion import calibrate_from_motion, check_rigid
from .heldout import heldout_numbers
from .least_squares import Posterior, solve
from .numbers import Number, numbers, with_numbers
from .remainder import remainder, usual_size
from .result import Calibration, Round
from .ripple import sure_orders, with_found_orders
from .rounds import Kept, Rounds

_LONGEST = 0.5  # of a logarithm, in one step: columns hold no further
_HALVINGS = 3
_WORSE = 1.02  # of the misfit: a step that leaves more is halved
_REWEIGHED = 2  # times in a round
_FEW, _BANDS = 4, 8  # runs whose scatter says too little: bands of lines stand for runs then
_NOTHING = 1e-12  # tolerances: what rounding moved
_GAIN = 0.97  # of the misfit: a step that leaves more is of no use
_STAYS = 0.3  # of its standard deviation that every number moves less
_LOOKS_FOR_RIPPLE = 4  # first rounds in which more orders are looked for: far from the truth some are not there

Say = Callable[[str], None]


class Look(eqx.Module):
    """One simulation of the robot at x, and the step that it asks for.

    **Fields:** `misfit`: mean square over the plain floor that ripple alone leaves. `left`: what all columns leave.
    """

    x: Float[np.ndarray, "number"]
    evidence: Evidence = eqx.field(static=True)
    weighed: Weighed
    orders: tuple[Order, ...]
    posterior: Posterior = eqx.field(static=True)
    misfit: float
    left: float


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
    ripple, to first order along the simulated motion, with the robot's tolerances as what is known before. The robot so
    found is simulated again, until it stays: Gauss-Newton on the maximum a posteriori, lines weighed by what the model
    leaves around them. Without references, without a controller, or where the controller runs at another rate than the
    log, the motors are moved as measured instead (`trajectory/following.py`).

    How friction turns over near standstill is left open (two more columns a motor), so that another law there does not
    go into viscous friction.

    Intervals come from the scatter between positions (between runs, where there are less than three positions; between
    bands of lines, where there are less than four runs), so that errors
    of the model which repeat from line to line count, and from the tolerances. **Biased** where the robot lacks an
    effect: what repeats from position to position is not in the intervals; `jaxfrf.gap.diagnose` looks for it.

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
    - `parts`: keeps finished rounds (`jaxfrf.parts.Parts`), so that an interrupted run goes on where it was.
    - `say`: called with a line of progress.

    **Raises:** `jaxfrf.InputError` if robot and data do not fit together, if nothing is uncertain, and where the robot
    as given cannot be simulated.
    """
    require_x64("calibrate")
    records = [data] if isinstance(data, Experiment) else list(data)
    say = say or (lambda text: None)
    if not robot.n_motors and not robot.n_elastic:
        return calibrate_from_motion(robot, records, _carried(payloads, records), heldout, 4 * rounds, cutoff, say)
    for record in records:
        _check(robot, record)
    data = joined(records)
    each = [len(r.q) * r.n_exp // together(records) for r in records]
    carried = [p for p, times in zip(_carried(payloads, records), each, strict=True) for _ in range(times)]
    these = numbers(robot)
    if not these:
        raise input_error(
            f"{robot.name}: tolerances", "0 for every number", "something that is not exact", "State a tolerance."
        )
    fitted, judged = _split(measured(data, carried if any(p is not None for p in carried) else ()), heldout)
    kept = Rounds(parts, robot, these, fitted, heldout)
    search = _Search(robot, fitted, these, say)
    look, converged = search.run(rounds, kept)
    return _result(robot, these, look, [one.round for one in kept.done], converged, fitted, judged)


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
    if not why_followed(robot, data):
        check_fit(robot, data.fs, data.r.shape[3], "record")


def _split(record: Measured, heldout: Sequence[int]) -> tuple[Measured, Measured | None]:
    n, held = record.data.n_pos, heldout_numbers(heldout, record.data.n_pos)
    if not held:
        return record, None
    return record.at([p for p in range(n) if p not in held]), record.at(held)


class _Search:
    """What stays the same from round to round, and the floor, which follows what is left."""

    def __init__(self, robot: Robot, record: Measured, these: Sequence[Number], say: Say):
        self.robot, self.record, self.these, self.say = robot, record, these, say
        self.floor: np.ndarray | None = None
        self.near_rest = near_rest_columns(robot)

    def run(self, rounds: int, kept: Rounds) -> tuple[Look, bool]:
        """The last look, and whether the numbers stay; from where an earlier run was interrupted."""
        if kept.done:
            last = kept.done[-1]
            self.floor = last.floor
            look = self.look(last.x, last.orders, False)
            self.say(f"goes on behind round {len(kept.done)}")
        else:
            look = self.look(np.zeros(len(self.these)), (), True)
            self.tell(look, kept)
        converged = self.stays(look)
        while len(kept.done) < rounds and not converged:
            further = self.further(look, len(kept.done) < _LOOKS_FOR_RIPPLE)
            if further is None:
                self.say("no step makes the misfit smaller")
                break
            look = further
            self.tell(look, kept)
            converged = self.stays(look)
        return look, converged

    def tell(self, look: Look, kept: Rounds) -> None:
        found = Round(look.misfit, look.left, look.posterior.effect)
        kept.keep(Kept(look.x, look.orders, look.evidence.floor, found))
        self.say(
            f"round {len(kept.done)}: {look.misfit**0.5:.3g} times the floor, {look.left**0.5:.3g} after its step; "
            f"{len(look.orders)} orders of ripple, {look.posterior.effect:.3g} lines count as one"
        )

    def look(self, x, orders: tuple[Order, ...], more: bool) -> Look:
        """Simulate, differentiate, solve; `more`: whether to look for more orders of ripple."""
        now = with_numbers(self.robot, self.these, x)
        evidence = Evidence(now, self.record)
        if self.floor is not None:
            evidence.floor = self.floor
        own = number_columns(self.robot, self.these, x)
        weighed = weigh(evidence, [*own, *self.near_rest, *order_columns(orders)])
        posterior = solve(weighed.gram, self.these, x)
        if more:
            orders, weighed = with_found_orders(evidence, weighed, orders, posterior.change)
            posterior = solve(weighed.gram, self.these, x)
        misfit = _misfit(evidence, weighed, np.arange(len(self.these), weighed.gram.b.shape[1]))
        for _ in range(_REWEIGHED):
            left = remainder(evidence, weighed, posterior.change)
            floor = usual_size(left, evidence.noise)
            weighed = refloored(weighed, evidence.floor, floor)
            evidence.floor = floor
            posterior = solve(weighed.gram, self.these, x)
        runs = len(weighed.gram.A)
        weighed = precise(weighed, _BANDS) if runs < _FEW else placed(precise(weighed), places(self.record.data))
        posterior = solve(weighed.gram, self.these, x)
        self.floor = evidence.floor
        left = remainder(evidence, weighed, posterior.change)
        return Look(np.asarray(x, float), evidence, weighed, orders, posterior, misfit, _square(left / evidence.plain))

    def further(self, look: Look, more: bool) -> Look | None:
        """The next robot, by a step that is short enough to leave less."""
        sure = sure_orders(look.orders, look.posterior)
        orders = tuple(o for o, is_sure in zip(look.orders, sure, strict=True) if is_sure)
        # Orders that go take nothing away any more: what they took is no reason to refuse a step.
        kept = np.flatnonzero(np.concatenate([np.ones(len(self.near_rest), bool), np.repeat(sure, 2)]))
        before = _misfit(look.evidence, look.weighed, len(self.these) + kept)
        step = look.posterior.change[: len(self.these)]
        longest = max((abs(n.size * s) for n, s in zip(self.these, step, strict=True) if n.positive), default=0.0)
        part = min(1.0, _LONGEST / longest) if longest > 0 else 1.0
        for _ in range(_HALVINGS):
            try:
                found = self.look(look.x + part * step, orders, more)
            except InputError as error:
                self.say(f"a step too far: {error}")
            else:
                if found.misfit < _WORSE * before or part * longest < 0.02:
                    return found
            part /= 2
        return None

    def stays(self, look: Look) -> bool:
        """Whether the next step would be small beside what is known of every number, and take little off the misfit.
        How Coulomb friction is smoothed has no true value where a machine's friction is another law: it may creep."""
        step, count = look.posterior.change, len(self.these)
        std = np.sqrt(np.diag(look.posterior.covariance))
        counts = np.array([n.kind != "smoothing" for n in self.these])
        small = np.abs(step[:count]) < _STAYS * std[:count]
        return bool(np.all(small[counts])) and look.left > _GAIN * look.misfit


def _square(z) -> float:
    return 0.5 * float(np.mean(np.abs(z) ** 2))


def _misfit(evidence: Evidence, weighed: Weighed, ripple) -> float:
    """Of the robot as it was simulated, what these columns explain taken away; over the plain floor."""
    gram = weighed.gram
    A, b = gram.A.sum(axis=0)[np.ix_(ripple, ripple)], gram.b.sum(axis=0)[ripple]
    change = np.zeros(gram.b.shape[1])
    if len(b):
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        change[ripple] = np.linalg.lstsq(A / np.outer(size, size), b / size, rcond=1e-7)[0] / size
    return _square(remainder(evidence, weighed, change) / evidence.plain)


def _result(robot: Robot, these, look: Look, rounds, converged: bool, fitted: Measured, judged) -> Calibration:
    posterior, count = look.posterior, len(these)
    x = look.x + posterior.change[:count] if converged else look.x
    x = np.where(np.abs(x) < _NOTHING, 0.0, x)
    sure = sure_orders(look.orders, posterior)
    waves = posterior.change[len(posterior.change) - 2 * len(look.orders) :].reshape(-1, 2)
    kept = [i for i, is_sure in enumerate(sure) if is_sure]
    orders = tuple(look.orders[i] for i in kept)
    found = with_numbers(robot, these, x).with_effects(*ripple_effects(robot.axis_names, orders, waves[kept]))
    part = slice(0, count)
    return Calibration(
        given=robot,
        robot=found,
        numbers=tuple(these),
        x=x,
        covariance=posterior.covariance[part, part],
        half_width=posterior.half_width()[part],
        told=posterior.told[part],
        dependence=np.linalg.inv(posterior.normal)[part, part],
        orders=orders,
        waves=waves[kept],
        rounds=tuple(rounds),
        converged=converged,
        missed_before=missed(Evidence(robot, fitted), fitted),
        missed_after=missed(Evidence(found, fitted), fitted),
        heldout=None if judged is None else _missed_pair(robot, found, judged),
        compared=compared(robot, fitted.data),
        sources=fitted.data.sources,
    )


def missed(evidence: Evidence, record: Measured) -> Float[np.ndarray, "axis"]:
    """Torque that the simulated robot misses, of the measured torque without its mean, rms by axis."""
    squares = lambda x: np.sum(np.abs(x[:, :, 1:]) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(evidence.residual) / squares(record.U))


def _missed_pair(before: Robot, after: Robot, record: Measured):
    return tuple(missed(Evidence(robot, record), record) for robot in (before, after))
