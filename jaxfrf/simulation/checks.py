"""What must hold before anything is simulated, and the loop at rest that comes of it."""

import numpy as np

from .._errors import input_error
from .._memory import check_memory
from .._text import number, percent
from .._types import arrays
from ..excitation import Multisine
from ..robot import OperatingPoint, Robot, linearise, local_stiffness, operating_point
from .closed_loop import ClosedLoop
from .steps import fine_steps

_AT = 1e-9  # of the torque limit: rounding
_OFTEN = 1e-3  # of the samples


def check_fit(robot: Robot, fs: float, channels: int, source: str) -> None:
    """Controller, sampling frequency and axes of the robot against references from `source` (design, record)."""
    if robot.controller is None:
        raise input_error(
            f"{robot.name}: controller",
            "none",
            "a [controller] table",
            "Without its controller the robot cannot be simulated in closed loop: state position_gain, "
            "integral_time and each joint's velocity_gain.",
        )
    if fs != robot.sampling_frequency:
        raise input_error(
            f"fs of the {source}",
            f"{fs:g} Hz",
            f"{robot.sampling_frequency:g} Hz, the sampling_frequency of {robot.name}",
            "Change one of them: the controller plays one reference value a sample.",
        )
    if channels != robot.n_axes:
        raise input_error(
            f"inputs of the {source}",
            f"{channels}",
            f"{robot.n_axes}, one for each driven joint of {robot.name}",
            "Set inputs, or complete rms and the slow sine."
            if source == "design"
            else "Choose the channels of r in the order of the joints.",
        )


def check_data(robot: Robot, data) -> None:
    """Refuse data, records or an FRF, that cannot come from this robot.

    **Raises:** `jaxfrf.InputError` saying which number does not fit.
    """
    axes = robot.n_axes
    counts = (data.n_out, data.n_in)
    if counts != (axes, axes):
        raise input_error(
            "data and robot",
            f"{counts[0]} outputs and {counts[1]} inputs with {axes} driven joints of {robot.name}",
            "one output and one input for each driven joint",
            "Take the robot that was measured, or choose channels (--map) in the order of its joints.",
        )
    if data.q is None or np.shape(data.q)[-1] != axes:
        raise input_error(
            "q of the data",
            "none" if data.q is None else f"{np.shape(data.q)[-1]} angles",
            f"the {axes} arm angles of {robot.name} at every position",
            "Store q with the records (--set q=0;0.5 for one position) and estimate again.",
        )


def check_noise(noise: float) -> None:
    if not (np.ndim(noise) == 0 and np.isfinite(noise) and noise >= 0):
        raise input_error("noise", f"{noise}", "a standard deviation, 0 or more, rad", "E.g. noise=5e-5.")


def check_runs(design: Multisine, positions: int) -> None:
    """Whether the record of so many positions can be held."""
    samples = (design.periods + design.transient_periods) * design.period
    runs = positions * design.n_exp
    check_memory(
        f"{runs} runs ({positions} positions, {design.n_exp} experiments) of {samples} samples",
        16.0 * runs * samples * design.n_in,
        "Simulate fewer positions, experiments or periods at a time.",
    )


def at_limits(robot: Robot, torque: np.ndarray) -> tuple[str, ...]:
    """A sentence for every motor that ran at its torque limit for a part of the record that matters."""
    return limits_told(robot, limit_share(robot, torque))


def limit_share(robot: Robot, torque: np.ndarray) -> np.ndarray:
    """Share of the samples (pos, exp, time, axis) at which every motor is at its limit: (pos, exp, axis)."""
    limit = np.asarray(robot.drives.torque_limit)
    return np.stack([np.mean(np.abs(torque[..., i]) >= (1 - _AT) * x, axis=-1) for i, x in enumerate(limit)], axis=-1)


def limits_told(robot: Robot, shares: np.ndarray) -> tuple[str, ...]:
    """A sentence for every motor whose share is large anywhere."""
    limit = np.asarray(robot.drives.torque_limit)
    said = []
    for axis, name in enumerate(robot.axis_names):
        share = shares[..., axis]
        if np.isfinite(limit[axis]) and share.max() > _OFTEN:
            pos, exp = (int(i) for i in np.unravel_index(np.argmax(share), share.shape))
            said.append(
                f"{name}: the motor is at its torque limit of {number(limit[axis])} N m for {percent(share.max())} of "
                f"the samples of position {pos}, experiment {exp} ({percent(share.mean())} of all): a clipped "
                "torque no longer excites as designed, and the response is not that of the linear robot. Lower rms "
                "or the slow sine, or take another position."
            )
    return tuple(said)


def soft_springs(robot: Robot, point: OperatingPoint, design: Multisine) -> tuple[str, ...]:
    """A sentence for every spring so soft that motor and arm are hardly joined within the record."""
    if not robot.n_motors:
        return ()
    mass = np.asarray(linearise(robot, point).mass)
    stiffness = np.asarray(local_stiffness(robot, point))
    duration = design.periods * design.period / design.fs
    said = []
    for spring, axis in enumerate(robot.flexible_axes):
        arm = np.abs(np.diagonal(mass, axis1=-2, axis2=-1)[..., axis])
        slowest = float(np.sqrt(np.min(stiffness[..., spring] / arm))) / (2 * np.pi)
        if slowest * duration < 1:
            said.append(
                f"{robot.axis_names[axis]}: its spring lets the arm swing at {number(slowest, 2)} Hz, less than once "
                f"in the record of {number(duration)} s: the arm is hardly joined to its motor. Check the stiffness."
            )
    return tuple(said)


def check_positions(robot: Robot, positions) -> np.ndarray:
    """Arm angles at rest as (pos, axis), finite."""
    positions = np.asarray(positions, float)
    if positions.ndim != 2 or positions.shape[1] != robot.n_axes or not len(positions):
        raise input_error(
            "positions",
            f"an array of shape {positions.shape}",
            f"(position, {robot.n_axes}), rad",
            "Give one row of arm angles for each position.",
        )
    if not np.isfinite(positions).all():
        raise input_error("positions", "NaN or Inf", "finite angles, rad", "Correct the file.")
    return positions


def loop_at_rest(
    robot: Robot, positions: np.ndarray, noise: float, steps: int | None
) -> tuple[ClosedLoop, OperatingPoint]:
    """The loop with as many fine steps as it needs, and its equilibria at checked positions."""
    if steps is not None and not (steps == int(steps) and steps >= 1):
        raise input_error("steps", f"{steps}", "a whole number, 1 or more, or None", "None finds it.")
    # Numbers of effects may be plain floats: as arrays, robots that differ in them only share what is compiled.
    robot = arrays(robot)
    point = equilibria(robot, positions)
    steps = fine_steps(robot, point) if steps is None else int(steps)
    return ClosedLoop.of(robot, noise=noise, steps=steps), point


def equilibria(robot: Robot, positions: np.ndarray, limited: bool = True) -> OperatingPoint:
    """Rest at every position; `limited`: whether the motors' limits have to allow it."""
    point = operating_point(robot, positions)
    lost = np.flatnonzero(~np.asarray(point.converged))
    if lost.size:
        raise input_error(
            f"{robot.name}",
            f"no equilibrium at position {lost[0]}, q = {np.round(positions[lost[0]], 3).tolist()}",
            "springs that carry the arm's weight",
            "Check stiffness, masses and the position.",
        )
    limit, torque = np.asarray(robot.drives.torque_limit), np.abs(np.asarray(point.torque))
    for p, axis in np.argwhere(limited & (torque > limit))[:1]:
        raise input_error(
            f"{robot.name}: {robot.axis_names[axis]}",
            f"{number(torque[p, axis])} N m to hold the arm at position {p}",
            f"at most the torque_limit of {number(limit[axis])} N m",
            "Lower the payload, or choose other positions.",
        )
    return point
