"""A gain that changes from period to period, the same at all lines: a sensor or amplifier, not the machine."""

from collections.abc import Iterator

import numpy as np

from .finding import Finding, Severity
from .record import Record

_LEAST = 0.003  # relative; less is within what amplifiers do
_SURE = 8.0  # standard errors
_BANDS = 4  # the change must be the same in all of them, ...
_SAME = 0.35  # ... within this part of it, and their errors
_FEWEST = 12  # lines


def gain_drift(record: Record) -> Iterator[Finding]:
    """Periods whose gain differs from the others by the same factor at all lines.

    A machine that changes (warmer friction, another load) changes more at some lines than at others; that is left to
    the scatter between periods. A reference that changes with the signal is no fault of it.
    """
    data = record.data
    if data.n_periods < 2 or len(record.lines) < _FEWEST:
        return
    changes = {}
    for name, X in record.spectra.items():
        for pos, exp, channel in np.ndindex(X.shape[0], X.shape[1], X.shape[4]):
            changes[name, pos, exp, channel] = _change(X[pos, exp, ..., channel])
    driven = {
        (p, e): [v for (n, q, f, _), v in changes.items() if n == "r" and (q, f) == (p, e) and v]
        for p, e in np.ndindex(data.n_pos, data.n_exp)
    }
    for (name, pos, exp, channel), found in changes.items():
        if found is None or name == "r" or driven[pos, exp]:
            continue
        change, sure, low, high = found
        yield Finding(
            "gain",
            Severity.WARNED,
            change,
            f"{name}: channel {channel} (position {pos}, experiment {exp}) changes its gain by {100 * change:.2g} % "
            f"between steady periods {low} and {high}, at all lines alike: a sensor, an amplifier or a supply that "
            f"drifts? The FRF is off by up to {100 * change / 2:.2g} % for it, more than its interval says. Record "
            "again when it is warm, or use few periods.",
            sure=sure,
            effect=change / 2,
            signal=name,
            channel=channel,
            pos=pos,
            exp=exp,
        )


def _change(X: np.ndarray) -> tuple[float, float, int, int] | None:
    """Relative change between the periods with the least and the greatest gain; X (period, freq)."""
    mean = X.mean(axis=0)
    power = np.abs(mean) ** 2
    if not power.any():
        return None
    gain = np.real(X @ mean.conj()) / power.sum()
    low, high = sorted((int(np.argmin(gain)), int(np.argmax(gain))))
    step = X[high] - X[low]
    change, error = _slope(step, mean)
    if abs(change) < _LEAST or abs(change) < _SURE * error:
        return None
    # In bands of equal power, not of equal width: a band without power says nothing.
    edges = np.searchsorted(np.cumsum(power), np.linspace(0, 1, _BANDS + 1)[1:-1] * power.sum())
    for part in np.split(np.arange(len(mean)), np.unique(edges)):
        if part.size < 3:
            continue
        own, own_error = _slope(step[part], mean[part])
        if abs(own - change) > _SAME * abs(change) + 3 * own_error:
            return None
    return abs(change), abs(change) / max(error, 1e-300), low, high


def _slope(step, mean) -> tuple[float, float]:
    """Real g of step = g mean, by least squares, and its standard error from what is left."""
    power = np.abs(mean) ** 2
    change = float(np.real(np.vdot(mean, step)) / power.sum())
    rest = np.real((step - change * mean) * mean.conj())
    return change, float(np.sqrt(np.sum(rest**2)) / power.sum() * np.sqrt(len(mean) / max(len(mean) - 1, 1)))
