"""An effect hidden in a small robot, and what the diagnosis makes of the robot's records.

`machine` and `HIDDEN` are the truth: they make the records and are shown beside what was found, but the search gets
the records and `model` alone.
"""

import importlib.resources
import tomllib

import jax.random as jr
import numpy as np

from .._text import NORMAL_95
from ..effects import CoulombFriction, TorqueRipple
from ..excitation import Multisine, SlowSine
from ..experiment import Experiment
from ..gap import Diagnosis, diagnose
from ..robot import Robot, parameters, robot_from_table, with_parameters
from ..simulation import simulate

HIDDEN = CoulombFriction("shoulder", 0.06)
OFF = {"stiffness": 1.02, "damping": 0.95, "mass": 1.006, "viscous_friction": 1.02}
"""The machine's numbers over those of its model: what a data sheet is off by."""
POSITIONS = np.array([[0.3, 0.9], [-0.5, 1.4], [1.5, -1.1]])  # rad; the last one unloads the shoulder
NOISE = 1e-4  # rad
RUN_IN = 3.0  # s


def model() -> Robot:
    """The robot as its maker states it."""
    text = importlib.resources.files(__package__).joinpath("two_axes.toml").read_text(encoding="utf-8")
    return robot_from_table(tomllib.loads(text), "two_axes.toml")


def machine() -> Robot:
    """The robot as built: other springs, dampers, links and friction than stated, ripple, and the hidden effect."""
    robot = model()
    own = {name: factor * value for kind, factor in OFF.items() for name, value in parameters(robot, [kind]).items()}
    return with_parameters(robot, own).with_effects(*ripple(), HIDDEN)


def ripple() -> tuple[TorqueRipple, ...]:
    """Of the machine's motors."""
    return TorqueRipple("shoulder", [0.01], [6], [0.3]), TorqueRipple("elbow", [0.006], [2], [0.3])


def plan(seed: int = 4) -> Multisine:
    """112 odd lines from 4 to 60 Hz, a period of 4 s, two axes at once, on top of a slow sine."""
    slow = SlowSine([3, 5], [30.0, 30.0])
    return Multisine(1000.0, 4000, np.arange(17, 240, 2), rms=[2.0, 3.0], slow=slow, seed=seed)


def hidden_record(seed: int) -> Experiment:
    """What the machine gives at every position; noise from `seed`."""
    return simulate(machine(), plan(), POSITIONS, key=jr.key(2000 + seed), run_in=RUN_IN, noise=NOISE, chunk=6)


def hidden_row(data: Experiment, say=None) -> tuple[dict, dict[str, np.ndarray]]:
    """What the diagnosis of a record says, beside the truth: plain numbers, and the arrays of the picture."""
    found = diagnose(model(), data, say=say)
    gap = found.gap
    numbers = {
        "robot": model().name,
        "verdict": found.verdict,
        "says": found.says,
        "effects": [_effect(named) for named in found.effects],
        "true": {
            "name": HIDDEN.name,
            "joint": HIDDEN.joint,
            "parameters": {n: getattr(HIDDEN, n) for n in HIDDEN.units},
        },
        "off": OFF,
        "gap": {"before": gap.before, "after": gap.after, "floor": gap.floor, "shrink": gap.shrink, "on": gap.on},
        "torque": {
            name: {"before": float(before), "after": float(after)}
            for name, before, after in zip(model().axis_names, gap.torque_before, gap.torque_after, strict=True)
        },
        "next": [
            {"name": r.name, "joint": r.joint, "explains": r.score, "why": r.why} for r in found.ranking[:_RANKED]
        ],
        "fitted": list(found.fitted),
        "heldout": list(found.heldout),
        "experiments": data.n_exp,
        "period_s": data.period / data.fs,
    }
    return numbers, _courses(found)


_RANKED = 5


def _effect(named) -> dict:
    values = {
        name: {
            "value": x.value,
            "unit": x.unit,
            "std": x.std,
            "low": x.value - NORMAL_95 * x.std,
            "high": x.value + NORMAL_95 * x.std,
        }
        for name, x in named.parameters.items()
    }
    return {
        "name": named.name,
        "joint": named.joint,
        "parameters": values,
        "p_value": named.p_value,
        "equivalent": list(named.equivalent),
    }


def _courses(found: Diagnosis) -> dict[str, np.ndarray]:
    """Mean torque residual against speed, angle and load: name -> (values, before, after), each (axis, bin)."""
    return {name: np.stack([np.asarray(x) for x in course]) for name, course in found.maps.courses.items()}
