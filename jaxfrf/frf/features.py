"""What one reads off a response: resonances and antiresonances."""

import equinox as eqx
import numpy as np
from scipy.signal import find_peaks

from .response import FRF


class Feature(eqx.Module):
    """An extremum of the magnitude of one element: `kind` is `resonance` or `antiresonance`."""

    kind: str = eqx.field(static=True)
    frequency: float = eqx.field(static=True)
    magnitude_db: float = eqx.field(static=True)
    prominence_db: float = eqx.field(static=True)


def features(frf: FRF, out: int = 0, into: int = 0, *, position: int = 0, prominence_db: float = 6.0) -> list[Feature]:
    """Peaks and dips of |G[out, into]| that stand out by at least `prominence_db`, the most prominent first.

    Read off the lines there are, without interpolation: good to one line. What two standard deviations could have made
    is left out; where the standard deviation is unknown, noise makes more of them.
    """
    magnitude = np.maximum(np.abs(np.asarray(frf.G)[position, :, out, into]), 1e-300)
    level = 20 * np.log10(magnitude)
    doubt = 2 * np.nan_to_num(np.asarray(frf.std)[position, :, out, into]) / magnitude
    certain = {
        "resonance": -20 * np.log10(np.maximum(1 - doubt, 1e-300)),
        "antiresonance": 20 * np.log10(1 + doubt),
    }
    found = []
    for kind, sign in (("resonance", 1.0), ("antiresonance", -1.0)):
        at, about = find_peaks(sign * level, prominence=prominence_db)
        for i, prominence in zip(at, about["prominences"], strict=True):
            if prominence > certain[kind][i]:
                found.append(Feature(kind, float(frf.frequency[i]), float(level[i]), float(prominence)))
    return sorted(found, key=lambda x: -x.prominence_db)
