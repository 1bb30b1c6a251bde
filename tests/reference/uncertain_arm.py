"""The small arm with a bent spring, of which nothing is known well, as built, and its records by MuJoCo."""

import functools

import numpy as np
from _mujoco_records import mujoco_experiment
from small_arm import FS, PERIOD, Q, small_robot

import jaxfrf as jf
from jaxfrf.robot import parameters, tolerances_from, with_parameters

WIDE = tolerances_from({"links": 0.05, "rotors": 0.05, "friction": 0.5, "smoothing": 0.7, "damping": 0.7}, ())


@functools.cache
def model():
    """The small robot with a bent spring, of which nothing is known well."""
    robot = with_parameters(small_robot(), {"elbow.stiffness_ratio": 0.7, "elbow.stiffness_knee": 1e-3})
    return robot.with_tolerances(WIDE)


@functools.cache
def machine(seed: int = 0):
    """As built: every number is off by what a data sheet is."""
    rng, values = np.random.default_rng([seed, 12]), {}
    off = {
        "stiffness": 0.2,
        "damping": 0.4,
        "viscous_friction": 0.3,
        "coulomb_friction": 0.3,
        "motor_inertia": 0.03,
        "mass": 0.05,
        "com": 0.05,
        "inertia": 0.05,
        "stiffness_ratio": 0.2,
        "stiffness_knee": 0.2,
    }
    for kind, part in off.items():
        for name, value in parameters(model(), [kind]).items():
            if kind.startswith("stiffness_") and name.startswith("shoulder"):
                continue
            values[name] = value * (1.0 + rng.uniform(-part, part))
    return with_parameters(model(), values)


def design(seed: int):
    slow = jf.SlowSine([3, 5], [30.0, 30.0])
    return jf.Multisine(FS, PERIOD, np.arange(17, 240, 2), rms=[2.0, 3.0], slow=slow, seed=seed)


@functools.cache
def played(seed: int = 0):
    q = np.concatenate([Q, Q[:, ::-1] + 0.2])
    return mujoco_experiment(machine(seed), design(seed), q, seed=seed, run_in=3.0, noise=2e-5, ripple=None)
