"""Several records of one robot as one set of data: other places, amplitudes, numbers of experiments."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from .._errors import input_error
from ..experiment import Experiment


def joined(records: Sequence[Experiment]) -> Experiment:
    """Several records as one: their positions one after the other, places that come again included.

    Where records have different numbers of experiments, each of their positions becomes several with as many
    experiments as divide them all.

    **Raises:** `jaxfrf.InputError` where they do not belong together.
    """
    if not records:
        raise input_error("data", "no record", "one or more", "Give the files of the experiment.")
    first = records[0]
    for other in records[1:]:
        for name in ("fs", "period", "n_time", "y_quantity", "r_quantity", "transient_periods"):
            if getattr(other, name) != getattr(first, name):
                raise input_error(
                    f"{name} of the records",
                    f"{getattr(first, name)} and {getattr(other, name)}",
                    "the same in all files",
                    "Take them one by one.",
                )
        if (other.r is None) != (first.r is None):
            raise input_error("r", "in some of the records only", "in all of them, or in none", "Leave it out.")
    for record in records:
        if record.q is None:
            raise input_error("q", "none", "the arm configuration of every position", "Store q with the records.")
    if len(records) == 1:
        return first
    count = together(records)
    stack = lambda name: np.concatenate([_split(getattr(r, name), count) for r in records])
    known = [np.asarray(r.lines) for r in records if r.lines is not None]
    return dataclasses.replace(
        first,
        u=stack("u"),
        y=stack("y"),
        r=None if first.r is None else stack("r"),
        q=np.concatenate([np.repeat(np.asarray(r.q), r.n_exp // count, axis=0) for r in records]),
        lines=np.unique(np.concatenate(known)) if known else None,
        sources=tuple(s for r in records for s in r.sources),
        warnings=tuple(dict.fromkeys(w for r in records for w in r.warnings)),
    )


def together(records: Sequence[Experiment]) -> int:
    """Experiments that a position has where these records are joined."""
    return math.gcd(*(record.n_exp for record in records))


def _split(signal, count: int):
    """(pos, exp, ...) with so many experiments a position."""
    signal = np.asarray(signal)
    return signal.reshape(-1, count, *signal.shape[2:])


def places(data: Experiment) -> np.ndarray:
    """Which place each position is, (pos,), counted from 0: those of the same arm configuration are one."""
    return np.unique(np.round(np.asarray(data.q), 9), axis=0, return_inverse=True)[1].reshape(-1)
