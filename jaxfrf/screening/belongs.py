"""Experiments beside each other: one that the same machine cannot have answered, and the same one given twice."""

import dataclasses
import hashlib
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from .._text import number, percent
from ..experiment import Experiment
from .finding import Finding, Severity
from .record import Record

_TERMS = 2  # G is taken as a straight line over a window of lines
_DOF = 2.0  # equations over unknowns in a window, without the experiments looked at
_MISMATCH = 1e-3  # power that the others do not predict, of an experiment's output, from which it can be foreign ...
_USUAL = 2.4  # ... if this many times less is left over of four experiments without it: clean ones reach 1.7 ...
_FAR = 4.0  # ... and it is this much farther off than they are
_FLOOR = 1e-6  # power that is always left over
_ONE_MORE = 3.0  # by which two outsiders must explain more than one
_PAIRS = 10  # experiments up to which pairs are looked at
_CONTRADICT = 2e-3  # power left over of two experiments, from which they contradict each other ...
_TWO = 4.0  # ... if it is so many times what is left of each alone
_CAUSE = 0.25  # of the mismatch, that a swap or a sign leaves, to be named
_LEVEL = 1.5  # ratio of excitation from which another answer is no wonder


def foreign(record: Record) -> Iterator[Finding]:
    """Experiments whose output the others do not predict, with what would mend them where that is plain.

    Over windows of neighbouring lines, Y = G U with G a straight line in frequency is fitted to all experiments and
    without one or two of them: foreign are those without which far less power is left over per degree of
    freedom. Of two experiments alone none can be blamed: they contradict each other.
    """
    data = record.data
    if data.n_exp < 2 or not data.period or len(record.lines) < 8:
        return
    for pos in range(data.n_pos):
        windows = _windows(record, pos)
        if windows is None:
            continue
        outsiders = _outsiders(windows) if data.n_exp > 2 else []
        yield from (_does_not_belong(record, pos, windows, found, len(outsiders)) for found in outsiders)
        if not outsiders and data.n_exp < 4:
            yield from _contradict(record, pos)


@dataclasses.dataclass(frozen=True)
class _Windows:
    A: np.ndarray  # (exp, window, line, unknown): U and U times the place in the window
    Y: np.ndarray  # (exp, window, line, out)

    def prediction(self, exps) -> np.ndarray:
        """Coefficients from these experiments: (window, unknown, out)."""
        A, Y = self.A[exps], self.Y[exps]
        normal = np.einsum("ewlp,ewlq->wpq", A.conj(), A)
        size = np.trace(normal, axis1=1, axis2=2).real[:, None, None] / normal.shape[-1]
        normal = normal + 1e-10 * np.maximum(size, 1e-300) * np.eye(normal.shape[-1])
        return np.linalg.solve(normal, np.einsum("ewlp,ewlo->wpo", A.conj(), Y))

    def cost(self, exps) -> np.ndarray:
        """Power that one response leaves over in experiments, per degree of freedom, median of windows: (out,)."""
        rest = np.sum(np.abs(self.Y[exps] - self.A[exps] @ self.prediction(exps)) ** 2, axis=(0, 2))
        size = np.sum(np.abs(self.Y[exps]) ** 2, axis=(0, 2))
        free = len(exps) * self.A.shape[2] - self.A.shape[3]
        return np.median(rest / np.maximum(size, 1e-300), axis=0) / free * len(exps) * self.A.shape[2] + _FLOOR

    def mismatch(self, exp: int, G, Y=None) -> np.ndarray:
        """Power of an experiment's output that G does not predict, of all its power, by channel: median of windows."""
        Y = self.Y[exp] if Y is None else Y
        rest = np.sum(np.abs(Y - self.A[exp] @ G) ** 2, axis=1)
        return np.median(rest / np.maximum(np.sum(np.abs(Y) ** 2, axis=1), 1e-300), axis=0)


@dataclasses.dataclass(frozen=True)
class _Foreign:
    exp: int
    mismatch: np.ndarray  # (out,)
    usual: float
    G: np.ndarray


def _windows(record: Record, pos: int, *, each_alone: bool = False) -> _Windows | None:
    U, Y = (record.spectra[name][pos].mean(axis=1) for name in ("u", "y"))  # (exp, freq, channel)
    U, Y = (X / np.maximum(np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 1))), 1e-300) for X in (U, Y))
    n_exp, n_freq, n_in = U.shape
    fitted = 1 if each_alone else max(n_exp - (2 if n_exp >= 4 else 1), 1)
    width = int(np.ceil(_DOF * _TERMS * n_in / fitted)) + 1
    count = n_freq // width
    if count < 3:
        return None
    place = np.linspace(-1, 1, width)[:, None]
    U, Y = (X[:, : count * width].reshape(n_exp, count, width, -1) for X in (U, Y))
    return _Windows(np.concatenate([U, U * place], axis=-1), Y)


def _outsiders(windows: _Windows) -> list[_Foreign]:
    """The one or two experiments without which the others fit one response far better."""
    n = len(windows.Y)
    everyone = list(range(n))
    all_in = windows.cost(everyone)
    best: tuple[float, tuple[int, ...]] = (1.0, ())
    for count in (1, 2) if n >= 4 else (1,):
        tried = itertools.combinations(everyone, count) if n <= _PAIRS else [()]
        for out in tried:
            if not out or n - count < 2:
                continue
            gain = float(np.max(all_in / windows.cost([e for e in everyone if e not in out])))
            if gain > best[0] * (_ONE_MORE if len(out) > len(best[1]) > 0 else 1.0):
                best = gain, out
        if n > _PAIRS and count == 1:
            gains = [np.max(all_in / windows.cost([x for x in everyone if x != e])) for e in everyone]
            best = float(np.max(gains)), (int(np.argmax(gains)),)
    gain, out = best
    if gain < 1 + (_USUAL - 1) * min(1.0, 4 / n):
        return []
    inside = [e for e in everyone if e not in out]
    G = windows.prediction(inside)
    usual = float(np.median([windows.mismatch(e, G).max() for e in inside]))
    found = [_Foreign(e, windows.mismatch(e, G), usual, G) for e in out]
    return [f for f in found if f.mismatch.max() > max(_MISMATCH, _FAR * usual)]


def _does_not_belong(record: Record, pos: int, windows: _Windows, found: _Foreign, n_out: int) -> Finding:
    n = record.data.n_exp
    channel = int(np.argmax(found.mismatch))
    size = float(np.sqrt(found.mismatch[channel]))
    level = _level(record, pos, found.exp)
    cause = _cause(windows, found)
    why = f" {cause}" if cause else " Swapped cables or channels, another machine, or noise?"
    severity = Severity.WARNED
    if not cause and (level > _LEVEL or level < 1 / _LEVEL):
        severity = Severity.TOLD
        why = f" It was excited {number(level, 2)} times as strongly: a nonlinear machine answers differently."
    effect = min(size * n_out / n, 1.0)
    return Finding(
        "foreign",
        severity,
        size,
        f"experiment {found.exp} (position {pos}{_file(record, found.exp)}) does not belong to the others: they "
        f"predict its y (channel {channel}) with an error of {percent(size)}, each other's with "
        f"{percent(np.sqrt(found.usual))}.{why} The FRF may be off by {percent(effect)}: mend it, leave it, or "
        "take a mean in which odd experiments do not count (--method robust).",
        effect=effect,
        signal="y",
        channel=channel,
        pos=pos,
        exp=found.exp,
    )


def _file(record: Record, exp: int) -> str:
    """The file that an experiment comes from, where there are several."""
    sources, n = record.data.sources, record.data.n_exp
    return f", file {sources[exp * len(sources) // n].name}" if len(sources) > 1 and n % len(sources) == 0 else ""


def _level(record: Record, pos: int, exp: int) -> float:
    """Excitation of an experiment over the median one."""
    name = "u" if record.data.r is None else "r"
    power = np.sum(np.abs(record.spectra[name][pos].mean(axis=1)) ** 2, axis=(1, 2))
    return float(np.sqrt(power[exp] / max(np.median(np.delete(power, exp)), 1e-300)))


def _cause(windows: _Windows, found: _Foreign) -> str:
    """What would make the experiment fit: signs, channels of y or u exchanged, the output of another one."""
    Y, A, e = windows.Y[found.exp], windows.A[found.exp], found.exp
    good = _CAUSE * found.mismatch.max()

    def fits(y, a=A) -> bool:
        rest = np.sum(np.abs(y - a @ found.G) ** 2, axis=1) / np.maximum(np.sum(np.abs(y) ** 2, axis=1), 1e-300)
        return bool(np.median(rest, axis=0).max() < good)

    n_out, n_in = Y.shape[-1], A.shape[-1] // _TERMS
    for c in range(n_out):
        sign = np.where(np.arange(n_out) == c, -1.0, 1.0)
        if fits(Y * sign):
            return f"With the sign of y: channel {c} turned it fits: is a cable or an axis reversed?"
    for c in range(n_in):
        sign = np.tile(np.where(np.arange(n_in) == c, -1.0, 1.0), _TERMS)
        if fits(Y, A * sign):
            return f"With the sign of u: channel {c} turned it fits: is a cable or an axis reversed?"
    if fits(-Y):
        return "With all signs of y turned it fits."
    for a, b in itertools.combinations(range(n_out), 2):
        order = np.arange(n_out)
        order[[a, b]] = b, a
        if fits(Y[..., order]):
            return f"With channels {a} and {b} of y exchanged it fits."
    for a, b in itertools.combinations(range(n_in), 2):
        order = np.arange(n_in)
        order[[a, b]] = b, a
        if fits(Y, A[..., np.concatenate([order + i * n_in for i in range(_TERMS)])]):
            return f"With channels {a} and {b} of u exchanged it fits."
    for other in range(len(windows.Y)):
        if other != e and fits(windows.Y[other]):
            return f"Its u fits the y of experiment {other}: the order of the experiments is not the same in both."
    return ""


def _contradict(record: Record, pos: int) -> Iterator[Finding]:
    """Two or three experiments: one is smooth in frequency by itself, not all with one response."""
    windows = _windows(record, pos, each_alone=True)
    if windows is None:
        return
    everyone = list(range(len(windows.Y)))
    together = windows.cost(everyone)
    each = [windows.cost([e]) for e in everyone]
    alone = np.max(each, axis=0) if len(each) == 2 else np.min(each, axis=0)  # two of three may be mixed up
    channel = int(np.argmax(together / alone))
    size, left = float(together[channel]), float(alone[channel])
    levels = [_level(record, pos, e) for e in everyone]
    if size < _CONTRADICT or size < _TWO * left or max(levels) > _LEVEL or min(levels) < 1 / _LEVEL:
        return
    yield Finding(
        "foreign",
        Severity.WARNED,
        float(np.sqrt(size)),
        f"experiments {' and '.join(map(str, everyone))} (position {pos}) contradict each other: no one response gives "
        f"y (channel {channel}) in all, {percent(np.sqrt(size))} is left over, and {percent(np.sqrt(left))} in "
        "one alone. Channels swapped, a sign turned, experiments exchanged, or noise in one of them? Estimate them one "
        "by one and compare.",
        effect=float(min(np.sqrt(size), 1.0)),
        signal="y",
        channel=channel,
        pos=pos,
    )


def twice(record: Record) -> Iterator[Finding]:
    """Experiments, or halves of a record, that are the same samples: they say nothing new, and the interval shrinks."""
    data = record.data
    seen: dict[bytes, tuple[int, int]] = {}
    pairs = []
    for pos, exp in np.ndindex(data.n_pos, data.n_exp):
        y, u = np.ascontiguousarray(data.y[pos, exp]), np.ascontiguousarray(data.u[pos, exp])
        key = y[:: max(len(y) // 64, 1)].tobytes()
        if key in seen:
            first = seen[key]
            if np.array_equal(y, data.y[first]) and np.array_equal(u, data.u[first]):
                pairs.append((first, (pos, exp)))
        else:
            seen[key] = (pos, exp)
    yield from _twice_told(pairs, data.n_pos * data.n_exp, lambda exp: _file(record, exp))
    yield from halves(record)


def copied(record: Record) -> Iterator[Finding]:
    """Positions of which all experiments are one: nothing differs between them, and their FRF would look exact."""
    data = record.data
    for pos in range(data.n_pos if data.n_exp > 1 else 0):
        moves = record.moving["u"][pos].any() and record.moving["y"][pos].any()
        if moves and all(np.array_equal(x[pos, 0], one) for x in (data.u, data.y) for one in x[pos, 1:]):
            yield Finding(
                "copied",
                Severity.REFUSED,
                data.n_exp,
                f"experiments: found that all {data.n_exp} (position {pos}) are the same samples; expected records "
                "that differ: nothing between these tells the noise, and their FRF would look exact. Give it once.",
                pos=pos,
            )


def marks(data: Experiment) -> list[list[str]]:
    """A digest of the samples of every experiment, (pos, exp): the same for the same samples."""
    signals = (np.asarray(data.y), np.asarray(data.u))
    mark = lambda at: hashlib.blake2b(b"".join(np.ascontiguousarray(x[at]).data for x in signals), digest_size=16)
    return [[mark((pos, exp)).hexdigest() for exp in range(data.n_exp)] for pos in range(data.n_pos)]


def marked_twice(marked: Sequence[Sequence[str]]) -> Iterator[Finding]:
    """As `twice`, from the `marks` of all positions of a record that was looked at part by part."""
    seen: dict[str, tuple[int, int]] = {}
    pairs = []
    for place in ((pos, exp) for pos, row in enumerate(marked) for exp in range(len(row))):
        mark = marked[place[0]][place[1]]
        if mark in seen:
            pairs.append((seen[mark], place))
        seen.setdefault(mark, place)
    yield from _twice_told(pairs, sum(map(len, marked)), lambda exp: "")


def _twice_told(pairs, count: int, file: Callable[[int], str]) -> Iterator[Finding]:
    if pairs:
        (p, e), (q, f) = pairs[0]
        yield Finding(
            "twice",
            Severity.WARNED,
            len(pairs),
            f"experiment {f} (position {q}{file(f)}) holds the samples of experiment {e} (position {p}) once "
            f"more, and {len(pairs) - 1} others do so too: the same data count twice, and the interval is too small "
            f"by {number(np.sqrt(1 + len(pairs) / max(count - len(pairs), 1)), 2)} times. Give each once."
            if len(pairs) > 1
            else f"experiment {f} (position {q}{file(f)}) holds the samples of experiment {e} (position {p}) "
            "once more: the same data count twice, and the interval is too small. Give each only once.",
            pos=q,
            exp=f,
        )


def halves(record: Record) -> Iterator[Finding]:
    """Records whose second half is the first one once more."""
    data = record.data
    if data.n_periods < 4 or data.n_periods % 2:
        return
    first = data.transient_periods * data.period
    half = data.n_periods // 2 * data.period
    for pos, exp in np.ndindex(data.n_pos, data.n_exp):
        y = data.y[pos, exp, first:]
        if np.array_equal(y[:half], y[half:]) and not np.array_equal(
            y[: data.period], y[data.period : 2 * data.period]
        ):
            yield Finding(
                "twice",
                Severity.WARNED,
                1.0,
                f"y (position {pos}, experiment {exp}): the second half of the record is the first half once more, to "
                "the last digit: the same data count twice, and the interval is too small. Keep one of them "
                f"(--periods 0:{data.n_periods // 2}).",
                signal="y",
                pos=pos,
                exp=exp,
            )
