"""What a drive's linear model leaves at unexcited lines: odd and even levels by band, and whether friction explains it.

D = Y - G U at detection lines,  D = -G level DFT{shape of the law along the measured motion}  if it is the cause
"""

import itertools
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from ..experiment import QUANTITIES, Experiment
from ..spectra import dft, unexcited_spectra
from .coupling import DriveDiagnosis

_CLEAR = 10.0  # dB above the noise, from which distortion is worth a sentence
_CLEARLY = 6.0  # dB between odd and even lines
_ENOUGH = 0.5  # of the distortion on lines that the fit did not see


class DistortionBand(eqx.Module):
    """Levels of D in a band, dB re one unit of y (rms of the Fourier coefficients); `raw_odd`, `raw_even`: of Y itself;
    `noise`: of the mean period. NaN where the band has no such line."""

    low: float
    high: float
    odd: float
    even: float
    raw_odd: float
    raw_even: float
    noise: float


class DistortionDiagnosis(eqx.Module):
    """What `diagnose_distortion` found.

    **Fields:** `verdict`: `sufficient` (no distortion above the noise), `named` or `unexplained`. `bands`: the map.
    `explained`: law -> share of the power of D, in the bands with clear distortion, that it explains on lines which its
    fit did not see. `levels`: fitted level of every law, in units of u. `says`: sentences.
    """

    verdict: str = eqx.field(static=True)
    bands: tuple[DistortionBand, ...]
    explained: dict[str, float]
    levels: dict[str, float]
    says: tuple[str, ...] = eqx.field(static=True)


def diagnose_distortion(
    data: Experiment,
    drive: DriveDiagnosis,
    edges: Float[np.ndarray, "edge"] | tuple[float, ...] = (11, 40, 60, 90, 250),
) -> DistortionDiagnosis:
    """The distortion that a drive's linear model leaves, as a map, and laws of friction tried on it.

    Laws act along the measured speed with what the model says of the sensor taken off; each has one level, fitted at
    every other detection line and judged at the rest. Hysteretic laws (presliding, as of rolling bearings) are tried in
    the same way though the library has none on the motor's side.

    It fails where the excitation leaves no lines free, and for laws whose effect on the excited lines is large.

    **Arguments:** `data`: periodic, one input, one output, detection lines in the band. `drive`: fitted on the same
    quantity y. `edges`: of the bands, Hz.

    **Raises:** `jaxfrf.InputError` where no line is unexcited, or there are more channels.
    """
    if (data.n_pos, data.n_in, data.n_out) != (1, 1, 1):
        raise input_error("record", f"{data.n_in} inputs, {data.n_out} outputs", "one drive", "Pick its channels.")
    edges = np.asarray(edges, float)
    rest = unexcited_spectra(data, (float(edges[0]), float(edges[-1])))
    f, U, Y = rest.frequency, np.mean(rest.U[0], axis=0)[:, 0], np.mean(rest.Y[0], axis=0)[:, 0]
    G = drive.response(f)
    D = Y - G * U
    noise = np.full(len(f), np.nan) if rest.noise is None else np.mean(rest.noise[0, :, :, 0, 0].real, axis=0)
    bands = tuple(_band(f, rest.lines, (D, Y), noise, *pair) for pair in itertools.pairwise(edges))
    clear = np.zeros(len(f), bool)
    for band in bands:
        if np.nanmax([band.odd, band.even]) > band.noise + _CLEAR:
            clear |= (f >= band.low) & (f < band.high)
    if not clear.any():
        return DistortionDiagnosis("sufficient", bands, {}, {}, ("no distortion stands 10 dB above the noise.",))
    explained, levels = {}, {}
    motion = _motion(data, drive)
    for name, law in _LAWS.items():
        shape = _at_lines(law(*motion), rest.lines)
        explained[name], levels[name] = _tried(D[clear], -G[clear] * shape[clear])
    best = max(explained, key=explained.get)
    verdict = "named" if explained[best] >= _ENOUGH and levels[best] > 0 else "unexplained"
    return DistortionDiagnosis(verdict, bands, explained, levels, _said(bands, best, explained[best], verdict))


def _band(f, lines, spectra, noise, low: float, high: float) -> DistortionBand:
    here = (f >= low) & (f < high)
    level = lambda power: float(10 * np.log10(np.mean(power))) if len(power) else float("nan")
    levels = [level(np.abs(X[here & (lines % 2 == k)]) ** 2) for X in spectra for k in (1, 0)]
    return DistortionBand(float(low), float(high), *levels, level(noise[here]))


def _motion(data: Experiment, drive: DriveDiagnosis):
    """Position and speed of the mean steady period, (sample,), the model's delay and lag taken off; up to the highest
    excited line's third harmonic, where noise does not rule yet."""
    steady = np.asarray(data.y)[0, :, data.transient_periods * data.period :, 0]
    period = steady.reshape(-1, data.period).mean(axis=0)
    top = min(3 * int(dft(data).lines[-1]), data.period // 2)
    s = 2j * np.pi * np.arange(top + 1) * data.fs / data.period
    late = {k: drive.parameters[k].value if k in drive.parameters else 0.0 for k in ("delay", "time_constant")}
    Y = np.fft.rfft(period)[: top + 1] * (1.0 + s * late["time_constant"]) * np.exp(s * late["delay"])
    order = QUANTITIES[data.y_quantity]
    Y[0] = 0.0
    s[0] = 1.0
    back = lambda X: np.fft.irfft(np.pad(X, (0, data.period // 2 - top)), data.period)
    return back(Y * s ** (0 - order)), back(Y * s ** (1 - order))


def _slider(width: float) -> Callable:
    """Stop operator: an elastic slider (Prandtl element) that yields after `width` rms positions."""

    def law(position, speed):
        most, force, before = width * position.std(), 0.0, position[-1]
        out = np.empty_like(position)
        for _ in range(2):
            for i, x in enumerate(position):
                force = min(max(force + x - before, -most), most)
                before, out[i] = x, force
        return out / most

    return law


_LAWS: dict[str, Callable] = {
    "coulomb_friction": lambda x, v: np.tanh(v / (0.05 * v.std())),
    "coulomb_friction, smooth": lambda x, v: np.tanh(v / (0.3 * v.std())),
    "stribeck_friction": lambda x, v: np.exp(-((v / (0.3 * v.std())) ** 2)) * np.tanh(v / (0.05 * v.std())),
    "quadratic friction": lambda x, v: v * np.abs(v) / np.var(v),
    "friction that differs by direction": lambda x, v: np.abs(v) / v.std(),
    "presliding .1": _slider(0.1),
    "presliding .5": _slider(0.5),
}


def _at_lines(signal, lines):
    return (np.fft.rfft(signal) / len(signal))[lines]


def _tried(D, column) -> tuple[float, float]:
    """Share of the power of D explained on lines held out in turn, and the level fitted on all."""
    fitted = lambda use: np.real(np.vdot(column[use], D[use])) / np.sum(np.abs(column[use]) ** 2)
    left, turn = 0.0, np.arange(len(D)) % 2
    for k in (0, 1):
        left += np.sum(np.abs(D[turn == k] - fitted(turn != k) * column[turn == k]) ** 2)
    return float(1.0 - left / np.sum(np.abs(D) ** 2)), float(fitted(turn >= 0))


def _said(bands, best: str, share: float, verdict: str) -> tuple[str, ...]:
    said = []
    for b in bands:
        if np.nanmax([b.odd, b.even]) > b.noise + _CLEAR:
            kind = _kind(b.raw_odd - b.raw_even)
            said.append(
                f"{b.low:g} to {b.high:g} Hz: distortion, {kind}: odd lines {b.raw_odd:.0f} dB, "
                f"even {b.raw_even:.0f} dB (without the reaction of u {b.odd:.0f} and {b.even:.0f}), "
                f"noise {b.noise:.0f} dB."
            )
    end = "" if verdict == "named" else ": none of the laws tried explains half of it, nothing is named"
    return (*said, f"best law: {best}, {max(share, 0.0):.0%} of the distortion{end}.")


def _kind(odd_over_even: float) -> str:
    if odd_over_even > _CLEARLY:
        return "odd, as friction makes it"
    return "even" if odd_over_even < -_CLEARLY else "odd and even"
