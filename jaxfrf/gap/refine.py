"""Parameters of an effect that enter nonlinearly, by Gauss-Newton on its signature."""

import equinox as eqx
import numpy as np

from ..effects import AbstractEffect, StiffnessHardening
from ..effects._place import spring_of
from ..robot import Robot
from ..trajectory.evidence import weigh
from ..trajectory.signature import signature
from .score import fit_beside, projected, sums, variance
from .stage import Stage

_STEP = 0.02  # of a parameter, for its derivative
_LONGEST = 0.5  # of one step, in the logarithm or of the visible value
_ROUNDS = 6

# What may be changed beside the first parameter, which always may; all of them are positive and known by scale.
MORE: dict[str, tuple[str, ...]] = {
    "stribeck_friction": ("width",),
    "stiffness_hardening": ("knee",),
    "gear_hysteresis": ("slip",),
    "extra_flexibility": ("damping",),
    "counterbalance": ("rest",),
    "dress_pack": ("rest",),
}
FIRST = {"extra_flexibility": "stiffness", "payload": "mass"}
FIXED = frozenset(("torque_ripple", "resolver_ripple", "transmission_error", "encoder_quantisation"))
_SIGNED = frozenset(("rest",))


class Refined(eqx.Module):
    """An effect with its parameters refined. `drop`: decrease of the squares it makes with the base giving way.
    `names`, `std`: of its parameters, with the misfit that is left and the scatter of model errors counted by it."""

    effect: AbstractEffect
    drop: float
    names: tuple[str, ...] = eqx.field(static=True)
    std: tuple[float, ...] = eqx.field(static=True)


def names_of(effect: AbstractEffect) -> tuple[str, ...]:
    """Parameters that are refined."""
    if effect.name in FIXED:
        return ()
    first = FIRST.get(effect.name, next(iter(effect.units)))
    return (first, *MORE.get(effect.name, ()))


def absent(effect: AbstractEffect, robot: Robot) -> float:
    """Value of the first parameter at which a robot is as it is without the effect. Of a stiffness or a limit that is
    infinity; being zero or being infinite are as many relative standard deviations away."""
    if isinstance(effect, StiffnessHardening):
        return float(robot.springs.stiffness_ratio[spring_of(robot, effect.joint)])
    return 0.0


def refine(stage: Stage, effect: AbstractEffect, visible: float, simulated: AbstractEffect | None = None) -> Refined:
    """Fit the parameters of one effect beside the base of a stage.

    **Arguments:** `visible`: size of the first parameter that is just visible. `simulated`: the effect as the stage's
    robot already has it; `None` where it has not.
    """
    names = names_of(effect)
    offset = None if simulated is None else lambda scene: signature(simulated, scene)
    best = None
    for round in range(_ROUNDS + 1):
        steps = [_step(effect, name, visible) for name in names]
        moved = [_moved(effect, name, step) for name, step in zip(names, steps, strict=True)]
        columns = [_difference(effect, offset)] + [
            _slope(effect, other, step) for other, step in zip(moved, steps, strict=True)
        ]
        weighed = weigh(stage.evidence, columns, stage.weighed)
        start = stage.weighed.gram.b.shape[1]
        fit = fit_beside(weighed.gram, stage.fit, start)
        value = _fixed_drop(weighed.gram, stage.fit, fit, start)
        if best is None or value > best.drop:
            best = Refined(effect, value, names, (0.0,) * len(names))
        elif round:
            break
        if not names:
            break
        change, std = _newton(weighed.gram, fit, start, len(names))
        best = Refined(best.effect, best.drop, names, tuple(float(x) for x in std))
        if round == _ROUNDS:
            break
        following = effect
        for name, delta in zip(names, change, strict=True):
            following = _limited(following, name, delta, visible)
        if simulated is not None:
            following = _within_reach(following, simulated, names)
        if all(
            abs(a - b) < 1e-3 * abs(b) + 1e-15
            for a, b in zip(_values(following, names), _values(effect, names), strict=True)
        ):
            break
        effect = following
    return best


def _values(effect, names):
    return [float(getattr(effect, n)) for n in names]


def _difference(effect, offset):
    if offset is None:
        return lambda scene: signature(effect, scene)
    return lambda scene: signature(effect, scene) - offset(scene)


def _slope(effect, other, step):
    return lambda scene: (signature(other, scene) - signature(effect, scene)) / step


def _step(effect, name, visible) -> float:
    value = float(getattr(effect, name))
    if name in _SIGNED:
        return 0.02
    return _STEP * max(abs(value), abs(visible) if name == names_of(effect)[0] else 0.0)


def _moved(effect, name, step):
    return eqx.tree_at(lambda e: getattr(e, name), effect, float(getattr(effect, name)) + step)


def _limited(effect, name, delta, visible):
    value = float(getattr(effect, name))
    low, high = effect.bounds.get(name, (-np.inf, np.inf))
    if name in _SIGNED:
        new = value + float(np.clip(delta, -0.5, 0.5))
    elif low >= 0 and value > 0:
        new = value * float(np.exp(np.clip(delta / value, -_LONGEST, _LONGEST)))
    else:
        size = max(abs(value), abs(visible))
        new = value + float(np.clip(delta, -size, size))
    return eqx.tree_at(lambda e: getattr(e, name), effect, float(np.clip(new, low, high)))


def _within_reach(effect, simulated, names):
    """Scales stay near those that were simulated: the signature of a change is of first order."""
    for name in names:
        value, old = float(getattr(effect, name)), float(getattr(simulated, name))
        if value > 0 and old > 0 and name not in _SIGNED:
            value = float(np.clip(value, old * np.exp(-_LONGEST), old * np.exp(_LONGEST)))
            effect = eqx.tree_at(lambda e, name=name: getattr(e, name), effect, value)
    return effect


def _fixed_drop(gram, before, fit, row) -> float:
    """Decrease of the squares by one column with the coefficient one, the base as `fit` beside it."""
    columns, x = np.append(fit.columns, row), np.append(fit.x, 1.0)
    A, b, rr = sums(gram, fit.columns, fit.limits, fit.runs)
    return before.squares - float(rr - 2 * b[columns] @ x + x @ A[np.ix_(columns, columns)] @ x)


def _newton(gram, fit, row, count: int):
    rows = [row, *range(row + 1, row + 1 + count)]
    a, p = projected(gram, fit, rows)
    left = p[1:] - a[1:, 0]
    inner = a[1:, 1:] + 1e-9 * np.diag(np.diag(a[1:, 1:])) + 1e-300 * np.eye(count)
    inverse = np.linalg.pinv(inner)
    known = np.diag(inverse) > 0  # else nothing of the column is its own beside the base
    return inverse @ left, np.sqrt(np.where(known, np.diag(inverse) * variance(gram, fit), np.inf))


def beside(stage: Stage, effect: AbstractEffect, simulated: AbstractEffect | None = None):
    """Coefficients of all base columns where this effect is there, zero for those that stand apart."""
    offset = None if simulated is None else lambda scene: signature(simulated, scene)
    weighed = weigh(stage.evidence, [_difference(effect, offset)], stage.weighed)
    row = stage.weighed.gram.b.shape[1]
    x = np.zeros(row)
    x[stage.fit.columns] = fit_beside(weighed.gram, stage.fit, row).x
    return x
