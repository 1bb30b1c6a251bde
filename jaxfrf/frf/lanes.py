"""Small complex matrices of many lines at once, as the vector units of a processor take them.

Eight neighbouring lines lie innermost, real and imaginary parts apart, so that a product is made of multiplications of
whole registers: a third of the time that complex matrices of one line after the other take. Every operation's result
is written down (`apart`), as XLA would otherwise work it out anew wherever the next one reads it. There is no LAPACK in
it: its batched calls copy matrices, and hand work to threads that wait for each other.
"""

import functools
import operator
from collections.abc import Iterable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._compile import apart
from .._types import Array
from . import inverse as by_line
from .complex_parts import conjugate, one, over, product, signs, square
from .matrices import AbstractElimination, AbstractMatrices

LANES = 8  # lines side by side; of more, matrices leave the innermost cache
_TERMS = 40  # of a sum that are written out; of longer ones parts go round
_PART = 16  # terms of such a part
_PANEL = 8  # columns that are eliminated together
_TIE = 1e-15  # by which the first of rows with equal elements counts as larger
_LARGE = 24  # rows, from which on LAPACK is as fast and shorter to compile
_ROW, _COLUMN = -3, -2  # axes
_Sums = tuple[Array, Array] | None


class Lanes(AbstractMatrices):
    """Matrices of neighbouring lines, by real and imaginary parts.

    `pieces`: one beside the other. `first`: the row that each begins with, of as many as there are in `n_row`;
    `columns`: first and last of all; so that who reads a part need not copy it first."""

    pieces: tuple[Float[Array, "2 *batch _ _ lane"], ...]
    first: tuple[int, ...] = eqx.field(static=True)
    n_row: int = eqx.field(static=True)
    columns: tuple[int, int] = eqx.field(static=True)

    def __init__(self, pieces, first=None, n_row: int | None = None, columns: tuple[int, int] | None = None):
        self.pieces = pieces if isinstance(pieces, tuple) else (pieces,)
        self.first = first or (0,) * len(self.pieces)
        self.n_row = self.pieces[0].shape[_ROW] if n_row is None else n_row
        self.columns = columns or (0, sum(x.shape[_COLUMN] for x in self.pieces))

    @property
    def parts(self) -> Float[Array, "2 *batch row col lane"]:
        """Real and imaginary parts."""
        every = self._every_column
        whole = every[0] if len(every) == 1 else jnp.concatenate(every, axis=_COLUMN)
        return whole[..., slice(*self.columns), :]

    @property
    def _every_column(self):
        """The rows that are meant, of every piece."""
        return [x[..., k : k + self.n_row, :, :] for x, k in zip(self.pieces, self.first, strict=True)]

    @property
    def real(self) -> Float[Array, "*batch row col lane"]:
        return self.parts[0]

    @property
    def imag(self) -> Float[Array, "*batch row col lane"]:
        return self.parts[1]

    @property
    def shape(self) -> tuple[int, int]:
        return self.n_row, self.columns[1] - self.columns[0]

    @property
    def batch(self) -> tuple[int, ...]:
        return self.pieces[0].shape[1:_ROW]

    @property
    def n_lane(self) -> int:
        return self.pieces[0].shape[-1]

    def __getitem__(self, key) -> "Lanes":
        rows, columns = key
        if not (isinstance(rows, slice) and isinstance(columns, slice)):
            return Lanes(self.parts[..., rows, :, :][..., columns, :])
        top, n_row = _within(self.n_row, rows)
        left, n_column = _within(self.shape[1], columns)
        left += self.columns[0]
        return Lanes(self.pieces, tuple(k + top for k in self.first), n_row, (left, left + n_column))

    def __add__(self, other: "Lanes") -> "Lanes":
        return Lanes(operator.add(*_aligned(self.parts, other.parts)))

    def __sub__(self, other: "Lanes") -> "Lanes":
        return Lanes(operator.sub(*_aligned(self.parts, other.parts)))

    def __mul__(self, other) -> "Lanes":
        return Lanes(product(self.parts, other.parts) if isinstance(other, Lanes) else self.parts * other)

    @property
    def adjoint(self) -> "Lanes":
        return Lanes(conjugate(self.parts.swapaxes(_ROW, _COLUMN)))

    @property
    def conjugate(self) -> "Lanes":
        return Lanes(conjugate(self.parts))

    @property
    def transpose(self) -> "Lanes":
        return Lanes(self.parts.swapaxes(_ROW, _COLUMN))

    def at(self, number: int) -> "Lanes":
        return Lanes(tuple(x[:, number] for x in self.pieces), self.first, self.n_row, self.columns)

    def plus_diagonal(self, more: np.ndarray) -> "Lanes":
        real = more[..., None, :] * np.eye(*self.shape)
        return Lanes(self.parts + np.stack([real, np.zeros_like(real)])[..., None])

    def times(self, other: "Lanes") -> "Lanes":
        return _times(self, other)

    def adjoint_times(self, other: "Lanes") -> "Lanes":
        return _adjoint_times(self, other)

    def times_adjoint(self, other: "Lanes") -> "Lanes":
        return _times_adjoint(self, other)

    @property
    def inverse(self) -> "Lanes":
        return _inverse(self) if in_registers(self.n_row) else _by_lapack(by_line.inverse, self)

    @property
    def diagonal(self) -> Float[Array, "*batch row lane"]:
        return jnp.moveaxis(jnp.diagonal(self.real, axis1=_ROW, axis2=_COLUMN), -1, -2)

    @property
    def power(self) -> Float[Array, "*batch row lane"]:
        return _power(self)

    def eliminated(self, unit: int = 0) -> "_ByColumns":
        return _eliminated(self, unit)

    @property
    def by_window(self) -> Complex[Array, "lane *batch row col"]:
        parts = jnp.moveaxis(self.parts, -1, 1)
        return jax.lax.complex(parts[0], parts[1])

    def reshaped(self, *shape: int) -> "Lanes":
        if shape[-1] == self.shape[1] == sum(x.shape[_COLUMN] for x in self.pieces):
            return Lanes(tuple(x.reshape(2, *shape[:-1], *x.shape[_COLUMN:]) for x in self._every_column))
        return Lanes(self.parts.reshape(2, *shape, self.n_lane))

    def moved(self, axis: int, to: int) -> "Lanes":
        return Lanes(jnp.moveaxis(self.parts, axis - 1, to - 1))

    @staticmethod
    def joined(several: Sequence["Lanes"], axis: int) -> "Lanes":
        return Lanes(jnp.concatenate([x.parts for x in several], axis=axis - 1))

    @staticmethod
    def stacked(several: Sequence["Lanes"]) -> "Lanes":
        return Lanes(jnp.stack([x.parts for x in several], axis=1))


def lane_count(n_line: int, n_element: int, most: int) -> int:
    """How many lines of so many elements go side by side, in groups of one size that hold `most` elements: a multiple
    of eight."""
    side_by_side = max(most // n_element // LANES * LANES, LANES)
    n_group = -(-n_line // side_by_side)
    return -(-n_line // (LANES * n_group)) * LANES


def of_signal(X: Complex[Array, "exp line channel"], n_lane: int = LANES) -> Lanes:
    """A signal as matrices (channel, exp): experiments side by side as columns."""
    return of_lines(X.transpose(1, 2, 0), n_lane)


def of_lines(X: Complex[Array, "line row col"], n_lane: int = LANES) -> Lanes:
    """Matrices of every line, in groups along one axis `batch`. The last group is filled up by repeats of the last
    line."""
    missing = -len(X) % n_lane
    X = jnp.pad(X, ((0, missing), (0, 0), (0, 0)), mode="edge") if missing else X
    X = X.reshape(-1, n_lane, *X.shape[1:]).transpose(0, 2, 3, 1)
    return Lanes(jnp.stack([X.real, X.imag]))


def of_numbers(x: Float[Array, "line"]) -> Float[Array, "group 1 1 lane"]:
    """A number of every line, beside the numbers of matrices."""
    return of_lines(x[:, None, None]).real


def in_registers(n_row: int) -> bool:
    """Whether inverses of so many rows are made here, and not by LAPACK."""
    return n_row <= _LARGE


def identity(like: Lanes) -> Lanes:
    """1 in every line."""
    return Lanes(_unit(like.shape[0], like))


def lines(A: Lanes, n_line: int) -> Complex[Array, "line row col"]:
    """The matrices line by line."""
    return A.by_window.swapaxes(0, 1).reshape(-1, *A.shape)[:n_line]


def some_lines(A: Lanes, which: np.ndarray) -> Complex[Array, "chosen row col"]:
    """The matrices of some lines."""
    group, lane = np.divmod(which, A.n_lane)
    return jax.lax.complex(A.real[group, :, :, lane], A.imag[group, :, :, lane])


@apart
def _power(A: Lanes) -> Float[Array, "*batch row lane"]:
    """The sum of squares of every row."""
    n = A.shape[1]
    if n > _TERMS:
        return jnp.sum(by_line.squares(A), axis=_COLUMN)
    return total(square(_along(A, _COLUMN, k)) for k in range(n))


# Products -------------------------------------------------------------------------------------------------------------


# What is to be taken off something is written down by itself, too: where XLA puts a result in the place of what it
# starts with, loops are not vectorised.


@apart
def _times(A: Lanes, B: Lanes) -> Lanes:
    return Lanes(_sum(((A, B),), _COLUMN, _ROW))


@apart
def _adjoint_times(A: Lanes, B: Lanes) -> Lanes:
    return Lanes(_sum(((A, B),), _ROW, _ROW))


@apart
def _times_adjoint(A: Lanes, B: Lanes) -> Lanes:
    return Lanes(_sum(((A, B),), _COLUMN, _COLUMN))


def _sum(pairs, over: int, beside: int) -> Float[Array, "2 *batch row col lane"]:
    """Over an axis of A and one of B, all products of what is left of both, of every pair: A B, A^H B or A B^H.

    Real parts of B times A, and imaginary ones times A with its parts exchanged, are summed by themselves, so that
    signs are a matter of what comes out."""
    sums: _Sums = None
    for A, B in pairs:
        n = A.shape[0 if over == _ROW else 1]
        if n > _TERMS:
            sums = _plus_long(sums, A.parts, B.parts, over, beside)
            continue
        for k in range(n):
            sums = _plus_term(sums, _along(A, over, k), _along(B, beside, k))
    assert sums is not None  # there is a term
    direct, exchanged = sums
    if over == _ROW:
        return conjugate(direct) + exchanged
    return direct + exchanged * signs([-1.0, 1.0] if beside == _ROW else [1.0, -1.0], exchanged)


def _along(A: Lanes, axis: int, k: int) -> Float[Array, "2 *batch left lane"]:
    """Column or row k."""
    if axis == _ROW:
        return A[k : k + 1, :].parts[..., 0, :, :]
    place = A.columns[0] + k
    for piece, first in zip(A.pieces, A.first, strict=True):
        if place < piece.shape[_COLUMN]:
            return piece[..., first : first + A.n_row, place, :]
        place -= piece.shape[_COLUMN]
    raise IndexError(k)


def _plus_term(sums: _Sums, a, b) -> tuple[Array, Array]:
    """A column or row of A times one of B, every element with every element."""
    a, b = _aligned(a[..., :, None, :], b[..., None, :, :])
    direct, exchanged = a * b[:1], a[::-1] * b[1:]
    return (direct, exchanged) if sums is None else (sums[0] + direct, sums[1] + exchanged)


def _plus_long(sums: _Sums, a, b, over: int, beside: int):
    """Of many terms, some at a time."""
    n = a.shape[over]
    whole = n // _PART * _PART

    def plus_part(sums: _Sums, first, count: int):
        a_part, b_part = (
            jax.lax.dynamic_slice_in_dim(x, first, count, axis=x.ndim + axis) for x, axis in ((a, over), (b, beside))
        )
        for k in range(count):
            sums = _plus_term(sums, jnp.take(a_part, k, axis=over), jnp.take(b_part, k, axis=beside))
        return sums

    sums = jax.tree.map(jnp.zeros_like, plus_part(None, 0, 1)) if sums is None else sums
    sums = jax.lax.fori_loop(0, whole // _PART, lambda k, sums: plus_part(sums, k * _PART, _PART), sums)
    return plus_part(sums, whole, n - whole)


def total(terms: Iterable[Array]) -> Array:
    """Their sum, term by term: XLA's own loop for the sum along an axis is not vectorised."""
    return functools.reduce(operator.add, terms)


def _aligned(a, b):
    """With as many axes `batch`."""
    more = b.ndim - a.ndim
    return a.reshape(2, *[1] * more, *a.shape[1:]), b.reshape(2, *[1] * -more, *b.shape[1:])


def _unit(n: int, like: Lanes) -> Float[Array, "2 *batch row row lane"]:
    """1, for as many windows."""
    batch, lane = like.batch, like.n_lane
    unit = np.stack([np.eye(n), np.zeros((n, n))]).reshape(2, *[1] * len(batch), n, n, 1)
    return jnp.broadcast_to(unit, (2, *batch, n, n, lane))


# Elimination ----------------------------------------------------------------------------------------------------------


class _ByColumns(AbstractElimination):
    """`L`: of every column what stands below the diagonal, of L and then of A_2 L^-H. `inverse_diagonal`: of L."""

    rows: Lanes
    pivot: Float[Array, "*batch col lane"]
    L: tuple[Lanes, ...]
    inverse_diagonal: tuple[Float[Array, "*batch lane"], ...]
    unit: int = eqx.field(static=True)

    @property
    def end(self) -> Lanes:
        return _back(self.L[-self.unit :], self.inverse_diagonal[-self.unit :], Lanes(_unit(self.unit, self.L[0])))

    def back(self, Y: Lanes) -> Lanes:
        return _back(self.L, self.inverse_diagonal, Y)


def _back(L, inverse_diagonal, Y: Lanes) -> Lanes:
    """L^-H Y, from the last row on."""
    n = len(L)
    found: dict[int, Lanes] = {}
    for k in reversed(range(n)):
        known = tuple((L[k][i - k - 1 : i - k, :], X) for i, X in found.items())
        found[k] = _next_row(Y[k : k + 1, :], known, inverse_diagonal[k])
    return Lanes.joined([found[k] for k in range(n)], -2)


def _eliminated(A: Lanes, unit: int) -> _ByColumns:
    """Cholesky's factor column by column, of which a panel has those terms taken off together that are known."""
    n_row, n = A.shape
    L: list[Lanes] = []
    panels: list[Lanes] = []
    diagonal: list[Array] = []
    for first in range(0, n, _PANEL):
        panel = A[first:, first : first + _PANEL]
        if panels:
            known = _beside([_last_rows(x, n_row - first) for x in panels])
            panel = panel - known.times_adjoint(known[: panel.shape[1], :])
        for k in range(panel.shape[1]):
            of_panel = tuple(_last_rows(x, panel.shape[0] - k) for x in L[first:])
            column, inverse = _next_column(panel[k:, k : k + 1], of_panel)
            L.append(column)
            diagonal.append(inverse)
        panels.append(Lanes.joined([_last_rows(x, L[-1].shape[0]) for x in L[first:]], -1))
    rows = _beside([_last_rows(x, n_row - n) for x in panels])
    return _ByColumns(rows, jnp.stack(diagonal, axis=-2) ** -2, tuple(L), tuple(diagonal), unit)


@apart
def _next_column(A: Lanes, known: tuple[Lanes, ...]):
    """A column of L below the diagonal, and 1 over the diagonal, where those before it are known."""
    left = A.parts - _sum([(x, x[:1, :]) for x in known], _COLUMN, _COLUMN) if known else A.parts
    inverse = 1 / jnp.sqrt(left[0, ..., 0, 0, :])
    return Lanes(left[..., 1:, :, :] * inverse[..., None, None, :]), inverse


@apart
def _next_row(A: Lanes, known, factor) -> Lanes:
    """A row of L^-H Y, where those behind it are known."""
    left = A.parts - _sum(known, _ROW, _ROW) if known else A.parts
    return Lanes(left * factor[..., None, None, :])


def _last_rows(A: Lanes, count: int) -> Lanes:
    return A[A.shape[0] - count :, :]


def _beside(columns: Sequence[Lanes]) -> Lanes:
    """Matrices of the same rows side by side, without a copy."""
    first = tuple(k for x in columns for k in x.first)
    return Lanes(tuple(piece for x in columns for piece in x.pieces), first, columns[0].n_row)


def _slice(x, k, axis: int):
    return jax.lax.dynamic_slice_in_dim(x, k, 1, axis=x.ndim + axis)


def inverse_of_products(X: Lanes) -> Lanes:
    """(X X^H)^-1, NaN where it is singular."""
    A = X.times_adjoint(X)
    if in_registers(A.shape[0]):
        half = A.eliminated(unit=A.shape[0]).end
    else:
        half = _by_lapack(by_line.positive_half_inverse, A).adjoint
    return half.times_adjoint(half)


def _by_lapack(function, A: Lanes) -> Lanes:
    found = jax.vmap(function)(A.by_window.reshape(-1, *A.shape))
    found = found.reshape(A.n_lane, *A.batch, *A.shape)
    return Lanes(jnp.moveaxis(jnp.stack([found.real, found.imag]), 1, -1))


def _inverse(A: Lanes) -> Lanes:
    """Gauss and Jordan's, in place: in every step the unknown of a column changes sides with the right-hand side of the
    row that has the largest element there, of those rows that have not yet. NaN where it is not finite."""
    n = A.shape[0]

    def exchanged(k, state):
        W, chosen, used = state
        this = _largest(W, used, k)
        W = _exchanged(W, this, _pivot_row(W, this, k), k)
        return W, jax.lax.dynamic_update_slice_in_dim(chosen, this[None], k, axis=0), used + this

    none = jnp.zeros((n, *A.batch, n, A.n_lane))
    W, chosen, _ = jax.lax.fori_loop(0, n, exchanged, (A.parts, none, none[0]))
    return _where_finite(_columns_in_order(_rows_in_order(W, chosen), chosen))


@apart
def _largest(W, used, k) -> Float[Array, "*batch row lane"]:
    """1 at the row of the largest element of column k, of those that are not used, the first of equal ones."""
    first = 1 - _TIE * np.arange(W.shape[_ROW])[:, None]
    size = square(_slice(W, k, _COLUMN))[..., 0, :] * first * (1 - used) - used
    return _at_largest(size)


@apart
def _at_largest(size):
    return (size == jnp.max(size, axis=-2, keepdims=True)).astype(float)


@apart
def _pivot_row(W, this, k) -> Float[Array, "2 *batch 1 col lane"]:
    """The row that is taken, solved for the unknown of column k."""
    row = total(W[..., i, :, :] * this[..., i, None, :] for i in range(W.shape[_ROW]))[..., None, :, :]
    return over(jnp.where(_is_column(W, k), one(row), row), _slice(row, k, _COLUMN))


@apart
def _exchanged(W, this, row, k):
    """That row, and what it makes of the others."""
    others = jnp.where(_is_column(W, k), 0.0, W) - product(_slice(W, k, _COLUMN), row)
    return jnp.where(this[..., :, None, :] > 0, row, others)


def _is_column(W, k):
    return (np.arange(W.shape[_COLUMN]) == k)[:, None]


@apart
def _rows_in_order(W, chosen):
    """The rows of the inverse as columns were."""
    n = W.shape[_ROW]
    rows = [total(W[..., i, :, :] * chosen[k, ..., i, None, :] for i in range(n)) for k in range(n)]
    return jnp.stack(rows, axis=_ROW)


@apart
def _columns_in_order(W, chosen):
    """Its columns as rows were."""
    return total(W[..., k, None, :] * chosen[k, ..., None, :, :] for k in range(W.shape[_COLUMN]))


@apart
def _where_finite(W) -> Lanes:
    finite = jnp.isfinite(jnp.sum(W, axis=(0, _ROW, _COLUMN)))
    return Lanes(jnp.where(finite[..., None, None, :], W, jnp.nan))


def _within(n: int, part: slice) -> tuple[int, int]:
    """Where a part begins, and how long it is."""
    first, last, _ = part.indices(n)
    return first, max(last - first, 0)
