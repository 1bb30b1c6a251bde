"""Eigenvalues and eigenvectors of small complex matrices of many lines at once.

Schur's form by Hessenberg's and QR steps with Wilkinson's shift (Golub & Van Loan, Matrix Computations, 7.5; explicit
shifts, as EISPACK's comqr2), all lines in step until the last is done; eigenvectors from it by substitution. Lines lie
innermost, as many as the cache takes. LAPACK, one matrix after the other, takes four times as long for six rows, and
its batched calls hand work to threads that wait for each other.
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
from .lanes import Lanes, identity

_EPS = np.finfo(float).eps
_NOTHING = 1e-290  # square of an element, where the largest of the matrix is 1
_STEPS = 30  # of QR for every row, as LAPACK has it: three are usual
_PATIENCE = 5  # steps for every row, behind which what rounding makes of the whole matrix counts no more
_ODD = 10  # every so many steps another shift, which leaves a cycle
ELEMENTS = 4096  # of the matrices that go side by side: with those of their vectors, 130 kB
_LEAST = 1e-60  # square of an element over the largest: smaller ones tell no ratio

_Rotation = Float[Array, "3 lane"]  # cosine, sine's real and imaginary part


class Eigen(NamedTuple):
    """A = V diag(values) V_inverse, columns of V of length one. NaN where there is none."""

    values: Float[Array, "2 n lane"]
    V: Lanes
    V_inverse: Lanes


def eigen(A: Lanes) -> Eigen:
    """Of one group of lines."""
    parts, unit, scale = _balanced(A.parts)
    T, Q = _schur(parts)
    X = _vectors(T)
    V = Lanes(Q).times(Lanes(X)).parts * unit[:, None]
    V_inverse = Lanes(_inverse_of_triangle(X)).times(Lanes(Q).adjoint).parts / unit
    length = jnp.sqrt(jnp.sum(square(V), axis=0))
    return Eigen(_diagonal(T) * scale, Lanes(V / length), Lanes(V_inverse * length[:, None]))


# Balance --------------------------------------------------------------------------------------------------------------


def units(squares: Float[Array, "n n lane"]) -> Float[Array, "n lane"]:
    """The d for which diag(1/d) A diag(d) has rows as large as columns, by the mean logarithm of the ratios of
    elements, whose squares are given, where that makes A smaller; powers of 2, so that nothing is rounded."""
    return _where_smaller(_even(_logarithms(squares)), squares)


@apart
def _logarithms(squares):
    """Of every element over the one across the diagonal, NaN where one of them is zero."""
    largest = _along(jnp.maximum, _along(jnp.maximum, squares))
    least = _LEAST * largest + _LEAST
    logs = jnp.where(squares > least, jnp.log2(squares), jnp.nan)
    return logs - logs.swapaxes(0, 1)


@apart
def _even(ratios):
    told = ~jnp.isnan(ratios)
    total = _along(jnp.add, jnp.where(told, ratios, 0.0).swapaxes(0, 1))
    return jnp.exp2(jnp.round(0.25 * total / jnp.maximum(_along(jnp.add, told.astype(float).swapaxes(0, 1)), 1.0)))


@apart
def _where_smaller(d, squares):
    change = jnp.square(d / d[:, None]) - 1.0
    smaller = _along(jnp.add, _along(jnp.add, squares * change)) < 0.0
    return jnp.where(smaller, d, 1.0)


def _along(operation, x):
    """Over the first axis: XLA's own loop for it is not vectorised."""
    return functools.reduce(operation, x)


def _balanced(A: Parts):
    """The matrix in units and of a size that are its own, those units, and the size."""
    scale = _size(A)
    d = units(_squares(A, scale))
    return _in_units(A, d, scale), d, scale


@apart
def _size(A: Parts):
    largest = _along(jnp.maximum, _along(jnp.maximum, size(A)))
    return jnp.exp2(jnp.round(jnp.log2(jnp.where(largest > 0, largest, 1.0))))


@apart
def _squares(A: Parts, scale):
    return square(A / scale)


@apart
def _in_units(A: Parts, d, scale) -> Parts:
    return A * (d / (d[:, None] * scale))


# Hessenberg's form ----------------------------------------------------------------------------------------------------


def _hessenberg(A: Parts) -> tuple[Parts, Parts]:
    """H of no elements below the first subdiagonal, and Q of Q^H A Q = H, by Householder's reflections."""
    n = A.shape[-2]
    H, Q = A, identity(Lanes(A)).parts
    for k in range(n - 2):
        v = Lanes(_reflection(H[:, k + 1 :, k]))
        below = Lanes(H)[k + 1 :, :]
        below -= v.times(v.adjoint_times(below))
        both = Lanes(_joined((H[:, : k + 1], below.parts, Q), -3))
        behind = both[:, k + 1 :]
        behind -= behind.times(v).times_adjoint(v)
        parts = _joined((both[:, : k + 1].parts, behind.parts), -2)
        H, Q = parts[:, :n], parts[:, n:]
    return H, Q


@apart
def _reflection(x: Float[Array, "2 row lane"]) -> Float[Array, "2 row 1 lane"]:
    """v, for which x - v v^H x has only its first element; zero where x is."""
    first = _phase(x[:, 0], square(x[:, 0])) * jnp.sqrt(jnp.sum(square(x), axis=0))
    v = jnp.concatenate([x[:, :1] + first[:, None], x[:, 1:]], axis=1)
    length = jnp.sum(square(v), axis=0)
    some = length > _NOTHING
    return (v * jnp.where(some, jnp.sqrt(2.0 / jnp.where(some, length, 1.0)), 0.0))[:, :, None]


def _phase(x: Parts, squared) -> Parts:
    """x / |x|, and 1 of nothing."""
    nothing = squared <= _NOTHING
    return jnp.where(nothing, one(x), x / jnp.sqrt(jnp.where(nothing, 1.0, squared)))


def _joined(several: tuple[Parts, ...], axis: int) -> Parts:
    return apart(functools.partial(jnp.concatenate, axis=axis))(several)


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
    """R Q + s of H - s = Q R, s being a shift of each line's own."""
    n = H.shape[-2]
    shift = _shift(_last_block(H, _last(left)), odd)
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
def _last(left) -> Float[Array, "_ lane"]:
    """1 of the last of those."""
    later = sum(left[k] * (np.arange(len(left)) < k)[:, None] for k in range(1, len(left)))
    return jnp.where(later > 0, 0.0, left)


@apart
def _last_block(H: Parts, last) -> Float[Array, "4 2 lane"]:
    """Elements of the two rows and columns about it."""
    on = _diagonal(H)
    return jnp.stack([jnp.sum(x * last, axis=1) for x in (on[:, :-1], _diagonal(H, 1), _diagonal(H, -1), on[:, 1:])])


@apart
def _shift(block: Float[Array, "4 2 lane"], odd) -> Parts:
    """The eigenvalue of [[a, b], [c, d]] that is nearer to d; now and then another number."""
    a, b, c, d = block
    half, across = 0.5 * (a - d), product(b, c)
    apart_by = root(product(half, half) + across)
    away = half + jnp.where(jnp.sum(half * apart_by, axis=0) >= 0, apart_by, -apart_by)
    some = square(away) > _NOTHING
    wilkinson = d - jnp.where(some, over(across, jnp.where(some, away, one(away))), 0.0)
    return jnp.where(odd > 0, d + 0.75 * size(c) * one(d), wilkinson)


@apart
def _shifted(H: Parts, left, shift) -> Parts:
    """H - s, without those elements of the subdiagonal that count no more."""
    n = H.shape[-2]
    counts = jnp.concatenate([jnp.zeros_like(left[:1]), left])[:, None]
    H = jnp.where(np.eye(n, k=-1)[..., None] > 0, H * counts, H)
    return H - np.eye(n)[..., None] * shift[:, None, None]


@apart
def _plus_shift(columns: tuple[Parts, ...], shift) -> Parts:
    H = jnp.stack(columns, axis=-2)
    return H + np.eye(len(columns))[..., None] * shift[:, None, None]


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
    sizes = size(values)

    def row(k: int, unit: Parts, behind: Parts) -> Parts:
        return _plus(unit, behind, _one_over(values - values[:, k : k + 1], sizes))

    return _from_the_last_row(T, row)


def _inverse_of_triangle(X: Parts) -> Parts:
    """X^-1, X being upper triangular with ones on its diagonal."""
    return _from_the_last_row(X, lambda k, unit, behind: _minus(unit, behind))


def _from_the_last_row(A: Parts, row) -> Parts:
    """X whose row k is made from that of 1, and from those behind it times what A has right of its diagonal."""
    n = A.shape[-2]
    unit = identity(Lanes(A)).parts
    rows = [unit[:, n - 1]]
    for k in reversed(range(n - 1)):
        behind = Lanes(A)[k : k + 1, k + 1 :].times(Lanes(_stacked(tuple(rows), -3)))
        rows.insert(0, row(k, unit[:, k], behind.parts[:, 0]))
    return _stacked(tuple(rows), -3)


@apart
def _one_over(difference: Parts, sizes) -> Parts:
    """Two eigenvalues that are the same are taken to differ by their rounding."""
    least = jnp.maximum(_EPS * sizes, np.sqrt(_NOTHING))
    difference = jnp.where(size(difference) < least, least * one(difference), difference)
    return over(jnp.broadcast_to(one(difference), difference.shape), difference)


@apart
def _plus(unit: Parts, x: Parts, factor: Parts) -> Parts:
    return unit + product(x, factor)


@apart
def _minus(unit: Parts, x: Parts) -> Parts:
    return unit - x
