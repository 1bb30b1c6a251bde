"""Numbers of a rigid robot that give way within what is known of them, beside what is looked for."""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Bool, Float

from ...calibration.columns import OF_LINKS
from ...calibration.from_motion import thinned_rows, torque_slopes
from ...calibration.numbers import Number, numbers, with_numbers
from ...robot import Friction, Robot
from ...trajectory.rigid_motion import MeasuredMotion
from ..settings import GIVES

_KINDS = (*OF_LINKS, "coulomb_friction", "smoothing", "torque_constant")
_UNKNOWN = 1e-9  # of what a tolerance costs, for numbers of which nothing is known
_AT_BOUND = 1.0 - 1e-6  # of a bound

Rows = Float[np.ndarray, "row"]


class GivingNumbers(eqx.Module):
    """Coordinates of numbers, in tolerances, with what one of each adds to the needed torque, to first order.

    **Fields:** `numbers`; `columns`: (row, number), over the unit of the rows. `price`: squares of rows that a
    tolerance costs.
    """

    numbers: tuple[Number, ...] = eqx.field(static=True)
    columns: Float[np.ndarray, "row number"]
    price: float = eqx.field(static=True, default=0.0)

    def at(self, r: Rows) -> Float[np.ndarray, "number"]:
        """Where the numbers are of which least is left of r: within `GIVES` tolerances, each at its price."""
        if not self.numbers:
            return np.zeros(0)
        scaled, root = self._scaled()
        normal = scaled.T @ scaled + self.price * np.eye(len(root))
        triangle = scipy.linalg.cholesky(normal)
        target = scipy.linalg.solve_triangular(triangle, scaled.T @ r, trans="T")
        most = GIVES * root * np.where([n.prior > 0.0 for n in self.numbers], 1.0, np.inf)
        return scipy.optimize.lsq_linear(triangle, target, (-most, most), method="bvls").x / root

    def beside(self, r: Rows) -> tuple[Rows, Callable[[np.ndarray], np.ndarray]]:
        """What r is beside those that stand at their bounds, and a weight of rows in which the others, as uncertain as
        they are, count as noise (generalised least squares)."""
        x = self.at(r)
        stuck = np.array([n.prior > 0.0 for n in self.numbers], bool) & (np.abs(x) > _AT_BOUND * GIVES)
        return r - self.columns[:, stuck] @ x[stuck], self._weight(~stuck)

    def _weight(self, free: Bool[np.ndarray, "number"]) -> Callable[[np.ndarray], np.ndarray]:
        if not free.any():
            return lambda rows: rows
        scaled = self._scaled()[0][:, free]
        square, vectors = np.linalg.eigh(scaled.T @ scaled)
        shows = square > 1e-12 * square[-1]
        square, axes = square[shows], scaled @ vectors[:, shows]
        share = (1.0 - np.sqrt(self.price / (square + self.price))) / square
        return lambda rows: rows - axes @ (share * (axes.T @ rows).T).T

    def _scaled(self):
        root = np.sqrt([n.prior or _UNKNOWN for n in self.numbers])
        return self.columns / root, root

    def of(self, robot: Robot, x: Float[np.ndarray, "number"]) -> Robot:
        """The robot with these coordinates."""
        return with_numbers(robot, self.numbers, x) if self.numbers else robot


def giving_numbers(robot: Robot, motions: Sequence[MeasuredMotion], size: Float[np.ndarray, "axis"]) -> GivingNumbers:
    """Masses, centres, inertias, Coulomb friction and torque constants of a robot as its tolerances say."""
    known = isinstance(robot.drives.friction, Friction)
    some = tuple(n for n in numbers(robot) if n.kind in _KINDS and not n.of_effect) if known else ()
    if not some:
        return GivingNumbers((), np.zeros((0, 0)))
    as_given = np.zeros(len(some))
    slopes = [torque_slopes(robot, some, as_given, thinned_rows(robot, m, None)) / size[:, None] for m in motions]
    return GivingNumbers(some, np.concatenate(slopes).reshape(-1, len(some)))
