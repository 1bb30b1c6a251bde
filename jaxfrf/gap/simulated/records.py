"""Which positions of a record are fitted, which decide, and which are held out."""

import equinox as eqx
import numpy as np

from ..._errors import input_error
from ...experiment import Experiment
from ...trajectory.joined import places
from ...trajectory.measured import Measured
from ..settings import FEW, RUNS, SELECT


class Records(eqx.Module):
    """A record, and its positions that are fitted, that decide which effect is taken, and that are held out.

    `whole`: with the experiments that are fitted; `every`: with those that judge."""

    whole: Measured
    every: Measured
    fit: np.ndarray
    select: np.ndarray
    heldout: np.ndarray

    @property
    def fitted(self) -> Measured:
        return self.whole.at(self.fit)

    @property
    def opened(self) -> np.ndarray:
        return np.union1d(self.fit, self.select)

    @property
    def final(self) -> Measured:
        """The positions that are not held out, with as many experiments as the last fit takes."""
        most = RUNS // len(self.opened)
        return (self.every.fewer(most) if most > self.whole.data.n_exp else self.whole).at(self.opened)

    @property
    def deciding(self) -> Measured:
        return self.every.at(self.select)

    @property
    def judged(self) -> np.ndarray:
        """Where the result is told: the held-out ones, or those that were fitted where none are held out."""
        return self.heldout if len(self.heldout) else self.opened


def split(record: Measured, every: Measured, heldout_count: int | None) -> Records:
    """Positions that are fitted, that decide and that are held out; few are fitted and decide. `every`: the same
    positions, with the experiments that judge."""
    opened = opened_positions(record.data, heldout_count)
    place = places(record.data)
    left = list(dict.fromkeys(place[opened].tolist()))
    count = len(left) // SELECT if len(left) >= FEW else 0
    chosen = {left[int(i)] for i in np.round((np.arange(count) + 0.5) * len(left) / max(count, 1))}
    select = opened & np.array([p in chosen for p in place])
    fit = opened & ~select
    numbers = [np.flatnonzero(x) for x in (fit, select if count else fit, ~opened)]
    return Records(record, every, *numbers)


def opened_positions(record: Experiment, heldout_count: int | None) -> np.ndarray:
    """Which positions are fitted, (pos,): the held-out ones stand between them. Records of one place stay together."""
    place = places(record)
    count = place.max() + 1
    if heldout_count is None:
        heldout_count = count // 3 if count >= 3 else 0
    if not 0 <= heldout_count < count:
        raise input_error(
            "held-out positions",
            f"{heldout_count}",
            f"0 to {count - 1} of {count} positions",
            "Leave some for the fit.",
        )
    order = dict.fromkeys(place.tolist())
    names = list(order)
    chosen = {names[int(i)] for i in np.round((np.arange(heldout_count) + 1) * count / max(heldout_count, 1)) - 1}
    return np.array([p not in chosen for p in place])
