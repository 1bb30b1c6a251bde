"""The rounds of a calibration: ripple beside the robot first, then simulated with it.

Far from the truth, what looks like ripple is something else, and columns beside the numbers are enough. Near it they
are not: friction meets motors that do not turn evenly, above all where they are slow, and what that does to a torque is
no column of any number.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from .._errors import InputError
from ..robot import Robot
from ..trajectory.alike import alike
from ..trajectory.evidence import Column
from ..trajectory.measured import Measured
from ..trajectory.ripple import Wave
from .numbers import Number
from .result import Round, missed
from .ripple import LITTLE, found_waves, other_share, waves_to_simulate
from .rounds import Kept, Rounds
from .search import Difference, Iterate, Say, Search

_ROUNDS_FOR_RIPPLE = 4  # first rounds in which more orders are looked for: far from the truth some are not there
_FEW_ROUNDS = 2  # with less, ripple of a motor is not found yet
_ROUNDS_AGAIN = 2  # the same, of rounds with ripple that is simulated: weak orders drowned before
_NEAR = 0.15  # of the misfit: where a step leaves more, the robot is near
_SAME = 0.99  # of the misfit: rounds near the truth that leave more, one after the other, bring nothing
_MUCH = 0.8  # of the misfit: a step that leaves less promises much
_WORSE = 1.05  # of what was left: ripple with which more is left is not simulated


class Descent:
    """A robot's numbers on their way, round by round. `differences`: as of `Search`.

    **Fields:** `iterate`: the last simulation. `near`: whether the robot is so near the truth that ripple and the
    smoothing of its friction are simulated. `inside`: ripple that it had beside the robot's own. `settled`: whether the
    numbers stay.
    """

    def __init__(
        self,
        robot: Robot,
        record: Measured,
        numbers: Sequence[Number],
        say: Say,
        beside: Sequence[Column] = (),
        differences: Mapping[str, Difference] = MappingProxyType({}),
    ):
        self.robot, self.record, self.numbers, self.say, self.beside = robot, record, numbers, say, tuple(beside)
        self.differences = differences
        self.settled = False
        self._end: tuple[Iterate, np.ndarray] | None = None  # of a settled iterate: it is asked for often
        self._misfits: list[float] = []  # of the rounds with ripple beside the robot, then of those near the truth

    def run(self, rounds: int, kept: Rounds) -> None:
        """So many simulations, from where an earlier run was interrupted."""
        self.begin(kept)
        while len(kept.done) < rounds and self.advance(kept):
            pass

    def advance(self, kept: Rounds) -> bool:
        """One simulation further; whether there was one that leaves less."""
        if self.settled:
            return False
        iterate = self._nearer()
        if iterate is None:
            iterate = self._further()
        if iterate is None:
            self.say("no step makes the misfit smaller")
            return False
        self.iterate = iterate
        self._keep(kept)
        return True

    def begin(self, kept: Rounds, more: bool = False) -> None:
        """Simulate the robot as it was given, or where the last of the finished rounds had it. `more`: look for more
        ripple there, as on a record that tells more than that of these rounds."""
        if not kept.done:
            self._take(False, (), None)
            self.iterate = self.search.evaluate(np.zeros(len(self.numbers)), (), True)
            self._keep(kept)
            return
        last = kept.done[-1]
        self._take(last.near, last.inside, last.floor)
        self._misfits = [one.round.misfit for one in kept.done if one.near == last.near]
        self.iterate = self.search.evaluate(last.x, last.orders, more)
        self.settled = self._settles()
        self.say(f"goes on behind round {len(kept.done)}")

    def _take(self, near: bool, inside: Sequence[Wave], floor) -> None:
        self.near, self.inside = near, tuple(inside)
        robot = alike(self.robot, inside)
        orders = [o for o, _ in inside]
        self.search = Search(robot, self.record, self.numbers, self.say, self.beside, orders, near, self.differences)
        self.search.floor = floor

    def _keep(self, kept: Rounds) -> None:
        iterate = self.iterate
        self._misfits.append(iterate.misfit)
        self.settled = self._settles()
        round = Round(iterate.misfit, iterate.left, iterate.posterior.effect)
        torque = missed(iterate.evidence, self.record)
        kept.keep(Kept(iterate.x, iterate.orders, iterate.start_floor, round, self.near, self.inside, torque))
        self.say(
            f"round {len(kept.done)}: {iterate.misfit**0.5:.3g} times the floor, "
            f"{iterate.left**0.5:.3g} after its step; {len(iterate.orders)} orders of ripple"
            + (f", {len(self.inside)} of them simulated" if self.inside else "")
            + f", {iterate.posterior.effect:.3g} lines count as one"
        )

    def _settles(self) -> bool:
        """A robot whose ripple stands beside it only is not done; one whose misfit stays is, though numbers may creep
        along what the record does not tell. Where two rounds brought nothing, a step is believed that promises much."""
        if not self.near and self._refines:
            return False
        if self.search.has_converged(self.iterate):
            return True
        if not self.near or self._rounds <= _ROUNDS_AGAIN:
            return False
        *before, last, now = self._misfits
        twice = last > _SAME * min(before) and self.iterate.left > _MUCH * now
        return now > _SAME * last and (self.rests or twice)

    @property
    def _rounds(self) -> int:
        return len(self._misfits)

    @property
    def rests(self) -> bool:
        """Whether the next step brings nothing, nor other ripple."""
        same = _SAME * self.iterate.misfit < self.iterate.left < self.iterate.misfit / _SAME
        return same and not self._has_other_ripple

    @property
    def _has_other_ripple(self) -> bool:
        """Whether near the truth, as long as more ripple is looked for, what is sure by now and was not simulated
        matters."""
        if not self.near or self._rounds > _ROUNDS_AGAIN:
            return False
        return other_share(self.iterate.orders, self.iterate.posterior, self.inside) > LITTLE

    @property
    def _refines(self) -> bool:
        """Whether there is anything that is simulated near the truth only."""
        return bool(self.found_waves) or any(n.kind == "smoothing" for n in self.numbers)

    @property
    def found_waves(self) -> tuple[Wave, ...]:
        """Ripple of the robot as it would be written."""
        return found_waves(self.iterate.orders, self.iterate.posterior, self.inside)

    @property
    def x(self) -> Float[np.ndarray, "number"]:
        """Where the numbers are."""
        if not self.settled:
            return self.iterate.x
        if self._end is None or self._end[0] is not self.iterate:
            self._end = self.iterate, self.search.end(self.iterate)
        return self._end[1]

    def _further(self) -> Iterate | None:
        """One step further; with the ripple that is sure by now where that is other: what was found before some of it,
        or beside a robot that lacked more, may have stood for what is not ripple."""
        more = self._rounds < (_ROUNDS_AGAIN if self.near else _ROUNDS_FOR_RIPPLE)
        found = self._with_other_ripple(more) if self._has_other_ripple else None
        return self.search.further(self.iterate, more) if found is None else found

    def _with_other_ripple(self, more: bool) -> Iterate | None:
        """The same, the robot's ripple being what is sure; `None` where that leaves more."""
        search, inside = self.search, self.inside
        self.differences = self.iterate.differences or self.differences
        self._take(True, waves_to_simulate(self.iterate.orders, self.iterate.posterior, inside), search.floor)
        found = self.search.further(self.iterate, more)
        if found is None:
            self.say("with the ripple that is sure by now more is left: it stays as it was")
            self.search, self.inside = search, inside
        return found

    def _nearer(self) -> Iterate | None:
        """The next robot, its motors turning as they were found to; `None` where it is too early, where they turn
        evenly, and where that leaves more."""
        before, waves = self.iterate, self.found_waves
        early = self._rounds < _FEW_ROUNDS or before.left < _NEAR * before.misfit
        if self.near or early or not self._refines:
            return None
        x, floor, self._misfits = self.search.next(before), self.search.floor, []
        self._take(True, waves, floor)
        if not waves:
            return None
        try:
            iterate = self.search.evaluate(x, tuple(o for o, _ in waves), True)
        except InputError as error:
            self.say(f"with the ripple that was found: {error}")
        else:
            if iterate.left < _WORSE * before.left:
                return iterate
            self.say("ripple that is simulated leaves more: it stays beside the robot")
        self._take(True, (), floor)
        return None
