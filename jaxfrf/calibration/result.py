"""A calibrated robot, and how every number of it is known."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import __version__
from .._text import percent
from ..robot import Robot
from ..trajectory.evidence import Evidence
from ..trajectory.measured import Measured
from ..trajectory.ripple import Order
from .numbers import Number

_RISES, _LITTLE = 1.25, 0.01  # times the torque missed before; of the torque: less is noise or rounding
DATA_SHARE = 0.9  # of the prior's variance that the data take away: less is not determined by the data
_SURE = 0.3  # in x: a number of which nothing was known before is determined where its deviation is below
_TOGETHER = 0.5  # correlation of numbers that are determined in combination only
_PART_OF_TURN = 0.5  # that a motor must go over for ripple to be told by its orders
_FAR = 4.0  # of what was known of a number: one of fifteen thousand right ones
_MUCH = 0.1  # of an axis's torque: a robot that misses more lacks something, or was not given what moved


class Round(eqx.Module):
    """One simulation. `misfit`: mean square of the residual over the floor, without ripple; `left`: after its step;
    `design_effect`: so many lines counted as one."""

    misfit: float = eqx.field(static=True)
    left: float = eqx.field(static=True)
    design_effect: float = eqx.field(static=True)


def missed(evidence: Evidence, record: Measured) -> Float[np.ndarray, "axis"]:
    """Torque that the simulated robot misses, of the measured torque without its mean, rms by axis."""
    squares = lambda x: np.sum(np.abs(x[:, :, 1:]) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(evidence.residual) / squares(record.U))


class Calibration(eqx.Module):
    """A robot whose uncertain numbers were fitted to records.

    **Fields:**

    - `given`: the robot as it was given; `robot`: as it was found, with the ripple of its motors.
    - `numbers`: that were fitted, and `x`: where, in tolerances from what was given. `covariance`: of x.
      `half_width`: of the 95 % intervals, in x. `data_share`: part of each that the data determine, the rest being what
      was known before. `dependence`: inverse of the normal matrix, in x.
    - `orders`, `waves`: of ripple, with coefficients of sine and cosine, (order, 2), N m or rad.
    - `rounds`: of simulation. `converged`: whether another round would hardly change a number, which
      does not say that they explain the records: see `unexplained`.
    - `missed_before`, `missed_after`: torque that the simulated robot misses, relative, by axis. `heldout`: the same
      two on positions that were not fitted, or `None`. `compared`: what of the robot with the records, in words.
    - `sources`: of the records. `hints`: what could be wrong with the record, in sentences, where most of a torque
      is missed. `misplaced`: where its motors stand elsewhere than q says. `turned`: part of a turn that each motor
      went over.
    """

    given: Robot
    robot: Robot
    numbers: tuple[Number, ...]
    x: Float[np.ndarray, "number"]
    covariance: Float[np.ndarray, "number number"]
    half_width: Float[np.ndarray, "number"]
    data_share: Float[np.ndarray, "number"]
    dependence: Float[np.ndarray, "number number"]
    orders: tuple[Order, ...]
    waves: Float[np.ndarray, "order 2"]
    rounds: tuple[Round, ...]
    converged: bool = eqx.field(static=True)
    missed_before: Float[np.ndarray, "axis"]
    missed_after: Float[np.ndarray, "axis"]
    heldout: tuple[np.ndarray, np.ndarray] | None
    compared: str = eqx.field(static=True)
    sources: tuple = eqx.field(static=True)
    hints: tuple[str, ...] = eqx.field(static=True, default=())
    misplaced: tuple[str, ...] = eqx.field(static=True, default=())
    turned: tuple[float, ...] = eqx.field(static=True, default=())

    @property
    def values(self) -> dict[str, float]:
        """Every number by name, in its unit."""
        return {n.name: n.value(float(x)) for n, x in zip(self.numbers, self.x, strict=True)}

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations, in the numbers' units."""
        spread = np.sqrt(np.diag(self.covariance))
        return {n.name: n.deviation(float(x), float(s)) for n, x, s in zip(self.numbers, self.x, spread, strict=True)}

    def interval(self, name: str) -> tuple[float, float]:
        """The 95 % interval of a number, in its unit."""
        i = [n.name for n in self.numbers].index(name)
        number, x, half = self.numbers[i], float(self.x[i]), float(self.half_width[i])
        return number.value(x - half), number.value(x + half)

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Axes whose torque is missed by more than a tenth, as it is found: what the robot lacks there is in no
        interval."""
        return tuple(n for n, x in zip(self.given.axis_names, self.missed_after, strict=True) if not x <= _MUCH)

    def determined_by(self, name: str) -> str:
        """What a number rests on.

        **Arguments:** `name`: as in `values`.

        **Returns:** "data"; "data in combination" where the data know it only together with others; "prior" where what
        was known before stands; "nothing" where nothing was known before and the data do not tell it.
        """
        i = [n.name for n in self.numbers].index(name)
        alone = 1.0 / np.linalg.inv(self.dependence)[i, i]  # variance of x where all others were known
        prior = self.numbers[i].prior
        if (prior and self.data_share[i] >= DATA_SHARE) or (not prior and np.sqrt(self.covariance[i, i]) < _SURE):
            return "data"
        if self.partners(name) and (1.0 - alone >= DATA_SHARE if prior else alone < _SURE**2):
            return "data in combination"
        return "prior" if prior else "nothing"

    def partners(self, name: str) -> tuple[str, ...]:
        """Numbers that this one is correlated with, strongest first."""
        i = [n.name for n in self.numbers].index(name)
        size = np.sqrt(np.diag(self.dependence))
        rho = np.abs(self.dependence[i] / (size * size[i]))
        return tuple(self.numbers[j].name for j in np.argsort(-rho) if j != i and rho[j] > _TOGETHER)

    def lines(self) -> list[str]:
        """A short summary, line by line."""
        determined = [n for n in self.numbers if self.determined_by(n.name) == "data"]
        text = [
            f"{self.given.name}: {len(self.numbers)} numbers, {len(determined)} of them determined by the data, "
            f"{len(self.rounds)} rounds" + ("" if self.converged else "; not converged"),
            f"compared {self.compared}",
        ]
        for number in determined:
            if number.kind in ("com", "inertia"):
                continue
            low, high = self.interval(number.name)
            text.append(f"{number.name} = {self.values[number.name]:.4g} {number.unit} ({low:.4g} to {high:.4g})")
        named = list(zip(self.given.axis_names, self.missed_before, self.missed_after, strict=True))
        text.append("torque missed: " + ", ".join(f"{n} {percent(b, 3)} -> {percent(a)}" for n, b, a in named))
        if self.heldout is not None:
            pair = zip(self.given.axis_names, *self.heldout, strict=True)
            text.append("held out: " + ", ".join(f"{n} {percent(b, 3)} -> {percent(a)}" for n, b, a in pair))
        return text + self.doubts()

    def doubts(self) -> list[str]:
        """What speaks against believing the intervals, in sentences."""
        named = list(zip(self.given.axis_names, self.missed_before, self.missed_after, strict=True))
        much = ", ".join(f"{percent(a)} of {n}" for n, _, a in named if n in self.unexplained)
        more = ", ".join(
            f"{n} ({percent(b, 3)} -> {percent(a, 3)})" for n, b, a in named if a > max(_RISES * b, _LITTLE)
        )
        said = list(self.misplaced)
        if much:
            said.append(
                f"the model does not explain the torque: {much} is missed, which no interval above holds. Are units, "
                "payload, controller and positions right? If they are, an effect is missing."
            )
            said += self.hints
        if more:
            said.append(
                f"more of the torque is missed than by the robot as given: {more}. What the fit gained elsewhere cost "
                "it there; look at the numbers of that axis before you use them."
            )
        said += self._of_part_of_a_turn()
        if far := _far_off(self.numbers, self.x):
            said.append(
                f"off by more than {_FAR:g} tolerances: {far}. Was it carrying something, is a value or a tolerance "
                "wrong, or is an effect missing? Others, and their intervals, may lean on it."
            )
        return said

    def _of_part_of_a_turn(self) -> list[str]:
        """Ripple of motors that hardly turned."""
        said = []
        for axis, (name, part) in enumerate(zip(self.given.axis_names, self.turned, strict=False)):
            orders = ", ".join(sorted({f"{o.order:g}" for o in self.orders if o.axis == axis}, key=float))
            if orders and part < _PART_OF_TURN:
                said.append(
                    f"ripple of {name} (orders {orders}) is of {part:.1g} of a turn, over which orders stand for each "
                    "other and for friction: together they hold for this motion, one by one for none. Turn the motor "
                    "further, or leave them out."
                )
        return said

    def as_dict(self) -> dict[str, Any]:
        """What fit.json holds."""
        return {
            "kind": "whole robot",
            "compared": self.compared,
            "parameters": {n.name: self._entry(n) for n in self.numbers},
            "ripple": [
                {"joint": self.given.axis_names[o.axis], "kind": o.kind, "order": o.order, "sine": s, "cosine": c}
                for o, (s, c) in zip(self.orders, self.waves.tolist(), strict=True)
            ],
            "converged": self.converged,
            "doubts": self.doubts(),
            "rounds": [{"misfit": r.misfit, "left": r.left, "design_effect": r.design_effect} for r in self.rounds],
            "torque_missed": {
                "before": self.missed_before.tolist(),
                "after": self.missed_after.tolist(),
                "heldout": None if self.heldout is None else [x.tolist() for x in self.heldout],
            },
            "axes": list(self.given.axis_names),
            "robot": self.given.name,
            "sources": [{"name": s.name, "sha256": s.sha256} for s in self.sources],
            "version": __version__,
        }

    def _entry(self, number: Number) -> dict[str, Any]:
        name = number.name
        return {
            "value": self.values[name],
            "std": self.std[name],
            "unit": number.unit,
            "start": number.given,
            "interval95": list(self.interval(name)),
            "determined_by": self.determined_by(name),
            "with": list(self.partners(name))[:3] if self.determined_by(name) == "data in combination" else [],
            "identifiable": self.determined_by(name) == "data",
            "kind": number.kind,
            "size": number.size,
            "logarithmic": number.positive,
            "known_before": bool(number.prior),
        }


def _far_off(numbers: Sequence[Number], x) -> str:
    """Numbers far from what was known of them; how friction turns over has no true value."""
    known = [(n, float(at)) for n, at in zip(numbers, x, strict=True) if n.prior and n.kind != "smoothing"]
    return ", ".join(f"{n.name} ({n.value(at):.4g} {n.unit} for {n.given:.4g})" for n, at in known if abs(at) > _FAR)
