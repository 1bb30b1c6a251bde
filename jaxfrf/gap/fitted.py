"""A robot whose uncertain numbers were fitted to a record, from its file or from where another was fitted."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Float

from ..calibration.numbers import Number, numbers, with_numbers
from ..calibration.ripple import TRIED, sure_orders
from ..calibration.search import Look, Search
from ..effects import TorqueConstant
from ..effects._place import axis_of
from ..robot import Robot, Tolerances
from ..trajectory.measured import Measured
from ..trajectory.remainder import excess, remainder
from ..trajectory.ripple import Order, ripple_effects
from .settings import FLOOR, LOOKS_FOR_RIPPLE, ROUNDS, SLOW

Say = Callable[[str], None]


class Fitted(eqx.Module):
    """A robot as it was given or extended, the numbers of it that are not exact, and where a record puts them.

    **Fields:** `unknown`: numbers of which nothing is known before, whatever the robot says. `look`: the last
    simulation. `stays`: whether another would hardly change a number: then the step that the look asks for counts, too.
    """

    robot: Robot
    unknown: Tolerances = eqx.field(static=True)
    these: tuple[Number, ...]
    look: Look
    stays: bool = eqx.field(static=True)

    @property
    def x(self) -> Float[np.ndarray, "number"]:
        """Tolerances that every number is off by."""
        step = self.look.posterior.change[: len(self.these)]
        return self.look.x + step if self.stays else self.look.x

    @property
    def priced(self) -> float:
        """Squares of tolerances that the numbers are off by; how Coulomb friction is smoothed has no true value."""
        return float(sum(n.prior * x**2 for n, x in zip(self.these, self.x, strict=True) if n.kind != "smoothing"))

    @property
    def left(self):
        """What is left of the record, N m, (pos, exp, line, axis)."""
        return remainder(self.look.evidence, self.look.weighed, self.look.posterior.change)

    def excess(self, record: Measured) -> float:
        """Mean square over the floor where most is left: of one axis in one band."""
        return excess(self.left, self.look.evidence.plain, record.frequency)

    @property
    def of_worst_axis(self) -> float:
        """Mean square over the floor that is left of the axis with most."""
        return 0.5 * float(np.max(np.mean(np.abs(self.left / self.look.evidence.plain) ** 2, axis=(0, 1, 2))))

    def place(self, name: str) -> int:
        return [n.name for n in self.these].index(name)

    def value(self, name: str) -> float:
        i = self.place(name)
        return self.these[i].value(float(self.x[i]))

    def deviation(self, name: str) -> float:
        """Half of the 95 % interval over 1.96, in the number's unit."""
        i = self.place(name)
        return self.these[i].deviation(float(self.x[i]), float(self.look.posterior.half_width()[i]) / 1.959964)

    def waves(self) -> list[tuple[Order, Float[np.ndarray, "2"]]]:
        """Orders of ripple that are there beyond chance, with the coefficients of sine and cosine."""
        orders, posterior = self.look.orders, self.look.posterior
        return [
            (o, w)
            for o, w, sure in zip(orders, self._coefficients, sure_orders(orders, posterior), strict=True)
            if sure
        ]

    @property
    def _coefficients(self) -> Float[np.ndarray, "order 2"]:
        change = self.look.posterior.change
        return change[len(change) - 2 * len(self.look.orders) :].reshape(-1, 2)

    def wave_p_value(self, kind: str, axis: int) -> float:
        """Of the surest order of one motor's ripple of a kind, were there none, among all that were tried."""
        spread = np.sqrt(np.diag(self.look.posterior.covariance))[-2 * len(self.look.orders) :].reshape(-1, 2)
        size = np.sum((self._coefficients / np.maximum(spread, 1e-300)) ** 2, axis=1)
        own = [x for o, x in zip(self.look.orders, size, strict=True) if (o.kind, o.axis) == (kind, axis)]
        tests = self.robot.n_axes * sum(map(len, TRIED.values()))
        return float(min(1.0, tests * scipy.stats.chi2.sf(max(own), 2)))

    def written(self, quiet: bool = False) -> Robot:
        """The robot as it would be written, with its motors' ripple; `quiet`: without what is louder than usual."""
        waves = [(o, w) for o, w in self.waves() if not quiet or np.hypot(*w) <= o.loud(self.robot)]
        found = with_numbers(self.robot, self.these, self.x)
        if not waves:
            return found
        return found.with_effects(
            *ripple_effects(found.axis_names, [o for o, _ in waves], np.array([w for _, w in waves]))
        )


def fitted(robot: Robot, record: Measured, say: Say, rounds: int = ROUNDS) -> tuple[Fitted, Fitted]:
    """The robot fitted, and as it was given."""
    fit = _Fit(robot, Tolerances(), record, say)
    first = fit.search.look(np.zeros(len(fit.these)), (), True)
    return fit.descended(first, rounds, True), fit.found(first, False)


def fitted_from(
    robot: Robot, unknown: Tolerances, record: Measured, start: Fitted, say: Say, rounds: int, more: bool = False
) -> Fitted:
    """A robot with other effects or tolerances, its numbers from where those of `start` are; `more`: whether other
    orders of ripple are looked for."""
    fit = _Fit(robot, unknown, record, say)
    known = {n.name: (n, float(x)) for n, x in zip(start.these, start.x, strict=True)}
    fit.search.floor = start.look.evidence.floor
    look = fit.search.look(np.array([_begins(n, known) for n in fit.these]), start.look.orders, more)
    return fit.descended(look, rounds - 1, False)


def further(found: Fitted, record: Measured, say: Say, rounds: int) -> Fitted:
    """The same, fitted for so many more rounds."""
    if found.stays:
        return found
    fit = _Fit(found.robot, found.unknown, record, say)
    fit.search.floor = found.look.evidence.floor
    return fit.descended(found.look, rounds, False)


class _Fit:
    """A robot's numbers on their way.

    What is not known beforehand stands beside the robot, not in it: robots that differ in that alone share what is
    compiled."""

    def __init__(self, robot: Robot, unknown: Tolerances, record: Measured, say: Say):
        self.these = numbers(robot.with_tolerances(unknown))
        self.robot, self.unknown, self.record, self.say = _like_its_fit(robot, self.these), unknown, record, say
        self.search = Search(self.robot, record, self.these, lambda text: None, ())

    def found(self, look: Look, stays: bool) -> Fitted:
        return Fitted(self.robot, self.unknown, self.these, look, stays)

    def descended(self, look: Look, rounds: int, ripple: bool) -> Fitted:
        """Gauss-Newton, given up where it does not come down to the floor by itself."""
        left, stays = self._excess(look), self.search.stays(look)
        for number in range(rounds):
            if stays:
                break
            found = self.search.further(look, ripple and number < LOOKS_FOR_RIPPLE)
            if found is None:
                break
            slow = found.misfit > SLOW * look.misfit and found.left > SLOW * look.left
            look, before, left = found, left, self._excess(found)
            stays = self.search.stays(look)
            self.say(f"    {look.misfit**0.5:.3g} times the floor, at most {left**0.5:.3g} behind the next step")
            near = FLOOR < left < 2 * FLOOR
            if slow and left > SLOW * before and not near and not (ripple and number < LOOKS_FOR_RIPPLE - 1):
                break
        return self.found(look, stays)

    def _excess(self, look: Look) -> float:
        left = remainder(look.evidence, look.weighed, look.posterior.change)
        return excess(left, look.evidence.plain, self.record.frequency)


def _like_its_fit(robot: Robot, these) -> Robot:
    """Numbers as arrays, and an error of every torque constant that may have one, for the same reason."""
    had = {robot.axis_names[axis_of(robot, e.joint)] for e in robot.effects if isinstance(e, TorqueConstant)}
    more = [TorqueConstant(n.joint, 0.0) for n in these if n.kind == "torque_constant" and n.joint not in had]
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.asarray(x).dtype), robot.with_effects(*more))


def _begins(number: Number, known: dict[str, tuple[Number, float]]) -> float:
    """Where a number stands in another robot; as given where an effect has changed what it is given as."""
    if number.name not in known:
        return 0.0
    old, x = known[number.name]
    if number.given != old.given:
        return 0.0
    return number.coordinate(old.value(x))


def at(robot: Robot, unknown: Tolerances, record: Measured, values, orders, floor, say: Say) -> Fitted:
    """The robot where an earlier run had left it; `values`: of its numbers, by name."""
    fit = _Fit(robot, unknown, record, say)
    fit.search.floor = floor
    x = np.array([n.coordinate(values[n.name]) if n.name in values else 0.0 for n in fit.these])
    look = fit.search.look(x, orders, False)
    return fit.found(look, fit.search.stays(look))
