"""Welch's method: cross spectra averaged over windowed, overlapping segments of a record."""

import dataclasses

import numpy as np
import scipy  # not scipy.signal, which takes a second to import: it loads when a window is asked for

from .._annotated import check_fields
from .._errors import input_error
from ..spectra import Spectra
from .classical import H1
from .covariance import KroneckerSum
from .joint import JointInputOutput
from .method import AbstractMethod, Estimate, Signals, flags

_REACH = 4  # lines that a Hann window reaches over


class Welch(AbstractMethod):
    """G = S_yu S_uu^-1, cross spectra averaged over windowed, overlapping segments (Welch 1967): any long record.

    What `scipy.signal.csd(u, y) / scipy.signal.welch(u)` gives for one input and output, and MATLAB's `tfestimate`; for
    several inputs the matrix version. No period is needed; a periodic record is better served by every other method.
    Biased by leakage, which a window and long segments make smaller: a resonance narrower than about three lines
    (3 fs/segment) comes out too low and too wide, and that is *not* in the covariance. Biased low by noise in u, in
    closed loop by the noise that is fed back; with `use_reference`, G = S_yr S_ur^-1 is free of that.

    The covariance is that of `H1` over segments, which overlap: as if there were K / (1 + 2 sum_m (1 - m/K) rho_m^2) of
    them, rho_m the correlation of the window with itself m segments later (Welch 1967). Neighbouring lines share data;
    `FRF.window` says how many.

    **Arguments:**

    - `segment`: samples in a segment (SciPy's `nperseg`); `None`: as long as eight that overlap by half can be, as in
      MATLAB.
    - `overlap`: share of a segment that the next one repeats. `window`: as `scipy.signal.get_window` names it.
    - `use_reference`: see above.

    **Raises:** `jaxfrf.InputError` for a segment below 8 samples, an overlap outside 0 to 1 or an unknown window; in
    `jaxfrf.estimate` for no more segments than inputs.

    **Source:** Welch, IEEE Trans. Audio and Electroacoustics 15 (1967) 70-73; for several inputs as in Bendat &
    Piersol, Random Data, 4th ed. 2010.
    """

    segment: int | None = None
    overlap: float = 0.5
    window: str = "hann"
    use_reference: bool = False

    def __check_init__(self):
        check_fields(self)
        if self.segment is not None and (self.segment != int(self.segment) or self.segment < 8):
            raise input_error("segment", repr(self.segment), "a whole number of samples, 8 or more", "Give e.g. 4096.")
        if not 0 <= self.overlap < 1:
            raise input_error("overlap", repr(self.overlap), "a share from 0 up to 1", "Give e.g. 0.5.")
        if self.window != "hann":
            _check_window(self.window)

    @property
    def inner(self) -> AbstractMethod:
        return JointInputOutput(H1()) if self.use_reference else H1()

    def block_size(self, spectra: Spectra | Signals) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        if not spectra.segments:
            raise input_error(
                "spectra",
                "the spectra of whole periods, or of a whole record",
                "those of segments",
                "Give the record itself to jaxfrf.estimate, or take jaxfrf.segment_spectra(data).",
            )
        if spectra.n_exp <= spectra.n_in:
            raise input_error(
                "segments",
                f"{spectra.n_exp} of {spectra.period} samples, with {spectra.n_in} inputs",
                f"at least {spectra.n_in + 1}",
                "Shorten them (option segment), or record longer.",
            )
        if self.use_reference:
            self.inner.check(dataclasses.replace(spectra, at_rest=True))

    def residual_dof(self, signals: Signals) -> float:
        return float(signals.n_exp - signals.n_in)

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        found = self.inner.at_point(signals, lines)
        assert isinstance(found.cov, KroneckerSum)
        repeated = 1 / self.independent_share(signals.n_exp)
        dof = np.maximum(signals.n_exp / repeated - signals.n_in, 0.5) + 0 * found.dof
        return dataclasses.replace(
            found,
            cov=KroneckerSum(found.cov.left * repeated, found.cov.right),
            cov_noise=None,
            dof=dof,
            status=found.status & ~flags(NO_COVARIANCE=dof > 0) | _first_lines(signals.U.shape[1], lines),
            window=found.window * self.bandwidth,
        )

    def independent_share(self, n_segments: int) -> float:
        """Independent segments over all segments."""
        n = 1024
        taper = scipy.signal.get_window(self.window, n)
        hop = max(round(n * (1 - self.overlap)), 1)
        apart = np.arange(1, min(-(-n // hop), n_segments))
        rho = np.array([taper[m * hop :] @ taper[: n - m * hop] for m in apart]) / (taper @ taper)
        return float(1 / (1 + 2 * np.sum((1 - apart / n_segments) * rho**2)))

    @property
    def bandwidth(self) -> float:
        """Noise bandwidth of the window, in lines."""
        taper = scipy.signal.get_window(self.window, 1024)
        return float(len(taper) * np.sum(taper**2) / np.sum(taper) ** 2)


def _first_lines(n: int, lines):
    """The window reaches below zero there, and over what the mean of a segment takes away."""
    first = flags(EDGE_WINDOW=np.arange(n) < _REACH)
    return first if lines is None else first[lines]


def _check_window(name: str) -> None:
    try:
        scipy.signal.get_window(name, 8)
    except ValueError:
        raise input_error(
            "window", repr(name), "a window of scipy.signal, e.g. hann", "Choose hann, hamming or boxcar."
        ) from None
