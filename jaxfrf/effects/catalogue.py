"""The library of effects by name; effects from and to tables of a robot's file."""

import inspect
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import input_error
from .._text import nearest
from .effect import AbstractEffect


def library() -> dict[str, type[AbstractEffect]]:
    """Every effect by its name; `library()[name].typical(robot, joint)` is one at a just visible magnitude.

    It holds what `jaxfrf.effects` exports: the line that exports a class is all that lists it.
    """
    exported = vars(sys.modules[__package__]).values()
    kinds = [x for x in exported if inspect.isclass(x) and issubclass(x, AbstractEffect) and not inspect.isabstract(x)]
    return {kind.name: kind for kind in kinds}


def effect_from_table(
    table: Mapping[str, Any], where: str = "effect", own: Sequence[type[AbstractEffect]] = ()
) -> AbstractEffect:
    """The effect that a table {name, joint, parameters} describes.

    **Arguments:** `where`: the table's place in messages. `own`: effects of your own, known beside the library's.

    **Raises:** `jaxfrf.InputError` for an unknown name or parameter, with the nearest known one, a parameter that
    is missing, and a value that is no number.
    """
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
    arguments = {key: _number(f"{where}: {key}", value) for key, value in given.items()}
    options = inspect.signature(kind).parameters
    for key in kind.units:
        if key not in arguments and options[key].default is inspect.Parameter.empty:
            raise input_error(f"{where}: {key}", "nothing", f"a value, {kind.units[key]}", f"Add {key} = ... there.")
    joint = table.get("joint", "")
    if joint == "" and options["joint"].default is inspect.Parameter.empty:
        raise input_error(f"{where}: joint", "nothing", "the name of a driven joint", 'Add joint = "..." there.')
    return kind(joint=joint, **arguments)


def effect_to_table(effect: AbstractEffect, joint: str) -> dict[str, Any]:
    """The table of an effect on the joint of this name: `effect_from_table` of it gives the same effect.

    **Arguments:** `effect`: its parameters in their units, `effect.units`. `joint`: name.
    """
    values = {key: getattr(effect, key) for key in effect.units}
    plain = {key: np.asarray(value).tolist() for key, value in values.items() if value is not None}
    return {"name": effect.name, "joint": joint, **plain}


def _number(where: str, value) -> Any:
    numbers = value if isinstance(value, list) else [value]
    plain = all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in numbers)
    if not plain or not numbers:
        raise input_error(where, repr(value), "a number, or a list of numbers", "Write it in SI units.")
    return np.asarray(value) if isinstance(value, list) else float(value)
