"""Nothing known exactly: machines drawn around a robot, calibrated whole, and by springs and dampers alone.

Records are made by jaxfrf's own simulator, whose equations the calibration has too: what is measured here is what not
knowing the numbers costs, not what other physics would. `benchmarks/bench_calibration.py` asks that, with MuJoCo.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from ..calibration import Calibration, Number, calibrate, numbers
from ..effects import AbstractEffect
from ..excitation import Multisine, SlowSine
from ..experiment import Experiment
from ..graybox import Fit, RobotModel, fit_indirectly
from ..robot import Robot, Tolerances, parameters, r3x, r3x_ripple, with_parameters
from ..simulation import random_positions, simulate
from . import hidden
from .bias import first_experiments
from .parameters import candidates, fit_positions
from .settings import PAPER, SLOW_AMPLITUDE, Settings, design

OFF = {
    "stiffness": 0.2,
    "stiffness_ratio": 0.2,
    "stiffness_knee": 0.2,
    "damping": 0.4,
    "coulomb_friction": 0.3,
    "viscous_friction": 0.3,
    "motor_inertia": 0.03,
    "mass": 0.05,
    "com": 0.05,
    "inertia": 0.05,
}
"""How far, at most and evenly, every number of a machine is from its model's, relative. The calibration is told the
defaults of `jaxfrf.robot.tolerances`, not these."""
MEASURED = {
    "stiffness": "stiffness",
    "damping": "damping",
    "coulomb_friction": "Coulomb friction",
    "last_mass": "mass of the last link",
}
"""What errors are told of, with words for it; the last link of R3X holds its payload."""
SMALL_POSITIONS = 5  # of the small robot
_DRAW = 9  # beside the seed, of the random numbers of a machine


class Trial(eqx.Module):
    """What is known of a robot, and how it is measured: `robot`, `ripple` of its motors, `plan`, arm angles `q` (rad),
    position `noise` (rad), `run_in` (s)."""

    robot: Robot
    ripple: tuple[AbstractEffect, ...]
    plan: Multisine
    q: np.ndarray
    noise: float
    run_in: float


def trial(settings: Settings, seed: int) -> Trial:
    """R3X at the paper's seven fit positions, or, where the study is small, the robot of the hidden effect."""
    if settings.uncertain_robot == "R3X":
        slow = SlowSine([5, 7, 9, 11, 13, 15], SLOW_AMPLITUDE)
        rms = np.asarray(design(1, seed).rms)
        plan = Multisine(2000.0, 16000, np.arange(33, 641, 2), rms=rms, slow=slow, seed=seed)
        return Trial(r3x(), r3x_ripple(), plan, candidates(PAPER)[list(fit_positions(PAPER))], 5e-5, 2.0)
    q = random_positions(SMALL_POSITIONS, jr.key(settings.position_seed), 2)
    # Its file's tolerances are those of the machine with the hidden effect; here the defaults hold.
    robot = dataclasses.replace(hidden.model(), tolerances=Tolerances())
    return Trial(robot, hidden.ripple(), hidden.plan(seed), np.asarray(q), hidden.NOISE, hidden.RUN_IN)


def drawn(robot: Robot, seed: int) -> Robot:
    """A machine: every number off by up to `OFF`, evenly, from `numpy.random.default_rng([seed, 9])`."""
    rng = np.random.default_rng([seed, _DRAW])
    own: dict[str, jax.Array | float] = {}
    linear = {n.rpartition(".")[0] for n, r in parameters(robot, ["stiffness_ratio"]).items() if float(r) == 1.0}
    for kind, most in OFF.items():
        for name, value in parameters(robot, [kind]).items():
            if kind.startswith("stiffness_") and name.rpartition(".")[0] in linear:
                continue
            size = (3,) if kind == "com" else ()  # a tensor is scaled as a whole, so that it stays one
            own[name] = jnp.asarray(value) * (1.0 + rng.uniform(-most, most, size))
    return with_parameters(robot, own)


def uncertain_record(given: Trial, machine: Robot, seed: int) -> Experiment:
    """What a machine gives at every position; noise from `seed`."""
    own = machine.with_effects(*given.ripple)
    return simulate(own, given.plan, given.q, key=jr.key(3000 + seed), noise=given.noise, run_in=given.run_in, chunk=6)


def uncertain_row(settings: Settings, seed: int, count: int, say=None) -> dict:
    """One machine, from so many experiments at every position: all of its numbers by `jaxfrf.calibrate`, and, unless
    the study leaves it out, springs and dampers by `jaxfrf.fit_indirectly`, which takes all else as exact."""
    given = trial(settings, seed)
    machine = drawn(given.robot, seed)
    data = first_experiments(uncertain_record(given, machine, seed), count)
    whole = calibrate(given.robot, data, say=say)
    alone = _springs(settings, seed, given, data, say) if settings.springs_alone else None
    true = {number.name: number.given for number in numbers(machine)}
    return {
        "robot": given.robot.name,
        "seed": seed,
        "experiments": count,
        "positions": data.n_pos,
        "period_s": data.period / data.fs,
        "numbers": [_number(n, true[n.name], whole, alone) for n in whole.numbers],
        "torque_missed": {"before": whole.missed_before.tolist(), "after": whole.missed_after.tolist()},
        "converged": whole.converged,
    }


def _springs(settings: Settings, seed: int, given: Trial, data: Experiment, say) -> Fit:
    slow = given.plan.slow
    model = RobotModel(given.robot, slow_amplitude=None if slow is None else np.asarray(slow.amplitude))
    return fit_indirectly(model, data, starts=settings.starts, key=jr.key(seed), rounds=settings.rounds, say=say).fit


def _number(number: Number, true: float, whole: Calibration, alone: Fit | None) -> dict:
    """One number, as it is, as it was given, and as both fits say."""
    springs, found = None if alone is None else alone.interval().get(number.name), None
    if alone is not None and springs is not None:
        found = _found(float(alone.values[number.name]), springs, true)
    return {
        "name": number.name,
        "kind": number.kind,
        "unit": number.unit,
        "true": true,
        "given": number.given,
        "whole": _found(whole.values[number.name], whole.interval(number.name), true),
        "determined_by": whole.determined_by(number.name),
        "springs": found,
    }


def _found(value: float, interval: tuple[float, float], true: float) -> dict:
    low, high = interval
    return {"value": value, "low": low, "high": high, "holds": bool(low <= true <= high)}


def compared(rows: list[dict]) -> list[dict]:
    """For every number of experiments: errors by kind, as given and by both fits, medians and ranges over the machines;
    and how many 95 % intervals hold."""
    found = []
    for count in dict.fromkeys(row["experiments"] for row in rows):
        these = [row for row in rows if row["experiments"] == count]
        every = [n for row in these for n in row["numbers"]]
        determined = [n["whole"]["holds"] for n in every if n["determined_by"] == "data" and n["kind"] != "smoothing"]
        springs = [n["springs"]["holds"] for n in every if n["springs"] is not None]
        found.append(
            {
                "robot": these[0]["robot"],
                "experiments": count,
                "machines": len(these),
                "positions": these[0]["positions"],
                "period_s": these[0]["period_s"],
                "errors": {kind: _errors(kind, these) for kind in MEASURED},
                "intervals": {
                    "whole": {"hold": sum(determined), "of": len(determined)},
                    "springs": {"hold": sum(springs), "of": len(springs)},
                },
            }
        )
    return found


def _errors(kind: str, rows: list[dict]) -> dict:
    """Of one kind of number: what -> mean over the machine's numbers, its median and range over the machines, and the
    largest of all; `None` for a fit that takes these numbers as exact."""
    members = [_members(kind, row["numbers"]) for row in rows]
    error = lambda found, n: abs(found / n["true"] - 1.0)
    by = {
        "given": [[error(n["given"], n) for n in these] for these in members],
        "springs": [[error(n["springs"]["value"], n) for n in these if n["springs"] is not None] for these in members],
        "whole": [[error(n["whole"]["value"], n) for n in these] for these in members],
    }
    return {what: _spread(errors) if any(errors) else None for what, errors in by.items()}


def _members(kind: str, these: list[dict]) -> list[dict]:
    if kind == "last_mass":
        return [n for n in these if n["kind"] == "mass"][-1:]
    return [n for n in these if n["kind"] == kind]


def _spread(errors: list[list[float]]) -> dict:
    means = [float(np.mean(e)) for e in errors]
    worst = max(x for e in errors for x in e)
    return {"median": float(np.median(means)), "least": min(means), "largest": max(means), "worst": worst}
