"""Ripple beside the numbers: at the orders that a residual holds, found one after the other; and as it is simulated."""

import itertools
from collections.abc import Sequence

import numpy as np
import scipy.stats

from ..trajectory.evidence import Evidence, Weighed, weigh
from ..trajectory.remainder import remainder
from ..trajectory.ripple import Order, Wave, find_orders, order_columns
from .least_squares import Posterior

TRIED = {"torque": np.arange(1, 51), "resolver": np.arange(1, 13)}  # whole orders of the motor's turn
_AT_ONCE = {"torque": 3, "resolver": 2}  # of every motor, in a round
_NEAR = 3  # orders of one motor no further apart may imitate one that stands between them
_CHANCE = 1e-3  # of an order that is kept without being there
LITTLE = 0.01  # of the squares that are left: ripple that takes away less is not worth another simulation
_MUCH = 0.5  # of the squares that are left: orders that take away more together stay, sure or not


def with_found_orders(
    evidence: Evidence, weighed: Weighed, orders: Sequence[Order], change
) -> tuple[tuple[Order, ...], Weighed]:
    """The strongest orders that are left in the residual behind those that stand there already, and those between
    neighbours of these: where a motor hardly turns, two neighbours are found in the place of the one between them,
    each of them sure, and hold at no other position.

    `change`: what the columns of `weighed` are taken with.
    """
    scenes, orders = evidence.scenes, list(orders)
    left = remainder(evidence, weighed, change)
    new: list[Order] = []
    for axis in range(evidence.robot.n_axes):
        for kind, tried in TRIED.items():
            had = [o.order for o in orders if (o.kind, o.axis) == (kind, axis)]
            found = find_orders(scenes, left, evidence.floor, kind, axis, np.setdiff1d(tried, had), most=_AT_ONCE[kind])
            known = {*had, *(o.order for o in found)}
            new += [*found, *(Order(kind, axis, h) for h in _between(had) if h not in known)]
    return (*orders, *new), weigh(evidence, order_columns(new), weighed)


def _between(orders: Sequence[float]) -> list[float]:
    """Whole orders between neighbouring ones."""
    pairs = itertools.pairwise(sorted(orders))
    return [float(h) for a, b in pairs if b - a <= _NEAR for h in range(int(a) + 1, int(b))]


def sure_orders(orders: Sequence[Order], posterior: Posterior, inside=0.0) -> list[bool]:
    """Which orders are there beyond chance, by the scatter of the data, or together: where a motor hardly turns,
    neighbours take each other's place, and without all of them much more would be left. `inside`: what of them the
    robot has, (order, 2)."""
    if not orders:
        return []
    first = len(posterior.change) - 2 * len(orders)
    waves = posterior.change[first:].reshape(-1, 2) + inside
    spread = np.sqrt(np.diag(posterior.covariance))[first:].reshape(-1, 2)
    size = np.sum((waves / np.where(spread > 0, spread, np.inf)) ** 2, axis=1)
    sure = size > scipy.stats.chi2.isf(_CHANCE, 2)
    covariance = np.linalg.inv(posterior.normal)[first:, first:]
    out: list[int] = []
    for i in np.argsort(size):
        together = _squares(waves, covariance, [*out, i])
        if sure[i] or together > max(_MUCH * posterior.left, scipy.stats.chi2.isf(_CHANCE, 2 * len(out) + 2)):
            break  # it and all that are stronger stay
        out.append(int(i))
    return [i not in out for i in range(len(orders))]


def _squares(waves, covariance, some: Sequence[int]) -> float:
    """What these orders take away together."""
    rows = np.ravel([(2 * k, 2 * k + 1) for k in some])
    return float(waves.ravel()[rows] @ np.linalg.solve(covariance[np.ix_(rows, rows)], waves.ravel()[rows]))


def found_waves(orders: Sequence[Order], posterior: Posterior, inside: Sequence[Wave] = ()) -> tuple[Wave, ...]:
    """Ripple as it would be written: orders that are there beyond chance, and those that were simulated, `inside`,
    whose columns correct them. The latter stay, sure or not: two of them may be told together only."""
    had = {order_key(o) for o, _ in inside}
    waves = _waves(orders, posterior, inside)
    return tuple(wave for wave, sure in waves if sure or (order_key(wave[0]) in had and any(wave[1])))


def waves_to_simulate(orders: Sequence[Order], posterior: Posterior, inside: Sequence[Wave] = ()) -> tuple[Wave, ...]:
    """Ripple that is there beyond chance, whether it was simulated (`inside`) or not, and what of the latter takes much
    away, sure or not."""
    return tuple(wave for wave, stays in _next(orders, posterior, inside) if stays)


def other_share(orders: Sequence[Order], posterior: Posterior, inside: Sequence[Wave]) -> float:
    """What orders take away that are simulated next and were not, or that were and will not be, over what is left."""
    had, waves = {order_key(o) for o, _ in inside}, _next(orders, posterior, inside)
    other = [i for i, ((order, _), stays) in enumerate(waves) if stays != (order_key(order) in had)]
    return _share_of([wave for (_, wave), _ in waves], posterior)(other) if other else 0.0


def _next(orders: Sequence[Order], posterior: Posterior, inside: Sequence[Wave]) -> list[tuple[Wave, bool]]:
    """Every order with what there is of it, and whether it is simulated next."""
    had, waves = {order_key(o) for o, _ in inside}, _waves(orders, posterior, inside)
    share = _share_of([wave for (_, wave), _ in waves], posterior)
    stays = [sure or (order_key(o) in had and share([i]) > LITTLE) for i, ((o, _), sure) in enumerate(waves)]
    return [(wave, is_next) for (wave, _), is_next in zip(waves, stays, strict=True)]


def _share_of(waves: Sequence[tuple[float, float]], posterior: Posterior):
    """A function that says what some of these orders take away together, over what is left."""
    first = len(posterior.change) - 2 * len(waves)
    covariance, sizes = np.linalg.inv(posterior.normal)[first:, first:], np.array(waves)
    return lambda some: _squares(sizes, covariance, some) / max(posterior.left, 1e-300)


def _waves(orders: Sequence[Order], posterior: Posterior, inside: Sequence[Wave]) -> list[tuple[Wave, bool]]:
    """Every order with what there is of it, and whether that is there beyond chance."""
    had = {order_key(o): np.array(w) for o, w in inside}
    own = np.array([had.get(order_key(o), np.zeros(2)) for o in orders]).reshape(-1, 2)
    waves = own + posterior.change[len(posterior.change) - 2 * len(orders) :].reshape(-1, 2)
    sure = sure_orders(orders, posterior, own)
    return [
        ((order, (float(wave[0]), float(wave[1]))), is_sure and bool(np.any(wave)))
        for order, wave, is_sure in zip(orders, waves, sure, strict=True)
    ]


def order_key(order: Order) -> tuple[str, int, float]:
    """What two equal orders have in common."""
    return order.kind, order.axis, order.order
