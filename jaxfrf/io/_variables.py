"""A file's variables under the names that the caller says, as numbers and texts."""

import dataclasses
import pathlib
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._errors import InputError, input_error
from ..units import QUANTITIES, known_unit, quantity_of
from ._container import Variables
from ._select import select
from .record_arguments import SIGNALS, split


@dataclasses.dataclass(frozen=True)
class Given:
    """What the caller says about the files."""

    names: Mapping[str, str]
    values: Mapping[str, object]
    factor: Mapping[str, float | tuple[float, ...]]
    anyway: bool = False


@dataclasses.dataclass(frozen=True)
class File:
    """One file, and what the caller says about it."""

    path: pathlib.Path
    variables: Variables
    given: Given

    def get(self, key: str):
        """Value of a name of the experiment file, or `None`; what the caller sets goes first."""
        if key in self.given.values:
            return self.given.values[key]
        if key in self.given.names or key in self.variables:
            return select(self.path, self.variables, key, self.given.names.get(key, key))
        return None

    def label(self, key: str) -> str:
        """`u`, or `u (iq_adx)` where the file has another name for it."""
        name = self.given.names.get(key, key)
        return key if name == key else f"{key} ({name})"

    def error(self, key: str, found: str, expected: str, do: str) -> InputError:
        return input_error(f"{self.path}: {self.label(key)}", found, expected, do)


def numbers(file: File, key: str, value) -> np.ndarray:
    x = np.asarray(value)
    if x.dtype.kind not in "biuf":
        kind = {"c": "complex numbers", "U": "text", "S": "text", "O": "objects"}.get(x.dtype.kind, f"{x.dtype} data")
        raise file.error(key, kind, "real numbers", "Store the time record itself, not its spectrum or a text.")
    return x


def unit_of(file: File, key: str) -> tuple[str, float]:
    """The SI unit of a record, "" if nothing is known, and the factor to it."""
    said = file.given.values.get(f"{key}_unit")
    if said is not None:
        return known_unit(str(said)) or (str(said), 1.0)
    if key in file.given.values:
        return "", 1.0
    if isinstance(of_file := file.variables.get(f"{key}_unit"), str) and of_file.strip():
        return known_unit(of_file) or (of_file.strip(), 1.0)
    said = _units_of_channels(file, key)
    found = {known_unit(text) or (text, 1.0) for text in said}
    if len(found) == 1:
        return found.pop()
    # Angles beside lengths are of a robot that slides, too.
    if len({quantity_of(unit) for unit, _ in found} - {None}) > 1:
        raise file.error(
            key,
            f"channels in {', '.join(sorted(said))}",
            "one quantity in all channels",
            f"Estimate them apart (--map {key}=...), or say that they are one: --set {key}_unit=...",
        )
    stated = key in file.given.factor or of_each(file, key) is not None
    if not stated and len({factor for _, factor in found}) > 1:
        raise file.error(
            key,
            f"channels in {', '.join(sorted(said))}",
            "one unit for all",
            f"Say one factor for each: --factor {key}=[...].",
        )
    units = {unit for unit, _ in found}
    return units.pop() if len(units) == 1 else "", 1.0


def stated_quantity(file: File, key: str) -> str | None:
    """The quantity that the units of a motion say, alike in all channels; `None` where they do not."""
    unit, _ = unit_of(file, key)
    said = {unit} if unit or key in file.given.values else _units_of_channels(file, key)
    found = {quantity_of((known_unit(text) or (text, 1.0))[0]) for text in said}
    return found.pop() if len(found) == 1 else None


def _units_of_channels(file: File, key: str) -> set[str]:
    return {_stated(file.variables.units, part) for part in _parts(file, file.given.names.get(key, key).strip())}


def _parts(file: File, name: str) -> list[str]:
    """The variables that `[one;other]` stacks; a variable's own name may have brackets (`[V] speed [deg/s]`)."""
    stacked = name not in file.variables and name.startswith("[") and name.endswith("]")
    return split(name[1:-1], ";") if stacked else [name]


def _stated(units: Mapping[str, str], name: str) -> str:
    """The unit that the file states of a variable, as it is written or less what picks or turns its channels."""
    return units.get(name) or units.get(re.sub(r"'?(\[[^\[\]]*\])?$", "", name).strip(), "")


def of_each(file: File, key: str) -> np.ndarray | None:
    """Factors of channels that state a unit each, as a force in kN beside one in N, or angles of turning joints beside
    lengths of sliding ones do."""
    if key in file.given.values or f"{key}_unit" in file.given.values or f"{key}_unit" in file.variables:
        return None
    said = [_stated(file.variables.units, part) for part in _parts(file, file.given.names.get(key, key).strip())]
    factors = np.array([(known_unit(text) or (text, 1.0))[1] for text in said])
    known = all(said) if key == "q" else all(known_unit(text) for text in said)
    return factors if len(factors) > 1 and len(set(said)) > 1 and known else None


def scaled(file: File, key: str, x: np.ndarray) -> np.ndarray:
    factor: Any = file.given.factor.get(key)
    each = of_each(file, key) if key in (*SIGNALS, "q") and factor is None else None
    if each is not None:
        factor = each
    elif factor is None:
        factor = unit_of(file, key)[1] if key in (*SIGNALS, "q", "t") else 1.0
        return x if factor == 1.0 else x * factor
    channels = 1 if x.ndim == 0 else x.shape[-1]
    if np.size(factor) not in (1, channels):
        raise file.error(
            key,
            f"{np.size(factor)} {'factors in --factor' if each is None else 'units'} for {channels} channels",
            "one, or one each",
            "Correct --factor." if each is None else f"Say one factor for each: --factor {key}=[...].",
        )
    return x * np.asarray(factor, np.float64)


def scalar(file: File, key: str, default: float | None) -> float | None:
    value = file.get(key)
    if value is None:
        return default
    x = numbers(file, key, value)
    if x.size != 1:
        raise file.error(key, f"an array of shape {x.shape}", "one number", f"Set it: --set {key}=NUMBER.")
    return float(scaled(file, key, x.reshape(())))


def text(file: File, key: str, default: str) -> str:
    value = file.get(key)
    if value is not None and not isinstance(value, str):
        choices = " or ".join(QUANTITIES)
        raise file.error(key, f"numbers of shape {np.shape(value)}", choices, f"Set it: --set {key}=velocity.")
    return default if value is None else value.strip()
