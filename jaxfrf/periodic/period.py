"""The period of a record, from the record itself.

For a lag L the mismatch

    D(L) = sum_t |x(t) - x(t+L)|^2 / sum_t (|x(t)|^2 + |x(t+L)|^2)

is 0 where x repeats after L samples, 1 where x(t+L) has nothing to do with x(t), and the share of the noise in the
power where a periodic signal is noisy. All lags come from one correlation by FFT.
"""

import dataclasses

import numpy as np
import scipy.fft
import scipy.ndimage
from jaxtyping import Float

from .._text import percent
from .._types import Array

_LEAST_LAG = 8  # samples; what repeats sooner has no lines to speak of
_LONGEST = 2 / 3  # of the record: the comparison needs the rest
_LARGE = 2**21  # samples x channels that are looked at; channels beyond are left out
_SURE = 6.0  # standard deviations of the correlation at other lags
_MOST = 0.85  # mismatch of a period: of what repeats so little most is something else
_EXACT = 1e-3  # mismatch of a record that repeats whatever the statistics say
_MULTIPLES = 0.6  # of the match after one period, that must be left after two, three, ... of them
_AS_GOOD = 1.35  # mismatch of the shortest period over the best one (multiples of it), beyond which it is another
_WELL = 0.1  # mismatch below which no other lag is asked
_STANDS_OUT = 2.0  # over how far any other lag is from chance: steps at random match by halves at many lags
_BESIDE, _QUARTERS = 8, 32  # parts of a period, one on either side, that belong to it (side lobes), and to a quarter of
# it, after which every fourth line is as it was but for its phase
_HELD = 0.25  # of its power by the length, that must be left in what is compared: a blow leaves nothing
_WHITE = 1e-4  # power, of the strongest band, up to which weaker bands are raised
_FLAT_BINS = 64  # a spectrum is smoothed over this part of its width


@dataclasses.dataclass(frozen=True)
class FoundPeriod:
    """`period` samples after which the signals repeat; `mismatch` D there; `sure`: its distance from chance, in
    standard deviations of the correlation at lags that are no period."""

    period: int
    mismatch: float
    sure: float

    @property
    def confidence(self) -> str:
        return "exactly" if self.mismatch < 1e-9 else f"but for {percent(self.mismatch)} of its power"


def find_period(x: Float[Array, "time channel"]) -> FoundPeriod | None:
    """The shortest lag after which x repeats as well as after any other; `None` where nothing stands out from chance.

    At least a half more than one period must be there. The mean is taken off; strong bands (a slow sine below a weak
    multisine) are levelled first, and the plain signal is looked at as well: the clearer of both counts. A transient
    or a fault in some periods raises the mismatch and does not hide the period. A period that is no whole number of
    samples is found where it comes close enough to one.
    """
    usable = _usable(x)
    if usable is None:
        return None
    spectrum = scipy.fft.rfft(usable, 2 * scipy.fft.next_fast_len(len(usable), real=True), axis=0)
    both = _clearest(_mismatch(usable, spectrum)), _clearest(_mismatch(*_levelled(spectrum, len(usable))))
    return max((f for f in both if f is not None), key=lambda f: f.sure, default=None)


def mismatch(x: Float[Array, "time channel"], lag: int) -> float:
    """D(lag) of x, its strong bands levelled; 1 where the record is too short to tell."""
    usable = _usable(np.asarray(x)[: 3 * lag])
    if usable is None or not 0 < lag <= _LONGEST * len(usable):
        return 1.0
    n = len(usable)
    flat, _ = _levelled(scipy.fft.rfft(usable, 2 * scipy.fft.next_fast_len(n, real=True), axis=0), n)
    a, b = flat[:-lag], flat[lag:]
    return float(np.sum((a - b) ** 2) / np.sum(a**2 + b**2))


def _usable(x) -> np.ndarray | None:
    """Moving channels, each of unit variance, no more of them than can be looked at quickly."""
    x = np.asarray(x, np.float64)
    if len(x) < 3 * _LEAST_LAG:
        return None
    x = x[:, : max(1, _LARGE // len(x))] if np.ptp(x[:, 0]) > 0 else x
    x = x - x.mean(axis=0)
    std = x.std(axis=0)
    moving = std > 0
    return x[:, moving] / std[moving] if moving.any() else None


def _levelled(spectrum, n: int) -> tuple[np.ndarray, np.ndarray]:
    """x with the power of its bands made equal, as far as they are no more than 40 dB below the strongest."""
    power = np.abs(spectrum) ** 2
    band = scipy.ndimage.uniform_filter1d(power, max(len(power) // _FLAT_BINS, 3), axis=0, mode="nearest")
    flat = spectrum / np.sqrt(band + _WHITE * band.max(axis=0))
    x = scipy.fft.irfft(flat, axis=0)[:n]
    x = x / x.std(axis=0)
    return x, scipy.fft.rfft(x, 2 * (len(spectrum) - 1), axis=0)


def _mismatch(x, spectrum) -> np.ndarray:
    """D at lags 0 ... up to the longest that can be compared."""
    n = len(x)
    together = scipy.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=1))[: int(_LONGEST * n) + 1]
    energy = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=1))])
    lags = np.arange(len(together))
    both = energy[n - lags] + energy[n] - energy[lags]
    D = np.maximum(1 - 2 * together / np.maximum(both, 1e-300), 0.0)
    return np.where(both < _HELD * 2 * energy[n] * (n - lags) / n, 1.0, D)


def _clearest(D: np.ndarray) -> FoundPeriod | None:
    first = int(np.argmax(D > 0.5)) if np.any(D > 0.5) else len(D)  # beyond the width of the peak at lag 0
    lags = np.arange(max(first, _LEAST_LAG), len(D) - 1)
    lags = lags[(D[lags] <= D[lags - 1]) & (D[lags] < D[lags + 1])]
    if not lags.size:
        return None
    n = 1.5 * len(D)  # samples of the record
    usual = np.median(D[max(first, _LEAST_LAG) :])
    spread = 1.4826 * np.median(np.abs(D[max(first, _LEAST_LAG) :] - usual)) + 1e-12
    sure = (usual - D[lags]) / (spread * np.sqrt(n / (n - lags)))
    clear = ((sure > _SURE) & (D[lags] < _MOST)) | (D[lags] < _EXACT)
    if not clear.any():
        return None
    best = D[lags[clear]].min()
    good = lags[clear & (D[lags] <= _AS_GOOD * best + 1e-9)]
    repeating = [p for p in good if _repeats(D, p, usual) and (D[p] < _WELL or _stands_out(lags, sure, p))]
    if not repeating:
        return None
    shortest = _refined(D, int(repeating[0]))
    return FoundPeriod(shortest, float(D[shortest]), float((usual - D[shortest]) / spread))


def _repeats(D: np.ndarray, period: int, usual: float) -> bool:
    """Whether the signal still matches after several periods, as a chirp or an oscillation that dies out does not."""
    count = min((len(D) - 3) // (period + 1), 12)
    dips = [
        D[k * period - min(k, period // 4) : k * period + min(k, period // 4) + 1].min() for k in range(2, count + 1)
    ]
    return not dips or bool(np.mean(usual - np.array(dips)) >= _MULTIPLES * (usual - D[period]))


def _stands_out(lags, sure, period: int) -> bool:
    """Whether it is farther from chance than every lag that is no multiple of it, nor beside one."""
    far = lambda step, part: np.abs((lags + step / 2) % step - step / 2) > max(2, period / part)
    others = sure[far(period, _BESIDE) & far(period / 4, _QUARTERS)]
    return bool(sure[lags == period][0] >= _STANDS_OUT * others.max(initial=0.0))


def _refined(D: np.ndarray, period: int) -> int:
    """The whole number near `period` whose multiples fit best: noise moves the first dip by a sample."""
    near = [p for p in range(period - 2, period + 3) if _LEAST_LAG <= p < len(D)]
    return min(near, key=lambda p: np.mean(D[p::p][: (len(D) - 1) // (period + 2)] if period + 2 < len(D) else D[p]))
