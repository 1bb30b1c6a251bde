"""When samples were taken: jitter, and an output that comes before its cause."""

from collections.abc import Iterator

import numpy as np
import scipy.ndimage

from .._text import number
from .finding import Finding, Severity
from .record import Channel, Record, of_channels

_BINS = 12  # of the slope
_JITTER_SHARE = 0.6  # of the difference between periods, that slope and jitter explain
_JITTER_LEAST = 0.02  # sample intervals
_JITTER_FIT = 0.25  # of the explained part, that the bins may deviate from the straight line by, beyond chance
_JITTER_WHITE = 0.3  # correlation of neighbouring samples: delays that change slowly are no jitter
_LOOK = 200_000  # samples are enough

_LEAD = 0.45  # samples: where u is held between samples, a lead of one leaves a half
_LEAD_SURE = 6.0  # standard errors
_LEAD_SPREAD = 0.15  # rad about the straight line, that a lead is
_LEAD_SAME = 0.4  # part of it, by which it may differ in each third of the band
_END = 0.5  # of the highest line: from here on the magnitude must run straight ...
_STRAIGHT_DB = 1.0  # ... within this, ...
_STEEP_DB = 18.0  # ... and no steeper than 40 dB a decade (20/ln 10 = 8.7 dB for each power of frequency)
_CLEAR = 100.0  # power of the mean spectrum over its scatter, where phases are looked at
_FEWEST = 20  # lines
_LEAST_TURN = 0.1  # rad, by a lead of one sample at the highest line; below it, phases tell nothing

_LEADS = np.arange(-8.0, 8.01, 0.05)  # samples, tried for lightly damped machines
_NEAR_AXIS = 0.15  # rad, within which a phase counts as that of an undamped machine
_ON_AXES, _BETTER = 0.5, 1.3  # share of the band that is, at the lead; that share over the best one without a lead
_LIGHT_SURE = 5.0  # standard errors
_LEAST_LIGHT = 0.3  # rad at the highest line: dampers of springs make less
_HALF, _IN_HALF = 0.5 * np.pi + 0.25, 0.97  # rad; share of the band within it
_BLOCKS = 10  # of the band, each left out once


@of_channels("uy")
def jitter(c: Channel) -> Iterator[Finding]:
    """Samples taken early and late: successive periods differ where the signal is steep, by its slope times the jitter.

    Var[x_p(t) - x_q(t)] = 2 s^2 x'(t)^2 + const.
    """
    if c.n_periods > 1:
        yield from _jitter(c)


def _jitter(c: Channel) -> Iterator[Finding]:
    x = c.steady[: max(2, _LOOK // c.period)]
    slope = np.gradient(x.mean(axis=0)) ** 2
    difference = np.mean(np.diff(x, axis=0) ** 2, axis=0)
    if not slope.any() or not difference.any():
        return
    order = np.argsort(slope)
    part = np.array_split(order, _BINS)
    s, d = (np.array([z[i].mean() for i in part]) for z in (slope, difference))
    if s.mean() == 0:
        return
    fit = np.polyfit(s, d, 1)
    if not fit[0] > 0:
        return
    size = float(np.sqrt(fit[0] / 2))
    share = fit[0] * s.mean() / d.mean()
    chance = np.mean([difference[i].var() / len(i) for i in part])
    rest = np.sqrt(max(np.var(d - np.polyval(fit, s)) - chance, 0.0)) / max(fit[0] * s.std(), 1e-300)
    moved = np.diff(x, axis=0) * np.gradient(x.mean(axis=0))  # white where the jitter is
    together = np.sum(moved[:, 1:] * moved[:, :-1]) / max(np.sum(moved**2), 1e-300)
    if size > _JITTER_LEAST and share > _JITTER_SHARE and rest < _JITTER_FIT and together < _JITTER_WHITE:
        yield c.finding(
            "jitter",
            Severity.TOLD if size < 0.2 else Severity.WARNED,
            size,
            f"looks sampled with jitter of {number(size, 2)} sample intervals (standard deviation): periods differ "
            "where it is steep. That adds noise towards high frequencies and lowers the FRF there, by "
            "(2 pi f/fs x jitter)^2/2. Log from a clock, not from a loop of a computer.",
        )


def noncausal(record: Record) -> Iterator[Finding]:
    """An output that leads its input by more than its magnitude allows: samples shifted against each other.

    The phase of a response without zeros in the right half plane follows from its magnitude (Bode 1945),
    arg G(w) = 1/pi int d ln|G|/dv ln coth(|v|/2) dv, v = ln(w'/w), up to a multiple of pi/2; delays and other zeros
    only take from it. What is left and rises with frequency is a lead, which no machine has. Within a band a resonance
    beyond its end does the same, so that this is used only where |G| runs straight over the upper half of the band; or
    where drive and sensor are at one place and damping is light (`_light_lead`), which needs nothing from beyond it.
    A band of little turn, heavy damping, drive and sensor apart: a lead cannot be told from what the machine is.
    """
    data = record.data
    if not data.n_periods or len(record.lines) < _FEWEST or data.n_in != data.n_out:
        return
    omega = 2 * np.pi * record.lines / data.period  # rad per sample
    if omega[-1] < _LEAST_TURN:
        return
    for pos in range(data.n_pos):
        k, G, clear = _response(record, pos)
        if G is None:
            continue
        for channel in range(data.n_in):
            good = clear[:, channel]
            if good.sum() < _FEWEST // 2 or good.mean() < 0.5:
                continue
            lead, error = _lead(omega[k][good], G[good, channel, channel])
            if not (lead > _LEAD and lead > _LEAD_SURE * error):
                lead, error = _light_lead(omega[k][good], G[good, channel, channel])
            if lead > _LEAD:
                yield Finding(
                    "noncausal",
                    Severity.WARNED,
                    lead,
                    f"y: channel {channel} (position {pos}) leads u by about {lead:.1f} samples more than its gain "
                    "allows, which no machine does: u is logged late, or y early. The phase of the FRF is off by "
                    f"{np.degrees(omega[-1] * lead):.0f} degrees at the highest line. Shift one of them, or correct "
                    "the logger.",
                    sure=lead / max(error, 1e-300),
                    effect=float(min(omega[-1] * lead, 2.0)),
                    signal="y",
                    channel=channel,
                    pos=pos,
                )


def _response(record: Record, pos: int):
    """A response by least squares over groups of lines, and where it can be trusted: group centres, G, clear."""
    U, Y = (record.spectra[name][pos].mean(axis=1) for name in ("u", "y"))  # (exp, freq, channel)
    n_exp, n_freq, n_in = U.shape
    width = max(1, -(-2 * n_in // n_exp)) if n_exp < n_in else 1
    groups = n_freq // width
    if groups < _FEWEST // 2:
        return None, None, None
    cut = slice(0, groups * width)
    U = np.moveaxis(U[:, cut].reshape(n_exp, groups, width, n_in), 1, 0).reshape(groups, -1, n_in)
    Y = np.moveaxis(Y[:, cut].reshape(n_exp, groups, width, -1), 1, 0).reshape(groups, n_exp * width, -1)
    with np.errstate(all="ignore"):
        try:
            G = np.swapaxes(np.linalg.pinv(U) @ Y, 1, 2)
        except np.linalg.LinAlgError:
            return None, None, None
    return np.arange(groups) * width + width // 2, G, _clear(record, pos, groups, width)


def _clear(record: Record, pos: int, groups: int, width: int) -> np.ndarray:
    """Groups and outputs where the mean spectrum stands 20 dB above its scatter: (group, out)."""
    Y = record.spectra["y"][pos]  # (exp, period, freq, channel)
    power = np.sum(np.abs(Y.mean(axis=1)) ** 2, axis=0)
    if Y.shape[1] < 2:
        return np.ones((groups, Y.shape[-1]), bool)
    scatter = np.sum(Y.var(axis=1, ddof=1), axis=0) / Y.shape[1]
    scatter = scipy.ndimage.uniform_filter1d(scatter, 9, axis=0, mode="nearest")
    clear = power > _CLEAR * scatter
    return clear[: groups * width].reshape(groups, width, -1).mean(axis=1) > 0.5


def _lead(omega, G) -> tuple[float, float]:
    """Phase of G beyond that of its magnitude, as a lead in samples, with its standard error."""
    good = np.isfinite(G) & (np.abs(G) > 0)
    omega, G = omega[good], G[good]
    if len(omega) < _FEWEST // 2:
        return 0.0, np.inf
    if not _calm_end(omega, np.abs(G)):
        return 0.0, np.inf
    grid = np.geomspace(omega[0], omega[-1], 4 * len(omega))
    gain = np.interp(np.log(grid), np.log(omega), np.log(np.abs(G)))
    phase = np.interp(omega, grid, _phase_of_gain(np.log(grid), gain))
    extra = np.unwrap(np.angle(G * np.exp(-1j * phase)))
    inner = (omega > omega[0] * 1.2) & (omega < omega[-1] / 1.1)
    w, e = omega[inner], extra[inner]
    if len(w) < _FEWEST // 2:
        return 0.0, np.inf
    lead, spread = _line(w, e)
    parts = [_line(w[i], e[i])[0] for i in np.array_split(np.arange(len(w)), 3)]
    if spread > _LEAD_SPREAD or max(abs(p - lead) for p in parts) > max(_LEAD_SAME * abs(lead), 0.15):
        return 0.0, np.inf  # steps, not a line: a resonance between two lines, or beyond the band
    # Errors of the phase of the gain are alike at neighbouring lines: a tenth of them count as independent.
    independent = max(len(w) / 10, 3)
    return lead, float(spread / (w.std() * np.sqrt(independent)))


def _light_lead(omega, G) -> tuple[float, float]:
    """Lead of a lightly damped machine that is driven and seen at one place, with its standard error; 0 where it is
    not sure that it is one.

    Such a machine answers with a phase near two opposite directions, 0 and pi or both turned by pi/2, between which it
    changes at resonances and antiresonances in turn (the Foster theorem), whatever lies beyond the band. The lead is
    that which brings most of the band there.
    """
    good = np.isfinite(G) & (np.abs(G) > 0)
    omega, phase = omega[good], np.angle(G[good])
    if len(omega) < _FEWEST:
        return 0.0, np.inf
    weight = np.gradient(omega) / np.ptp(omega)
    most, turn, parts = 0.0, 0.0, np.zeros((1, len(_LEADS)))
    for direction in (0.0, 0.5 * np.pi):
        off = np.angle(np.exp(2j * (phase - omega * _LEADS[:, None] - direction))) / 2
        near = np.exp(-((off / _NEAR_AXIS) ** 2)) * weight
        blocks = np.stack([near[:, i].sum(axis=1) for i in np.array_split(np.arange(len(omega)), _BLOCKS)])
        if (level := float(blocks.sum(axis=0).max())) > most:
            most, turn, parts = level, direction, blocks
    whole = parts.sum(axis=0)
    lead = float(_LEADS[np.argmax(whole)])
    without = _LEADS[np.argmax(whole - parts, axis=1)]  # each block left out: the jackknife
    error = max(float(np.sqrt((_BLOCKS - 1) * np.var(without))), _LEADS[1] - _LEADS[0])
    sure = most > _ON_AXES and most > _BETTER * whole[_LEADS <= 0].max() and lead > _LIGHT_SURE * error
    if not sure or lead * omega[-1] < _LEAST_LIGHT or not _at_one_place(phase - omega * lead, turn, weight):
        return 0.0, np.inf
    return lead, error


def _at_one_place(phase, turn: float, weight) -> bool:
    """Whether phases change between two opposite directions, through one half plane, at least twice."""
    away = [np.abs(np.angle(np.exp(1j * (phase - o)))) < _HALF for o in (0, 0.5 * np.pi, np.pi, -0.5 * np.pi)]
    side = scipy.ndimage.median_filter(np.sign(np.cos(phase - turn)), 5)
    changes = int(np.count_nonzero(np.diff(side)))
    return max(float(np.sum(weight * x)) for x in away) > _IN_HALF and changes >= 2


def _calm_end(omega, size) -> bool:
    """Whether |G| runs straight on logarithmic axes over the upper end of the band: a resonance near or beyond it turns
    phases within the band that the magnitude there does not tell."""
    top = omega > _END * omega[-1]
    if top.sum() < 5:
        return False
    v, gain = np.log(omega[top]), 20 * np.log10(size[top])
    fit = np.polyfit(v, gain, 1)
    return bool(np.std(gain - np.polyval(fit, v)) < _STRAIGHT_DB and abs(fit[0]) < _STEEP_DB)


def _line(w, e) -> tuple[float, float]:
    """Slope of e over w by the median of pairs (Theil 1950), and the spread about that line."""
    half = len(w) // 2
    slope = float(np.median((e[half : 2 * half] - e[:half]) / (w[half : 2 * half] - w[:half])))
    rest = e - slope * w
    return slope, float(1.4826 * np.median(np.abs(rest - np.median(rest)))) + 1e-9


def _phase_of_gain(v, gain) -> np.ndarray:
    """Bode's integral on a grid even in v = ln w, the slopes at both ends going on beyond them."""
    n, step = len(v), v[1] - v[0]
    pad = n
    slope = np.gradient(gain, step)
    edge = max(n // 20, 2)
    slope = np.concatenate([np.full(pad, slope[:edge].mean()), slope, np.full(pad, slope[-edge:].mean())])
    far = np.arange(-(n + pad), n + pad + 1) * step
    middle = n + pad
    with np.errstate(divide="ignore"):
        kernel = np.log(1 / np.tanh(np.abs(far) / 2))
    # The pole at 0: its integral over one step, ln coth(v/2) ~ ln(2/v).
    kernel[middle] = np.log(4 / step) + 1
    whole = np.convolve(slope, kernel, mode="full")[middle : middle + len(slope)] * step / np.pi
    return whole[pad : pad + n]
