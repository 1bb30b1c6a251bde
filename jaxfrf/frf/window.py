"""Sliding windows over the excited lines, and what is made of the Gram matrix of each.

No window is ever gathered: of neighbours `vmap` makes one real matrix product of their moments, and experiments that
share a model are summed before it.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from .._device import at_once, on_accelerator
from .._errors import input_error
from .._types import Array
from .gram import Columns, Gram, moments, products
from .neighbours import by_number, over_neighbours
from .part import Part

_PART, _LEAST_PART = 16, 4  # neighbouring windows whose moments are one product, which meets the lines of all of them
_SMALL = 56  # columns, up to which windows go side by side: more leave the cache, and compile for 5 s longer
_MANY = 64  # lines, from which on that is worth its compilation, which takes half a second to two more
_TILE = 48  # windows that are solved together
_CACHE = 1.4e6  # bytes of Gram matrices of a tile: a core has about as much for itself
_WIDE = 4  # times as many lines as columns: moments of such windows take as long as the rest, parts are to be large


class Windows(eqx.Module):
    """Where the window of every line stands, and around which lines windows are wanted.

    - `coordinate`: (freq,), the local variable before centring and scaling: line index or frequency.
    - `start`, `stop`: (freq,), first line of each window, and the one after its last. Even widths 2b reach from -b to
      b-1 (the paper's window), odd ones are symmetric; near the ends of the band windows are shifted inwards and no
      longer centred.
    - `part`: those lines; all where it is `None`.
    """

    coordinate: Float[Array, "freq"]
    start: Int[Array, "freq"]
    stop: Int[Array, "freq"]
    part: Part | None = None

    @property
    def width(self) -> int:
        return int(self.stop[0] - self.start[0])

    @property
    def centred(self) -> Bool[Array, "freq"]:
        """Whether each window stands around its line."""
        return self.start == np.arange(len(self.start)) - self.width // 2

    @property
    def first(self):
        """The first line of the part."""
        return 0 if self.part is None else self.part.first

    @property
    def count(self) -> int:
        """Lines of the part."""
        return len(self.start) if self.part is None else self.part.count

    @property
    def lines(self) -> Int[Array, "line"]:
        """The lines of the part."""
        return np.arange(len(self.start)) if self.part is None else self.part.lines(len(self.start))


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


def over_windows(solve, signals: Complex[Array, "exp freq sig"], several: Sequence[Windows], columns: Columns):
    """`solve(A, number)` of every window of every one of several `Windows` around the same lines, A its Gram matrix: a
    pytree with leading axes (number, line).

    Neighbouring windows go side by side through the registers of a processor (`lanes`), one group after the other
    (`lax.map`), so that only what `solve` returns is ever kept of all. Large ones, and all on an accelerator, are taken
    one by one by `vmap`.
    """
    over = over_neighbours if side_by_side(columns, signals.shape[1]) else _one_by_one
    return over(solve, signals, several, columns)


def side_by_side(columns: Columns, n_line: int) -> bool:
    """Whether windows of so many lines go through the registers, and not through LAPACK."""
    return len(columns.power) <= _SMALL and n_line >= _MANY and not on_accelerator()


def _one_by_one(solve, signals, several: Sequence[Windows], columns: Columns):
    n_freq, of = signals.shape[1], products(signals, columns)
    count = several[0].count
    size, n_part = _parts(several, count, len(columns.power))

    def one_part(windows, first):
        lines = jnp.minimum(first + np.arange(size), n_freq - 1)
        span = min(size - 1 + windows.width, n_freq)
        source = jnp.clip(jnp.asarray(windows.start)[lines[0]], 0, n_freq - span)
        part = [jax.lax.dynamic_slice_in_dim(x, source, span, 1) for x in of]
        near = source + np.arange(span)
        return jax.vmap(lambda line: moments(*local_variable(windows, line, near), part, columns))(lines)

    def parts(windows, first):
        if on_accelerator():
            every = jax.vmap(lambda i: one_part(windows, first + i * size))(np.arange(n_part))
            return [every.reshape(-1, every.shape[-1])]
        return [one_part(windows, first + i * size) for i in range(n_part)]

    def one_tile(first):
        every = jnp.concatenate([x for windows in several for x in parts(windows, first)])
        number = np.repeat(np.arange(len(several)), n_part * size)
        found = jax.vmap(lambda moments, number: solve(Gram(moments, columns), number))(every, number)
        return jax.tree.map(lambda x: x.reshape(len(several), n_part * size, *x.shape[1:]), found)

    return by_number(jax.lax.map(one_tile, several[0].first + jnp.arange(0, count, n_part * size)), count)


def _parts(several: Sequence[Windows], n_line: int, n_column: int) -> tuple[int, int]:
    """Neighbouring windows whose moments are one product, and how many such parts of each of `several` make a tile."""
    tile = at_once(n_column) if on_accelerator() else _windows_of_tile(n_column)
    wide = max(windows.width for windows in several) > _WIDE * n_column
    size = min(_PART, max(tile // len(several), _PART if wide else _LEAST_PART), n_line)
    return size, max(min(tile // len(several), n_line + size - 1) // size, 1)


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
