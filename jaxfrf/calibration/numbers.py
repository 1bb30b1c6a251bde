"""The numbers of a robot that an experiment may tell, each in the coordinate that a fit moves."""

import functools
import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from ..effects import (
    AbstractEffect,
    AbstractFriction,
    library,
)
from ..effects._place import axis_of, stated
from ..robot import PARAMETER_UNITS, Robot, parameter_unit, parameters
from ..robot.drive import Friction, Spring
from ..robot.parameters import parameter_field, unit_at
from ..robot.tolerances import KINDS, Tolerance, relative_sizes

_UNKNOWN = 1.0  # size of the coordinate of a number of which nothing is known: of its logarithm
_FAR = 50.0  # logarithms that a fit that goes astray may move a number by: further, and it is no number any more
_ELEMENTS = {"com": ("x", "y", "z"), "inertia": ("xx", "yy", "zz", "xy", "xz", "yz")}
_POSITIVE = (
    "stiffness",
    "damping",
    "stiffness_ratio",
    "stiffness_knee",
    "backlash",
    "motor_inertia",
    "viscous_friction",
    "coulomb_friction",
    "smoothing",
    "mass",
)
_OFFSET = "torque_offset"  # of the drives' numbers the one that not every fit has


class Number(eqx.Module):
    """One number of a robot; x = 0 where it is as given, 1 where it is one tolerance above.

    **Fields:** `name`: `joint6.mass`, `joint6.com.x`. `kind`. `unit`. `given`: its value in the robot's file. `size`:
    of x = 1, in the logarithm of the value where `positive`, in its unit otherwise. `prior`: what x^2 costs, 1, or 0
    where nothing is known before.
    """

    name: str = eqx.field(static=True)
    kind: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    given: float = eqx.field(static=True)
    size: float = eqx.field(static=True)
    positive: bool = eqx.field(static=True)
    prior: float = eqx.field(static=True)

    @property
    def of_effect(self) -> bool:
        """Whether it is a parameter of an effect: joint4.stribeck_friction.level."""
        return self.kind == "effect" or (self.kind == "smoothing" and self.name.count(".") == 2)

    @property
    def joint(self) -> str:
        if self.of_effect:
            return self.name.split(".")[0]
        return self.name[: self.name.rindex(f".{self.kind}")] if f".{self.kind}" in self.name else ""

    @property
    def element(self) -> tuple[int, ...]:
        """Place in a vector, () of a plain number."""
        return (_ELEMENTS[self.kind].index(self.name.rpartition(".")[2]),) if self.kind in _ELEMENTS else ()

    def value(self, x: float) -> float:
        """Of the number, in its unit, where its coordinate is x."""
        if not self.positive:
            return self.given + self.size * x
        return self.given * math.exp(min(max(self.size * x, -_FAR), _FAR))

    def coordinate(self, value: float) -> float:
        """x of a value; the inverse of `value`."""
        change = math.log(value / self.given) if self.positive else value - self.given
        return change / self.size

    def deviation(self, x: float, std: float) -> float:
        """Standard deviation of the value, in its unit, from that of x."""
        return self.size * std * (self.value(x) if self.positive else 1.0)


def prior_cost(numbers: Sequence[Number], x) -> float:
    """Squares of tolerances that numbers at these coordinates are off by; how Coulomb friction is smoothed has no true
    value."""
    return float(sum(n.prior * a**2 for n, a in zip(numbers, x, strict=True) if n.kind != "smoothing"))


def numbers(robot: Robot, offset_size: Float[np.ndarray, "axis"] | None = None) -> tuple[Number, ...]:
    """All numbers that are not exact, by the robot's tolerances.

    Left out is what a robot does not have or what does nothing: the shape of a linear spring, numbers that are zero
    and known in relation to that, bodies without mass.

    **Arguments:** `robot`: with its tolerances. `offset_size`: of the coordinates of the motors' torque offsets,
    (axis,), N m; `None`: there are none.

    **Returns:** `Number`s, each with name, unit, given value and size of its coordinate.
    """
    found: list[Number] = []

    def add(name: str, kind: str, given: float, relative_to: float | None = None, unit: str | None = None):
        tolerance = robot.tolerances.of(name)
        if tolerance.exact or not math.isfinite(given):
            return
        if unit is None:
            joint = "" if kind == "smoothing" else name.split(".")[0]
            of_joint = kind in PARAMETER_UNITS
            unit = parameter_unit(robot, joint, kind) if of_joint else unit_at(robot, joint, KINDS[kind])
        number = _number(name, kind, unit, given, tolerance, abs(given) if relative_to is None else relative_to)
        if number is not None:
            found.append(number)

    bent = _bent(robot)
    for kind in KINDS:
        if kind in _ELEMENTS:
            for name, vector in parameters(robot, [kind]).items():
                values = np.asarray(vector, float)
                for element, value, size in zip(_ELEMENTS[kind], values, relative_sizes(values, kind), strict=True):
                    add(f"{name}.{element}", kind, float(value), float(size))
        elif kind == "smoothing":
            if isinstance(robot.drives.friction, Friction) and np.any(np.asarray(robot.drives.friction.coulomb)):
                add("friction.smoothing", kind, float(robot.drives.friction.smoothing))
        elif kind == _OFFSET:
            for axis, size in enumerate(() if offset_size is None else offset_size):
                add(f"{robot.axis_names[axis]}.{kind}", kind, _of_drive(robot, kind, axis), float(size))
        elif kind == "effect":
            for joint, effect, parameter in effect_parameters(robot):
                if offset_size is None or effect.drive_number != _OFFSET:
                    name, value = f"{joint}.{effect.name}.{parameter}", float(getattr(effect, parameter))
                    turns = isinstance(effect, AbstractFriction) and parameter == "smoothing"
                    unit = unit_at(robot, joint, effect.units[parameter])
                    add(name, "smoothing" if turns else kind, value, unit=unit)
        elif kind == "backlash":
            for name, gap in _gaps(robot).items():
                add(f"{name}.{kind}", kind, gap)
        elif kind in of_drives():
            for axis, name in enumerate(robot.axis_names):
                add(f"{name}.{kind}", kind, _of_drive(robot, kind, axis), 1.0)
        elif kind in _POSITIVE:
            for name, value in parameters(robot, [kind]).items():
                if not kind.startswith("stiffness_") or name.rpartition(".")[0] in bent:
                    add(name, kind, float(value))
    return tuple(found)


def _number(name: str, kind: str, unit: str, given: float, tolerance: Tolerance, relative_to: float) -> Number | None:
    absolute = tolerance.std if not tolerance.relative else tolerance.std * relative_to
    positive = given > 0.0 and (kind in _POSITIVE or (kind == "effect" and _is_positive(name)))
    if tolerance.unknown:
        size = _UNKNOWN if positive else relative_to
        return Number(name, kind, unit, given, size, positive, 0.0) if size > 0 else None
    if absolute == 0.0:
        return None
    size = absolute / given if positive else absolute
    return Number(name, kind, unit, given, size, positive, 1.0)


def effect_parameters(robot: Robot) -> list[tuple[str, AbstractEffect, str]]:
    """Joint, effect and name of every single number in the robot's effects that no other kind of number stands for."""
    found: dict[tuple[str, str, str], AbstractEffect] = {}
    for effect in robot.effects:
        drive = effect.drive_number not in ("", _OFFSET)
        if effect.name in KINDS or drive or not effect.differentiable:
            continue
        joint = robot.axis_names[axis_of(robot, effect.joint)]
        for parameter in effect.units:
            if eqx.is_array_like(getattr(effect, parameter)) and np.ndim(getattr(effect, parameter)) == 0:
                found.setdefault((joint, effect.name, parameter), effect)
    return [(joint, effect, parameter) for (joint, _, parameter), effect in found.items()]


def _is_positive(name: str) -> bool:
    """Whether a parameter of an effect of the library never changes its sign; those of one's own may."""
    _, effect, parameter = name.split(".")
    return effect in library() and library()[effect].bounds.get(parameter, (-1.0,))[0] >= 0.0


def _gaps(robot: Robot) -> dict[str, float]:
    """Play of the springs that have some, rad."""
    gaps = getattr(robot.springs, "backlash", None)
    if gaps is None:
        return {}
    return {name: float(gap) for name, gap in zip(robot.spring_names, np.asarray(gaps), strict=True) if gap > 0.0}


def _bent(robot: Robot) -> tuple[str, ...]:
    """Joints whose springs are not linear."""
    if not isinstance(robot.springs, Spring):
        return ()
    ratio = np.asarray(robot.springs.stiffness_ratio)
    return tuple(name for name, r in zip(robot.spring_names, ratio, strict=True) if r != 1.0)


@functools.cache
def of_drives() -> dict[str, type[AbstractEffect]]:
    """Kinds of numbers of every drive, and the effect that each is the first parameter of."""
    return {effect.drive_number: effect for effect in library().values() if effect.drive_number}


def _of_drive(robot: Robot, kind: str, axis: int) -> float:
    effect = of_drives()[kind]
    return stated(robot, effect, axis, next(iter(effect.units)))


def with_numbers(robot: Robot, numbers: Sequence[Number], x: Float[np.ndarray, "number"]) -> Robot:
    """The robot with these numbers where their coordinates x, in tolerances, say; the others as they are.

    **Arguments:** `robot`: as given. `numbers`: some of `numbers(robot)`. `x`: (number,), coordinates in tolerances, 0
    as given.

    **Returns:** a robot whose arrays hold the new values, in their SI units.

    **Raises:** `jaxfrf.InputError` where there is not one coordinate for each number.
    """
    if np.shape(x) != (len(numbers),):
        raise input_error("x", f"shape {np.shape(x)}", f"({len(numbers)},), one for each number", "Give them all.")
    fields = {kind: parameter_field(robot, kind) for kind in {n.kind for n in numbers} & set(PARAMETER_UNITS)}
    arrays: dict[str, np.ndarray] = {}
    drives: list[tuple[str, str, float]] = []
    for number, at in zip(numbers, x, strict=True):
        value, joint = number.value(float(at)), number.joint
        if number.kind in of_drives():
            drives.append((number.kind, joint, value))
        elif number.of_effect:
            robot = _with_parameter(robot, number.name, value)
        elif number.kind == "backlash":
            row = robot.spring_names.index(joint)
            robot = eqx.tree_at(
                lambda r: r.springs.backlash, robot, jnp.asarray(robot.springs.backlash).at[row].set(value)
            )
        elif number.kind == "smoothing":
            robot = eqx.tree_at(lambda r: r.drives.friction.smoothing, robot, jnp.asarray(value, float))
        else:
            where, joints = fields[number.kind]
            rows = arrays.setdefault(number.kind, np.array(where(robot), float))
            rows[(joints.index(joint), *number.element)] = value
    # All at once: to put one array into a robot takes as long as to put in ten.
    places = [fields[kind][0] for kind in arrays]
    robot = eqx.tree_at(lambda r: [place(r) for place in places], robot, [jnp.asarray(x) for x in arrays.values()])
    return _with_drives(robot, drives)


def _with_parameter(robot: Robot, name: str, value: float) -> Robot:
    """The robot with another value of an effect's parameter; none where it may have one sign only and the value has
    the other, as a fit of what was given as none may."""
    value = max(value, 0.0) if _is_positive(name) else value
    joint, effect, parameter = name.split(".")
    place = next(
        i
        for i, e in enumerate(robot.effects)
        if e.name == effect and robot.axis_names[axis_of(robot, e.joint)] == joint and parameter in e.units
    )
    return eqx.tree_at(lambda r: getattr(r.effects[place], parameter), robot, jnp.asarray(value, float))


def _with_drives(robot: Robot, values) -> Robot:
    """What stands in the drives at these numbers, in the place of those that the robot has."""
    kept = list(robot.effects)
    for kind, joint, value in values:
        effect, axis = of_drives()[kind], robot.axis_names.index(joint)
        had = [e for e in kept if isinstance(e, effect) and axis_of(robot, e.joint) == axis]
        now = effect.in_drive(joint, value, had)
        place = next((i for i, e in enumerate(kept) if had and e is had[0]), len(kept))
        kept[place : place + 1] = [] if now is None else [now]
        kept = [e for e in kept if not any(e is other for other in had)]
    return eqx.tree_at(lambda r: r.effects, robot, tuple(kept), is_leaf=lambda leaf: leaf is robot.effects)
