"""Diagnosis of a single drive by its FRF: what a rigid inertia of unknown torque constant lacks.

    G = (gain/s) s^m,  and with effects
    G = gain/(s + friction) (1 + 2 z_a s/w_a + s^2/w_a^2)/(1 + 2 z_r s/w_r + s^2/w_r^2) e^{-s delay}/(1 + s lag) s^m

The gain (torque constant over inertia) is free throughout, so that neither a wrong torque constant nor a wrong inertia
can be taken for an effect, nor be found. A missing mode, flexible coupling and load, is one antiresonance and one
resonance. Speed: m = 0, position: -1, acceleration: 1.
"""

import itertools

import equinox as eqx
import numpy as np
import scipy.optimize
import scipy.stats
from jaxtyping import Complex, Float

from .._errors import input_error
from ..experiment import QUANTITIES
from ..frf import FRF
from .torque_result import Ranked, Value

_FLOOR = 0.03  # relative error of an FRF that no model is asked to beat
_FOLDS = 5  # of interleaved lines
_BLOCKS = 24  # of neighbouring lines, that signs are flipped together in
_BANDS = 10
_LEAST_DROP = 0.2
_LEVEL = 0.05

_GROUPS = {
    "extra_flexibility": {
        "antiresonance": "Hz",
        "resonance": "Hz",
        "antiresonance_damping": "1",
        "resonance_damping": "1",
    },
    "viscous_friction": {"friction": "1/s"},
    "torque_delay": {"delay": "s"},
    "current_loop_lag": {"time_constant": "s"},
}
_ONE_WITH_THE_GAIN = ("motor_inertia", "torque_constant")
_SEPARATES = {
    ("torque_delay", "current_loop_lag"): "lines above 300 Hz, or a step of torque",
    ("viscous_friction", "current_loop_lag"): "lines at lower frequencies",
}


class DriveEffect(eqx.Module):
    """An effect that the FRF calls for: `parameters` refitted with all others, `share` of the reducible gap that it
    took away on held-out lines, `equivalent` effects and what would separate them."""

    name: str = eqx.field(static=True)
    parameters: dict[str, Value]
    p_value: float
    share: float
    equivalent: tuple[str, ...] = eqx.field(static=True)
    separating_experiment: str = eqx.field(static=True)


class BandError(eqx.Module):
    """Error of the base model in a band: `level` in dB and `phase` in degrees on average, `z`: rms over its error."""

    low: float
    high: float
    level: float
    phase: float
    z: float
    says: str = eqx.field(static=True)


class DriveDiagnosis(eqx.Module):
    """What `diagnose_drive` found.

    **Fields:** `verdict`: `sufficient`, `named`, `ambiguous`, `unexplained` or `inconclusive`. `effects`: in the order
    in which they were found. `ranking`: at the first step, `score` the share of the error's power that a full fit takes
    away. `where`: the base model's error by bands, worst first. `gap`: rms |log(measured/model)| `before`, `after` and
    `floor` (noise), on the sealed FRF or on held-out lines (`on`). `parameters`: of the whole model.
    """

    verdict: str = eqx.field(static=True)
    effects: tuple[DriveEffect, ...]
    ranking: tuple[Ranked, ...]
    where: tuple[BandError, ...]
    gap: dict[str, float]
    on: str = eqx.field(static=True)
    parameters: dict[str, Value]
    y_quantity: str = eqx.field(static=True)

    def response(self, frequency: Float[np.ndarray, "freq"]) -> Complex[np.ndarray, "freq"]:
        """G of the model with its effects, `frequency` in Hz."""
        values = {name: x.value for name, x in self.parameters.items()}
        return _response(values, np.asarray(frequency), QUANTITIES[self.y_quantity] - 1)


def diagnose_drive(
    frf: FRF, sealed: FRF | None = None, *, most: int = 4, draws: int = 999, seed: int = 0
) -> DriveDiagnosis:
    """Which effects a rigid drive lacks, from its FRF: real and imaginary part of log(measured/model) are fitted.

    Candidates are a flexible coupling, viscous friction, a delay and a lag, each fitted in full beside what has been
    found (a mode from several starts). One is taken where the error on held-out lines falls with a family-wise p-value
    below 5 % (sign flips over blocks of neighbouring lines) and by a fifth of what noise leaves to explain.

    It fails where nonlinear distortion is as large as the effect: FRFs of other realisations, as `sealed`, show it.

    **Arguments:** `frf`: one input, one output, one position; `sealed`: another record's, opened once.

    **Raises:** `jaxfrf.InputError` for other FRFs.
    """
    data = _lines(frf)
    order = QUANTITIES[frf.y_quantity] - 1
    base = _fit(data, (), order, None)
    chosen, found, ranking, now, last_p = (), [], (), base, 1.0
    for step in range(most + 1):
        trials = _trials(data, chosen, order, now, draws, seed + step)
        if step == 0:
            ranking = _ranking(trials)
        last_p = min((t.p_value for t in trials), default=1.0)
        good = [t for t in trials if t.accepted]
        if not good or step == most:
            break
        best, equivalent, level = _simplest(good)
        found.append((best, equivalent, level))
        chosen, now = (*chosen, best.name), best.values
    parameters = _with_std(data, now, order)
    target = data if sealed is None else _lines(sealed)
    gap = {name: _rms(_error(values, target, order)) for name, values in (("before", base), ("after", now))}
    gap["floor"] = float(np.sqrt(np.mean(target.variance)))
    gap["shrink"] = 1.0 - (gap["after"] - gap["floor"]) / max(gap["before"] - gap["floor"], 1e-12)
    effects = tuple(
        DriveEffect(
            t.name, {n: parameters[n] for n in _GROUPS[t.name]}, t.p_value, t.share, others, _separating(t, others)
        )
        for t, others, _ in found
    )
    return DriveDiagnosis(
        verdict=_verdict(found, gap, last_p),
        effects=effects,
        ranking=ranking,
        where=_bands(data, base, order),
        gap=gap,
        on="fitted lines" if sealed is None else "sealed record",
        parameters=parameters,
        y_quantity=frf.y_quantity,
    )


class _Lines(eqx.Module):
    frequency: Float[np.ndarray, "freq"]
    G: Complex[np.ndarray, "freq"]
    variance: Float[np.ndarray, "freq"]  # of log G

    @property
    def weight(self):
        return 1.0 / np.sqrt(_FLOOR**2 + self.variance)


def _lines(frf: FRF) -> _Lines:
    if (frf.n_pos, frf.n_out, frf.n_in) != (1, 1, 1):
        raise input_error(
            "frf",
            f"{frf.n_pos} positions of {frf.n_out} x {frf.n_in}",
            "one position of one drive",
            "Pick one channel, or diagnose the robot as a whole.",
        )
    G = np.asarray(frf.G)[0, :, 0, 0]
    variance = np.nan_to_num(np.asarray(frf.std)[0, :, 0, 0] ** 2 / np.abs(G) ** 2)
    return _Lines(np.asarray(frf.frequency), G, variance)


def _response(v: dict[str, float], f, order: int):
    s = 2j * np.pi * f
    G = v["gain"] / (s + v.get("friction", 0.0)) * s**order
    if "resonance" in v:
        G = (
            G
            * _pair(s, v["antiresonance"], v["antiresonance_damping"])
            / _pair(s, v["resonance"], v["resonance_damping"])
        )
    return G * np.exp(-s * v.get("delay", 0.0)) / (1.0 + s * v.get("time_constant", 0.0))


def _pair(s, frequency, damping):
    w = 2.0 * np.pi * frequency
    return 1.0 + 2.0 * damping * s / w + (s / w) ** 2


def _error(values, data: _Lines, order: int):
    return np.log(data.G / _response(values, data.frequency, order))


def _rms(error) -> float:
    return float(np.sqrt(np.mean(np.abs(error) ** 2)))


def _starts(name: str, f) -> list[dict[str, float]]:
    middle = 2.0 * np.pi * np.sqrt(f[0] * f[-1])
    if name == "viscous_friction":
        return [{"friction": 0.1 * middle}]
    if name != "extra_flexibility":
        return [{key: 0.1 / middle} for key in _GROUPS[name]]
    grid = np.geomspace(1.3 * f[0], 0.8 * f[-1], 7)
    damping = {"antiresonance_damping": 0.03, "resonance_damping": 0.03}
    return [{"antiresonance": float(x), "resonance": 1.3 * float(x), **damping} for x in grid]


def _fit(data: _Lines, names, order: int, start: dict[str, float] | None, held=None) -> dict[str, float]:
    """All values by least squares of E in logarithms of the values, from the start and every start of the last name."""
    use = np.ones(len(data.G), bool) if held is None else ~held
    part = _Lines(data.frequency[use], data.G[use], data.variance[use])
    if start is None:
        start = {"gain": float(np.median(np.abs(part.G * (2j * np.pi * part.frequency) ** (1 - order))))}
    fresh = bool(names) and next(iter(_GROUPS[names[-1]])) not in start
    best, least = start, np.inf
    for more in _starts(names[-1], part.frequency) if fresh else [{}]:
        values, cost = _descended(part, {**start, **more}, order)
        if cost < least:
            best, least = values, cost
    return best


def _descended(data: _Lines, start: dict[str, float], order: int):
    keys = list(start)

    def residual(x):
        e = _error(dict(zip(keys, np.exp(x), strict=True)), data, order) * data.weight
        return np.concatenate([e.real, e.imag])

    x0 = np.log([start[k] for k in keys])
    found = scipy.optimize.least_squares(residual, x0, bounds=(x0 - 8.0, x0 + 8.0), max_nfev=200)
    return dict(zip(keys, map(float, np.exp(found.x)), strict=True)), found.cost


class _Trial(eqx.Module):
    name: str
    values: dict[str, float]
    before: np.ndarray  # weighted squared error of every line, held out
    after: np.ndarray
    p_value: float
    share: float
    explained: float

    @property
    def accepted(self) -> bool:
        return self.p_value <= _LEVEL and self.share >= _LEAST_DROP


def _held_out(data: _Lines, names, order: int, values) -> np.ndarray:
    """Weighted squared error of every line by the fit to the lines of other folds."""
    squared, fold = np.empty(len(data.G)), np.arange(len(data.G)) % _FOLDS
    for k in range(_FOLDS):
        there = _fit(data, names, order, values, fold == k)
        squared[fold == k] = (np.abs(_error(there, data, order) * data.weight) ** 2)[fold == k]
    return squared


def _trials(data: _Lines, chosen, order: int, now, draws: int, seed: int) -> list[_Trial]:
    before = _held_out(data, chosen, order, now)
    noise = np.mean(data.variance * data.weight**2)
    reducible = max(np.mean(before) - noise, 1e-300)
    power = np.mean(np.abs(_error(now, data, order) * data.weight) ** 2)
    found = []
    for name in (n for n in _GROUPS if n not in chosen):
        values = _fit(data, (*chosen, name), order, now)
        after = _held_out(data, (*chosen, name), order, values)
        left = np.mean(np.abs(_error(values, data, order) * data.weight) ** 2)
        found.append((name, values, after, float(1.0 - left / power)))
    p = _p_values([before - after for _, _, after, _ in found], draws, seed)
    return [
        _Trial(name, values, before, after, float(q), float((before - after).mean() / reducible), explained)
        for (name, values, after, explained), q in zip(found, p, strict=True)
    ]


def _p_values(drops: list[np.ndarray], draws: int, seed: int) -> np.ndarray:
    """Family-wise: the drop of whole blocks of neighbouring lines, its sign flipped, against the largest of all."""
    if not drops:
        return np.ones(0)
    sums = np.array([[x.sum() for x in np.array_split(d, _BLOCKS)] for d in drops])
    size = np.sqrt(np.sum(sums**2, axis=1)) + 1e-300
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (draws, sums.shape[1]))
    largest = np.max(signs @ (sums / size[:, None]).T, axis=1)
    return np.array([(1 + np.sum(largest >= t)) / (draws + 1) for t in sums.sum(axis=1) / size])


def _simplest(good: list[_Trial]):
    best = min(good, key=lambda t: t.after.mean())

    def close(t):
        worse = np.array([x.sum() for x in np.array_split(t.after - best.after, _BLOCKS)])
        return worse.mean() <= worse.std(ddof=1) / np.sqrt(len(worse))

    level = [t for t in good if t is best or close(t)]
    chosen = min(level, key=lambda t: (len(_GROUPS[t.name]), t.after.mean()))
    others = tuple(t.name for t in level if t is not chosen)
    return chosen, others, any(len(_GROUPS[n]) <= len(_GROUPS[chosen.name]) for n in others)


def _separating(trial: _Trial, others) -> str:
    pairs = ((trial.name, o) for o in others)
    told = [_SEPARATES.get(p) or _SEPARATES.get(p[::-1]) or "another band" for p in pairs]
    return "; ".join(dict.fromkeys(told))


def _ranking(trials: list[_Trial]) -> tuple[Ranked, ...]:
    ranked = [Ranked(t.name, "", t.explained, t.p_value) for t in sorted(trials, key=lambda t: -t.explained)]
    return (*ranked, *(Ranked(name, "", 0.0, 1.0) for name in _ONE_WITH_THE_GAIN))


def _with_std(data: _Lines, values: dict[str, float], order: int) -> dict[str, Value]:
    """Standard deviations by the slopes of E, with the misfit of blocks of lines for colour."""
    keys, x0 = list(values), np.log(list(values.values()))
    at = lambda x: _error(dict(zip(keys, np.exp(x), strict=True)), data, order) * data.weight
    now = at(x0)
    S = np.stack([(at(x0 + 1e-6 * e) - now) / 1e-6 for e in np.eye(len(keys))], axis=1)
    bread = np.linalg.pinv(np.real(S.conj().T @ S), rcond=1e-12)
    g = np.array(
        [np.real(s.conj().T @ r) for s, r in zip(np.array_split(S, _BLOCKS), np.array_split(now, _BLOCKS), strict=True)]
    )
    std = np.sqrt(np.diag(bread @ (g.T @ g) @ bread))
    units = {"gain": "rad/s^2 per unit of u", **{k: u for group in _GROUPS.values() for k, u in group.items()}}
    return {k: Value(values[k], float(values[k] * s), units[k]) for k, s in zip(keys, std, strict=True)}


def _bands(data: _Lines, base, order: int) -> tuple[BandError, ...]:
    error, found = _error(base, data, order), []
    edges = np.geomspace(data.frequency[0], data.frequency[-1] * (1 + 1e-9), _BANDS + 1)
    for low, high in itertools.pairwise(edges):
        here = (data.frequency >= low) & (data.frequency < high)
        if not here.any():
            continue
        z = float(np.sqrt(np.mean(np.abs(error[here] * data.weight[here]) ** 2)))
        mean = error[here].mean()
        level, phase = 20 / np.log(10) * mean.real, float(np.rad2deg(mean.imag))
        says = f"{low:.3g} to {high:.3g} Hz: the measured response differs by {level:+.1f} dB and {phase:+.0f} degrees."
        found.append(BandError(float(low), float(high), float(level), phase, z, says))
    return tuple(sorted(found, key=lambda b: -b.z))


def _verdict(found, gap: dict[str, float], last_p: float) -> str:
    if found:
        if gap["before"] ** 2 - gap["after"] ** 2 < 0.5 * (gap["before"] ** 2 - gap["floor"] ** 2):
            return "unexplained"
        return "ambiguous" if any(level for _, _, level in found) else "named"
    # .5 dB and 4 degrees together
    if gap["after"] < np.hypot(0.5 * np.log(10) / 20, np.deg2rad(4.0)) and last_p > _LEVEL:
        return "sufficient"
    return "unexplained" if gap["after"] > 3.0 * max(gap["floor"], _FLOOR) else "inconclusive"
