"""What the values of one channel show without any model: clipping, quantisation, stretches held."""

from collections.abc import Iterator

import numpy as np

from .._text import number, percent
from .finding import Finding, Severity
from .record import Channel, Record, of_channels

# Clipping piles samples up at one extreme value. Where nothing is clipped, the extreme value itself is met at
# most about 2.4 times as often as the 0.5 % of the range below it (a quantised sine at its crest); a
# Gaussian-like signal clipped at two standard deviations, 20 times.
_CLIPPED_RATIO = 6.0
_CLIPPED_SAMPLES = 8  # fewer equal samples are chance, and too few to matter
_CLIPPED_BAND = 0.005
_MANY_LINES = 20
_HEAP = 3.2  # a sine has 2.4
_HEAP_FLOOR = 0.004  # of the samples: tails hold too few to compare
_HEAP_SHARE = 0.01
_RESTS = 0.4  # of the samples: a level that a signal is meant to have, at rest or of a random binary one
_HEAP_BESIDE, _HEAP_OF_REFERENCE = 2.5, 1.3  # where the reference has so little; multisines have less than 1
_HEAP_OF_LINES = 1.5  # over that of the same lines at other phases: a limit has its phases of its own, a slow sine none
_SURROGATES = 8
_EDGE, _EDGE_SURE = 2.0, 2.5  # at the end over beside it; standard deviations of the count, at least
_EDGE_FINE = 1.6  # that ratio over the same at four times the scale: 1 for sines, which crowd at every scale
_EDGE_LEAST = 0.3  # sample in a bin
_EDGE_VISITS = 6  # of a period: a limit is met again and again, the highest crests stand anywhere
_TWO_LEVELS = 0.9  # a signal with this share of samples at its extremes is a designed two-level signal
_CORNER = 0.25  # median step before a clipped stretch, in usual steps: what comes to rest there has none

# A step of half the standard deviation leaves a handful of levels: quantisation noise is then no longer
# white, and its level (step/sqrt(12), 17 dB below the signal) limits the FRF.
_COARSE_STEP = 0.5
_NOT_DRIVEN = 1e-12  # of the power of the strongest line: lines of other channels, in zippered designs
_COARSE_SNR_DB = 20.0  # of quantisation at the excited lines: the FRF is off by a tenth there

_COARSE_FINE_DB = 50.0  # the same where its error repeats with the period: in no interval, but then below .3 %
_LOOK = 20_000  # samples are enough
_COARSE_NOISE = 0.2  # power of quantisation over that of the noise, where it repeats and is in no interval

_HELD = 4  # equal samples in a row
_HELD_JUMP = 6.0  # usual steps, that a held channel jumps by when it is let go
_HELD_RARE = 1e-3  # of the samples equal to the one before, of a signal that has no levels
_HELD_STEPS = 4.0  # quanta that it jumps by: a coarse sensor at rest jumps by one
_COUNTS = 1.5  # the same of a signal that never stands still otherwise: an encoder at rest is let go by one count
_HELD_OFTEN = 8  # stretches: more of them are how the signal is (stiction, a slow sensor)
_SLOW_UPDATE = 0.45  # share of samples equal to the one before, of a signal that is sampled faster than it is updated


@of_channels("uyr")
def clipped(c: Channel) -> Iterator[Finding]:
    """Samples piled up at an extreme value which the signal runs into."""
    low, high = c.ends
    bottom, top = c.x == low, c.x == high
    if np.count_nonzero(bottom) + np.count_nonzero(top) > _TWO_LEVELS * len(c.x):
        return
    share, level, side = max((_piled_up(c.x, top), high, 1), (_piled_up(-c.x, bottom), low, 0))
    if share and (c.signal == "u" or _runs_into(c, top if side else bottom)):
        yield c.finding(
            "clipped",
            Severity.TOLD if c.signal == "r" else Severity.WARNED,
            share,
            f"looks clipped: {number(share, 2)} of the samples stand at exactly {level:g}. "
            "Lower the excitation, or expect a biased FRF.",
        )


@of_channels("uy")
def saturated(c: Channel) -> Iterator[Finding]:
    """A heap of samples near one end of the range, where a limit was met before noise was added.

    Only with 20 excited lines or more, whose sum is nearly Gaussian, and where the reference has no such heap (a motion
    that rests at its ends, or runs at its highest speed). A heap that is sharper than the rest of the distribution is
    one beside a slow sine, too.
    """
    if len(c.record.lines) < _MANY_LINES or len(np.unique(c.x[: 10 * _MANY_LINES])) <= _MANY_LINES:
        return
    heaps = c.record.once(_heaps_of_references)
    if heaps is None:
        return
    turns = c.signal == "y" and c.record.data.y_quantity == "position"  # where friction holds it for a while
    calm = not turns and (not heaps or max(heaps) <= _HEAP_OF_REFERENCE)
    least = _HEAP_BESIDE if heaps else _HEAP
    ratio, share = _heap(c.bins[0])
    sharp = not (calm and ratio > least and share > _HEAP_SHARE and ratio > _HEAP_OF_LINES * _heap_of_lines(c))
    if sharp:
        ratio, share = _sharp_edge(c)
    if 0 < share < _RESTS and ratio:
        yield c.finding(
            "saturated",
            Severity.WARNED,
            share,
            f"looks limited: {percent(share)} of its samples crowd within {0.7 if sharp else 3:g} % of the "
            f"range near one end, {number(ratio, 2)} times as many as beside them. A sensor or a drive at its "
            "limit biases the FRF: lower the excitation.",
        )


def _heaps_of_references(record: Record) -> list[float] | None:
    """Of every channel; `None` where one has a sharp edge."""
    heaps = []
    for c in record.channels("r"):
        if _sharp_edge(c)[0]:
            return None
        heaps.append(_heap(c.bins[0])[0])
    return heaps


def _heap(count: np.ndarray) -> tuple[float, float]:
    """Samples in the fullest three of the five outermost hundredths of the range over those in the next three."""
    count = count.reshape(100, -1).sum(axis=1).astype(float)
    total = count.sum()
    best = (0.0, 0.0)
    for side in (count, count[::-1]):
        heaps = [(side[j : j + 3].sum(), side[j + 3 : j + 6].sum()) for j in range(4)]
        top, beside = max(heaps, key=lambda h: h[0] / (h[1] + 1 + _HEAP_FLOOR * total))
        best = max(best, (top / (beside + 1 + _HEAP_FLOOR * total), top / total))
    return best


def _heap_of_lines(c: Channel) -> float:
    """The heap that the same amplitudes at random phases have (Theiler et al. 1992, surrogate data)."""
    rng = np.random.default_rng(0)
    X = np.abs(np.fft.rfft(c.x[c.first :]))
    turned = lambda: np.exp(2j * np.pi * rng.random(len(X))) * np.where(np.arange(len(X)), 1, 0)
    drawn = (np.fft.irfft(X * turned(), len(c.x) - c.first) for _ in range(_SURROGATES))
    return float(np.median([_heap(np.histogram(x, 100)[0])[0] for x in drawn]))


def _sharp_edge(c: Channel) -> tuple[float, float]:
    """Samples in the fullest two of the outermost bins over those beside, and their share; 0, 0 where that is chance,
    or how the signal crowds at wider scales, too. Periods that repeat count once, and chance is that of visits: one
    crest of a signal that is sampled finely is many samples."""
    x = c.x[c.first :]
    count, edges = c.bins
    each = count / max(c.n_periods, 1)
    for side, ends in ((each, edges), (each[::-1], edges[::-1])):
        first = int(np.argmax(side[:4] + side[1:5]))
        top, beside = side[first : first + 2].sum(), side[first + 2 : first + 8].sum() / 6
        ratio = top / 2 / max(beside, _EDGE_LEAST)
        coarse = side[: first + 8].mean() / max(side[first + 8 : first + 32].mean(), _EDGE_LEAST)
        if ratio > _EDGE and ratio > _EDGE_FINE * coarse:
            low, high = sorted((ends[first], ends[first + 2]))
            stay = _stay((x >= low) & (x <= high))
            sure = _surely(c) * np.sqrt(max(8 / 3 * beside * stay, 4 / 3 * stay**2))
            if top - 2 * beside > sure and top >= _EDGE_VISITS * stay:
                return float(ratio), float(top / max(len(x) / max(c.n_periods, 1), 1))
    return 0.0, 0.0


def _surely(c: Channel) -> float:
    """Standard deviations that chance does not reach at any end of any channel of the position."""
    data = c.record.data
    return max(_EDGE_SURE, float(np.sqrt(2 * np.log(2 * data.n_exp * (data.n_in + data.n_out)))))


def _stay(inside: np.ndarray) -> float:
    """Samples of a visit, in the mean."""
    visits = np.count_nonzero(inside[1:] & ~inside[:-1]) + bool(inside[0])
    return np.count_nonzero(inside) / max(int(visits), 1)


def _piled_up(x: np.ndarray, top: np.ndarray) -> float:
    """Share of samples at the maximum of x; 0 if it is no more than a smooth signal would have there."""
    count = np.count_nonzero(top)
    if count < _CLIPPED_SAMPLES or count == len(x):
        return 0.0
    high, next_level = x[top][0], x[~top].max()
    below = np.count_nonzero((x >= min(next_level, high - _CLIPPED_BAND * np.ptp(x))) & ~top)
    return count / len(x) if count > _CLIPPED_RATIO * below else 0.0


def _runs_into(c: Channel, flat: np.ndarray) -> bool:
    """Whether x is still moving where it reaches its extreme, as a signal that comes to rest there is not."""
    steps = c.steps
    entries = np.flatnonzero(flat[2:] & ~flat[1:-1]) + 1  # the step before the one that ends at the extreme
    usual = np.median(steps[steps > 0])
    return entries.size > 1 and bool(np.median(steps[entries - 1]) > _CORNER * usual)


@of_channels("uy")
def coarse(c: Channel) -> Iterator[Finding]:
    """Steps of a quantiser that are large beside the signal, or beside its part at the excited lines."""
    step = _quantum(c)
    two_levels = step >= (c.ends[1] - c.ends[0]) * (1 - 1e-9)
    if step > _COARSE_STEP * c.std and not two_levels:
        yield c.finding(
            "coarse",
            Severity.WARNED,
            step / c.std,
            f"is coarsely quantised: it moves in steps of {number(step)}, {number(step / c.std, 2)} of its "
            "standard deviation. Excite more strongly, or log with a finer resolution.",
        )
    elif c.n_periods and c.record.lines.size and not two_levels:
        X = c.record.spectra[c.signal][c.pos, c.exp, ..., c.channel]
        own = step**2 / 12 / c.period  # power of the quantiser at a line
        power = np.abs(X.mean(axis=0)) ** 2
        power = power[power > _NOT_DRIVEN * power.max(initial=0.0)]
        snr = 10 * np.log10(max(np.median(power) if power.size else 0.0, 1e-300) / own)
        if step > 1e-6 * c.std and (snr < _COARSE_SNR_DB or (snr < _COARSE_FINE_DB and _repeats(c, X, step, own))):
            yield c.finding(
                "coarse",
                Severity.TOLD,
                10 ** (-snr / 20),
                f"is coarsely quantised: its steps of {number(step)} stand {snr:.0f} dB below the excitation at "
                f"the median line and repeat with the period. The FRF may be off by {percent(10 ** (-snr / 20))}; "
                "excite more strongly, or log with a finer resolution.",
                effect=10 ** (-snr / 20),
            )


def _repeats(c: Channel, X: np.ndarray, step: float, own: float) -> bool:
    """Whether the error of the quantiser repeats with the period, for want of noise, and is not small beside the
    scatter between periods."""
    steps = np.abs(np.diff(c.x[c.first : c.first + _LOOK])) / step
    whole = bool(np.mean(np.abs(steps - np.round(steps))) < 0.05)  # 1/4 where the smallest step is none of a quantiser
    if c.n_periods < 2 or not whole:
        return False
    noise = np.diff(c.steady[:2], axis=0).std() / np.sqrt(2)
    return bool(noise < 0.5 * step and own > _COARSE_NOISE * np.median(X.var(axis=0, ddof=1)) / c.n_periods)


def _quantum(c: Channel) -> float:
    low, high = c.ends
    return float(
        c.steps[c.steps > 1e-12 * (high - low)].min(initial=np.inf)
    )  # rounding of a scale factor makes no level


@of_channels("uyr")
def held(c: Channel) -> Iterator[Finding]:
    """A stretch at one value (or zero) that the signal jumps out of, and a signal that is updated too rarely."""
    still = c.steps == 0
    if c.signal == "y" and still.mean() > _SLOW_UPDATE and (every := _updated_every(still)):
        yield c.finding(
            "slow update",
            Severity.WARNED,
            every,
            f"changes only every {every} samples: what is logged is held in between, which delays it by "
            f"{(every - 1) / 2:g} samples in the mean and turns the phase of the FRF. Log at its own rate, or "
            "correct for the delay.",
        )
        return
    yield from _held_stretch(c, still)


def _updated_every(still: np.ndarray) -> int:
    changes = np.diff(np.flatnonzero(~still))
    every = int(np.median(changes)) if changes.size > 20 else 0
    return every if every > 1 and np.mean(changes % every == 0) > 0.95 else 0


def _held_stretch(c: Channel, still: np.ndarray) -> Iterator[Finding]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2]  # x[first] ... x[last] are equal
    long = (last - first + 1 >= _HELD) & (last >= c.first)
    if not long.any():
        return
    first, last = first[long], last[long]
    steps = c.steps
    moving = steps[steps > 0]
    usual = np.median(moving)
    into = np.where(first > 0, steps[first - 1], 0.0)
    out = np.where(last < len(steps), steps[np.minimum(last, len(steps) - 1)], 0.0)
    least = max(_HELD_JUMP * usual, _HELD_STEPS * moving.min())
    rare = c.period > 0 and still.sum() - np.sum(last - first) < _HELD_RARE * len(
        still
    )  # else a signal that never stands still
    jumps = (
        (
            (np.maximum(into, out) > least)
            | (rare & (last - first + 1 >= 2 * _HELD) & (np.maximum(into, out) > _COUNTS * moving.min()))
        )
        & (c.x[first] != c.ends[0])
        & (c.x[first] != c.ends[1])
    )
    if not c.period:  # at rest before the start and after the end
        jumps &= (first > 0) & (last < len(steps))
    if not jumps.any() or jumps.sum() > _HELD_OFTEN:
        return
    first, last = first[jumps], last[jumps]
    worst = int(np.argmax(last - first))
    a, b = int(first[worst]), int(last[worst]) + 1
    value = c.x[a]
    what = "stands at exactly 0" if value == 0 else f"is held at {number(value, 6)}"
    yield c.finding(
        "held",
        Severity.WARNED,
        (b - a) / len(c.x),
        f"{what} from sample {a} to {b - 1} and jumps by "
        f"{number(max(into[jumps][worst], out[jumps][worst]) / usual, 2)} of its usual steps there: was the logger or "
        f"the link down? The FRF may be off by about {percent(np.sqrt((b - a) / len(c.x)))}; leave that part out "
        f"({_leave_out(c, a, b)}).",
        effect=float(np.sqrt((b - a) / len(c.x))),
        samples=(a, b),
    )


def _leave_out(c: Channel, start: int, stop: int) -> str:
    """The option that keeps the longest part of a record without samples start ... stop - 1."""
    if c.n_periods > 1:
        first, last = (start - c.first) // c.period, (stop - 1 - c.first) // c.period
        if first >= c.n_periods - 1 - last and first > 0:
            return f"--periods 0:{first}"
        if last + 1 < c.n_periods:
            return f"--periods {max(last + 1, 0)}:{c.n_periods}"
    if c.period:
        return "record again"
    return f"--set samples=0:{start}" if start > len(c.x) - stop else f"--set samples={stop}:{len(c.x)}"


def dead(record: Record) -> Iterator[Finding]:
    """Channels that stand still. Inputs and references may rest in single experiments (one axis a time)."""
    still = {name: ~moving for name, moving in record.moving.items()}  # (pos, exp, channel)
    inputs_move = ~still["u"].any(axis=-1, keepdims=True)
    for name, flags in still.items():
        everywhere = flags.all(axis=1, keepdims=True)
        found = everywhere | (flags & inputs_move) if name == "y" else np.broadcast_to(everywhere, flags.shape)
        for channel in np.flatnonzero(found.any(axis=(0, 1))):
            places = found[..., channel]
            pos, exp = (int(i) for i in np.argwhere(places)[0])
            value = getattr(record.data, name)[pos, exp, 0, channel]
            yield Finding(
                "dead",
                Severity.WARNED,
                float(places.sum()),
                f"{name}: channel {channel} is constant ({value:g}) in {places.sum()} of {places.size} "
                f"experiments, first at position {pos}, experiment {exp}: is the sensor or drive dead?",
                signal=name,
                channel=int(channel),
                pos=pos,
                exp=exp,
            )
