"""Arguments of public functions: a wrong kind of thing gets a message that says how to make the right one."""

import os
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ._errors import InputError, input_error
from ._text import shortened

_LARGEST = 2**53  # whole numbers that a float holds

_MADE = {
    ("Experiment", "path"): "Read it first: jaxfrf.io.read({value}).",
    ("Experiment", "array"): "Make a record of the signals: jaxfrf.Experiment(u, y, fs, period).",
    ("Experiment", "list"): "Join several records: jaxfrf.concatenate(records).",
    ("Spectra", "path"): "Read and transform it first: jaxfrf.dft(jaxfrf.io.read({value})).",
    ("Spectra", "Experiment"): "Transform it first: jaxfrf.dft(data).",
    ("FRF", "path"): "Read it first: jaxfrf.io.read_frf({value}).",
    ("FRF", "Experiment"): "Estimate first: jaxfrf.estimate(data, method).",
    ("FRF", "Spectra"): "Estimate first: jaxfrf.estimate(spectra, method).",
    ("FRF", "array"): "Make one of the numbers: jaxfrf.io.frf_from_arrays(G, frequency).",
    ("Robot", "path"): "Read it first: jaxfrf.io.read_robot({value}).",
    ("Multisine", "path"): "Read it first: jaxfrf.io.read_design({value}).",
    ("AbstractMethod", "path"): "Make one, e.g. jaxfrf.LRM(order=2). Names are for the command line (--method).",
    ("AbstractMethod", "class"): "Call it: {value}().",
    ("AbstractEffect", "class"): "Make one, of a joint or place and its numbers: {value}(...).",
}


def expect(name: str, value: Any, *kinds: type) -> None:
    """Refuse an argument that is none of these kinds.

    **Raises:** `jaxfrf.InputError` naming the argument, what was found, what was expected and how to make it.
    """
    if not isinstance(value, kinds):
        raise wrong_kind(name, value, " or ".join(f"a jaxfrf.{k.__name__}" for k in kinds), *kinds)


def expect_each(name: str, values: Any, *kinds: type, least: int = 1) -> None:
    """Refuse what is no list of these kinds, or one of fewer than `least`."""
    if isinstance(values, str | bytes) or not isinstance(values, Sequence) or len(values) < least:
        more = f", {'one' if least == 1 else least} or more" if least else ""
        listed = " or ".join(f"jaxfrf.{kind.__name__}" for kind in kinds)
        raise wrong_kind(name, values, f"a list of {listed}{more}", *kinds)
    for value in values:
        expect(name, value, *kinds)


def expect_callable(name: str, value: Any) -> None:
    """Refuse what cannot be called; `None` is nothing to call."""
    if value is not None and not callable(value):
        raise input_error(name, said(value), "a function, or None", "Leave it out for none.")


def expect_path(name: str, value: Any) -> None:
    """Refuse what names no file."""
    if not isinstance(value, str | os.PathLike):
        raise input_error(name, said(value), "the name of a file", "Give text or a pathlib.Path; check the order.")


def expect_text(name: str, value: Any) -> None:
    if not isinstance(value, str):
        raise input_error(name, said(value), "text", "Give it in quotes.")


def as_names(name: str, values: Any, count: int, things: str) -> list[str]:
    """A text for each of `count` things."""
    names = [] if isinstance(values, str | bytes) or not isinstance(values, Iterable) else list(values)
    if len(names) != count:
        found = f"{len(names)}" if names else said(values)
        raise input_error(name, found, f"one for each of the {count} {things}", "Name them all.")
    for each in names:
        expect_text(name, each)
    return names


def expect_whole(name: str, value: Any, least: int | None = 0) -> None:
    """Refuse what is no whole number of this size; of any size with `None`."""
    try:
        whole = np.ndim(value) == 0 and not isinstance(value, bool | str | bytes) and int(value) == value
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole or abs(value) > _LARGEST or (least is not None and value < least):
        size = "" if least is None else f", {least} or more"
        raise input_error(name, said(value), f"a whole number{size}", "Choose another.")


def expect_real(name: str, value: Any) -> None:
    """Refuse what is no finite real number, or are no such numbers."""
    if not _is_real(value):
        raise input_error(name, said(value), "finite real numbers", "Check it.")


def _is_real(value: Any) -> bool:
    try:
        x = np.asarray(value)
        return x.dtype.kind in "iuf" and x.size > 0 and bool(np.all(np.isfinite(x)))
    except (TypeError, ValueError):
        return False


def expect_number(name: str, value: Any) -> None:
    """Refuse what is not one finite real number."""
    if not _is_real(value) or np.ndim(value):
        raise input_error(name, said(value), "a finite real number", "Check it.")


def as_band(value: Any, highest: float = np.inf) -> tuple[float, float]:
    """The lower and the upper end of a band, Hz; 0 and `highest` where one is `None`, an open end.

    **Raises:** `jaxfrf.InputError` for what is no such pair.
    """
    try:
        low, high = list(value) if not isinstance(value, str | bytes) else [value]
        ends = np.asarray([0.0 if low is None else low, np.inf if high is None else high])
        fits = ends.shape == (2,) and ends.dtype.kind in "iuf" and bool(ends[0] <= ends[1])
    except (TypeError, ValueError):
        fits = False
    if not fits:
        found = shortened(value) if isinstance(value, list | tuple) else said(value)
        raise input_error("band", found, "the lower and the upper end, Hz", "E.g. band=(5.0, 80.0).")
    return float(ends[0]), highest if high is None else float(ends[1])


def expect_probability(name: str, value: Any) -> None:
    """Refuse what does not lie between 0 and 1."""
    expect_real(name, value)
    if np.ndim(value) or not 0 < value < 1:
        raise input_error(name, said(value), "a probability between 0 and 1", "Give 0.95, for 95 %.")


def as_key(name: str, value: Any) -> Any:
    """A key of JAX's; one that a whole number seeds.

    **Raises:** `jaxfrf.InputError` for anything else.
    """
    import jax

    if isinstance(value, jax.Array) and (jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key) or value.ndim):
        return value
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and 0 <= value < _LARGEST:
        return jax.random.key(int(value))
    raise input_error(name, said(value), "a key or a whole number, its seed", "Give it as jax.random.key(0).")


def expect_index(name: str, value: Any, count: int) -> None:
    """Refuse what is no place in a row of this length, counted from 0 (or from the end: -1 is the last)."""
    expect_whole(name, value, None)
    if not -count <= value < count:
        raise input_error(name, f"{value}", f"0 to {count - 1}, one of {count}", "Count from 0.")


def wrong_kind(name: str, value: Any, expected: str, *kinds: type) -> InputError:
    """The error of `expect`, where the check is another."""
    found = _kind(value)
    makes = (_MADE.get((kind.__name__, found)) for kind in kinds)
    written = value.__name__ if found == "class" else repr(str(value)) if found == "path" else ""
    do = next((text.format(value=written) for text in makes if text), "Check the order of the arguments.")
    return input_error(name, said(value), expected, do)


def _kind(value: Any) -> str:
    if isinstance(value, str | pathlib.PurePath):
        return "path"
    if isinstance(value, type):
        return "class"
    if isinstance(value, list | tuple):
        return "list" if value and not isinstance(value[0], int | float) else "array"
    return "array" if isinstance(value, np.ndarray) or hasattr(value, "__jax_array__") else type(value).__name__


def said(value: Any) -> str:
    """A value in a message."""
    value = value.item() if isinstance(value, np.generic) else value
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array of shape {value.shape}"
    if value is None or isinstance(value, str | int | float):
        return shortened(value)
    if isinstance(value, type):
        return f"the class {value.__name__}"
    return f"{_article(type(value).__name__)} {type(value).__name__}"


def _article(word: str) -> str:
    return "an" if word[:1].lower() in "aeiou" or word in ("FRF", "LPM", "LRM") else "a"
