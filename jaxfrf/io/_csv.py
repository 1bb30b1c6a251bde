"""Tables of numbers as text, with or without a line of headings."""

import pathlib

import numpy as np

from .._errors import InputError, input_error
from ._container import Leaf

KIND = "a table of numbers"

_COMMENTS = ("#", "%")


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """The columns by heading, or by number ("0" is the first) where there are no headings.

    Semicolons, tabs, commas or blanks separate the columns, whichever the table uses (in this order). In a
    table with semicolons a comma is a decimal comma. Lines that begin with `#` or `%` are comments; the last
    one before the numbers holds the headings if it has as many fields as the table (as `numpy.savetxt` writes
    them).
    """
    # A unit such as ° in an unknown encoding must not make the numbers unreadable.
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith(_COMMENTS)]
    if not numbered:
        raise input_error(str(path), "no lines of numbers", "a table", "Export or copy it again.")
    separator = _separator(numbered[0][1])
    headings = None
    if not all(_is_number(field, separator) for field in _fields(numbered[0][1], separator)):
        headings = _fields(numbered.pop(0)[1], separator)
    table = _numbers(path, numbered, separator)
    if headings is None:
        headings = _commented_headings(lines, numbered[0][0], separator, table.shape[1])
    if headings is None:
        headings = [str(i) for i in range(table.shape[1])]
    _check_headings(path, headings, table.shape[1])
    return {name: table[:, i] for i, name in enumerate(headings)}


def _separator(line: str) -> str | None:
    return next((c for c in ";\t," if c in line), None)


def _fields(line: str, separator: str | None) -> list[str]:
    return [field.strip().strip("\"'") for field in line.strip().split(separator)]


def _plain(field: str, separator: str | None) -> str:
    return field.replace(",", ".") if separator == ";" else field


def _is_number(field: str, separator: str | None) -> bool:
    try:
        float(_plain(field, separator))
    except ValueError:
        return False
    return True


def _numbers(path: pathlib.Path, numbered: list[tuple[int, str]], separator: str | None) -> np.ndarray:
    if not numbered:
        raise input_error(str(path), "headings without numbers", "a table", "Export or copy it again.")
    try:
        rows = (_plain(line, separator) for _, line in numbered)
        return np.loadtxt(rows, delimiter=separator, ndmin=2, comments=None, dtype=np.float64)
    except ValueError as error:
        raise _first_fault(path, numbered, separator) from error


def _first_fault(path: pathlib.Path, numbered: list[tuple[int, str]], separator: str | None) -> InputError:
    """What is wrong with a table that could not be read: its first ragged line or text field."""
    width = len(_fields(numbered[0][1], separator))
    for i, line in numbered:
        fields = _fields(line, separator)
        if len(fields) != width:
            return input_error(
                f"{path}: line {i}",
                f"{len(fields)} columns",
                f"{width} as in the lines before",
                "Complete or cut the table.",
            )
        wrong = [k for k, field in enumerate(fields) if not _is_number(field, separator)]
        if wrong:
            return input_error(
                f"{path}: line {i}, column {wrong[0]}",
                repr(fields[wrong[0]]),
                "a number (after one line of headings at most)",
                "Fill or cut that line; write decimal points, or separate columns by semicolons.",
            )
    return input_error(str(path), "a table that cannot be read", "numbers in columns", "Export it again.")


def _commented_headings(lines: list[str], first: int, separator: str | None, width: int) -> list[str] | None:
    before = [line for line in lines[: first - 1] if line.strip()]
    if not before:
        return None
    fields = _fields(before[-1].lstrip("#%"), separator)
    named = len(fields) == width and not any(_is_number(field, separator) for field in fields)
    return fields if named else None


def _check_headings(path: pathlib.Path, headings: list[str], width: int) -> None:
    if len(headings) != width:
        raise input_error(
            f"{path}: headings",
            f"{len(headings)} names over {width} columns",
            "one name for each column",
            "Correct the first line, or delete it and give columns by number.",
        )
    repeated = {name for name in headings if headings.count(name) > 1}
    if repeated:
        raise input_error(
            f"{path}: headings",
            f"{sorted(repeated)[0]!r} more than once",
            "different names",
            "Rename the columns, or delete the line of headings and give columns by number.",
        )
