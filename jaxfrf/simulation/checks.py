"""What must hold before anything is simulated, and the loop at rest that comes of it."""

import numpy as np

from .._errors import input_error
from .._types import arrays
from ..robot import OperatingPoint, Robot, operating_point
from .closed_loop import ClosedLoop
from .steps import fine_steps


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
            f"{torque[p, axis]:.3g} N m to hold the arm at position {p}",
            f"at most the torque_limit of {limit[axis]:.3g} N m",
            "Lower the payload, or choose other positions.",
        )
    return point
