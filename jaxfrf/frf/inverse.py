"""Products and inverses of small matrices of which single ones in a batch may be singular."""

import jax.numpy as jnp
from jax.lax import linalg


def inverse(A):
    """A^-1 (n, n); NaN where it is singular or not finite."""
    found = jnp.linalg.inv(A)
    finite = jnp.isfinite(found).all(axis=(-2, -1), keepdims=True)
    return jnp.where(finite, found, jnp.nan)


def positive_inverse(A):
    """A^-1 of a positive definite (n, n), in half of the time; NaN where it is not."""
    L = linalg.cholesky(A, symmetrize_input=False)
    found = linalg.triangular_solve(L, jnp.eye(len(A), dtype=A.dtype), left_side=True, lower=True)
    return product(adjoint(found), found)


def product(A, B):
    """A B of a few rows and columns: for a batch of them XLA's own product takes twice as long on a CPU."""
    return jnp.sum(A[:, :, None] * B, axis=1)


def adjoint(A):
    return A.conj().mT
