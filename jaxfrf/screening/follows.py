"""A loop whose measured signals follow their references in another unit."""

import math
from collections.abc import Iterator

import numpy as np

from .._text import number
from .finding import Finding, Severity
from .record import Record

_UNITS = {"rev/min": 60.0 / (2.0 * math.pi), "degrees": 180.0 / math.pi}  # in one of rad (/s)
_LINES = 6  # the lowest ones: there a loop follows
_LATE = 0.6  # rad: what follows is no later there, and what is driven by a torque is
_NEAR = 1.35  # times the factor of a unit, or one over it: how well it does


def other_unit(record: Record) -> Iterator[Finding]:
    """Where all channels of y follow r at the lowest excited lines, but for the factor of a unit.

    Nothing is said where y and r are different quantities. A loop that does not follow there, or a gear between y and
    r, can be taken for it where all channels have nearly that factor.
    """
    data = record.data
    if data.r is None or data.r.shape[-1] != data.n_out or data.r_quantity != data.y_quantity:
        return
    if not data.period or len(record.lines) < _LINES:
        return
    R, Y = (record.spectra[name][..., :_LINES, :].mean(axis=2) for name in ("r", "y"))  # (pos, exp, line, channel)
    power = np.sum(np.abs(R) ** 2, axis=1)
    if not power.all():
        return
    each = np.sum(Y * R.conj(), axis=1) / power  # (pos, line, channel)
    followed, late = (np.median(part, axis=1) for part in (np.abs(each), np.abs(np.angle(each))))
    if np.any(late > _LATE):
        return
    for unit, size in _UNITS.items():
        for larger, factor in (("y", size), ("r", 1.0 / size)):
            if np.all((followed > factor / _NEAR) & (followed < factor * _NEAR)):
                yield _in(unit, larger, float(np.median(followed)))


def _in(unit: str, larger: str, factor: float) -> Finding:
    other = "r" if larger == "y" else "y"
    return Finding(
        "other unit",
        Severity.WARNED,
        factor,
        f"y follows r at the lowest lines, {number(factor, 2)} times as large in all channels: is {larger} in {unit}, "
        f"and {other} in rad? Say so (--set {larger}_unit=..., or --factor), unless gears stand between them.",
        effect=1.0,
        signal=larger,
    )
