"""Corrections that are made until they converge: what was tried, what came of it, and where to try next."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .fit import Fit
from .parameter import Coordinates

_STAY = 0.1  # of a standard deviation: a correction below it changes nothing that matters
_STILL = 2e-5  # relative: nor does one below this
_DEPTH = 3  # corrections that the next one learns from
_LONGEST = 0.7  # of one correction, in x
_WORSE = 1.05  # times the smallest gap: then it turns back


class Correction(eqx.Module):
    """One round of a fit that is corrected by what its own result would have measured.

    **Fields:** `x`: parameters that were simulated. `update`: parameters that the corrected fit gave, which are `x`
    where it has come to rest. `gap_db`, `gap_deg`: weighted rms difference of measured and simulated FRF, in magnitude
    and phase; 0 where nothing was simulated.
    """

    x: Float[np.ndarray, "parameter"]
    update: Float[np.ndarray, "parameter"]
    gap_db: float
    gap_deg: float


def updated(coordinates: Coordinates, fitted: Fit) -> np.ndarray:
    """x of a fit in these coordinates; a parameter that it found without effect is where it was left."""
    same = fitted.coordinates.names == coordinates.names
    return np.asarray(fitted.x) if same else coordinates.coordinates(fitted.values)


def settled(correction: Correction, coordinates: Coordinates, fitted: Fit) -> np.ndarray:
    """Whether each parameter moved by less than a part of its standard deviation, (parameter,)."""
    known = dict(zip(fitted.coordinates.names, fitted.uncertainty.std, strict=True))
    std = np.array([known.get(name, np.inf) for name in coordinates.names])
    moved = np.abs(correction.update - correction.x)
    return (moved < _STAY * std) | (moved < _STILL)


def next_point(history: list[Correction], coordinates: Coordinates, latest: Fit) -> np.ndarray:
    """Where to simulate next: Anderson's mixture of the last answers, or half a step from the best round so far."""
    best = min(history, key=lambda c: c.gap_db)
    last = history[-1]
    if last.gap_db > _WORSE * best.gap_db:
        return best.x + 0.5 * _limited(best.update - best.x)
    recent = history[-_DEPTH:]
    f = np.stack([c.update - c.x for c in recent])
    if len(recent) == 1:
        return last.x + _limited(f[-1])
    # Residuals count by what the data know of them: along loose directions they are mostly noise.
    information = np.eye(f.shape[1])
    if latest.coordinates.names == coordinates.names:
        information = np.asarray(latest.uncertainty.information) + 1e-12 * information
    root = np.linalg.cholesky(information).T
    change = np.diff(f, axis=0)
    shares = np.linalg.lstsq((change @ root.T).T, root @ f[-1], rcond=1e-8)[0]
    steps = np.diff(np.stack([c.x for c in recent]), axis=0)
    return last.x + _limited(f[-1] - shares @ (steps + change))


def _limited(step: np.ndarray) -> np.ndarray:
    return step * min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-300))
