"""A table of a robot's file, each entry checked as it is read."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from .._errors import InputError, input_error
from .._text import nearest, shortened


class Table:
    """A table with the name of its place, so that every message says where it looks."""

    def __init__(self, table: Mapping[str, Any], where: str, known: Iterable[str] | None):
        if not isinstance(table, Mapping):
            raise input_error(where, shortened(table), "a table", "Write it as a TOML table.")
        self._table, self.where = table, where
        for key in table:
            if known is not None and key not in known:
                raise input_error(
                    where,
                    f"the unknown key {key!r}",
                    f"keys among {', '.join(known)}",
                    f"Did you mean {nearest(key, known)!r}?",
                )

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def __getitem__(self, key: str) -> Any:
        return self._table[key]

    def error(self, key: str, expected: str, do: str) -> InputError:
        found = shortened(self._table[key]) if key in self._table else "nothing"
        return input_error(f"{self.where}: {key}", found, expected, do)

    def _value(self, key: str, default: Any, expected: str) -> Any:
        if key in self._table:
            return self._table[key]
        if default is None:
            raise self.error(key, expected, f"Add {key} = ... there.")
        return default

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        positive: bool = False,
        nonnegative: bool = False,
        infinite: bool = False,
    ) -> float:
        kind = "a positive number" if positive else "a number, 0 or more" if nonnegative else "a number"
        value = self._value(key, default, f"{kind}, inf where it is rigid" if infinite else kind)
        if isinstance(value, bool) or not isinstance(value, int | float) or not _fits(value):
            raise self.error(key, kind, "Write a number, in SI units.")
        if (math.isinf(value) and not infinite) or (positive and value <= 0) or (nonnegative and value < 0):
            raise self.error(key, kind if infinite else f"{kind}, finite", "Correct the value or its unit.")
        return float(value)

    def number_or_each(self, key: str, size: int, default: float | None = None, **limits) -> float | list[float]:
        """One number for all, or a list of one for each."""
        value = self._table.get(key)
        if not isinstance(value, list):
            return self.number(key, default, **limits)
        if len(value) != size:
            raise self.error(key, f"a number, or {size} of them", "Give one for each driven joint, base to tip.")
        return [Table({key: x}, self.where, None).number(key, **limits) for x in value]

    def flag(self, key: str, default: bool) -> bool:
        value = self._value(key, default, "true or false")
        if not isinstance(value, bool):
            raise self.error(key, "true or false", "Write it without quotes.")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        value = self._value(key, default, "a text")
        if not isinstance(value, str):
            raise self.error(key, "a text", "Write it in quotes.")
        return value

    def vector(self, key: str, size: int, default: list[float] | None = None) -> list[float]:
        value = self._value(key, default, f"{size} numbers")
        plain = isinstance(value, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        if not plain or len(value) != size or not all(_fits(x) and math.isfinite(x) for x in value):
            raise self.error(key, f"a list of {size} finite numbers", "Write it as [x, y, z, ...], in SI units.")
        return [float(x) for x in value]

    def flat(self) -> dict[str, Any]:
        """Its entries, those of tables in it under both names: TOML reads `joint1.mass = 0.1` so."""
        inner = {
            f"{key}.{name}": x for key, v in self._table.items() if isinstance(v, Mapping) for name, x in v.items()
        }
        return {key: v for key, v in self._table.items() if not isinstance(v, Mapping)} | inner

    def table(self, key: str, known: Iterable[str] | None) -> "Table | None":
        if key not in self._table:
            return None
        return Table(self._table[key], f"{self.where}: [{key}]", known)

    def tables(self, key: str) -> list[Mapping[str, Any]]:
        value = self._table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(x, Mapping) for x in value):
            raise self.error(key, f"[[{key}]] tables", f"Head each with [[{key}]], two brackets.")
        return value


def _fits(value: int | float) -> bool:
    """Whether it is a number, and one that double precision holds: TOML's whole numbers have any length."""
    try:
        return not math.isnan(value)
    except OverflowError:
        return False
