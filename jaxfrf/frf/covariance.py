"""Covariances of vec(G), columns stacked, kept as the factors they are made of.

The dense covariance of a 6 x 6 response takes 20 kB a line, its factors one: they are written out only for those who
ask. A factored covariance can be used like the array it stands for; `numpy.asarray` writes it out.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._types import Array
from .inverse import squares


class AbstractFactors(eqx.Module, np.lib.mixins.NDArrayOperatorsMixin):
    """An array (*batch, vec, vec) that is computed from its factors whenever its entries are asked for.

    Indexing the first axis alone (`cov[3:5]`) keeps factors, any other index gives entries. Attributes and operations
    of `numpy.ndarray` go to the written-out array.
    """

    @abc.abstractmethod
    def dense(self) -> Complex[Array, "*batch vec vec"]:
        """The covariance written out; of the kind of array that the factors are (NumPy or JAX)."""

    @abc.abstractmethod
    def diagonal(self) -> Float[Array, "*batch vec"]:
        """The variances of vec(G)."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """(*batch, vec, vec)."""

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes of the factors."""
        return sum(x.nbytes for x in jax.tree.leaves(self))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key):
        first, *rest = key if isinstance(key, tuple) else (key,)
        if not isinstance(first, int | np.integer | slice | list | np.ndarray) or getattr(first, "ndim", 1) > 1:
            return np.asarray(self)[key]
        part = jax.tree.map(lambda x: np.asarray(x)[first], self)
        if rest and not isinstance(first, int | np.integer | slice):
            return np.asarray(self)[key]  # what several index arrays mean together is for NumPy to say
        if not rest:
            return part
        return np.asarray(part)[tuple(rest) if isinstance(first, int | np.integer) else (slice(None), *rest)]

    def __array__(self, dtype=None, copy=None):
        return np.asarray(jax.tree.map(np.asarray, self).dense(), dtype=dtype)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        plain = (np.asarray(x) if isinstance(x, AbstractFactors) else x for x in inputs)
        return getattr(ufunc, method)(*plain, **options)

    def __getattr__(self, name: str):
        if name.startswith("_") or not hasattr(np.ndarray, name):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return getattr(np.asarray(self), name)


class KroneckerSum(AbstractFactors):
    """A covariance as a sum of Kronecker products, sum_t S_t (x) C_t.

    **Fields:** `left`: S, (*batch, term, in, in). `right`: C, (*batch, term, out, out); their product has the unit of G
    squared.

    **Source:** closed form: errors of the outputs that are alike at all experiments of a least-squares estimate.
    """

    left: Complex[Array, "*batch term in in"]
    right: Complex[Array, "*batch term out out"]

    @property
    def shape(self) -> tuple[int, ...]:
        vec = self.left.shape[-1] * self.right.shape[-1]
        return (*self.left.shape[:-3], vec, vec)

    def dense(self):
        xp = np if isinstance(self.left, np.ndarray) else jnp
        if self.left.shape[-3] == 1:
            cov = self.left[..., 0, :, None, :, None] * self.right[..., 0, None, :, None, :]
            return cov.reshape(self.shape)
        n_in, n_out = self.left.shape[-1], self.right.shape[-1]
        left, right = (x.reshape(*x.shape[:-2], -1) for x in (self.left, self.right))
        cov = xp.swapaxes(left, -1, -2) @ right
        return xp.moveaxis(cov.reshape(*cov.shape[:-2], n_in, n_in, n_out, n_out), -2, -3).reshape(self.shape)

    def diagonal(self):
        xp = np if isinstance(self.left, np.ndarray) else jnp
        left, right = (xp.diagonal(x, axis1=-2, axis2=-1) for x in (self.left, self.right))
        return xp.sum((left[..., :, None] * right[..., None, :]).real, axis=-3).reshape(self.shape[:-1])


class OuterSum(AbstractFactors):
    """A covariance as a sum of outer products, sum_m d_m d_m^H.

    **Fields:** `columns`: d_m, (*batch, vec, term), unit of G.

    **Source:** closed form: the scatter of single estimates about their mean.
    """

    columns: Complex[Array, "*batch vec term"]

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.columns.shape[:-1], self.columns.shape[-2])

    def dense(self):
        return self.columns @ self.columns.conj().mT

    def diagonal(self):
        return squares(self.columns).sum(axis=-1)


def variances(cov) -> Float[Array, "*batch vec"]:
    """The diagonal of a covariance, whichever way it is kept."""
    if isinstance(cov, AbstractFactors):
        return cov.diagonal()
    xp = np if isinstance(cov, np.ndarray) else jnp
    return xp.diagonal(cov, axis1=-2, axis2=-1).real


def dense(cov) -> Complex[Array, "*batch vec vec"]:
    """A covariance written out, whichever way it is kept."""
    return cov.dense() if isinstance(cov, AbstractFactors) else cov


def sum_over(cov, factor: float):
    """`factor` times the sum over the first axis: terms side by side, while that is shorter than written out."""
    if not isinstance(cov, KroneckerSum):
        return factor * jnp.sum(dense(cov), axis=0)
    left, right = (jnp.moveaxis(x, 0, -4) for x in (cov.left * factor, cov.right))
    whole = KroneckerSum(*(x.reshape(*x.shape[:-4], -1, *x.shape[-2:]) for x in (left, right)))
    size = left.shape[-1] ** 2 + right.shape[-1] ** 2
    return whole if whole.left.shape[-3] * size < whole.shape[-1] ** 2 else whole.dense()
