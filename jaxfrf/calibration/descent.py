"""The rounds of a calibration: ripple beside the robot first, then simulated with it.

Far from the truth, what looks like ripple is something else, and columns beside the numbers are enough. Near it they
are not: friction meets motors that do not turn evenly, above all where they are slow, and what that does to a torque is
no column of any number.
"""

from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..robot import Robot
from ..trajectory.evidence import Column
from ..trajectory.measured import Measured
from ..trajectory.ripple import Wave, with_ripple
from .numbers import Number, alike
from .result import Round, missed
from .ripple import found_waves
from .rounds import Kept, Rounds
from .search import Look, Say, Search

_LOOKS_FOR_RIPPLE = 4  # first rounds in which more orders are looked for: far from the truth some are not there
_LOOKS_AGAIN = 2  # the same, of rounds with ripple that is simulated: weak orders drowned before
_NEAR = 0.5  # of the misfit: where a step leaves more, ripple is simulated
_WORSE = 1.05  # of what was left: ripple with which more is left is not simulated


class Descent:
    """A robot's numbers on their way, round by round.

    **Fields:** `look`: the last simulation. `inside`: ripple that it had beside the robot's own. `settled`: whether the
    numbers stay.
    """

    def __init__(
        self,
        robot: Robot,
        record: Measured,
        these: Sequence[Number],
        say: Say,
        beside: Sequence[Column] = (),
    ):
        self.robot, self.record, self.these, self.say, self.beside = robot, record, these, say, tuple(beside)
        self.settled = False
        self._may_have_ripple, self._looks = True, 0

    def run(self, rounds: int, kept: Rounds) -> None:
        """So many simulations, from where an earlier run was interrupted."""
        self._begin(kept)
        while len(kept.done) < rounds and not self.settled:
            look = self._with_ripple()
            if look is None:
                look = self._further()
            if look is None:
                self.say("no step makes the misfit smaller")
                break
            self.look = look
            self._keep(kept)

    def _begin(self, kept: Rounds) -> None:
        if not kept.done:
            self._take((), None)
            self.look = self.search.look(np.zeros(len(self.these)), (), True)
            self._keep(kept)
            return
        last = kept.done[-1]
        self._take(last.inside, last.floor)
        self._may_have_ripple = last.may_have_ripple
        self._looks = sum(bool(k.inside) == bool(last.inside) for k in kept.done)
        self.look = self.search.look(last.x, last.orders, False)
        self.settled = self._settles()
        self.say(f"goes on behind round {len(kept.done)}")

    def _take(self, inside: Sequence[Wave], floor) -> None:
        self.inside = tuple(inside)
        robot = with_ripple(alike(self.robot, self.these), inside)
        self.search = Search(robot, self.record, self.these, self.say, self.beside, [o for o, _ in inside])
        self.search.floor = floor

    def _keep(self, kept: Rounds) -> None:
        look, self._looks = self.look, self._looks + 1
        self.settled = self._settles()
        round = Round(look.misfit, look.left, look.posterior.effect)
        floor, torque = look.evidence.floor, missed(look.evidence, self.record)
        kept.keep(Kept(look.x, look.orders, floor, round, self.inside, self._may_have_ripple, torque))
        self.say(
            f"round {len(kept.done)}: {look.misfit**0.5:.3g} times the floor, {look.left**0.5:.3g} after its step; "
            f"{len(look.orders)} orders of ripple"
            + (f", {len(self.inside)} of them simulated" if self.inside else "")
            + f", {look.posterior.effect:.3g} lines count as one"
        )

    def _settles(self) -> bool:
        """A robot whose ripple stands beside it only is not done."""
        waiting = self._may_have_ripple and not self.inside and bool(self.found_waves)
        return not waiting and self.search.stays(self.look)

    @property
    def found_waves(self) -> tuple[Wave, ...]:
        """Ripple of the robot as it would be written."""
        return found_waves(self.look.orders, self.look.posterior, self.inside)

    def _further(self) -> Look | None:
        looks = _LOOKS_AGAIN if self.inside else _LOOKS_FOR_RIPPLE
        return self.search.further(self.look, self._looks < looks)

    def _with_ripple(self) -> Look | None:
        """The next robot, its motors turning as they were found to; `None` where it is too early, and where that leaves
        more."""
        before, waves = self.look, self.found_waves
        if self.inside or not self._may_have_ripple or not waves or before.left < _NEAR * before.misfit:
            return None
        x, floor = self.search.next(before), self.search.floor
        self._take(waves, floor)
        try:
            look = self.search.look(x, tuple(o for o, _ in waves), True)
        except InputError as error:
            self.say(f"with the ripple that was found: {error}")
        else:
            if look.left < _WORSE * before.left:
                self._looks = 0
                return look
            self.say("ripple that is simulated leaves more: it stays beside the robot")
        self._take((), floor)
        self._may_have_ripple = False
        return None
