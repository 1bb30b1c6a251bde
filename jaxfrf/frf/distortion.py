"""Noise and nonlinear distortion, told apart: over realisations (robust), or from unexcited lines (fast)."""

import dataclasses

import equinox as eqx
import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float

from .._arguments import expect
from .._errors import InputError, input_error
from .._status import Status
from .._text import counted
from .._threads import one_blas_thread
from .._types import Array
from ..experiment import Experiment
from ..spectra import Spectra, changed_signals, check_power, dft, silent_lines, unexcited_spectra
from .average import ArithmeticMean
from .causes import by_output, noise_level
from .covariance import variances
from .estimate import estimate
from .from_record import spectra_of
from .method import AbstractMethod
from .response import FRF
from .running import running_mean
from .scaled import scaled
from .select import Auto

_NEIGHBOURS = 8  # unexcited lines of one kind that the level at an excited line is the mean of
_AS_OUTPUT = (0.0, 0.5, 1.0, 1.5)  # powers of the output's that their level may go with
_LEAST_SHARE = 1e-12  # of the output's largest power
_SURELY = 2.0  # of the log-likelihood by which one but the first must be better
_FEWEST = 4  # of them, below which nothing is said
_STANDS_OUT, _USUAL = 10.0, 17  # power of the input over its median over so many unexcited lines of a kind: excited?
_COMES_NEAR, _BESIDE = 0.1, 5  # of the power of the weakest of so many excited lines around: noise is far below


class Distortion(eqx.Module):
    """The best linear approximation of a record, and what in the output is noise and what nonlinear distortion.

    All levels are rms values of Fourier coefficients of one experiment (its mean period), in the unit of y; NaN where
    they cannot be known.

    **Fields:**

    - `frf`: the best linear approximation, `cov_noise` and `cov_total` with it.
    - `output`: level of the output at the excited lines, (pos, freq, out).
    - `noise`, `even`, `odd`, `total`: at the excited lines, (pos, freq, out). `even` and `odd`: distortion of even and
      odd order without the noise, from the unexcited lines around; `total`: noise and all distortion that falls on the
      excited lines.
    - `unexcited`: frequencies of the detection lines, Hz, (line,); `is_even`, (line,); `detected`: what the linear
      response does not explain there, noise included, (pos, line, out); `detected_noise`: noise alone.
    - `way`: `fast` (from unexcited lines), `robust` (from realisations), or `noise only` where neither can be.
    """

    frf: FRF
    output: Float[Array, "pos freq out"]
    noise: Float[Array, "pos freq out"]
    even: Float[Array, "pos freq out"]
    odd: Float[Array, "pos freq out"]
    total: Float[Array, "pos freq out"]
    unexcited: Float[Array, "line"]
    is_even: Bool[Array, "line"]
    detected: Float[Array, "pos line out"]
    detected_noise: Float[Array, "pos line out"]
    way: str = eqx.field(static=True)


def best_linear_approximation(data: Experiment, method: AbstractMethod | None = None) -> Distortion:
    """Estimate the best linear approximation of a periodic record, with noise, even and odd distortion beside it.

    *Fast* (Pintelon & Schoukens 2012, sec. 4.3), where lines in the band are left unexcited: what Y - G U leaves there,
    G interpolated from the excited lines, so that what the controller of a closed loop plays at these lines is no
    distortion. Where a record lists no lines, those that may be excited are left out, and `frf.warnings` says so. Even
    lines show distortion of even order, odd ones of odd order; of odd excitations only the odd ones fall on excited
    lines. A level at an excited line is a mean over unexcited ones around, of what is left there or of its part in the
    output's power to the .5, 1 or 1.5, whichever tells neighbours best. Too high where G bends between two excited
    lines, as at a sharp resonance. *Robust*, from two realisations of two periods: `jaxfrf.levels`; even and odd are
    not told apart. Noise is what changes from period to period, and needs two.

    **Arguments:** `data`: periodic, (pos, exp, time, channel). `method`: estimates G; default `jaxfrf.Auto()`.

    **Returns:** a `Distortion`: G with its covariances, and levels in the unit of y.

    **Raises:** `jaxfrf.InputError` if the record is not periodic, or neither way nor two periods are there.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 4.3.
    """
    expect("data", data, Experiment)
    chosen = Auto() if method is None else method
    return distortion_of(estimate(spectra_of(data, chosen), chosen), data)


@one_blas_thread
def with_distortion(frf: FRF, data: Experiment, spectra: Spectra | None = None) -> FRF:
    """The FRF with what its record says of noise and distortion together (`cov_total`); as it is where that is nothing.

    Where the residuals leave no covariance (status `NOISE_ONLY`), it becomes the covariance, so that fits weigh by it.

    **Arguments:** `frf`: of the record, (pos, freq, out, in). `data`: the record. `spectra`: `jaxfrf.dft` of it, where
    it is there already.

    **Returns:** the FRF, with `cov_total` where the record tells it; units and lines stay.

    **Raises:** `jaxfrf.InputError` if `frf` is no FRF or `data` no experiment, and where the lines of the FRF are not
    all the record's.

    **Source:** as of `jaxfrf.best_linear_approximation`.
    """
    expect("frf", frf, FRF)
    expect("data", data, Experiment)
    if not data.period:
        return frf
    try:
        spectra = dft(data) if spectra is None else spectra
    except InputError:
        return frf
    _places(spectra, frf)
    try:
        return distortion_of(frf, data, spectra).frf
    except InputError:
        return frf


@one_blas_thread
def distortion_of(frf: FRF, data: Experiment, spectra: Spectra | None = None) -> Distortion:
    """As `best_linear_approximation`, of an FRF of the same record and band.

    Biased as that is: too high where G bends between two excited lines, and by the smoothing of `frf`, which counts as
    distortion at unexcited lines. Fails with an FRF of another record, or of the same one in another quantity: what G U
    does not explain is then no distortion.

    **Arguments:** `frf`: (pos, freq, out, in), of the record and in its quantity. `data`: the periodic record.
    `spectra`: `jaxfrf.dft` of the record, where it is there already.

    **Returns:** a `Distortion`: the FRF with its covariances, and levels in the unit of y.

    **Raises:** `jaxfrf.InputError` where nothing tells noise and distortion (one period, no unexcited line), and where
    the lines of the FRF are not all the record's.

    **Source:** as of `jaxfrf.best_linear_approximation`.
    """
    if spectra is None:
        spectra = dft(data)
    else:
        check_power(data, spectra, silent_lines(data, spectra))
    spectra = _at(spectra, _places(spectra, frf))
    shape = (spectra.n_pos, len(spectra.frequency), spectra.n_out)
    unknown = np.full(shape, np.nan)
    noise = unknown if spectra.noise is None else np.sqrt(noise_level(frf.G, spectra))
    excited_even = bool(np.any(np.asarray(spectra.lines) % 2 == 0))
    found, doubted = _fast(frf, data, spectra)
    even, odd, total, way = found["even"], found["odd"], unknown, "noise only"
    if np.isfinite(odd).any() and (np.isfinite(even).any() or not excited_even):
        power = odd**2 + (even**2 if excited_even else 0) + np.nan_to_num(noise) ** 2
        total, way = np.sqrt(power), "fast"
    elif spectra.n_real > 1 and spectra.noise is not None:
        total, way = _robust(spectra), "robust"
    elif np.isfinite(even).any():
        way = "fast"
    if way == "noise only" and spectra.noise is None:
        raise input_error(
            "distortion",
            f"{counted(spectra.n_real, 'realisation')} of {counted(spectra.n_periods, 'period')}, no line left "
            "unexcited",
            "unexcited lines in the band (odd designs), or two realisations, or two periods",
            "Excite odd lines only and leave some of them out (jaxfrf excite), or record longer.",
        )
    output = np.sqrt(np.mean(np.abs(np.asarray(spectra.Y)) ** 2, axis=1))
    frf = _with_total(frf, spectra, total, way)
    if doubted and way == "fast":
        frf = dataclasses.replace(frf, warnings=(*frf.warnings, _of_doubted(doubted)))
    return Distortion(frf=frf, output=output, noise=noise, total=total, way=way, **found)


def _places(spectra: Spectra, frf: FRF) -> np.ndarray:
    """Which of the lines of the spectra are those of the FRF; an error where one is not."""
    at = np.searchsorted(spectra.frequency, np.asarray(frf.frequency) * (1 - 1e-9))
    fits = (at < len(spectra.frequency)).all() and np.allclose(spectra.frequency[at], frf.frequency, rtol=1e-9)
    if not fits or (spectra.n_pos, spectra.n_out, spectra.n_in) != (frf.n_pos, frf.n_out, frf.n_in):
        raise input_error("frf", "other lines, positions or channels", "those of the record", "Take both from one.")
    return at


def _at(spectra: Spectra, at) -> Spectra:
    signals = changed_signals(spectra, lambda x: np.asarray(x)[:, :, at])
    return dataclasses.replace(spectra, **signals, lines=spectra.lines[at], frequency=spectra.frequency[at])


def _fast(frf: FRF, data: Experiment, spectra: Spectra) -> tuple[dict, int]:
    """Levels at the unexcited lines of the band, and brought to the excited ones; empty where there are none. How many
    lines are left out, as they may be excited."""
    shape = (spectra.n_pos, len(spectra.frequency), spectra.n_out)
    try:
        quiet = unexcited_spectra(data, (float(frf.frequency[0]), float(frf.frequency[-1])))
    except InputError:
        none = np.full((shape[0], 0, shape[2]), np.nan)
        nothing = dict(unexcited=np.zeros(0), is_even=np.zeros(0, bool), detected=none, detected_noise=none)
        return nothing | dict(even=np.full(shape, np.nan), odd=np.full(shape, np.nan)), 0
    kept = np.full(len(quiet.lines), True) if data.lines is not None else ~_may_be_excited(quiet, spectra)
    doubted, quiet = int(np.sum(~kept)), _at(quiet, kept)
    G = _interpolated(quiet.frequency, frf)
    power = _unexplained(quiet, G)
    noise = np.zeros_like(power) if quiet.noise is None else noise_level(G, quiet)
    is_even = np.asarray(quiet.lines) % 2 == 0
    level = np.mean(np.abs(np.asarray(spectra.Y)) ** 2, axis=1)
    there = _between_lines(quiet.frequency, spectra.frequency, level)
    brought = {
        name: _brought(
            spectra.frequency, np.asarray(quiet.frequency)[of], power[:, of], noise[:, of], level, there[:, of]
        )
        for name, of in (("even", is_even), ("odd", ~is_even))
    }
    levels = {
        "unexcited": np.asarray(quiet.frequency),
        "is_even": is_even,
        "detected": np.sqrt(power),
        "detected_noise": np.full_like(power, np.nan) if quiet.noise is None else np.sqrt(noise),
    }
    return levels | brought, doubted


def _may_be_excited(quiet: Spectra, excited: Spectra) -> np.ndarray:
    """Lines that were found unexcited, but where the input stands out of others of their kind and comes near that of an
    excited line beside, as the lines of a design do where a drive's force drops: (line,)."""
    power, beside = (np.max(np.mean(np.abs(np.asarray(x.U)) ** 2, axis=1), axis=0) for x in (quiet, excited))
    least = scipy.ndimage.minimum_filter1d(beside, _BESIDE, axis=0, mode="nearest")
    nearest = np.clip(np.searchsorted(excited.lines, quiet.lines), 0, len(beside) - 1)
    found = np.zeros(len(power), bool)
    for kind in (0, 1):
        of = np.asarray(quiet.lines) % 2 == kind
        if of.sum() >= _USUAL:
            usual = scipy.ndimage.median_filter(power[of], size=(_USUAL, 1), mode="nearest")
            stands_out = (power[of] > _STANDS_OUT * usual) & (power[of] > _COMES_NEAR * least[nearest[of]])
            found[of] = np.any(stands_out, axis=1)
    return found


def _of_doubted(count: int) -> str:
    return (
        f"distortion: {counted(count, 'line')} that count as unexcited carry ten times as much input as others around, "
        "and are left out: they may be excited. Give the excited lines (lines=...) if they are known."
    )


def _brought(frequency, known, power, noise, level, level_there) -> np.ndarray:
    """Root of the mean power of the nearest lines, (pos, freq, out), each as a part of what the output is there; NaN
    where there are too few. `level`: power of the output at the excited lines, `level_there`: at the unexcited ones.

    What enters beside the input, as friction and springs do, has the resonances that the output has; what a sensor
    adds, or another joint, has not, or has a part. That power of the output is taken by which lines tell their
    neighbours best: a mean over lines near a resonance tells several times too much beside it.
    """
    if len(known) < _FEWEST:
        return np.full((power.shape[0], len(frequency), power.shape[2]), np.nan)
    reach = min(_NEIGHBOURS, len(known)) // 2
    most = np.max(level, axis=1, keepdims=True)
    shares = [np.maximum(x / np.where(most > 0, most, 1.0), _LEAST_SHARE) for x in (level, level_there)]
    shapes = [(shares[0] ** p, shares[1] ** p) for p in _AS_OUTPUT]
    costs = np.array([_mistold(power / of, reach) + np.sum(np.log(of), axis=(0, 1)) for _, of in shapes])
    costs[0] -= _SURELY
    best = np.argmin(costs, axis=0)
    nearest = np.clip(np.searchsorted(known, frequency), 0, len(known) - 1)
    each = [running_mean((power - noise) / of, reach)[:, nearest] * at for at, of in shapes]
    return np.sqrt(np.maximum(np.choose(best, each), 0))


def _mistold(power, reach: int) -> Float[np.ndarray, "out"]:
    """How badly the mean of its neighbours tells the power of a line: minus the log-likelihood of an exponential
    distribution about it, (out,)."""
    n = power.shape[1]
    at = np.arange(n)
    count = (np.minimum(at + reach, n - 1) - np.maximum(at - reach, 0))[:, None]
    others = (running_mean(power, reach) * (count + 1) - power) / count
    others = np.maximum(others, np.finfo(float).tiny)
    return np.sum(np.log(others) + power / others, axis=(0, 1))


def _per_realisation(spectra: Spectra) -> np.ndarray:
    """Variance of a column of G from one block of n_in experiments, for outputs of unit variance: (pos, freq, in)."""
    U = np.moveaxis(np.asarray(spectra.U), 1, -1)
    power = U @ U.conj().swapaxes(-1, -2) * (spectra.n_in / spectra.n_exp)
    return np.diagonal(np.linalg.pinv(power, hermitian=True), axis1=-2, axis2=-1).real


def _robust(spectra: Spectra) -> np.ndarray:
    """Scatter between realisations as a level of the output, averaged over some lines: (pos, freq, out)."""
    scatter = levels(spectra).total ** 2 / _per_realisation(spectra)[..., None, :]
    return np.sqrt(running_mean(scatter.mean(axis=-1), _NEIGHBOURS // 2))


def _with_total(frf: FRF, spectra: Spectra, total, way: str) -> FRF:
    if not np.isfinite(total).any() or frf.cov_noise is None or spectra.noise is None:
        return frf
    reach = np.round(np.asarray(frf.window) / 2).astype(int)
    noise = running_mean(noise_level(frf.G, spectra), reach)
    ratio = np.sqrt(running_mean(total**2, reach) / np.maximum(noise, 1e-300))
    cov = scaled(frf.cov_noise, by_output(ratio, spectra.n_in))
    only_noise = (np.asarray(frf.status) & int(Status.NOISE_ONLY)) != 0
    if not only_noise.all():
        return dataclasses.replace(frf, cov_total=cov)
    free = spectra.n_exp * _NEIGHBOURS if way == "fast" else (spectra.n_real - 1) * (_NEIGHBOURS // 2 * 2 + 1)
    return dataclasses.replace(
        frf,
        cov=cov,
        cov_total=cov,
        dof=np.full(frf.status.shape, float(free)),
        status=np.asarray(frf.status) & ~int(Status.NOISE_ONLY),
    )


class Levels(eqx.Module):
    """Standard deviations of one realisation's G, by cause: (pos, freq, out, in), unit of G.

    - `noise`: what changes from period to period. `total`: what changes from realisation to realisation.
    - `nonlinear`: sqrt(total^2 - noise^2), stochastic nonlinear distortion; 0 where noise explains it all.
    """

    noise: Float[Array, "pos freq out in"]
    total: Float[Array, "pos freq out in"]
    nonlinear: Float[Array, "pos freq out in"]


def levels(spectra: Spectra) -> Levels:
    """Noise and nonlinear distortion by the robust method, from M realisations of P periods each.

    sigma_n^2 = mean_m var_p / P, sigma_tot^2 = var_m, sigma_S^2 = sigma_tot^2 - sigma_n^2 (Pintelon & Schoukens 2012,
    sec. 4.3), each for a single realisation; the mean over M has 1/M of them.

    From few realisations the levels scatter: of two, one degree of freedom is behind each. What is alike in all of
    them, as with the same phases, is not seen.

    **Arguments:** `spectra`: of `jaxfrf.dft`, M blocks of n_in experiments.

    **Returns:** `Levels`, each (pos, freq, out, in), in the unit of G.

    **Raises:** `jaxfrf.InputError` with fewer than two realisations (blocks of n_in experiments) or periods.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 4.3
    (robust method).
    """
    expect("spectra", spectra, Spectra)
    if spectra.n_real < 2 or spectra.noise is None:
        raise input_error(
            "levels",
            f"{counted(spectra.n_real, 'realisation')} of {counted(spectra.n_periods, 'period')}",
            "at least two realisations of two periods",
            "Repeat with new phases, or look at the unexcited lines (jaxfrf.distortion).",
        )
    mean = ArithmeticMean().estimate(spectra)
    noise, total = (np.asarray(variances(x)) * spectra.n_real for x in (mean.cov_noise, mean.cov_total))

    def root(variance):
        shape = (*variance.shape[:-1], spectra.n_in, spectra.n_out)
        return np.sqrt(np.maximum(variance, 0)).reshape(shape).swapaxes(-1, -2)

    return Levels(noise=root(noise), total=root(total), nonlinear=root(total - noise))


def distortion(unexcited: Spectra, frf: FRF) -> Float[np.ndarray, "pos freq out"]:
    """Level of the output that the linear response leaves unexplained at unexcited lines: rms of Y - G U.

    In closed loop the controller excites these lines as well, so G U (G interpolated between the excited lines) is
    taken off first (Pintelon & Schoukens 2012, sec. 4.3, fast method). Even lines show even, odd lines odd
    nonlinearity; both contain the noise. Unit of Y, Fourier coefficients as in `jaxfrf.dft`.

    **Arguments:** `unexcited`: at the lines that are not excited, e.g. of `jaxfrf.unexcited_spectra`. `frf`: of the
    same record, (pos, freq, out, in).

    **Returns:** rms over the experiments, (pos, freq, out), at the lines of `unexcited`.

    **Raises:** `jaxfrf.InputError` if FRF and spectra have other positions or channels.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 4.3
    (fast method).
    """
    expect("unexcited", unexcited, Spectra)
    expect("frf", frf, FRF)
    if unexcited.n_pos != frf.n_pos or (unexcited.n_out, unexcited.n_in) != (frf.n_out, frf.n_in):
        raise input_error(
            "frf",
            f"{frf.n_pos} positions of {frf.n_out} x {frf.n_in}",
            f"{unexcited.n_pos} positions of {unexcited.n_out} x {unexcited.n_in} as in the spectra",
            "Take both from the same record.",
        )
    G = _interpolated(unexcited.frequency, frf)
    return np.sqrt(_unexplained(unexcited, G))


def _unexplained(spectra: Spectra, G) -> np.ndarray:
    """Mean power of Y - G U over the experiments: (pos, freq, out)."""
    rest = np.asarray(spectra.Y) - np.einsum("pfoi,pefi->pefo", G, np.asarray(spectra.U))
    return np.mean(np.abs(rest) ** 2, axis=1)


def _interpolated(frequency, frf: FRF) -> np.ndarray:
    """G at other frequencies, linearly in real and imaginary part; the end values outside."""
    return _between_lines(frequency, frf.frequency, np.asarray(frf.G))


def _between_lines(frequency, known, x) -> np.ndarray:
    """x, (pos, freq, ...), at other frequencies than the known ones, linearly; the end values outside."""
    at, known = np.asarray(frequency), np.asarray(known)
    if len(known) == 1:
        return np.repeat(x, len(at), axis=1)
    right = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
    weight = np.clip((at - known[right - 1]) / (known[right] - known[right - 1]), 0, 1)
    weight = weight.reshape(-1, *[1] * (x.ndim - 2))
    return (1 - weight) * x[:, right - 1] + weight * x[:, right]
