"""Small complex matrices of many lines at once, as the vector units of a processor take them.

Eight neighbouring lines lie innermost, real and imaginary parts apart, so that a product is made of multiplications of
whole registers: a third of the time that complex matrices of one line after the other take. Every operation's result
is written down (`apart`), as XLA would otherwise work it out anew wherever the next one reads it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._compile import apart
from .._types import Array

_LANES = 8  # lines side by side; of more, matrices leave the innermost cache
_TERMS = 16  # of a sum that are written out; longer ones go round
_ROW, _COLUMN = 1, 2  # axes


class Lanes(eqx.Module):
    """Matrices of groups of neighbouring lines, by real and imaginary parts. The last group is filled up by repeats of
    the last line."""

    real: Float[Array, "group row col lane"]
    imag: Float[Array, "group row col lane"]

    def __add__(self, other: "Lanes") -> "Lanes":
        return Lanes(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: "Lanes") -> "Lanes":
        return Lanes(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: "Lanes | float") -> "Lanes":
        """Element by element."""
        if not isinstance(other, Lanes):
            return Lanes(self.real * other, self.imag * other)
        real = self.real * other.real - self.imag * other.imag
        return Lanes(real, self.real * other.imag + self.imag * other.real)


def of_signal(X: Complex[Array, "exp line channel"]) -> Lanes:
    """A signal as matrices (channel, exp): experiments side by side as columns."""
    return of_lines(X.transpose(1, 2, 0))


def of_lines(X: Complex[Array, "line row col"]) -> Lanes:
    """Matrices of every line."""
    missing = -len(X) % _LANES
    X = jnp.pad(X, ((0, missing), (0, 0), (0, 0)), mode="edge") if missing else X
    X = X.reshape(-1, _LANES, *X.shape[1:]).transpose(0, 2, 3, 1)
    return Lanes(X.real, X.imag)


def of_numbers(x: Float[Array, "line"]) -> Float[Array, "group 1 1 lane"]:
    """A number of every line, beside the numbers of matrices."""
    return of_lines(x[:, None, None]).real


def identity(like: Lanes) -> Lanes:
    """1 in every line."""
    one = jnp.broadcast_to(jnp.eye(like.real.shape[1])[:, :, None], like.real.shape)
    return Lanes(one, jnp.zeros_like(one))


def lines(A: Lanes, n_line: int) -> Complex[Array, "line row col"]:
    """The matrices line by line."""
    X = jax.lax.complex(A.real, A.imag).transpose(0, 3, 1, 2)
    return X.reshape(-1, *X.shape[2:])[:n_line]


def some_lines(A: Lanes, which: np.ndarray) -> Complex[Array, "chosen row col"]:
    """The matrices of some lines."""
    group, lane = np.divmod(which, _LANES)
    return jax.lax.complex(A.real[group, :, :, lane], A.imag[group, :, :, lane])


@apart
def product(A: Lanes, B: Lanes) -> Lanes:
    """A B."""
    return _sum(A, _COLUMN, B, _ROW)


@apart
def adjoint_times(A: Lanes, B: Lanes) -> Lanes:
    """A^H B."""
    return _sum(A, _ROW, B, _ROW)


@apart
def times_adjoint(A: Lanes, B: Lanes) -> Lanes:
    """A B^H."""
    return _sum(A, _COLUMN, B, _COLUMN)


@apart
def squares(A: Lanes) -> Float[Array, "group row lane"]:
    """The sum of squares of every row."""
    total = jnp.zeros((*A.real.shape[:2], _LANES))
    for k in range(A.real.shape[2]):
        total = total + (A.real[:, :, k] ** 2 + A.imag[:, :, k] ** 2)
    return total


def _sum(A: Lanes, over: int, B: Lanes, beside: int) -> Lanes:
    """Over an axis of A and one of B, all products of what is left of both: A B, A^H B, A B^H, by the axes."""
    n, (rows, columns) = A.real.shape[over], (A.real.shape[3 - over], B.real.shape[3 - beside])
    whole = n // _TERMS if n > _TERMS else 0

    def with_next(number, total):
        part = lambda X, axis: jax.tree.map(
            lambda x: jax.lax.dynamic_slice_in_dim(x, number * _TERMS, _TERMS, axis=axis), X
        )
        return _plus_terms(total, part(A, over), over, part(B, beside), beside, range(_TERMS))

    zero = jnp.zeros((len(A.real), rows, columns, _LANES))
    total = jax.lax.fori_loop(0, whole, with_next, Lanes(zero, zero)) if whole else Lanes(zero, zero)
    return _plus_terms(total, A, over, B, beside, range(whole * _TERMS, n))


def _plus_terms(total: Lanes, A: Lanes, over: int, B: Lanes, beside: int, terms) -> Lanes:
    real, imag = total.real, total.imag
    for k in terms:
        a, b = (jax.lax.index_in_dim(x, k, over, keepdims=False)[:, :, None] for x in (A.real, A.imag))
        c, d = (jax.lax.index_in_dim(x, k, beside, keepdims=False)[:, None] for x in (B.real, B.imag))
        if over == beside == _ROW:
            real, imag = real + (a * c + b * d), imag + (a * d - b * c)
        elif over == beside == _COLUMN:
            real, imag = real + (a * c + b * d), imag + (b * c - a * d)
        else:
            real, imag = real + (a * c - b * d), imag + (a * d + b * c)
    return Lanes(real, imag)
