"""Where the arm stood: stated in a file, or as it was logged, joint by joint, along the record."""

from collections.abc import Sequence

import numpy as np

from .._text import number
from ._select import column
from ._variables import File, numbers, scaled

_STILL = 0.5  # rad (m): farther, peak to peak, no joint of an experiment about an operating point moves
_NEAR = 0.02  # rad (m): means of records that differ by less are of one position, and those within half a movement


def logged(file: File, signal: tuple[int, ...]) -> bool:
    """Whether q is a time record, as long as the `signal` of this shape, instead of (pos, joint)."""
    q = file.get("q")
    if q is None or np.ndim(q) == 0 or isinstance(q, str):
        return False
    shape = column(np.asarray(q)).shape
    positions = signal[0] if len(signal) == 4 else 1
    return shape[-2] == signal[-2] and not (len(shape) == 2 and shape[0] == positions)


def stated_configurations(file: File) -> np.ndarray | None:
    """Of all positions, (pos, joint), rad; `None` where nothing is said."""
    q = file.get("q")
    return None if q is None else scaled(file, "q", numbers(file, "q", q))


def mean_configurations(file: File, steady: slice, positions: int) -> tuple[np.ndarray, np.ndarray, str]:
    """The mean of what was logged, (pos, joint), rad; how far off another mean is of the same position, (joint,), rad,
    as a slow motion that begins elsewhere has another mean; and what is to be said of it.

    **Arguments:** `steady`: the samples that count. `positions`: how many the record has.

    **Raises:** `jaxfrf.InputError` where the arm travels, or its experiments are at different positions.
    """
    x = scaled(file, "q", column(numbers(file, "q", file.get("q"))))
    x = x[..., steady, :].astype(np.float64)
    x = x.reshape(positions if x.ndim == 4 else 1, -1, *x.shape[-2:])  # (pos, exp, time, joint)
    travel = np.ptp(x, axis=2)
    if travel.max() > _STILL:
        joint = int(np.argmax(travel.max(axis=(0, 1))))
        raise file.error(
            "q",
            f"joint {joint + 1} moving by {number(travel.max(), 2)} rad within an experiment",
            f"arm angles that stay within {_STILL:g} rad, whose mean is the operating point",
            "Degrees? --set q_unit=deg. Motor angles? --factor q=FACTOR, 1 over the gear ratio. Where the arm travels "
            "on purpose, leave q out.",
        )
    means = x.mean(axis=2)
    apart, near = np.ptp(means, axis=1), np.maximum(_NEAR, 0.5 * travel.max(axis=(0, 1)))
    if np.any(apart > near):
        raise file.error(
            "q",
            f"experiments of one position that stand {number(apart.max(), 2)} rad apart",
            f"{number(near[int(np.argmax((apart - near).max(axis=0)))], 2)} rad at most",
            "Store other positions in files of their own, or along the first axis, (position, experiment, time, ...).",
        )
    said = f"{file.label('q')}: a record; its mean is the arm configuration, about which it moves by up to "
    return means.mean(axis=1), near, said + f"{number(travel.max(), 2)} rad."


def gathered(configurations: Sequence, near: Sequence[np.ndarray | None]) -> list:
    """Configurations of files, (pos, joint) or `None`; of those that are means of records, the ones that are `near`
    each other, as `mean_configurations` says, become the first of them. `None`: no mean."""
    found: list = []
    for i, (q, within) in enumerate(zip(configurations, near, strict=True)):
        firsts = (found[j] for j in range(i) if near[j] is not None and within is not None)
        found.append(next((p for p in firsts if p.shape == q.shape and np.all(np.abs(p - q) < within)), q))
    return found
