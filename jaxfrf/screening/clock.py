"""Clocks: input and output sampled at rates that differ a little, and periods of no whole number of samples."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.fft
import scipy.ndimage

from .._text import number
from .finding import Finding, Severity
from .record import Record

_FEWEST = 12  # lines
_SURE, _SURE_ALONE = 8.0, 20.0  # standard errors; of a single experiment
_CLEAR = 0.5  # power of the scatter between periods over that of the mean, at most lines
_LEAST = 0.01  # relative error of the FRF at the middle line
_LEAST_PERIOD = 0.1  # rad at the highest line over the record, that a period of no whole number of samples turns
_MOST = 2e-3  # rates differ by less
_GRID = 100  # delays tried on either side
_SMOOTH = 9  # lines, of the scatter
_FLOOR = 1e-6  # rad^2, of every phase
_BANDS, _WIDE = 4, 1.5  # of equal weight; the mean frequency of the highest over that of the lowest
_SAME = 0.3  # part of the delay, by which it may differ between bands and experiments, beside 2 errors
_STRAIGHT = 0.15  # part of the delay over the record, by which single periods may be off the straight line
_LAG_SURE, _LAG = 4.0, 0.03  # standard errors; part of the delay's phases
_BLOCKS, _MEAN, _EVEN = 16, 4, 0.6  # of a period; of them in a moving mean; part of the delay that they may differ by
_WHOLE = 0.03  # samples from a whole number


@dataclasses.dataclass(frozen=True)
class _Delay:
    """How much later the same channels come in every period, in samples, with its standard error."""

    rate: float
    error: float
    parts: tuple[tuple[float, float], ...]  # the same in bands and channels
    bent: tuple[float, float]  # the largest distance of a period from the straight line, and its error
    lag: bool  # whether gains change with it, or phases bend, as those of a pole that moves
    wide: bool
    x: np.ndarray  # (channel, period, time)
    whitening: np.ndarray  # (channel, freq)
    lines: np.ndarray

    def grows_by(self, by: float) -> bool:
        """Whether a delay `by` of this one grows evenly with time and turns phases in proportion to frequency."""
        alike = all(abs(rate - self.rate) < _SAME * abs(by) + 2 * error for rate, error in self.parts)
        straight = self.bent[0] < _STRAIGHT * abs(by) * (self.x.shape[1] - 1) + 3 * self.bent[1]
        return self.wide and not self.lag and alike and straight and self._even(by)

    def _even(self, by: float) -> bool:
        """Whether no part of a period is shifted more or less than others, as it is where samples are lost."""
        if self.x.shape[1] == 2 and abs(by) > 0.5 and abs(by - round(by)) < _WHOLE + 3 * self.error:
            return False  # between two periods: whole samples that are lost at their border look the same
        uneven, error = _uneven(self)
        return uneven < _EVEN * abs(by) + 5 * error


def clock(record: Record) -> Iterator[Finding]:
    """Outputs whose delay against the inputs grows from period to period: they are sampled by another clock.

    X_p(w) = X_0(w) exp(-j w d p), with one d for all lines, bands, parts of a period and experiments: a machine that
    warms or is nonlinear changes otherwise. Inputs and outputs that move alike: the period is no whole number.

    **Source:** closed form (the shift theorem of the Fourier transform); the tests of what else could turn the phases
    are this project's own.
    """
    data = record.data
    if data.n_periods < 2 or len(record.lines) < _FEWEST:
        return
    for pos in range(data.n_pos):
        yield from _of_position(record, pos)


def _of_position(record: Record, pos: int) -> Iterator[Finding]:
    joint = list(_differing(record, pos, slice(None)))
    if joint or record.data.n_exp == 1:
        yield from joint
        return
    for exp in range(record.data.n_exp):
        yield from (x for x in _differing(record, pos, slice(exp, exp + 1)) if x.signal and x.sure > _SURE_ALONE)


def _differing(record: Record, pos: int, exps: slice) -> Iterator[Finding]:
    delays = {name: _of_signal(record, name, pos, exps) for name in ("u", "r") if name in record.spectra}
    u, alike = delays["u"], []
    if u is None:
        return
    r = delays.get("r")
    for channel in range(record.data.n_out):
        y = _of_signal(record, "y", pos, exps, channel)
        if y is None:
            continue
        by, error = y.rate - u.rate, float(np.hypot(y.error, u.error))
        late = r is not None and abs(u.rate - r.rate) > abs(y.rate - r.rate)
        effect = _middle(record) * abs(by) * (record.data.transient_periods + record.data.n_periods / 2)
        if abs(by) < _SURE * error or effect < _LEAST:
            alike.append(y)
        elif (u if late else y).grows_by(by):
            exp = None if exps == slice(None) else exps.start
            yield _other_clock(record, ("u", None) if late else ("y", channel), pos, exp, by, error, effect)
            if late:
                return
    if len(alike) == record.data.n_out and (found := _no_whole_period(record, pos, u, alike)):
        yield found


def _other_clock(record, where, pos, exp, by: float, error: float, effect: float) -> Finding:
    name, channel = where
    other = "u" if name == "y" else "r and y"
    rate = by / record.data.period * (1 if name == "y" else -1)
    place = f"position {pos}, " + ("all experiments" if exp is None else f"experiment {exp}")
    return Finding(
        "clock",
        Severity.WARNED,
        effect,
        f"{name}: {'all channels' if channel is None else f'channel {channel}'} ({place}) is sampled by another clock "
        f"than {other}: it comes {number(abs(by), 2)} samples {'later' if rate > 0 else 'earlier'} in every period, "
        f"{number(abs(rate) * 1e6, 2)} ppm. The phase of the FRF is off by about {number(np.degrees(effect), 2)} "
        "degrees at the middle line, more above it, and its interval does not say so. Log all signals by one clock, "
        f"or interpolate {name} at the samples n x {1 + rate:.7f}.",
        sure=abs(by) / max(error, 1e-300),
        effect=min(effect, 2.0),
        signal=name,
        channel=channel,
        pos=pos,
        exp=exp,
    )


def _no_whole_period(record: Record, pos: int, u: _Delay, ys: list[_Delay]) -> Finding | None:
    n, period = record.data.n_periods, record.data.period
    repeats = f"{period + u.rate:.{len(str(period)) + 2}g}"
    turn = 2 * np.pi * record.lines[-1] / period * abs(u.rate) * (n - 1)
    least = min([u, *ys], key=lambda x: abs(x.rate) / max(x.error, 1e-300))
    sure = abs(least.rate) / max(least.error, 1e-300)
    if turn < _LEAST_PERIOD or sure < _SURE or not all(x.grows_by(u.rate) for x in (u, *ys)):
        return None
    return Finding(
        "period length",
        Severity.TOLD,
        turn,
        f"period: u and y (position {pos}) repeat every {repeats} samples, not every {period}: their "
        f"phases turn by {number(np.degrees(turn), 2)} degrees at the highest line over the record. The mean over "
        "periods loses power there, and leakage counts as noise; the FRF stands. Let one clock drive generator and "
        "logger.",
        sure=sure,
        pos=pos,
    )


def _middle(record: Record) -> float:
    """The middle line, rad per sample."""
    return float(2 * np.pi * np.median(record.lines) / record.data.period)


def _of_signal(record: Record, name: str, pos: int, exps: slice, channel: int | None = None) -> _Delay | None:
    """The common delay of the channels of a signal, or of one, in some experiments."""
    data = record.data
    channels = slice(None) if channel is None else slice(channel, channel + 1)
    moving = record.moving[name][pos, exps, channels]
    X = np.moveaxis(record.spectra[name][pos, exps][..., channels], -1, 1)[moving]  # (channel, period, freq)
    x = np.asarray(getattr(data, name))[pos, exps, data.transient_periods * data.period :, channels]
    x = np.swapaxes(x, 1, 2)[moving].reshape(len(X), data.n_periods, data.period)
    return _delay(X, x, record.lines) if len(X) else None


def _delay(X: np.ndarray, x: np.ndarray, lines: np.ndarray) -> _Delay | None:
    """Of spectra X at these lines, (channel, period, freq), of signals x."""
    omega = 2 * np.pi * lines / x.shape[-1]
    k = np.arange(X.shape[1]) - (X.shape[1] - 1) / 2
    rate = _nearly(X, omega, x.shape[-1])
    if not X.any():
        return None
    for _ in range(3):
        phases, scatter, size = _phases(_turned_back(X, omega, rate))
        weight = 1 / (scatter + _FLOOR)
        gain, trend = (np.tensordot(part, k / (k @ k), axes=(1, 0)) for part in (phases.real, phases.imag))
        step, error = _slope(omega, trend, weight)
        rate += step
    if np.median(scatter) > _CLEAR:
        return None
    each = np.array([_slope(omega, p, weight) for p in np.moveaxis(phases.imag, 1, 0)])
    off = each[:, 0] - k * step
    over_periods = np.sqrt(np.sum(off**2) / (len(k) - 2) / (k @ k)) if len(k) > 2 else 0.0
    parts, wide = _in_parts(omega, trend, weight)
    return _Delay(
        rate,
        float(np.hypot(error, over_periods)),
        tuple((rate - step + own, own_error) for own, own_error in parts),
        (float(np.abs(off).max()) if len(k) > 2 else 0.0, float(np.median(each[:, 1]))),
        _is_lag(omega, gain, trend, weight, rate, step),
        wide,
        x,
        np.sqrt(weight) / np.maximum(size, 1e-300),
        lines,
    )


def _phases(Z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every line over the mean, conjugate: gain, and how late it is, rad; power of scatter over mean; magnitude."""
    mean = Z.mean(axis=1)
    power = np.maximum(np.abs(mean) ** 2, 1e-300)
    scatter = scipy.ndimage.uniform_filter1d(Z.var(axis=1, ddof=1), _SMOOTH, axis=1, mode="nearest")
    scatter = np.maximum(scatter, 0.0)  # running sums of large and small ones end a little below
    return Z.conj() * mean[:, None] / power[:, None], scatter / power, np.sqrt(power)


def _turned_back(X, omega, rate: float) -> np.ndarray:
    return X * np.exp(1j * omega * rate * np.arange(X.shape[1])[:, None])


def _nearly(X, omega, period: int) -> float:
    """The delay from period to period at which these are most alike, on a grid."""
    cross = np.sum(X[:, 1:] * X[:, :-1].conj(), axis=(0, 1))
    step = 0.5 / omega[-1]
    n = min(int(_MOST * period / step), _GRID)
    alike = np.full(2 * n + 1, np.sum(cross).real)
    turn = np.exp(1j * step * omega)
    turned = turn
    for i in range(1, n + 1):  # powers: a tenth of the time of as many exponentials
        alike[n + i], alike[n - i] = (turned @ cross).real, np.vdot(turned, cross).real
        turned = turned * turn
    return float(step * (np.argmax(alike) - n))


def _slope(omega, phase, weight) -> tuple[float, float]:
    """d of phase = omega d by weighted least squares, and its standard error from what is left."""
    total = np.sum(weight * omega**2)
    if total == 0:
        return 0.0, np.inf
    d = float(np.sum(weight * omega * phase) / total)
    rest = weight * omega * (phase - omega * d)
    n = int(np.count_nonzero(weight))
    return d, float(np.sqrt(np.sum(rest**2)) / total * np.sqrt(n / max(n - 1, 1)))


def _is_lag(omega, gain, phase, weight, rate: float, step: float) -> bool:
    """Whether gains change as w^2, or phases as w^3, too: dG/G = -j w dT/(1 + j w T) of a lag T. Clocks leave both."""
    cubic = omega**3
    cubic = cubic - omega * (np.sum(weight * omega * cubic) / np.sum(weight * omega**2))
    for shape, change in ((omega**2, gain), (cubic, phase - omega * step)):
        size, error = _slope(shape, change, weight)
        part = np.sqrt(np.sum(weight * (size * shape) ** 2) / np.sum(weight * (rate * omega) ** 2)) if rate else 0.0
        if abs(size) > _LAG_SURE * error and part > _LAG:
            return True
    return False


def _in_parts(omega, phase, weight) -> tuple[list[tuple[float, float]], bool]:
    """Slopes in bands of equal weight and of each signal, and whether the bands are wide enough to tell anything."""
    worth = np.sum(weight, axis=0) * omega**2
    edges = np.searchsorted(np.cumsum(worth), np.linspace(0, 1, _BANDS + 1)[1:-1] * worth.sum())
    bands = [i for i in np.split(np.arange(len(omega)), edges) if len(i) > 2]
    found = [_slope(omega[i], phase[:, i], weight[:, i]) for i in bands]
    centres = [np.average(omega[i], weights=np.sum(weight[:, i], axis=0) + 1e-300) for i in bands]
    found += [_slope(omega, phase[i], weight[i]) for i in range(len(phase))] if len(phase) > 1 else []
    return found, len(bands) > 1 and centres[0] * _WIDE < centres[-1]


def _uneven(delay: _Delay) -> tuple[float, float]:
    """The largest shift that is left between two periods in a part of them, in samples, and its error."""
    period, lines = delay.x.shape[-1], delay.lines
    band = np.arange(
        lines[0], lines[-1] + 1
    )  # the lines between, too: of odd ones alone, half a period tells the other
    gain = np.array([np.interp(band, lines, x) for x in delay.whitening])
    spectrum = np.zeros((*delay.x.shape[:2], period // 2 + 1), complex)
    X = scipy.fft.rfft(delay.x, axis=-1)[..., band]
    spectrum[..., band] = _turned_back(X, 2 * np.pi * band / period, delay.rate) * gain[:, None]
    z = scipy.fft.irfft(spectrum, period)
    slope = scipy.fft.irfft(spectrum.mean(axis=1) * 2j * np.pi * np.arange(period // 2 + 1) / period, period)
    width = period // _BLOCKS
    in_blocks = lambda x: x[..., : width * _BLOCKS].reshape(*x.shape[:-1], _BLOCKS, width).sum(axis=-1)
    shift = -in_blocks(np.diff(z, axis=1) * slope[:, None]).sum(axis=0) / in_blocks(slope**2).sum(axis=0)
    smooth = scipy.ndimage.uniform_filter1d(shift, _MEAN, axis=1, mode="wrap")
    chance = 1.4826 * np.median(np.abs(np.diff(shift, axis=1))) / np.sqrt(2 * _MEAN)
    return float(np.abs(smooth).max()), float(chance)
