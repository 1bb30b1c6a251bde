"""Means over periods of the Fourier coefficients of a signal, and how these scatter."""

import numpy as np
import scipy  # its modules load when they are used: scipy.signal alone takes a second
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

_ROUNDS = 4  # of weighing periods
_WEIGHT_LINES = 9  # that share a weight
_CUT = 2.0  # times the usual distance of a period from the others, beyond it, where it no longer counts


def mean_and_variance(x, period: int, transient: int, lines) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean over the periods of the Fourier coefficients of x (time, channel), and the variance of that mean."""
    x = x[transient * period :].reshape(-1, period, x.shape[-1])
    per_period = scipy.fft.rfft(x, axis=1, workers=-1)[:, lines] / period
    n = len(per_period)
    return per_period.mean(axis=0), per_period.var(axis=0, ddof=1) / n if n > 1 else None


def coefficients(x, period: int, transient: int, lines, weight=None) -> tuple[np.ndarray, np.ndarray | None]:
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
