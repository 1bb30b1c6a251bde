"""Functions of square matrices: by their eigenvalues, with derivatives; the exponential by its series."""

import functools
import math
import operator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from .._device import on_accelerator
from .._threads import shared
from .._types import Array
from . import eigen, lanes
from .complex_parts import square
from .inverse import squares
from .lanes import Lanes


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def matrix_functions(
    functions: tuple, A: Complex[Array, "line n n"], which: int | Int[Array, ""]
) -> tuple[Complex[Array, "*function line n n"], Complex[Array, "line n"], Float[Array, "line"]]:
    """V diag(f(lambda)) V^-1 for A = V diag(lambda) V^-1 of every line, the eigenvalues, and the condition of V
    (Frobenius norm).

    f is that one of `functions` whose number is `which`. It need not be holomorphic; it is applied element by element,
    and may return several functions, stacked along leading axes, the others as many: a program that takes them in turn
    need not have eigenvalues, which take long to compile, twice. NaN where V is singular. The derivative is that of
    Daleckii & Krein (1965): divided differences of f between the eigenvalues.
    """

    def of_group(group: Lanes):
        values, V, V_inverse = _eigen(group)

        def composed(f):
            found = f(jax.lax.complex(*values))
            each = [_composed(one, V, V_inverse).by_window for one in found.reshape(-1, *values.shape[1:])]
            every = jnp.stack(each).reshape(*found.shape[:-2], *each[0].shape)
            return jnp.moveaxis(every, -3, 0)

        found = jax.lax.switch(which, [functools.partial(composed, f) for f in functions])
        return found, jax.lax.complex(*values).T, _norm(V) * _norm(V_inverse)

    found, values, condition = _of_groups(of_group, A)
    return jnp.moveaxis(found, 0, -3), values, condition


@matrix_functions.defjvp
def _derivative(functions, primals, tangents):
    A, which = primals
    values, V, V_inverse, condition = _of_groups(_known, A)
    turned = V_inverse @ tangents[0] @ V
    along = jnp.diagonal(turned, axis1=1, axis2=2)

    def f(values):
        return jax.lax.switch(which, functions, values)

    at, slope = jax.jvp(f, (values,), (jnp.ones_like(values),))
    gap = values[:, :, None] - values[:, None]
    near = jnp.abs(gap) <= 1e-12 * jnp.max(jnp.abs(values), axis=1)[:, None, None]
    change = (at[..., :, None] - at[..., None, :]) / jnp.where(near, 1.0, gap)
    divided = jnp.where(near, slope[..., None, :], change)
    _, own = jax.jvp(f, (values,), (along,))
    change = jnp.where(jnp.eye(values.shape[1], dtype=bool), own[..., None, :], divided * turned)
    result = ((V * at[..., None, :]) @ V_inverse, values, condition)
    return result, (V @ change @ V_inverse, along, jnp.zeros_like(condition))


def _known(group: Lanes):
    """What derivatives need, line by line."""
    values, V, V_inverse = _eigen(group)
    return jax.lax.complex(*values).T, V.by_window, V_inverse.by_window, _norm(V) * _norm(V_inverse)


def _of_groups(function, A: Complex[Array, "line n n"]):
    """`function` of some lines after the others, each result with lines in front."""
    n_line, n = A.shape[:2]
    few = is_small(n) and not on_accelerator()
    groups = lanes.of_lines(A, lanes.lane_count(n_line, n**2, eigen.ELEMENTS) if few else n_line)
    found = jax.lax.map(lambda parts: function(Lanes(parts)), jnp.moveaxis(groups.parts, 1, 0))
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:n_line], found)


def is_small(n_row: int) -> bool:
    """Whether eigenvalues of so many rows are found here, and not by LAPACK."""
    return lanes.in_registers(n_row)


def _eigen(A: Lanes) -> eigen.Eigen:
    by_lapack = functools.partial(_by_library, lambda A: tuple(jnp.linalg.eig(A)))
    on_cpu = eigen.eigen if is_small(A.shape[0]) else by_lapack
    return jax.lax.platform_dependent(A, cpu=on_cpu, default=functools.partial(_by_library, eigen_on_host))


def _by_library(function, A: Lanes) -> eigen.Eigen:
    values, V = function(A.by_window)
    V = lanes.of_lines(V, A.n_lane).at(0)
    return eigen.Eigen(jnp.stack([values.T.real, values.T.imag]), V, V.inverse)


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


def _composed(values: Complex[Array, "n lane"], V: Lanes, V_inverse: Lanes) -> Lanes:
    """V diag(values) V^-1."""
    return (V * Lanes(jnp.stack([values.real, values.imag])[:, None])).times(V_inverse)


def _norm(A: Lanes) -> Float[Array, "lane"]:
    return jnp.sqrt(lanes.total(lanes.total(square(A.parts))))


_BLOCK = 256  # matrices that one core takes: some 20 ms
_TERMS = 12  # of the series: where the norm is 1/2 at most, the next are below 4e-14
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
    norm = jnp.sqrt(jnp.sum(squares(A), axis=(1, 2)))
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
    return eigen.units(jnp.moveaxis(squares(jax.lax.stop_gradient(A)), 0, -1)).T


LARGEST_NORM = 0.5 * np.exp2(_SQUARINGS)
