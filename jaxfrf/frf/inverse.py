"""Inverses of batches in which single matrices may be singular."""

import numpy as np


def inverse(A) -> np.ndarray:
    """A^-1 of every matrix of a batch (*batch, n, n); NaN for those that are singular or not finite.

    One bad frequency must not stop the others, as `numpy.linalg.inv` would.
    """
    A = np.asarray(A)
    with np.errstate(all="ignore"):
        bad = ~np.isfinite(A).all(axis=(-2, -1)) | (np.linalg.det(A) == 0)
        result = np.linalg.inv(np.where(bad[..., None, None], np.eye(A.shape[-1]), A))
    return np.where(bad[..., None, None], np.nan, result)
