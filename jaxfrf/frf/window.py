"""Sliding windows over the excited lines, and the Gram matrices of all of them at once.

A window of w lines around line k holds the regressor columns x^p s_a, where s_a is a signal (reference, input, output,
or 1 for a transient) and x the local variable, zero at line k. All that a least-squares fit needs are the inner
products sum_j x_j^(p+q) conj(s_a) s_b: *moments* of products of signals. For a tile of neighbouring windows they are
one real matrix product (banded weights times products), so no window is ever gathered, and experiments that share a
model are summed before the product.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from .._errors import input_error
from .._types import Array

_TILE = 48  # windows per matrix product: weights and products of a tile stay in the second-level cache


class Windows(eqx.Module):
    """Where the window of every line stands.

    - `coordinate`: (freq,), the local variable before centring and scaling: line index or frequency.
    - `start`: (freq,), index of each window's first line; the window is start..start+width-1.
    - `width`: lines in a window. Even widths 2b reach from -b to b-1 (the paper's window), odd ones are symmetric;
      near the ends of the band windows are shifted inwards and no longer centred.
    """

    coordinate: Float[Array, "freq"]
    start: Int[Array, "freq"]
    width: int = eqx.field(static=True)

    def __init__(self, coordinate, width: int):
        n = len(coordinate)
        if width > n:
            raise input_error(
                "width",
                f"a window of {width} lines",
                f"at most the {n} excited lines there are",
                "Lower the order or the width, use more experiments, or excite more lines.",
            )
        self.coordinate = np.asarray(coordinate, float)
        self.start = np.clip(np.arange(n) - width // 2, 0, n - width)
        self.width = int(width)

    @property
    def centred(self) -> np.ndarray:
        """Whether each window stands around its line: (freq,)."""
        return self.start == np.arange(len(self.start)) - self.width // 2


class Columns(eqx.Module):
    """The columns x^power * signal of a local regression."""

    power: tuple[int, ...] = eqx.field(static=True)
    signal: tuple[int, ...] = eqx.field(static=True)


def span_of(windows: Windows) -> int:
    """Lines that the windows of one tile touch, rounded up so that windows of similar width share compiled code."""
    n_freq = len(windows.start)
    return min(-(-(min(_TILE, n_freq) + windows.width) // _TILE) * _TILE, n_freq)


def gram(signals: Complex[Array, "exp freq sig"], coordinate, start, stop, span: int, columns: Columns, finish):
    """`finish(A)` of every window, A the Gram matrix conj(column)^T column summed over experiments and lines.

    **Arguments:** `signals`; `coordinate`, `start`, `stop` (freq,): local variable and first and last line (not
    included) of every window; `span`: from `span_of`. `finish` maps A (window, column, column) to a pytree of arrays
    with leading axis window; it is applied tile by tile, so that only what it returns is kept.

    **Returns:** what `finish` returns, leading axis freq.
    """
    n_freq = signals.shape[1]
    tile = min(_TILE, n_freq)
    first = np.arange(0, n_freq, tile)
    source = jnp.clip(start[first], 0, n_freq - span)
    upper = np.triu_indices(signals.shape[2])
    place, sign = _layout(columns.power, columns.signal, signals.shape[2])
    top_power = 2 * max(columns.power)

    a, b = signals[..., upper[0]], signals[..., upper[1]]
    products = jnp.sum(jnp.concatenate([_real_of_product(a, b), _imag_of_product(a, b)], -1), axis=0)

    def one_tile(at):
        origin, left = at
        k = jnp.minimum(origin + jnp.arange(tile), n_freq - 1)
        lines = left + jnp.arange(span)
        x = coordinate[lines] - coordinate[k][:, None]
        inside = (lines >= start[k][:, None]) & (lines < stop[k][:, None])
        x = jnp.where(inside, x, 0.0)
        x = x / jnp.maximum(jnp.max(jnp.abs(x), axis=1, keepdims=True), 1e-300)
        weight = jnp.stack([jnp.where(inside, x**p, 0.0) for p in range(top_power + 1)])
        block = jax.lax.dynamic_slice_in_dim(products, left, span, 0)
        moments = (weight.reshape(-1, span) @ block).reshape(top_power + 1, tile, 2, -1)
        moments = jnp.transpose(moments, (1, 2, 0, 3)).reshape(tile, 2, -1)
        return finish(jax.lax.complex(moments[:, 0, place], moments[:, 1, place] * sign))

    tiles = jax.lax.map(one_tile, (jnp.asarray(first), source))
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:n_freq], tiles)


def _real_of_product(a, b):
    return a.real * b.real + a.imag * b.imag


def _imag_of_product(a, b):
    return a.real * b.imag - a.imag * b.real


@functools.lru_cache(maxsize=64)
def _layout(power: tuple[int, ...], signal: tuple[int, ...], n_sig: int):
    """For every entry of the Gram matrix: its place among the moments, and the sign of its imaginary part."""
    upper = np.triu_indices(n_sig)
    pair = np.zeros((n_sig, n_sig), int)
    pair[upper] = np.arange(len(upper[0]))
    pair = np.maximum(pair, pair.T)
    s = np.asarray(signal)
    p = np.asarray(power)
    place = (p[:, None] + p[None]) * len(upper[0]) + pair[s[:, None], s[None]]
    return place, np.sign(s[None] - s[:, None]).astype(float)
