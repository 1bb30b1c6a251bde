"""Whether a robot's own numbers explain a record: then nothing is missing, however far off its file is."""

import equinox as eqx
import numpy as np

from .._errors import InputError
from ..calibration.numbers import numbers, with_numbers
from ..calibration.search import Look, Search
from ..robot import Robot
from ..trajectory.measured import Measured
from ..trajectory.remainder import excess, remainder

_ROUNDS = 6
_FAR = 3.0  # tolerances: a number that is further off is looked at as a missing effect
_HOPELESS = 9.0  # tolerances, in any round
_OFF = 1.0  # tolerances from which on a number is told to be wrong
_TOLD = 0.9  # of what was not known of a number: by the record
_SLOW = 0.7  # of what a round before left: more, and what is far from the floor will not come down to it
_FLOOR = 1.0


class OwnNumbers(eqx.Module):
    """A robot whose numbers explain a record.

    **Fields:** `robot`: with these numbers. `wrong`: those that are further off than their tolerance, with the relative
    change that the record asks for.
    """

    robot: Robot
    wrong: tuple[tuple[str, float], ...] = eqx.field(static=True)

    def says(self) -> str:
        """Which numbers are wrong, in a sentence; empty where none are."""
        if not self.wrong:
            return ""
        changes = [f"{name} by {100 * change:+.0f} %" for name, change in self.wrong]
        return f" Numbers of the robot that are off by more than is known of them: {', '.join(changes)}."


def own_numbers(robot: Robot, record: Measured, say) -> OwnNumbers | None:
    """The robot with all its uncertain numbers fitted (`jaxfrf.calibrate`, but for what is left open of friction near
    rest, which could be a missing effect), if nothing of the record is beyond the floor then and every number is
    credible; `None` otherwise."""
    these = numbers(robot)
    if not these:
        return None
    search = Search(robot, record, these, lambda text: None, beside=())
    try:
        look = search.look(np.zeros(len(these)), (), True)
    except InputError:
        return None
    left = _excess(look, record)
    # How Coulomb friction is smoothed has no true value where a machine's friction is another law.
    held = np.array([n.prior > 0 and n.kind != "smoothing" for n in these])
    for number in range(_ROUNDS):
        if np.any(np.abs((look.x + look.posterior.change[: len(these)])[held]) > _HOPELESS):
            return None
        if search.stays(look):
            break
        further = search.further(look, number == 0)
        if further is None:
            break
        before, look, left = left, further, _excess(further, record)
        if left > _SLOW * before and not _FLOOR < left < 2 * _FLOOR:
            break
    say(f"with all its own numbers fitted, at most {left:.3g} times the floor is left")
    if left > _FLOOR:
        return None
    x = look.x + look.posterior.change[: len(these)]
    if np.any(np.abs(x[held]) > _FAR):
        return None
    told = look.posterior.told[: len(these)]
    wrong = tuple(
        (n.name, n.value(float(at)) / n.given - 1.0)
        for n, at, part, counts in zip(these, x, told, held, strict=True)
        if counts and n.positive and abs(at) > _OFF and part > _TOLD
    )
    return OwnNumbers(with_numbers(robot, these, x), wrong)


def _excess(look: Look, record: Measured) -> float:
    left = remainder(look.evidence, look.weighed, look.posterior.change)
    return excess(left, look.evidence.plain, record.frequency)
