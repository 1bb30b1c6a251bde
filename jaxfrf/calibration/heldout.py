"""Positions that are not fitted."""

from collections.abc import Sequence

from .._errors import input_error


def heldout_numbers(heldout: Sequence[int], n_pos: int) -> tuple[int, ...]:
    """Numbers of the positions that are kept to judge a result on, each once, in order.

    **Raises:** `jaxfrf.InputError` where one of them is no position, or none is left to fit.
    """
    held = tuple(sorted({int(p) for p in heldout}))
    if held and (held[0] < 0 or held[-1] >= n_pos or len(held) == n_pos):
        raise input_error(
            "heldout",
            f"positions {', '.join(map(str, held))} of {n_pos}",
            f"some of 0 to {n_pos - 1}, and at least one left to fit",
            "Positions are counted from 0.",
        )
    return held
