"""Which candidates of a ranking are fitted."""

import math
from collections.abc import Callable, Collection, Sequence

from ...effects import AbstractEffect, library
from ...robot import Robot
from ..settings import CANDIDATES, EXPLAINED, LEAST_PART, LEAST_SIZE, SHARE
from .hypothesis import Key, one_class
from .rank import Scored

Had = Sequence[tuple[AbstractEffect, Key]]  # effects that were taken before, with their keys


def chosen(scored: Sequence[Scored], had: Had) -> list[Scored]:
    """The candidates of a ranking that are fitted: those that are visible, or promise most of the cost, whatever is
    thought to be visible on this robot. A number whose tolerance cannot be true stands out from all others, however
    little of the cost it is."""
    found: dict[Key, Scored] = {}
    for this in scored:
        if (this.size >= LEAST_SIZE or this.part >= EXPLAINED) and not _stands(this, had):
            found.setdefault(this.key, this)
    best = list(found.values())
    promising = [s for s in best[:CANDIDATES] if s.part >= max(SHARE * best[0].part, LEAST_PART)]
    others = best[len(promising) :]
    return [*promising, *[s for s in others if s.disbelieved][:CANDIDATES]]


def _stands(this: Scored, had: Had) -> bool:
    """Whether an effect was taken before, or one that looks like it."""
    return any(one_class(effect, key, this.key) for effect, key in had)


def imitated(scored: Sequence[Scored], joints: Collection[str], disbelieved: Collection[str], had: Had) -> list[Scored]:
    """Effects that a joint's numbers imitate to first order: of these joints, and of those with such a number that is
    off by more than is known."""
    off = lambda this: any(f"{this.joint}.{kind}" in disbelieved for kind in this.effect.imitated_by)
    return _imitable(scored, had, lambda this: this.joint in joints or off(this))


def confused(scored: Sequence[Scored], effect: AbstractEffect, own: Key, had: Had, robot: Robot) -> list[Scored]:
    """Effects that this one is confused with on its joint, and that numbers imitate to first order: what they promise
    says little. Those that promise nothing are as they are just visible on this robot."""
    others = [kind for name, kind in library().items() if name in effect.confusable and kind.imitated_by]
    unseen = [Scored(kind.typical(robot, own[1]), own[1], 0.0, math.nan, 1.0) for kind in others if own[1]]
    return _imitable((*scored, *unseen), had, lambda this: this.joint == own[1] and this.key[0] in effect.confusable)


def _imitable(scored: Sequence[Scored], had: Had, is_wanted: Callable[[Scored], bool]) -> list[Scored]:
    """The best of each effect and joint that numbers imitate, of those that are wanted and not there already."""
    best: dict[Key, Scored] = {}
    for this in scored:
        if this.effect.imitated_by and is_wanted(this) and not _stands(this, had):
            best.setdefault(this.key, this)
    return list(best.values())
