"""Numbers in messages, summaries and pages."""

import ast
import pathlib
import re

import numpy as np
import pytest

import jaxfrf
from jaxfrf._text import counted, number, percent, plus_minus


@pytest.mark.parametrize(
    ("x", "digits", "text"),
    [
        (0.2512, 2, "0.25"),
        (2.0, 2, "2"),
        (199.7, 2, "200"),
        (9.99, 2, "10"),
        (12800.0, 4, "12800"),
        (1234567.0, 3, "1234567"),
        (1e-4, 2, "0.0001"),
        (2.5e-7, 2, "2.5e-7"),
        (-31.0, 1, "-31"),
        (3.2e9, 2, "3.2e9"),
        (0.0, 2, "0"),
        (-0.0, 2, "0"),
        (np.float64(120.0), 2, "120"),
        (np.inf, 2, "inf"),
        (np.nan, 2, "nan"),
    ],
)
def test_numbers(x, digits, text):
    assert number(x, digits) == text


def test_numbers_keep_zeros_where_they_say_how_many_digits_are_meant():
    assert [number(x, 4, zeros=True) for x in (1.0, 40.0, 12345.0, 1e-9)] == ["1.000", "40.00", "12345", "1.000e-9"]


def test_percentages():
    assert [percent(x) for x in (2.0, 0.0025, 12.34, 0.999)] == ["200 %", "0.25 %", "1234 %", "100 %"]


def test_counts():
    assert [counted(n, "period") for n in (0, 1, 6)] == ["0 periods", "1 period", "6 periods"]


def test_values_are_as_long_as_their_intervals_tell():
    assert plus_minus(39.90212, 0.3554) == "39.90 +- 0.36"
    assert plus_minus(39.90212, 12.6) == "40 +- 13"
    assert plus_minus(1234.6, 99.96) == "1235 +- 100"
    assert plus_minus(71.2730001, 2.1e-5, "±") == "71.273000 ± 0.000021"
    assert plus_minus(71.2730001, np.nan) == "71.27"
    assert plus_minus(71.2730001, 0.0) == "71.27"


def test_no_message_leaves_the_exponent_to_python():
    """`{x:.2g}` writes 200 as 2e+02: numbers in text go through `_text`. Those of `gap` and `calibration` follow."""
    package = pathlib.Path(jaxfrf.__file__).parent
    left = ("gap", "calibration")
    found = []
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0] in left or path.name in ("gap.py", "gap_words.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FormattedValue) and isinstance(node.format_spec, ast.JoinedStr):
                spec = "".join(str(x.value) for x in node.format_spec.values if isinstance(x, ast.Constant))
                if re.fullmatch(r"\.[1-6]g", spec):
                    found.append(f"{path.relative_to(package)}:{node.lineno}")
    assert not found
