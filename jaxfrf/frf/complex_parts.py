"""Complex numbers by real and imaginary parts, which are the first axis."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._types import Array

Parts = Float[Array, "2 ..."]


def signs(signs, like: Parts) -> np.ndarray:
    """Of the parts, beside the elements of an array."""
    return np.asarray(signs).reshape(2, *[1] * (like.ndim - 1))


def one(like: Parts) -> np.ndarray:
    return signs([1.0, 0.0], like)


def conjugate(x: Parts) -> Parts:
    return x * signs([1.0, -1.0], x)


def turned(x: Parts) -> Parts:
    """i x."""
    return x[::-1] * signs([-1.0, 1.0], x)


def product(x: Parts, y: Parts) -> Parts:
    """Element by element."""
    return x * y[:1] + turned(x) * y[1:]


def over(x: Parts, y: Parts) -> Parts:
    """x / y, element by element."""
    return product(x, conjugate(y) * (1 / square(y)))


def square(x: Parts) -> Float[Array, "..."]:
    """|x|^2."""
    return jnp.square(x[0]) + jnp.square(x[1])


def size(x: Parts) -> Float[Array, "..."]:
    """|Re x| + |Im x|."""
    return jnp.abs(x[0]) + jnp.abs(x[1])


def root(x: Parts) -> Parts:
    """The square root whose real part is not negative."""
    larger = jnp.sqrt(0.5 * (jnp.sqrt(square(x)) + jnp.abs(x[0])))
    smaller = jnp.abs(x[1]) / jnp.where(larger > 0, 2 * larger, 1.0)
    right = x[0] >= 0
    return jnp.stack([jnp.where(right, larger, smaller), jnp.copysign(jnp.where(right, smaller, larger), x[1])])
