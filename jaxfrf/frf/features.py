"""What one reads off a response: resonances and antiresonances."""

import equinox as eqx
import numpy as np
from scipy.signal import find_peaks

from .response import FRF

_TURN = np.pi / 4  # least phase across an extremum, between the lines where 3 dB of it are gone


class Feature(eqx.Module):
    """An extremum of the magnitude of one element: `kind` is `resonance` or `antiresonance`."""

    kind: str = eqx.field(static=True)
    frequency: float = eqx.field(static=True)
    magnitude_db: float = eqx.field(static=True)
    prominence_db: float = eqx.field(static=True)


def features(frf: FRF, out: int = 0, into: int = 0, *, position: int = 0, prominence_db: float = 6.0) -> list[Feature]:
    """Peaks and dips of |G[out, into]| that stand out by at least `prominence_db`, the most prominent first.

    Read off the lines there are, without interpolation: good to one line. What two standard deviations could have made
    is left out; where the standard deviation is unknown, noise makes more of them. A pole or zero pair turns the phase
    by 90 degrees within its 3 dB band; a valley between two slopes, as where no zero lies between two resonances, does
    not, and is left out too.
    """
    G = np.asarray(frf.G)[position, :, out, into]
    magnitude = np.maximum(np.abs(G), 1e-300)
    level = 20 * np.log10(magnitude)
    doubt = 2 * np.nan_to_num(np.asarray(frf.std)[position, :, out, into]) / magnitude
    higher, lower = 20 * np.log10(1 + doubt), -20 * np.log10(np.maximum(1 - doubt, 1e-300))
    found = []
    for kind, sign, of_peak, of_base in (("resonance", 1.0, lower, higher), ("antiresonance", -1.0, higher, lower)):
        peaks, about = find_peaks(sign * level, prominence=prominence_db)
        bases = zip(about["left_bases"], about["right_bases"], strict=True)
        for i, prominence, ends in zip(peaks, about["prominences"], bases, strict=True):
            base = max(ends, key=lambda k: sign * level[k])
            if prominence > of_peak[i] + of_base[base] and _turn(G, sign * level, i) > _TURN:
                found.append(Feature(kind, float(frf.frequency[i]), float(level[i]), float(prominence)))
    return sorted(found, key=lambda x: -x.prominence_db)


def _turn(G, level, at: int) -> float:
    """Phase between the nearest lines on both sides of a peak where the level is 3 dB lower (or the ends), rad."""
    gone = level < level[at] - 3.0
    left, right = np.flatnonzero(gone[:at]), np.flatnonzero(gone[at:])
    first = left[-1] if left.size else 0
    last = at + right[0] if right.size else len(level) - 1
    return abs(np.angle(G[last] * G[first].conj()))
