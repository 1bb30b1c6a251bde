"""Gram matrices of the columns of local regressions, from moments of products of signals.

A window of lines around line k holds the columns x^p s_a, where s_a is a signal (reference, input, output, or 1 for a
transient) and x the local variable, zero at line k. All that a least-squares fit needs of them are the inner products
sum_j x_j^(p+q) conj(s_a) s_b: *moments* of products of signals. They are few, as pairs of powers with the same sum have
them in common, and neighbouring windows take them from the same products.
"""

import abc
import functools
import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from .._types import Array
from .matrices import AbstractMatrices, Whole


class Columns(eqx.Module):
    """The columns x^power * signal of a local regression; signal -1 is a column of zeros."""

    power: tuple[int, ...] = eqx.field(static=True)
    signal: tuple[int, ...] = eqx.field(static=True)


class Group(NamedTuple):
    """Pairs a <= b of signals whose products have moments of the same powers, from `lowest` to `highest`."""

    lowest: int
    highest: int
    first: tuple[int, ...]
    second: tuple[int, ...]

    @property
    def n_power(self) -> int:
        return self.highest - self.lowest + 1


@functools.lru_cache(maxsize=64)
def groups_of(columns: Columns) -> tuple[Group, ...]:
    """The moments that the products of these columns are made of."""
    powers: dict[int, list[int]] = {}
    for power, signal in zip(columns.power, columns.signal, strict=True):
        powers.setdefault(signal, []).append(power)
    alike: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for pair in itertools.combinations_with_replacement(sorted(powers.keys() - {-1}), 2):
        of = [powers[signal] for signal in pair]
        alike.setdefault((sum(map(min, of)), sum(map(max, of))), []).append(pair)
    return tuple(Group(*reach, *zip(*pairs, strict=True)) for reach, pairs in alike.items())


def highest_power(columns: Columns) -> int:
    """Of any moment."""
    return 2 * max(columns.power)


def powers_of(x: Float[Array, "..."], highest: int) -> Float[Array, "power ..."]:
    """1, x, x^2 and so on."""
    found = [jnp.ones_like(x)]
    for _ in range(highest):
        found.append(found[-1] * x)
    return jnp.stack(found)


class AbstractGram(eqx.Module):
    """K^H K of a window, or of several side by side, K the columns at its lines: (col, col), of which only those blocks
    are made that are asked for."""

    @abc.abstractmethod
    def block(self, rows: Int[np.ndarray, "*batch row"], columns: Int[np.ndarray, "*batch col"]) -> AbstractMatrices:
        """The products of some columns with others, or with each other."""

    @property
    @abc.abstractmethod
    def power(self) -> Float[Array, "col *window"]:
        """Of every column, summed over its rows."""


class Gram(AbstractGram):
    """That of one window, by `moments`."""

    moments: Float[Array, "moment"]
    columns: Columns

    def block(self, rows, columns) -> Whole:
        of, place = (rows[..., :, None], columns[..., None, :]), _places(self.columns)
        real = self.moments[place.real[of]] * place.there[of]
        return Whole(jax.lax.complex(real, self.moments[place.imaginary[of]] * place.sign[of]))

    @property
    def power(self):
        real, there = (np.diagonal(x) for x in (_places(self.columns).real, _places(self.columns).there))
        return self.moments[real] * there


def products(signals: Complex[Array, "exp freq sig"], columns: Columns) -> list[Float[Array, "pair freq"]]:
    """conj(s_a) s_b of the pairs of every group, summed over experiments: real parts, then imaginary parts."""
    every = jnp.einsum("efa,efb->abf", signals.conj(), signals)
    found = [every[np.array(group.first), np.array(group.second)] for group in groups_of(columns)]
    return [jnp.concatenate([x.real, x.imag]) for x in found]


def moments(x: Float[Array, "line"], inside: Bool[Array, "line"], products, columns: Columns) -> Float[Array, "moment"]:
    """sum_j x_j^p conj(s_a) s_b from the `products` of every group, (pair, line), real parts and then imaginary ones:
    group by group, by powers, then pairs."""
    powers = jnp.where(inside, powers_of(x, highest_power(columns)), 0.0)
    found = [
        powers[group.lowest : group.highest + 1] @ of.T for group, of in zip(groups_of(columns), products, strict=True)
    ]
    return jnp.concatenate([x.ravel() for x in found])


class Places(NamedTuple):
    """For every entry of the Gram matrix: the places of its parts among the moments, the sign of its imaginary part,
    and whether there is such an entry."""

    real: np.ndarray
    imaginary: np.ndarray
    sign: np.ndarray
    there: np.ndarray


@functools.lru_cache(maxsize=64)
def _places(columns: Columns) -> Places:
    return places_of(columns, lambda group: (1, 2 * len(group.first)))


def places_of(columns: Columns, strides) -> Places:
    """`strides(group)`: from the moment of a pair to that of the next one, and to that of the next power."""
    power, signal = np.asarray(columns.power), np.asarray(columns.signal)
    at_power_zero, to_imaginary, to_next_power = np.zeros((3, max(signal) + 1, max(signal) + 1), int)
    first = 0
    for group in groups_of(columns):
        count = len(group.first)
        of_pair, of_power = strides(group)
        at_power_zero[group.first, group.second] = first + np.arange(count) * of_pair - group.lowest * of_power
        to_imaginary[group.first, group.second] = count * of_pair
        to_next_power[group.first, group.second] = of_power
        first += 2 * count * group.n_power
    pair = np.minimum.outer(signal, signal), np.maximum.outer(signal, signal)
    there = pair[0] >= 0
    real = np.where(there, at_power_zero[pair] + to_next_power[pair] * np.add.outer(power, power), 0)
    imaginary = np.where(there, real + to_imaginary[pair], 0)
    return Places(real, imaginary, np.sign(signal[None] - signal[:, None]) * there, there.astype(float))
