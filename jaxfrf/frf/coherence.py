"""Coherence: how much of an output the inputs explain."""

import numpy as np
from jaxtyping import Float

from .._arguments import expect
from .._errors import input_error
from .._text import counted
from ..spectra import Spectra
from .classical import by_line


def coherence(spectra: Spectra) -> Float[np.ndarray, "pos freq out in"]:
    """Ordinary coherence |S_yu|^2 / (S_yy S_uu) between every output and every input, over experiments.

    Between 0 and 1, without a unit. Below 1 come noise, nonlinearity, leakage and, with several inputs, the *other*
    inputs: use `multiple_coherence` then. From few experiments it is biased high: unrelated signals give 1/n_exp.

    **Arguments:** `spectra`: of two experiments or more, (pos, exp, freq, channel).

    **Returns:** (pos, freq, out, in), without a unit.

    **Raises:** `jaxfrf.InputError` with fewer than two experiments.

    **Source:** Bendat & Piersol, Random Data, 4th ed. 2010.
    """
    expect("spectra", spectra, Spectra)
    if spectra.n_exp < 2:
        raise _too_few(spectra, 2)
    U, Y = by_line(spectra.U), by_line(spectra.Y)
    cross = np.abs(Y @ U.conj().swapaxes(-1, -2)) ** 2
    power = np.sum(np.abs(Y) ** 2, axis=-1)[..., :, None] * np.sum(np.abs(U) ** 2, axis=-1)[..., None, :]
    return _ratio(cross, power)


def multiple_coherence(spectra: Spectra) -> Float[np.ndarray, "pos freq out"]:
    """Multiple coherence of every output: the part of its power that all inputs together explain linearly.

    gamma^2 = 1 - |y - G u|^2 / |y|^2 with G by H1 over the experiments, which needs more experiments than inputs
    (unrelated signals give n_in/n_exp). With fewer, but several periods, the scatter between periods takes the place of
    the residual: then only noise lowers it, not nonlinearity.

    **Arguments:** `spectra`: of more experiments than inputs, or of several periods, (pos, exp, freq, channel).

    **Returns:** (pos, freq, out), from 0 to 1, without a unit.

    **Raises:** `jaxfrf.InputError` where there are neither.

    **Source:** Bendat & Piersol, Random Data, 4th ed. 2010.
    """
    expect("spectra", spectra, Spectra)
    U, Y = by_line(spectra.U), by_line(spectra.Y)
    power = np.sum(np.abs(Y) ** 2, axis=-1)
    if spectra.n_exp > spectra.n_in:
        size = np.linalg.norm(U, axis=-1, keepdims=True)  # inputs may have units far apart
        U = U / np.where(size > 0, size, 1.0)
        gram = U @ U.conj().swapaxes(-1, -2)
        projected = Y @ U.conj().swapaxes(-1, -2) @ np.linalg.pinv(gram, hermitian=True) @ U
        return _ratio(np.sum(np.abs(projected) ** 2, axis=-1), power)
    if spectra.noise is None:
        raise _too_few(spectra, spectra.n_in + 1)
    of_mean = _output_noise(spectra)
    noise = of_mean * spectra.n_periods
    return np.clip(_ratio(np.maximum(power - of_mean, 0), power - of_mean + noise), 0, 1)


def _output_noise(spectra: Spectra) -> np.ndarray:
    """Power of the noise in the mean period of every output, summed over experiments: (pos, freq, out)."""
    variance = np.diagonal(np.asarray(spectra.noise), axis1=-2, axis2=-1).real[..., : spectra.n_out]
    return variance.sum(axis=1)


def _ratio(a, b) -> np.ndarray:
    """a/b, 0 where there is no power; NaN where that is not known."""
    unknown = np.where(np.isfinite(a + b), 0.0, np.nan)
    return np.divide(a, b, out=unknown, where=b > 0)


def _too_few(spectra: Spectra, needed: int):
    return input_error(
        "coherence",
        f"{counted(spectra.n_exp, 'experiment')} of {counted(spectra.n_periods, 'period')}",
        f"at least {needed} experiments, or several periods for the multiple coherence",
        "With a single experiment look at the standard deviation of a local estimate instead.",
    )
