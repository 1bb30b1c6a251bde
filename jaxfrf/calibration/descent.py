"""The rounds of a calibration: ripple beside the robot first, then simulated with it.

Far from the truth, what looks like ripple is something else, and columns beside the numbers are enough. Near it they
are not: friction meets motors that do not turn evenly, above all where they are slow, and what that does to a torque is
no column of any number.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._errors import InputError
from ..effects import AbstractFriction
from ..robot import Robot
from ..trajectory.alike import alike
from ..trajectory.evidence import Column
from ..trajectory.measured import Measured
from ..trajectory.ripple import Wave
from .numbers import Number
from .result import Round, missed
from .ripple import found_waves
from .rounds import Kept, Rounds
from .search import Look, Say, Search

_LOOKS_FOR_RIPPLE = 4  # first rounds in which more orders are looked for: far from the truth some are not there
_FEW_LOOKS = 2  # with less, ripple of a motor is not found yet
_LOOKS_AGAIN = 2  # the same, of rounds with ripple that is simulated: weak orders drowned before
_NEAR = 0.15  # of the misfit: where a step leaves more, the robot is near
_SAME = 0.99  # of the misfit: rounds near the truth that leave more, one after the other, bring nothing
_WORSE = 1.05  # of what was left: ripple with which more is left is not simulated


class Descent:
    """A robot's numbers on their way, round by round.

    **Fields:** `look`: the last simulation. `near`: whether the robot is so near the truth that ripple and the turn of
    its friction are simulated. `inside`: ripple that it had beside the robot's own. `settled`: whether the numbers
    stay.
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
        self.settled, self._looks = False, 0
        self._before: float | None = None  # misfit of the round before

    def run(self, rounds: int, kept: Rounds) -> None:
        """So many simulations, from where an earlier run was interrupted."""
        self.begin(kept)
        while len(kept.done) < rounds and self.advance(kept):
            pass

    def advance(self, kept: Rounds) -> bool:
        """One simulation further; whether there was one that leaves less."""
        if self.settled:
            return False
        look = self._nearer()
        if look is None:
            look = self._further()
        if look is None:
            self.say("no step makes the misfit smaller")
            return False
        self.look = look
        self._keep(kept)
        return True

    def begin(self, kept: Rounds) -> None:
        """Simulate the robot as it was given, or where the last of the finished rounds had it."""
        if not kept.done:
            self._take(False, (), None)
            self.look = self.search.look(np.zeros(len(self.these)), (), True)
            self._keep(kept)
            return
        last = kept.done[-1]
        self._take(last.near, last.inside, last.floor)
        self._looks = sum(one.near == last.near for one in kept.done)
        self._before = kept.done[-2].round.misfit if len(kept.done) > 1 else None
        self.look = self.search.look(last.x, last.orders, False)
        self.settled = self._settles()
        self.say(f"goes on behind round {len(kept.done)}")

    def _take(self, near: bool, inside: Sequence[Wave], floor) -> None:
        self.near, self.inside = near, tuple(inside)
        robot = alike(self.robot, inside)
        orders = [o for o, _ in inside]
        # Laws of friction that turn over some speed of their own tell it together with the robot's.
        turns = near and not any(isinstance(e, AbstractFriction) for e in robot.effects)
        self.search = Search(robot, self.record, self.these, self.say, self.beside, orders, turns)
        self.search.floor = floor

    def _keep(self, kept: Rounds) -> None:
        look, self._looks = self.look, self._looks + 1
        self._before = kept.done[-1].round.misfit if kept.done else None
        self.settled = self._settles()
        round = Round(look.misfit, look.left, look.posterior.effect)
        torque = missed(look.evidence, self.record)
        kept.keep(Kept(look.x, look.orders, look.begun, round, self.near, self.inside, torque))
        self.say(
            f"round {len(kept.done)}: {look.misfit**0.5:.3g} times the floor, {look.left**0.5:.3g} after its step; "
            f"{len(look.orders)} orders of ripple"
            + (f", {len(self.inside)} of them simulated" if self.inside else "")
            + f", {look.posterior.effect:.3g} lines count as one"
        )

    def _settles(self) -> bool:
        """A robot whose ripple stands beside it only is not done; one whose misfit stays is, though numbers may creep
        along what the record does not tell."""
        if not self.near and self._refines:
            return False
        before, look = self._before, self.look
        same = before is not None and look.misfit > _SAME * before and look.left > _SAME * look.misfit
        return self.search.stays(look) or (self.near and self._looks > _LOOKS_AGAIN and same)

    @property
    def _refines(self) -> bool:
        """Whether there is anything that is simulated near the truth only."""
        return bool(self.found_waves) or any(n.kind == "smoothing" for n in self.these)

    @property
    def found_waves(self) -> tuple[Wave, ...]:
        """Ripple of the robot as it would be written."""
        return found_waves(self.look.orders, self.look.posterior, self.inside)

    @property
    def x(self) -> Float[np.ndarray, "number"]:
        """Where the numbers are."""
        if not self.settled:
            return self.look.x
        return self.search.followed(self.look.x + self.look.posterior.change[: len(self.these)])

    def _further(self) -> Look | None:
        return self.search.further(self.look, self._looks < (_LOOKS_AGAIN if self.near else _LOOKS_FOR_RIPPLE))

    def _nearer(self) -> Look | None:
        """The next robot, its motors turning as they were found to; `None` where it is too early, where they turn
        evenly, and where that leaves more."""
        before, waves = self.look, self.found_waves
        early = self._looks < _FEW_LOOKS or before.left < _NEAR * before.misfit
        if self.near or early or not self._refines:
            return None
        x, floor, self._looks = self.search.next(before), self.search.floor, 0
        self._take(True, waves, floor)
        if not waves:
            return None
        try:
            look = self.search.look(x, tuple(o for o, _ in waves), True)
        except InputError as error:
            self.say(f"with the ripple that was found: {error}")
        else:
            if look.left < _WORSE * before.left:
                return look
            self.say("ripple that is simulated leaves more: it stays beside the robot")
        self._take(True, (), floor)
        return None
