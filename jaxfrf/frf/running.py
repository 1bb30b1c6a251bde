"""Means over neighbouring lines."""

import jax.numpy as jnp
import numpy as np


def running_mean(x, reach):
    """Mean of (pos, freq, ...) over `reach` lines on either side, a number or (pos, freq); NumPy's arrays or JAX's."""
    xp = np if isinstance(x, np.ndarray) else jnp
    n = x.shape[1]
    reach = np.broadcast_to(reach, x.shape[:2])
    line = np.arange(n)
    first, last = np.maximum(line - reach, 0), np.minimum(line + reach + 1, n)
    total = xp.concatenate([xp.zeros_like(x[:, :1]), xp.cumsum(x, axis=1)], axis=1)
    at = np.arange(len(x))[:, None]
    count = (last - first).reshape(*reach.shape, *[1] * (x.ndim - 2))
    return (total[at, last] - total[at, first]) / count
