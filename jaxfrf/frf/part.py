"""Some of the lines, which one core estimates while others estimate the rest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from .._types import Array
from .lanes import LANES


class Part(eqx.Module):
    """`count` lines from `first` on; behind the last one there is the last one again."""

    first: Int[Array, ""]
    count: int = eqx.field(static=True)

    def lines(self, n_line: int) -> Int[Array, "line"]:
        """Their numbers among so many."""
        return jnp.minimum(self.first + np.arange(self.count), n_line - 1)


def parts_of(n_line: int, n_part: int) -> list[Part]:
    """All lines in parts of one size, so that one program does for all: whole groups of those that go side by side."""
    size = -(-n_line // (n_part * LANES)) * LANES
    return [Part(np.asarray(first), size) for first in range(0, n_line, size)]


def joined(parts, n_line: int, axis: int):
    """What was found of every part, one behind the other along an axis: NumPy's arrays or JAX's."""

    def every(*arrays):
        xp = np if isinstance(arrays[0], np.ndarray) else jnp
        *others, last = arrays
        kept = n_line - sum(x.shape[axis] for x in others)
        last = last[(*[slice(None)] * axis, slice(kept))]
        return xp.concatenate([*others, last], axis=axis) if others else last

    return jax.tree.map(every, *parts)
