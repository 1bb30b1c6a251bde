"""Samples lost or doubled, stretches disturbed: successive periods beside each other, piece by piece.

x(t + N) - x(t) is noise where nothing happened. After a sample is lost at s it is the difference of the signal from
itself one sample later, for one period (s - N <= t < s), and noise again: both periods are shifted then.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.fft
import scipy.ndimage

from .._text import number, percent
from .finding import Finding, Severity
from .levels import _leave_out
from .record import Channel, of_channels

_BLOCKS = 32  # of a period, at least ...
_BLOCK = 16  # ... samples each
_SHIFT = 0.35  # samples, linearised, from which a shift is looked for
_SHARE = 0.3  # of the difference in a block, that the shift explains then
_TOO_DIFFERENT = 0.3  # energy of the difference over that of the signal, from which a shift is looked for
_EXPLAINED = 0.4  # of the difference, that is left after the shift
_LIKE_NOISE = 4.0  # energy that is left over what it is where nothing happened
_SURE = 8.0  # the same in standard deviations of chance
_END_BLOCKS = 3  # of either end, where a stretch may be too short for what is above; there ...
_END_LAGS = 64  # ... up to so many samples are looked for, ...
_END_SHORTEST = 8  # ... and so many must differ, ...
_END_SURE = 40.0  # ... by this many times more energy than one sample of the usual: e^20 against 2e4 lags and places
_SMOOTHED = 21  # lines over which the spectrum of the difference is averaged
_END_USUAL = 0.9  # of the blocks have less energy than the usual one
_END_EXPLAINED = 0.25  # of the difference may be left
_BEGIN = 0.25  # of the first period, in which a machine may not be steady yet
_DISTURBED = 30.0  # energy of a block over that of the quieter half ...
_DISTURBED_FEW = 300.0  # ... with two or three periods, which do not show what is usual at each place
_DISTURBED_SHARE = 0.5  # of all difference, in ...
_DISTURBED_PART = 0.2  # ... this part of the record
_SPIKE = 15.0  # standard deviations of the noise between neighbours
_SPIKES = 0.02  # of the samples: more of them are noise of another kind
_SAME_PLACE = 10  # samples of the period
_SPIKE_LEAST = 0.25  # of the rms; converters err by less now and then, more where the signal is strong
_MOST_SPIKES = 2000
_SPIKE_SHARE = 0.2  # of all power of the differences, that the spikes hold
_FLOOR = 1e-4  # of the rms: differences below it do not matter


@of_channels("uyr")
def lost(c: Channel) -> Iterator[Finding]:
    """Samples that are missing or doubled somewhere in two periods or more."""
    if c.n_periods > 1 and (found := _shift(c) or _at_ends(c)) is not None:
        lag, at, effect = found
        what = f"has lost {_samples(lag)}" if lag > 0 else f"holds {_samples(-lag)} too many"
        leave = _leave_out(c, at, at + 1)
        begins = c.first == 0 and at < _BEGIN * c.period
        unsteady = " Or the machine was not steady there yet: --set transient_periods=1." if begins else ""
        yield c.finding(
            "lost",
            Severity.WARNED,
            effect,
            f"{what} at about sample {at}: from there on it comes {abs(lag)} "
            f"{'early' if lag > 0 else 'late'} against the periods before. The FRF may be off by "
            f"{percent(effect)}. Keep the part before or after it ({leave}).{unsteady}",
            effect=effect,
            samples=(at, at + 1),
        )


@of_channels("uyr")
def disturbed(c: Channel) -> Iterator[Finding]:
    """A short stretch that differs between periods by far more than anything else does: a spike, a blow, a gap."""
    if c.n_periods < 2:
        return
    energy, width = _blocks(np.diff(c.steady, axis=0) ** 2, c.period)
    flat = energy.ravel()
    rms = c.steady.std()
    usual = np.mean(np.sort(flat)[: max(len(flat) // 2, 1)]) + (_FLOOR * rms) ** 2 * width
    if c.n_periods > 3:  # what every period does at this place (a motor that changes its direction) is usual
        usual = np.maximum(usual, np.median(energy, axis=0)[None, :])
    high = (energy > (_DISTURBED if c.n_periods > 3 else _DISTURBED_FEW) * usual).ravel()
    if not high.any() or high.mean() > _DISTURBED_PART or flat[high].sum() < _DISTURBED_SHARE * flat.sum():
        return
    a, b = _longest(high, flat)
    # An event in period p shows in its differences from both neighbours; the later one names it in any but the
    # first pair.
    size = float(np.sqrt(flat[a:b].sum() / 2 / ((b - a) * width)) / rms)
    first = c.first + a * width
    more = f" (or {first + c.period})" if c.n_periods == 2 else ""
    first = _place(c, a, b, width, flat)
    effect = float(np.sqrt(flat[a:b].sum() / 2 / len(c.steady.ravel())) / rms)
    yield c.finding(
        "disturbed",
        Severity.WARNED,
        size,
        f"differs at samples {first} to {first + (b - a) * width - 1}{more} by {number(size, 2)} of its rms from "
        f"the same place of the other periods, {number(np.sqrt(flat[a:b].max() / np.median(usual)), 2)} times as "
        f"much as elsewhere: a spike, a blow, or samples replaced? The FRF may be off by about {percent(effect)}. "
        f"Leave that period out ({_leave_out(c, first, first + (b - a) * width)}), or weigh the periods "
        "(--robust).",
        effect=effect,
        samples=(first, first + (b - a) * width),
    )


@of_channels("uyr")
def spikes(c: Channel) -> Iterator[Finding]:
    """Single samples that stand out from the difference of successive periods, against their own neighbours."""
    if c.n_periods < 2:
        return
    bend = np.abs(np.diff(np.diff(c.x[c.first + c.period :] - c.x[c.first : -c.period]), n=1))
    usual = 1.4826 * np.median(bend) + _FLOOR * c.std
    at = np.flatnonzero(bend > _SPIKE * usual) + 1
    if at.size > _MOST_SPIKES:
        return
    if c.n_periods > 3:
        at = at[~_again_and_again(at % c.period, c.period)]
    count = int(np.count_nonzero(np.diff(at, prepend=-10) > 3))
    power = np.sum(bend[at - 1] ** 2) / max(np.sum(bend**2), 1e-300)
    if not count or count > max(_SPIKES * len(bend), 4) or power < _SPIKE_SHARE:
        return
    where = c.first + int(at[0])
    effect = float(np.sqrt(np.sum(bend[at - 1] ** 2) / 6 / np.sum(c.steady**2)))
    if bend.max() / 2 < _SPIKE_LEAST * c.steady.std():
        return
    yield c.finding(
        "spikes",
        Severity.WARNED,
        effect,
        f"holds single samples that stand out in {count} places, the first at sample {where} or "
        f"{where + c.period}: up to {number(bend.max() / usual, 2)} times the noise between neighbours. The FRF "
        f"may be off by {percent(effect)}. Mend or leave out these periods, or weigh them (--robust).",
        effect=effect,
        samples=(where, where + 1),
    )


def _again_and_again(phase: np.ndarray, period: int) -> np.ndarray:
    """Places of the period where more than two periods differ from the next: what the machine does there, no accident.

    One accident shows in two differences, at up to three samples of each.
    """
    apart = np.abs(phase[:, None] - phase[None, :])
    near = np.minimum(apart, period - apart) <= _SAME_PLACE
    return near.sum(axis=1) > 6


def _place(c: Channel, a: int, b: int, width: int, flat) -> int:
    """The first sample of the event: in the period which differs from more of the others."""
    per = len(flat) // (c.n_periods - 1)
    p, block = divmod(a, per)
    rows = slice(block * width, min((block + (b - a)) * width, c.period))
    others = np.median(c.steady[:, rows], axis=0)
    worst = int(np.argmax(np.sum((c.steady[:, rows] - others) ** 2, axis=1))) if c.n_periods > 2 else p
    return c.first + worst * c.period + block * width


def _samples(n: int) -> str:
    return "1 sample" if n == 1 else f"{n} samples"


def _blocks(x: np.ndarray, period: int) -> tuple[np.ndarray, int]:
    """Sums of x (pair, time) over blocks, (pair, block), and their width."""
    width = max(_BLOCK, period // _BLOCKS)
    n = max(period // width, 1)
    width = min(width, period)
    return x[:, : n * width].reshape(len(x), n, width).sum(axis=2), width


def _longest(high: np.ndarray, energy: np.ndarray) -> tuple[int, int]:
    """The run of flagged blocks with the most energy, single gaps bridged."""
    label, n = scipy.ndimage.label(scipy.ndimage.binary_closing(np.pad(high, 1), iterations=1)[1:-1] | high)
    best = 1 + int(np.argmax(scipy.ndimage.sum_labels(energy, label, np.arange(1, n + 1))))
    at = np.flatnonzero(label == best)
    return int(at[0]), int(at[-1]) + 1


@dataclasses.dataclass(frozen=True)
class _Shift:
    lag: int
    start: int  # of the stretch where x(t + N) - x(t) is that of a shift
    stop: int
    left: float  # of the difference, after the shift


def _shift(c: Channel) -> tuple[int, int, float] | None:
    """Samples lost (negative: doubled), where, and what it does to the FRF; `None` where nothing is."""
    x = c.x[c.first :]
    n = c.period
    a, b = x[:-n], x[n:]
    difference = b - a
    slope = np.gradient(a) / 2 + np.gradient(b) / 2
    shape = (c.n_periods - 1, n)
    d2, width = _blocks(np.reshape(difference**2, shape), n)
    ds, _ = _blocks(np.reshape(difference * slope, shape), n)
    s2, _ = _blocks(np.reshape(slope**2, shape), n)
    mean = x.mean()
    x2, _ = _blocks(np.reshape((a - mean) ** 2, shape), n)
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(s2 > 0, ds / s2, 0.0)
        explained = np.where(d2 > 0, ds**2 / (s2 * d2), 0.0)
    floor = (_FLOOR * x.std()) ** 2 * width
    near = (np.abs(shift) > _SHIFT) & (explained > _SHARE) & (d2 > floor)
    high = near | ((d2 > _TOO_DIFFERENT * x2) & (d2 > 0.05 * np.mean(x2)))
    if high.sum() < 2:
        return None
    calm = d2[~high]
    usual = np.median(calm) / width if calm.size > 4 else np.inf
    found = _best_lag(a, b, high.ravel(), width, n, d2.ravel(), usual + floor / width)
    if found is None:
        return None
    # Lost at the end of the stretch, unless that is the end of the record: then one period after its beginning.
    at = found.stop if found.stop < len(a) - 2 * width else found.start + n
    share = min(found.stop - found.start, n) / len(x)
    effect = float(np.sqrt(np.mean((difference[found.start : found.stop]) ** 2)) / x.std() * np.sqrt(share))
    return found.lag, c.first + at, effect


def _at_ends(c: Channel) -> tuple[int, int, float] | None:
    """The same near the end of the record, or its beginning, where less than two blocks are shifted."""
    x, n = c.x[c.first :], c.period
    difference = np.diff(c.steady, axis=0)
    energy, width = _blocks(difference**2, n)
    usual = np.quantile(energy, _END_USUAL) / width + (_FLOOR * x.std()) ** 2
    sure = _END_SURE * usual * _alike(difference)
    for late, y in ((True, x), (False, x[::-1])):
        found = _at_end(y, n, min(_END_BLOCKS * width, n // 2), usual, sure)
        if found is not None:
            lag, length, energy_there = found
            effect = float(np.sqrt(energy_there / len(x)) / x.std())
            return lag, c.first + (len(x) - length if late else length), effect
    return None


def _alike(difference: np.ndarray) -> float:
    """How many neighbouring samples of a difference, (period, time), count as one: 1 of white noise, more in a loop
    that resonates. The sum of its squared correlations, from its spectrum (Bendat & Piersol, Random Data, 2010)."""
    power = np.mean(np.abs(scipy.fft.rfft(difference, axis=1)) ** 2, axis=0)
    power = scipy.ndimage.uniform_filter1d(power, min(_SMOOTHED, len(power)))  # a line alone scatters by itself
    return float(np.mean(power**2) / max(np.mean(power) ** 2, np.finfo(float).tiny))


def _at_end(x: np.ndarray, n: int, length: int, usual: float, sure: float) -> tuple[int, int, float] | None:
    """Samples lost so many samples before the end of x, by the period before; and the energy of the difference. `usual`
    energy of a sample, and how much more is sure to be none of chance."""
    last = x[-length:]
    reach = min(_END_LAGS, length // 2)
    from_end = len(x) - n - length
    if from_end < reach:
        return None
    lags = np.array([k for k in range(-reach, reach + 1) if k])
    before = (last - x[from_end : from_end + length]) ** 2
    shifted = np.lib.stride_tricks.sliding_window_view(x[from_end - reach : from_end + length + reach], length)
    after = (last - shifted[lags + reach]) ** 2
    tails = lambda e: np.cumsum(e[..., ::-1], axis=-1)  # over the last 1, 2, ... samples
    more, less = tails(before), tails(after)
    long = np.arange(1, length + 1)
    gain = np.where(
        (less <= _END_EXPLAINED * more) & (less <= _LIKE_NOISE * usual * long) & (long >= _END_SHORTEST),
        more - less,
        0.0,
    )
    k, at = np.unravel_index(np.argmax(gain), gain.shape)
    if gain[k, at] <= sure:
        return None
    return int(lags[k]), int(at) + 1, float(more[at])


def _best_lag(a, b, high, width: int, n: int, energy, usual: float) -> _Shift | None:
    """The shift that explains the difference in the flagged stretch best."""
    label, count = scipy.ndimage.label(scipy.ndimage.binary_closing(np.pad(high, 2), iterations=2)[2:-2] | high)
    sums = scipy.ndimage.sum_labels(energy, label, np.arange(1, count + 1))
    at = np.flatnonzero(label == 1 + int(np.argmax(sums)))
    start, stop = int(at[0]) * width, min((int(at[-1]) + 1) * width, len(a))
    if stop - start < 2 * _BLOCK:
        return None
    reach = min((stop - start) // 2, n // 2)
    lag = _lag(a, b, start, stop, reach)
    if lag == 0:
        return None
    start, stop = _stretch(a, b, lag)
    if stop - start < 2 * _BLOCK:
        return None
    before = np.sum((b[start:stop] - a[start:stop]) ** 2)
    first, last = max(start, -lag), min(stop, len(a) - lag)
    rest = b[first:last] - a[first + lag : last + lag]
    after = np.sum(rest**2)
    before = np.sum((b[first:last] - a[first:last]) ** 2)
    # What white noise would let the best of many lags gain: less than its standard deviation times _SURE.
    if (
        last - first < 2 * _BLOCK
        or after > _EXPLAINED * before
        or before - after < _SURE * after / np.sqrt(last - first)
    ):
        return None
    if after > max(_LIKE_NOISE * usual * (last - first), 0.02 * before):
        return None
    return _Shift(lag, start, stop, float(after / before))


def _lag(a, b, start: int, stop: int, reach: int) -> int:
    """The lag L with the least sum of |b(t) - a(t + L)|^2 over a stretch, |L| up to `reach`."""
    start, stop = max(start, reach // 2), min(stop, len(a) - reach // 2)  # at both ends of a, lags of both signs
    low, high = max(start - reach, 0), min(stop + reach, len(a))
    piece, around = b[start:stop], a[low:high]
    mean = around.mean()
    piece, around = piece - mean, around - mean
    size = scipy.fft.next_fast_len(len(around) + len(piece), real=True)
    product = scipy.fft.irfft(scipy.fft.rfft(around, size) * np.conj(scipy.fft.rfft(piece, size)), size)
    count = len(around) - len(piece) + 1
    energy = np.concatenate([[0.0], np.cumsum(around**2)])
    error = energy[len(piece) :][:count] - energy[:count] - 2 * product[:count]
    return int(np.argmin(error)) + low - start


def _stretch(a, b, lag: int) -> tuple[int, int]:
    """Where the shift explains more than it spoils: the stretch with the largest sum of the gain."""
    t = np.arange(max(0, -lag), min(len(a), len(a) - lag))
    gain = (b[t] - a[t]) ** 2 - (b[t] - a[t + lag]) ** 2
    total = np.cumsum(gain)
    lowest = np.minimum.accumulate(np.concatenate([[0.0], total[:-1]]))
    stop = int(np.argmax(total - lowest))
    start = int(np.argmin(np.concatenate([[0.0], total[:stop]]))) if stop else 0
    return int(t[start]), int(t[stop]) + 1
