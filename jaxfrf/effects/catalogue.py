"""The library of effects by name; effects from and to tables of a robot's file."""

import dataclasses
import inspect
import math
import sys
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._arguments import said
from .._errors import InputError, input_error
from .._text import nearest, shortened
from .effect import AbstractEffect

_LARGEST = sys.float_info.max
_EXPECTED = {None: "a number, or a list of numbers", "": "a number"}


def library() -> dict[str, type[AbstractEffect]]:
    """Every effect by its name; `library()[name].typical(robot, joint)` is one at a just visible magnitude.

    It holds what `jaxfrf.effects` exports: the line that exports a class is all that lists it.
    """
    exported = vars(sys.modules[__package__]).values()
    kinds = [x for x in exported if _is_effect(x) and not inspect.isabstract(x)]
    return {kind.name: kind for kind in kinds}


def check_own(own: Sequence[type[AbstractEffect]]) -> None:
    """Refuse what is no list of classes of effects."""
    if not isinstance(own, list | tuple) or not all(map(_is_effect, own)):
        do = "Give the classes themselves, e.g. own=[MyEffect]."
        raise input_error("own", said(own), "a list of classes of effects", do)


def _is_effect(kind: Any) -> bool:
    return inspect.isclass(kind) and issubclass(kind, AbstractEffect)


def effect_from_table(
    table: Mapping[str, Any], where: str = "effect", own: Sequence[type[AbstractEffect]] = ()
) -> AbstractEffect:
    """The effect that a table {name, joint, parameters} describes.

    **Arguments:** `where`: the table's place in messages. `own`: effects of your own, known beside the library's.

    **Raises:** `jaxfrf.InputError` for an unknown name or parameter, with the nearest known one, a parameter that
    is missing, and a value that is no number, of another shape than the parameter, or of a sign that it cannot have.
    """
    check_own(own)
    name, known = table.get("name"), library() | {kind.name: kind for kind in own}
    if name not in known:
        near = nearest(name, known)
        raise input_error(
            f"{where}: name", "nothing" if name is None else repr(name), ", ".join(known), f"Did you mean {near!r}?"
        )
    kind, given = known[name], {k: v for k, v in table.items() if k not in ("name", "joint")}
    for key in given:
        if key not in kind.units:
            near = nearest(key, kind.units)
            raise input_error(
                where, f"the unknown key {key!r}", f"keys among {', '.join(kind.units)}", f"Did you mean {near!r}?"
            )
    arguments = {key: _value(f"{where}: {key}", kind, key, value) for key, value in given.items()}
    options = inspect.signature(kind).parameters
    for key in kind.units:
        if key not in arguments and options[key].default is inspect.Parameter.empty:
            raise input_error(f"{where}: {key}", "nothing", f"a value, {kind.units[key]}", f"Add {key} = ... there.")
    joint = table.get("joint", "")
    if joint == "" and options["joint"].default is inspect.Parameter.empty:
        raise input_error(f"{where}: joint", "nothing", "the name of a driven joint", 'Add joint = "..." there.')
    try:
        return kind(joint=joint, **arguments)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def effect_to_table(effect: AbstractEffect, joint: str) -> dict[str, Any]:
    """The table of an effect on the joint of this name: `effect_from_table` of it gives the same effect.

    **Arguments:** `effect`: its parameters in their units, `effect.units`. `joint`: name.
    """
    values = {key: getattr(effect, key) for key in effect.units}
    plain = {key: np.asarray(value).tolist() for key, value in values.items() if value is not None}
    return {"name": effect.name, "joint": joint, **plain}


def _value(where: str, kind: type[AbstractEffect], key: str, value: Any) -> Any:
    """A number or an array of the parameter's shape; of a sign that it may have, as the library's bounds say it."""
    axis, numbers = _axis(kind, key), value if isinstance(value, list) else [value]
    if not numbers or not all(map(_is_number, numbers)) or not _fits(axis, value):
        expected = f"a list of {axis} numbers" if (axis or "").isdigit() else _EXPECTED.get(axis, _EXPECTED[None])
        raise input_error(where, shortened(value), expected, "Write it in SI units.")
    changes = kind.is_error or library().get(kind.name) is not kind  # numbers of the robot; one's own go either way
    least = -math.inf if changes else kind.bounds[key][0]
    if least >= 0.0 and (min(numbers) < 0.0 or (least > 0.0 and min(numbers) == 0.0)):
        expected = "a number above 0" if least > 0.0 else "a number, 0 or more"
        raise input_error(where, shortened(value), f"{expected} ({kind.units[key]})", "Correct the value or its unit.")
    return np.asarray(value) if isinstance(value, list) else float(value)


def _is_number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= _LARGEST


def _fits(axis: str | None, value: Any) -> bool:
    many = isinstance(value, list)
    if axis is not None and axis.isdigit():
        return many and len(value) == int(axis)
    return not many if axis == "" else True


def _axis(kind: type[AbstractEffect], key: str) -> str | None:
    """The axis of a parameter, as its annotation says: "" of a number; `None` where that is not said."""
    stated = next((field.type for field in dataclasses.fields(kind) if field.name == key), None)
    each = typing.get_args(stated) if typing.get_origin(stated) in (typing.Union, types.UnionType) else (stated,)
    axes = {"" if one is float else getattr(one, "dim_str", None) for one in each} - {None}
    return axes.pop() if len(axes) == 1 else None
