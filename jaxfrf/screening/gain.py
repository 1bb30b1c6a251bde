"""A gain that changes from period to period, the same at all lines: a sensor or amplifier, not the machine."""

from collections.abc import Iterator

import numpy as np

from .._text import percent
from .finding import Finding, Severity
from .record import Record

_LEAST = 0.003  # relative; less is within what amplifiers do
_SURE = 6.0  # standard errors
_BANDS = 4  # the change must be the same in all of them, ...
_SAME = 0.35  # ... within this part of it, and their errors
_FEWEST = 12  # lines


def gain_drift(record: Record) -> Iterator[Finding]:
    """Periods whose gain differs from the others by the same factor at all lines.

    A trend, or the periods with the least and the greatest gain; in single experiments, or in the mean of all. A
    machine that changes (warmer friction, another load) changes more at some lines than at others; that is left to the
    scatter between periods. Nothing is said where the reference changes with the signal.
    """
    data = record.data
    if data.n_periods < 2 or len(record.lines) < _FEWEST:
        return
    driven = set()
    for name in ("r", "u", "y"):
        X = record.spectra.get(name)
        if X is None:
            continue
        for pos, channel in np.ndindex(X.shape[0], X.shape[4]):
            each = {exp: _change([X[pos, exp, ..., channel]]) for exp in range(data.n_exp)}
            found: dict[int | None, tuple] = {exp: x for exp, x in each.items() if x is not None}
            if data.n_exp > 1 and (joint := _change(list(X[pos, ..., channel]))) is not None and not found:
                found = {None: joint}
            if name == "r":
                driven |= {(pos, exp) for exp in found}
                continue
            for exp, (change, sure, low, high) in found.items():
                if (pos, exp) not in driven:
                    yield _changes(name, pos, exp, channel, change, sure, low, high)


def _changes(name, pos, exp, channel, change: float, sure: float, low: int, high: int) -> Finding:
    where = f"position {pos}, " + ("all experiments" if exp is None else f"experiment {exp}")
    return Finding(
        "gain",
        Severity.WARNED,
        change,
        f"{name}: channel {channel} ({where}) changes its gain by {percent(change)} between steady periods {low} "
        f"and {high}, at all lines alike: a sensor, an amplifier or a supply that drifts? The FRF is off by up to "
        f"{percent(change / 2)} for it, more than its interval says. Record again when it is warm, or use fewer.",
        sure=sure,
        effect=change / 2,
        signal=name,
        channel=channel,
        pos=pos,
        exp=exp,
    )


def _change(X: list[np.ndarray]) -> tuple[float, float, int, int] | None:
    """Relative change of gain over the periods of one or several experiments, each (period, freq)."""
    mean = np.concatenate([x.mean(axis=0) for x in X])
    power = np.abs(mean) ** 2
    if not power.any():
        return None
    together = np.concatenate(X, axis=1)
    n = len(together)
    gain = np.real(together @ mean.conj()) / power.sum()
    low, high = sorted((int(np.argmin(gain)), int(np.argmax(gain))))
    k = np.arange(n) - (n - 1) / 2
    trend = np.tensordot(k / (k @ k) * (n - 1), together, axes=1)
    for step, a, b in ((together[high] - together[low], low, high), (trend, 0, n - 1)):
        found = _same_everywhere(step, mean, power)
        if found is not None:
            return *found, a, b
    return None


def _same_everywhere(step, mean, power) -> tuple[float, float] | None:
    """How far `step` is the mean times one real factor, and how sure that is."""
    change, error = _slope(step, mean)
    if abs(change) < _LEAST or abs(change) < _SURE * error:
        return None
    # In bands of equal power, not of equal width: a band without power says nothing.
    edges = np.searchsorted(np.cumsum(power), np.linspace(0, 1, _BANDS + 1)[1:-1] * power.sum())
    for part in np.split(np.arange(len(mean)), np.unique(edges)):
        own, own_error = _slope(step[part], mean[part]) if part.size > 2 else (change, 0.0)
        if abs(own - change) > _SAME * abs(change) + 3 * own_error:
            return None
    return abs(change), abs(change) / max(error, 1e-300)


def _slope(step, mean) -> tuple[float, float]:
    """Real g of step = g mean, by least squares, and its standard error from what is left."""
    power = np.abs(mean) ** 2
    change = float(np.real(np.vdot(mean, step)) / power.sum())
    rest = np.real((step - change * mean) * mean.conj())
    return change, float(np.sqrt(np.sum(rest**2)) / power.sum() * np.sqrt(len(mean) / max(len(mean) - 1, 1)))
