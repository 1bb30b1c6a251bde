"""What one reads off a response: resonances and antiresonances, with intervals."""

import itertools

import equinox as eqx
import numpy as np

from .._arguments import expect, expect_index, expect_number
from .._status import Status
from .._threads import one_blas_thread
from .overlap import Overlap, of_fractions, overlaps
from .poles import PoleFit, fit_poles
from .response import FRF
from .scatter import scatter

_TURN = np.pi / 4  # least phase across an extremum, between the lines where 3 dB of it are gone
_AROUND = 3.0  # half widths (3 dB) of lines on each side that tell frequency and damping
_ENOUGH = 8  # lines, to see how they scatter
_FEWEST = 4  # lines on each side, at least
_SIGNIFICANT = 3.0  # standard deviations of the extremum itself, beside its surroundings
_NUMBERS = 8  # that a pole and a straight line are
_SURE = 0.5  # relative standard deviation of a damping beyond which it is not told


class Feature(eqx.Module):
    """An extremum of the magnitude of one element: `kind` is `resonance` or `antiresonance`.

    **Fields:** `frequency`: Hz, of the pole or zero where the lines tell it, else of the line. `frequency_std`: its
    standard deviation (of a line, by the 3 dB band around it); a 95 % interval is +-1.96 of it. `damping`,
    `damping_std`: ratio to the critical one; NaN where the lines do not tell it. `magnitude_db`, `prominence_db`: at
    the line, and over the surroundings.
    """

    kind: str = eqx.field(static=True)
    frequency: float = eqx.field(static=True)
    magnitude_db: float = eqx.field(static=True)
    prominence_db: float = eqx.field(static=True)
    frequency_std: float = eqx.field(static=True, default=float("nan"))
    damping: float = eqx.field(static=True, default=float("nan"))
    damping_std: float = eqx.field(static=True, default=float("nan"))


@one_blas_thread
def features(frf: FRF, out: int = 0, into: int = 0, *, position: int = 0, prominence_db: float = 6.0) -> list[Feature]:
    """Peaks and dips of |G[out, into]| that stand out by at least `prominence_db`, the most prominent first.

    Frequency and damping are those of one pole (of G, or of 1/G for a dip) beside a smooth rest, fitted to the lines
    around the extremum; `jaxfrf.modal` fits all modes of all elements together. What two standard deviations could have
    made, and a pole that is not significant beside the smooth rest, is left out; where the standard deviation is
    unknown, it is seen in how the lines around scatter. Where it is that of the noise alone (status `NOISE_ONLY`), how
    rough the response is from line to line counts as well: distortion scatters it. At lines that a taper reaches beyond
    the band from (`EDGE_WINDOW` of `Welch`) nothing is told. A pole or zero pair turns the phase by 90 degrees within
    its 3 dB band; a valley between two slopes, as where no zero lies between two resonances, does not, and is left out
    too.

    Biased where two resonances overlap, and by the window of a local method that is wider than the resonance.

    **Arguments:** `frf`: `position`, `out` and `into` choose one of its elements, each from 0. `prominence_db`: least
    height over the surroundings, dB.

    **Returns:** `Feature`s, with frequencies in Hz; none where nothing stands out.

    **Raises:** `jaxfrf.InputError` if `frf` is none, or has no such position, output or input.

    **Source:** closed form of one pole, fitted by variable projection (Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973)
    413-432); prominence as `scipy.signal.find_peaks` has it. What counts as significant is this project's own.
    """
    expect("frf", frf, FRF)
    for name, chosen, count in (("position", position, frf.n_pos), ("out", out, frf.n_out), ("into", into, frf.n_in)):
        expect_index(name, chosen, count)
    expect_number("prominence_db", prominence_db)
    G = np.asarray(frf.G)[position, :, out, into]
    std = np.asarray(frf.std)[position, :, out, into]
    window = np.nan_to_num(np.asarray(frf.window, float)[position], nan=1.0)
    columns = np.asarray(frf.G)[position, :, :, into]
    of_windows = overlaps(window[None])
    frequency = np.asarray(frf.frequency, float)
    std = np.where(np.isfinite(std) & (std > 0), std, _scatter(frequency, G))
    magnitude = np.maximum(np.abs(G), 1e-300)
    status = np.asarray(frf.status)[position]
    std = np.where(status & int(Status.NOISE_ONLY), np.fmax(std, _scatter(frequency, G)), std)
    at_end = ((status & int(Status.EDGE_WINDOW)) != 0) & (window < _FEWEST)
    level = 20 * np.log10(magnitude)
    doubt = 2 * np.nan_to_num(std) / magnitude
    higher, lower = 20 * np.log10(1 + doubt), -20 * np.log10(np.maximum(1 - doubt, 1e-300))
    found = []
    for kind, sign, of_peak, of_base in (("resonance", 1.0, lower, higher), ("antiresonance", -1.0, higher, lower)):
        for i, base in _peaks(sign * level, prominence_db):
            prominence = abs(level[i] - level[base])
            surroundings = _surroundings(sign * level, sign * level + of_base, i)
            if sign * level[i] - of_peak[i] <= surroundings or at_end[i] or _turn(G, sign * level, i) <= _TURN:
                continue
            value, slope = (G, np.ones_like(G)) if sign > 0 else (1 / G, -1 / G**2)
            lines = np.arange(len(G))[_lines(sign * level, i)]
            alike = () if of_windows is None else _alike(of_windows[0].at(lines), window, columns, slope[lines])
            fitted = _around(frequency, value, std * np.abs(slope), alike, sign * level, i)
            if fitted is not None:
                at, *intervals = map(float, fitted)
                found.append(Feature(kind, at, float(level[i]), float(prominence), *intervals))
    return sorted(found, key=lambda x: -x.prominence_db)


def _scatter(frequency, G) -> np.ndarray:
    """Of every line with a number, by how the lines around it scatter; NaN elsewhere."""
    enough = np.isfinite(G).sum() >= _ENOUGH
    return np.maximum(scatter(frequency, G), 1e-6 * np.abs(G)) if enough else np.full(len(G), np.nan)


def _peaks(level, prominence: float) -> list[tuple[int, int]]:
    """Local maxima that stand out by at least `prominence`, and the higher one of the two valleys beside each. What
    `scipy.signal.find_peaks` gives (tested), whose import takes as long as a small estimate."""
    change = np.sign(np.diff(level))
    steps = np.flatnonzero(change)
    tops = [(a + 1 + b) // 2 for a, b in itertools.pairwise(steps) if change[a] > 0 > change[b]]
    found = []
    for top in map(int, tops):
        first, last = _reach(level, top)
        valleys = first + int(np.argmin(level[first : top + 1])), top + int(np.argmin(level[top:last]))
        base = max(valleys, key=lambda k: level[k])
        if level[top] - level[base] >= prominence:
            found.append((top, base))
    return found


def _reach(level, top: int) -> tuple[int, int]:
    """The first of the lines around a peak that are no higher than it, and the one after the last."""
    higher = np.flatnonzero(level > level[top])
    left, right = higher[higher < top], higher[higher > top]
    return (int(left[-1]) + 1 if left.size else 0), (int(right[0]) if right.size else len(level))


def _surroundings(level, highest, top: int) -> float:
    """How high the valleys on both sides of a peak may be, the higher one: each by the line that tells most, which in a
    record is seldom the lowest one (that is often a line which carries nothing)."""
    first, last = _reach(level, top)
    return float(max(highest[first : top + 1].min(), highest[top:last].min()))


def _lines(level, at: int) -> slice:
    """The lines around a peak that tell of it."""
    left, right = _edges(level, at)
    reach = [max(int(np.ceil(_AROUND * n)), _FEWEST) for n in (at - left, right - at)]
    return slice(max(at - reach[0], 0), min(at + reach[1] + 1, len(level)))


def _edges(level, at: int) -> tuple[int, int]:
    """The nearest lines on both sides of a peak where the level is 3 dB lower, or the ends."""
    gone = level < level[at] - 3.0
    left, right = np.flatnonzero(gone[:at]), np.flatnonzero(gone[at:])
    return (left[-1] if left.size else 0), (at + right[0] if right.size else len(level) - 1)


def _turn(G, level, at: int) -> float:
    """Phase between the lines on both sides of a peak where the level is 3 dB lower (or the ends), rad."""
    first, last = _edges(level, at)
    return abs(np.angle(G[last] * G[first].conj()))


def _alike(overlap: Overlap, window, G, slope) -> tuple:
    """Correlations that errors of a function of G with this slope may have at the lines of `overlap`, of windows that
    share data: as parabolas have them and as fractions do, which beside a pole err in its shape."""
    turn = slope / np.maximum(np.abs(slope), 1e-300)
    of_shape = of_fractions(window, np.where(np.isfinite(G), G, 0.0), overlap.lines)
    return overlap, turn[:, None] * of_shape * turn.conj()


def _around(frequency, G, std, alike, level, at: int) -> tuple[float, float, float, float] | None:
    """Frequency, damping and their deviations of the pole behind a peak; `None` where it is not significant."""
    lines = _lines(level, at)
    f = frequency[lines]
    apart = float(np.median(np.diff(f))) if len(f) > 1 else 0.0
    left, right = _edges(level, at)
    broad = max(float(frequency[right] - frequency[left]) - apart, apart)  # a peak alone is not known better
    by_line = (float(frequency[at]), broad / np.sqrt(12.0), float("nan"), float("nan"))
    if len(f) < 2 * _FEWEST or not (np.isfinite(G[lines]).all() and np.isfinite(std[lines]).all()):
        return by_line
    fitted = _one_pole(f, G[lines], std[lines], alike, frequency[at])
    size, spread = fitted.residues
    if np.abs(size[0, 0]) < _SIGNIFICANT * spread[0, 0]:
        return None
    # What is left beyond the noise is one error of all lines: of data that they share, or of another mode's tail.
    chance = 1.0 if alike else 1.0 + np.sqrt(1.0 / max(len(f) - _NUMBERS / 2, 1.0))
    systematic = np.sqrt(1.0 + max(1.0 - chance / fitted.misfit**2, 0.0) * len(f))
    frequency_std, damping_std = (float(systematic * x[0]) for x in (fitted.frequency_std, fitted.damping_std))
    pole = float(np.abs(fitted.poles[0]) / 2 / np.pi)
    if abs(pole - frequency[at]) > max(2 * apart, broad / 2) or not frequency_std < broad:
        return by_line
    damping = float(fitted.damping[0])
    sure = damping_std < _SURE * damping
    return (pole, frequency_std, damping, damping_std) if sure else (pole, frequency_std, float("nan"), float("nan"))


def _one_pole(f, G, std, alike, centre: float) -> PoleFit:
    """One pole pair and a complex straight line."""
    s = 2j * np.pi * f
    x = (f - centre) / max(np.ptp(f), 1e-300)
    smooth = np.stack([np.ones_like(x), 1j * np.ones_like(x), x, 1j * x], axis=1).astype(complex)
    magnitude = np.abs(G)
    wide = f[magnitude > magnitude.max() / np.sqrt(2)]
    damping = max(np.ptp(wide), np.min(np.diff(f))) / (2 * centre)
    start = 2 * np.pi * centre * complex(-damping, np.sqrt(max(1 - damping**2, 0.0)))
    floor = np.maximum(std, 1e-6 * magnitude)[:, None]
    return fit_poles(s, G[:, None], floor, np.array([start]), smooth, alike=alike)
