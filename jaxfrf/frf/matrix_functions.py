"""Functions of square matrices: by their eigenvalues, with derivatives; the exponential by its series."""

import functools
import math
import operator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._threads import shared
from .._types import Array
from . import lanes
from .inverse import squares
from .lanes import Lanes


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def matrix_functions(
    f, A: Complex[Array, "line n n"]
) -> tuple[Complex[Array, "*function line n n"], Complex[Array, "line n"], Float[Array, "line"]]:
    """V diag(f(lambda)) V^-1 for A = V diag(lambda) V^-1 of every line, the eigenvalues, and the condition of V
    (Frobenius norm).

    `f` need not be holomorphic; it is applied element by element, and may return several functions, stacked along
    leading axes. NaN where V is singular. The derivative is that of Daleckii & Krein (1965): divided differences of f
    between the eigenvalues.
    """
    values, V, V_inverse = _eigen(A)
    return _composed(f(values), V, V_inverse), values, _norm(V) * _norm(V_inverse)


@matrix_functions.defjvp
def _derivative(f, primals, tangents):
    values, V, V_inverse = _eigen(primals[0])
    condition = _norm(V) * _norm(V_inverse)
    turned = V_inverse @ tangents[0] @ V
    along = jnp.diagonal(turned, axis1=1, axis2=2)
    at, slope = jax.jvp(f, (values,), (jnp.ones_like(values),))
    gap = values[:, :, None] - values[:, None]
    near = jnp.abs(gap) <= 1e-12 * jnp.max(jnp.abs(values), axis=1)[:, None, None]
    change = (at[..., :, None] - at[..., None, :]) / jnp.where(near, 1.0, gap)
    divided = jnp.where(near, slope[..., None, :], change)
    _, own = jax.jvp(f, (values,), (along,))
    change = jnp.where(jnp.eye(values.shape[1], dtype=bool), own[..., None, :], divided * turned)
    result = (_composed(at, V, V_inverse), values, condition)
    return result, (V @ change @ V_inverse, along, jnp.zeros_like(condition))


def _eigen(A):
    values, V = jax.lax.platform_dependent(A, cpu=lambda a: tuple(jnp.linalg.eig(a)), default=eigen_on_host)
    return values, V, lanes.lines(lanes.of_lines(V).inverse, len(V))


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
    """V diag(values) V^-1 of every line, for one set of values or several."""
    n_line, left, right = len(V), lanes.of_lines(V), lanes.of_lines(V_inverse)
    every = values.reshape(-1, *values.shape[-2:])
    found = [(left * lanes.of_lines(each[:, None])).times(right) for each in every]
    return jnp.stack([lanes.lines(A, n_line) for A in found]).reshape(*values.shape[:-2], *V.shape)


def _norm(A):
    return jnp.sqrt(jnp.sum(squares(A), axis=(-2, -1)))


_BLOCK = 256  # matrices that one core takes: some 20 ms
_TERMS = 12  # of the series: where the norm is 1/2 at most, the next are below 4e-14
_LEAST = 1e-60  # square of an element over the largest: smaller ones tell no ratio
_OFTEN = 5  # squarings that are enough for norms up to 16
_SQUARINGS = 10  # norms up to 512, once the mean eigenvalue is taken off: a logarithm's are some tens


def exponentials(
    A: Complex[Array, "line n n"],
) -> tuple[Complex[Array, "line n n"], Float[Array, "line"]]:
    """e^A of every line, and the norm of what the series takes: A balanced, less its mean eigenvalue (Frobenius), to be
    below 512.

    The Taylor series of A/2^s, squared s times (Moler & Van Loan, SIAM Review 45, 2003, method 3): a quarter of the
    time of eigenvalues, and accurate where eigenvectors are parallel. Channels of other units turn A into
    diag(d) A diag(1/d): that is taken off before and put back behind."""
    n_line, n = A.shape[:2]
    mean, scale = jnp.trace(A, axis1=1, axis2=2)[:, None, None] / n, _units(A)[:, None]
    A = (A - mean * jnp.eye(n)) * (scale / scale.mT)
    norm = _norm(A)
    times = jnp.ceil(jnp.clip(jnp.log2(jnp.maximum(2.0 * jax.lax.stop_gradient(norm), 1.0)), 0.0, _SQUARINGS))
    result = _squared(_series(lanes.of_lines(A / 2.0 ** times[:, None, None])), lanes.of_numbers(times))
    return jnp.exp(mean) * lanes.lines(result, n_line) * (scale.mT / scale), norm


def _series(A: Lanes) -> Lanes:
    """1 + A + ... + A^12/12!, by powers of A^3."""
    second = A.times(A)
    third, powers = A.times(second), (lanes.identity(A), A, second)

    def block(first: int) -> Lanes:
        terms = [powers[k] * (1 / math.factorial(first + k)) for k in range(3) if first + k <= _TERMS]
        return functools.reduce(operator.add, terms)

    *others, last = range(0, _TERMS + 1, 3)
    return functools.reduce(lambda result, first: result.times(third) + block(first), reversed(others), block(last))


def _squared(A: Lanes, times: Float[Array, "group 1 1 lane"]) -> Lanes:
    """A^(2^times)."""

    def once(step, X):
        return jax.tree.map(lambda new, old: jnp.where(step < times, new, old), X.times(X), X)

    def several(first, last, X):
        return jax.lax.fori_loop(first, last, once, X)

    X = several(0, _OFTEN, A)
    return jax.lax.cond(jnp.any(times > _OFTEN), lambda X: several(_OFTEN, _SQUARINGS, X), lambda X: X, X)


def _units(A) -> Float[Array, "line n"]:
    """The d for which diag(1/d) A diag(d) has rows as large as columns, by the mean logarithm of elements' ratios,
    where that makes A smaller; powers of 2, so that nothing is rounded."""
    A = jax.lax.stop_gradient(A)
    size = squares(A)
    least = _LEAST * size.max(axis=(1, 2), keepdims=True) + _LEAST
    told = (size > least) & (size.mT > least)
    logs = jnp.where(told, jnp.log2(jnp.maximum(size, least)), 0.0)
    d = jnp.exp2(jnp.round(0.25 * jnp.sum(logs - logs.mT, axis=2) / jnp.maximum(told.sum(axis=2), 1)))
    better = jnp.sum(size * jnp.square(d[:, None] / d[:, :, None]), axis=(1, 2)) < jnp.sum(size, axis=(1, 2))
    return jnp.where(better[:, None], d, 1.0)


LARGEST_NORM = 0.5 * np.exp2(_SQUARINGS)
