"""From a record to an FRF file in one go, as the command line does it: choose the spectra, resume, summarise."""

import dataclasses
import hashlib
import pathlib
import shutil
import time

import equinox as eqx
import numpy as np

from . import __version__
from ._errors import InputError, input_error
from ._status import describe
from .experiment import Experiment, select_periods
from .frf import FRF, AbstractMethod, concatenate_positions, describe_method, estimate
from .frf.features import features
from .spectra import Spectra, dft, record_spectra, select_band, select_positions

_RUN = "run-"  # begins the name of the file that says which run the finished parts belong to


def spectra_of(data: Experiment, method: AbstractMethod, *, periods=None, band=None) -> Spectra:
    """The spectra that `method` needs: of steady periods, or of the whole record if it is not periodic and the method
    has a transient term. `periods` (from, to) and `band` (low, high, Hz) choose a part; `None` at an end: open.
    """
    if periods is not None:
        data = select_periods(data, periods[0] or 0, periods[1])
    if not data.period and _takes_transients(method):
        low, high = band or (None, None)
        whole = None if band is None else (low or 0.0, high or data.fs / 2)
        return record_spectra(data, whole)
    spectra = dft(data)
    return spectra if band is None else select_band(spectra, band[0] or 0.0, band[1] or data.fs / 2)


def _takes_transients(method: AbstractMethod) -> bool:
    inner = [getattr(method, f.name) for f in dataclasses.fields(method)]
    return getattr(method, "transient", None) is not None or any(
        _takes_transients(x) for x in inner if isinstance(x, AbstractMethod)
    )


def estimate_resumable(spectra: Spectra, method: AbstractMethod, output, *, resume: bool = False, say=None) -> FRF:
    """`jaxfrf.estimate`, operating point by operating point, each kept in a folder beside `output` until all are done.

    With `resume`, operating points found there from the same data and method are not estimated again.
    `say` is called with a line of text now and then.
    """
    from .io import read_frf, write_frf

    method.check(spectra)
    if spectra.n_pos == 1:
        return estimate(spectra, method)
    folder = folder_of_parts(output, _fingerprint(spectra, method), resume)
    start, last, parts = time.monotonic(), 0.0, []
    for pos in range(spectra.n_pos):
        path = folder / f"{pos:05d}.npz"
        if not path.exists():
            try:
                write_frf(path, estimate(select_positions(spectra, [pos]), method))
            except InputError:
                shutil.rmtree(folder)
                raise
        parts.append(read_frf(path))
        spent = time.monotonic() - start
        if say is not None and spent - last > 5:
            last = spent
            say(f"{pos + 1} of {spectra.n_pos} operating points, {spent * (spectra.n_pos / (pos + 1) - 1):.0f} s left")
    frf = concatenate_positions(parts)
    shutil.rmtree(folder)
    return frf


def folder_of_parts(output, key: str, resume: bool) -> pathlib.Path:
    """The folder for finished operating points: as an interrupted run of this `key` left it, or empty."""
    folder = pathlib.Path(f"{output}.parts")
    if folder.exists() and not any(folder.glob(f"{_RUN}*")):
        raise input_error(str(folder), "files of someone else", "the parts of an earlier run, or nothing", "Rename it.")
    if folder.exists() and not (resume and (folder / key).exists()):
        shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    (folder / key).touch()
    return folder


def _fingerprint(spectra: Spectra, method: AbstractMethod) -> str:
    """What the estimate and everything that is stored with it depend on."""
    about = (describe_method(method), __version__, spectra.y_quantity, spectra.n_periods, spectra.sources)
    digest = hashlib.sha256(repr(about).encode())
    for x in (spectra.U, spectra.Y, spectra.R, spectra.frequency, spectra.q):
        if x is not None:
            digest.update(np.ascontiguousarray(x).tobytes())
    return f"{_RUN}{digest.hexdigest()[:16]}"


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
                at = sorted(x.frequency for x in [x for x in found if x.kind == kind][:4])
                if at:
                    text.append(f"G{i + 1}{j + 1}: {kind} at {', '.join(f'{f:.4g}' for f in at)} Hz")
        return text + [f"note: {x}" for x in about["status"]]


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
