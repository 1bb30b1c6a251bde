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

    Read off the lines there are, without interpolation: good to one line. Noise makes dips deeper and more of them.
    """
    level = 20 * np.log10(np.maximum(np.abs(np.asarray(frf.G)[position, :, out, into]), 1e-300))
    found = []
    for kind, sign in (("resonance", 1.0), ("antiresonance", -1.0)):
        at, about = find_peaks(sign * level, prominence=prominence_db)
        for i, prominence in zip(at, about["prominences"], strict=True):
            found.append(Feature(kind, float(frf.frequency[i]), float(level[i]), float(prominence)))
    return sorted(found, key=lambda x: -x.prominence_db)
