"""Functions of square matrices by their eigenvalues, with derivatives."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Complex, Float

from .._types import Array
from .inverse import inverse


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def matrix_function(
    f, A: Complex[Array, "n n"]
) -> tuple[Complex[Array, "*function n n"], Complex[Array, " n"], Float[Array, ""]]:
    """V diag(f(lambda)) V^-1 for A = V diag(lambda) V^-1, the eigenvalues, and the condition of V (Frobenius norm).

    `f` need not be holomorphic; it is applied element by element, and may return several functions, stacked along
    leading axes. NaN where V is singular. The derivative is that of Daleckii & Krein (1965): divided differences of f
    between the eigenvalues.
    """
    values, V, V_inverse = _eigen(A)
    return _composed(f(values), V, V_inverse), values, jnp.linalg.norm(V) * jnp.linalg.norm(V_inverse)


@matrix_function.defjvp
def _derivative(f, primals, tangents):
    values, V, V_inverse = _eigen(primals[0])
    condition = jnp.linalg.norm(V) * jnp.linalg.norm(V_inverse)
    turned = V_inverse @ tangents[0] @ V
    along = jnp.diagonal(turned)
    at, slope = jax.jvp(f, (values,), (jnp.ones_like(values),))
    gap = values[:, None] - values[None]
    near = jnp.abs(gap) <= 1e-12 * jnp.max(jnp.abs(values))
    divided = jnp.where(near, slope[..., None, :], (at[..., :, None] - at[..., None, :]) / jnp.where(near, 1.0, gap))
    _, own = jax.jvp(f, (values,), (along,))
    change = jnp.where(jnp.eye(len(values), dtype=bool), own[..., None, :], divided * turned)
    result = (_composed(at, V, V_inverse), values, condition)
    return result, (V @ change @ V_inverse, along, jnp.zeros_like(condition))


def _eigen(A):
    values, V = jnp.linalg.eig(A)
    return values, V, inverse(V)


def _composed(values, V, V_inverse):
    return (V * values[..., None, :]) @ V_inverse
