"""What every estimation method is."""

import abc
import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float, Int

from .._types import Array
from ..spectra import Spectra, changed_signals


class KroneckerSum(eqx.Module):
    """Covariances sum_t S_t (x) C_t kept as factors: (*batch, term, in, in) and (*batch, term, out, out).

    A full covariance of a 6 x 6 response takes 20 kB a line, its factors one.
    """

    left: Complex[Array, "*batch term in in"]
    right: Complex[Array, "*batch term out out"]

    def dense(self) -> Complex[Array, "*batch vec vec"]:
        """Covariance of vec(G), columns stacked."""
        left, right = np.asarray(self.left), np.asarray(self.right)
        if left.shape[-3] == 1:
            cov = left[..., 0, :, None, :, None] * right[..., 0, None, :, None, :]
        else:
            cov = np.einsum("...tab,...tij->...aibj", left, right)
        return cov.reshape(*left.shape[:-3], left.shape[-1] * right.shape[-1], -1)

    def diagonal(self) -> Float[Array, "*batch vec"]:
        """Variances of vec(G)."""
        left, right = (np.diagonal(np.asarray(x), axis1=-2, axis2=-1) for x in (self.left, self.right))
        return np.sum(left[..., :, None] * right[..., None, :], axis=-3).real.reshape(*left.shape[:-2], -1)


class Estimate(eqx.Module):
    """What a method returns; the fields mean the same as those of `jaxfrf.FRF`."""

    G: Complex[Array, "pos freq out in"]
    cov: KroneckerSum | Complex[Array, "pos freq vec vec"]
    dof: Float[Array, "pos freq"]
    status: Int[Array, "pos freq"]
    window: Float[Array, "pos freq"]
    cov_noise: Complex[Array, "pos freq vec vec"] | None = None
    cov_total: Complex[Array, "pos freq vec vec"] | None = None


def dense(cov) -> Array:
    """A covariance as an array, whichever way it is kept."""
    return cov.dense() if isinstance(cov, KroneckerSum) else cov


def variances(cov) -> Array:
    """The diagonal of a covariance, whichever way it is kept."""
    return cov.diagonal() if isinstance(cov, KroneckerSum) else np.diagonal(cov, axis1=-2, axis2=-1).real


class AbstractMethod(eqx.Module):
    """A way of estimating an FRF from spectra; its fields are its options. Passed to `jaxfrf.estimate`."""

    @abc.abstractmethod
    def estimate(self, spectra: Spectra) -> Estimate:
        """The estimate at every operating point and line, from all experiments there."""

    @abc.abstractmethod
    def check(self, spectra: Spectra) -> None:
        """Raise `jaxfrf.InputError` if the method cannot be used on these spectra."""

    @abc.abstractmethod
    def block_size(self, spectra: Spectra) -> int:
        """Experiments that one estimate needs at least: the block over which averaging methods average."""


def split_blocks(spectra: Spectra, size: int) -> Spectra:
    """Blocks of `size` experiments as operating points of their own: (pos*block, size, freq, channel)."""
    n_block = spectra.n_exp // size

    def split(x):
        x = np.asarray(x)[:, : n_block * size]
        return x.reshape(-1, size, *x.shape[2:])

    return dataclasses.replace(spectra, **changed_signals(spectra, split), q=None)
