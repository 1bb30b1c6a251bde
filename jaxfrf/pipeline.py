"""From spectra to an FRF as the command line does it: keep what is finished, summarise."""

import time

import equinox as eqx
import numpy as np

from ._errors import InputError
from ._status import describe
from .frf import FRF, AbstractMethod, concatenate_positions, describe_method, estimate
from .frf.features import features
from .parts import Parts, files_text, numbers_text
from .spectra import Spectra, select_positions

_PART_FILES = ("[0-9]" * 5 + ".npz",)


def estimate_in_parts(spectra: Spectra, method: AbstractMethod, parts: Parts, *, say=None) -> FRF:
    """`jaxfrf.estimate`, operating point by operating point, each kept in `parts`.

    Operating points that an interrupted run left there are not estimated again. `say` is called with a line of text now
    and then.

    **Raises:** `jaxfrf.InputError` as `jaxfrf.estimate` does; nothing is kept then: it would again.
    """
    from .io import read_frf, write_frf

    method.check(spectra)
    parts.begin(_about(spectra, method), _PART_FILES)
    if spectra.n_pos == 1:
        return estimate(spectra, method)
    start, last, found = time.monotonic(), 0.0, []
    for pos in range(spectra.n_pos):
        name = f"{pos:05d}.npz"
        frf = parts.read(name, read_frf)
        if frf is None:
            frf = _estimated(select_positions(spectra, [pos]), method, parts)
            write_frf(parts.path(name), frf)
        found.append(frf)
        spent = time.monotonic() - start
        if say is not None and spent - last > 5:
            last = spent
            say(f"{pos + 1} of {spectra.n_pos} operating points, {spent * (spectra.n_pos / (pos + 1) - 1):.0f} s left")
    return concatenate_positions(found)


def _estimated(spectra: Spectra, method: AbstractMethod, parts: Parts) -> FRF:
    try:
        return estimate(spectra, method)
    except InputError:
        parts.discard()
        raise


def _about(spectra: Spectra, method: AbstractMethod) -> dict:
    """What the estimate and everything that is stored with it depend on."""
    f = spectra.frequency
    return {
        "method": describe_method(method),
        "data": files_text(spectra.sources),
        "output": spectra.y_quantity,
        "periods": spectra.n_periods,
        "lines": f"{len(f)} from {f[0]:.6g} to {f[-1]:.6g} Hz",
        "positions": spectra.n_pos,
        "numbers of the data": numbers_text(spectra.U, spectra.Y, spectra.R, f, spectra.q),
    }


class Summary(eqx.Module):
    """What a person wants to know first of an estimate."""

    spectra: Spectra
    frf: FRF

    def as_dict(self) -> dict:
        """For `--json`: plain numbers and texts."""
        frf = self.frf
        return {
            "method": frf.method,
            "positions": frf.n_pos,
            "experiments": self.spectra.n_exp,
            "periods": self.spectra.n_periods,
            "lines": len(frf.frequency),
            "band_hz": [float(frf.frequency[0]), float(frf.frequency[-1])],
            "median_relative_std": _finite(_relative_std(frf)),
            "median_window": float(np.median(frf.window)),
            "effective_independent_lines": float(np.median(np.sum(1 / frf.window, axis=1))),
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

    def lines(self) -> list[str]:
        """For a person."""
        about = self.as_dict()
        frf = self.frf
        text = [
            f"{frf.n_out} x {frf.n_in} FRF at {about['positions']} operating point(s), {about['lines']} lines from "
            f"{about['band_hz'][0]:.4g} to {about['band_hz'][1]:.4g} Hz, from {about['experiments']} experiment(s) of "
            f"{about['periods']} period(s)",
            f"method: {about['method']}",
        ]
        if about["median_relative_std"] is None:
            text.append("standard deviation: unknown (no residual degree of freedom)")
        else:
            text.append(
                f"standard deviation: {100 * about['median_relative_std']:.2g} % of |G| (median of the diagonal); "
                f"about {about['effective_independent_lines']:.0f} independent lines"
            )
        for i, j in _elements(frf):
            found = features(frf, i, j)
            for kind in ("antiresonance", "resonance"):
                at = sorted([x for x in found if x.kind == kind][:4], key=lambda x: x.frequency)
                if at:
                    text.append(f"G{i + 1}{j + 1}: {kind} at {', '.join(_at(x) for x in at)}")
        return text + [f"note: {x}" for x in about["status"]]


def _at(feature) -> str:
    """Frequency and damping with their 95 % intervals."""
    text = f"{feature.frequency:.5g} +- {1.96 * feature.frequency_std:.1g} Hz"
    if not np.isfinite(feature.damping):
        return text
    return f"{text} (damping {100 * feature.damping:.2g} +- {196 * feature.damping_std:.1g} %)"


def summary(spectra: Spectra, frf: FRF) -> Summary:
    """What was estimated, in a form to print."""
    return Summary(spectra, frf)


def _elements(frf: FRF):
    return [(i, i) for i in range(min(frf.n_out, frf.n_in))]


def _relative_std(frf: FRF) -> float:
    n = range(min(frf.n_out, frf.n_in))
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.asarray(frf.std)[..., n, n] / np.abs(np.asarray(frf.G)[..., n, n])
    return float(np.nanmedian(relative)) if np.isfinite(relative).any() else np.nan


def _finite(x: float) -> float | None:
    return x if np.isfinite(x) else None
