"""What every candidate promises to take off the cost of a robot whose numbers are fitted, to first order."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from .. import effects as fx
from ..effects import AbstractEffect
from ..trajectory.evidence import placed, precise, weigh
from ..trajectory.joined import places
from ..trajectory.measured import Measured
from ..trajectory.remainder import remainder
from ..trajectory.ripple import gear_orders
from ..trajectory.signature import signature
from .candidates import Candidate, candidates, gear_errors
from .fitted import Fitted
from .settings import OWN

_RIDGE = 1e-9  # of a column's square: products are made in single precision


class Scored(eqx.Module):
    """A candidate. `effect`: as it would begin. `part`: of the cost. `t`: of the score, over the positions. `size`:
    over the just visible one."""

    effect: AbstractEffect
    joint: str = eqx.field(static=True)
    part: float = eqx.field(static=True)
    t: float = eqx.field(static=True)
    size: float = eqx.field(static=True)

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.joint


def ranked(view: Fitted, record: Measured, own: Sequence[type[AbstractEffect]] = ()) -> list[Scored]:
    """All candidates beside the numbers of a robot, best first.

    The cost is |residual/floor|^2/effect + the squares of the tolerances that numbers are off by; a column takes off it
    what is its own beside the numbers, and what it saves them. A number with a tolerance is set free."""
    cost = squares(view) / view.look.posterior.effect + view.priced
    return sorted([*_columns(view, record, own, cost), *_set_free(view, cost)], key=lambda s: -s.part)


def squares(view: Fitted) -> float:
    """Of what is left, over the floor that follows it."""
    gram, change = view.look.weighed.gram, view.look.posterior.change
    A, b = gram.A.sum(axis=0), gram.b.sum(axis=0)
    return float(gram.rr.sum() - 2 * b @ change + change @ A @ change)


def _columns(view: Fitted, record: Measured, own, cost: float) -> list[Scored]:
    look, posterior = view.look, view.look.posterior
    pool = _pool(view, record, own)
    count = look.weighed.gram.b.shape[1]
    columns = [lambda s, e=e: signature(e, s) for c in pool for e in c.basis]
    base = placed(precise(look.weighed), places(record.data))
    gram = placed(precise(weigh(look.evidence, columns, base)), places(record.data)).gram
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
        x = np.clip(np.linalg.solve(a + _RIDGE * np.diag(size), p), candidate.low, candidate.high)
        drop = float(2 * x @ p - x @ a @ x) / posterior.effect
        if not np.any(x) or drop <= 0:
            continue
        each = (left[:, rows] - left[:, :count] @ s) @ x
        made = candidate.make(x)
        found.append(
            Scored(made, candidate.joint, float(drop / cost), _t(each, gram.position), _size(candidate, made, x))
        )
    return found


def _pool(view: Fitted, record: Measured, own) -> list[Candidate]:
    """Effects that are no number of the robot already."""
    largest = np.abs(np.asarray(record.data.u)).max(axis=(0, 1, 2))
    had = {n.name for n in view.these}
    at_its_numbers = view.look.evidence.robot
    found = [*candidates(at_its_numbers, largest, own), *_gear_errors(view)]
    return [c for c in found if f"{c.joint}.{_NUMBERS.get(c.name, c.name)}" not in had]


def _gear_errors(view: Fitted) -> list[Candidate]:
    """Errors of the teeth of every gear, at the orders that most of the residual goes by."""
    look, robot, found = view.look, view.look.evidence.robot, []
    change = look.posterior.change
    first = len(change) - 2 * len(look.orders)
    for axis in robot.flexible_axes:
        # Whole orders of this motor stay in the residual: they would take most of an error at an order nearby.
        other = np.array([i < first or look.orders[(i - first) // 2].axis != axis for i in range(len(change))])
        left = remainder(look.evidence, look.weighed, change[other], np.flatnonzero(other))
        found += gear_errors(robot, axis, gear_orders(look.evidence.scenes, left, look.evidence.floor, axis))
    return found


# Effects that are an error of a number which a robot may have.
_NUMBERS = {"torque_delay": "delay", "stiffness_hardening": "stiffness_ratio"}


def _size(candidate: Candidate, effect, x) -> float:
    amplitude = getattr(effect, "amplitude", None)
    return float(abs(x[0]) if amplitude is None else np.max(np.asarray(amplitude))) / candidate.visible


def _t(each, positions) -> float:
    sums = np.array([each[positions == c].sum() for c in np.unique(positions)])
    sums = sums if len(sums) > 1 else each
    if len(sums) < 2:
        return float("nan")
    return float(sums.mean() * np.sqrt(len(sums)) / max(sums.std(ddof=1), 1e-300))


_FREE = {
    "coulomb_friction": (fx.CoulombFriction, "level"),
    "viscous_friction": (fx.ViscousFriction, "coefficient"),
    "motor_inertia": (fx.MotorInertia, "increase"),
}


def _set_free(view: Fitted, cost: float) -> list[Scored]:
    """What it would save to know nothing of a number beforehand: exact, where a cost is quadratic."""
    posterior, robot = view.look.posterior, view.robot
    inverse = np.diag(np.linalg.inv(posterior.normal))
    std = np.sqrt(np.diag(posterior.covariance))
    found = []
    for i, (number, x) in enumerate(zip(view.these, view.x, strict=True)):
        if not number.prior or number.kind not in (*_FREE, "torque_constant"):
            continue
        value = number.value(float(x))
        effect = _error(number, value)
        typical = type(effect).typical(robot, number.joint)
        first = next(iter(effect.units))
        size = abs(float(getattr(effect, first))) / abs(float(getattr(typical, first)))
        saved = float(x) ** 2 / max(1.0 - inverse[i], 1e-6)
        found.append(Scored(effect, number.joint, float(saved / cost), float(x / max(std[i], 1e-12)), float(size)))
    return found


def _error(number, value: float) -> AbstractEffect:
    if number.kind == "torque_constant":
        return fx.TorqueConstant(number.joint, value)
    kind, _ = _FREE[number.kind]
    return kind(number.joint, value - number.given)
