"""Sliding windows over the excited lines, and the Gram matrices of the regressors in them.

A window of w lines around line k holds the columns x^p s_a, where s_a is a signal (reference, input, output, or 1 for a
transient) and x the local variable, zero at line k. All that a least-squares fit needs of them are the inner products
sum_j x_j^(p+q) conj(s_a) s_b: *moments* of products of signals. For windows that are neighbours the products are the
same, so that `vmap` makes one real matrix product of their moments: no window is ever gathered, and experiments that
share a model are summed before the product.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from .._device import at_once, on_accelerator
from .._errors import input_error
from .._types import Array
from .lanes import LANES, Lanes
from .matrices import AbstractMatrices, Whole

_PART, _LEAST_PART = 16, 4  # neighbouring windows whose moments are one product, which meets the lines of all of them
_SMALL = 56  # columns, up to which windows go side by side: more leave the cache, and compile for 5 s longer
_MANY = 64  # lines, from which on that is worth its compilation, which takes half a second to two more
_TILE = 48  # windows that are solved together
_CACHE = 1.4e6  # bytes of Gram matrices of a tile: a core has about as much for itself
_WIDE = 4  # times as many lines as columns: moments of such windows take as long as the rest, parts are to be large


class Windows(eqx.Module):
    """Where the window of every line stands.

    - `coordinate`: (freq,), the local variable before centring and scaling: line index or frequency.
    - `start`, `stop`: (freq,), first line of each window, and the one after its last. Even widths 2b reach from -b to
      b-1 (the paper's window), odd ones are symmetric; near the ends of the band windows are shifted inwards and no
      longer centred.
    """

    coordinate: Float[Array, "freq"]
    start: Int[Array, "freq"]
    stop: Int[Array, "freq"]

    @property
    def width(self) -> int:
        return int(self.stop[0] - self.start[0])

    @property
    def centred(self) -> Bool[Array, "freq"]:
        """Whether each window stands around its line."""
        return self.start == np.arange(len(self.start)) - self.width // 2


def windows(coordinate, width: int) -> Windows:
    """The windows of `width` lines around every line.

    **Raises:** `jaxfrf.InputError` if there are fewer lines.
    """
    n = len(coordinate)
    if width > n:
        raise input_error(
            "width",
            f"a window of {width} lines",
            f"at most the {n} excited lines there are",
            "Lower the order or the width, use more experiments, or excite more lines.",
        )
    start = np.clip(np.arange(n) - width // 2, 0, n - width)
    return Windows(coordinate, start, start + int(width))


def local_variable(windows: Windows, line, near) -> tuple[Float[Array, "line"], Bool[Array, "line"]]:
    """x of the window around `line` at the lines `near`, scaled to at most 1, and which of them are inside.

    The paper's r of Eq. (def_G), over its largest magnitude: that scales unknowns and leaves the response as it is."""
    start, stop = jnp.asarray(windows.start)[line], jnp.asarray(windows.stop)[line]
    inside = (near >= start) & (near < stop)
    coordinate = jnp.asarray(windows.coordinate, float)
    x = jnp.where(inside, coordinate[near] - coordinate[line], 0.0)
    return x / jnp.maximum(jnp.max(jnp.abs(x)), 1e-300), inside


class Columns(eqx.Module):
    """The columns x^power * signal of a local regression; signal -1 is a column of zeros."""

    power: tuple[int, ...] = eqx.field(static=True)
    signal: tuple[int, ...] = eqx.field(static=True)


class Group(NamedTuple):
    """Pairs a <= b of signals whose products have moments of powers up to the same `highest`."""

    highest: int
    first: tuple[int, ...]
    second: tuple[int, ...]


def products(signals: Complex[Array, "exp freq sig"], columns: Columns) -> list[Float[Array, "pair freq"]]:
    """conj(s_a) s_b of the pairs of every group, summed over experiments: real parts, then imaginary parts."""
    every = jnp.einsum("efa,efb->abf", signals.conj(), signals)
    found = [every[np.array(group.first), np.array(group.second)] for group in _groups(columns)]
    return [jnp.concatenate([x.real, x.imag]) for x in found]


def moments(
    x: Float[Array, "*window line"], inside: Bool[Array, "*window line"], products, columns: Columns
) -> Float[Array, "moment *window"]:
    """sum_j x_j^p conj(s_a) s_b from the `products` of every group, (pair, line), real parts and then imaginary ones.

    Group by group; of one window by powers, then pairs; of several by pairs, then powers, so that windows stay
    innermost."""
    powers = jnp.stack([jnp.where(inside, x**p, 0.0) for p in range(2 * max(columns.power) + 1)])
    found = []
    for group, of in zip(_groups(columns), products, strict=True):
        of_group = powers[: group.highest + 1]
        found.append(of_group @ of.T if x.ndim == 1 else jnp.tensordot(of, of_group, (1, -1)))
    return jnp.concatenate([m.reshape(-1, *x.shape[:-1]) for m in found])


class Gram(eqx.Module):
    """K^H K of one window, or of several side by side, K the columns at its lines: (col, col), of which only those
    blocks are made that are asked for."""

    moments: Float[Array, "moment *window"]
    columns: Columns
    first: Int[Array, ""] | int = 0  # of its own among the moments

    def block(self, rows: Int[np.ndarray, "*batch row"], columns: Int[np.ndarray, "*batch col"]) -> AbstractMatrices:
        """The products of some columns with others, or with each other."""
        of, place = (rows[..., :, None], columns[..., None, :]), self._places
        which = np.stack([place.real[of], place.imaginary[of]])
        sign = np.stack([place.there[of], place.sign[of]])
        parts = self.moments[self.first + which]
        if self.moments.ndim > 1:
            return Lanes(parts * sign[..., None])
        return Whole(jax.lax.complex(*(parts * sign)))

    @property
    def power(self) -> Float[Array, "col *window"]:
        """Of every column, summed over its rows."""
        real, there = (np.diagonal(x) for x in (self._places.real, self._places.there))
        return self.moments[self.first + real] * there.reshape(-1, *[1] * (self.moments.ndim - 1))

    @property
    def _places(self) -> "_Places":
        return _places(self.columns, self.moments.ndim == 1)


def over_windows(solve, signals: Complex[Array, "exp freq sig"], several: Sequence[Windows], columns: Columns):
    """`solve(A, number)` of every window of every one of several `Windows`, A its `Gram` matrix: a pytree with leading
    axes (number, freq).

    Neighbouring windows go side by side through the registers of a processor (`lanes`), one group after the other
    (`lax.map`), so that only what `solve` returns is ever kept of all. Large ones, and all on an accelerator, are taken
    one by one by `vmap`.
    """
    n_freq, of = signals.shape[1], products(signals, columns)
    in_lanes = len(columns.power) <= _SMALL and n_freq >= _MANY and not on_accelerator()
    size, n_part = (LANES, 1) if in_lanes else _parts(several, n_freq, len(columns.power))

    def one_part(windows, first):
        lines = jnp.minimum(first + np.arange(size), n_freq - 1)
        span = min(size - 1 + windows.width, n_freq)
        source = jnp.clip(jnp.asarray(windows.start)[lines[0]], 0, n_freq - span)
        part = [jax.lax.dynamic_slice_in_dim(x, source, span, 1) for x in of]
        near = source + np.arange(span)
        of_each = lambda line: local_variable(windows, line, near)
        if in_lanes:
            return moments(*jax.vmap(of_each)(lines), part, columns)
        return jax.vmap(lambda line: moments(*of_each(line), part, columns))(lines)

    def parts(windows, first):
        if on_accelerator():
            every = jax.vmap(lambda i: one_part(windows, first + i * size))(np.arange(n_part))
            return [every.reshape(-1, every.shape[-1])]
        return [one_part(windows, first + i * size) for i in range(n_part)]

    def one_tile(first):
        if in_lanes:
            every = jnp.concatenate([one_part(windows, first) for windows in several])
            count = len(every) // len(several)
            return _of_each(lambda number: solve(Gram(every, columns, number * count), number), len(several))
        every = jnp.concatenate([x for windows in several for x in parts(windows, first)])
        number = np.repeat(np.arange(len(several)), n_part * size)
        found = jax.vmap(lambda moments, number: solve(Gram(moments, columns), number))(every, number)
        return jax.tree.map(lambda x: x.reshape(len(several), n_part * size, *x.shape[1:]), found)

    def in_order(x):
        x = jnp.moveaxis(x, 1, 0)
        return x.reshape(len(several), -1, *x.shape[3:])[:, :n_freq]

    return jax.tree.map(in_order, jax.lax.map(one_tile, jnp.arange(0, n_freq, n_part * size)))


def _of_each(solve, count: int):
    """`solve(number)` of every number, stacked."""
    if count == 1:
        return jax.tree.map(lambda x: x[None], solve(0))
    return jax.lax.map(solve, jnp.arange(count))


def _parts(several: Sequence[Windows], n_freq: int, n_column: int) -> tuple[int, int]:
    """Neighbouring windows whose moments are one product, and how many such parts of each of `several` make a tile."""
    tile = at_once(n_column) if on_accelerator() else _windows_of_tile(n_column)
    wide = max(windows.width for windows in several) > _WIDE * n_column
    size = min(_PART, max(tile // len(several), _PART if wide else _LEAST_PART), n_freq)
    return size, max(min(tile // len(several), n_freq + size - 1) // size, 1)


def _windows_of_tile(n_column: int) -> int:
    """Windows of so many columns, that a processor solves together."""
    return min(_TILE, int(_CACHE / (16 * n_column**2)))


def rows(signals: Complex[Array, "exp freq sig"], windows: Windows, columns: Columns, line):
    """K of the window around `line` written out: (exp*width, col)."""
    near = jnp.asarray(windows.start)[line] + np.arange(windows.width)
    x, _ = local_variable(windows, line, near)
    real = np.asarray(columns.signal) >= 0
    part = signals[:, near][..., np.maximum(columns.signal, 0)]
    K = jnp.where(real, x[:, None] ** np.asarray(columns.power) * part, 0.0)
    return K.reshape(-1, len(columns.power))


@functools.lru_cache(maxsize=64)
def _groups(columns: Columns) -> tuple[Group, ...]:
    """The moments that the products of these columns are made of."""
    highest: dict[int, int] = {}
    for power, signal in zip(columns.power, columns.signal, strict=True):
        highest[signal] = max(power, highest.get(signal, 0))
    alike: dict[int, list[tuple[int, int]]] = {}
    for pair in itertools.combinations_with_replacement(sorted(highest.keys() - {-1}), 2):
        alike.setdefault(highest[pair[0]] + highest[pair[1]], []).append(pair)
    return tuple(Group(power, *zip(*pairs, strict=True)) for power, pairs in alike.items())


class _Places(NamedTuple):
    """For every entry of the Gram matrix: the places of its parts among the moments, the sign of its imaginary part,
    and whether there is such an entry."""

    real: np.ndarray
    imaginary: np.ndarray
    sign: np.ndarray
    there: np.ndarray


@functools.lru_cache(maxsize=64)
def _places(columns: Columns, of_one: bool) -> _Places:
    power, signal = np.asarray(columns.power), np.asarray(columns.signal)
    at_power_zero, to_imaginary, to_next_power = np.zeros((3, max(signal) + 1, max(signal) + 1), int)
    first = 0
    for group in _groups(columns):
        count, powers = len(group.first), group.highest + 1
        of_pair, of_power = (1, 2 * count) if of_one else (powers, 1)
        at_power_zero[group.first, group.second] = first + np.arange(count) * of_pair
        to_imaginary[group.first, group.second] = count * of_pair
        to_next_power[group.first, group.second] = of_power
        first += 2 * count * powers
    pair = np.minimum.outer(signal, signal), np.maximum.outer(signal, signal)
    there = pair[0] >= 0
    real = np.where(there, at_power_zero[pair] + to_next_power[pair] * np.add.outer(power, power), 0)
    imaginary = np.where(there, real + to_imaginary[pair], 0)
    return _Places(real, imaginary, np.sign(signal[None] - signal[:, None]) * there, there.astype(float))
