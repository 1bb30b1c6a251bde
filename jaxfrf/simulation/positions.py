"""Arm configurations at which a robot is measured."""

import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray

_LOW = np.array([-150.0, -60.0, 20.0, -150.0, 25.0, -150.0])  # degrees
_HIGH = np.array([150.0, 60.0, 150.0, 150.0, 100.0, 150.0])


def random_positions(n: int, key: PRNGKeyArray) -> Float[np.ndarray, "pos 6"]:
    """Arm angles of a six-axis elbow robot, (n, 6), rad: uniform, within reach of its payload.

    In degrees, 1: +-150, 2: -60..60, 3: 20..150, 4: +-150, 5: +-(25..100), 6: +-150; joint 5 keeps clear of
    zero, where axes 4 and 6 are in line. A position does not depend on how many are drawn.
    """
    draw = np.array([np.asarray(jr.uniform(jr.fold_in(key, i), (7,))) for i in range(n)]).reshape(n, 7)
    q = _LOW + (_HIGH - _LOW) * draw[:, :6]
    q[:, 4] *= np.where(draw[:, 6] < 0.5, -1.0, 1.0)
    return np.deg2rad(q)
