"""Products of residuals, E = sum_rows v conj(v)^T of all targets, and of those of a ratio of two responses.

With targets that are first y, then u, the residuals of y - G u are M v, M = [I, -G]: M E M^H is smaller than E, and is
worked out without it where E is what regressors leave of products of the targets.
"""

import abc

import equinox as eqx
from jaxtyping import Float

from .._types import Array
from .matrices import AbstractMatrices


class AbstractResiduals(eqx.Module):
    """E, (target, target)."""

    @property
    @abc.abstractmethod
    def whole(self) -> AbstractMatrices:
        """E."""

    @property
    @abc.abstractmethod
    def power(self) -> Float[Array, "target *window"]:
        """Its diagonal."""

    @abc.abstractmethod
    def of_ratio(self, G: AbstractMatrices) -> AbstractMatrices:
        """M E M^H, M = [I, -G]: (out, out)."""


class Residuals(AbstractResiduals):
    """As it is."""

    E: AbstractMatrices

    @property
    def whole(self):
        return self.E

    @property
    def power(self):
        return self.E.diagonal

    def of_ratio(self, G):
        first, *others = in_parts(G, self.E)
        return sum(others, first)


class Unexplained(AbstractResiduals):
    """E^* = P - B B^H, of products P of the targets, of which B B^H is explained: as Gram matrices have it, whose
    factors on the left are the conjugate ones."""

    products: AbstractMatrices
    explained: AbstractMatrices

    @property
    def whole(self):
        return (self.products - self.explained.times_adjoint(self.explained)).hermitian.conjugate

    @property
    def power(self):
        return self.products.diagonal - self.explained.power

    def of_ratio(self, G):
        n_out, G = G.shape[0], G.conjugate
        B = self.explained[:n_out, :] - G.times(self.explained[n_out:, :])
        first, *others = in_parts(G, self.products)
        return (sum(others, first) - B.times_adjoint(B)).hermitian.conjugate


def in_parts(G: AbstractMatrices, C: AbstractMatrices) -> list[AbstractMatrices]:
    """M C M^H, M = [I, -G], as four terms: of the errors of y, of both in either order, of those of u."""
    n_out = G.shape[0]
    of_u = C[:, n_out:].times_adjoint(G)
    both = of_u[:n_out, :] * -1.0
    return [C[:n_out, :n_out], both, both.adjoint, G.times(of_u[n_out:, :])]
