"""From records to spectra: steady periods, Fourier coefficients at the excited lines, noise between periods."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import numpy as np
import scipy  # its modules load when they are used: scipy.signal alone takes a second
from jaxtyping import Complex, Float, Int
from scipy.ndimage import uniform_filter1d

from ._arguments import expect
from ._errors import input_error
from ._types import Array
from .experiment import QUANTITIES, Experiment, Source, how_to_set, seen_period
from .periodic import FoundLines, find_lines
from .units import differentiated

_SILENT = 1e-14  # power, relative to the median line, below which a line carries nothing (rounding)
_STRONG, _STRONG_IN_BAND = 1e-4, 1e-24  # power, of the strongest line's, from which a line of a whole record counts
_ROUNDS = 4  # of weighing periods
_WEIGHT_LINES = 9  # that share a weight
_CUT = 2.0  # times the usual distance of a period from the others, beyond it, where it no longer counts
_SILENT_SHARE = 1e-24  # the same relative to the whole signal, for when the median line is rounding itself


class Spectra(eqx.Module):
    """Fourier coefficients X(k) = 1/N sum_t x(t) exp(-2 pi j k t / N) of the mean steady period.

    **Fields:**

    - `U`, `Y`, `R`: input, output, reference, (pos, exp, freq, channel); `R` is `None` where it was not recorded.
    - `lines`, `frequency`: DFT lines (freq,) and their frequencies, Hz.
    - `noise`: covariance of [Y; U] (mean over the periods) that the scatter between periods shows,
      (pos, exp, freq, sig, sig); `None` with fewer than two periods.
    - `n_periods`: periods averaged. `periodic`: false where the record was taken whole, with leakage
      (`record_spectra`); only methods with a transient term can use it then.
    - `segments`: of every experiment that stand for experiments here (`segment_spectra`); 0 otherwise.
    - `q`, `fs`, `period`, `y_quantity`, `u_unit`, `y_unit`, `sources`, `warnings`: as in `Experiment`.
    """

    U: Complex[Array, "pos exp freq in"]
    Y: Complex[Array, "pos exp freq out"]
    R: Complex[Array, "pos exp freq ref"] | None
    lines: Int[Array, "freq"]
    frequency: Float[Array, "freq"]
    noise: Complex[Array, "pos exp freq sig sig"] | None
    q: Float[Array, "pos joint"] | None = None
    fs: float = eqx.field(static=True, default=1.0)
    period: int = eqx.field(static=True, default=0)
    n_periods: int = eqx.field(static=True, default=1)
    periodic: bool = eqx.field(static=True, default=True)
    segments: int = eqx.field(static=True, default=0)
    y_quantity: str = eqx.field(static=True, default="velocity")
    u_unit: str = eqx.field(static=True, default="")
    y_unit: str = eqx.field(static=True, default="")
    sources: tuple[Source, ...] = eqx.field(static=True, default=())
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        for name in ("Y", "R"):
            x = getattr(self, name)
            if x is not None and x.shape[:3] != self.U.shape[:3]:
                raise ValueError(f"{name} has shape {x.shape}, U {self.U.shape}; expected the same first three axes.")
        if self.U.shape[2] != len(self.lines):
            raise ValueError(f"U holds {self.U.shape[2]} lines, `lines` {len(self.lines)}; expected as many.")

    @property
    def n_pos(self) -> int:
        return self.U.shape[0]

    @property
    def n_exp(self) -> int:
        return self.U.shape[1]

    @property
    def n_in(self) -> int:
        return self.U.shape[3]

    @property
    def n_out(self) -> int:
        return self.Y.shape[3]

    @property
    def n_real(self) -> int:
        """Blocks M of n_in experiments; experiments beyond the last whole block are not counted."""
        return self.n_exp // self.n_in


def dft(data: Experiment, *, robust: bool = False, silent: bool = False) -> Spectra:
    """Spectra of the mean steady period at the excited lines (`data.lines`, or found by `excited_lines`).

    Periodic data only: the DFT of whole steady periods has no leakage. The noise covariance of the mean is
    1/(P (P-1)) sum_p (X_p - X)(X_p - X)^H (Pintelon & Schoukens 2012, ch. 2); it needs P >= 2 periods and does not
    see what repeats with the period (nonlinear distortion, ripple).

    **Arguments:** `robust`: weigh periods, so that one with a glitch, a lost sample or a disturbance does not count:
    the mean is sum_p w_p X_p / sum_p w_p with the weights of Tukey's biweight (Beaton & Tukey 1974), from the distance
    of the period from the others over all channels and some neighbouring lines, the same for r, u and y, so that
    y = G u still holds; its covariance is sum_p w_p^2 (X_p - X)(X_p - X)^H / ((sum_p w_p)^2 (1 - 1/sum_p w_p)). It
    costs a few per cent of the information of clean periods. `silent`: lines that carry no power in any experiment are
    taken, too (of some positions of a larger record, say).

    **Raises:** `jaxfrf.InputError` if the record is not periodic, an excited line carries no power, or `robust` has
    fewer than three periods.
    """
    expect("data", data, Experiment)
    if not data.period:
        raise input_error(
            _where(data, "period"),
            "0: the record is not periodic",
            "whole steady periods, which this method needs (the DFT of anything else leaks)",
            f"{period_advice(data)} Otherwise use a local method with a transient term (--method auto --option "
            "transient=2), which takes the record whole, or --method welch.",
        )
    if robust and data.n_periods < 3:
        raise input_error(
            _where(data, "robust"),
            f"{data.n_periods} steady period(s)",
            "at least three, of which most agree",
            "Leave robust out, or record more periods.",
        )
    lines = known_lines(data)
    spectra = _at_lines(data, lines, robust)
    if not silent:
        check_power(data, spectra, silent_lines(data, spectra))
    return spectra


def period_advice(data: Experiment) -> str:
    """What to set for the period of a record that is said to have none: what its signals show."""
    seen = seen_period(data.r, data.u, data.y)
    if seen is None:
        return "No period is seen in the record; say it if there is one (--set period=N)."
    return f"{seen[0]} repeats every {seen[1].period} samples: {how_to_set(data.n_time, seen[1].period)}."


def unexcited_spectra(data: Experiment, band: tuple[float, float] | None = None) -> Spectra:
    """Spectra of the mean steady period at the *unexcited* lines (detection lines) of the excited band, or `band` (Hz).

    What stands there is noise and nonlinear distortion: even lines show even, odd lines odd nonlinearity.
    In closed loop it is the loop's reaction too; `jaxfrf.distortion` subtracts G U first.

    **Raises:** `jaxfrf.InputError` if `data` is no experiment or not periodic, or every line is excited.
    """
    expect("data", data, Experiment)
    excited = dft(data)
    low, high = (excited.frequency[0], excited.frequency[-1]) if band is None else band
    k = np.arange(1, (data.period - 1) // 2 + 1)
    f = k * data.fs / data.period
    k = k[(f >= low) & (f <= high) & ~np.isin(k, excited.lines)]
    if k.size == 0:
        raise input_error(
            "detection lines",
            f"every line from {low:.4g} to {high:.4g} Hz is excited",
            "some lines left unexcited",
            "Excite odd or random-odd lines only, to see nonlinear distortion.",
        )
    return _at_lines(data, k)


def record_spectra(data: Experiment, band: tuple[float, float] | None = None) -> Spectra:
    """Spectra of the whole record, for data that are not periodic: all DFT lines of the record in `band` (Hz).

    Leakage makes Y = G U + T with a transient T that is smooth in frequency: only estimators with a transient term
    take such spectra. Lines that hold less than 1e-4 of the strongest reference power (input power where there is no
    reference) are left out: in closed loop the response there would be that of the controller. With `band` all lines in
    it are taken but those that hold rounding only (1e-24).

    **Raises:** `jaxfrf.InputError` if `data` is no experiment, or the band holds no excited line.
    """
    expect("data", data, Experiment)
    n = data.n_time
    k = np.arange(1, (n - 1) // 2 + 1)
    whole = _rebuild_whole(data)
    strength = _strength(whole, k)
    strong = strength >= (_STRONG if band is None else _STRONG_IN_BAND) * strength.max()
    if band is None:
        k = k[strong]
    else:
        f = k * data.fs / n
        k = k[(f >= band[0]) & (f <= band[1]) & strong]
        if k.size == 0:
            raise input_error(
                "band",
                f"{band[0]:g} to {band[1]:g} Hz",
                f"a band that holds excited lines between {data.fs / n:.4g} and {data.fs / 2:g} Hz",
                "Widen the band.",
            )
    spectra = _at_lines(whole, k)
    return dataclasses.replace(
        spectra, periodic=False, noise=None, warnings=(*spectra.warnings, _what_it_can_give(data, spectra))
    )


def segment_spectra(
    data: Experiment, segment: int | None = None, *, overlap: float = 0.5, window: str = "hann"
) -> Spectra:
    """Spectra of windowed segments of a record, as experiments beside each other: what Welch's method averages.

    As in `scipy.signal.welch` the mean of every segment is taken off, and what is left at the end is not used. With
    them `jaxfrf.coherence(spectra)` is `scipy.signal.coherence`, and `jaxfrf.estimate(spectra, jaxfrf.Welch())` is
    csd(u, y)/welch(u). Leakage from line to line is as the window makes it.

    **Arguments:** `segment`, in samples; `None`: as long as eight with half an overlap can be. `overlap`: share of a
    segment. `window`: as `scipy.signal.get_window` names it.

    **Raises:** `jaxfrf.InputError` if the record is shorter than a segment.
    """
    n = data.n_time
    length = max(2 * n // 9, 8) if segment is None else int(segment)
    if not 8 <= length <= n:
        raise input_error("segment", f"{length} samples of a record of {n}", f"from 8 to {n} samples", "Shorten it.")
    hop = max(length - int(length * overlap), 1)
    taper = scipy.signal.get_window(window, length)
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
        q=data.q,
        fs=data.fs,
        period=length,
        periodic=False,
        segments=(n - length) // hop + 1,
        y_quantity=data.y_quantity,
        sources=data.sources,
        warnings=data.warnings,
    )


def _what_it_can_give(data: Experiment, spectra: Spectra) -> str:
    """One sentence on where the excitation of an aperiodic record has its power."""
    name, X = ("u", spectra.U) if spectra.R is None else ("r", spectra.R)
    power = np.sum(np.abs(X) ** 2, axis=(0, 1))
    share = np.cumsum(power, axis=0) / np.sum(power, axis=0)
    limit = [f"{f:.3g}" for f in np.unique(spectra.frequency[np.argmax(share >= 0.99, axis=0)])]
    below = f"{limit[0]} Hz" if len(limit) == 1 else f"{limit[0]} to {limit[-1]} Hz (by channel)"
    return (
        f"{_where(data, name)}: not periodic, taken whole with a transient term; 99 % of the power between "
        f"{spectra.frequency[0]:.3g} and {spectra.frequency[-1]:.3g} Hz lies below {below}. Above that, and between "
        "lines that carry little, look at the standard deviation before the FRF; no noise level can be told apart from "
        "distortion."
    )


def _rebuild_whole(data: Experiment) -> Experiment:
    return Experiment(
        data.u,
        data.y,
        data.fs,
        data.n_time,
        r=data.r,
        q=data.q,
        r_quantity=data.r_quantity,
        y_quantity=data.y_quantity,
        u_unit=data.u_unit,
        y_unit=data.y_unit,
        sources=data.sources,
        warnings=data.warnings,
    )


def known_lines(data: Experiment) -> Int[np.ndarray, "freq"]:
    """The excited lines that a record lists, or those that are found in it (`excited_lines`)."""
    return excited_lines(data) if data.lines is None else np.asarray(data.lines)


def excited_lines(data: Experiment) -> Int[np.ndarray, "freq"]:
    """The lines that the reference (or, without one, the input) excites, found from its spectrum.

    A line counts when *every* channel is excited there (a slow sine on one axis does not make a line); of zippered
    designs, where each channel has lines of its own, those of all channels count. `found_lines` says how sure that is,
    `jaxfrf.periodic.find_lines` how it is done. Give `lines` where they are known.

    **Raises:** `jaxfrf.InputError` if a channel carries no power.
    """
    expect("data", data, Experiment)
    return found_lines(data).lines


def found_lines(data: Experiment) -> FoundLines:
    """`excited_lines` with the design they fit, in words, and a confidence from 0 to 1."""
    k = np.arange(1, (data.period - 1) // 2 + 1)
    power, noise = _power(data, k)
    return lines_in(k, power, noise, data)


def lines_in(k, power, noise, data: Experiment) -> FoundLines:
    """The lines that stand out of power and noise at lines k, as of `added_power`; `data` is named where none do."""
    found = find_lines(k, power, noise)
    if found is None:
        raise input_error(
            _where(data, "u" if data.r is None else "r"),
            "no power at any line",
            "an excitation in every channel",
            "Check the names in --map, and that every channel was excited.",
        )
    return found


def _power(data: Experiment, k) -> tuple[np.ndarray, np.ndarray | None]:
    """Power per line and channel of the reference (or input) over all experiments, and what of it is noise as far as
    the scatter between periods shows: (freq, channel). A position counts by its speed."""
    return weighed_power(data, k, *added_power(data, k))


def added_power(data: Experiment, k, power=None, noise=None) -> tuple[np.ndarray, np.ndarray | None]:
    """Power of the experiments, added to that of others, and noise (`None` of single periods): (freq, channel)."""
    x = data.u if data.r is None else data.r
    power = np.zeros((len(k), x.shape[-1])) if power is None else power
    noise = (np.zeros_like(power) if noise is None else noise) if data.n_periods > 1 else None
    for pos in range(data.n_pos):
        for exp in range(data.n_exp):
            mean, variance = _mean_and_variance(x[pos, exp], data.period, data.transient_periods, k)
            power += np.abs(mean) ** 2
            if noise is not None:
                noise += variance
    return power, noise


def weighed_power(data: Experiment, k, power, noise) -> tuple[np.ndarray, np.ndarray | None]:
    """The same of speeds, where the reference is a position."""
    weight = np.ones(len(k))
    if data.r is not None and data.r_quantity == "position":
        weight = k.astype(float) ** 2
    return power * weight[:, None], None if noise is None else noise * weight[:, None]


def line_power(data: Experiment) -> np.ndarray:
    """Power of the reference (or input) at lines 1, 2, ... of the period, summed over experiments: (freq, channel)."""
    return _power(data, np.arange(1, (data.period - 1) // 2 + 1))[0]


def _strength(data: Experiment, k) -> np.ndarray:
    """Power per line of the weakest channel, each channel in units of its own median-free peak: (freq,)."""
    power, _ = _power(data, k)
    peak = np.sort(power, axis=0)[-min(4, len(k))]
    if np.any(peak <= 0):
        return np.zeros(len(k))
    return np.min(power / peak, axis=1)


def _at_lines(data: Experiment, lines, robust: bool = False) -> Spectra:
    lines = np.asarray(lines)
    shape = (data.n_pos, data.n_exp, len(lines))
    n_sig = data.n_out + data.n_in
    U = np.empty((*shape, data.n_in), complex)
    Y = np.empty((*shape, data.n_out), complex)
    R = None if data.r is None else np.empty((*shape, data.r.shape[-1]), complex)
    noise = np.empty((*shape, n_sig, n_sig), complex) if data.n_periods > 1 else None
    for pos in range(data.n_pos):
        for exp in range(data.n_exp):
            signal = np.concatenate([data.y[pos, exp], data.u[pos, exp]], axis=-1)
            steady = (data.period, data.transient_periods)
            weight = period_weights(signal, *steady, lines) if robust else None
            mean, scatter = _coefficients(signal, *steady, lines, weight)
            Y[pos, exp], U[pos, exp] = mean[:, : data.n_out], mean[:, data.n_out :]
            if noise is not None:
                noise[pos, exp] = scatter
            if R is not None:
                R[pos, exp], _ = _coefficients(data.r[pos, exp], *steady, lines, weight)
    return Spectra(
        U=U,
        Y=Y,
        R=R,
        lines=lines,
        frequency=lines * data.fs / data.period,
        noise=noise,
        q=data.q,
        fs=data.fs,
        period=data.period,
        n_periods=data.n_periods,
        y_quantity=data.y_quantity,
        u_unit=data.u_unit,
        y_unit=data.y_unit,
        sources=data.sources,
        warnings=data.warnings,
    )


def _mean_and_variance(x, period: int, transient: int, lines) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean over the periods of the Fourier coefficients of x (time, channel), and the variance of that mean."""
    x = x[transient * period :].reshape(-1, period, x.shape[-1])
    per_period = scipy.fft.rfft(x, axis=1, workers=-1)[:, lines] / period
    n = len(per_period)
    return per_period.mean(axis=0), per_period.var(axis=0, ddof=1) / n if n > 1 else None


def period_weights(x, period: int, transient: int, lines) -> Float[np.ndarray, "period freq"]:
    """What every period of x (time, channel) counts at every line, from 0 to 1: see `dft`."""
    x = x[transient * period :].reshape(-1, period, x.shape[-1])
    per_period = scipy.fft.rfft(x, axis=1, workers=-1)[:, lines] / period
    centre = np.median(per_period.real, axis=0) + 1j * np.median(per_period.imag, axis=0)
    weight = np.ones(per_period.shape[:2])
    for _ in range(_ROUNDS):
        power = np.abs(per_period - centre) ** 2
        usual = np.median(power, axis=0) / np.log(2)  # of a circular Gaussian the median power is log 2 of the mean
        usual = uniform_filter1d(usual, _WEIGHT_LINES, axis=0, mode="nearest")
        distance = np.mean(power / np.maximum(usual, 1e-300), axis=2)
        distance = np.sqrt(uniform_filter1d(distance, _WEIGHT_LINES, axis=1, mode="nearest"))
        distance = distance / np.maximum(np.median(distance, axis=0), 1e-300)
        weight = np.maximum(1 - (np.maximum(distance - 1, 0) / _CUT) ** 2, 0) ** 2
        centre = np.sum(weight[..., None] * per_period, axis=0) / np.sum(weight, axis=0)[:, None]
    return weight


def _coefficients(x, period: int, transient: int, lines, weight=None) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean over the periods of the Fourier coefficients of x (time, channel), and the covariance of that mean."""
    if weight is not None:
        return _weighted(x, period, transient, lines, weight)
    x = x[transient * period :].reshape(-1, period, x.shape[-1])
    per_period = scipy.fft.rfft(x, axis=1, workers=-1)[:, lines] / period
    mean = per_period.mean(axis=0)
    n = len(per_period)
    if n < 2:
        return mean, None
    deviation = per_period - mean
    return mean, np.einsum("pfa,pfb->fab", deviation, deviation.conj(), optimize=True) / (n * (n - 1))


def _weighted(x, period: int, transient: int, lines, weight) -> tuple[np.ndarray, np.ndarray]:
    """The same with weights (period, freq)."""
    x = x[transient * period :].reshape(-1, period, x.shape[-1])
    per_period = scipy.fft.rfft(x, axis=1, workers=-1)[:, lines] / period
    total = weight.sum(axis=0)
    mean = np.sum(weight[..., None] * per_period, axis=0) / total[:, None]
    deviation = weight[..., None] * (per_period - mean)
    scatter = np.einsum("pfa,pfb->fab", deviation, deviation.conj(), optimize=True)
    return mean, scatter / (total**2 * np.maximum(1 - 1 / total, 0.1))[:, None, None]


def silent_lines(data: Experiment, spectra: Spectra) -> np.ndarray:
    """Excited lines without any power in the reference (or input), (freq, channel): an estimate there is rounding
    noise."""
    name, X = ("u", spectra.U) if spectra.R is None else ("r", spectra.R)
    power = np.mean(np.abs(X) ** 2, axis=(0, 1))
    silent = power <= _SILENT * np.median(power, axis=0)
    if data.lines is not None:  # lines that were found have power; those that were given may all be wrong
        steady = getattr(data, name)[:, :, data.transient_periods * data.period :]
        silent |= power <= _SILENT_SHARE * np.mean([np.var(x, axis=0) for at in steady for x in at], axis=0)
    return silent


def check_power(data: Experiment, spectra: Spectra, silent: np.ndarray) -> None:
    """Refuse `silent_lines`."""
    name = "u" if spectra.R is None else "r"
    if silent.any():
        line, channel = (int(i) for i in np.argwhere(silent)[0])
        raise input_error(
            _where(data, name),
            f"no power in channel {channel} at {int(np.any(silent, axis=1).sum())} of the {len(spectra.lines)} excited "
            f"lines, the first line {spectra.lines[line]} ({spectra.frequency[line]:.4g} Hz)",
            "power at every excited line in every channel",
            "Check fs and period, or leave these lines out of `lines`.",
        )


def _where(data: Experiment, name: str) -> str:
    return f"{data.sources[0].name}: {name}" if data.sources else name


def select_band(spectra: Spectra, low: float, high: float) -> Spectra:
    """The same spectra at the lines from `low` to `high` (Hz) only.

    **Raises:** `jaxfrf.InputError` if no line is left.
    """
    expect("spectra", spectra, Spectra)
    inside = (spectra.frequency >= low) & (spectra.frequency <= high)
    if not inside.any():
        raise input_error(
            "band",
            f"no excited line between {low:g} and {high:g} Hz",
            f"a part of {spectra.frequency[0]:.4g} to {spectra.frequency[-1]:.4g} Hz",
            "Widen the band.",
        )

    signals = changed_signals(spectra, lambda x: x[:, :, inside])
    return dataclasses.replace(spectra, **signals, lines=spectra.lines[inside], frequency=spectra.frequency[inside])


def select_positions(spectra: Spectra, positions) -> Spectra:
    """The same spectra at some operating points only (`positions`: a slice or a list of indices).

    **Raises:** `jaxfrf.InputError` if `spectra` are none.
    """
    expect("spectra", spectra, Spectra)

    q = None if spectra.q is None else spectra.q[positions]
    return dataclasses.replace(spectra, **changed_signals(spectra, lambda x: x[positions]), q=q)


def changed_signals(spectra: Spectra, change: Callable[[Array], Array]) -> dict[str, Array]:
    """`change` applied to U, Y, R and the noise covariance, as far as they are there, by field name."""
    names = [name for name in ("U", "Y", "R", "noise") if getattr(spectra, name) is not None]
    return {name: change(getattr(spectra, name)) for name in names}


def differentiate(X, omega, times: int):
    """Spectra `X`, (*batch, freq, channel), differentiated `times` times: times (j `omega`)^times, `omega` in rad/s.

    **Returns:** (*batch, freq, channel).
    """
    return X * ((1j * np.asarray(omega)) ** times)[:, None]


def with_output_quantity(spectra: Spectra, quantity: str) -> Spectra:
    """The same spectra with the output as `position`, `velocity` or `acceleration`, by (j omega)^n.

    **Raises:** `jaxfrf.InputError` for any other quantity.
    """
    expect("spectra", spectra, Spectra)
    if quantity not in QUANTITIES:
        raise input_error("quantity", repr(quantity), "position, velocity or acceleration", "Choose one of them.")
    times = QUANTITIES[quantity] - QUANTITIES[spectra.y_quantity]
    factor = (2j * np.pi * np.asarray(spectra.frequency)) ** times
    noise = spectra.noise
    if noise is not None:
        scale = np.ones((len(factor), noise.shape[-1]), complex)
        scale[:, : spectra.n_out] = factor[:, None]
        noise = noise * scale[:, :, None] * scale[:, None, :].conj()
    unit = differentiated(spectra.y_unit, times) if spectra.y_unit else ""
    return dataclasses.replace(spectra, Y=spectra.Y * factor[:, None], noise=noise, y_quantity=quantity, y_unit=unit)
