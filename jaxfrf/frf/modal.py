"""Modes of a machine from its FRF: poles, damping and residues, with intervals and a stabilisation diagram."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from .._arguments import expect, expect_number, expect_whole
from .._errors import input_error
from .._text import NORMAL_95, number
from .._threads import one_blas_thread
from .._types import Array
from .modal_lines import Lines, background_of, chosen_lines
from .poles import PoleFit
from .response import FRF
from .stabilisation import LARGEST_DAMPING, Stabilisation, clusters, nearest, pole, stabilisation

_HOPELESS = 10.0  # standard deviations, rms, that no mode at all leaves: they say less than how linear a machine is
_LINEAR = 0.01  # of |G|, then: with the noise alone the few quietest lines of a real machine decide
_DELAYS, _QUARTER = 17, np.pi / 2  # delays that are tried, up to those that turn the highest line by a quarter turn
_USUAL, _HIGHER = 30, 60  # orders, the latter where much is left: modes in a small part of a wide band
_LIKELY = 3.84  # by how much the cost rises at the ends of a 95 % interval: chi-square of one number
_SIGNIFICANT = 4.0  # standard deviations of its residues, root mean square over the elements
_MISSED = 2.0  # misfit from which a mode is fitted to the lines around it, too, to see what the others do to it
_LAG_DAMPING = (0.7, 0.999)  # that a lag is looked for with, of a second and of a first order, ...
_LAG_AT = (0.15, 0.4, 1.0)  # ... at these parts of the highest frequency
_LAG_EXPLAINS = 1.2  # misfit, at most, beside a lag that is one; 1 but for noise, more where its fit did not end
_MISSED_BY_LAG = 1.07  # the same beside a lag, which leaves nothing where it is one
_THERE = 0.07  # of the frequency at which a mode was asked for, within which it is
_AROUND, _FEWEST = 8.0, 16  # half widths of the resonance on either side; lines
_SURE = 0.5  # relative standard deviation of a damping beyond which nothing is known of it


class Mode(eqx.Module):
    """A mode: lambda = -damping w + j w sqrt(1 - damping^2), w = 2 pi frequency.

    **Fields:** `frequency`: Hz (undamped). `damping`: ratio to the critical one. `frequency_std`, `damping_std`:
    standard deviations; 95 % intervals are +-1.96 of them. `residue`: (out, in), of 1/(s - lambda), unit of G rad/s.
    `residue_std`: of its modulus, (out, in). `significance`: root mean square of residue over its standard deviation.
    """

    frequency: float = eqx.field(static=True)
    damping: float = eqx.field(static=True)
    frequency_std: float = eqx.field(static=True)
    damping_std: float = eqx.field(static=True)
    residue: Complex[np.ndarray, "out in"]
    residue_std: Float[np.ndarray, "out in"]
    significance: float = eqx.field(static=True)

    @property
    def pole(self) -> complex:
        """rad/s, that of the pair with a positive imaginary part."""
        return pole(self.frequency, self.damping)


class ModalModel(eqx.Module):
    """The modes of an FRF at one operating point.

    **Fields:** `modes`: by frequency, those that are significant. `background`: what the modes outside the band and the
    rigid motion amount to: coefficients of s^(q-2), s^(q-1), s^q, (3, out, in), q the derivative that y is. `misfit`:
    root mean square of the residual over its standard deviation; far above 1 the standard deviations, which are widened
    by it, are lower limits, and `doubt` says what may be the cause. An FRF without covariance is held against how it
    scatters from line to line: 1.0 to 1.2 where the modes explain it, up to 1.8 where lines share data. `delay`: s, of
    all elements alike, and `delay_std`, its standard deviation; 0 where none is significant or it was given.
    `stabilisation`: see there. `dropped`: frequencies, Hz, of stable poles that turned out not significant. `lags`:
    pairs of poles that were fitted with the modes and are none, as they are damped by more than .5: what a drive or a
    filter does; empty where the modes alone are enough. `frequency`, `measured`: the FRF that was fitted, (freq,), Hz,
    and (freq, out, in). `y_quantity`, `u_unit`, `y_unit`: as in `FRF`.
    """

    modes: tuple[Mode, ...]
    background: Float[np.ndarray, "term out in"]
    misfit: float
    delay: float
    delay_std: float
    stabilisation: Stabilisation
    dropped: Float[np.ndarray, "mode"]
    lags: tuple[Mode, ...]
    frequency: Float[np.ndarray, "freq"]
    measured: Complex[np.ndarray, "freq out in"]
    y_quantity: str = eqx.field(static=True)
    u_unit: str = eqx.field(static=True, default="")
    y_unit: str = eqx.field(static=True, default="")
    outside: tuple[Mode, ...] = ()

    @property
    def doubt(self) -> str:
        """Why these modes may not be the machine's, in one sentence; "" where `misfit` is up to 2."""
        if not self.misfit > _MISSED:
            return ""
        return (
            f"the modes leave {number(self.misfit, 2)} times the FRF's standard deviation (or a hundredth of it), and "
            "their intervals may be too small: a mode is missing (--near, --order), modes beyond the band shape it "
            "(--band), drives have several lags or filters in the band (--band around one mode), channels are delayed "
            "by different times, which shows towards high lines (--band), or the machine is not linear"
        )

    def response(self, frequency: Float[Array, "freq"]) -> Complex[np.ndarray, "freq out in"]:
        """G of the modes, the lags, the background and the delay, (freq, out, in)."""
        s = 2j * np.pi * np.asarray(frequency, float)
        G = np.einsum("ft,toi->foi", background_of(s, self.y_quantity), self.background)
        for mode in (*self.modes, *self.lags, *self.outside):
            R, pole = mode.residue, mode.pole
            G = G + R / (s - pole)[:, None, None] + R.conj() / (s - np.conj(pole))[:, None, None]
        return G * np.exp(-s * self.delay)[:, None, None]


@one_blas_thread
def modal(
    frf: FRF,
    *,
    position: int = 0,
    band: tuple[float | None, float | None] | None = None,
    max_order: int | None = None,
    near: Sequence[float] | None = None,
    delay: float | None = None,
) -> ModalModel:
    """Modes of an FRF: frequencies, damping ratios and residues, each with its standard deviation.

    Poles come from a right matrix fraction in z = exp(-j w T), fitted by least squares to all elements at once for
    every order up to `max_order` (polyreference least-squares complex frequency domain). A pole that stays from order
    to order is a mode. Modes, residues and a background are then fitted together, each line weighed by its standard
    deviation; modes without significance are left out and the others fitted again.

        G(s) = e^(-s delay) (sum_i R_i/(s - lambda_i) + conj. + B_0 s^(q-2) + B_1 s^(q-1) + B_2 s^q),
        q = 0, 1, 2 as y is

    An input that is held between samples acts half a sample late, a filter or a bus later still: one delay of all
    elements is fitted with the modes, and left out where it is not significant. A drive's lag or a filter is a pair of
    strongly damped poles more: it is fitted where it explains what is left, and is no mode (`lags`).

    Standard deviations are those of this fit, from the FRF's covariance (errors that all outputs share, as noise of
    an input, count as such), with the misfit, and with how alike the errors of lines are that share data
    (`window`); without a covariance (a UFF file) from how G scatters from line to line, and how what is left hangs
    together. Where much is left (`misfit` above 2: dynamics that are no modes, as several lags), every mode is
    fitted once more to the lines around it alone, with a background and a delay of its own, and how far its
    frequency and damping move widens their standard deviations: the 95 % interval reaches where they move to. Where
    no mode at all is found and much is left, a hundredth of |G| stands in the place of smaller standard deviations,
    for `misfit` too. Biased: modes smoothed by a window wider than their resonance look more damped, and closely
    spaced modes of a record with few lines may be taken as one; delays that differ between channels misfit towards
    high lines; lags within the band pull modes by more than the widened interval now and then: choose a `band`
    around the mode. Fails where fewer than three lines lie in a resonance.

    **Arguments:**

    - `frf`: `position` chooses the operating point, `band` (low, high; Hz; `None` at an end: open) a part.
    - `max_order`: of the denominator; by default 30, and 60 where that leaves much, or less where there are few lines.
    - `near`: frequencies, Hz, of the modes to take, where the automatic choice is not wanted.
    - `delay`: s, where it is known; by default found.

    **Returns:** a `ModalModel`: frequencies in Hz, damping ratios, residues (out, in) of the unit of G rad/s.

    **Raises:** `jaxfrf.InputError` for a `band`, `delay` or order that is none, if too few lines are left, and where
    no pole lies near one of `near` or the fit goes elsewhere.

    **Source:** Peeters, Van der Auweraer, Guillaume & Leuridan, Shock and Vibration 11 (2004) 395-409.
    """
    expect("frf", frf, FRF)
    if delay is not None:
        expect_number("delay", delay)
    lines = chosen_lines(frf, position, band)
    asked = _Asked(_orders(max_order, near, len(lines.s), frf.n_in), near, delay)
    found = _fitted(lines, asked)
    if near is not None:
        _check_there(found.fitted, near)
    return _reported(found._replace(fitted=_with_intervals(found.fitted, lines, asked)), lines, frf)


class _Asked(NamedTuple):
    """Of `modal`: orders that are looked at, the latter where the former leave much; `near`, `delay`."""

    orders: tuple[int, ...]
    near: Sequence[float] | None
    delay: float | None

    def fit(self, lines: Lines, poles, lags=()) -> tuple[PoleFit, np.ndarray]:
        """The significant ones of these poles, and those that were dropped."""
        return _significant(lines, poles, self.near is not None, self.delay, lags)


class _Found(NamedTuple):
    """Poles of an order, rad/s: from where they were fitted, `start`; `fitted`; and those that were `dropped`."""

    table: Stabilisation
    start: Complex[np.ndarray, "mode"]
    fitted: PoleFit
    dropped: Complex[np.ndarray, "mode"]


def _fitted(lines: Lines, asked: _Asked) -> _Found:
    """What a search with even weights finds, fitted with those of the lines."""
    even = lines.evenly_weighed()
    found = _searched(even, asked)
    fitted = found.fitted
    if not len(fitted.poles) and fitted.misfit > _HOPELESS:
        return _searched(even._replace(std=np.maximum(even.std, _LINEAR * np.abs(lines.G))), asked)
    if even is lines:
        return found
    lag = fitted.damping > LARGEST_DAMPING
    fitted, more = asked.fit(lines, fitted.poles[~lag], fitted.poles[lag])
    return found._replace(fitted=fitted, dropped=np.append(found.dropped, more))


def _searched(lines: Lines, asked: _Asked) -> _Found:
    """The order that leaves least; beside a lag where all leave much."""
    tried: list[_Found] = []
    for order in asked.orders:
        table = stabilisation(lines.frequency, lines.G, lines.std, order)
        start = clusters(table) if asked.near is None else nearest(table, asked.near)
        tried.append(_Found(table, start, *asked.fit(lines, start)))
        if tried[-1].fitted.misfit <= _MISSED:
            return tried[-1]
    return _with_lag(min(tried, key=lambda x: x.fitted.misfit), lines, asked)


def _with_intervals(fitted: PoleFit, lines: Lines, asked: _Asked) -> PoleFit:
    """The fit with the interval of its delay, and with wider ones of its modes where much is left."""
    if asked.delay is None and len(fitted.poles):
        fitted = _profiled(fitted, lines)
    lagging = np.any(fitted.damping > LARGEST_DAMPING)
    much = fitted.misfit > (_MISSED_BY_LAG if lagging else _MISSED)
    return _widened(fitted, lines) if much else fitted


def _reported(found: _Found, lines: Lines, frf: FRF) -> ModalModel:
    fitted, (n_out, n_in) = found.fitted, lines.G.shape[1:]
    every = _modes(fitted, n_out, n_in)
    modes = [x for x in every if x.damping <= LARGEST_DAMPING]
    inside = lambda mode: lines.frequency[0] <= mode.frequency <= lines.frequency[-1]
    return ModalModel(
        modes=tuple(x for x in modes if inside(x)),
        background=fitted.coefficients[:, 2 * len(fitted.poles) :].T.reshape(-1, n_out, n_in),
        misfit=float(fitted.misfit) if np.isfinite(fitted.misfit) else 1.0,
        delay=fitted.delay,
        delay_std=fitted.delay_std,
        stabilisation=found.table,
        dropped=np.sort(np.abs(found.dropped)) / (2 * np.pi),
        lags=tuple(x for x in every if x.damping > LARGEST_DAMPING),
        outside=tuple(x for x in modes if not inside(x)),
        frequency=lines.frequency,
        measured=lines.G,
        y_quantity=frf.y_quantity,
        u_unit=frf.u_unit,
        y_unit=frf.y_unit,
    )


def _orders(asked: int | None, near, n_lines: int, n_in: int) -> tuple[int, ...]:
    """The usual order and, where nothing was asked for, a higher one, as far as there are lines."""
    most = max((n_lines - 4) // (1 + n_in) - 1, 2)
    if asked is None:
        orders = [min(order, most) for order in (_USUAL, _HIGHER)]
        return tuple(dict.fromkeys(orders if near is None else orders[:1]))
    expect_whole("max_order", asked)
    if not 2 <= asked <= most:
        raise input_error("max_order", f"{asked}", f"2 to {most} with {n_lines} lines", "Choose another.")
    return (int(asked),)


def _significant(lines: Lines, poles, keep: bool, delay, lags=()) -> tuple[PoleFit, np.ndarray]:
    """Fit all, leave out the least significant, until all that is left is significant; `lags` stay."""
    dropped: list[float] = []
    poles = np.append(poles, lags)
    lag = np.arange(len(poles)) >= len(poles) - len(lags)
    while True:
        if not len(poles):
            delay = delay or 0.0  # a delay of nothing
        fitted = lines.fit(poles, delay)
        lag = lag[fitted.began]
        bad = np.zeros(len(poles), bool) if keep or not len(poles) else _doubtful(fitted, lag)
        if not bad.any():
            if delay is None and not abs(fitted.delay) > _SIGNIFICANT * fitted.delay_std:
                delay = 0.0
                continue
            return fitted, np.array(dropped)
        strength = fitted.strength
        # Those without any significance at once, the doubtful ones one by one: they may gain by what went.
        gone = bad & (strength <= max(_SIGNIFICANT / 2, np.min(np.where(bad, strength, np.inf))))
        dropped += list(fitted.poles[gone])
        poles, lag = fitted.poles[~gone], lag[~gone]


def _profiled(fitted: PoleFit, lines: Lines) -> PoleFit:
    """The fit with the interval of its delay by the profile of the cost, and coefficients as loose as they are over it;
    without a delay where that explains the data as well.

    Delay and phases of residues make a long curved valley, whose curvature at its lowest point says too little."""
    delays = np.linspace(-1.0, 1.0, _DELAYS) * _QUARTER / np.abs(lines.s).max()
    each = {x: lines.fit(fitted.poles, x) for x in delays}
    nothing = each[0.0]
    best = min([fitted, *each.values()], key=lambda x: x.cost)
    rise = lambda x: (x.cost - best.cost) / fitted.unit
    width, ends = NORMAL_95 * fitted.delay_std, []
    for sign in (-1.0, 1.0):
        beyond = sorted((x for x in each if sign * (x - fitted.delay) > 0), key=lambda x: sign * x)
        known = [x for x in beyond if rise(each[x]) < _LIKELY]
        far = max((abs(x - fitted.delay) for x in known), default=0.0)
        behind = [x for x in beyond if abs(x - fitted.delay) > far]
        if behind and not known:  # the cost rises as the square of the distance
            far = abs(behind[0] - fitted.delay) * np.sqrt(_LIKELY / rise(each[behind[0]]))
        width = max(width, far)
        ends += [each[x] for x in known[-1:]]
    fitted = nothing if rise(nothing) < _LIKELY else fitted._replace(delay_std=width / NORMAL_95)
    return _turning(fitted, ends)


def _turning(fitted: PoleFit, others: Sequence[PoleFit]) -> PoleFit:
    """Standard deviations of the coefficients with how far they move where the delay is another that may be."""
    std = fitted.coefficient_std
    for other in others:
        if other.coefficients.shape == fitted.coefficients.shape:
            std = np.maximum(std, np.abs(other.coefficients - fitted.coefficients) / NORMAL_95)
    return fitted._replace(coefficient_std=std)


def _check_there(fitted: PoleFit, near: Sequence[float]) -> None:
    """Raise where a mode that was asked for went elsewhere, or to another's place."""
    ends = np.abs(fitted.poles[fitted.damping <= LARGEST_DAMPING]) / (2 * np.pi)
    for f, end in zip(np.sort(np.atleast_1d(near)), ends, strict=False):
        if abs(end - f) > _THERE * f:
            raise input_error(
                "near",
                f"{f:g} Hz, from where the fit goes to {number(end, 4)} Hz",
                "frequencies of modes",
                "See the stabilisation diagram; leave --near out to have the modes found.",
            )


def _with_lag(plain: _Found, lines: Lines, asked: _Asked) -> _Found:
    """The same with a strongly damped pair of poles more, where that leaves nothing but noise, or finds the modes;
    beside certain modes that were asked for the pair may not become another."""
    top = np.abs(lines.s).max() / (2 * np.pi)
    lags = [pole(part * top, damping) for damping in _LAG_DAMPING for part in _LAG_AT]
    fits = [asked.fit(lines, plain.start, (lag,)) for lag in lags]
    tried = [plain._replace(fitted=fitted, dropped=dropped) for fitted, dropped in fits]
    modes = lambda found: np.count_nonzero(found.fitted.damping <= LARGEST_DAMPING)
    tried = [x for x in tried if asked.near is None or modes(x) == modes(plain)] or [plain]
    best = min(tried, key=lambda found: found.fitted.misfit)
    lost = not len(plain.fitted.poles) and best.fitted.misfit < plain.fitted.misfit / 2
    return best if best.fitted.misfit < _LAG_EXPLAINS or lost else plain


def _doubtful(fitted: PoleFit, lag: np.ndarray) -> np.ndarray:
    """Which poles say too little; a lag may: its residues cancel where one real pole is enough."""
    loose = fitted.damping_std / np.abs(fitted.damping)
    unlikely = (fitted.damping <= 0) | (fitted.damping > LARGEST_DAMPING)
    doubtful = (fitted.strength < _SIGNIFICANT) | ~(loose < _SURE) | unlikely
    return doubtful & ~(lag & (fitted.damping > LARGEST_DAMPING))


def _widened(fitted: PoleFit, lines: Lines) -> PoleFit:
    """Standard deviations with how far each mode moves where lines far from it do not count."""
    each = range(len(fitted.poles))
    moved = np.array([_moved(fitted, i, lines) for i in each]).reshape(-1, 2)
    return fitted._replace(
        frequency_std=np.hypot(fitted.frequency_std, moved[:, 0] / NORMAL_95),
        damping_std=np.hypot(fitted.damping_std, moved[:, 1] / NORMAL_95),
    )


def _moved(fitted: PoleFit, i: int, lines: Lines) -> tuple[float, float]:
    """Of frequency, Hz, and damping, beyond what the fit around the mode does not know itself; 0 where it fails."""
    at, damping = abs(fitted.poles[i]), fitted.damping[i]
    away = np.abs(np.abs(lines.s) - at)
    wide = max(_AROUND * damping * at, np.sort(away)[min(_FEWEST, len(away)) - 1])
    inside = np.abs(np.abs(fitted.poles) - at) <= wide
    local = lines.at(away <= wide).fit(fitted.poles[inside], None)
    j = int(np.argmin(np.abs(local.poles - fitted.poles[i])))
    by = (abs(local.poles[j]) - at) / (2 * np.pi), local.damping[j] - damping
    known = local.frequency_std[j], local.damping_std[j]
    if not (np.isfinite(known).all() and 0 < local.damping[j] < LARGEST_DAMPING):
        return 0.0, 0.0
    beyond = [float(np.sqrt(max(b**2 - k**2, 0.0))) for b, k in zip(by, known, strict=True)]
    return beyond[0], beyond[1]


def _strength(fitted: PoleFit) -> np.ndarray:
    """Root mean square over the elements of residues over their standard deviation."""
    size, std = fitted.residues
    return np.sqrt(np.mean((np.abs(size) / std) ** 2, axis=0))


def _modes(fitted: PoleFit, n_out: int, n_in: int) -> tuple[Mode, ...]:
    residue, std = fitted.residues
    strength = _strength(fitted) if len(fitted.poles) else np.zeros(0)
    return tuple(
        Mode(
            frequency=float(abs(pole) / 2 / np.pi),
            damping=float(fitted.damping[i]),
            frequency_std=float(fitted.frequency_std[i]),
            damping_std=float(fitted.damping_std[i]),
            residue=residue[:, i].reshape(n_out, n_in),
            residue_std=std[:, i].reshape(n_out, n_in),
            significance=float(strength[i]),
        )
        for i, pole in enumerate(fitted.poles)
    )
