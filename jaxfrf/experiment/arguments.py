"""What a record is made of, as it is given, becomes arrays and numbers that can be relied on."""

from collections.abc import Iterable

import numpy as np

from .._arguments import expect_text, said
from .._errors import input_error
from .._text import number
from ..units import QUANTITIES, known_unit

_LARGEST = 1e100


def _array(name: str, value) -> np.ndarray:
    """An array; what is no array, or one of which a mask hides a part, is refused."""
    if np.ma.is_masked(value):
        hidden = int(np.ma.getmaskarray(value).sum())
        raise input_error(
            name,
            f"a masked array that hides {hidden} samples",
            "a record without holes",
            "Cut it to what is whole, or fill the holes yourself (.filled) and know what that does to the spectrum.",
        )
    try:
        return np.asarray(value)
    except ValueError:
        raise input_error(
            name, "lists of unequal length", "numbers in rows of one length", "Cut them to their common part."
        ) from None


def as_signal(name: str, value) -> np.ndarray:
    if value is None:
        raise input_error(name, "None", "a record", "Give the signal.")
    x = _array(name, value)
    if not (np.issubdtype(x.dtype, np.floating) or np.issubdtype(x.dtype, np.integer) or x.dtype == bool):
        kind = "complex numbers" if np.issubdtype(x.dtype, np.complexfloating) else f"{x.dtype} data"
        raise input_error(name, kind, "real numbers", "Store the time record itself, not its spectrum or a text.")
    if x.size == 0:
        raise input_error(name, f"no samples (shape {x.shape})", "a record", "Check the file and the names in --map.")
    if x.ndim == 1 or (x.ndim == 2 and len(x) == 1):
        x = x.reshape(-1, 1)  # a row vector is one channel too
    if not 2 <= x.ndim <= 4:
        raise input_error(
            name,
            f"{x.ndim} dimensions {x.shape}",
            "(time, channel), (experiment, time, channel) or (position, experiment, time, channel)",
            "Reshape the array.",
        )
    x = x.astype(np.float64, copy=False)
    x = x.reshape((1,) * (4 - x.ndim) + x.shape)
    if x.shape[3] > x.shape[2]:
        raise input_error(
            name,
            f"{x.shape[2]} samples of {x.shape[3]} channels",
            "more samples than channels (the last two axes are time, channel)",
            "The axes look swapped: transpose the array.",
        )
    # One NaN or Inf makes the sum so; the mask, as long as the record, is needed then only.
    with np.errstate(over="ignore", invalid="ignore"):
        suspicious = not np.isfinite(x.sum())
    if suspicious and (bad := ~np.isfinite(x)).any():
        pos, exp, time, channel = (int(i) for i in np.argwhere(bad)[0])
        raise input_error(
            name,
            f"{int(bad.sum())} NaN or Inf samples, the first at position {pos}, experiment {exp}, "
            f"sample {time}, channel {channel}",
            "finite numbers",
            "Repair or cut the record: a DFT spreads one bad sample over all frequencies.",
        )
    if max(x.max(), -x.min()) > _LARGEST:
        raise input_error(
            name,
            f"numbers up to {number(max(x.max(), -x.min()))}",
            f"at most {number(_LARGEST)}, whose squares are finite",
            "The file is damaged, or these are no numbers of a record.",
        )
    return x


def as_configurations(value) -> np.ndarray:
    q = np.atleast_2d(_array("q", value))
    if q.ndim != 2 or q.dtype.kind not in "iuf" or not np.isfinite(q).all():
        raise input_error(
            "q", f"{q.dtype} of shape {q.shape}", "finite angles of shape (position, joint), rad", "Check q."
        )
    return q.astype(np.float64)


def as_line_numbers(value) -> np.ndarray:
    k = np.atleast_1d(_array("lines", value)).ravel()
    if k.size == 0 or k.dtype.kind not in "iuf" or np.any(k != np.round(k)):
        raise input_error("lines", f"{k[:5]}", "whole DFT line numbers of one period", "Line k is k*fs/period Hz.")
    return k.astype(np.int64)


def _number(name: str, value) -> float:
    x = _array(name, value)
    if x.size != 1 or x.dtype.kind not in "biuf":
        raise input_error(name, f"{x.dtype} of shape {x.shape}", "one real number", f"Set it, e.g. --set {name}=2000.")
    return float(x.item())


def as_positive(name: str, value) -> float:
    x = _number(name, value)
    if not (np.isfinite(x) and x > 0):
        raise input_error(name, f"{x:g}", "a positive number", f"Set it, e.g. --set {name}=2000.")
    return x


_SAMPLE = {"period": 2500}


def as_count(name: str, value) -> int:
    x = _number(name, value)
    if not (np.isfinite(x) and x >= 0 and x == round(x)):
        raise input_error(
            name, f"{x:g}", "a whole number, 0 or more", f"Set it, e.g. --set {name}={_SAMPLE.get(name, 1)}."
        )
    return int(x)


def as_quantity(name: str, value) -> str:
    value = str(value)
    if value not in QUANTITIES:
        raise input_error(name, repr(value), "position, velocity or acceleration", f"Set it: --set {name}=velocity.")
    return value


def as_unit(name: str, value) -> str:
    """The unit as SI has it; one that nobody knows is a name."""
    expect_text(name, value)
    unit, factor = known_unit(value) or (value, 1.0)
    if factor != 1.0:
        do = f"Multiply the numbers by {number(factor, 6)} and give {unit!r}."
        raise input_error(name, repr(value), "a unit of SI: numbers are not converted here", do)
    return unit


def as_each(name: str, values, kind: type) -> tuple:
    given = tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else (None,)
    if not all(isinstance(x, kind) for x in given):
        each = "texts" if kind is str else f"jaxfrf.experiment.{kind.__name__}s"
        raise input_error(name, said(values), f"a list of {each}", "Leave it out where there are none.")
    return given
