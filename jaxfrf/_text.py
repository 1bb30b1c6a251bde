"""Numbers and names as people write them, in messages, summaries and pages."""

import difflib
import math
from collections.abc import Iterable
from typing import SupportsFloat

_WHOLE = 7  # digits before the point that are written out
_LONG = 60  # characters
_SMALL = -4  # the power of ten below which there is an exponent

NORMAL_95 = 1.959964
"""Standard deviations in half of a 95 % interval of a normal quantity."""


def number(x: SupportsFloat, digits: int = 3, *, zeros: bool = False) -> str:
    """So many significant digits, thousands whole and no exponent where there is room: `0.25`, `1234`, `2.5e-7`.

    **Arguments:** `zeros`: keep those behind the point that say how many digits are meant, `1.000`.
    """
    x = float(x)
    if not math.isfinite(x) or x == 0:
        return f"{x:g}".replace("-0", "0")
    mantissa, power = f"{x:.{digits - 1}e}".split("e")  # the power after rounding: 9.99 is 10 with two digits
    size = int(power)
    if _SMALL <= size < _WHOLE:
        text = f"{x:.{max(digits - 1 - size, 0)}f}"
        return text if zeros else _short(text)
    return f"{mantissa if zeros else _short(mantissa)}e{size}"


def percent(part: SupportsFloat, digits: int = 2) -> str:
    """A part of the whole in per cent: `0.25 %`, `200 %`."""
    return f"{number(100 * float(part), digits)} %"


def plus_minus(value: SupportsFloat, half: SupportsFloat, sign: str = "+-") -> str:
    """A value and half its interval, with two digits of the interval: `71.27 +- 0.16`; the value alone, with four
    digits, where the interval is not known."""
    value, half = float(value), float(half)
    if not (math.isfinite(half) and half > 0 and math.isfinite(value)):
        return number(value, 4)
    size = int(f"{half:.1e}".split("e")[1])
    if size < -9 or size >= _WHOLE:
        return f"{number(value, 4)} {sign} {number(half, 2)}"
    places = max(1 - size, 0)
    return f"{value:.{places}f} {sign} {half:.{places}f}"


def shortened(value: object) -> str:
    """What was given, in messages: as Python writes it, the end of what is long left out."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONG else f"{text[: _LONG - 3]}..."


def counted(n: int, noun: str) -> str:
    """`1 period`, `6 periods`."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def nearest(name: object, known: Iterable[str]) -> str:
    """The known name that is most like what was given, by letters; the first where none is."""
    known = list(known)
    return (difflib.get_close_matches(str(name), known, n=1, cutoff=0.0) or known)[0]


def _short(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text
