"""A first look at whether experiments are of one noise, which costs little beside any estimate."""

import functools

import jax.numpy as jnp
import numpy as np

from .running import running_mean

_LINES, _TOLD_BY = 48, 288  # lines that it is taken at; lines times outputs that are enough for it
_ALIKE = 1.5  # ratio of two experiments' noise power, up to which they are taken for alike
_SHOWN = 0.1  # of an experiment's noise, that its residuals must show for that: one may be so loud that G follows it
_NEAR = 4  # lines on either side, over which the noise of a line is averaged
_LEAST = 1e-9  # of all degrees of freedom: as few are none


def few_lines(n_freq: int, n_out: int):
    """Lines that are enough, spread over the band."""
    return spread_lines(n_freq, min(_LINES, max(_TOLD_BY // n_out, 1)))


@functools.cache
def spread_lines(n_freq: int, most: int):
    """At most so many of the lines, spread over the band."""
    return np.unique(np.linspace(0, n_freq - 1, most).astype(int))


def looks_alike(left, free):
    """Whether experiments look it: False is no verdict, `jaxfrf.frf.weighed` asks further.

    **Arguments:** arrays of NumPy or JAX: `left`, the power that every experiment leaves of an output, (freq, out,
    exp); `free`, the share of its noise that it leaves there, one less its leverage, (freq, exp)."""
    power = power_left(left, free)
    shown = _where_finite(free).mean(axis=0)
    return (shown.min() > _SHOWN) & (power.max() > 0.0) & (power.max() < _ALIKE * power.min())


def power_left(left, free):
    """Power that experiments leave over their share of the degrees of freedom, in units of what lines around leave."""
    xp = np if isinstance(left, np.ndarray) else jnp
    left, free = _where_finite(left), _where_finite(free)
    usual = running_mean(left.mean(axis=2)[None], _NEAR)[0]
    power = (left / xp.where(usual > 0, usual, 1.0)[..., None]).mean(axis=1).sum(axis=0)
    return power / xp.maximum(free.sum(axis=0), _LEAST * len(free))


def _where_finite(x):
    xp = np if isinstance(x, np.ndarray) else jnp
    return xp.where(xp.isfinite(x), x, 0.0)
