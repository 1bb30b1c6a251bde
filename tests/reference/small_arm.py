"""A small arm for tests, two axes in a vertical plane on flexible gears, and its records."""

import functools

import jax.random as jr
import numpy as np

import jaxfrf as jf

FS, PERIOD, STEPS = 1000.0, 4000, 4

Q = np.array([[0.3, 0.9], [-0.5, 1.4], [1.5, -1.1]])  # the last one unloads the shoulder

SHOULDER = {
    "name": "shoulder",
    "type": "driven",
    "axis": [0.0, 0.0, 1.0],
    "offset": [0.0, 0.0, 0.0],
    "mass": 20.0,
    "com": [0.25, 0.0, 0.05],
    "inertia": [0.3, 1.0, 1.0, 0.0, 0.05, 0.0],
    "gear_ratio": 100.0,
    "motor_inertia": 1e-3,
    "stiffness": 9e4,
    "damping": 60.0,
    "viscous_friction": 1e-3,
    "coulomb_friction": 0.1,
    "torque_limit": 12.0,
    "velocity_gain": 0.2,
}

ELBOW = SHOULDER | {
    "name": "elbow",
    "offset": [0.5, 0.0, 0.1],
    "mass": 10.0,
    "com": [0.2, 0.05, 0.06],
    "inertia": [0.1, 0.4, 0.4, 0.02, 0.03, 0.0],
    "gear_ratio": 80.0,
    "motor_inertia": 5e-4,
    "stiffness": 3e4,
    "damping": 20.0,
    "viscous_friction": 8e-4,
    "torque_limit": 8.0,
    "velocity_gain": 0.1,
}


@functools.cache
def small_robot(**elbow):
    """An upper arm and a forearm in a vertical plane, on flexible gears."""
    return jf.robot.robot_from_table(
        {
            "name": "small",
            "gravity": [0.0, -9.81, 0.0],
            "sampling_frequency": FS,
            "joint": [SHOULDER, ELBOW | elbow],
            "controller": {"position_gain": 10.0, "integral_time": 0.1},
            "tolerance": {"links": 0.01, "rotors": 0.005, "friction": 0.03, "smoothing": 0.3, "damping": 1.0},
        }
    )


def record(robot, positions=Q, noise=1e-4, slow=30.0, highest=240):
    slow = jf.SlowSine([3, 5], [slow, slow])
    plan = jf.Multisine(FS, PERIOD, np.arange(17, highest, 2), rms=[2.0, 3.0], slow=slow, seed=4)
    return jf.simulate(robot, plan, positions, key=jr.key(1), run_in=3.0, noise=noise, steps=STEPS)


def made_up(n_pos=3, n_exp=4, fs=100.0, seed=0, **fields):
    """A record of noise, whose shapes are right."""
    rng = np.random.default_rng(seed)
    signal = lambda: rng.standard_normal((n_pos, n_exp, 50, 2))
    known = {"u": signal(), "y": signal(), "r": signal(), "q": np.arange(2.0 * n_pos).reshape(n_pos, 2) + 10 * seed}
    return jf.Experiment(**(known | {"fs": fs, "period": 50, "y_quantity": "position"} | fields))
