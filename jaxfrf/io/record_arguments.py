"""The arguments of `read`, and their spelling on the command line: names, values and factors.

names    u=iq_adx,y=omega_max      which variable of the file is which
values   fs=2500,period=2500       what the file does not say
factor    y=0.0174532925            factors that make the units SI
"""

import difflib
import re
from collections.abc import Mapping, Sequence

import numpy as np

from .._arguments import expect_text
from .._errors import InputError, input_error
from .._memory import check_memory

SIGNALS = ("r", "u", "y")
MAPPED = (*SIGNALS, "q", "t", "fs", "period", "lines", "transient_periods", "r_quantity", "y_quantity")
_UNITS = ("r_unit", "u_unit", "y_unit", "t_unit", "q_unit")
SET = ("fs", "period", "transient_periods", "lines", "q", "samples", "r_quantity", "y_quantity", *_UNITS)
SCALED = (*SIGNALS, "q", "t", "fs")


def parse_map(text: str) -> dict[str, str]:
    """Which variable of the file is which, from `u=iq_adx,y=omega_max,r=iq_refx`.

    On the left stands a name of the experiment file (`r u y q t fs period ...`; `t` is a time vector in s),
    on the right one of the user's file: a variable, a field of a struct (`y=rec.act_vel`), a column of a
    table (its heading, or its number, counted from 1, where there are no headings; `u=1:3` are the first three),
    several of them stacked as channels (`u=[tau1;tau2]`), one of several files of one record (`u=currents.csv:tau1`,
    `u=currents.csv:[tau1;tau2]`, `u=currents.csv:1:6`), some channels of one (`u=log[3]`, `y=log[0:3]`, counted from
    0, the stop not included), or one transposed (`u=torque'`).

    **Arguments:** `text`: as behind `--map`.

    **Returns:** the `names` of `read`: {name here: name in the file}.

    **Raises:** `jaxfrf.InputError` if the text is not of this form.
    """
    expect_text("text", text)
    return check_names(_pairs("--map", text, "u=NAME,y=NAME"))


def parse_values(text: str) -> dict[str, object]:
    """Values that the file does not hold (or holds wrongly), from `fs=2500,period=2500,transient_periods=1`.

    `samples=0:18720` cuts the record to these samples (counted from 0, the stop not included);
    `lines=11:251`, `lines=13:250:4` or `lines=13;17;21` lists the excited lines; `q=0;0.5;1.2` is the arm
    configuration in rad; `r_quantity`, `y_quantity` are `position`, `velocity` or `acceleration`; `u_unit=mA`,
    `y_unit=deg/s` (`r_unit`, `q_unit`, `t_unit`) are the units that the file's numbers have: they are converted to SI.

    **Arguments:** `text`: as behind `--set`.

    **Returns:** the `values` of `read` by name, numbers in SI units.

    **Raises:** `jaxfrf.InputError` if the text is not of this form.
    """
    expect_text("text", text)
    return check_values(_pairs("--set", text, "fs=2500,period=2500"))


def parse_factor(text: str) -> dict[str, float | tuple[float, ...]]:
    """Factors for unit conversion, from `y=0.0174532925` or, one for each channel, `y=[1;-1]`.

    **Arguments:** `text`: as behind `--factor`.

    **Returns:** the `factor` of `read`: a number, or one for each channel, by name.

    **Raises:** `jaxfrf.InputError` if the text is not of this form.
    """
    expect_text("text", text)
    return check_factor(_pairs("--factor", text, "y=0.0174532925"))


def check_names(names: Mapping[str, str] | None) -> dict[str, str]:
    names = _mapping("names", names, "parse_map")
    _check_keys("--map", names, MAPPED)
    for key, name in names.items():
        if not isinstance(name, str) or not name.strip():
            raise input_error(f"--map {key}", repr(name), "the name of a variable", f"Write --map {key}=NAME.")
    return names


def check_values(values: Mapping[str, object] | None) -> dict[str, object]:
    values = _mapping("values", values, "parse_values")
    _check_keys("--set", values, SET)
    return {key: _value(key, value) for key, value in values.items()}


def check_factor(factor: Mapping[str, object] | None) -> dict[str, float | tuple[float, ...]]:
    factor = _mapping("factor", factor, "parse_factor")
    _check_keys("--factor", factor, SCALED)
    return {key: _factor(key, value) for key, value in factor.items()}


def split(text: str, separator: str) -> list[str]:
    """Split at separators that stand outside brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += {"[": 1, "]": -1}.get(character, 0)
        if character == separator and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def nearest(name: str, known: Sequence[str]) -> str | None:
    """The known name most like `name`, by letters, whatever their case; `None` if none is like it."""
    by_lower = {k.lower(): k for k in known}
    found = difflib.get_close_matches(name.lower(), by_lower, 1, cutoff=0.5)
    return by_lower[found[0]] if found else None


def _pairs(option: str, text: str, example: str) -> dict[str, str]:
    pairs = {}
    for part in split(text, ","):
        key, equals, value = (x.strip() for x in part.partition("="))
        if not (key and equals and value):
            raise input_error(
                option, repr(part), "NAME=VALUE, separated by commas", f"Write it like {option} {example}."
            )
        if key in pairs:
            raise input_error(option, f"{key} twice", "each name once", "Leave one of them out.")
        pairs[key] = value
    return pairs


def _mapping(name: str, given, parser: str) -> dict:
    if given is not None and not isinstance(given, Mapping):
        do = f"Parse text first: jaxfrf.io.{parser}(...)." if isinstance(given, str) else "Write {'u': ...}."
        raise input_error(name, f"{type(given).__name__} {given!r:.60}", "a dictionary", do)
    return dict(given or {})


def _check_keys(option: str, given: Mapping, known: Sequence[str]) -> None:
    for key in given:
        if key not in known:
            near = nearest(key, known)
            raise input_error(
                option,
                f"the unknown name {key!r}",
                f"one of {', '.join(known)}",
                f"Did you mean {near}?" if near else "Choose one of them.",
            )


def _value(key: str, value):
    if key in ("r_quantity", "y_quantity", *_UNITS):
        return value
    if key == "samples":
        return _samples(value)
    if not isinstance(value, str):
        return value
    try:
        if key == "lines" and ":" in value:
            return _stepped(value)
        if key in ("lines", "q"):
            return np.array([number(x) for x in split(value.strip("[]"), ";")])
        return number(value)
    except (ValueError, TypeError, OverflowError):
        expected = {"lines": "line numbers like 11:251 or 13;17;21", "q": "angles like 0;0.5;1.2"}
        raise _bad_value("--set", key, value, expected.get(key, "a number")) from None


def number(text: str) -> float:
    """As `float`, without the digits that Python alone groups by underscores."""
    if "_" in text:
        raise ValueError(text)
    return float(text)


def _stepped(text: str) -> np.ndarray:
    bounds = [int(number(x)) for x in text.split(":")]
    if any(bound != number(x) for bound, x in zip(bounds, text.split(":"), strict=True)):
        raise ValueError(text)
    span = range(*bounds)
    check_memory("--set lines", 8.0 * len(span), "Name the lines that are excited.")
    return np.arange(*bounds)


def _samples(value) -> slice:
    if isinstance(value, str):
        bounds = re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", value)
        value = slice(*(int(x) if x else None for x in bounds.groups())) if bounds else value
    if not isinstance(value, slice) or value.step not in (None, 1):
        raise _bad_value("--set", "samples", value, "START:STOP, counted from 0, like 0:18720")
    return value


def _factor(key: str, value) -> float | tuple[float, ...]:
    try:
        parts = split(value.strip("[]"), ";") if isinstance(value, str) else np.ravel(value)
        factors = tuple(number(x) if isinstance(x, str) else float(x) for x in parts)
    except (ValueError, TypeError):
        raise _bad_value("--factor", key, value, "a factor like 0.0174532925, or one a channel like [1;-1]") from None
    if not factors or not np.isfinite(factors).all() or 0.0 in factors:
        raise _bad_value("--factor", key, value, "finite factors other than zero")
    return factors[0] if len(factors) == 1 else factors


def _bad_value(option: str, key: str, value, expected: str) -> InputError:
    return input_error(f"{option} {key}", repr(value), expected, "Correct it.")
