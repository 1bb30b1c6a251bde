"""Noise and nonlinear distortion, told apart: over realisations (robust), or from unexcited lines (fast)."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._arguments import expect
from .._errors import input_error
from .._types import Array
from ..spectra import Spectra
from .average import ArithmeticMean
from .covariance import variances
from .response import FRF


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

    **Raises:** `jaxfrf.InputError` with fewer than two realisations (blocks of n_in experiments) or periods.
    """
    expect("spectra", spectra, Spectra)
    if spectra.n_real < 2 or spectra.noise is None:
        raise input_error(
            "levels",
            f"{spectra.n_real} realisation(s) of {spectra.n_periods} period(s)",
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
    """
    if unexcited.n_pos != frf.n_pos or (unexcited.n_out, unexcited.n_in) != (frf.n_out, frf.n_in):
        raise input_error(
            "frf",
            f"{frf.n_pos} positions of {frf.n_out} x {frf.n_in}",
            f"{unexcited.n_pos} positions of {unexcited.n_out} x {unexcited.n_in} as in the spectra",
            "Take both from the same record.",
        )
    G = _interpolated(unexcited.frequency, frf)
    rest = np.asarray(unexcited.Y) - np.einsum("pfoi,pefi->pefo", G, np.asarray(unexcited.U))
    return np.sqrt(np.mean(np.abs(rest) ** 2, axis=1))


def _interpolated(frequency, frf: FRF) -> np.ndarray:
    """G at other frequencies, linearly in real and imaginary part; the end values outside."""
    at, known = np.asarray(frequency), np.asarray(frf.frequency)
    right = np.clip(np.searchsorted(known, at), 1, max(len(known) - 1, 1))
    if len(known) == 1:
        return np.repeat(np.asarray(frf.G), len(at), axis=1)
    weight = np.clip((at - known[right - 1]) / (known[right] - known[right - 1]), 0, 1)[:, None, None]
    G = np.asarray(frf.G)
    return (1 - weight) * G[:, right - 1] + weight * G[:, right]
