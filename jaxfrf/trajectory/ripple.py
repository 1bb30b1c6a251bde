"""Ripple over the motor's angle: which orders a residual holds, of torque, of the resolver, of the gear."""

import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
import scipy.fft
from jaxtyping import Float

from ..effects import AbstractEffect, ResolverRipple, TorqueRipple
from ..robot import Robot
from .scene import Scene, Signature

RIPPLE: dict[str, type[TorqueRipple] | type[ResolverRipple]] = {"torque": TorqueRipple, "resolver": ResolverRipple}
_ORDERS = np.arange(1, 51)
_GEAR_ORDERS = np.arange(0.25, 8.0, 0.1)  # of a gear's error: in a motor's turn
_RATE = 500.0  # Hz, of the course of a residual that orders are looked for in, at least
_LOUD = 8e-3  # of the torque limit: above, ripple is no background
_LOUD_RESOLVER = 6.5e-3  # rad, amplitude times order squared: 1.6 times what resolvers have


class Order(eqx.Module):
    """One order of ripple of one motor: sine and cosine are two columns.

    **Fields:** `kind`: "torque", "resolver" or "gear". `axis`; `order`: per motor turn.
    """

    kind: str = eqx.field(static=True)
    axis: int = eqx.field(static=True)
    order: float = eqx.field(static=True)

    @classmethod
    def of(cls, kind: str, axis: float, order: float) -> "Order":
        """From what a file holds of it, see `listed`."""
        return cls(kind, int(axis), float(order))

    def listed(self) -> list:
        """For a file."""
        return [self.kind, self.axis, self.order]

    def columns(self, scene: Scene) -> tuple[Signature, Signature]:
        """Of sin(order theta) and cos(order theta), N m or rad."""
        return self._columns(scene, slice(None))

    def loud(self, robot: Robot) -> float:
        """Amplitude that is more than a motor's usual ripple, N m or rad."""
        if self.kind == "torque":
            limit = float(robot.drives.torque_limit[self.axis])
            return _LOUD * (limit if np.isfinite(limit) else 1.0)
        return _LOUD_RESOLVER / self.order**2

    def one(self, scene: Scene) -> Signature:
        """The first column of the first run."""
        return self._columns(scene, slice(0, 1))[0]

    def _columns(self, scene: Scene, runs: slice):
        if self.order == int(self.order):
            turned = _power(scene.turn[self.axis, runs], int(self.order))
        else:
            turned = np.exp(1j * self.order * scene.reading[runs, :, self.axis])
        waves = turned.imag, turned.real
        if self.kind == "torque":
            return tuple(scene.by_motor(self.axis, -x) for x in waves)
        if self.kind == "resolver":
            return tuple(scene.by_sensor(self.axis, x) for x in waves)
        spring = scene.robot.flexible_axes.index(self.axis)
        load = scene.load[runs, :, self.axis]
        slopes = self.order * waves[1] * scene.gear[self.axis], -self.order * waves[0] * scene.gear[self.axis]
        return tuple(
            scene.by_shift(spring, 1e-5 * x) * 1e5 + scene.by_motor(self.axis, slope * load)
            for x, slope in zip(waves, slopes, strict=True)
        )


def _power(x, n: int):
    """x^n of a whole n from 1 on, by few products."""
    if n == 1:
        return x
    half = _power(x, n // 2)
    return half * half * x if n % 2 else half * half


def strength(
    scene: Scene, weighted: np.ndarray, kind: str, axis: int, orders: Float[np.ndarray, "order"] = _ORDERS
) -> np.ndarray:
    """Correlation of a residual with e^{j order theta}, (order,), complex; positions add up.

    **Arguments:** `weighted`: residual times the inverse of its floor squared, (exp, line, axis).
    """
    own = weighted[..., axis]
    if kind == "resolver":
        own = own * -np.conj(scene.still.impedance[:, axis, axis])
    elif kind == "gear":
        spring = scene.robot.flexible_axes.index(axis)
        own = np.einsum("ela,la->el", weighted, np.conj(scene.per_shift(spring)))
    count, angle = _coarse(scene, axis)
    course = scipy.fft.irfft(own, n=count, axis=1) * count
    return np.array([np.vdot(turned, course) for turned in _turning(angle, np.asarray(orders, float))])


def _coarse(scene: Scene, axis: int) -> tuple[int, np.ndarray]:
    """A number of samples that is enough for orders, and the measured angle there, (exp, sample)."""
    count = scene.samples(_RATE)
    some = np.round(np.arange(count) * (scene.period / count)).astype(int)
    return count, scene.reading[:, some, axis]


def _turning(angle, orders):
    """e^{j h angle} of one order h after the other; on a grid each from the one before, which is quicker."""
    step = np.min(np.diff(orders), initial=1.0)
    places = np.round((orders - orders[0]) / step).astype(int)
    if not np.allclose(orders[0] + step * places, orders, atol=1e-9):
        yield from (np.exp(1j * h * angle) for h in orders)
        return
    now, turn, at = np.exp(1j * orders[0] * angle), np.exp(1j * step * angle), 0
    for place in places:
        while at < place:
            now, at = now * turn, at + 1
        yield now


def find_orders(scenes, residuals, floor, kind: str, axis: int, orders=_ORDERS, most: int = 6) -> list[Order]:
    """The strongest orders of one motor in a residual, those first that would take most away from it alone."""
    weight = 1.0 / np.square(floor)
    b = sum(strength(s, r * weight, kind, axis, orders) for s, r in zip(scenes, residuals, strict=True))
    size = np.array([_weighted_power(scenes[0], Order(kind, axis, float(h)), floor) for h in orders])
    drop = np.abs(b) ** 2 / np.maximum(size, 1e-12 * size.max())
    best = np.argsort(drop)[::-1][:most]
    return [Order(kind, axis, float(orders[i])) for i in best]


def _weighted_power(scene: Scene, order: Order, floor) -> float:
    """Weighted power of an order in the first run."""
    return float(np.sum(np.abs(order.one(scene) / floor) ** 2))


def gear_orders(scenes, residuals, floor, axis: int, most: int = 4) -> list[float]:
    """Orders of the motor's angle, not whole, that a gear's error would have, by what it and its second harmonic would
    take off: at every position by itself, then in phase."""
    weighted = [r / np.square(floor) for r in residuals]
    each = np.array([_harmonics(s, w, axis, _GEAR_ORDERS) for s, w in zip(scenes, weighted, strict=True)])
    some = _GEAR_ORDERS[::4]
    sizes = np.array([_gear_powers(scenes[0], floor, axis, harmonic * some) for harmonic in (1.0, 2.0)])
    size = lambda orders: np.array([np.interp(orders, some, row) for row in sizes])
    power = np.sum(np.sum(np.abs(each) ** 2, axis=0) / size(_GEAR_ORDERS), axis=0)
    found: list[float] = []
    for i in np.argsort(power)[::-1]:
        if all(abs(_GEAR_ORDERS[i] - f) > 0.3 for f in found):
            found.append(float(_GEAR_ORDERS[i]))
        if len(found) == most:
            break
    result = []
    for peak in found:
        fine = peak + np.arange(-0.12, 0.12, 0.003)
        b = np.sum([_harmonics(s, w, axis, fine) for s, w in zip(scenes, weighted, strict=True)], axis=0)
        result.append(float(fine[int(np.argmax(np.sum(np.abs(b) ** 2 / size(fine), axis=0)))]))
    return result


def _harmonics(scene: Scene, weighted, axis: int, orders) -> np.ndarray:
    """Strength of a gear's error at orders and at twice these, (2, order)."""
    return np.array([strength(scene, weighted, "gear", axis, harmonic * orders) for harmonic in (1.0, 2.0)])


def _gear_powers(scene: Scene, floor, axis: int, orders) -> Float[np.ndarray, "order"]:
    """Weighted power of a gear's error of one unit in the first run."""
    count, angle = _coarse(scene, axis)
    per_shift = scene.per_shift(scene.robot.flexible_axes.index(axis)) / floor
    seen = np.sum(np.abs(per_shift) ** 2, axis=1)
    waves = (scipy.fft.rfft(np.sin(h * angle[0]))[: len(seen)] / count for h in orders)
    return np.array([np.sum(np.abs(wave) ** 2 * seen[: len(wave)]) for wave in waves])


Wave = tuple[Order, tuple[float, float]]  # with coefficients of sine and cosine, N m or rad


def order_columns(orders: Sequence[Order]) -> list[Callable[[Scene], Signature]]:
    """Sine and cosine of each order, (2 order) columns."""
    return [functools.partial(pair, i) for pair in map(_Pair, orders) for i in (0, 1)]


class _Pair:
    """Sine and cosine of an order, which are made together: the second is kept until it is asked for."""

    def __init__(self, order: Order):
        self.order = order
        self._second: dict[int, Signature] = {}

    def __call__(self, i: int, scene: Scene) -> Signature:
        if i == 1 and id(scene) in self._second:
            return self._second.pop(id(scene))
        both = self.order.columns(scene)
        self._second[id(scene)] = both[1]
        return both[i]


def kind_of(effect: AbstractEffect) -> str:
    """`torque` or `resolver`; "" of what is no ripple."""
    return next((kind for kind, make in RIPPLE.items() if isinstance(effect, make)), "")


def ripple_effects(names: Sequence[str], orders: Sequence[Order], waves) -> list[AbstractEffect]:
    """One effect for each motor and kind; `waves`: coefficients of sine and cosine, (order, 2)."""
    found: list[AbstractEffect] = []
    for axis, joint in enumerate(names):
        for kind, make in RIPPLE.items():
            rows = [i for i, o in enumerate(orders) if (o.kind, o.axis) == (kind, axis)]
            if rows:
                amplitude = np.hypot(*waves[rows].T)
                phase = np.arctan2(waves[rows, 1], waves[rows, 0])
                found.append(make(joint, amplitude, [int(orders[i].order) for i in rows], phase))
    return found


def with_ripple(robot: Robot, waves: Sequence[Wave]) -> Robot:
    """The robot with this ripple beside its own."""
    if not waves:
        return robot
    return robot.with_effects(*ripple_effects(robot.axis_names, [o for o, _ in waves], np.array([w for _, w in waves])))
