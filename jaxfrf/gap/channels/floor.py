"""How much of a residual any function of the motion could explain: kernel regression on held-out stretches."""

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

_ROWS = 400  # of the records, that the regression learns from
_WIDTHS = (0.3, 1.0)  # of the kernel, in standard deviations times the root of the number of coordinates
_RIDGES = (0.03, 0.3, 3.0)


def unpredictable(
    residual: Float[np.ndarray, "row axis"], motion: Float[np.ndarray, "row feature"], stretch: Int[np.ndarray, "row"]
) -> Float[np.ndarray, "row axis"]:
    """What is left of the residual where it is predicted from the motion, learned on the other stretches.

    Ridge regression with a Gaussian kernel over standardised features; width and ridge are those with the least
    held-out error, or no prediction at all where none helps. A record that repeats its motion shows what repeats.
    """
    x = (motion - motion.mean(axis=0)) / np.maximum(motion.std(axis=0), 1e-12)
    best, least = residual, np.sum(residual**2)
    for width in _WIDTHS:
        lowest = [np.empty_like(residual) for _ in _RIDGES]
        for held in np.unique(stretch):
            here, other = stretch == held, np.flatnonzero(stretch != held)
            other = other[:: max(len(other) // _ROWS, 1)]
            kernel, ahead = _kernel(x[other], x[other], width), _kernel(x[here], x[other], width)
            for left, ridge in zip(lowest, _RIDGES, strict=True):
                factor = scipy.linalg.cho_factor(kernel + ridge * np.eye(len(kernel)))
                left[here] = residual[here] - ahead @ scipy.linalg.cho_solve(factor, residual[other])
        for left in lowest:
            if np.sum(left**2) < least:
                best, least = left, np.sum(left**2)
    return best


def _kernel(a, b, width: float):
    squared = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * a @ b.T
    return np.exp(-np.maximum(squared, 0.0) / (2 * width**2 * a.shape[1]))
