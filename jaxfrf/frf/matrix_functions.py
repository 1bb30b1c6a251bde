"""Functions of square matrices: by their eigenvalues, with derivatives; the exponential by its series."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._threads import shared
from .._types import Array
from .inverse import inverse, product


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
    values, V = jax.lax.platform_dependent(A, cpu=lambda a: tuple(jnp.linalg.eig(a)), default=eigen_on_host)
    return values, V, inverse(V)


def eigen_on_host(A: Complex[Array, "n n"]) -> tuple[Complex[Array, " n"], Complex[Array, "n n"]]:
    """Eigenvalues and eigenvectors by the processor, of a whole batch at once: a GPU takes one matrix after the other,
    and ten times as long."""
    like = jax.ShapeDtypeStruct(A.shape[:-1], A.dtype), jax.ShapeDtypeStruct(A.shape, A.dtype)
    return jax.pure_callback(_eigen_of_each, like, A, vmap_method="expand_dims")


def _eigen_of_each(A):
    """NaN where an element is no number, as XLA has it; NumPy raises."""
    A = np.asarray(A)
    finite = np.isfinite(A).all(axis=(-2, -1))[..., None]
    known = np.where(finite[..., None], A, np.eye(A.shape[-1])).reshape(-1, *A.shape[-2:])
    blocks = [known[k : k + _BLOCK] for k in range(0, len(known), _BLOCK)]
    values, V = (np.concatenate(x) for x in zip(*shared(np.linalg.eig, blocks), strict=True))
    return np.where(finite, values.reshape(A.shape[:-1]), np.nan), np.where(
        finite[..., None], V.reshape(A.shape), np.nan
    )


def _composed(values, V, V_inverse):
    return (V * values[..., None, :]) @ V_inverse


_BLOCK = 256  # matrices that one core takes: some 20 ms
_TERMS = 12  # of the series: where the norm is 1/2 at most, the next are below 4e-14
_LEAST = 1e-60  # square of an element over the largest: smaller ones tell no ratio
_SQUARINGS = 10  # norms up to 512, once the mean eigenvalue is taken off: a logarithm's are some tens


def exponential(A: Complex[Array, "n n"]) -> tuple[Complex[Array, "n n"], Float[Array, ""]]:
    """e^A, and the norm of what the series takes: A balanced, less its mean eigenvalue (Frobenius), to be below 512.

    The Taylor series of A/2^s, squared s times (Moler & Van Loan, SIAM Review 45, 2003, method 3): a quarter of the
    time of eigenvalues, and accurate where eigenvectors are parallel. Channels of other units turn A into
    diag(d) A diag(1/d): that is taken off before and put back behind."""
    n = A.shape[-1]
    mean, scale = jnp.trace(A) / n, _units(A)
    A = (A - mean * jnp.eye(n)) * (scale / scale[:, None])
    norm = jnp.sqrt(jnp.sum(jnp.square(A.real) + jnp.square(A.imag)))
    times = jnp.ceil(jnp.clip(jnp.log2(jnp.maximum(2.0 * jax.lax.stop_gradient(norm), 1.0)), 0.0, _SQUARINGS))
    A = A / 2.0**times
    second = product(A, A)
    third, powers = product(A, second), (jnp.eye(n, dtype=A.dtype), A, second)
    result: Array = jnp.zeros_like(A)
    for first in reversed(range(0, _TERMS + 1, 3)):
        terms = [powers[k] / math.factorial(first + k) for k in range(3) if first + k <= _TERMS]
        block = jnp.sum(jnp.stack(terms), axis=0)
        result = block if first + 3 > _TERMS else product(result, third) + block

    def squared(step, X):
        return jnp.where(step < times, product(X, X), X)

    result = jax.lax.fori_loop(0, _SQUARINGS, squared, result)
    return jnp.exp(mean) * result * (scale[:, None] / scale), norm


def _units(A) -> Float[Array, " n"]:
    """The d for which diag(1/d) A diag(d) has rows as large as columns, by the median of their elements' ratios, where
    that makes A smaller; powers of 2, so that nothing is rounded."""
    A = jax.lax.stop_gradient(A)
    size = jnp.square(A.real) + jnp.square(A.imag)
    logs = jnp.log2(jnp.maximum(size, _LEAST * size.max() + _LEAST))
    d = jnp.exp2(jnp.round(0.25 * jnp.median(logs - logs.T, axis=1)))
    better = jnp.sum(size * jnp.square(d / d[:, None])) < jnp.sum(size)
    return jnp.where(better, d, 1.0)


LARGEST_NORM = 0.5 * np.exp2(_SQUARINGS)
