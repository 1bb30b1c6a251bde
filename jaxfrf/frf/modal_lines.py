"""The lines of an FRF that modes are fitted to: deviations, background, and what errors have in common."""

from typing import NamedTuple

import numpy as np
import scipy.ndimage
from jaxtyping import Complex, Float

from .._arguments import as_band, expect_index
from .._errors import input_error
from ..experiment import QUANTITIES
from .overlap import Overlap, overlaps
from .poles import PoleFit, fit_poles
from .response import FRF
from .scatter import scatter

_SCATTER = 10  # degrees of freedom behind a deviation that weighs a line
_EVEN = 11  # lines, over which weights are alike in a search
_BLOCK = 2_000_000  # entries of covariances that are looked at together


class Lines(NamedTuple):
    """An FRF at the lines that are fitted. `s`: rad/s. `measured`: whether `std` was, or comes from the scatter of G.
    `background`: see `modal`. `overlap`: of windows."""

    s: Complex[np.ndarray, "freq"]
    G: Complex[np.ndarray, "freq out in"]
    std: Float[np.ndarray, "freq out in"]
    measured: bool
    background: Float[np.ndarray, "freq term"]
    overlap: Overlap | None
    errors: "ElementErrors | None"

    @property
    def frequency(self) -> Float[np.ndarray, "freq"]:
        return self.s.imag / (2 * np.pi)

    def fit(self, poles, delay: float | None) -> PoleFit:
        g = self.G.reshape(len(self.s), -1)
        alike = () if self.overlap is None else (self.overlap,)
        return fit_poles(
            self.s,
            g,
            self.std.reshape(g.shape),
            poles,
            self.background,
            alike=alike,
            delay=delay,
            errors=self.errors,
            measured=self.measured,
        )

    def evenly_weighed(self) -> "Lines":
        """For a search: deviations that come from the scatter of G as means over some lines. Noise that grows with |G|
        gives a peak itself so little weight that a fit from afar passes it by."""
        if self.measured:
            return self
        variance = scipy.ndimage.uniform_filter1d(self.std**2, _EVEN, axis=0, mode="reflect")
        return self._replace(std=np.sqrt(variance))

    def at(self, some) -> "Lines":
        errors, overlap = self.errors and self.errors.at(some), self.overlap and self.overlap.at(some)
        return Lines(self.s[some], self.G[some], self.std[some], self.measured, self.background[some], overlap, errors)


def chosen_lines(frf: FRF, position: int, band) -> Lines:
    expect_index("position", position, frf.n_pos)
    low, high = (0.0, np.inf) if band is None else as_band(band)
    frequency, G = np.asarray(frf.frequency, float), np.asarray(frf.G)[position]
    std = np.asarray(frf.std)[position]
    wanted = (frequency >= low) & (frequency <= high) & (frequency > 0) & np.isfinite(G).all(axis=(1, 2))
    if wanted.sum() < 12:
        raise input_error(
            "lines", f"{int(wanted.sum())} in the band", "12 or more with a finite response", "Widen the band."
        )
    frequency, G, std = frequency[wanted], G[wanted], std[wanted]
    of_lines = overlaps(np.asarray(frf.window, float)[[position]])
    overlap = None if of_lines is None else of_lines[0].at(np.flatnonzero(wanted))
    level = np.sqrt(np.mean(np.abs(G) ** 2, axis=0))
    s = 2j * np.pi * frequency
    background = background_of(s, frf.y_quantity)
    measured = bool(np.isfinite(std).all() and (std > 0).all())
    std = _steady(std, np.asarray(frf.dof, float)[position][wanted]) if measured else scatter(frequency, G)
    # Below a thousandth of the element's level a standard deviation says more of the noise than of the model.
    floored = np.maximum(std, 1e-4 * np.maximum(np.abs(G), 1e-2 * level))
    errors = ElementErrors(frf, position, np.flatnonzero(wanted), std.reshape(len(std), -1)) if measured else None
    return Lines(s, G, floored, measured, background, overlap, errors)


def _steady(std, dof) -> Float[np.ndarray, "freq out in"]:
    """Deviations over as many lines as make `_SCATTER` degrees of freedom: one of few is now and then next to nothing,
    and its line would outweigh all others."""
    lines = int(min(np.ceil(_SCATTER / max(float(np.median(dof)), 1.0)), len(std)))
    return np.sqrt(scipy.ndimage.uniform_filter1d(std**2, lines, axis=0, mode="reflect")) if lines > 1 else std


class ElementErrors:
    """Errors of the elements of an FRF at some lines, with what is common to them: noise of an input shows in all
    outputs. `std`: what stands for their deviations where they are smoothed."""

    def __init__(self, frf: FRF, position: int, lines, std: Float[np.ndarray, "freq element"]):
        self.frf, self.position, self.lines, self.std = frf, position, lines, std

    def at(self, chosen) -> "ElementErrors":
        return ElementErrors(self.frf, self.position, self.lines[chosen], self.std[chosen])

    def __call__(self, columns, deviations):
        """As `Errors`. Where deviations are larger than those of the FRF, what is more is each element's own."""
        n_out, n_in = self.frf.n_out, self.frf.n_in
        vec = np.arange(n_out * n_in).reshape(n_in, n_out).T.ravel()  # of the elements, row by row
        cov, total = self.frf.cov[self.position], np.zeros((columns.shape[-1],) * 2)
        size = max(1, _BLOCK // len(vec) ** 2)
        for first in range(0, len(self.lines), size):
            some = slice(first, first + size)
            C = np.asarray(cov[self.lines[some]])[:, vec[:, None], vec]
            own = np.maximum(deviations[some] ** 2 - self.std[some] ** 2, 0.0)
            C = C + own[:, :, None] * np.eye(len(vec))
            w = columns[:, some] / deviations[some].T[..., None]
            total += np.einsum("efp,feg,gfq->pq", w.conj(), C, w, optimize=True).real
        return total


def background_of(s: np.ndarray, quantity: str) -> Float[np.ndarray, "freq term"]:
    q = QUANTITIES[quantity]
    middle = np.exp(np.mean(np.log(np.abs(s))))
    return np.stack([(s / middle) ** n * middle**n for n in (q - 2, q - 1, q)], axis=1)
