"""Units of records: read where files state them, converted to SI, kept with what is made of them."""

import re
import typing

from . import _arguments, _errors

QUANTITIES = {"position": 0, "velocity": 1, "acceleration": 2}
"""How many times each quantity is the time derivative of a position."""

UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
"""Of a motor's motion, where a record says nothing else."""

DEFAULT_INPUT = "N m"
"""Of a motor's torque, where a record says nothing else."""

_LADDERS = (("rad", "rad/s", "rad/s^2"), ("m", "m/s", "m/s^2"))
_TURN = 6.283185307179586
_DEGREE = _TURN / 360
_INCH, _FOOT = 0.0254, 0.3048
_GRAVITY = 9.80665  # m/s^2, by definition
_POUND = 4.4482216152605  # N: the weight of 0.45359237 kg
# Where case tells: mega and milli, newton and nano.
_EXACT: dict[str, tuple[str, float]] = {
    **{"MN": ("N", 1e6), "mN": ("N", 1e-3), "MNm": ("N m", 1e6), "mNm": ("N m", 1e-3)},
    **{"MV": ("V", 1e6), "mV": ("V", 1e-3), "MA": ("A", 1e6), "mA": ("A", 1e-3), "Ms": ("s", 1e6), "ms": ("s", 1e-3)},
    **{"MHz": ("Hz", 1e6), "mHz": ("Hz", 1e-3), "Mm": ("m", 1e6)},
    # `IN`, `FT` and `Mg` are no inches, feet and thousandths of g: a direction, a sensor of force and torque, a mass.
    **{"in": ("m", _INCH), "ft": ("m", _FOOT), "mg": ("m/s^2", 1e-3 * _GRAVITY)},
}
_EITHER = ("nm",)  # nanometres, or newton metres of somebody in a hurry
# Text as files write it, lower case, without blanks: the SI unit and the factor to it.
_KNOWN: dict[str, tuple[str, float]] = {
    **{x: ("s", 1.0) for x in ("s", "sec")},
    **{"ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "ns": ("s", 1e-9), "min": ("s", 60.0)},
    **{"hz": ("Hz", 1.0), "khz": ("Hz", 1e3)},
    **{x: ("N m", 1.0) for x in ("nm", "n*m", "n.m", "n·m", "newtonmeter", "newton-meter")},
    **{"mnm": ("N m", 1e-3), "knm": ("N m", 1e3), "ncm": ("N m", 1e-2)},
    **{"n": ("N", 1.0), "kn": ("N", 1e3), "mn": ("N", 1e-3), "lbf": ("N", _POUND)},
    **{"a": ("A", 1.0), "ma": ("A", 1e-3), "arms": ("A", 1.0), "v": ("V", 1.0), "mv": ("V", 1e-3)},
    **{"rad": ("rad", 1.0), "mrad": ("rad", 1e-3), "deg": ("rad", _DEGREE), "°": ("rad", _DEGREE)},
    **{"degree": ("rad", _DEGREE), "degrees": ("rad", _DEGREE), "rev": ("rad", _TURN), "turn": ("rad", _TURN)},
    **{"rad/s": ("rad/s", 1.0), "1/s": ("1/s", 1.0), "deg/s": ("rad/s", _DEGREE), "°/s": ("rad/s", _DEGREE)},
    **{x: ("rad/s", _TURN / 60) for x in ("rpm", "1/min", "rev/min", "u/min")},
    **{"rev/s": ("rad/s", _TURN)},
    **{x: ("rad/s^2", 1.0) for x in ("rad/s^2", "rad/s2", "rad/s²")},
    **{x: ("rad/s^2", _DEGREE) for x in ("deg/s^2", "deg/s2", "°/s²", "°/s^2")},
    **{"m": ("m", 1.0), "mm": ("m", 1e-3), "um": ("m", 1e-6), "µm": ("m", 1e-6), "cm": ("m", 1e-2), "km": ("m", 1e3)},
    **{"m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "km/h": ("m/s", 1 / 3.6)},
    **{"in/s": ("m/s", _INCH), "ft/s": ("m/s", _FOOT)},
    **{x: ("m/s^2", 1.0) for x in ("m/s^2", "m/s2", "m/s²", "m/s/s")},
    **{x: ("m/s^2", 1e-3) for x in ("mm/s^2", "mm/s2", "mm/s²")},
    **{x: ("m/s^2", _INCH) for x in ("in/s^2", "in/s2", "in/s²")},
    **{x: ("m/s^2", _FOOT) for x in ("ft/s^2", "ft/s2", "ft/s²")},
    **{"g": ("m/s^2", _GRAVITY), "gn": ("m/s^2", _GRAVITY)},
    **{"%": ("1", 0.01), "-": ("1", 1.0), "1": ("1", 1.0)},
}


def known_unit(text: str) -> tuple[str, float] | None:
    """The SI unit and the factor to it, of a unit as people write it; `None` if it is not known.

    `g` is the acceleration, 9.80665 m/s^2, and `mg` a thousandth of it: nobody logs grams of a machine that vibrates.
    `in` and `ft` are inches and feet, in lower case alone. `nm` is not known: it may be nanometres or newton metres,
    which differ by what is measured.

    **Arguments:** `text`: e.g. `deg/s`, `[mA]`, `rpm`.

    **Returns:** e.g. (`rad/s`, 0.0174533).

    **Raises:** `jaxfrf.InputError` for what is no text.
    """
    _arguments.expect_text("unit", text)
    plain = text.replace("\u03bc", "\u00b5").strip().strip("[]()").strip()  # the Greek letter for the sign of micro
    if plain in _EITHER:
        return None
    joined = re.sub(r"\s+", "", plain)
    return _EXACT.get(joined) or _KNOWN.get(joined.lower())


def quantity_of(unit: str) -> str | None:
    """`position`, `velocity` or `acceleration`, as the SI unit of a motion says; `None` of anything else.

    **Arguments:** `unit`: e.g. `rad/s`.
    """
    for ladder in _LADDERS:
        if unit in ladder:
            return list(QUANTITIES)[ladder.index(unit)]
    return None


def expect_quantity(name: str, value: typing.Any) -> None:
    """Refuse what is no quantity of a motion.

    **Arguments:** `name`: of the argument. `value`: its value.

    **Raises:** `jaxfrf.InputError` for anything else than `position`, `velocity` or `acceleration`.
    """
    if not isinstance(value, str) or value not in QUANTITIES:
        raise _errors.input_error(
            name, _arguments.said(value), "position, velocity or acceleration", "Choose one of them."
        )


def differentiated(unit: str, times: int) -> str:
    """The unit of the `times`-th time derivative (negative: integral).

    **Arguments:** `unit`: in SI, as text. `times`: how often.

    **Returns:** e.g. `rad/s^2` of `rad` and 2.

    **Raises:** `jaxfrf.InputError` for a unit that is no text, or `times` that is no whole number.
    """
    _arguments.expect_text("unit", unit)
    _arguments.expect_whole("times", times, None)
    for ladder in _LADDERS:
        if unit in ladder and 0 <= ladder.index(unit) + times < len(ladder):
            return ladder[ladder.index(unit) + times]
    power = f"^{abs(times)}" if abs(times) > 1 else ""
    return f"{unit}{'/' if times > 0 else ' '}s{power}" if times else unit


class _WithUnits(typing.Protocol):
    """A record, spectra or an FRF."""

    @property
    def u_unit(self) -> str: ...

    @property
    def y_unit(self) -> str: ...

    @property
    def y_quantity(self) -> str: ...


def input_unit(of: _WithUnits) -> str:
    """The unit of u of a record, of spectra or of an FRF.

    **Arguments:** `of`: `jaxfrf.Experiment`, `jaxfrf.Spectra` or `jaxfrf.FRF`.

    **Returns:** its SI unit, as text; `N m` where it says none.
    """
    return of.u_unit or DEFAULT_INPUT


def output_unit(of: _WithUnits) -> str:
    """The unit of y of a record, of spectra or of an FRF.

    **Arguments:** `of`: `jaxfrf.Experiment`, `jaxfrf.Spectra` or `jaxfrf.FRF`.

    **Returns:** its SI unit, as text; that of a motor's motion where it says none.
    """
    return of.y_unit or UNITS[of.y_quantity]


def response_unit(of: _WithUnits) -> str:
    """The unit of y over that of u.

    **Arguments:** `of`: `jaxfrf.Experiment`, `jaxfrf.Spectra` or `jaxfrf.FRF`.

    **Returns:** e.g. `(rad/s)/(N m)`.
    """
    return f"{_bracketed(output_unit(of))}/{_bracketed(input_unit(of))}"


def _bracketed(unit: str) -> str:
    return f"({unit})" if re.search(r"[\s/*^]", unit) else unit
