"""What is told of an estimate."""

import dataclasses
import itertools

import equinox as eqx
import numpy as np

from ._status import describe
from ._text import NORMAL_95, counted, number, percent, plus_minus
from .frf import FRF, Distortion
from .frf.features import features
from .spectra import Spectra


class Summary(eqx.Module):
    """What a person wants to know first of an estimate."""

    spectra: Spectra
    frf: FRF

    def as_dict(self) -> dict:
        """For `--json`: plain numbers and texts."""
        frf, at = self.frf, self._excited()
        return {
            "method": frf.method,
            "positions": frf.n_pos,
            "experiments": self.spectra.n_exp,
            "periods": self.spectra.n_periods,
            "lines": len(frf.frequency),
            "band_hz": [float(frf.frequency[0]), float(frf.frequency[-1])],
            "median_relative_std": _finite(_relative_std(frf, at=at)),
            "median_relative_noise": _finite(_relative_std(frf, frf.cov_noise, at=at)),
            "median_relative_total": _finite(_relative_std(frf, frf.cov_total, at=at)),
            "median_relative_bias": _finite(_relative(frf, frf.bias, at=at)),
            "median_band_hz": [float(x) for x in frf.frequency[at][[0, -1]]],
            "median_window": _finite(float(np.median(frf.window))),
            "effective_independent_lines": _finite(float(np.median(np.sum(1 / frf.window, axis=1)))),
            "features": [
                {
                    "element": f"G{i + 1}{j + 1}",
                    "kind": x.kind,
                    "hz": x.frequency,
                    "prominence_db": x.prominence_db,
                    "hz_std": _finite(x.frequency_std),
                    "damping": _finite(x.damping),
                    "damping_std": _finite(x.damping_std),
                }
                for i, j in _elements(frf)
                for x in features(frf, i, j)[:6]
            ],
            "status": describe(frf.status),
            "warnings": list(frf.warnings),
        }

    def _excited(self) -> slice:
        """The lines that medians are of: all; of segments, which go up to half the rate, those that
        99 % of the input's power lies between."""
        power = np.sum(np.abs(np.asarray(self.spectra.U)) ** 2, axis=(0, 1))
        if not self.spectra.segments or len(power) != len(self.frf.frequency):
            return slice(None)
        share = np.mean(np.cumsum(power, axis=0) / np.maximum(np.sum(power, axis=0), 1e-300), axis=-1)
        first, last = np.searchsorted(share, [_EDGE_POWER, 1 - _EDGE_POWER])
        return slice(int(first), int(last) + 1)

    def _data(self) -> str:
        spectra = self.spectra
        if spectra.segments:
            each = spectra.n_exp // spectra.segments
            return f"{counted(each, 'experiment')}, {spectra.segments} segments of {spectra.period} samples each"
        if not spectra.periodic:
            return f"{counted(spectra.n_exp, 'experiment')} without a period, {spectra.period} samples each"
        return f"{counted(spectra.n_exp, 'experiment')} of {counted(spectra.n_periods, 'period')}"

    def lines(self) -> list[str]:
        """For a person."""
        about = self.as_dict()
        frf = self.frf
        text = [
            f"{frf.n_out} x {frf.n_in} FRF at {counted(about['positions'], 'operating point')}, {about['lines']} "
            f"lines from {number(about['band_hz'][0], 4)} to {number(about['band_hz'][1], 4)} Hz, from {self._data()}",
            f"method: {about['method']}",
        ]
        if about["median_relative_std"] is None:
            text.append("standard deviation: unknown (no residual degree of freedom)")
        else:
            low, high = (number(x, 3) for x in about["median_band_hz"])
            where = f", from {low} to {high} Hz, where the input has its power" if self.spectra.segments else ""
            text.append(
                f"standard deviation: {percent(about['median_relative_std'])} of |G| (median of the diagonal{where})"
                f"{_independent(about)}"
            )
            text += _causes(about)
        for i, j in _elements(frf):
            found = features(frf, i, j)
            for kind in ("antiresonance", "resonance"):
                at = sorted([x for x in found if x.kind == kind][:4], key=lambda x: x.frequency)
                if at:
                    text.append(f"G{i + 1}{j + 1}: {kind} at {', '.join(_at(x) for x in at)}")
        return text + [f"note: {x}" for x in about["status"]]


def _independent(about: dict) -> str:
    """How many lines tell something of their own; nothing where that is not known."""
    lines = about["effective_independent_lines"]
    if lines is None:
        return ""
    if round(lines) >= about["lines"]:
        return "; all lines are independent"
    return f"; about {lines:.0f} independent lines, the others share their data"


def _at(feature) -> str:
    """Frequency and damping with their 95 % intervals."""
    text = f"{plus_minus(feature.frequency, NORMAL_95 * feature.frequency_std)} Hz"
    if not np.isfinite(feature.damping):
        return text
    return f"{text} (damping {plus_minus(100 * feature.damping, 100 * NORMAL_95 * feature.damping_std)} %)"


def summary(spectra: Spectra, frf: FRF) -> Summary:
    """What was estimated, in a form to print."""
    return Summary(spectra, frf)


def _elements(frf: FRF):
    return [(i, i) for i in range(min(frf.n_out, frf.n_in))]


_EDGE_POWER = 0.005  # of the input's, below and above the lines that medians are of


def _relative_std(frf: FRF, cov="own", at: slice = slice(None)) -> float:
    """Of the covariance, or of a part of it."""
    if cov is None:
        return np.nan
    return _relative(frf, frf.std if isinstance(cov, str) else dataclasses.replace(frf, cov=cov).std, at)


def _relative(frf: FRF, std, at: slice = slice(None)) -> float:
    if std is None:
        return np.nan
    n = range(min(frf.n_out, frf.n_in))
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.asarray(std)[:, at][..., n, n] / np.abs(np.asarray(frf.G)[:, at][..., n, n])
    return float(np.nanmedian(relative)) if np.isfinite(relative).any() else np.nan


def _causes(about: dict) -> list[str]:
    """What the standard deviation is made of, as far as it is known."""
    parts = (
        ("median_relative_noise", "{} % noise (scatter between periods)"),
        ("median_relative_total", "{} % noise and nonlinear distortion"),
        ("median_relative_bias", "{} % bias of the window (from the pointwise estimate)"),
    )
    told = [text.format(number(100 * about[name], 2)) for name, text in parts if about[name] is not None]
    if not told:
        return []
    known = sum(about[name] ** 2 for name, _ in parts if about[name] is not None)
    rest = known < _ALL**2 * about["median_relative_std"] ** 2
    return [f"in it: {', '.join(told)}{_REST if rest else ''}"]


_ALL = 0.9  # of the standard deviation: what is left is not worth a word
_REST = "; what is left is distortion, disturbances and bias not told apart"


def _finite(x: float) -> float | None:
    return x if np.isfinite(x) else None


class DistortionSummary(eqx.Module):
    """Levels of noise and distortion by octave, in decibels below the output."""

    found: Distortion

    def as_dict(self) -> dict:
        """For `--json`: of every output at the first operating point, band by band."""
        return {
            "way": self.found.way,
            "lines": len(self.found.frf.frequency),
            "unexcited_lines": len(self.found.unexcited),
            "outputs": [self._bands(out) for out in range(self.found.output.shape[2])],
        }

    def _bands(self, out: int) -> list[dict]:
        found, frequency = self.found, np.asarray(self.found.frf.frequency)
        edges = np.append(frequency[0] * 2.0 ** np.arange(np.ceil(np.log2(frequency[-1] / frequency[0])) or 1), np.inf)
        bands = []
        for low, high in itertools.pairwise(edges):
            at = (frequency >= low) & (frequency < high)
            if at.any():
                bands.append(
                    {"band_hz": [float(low), float(min(high, frequency[-1]))]}
                    | {
                        name: _decibels_below(getattr(found, name)[0, at, out], found.output[0, at, out])
                        for name in ("noise", "even", "odd", "total")
                    }
                )
        return bands

    def lines(self) -> list[str]:
        """For a person."""
        about, found = self.as_dict(), self.found
        how = {
            "fast": f"from {about['unexcited_lines']} unexcited lines",
            "robust": "from the scatter between realisations",
            "noise only": "not told: no unexcited lines and no second realisation; noise alone",
        }[found.way]
        text = [f"distortion {how}; decibels relative to the output of one experiment, its mean period"]
        if np.isfinite(found.total).any():
            text.append("total: noise, and the distortion that falls on excited lines")
        if np.isnan(found.total).all() and found.way == "fast":
            text.append(
                "every odd line of the band is excited: distortion of odd order, which falls on them, is not seen; "
                'leave some of them out (grid = "random-odd" of a design, `jaxfrf.random_odd_lines`)'
            )
        for out, bands in enumerate(about["outputs"]):
            for band in bands:
                told = [_level(band, name) for name in ("noise", "even", "odd", "total") if band[name] is not None]
                low, high = band["band_hz"]
                text.append(
                    f"y{out + 1}, {number(low, 4)} to {number(high, 4)} Hz: {', '.join(told) or 'nothing known'}"
                )
        return text

    @property
    def is_clear(self) -> bool:
        """Whether distortion stands above the noise in any band."""
        bands = [band for out in self.as_dict()["outputs"] for band in out]
        return any(
            band[name] is not None and band["noise"] is not None and not _within(band, name)
            for band in bands
            for name in ("even", "odd")
        )


def distortion_summary(found: Distortion) -> DistortionSummary:
    """What was found, in a form to print."""
    return DistortionSummary(found)


_CLEAR = 3.0  # decibels
_NOTHING = 1e-30  # power of rounding, relative to the output's


def _decibels_below(level, output) -> float | None:
    power, whole = np.mean(level**2), np.mean(output**2)
    return float(10 * np.log10(max(power / whole, _NOTHING))) if np.isfinite(power) and whole > 0 else None


def _level(band: dict, name: str) -> str:
    """What is left of a level when the noise is taken off may be chance where it is not clearly more than the noise."""
    if name in ("even", "odd") and _within(band, name):
        return f"{name} within the noise"
    return f"{name} {band[name]:.0f} dB"


def _within(band: dict, name: str) -> bool:
    return band["noise"] is not None and band[name] < band["noise"] + _CLEAR
