"""Diagnosis of transmissions by their deflection: motor-side less link-side position against the motor's torque.

    q_m/n - q_a = compliance u + constant + what is missing

For robots with encoders on both sides, on any motion. Every candidate stands for one more term; a physical one has a
sign: friction takes torque away before the gear (negative), hardening, play and hysteresis give way (positive), and a
link-side position that is logged late looks like a deflection of delay times speed.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from ..experiment import Experiment
from ..trajectory.rigid_motion import smooth
from .torque_result import Value
from .torque_score import block_length, covariance, family_wise, numbered, projector, score

_LEAST_DROP = 0.2  # of the remaining power on the run that was not used, that a term must take away
_MOST = 3
_LEVEL = 0.05
_SMOOTHING = 0.02  # of the largest speed, over which friction changes its sign


class DeflectionEffect(eqx.Module):
    """A term that the deflection of one axis calls for.

    **Fields:** `name`, `joint` (axis1, axis2, ...). `value`: its coefficient, refitted on all runs. `p_value`:
    family-wise. `share`: of the remaining power on the runs not used that it took away.
    """

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    value: Value
    p_value: float
    share: float


class DeflectionDiagnosis(eqx.Module):
    """What `diagnose_deflection` found.

    **Fields:**

    - `verdict`: `named` where every axis called for a term, `unexplained` where none did, `ambiguous` in between.
    - `effects`: axis by axis. `compliance`: of every axis, rad (link side) per N m of motor torque, with the effects.
    - `held_out`: name -> (run, axis), rms of what is left of the deflection of the run that was *not* used over the rms
      of that deflection, both about the mean; for the spring alone (`linear spring`), with every candidate by itself
      (whatever the sign of its coefficient), and with all effects (`named`).
    - `wrong_sign`: candidates whose coefficient has a sign that no such effect can have, name -> (axis,).
    - `remarks`: sentences.
    """

    verdict: str = eqx.field(static=True)
    effects: tuple[DeflectionEffect, ...]
    compliance: tuple[Value, ...]
    held_out: dict[str, Float[np.ndarray, "run axis"]]
    wrong_sign: dict[str, np.ndarray]
    remarks: tuple[str, ...] = eqx.field(static=True)


def diagnose_deflection(
    data: Sequence[Experiment], *, cutoff: float = 10.0, draws: int = 999, seed: int = 0
) -> DeflectionDiagnosis:
    """What the deflection of transmissions holds beside a linear spring, axis by axis.

    All terms go through the same low-pass without phase; a term is taken where its coefficient has the sign that it
    must have, its family-wise p-value is below 5 %, and the error falls on every run that the fit did not use, by a
    fifth of its power at least. It fails where motor torque at the cut-off goes into the motor's own inertia.

    **Arguments:** `data`: two or more runs; u: motor torques, y: motor-side positions (as link-side angles, rad), then
    link-side positions, twice as many channels as u. `cutoff`: Hz.

    **Raises:** `jaxfrf.InputError` for a single run, and for other channels.
    """
    runs = [x for record in data for x in _runs(record)]
    if len(runs) < 2:
        raise input_error("runs", f"{len(runs)}", "two or more, to judge on one that was not used", "Name more files.")
    n_axes = runs[0][0].shape[1]
    thin = [
        [_columns(u[:, i], motor[:, i], link[:, i], fs, cutoff) for u, motor, link, fs in runs] for i in range(n_axes)
    ]
    found = [_axis(f"axis{i + 1}", x, draws, seed) for i, x in enumerate(thin)]
    names = found[0].held_out
    held_out = {name: np.stack([x.held_out[name] for x in found], axis=1) for name in names}
    effects = tuple(e for x in found for e in x.effects)
    named = [bool(x.effects) for x in found]
    return DeflectionDiagnosis(
        verdict="named" if all(named) else "ambiguous" if any(named) else "unexplained",
        effects=effects,
        compliance=tuple(x.compliance for x in found),
        held_out=held_out,
        wrong_sign={name: np.array([x.wrong_sign[name] for x in found]) for name in _TERMS},
        remarks=_remarks(effects, held_out, found),
    )


class _Term(eqx.Module):
    """`column(u, motor, link, speed, acceleration)`; `sign` of its coefficient: 1, -1 or 0 (either);
    `crossing`: it shows only where the torque changes its sign."""

    column: Callable = eqx.field(static=True)
    sign: int = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    crossing: bool = eqx.field(static=True, default=False)


def _play(u, half: float):
    """Play operator: follows u once it has moved by `half` its standard deviation the other way."""
    width, out = half * u.std(), np.empty_like(u)
    out[0] = u[0]
    for i in range(1, len(u)):
        out[i] = min(max(out[i - 1], u[i] - width), u[i] + width)
    return out


def _sliding(v):
    return np.tanh(v / (_SMOOTHING * np.abs(v).max()))


_TERMS = {
    "sensor_delay": _Term(lambda u, m, l, v, a: v, 1, "s"),
    "viscous_friction": _Term(lambda u, m, l, v, a: v, -1, "s"),
    "coulomb_friction": _Term(lambda u, m, l, v, a: _sliding(v), -1, "rad"),
    "load_dependent_friction": _Term(lambda u, m, l, v, a: np.abs(u) * _sliding(v), -1, "rad/(N m)"),
    "motor_inertia": _Term(lambda u, m, l, v, a: a, -1, "s^2"),
    "stiffness_hardening": _Term(lambda u, m, l, v, a: np.tanh(u / u.std()), 1, "rad", True),
    "backlash": _Term(lambda u, m, l, v, a: np.tanh(u / (0.05 * u.std())), 1, "rad", True),
    "gear_hysteresis": _Term(lambda u, m, l, v, a: _play(u, 0.5), 1, "rad/(N m)"),
    "gear_ratio": _Term(lambda u, m, l, v, a: m, 0, "1"),
    "link_encoder_cosine": _Term(lambda u, m, l, v, a: np.cos(l), 0, "rad"),
    "link_encoder_sine": _Term(lambda u, m, l, v, a: np.sin(l), 0, "rad"),
}


def _runs(data: Experiment):
    if data.n_out != 2 * data.n_in:
        raise input_error(
            "y of the records",
            f"{data.n_out} channels for {data.n_in} torques",
            f"{2 * data.n_in}: the positions of all motors, then those of all links",
            'Stack them: --map "y=[motor;link]".',
        )
    if data.y_quantity != "position":
        raise input_error("y_quantity", data.y_quantity, "position", "Set it: --set y_quantity=position.")
    for pos in range(data.n_pos):
        for exp in range(data.n_exp):
            y = data.y[pos, exp]
            yield data.u[pos, exp], y[:, : data.n_in], y[:, data.n_in :], data.fs


class _Run(eqx.Module):
    """One axis in one run, thinned: the deflection, the torque as `base`, and every candidate's column."""

    deflection: np.ndarray
    base: np.ndarray
    terms: dict[str, np.ndarray]


def _columns(u, motor, link, fs: float, cutoff: float) -> _Run:
    low = lambda x: smooth(x, fs, cutoff)
    end, step = int(np.ceil(2.0 * fs / cutoff)), max(int(0.4 * fs / cutoff), 1)
    # About the mean of the run: the encoders' zero may be another one in every run.
    thin = lambda x: (lambda y: y - y.mean())(low(x)[end : len(x) - end : step])
    m = low(motor)
    v = np.gradient(m, 1.0 / fs)
    a, quiet = np.gradient(v, 1.0 / fs), low(u)
    terms = {name: _told(thin(t.column(quiet, m, low(link), v, a)), t, quiet) for name, t in _TERMS.items()}
    return _Run(thin(motor - link), thin(u)[:, None], terms)


def _told(x, term: _Term, u):
    """A column, or zero where the run does not show it: play and hardening need a torque that changes its sign."""
    crosses = u.min() < 0.0 < u.max()
    return x if crosses or not term.crossing else np.zeros_like(x)


class _Axis(eqx.Module):
    effects: tuple[DeflectionEffect, ...]
    compliance: Value
    held_out: dict[str, np.ndarray]
    wrong_sign: dict[str, bool]


def _axis(joint: str, runs: list[_Run], draws: int, seed: int) -> _Axis:
    squares = lambda names: np.array([_left(runs, k, names) for k in range(len(runs))])
    spread = np.array([np.var(x.deflection) for x in runs])
    held_out = {"linear spring": squares(()), **{name: squares((name,)) for name in _TERMS}}
    signs = {name: _solved(runs, (name,))[-1] for name in _TERMS}
    chosen: list[tuple[str, float, float]] = []
    for step in range(_MOST):
        names, before = tuple(x[0] for x in chosen), squares(tuple(x[0] for x in chosen))
        p = _p_values(runs, names, draws, seed + step)
        best = None
        for name in (n for n in _TERMS if n not in names):
            if p[name] > _LEVEL or not _sensible(runs, (*names, name)):
                continue
            after = squares((*names, name))
            share = 1.0 - np.mean(after / spread) / np.mean(before / spread)
            if np.all(after < before) and share >= _LEAST_DROP and (best is None or share > best[2]):
                best = (name, p[name], float(share))
        if best is None:
            break
        chosen.append(best)
    names = tuple(x[0] for x in chosen)
    theta, std = _coefficients(runs, names)
    effects = tuple(
        DeflectionEffect(name, joint, Value(float(theta[1 + i]), float(std[1 + i]), _TERMS[name].unit), p, share)
        for i, (name, p, share) in enumerate(chosen)
    )
    held_out["named"] = squares(names)
    wrong = {name: bool(t.sign and np.sign(signs[name]) != t.sign) for name, t in _TERMS.items()}
    return _Axis(
        effects,
        Value(float(theta[0]), float(std[0]), "rad/(N m)"),
        {name: np.sqrt(x / spread) for name, x in held_out.items()},
        wrong,
    )


def _matrix(run: _Run, names) -> np.ndarray:
    return np.concatenate([run.base, *(run.terms[n][:, None] for n in names)], axis=1)


def _solved(runs: Sequence[_Run], names):
    X = np.concatenate([_matrix(x, names) for x in runs])
    size = np.linalg.norm(X, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.linalg.lstsq(X / size, np.concatenate([x.deflection for x in runs]), rcond=1e-10)[0] / size


def _left(runs: list[_Run], held: int, names) -> float:
    """Mean square left on one run by the fit to the others."""
    theta = _solved([x for k, x in enumerate(runs) if k != held], names)
    return float(np.var(runs[held].deflection - _matrix(runs[held], names) @ theta))


def _sensible(runs: list[_Run], names) -> bool:
    """Whether all coefficients have their sign, whichever run is left out."""
    sign = np.array([_TERMS[n].sign for n in names])
    for held in range(len(runs)):
        theta = _solved([x for k, x in enumerate(runs) if k != held], names)[1:]
        if np.any(sign * np.sign(theta) < 0):
            return False
    return True


def _blocks(runs: list[_Run], r):
    lengths = [len(x.deflection) for x in runs]
    parts = np.split(r[:, None], np.cumsum(lengths)[:-1])
    return numbered(lengths, block_length(parts), 1)


def _p_values(runs: list[_Run], names, draws: int, seed: int) -> dict[str, float]:
    X = np.concatenate([_matrix(x, names) for x in runs])
    project = projector(X)
    r = project(np.concatenate([x.deflection for x in runs]))
    block = _blocks(runs, r)
    every = {n: np.concatenate([x.terms[n] for x in runs])[:, None] for n in _TERMS}
    scores = [score(r, column, project, block) for column in every.values()]
    return dict(zip(every, map(float, family_wise(scores, draws, seed)), strict=True))


def _coefficients(runs: list[_Run], names):
    theta = _solved(runs, names)
    X = np.concatenate([_matrix(x, names) for x in runs])
    r = np.concatenate([x.deflection for x in runs]) - X @ theta
    return theta, np.sqrt(np.diag(covariance(r, X, _blocks(runs, r))))


def _remarks(effects, held_out, found: list[_Axis]) -> tuple[str, ...]:
    span = lambda x: f"{x.min():.0%} to {x.max():.0%}"
    said = [
        f"a linear spring leaves {span(held_out['linear spring'])} of the deflection on runs that were not used, the "
        f"named terms {span(held_out['named'])}."
    ]
    late = [e.value for e in effects if e.name == "sensor_delay"]
    if late:
        values = np.array([x.value for x in late])
        said.append(
            f"the link-side position is {1e3 * values.min():.2g} to {1e3 * values.max():.2g} ms late on {len(late)} "
            "axes: a delay of the log (or of the encoder), no property of the gears. Correct the time stamps first."
        )
    if any(x.wrong_sign["coulomb_friction"] for x in found):
        said.append(
            f"tanh of speed alone leaves {span(held_out['coulomb_friction'])}, but with a sign that adds torque in the "
            "direction of motion: it stands in for something else and is not friction."
        )
    return tuple(said)
