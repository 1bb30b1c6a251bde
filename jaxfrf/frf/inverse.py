"""Products and inverses of small matrices of which single ones in a batch may be singular, squares of elements."""

import jax.numpy as jnp
import numpy as np
from jax.lax import linalg


def inverse(A):
    """A^-1 (n, n); NaN where it is singular or not finite."""
    LU, pivots, _ = linalg.lu(A)
    half = linalg.triangular_solve(LU, _swapped(pivots, A.dtype), left_side=True, lower=True, unit_diagonal=True)
    found = linalg.triangular_solve(LU, half, left_side=True, lower=False)
    finite = jnp.isfinite(found).all(axis=(-2, -1), keepdims=True)
    return jnp.where(finite, found, jnp.nan)


def _swapped(pivots, dtype):
    """The identity with its rows swapped as LAPACK says, one after the other: XLA has a loop for it that takes as long
    as the factorisation."""
    place = np.arange(len(pivots))
    row = jnp.asarray(place)
    for k, other in enumerate(pivots):
        there = jnp.sum(jnp.where(place == other, row, 0))
        row = jnp.where(place == k, there, jnp.where(place == other, row[k], row))
    return (row[:, None] == place).astype(dtype)


def positive_half_inverse(A):
    """F, F^H F = A^-1 of a positive definite (n, n); NaN where it is not."""
    L = linalg.cholesky(A, symmetrize_input=False)
    return linalg.triangular_solve(L, jnp.eye(len(A), dtype=A.dtype), left_side=True, lower=True)


def product(A, B):
    """A B of a few rows and columns: for a batch of them XLA's own product takes twice as long on a CPU."""
    return jnp.sum(A[..., :, :, None] * B[..., None, :, :], axis=-2)


def adjoint(A):
    return A.conj().mT


def squares(X):
    """|X|^2 of every element of an array, NumPy's or JAX's, without the root that `abs` takes."""
    return X.real**2 + X.imag**2
