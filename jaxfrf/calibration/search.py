"""One robot on its way by Gauss-Newton: simulated, differentiated, moved."""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._errors import InputError
from .._threads import lapack_threads, shared
from ..robot import Robot
from ..simulation import finest_smoothing
from ..trajectory.evidence import Column, Evidence, Weighed, placed, precise, refloored, weigh
from ..trajectory.joined import places
from ..trajectory.measured import Measured
from ..trajectory.remainder import remainder, usual_size
from ..trajectory.ripple import Order, order_columns
from .columns import number_columns
from .least_squares import Posterior, solve, with_bands
from .numbers import Number, with_numbers
from .ripple import order_key, sure_orders, with_found_orders

_LONGEST = 0.5  # of a logarithm, in one step: columns hold no further
_HALVINGS = 3
_WORSE = 1.02  # of the misfit: a step that leaves more is halved
_REWEIGHED = 2  # times in a round
_FEW, _BANDS = 4, 8  # runs whose scatter says too little: bands of lines stand for runs then
_FINE_BANDS = 24  # of lines, beside positions
_GAIN = 0.97  # of the misfit: a step that leaves more is of no use
_STAYS = 0.3  # of its standard deviation that every number moves less

_TURN = 0.3  # of the logarithm of the friction's smoothing, by which its column is simulated
_SAME_TURN = 0.1  # of that logarithm: a column is not simulated again
_FARTHEST_TURN = 1.0  # of that logarithm, in one step
_AT_BOUND = 1e-9
_MARGIN = 1.03  # between the sharpest friction that steps follow and the one that is simulated

Say = Callable[[str], None]


class Look(eqx.Module):
    """One simulation of the robot at x, and the step that it asks for.

    **Fields:** `misfit`: mean square over the plain floor that ripple alone leaves. `left`: what all columns leave.
    `begun`: the floor that it began with, and with which it can be made again; `None`: the plain one.
    """

    x: Float[np.ndarray, "number"]
    evidence: Evidence = eqx.field(static=True)
    weighed: Weighed
    orders: tuple[Order, ...]
    posterior: Posterior = eqx.field(static=True)
    misfit: float
    left: float
    begun: Float[np.ndarray, "line axis"] | None


class Search:
    """What stays the same from round to round, and the floor, which follows what is left.

    `beside`: columns that stand beside those of the numbers. `inside`: orders of ripple that the robot has, whose
    columns correct them. `turns`: whether the column of the friction's smoothing is the difference of two simulations:
    a motor that stands still for a moment moves as its friction lets it, and the column along a given motion is many
    times too large. The smoothing is not simulated finer than the robot's steps follow; beyond, its column stands
    beside the robot.

    All rounds with their beginning and end: `descent`."""

    def __init__(
        self,
        robot: Robot,
        record: Measured,
        these: Sequence[Number],
        say: Say,
        beside: Sequence[Column] = (),
        inside: Sequence[Order] = (),
        turns: bool = False,
    ):
        self.robot, self.record, self.these, self.say = robot, record, these, say
        kinds = [n.kind for n in these]
        self.smoothing = kinds.index("smoothing") if "smoothing" in kinds else -1
        self.turns = turns and self.smoothing >= 0
        self._turned: tuple[float, np.ndarray] | None = None
        self.floor: np.ndarray | None = None
        self.beside = tuple(beside)
        self.inside = {order_key(o) for o in inside}

    def look(self, x, orders: tuple[Order, ...], more: bool) -> Look:
        """Simulate, differentiate, solve; `more`: whether to look for more orders of ripple."""
        x = self.followed(x)
        evidence, *turned = shared(
            lambda x: Evidence(with_numbers(self.robot, self.these, x), self.record),
            [x, *self._to_turn(x)],
            lapack_threads(),
        )
        begun = self.floor
        if begun is not None:
            evidence.floor = begun
        own = number_columns(self.robot, self.these, x)
        if self.turns:
            own[self.smoothing] = self._turning(x, evidence, turned)
        weighed = weigh(evidence, [*own, *self.beside, *order_columns(orders)])
        posterior = solve(weighed.gram, self.these, x)
        if more:
            orders, weighed = with_found_orders(evidence, weighed, orders, posterior.change)
            posterior = solve(weighed.gram, self.these, x)
        free = np.arange(len(self.these), weighed.gram.b.shape[1])
        misfit = _misfit(evidence, weighed, np.concatenate([self._at_bound(x), free]))
        for _ in range(_REWEIGHED):
            left = remainder(evidence, weighed, posterior.change)
            floor = usual_size(left, evidence.noise)
            weighed = refloored(weighed, evidence.floor, floor)
            evidence.floor = floor
            posterior = solve(weighed.gram, self.these, x)
        runs = len(weighed.gram.A)
        weighed = precise(weighed, _BANDS) if runs < _FEW else placed(precise(weighed), places(self.record.data))
        posterior = solve(weighed.gram, self.these, x)
        if runs >= _FEW:
            posterior = with_bands(posterior, weighed, _FINE_BANDS)
        self.floor = evidence.floor
        left = remainder(evidence, weighed, posterior.change)
        left_square = mean_square(left / evidence.plain)
        return Look(np.asarray(x, float), evidence, weighed, orders, posterior, misfit, left_square, begun)

    def further(self, look: Look, more: bool) -> Look | None:
        """The next robot, by a step that is short enough to leave less."""
        sure = sure_orders(look.orders, look.posterior)
        sure = [is_sure or order_key(o) in self.inside for o, is_sure in zip(look.orders, sure, strict=True)]
        orders = tuple(o for o, is_sure in zip(look.orders, sure, strict=True) if is_sure)
        # Orders that go take nothing away any more: what they took is no reason to refuse a step.
        kept = np.flatnonzero(np.concatenate([np.ones(len(self.beside), bool), np.repeat(sure, 2)]))
        before = _misfit(look.evidence, look.weighed, np.concatenate([self._at_bound(look.x), len(self.these) + kept]))
        step, part, longest = self._step(look)
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

    def next(self, look: Look) -> Float[np.ndarray, "number"]:
        """Where the step goes, no further than columns hold."""
        step, part, _ = self._step(look)
        return look.x + part * step

    def _step(self, look: Look):
        step = look.posterior.change[: len(self.these)].copy()
        if self.turns:
            farthest = _FARTHEST_TURN / self.these[self.smoothing].size
            step[self.smoothing] = np.clip(step[self.smoothing], -farthest, farthest)
        lengths = [abs(n.size * s) for n, s in zip(self.these, step, strict=True) if n.positive and not self._turn(n)]
        longest = max(lengths, default=0.0)
        return step, min(1.0, _LONGEST / longest) if longest > 0 else 1.0, longest

    def _turn(self, number: Number) -> bool:
        return self.turns and number.kind == "smoothing"

    def _finest(self, x) -> float:
        """Where the friction's smoothing is what the robot's steps follow, as a coordinate."""
        number = self.these[self.smoothing]
        now = with_numbers(self.robot, self.these, x)
        return number.coordinate(_MARGIN * finest_smoothing(now, like=self.robot))

    def followed(self, x) -> Float[np.ndarray, "number"]:
        """The same coordinates, the friction no sharper than it is simulated."""
        x = np.array(x, float)
        if self.turns:
            x[self.smoothing] = max(x[self.smoothing], self._finest(x))
        return x

    def _at_bound(self, x) -> np.ndarray:
        """The smoothing's column, where it may not become less."""
        if self.turns and x[self.smoothing] <= self._finest(x) + _AT_BOUND:
            return np.array([self.smoothing])
        return np.array([], int)

    def _to_turn(self, x) -> list[np.ndarray]:
        """Where the robot is simulated, too, for the column of its friction's smoothing; nowhere, where another round
        had nearly the same."""
        if not self.turns:
            return []
        size, at = self.these[self.smoothing].size, float(x[self.smoothing])
        if self._turned is not None and abs(at - self._turned[0]) * size <= _SAME_TURN:
            return []
        more = x.copy()
        more[self.smoothing] += _TURN / size
        return [more]

    def _turning(self, x, evidence: Evidence, turned: Sequence[Evidence]) -> Column:
        """The column of the friction's smoothing, by this other simulation or that of another round."""
        for other in turned:
            slope = (evidence.residual - other.residual) * (self.these[self.smoothing].size / _TURN)
            self._turned = float(x[self.smoothing]), slope
        assert self._turned is not None
        columns = {id(scene): column for scene, column in zip(evidence.scenes, self._turned[1], strict=True)}
        return lambda scene: columns[id(scene)]

    def stays(self, look: Look) -> bool:
        """Whether the next step would be small beside what is known of every number, and take little off the misfit.
        How Coulomb friction is smoothed has no true value where a machine's friction is another law: it may creep."""
        step, count = look.posterior.change, len(self.these)
        std = np.sqrt(np.diag(look.posterior.covariance))
        counts = np.array([n.kind != "smoothing" for n in self.these])
        small = np.abs(step[:count]) < _STAYS * std[:count]
        return bool(np.all(small[counts])) and look.left > _GAIN * look.misfit


def mean_square(z) -> float:
    return 0.5 * float(np.mean(np.abs(z) ** 2))


def _misfit(evidence: Evidence, weighed: Weighed, ripple) -> float:
    """Of the robot as it was simulated, what these columns explain taken away; over the plain floor."""
    gram = weighed.gram
    A, b = gram.A.sum(axis=0)[np.ix_(ripple, ripple)], gram.b.sum(axis=0)[ripple]
    change = np.zeros(gram.b.shape[1])
    if len(b):
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        change[ripple] = np.linalg.lstsq(A / np.outer(size, size), b / size, rcond=1e-7)[0] / size
    return mean_square(remainder(evidence, weighed, change) / evidence.plain)
