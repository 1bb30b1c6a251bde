"""One robot on its way by Gauss-Newton: simulated, differentiated, moved."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from .._errors import InputError
from .._threads import lapack_threads, shared
from ..robot import Robot
from ..simulation import smoothing_factor
from ..trajectory.evidence import Column, Evidence, Weighed, has_few_runs, refloored, scattered, weigh
from ..trajectory.joined import places
from ..trajectory.measured import Measured
from ..trajectory.remainder import remainder, usual_size
from ..trajectory.ripple import Order, order_columns
from .columns import number_columns
from .least_squares import Posterior, solve, with_bands
from .numbers import Number, prior_cost, with_numbers
from .ripple import order_key, sure_orders, with_found_orders

_LONGEST = 0.5  # of a logarithm, in one step: columns hold no further
_HALVINGS = 3
_WORSE = 1.02  # of the misfit: a step that leaves more is halved
_REWEIGHED = 2  # times in a round
_FINE_BANDS = 24  # of lines, beside positions
_GAIN = 0.97  # of the misfit: a step that leaves more is of no use
_CONVERGED = 0.3  # of its standard deviation that every number moves less

_PERTURBATION = 0.3  # of the logarithm of the friction's smoothing, by which its column is simulated
_SAME_COLUMN = 0.1  # of that logarithm: a column is not simulated again
_FARTHEST = 1.0  # of that logarithm, in one step
_AT_BOUND = 0.01  # of that logarithm, that a smoothing may not become less by
_TURNS = 6  # of a secant, whose function is nearly straight
_ROUNDING = 1e-9
_NOTHING = 1e-9  # squares over the floor that one unit of a column takes: less is none
_MARGIN = 1.03  # between the sharpest friction that steps follow and the one that is simulated

Say = Callable[[str], None]


class Difference(eqx.Module):
    """The column of a smoothing of friction as the difference of two simulations: `slope`, N m per unit of the
    coordinate, at the coordinate `at`."""

    at: float
    slope: Complex[np.ndarray, "pos exp line axis"]


class Iterate(eqx.Module):
    """A point x of the Gauss-Newton search: the robot simulated there, and the step that follows.

    **Fields:** `misfit`: mean square over the plain floor that ripple alone leaves. `left`: what all columns leave;
    `rest`: that itself, N m. `differences`: the columns of smoothings, by their names, where they were simulated.
    `start_floor`: the floor that it began with, and with which it can be made again; `None`: the plain one.
    """

    x: Float[np.ndarray, "number"]
    evidence: Evidence = eqx.field(static=True)
    weighed: Weighed
    orders: tuple[Order, ...]
    posterior: Posterior = eqx.field(static=True)
    misfit: float
    left: float
    rest: Complex[np.ndarray, "pos exp line axis"]
    differences: dict[str, Difference]
    start_floor: Float[np.ndarray, "line axis"] | None

    def without_columns(self) -> "Iterate":
        """The same with the columns' products alone: columns are most of the memory."""
        return dataclasses.replace(self, weighed=Weighed((), self.weighed.gram))


class Search:
    """What stays the same from round to round, and the floor, which follows what is left.

    `beside`: columns that stand beside those of the numbers. `inside`: orders of ripple that the robot has, whose
    columns correct them. `by_difference`: whether the columns of smoothings, of the friction's and of its effects', are
    differences of two simulations: a motor that stands still for a moment moves as its friction lets it, and a column
    along a given motion is many times too large. Nothing is simulated finer than the robot's steps follow; beyond,
    columns stand beside the robot. `differences`: these columns, where they are known from another robot nearby.

    All rounds with their beginning and end: `descent`."""

    def __init__(
        self,
        robot: Robot,
        record: Measured,
        numbers: Sequence[Number],
        say: Say,
        beside: Sequence[Column] = (),
        inside: Sequence[Order] = (),
        by_difference: bool = False,
        differences: Mapping[str, Difference] = MappingProxyType({}),
    ):
        self.robot, self.record, self.numbers, self.say = robot, record, numbers, say
        self.by_difference = [i for i, n in enumerate(numbers) if n.kind == "smoothing" and by_difference]
        self._differences = dict(differences)
        self.floor: np.ndarray | None = None
        self.beside = tuple(beside)
        self.inside = {order_key(o) for o in inside}

    def evaluate(self, x, orders: tuple[Order, ...], more: bool) -> Iterate:
        """Simulate, differentiate, solve; `more`: whether to look for more orders of ripple."""
        x = self.followed(x)
        perturbed = self._perturbed(x)
        evidence, *others = shared(
            lambda x: Evidence(with_numbers(self.robot, self.numbers, x), self.record),
            [x, *perturbed.values()],
            lapack_threads(),
        )
        for i, other in zip(perturbed, others, strict=True):
            slope = (evidence.residual - other.residual) * (self.numbers[i].size / _PERTURBATION)
            self._differences[self.numbers[i].name] = Difference(float(x[i]), slope)
        start_floor = self.floor
        if start_floor is not None:
            evidence.floor = start_floor
        own = number_columns(self.robot, self.numbers, x)
        for i in self.by_difference:
            own[i] = self._difference_column(i, evidence)
        weighed = weigh(evidence, [*own, *self.beside, *order_columns(orders)])
        posterior = solve(weighed.gram, self.numbers, x)
        if more:
            orders, weighed = with_found_orders(evidence, weighed, orders, posterior.change)
            posterior = solve(weighed.gram, self.numbers, x)
        free = np.arange(len(self.numbers), weighed.gram.b.shape[1])
        misfit = _misfit(evidence, weighed, np.concatenate([self._at_bound(x), free]))
        for _ in range(_REWEIGHED):
            floor = usual_size(remainder(evidence, weighed, posterior.change), evidence.noise)
            weighed = refloored(weighed, evidence.floor, floor)
            evidence.floor = floor
            posterior = solve(weighed.gram, self.numbers, x)
        weighed = scattered(weighed.parts, places(self.record.data))
        posterior = solve(weighed.gram, self.numbers, x)
        if not has_few_runs(weighed.parts):
            posterior = with_bands(posterior, weighed, _FINE_BANDS)
        self.floor = evidence.floor
        evidence.forget()
        rest = remainder(evidence, weighed, posterior.change)
        left = mean_square(rest / evidence.plain)
        differences = dict(self._differences) if self.by_difference else {}
        x = np.asarray(x, float)
        return Iterate(x, evidence, weighed, orders, posterior, misfit, left, rest, differences, start_floor)

    def further(self, iterate: Iterate, more: bool) -> Iterate | None:
        """The next robot, by a step that is short enough to leave less, or to cost less: where all of it is nearly met,
        numbers that no motion tells must find back to what was known of them."""
        sure = sure_orders(iterate.orders, iterate.posterior)
        sure = [is_sure or order_key(o) in self.inside for o, is_sure in zip(iterate.orders, sure, strict=True)]
        orders = tuple(o for o, is_sure in zip(iterate.orders, sure, strict=True) if is_sure)
        # Orders that go take nothing away any more: what they took is no reason to refuse a step.
        kept = np.flatnonzero(np.concatenate([np.ones(len(self.beside), bool), np.repeat(sure, 2)]))
        explained = np.concatenate([self._at_bound(iterate.x), len(self.numbers) + kept])
        before = _misfit(iterate.evidence, iterate.weighed, explained)
        # The floor is what is left, as in the least squares whose step this is.
        lines = 2.0 * iterate.rest.size / (iterate.posterior.effect * max(iterate.left, 1e-300))
        cost = lambda misfit, x: lines * misfit + prior_cost(self.numbers, x)
        step, part, longest = self._step(iterate)
        for _ in range(_HALVINGS):
            try:
                found = self.evaluate(iterate.x + part * step, orders, more)
            except InputError as error:
                self.say(f"a step too far: {error}")
            else:
                costs_less = cost(found.misfit, found.x) < cost(before, iterate.x)
                if found.misfit < _WORSE * before or costs_less or part * longest < 0.02:
                    return found
            part /= 2
        return None

    def next(self, iterate: Iterate) -> Float[np.ndarray, "number"]:
        """Where the step goes, no further than columns hold."""
        step, part, _ = self._step(iterate)
        return iterate.x + part * step

    def end(self, iterate: Iterate) -> Float[np.ndarray, "number"]:
        """Where the last step goes, behind which nothing is simulated: smoothings, whose step may be long where they
        hardly matter, move no further than they were simulated."""
        step, part, _ = self._step(iterate, _PERTURBATION)
        return self.followed(iterate.x + part * step)

    def _step(self, iterate: Iterate, farthest: float = _FARTHEST):
        step = iterate.posterior.change[: len(self.numbers)].copy()
        for i in self.by_difference:
            most = farthest / self.numbers[i].size
            step[i] = np.clip(step[i], -most, most)
        logarithms = [n.positive and i not in self.by_difference for i, n in enumerate(self.numbers)]
        lengths = [abs(n.size * s) for n, s, is_log in zip(self.numbers, step, logarithms, strict=True) if is_log]
        longest = max(lengths, default=0.0)
        return step, min(1.0, _LONGEST / longest) if longest > 0 else 1.0, longest

    def followed(self, x) -> Float[np.ndarray, "number"]:
        """The same coordinates, friction no sharper than the robot's steps follow: what is sharper than it was given
        turns milder, so far as is needed; all of it only where friction itself has become more."""
        x = np.array(x, float)
        if not self.by_difference:
            return x
        some = [self.numbers[i] for i in self.by_difference]

        def wider(at, by: float) -> Float[np.ndarray, "smoothing"]:
            return np.array([n.coordinate(by * n.value(float(one))) for n, one in zip(some, at, strict=True)])

        sharpness, asked = self._sharpness(x), x[self.by_difference]
        mild, needed = np.maximum(asked, wider(np.zeros(len(asked)), _MARGIN)), sharpness(asked)
        at, by, before = asked, needed, (1.0, needed)
        for _ in range(_TURNS):  # what is needed goes as 1/by, beside what the laws that stay need
            if needed <= 1.0:
                break
            at = np.minimum(mild, wider(asked, by))
            needed = sharpness(at)
            own = (before[1] - needed) / ((1.0 / before[0] - 1.0 / by) or np.inf)
            before, rest = (by, needed), needed - own / by
            if not rest < 1.0 or not own > 0.0:
                break
            by = own / (1.0 - rest) * (1.0 + 1e-6)
        x[self.by_difference] = at if needed <= 1.0 else wider(mild, sharpness(mild))
        return x

    def _sharpness(self, x) -> Callable[[np.ndarray], float]:
        """How many times its smoothing friction needs, to be what the robot's steps follow, by the coordinates of the
        smoothings; 1 where none is needed. All other numbers are as `x` has them."""
        moved = with_numbers(self.robot, self.numbers, x)
        some = [self.numbers[i] for i in self.by_difference]

        def factor(at: np.ndarray) -> float:
            needed = _MARGIN * float(smoothing_factor(with_numbers(moved, some, at), like=self.robot))
            return needed if needed > 1.0 + _ROUNDING else 1.0

        return factor

    def _at_bound(self, x) -> np.ndarray:
        """Columns of smoothings that may not become less."""
        if not self.by_difference:
            return np.array([], int)
        sharpness, at = self._sharpness(x), np.asarray(x, float)[self.by_difference]
        less = [_AT_BOUND / self.numbers[i].size for i in self.by_difference]
        bound = [sharpness(at - by * (np.arange(len(at)) == k)) > 1.0 for k, by in enumerate(less)]
        return np.array(self.by_difference, int)[bound]

    def _perturbed(self, x) -> dict[int, np.ndarray]:
        """Where the robot is simulated, too, for finite differences by its smoothings; not by those of which another
        round had nearly the same."""
        found = {}
        for i in self.by_difference:
            size, known = self.numbers[i].size, self._differences.get(self.numbers[i].name)
            if known is None or abs(float(x[i]) - known.at) * size > _SAME_COLUMN:
                found[i] = x.copy()
                found[i][i] += _PERTURBATION / size
        return found

    def _difference_column(self, i: int, evidence: Evidence) -> Column:
        """The column of a smoothing, from this round or another."""
        slope = self._differences[self.numbers[i].name].slope
        columns = {id(scene): column for scene, column in zip(evidence.scenes, slope, strict=True)}
        return lambda scene: columns[id(scene)]

    def has_converged(self, iterate: Iterate) -> bool:
        """Whether the next step would be small beside what is known of every number, and take little off the misfit.
        How Coulomb friction is smoothed has no true value where a machine's friction is another law: it may creep."""
        step, count = iterate.posterior.change, len(self.numbers)
        std = np.sqrt(np.diag(iterate.posterior.covariance))
        counts = np.array([n.kind != "smoothing" for n in self.numbers])
        small = np.abs(step[:count]) < _CONVERGED * std[:count]
        return bool(np.all(small[counts])) and iterate.left > _GAIN * iterate.misfit


def mean_square(z) -> float:
    return 0.5 * float(np.mean(np.abs(z) ** 2))


def _misfit(evidence: Evidence, weighed: Weighed, ripple) -> float:
    """Of the robot as it was simulated, what these columns explain taken away; over the plain floor."""
    gram = weighed.gram
    ripple = ripple[np.diag(gram.A.sum(axis=0))[ripple] > _NOTHING]  # others are rounding: the turn of no friction
    A, b = gram.A.sum(axis=0)[np.ix_(ripple, ripple)], gram.b.sum(axis=0)[ripple]
    change = np.zeros(gram.b.shape[1])
    if len(b):
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        change[ripple] = np.linalg.lstsq(A / np.outer(size, size), b / size, rcond=1e-7)[0] / size
    return mean_square(remainder(evidence, weighed, change) / evidence.plain)
