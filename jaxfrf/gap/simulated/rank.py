"""What every candidate promises to take off the cost of a robot whose numbers are fitted, to first order."""

import functools
import operator
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ... import effects as fx
from ..._threads import shared
from ...calibration.least_squares import solve
from ...effects import AbstractEffect, OwnNumber
from ...effects._place import axis_of
from ...robot import Robot
from ...trajectory.evidence import Gram, parts_beside, put_over_floor, scattered
from ...trajectory.joined import places
from ...trajectory.measured import Measured
from ...trajectory.remainder import remainder, steady_seen
from ...trajectory.ripple import gear_orders
from ...trajectory.signature import signature
from ..settings import DISBELIEVED, OWN
from .candidates import Candidate, candidates
from .fitted import Fitted

_RIDGE = 1e-9  # of a column's square: products are made in single precision


class Scored(eqx.Module):
    """A candidate. `effect`: as it would begin. `part`: of the cost. `t`: of the score, over the positions. `size`:
    over the just visible one. `disbelieved`: a number whose tolerance cannot be true."""

    effect: AbstractEffect
    joint: str = eqx.field(static=True)
    part: float = eqx.field(static=True)
    t: float = eqx.field(static=True)
    size: float = eqx.field(static=True)
    disbelieved: bool = eqx.field(static=True, default=False)

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.joint


def ranked(
    view: Fitted, record: Measured, own: Sequence[type[AbstractEffect]] = (), misses: bool = True
) -> list[Scored]:
    """All candidates beside the numbers of a robot, best first; those numbers alone whose tolerance cannot be believed,
    where there are some and the robot `misses` nothing else.

    The cost is |residual/floor|^2/effect + the squares of the tolerances that numbers are off by; a column takes off it
    what is its own beside the numbers, and what it saves them. A number whose tolerance cannot be believed is set
    free."""
    cost = view.iterate.posterior.left + view.prior_cost
    numbers = _set_free(view, record, cost)
    terms = _columns(view, record, own) if misses or not numbers else []
    view.iterate.evidence.forget()
    return sorted([*terms, *numbers], key=lambda s: -s.part)


def _columns(view: Fitted, record: Measured, own) -> list[Scored]:
    iterate = view.iterate
    pool = _pool(view, record, own)
    count = iterate.weighed.gram.b.shape[1]
    signatures = [functools.partial(signature, e) for c in pool for e in c.basis]
    parts = parts_beside(iterate.evidence, signatures, iterate.weighed.parts)
    put_over_floor(parts, iterate.evidence.floor, steady_seen(iterate.evidence))
    gram = scattered(parts, places(record.data)).gram
    base = Gram(gram.A[:, :count, :count], gram.b[:, :count], gram.rr, gram.position, gram.count)
    posterior = solve(base, view.numbers, iterate.x)
    x = iterate.x + posterior.change[: len(view.numbers)]
    cost = posterior.left + float(np.sum(posterior.prior[: len(x)] * x**2))
    left = gram.b - np.einsum("rij,j->ri", gram.A[:, :, :count], posterior.change)
    whole = gram.A.sum(axis=0)
    share = np.linalg.solve(posterior.normal, whole[:count, count:] / posterior.effect)
    found, start = [], count
    for candidate in pool:
        rows = np.arange(start, start + len(candidate.basis))
        start += len(rows)
        s = share[:, rows - count]
        a = whole[np.ix_(rows, rows)] - whole[np.ix_(rows, np.arange(count))] @ s
        size = np.diag(whole)[rows]
        if np.any(size <= 0) or np.any(np.diag(a) < OWN * size):
            continue
        p = left[:, rows].sum(axis=0)
        c = np.clip(np.linalg.solve(a + _RIDGE * np.diag(size), p), candidate.low, candidate.high)
        drop = float(2 * c @ p - c @ a @ c) / posterior.effect
        if not np.any(c) or drop <= 0:
            continue
        each = (left[:, rows] - left[:, :count] @ s) @ c
        made = candidate.make(c)
        found.append(
            Scored(made, candidate.joint, float(drop / cost), _t(each, gram.position), _size(candidate, made, c))
        )
    return found


def _pool(view: Fitted, record: Measured, own) -> list[Candidate]:
    """Effects that are no number of the robot already."""
    at_its_numbers = view.iterate.evidence.robot
    found = [*candidates(at_its_numbers, _largest(record), own), *_gear_errors(view)]
    had = {n.name for n in view.numbers}
    return [c for c in found if not is_had(at_its_numbers, c.basis[0], had)]


def _largest(record: Measured) -> Float[np.ndarray, "axis"]:
    """Torque, N m."""
    return np.abs(np.asarray(record.data.u)).max(axis=(0, 1, 2))


def is_had(robot, effect: AbstractEffect, had: set[str]) -> bool:
    """Whether the numbers of a robot are fitted that an effect would change."""
    if effect.unknown_beside(robot):
        return False
    own = effect.own_numbers(robot)
    return bool(own) and (own[0].number in had or _is_stated(robot, effect, own[0].number))


def _is_stated(robot, effect: AbstractEffect, number: str) -> bool:
    """Whether a robot has an effect whose number would be taken for that of a second one on the same joint."""
    if number.count(".") < 2:  # joint.kind: such numbers are the sum of all
        return False
    axis = axis_of(robot, effect.joint)
    return any(e.name == effect.name and axis_of(robot, e.joint) == axis for e in robot.effects)


def _gear_errors(view: Fitted) -> list[Candidate]:
    """Errors of the teeth of every gear, at the orders that most of the residual goes by."""
    iterate, robot = view.iterate, view.iterate.evidence.robot
    change = iterate.posterior.change
    first = len(change) - 2 * len(iterate.orders)

    def orders(axis: int) -> list[float]:
        # Whole orders of this motor stay in the residual: they would take most of an error at an order nearby.
        other = np.array([i < first or iterate.orders[(i - first) // 2].axis != axis for i in range(len(change))])
        left = remainder(iterate.evidence, iterate.weighed, change[other], np.flatnonzero(other))
        return gear_orders(iterate.evidence.scenes, left, iterate.evidence.floor, axis)

    found: list[Candidate] = []
    for axis, tried in zip(robot.flexible_axes, shared(orders, robot.flexible_axes), strict=True):
        for kind in fx.library().values():
            if issubclass(kind, fx.AbstractGearError):
                found += kind.candidates_at(robot, robot.axis_names[axis], tried)
    return found


def _size(candidate: Candidate, effect, x) -> float:
    amplitude, one = (getattr(e, "amplitude", None) for e in (effect, candidate.basis[0].stated()))
    if amplitude is None or one is None:
        return float(abs(x[0])) / candidate.visible
    return float(np.max(np.asarray(amplitude)) / np.max(np.asarray(one))) / candidate.visible


def _t(each, positions) -> float:
    sums = np.array([each[positions == c].sum() for c in np.unique(positions)])
    sums = sums if len(sums) > 1 else each
    if len(sums) < 2:
        return float("nan")
    return float(sums.mean() * np.sqrt(len(sums)) / max(sums.std(ddof=1), 1e-300))


def _set_free(view: Fitted, record: Measured, cost: float) -> list[Scored]:
    """What it would save to know nothing of a number beforehand: exact, where a cost is quadratic."""
    statistic, p_values, found = view.tolerance_statistic, view.tolerance_p_values, []
    errors = _errors(view.robot, _largest(record)) if view.out_of_tolerance else {}
    for i in view.out_of_tolerance:
        number = view.numbers[i]
        if number.name not in errors:
            continue
        typical, joint, own = errors[number.name]
        error = number.value(float(view.x[i])) - own.minus
        size = abs(error / float(getattr(typical, own.parameter)))
        sure = bool(p_values[i] < DISBELIEVED)
        effect = eqx.tree_at(operator.attrgetter(own.parameter), typical, error)
        found.append(Scored(effect, joint, float(statistic[i] ** 2 / cost), float(statistic[i]), size, sure))
    return found


def _errors(robot: Robot, largest) -> dict[str, tuple[AbstractEffect, str, OwnNumber]]:
    """By number: the effect that is its error, as it is just visible, and on which joint."""
    found: dict[str, tuple[AbstractEffect, str, OwnNumber]] = {}
    for candidate in candidates(robot, largest):
        kind = type(candidate.basis[0])
        if kind.is_error:
            typical = kind.typical(robot, candidate.joint)
            for own in typical.own_numbers(robot):
                found.setdefault(own.number, (typical, candidate.joint, own))
    return found
