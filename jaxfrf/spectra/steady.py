"""From steady periods to spectra: at the excited lines, and between them."""

import numpy as np

from .._arguments import as_band, expect
from .._errors import input_error
from .._text import counted, number
from ..experiment import Experiment, how_to_set, seen_period
from .fourier import coefficients, period_weights
from .lines import known_lines, where
from .spectra import Spectra

_SILENT = 1e-14  # power, relative to the median line, below which a line carries nothing (rounding)
_SILENT_SHARE = 1e-24  # the same relative to the whole signal, for when the median line is rounding itself


def dft(data: Experiment, *, robust: bool = False, silent: bool = False) -> Spectra:
    """Spectra of the mean steady period at the excited lines (`data.lines`, or found by `excited_lines`).

    Periodic data only: the DFT of whole steady periods has no leakage. The noise covariance of the mean is
    1/(P (P-1)) sum_p (X_p - X)(X_p - X)^H (Pintelon & Schoukens 2012, ch. 2); it needs P >= 2 periods and does not
    see what repeats with the period (nonlinear distortion, ripple).

    **Arguments:** `data`: periodic, (pos, exp, time, channel). `robust`: weigh periods, so that one with a glitch, a
    lost sample or a disturbance does not count: the mean is sum_p w_p X_p / sum_p w_p with the weights of Tukey's
    biweight (Beaton & Tukey 1974), from the distance of the period from the others over all channels and some
    neighbouring lines, the same for r, u and y, so that y = G u still holds; its covariance is
    sum_p w_p^2 (X_p - X)(X_p - X)^H / ((sum_p w_p)^2 (1 - 1/sum_p w_p)). It costs a few per cent of the information of
    clean periods.
    `silent`: lines that carry no power in any experiment are taken, too (of some positions of a larger record, say).

    **Returns:** `Spectra` at the excited lines, coefficients in the units of `data`.

    **Raises:** `jaxfrf.InputError` if the record is not periodic, an excited line carries no power, or `robust` has
    fewer than three periods.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, chapter 2 (mean
    and covariance over periods); Beaton & Tukey, Technometrics 16 (1974) 147-185 (the weights; their distance over
    channels and lines is this project's own).
    """
    expect("data", data, Experiment)
    _check_periodic(data)
    if robust and data.n_periods < 3:
        raise input_error(
            where(data, "robust"),
            f"{counted(data.n_periods, 'steady period')}",
            "at least three, of which most agree",
            "Leave robust out, or record more periods.",
        )
    lines = known_lines(data)
    spectra = at_lines(data, lines, robust)
    if not silent:
        check_power(data, spectra, silent_lines(data, spectra))
    return spectra


def _check_periodic(data: Experiment) -> None:
    if not data.period:
        seen = seen_period(data.r, data.u, data.y)
        raise input_error(
            where(data, "period"),
            "0: the record is not periodic" if seen is None else "0: the record does not say that it is periodic",
            "whole steady periods, which this method needs (the DFT of anything else leaks)",
            f"{period_advice(data)} Otherwise use a local method with a transient term (--method auto --option "
            "transient=2), which takes the record whole, or --method welch.",
        )


def period_advice(data: Experiment) -> str:
    """What to set for the period of a record that is said to have none: what its signals show."""
    seen = seen_period(data.r, data.u, data.y)
    if seen is None:
        return "No period is seen in the record; say it if there is one (--set period=N)."
    return f"{seen[0]} repeats every {seen[1].period} samples: {how_to_set(data.n_time, seen[1].period)}."


def unexcited_spectra(data: Experiment, band: tuple[float | None, float | None] | None = None) -> Spectra:
    """Spectra of the mean steady period at the *unexcited* lines (detection lines) of the excited band, or `band` (Hz).

    What stands there is noise and nonlinear distortion: even lines show even, odd lines odd nonlinearity.
    In closed loop it is the loop's reaction too; `jaxfrf.distortion` subtracts G U first.

    **Arguments:** `data`: periodic. `band`: lowest and highest frequency, Hz, both included, `None` at an end: open; by
    default from the first to the last excited line.

    **Returns:** `Spectra` at these lines, coefficients in the units of `data`, with the noise between periods where
    there are two.

    **Raises:** `jaxfrf.InputError` if `data` is no experiment or not periodic, or every line is excited.

    **Source:** Pintelon & Schoukens, System Identification, 2nd ed. 2012, section 4.3.
    """
    expect("data", data, Experiment)
    _check_periodic(data)
    excited = known_lines(data)
    usual = np.asarray(excited)[[0, -1]] * data.fs / data.period
    low, high = usual if band is None else as_band(band, data.fs / 2)
    k = np.arange(1, (data.period - 1) // 2 + 1)
    f = k * data.fs / data.period
    k = k[(f >= low) & (f <= high) & ~np.isin(k, excited)]
    if k.size == 0:
        raise input_error(
            "detection lines",
            f"every line from {number(low, 4)} to {number(high, 4)} Hz is excited",
            "some lines left unexcited",
            "Excite odd or random-odd lines only, to see nonlinear distortion.",
        )
    return at_lines(data, k)


def at_lines(data: Experiment, lines, robust: bool = False) -> Spectra:
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
            mean, scatter = coefficients(signal, *steady, lines, weight)
            Y[pos, exp], U[pos, exp] = mean[:, : data.n_out], mean[:, data.n_out :]
            if noise is not None:
                noise[pos, exp] = scatter
            if R is not None and data.r is not None:
                R[pos, exp], _ = coefficients(data.r[pos, exp], *steady, lines, weight)
    return Spectra(
        U=U,
        Y=Y,
        R=R,
        lines=lines,
        frequency=lines * data.fs / data.period,
        noise=noise,
        period=data.period,
        n_periods=data.n_periods,
        **said_of(data),
    )


def said_of(data: Experiment) -> dict:
    """What spectra say as their record does."""
    names = ("q", "fs", "y_quantity", "u_unit", "y_unit", "sources", "warnings")
    return {name: getattr(data, name) for name in names}


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


def without_power(silent: np.ndarray) -> np.ndarray:
    """Of `silent_lines`: lines at which no channel has power, and lines of channels that have none anywhere. Lines that
    channels share (zippered designs) are neither."""
    return silent & (silent.all(axis=1, keepdims=True) | silent.all(axis=0))


def check_power(data: Experiment, spectra: Spectra, silent: np.ndarray) -> None:
    """Refuse `silent_lines` that are `without_power`."""
    name, wrong = "u" if spectra.R is None else "r", without_power(silent)
    if wrong.any():
        line, channel = (int(i) for i in np.argwhere(wrong)[0])
        alone = wrong.shape[1] == 1 or bool(np.all(wrong[:, channel]))
        which = f"in channel {channel}" if alone else "in any channel"
        raise input_error(
            where(data, name),
            f"no power {which} at {int(wrong[:, channel].sum())} of the {len(spectra.lines)} excited "
            f"lines, the first line {spectra.lines[line]} ({number(spectra.frequency[line], 4)} Hz)",
            "power at every excited line, and in every channel",
            "Check fs and period, or leave these lines out of `lines`.",
        )
