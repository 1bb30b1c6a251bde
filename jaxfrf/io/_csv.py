"""Tables of numbers as text, with or without a line of headings."""

import pathlib
import re

import numpy as np

from .._errors import InputError, input_error
from ..units import known_unit
from ._container import Leaf, Unreadable, Variables

KIND = "a table of numbers"

_COMMENTS = ("#", "%")
_SEPARATORS = (";", "\t", ",", None)
_HEADING = re.compile(r"(?P<name>[^\[(]*\w[^\[(]*)[\[(](?P<unit>[^\[\]()\d]{1,9}\d?|1/[^\[\]()\d]{1,8}\d?)[\])]")
_LOOK = 20  # last lines that tell the separator
_TOP = 100  # first lines among which the headings are looked for where these do not
_SEP = re.compile(r"sep=.", re.IGNORECASE)  # a line for spreadsheets
_QUOTED = {q: re.compile(rf"{q}([^{q}]*){q}") for q in "\"'"}
_DECIMAL_COMMA = re.compile(r"[-+]?(\d{1,3}(\.\d{3})+|\d*),\d+([eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d*")
_HIDDEN = {ord(c): 0xE000 + ord(c) for c in ",;\t "}  # separators within quotes, in Unicode's private area
_SHOWN = {hidden: shown for shown, hidden in _HIDDEN.items()}
_NUMBERED = re.compile(r"\d{1,3}")  # a heading, beside others that are words
_QUOTES = re.compile(r"\"|'")
_GROUPED = re.compile(r"[-+]?\d{1,3}([.,'\u2019 \u00a0\u202f])\d{3}(\1\d{3})*([.,]\d*)?")
_DIGIT = re.compile(r"\d")
_CLOCK = re.compile(r"\d:\d\d|\d{4}-\d\d-\d\d|\d\d?[./]\d\d?[./]\d{4}")
_TIME_OF_DAY = re.compile(  # behind a date or nothing, before a time zone or nothing
    r"(?:\d{4}-\d\d?-\d\d?[T ]\s*|\d\d?([./])\d\d?\1\d{2,4},?\s+)?"
    r"(?P<h>\d\d?):(?P<m>[0-5]\d):(?P<s>[0-5]\d(?:[.,]\d+)?)(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?\s*(?:Z|[+-]\d\d:?\d\d)?"
)
_DAY = 86400.0  # s
_WORD = re.compile(r"[^\W\d].*", re.DOTALL)


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """The columns by heading, or by number ("1" is the first) where there are no headings.

    Semicolons, tabs, commas or (runs of) blanks separate the columns, whichever makes the lines numbers (tried in this
    order); one may end every line. A comma between digits is a decimal comma where something else separates. Lines that
    begin with `#` or `%` are comments. Before the numbers may stand lines of text; the last one with as many fields as
    the table holds the headings (as `numpy.savetxt` writes them, commented or not), but for one line of units below it.
    UTF-8 and UTF-16 are read, with or without a mark at the beginning. Fields may stand in quotes, numbers too, which
    then hold a decimal comma or thousands if they like; a first line `sep=;` is left out.

    Times of day that increase from line to line, `22:01:46.123`, with a date before them or not, are seconds, on from
    midnight where they pass it. A column with another cell that is no number (a comment, an empty cell) stays closed:
    who asks for it is told where that cell stands.
    """
    lines = _text(path).splitlines()
    lines = _unquoted(lines[1:] if lines and _SEP.fullmatch(lines[0].strip('"\r\n')) else lines)
    if lines and lines[0].startswith("LabVIEW Measurement"):
        lines = _labview(lines)
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith(_COMMENTS)]
    if not numbered:
        raise input_error(str(path), "no lines of numbers", "a table", "Export or copy it again.")
    separator = _separator([line for _, line in numbered])
    text, numbered = _without_ends(*_preamble(numbered, separator), separator)
    leaves, clocks = _leaves(path, text, numbered, separator)
    width = len(leaves)
    headings = _headings(text, separator, width)
    if headings is None and text:  # separated by something else than the numbers
        split = (_fields(text[-1], c) for c in _SEPARATORS)
        headings = next((fields for fields in split if len(fields) == width), None)
    if headings is None and text:
        _check_headings(path, _fields(text[-1], separator), width)
    if headings is None:
        headings = _commented_headings(lines, numbered[0][0], separator, width)
    if headings is None:
        headings = [str(i) for i in range(1, width + 1)]
    _check_headings(path, headings, width)
    plain, bracketed = _without_units(headings)
    units = _without_directions(_units(text, separator, width) or bracketed)
    units = ["s" if k in clocks else unit for k, unit in enumerate(units)]
    columns = dict(zip(headings, leaves, strict=True))
    aliases = {short: name for short, name in zip(plain, headings, strict=True) if short not in columns}
    return Variables(columns, dict(zip(headings, units, strict=True)), aliases)


def _units(text: list[str], separator: str | None, width: int) -> list[str] | None:
    """The line of units below the headings, if there is one."""
    fitting = [fields for fields in (_fields(line, separator) for line in text) if len(fields) == width]
    return [x.strip("[]() ") for x in fitting[-1]] if len(fitting) > 1 and _are_units(fitting[-1]) else None


def _without_units(headings: list[str]) -> tuple[list[str], list[str]]:
    """Headings, and the units that they end with: `speed [deg/s]`, `torque (N m)`."""
    found = [_HEADING.fullmatch(name) for name in headings]
    plain = [m["name"].strip() if m else name for m, name in zip(found, headings, strict=True)]
    if len(set(plain)) < len(plain):
        return headings, [""] * len(headings)
    return plain, [m["unit"].strip() if m else "" for m in found]


def _without_directions(units: list[str]) -> list[str]:
    """Units but for `in` beside `out`: `torque (in)` and `speed (out)` say which way a signal goes, not inches."""
    if not {"in", "out"} <= set(units):
        return units
    return ["" if unit in ("in", "out") else unit for unit in units]


def _text(path: pathlib.Path) -> str:
    """A unit such as ° in an unknown encoding must not make the numbers unreadable."""
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:200]:  # every other byte of plain text in UTF-16
        return data.decode("utf-16-be" if data[:1] == b"\0" else "utf-16-le", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:  # what loggers on Windows write, or a part of it
        return data.decode("cp1252", errors="replace")


def _unquoted(lines: list[str]) -> list[str]:
    """Lines whose quoted fields hold no separators. Numbers lose their quotes where the last line has quoted ones, so
    that headings in quotes over plain numbers stay what they are."""
    last = next((line for line in reversed(lines) if line.strip()), "").lstrip()
    quote = "'" if last.startswith("'") or (lines and lines[0].startswith("'")) else '"'
    if not any(quote in line for line in lines):
        return lines
    numbers = quote in last

    def field(match: re.Match) -> str:
        text = match[1].strip()
        if numbers and _DECIMAL_COMMA.fullmatch(text):
            return text.replace(".", "").replace(",", ".")
        if numbers and _THOUSANDS.fullmatch(text):
            return text.replace(",", "")
        hidden = text.translate(_HIDDEN)
        return hidden if numbers else f"{quote}{hidden}{quote}"

    return [_QUOTED[quote].sub(field, line) if quote in line else line for line in lines]


def _labview(lines: list[str]) -> list[str]:
    """The table of a `.lvm` file: what stands below its last header, without columns that are empty (the comments, and
    the time where none was logged)."""
    ends = [i for i, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    rows = [line.split("\t") for line in lines[ends[-1] + 1 :] if line.strip()] if ends else []
    width = max((len(row) for row in rows), default=0)
    rows = [row + [""] * (width - len(row)) for row in rows]
    filled = [k for k in range(width) if any(row[k].strip() for row in rows[1:])]
    return ["\t".join(row[k] for k in filled) for row in rows]


def _separator(lines: list[str]) -> str | None:
    """The separator by which the last lines are numbers. Where none makes them so, the one that gives them a column of
    numbers and as many fields as the headings have; that stands in the first line; or that gives them a column of
    numbers."""
    last = lines[-_LOOK:]
    for c in _SEPARATORS:
        if any(c in line if c else len(line.split()) > 1 for line in last) and all(_is_row(line, c) for line in last):
            return c
        if c == "\t" and _names_holes(lines):
            return c
    single = all(_is_row(line, None) for line in last)
    tables = [c for c in _SEPARATORS if _has_numbers(last, c)] if not single else []
    headed = [c for c in tables if _headings_of(lines, c)]
    return next(iter([*headed, *(c for c in ";\t," if c in lines[0]), *tables]), None)


def _names_holes(lines: list[str]) -> bool:
    """Whether tabs separate numbers and empty cells, which would be no cells if blanks separated them: the headings
    name their columns, too."""
    last = lines[-_LOOK:]
    plain = all(not field or _is_number(field, "\t") for line in last for field in _fields(line, "\t"))
    return plain and _has_numbers(last, "\t") and any(all(words) for words in _headings_of(lines, "\t"))


def _has_numbers(lines: list[str], separator: str | None) -> bool:
    """Whether these lines have one number of fields, more than one, and numbers in one column throughout."""
    rows = [_fields(line, separator) for line in lines]
    if len(rows[0]) < 2 or len({len(row) for row in rows}) > 1:
        return False
    return any(all(_is_number(field, separator) for field in column) for column in zip(*rows, strict=True))


def _headings_of(lines: list[str], separator: str | None) -> list[list[str]]:
    """What may be headings: those of the first lines that hold no number, and as many fields as the last line."""
    width = len(_fields(lines[-1], separator))
    rows = [_fields(line, separator) for line in lines[:_TOP]]
    return [x for x in rows if len(x) == width and not any(_is_number(field, separator) for field in x)]


def _is_row(line: str, separator: str | None) -> bool:
    fields = _fields(line, separator)
    if separator is not None and len(fields) > 1 and not fields[-1]:
        fields = fields[:-1]
    return all(_is_number(field, separator) for field in fields)


def _preamble(numbered, separator) -> tuple[list[str], list]:
    """The lines of text before the numbers, and the numbers. A line of text holds no number at all, or other fields in
    number than the table beside some text: what is left of a row is no text."""
    width = len(_fields(numbered[-1][1], separator))

    def begins(line: str) -> bool:
        fields = _fields(line, separator)
        if len(fields) > 1 and not fields[-1]:
            fields = fields[:-1]
        numbers = [_is_number(field, separator) for field in fields]
        if _QUOTES.match(line.lstrip()) or (line is numbered[0][1] and _named(fields, numbers)):
            return False
        return all(numbers) or (any(numbers) and len(_fields(line, separator)) == width)

    first = next((i for i, (_, line) in enumerate(numbered) if begins(line)), len(numbered))
    return [line for _, line in numbered[:first]], numbered[first:]


def _without_ends(text: list[str], numbered: list, separator: str | None) -> tuple[list[str], list]:
    """The lines without separators that end every one of them, unless a heading names the empty column behind."""
    while separator is not None and numbered and all(line.rstrip(" ").endswith(separator) for _, line in numbered):
        if _names_last(text, numbered, separator):
            break
        numbered = [(i, line.rstrip(" ")[: -len(separator)]) for i, line in numbered]
        text = [line.rstrip(" ").removesuffix(separator) for line in text]
    return text, numbered


def _names_last(text: list[str], numbered: list, separator: str | None) -> bool:
    """Whether the last column has a heading, as the first row counts them."""
    headings = _headings(text, separator, len(_fields(numbered[0][1], separator))) if text else None
    return headings is not None and bool(headings[-1])


def _named(fields: list[str], numbers: list[bool]) -> bool:
    """Whether these are headings of which some are numbers: `t,1,2`; the others are words."""
    words = [field for field, is_number in zip(fields, numbers, strict=True) if not is_number]
    counted = [field for field, is_number in zip(fields, numbers, strict=True) if is_number]
    return bool(words) and all(_WORD.match(x) for x in words) and all(_NUMBERED.fullmatch(x) for x in counted)


def _headings(text: list[str], separator: str | None, width: int) -> list[str] | None:
    """The last line of text with as many fields as the table; the one before it where that is a line of units."""
    fitting = [fields for fields in (_fields(line, separator) for line in text) if len(fields) == width]
    if not fitting or len(_fields(text[-1], separator)) != width:
        return fitting[-1] if fitting else None
    if len(fitting) > 1 and _are_units(fitting[-1]):
        return fitting[-2]
    return fitting[-1]


def _are_units(fields: list[str]) -> bool:
    """`[s]`, `(N m)`, `rad/s`, `-`, or nothing: short, and in brackets or of the usual letters."""
    plain = [field.strip("[]() ") for field in fields]
    bracketed = any(field[:1] in "[(" for field in fields if field)
    return all(len(x) < 12 for x in plain) and (bracketed or all(not x or known_unit(x) for x in plain))


def _fields(line: str, separator: str | None) -> list[str]:
    return [field.strip().strip("\"'").translate(_SHOWN) for field in line.strip(" \r\n").split(separator)]


def _plain(field: str, separator: str | None) -> str:
    return field if separator == "," else field.replace(",", ".")


def _is_number(field: str, separator: str | None) -> bool:
    if "_" in field:  # Python's, of nobody else
        return False
    try:
        float(_plain(field, separator))
    except ValueError:
        return False
    return True


def _leaves(
    path: pathlib.Path, text: list[str], numbered: list[tuple[int, str]], separator: str | None
) -> tuple[list[Leaf], set[int]]:
    """The columns: arrays, or closed where a cell is no number; and which of them are times of day."""
    if not numbered:
        raise input_error(str(path), "headings without numbers", "a table", "Export or copy it again.")
    try:
        rows = (_plain(line.strip(), separator) for _, line in numbered)
        table = np.loadtxt(rows, delimiter=separator, ndmin=2, comments=None, dtype=np.float64)
    except ValueError:
        return _mixed_leaves(path, numbered, separator)
    empty_last = table.shape[1] < len(_fields(numbered[0][1], separator))  # behind tabs at the end
    if empty_last and _names_last(text, numbered, separator):
        return _mixed_leaves(path, numbered, separator)
    return list(table.T), set()


def _mixed_leaves(
    path: pathlib.Path, numbered: list[tuple[int, str]], separator: str | None
) -> tuple[list[Leaf], set[int]]:
    """The columns of a table of which some hold more than numbers; and which of them are times of day.

    **Raises:** `jaxfrf.InputError` where lines have other numbers of fields, no column is numbers, or a line is none of
    the table.
    """
    faults = _faults(path, numbered, separator)
    columns = range(len(_cells(numbered[0][1], separator)))
    kept = [k for k in columns if k not in faults]
    first = min(faults.values(), default=None)
    stray = _stray(numbered, separator) if kept else first
    if stray is not None:
        raise InputError(_says(path, stray, separator))
    try:
        rows = (_plain(line.strip(" \r\n"), separator) for _, line in numbered)
        table = np.loadtxt(rows, delimiter=separator, ndmin=2, comments=None, dtype=np.float64, usecols=kept)
    except ValueError as error:
        raise input_error(str(path), "a table that cannot be read", "numbers in columns", "Export it again.") from error
    numbers = dict(zip(kept, table.T, strict=True))
    clocks = {k: t for k in faults if (t := _times_of_day(numbered, separator, k)) is not None}
    numbers |= clocks
    return [numbers[k] if k in numbers else _closed(path, faults[k], separator) for k in columns], set(clocks)


def _times_of_day(numbered: list[tuple[int, str]], separator: str | None, column: int) -> np.ndarray | None:
    """Seconds since the first midnight; `None` where a cell is no time of day, and where times do not increase, as
    those of a clock that is coarser than the sampling."""
    found = []
    for _, line in numbered:
        match = _TIME_OF_DAY.fullmatch(_fields(line, separator)[column])
        if match is None:
            return None
        hours = int(match["h"]) % 12 + 12 * (match["half"] in "Pp") if match["half"] else int(match["h"])
        found.append(3600.0 * hours + 60.0 * int(match["m"]) + float(match["s"].replace(",", ".")))
    steps = np.diff(found)
    steps = np.where(steps < -_DAY / 2, steps + _DAY, steps)
    return found[0] + np.concatenate([[0.0], np.cumsum(steps)]) if np.all(steps > 0.0) else None


_Fault = tuple[int, int, str]  # line and column, as people count, and the cell that is no number


def _faults(path: pathlib.Path, numbered: list[tuple[int, str]], separator: str | None) -> dict[int, _Fault]:
    """By column, from 0, the first cell that is no number.

    **Raises:** `jaxfrf.InputError` at a line that has more or fewer cells than the first.
    """
    width = len(_cells(numbered[0][1], separator))
    found: dict[int, _Fault] = {}
    open_columns = list(range(width))
    for i, line in numbered:
        cells = _cells(line, separator)
        if len(cells) != width:
            raise input_error(
                f"{path}: line {i}",
                f"{len(cells)} columns",
                f"{width} as in the lines before",
                "Complete or cut the table.",
            )
        wrong = [k for k in open_columns if not _is_number(cells[k], separator)]
        if wrong:
            found |= {k: (i, k + 1, cells[k].strip().translate(_SHOWN)) for k in wrong}
            open_columns = [k for k in open_columns if k not in found]
    return found


def _cells(line: str, separator: str | None) -> list[str]:
    """As `_fields`, as they are written."""
    return line.strip(" \r\n").split(separator)


def _stray(numbered: list[tuple[int, str]], separator: str | None) -> _Fault | None:
    """A first or last line that is no row: it begins with a word (`Sensitivity`, `Maximum`), and others with a number,
    a date or a time. What stands in it is no sample."""
    usual = _fields(numbered[len(numbered) // 2][1], separator)[0]
    if not (_is_number(usual, separator) or _CLOCK.search(usual)):
        return None
    for i, line in (numbered[0], numbered[-1]):
        cell = _fields(line, separator)[0]
        if cell and not _DIGIT.search(cell) and not _is_number(cell, separator):
            return i, 1, cell
    return None


def _closed(path: pathlib.Path, fault: _Fault, separator: str | None) -> Unreadable:
    return Unreadable(f"no number in line {fault[0]}", _says(path, fault, separator))


def _says(path: pathlib.Path, fault: _Fault, separator: str | None) -> str:
    line, column, cell = fault
    what, expected = f"{path}: line {line}, column {column}", "a number (after one line of headings at most)"
    return str(input_error(what, repr(cell), expected, _advice(cell, separator)))


def _advice(cell: str, separator: str | None) -> str:
    """What to do about a cell that is no number."""
    if _GROUPED.fullmatch(cell):
        return "Remove the thousands separators."
    if _CLOCK.search(cell):
        return "Write seconds, or leave that column out and say the rate: --set fs=RATE."
    if separator == "," and _DIGIT.search(cell):
        return "Fill or cut that line; write decimal points, or separate columns by semicolons."
    return "Fill or cut that line, or name a column of numbers."


def _commented_headings(lines: list[str], first: int, separator: str | None, width: int) -> list[str] | None:
    before = [line for line in lines[: first - 1] if line.strip()]
    if not before:
        return None
    text = before[-1].lstrip("#%")
    fields = next((f for f in (_fields(text, separator), text.split()) if len(f) == width), [])
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
