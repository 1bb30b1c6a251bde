"""Steady periods beside each other: a first one that is not steady, one that is odd, drifting means, noise."""

from collections.abc import Iterator

import numpy as np

from .._text import number
from .finding import Finding, Severity
from .record import Channel, Record, of_channels

# A drift by d over one period leaks d/(2 pi k) into line k. Over the record, 5 % of the rms is where a
# drifting offset (temperature, slipping) starts to be seen beside the excitation.
_DRIFT = 0.05
_DRIFT_FEW = 0.02  # the same of two or three periods, where an offset that moves steadily is plain to see
_DRIFT_SIGNIFICANT = 5.0  # standard errors
_DRIFT_STEP = 10.0  # the same from the difference of two periods, in standard errors of its mean over blocks
_BLOCKS = 16

# A period is odd if it deviates from the mean of the others more than the noise lets the median period do.
# Measured periods scatter by up to a factor of 4 (friction, disturbances). A reference should repeat exactly.
_ODD_RATIO = 5.0
_ODD_MEASURED = 0.01
_ODD_REFERENCE = 0.001

# Below 10 dB the mean spectrum itself is wrong by a third, and the logarithm of an FRF is biased.
_LOW_SNR_DB = 10.0
_NO_SNR = 0.1  # less cannot be told from nothing by the scatter of some periods


@of_channels("uyr")
def odd_period(c: Channel) -> Iterator[Finding]:
    """Of three periods or more, one that differs from the others; the first one: not steady yet."""
    if c.n_periods > 2:
        yield from _odd_period(c)


def _odd_period(c: Channel) -> Iterator[Finding]:
    x, n = c.steady, c.n_periods
    rms = x.mean(axis=0).std()
    if rms == 0:
        return
    # Against the mean of the other periods: x_p - (n m - x_p)/(n - 1) = (x_p - m) n/(n - 1). Offsets are drift.
    deviation = (x - x.mean(axis=0)) * (n / (n - 1))
    size = deviation.std(axis=1) / rms
    worst = int(np.argmax(size))
    least = _ODD_REFERENCE if c.signal == "r" else _ODD_MEASURED
    # With one bad period among n all others deviate by 1/(n - 1) of it, which few periods cannot be blamed for.
    usual = min(_ODD_RATIO, 0.75 * (n - 1)) * np.median(size)
    if size[worst] <= max(least, usual):
        return
    sample = int(np.argmax(np.abs(deviation[worst])))
    first = c.first + worst * c.period
    more = {"samples": (first, first + c.period), "effect": float(size[worst] / n)}
    if worst == 0:
        yield c.finding(
            "unsteady",
            Severity.WARNED,
            size[worst],
            f"is not steady in its first used period ({number(size[worst], 2)} of the rms away from the "
            f"others): drop it, --set transient_periods={c.first // c.period + 1}.",
            **more,
        )
    else:
        yield c.finding(
            "odd period",
            Severity.WARNED,
            size[worst],
            f"differs in {_called(worst, n)} (samples {first} to {first + c.period - 1}) by "
            f"{number(size[worst], 2)} of the rms from the others, most at sample {first + sample}: samples lost or "
            f"repeated, or a disturbance? Leave it out (--periods {_without(worst, n)}), or weigh the "
            "periods (--robust).",
            **more,
        )


def _without(period: int, n: int) -> str:
    return f"0:{period}" if period >= n - 1 - period else f"{period + 1}:{n}"


def _called(period: int, n: int) -> str:
    return "its last period" if period == n - 1 else f"steady period {period} of 0 to {n - 1}"


@of_channels("uy")
def drift(c: Channel) -> Iterator[Finding]:
    """Means that move from period to period, or within two of them."""
    if c.n_periods > 1:
        yield from _drift_over_periods(c) if c.n_periods > 3 else _drift_of_few(c)


def _drift_over_periods(c: Channel) -> Iterator[Finding]:
    means, rms, n = c.steady.mean(axis=1), c.steady.mean(axis=0).std(), c.n_periods
    k = np.arange(n) - (n - 1) / 2
    slope = k @ means / (k @ k)
    error = np.sqrt(np.sum((means - means.mean() - slope * k) ** 2) / max(n - 2, 1) / (k @ k))
    size = abs(slope) * (n - 1) / max(rms, 1e-300)
    if size > _DRIFT and abs(slope) > _DRIFT_SIGNIFICANT * error:
        yield _drifts(c, slope * (n - 1), size, abs(slope) / max(error, 1e-300))


def _drift_of_few(c: Channel) -> Iterator[Finding]:
    """Of two or three periods the scatter of means says nothing; that of the difference within a period does."""
    rms = c.steady.mean(axis=0).std()
    step = np.diff(c.steady, axis=0)
    width = c.period // _BLOCKS
    blocks = step[:, : width * _BLOCKS].reshape(len(step), _BLOCKS, width).mean(axis=2)
    mean = blocks.mean(axis=1)
    error = np.sqrt(blocks.var(axis=1, ddof=1).mean() / _BLOCKS)
    total = float(mean.sum())
    size = abs(total) / max(rms, 1e-300)
    same_way = bool(np.all(np.sign(mean) == np.sign(mean[0])))
    if size > _DRIFT_FEW and same_way and np.abs(mean).min() > _DRIFT_STEP * error:
        yield _drifts(c, total, size, float(np.abs(mean).min() / max(error, 1e-300)))
        return
    # A step somewhere: blocks of the difference on two levels, and little between neighbours.
    levels = np.concatenate(blocks)
    usual = np.median(np.abs(np.diff(levels))) + 1e-9 * rms
    by = np.ptp(levels)
    at = int(np.argmax(np.abs(np.diff(levels))))
    two = abs(np.median(levels[: at + 1]) - np.median(levels[at + 1 :]))
    if by > _DRIFT * rms and two > 0.7 * by and two > 2 * _DRIFT_STEP * usual:
        yield _drifts(c, two, two / max(rms, 1e-300), float(two / usual))


def _drifts(c: Channel, by: float, size: float, sure: float) -> Finding:
    return c.finding(
        "drift",
        Severity.WARNED,
        size,
        f"drifts: its mean moves by {number(by)}, {number(size, 2)} of the rms, over {c.n_periods} "
        "periods. Leakage of it disturbs the lowest lines: take a method with a transient term, or leave these out.",
        sure=sure,
    )


def noise(record: Record) -> Iterator[Finding]:
    """Signal-to-noise ratio of the mean spectra at a position, median over the excited lines."""
    data = record.data
    if data.n_periods < 2 or not record.lines.size:
        return
    for name in ("y", "u"):
        X = record.spectra[name]
        power = np.sum(np.abs(X.mean(axis=2)) ** 2, axis=1)  # (pos, freq, channel)
        scatter = np.sum(X.var(axis=2, ddof=1), axis=1) / data.n_periods
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(power > 0, power / scatter, np.nan)
        # The power holds the noise once more.
        snr = 10 * np.log10(np.maximum(np.median(ratio, axis=1) - 1, _NO_SNR))
        for pos, channel in zip(*np.nonzero(snr < _LOW_SNR_DB), strict=True):
            value = float(snr[pos, channel])
            told = f"{value:.1f}" if value > 10 * np.log10(_NO_SNR) else "-10 or less"
            yield Finding(
                "noise",
                Severity.WARNED,
                -value,
                f"{name}: channel {channel} (position {pos}) has a median signal-to-noise ratio of only "
                f"{told} dB at the excited lines. Excite more strongly, or average more periods.",
                signal=name,
                channel=int(channel),
                pos=int(pos),
            )
