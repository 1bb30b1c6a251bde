"""Uniform random numbers from a JAX key, the same in 32 and in 64 bit."""

import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._arguments import as_key


def uniform(key: PRNGKeyArray, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Float64 numbers in [0, 1), drawn on the host from a generator that the key seeds.

    A seed so means the same signal whether or not JAX runs in 64 bit, and no shape has to be compiled.
    """
    return np.random.default_rng(np.asarray(jr.key_data(as_key("key", key)))).random(shape)
