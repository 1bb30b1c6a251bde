"""What the least squares of a window do with matrices: of one window, or of several side by side (`lanes`)."""

import abc
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import linalg
from jaxtyping import Complex, Float

from .._types import Array
from .inverse import adjoint, inverse, squares


class AbstractMatrices(eqx.Module):
    """Matrices (row, col), maybe several in front of each other (axes `batch`, which broadcast)."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int]:
        """(row, col)."""

    @property
    @abc.abstractmethod
    def batch(self) -> tuple[int, ...]: ...

    @abc.abstractmethod
    def __getitem__(self, key) -> Self:
        """Some rows and columns: two slices or arrays of numbers."""

    @abc.abstractmethod
    def __add__(self, other: Self) -> Self: ...

    @abc.abstractmethod
    def __sub__(self, other: Self) -> Self: ...

    @abc.abstractmethod
    def __mul__(self, other) -> Self:
        """Element by element: by numbers, or by a number of every window."""

    @property
    @abc.abstractmethod
    def adjoint(self) -> Self: ...

    @property
    @abc.abstractmethod
    def conjugate(self) -> Self: ...

    @property
    @abc.abstractmethod
    def transpose(self) -> Self: ...

    @property
    def hermitian(self) -> Self:
        """Without the rounding by which a matrix is not its own adjoint."""
        return (self + self.adjoint) * 0.5

    @abc.abstractmethod
    def at(self, number: int) -> Self:
        """One along the first axis `batch`."""

    @abc.abstractmethod
    def plus_diagonal(self, more: np.ndarray) -> Self:
        """Real numbers (*batch, col) added on the diagonal."""

    @abc.abstractmethod
    def times(self, other: Self) -> Self:
        """A B."""

    @abc.abstractmethod
    def adjoint_times(self, other: Self) -> Self:
        """A^H B."""

    @abc.abstractmethod
    def times_adjoint(self, other: Self) -> Self:
        """A B^H."""

    @property
    @abc.abstractmethod
    def inverse(self) -> Self:
        """A^-1; not finite where it is singular."""

    @property
    @abc.abstractmethod
    def diagonal(self) -> Float[Array, "*batch row"]:
        """Real parts on the diagonal, with the axis of windows behind where there are several."""

    @property
    @abc.abstractmethod
    def power(self) -> Float[Array, "*batch row"]:
        """The sum of squares of every row, with the axis of windows behind where there are several."""

    @abc.abstractmethod
    def eliminated(self, unit: int = 0) -> "AbstractElimination":
        """A = [A_1; A_2] with A_1 = L L^H, of as many rows as columns, positive definite, of which only the lower
        triangle is read. `unit`: rows and columns of `AbstractElimination.end`."""

    @property
    @abc.abstractmethod
    def by_window(self) -> Complex[Array, "... row col"]:
        """As arrays of complex numbers."""

    @abc.abstractmethod
    def reshaped(self, *shape: int) -> Self:
        """Other axes (*batch, row, col)."""

    @abc.abstractmethod
    def moved(self, axis: int, to: int) -> Self:
        """An axis of (*batch, row, col), counted from the last one: -1 is that of columns."""

    @staticmethod
    @abc.abstractmethod
    def joined(several, axis: int):
        """One behind the other: -1 side by side, -2 on top of each other."""

    @staticmethod
    @abc.abstractmethod
    def stacked(several):
        """Along a new first axis of `batch`."""


class AbstractElimination(eqx.Module):
    """L, as far as it is asked for. `rows`: A_2 L^-H. `pivot`: |diag L|^2, (*batch, col, *window)."""

    rows: eqx.AbstractVar[AbstractMatrices]
    pivot: eqx.AbstractVar[Array]

    @property
    @abc.abstractmethod
    def end(self):
        """L_e^-H, L_e being the last rows and columns of L."""

    @abc.abstractmethod
    def back(self, Y):
        """L^-H Y."""


class Whole(AbstractMatrices):
    """Arrays of complex numbers, as LAPACK takes them: one window (`jax.vmap` takes them over more), large matrices."""

    array: Complex[Array, "*batch row col"]

    @property
    def shape(self) -> tuple[int, int]:
        return self.array.shape[-2], self.array.shape[-1]

    @property
    def batch(self) -> tuple[int, ...]:
        return self.array.shape[:-2]

    def __getitem__(self, key) -> "Whole":
        rows, columns = key
        return Whole(self.array[..., rows, :][..., columns])

    def __add__(self, other: "Whole") -> "Whole":
        return Whole(self.array + other.array)

    def __sub__(self, other: "Whole") -> "Whole":
        return Whole(self.array - other.array)

    def __mul__(self, other) -> "Whole":
        return Whole(self.array * other)

    @property
    def adjoint(self) -> "Whole":
        return Whole(adjoint(self.array))

    @property
    def conjugate(self) -> "Whole":
        return Whole(self.array.conj())

    @property
    def transpose(self) -> "Whole":
        return Whole(self.array.mT)

    def at(self, number: int) -> "Whole":
        return Whole(self.array[number])

    def plus_diagonal(self, more: np.ndarray) -> "Whole":
        return Whole(jnp.asarray(self.array) + more[..., None, :] * np.eye(*self.shape))

    def times(self, other: "Whole") -> "Whole":
        return Whole(self.array @ other.array)

    def adjoint_times(self, other: "Whole") -> "Whole":
        return Whole(adjoint(self.array) @ other.array)

    def times_adjoint(self, other: "Whole") -> "Whole":
        return Whole(self.array @ adjoint(other.array))

    @property
    def inverse(self) -> "Whole":
        return Whole(inverse(self.array))

    @property
    def diagonal(self):
        return jnp.diagonal(self.array, axis1=-2, axis2=-1).real

    @property
    def power(self):
        return jnp.sum(squares(self.array), axis=-1)

    def eliminated(self, unit: int = 0) -> "_ByLapack":
        n = self.shape[1]
        L = linalg.cholesky(jnp.asarray(self.array[..., :n, :]), symmetrize_input=False)
        pivot = jnp.diagonal(L, axis1=-2, axis2=-1).real ** 2
        return _ByLapack(Whole(_times_inverse_adjoint(self.array[..., n:, :], L)), pivot, L, unit)

    @property
    def by_window(self):
        return self.array

    def reshaped(self, *shape: int) -> "Whole":
        return Whole(self.array.reshape(shape))

    def moved(self, axis: int, to: int) -> "Whole":
        return Whole(jnp.moveaxis(self.array, axis, to))

    @staticmethod
    def joined(several, axis: int) -> "Whole":
        return Whole(jnp.concatenate([x.array for x in several], axis=axis))

    @staticmethod
    def stacked(several) -> "Whole":
        return Whole(jnp.stack([x.array for x in several]))


class _ByLapack(AbstractElimination):
    rows: Whole
    pivot: Float[Array, "*batch col"]
    L: Complex[Array, "*batch col col"]
    unit: int = eqx.field(static=True)

    @property
    def end(self) -> Whole:
        L = self.L[..., -self.unit :, -self.unit :]
        return Whole(_times_inverse_adjoint(jnp.broadcast_to(jnp.eye(self.unit, dtype=L.dtype), L.shape), L))

    def back(self, Y: Whole) -> Whole:
        solved = linalg.triangular_solve(
            self.L, Y.array, left_side=True, lower=True, transpose_a=True, conjugate_a=True
        )
        return Whole(solved)


def _times_inverse_adjoint(X, L):
    """X L^-H, L lower triangular."""
    return linalg.triangular_solve(L, X, left_side=False, lower=True, transpose_a=True, conjugate_a=True)


def each_window(function, matrices: AbstractMatrices, *others: AbstractMatrices):
    """`function` of arrays of complex numbers, of one window after the other."""
    arrays = [x.by_window for x in (matrices, *others)]
    return function(*arrays) if isinstance(matrices, Whole) else jax.vmap(function)(*arrays)
