"""How well a robot's numbers are known before an experiment: the one place that says it."""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .._annotated import check_fields, checked
from .._errors import input_error
from .._text import nearest
from ..effects import AbstractStructure, library
from .sliding import sliding_unit

KINDS: dict[str, str] = {
    "stiffness": "N m/rad",
    "damping": "N m s/rad",
    "stiffness_ratio": "1",
    "stiffness_knee": "rad",
    "backlash": "rad",
    "motor_inertia": "kg m^2",
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "smoothing": "rad/s",
    "mass": "kg",
    "com": "m",
    "inertia": "kg m^2",
    "torque_constant": "1",
    "delay": "s",
    "torque_offset": "N m",
    "torque_ripple": "N m",
    "resolver_ripple": "rad",
    "controller_gain": "1",
    "effect": "",
}
"""Kinds of numbers that an experiment may tell, with their units: `effect` is any parameter of an effect."""

GROUPS: dict[str, tuple[str, ...]] = {
    "links": ("mass", "com", "inertia"),
    "rotors": ("motor_inertia",),
    "friction": ("coulomb_friction", "viscous_friction"),
    "spring_shape": ("stiffness_ratio", "stiffness_knee"),
    "ripple": ("torque_ripple", "resolver_ripple"),
    "all": tuple(KINDS),
}
"""Names for several kinds at once."""


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """What is known of one number: its standard deviation before the experiment.

    **Fields:** `std`: 0 = exact, `inf` = unknown. `relative`: whether it is relative. Of a positive number that is the
    standard deviation of its logarithm (.69 = a factor of two); of a centre of mass or a tensor of inertia, whose
    elements may be zero, it is relative to the distance of the centre or to the mean of the moments.
    """

    std: float
    relative: bool = True

    def __post_init__(self):
        check_fields(self)
        if not self.std >= 0:
            raise input_error(
                "tolerance", f"{self.std!r}", "a standard deviation of 0 or more", "0 says exact, inf unknown."
            )

    @property
    def exact(self) -> bool:
        return self.std == 0.0

    @property
    def unknown(self) -> bool:
        return math.isinf(self.std)

    def said(self, unit: str) -> str | float:
        """As a robot's file states it: .05, "0.2 kg", "unknown"."""
        if self.unknown:
            return "unknown"
        return self.std if self.relative else f"{self.std:g} {unit}"


_FACTOR_TWO = math.log(2.0)
DEFAULTS: dict[str, Tolerance] = {
    "stiffness": Tolerance(0.3),
    "damping": Tolerance(_FACTOR_TWO),
    "stiffness_ratio": Tolerance(0.5),
    "stiffness_knee": Tolerance(0.5),
    "backlash": Tolerance(0.5),
    "motor_inertia": Tolerance(0.05),
    "viscous_friction": Tolerance(0.5),
    "coulomb_friction": Tolerance(0.5),
    "smoothing": Tolerance(_FACTOR_TWO),
    "mass": Tolerance(0.05),
    "com": Tolerance(0.05),
    "inertia": Tolerance(0.05),
    "torque_constant": Tolerance(0.03, relative=False),
    "delay": Tolerance(0.0, relative=False),
    "torque_offset": Tolerance(math.inf, relative=False),
    "torque_ripple": Tolerance(math.inf, relative=False),
    "resolver_ripple": Tolerance(math.inf, relative=False),
    "controller_gain": Tolerance(0.1),
    "effect": Tolerance(0.5),
}
"""What is known of each kind of number (`Tolerance`: a standard deviation) of a robot that says nothing: catalogue
springs, links from CAD, friction that drifts with temperature."""


@dataclasses.dataclass(frozen=True)
class Tolerances:
    """What is known of a robot's numbers; the most particular word counts.

    **Arguments:** `stated`: (key, tolerance) pairs, a key being the name of a number (`joint6.mass`), a kind of number
    (`mass`), or a group of kinds (`links`). Where nothing is stated, `DEFAULTS` hold.
    """

    stated: tuple[tuple[str, Tolerance], ...] = ()

    def of(self, name: str) -> Tolerance:
        """Of a number by its name, `joint6.mass`; elements of vectors (`joint6.com.x`) go by the vector."""
        kind = kind_of(name)
        said = dict(self.stated)
        vector = name if kind == "effect" else name[: name.index(kind) + len(kind)]
        group = next((g for g, kinds in GROUPS.items() if kind in kinds and g in said and g != "all"), "all")
        for key in (name, vector, kind, group):
            if key in said:
                return said[key]
        return DEFAULTS[kind]

    def updated(self, more: "Tolerances") -> "Tolerances":
        """The same with others stated; one that is stated again for a kind or a group takes the place of what was
        stated for its members before."""
        kept = [(key, t) for key, t in self.stated if not any(_covers(new, key) for new, _ in more.stated)]
        return Tolerances((*kept, *more.stated))


def kind_of(name: str) -> str:
    """The kind of a number by its name: `mass` of `joint6.mass`, `com` of `joint6.com.x`, `effect` of
    `joint4.stribeck_friction.level`."""
    return next((part for part in reversed(name.split(".")) if part in KINDS), "effect")


@checked
def tolerances_from(table: Mapping[str, Any], names: Iterable[str], where: str = "tolerance") -> Tolerances:
    """Tolerances as a file or the command line states them: numbers are relative, "0.2 kg" is absolute.

    **Arguments:** `table`: {key: value}; a key is the name of a number (`joint6.mass`), a kind (`mass`) or a group
    (`links`), a value a number (0: exact), a text with a unit, or "unknown". `names`: of the robot's joints, whose
    numbers may be named. `where`: the table's name in messages.

    **Returns:** the `Tolerances` that it states.

    **Raises:** `jaxfrf.InputError` for a key that is no number of the robot, no kind and no group, and for a value that
    is no tolerance.
    """
    joints = tuple(names)
    return Tolerances(tuple((_key(key, joints, where), _value(key, value, where)) for key, value in table.items()))


def _key(key: str, joints: tuple[str, ...], where: str) -> str:
    joint, _, kind = key.rpartition(".")
    if (not joint and (kind in KINDS or kind in GROUPS)) or (joint in joints and kind in KINDS):
        return key
    acting, _, name = joint.rpartition(".")
    effect = library().get(name)
    if acting in joints and effect is not None and not issubclass(effect, AbstractStructure) and kind in effect.units:
        return key
    known = [*GROUPS, *KINDS, *(f"{joint}.{kind}" for joint in joints for kind in KINDS)]
    near = nearest(key, known)
    raise input_error(
        where,
        f"the unknown key {key!r}",
        f"a group ({', '.join(GROUPS)}), a kind ({', '.join(KINDS)}) or a number, as joint1.stiffness",
        f"Did you mean {near!r}?",
    )


def _value(key: str, value: Any, where: str) -> Tolerance:
    kind = key.rpartition(".")[2]
    unit = KINDS.get(kind)
    bad = input_error(
        f"{where}: {key}",
        repr(value),
        f'a relative standard deviation (0.05), an absolute one ("0.05 {unit or "kg"}"), or "unknown"',
        "0 says that it is exact.",
    )
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise bad
    if not isinstance(value, str):
        if not value >= 0:
            raise bad
        return Tolerance(float(value), relative=DEFAULTS[kind].relative if kind in DEFAULTS else True)
    if value.strip() == "unknown":
        return Tolerance(math.inf)
    number, _, said = value.strip().partition(" ")
    try:
        std = float(number)
    except ValueError:
        raise bad from None
    if not std >= 0 or (said and said not in (unit, sliding_unit(unit or ""))):
        raise bad
    return Tolerance(std, relative=not said and (kind not in DEFAULTS or DEFAULTS[kind].relative))


def table_of(tolerances: Tolerances) -> dict[str, Any]:
    """As `tolerances_from` reads it."""
    return {key: t.said(KINDS.get(key.rpartition(".")[2], "")) for key, t in tolerances.stated}


def _covers(new: str, old: str) -> bool:
    """Whether a statement about `new` says something about all that `old` names."""
    kinds = GROUPS.get(new, (new,))
    members = GROUPS.get(old, (old.rpartition(".")[2],))
    return new == old or ("." not in new and set(members) <= set(kinds))


def relative_sizes(values: np.ndarray, kind: str) -> np.ndarray:
    """What a relative tolerance of a vector's elements is relative to."""
    if kind == "com":
        return np.full(3, np.linalg.norm(values))
    if kind == "inertia":
        return np.full(6, np.mean(np.abs(values[:3])))
    return np.abs(values)
