"""What is suspicious but usable in a record: where it is, and how much."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import scipy.fft

from ._errors import InputError
from .experiment import Experiment
from .spectra import excited_lines

# Clipping piles samples up at one extreme value. Where nothing is clipped, the extreme value itself is met at
# most about 2.4 times as often as the 0.5 % of the range below it (a quantised sine at its crest); a
# Gaussian-like signal clipped at two standard deviations, 20 times.
_CLIPPED_RATIO = 6.0
_CLIPPED_SAMPLES = 8  # fewer equal samples are chance, and too few to matter
_CLIPPED_BAND = 0.005
_TWO_LEVELS = 0.9  # a signal with this share of samples at its extremes is a designed two-level signal

# A step of half the standard deviation leaves a handful of levels: quantisation noise is then no longer
# white, and its level (step/sqrt(12), 17 dB below the signal) limits the FRF.
_COARSE_STEP = 0.5

# A drift by d over one period leaks d/(2 pi k) into line k. Over the record, 5 % of the rms is where a
# drifting offset (temperature, slipping) starts to be seen beside the excitation.
_DRIFT = 0.05
_DRIFT_SIGNIFICANT = 5.0  # standard errors

# A period is odd if it deviates from the mean of the others more than the noise lets the median period do.
# Measured periods scatter by up to a factor of 4 (friction, disturbances). A reference should repeat exactly.
_ODD_RATIO = 5.0
_ODD_MEASURED = 0.01
_ODD_REFERENCE = 0.001

# Below 10 dB the mean spectrum itself is wrong by a third, and the logarithm of an FRF is biased.
_LOW_SNR_DB = 10.0
_NO_SNR = 0.1  # less cannot be told from nothing by the scatter of some periods


@dataclasses.dataclass(frozen=True)
class _Finding:
    kind: str
    severity: float  # the worst finding of a kind is the one that is told
    says: str


def screen(data: Experiment) -> tuple[str, ...]:
    """What looks wrong in a record though it can be used: one sentence a kind, with the worst place.

    Looks for clipped inputs, dead channels and coarse quantisation; in periodic records also for a first
    period that is not steady yet, single periods that differ from the others, drifting means and a low
    signal-to-noise ratio at the excited lines (from the scatter between periods). Nonlinear distortion
    repeats with the period and is not seen.
    """
    findings = [*_dead(data)]
    for name, x in _signals(data):
        for pos in range(data.n_pos):
            for exp in range(data.n_exp):
                place = f"position {pos}, experiment {exp}"
                findings += _record(name, x[pos, exp], place)
                if data.n_periods > 1:
                    findings += _periods(data, name, x[pos, exp], place)
    if data.n_periods > 1:
        findings += _noisy(data)
    return _worst_of_each_kind(findings)


def _signals(data: Experiment) -> Iterator[tuple[str, np.ndarray]]:
    for name in ("u", "y", "r"):
        x = getattr(data, name)
        if x is not None:
            yield name, np.asarray(x)


def _worst_of_each_kind(findings: list[_Finding]) -> tuple[str, ...]:
    kinds: dict[str, list[_Finding]] = {}
    for finding in findings:
        kinds.setdefault(finding.kind, []).append(finding)
    sentences = []
    for same in kinds.values():
        worst = max(same, key=lambda finding: finding.severity)
        more = f" This is the worst of {len(same)} such places." if len(same) > 1 else ""
        sentences.append(worst.says + more)
    return tuple(sentences)


def _dead(data: Experiment) -> Iterator[_Finding]:
    """Channels that stand still. Inputs and references may rest in single experiments (one axis a time)."""
    still = {name: np.ptp(x, axis=2) == 0 for name, x in _signals(data)}  # (pos, exp, channel)
    inputs_move = ~still["u"].any(axis=-1, keepdims=True)
    for name, flags in still.items():
        everywhere = flags.all(axis=1, keepdims=True)
        dead = everywhere | (flags & inputs_move) if name == "y" else np.broadcast_to(everywhere, flags.shape)
        for channel in np.flatnonzero(dead.any(axis=(0, 1))):
            places = dead[..., channel]
            pos, exp = (int(i) for i in np.argwhere(places)[0])
            value = getattr(data, name)[pos, exp, 0, channel]
            yield _Finding(
                "dead",
                float(places.sum()),
                f"{name}: channel {channel} is constant ({value:g}) in {places.sum()} of {places.size} "
                f"experiments, first at position {pos}, experiment {exp}: is the sensor or drive dead?",
            )


def _record(name: str, x: np.ndarray, place: str) -> Iterator[_Finding]:
    """Findings in one record (time, channel) that need no period."""
    for channel, signal in enumerate(np.ascontiguousarray(x.T)):
        if np.ptp(signal) == 0:
            continue
        at = f"{name}: channel {channel} ({place})"
        if name == "u":
            yield from _clipped(signal, at)
        if name != "r":
            yield from _coarse(signal, at)


def _clipped(x: np.ndarray, at: str) -> Iterator[_Finding]:
    low, high = x.min(), x.max()
    bottom, top = x == low, x == high
    if np.count_nonzero(bottom) + np.count_nonzero(top) > _TWO_LEVELS * len(x):
        return
    worst = max((_piled_up(x, top), high), (_piled_up(-x, bottom), low))
    share, level = worst
    if share:
        yield _Finding(
            "clipped",
            share,
            f"{at} looks clipped: {share:.2g} of the samples stand at exactly {level:g}. "
            "Lower the excitation, or expect a biased FRF.",
        )


def _piled_up(x: np.ndarray, top: np.ndarray) -> float:
    """Share of samples at the maximum of x; 0 if it is no more than a smooth signal would have there."""
    count = np.count_nonzero(top)
    if count < _CLIPPED_SAMPLES or count == len(x):
        return 0.0
    high, next_level = x[top][0], x[~top].max()
    below = np.count_nonzero((x >= min(next_level, high - _CLIPPED_BAND * np.ptp(x))) & ~top)
    return count / len(x) if count > _CLIPPED_RATIO * below else 0.0


def _coarse(x: np.ndarray, at: str) -> Iterator[_Finding]:
    steps = np.abs(np.diff(x))
    steps = steps[steps > 1e-12 * np.ptp(x)]  # rounding of a scale factor makes no level
    step = steps.min()
    two_levels = step >= np.ptp(x) * (1 - 1e-9)
    if step > _COARSE_STEP * x.std() and not two_levels:
        yield _Finding(
            "coarse",
            step / x.std(),
            f"{at} is coarsely quantised: it moves in steps of {step:.3g}, {step / x.std():.2g} of its "
            "standard deviation. Excite more strongly, or log with a finer resolution.",
        )


def _periods(data: Experiment, name: str, x: np.ndarray, place: str) -> Iterator[_Finding]:
    """Findings in one record from the comparison of its steady periods."""
    n = data.n_periods
    x = x[data.transient_periods * data.period :].reshape(n, data.period, -1)
    rms = x.mean(axis=0).std(axis=0)
    means = x.mean(axis=1)
    for channel in np.flatnonzero(rms > 0):
        at = f"{name}: channel {channel} ({place})"
        if n > 2:
            yield from _odd_period(data, name, x[..., channel], rms[channel], at)
        if name != "r" and n > 3:
            yield from _drift(means[:, channel], rms[channel], at)


def _odd_period(data: Experiment, name: str, x: np.ndarray, rms: float, at: str) -> Iterator[_Finding]:
    n = len(x)
    # Against the mean of the other periods: x_p - (n m - x_p)/(n - 1) = (x_p - m) n/(n - 1). Offsets are
    # drift.
    deviation = (x - x.mean(axis=0)) * (n / (n - 1))
    size = deviation.std(axis=1) / rms
    worst = int(np.argmax(size))
    least = _ODD_REFERENCE if name == "r" else _ODD_MEASURED
    # With one bad period among n all others deviate by 1/(n - 1) of it, which few periods cannot be blamed
    # for.
    usual = min(_ODD_RATIO, 0.75 * (n - 1)) * np.median(size)
    if size[worst] <= max(least, usual):
        return
    sample = int(np.argmax(np.abs(deviation[worst])))
    first = (data.transient_periods + worst) * data.period
    if worst == 0:
        yield _Finding(
            "unsteady",
            size[worst],
            f"{at} is not steady in its first used period ({size[worst]:.2g} of the rms away from the "
            f"others): drop it, --set transient_periods={data.transient_periods + 1}.",
        )
    else:
        yield _Finding(
            "odd period",
            size[worst],
            f"{at} differs in {_called(worst, n)} (samples {first} to {first + data.period - 1}) by "
            f"{size[worst]:.2g} of the rms from the others, most at sample {first + sample}: samples lost or "
            "repeated, or a disturbance?",
        )


def _called(period: int, n: int) -> str:
    return "its last period" if period == n - 1 else f"steady period {period} of 0 to {n - 1}"


def _drift(means: np.ndarray, rms: float, at: str) -> Iterator[_Finding]:
    n = len(means)
    k = np.arange(n) - (n - 1) / 2
    slope = k @ means / (k @ k)
    error = np.sqrt(np.sum((means - means.mean() - slope * k) ** 2) / max(n - 2, 1) / (k @ k))
    drift = abs(slope) * (n - 1) / rms
    if drift > _DRIFT and abs(slope) > _DRIFT_SIGNIFICANT * error:
        yield _Finding(
            "drift",
            drift,
            f"{at} drifts: its mean moves by {slope * (n - 1):.3g}, {drift:.2g} of the rms, over {n} "
            "periods. Leakage of it disturbs the lowest lines.",
        )


def _noisy(data: Experiment) -> Iterator[_Finding]:
    """Signal-to-noise ratio of the mean spectra at a position, median over the excited lines."""
    try:
        lines = excited_lines(data) if data.lines is None else np.asarray(data.lines)
    except InputError:  # nothing excited: the estimators will say so, with the method at hand
        return
    for name in ("y", "u"):
        x = np.asarray(getattr(data, name))
        for pos in range(data.n_pos):
            power, noise = sum(_power_and_noise(data, record, lines) for record in x[pos])
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.where(power > 0, power / noise, np.nan)
            # The power holds the noise once more.
            snr = 10 * np.log10(np.maximum(np.median(ratio, axis=0) - 1, _NO_SNR))
            for channel in np.flatnonzero(snr < _LOW_SNR_DB):
                told = f"{snr[channel]:.1f}" if snr[channel] > 10 * np.log10(_NO_SNR) else "-10 or less"
                yield _Finding(
                    "noise",
                    -snr[channel],
                    f"{name}: channel {channel} (position {pos}) has a median signal-to-noise ratio of only "
                    f"{told} dB at the excited lines. Excite more strongly, or average more periods.",
                )


def _power_and_noise(data: Experiment, x: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """|X|^2 of the mean steady period and its variance by the scatter between periods: (2, line, channel)."""
    n = data.n_periods
    periods = x[data.transient_periods * data.period :].reshape(n, data.period, -1)
    X = scipy.fft.rfft(periods, axis=1, workers=-1)[:, lines]
    return np.stack([np.abs(X.mean(axis=0)) ** 2, X.var(axis=0, ddof=1) / n])
