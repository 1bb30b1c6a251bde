"""A record as the checks look at it: channel by channel, in periods, and at the excited lines."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
import scipy.fft

from .._errors import InputError
from .._threads import kept
from ..experiment import Experiment
from ..periodic import FoundLines
from ..spectra import found_lines
from .finding import Finding, Severity

T = TypeVar("T")
_BINS = 300  # of the range: fine enough for a limit with noise of a third of a percent behind it; hundredths hold three


@dataclasses.dataclass(frozen=True)
class Channel:
    """One channel of one signal in one experiment, and where it is."""

    record: "Record"
    signal: str
    channel: int
    pos: int
    exp: int
    x: np.ndarray  # (time,), with the transient periods
    period: int
    first: int  # of the steady samples

    @property
    def at(self) -> str:
        return f"{self.signal}: channel {self.channel} (position {self.pos}, experiment {self.exp})"

    @kept
    def steady(self) -> np.ndarray:
        """The steady periods (period, time), not copied; the record without a period is one."""
        return self.x[self.first :].reshape(-1, self.period or len(self.x))

    @property
    def n_periods(self) -> int:
        return len(self.steady) if self.period else 0

    @kept
    def steps(self) -> np.ndarray:
        """From sample to sample, without their sign."""
        return np.abs(np.diff(self.x))

    @kept
    def std(self) -> float:
        return float(self.x.std())

    @kept
    def bins(self) -> tuple[np.ndarray, np.ndarray]:
        """How many samples behind the transient stand in every 300th of their range, and the edges of these."""
        return np.histogram(self.x[self.first :], _BINS)

    @kept
    def ends(self) -> tuple[float, float]:
        """The least and the largest value."""
        return float(self.x.min()), float(self.x.max())

    def finding(self, kind: str, severity: Severity, size: float, says: str, **more) -> Finding:
        where: dict[str, Any] = {"signal": self.signal, "channel": self.channel, "pos": self.pos, "exp": self.exp}
        return Finding(kind, severity, size, f"{self.at} {says}", **where, **more)


@dataclasses.dataclass(frozen=True)
class OfChannels:
    """A check that looks at one channel after the other, of the signals of these names.

    All checks of this kind look at a channel before the next one is taken: it stays in the cache."""

    check: Callable[[Channel], Iterator[Finding]]
    signals: str


def of_channels(signals: str) -> Callable[[Callable[[Channel], Iterator[Finding]]], OfChannels]:
    return lambda check: OfChannels(check, signals)


class Record:
    """An experiment, and what several checks need of it, computed once."""

    def __init__(self, data: Experiment):
        self.data = data
        self._known: dict[Callable, Any] = {}

    def once(self, function: Callable[["Record"], T]) -> T:
        """`function(record)`, called once."""
        if function not in self._known:
            self._known[function] = function(self)
        return self._known[function]

    def signals(self) -> Iterator[tuple[str, np.ndarray]]:
        for name in ("u", "y", "r"):
            x = getattr(self.data, name)
            if x is not None:
                yield name, np.asarray(x)

    def channels(self, names: str = "uyr") -> Iterator[Channel]:
        """The channels that move, of the signals of these names."""
        data = self.data
        first = data.transient_periods * data.period
        for name, x in self.signals():
            if name not in names:
                continue
            for pos, exp in np.ndindex(data.n_pos, data.n_exp):
                moving = self.moving[name][pos, exp]
                for channel, one in enumerate(np.ascontiguousarray(x[pos, exp].T)):
                    if moving[channel]:
                        yield Channel(self, name, channel, pos, exp, one, data.period, first)

    @kept
    def moving(self) -> dict[str, np.ndarray]:
        """Which channels move: (pos, exp, channel)."""
        by_channel = lambda x: np.array([[np.ptp(np.ascontiguousarray(one.T), axis=1) for one in at] for at in x])
        return {name: by_channel(x) > 0 for name, x in self.signals()}

    @kept
    def found_lines(self) -> FoundLines | None:
        """What the spectrum shows; `None` without a period, or where nothing is excited."""
        try:
            return found_lines(self.data) if self.data.period else None
        except InputError:  # the estimators will say so, with the method at hand
            return None

    @kept
    def lines(self) -> np.ndarray:
        """The excited lines, given or found; none without a period."""
        if self.data.lines is not None and self.data.period:
            return np.asarray(self.data.lines)
        return np.zeros(0, int) if self.found_lines is None else self.found_lines.lines

    @kept
    def spectra(self) -> dict[str, np.ndarray]:
        """Fourier coefficients of every steady period at the excited lines: (pos, exp, period, freq, channel)."""
        data, found = self.data, {}
        for name, x in self.signals():
            shape = (data.n_pos, data.n_exp, data.n_periods, len(self.lines), x.shape[-1])
            found[name] = np.empty(shape, complex)
            for pos, exp in np.ndindex(shape[:2]):
                steady = x[pos, exp, data.transient_periods * data.period :]
                steady = steady.reshape(data.n_periods, data.period, -1)
                found[name][pos, exp] = scipy.fft.rfft(steady, axis=1, workers=-1)[:, self.lines] / data.period
        return found
