"""Whether a measured position moves in whole counts."""

import numpy as np

from ..settings import COUNT_CLEAR, COUNT_FINEST, COUNT_FIRST, COUNT_JUMP

_SAMPLES = 40000


def resolution(position: np.ndarray, noise: float) -> float:
    """Count of an encoder, rad, from its readings (run, time); 0 where none is seen.

    The increments of quantised readings are whole counts q: |mean exp(2 pi j increment/q)| is near one. `noise`:
    standard deviation of what is added behind the encoder, rad; counts below five times that are not found.
    """
    increments = np.diff(position, axis=1).ravel()
    increments = increments[:: max(1, len(increments) // _SAMPLES)]
    if not increments.size or not np.isfinite(increments).all():
        return 0.0
    size = np.abs(increments)
    increments = increments[size <= COUNT_JUMP * np.median(size[size > 0])] if np.any(size) else increments
    spread = float(np.std(increments))
    if spread == 0.0:
        return 0.0
    widest = 1.2 / spread  # counts per rad from which on a smooth distribution has no characteristic function left
    finest = 1.0 / (COUNT_FINEST * noise) if noise > 0 else 200.0 * widest
    step = 1.0 / (8.0 * np.max(np.abs(increments)))
    if finest <= widest:
        return 0.0
    tried = np.arange(widest, finest, step)
    level = _levels(increments, tried[0], step, len(tried))
    if level.max() < COUNT_CLEAR:
        return 0.0
    first = int(np.argmax(level > COUNT_FIRST * level.max()))
    while first + 1 < len(level) and level[first + 1] > level[first]:
        first += 1
    fine = tried[first] + np.linspace(-step, step, 41)
    finer = [np.abs(np.mean(np.exp(2j * np.pi * f * increments))) for f in fine]
    return float(1.0 / fine[int(np.argmax(finer))])


def _levels(increments, first: float, step: float, count: int) -> np.ndarray:
    """|mean exp(2 pi j f increment)| at f = first, first + step, ...; each from the one before by one product."""
    now, turn = (np.exp(2j * np.pi * f * increments) for f in (first, step))
    level = np.empty(count)
    for i in range(count):
        level[i] = np.abs(now.mean())
        now *= turn
    return level
