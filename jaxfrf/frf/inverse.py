"""Inverses of matrices of which single ones in a batch may be singular."""

import jax.numpy as jnp


def inverse(A):
    """A^-1 (n, n); NaN where it is singular or not finite."""
    found = jnp.linalg.inv(A)
    finite = jnp.isfinite(found).all(axis=(-2, -1), keepdims=True)
    return jnp.where(finite, found, jnp.nan)


def adjoint(A):
    return A.conj().mT
