"""What every channel says of itself: what is compared, and how an effect shows in it."""

import abc
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ..._errors import InputError
from ...effects import AbstractEffect, Candidate
from ...robot import Robot
from ...robot.parameters import with_values
from ..result import Cell, Diagnosis
from ..settings import NEAR

Rows = Float[np.ndarray, "row"]


class State(eqx.Module):
    """A robot, values of its own numbers that give way, and effects with coefficients.

    **Fields:** `given`: the robot as it was given. `own`: numbers of it by name, in their units. `chosen`: effects that
    were added, each as its `jaxfrf.effects.Candidate` and its coefficients.
    """

    given: Robot
    own: dict[str, float]
    chosen: tuple[tuple[Candidate, tuple[float, ...]], ...] = ()

    def robot(self) -> Robot:
        effects = [candidate.make(np.array(values)) for candidate, values in self.chosen]
        return with_values(self.given, self.own).with_effects(*effects)

    @property
    def values(self) -> Float[np.ndarray, "free"]:
        """All that is free: own numbers, then the coefficients of every effect."""
        return np.array([*self.own.values(), *(v for _, values in self.chosen for v in values)])

    @property
    def bounds(self) -> tuple[Float[np.ndarray, "free"], Float[np.ndarray, "free"]]:
        """Lowest and highest values, of coefficients that an effect is not linear in: the others tell by themselves
        what makes no sense."""
        low, high = [-np.inf] * len(self.own), [np.inf] * len(self.own)
        for candidate, values in self.chosen:
            low += candidate.low if candidate.start else [-np.inf] * len(values)
            high += candidate.high if candidate.start else [np.inf] * len(values)
        return np.array(low), np.array(high)

    def at(self, values: Iterable[float]) -> "State":
        left = [float(v) for v in values]
        own = {name: left.pop(0) for name in self.own}
        chosen = tuple((c, tuple(left.pop(0) for _ in old)) for c, old in self.chosen)
        return State(self.given, own, chosen)

    def having(self, candidate: Candidate, values: Iterable[float]) -> "State":
        return State(self.given, self.own, (*self.chosen, (candidate, tuple(float(v) for v in values))))

    def without(self, i: int) -> "State":
        return State(self.given, self.own, self.chosen[:i] + self.chosen[i + 1 :])

    def replaced(self, i: int, candidate: Candidate, values: Iterable[float]) -> "State":
        """The same, another effect in the place of the i-th."""
        new = candidate, tuple(float(v) for v in values)
        return State(self.given, self.own, (*self.chosen[:i], new, *self.chosen[i + 1 :]))

    def place(self, i: int) -> slice:
        """Of the coefficients of the i-th effect among the values."""
        first = len(self.own) + sum(len(values) for _, values in self.chosen[:i])
        return slice(first, first + len(self.chosen[i][1]))


class AbstractChannel(eqx.Module):
    """One comparison of a robot with measurements, as rows.

    Rows count in the unit of their floor or of what was measured, whichever makes them alike; each belongs to a group
    (an axis) and to a fold, which is held out in turn.

    **Class attributes:** `compared`: what is, in a sentence. `quantity`: what a residual is called; `unit`: of the gap.
    `tolerance`: residual, in the gap's unit, below which nothing is asked for. `linear`: whether rows are linear in the
    coefficients of a candidate, near enough to choose among them; otherwise each is fitted in full. `least_drop`: of
    the power that is left where an effect acts, that it takes away on held-out rows, whatever the floor. `smallest`:
    of what was measured, rms where it acts, that an effect explains; less is none, however significant. `tie`: of
    what the best takes away, within which another is as good whatever its standard error says. `n_parts`: that share
    nothing, each of which may miss as many effects as a whole may.
    """

    compared: ClassVar[str]
    quantity: ClassVar[str]
    unit: ClassVar[str]
    tolerance: ClassVar[float]
    linear: ClassVar[bool] = True
    least_drop: ClassVar[float] = 0.0
    smallest: ClassVar[float] = 0.0
    tie: ClassVar[float] = NEAR

    @property
    def n_parts(self) -> int:
        return 1

    robot: eqx.AbstractVar[Robot]
    measured: eqx.AbstractVar[Rows]
    group: eqx.AbstractVar[Int[np.ndarray, "row"]]
    fold: eqx.AbstractVar[Int[np.ndarray, "row"]]

    @classmethod
    @abc.abstractmethod
    def takes(cls, robot: Robot | None, data: Sequence[Any]) -> bool:
        """Whether these data (records or FRFs) are of this kind."""

    @classmethod
    @abc.abstractmethod
    def opened(cls, robot: Robot | None, data: Sequence[Any]) -> Self:
        """The channel of these data. **Raises:** `jaxfrf.InputError` where they do not fit."""

    @abc.abstractmethod
    def of(self, data: Sequence[Any]) -> Self:
        """The same comparison on other data, with the filters and the robot of this one."""

    @abc.abstractmethod
    def own(self) -> dict[str, float]:
        """Numbers of the robot that give way before an effect is looked for, with their values."""

    @abc.abstractmethod
    def tried(self, kind: type[AbstractEffect], joint: str) -> tuple[Candidate, ...]:
        """What is tried of an effect on a joint. **Raises:** `jaxfrf.InputError` where it cannot be seen, and why."""

    @abc.abstractmethod
    def predicted(self, state: State) -> Rows:
        """What the robot of the state makes of the measured rows."""

    @abc.abstractmethod
    def floor(self, residual: Rows) -> Rows:
        """What no robot would explain of the residual, row by row."""

    @abc.abstractmethod
    def blocks(self, residual: Rows) -> Int[np.ndarray, "row"]:
        """Numbers of blocks, long against the residual's memory."""

    @abc.abstractmethod
    def sensible(self, candidate: Candidate, values: Float[np.ndarray, "free"]) -> bool:
        """Whether fitted coefficients have a sign and a size that make sense for any robot."""

    @abc.abstractmethod
    def spectra(self, rows: Rows) -> list[tuple[Float[np.ndarray, "freq"], Float[np.ndarray, "freq axis"]]]:
        """Power of rows over frequency, Hz, in the gap's unit squared, of every record or position."""

    def residual(self, state: State) -> Rows:
        return self.measured - self.predicted(state)

    def columns(self, state: State, candidates: Sequence[Candidate]) -> list[Float[np.ndarray, "row free"]]:
        """What each candidate adds to the prediction, per unit of its coefficients."""
        robot_with = lambda e: dataclasses.replace(state, given=state.given.with_effects(e))
        now = self.predicted(state)
        return [np.stack([self.predicted(robot_with(e)) - now for e in c.basis], axis=1) for c in candidates]

    def slopes(self, state: State) -> Float[np.ndarray, "row free"]:
        """d(prediction)/d(value) by differences, own numbers first."""
        now, at, columns = self.predicted(state), state.values, []
        for i, value in enumerate(at):
            step = 1e-4 * abs(value) or 1e-6
            moved = at.copy()
            moved[i] += step
            columns.append((self.predicted(state.at(moved)) - now) / step)
        return np.stack(columns, axis=1) if columns else np.zeros((len(now), 0))

    def plain(self, rows: Rows) -> Rows:
        """Rows in the unit of the gap."""
        return rows

    def courses(self, robot: Robot, before: Rows, after: Rows) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Mean residuals against signals, see `jaxfrf.gap.Maps`."""
        return {}

    def where(self, outcome: "Outcome", cells: tuple[Cell, ...]) -> tuple[Cell, ...]:
        """Where the gap is, and what is left of it goes with: by default the largest `cells` of the maps."""
        return cells

    def remarks(self, outcome: "Outcome") -> tuple[str, ...]:
        """Sentences that belong to the result."""
        return ()

    def joined(self, found: Diagnosis) -> Diagnosis:
        """The result, beside what had to be found before this comparison was possible."""
        return found


class Outcome(eqx.Module):
    """What a channel may see of a finished search.

    **Fields:** `base`, `state`: before and after. `before`, `residual`: what is left of the rows in each, (row,).
    `ranking`: of the candidates, as in `Diagnosis`. `test`: of columns beside the residual, (row, column): share,
    coefficient and p-value of each, family-wise.
    """

    base: State
    state: State
    before: Rows
    residual: Rows
    ranking: tuple
    test: Callable[[Float[np.ndarray, "row column"]], list[tuple[float, float, float]]] = eqx.field(static=True)


def makes_sense(
    robot: Robot, candidate: Candidate, values: Float[np.ndarray, "free"], most: float, bounded: bool = True
) -> bool:
    """Whether fitted coefficients have a sign and a size that make sense for any robot.

    `bounds` of an effect are for robots of some kilowatts. What carries a torque (levels, coefficients, stiffness) is
    only held to the sign that they state, or to the robot's own number, and to the largest torque on its joint; times
    and ratios to the bounds, or to their sign alone where the robot is not known (`bounded`).

    **Arguments:** `robot`: as it was given. `candidate`: the effect that is tried. `values`: its fitted coefficients.
    `most`: the largest torque on the joint, N m. `bounded`: see above.

    **Returns:** whether they do.

    **Source:** this project's own.
    """
    try:
        effect = candidate.make(np.asarray(values))
    except InputError:
        return False
    name = next(iter(effect.units))
    kind, unit = type(effect), effect.units[name]
    value = float(np.max(np.asarray(getattr(effect, name))))
    low, high = kind.plausible(robot, candidate.joint or robot.axis_names[-1])
    if "N m" in unit or not bounded:
        stated = low != kind.bounds[name][0]
        low, high = (low if stated else 0.0 if low >= 0.0 else -np.inf), np.inf
    if unit == "N m":
        low, high = max(low, -most), most
    return low <= value <= high


def acting(columns: Float[np.ndarray, "row free"], group: Int[np.ndarray, "row"]) -> Bool[np.ndarray, "row"]:
    """Rows of the groups in which a candidate shows at all."""
    shows = np.any(columns != 0.0, axis=1)
    return np.isin(group, np.unique(group[shows]))
