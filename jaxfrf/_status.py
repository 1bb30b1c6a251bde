"""What an estimator says of every single frequency."""

import enum


class Status(enum.IntFlag):
    """Bits of `FRF.status`, one integer per operating point and frequency; 0 is a plain good estimate.

    The first three and `NOISE_ONLY` are remarks; of the others the estimate should be looked at before it is used.

    - `EDGE_WINDOW`, 1: the window is not centred on the line: it stands at an end of the band.
    - `REFINED`, 2: the fast solver's pivots were too small; solved again by an orthogonal factorisation.
    - `NO_COVARIANCE`, 4: no residual degree of freedom is left: `cov` is NaN.
    - `RANK_DEFICIENT`, 8: the regressor has not full rank: the estimate is the minimum-norm one.
    - `LOW_EXCITATION`, 16: an input (or reference) carries almost no power here.
    - `LOG_BRANCH`, 32: the matrix logarithm is not safe: an eigenvalue left the right half-plane, or V is ill
      conditioned.
    - `NOT_FINITE`, 64: the estimate is NaN or infinite.
    - `NOISE_ONLY`, 128: `cov` is the noise between periods: nothing is left over to show nonlinear distortion.
    """

    OK = 0
    EDGE_WINDOW = 1
    REFINED = 2
    NO_COVARIANCE = 4
    RANK_DEFICIENT = 8
    LOW_EXCITATION = 16
    LOG_BRANCH = 32
    NOT_FINITE = 64
    NOISE_ONLY = 128


SERIOUS = Status.RANK_DEFICIENT | Status.LOW_EXCITATION | Status.LOG_BRANCH | Status.NOT_FINITE
"""What is told of an estimate, and left out of pictures."""

ADVICE: dict[Status, str] = {
    Status.EDGE_WINDOW: "window not centred (an end of the band): more bias than inside",
    Status.REFINED: "solved again by an orthogonal factorisation (nearly collinear window): nothing to do",
    Status.NO_COVARIANCE: "no residual left for a covariance: widen the window, or add experiments or periods",
    Status.NOISE_ONLY: "the standard deviation is that of the noise between periods; distortion and what repeats with "
    "the period are not in it: see jaxfrf distortion, or add experiments",
    Status.RANK_DEFICIENT: "the regressor lost rank: widen the window, lower the order, or excite independently",
    Status.LOW_EXCITATION: "an input carries almost no power here: excite these lines, or leave them out",
    Status.LOG_BRANCH: "the matrix logarithm is unsafe here: compare with the arithmetic or stacked estimate",
    Status.NOT_FINITE: "the estimate is not finite here: the regressor is singular",
}


def describe(status) -> list[str]:
    """One sentence per flag that occurs in `status` (any integer array): how many frequencies, and what to do."""
    import numpy as np

    status = np.asarray(status)
    if not status.any():
        return []
    return [
        f"{int(np.count_nonzero(status & flag))} of {status.size} estimates: {text}"
        for flag, text in ADVICE.items()
        if np.any(status & flag)
    ]
