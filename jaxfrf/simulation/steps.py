"""How finely a control sample must be cut."""

import math

import numpy as np

from .._errors import input_error
from .._text import number
from ..effects import AbstractGearTorque
from ..effects.acting import groups
from ..robot import OperatingPoint, Robot, friction_effects, linearise, local_stiffness, spring_directions

_LEAST = 3  # steps at which the error of R3X is below that of holding the inertia over a sample
_DECAY = 2.2  # rate times step up to which friction near rest is stable: the limit of the method is 2.79
_TURN = 0.35  # rad in a step of the fastest mode: an error below 1e-5 of its amplitude in a period
_MOST = 64


def fine_steps(robot: Robot, point: OperatingPoint) -> int:
    """Runge-Kutta steps in a control sample: enough for the stiffest friction and the fastest mode.

    Smoothed Coulomb friction pulls a motor to rest at the rate c/(eps J), which an explicit step must resolve;
    springs turn at their modes' frequencies.

    **Arguments:** `robot`: with its sampling frequency. `point`: the equilibria about which it moves, one or several
    (`jaxfrf.robot.operating_point`).

    **Returns:** steps in a sample, 3 to 64.

    **Raises:** `jaxfrf.InputError` where more than 64 were needed, and for a joint that nothing is accelerated by.

    **Source:** the stability limit of the classical Runge-Kutta method, 2.79 on the negative real axis; the margins
    below it are this project's own.
    """
    sample = 1.0 / robot.sampling_frequency
    decay, mode = _friction_rate(robot), _fastest_mode(robot, point)
    needed = max(sample * decay / _DECAY, sample * mode / _TURN)
    if not needed <= _MOST:
        friction = sample * decay / _DECAY >= sample * mode / _TURN
        raise input_error(
            f"{robot.name}",
            f"friction that stops a motor at a rate of {number(decay)}/s"
            if friction
            else f"a mode at {number(mode / 2 / np.pi)} Hz",
            f"what {_MOST} steps in a sample of {sample:g} s can follow",
            "Raise the friction's smoothing." if friction else "Make that spring rigid: stiffness = inf.",
        )
    return max(_LEAST, math.ceil(needed))


def smoothing_factor(robot: Robot, like: Robot) -> float:
    """How many times its smoothing a robot's friction needs, that of its effects included, to take no more steps than
    that of another robot, or than the fewest; below 1 where it could be sharper.

    **Arguments:** `robot`: any. `like`: another one, whose steps are to be enough.

    **Returns:** the factor.

    **Source:** the rate c/(eps J) of `fine_steps`, solved for the smoothing.
    """
    return _friction_rate(robot) / max(_friction_rate(like), _LEAST * _DECAY * robot.sampling_frequency)


def _friction_rate(robot: Robot) -> float:
    """Largest slope of the friction near rest over the motor's inertia, 1/s."""
    speed = np.full(robot.n_axes, 1e-6)
    load = np.asarray(robot.drives.torque_limit)
    load = np.where(np.isfinite(load), load, 0.0)
    law = lambda v: robot.drives.friction.torque(v) + friction_effects(robot, v, load)
    slope = 0.5 * (law(speed) - law(-speed)) / speed  # the difference leaves out constant torques
    return float(np.max(np.abs(slope) / robot.drives.motor_inertia))


def _fastest_mode(robot: Robot, point: OperatingPoint) -> float:
    """Highest undamped natural frequency over the positions, rad/s, springs as stiff as they get."""
    model, W = linearise(robot, point), np.asarray(spring_directions(robot))
    stiffest = robot.springs.tangent(np.ones(W.shape[1]))
    more = np.asarray(_beside_springs(robot, stiffest) + stiffest - local_stiffness(robot, point))
    mass, stiffness = np.asarray(model.mass), model.stiffness + np.einsum("is,...s,js->...ij", W, more, W)
    try:
        squared = np.linalg.eigvals(np.linalg.solve(mass, stiffness))
    except np.linalg.LinAlgError:
        raise input_error(
            f"{robot.name}",
            "a joint that nothing is accelerated by (singular mass matrix)",
            "mass and inertia of every link about its joint's axis",
            "State them, or stiffness = inf for a joint without a spring.",
        ) from None
    return float(np.sqrt(np.max(np.abs(squared), initial=0.0)))


def _beside_springs(robot: Robot, tangent) -> np.ndarray:
    """Stiffness that effects with a memory add to the springs' `tangent` in fast motion, (spring,)."""
    flexible, added = list(robot.flexible_axes), np.zeros(len(tangent))
    rows = np.zeros(robot.n_axes)
    rows[flexible] = tangent[: len(flexible)]
    for group in groups(robot, AbstractGearTorque):
        springs = [flexible.index(axis) for axis in group.axes]
        added[springs] += np.asarray(group(lambda e, k: e.stiffness(k), rows))
    return added
