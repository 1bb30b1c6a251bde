"""Experiments beside each other: one that the same machine cannot have answered, and the same one given twice."""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from .finding import Finding, Severity
from .record import Record

_TERMS = 2  # G is taken as a straight line over a window of lines
_DOF = 2.0  # equations over unknowns in a window, without the experiment looked at
_MISMATCH = 0.25  # power that the others cannot predict, of an experiment's output, from which it does not belong ...
_USUAL = 6.0  # ... and this many times what is so with the other ones
_TWO = 6.0  # residual of two experiments together over that of each alone
_CAUSE = 0.25  # of the mismatch, that a swap or a sign leaves, to be named
_LEVEL = 1.5  # ratio of excitation from which another answer is no wonder


def foreign(record: Record) -> Iterator[Finding]:
    """An experiment whose output the others do not predict, with what would mend it where that is plain.

    Over windows of neighbouring lines, Y = G U with G a straight line in frequency is fitted to the other experiments
    and tested on the one. Of two experiments alone none can be blamed: they contradict each other.
    """
    data = record.data
    if data.n_exp < 2 or not data.period or len(record.lines) < 8:
        return
    for pos in range(data.n_pos):
        windows = _windows(record, pos)
        if windows is None:
            continue
        left_out: list[int] = []
        while data.n_exp - len(left_out) > 2 and len(left_out) < max(data.n_exp // 3, 1):
            found = _worst(windows, left_out)
            if found is None:
                break
            left_out.append(found.exp)
            yield _does_not_belong(record, pos, windows, found, left_out)
        if data.n_exp - len(left_out) == 2:
            yield from _contradict(record, pos, windows, left_out)


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


def _windows(record: Record, pos: int) -> _Windows | None:
    U, Y = (record.spectra[name][pos].mean(axis=1) for name in ("u", "y"))  # (exp, freq, channel)
    U, Y = (X / np.maximum(np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 1))), 1e-300) for X in (U, Y))
    n_exp, n_freq, n_in = U.shape
    width = int(np.ceil(_DOF * _TERMS * n_in / max(n_exp - 1, 1))) + 1
    count = n_freq // width
    if count < 3:
        return None
    place = np.linspace(-1, 1, width)[:, None]
    U, Y = (X[:, : count * width].reshape(n_exp, count, width, -1) for X in (U, Y))
    return _Windows(np.concatenate([U, U * place], axis=-1), Y)


def _worst(windows: _Windows, without: list[int]) -> _Foreign | None:
    exps = [e for e in range(len(windows.Y)) if e not in without]
    each = {}
    for e in exps:
        G = windows.prediction([x for x in exps if x != e])
        each[e] = (windows.mismatch(e, G), G)
    worst = max(exps, key=lambda e: each[e][0].max())
    others = [e for e in exps if e != worst]
    # What is usual without it: each other one predicted by the rest.
    if len(others) > 2:
        usual = [windows.mismatch(e, windows.prediction([x for x in others if x != e])) for e in others]
    else:
        usual = [windows.mismatch(e, each[worst][1]) for e in others]
    usual = float(np.median([m.max() for m in usual]))
    size = each[worst][0]
    if size.max() < _MISMATCH or size.max() < _USUAL * usual:
        return None
    return _Foreign(worst, size, usual, each[worst][1])


def _does_not_belong(record: Record, pos: int, windows: _Windows, found: _Foreign, left_out: list[int]) -> Finding:
    n = record.data.n_exp
    channel = int(np.argmax(found.mismatch))
    size = float(np.sqrt(found.mismatch[channel]))
    level = _level(record, pos, found.exp)
    cause = _cause(windows, found)
    why = f" {cause}" if cause else " Swapped cables or channels, another machine, or noise?"
    severity = Severity.WARNED
    if not cause and (level > _LEVEL or level < 1 / _LEVEL):
        severity = Severity.TOLD
        why = f" It was excited {level:.2g} times as strongly: a nonlinear machine answers differently."
    effect = min(size / (n - len(left_out) + 1), 1.0)
    return Finding(
        "foreign",
        severity,
        size,
        f"experiment {found.exp} (position {pos}{_file(record, found.exp)}) does not belong to the others: they predict "
        f"its y (channel {channel}) with an error of {100 * size:.2g} %, each other with {100 * np.sqrt(found.usual):.2g} "
        f"%.{why} The FRF may be off by {100 * effect:.2g} %; leave it out, or correct it.",
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


def _contradict(record: Record, pos: int, windows: _Windows, left_out: list[int]) -> Iterator[Finding]:
    """Two experiments: each smooth in frequency by itself, not both with one response."""
    pair = [e for e in range(record.data.n_exp) if e not in left_out]
    n_in = record.data.n_in
    both = windows.prediction(pair)
    together = np.max([windows.mismatch(e, both) for e in pair], axis=0)
    if n_in > 1 or windows.A.shape[2] <= _TERMS * n_in + 1:
        alone = np.full_like(together, np.inf)
        wide = _wider(record, pos, pair)
        if wide is None:
            return
        both = wide.prediction([0, 1])
        together = np.max([wide.mismatch(e, both) for e in (0, 1)], axis=0)
        alone = np.max([wide.mismatch(e, wide.prediction([e])) for e in (0, 1)], axis=0)
    else:
        alone = np.max([windows.mismatch(e, windows.prediction([e])) for e in pair], axis=0)
    channel = int(np.argmax(together / np.maximum(alone, 1e-6)))
    size = together[channel]
    if size < _MISMATCH / 4 or size < _TWO * alone[channel]:
        return
    level = _level(record, pos, pair[0])
    if level > _LEVEL or level < 1 / _LEVEL:
        return
    yield Finding(
        "foreign",
        Severity.WARNED,
        float(np.sqrt(size)),
        f"experiments {pair[0]} and {pair[1]} (position {pos}) contradict each other: no one response gives y (channel "
        f"{channel}) in both, {100 * np.sqrt(size):.2g} % is left over, and {100 * np.sqrt(alone[channel]):.2g} % in each "
        "alone. Channels swapped, a sign turned, or noise in one of them? Estimate them one by one and compare.",
        effect=float(min(np.sqrt(size), 1.0)),
        signal="y",
        channel=channel,
        pos=pos,
    )


def _wider(record: Record, pos: int, pair: list[int]) -> _Windows | None:
    """Windows in which each experiment alone determines a response."""
    U, Y = (record.spectra[name][pos][pair].mean(axis=1) for name in ("u", "y"))
    U, Y = (X / np.maximum(np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 1))), 1e-300) for X in (U, Y))
    width = 2 * _TERMS * U.shape[-1]
    count = U.shape[1] // width
    if count < 3:
        return None
    place = np.linspace(-1, 1, width)[:, None]
    U, Y = (X[:, : count * width].reshape(2, count, width, -1) for X in (U, Y))
    return _Windows(np.concatenate([U, U * place], axis=-1), Y)


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
    if pairs:
        (p, e), (q, f) = pairs[0]
        yield Finding(
            "twice",
            Severity.WARNED,
            len(pairs),
            f"experiment {f} (position {q}{_file(record, f)}) holds the samples of experiment {e} (position {p}) once "
            f"more, and {len(pairs) - 1} others do so too: the same data count twice, and the interval is too small "
            f"by {np.sqrt(1 + len(pairs) / max(data.n_pos * data.n_exp - len(pairs), 1)):.2g} times. Give each only once."
            if len(pairs) > 1
            else f"experiment {f} (position {q}{_file(record, f)}) holds the samples of experiment {e} (position {p}) "
            "once more: the same data count twice, and the interval is too small. Give each only once.",
            pos=q,
            exp=f,
        )
    yield from _halves(record)


def _halves(record: Record) -> Iterator[Finding]:
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
