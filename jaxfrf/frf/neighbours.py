"""Moments and Gram matrices of neighbouring windows side by side.

Eight neighbouring windows have nearly all of their lines in common: the *core*, from where the last of them begins to
where the first one ends, and at most seven lines on either side of it, the *edges*. Moments of the core are taken once,
about its middle m; about the centre c of each window, in units of its reach h, they are

    sum_j ((x_j - c)/h)^p P_j = sum_k binom(p, k) (1/h)^k ((m - c)/h)^(p-k) sum_j (x_j - m)^k P_j,

to which the edges are added line by line. A window's lines of the core are within its reach, so that no term of the sum
is larger than what it adds up to. Cores of several widths are one product of matrices.
"""

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from .._compile import after, apart
from .._types import Array
from . import lanes
from .gram import AbstractGram, Columns, Group, Places, groups_of, highest_power, places_of, powers_of
from .lanes import LANES, Lanes

if TYPE_CHECKING:
    from .window import Windows


_APART = 60  # lines that one width would have to have less, for two products of matrices to be faster than one


class NeighbouringGrams(AbstractGram):
    """Those of neighbouring windows.

    `moments`: of every group the real parts and then the imaginary ones, by pairs, then powers; behind all of these the
    imaginary ones with the other sign, then zeros."""

    moments: Float[Array, "row window"]
    columns: Columns

    def block(self, rows, columns) -> Lanes:
        of, place = (rows[..., :, None], columns[..., None, :]), _places(self.columns)
        return Lanes(self.moments[np.stack([place.real[of], place.imaginary[of]])])

    @property
    def power(self):
        return self.moments[np.diagonal(_places(self.columns).real)]


class Neighbours(eqx.Module):
    """Neighbouring windows of several widths.

    - `begin`, `end`: first line of each, and the one after its last.
    - `centre`, `reach`: coordinate of its line, and the largest distance of its lines from there (1 of a single line).
    - `middle`: the coordinate about which moments of the cores are taken."""

    begin: Int[Array, "width window"]
    end: Int[Array, "width window"]
    centre: Float[Array, "window"]
    reach: Float[Array, "width window"]
    middle: Float[Array, ""]


def over_neighbours(solve, signals: Complex[Array, "exp freq sig"], several: Sequence["Windows"], columns: Columns):
    """`solve(A, number)` of every window of every one of several `Windows` around the same lines: a pytree with leading
    axes (number, line)."""
    n_freq, count, widest = signals.shape[1], several[0].count, max(windows.width for windows in several)
    every = _lines_of_windows(several, min(count + widest + LANES, n_freq))
    of = products(jax.lax.dynamic_slice_in_dim(signals, every[0], len(every), axis=1), columns)
    coordinate = jnp.asarray(several[0].coordinate, float)[every]
    n_line = min(widest + LANES - 1, len(every))

    def around(first):
        near = neighbours(several, jnp.minimum(first + np.arange(LANES), n_freq - 1))
        source = jnp.minimum(jnp.min(near.begin), every[-1] + 1 - n_line)
        here = (jax.lax.dynamic_slice_in_dim(x, source - every[0], n_line) for x in (coordinate, of))
        moments = _moments(near, _Lines(source + np.arange(n_line), *here), columns, [w.width for w in several])
        return _of_each(lambda number: solve(NeighbouringGrams(moments(number), columns), number), len(several))

    return by_number(jax.lax.map(around, several[0].first + jnp.arange(0, count, LANES)), count)


def _lines_of_windows(several: Sequence["Windows"], count: int) -> Int[Array, "line"]:
    """So many lines, among which are all of the windows."""
    n_freq, first = len(several[0].coordinate), several[0].first
    begin = functools.reduce(jnp.minimum, [jnp.asarray(windows.start)[first] for windows in several])
    return jnp.minimum(begin, n_freq - count) + np.arange(count)


def by_number(found, n_line: int):
    """(tile, number, line, ...) as (number, line, ...)."""

    def in_order(x):
        x = jnp.moveaxis(x, 1, 0)
        return x.reshape(x.shape[0], -1, *x.shape[3:])[:, :n_line]

    return jax.tree.map(in_order, found)


def _of_each(solve, count: int):
    """`solve(number)` of every number, stacked."""
    if count == 1:
        return jax.tree.map(lambda x: x[None], solve(0))
    return jax.lax.map(solve, jnp.arange(count))


def neighbours(several: Sequence["Windows"], lines: Int[Array, "window"]) -> Neighbours:
    """The windows around some lines."""
    coordinate = jnp.asarray(several[0].coordinate, float)
    begin, end = (jnp.asarray(np.stack(x))[:, lines] for x in zip(*((w.start, w.stop) for w in several), strict=True))
    centre = coordinate[lines]
    reach = jnp.maximum(jnp.abs(coordinate[begin] - centre), jnp.abs(coordinate[end - 1] - centre))
    return Neighbours(begin, end, centre, jnp.where(reach > 0, reach, 1.0), centre[LANES // 2])


class _Lines(eqx.Module):
    """The lines that hold some windows: their numbers, coordinates and products."""

    number: Int[Array, "line"]
    coordinate: Float[Array, "line"]
    products: Float[Array, "line product"]


def _moments(windows: Neighbours, here: _Lines, columns: Columns, widths: list[int]):
    """What takes the number of a width to the moments of its windows."""
    highest, groups = highest_power(columns), groups_of(columns)
    core, (table, *places) = _cores(windows, here, highest, widths), _tables(windows, here, highest)
    tables = [_of_group(table, group, highest) for group in groups]
    ends = np.cumsum([0, *(2 * len(group.first) for group in groups)])

    def of_width(number):
        edges = [jax.lax.dynamic_slice_in_dim(here.products, place[number], LANES - 1) for place in places]
        parts = []
        for group, of_group, first, last in zip(groups, tables, ends[:-1], ends[1:], strict=True):
            part = group.highest + 1, int(first), int(last)
            parts.append(_summed(of_group[number], (core[number], *edges), part, parts[-1:]))
        return _one_behind_the_other([*parts, *(-x[len(x) // 2 :] for x in parts)])

    return of_width


def _of_group(table, group: Group, highest: int) -> Float[Array, "width term number"]:
    """The table for those moments that a group has."""
    of_powers = table[:, :, group.lowest : group.highest + 1]
    of_powers = jnp.concatenate([of_powers[:, : group.highest + 1], of_powers[:, highest + 1 :]], axis=1)
    return of_powers.reshape(*of_powers.shape[:2], -1)


def _summed(table, values, part: tuple[int, int, int], before) -> Float[Array, "moment window"]:
    """Sum over powers of the core and lines of the edges, of some products, `before` being there: what has to wait for
    nothing XLA hands to another core, which takes longer than the sum."""
    n_core, first, last = part

    @apart
    def summed(before, table, core, *edges):
        terms = zip([row[first:last, None] for x in (core[:n_core], *edges) for row in x], table, strict=True)
        total = sum(products * numbers for products, numbers in terms)
        return functools.reduce(after, before, total)

    return summed(before, table, *values).reshape(-1, LANES)


def _one_behind_the_other(parts) -> Float[Array, "row window"]:
    """And zeros behind; copied as they are, as XLA writes a concatenation element by element."""
    found, first = jnp.zeros((sum(map(len, parts)) + 1, LANES)), 0
    for part in parts:
        found = jax.lax.dynamic_update_slice_in_dim(found, part, first, 0)
        first += len(part)
    return found


def _cores(windows: Neighbours, here: _Lines, highest: int, widths: list[int]) -> Float[Array, "width power product"]:
    """Moments of the lines that all windows of a width have, about the middle."""
    parts = [(_some(windows, which), max(widths[which])) for which in _together(widths)]
    return jnp.concatenate([_core(part, _about(part, here, widest), highest) for part, widest in parts])


def _together(widths: list[int]) -> list[slice]:
    """Widths that are taken together: all, or the first and the last ones by themselves where that is less to multiply,
    as narrow windows have few of the lines."""

    def cost(first: int) -> int:
        return sum(len(part) * (max(part) + LANES) + _APART for part in (widths[:first], widths[first:]) if part)

    first = min(range(len(widths)), key=cost)
    return [part for part in (slice(first), slice(first, None)) if widths[part]]


def _some(windows: Neighbours, which: slice) -> Neighbours:
    """Those of some widths."""
    begin, end, reach = (x[which] for x in (windows.begin, windows.end, windows.reach))
    return Neighbours(begin, end, windows.centre, reach, windows.middle)


def _about(windows: Neighbours, here: _Lines, widest: int) -> _Lines:
    """The lines that hold them."""
    count = min(widest + LANES - 1, len(here.number))
    first = jnp.minimum(jnp.min(windows.begin) - here.number[0], len(here.number) - count)
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, count), here)


def _core(windows: Neighbours, here: _Lines, highest: int) -> Float[Array, "width power product"]:
    inside = (here.number >= windows.begin[:, -1:]) & (here.number < windows.end[:, :1])
    powers = jnp.where(inside[:, None], powers_of(here.coordinate - windows.middle, highest), 0.0)
    return (powers.reshape(-1, inside.shape[1]) @ here.products).reshape(*powers.shape[:2], -1)


def _tables(windows: Neighbours, here: _Lines, highest: int):
    """(width, power of the core and then line of an edge, power, window): what each of them counts in each moment; and
    for both edges the first line, (width,), counted from the first one here."""
    both = [_edge(windows, here, highest, first, stop) for first, stop in _edges(windows)]
    return jnp.concatenate([_shift(windows, highest), *(table for table, _ in both)], axis=1), *(x for _, x in both)


def _shift(windows: Neighbours, highest: int) -> Float[Array, "width power power window"]:
    """binom(p, k) (1/h)^k ((m - c)/h)^(p-k)."""
    k, p = np.arange(highest + 1)[:, None], np.arange(highest + 1)
    binomial = np.array([[math.comb(p, k) for p in range(highest + 1)] for k in range(highest + 1)], float)
    scale = powers_of(1 / windows.reach, highest)[k]
    away = powers_of((windows.middle - windows.centre) / windows.reach, highest)[np.maximum(p - k, 0)]
    return jnp.moveaxis(binomial[..., None, None] * scale * away, 2, 0)


def _edges(windows: Neighbours):
    """First and last of the lines that some windows have before the core, and behind it."""
    before = windows.begin[:, 0], jnp.minimum(windows.begin[:, -1:], windows.end)
    behind = jnp.maximum(windows.end[:, 0], windows.begin[:, -1]), windows.end
    return before, behind


def _edge(windows: Neighbours, here: _Lines, highest: int, first, stop):
    """Powers of its lines in each window that has them, (width, line, power, window), and the first line's place."""
    first_here = jnp.clip(first - here.number[0], 0, len(here.number) - (LANES - 1))
    near = first_here[:, None] + np.arange(LANES - 1)  # (width, line)
    number, x = here.number[near][..., None], here.coordinate[near][..., None]
    inside = (number >= jnp.maximum(windows.begin, first[:, None])[:, None]) & (number < stop[:, None])
    powers = powers_of((x - windows.centre) / windows.reach[:, None], highest)
    return jnp.where(inside[:, :, None], jnp.moveaxis(powers, 0, 2), 0.0), first_here


def products(signals: Complex[Array, "exp freq sig"], columns: Columns) -> Float[Array, "freq product"]:
    """conj(s_a) s_b summed over experiments: of every group's pairs real parts, then imaginary parts."""
    of_signals = lanes.of_signal(signals)
    every = of_signals.times_adjoint(of_signals).parts  # s_a conj(s_b), (2, group, sig, sig, lane)
    n_sig = every.shape[-2]
    real = [np.array(group.second) * n_sig + np.array(group.first) for group in groups_of(columns)]
    place = np.concatenate([np.concatenate([x, x + n_sig**2]) for x in real])
    by_line = every.transpose(1, 4, 0, 2, 3).reshape(-1, 2 * n_sig**2)
    return by_line[: signals.shape[1], place]


@functools.lru_cache(maxsize=64)
def _places(columns: Columns) -> Places:
    """As of one window, but that the sign is a matter of the place."""
    with_signs, negative = places_of(columns, lambda group: (group.n_power, 1)), _negative(columns)
    zero = _n_moment(columns) + len(negative) // 2
    sign, there = with_signs.sign, with_signs.there
    imaginary = np.where(sign < 0, negative[with_signs.imaginary], with_signs.imaginary)
    return Places(np.where(there > 0, with_signs.real, zero), np.where(sign != 0, imaginary, zero), sign, there)


def _negative(columns: Columns) -> np.ndarray:
    """For every moment that is an imaginary part, the place of the same with the other sign."""
    found, first, at = np.zeros(_n_moment(columns), int), 0, _n_moment(columns)
    for group in groups_of(columns):
        count = len(group.first) * group.n_power
        found[first + count : first + 2 * count] = at + np.arange(count)
        first, at = first + 2 * count, at + count
    return found


def _n_moment(columns: Columns) -> int:
    return sum(2 * len(group.first) * group.n_power for group in groups_of(columns))
