"""A robot whose uncertain numbers were fitted to a record, from its file or from where another was fitted.

The fit is the calibration's (`calibration.descent`): ripple beside the robot first, then simulated with it.
"""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType

import equinox as eqx
import numpy as np
import scipy.stats
from jaxtyping import Bool, Float

from ..._errors import InputError
from ..._text import NORMAL_95
from ...calibration.columns import OF_LINKS
from ...calibration.descent import Descent
from ...calibration.least_squares import with_another, with_column_errors
from ...calibration.numbers import Number, effect_parameters, numbers, prior_cost, with_numbers
from ...calibration.result import Round
from ...calibration.ripple import TRIED, found_waves
from ...calibration.rounds import Kept, Rounds
from ...calibration.search import Difference, Iterate
from ...robot import Robot, Tolerances
from ...trajectory.measured import Measured
from ...trajectory.remainder import excess, steady_seen
from ...trajectory.ripple import Order, Wave, with_ripple
from ..settings import FAR, FLOOR, LINK_ERROR, OTHERS, OUT_OF_TOLERANCE, PROMISING, ROUNDS, SLOW

Say = Callable[[str], None]


class Fitted(eqx.Module):
    """A robot as it was given or extended, the numbers of it that are not exact, and where a record puts them.

    **Fields:** `unknown`: numbers of which nothing is known before, whatever the robot says. `x`: where the numbers
    are, in tolerances. `iterate`: the last simulation. `near`: whether ripple and the smoothing of friction were
    simulated; `inside`: the ripple that was. `settled`: whether another round would hardly change a number.
    """

    robot: Robot
    unknown: Tolerances = eqx.field(static=True)
    numbers: tuple[Number, ...]
    x: Float[np.ndarray, "number"]
    iterate: Iterate
    near: bool = eqx.field(static=True)
    inside: tuple[Wave, ...] = eqx.field(static=True)
    settled: bool = eqx.field(static=True)

    @property
    def prior_cost(self) -> float:
        """Of the numbers behind the next step, as `left` is."""
        return prior_cost(self.numbers, self.iterate.x + self.iterate.posterior.change[: len(self.numbers)])

    @property
    def left(self):
        """What is left of the record behind the next step, N m, (pos, exp, line, axis)."""
        return self.iterate.rest

    def excess(self, record: Measured) -> float:
        """Mean square over the floor where most is left: of one axis in one band."""
        return excess(self.left, self.iterate.evidence.plain, record.frequency)

    @property
    def of_axes(self) -> Float[np.ndarray, "axis"]:
        """Mean square over the floor that is left of every axis."""
        return 0.5 * np.mean(np.abs(self.left / self.iterate.evidence.plain) ** 2, axis=(0, 1, 2))

    def without_columns(self) -> "Fitted":
        """The same, beside which no candidate can be ranked any more."""
        return dataclasses.replace(self, iterate=self.iterate.without_columns())

    def place(self, name: str) -> int:
        return [n.name for n in self.numbers].index(name)

    def value(self, name: str) -> float:
        i = self.place(name)
        return self.numbers[i].value(float(self.x[i]))

    def deviation(self, name: str) -> float:
        """Half of the 95 % interval over 1.96, in the number's unit; with the step that a fit has still ahead."""
        i, own = self.place(name), self.iterate.posterior
        ahead = float(self.iterate.x[i] + own.change[i] - self.x[i])
        return self.numbers[i].deviation(float(self.x[i]), math.hypot(float(own.half_width()[i]) / NORMAL_95, ahead))

    def covariance(self, names: Sequence[str]) -> Float[np.ndarray, "name name"]:
        """Of numbers, in their units, as wide as their intervals are."""
        rows = [self.place(name) for name in names]
        covariance = self.iterate.posterior.covariance[np.ix_(rows, rows)]
        wide = np.array([self.deviation(name) for name in names]) / np.maximum(np.sqrt(np.diag(covariance)), 1e-300)
        return wide[:, None] * covariance * wide

    @property
    def tolerance_statistic(self) -> Float[np.ndarray, "number"]:
        """What every number is off by, over the standard deviation that this would have if all tolerances were true, up
        to one factor (data snooping: Baarda, A Testing Procedure for Use in Geodetic Networks, 1968; with the factor
        of all other numbers: Pope, The Statistics of Residuals, NOAA 1976). 0 where nothing is known beforehand. No
        tolerance is taken to be wider than it is stated; the factor is one where fewer than `OTHERS` others tell it.
        """
        known, share = self._known, self._data_share
        squares, others = np.where(known, self.x**2, 0.0), share.sum() - share
        factor = np.where(others < OTHERS, 1.0, (squares.sum() - squares) / np.maximum(others, 1e-6))
        return np.where(known, self.x / np.sqrt(np.maximum(share, 1e-6) * np.clip(factor, 1e-6, 1.0)), 0.0)

    @property
    def tolerance_p_values(self) -> Float[np.ndarray, "number"]:
        """Of every number's statistic among those of all numbers, were all tolerances true: its factor is known as well
        as so many others tell it."""
        statistic, share = np.abs(self.tolerance_statistic), self._data_share
        others = share.sum() - share
        one = np.where(
            others < OTHERS, scipy.stats.norm.sf(statistic), scipy.stats.t(np.maximum(others, OTHERS)).sf(statistic)
        )
        return np.minimum(1.0, np.sum(self._known) * 2.0 * one)

    @property
    def _known(self) -> Bool[np.ndarray, "number"]:
        """Numbers with a tolerance that is one."""
        return np.array([n.prior > 0 and n.kind != "smoothing" for n in self.numbers], bool)

    @property
    def _data_share(self) -> Float[np.ndarray, "number"]:
        """Part of every number that the record determines, of those with a tolerance."""
        own = np.diag(np.linalg.inv(self.iterate.posterior.normal))[: len(self.numbers)]
        return np.where(self._known, np.clip(1.0 - own, 1e-6, 1.0), 0.0)

    @property
    def out_of_tolerance(self) -> tuple[int, ...]:
        """Numbers whose tolerance the record does not let one believe, worst first."""
        order, p_values = np.argsort(-np.abs(self.tolerance_statistic)), self.tolerance_p_values
        return tuple(int(i) for i in order if p_values[i] < OUT_OF_TOLERANCE and abs(self.x[i]) > FAR)

    @property
    def waves(self) -> tuple[Wave, ...]:
        """Ripple that is there beyond chance or was simulated, with the coefficients of sine and cosine."""
        return found_waves(self.iterate.orders, self.iterate.posterior, self.inside)

    def wave_p_value(self, kind: str, axis: int) -> float:
        """Of the surest order of one motor's ripple of a kind, were there none, among all that were tried."""
        spread = np.sqrt(np.diag(self.iterate.posterior.covariance))[-2 * len(self.iterate.orders) :].reshape(-1, 2)
        scatter = {(o.kind, o.axis, o.order): s for o, s in zip(self.iterate.orders, spread, strict=True)}
        own = [
            np.sum((np.array(w) / np.maximum(scatter[(o.kind, o.axis, o.order)], 1e-300)) ** 2)
            for o, w in self.waves
            if (o.kind, o.axis) == (kind, axis)
        ]
        tests = self.robot.n_axes * sum(map(len, TRIED.values()))
        return float(min(1.0, tests * scipy.stats.chi2.sf(max(own), 2)))

    def wave_covariance(self, kind: str, axis: int) -> dict[float, Float[np.ndarray, "2 2"]]:
        """Of the coefficients of sine and cosine of one motor's ripple, by order, as wide as their intervals are."""
        orders = self.iterate.orders
        wide, covariance = self.iterate.posterior.half_width() / NORMAL_95, self.iterate.posterior.covariance
        scale = wide / np.maximum(np.sqrt(np.diag(covariance)), 1e-300)
        scaled, first = scale[:, None] * covariance * scale, len(covariance) - 2 * len(orders)
        rows = {o.order: first + 2 * i for i, o in enumerate(orders) if (o.kind, o.axis) == (kind, axis)}
        return {order: scaled[i : i + 2, i : i + 2] for order, i in rows.items()}

    def written(
        self, without: Callable[[Order, tuple[float, float]], bool] = lambda o, w: False, given: Collection[str] = ()
    ) -> Robot:
        """The robot as it would be written, with its motors' ripple but for that which is left out; numbers of these
        names as they were given."""
        waves = [(o, w) for o, w in self.waves if not without(o, w)]
        x = np.where([n.name in given for n in self.numbers], 0.0, self.x)
        return with_numbers(with_ripple(self.robot, waves), self.numbers, x)


def is_loud(robot: Robot, order: Order, wave: Sequence[float]) -> bool:
    """Whether ripple is more than motors usually have."""
    return float(np.hypot(wave[0], wave[1])) > order.loud(robot)


def fitted(robot: Robot, record: Measured, say: Say, rounds: int = ROUNDS) -> tuple[Fitted, Fitted]:
    """The robot fitted, and as it was given."""
    fit = RobotFit(robot, Tolerances(), record, say)
    fit.begin(None)
    given = fit.found
    fit.go_on(rounds - 1)
    return fit.found, given


def as_given(robot: Robot, record: Measured, say: Say) -> Fitted:
    """The robot with its numbers as they are."""
    fit = RobotFit(robot, Tolerances(), record, say)
    fit.begin(None)
    return fit.found


def fitted_from(robot: Robot, unknown: Tolerances, record: Measured, start: Fitted, say: Say, rounds: int) -> Fitted:
    """A robot with other effects or tolerances, its numbers from where those of `start` are."""
    fit = RobotFit.beside(start, robot, unknown, record, say)
    fit.go_on(rounds - 1)
    return fit.found


def further(found: Fitted, record: Measured, say: Say, rounds: int) -> "RobotFit":
    """The same robot, fitted for so many rounds to another record, in which ripple is looked for anew."""
    fit = RobotFit.beside(found, found.robot, found.unknown, record, say, more=True)
    fit.go_on(rounds - 1)
    return fit


def with_link_errors(found: Fitted) -> Fitted:
    """The same, links being what their masses, centres and inertias say to `LINK_ERROR` only: where those of one give
    way to one another and to those of the next, what is left of their torques tells nothing."""
    errors = np.zeros(len(found.iterate.posterior.change))
    errors[: len(found.numbers)] = [LINK_ERROR * (n.kind in OF_LINKS) for n in found.numbers]
    posterior = with_column_errors(found.iterate.posterior, found.iterate.weighed.gram, errors)
    return dataclasses.replace(found, iterate=dataclasses.replace(found.iterate, posterior=posterior))


def or_at(found: Fitted, other: Fitted) -> Fitted:
    """The same, its numbers as uncertain as they are where they may as well be those of another fit of the robot."""
    posterior = with_another(found.iterate.posterior, other.x - found.x, other.iterate.posterior)
    return dataclasses.replace(found, iterate=dataclasses.replace(found.iterate, posterior=posterior))


class RobotFit:
    """A robot's numbers on their way.

    What is not known beforehand stands beside the robot, not in it: robots that differ in that alone share what is
    compiled."""

    def __init__(
        self,
        robot: Robot,
        unknown: Tolerances,
        record: Measured,
        say: Say,
        differences: Mapping[str, Difference] = MappingProxyType({}),
    ):
        self.numbers = numbers(robot.with_tolerances(unknown))
        self.robot, self.unknown, self.record, self.say = robot, unknown, record, say
        self.descent = Descent(robot, record, self.numbers, lambda text: None, differences=differences)
        self.kept = Rounds(None, robot, self.numbers, record, ())

    @classmethod
    def beside(
        cls,
        start: Fitted,
        robot: Robot,
        unknown: Tolerances,
        record: Measured,
        say: Say,
        anew: Collection[str] = (),
        more: bool = False,
    ) -> "RobotFit":
        """A robot with other effects or tolerances, its numbers where those of `start` are, or as they were given
        (`anew`). `more`: whether more ripple is looked for there.

        **Raises:** `jaxfrf.InputError` where it cannot be simulated there."""
        scenes = start.iterate.evidence.scenes
        same_motion = np.array_equal(np.asarray(record.data.q), [s.still.q for s in scenes]) and all(
            len(s.u) == record.data.n_exp for s in scenes
        )
        fit = cls(robot, unknown, record, say, start.iterate.differences if same_motion else {})
        known = {n.name: (n, float(x)) for n, x in zip(start.numbers, start.x, strict=True) if n.name not in anew}
        x = np.array([_begins(n, known) for n in fit.numbers])
        floor = steady_seen(start.iterate.evidence)
        fit.begin(start_of(x, start.iterate.orders, floor, start.near, start.inside), more)
        return fit

    @property
    def found(self) -> Fitted:
        d = self.descent
        return Fitted(self.robot, self.unknown, self.numbers, d.x, d.iterate, d.near, d.inside, d.settled)

    @classmethod
    def at(
        cls,
        robot: Robot,
        unknown: Tolerances,
        record: Measured,
        values: Mapping[str, float],
        start: Kept,
        say: Say,
        differences: Mapping[str, Difference] = MappingProxyType({}),
    ) -> "RobotFit":
        """A robot that begins where another fit of it was; `values`: of its numbers, by name. `start`: all else.

        **Raises:** `jaxfrf.InputError` where it cannot be simulated there."""
        fit = cls(robot, unknown, record, say, differences)
        x = np.array([n.coordinate(values[n.name]) if n.name in values else 0.0 for n in fit.numbers])
        fit.begin(dataclasses.replace(start, x=x))
        return fit

    def elsewhere(self) -> "list[RobotFit]":
        """Fits of the same robot from where its effects do nearly the same (`AbstractEffect.elsewhere`)."""
        found = self.found
        iterate = found.iterate
        here = {n.name: n.value(x) for n, x in zip(found.numbers, map(float, found.x), strict=True)}
        start = start_of(found.x, iterate.orders, steady_seen(iterate.evidence), found.near, found.inside)
        acting = {(joint, effect.name): effect for joint, effect, _ in effect_parameters(found.written())}
        others = []
        for (joint, name), effect in acting.items():
            for other in effect.elsewhere(self.robot):
                values = here | {f"{joint}.{name}.{x}": float(getattr(other, x)) for x in other.units}
                with contextlib.suppress(InputError):  # it cannot be simulated there
                    others.append(
                        RobotFit.at(self.robot, self.unknown, self.record, values, start, self.say, iterate.differences)
                    )
        return others

    def begin(self, start: Kept | None, more: bool = False) -> None:
        self.kept.done = [] if start is None else [start]
        self.descent.begin(self.kept, more)
        iterate = self.descent.iterate
        round = Round(iterate.misfit, iterate.left, iterate.posterior.effect)
        self.kept.done[-1] = dataclasses.replace(self.kept.done[-1], round=round)

    def go_on(self, rounds: int, late: int = 0) -> None:
        """So many rounds, fewer where the misfit does not come down to the floor by itself, nor by the next step, and
        where below the floor the next step brings nothing. `late`: further rounds, as long as the next step promises
        much, or the last one brought much and the floor is not reached."""
        left, brought_much = self._excess(), False
        for further in reversed(range(rounds + late)):
            was_near, iterate = self.descent.near, self.descent.iterate
            if further < late and not brought_much and not _promises_much(iterate):
                break
            if not self.descent.advance(self.kept):
                break
            now, before, left = self.descent.iterate, left, self._excess()
            self.say(f"    {now.misfit**0.5:.3g} times the floor, at most {left**0.5:.3g} behind the next step")
            if self.descent.near and self.descent.rests and now.misfit < FLOOR:
                break
            brought_much = FLOOR < now.misfit < SLOW * iterate.misfit
            slow = now.misfit > SLOW * iterate.misfit and now.left > SLOW * iterate.left and left > SLOW * before
            end = left * min(left / before, 1.0) ** further  # where it would come at this pace
            if slow and was_near and end > FLOOR and not _promises_much(now):
                break

    def _excess(self) -> float:
        return self.found.excess(self.record)


def _promises_much(iterate: Iterate) -> bool:
    return iterate.left <= PROMISING * iterate.misfit


def start_of(x, orders: Sequence[Order], floor, near: bool, inside: Sequence[Wave]) -> Kept:
    """Where a fit ended, for another to begin there."""
    return Kept(x, tuple(orders), floor, Round(np.inf, np.inf, 1.0), near, tuple(inside), np.zeros(0))


def _begins(number: Number, known: dict[str, tuple[Number, float]]) -> float:
    """Where a number stands in another robot; as given where an effect has changed what it is given as."""
    if number.name not in known:
        return 0.0
    old, x = known[number.name]
    if number.given != old.given:
        return 0.0
    return number.coordinate(old.value(x))
