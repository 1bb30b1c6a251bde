"""Where the motors of a record stand, and whether that is where its arm configurations say.

A wrong configuration fits: masses, centres and inertias take it on. The logged positions of the motors deny it.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._text import number
from ..experiment import Experiment
from ..robot import Robot
from ..robot.equations import arm_angles
from .measured import mean_period

_NEAR = 0.02  # rad or m, of the arm, beside how far it moves: a slip of 1 degree is none, and bends no number by much


def misplaced(robot: Robot, data: Experiment) -> tuple[str, ...]:
    """Where q and the logged positions of the motors do not agree, in sentences; none where they do, where positions
    were not logged, and of an axis whose encoder begins at zero wherever it stands.

    **Arguments:** `robot`: for its gears, and the zeros of its encoders. `data`: periodic.
    """
    if data.y_quantity != "position" or data.q is None or data.n_out != robot.n_axes:
        return ()
    arm, moves = _arm(robot, data)
    q, room = np.asarray(data.q), _NEAR + moves
    axes = range(robot.n_axes)
    units = robot.axis_units
    each = [_of_axis(arm[..., a], q[:, a], room[:, a], units[a]) for a in axes]
    said = "; ".join(f"{name} {text}" for name, text in zip(robot.axis_names, each, strict=True) if text)
    if not said:
        return ()
    return (
        f"the logged positions of the motors are not those of q: {said}. An encoder may have another zero; where q is "
        "what is wrong, masses, centres and inertias are, too.",
    )


def _arm(robot: Robot, data: Experiment) -> tuple[Float[np.ndarray, "pos exp axis"], Float[np.ndarray, "pos axis"]]:
    """Mean positions of the motors on the arm side, and how far they move at most."""
    means, moves = [], []
    for pos in range(data.n_pos):
        period = np.asarray(arm_angles(robot, robot.drives.turned(jnp.asarray(mean_period(data, pos, data.y)))))
        means.append(period.mean(axis=1))
        moves.append(np.ptp(period, axis=1).max(axis=0))
    return np.array(means), np.array(moves)


def _of_axis(arm: Float[np.ndarray, "pos exp"], q, room: Float[np.ndarray, "pos"], unit: str) -> str:
    """What is said of one axis: arm, and the q and the room of every position."""
    apart = np.ptp(arm, axis=1)
    if np.any(apart > room):
        at = int(np.argmax(apart - room))
        return f"stands up to {number(apart[at])} {unit} apart in the experiments at position {at}"
    stands = arm.mean(axis=1)
    if np.ptp(q) > 2 * np.max(room) > 4 * np.ptp(stands):
        return ""  # begins at zero
    beside = stands - q
    zero = float(np.median(beside))
    away = np.abs(beside - zero)
    if np.any(away > room):
        at = int(np.argmax(np.abs(beside)))
        return f"stands up to {number(abs(beside[at]))} {unit} away (position {at})"
    if abs(zero) > np.max(room):
        return f"stands {number(zero)} {unit} away at every position"
    return ""
