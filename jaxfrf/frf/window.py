"""Sliding windows over the excited lines, and the Gram matrices of the regressors in them.

A window of w lines around line k holds the columns x^p s_a, where s_a is a signal (reference, input, output, or 1 for a
transient) and x the local variable, zero at line k. All that a least-squares fit needs of them are the inner products
sum_j x_j^(p+q) conj(s_a) s_b: *moments* of products of signals. For windows that are neighbours the products are the
same, so that `vmap` makes one real matrix product of their moments: no window is ever gathered, and experiments that
share a model are summed before the product.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from .._errors import input_error
from .._types import Array

_TILE = 48  # neighbouring windows that are solved together: their moments and Gram matrices stay in the cache
_BLOCK = 512  # windows of one line that are solved together


class Windows(eqx.Module):
    """Where the window of every line stands.

    - `coordinate`: (freq,), the local variable before centring and scaling: line index or frequency.
    - `start`, `stop`: (freq,), first line of each window, and the one after its last. Even widths 2b reach from -b to
      b-1 (the paper's window), odd ones are symmetric; near the ends of the band windows are shifted inwards and no
      longer centred.
    - `span`: lines that the windows of neighbouring lines touch together, rounded up so that windows of similar width
      share compiled code.
    """

    coordinate: Float[Array, "freq"]
    start: Int[Array, "freq"]
    stop: Int[Array, "freq"]
    span: int = eqx.field(static=True)

    @property
    def width(self) -> Int[Array, ""]:
        return self.stop[0] - self.start[0]

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
    span = 1 if width == 1 else min(-(-(min(_TILE, n) + width) // _TILE) * _TILE, n)
    return Windows(coordinate, start, start + int(width), span)


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


def products(signals: Complex[Array, "exp freq sig"]) -> Float[Array, "freq pair"]:
    """conj(s_a) s_b of every pair a <= b of signals, summed over experiments: real parts, then imaginary parts."""
    upper = np.triu_indices(signals.shape[-1])
    every = jnp.einsum("efa,efb->fab", signals.conj(), signals)[:, upper[0], upper[1]]
    return jnp.concatenate([every.real, every.imag], axis=-1)


def gram(
    x: Float[Array, "line"], inside: Bool[Array, "line"], products: Float[Array, "line pair"], columns: Columns
) -> Complex[Array, "col col"]:
    """K^H K of one window, K the columns at the lines inside, from the products of its signals."""
    powers = jnp.stack([jnp.where(inside, x**p, 0.0) for p in range(2 * max(columns.power) + 1)])
    place, sign, real = _layout(columns.power, columns.signal, products.shape[-1] // 2)
    moments = powers @ products
    real_part, imaginary_part = (part.reshape(-1)[place] for part in jnp.split(moments, 2, axis=-1))
    return jax.lax.complex(real_part * real, imaginary_part * sign)


def over_windows(solve, signals: Complex[Array, "exp freq sig"], windows: Windows, columns: Columns, of=None):
    """`solve(A)` of every window, A its Gram matrix: a pytree with leading axis freq.

    One window after the other is written here; `vmap` takes it over neighbouring lines, `lax.map` over blocks of them,
    so that only what `solve` returns is ever kept of all. `of`: the signals' `products`, where they are known already.
    """
    n_freq, span = signals.shape[1], windows.span
    if span == 1:
        return jax.lax.map(solve, _gram_of_lines(signals, columns), batch_size=_BLOCK)
    of = products(signals) if of is None else of

    def one_window(line, near, products):
        return solve(gram(*local_variable(windows, line, near), products, columns))

    tile = min(_TILE, n_freq)

    def one_tile(first):
        source = jnp.clip(jnp.asarray(windows.start)[first], 0, n_freq - span)
        lines = jnp.minimum(first + jnp.arange(tile), n_freq - 1)
        near, part = source + jnp.arange(span), jax.lax.dynamic_slice_in_dim(of, source, span, 0)
        return jax.vmap(one_window, in_axes=(0, None, None))(lines, near, part)

    tiles = jax.lax.map(one_tile, jnp.arange(0, n_freq, tile))
    return jax.tree.map(lambda y: y.reshape(-1, *y.shape[2:])[:n_freq], tiles)


def _gram_of_lines(signals, columns: Columns) -> Complex[Array, "freq col col"]:
    """The Gram matrices of windows of one line, where x is zero."""
    which, power = np.asarray(columns.signal), np.asarray(columns.power)
    used = signals if np.array_equal(which, np.arange(signals.shape[-1])) else signals[..., which]
    used = jnp.where((power == 0) & (which >= 0), used, 0)
    return jnp.einsum("efa,efb->fab", used.conj(), used)


def rows(signals: Complex[Array, "exp freq sig"], windows: Windows, columns: Columns, line):
    """K of the window around `line` written out: (exp*width, col). The width must be known when this is compiled."""
    near = jnp.asarray(windows.start)[line] + np.arange(windows.width)
    x, _ = local_variable(windows, line, near)
    real = np.asarray(columns.signal) >= 0
    part = signals[:, near][..., np.maximum(columns.signal, 0)]
    K = jnp.where(real, x[:, None] ** np.asarray(columns.power) * part, 0.0)
    return K.reshape(-1, len(columns.power))


@functools.lru_cache(maxsize=64)
def _layout(power: tuple[int, ...], signal: tuple[int, ...], n_pair: int):
    """For every entry of the Gram matrix: its place among the moments, the sign of its imaginary part, whether there is
    such an entry."""
    n_sig = round((np.sqrt(8 * n_pair + 1) - 1) / 2)
    upper = np.triu_indices(n_sig)
    pair = np.zeros((n_sig, n_sig), int)
    pair[upper] = np.arange(n_pair)
    pair = np.maximum(pair, pair.T)
    s, p = np.maximum(signal, 0), np.asarray(power)
    real = np.asarray(signal) >= 0
    both = (real[:, None] & real[None]).astype(float)
    place = (p[:, None] + p[None]) * n_pair + pair[s[:, None], s[None]]
    return place, np.sign(s[None] - s[:, None]) * both, both
