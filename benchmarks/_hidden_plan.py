"""Which cases there are: robot, log, simulator, what is hidden.

Every cell (robot, log, simulator) has as many cases of every kind as any other. They stand in an order in which the
first n of a part, and every second, third, ... sixth one, have robots, logs, simulators and kinds, and pairs of these,
in nearly the proportions of the whole: a run that is interrupted, or shared out, says something about all of them.
"""

import collections
import dataclasses
import functools
import itertools
import math

import numpy as np
from _hidden_effects import MAIN, Hidden
from _hidden_robots import LOGS, PLANTS, Plant

KINDS = ("none", "single", "double", "outside")
SIMULATORS = ("jaxfrf", "mujoco")
CLASSES = (("torque_delay", "current_loop_lag"), ("counterbalance", "dress_pack"))
"""Effects that such data cannot tell apart: two equations with one response in 4-80 Hz, two names of one spring."""

_OUTSIDE = {
    "jaxfrf": ("gain_drift", "bumper"),
    "mujoco": ("presliding_friction", "bumper", "presliding_friction", "gain_drift"),
}
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_STRONGEST = 8.0
_EVERY = 6  # up to every so manieth case is a fair sample


@dataclasses.dataclass(frozen=True)
class Case:
    """One machine: `kind` of `KINDS`, `robot` of `PLANTS`, `log` of `LOGS`, `simulator` of `SIMULATORS`."""

    part: str
    number: int
    kind: str
    robot: str
    log: str
    simulator: str
    hidden: tuple[Hidden, ...]

    @property
    def name(self) -> str:
        return f"{self.number:03d}"

    @property
    def seed(self) -> int:
        return 1000 * _PARTS[self.part].seed + self.number

    @property
    def plant(self) -> Plant:
        return PLANTS[self.robot]


@dataclasses.dataclass(frozen=True)
class _Part:
    """Its robots, and how many cases of each of `KINDS` every cell has."""

    seed: int
    robots: tuple[str, ...]
    each: tuple[int, int, int, int]


_PARTS = {
    "tune": _Part(141, ("r3x", "small"), (2, 3, 1, 1)),
    "report": _Part(173, ("r3x", "small", "pallet"), (4, 6, 2, 2)),
    "unseen": _Part(211, ("r3x", "small", "pallet"), (4, 6, 2, 2)),
}
PARTS = tuple(_PARTS)


@functools.cache
def cases(part: str) -> tuple[Case, ...]:
    """All cases of a part; the same whenever it is asked.

    Effects come as often as any other that the robot has, but for one that a log does not show. Levels are spread
    evenly over the logarithm from 1 to 8, in any stretch of cases.
    """
    plan = _PARTS[part]
    rng = np.random.default_rng(plan.seed)
    decks = {name: _Deck(PLANTS[name], rng) for name in plan.robots}
    outside = {simulator: itertools.cycle(rng.permutation(names).tolist()) for simulator, names in _OUTSIDE.items()}
    levels = {kind: _levels(rng.uniform()) for kind in KINDS}
    found = []
    for number, (kind, robot, log, simulator) in enumerate(_order(plan, rng)):
        deck, names = decks[robot], []
        if kind == "outside":
            names = [next(outside[simulator])]
        for _ in range({"single": 1, "double": 2}.get(kind, 0)):
            names.append(deck.draw(log, names))
        joints = deck.joints(names)
        hidden = tuple(Hidden(name, joints[name], next(levels[kind])) for name in names)
        found.append(Case(part, number, kind, robot, log, simulator, hidden))
    return tuple(found)


def class_of(name: str) -> tuple[str, ...]:
    """The effects that look like this one, itself among them."""
    return next((alike for alike in CLASSES if name in alike), (name,))


def _order(plan: _Part, rng) -> list[tuple[str, str, str, str]]:
    """(kind, robot, log, simulator) of every case: each is the one that the stretches which it ends lack most."""
    items = list(itertools.product(KINDS, plan.robots, LOGS, SIMULATORS))
    left = np.array([plan.each[KINDS.index(item[0])] for item in items])
    marks = [tuple((i, item[i]) for i in which) for item in items for n in (1, 2) for which in _choices(n)]
    marks = list(dict.fromkeys(marks))
    has = np.array([[all(item[i] == value for i, value in mark) for mark in marks] for item in items], float)
    share = left @ has / left.sum()
    seen: dict[tuple[int, int], np.ndarray] = collections.defaultdict(lambda: np.zeros(len(marks)))
    order = []
    for number in range(left.sum()):
        stretches = [(k, number % k) for k in range(1, _EVERY + 1)]
        # What a further case adds to the sum of (count - expected)^2/expected, but for a constant.
        excess = sum(seen[s] - share * (number // s[0] + 1) for s in stretches)
        cost = has @ (excess / share) + rng.uniform(0.0, 1e-6, len(items))
        best = int(np.argmin(np.where(left > 0, cost, np.inf)))
        left[best] -= 1
        for stretch in stretches:
            seen[stretch] += has[best]
        order.append(items[best])
    return order


def _choices(n: int):
    return itertools.combinations(range(4), n)


def _levels(start: float):
    """Multiples of the golden ratio: any stretch of them is even."""
    return (_STRONGEST ** ((start + k * _GOLDEN) % 1.0) for k in itertools.count())


class _Deck:
    """Effects that make sense on a robot, all of them before one comes again, on joints that had the fewest."""

    def __init__(self, plant: Plant, rng):
        self._plant, self._rng = plant, rng
        self._names = [name for name in MAIN if plant.joints_of(name)]
        self._left: list[str] = []
        self._used: collections.Counter[str] = collections.Counter()

    def draw(self, log: str, beside: list[str]) -> str:
        while True:
            for name in self._left:
                if self._fits(name, log, beside):
                    self._left.remove(name)
                    return name
            self._left += [self._names[i] for i in self._rng.permutation(len(self._names))]

    def _fits(self, name: str, log: str, beside: list[str]) -> bool:
        """Whether such a log shows it, and it is neither of the class of one `beside` nor confined to its joint."""
        if name == "encoder_quantisation" and log != "position":
            return False
        mine = set(self._plant.joints_of(name))
        theirs = [set(self._plant.joints_of(other)) for other in beside]
        alone = any(len(mine) == 1 and mine == joints for joints in theirs)
        return not alone and not any(name in class_of(other) for other in beside)

    def joints(self, names: list[str]) -> dict[str, str]:
        """One for each effect, another one for each: of those that were chosen least often, at random."""
        chosen: dict[str, str] = {}
        for name in sorted(names, key=lambda name: len(self._plant.joints_of(name))):
            possible = [joint for joint in self._plant.joints_of(name) if joint not in chosen.values()]
            least = min(self._used[joint] for joint in possible)
            chosen[name] = str(self._rng.choice([joint for joint in possible if self._used[joint] == least]))
            self._used[chosen[name]] += 1
        return chosen
