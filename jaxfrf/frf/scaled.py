"""Covariances that are those of something else but for their size."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._types import Array
from .covariance import AbstractFactors, dense as written_out, variances


class Scaled(AbstractFactors):
    """D C D with D = diag(scale): the correlations of `of`, other standard deviations. `scale`: (*batch, vec)."""

    of: AbstractFactors | Complex[Array, "*batch vec vec"]
    scale: Float[Array, "*batch vec"]

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.scale.shape, self.scale.shape[-1])

    def dense(self):
        return written_out(self.of) * self.scale[..., :, None] * self.scale[..., None, :]

    def diagonal(self):
        return variances(self.of) * self.scale**2


class Widened(AbstractFactors):
    """C + diag(more): a variance added to every element. `more`: (*batch, vec)."""

    of: AbstractFactors | Complex[Array, "*batch vec vec"]
    more: Float[Array, "*batch vec"]

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.more.shape, self.more.shape[-1])

    def dense(self):
        xp = np if isinstance(self.more, np.ndarray) else jnp
        return written_out(self.of) + self.more[..., None] * xp.eye(self.more.shape[-1])

    def diagonal(self):
        return variances(self.of) + self.more


class Variances(AbstractFactors):
    """diag(v), of a covariance of which the variances alone were kept. `v`: (*batch, vec)."""

    v: Float[Array, "*batch vec"]

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.v.shape, self.v.shape[-1])

    def dense(self):
        xp = np if isinstance(self.v, np.ndarray) else jnp
        return self.v[..., None] * xp.eye(self.v.shape[-1])

    def diagonal(self):
        return self.v


def scaled(cov, scale) -> Scaled:
    """D C D; one D for several, one after the other."""
    return Scaled(cov.of, cov.scale * scale) if isinstance(cov, Scaled) else Scaled(cov, scale)
