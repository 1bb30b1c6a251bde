"""Products and inverses of small complex matrices, by the thousand."""

import jax
import jax.numpy as jnp

_UNROLLED = 48


def product(A, B):
    """A B of small complex matrices, as the sum of outer products.

    Under `vmap`, XLA's own product of complex matrices on a CPU takes three times as long: it has no BLAS call there.
    The barrier keeps a product from being computed again for every element of what is made of it.
    """
    n = A.shape[-1]
    if n > _UNROLLED:
        return A @ B
    return jax.lax.optimization_barrier(sum(A[..., :, k, None] * B[..., k, None, :] for k in range(n)))


def inverse(A):
    """A^-1 (n, n); NaN where it is singular or not finite."""
    found = jnp.linalg.inv(A)
    finite = jnp.isfinite(found).all(axis=(-2, -1), keepdims=True)
    return jax.lax.optimization_barrier(jnp.where(finite, found, jnp.nan))


def adjoint(A):
    return A.conj().mT
