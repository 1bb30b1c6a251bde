"""The estimator that chooses its window from the data."""

import dataclasses

import numpy as np
import scipy.ndimage

from .._errors import input_error
from ..spectra import Spectra
from .joint import JointInputOutput
from .local import LRM, AbstractLocal
from .method import AbstractMethod, Estimate, dense


class Auto(AbstractMethod):
    """Stacked local rational estimate through the reference where there is one, its window chosen at every line.

    From narrow to wide, a window is accepted while its estimate agrees with those of all narrower ones: rms over the
    elements of |G_w - G_v| / (s_w + s_v) at most `threshold`, s the standard deviations (intersection of confidence
    intervals: Goldenshluger & Nemirovski 1997). Wide windows average more noise, and are given up where the response
    bends too much for them. The choice is smoothed over neighbouring lines by a median.

    The covariance is that of the chosen window, as if it had been chosen beforehand; what bias the choice lets through
    is at most about `threshold` standard deviations of a narrower window. The default was tuned on plants with 1, 2
    and 6 axes, 1 to 6 experiments, 2 and 10 % disturbance (`benchmarks/bench_accuracy.py`, which reports on other
    seeds). Nearly constant responses are averaged less widely than they could be.

    **Arguments:**

    - `method`: the local method whose `width` is chosen; default `LRM()`, R = 2.
    - `widths`: windows to choose from, in lines; by default six from the narrowest useful one to a third of the band.
    - `threshold`: see above. `use_reference`: estimate through r where it is recorded.
    """

    method: AbstractLocal = LRM()
    widths: tuple[int, ...] | None = None
    threshold: float = 0.85
    use_reference: bool = True

    def __check_init__(self):
        if self.method.width is not None:
            raise input_error(
                "width",
                f"width={self.method.width} for a method that chooses its windows",
                "no width",
                f"Say which windows to choose from (widths={self.method.width}), or take a method with a fixed one, "
                "e.g. lrm-jio-stacked.",
            )

    def block_size(self, spectra: Spectra) -> int:
        return 1

    def check(self, spectra: Spectra) -> None:
        self._with_width(self.candidates(spectra)[0], spectra).check(spectra)

    def candidates(self, spectra: Spectra) -> tuple[int, ...]:
        """The windows tried, narrowest first."""
        n_lines = len(spectra.lines)
        if self.widths is not None:
            return tuple(sorted({int(w) for w in self.widths}))
        n = self.method.n_parameters(spectra, spectra.n_in, max(spectra.n_out, spectra.n_in))
        least = min(-(-n // spectra.n_exp) + max(4, -(-n // (2 * spectra.n_exp))), n_lines)
        most = max(n_lines // 3, least)
        return tuple(sorted({round(w) for w in np.geomspace(least, most, 6)}))

    def estimate(self, spectra: Spectra) -> Estimate:
        tried = [self._with_width(w, spectra).estimate(spectra) for w in self.candidates(spectra)]
        tried = [dataclasses.replace(x, G=np.asarray(x.G), cov=np.asarray(dense(x.cov))) for x in tried]
        return _chosen(tried, _choice(tried, self.threshold))

    def _with_width(self, width: int, spectra: Spectra) -> AbstractMethod:
        method = dataclasses.replace(self.method, width=width)
        through = self.use_reference and spectra.R is not None and spectra.R.shape[-1] == spectra.n_in
        return JointInputOutput(method) if through else method


def _choice(tried: list[Estimate], threshold: float) -> np.ndarray:
    """Number of the widest window that agrees with all narrower ones, smoothed: (pos, freq)."""
    G = [x.G for x in tried]
    std = [_std(x.cov, x.G.shape) for x in tried]
    agreed = np.ones(G[0].shape[:2], bool)
    choice = np.zeros(G[0].shape[:2], int)
    for wide in range(1, len(tried)):
        for narrow in range(wide):
            step = np.abs(G[wide] - G[narrow]) / (std[wide] + std[narrow])
            with np.errstate(invalid="ignore"):
                agreed &= ~(np.sqrt(np.mean(step**2, axis=(-2, -1))) > threshold)
        choice[agreed] = wide
    span = min(9, choice.shape[1])
    return scipy.ndimage.median_filter(choice, size=(1, span), mode="nearest")


def _chosen(tried: list[Estimate], choice) -> Estimate:
    def pick(name):
        every = [getattr(x, name) for x in tried]
        shape = choice.shape + (1,) * (every[0].ndim - 2)
        return np.choose(choice.reshape(shape), every) if len(every) > 1 else every[0]

    return Estimate(**{name: pick(name) for name in ("G", "cov", "dof", "status", "window")})


def _std(cov, shape) -> np.ndarray:
    variance = np.maximum(np.diagonal(cov, axis1=-2, axis2=-1).real, 0)
    return np.sqrt(variance).reshape(*shape[:2], shape[3], shape[2]).swapaxes(-1, -2)
