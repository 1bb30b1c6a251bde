"""Arguments and fields are what their annotations say: classes, and arrays of named axes."""

import collections.abc
import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar

import numpy as np

from ._arguments import said
from ._errors import input_error

P = ParamSpec("P")
T = TypeVar("T")
_NUMBERS = "biuf"


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Refuse arguments that are not what this public function is annotated with, before they are used.

    Looked at are classes, texts, collections and arrays (jaxtyping): real or complex numbers, of as many axes, and axes
    of one name as long in all arguments. What has `axis_lengths` (a robot: its joints, axes, springs) says how long
    axes of these names are. Arrays that JAX traces are looked at, too, while it traces; lists become arrays.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # Python says what is missing or too many
        given = bound.arguments
        kinds = {name: signature.parameters[name].annotation for name in given}
        _check({name: (kinds[name], value) for name, value in given.items()})
        given |= {name: _as_array(kinds[name], x) for name, x in given.items() if isinstance(x, list | tuple)}
        return function(*bound.args, **bound.kwargs)

    return call


def check_fields(module: Any) -> None:
    """Refuse fields of a dataclass that are not what they are annotated with, as `checked` does arguments."""
    fields = {field.name: (field.type, getattr(module, field.name)) for field in dataclasses.fields(module)}
    _check({name: given for name, given in fields.items() if not isinstance(given[0], str)})


def _check(given: Mapping[str, tuple[Any, Any]]) -> None:
    lengths: dict[str, int] = {}
    for name, (kind, value) in given.items():
        expected = list(dict.fromkeys(_expected(kind, value, lengths)))
        if expected:
            raise input_error(name, said(value), " or ".join(expected), "Check it and the order of the arguments.")
        lengths |= getattr(value, "axis_lengths", {})


def _expected(kind: Any, value: Any, lengths: dict[str, int]) -> list[str]:
    """What was expected instead; nothing where the value is that."""
    if isinstance(kind, types.UnionType) or typing.get_origin(kind) is typing.Union:
        found = [_expected(one, value, lengths) for one in typing.get_args(kind)]
        return [] if [] in found else [text for one in found for text in one]
    if hasattr(kind, "dim_str"):
        return _expected_array(kind, value, lengths)
    if kind in (float, int):
        shape, numbers = _shape(value)
        fits = shape == () and numbers in (_NUMBERS if kind is float else "iu")
        return [] if fits else ["a real number" if kind is float else "a whole number"]
    base = typing.get_origin(kind) or kind
    if base is types.NoneType or kind is None:
        return [] if value is None else ["None"]
    if base is bool:
        shape, numbers = _shape(value)
        return [] if shape == () and numbers in "biu" else ["True or False"]
    if base is Any or not isinstance(base, type):
        return []
    lies = base in (collections.abc.Iterable, collections.abc.Sequence) and isinstance(value, str | bytes)
    return [] if isinstance(value, base) and not lies else [_called(base)]


def _called(base: type) -> str:
    plain: dict[Any, str] = {str: "text", tuple: "a tuple", collections.abc.Mapping: "a table {name: value}"}
    listed = dict.fromkeys((collections.abc.Iterable, collections.abc.Sequence), "a list")
    room = ".".join(base.__module__.split(".")[:2])
    return (plain | listed).get(base, f"a {room}.{base.__name__}")


def _as_array(kind: Any, value: Any) -> Any:
    """A list where nothing but arrays and numbers are expected."""
    kinds = typing.get_args(kind) if typing.get_origin(kind) in (typing.Union, types.UnionType) else (kind,)
    arrays = [one for one in kinds if hasattr(one, "dim_str")]
    if not arrays or any(one not in arrays and one not in (float, int, types.NoneType) for one in kinds):
        return value
    array = np.asarray(value)
    whole = any(str(dtype).startswith(("int", "uint", "bool")) for one in arrays for dtype in one.dtypes)
    return array if whole or array.dtype.kind == "c" else array.astype(float)


def _expected_array(kind: Any, value: Any, lengths: dict[str, int]) -> list[str]:
    if not {"prng_key", "uint32"}.isdisjoint(kind.dtypes):
        is_key = str(getattr(value, "dtype", "")).startswith(("key", "uint32"))
        return [] if is_key else ["a key (jax.random.key)"]
    axes = kind.dim_str.split()
    named = [axis for axis in axes if axis != "..." and not axis.startswith("*")]
    shape, numbers = _shape(value)
    enough = len(shape) == len(named) if len(named) == len(axes) else len(shape) >= len(named)
    last = dict(zip(named, shape[len(shape) - len(named) :], strict=False))
    known = {axis: int(axis) if axis.isdigit() else lengths.get(axis, last.get(axis)) for axis in named}
    if enough and numbers in _NUMBERS + "c" * ("complex128" in kind.dtypes) and known == last:
        lengths |= {axis: n for axis, n in last.items() if not axis.isdigit()}
        return []
    return [_described(axes, lengths)]


def _shape(value: Any) -> tuple[tuple[int, ...], str]:
    """Shape and kind of numbers, "O" of what is no array; of arrays that are traced, too."""
    try:
        array = value if hasattr(value, "dtype") and hasattr(value, "shape") else np.asarray(value)
        return tuple(array.shape), np.dtype(array.dtype).kind
    except (TypeError, ValueError):
        return (), "O"


def _described(axes: list[str], lengths: Mapping[str, int]) -> str:
    if not axes:
        return "a real number"
    told = [f"{axis} = {lengths[axis]}" for axis in axes if axis in lengths]
    return f"numbers of shape ({', '.join(axes)}{',' * (len(axes) == 1)})" + "".join(f", {text}" for text in told)
