"""Spectra of records without a period: taken whole, or in windowed segments."""

import dataclasses

import numpy as np
import scipy  # its modules load when they are used: scipy.signal alone takes a second

from .._arguments import as_band, expect, expect_real, expect_whole
from .._errors import input_error
from .._text import number, percent
from ..experiment import Experiment, rebuilt
from .lines import strength, where
from .rest import at_rest, is_short, left_at_end
from .spectra import Spectra
from .steady import at_lines, said_of

_STRONG, _STRONG_IN_BAND = 1e-4, 1e-24  # power, of the strongest line's, from which a line of a whole record counts
_ENDS = 0.02  # of a record, both ends together, that a taper lets in and out
_AT_ENDS = 0.01  # power left by the taper, over that of the whole record, below which a line holds ends alone
_BESIDE = 20  # lines on either side, over which that is looked at


def record_spectra(data: Experiment, band: tuple[float | None, float | None] | None = None) -> Spectra:
    """Spectra of the whole record, for data that are not periodic: all DFT lines of the record in `band` (Hz).

    Leakage makes Y = G U + T with a transient T that is smooth in frequency: only estimators with a transient term
    take such spectra (`leaks`). Where every run begins and ends at rest, as around a blow of a hammer, there is no T.
    Where the response to an excitation as short as that is cut off there is, but it could not be told from G U: it
    counts as none then, and a warning says so.

    Lines that hold less than 1e-4 of the strongest reference power (input power where there is no reference) are left
    out: in closed loop the response there would be that of the controller. So are lines whose power a taper of 1 % at
    each end takes away, as beyond the last frequency of a sweep: what is left there is how the record begins and ends,
    as smooth as T and not to be told from it. With `band` all lines in it are taken but those that hold rounding only
    (1e-24).

    **Arguments:** `data`: of any kind; its period and transient periods are not used. `band`: lowest and highest
    frequency, Hz, both included, `None` at an end: open; the whole range by default.

    **Returns:** `Spectra` at multiples of fs/n_time Hz, with `periodic` false and without noise covariance.

    **Raises:** `jaxfrf.InputError` if `data` is no experiment, or the band holds no excited line.

    **Source:** the transient is that of Pintelon, Schoukens, Vandersteen & Barbé, Mech. Syst. Signal Process. 24 (2010)
    573-595; the choice of lines, and what counts as at rest, is this project's own.
    """
    expect("data", data, Experiment)
    n = data.n_time
    k = np.arange(1, (n - 1) // 2 + 1)
    whole = rebuilt(data, period=n, lines=None, transient_periods=0)
    power = strength(whole, k)
    strong = power >= (_STRONG if band is None else _STRONG_IN_BAND) * power.max()
    if band is None:
        k = k[strong & ~_ends_alone(whole, k)]
    else:
        f, (low, high) = k * data.fs / n, as_band(band, data.fs / 2)
        k = k[(f >= low) & (f <= high) & strong]
        if k.size == 0:
            raise input_error(
                "band",
                f"{low:g} to {high:g} Hz",
                f"a band that holds excited lines between {number(data.fs / n, 4)} and {data.fs / 2:g} Hz",
                "Widen the band.",
            )
    spectra = at_lines(whole, k)
    rest = at_rest(data)
    short = not rest and is_short(data, spectra.U if spectra.R is None else spectra.R)
    warnings = (_what_it_can_give(data, spectra, rest or short), *([_cut_off(data)] if short else []))
    return dataclasses.replace(
        spectra, periodic=False, at_rest=rest or short, noise=None, warnings=(*spectra.warnings, *warnings)
    )


def _ends_alone(whole: Experiment, k) -> np.ndarray:
    """Lines where every channel of the reference (or input) holds what its ends leak, and nothing else: (freq,)."""
    x = whole.u if whole.r is None else whole.r
    x = x - x.mean(axis=2, keepdims=True)
    taper = scipy.signal.windows.tukey(whole.n_time, _ENDS)[:, None]
    plain, tapered = (
        _near(np.sum(np.abs(scipy.fft.rfft(s, axis=2)[:, :, k]) ** 2, axis=(0, 1))) for s in (x, x * taper)
    )
    left = tapered / np.maximum(plain, 1e-300)
    usual = tapered.sum(axis=0) / np.maximum(plain.sum(axis=0), 1e-300)  # an impact at the start is all at an end
    return np.all(left < _AT_ENDS * usual, axis=-1)


def _near(power) -> np.ndarray:
    return scipy.ndimage.uniform_filter1d(power, 2 * _BESIDE + 1, axis=0, mode="nearest")


def segment_spectra(
    data: Experiment, segment: int | None = None, *, overlap: float = 0.5, window: str = "hann"
) -> Spectra:
    """Spectra of windowed segments of a record, as experiments beside each other: what Welch's method averages.

    As in `scipy.signal.welch` the mean of every segment is taken off, and what is left at the end is not used. With
    them `jaxfrf.coherence(spectra)` is `scipy.signal.coherence`, and `jaxfrf.estimate(spectra, jaxfrf.Welch())` is
    csd(u, y)/welch(u). Leakage from line to line is as the window makes it.

    **Arguments:** `data`: of any kind, (pos, exp, time, channel). `segment`: samples; `None`: as long as eight with
    half an overlap can be. `overlap`: share of a segment. `window`: as `scipy.signal.get_window` names it.

    **Returns:** `Spectra` at multiples of fs/`segment` Hz, of all segments, in the units of `data` (the DFT over
    the sum of the window), with `periodic` false and without noise covariance.

    **Raises:** `jaxfrf.InputError` if the record is shorter than a segment, and for an overlap or window that is none.

    **Source:** Welch, IEEE Trans. Audio and Electroacoustics 15 (1967) 70-73.
    """
    expect("data", data, Experiment)
    n = data.n_time
    if segment is not None:
        expect_whole("segment", segment, 1)
    expect_real("overlap", overlap)
    if not 0 <= overlap < 1:
        raise input_error("overlap", f"{overlap}", "a share of a segment, from 0 to below 1", "0.5 is usual.")
    length = max(2 * n // 9, 8) if segment is None else int(segment)
    if not 8 <= length <= n:
        raise input_error("segment", f"{length} samples of a record of {n}", f"from 8 to {n} samples", "Shorten it.")
    hop = max(length - int(length * overlap), 1)
    taper = _window(window, length)
    k = np.arange(1, (length - 1) // 2 + 1)

    def cut(x):
        if x is None:
            return None
        starts = range(0, n - length + 1, hop)
        pieces = np.stack([x[:, :, s : s + length] for s in starts], axis=2)
        pieces = (pieces - pieces.mean(axis=3, keepdims=True)) * taper[:, None]
        found = scipy.fft.rfft(pieces, axis=3, workers=-1)[:, :, :, k] / taper.sum()
        return found.reshape(found.shape[0], -1, *found.shape[3:])

    return Spectra(
        U=cut(data.u),
        Y=cut(data.y),
        R=cut(data.r),
        lines=k,
        frequency=k * data.fs / length,
        noise=None,
        period=length,
        periodic=False,
        segments=(n - length) // hop + 1,
        **said_of(data),
    )


def _window(name, length: int) -> np.ndarray:
    try:
        return scipy.signal.get_window(name, length)
    except (ValueError, TypeError) as error:
        found = f"{name!r} ({error})"
        raise input_error("window", found, "a window of scipy.signal.get_window", "E.g. hann.") from None


def _cut_off(data: Experiment) -> str:
    return (
        f"{where(data, 'y')}: does not begin and end at rest; {percent(left_at_end(data))} of its rms value are left "
        "at the end. Beside an excitation as short as this one, what that leaks cannot be told from the response: the "
        "FRF ripples, and resonances come out too broad. Record some time before it, and until the response has died "
        "out, or multiply u and y by a window that falls to nothing."
    )


def _what_it_can_give(data: Experiment, spectra: Spectra, rest: bool) -> str:
    """One sentence on where the excitation of an aperiodic record has its power."""
    name, X = ("u", spectra.U) if spectra.R is None else ("r", spectra.R)
    power = np.sum(np.abs(X) ** 2, axis=(0, 1))
    share = np.cumsum(power, axis=0) / np.sum(power, axis=0)
    limit = [number(f) for f in np.unique(spectra.frequency[np.argmax(share >= 0.99, axis=0)])]
    below = f"{limit[0]} Hz" if len(limit) == 1 else f"{limit[0]} to {limit[-1]} Hz (by channel)"
    return (
        f"{where(data, name)}: not periodic, taken whole with{'out' if rest else ''} a transient term; 99 % of the "
        f"power between {number(spectra.frequency[0])} and {number(spectra.frequency[-1])} Hz lies below {below}. "
        "Above that, and between lines that carry little, look at the standard deviation before the FRF; no noise "
        "level can be told apart from distortion."
    )
