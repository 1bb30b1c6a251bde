"""Eigenvalues and eigenvectors of small complex matrices of many lines at once.

Schur's form by Hessenberg's and QR steps with Wilkinson's shift (Golub & Van Loan, Matrix Computations, 7.5; explicit
shifts, as EISPACK's comqr2), all lines in step until the last is done; eigenvectors from it by substitution. Lines lie
innermost, as many as the cache takes. LAPACK takes one matrix after the other, and its batched calls hand work to
threads that wait for each other.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._compile import apart
from .._types import Array
from .complex_parts import Parts, conjugate, one, over, product, root, size, square
from .lanes import Lanes, identity, total

_EPS = np.finfo(float).eps
_NOTHING = 1e-290  # square of an element, where the largest of the matrix is 1
_STEPS = 30  # of QR for every row, as LAPACK has it: three are usual
_PATIENCE = 5  # steps for every row, behind which what rounding makes of the whole matrix counts no more
_ODD = 10  # every so many steps another shift, which leaves a cycle
ELEMENTS = 4096  # of the matrices that go side by side: with those of their vectors, 130 kB
_LEAST = 1e-60  # square of an element over the largest: smaller ones tell no ratio

_Rotation = Float[Array, "3 lane"]  # cosine, sine's real and imaginary part


class Eigen(NamedTuple):
    """A = V diag(values) V_inverse, columns of V of length one. V is not finite, or of a large condition, where there
    are no n eigenvectors."""

    values: Float[Array, "2 n lane"]
    V: Lanes
    V_inverse: Lanes


def eigen(A: Lanes) -> Eigen:
    """Of one group of lines."""
    backwards = _begins_small(A.parts)
    parts, unit, scale = _balanced(_reversed(A.parts, backwards, (1, 2)))
    T, Q = _schur(parts)
    X = _vectors(T)
    V = _reversed(Lanes(Q).times(Lanes(X)).parts * unit[:, None], backwards, (1,))
    V_inverse = _reversed(Lanes(_inverse_of_triangle(X)).times(Lanes(Q).adjoint).parts / unit, backwards, (2,))
    length = jnp.sqrt(total(square(V)))
    return Eigen(_diagonal(T) * scale, Lanes(V / length), Lanes(V_inverse * length[:, None]))


# Balance --------------------------------------------------------------------------------------------------------------


@apart
def _begins_small(A: Parts):
    """Whether rows and columns are to be taken from the last one on: QR steps find small eigenvalues exactly where the
    small elements are the last ones."""
    return size(A[:, -1, -1]) > size(A[:, 0, 0])


def _reversed(A: Parts, backwards, axes: tuple[int, ...]) -> Parts:
    return jnp.where(backwards, jnp.flip(A, axes), A)


def units(squares: Float[Array, "n n lane"]) -> Float[Array, "n lane"]:
    """The d for which diag(1/d) A diag(d) has rows as large as columns, by the mean logarithm of the ratios of
    elements, whose squares are given, where that makes A smaller; powers of 2, so that nothing is rounded."""
    return _where_smaller(_even(_log_ratios(squares)), squares)


@apart
def _log_ratios(squares):
    """Of every element over the one across the diagonal, NaN where one of them is zero."""
    largest = _largest(squares)
    least = _LEAST * largest + _LEAST
    logs = jnp.where(squares > least, jnp.log2(squares), jnp.nan)
    return logs - logs.swapaxes(0, 1)


@apart
def _even(ratios):
    told = ~jnp.isnan(ratios)
    whole = total(jnp.where(told, ratios, 0.0).swapaxes(0, 1))
    return _power_of_two(0.25 * whole / jnp.maximum(total(told.astype(float).swapaxes(0, 1)), 1.0))


@apart
def _where_smaller(d, squares):
    change = jnp.square(d / d[:, None]) - 1.0
    return jnp.where(total(total(squares * change)) < 0.0, d, 1.0)


def _balanced(A: Parts):
    """The matrix in units and of a size that are its own, those units, and the size."""
    scale = _size(A)
    d = units(_squares(A, scale))
    return _in_units(A, d, scale), d, scale


@apart
def _size(A: Parts):
    largest = _largest(size(A))
    return _power_of_two(jnp.log2(jnp.where(largest > 0, largest, 1.0)))


def _largest(x: Float[Array, "n n lane"]) -> Float[Array, "lane"]:
    of_columns = functools.reduce(jnp.maximum, list(x))  # XLA's own loop is not vectorised
    return functools.reduce(jnp.maximum, list(of_columns))


def _power_of_two(exponent):
    """The nearest one; XLA's `exp2` is off by its rounding. 1 where there is no exponent."""
    known = jnp.isfinite(exponent)
    return jnp.ldexp(1.0, jnp.where(known, jnp.round(exponent), 0.0).astype(int))


@apart
def _squares(A: Parts, scale):
    return square(A / scale)


@apart
def _in_units(A: Parts, d, scale) -> Parts:
    return A * (d / (d[:, None] * scale))


# Hessenberg's form ----------------------------------------------------------------------------------------------------


def _hessenberg(A: Parts) -> tuple[Parts, Parts]:
    """H of no elements below the first subdiagonal, but for rounding, and Q of Q^H A Q = H: by Householder's
    reflections."""
    n = A.shape[-2]

    def reflected(k, both):
        v = Lanes(_reflection(both, k))
        H = Lanes(both[:, :n])
        both = jnp.concatenate([(H - v.times(v.adjoint_times(H))).parts, both[:, n:]], axis=1)
        both = Lanes(both)
        return (both - both.times(v).times_adjoint(v)).parts

    both = jax.lax.fori_loop(0, n - 2, reflected, jnp.concatenate([A, identity(Lanes(A)).parts], axis=1))
    return both[:, :n], both[:, n:]


@apart
def _reflection(H: Parts, k) -> Float[Array, "2 row 1 lane"]:
    """v, for which x - v v^H x has only its first element, x being what column k has below the diagonal; zero where x
    is."""
    n = H.shape[-2]
    x = jax.lax.dynamic_index_in_dim(H[:, :n], k, axis=2, keepdims=False)
    x = jnp.where((np.arange(n) > k)[:, None], x, 0.0)
    first = jax.lax.dynamic_index_in_dim(x, k + 1, axis=1, keepdims=False)
    first = _phase(first, square(first)) * jnp.sqrt(total(square(x)))
    v = x + jnp.where((np.arange(n) == k + 1)[:, None], first[:, None], 0.0)
    length = total(square(v))
    some = length > _NOTHING
    return (v * jnp.where(some, jnp.sqrt(2.0 / jnp.where(some, length, 1.0)), 0.0))[:, :, None]


def _phase(x: Parts, squared) -> Parts:
    """x / |x|, and 1 of nothing."""
    nothing = squared <= _NOTHING
    return jnp.where(nothing, one(x), x / jnp.sqrt(jnp.where(nothing, 1.0, squared)))


# Schur's form ---------------------------------------------------------------------------------------------------------


def _schur(A: Parts) -> tuple[Parts, Parts]:
    """T, upper triangular (what is below is not zero), and Q of A = Q T Q^H; NaN where QR steps do not end."""
    n = A.shape[-2]
    H, Q = _hessenberg(A)
    if n == 1:
        return H, Q

    def goes_on(state):
        *_, left, step = state
        return (jnp.max(left) > 0) & (step < _STEPS * n)

    def stepped(state):
        H, Q, left, step = state
        H, Q = _qr_step(H, Q, left, jnp.where(step % _ODD == _ODD - 1, 1.0, 0.0))
        return H, Q, _left(H, jnp.where(step < _PATIENCE * n, 0.0, _EPS)), step + 1

    H, Q, left, _ = jax.lax.while_loop(goes_on, stepped, (H, Q, _left(H, 0.0), 0))
    return jnp.where(jnp.max(left, axis=0) > 0, jnp.nan, H), Q


def _qr_step(H: Parts, Q: Parts, left, odd) -> tuple[Parts, Parts]:
    """R Q + S of H - S = Q R, S being a shift of each line's own, in those rows that are not done: it would round small
    eigenvalues that are."""
    n = H.shape[-2]
    shift = _shift(_last_block(H, _last(left)), odd)[:, None] * _undone(left)
    shifted = _shifted(H, left, shift)
    row, rotations, rows = shifted[:, 0], [], []
    for k in range(n - 1):
        following = shifted[:, k + 1]
        rotation = _rotation(row[:, k], following[:, k])
        rotations.append(_from_right(rotation))
        rows.append(_first(rotation, row, following))
        row = _second(rotation, row, following)
    R = _stacked((*rows, row), -3)
    return _plus_shift(_rotated(R, rotations), shift), _stacked(_rotated(Q, rotations), -2)


def _rotated(A: Parts, rotations) -> tuple[Parts, ...]:
    """The columns of A Q, one after the other."""
    column, columns = A[:, :, 0], []
    for k, rotation in enumerate(rotations):
        columns.append(_first(rotation, column, A[:, :, k + 1]))
        column = _second(rotation, column, A[:, :, k + 1])
    return *columns, column


@apart
def _rotation(a: Parts, b: Parts) -> _Rotation:
    """Of the rotation that takes b off below a."""
    a2, b2 = square(a), square(b)
    none = b2 <= _NOTHING
    length = jnp.sqrt(jnp.where(none, 1.0, a2 + b2))
    cosine = jnp.where(none, 1.0, jnp.where(a2 <= _NOTHING, 0.0, jnp.sqrt(a2) / length))
    sine = jnp.where(none, 0.0, product(_phase(a, a2), conjugate(b)) / length)
    return jnp.concatenate([cosine[None], sine])


@apart
def _from_right(rotation: _Rotation) -> _Rotation:
    """That whose transpose is the adjoint."""
    return rotation * np.array([1.0, 1.0, -1.0])[:, None]


@apart
def _first(rotation: _Rotation, a: Parts, b: Parts) -> Parts:
    """c a + s b of rows."""
    return rotation[0] * a + product(b, rotation[1:, None])


@apart
def _second(rotation: _Rotation, a: Parts, b: Parts) -> Parts:
    """c b - s* a of rows."""
    return rotation[0] * b - product(a, conjugate(rotation[1:])[:, None])


@apart
def _left(H: Parts, least) -> Float[Array, "_ lane"]:
    """1 of every element of the subdiagonal that still counts: beside its neighbours on the diagonal, and `least`."""
    on, below = size(_diagonal(H)), size(_diagonal(H, -1))
    small = jnp.maximum(_EPS * (on[1:] + on[:-1]), jnp.maximum(least, np.sqrt(_NOTHING)))
    return (below > small).astype(float)


@apart
def _undone(left) -> Float[Array, "n lane"]:
    """1 of every row beside such an element."""
    none = jnp.zeros_like(left[:1])
    return jnp.maximum(jnp.concatenate([none, left]), jnp.concatenate([left, none]))


@apart
def _last(left) -> Float[Array, "_ lane"]:
    """1 of the last of those."""
    later = sum(left[k] * (np.arange(len(left)) < k)[:, None] for k in range(1, len(left)))
    return jnp.where(later > 0, 0.0, left)


@apart
def _last_block(H: Parts, last) -> Float[Array, "4 2 lane"]:
    """Elements of the two rows and columns about it."""
    on = _diagonal(H)
    along = (on[:, :-1], _diagonal(H, 1), _diagonal(H, -1), on[:, 1:])
    return jnp.stack([total(x[:, k] * last[k] for k in range(len(last))) for x in along])


@apart
def _shift(block: Float[Array, "4 2 lane"], odd) -> Parts:
    """The eigenvalue of [[a, b], [c, d]] that is nearer to d; now and then another number."""
    a, b, c, d = block
    half, across = 0.5 * (a - d), product(b, c)
    apart_by = root(product(half, half) + across)
    away = half + jnp.where(half[0] * apart_by[0] + half[1] * apart_by[1] >= 0, apart_by, -apart_by)
    some = square(away) > _NOTHING
    wilkinson = d - jnp.where(some, over(across, jnp.where(some, away, one(away))), 0.0)
    return jnp.where(odd > 0, d + 0.75 * size(c) * one(d), wilkinson)


@apart
def _shifted(H: Parts, left, shift) -> Parts:
    """H - s, without those elements of the subdiagonal that count no more."""
    n = H.shape[-2]
    counts = jnp.concatenate([jnp.zeros_like(left[:1]), left])[:, None]
    H = jnp.where(np.eye(n, k=-1)[..., None] > 0, H * counts, H)
    return H - np.eye(n)[..., None] * shift[:, None]


@apart
def _plus_shift(columns: tuple[Parts, ...], shift) -> Parts:
    H = jnp.stack(columns, axis=-2)
    return H + np.eye(len(columns))[..., None] * shift[:, None]


def _stacked(several: tuple[Parts, ...], axis: int) -> Parts:
    return apart(functools.partial(jnp.stack, axis=axis))(several)


def _diagonal(A: Parts, offset: int = 0) -> Float[Array, "2 _ lane"]:
    n = A.shape[-2]
    first = offset if offset >= 0 else -offset * n
    return A.reshape(2, n * n, -1)[:, first : n * n - max(offset, 0) * n : n + 1]


# Eigenvectors ---------------------------------------------------------------------------------------------------------


def _vectors(T: Parts) -> Parts:
    """X, upper triangular with ones on its diagonal, of T X = X diag T."""
    values = _diagonal(T)

    def row(k, behind):
        own = jax.lax.dynamic_slice_in_dim(values, k, 1, axis=1)
        return _times_inverse(behind, values - own, size(values))

    return _from_the_last_row(T, row)


def _inverse_of_triangle(X: Parts) -> Parts:
    """X^-1, X being upper triangular with ones on its diagonal."""
    return _from_the_last_row(X, lambda k, behind: -behind)


def _from_the_last_row(A: Parts, row) -> Parts:
    """X, whose row k is that of 1 and `row(k, behind)`: of the rows behind it, times what A has right of its
    diagonal."""
    n = A.shape[-2]

    def with_row(done, X):
        k = n - 2 - done
        right = Lanes(_right_of_diagonal(A, k))
        more = row(k, right.times(Lanes(X)).parts[:, 0])
        return jax.lax.dynamic_update_slice_in_dim(X, _plus_one(more, k)[:, None], k, axis=1)

    return jax.lax.fori_loop(0, n - 1, with_row, identity(Lanes(A)).parts)


@apart
def _right_of_diagonal(A: Parts, k) -> Float[Array, "2 1 n lane"]:
    row = jax.lax.dynamic_slice_in_dim(A, k, 1, axis=1)
    return jnp.where((np.arange(A.shape[-2]) > k)[:, None], row, 0.0)


@apart
def _plus_one(row: Parts, k) -> Parts:
    return row + one(row) * (np.arange(row.shape[1]) == k)[:, None]


@apart
def _times_inverse(x: Parts, difference: Parts, sizes) -> Parts:
    """x over differences of eigenvalues: two that are the same are taken to differ by their rounding."""
    least = jnp.maximum(_EPS * sizes, _EPS**2)
    return over(x, jnp.where(size(difference) < least, least * one(difference), difference))
