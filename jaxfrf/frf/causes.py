"""What the stated uncertainty of an estimate is made of: noise between periods, and bias that the data show.

The covariance of a method comes from its residuals: noise, nonlinear distortion and whatever else its model leaves,
all together. Here is what else the spectra know: how much of it changes from period to period; and, where there are at
least as many experiments as inputs, how far a local estimate is from the pointwise one, which has no window.
"""

import dataclasses

import numpy as np

from .._status import Status
from ..spectra import Spectra
from .aperiodic import has_fractions, uses_reference, uses_windows
from .average import AbstractAverage
from .classical import channel_size
from .covariance import variances
from .inverse import squares
from .method import AbstractMethod, Estimate
from .running import running_mean
from .scaled import Widened, scaled

_NEAR, _LEAST_NEAR = 8, 2  # bias is averaged over this part of the window, and so many lines on either side
_OTHERS = 0.25  # weight of all elements together beside the element itself
_LEAST = 0.5  # of the smaller variance, that two estimates at least differ by
_DOUBT = 2.0  # standard errors of the mean over lines: an excess of less is mostly chance
_UNSEEN = 0.13  # of the variance of the difference: bias of fractions, by noise in their regressors, that no test sees
_NOISE_LINES = 4  # on either side, over which the residuals of pointwise estimates are averaged
_SINGULAR = 1e10  # condition (Frobenius) of U Z^H, channels scaled, from which on a line has no pointwise estimate


def with_causes(estimate: Estimate, spectra: Spectra, method: AbstractMethod) -> Estimate:
    """The estimate (arrays of the host, with the axis of positions) with noise and bias told.

    - `cov_noise`, where the method has none of its own and there are two periods: the covariance times the share of the
      noise in the residuals, output by output.
    - Where the residuals say nothing (H1 of as many experiments as inputs) the noise between periods is the covariance,
      with the status `NOISE_ONLY`.
    - `bias` of local methods with a given window, as a variance that is added to the covariance: what
      |G - Y Z^H (U Z^H)^-1|^2, Z the reference or the input, has beyond the variance of the difference, averaged over
      some lines: x^3/(x^2 + e^2) of an excess x with the standard error e, so that chance adds little. Of fractions,
      where there are more experiments than inputs, an eighth of that variance more, for what no test sees.
    """
    estimate = _with_noise(estimate, spectra)
    estimate = _with_noise_only(estimate, spectra)
    return _with_bias(estimate, spectra, method)


def variance_of(cov, n_out: int) -> np.ndarray:
    """Variances as (pos, freq, out, in)."""
    v = np.asarray(variances(cov))
    return np.maximum(v.reshape(*v.shape[:-1], -1, n_out).swapaxes(-1, -2), 0)


def by_output(level, n_in: int) -> np.ndarray:
    """(pos, freq, out) as a factor of vec(G): (pos, freq, vec)."""
    return np.tile(level, n_in)


def residual_level(estimate: Estimate, spectra: Spectra) -> np.ndarray:
    """Variance of what G U leaves of an output in one experiment, averaged over the window: (pos, freq, out).

    The residual is too small by what the estimate has adapted to the data: its own variance."""
    U, Y = np.asarray(spectra.U), np.asarray(spectra.Y)
    rest = np.mean(squares(Y - np.einsum("pfoi,pefi->pefo", estimate.G, U)), axis=1)
    adapted = np.einsum("pfoi,pefi->pfo", variance_of(estimate.cov, spectra.n_out), np.abs(U) ** 2) / U.shape[1]
    reach = np.round(np.asarray(estimate.window) / 2).astype(int)
    return running_mean(rest + np.nan_to_num(adapted), reach)


def noise_level(G, spectra: Spectra) -> np.ndarray:
    """Variance of Y - G U in one experiment that the scatter between periods shows: (pos, freq, out)."""
    eye = np.broadcast_to(np.eye(G.shape[-2]), (*G.shape[:-1], G.shape[-2]))
    effect = np.concatenate([eye, -np.asarray(G)], axis=-1)
    noise = np.mean(np.asarray(spectra.noise), axis=1)
    return np.maximum(np.einsum("pfos,pfst,pfot->pfo", effect, noise, effect.conj()).real, 0)


def _with_noise(estimate: Estimate, spectra: Spectra) -> Estimate:
    if estimate.cov_noise is not None or spectra.noise is None:
        return estimate
    reach = np.round(np.asarray(estimate.window) / 2).astype(int)
    noise = running_mean(noise_level(estimate.G, spectra), reach)
    level = residual_level(estimate, spectra)
    share = np.clip(np.divide(noise, level, out=np.ones_like(noise), where=level > 0), 0, 1)
    return dataclasses.replace(estimate, cov_noise=scaled(estimate.cov, by_output(np.sqrt(share), spectra.n_in)))


def _with_noise_only(estimate: Estimate, spectra: Spectra) -> Estimate:
    if estimate.cov_noise is None:
        return estimate
    unknown = (np.asarray(estimate.status) & int(Status.NO_COVARIANCE)) != 0
    if not unknown.all() or not np.isfinite(variances(estimate.cov_noise)).any():
        return estimate
    status = np.asarray(estimate.status) & ~int(Status.NO_COVARIANCE) | int(Status.NOISE_ONLY)
    dof = np.full(status.shape, float(spectra.n_exp * (spectra.n_periods - 1)))
    return dataclasses.replace(estimate, cov=estimate.cov_noise, dof=dof, status=status)


def _with_bias(estimate: Estimate, spectra: Spectra, method: AbstractMethod) -> Estimate:
    if not uses_windows(method) or not spectra.periodic or spectra.n_exp < spectra.n_in:
        return estimate
    Z = spectra.R if uses_reference(method) else spectra.U
    pointwise, weight, rest = _pointwise(spectra, np.asarray(Z))
    own = np.nan_to_num(variance_of(estimate.cov, spectra.n_out))
    if rest is None:
        rest = residual_level(estimate, spectra)
    variance = rest[..., :, None] * weight[..., None, :]
    apart = np.maximum(np.abs(variance - own), _LEAST * np.minimum(variance, own))
    difference = variance if _averages_single(method, spectra) else apart
    usable = np.isfinite(pointwise) & (difference > 0)
    excess = np.where(usable, squares(estimate.G - pointwise) / np.where(usable, difference, 1.0), 0.0)
    excess = (1 - _OTHERS) * excess + _OTHERS * excess.mean(axis=(-2, -1), keepdims=True)
    reach = np.maximum(np.asarray(estimate.window) // _NEAR, _LEAST_NEAR).astype(int)
    found = np.maximum(running_mean(excess, reach) - 1, 0)
    doubt = _DOUBT / np.sqrt(2 * reach + 1)[..., None, None]
    power = found**3 / (found**2 + doubt**2) * np.where(usable, difference, 0.0)
    unseen = _UNSEEN * np.where(usable, apart, 0.0) if has_fractions(method) and spectra.n_exp > spectra.n_in else 0.0
    more = (power + unseen).swapaxes(-1, -2).reshape(*power.shape[:2], -1)
    return dataclasses.replace(estimate, cov=Widened(estimate.cov, more), bias=np.sqrt(power + unseen))


def _averages_single(method: AbstractMethod, spectra: Spectra) -> bool:
    """Whether the estimate is a mean over blocks of fewer experiments than inputs.

    The variance of the difference between an estimate and a noisier one is the difference of their variances only where
    the noisier one says nothing that the other does not know. Such means throw away what experiments tell together:
    the error that they share with the pointwise estimate is half of their variance (2 and 4 inputs, tuning plants of
    `benchmarks/bench_coverage.py`: the mean square of the difference is .9-1.2 of the pointwise variance)."""
    size = method.block_size(spectra)
    return isinstance(method, AbstractAverage) and size < spectra.n_in and spectra.n_exp >= 2 * size


def _pointwise(spectra: Spectra, Z):
    """G = Y Z^H (U Z^H)^-1 at every line; the variance of its columns over that of one output; and the latter, (pos,
    freq, out), where experiments are left over to tell it."""
    U, Y, Z = (np.moveaxis(np.asarray(X), 1, -1) for X in (spectra.U, spectra.Y, Z))
    H = Z.conj().swapaxes(-1, -2)
    # Units of channels do not matter, lines at which one has no power do.
    size_u, size_z = (channel_size(X, (1, 3))[:, :, :, 0] for X in (U, Z))
    product = U @ H / (size_u[..., :, None] * size_z[..., None, :])
    inverse, singular = _inverse(product)
    influence = H / size_z[..., None, :] @ inverse / size_u[..., None, :]  # (exp, in)
    G = np.where(singular[..., None, None], np.nan, Y @ influence)
    weight = np.sum(squares(influence), axis=-2)
    left = spectra.n_exp - spectra.n_in
    if left < 1:
        return G, weight, None
    rest = np.sum(squares(Y - np.nan_to_num(G) @ U), axis=-1) / left
    return G, weight, running_mean(rest, _NOISE_LINES)


def _inverse(A) -> tuple[np.ndarray, np.ndarray]:
    """Of every line, and which are singular or nearly: they have 1 for an inverse."""
    one = np.eye(A.shape[-1])
    singular = ~np.isfinite(A).all(axis=(-2, -1))
    A = np.where(singular[..., None, None], one, A)
    with np.errstate(all="ignore"):
        try:
            inverse = np.linalg.inv(A)
        except np.linalg.LinAlgError:  # for all lines, where one is exactly singular
            singular |= ~(np.linalg.cond(A) < _SINGULAR)
            inverse = np.linalg.inv(np.where(singular[..., None, None], one, A))
        sizes = [np.sqrt(np.sum(squares(X), axis=(-2, -1))) for X in (A, inverse)]
        singular |= ~(sizes[0] * sizes[1] < _SINGULAR)
    return np.where(singular[..., None, None], one, inverse), singular
