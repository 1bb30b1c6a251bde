"""The gray-box model of a robot for given data, and whether the two belong together."""

from collections.abc import Sequence

import numpy as np

from ..experiment import Experiment
from ..frf import FRF
from ..graybox import RobotModel, fix, free, share
from ..graybox.indirect import check_simulated
from ..robot import Robot, ZeroOrderHold
from ..simulation.checks import check_fit

QUANTITY = "acceleration"
"""Of y in the fit to records: the logarithm of a ratio is the same in all of them."""


def robot_model(
    robot: Robot,
    data: Experiment | FRF,
    *,
    fixed: Sequence[str] = (),
    freed: Sequence[str] = (),
    shared: Sequence[Sequence[str]] = (),
    simulated: bool = False,
) -> RobotModel:
    """The gray-box model of a robot for these data: quantity, hold, first guess of friction, and what is fitted.

    **Raises:** `jaxfrf.InputError` for a name that the model does not have, with the nearest one, and for a parameter
    that a simulation (`simulated`) does not know.
    """
    if isinstance(data, FRF):
        model = RobotModel(robot, quantity=data.y_quantity)
    else:
        hold = ZeroOrderHold(data.fs, "velocity" if data.y_quantity == "velocity" else "position")
        model = RobotModel(robot, quantity=QUANTITY, hold=hold, slow_amplitude=_amplitude(data))
    model = free(model, freed) if freed else model
    model = fix(model, fixed) if fixed else model
    for names in shared:
        model = share(model, names)
    if simulated:
        check_simulated(model)
    return model


def why_direct(robot: Robot, data: Experiment | FRF, direct: bool) -> str:
    """Why there is no indirect fit; empty where there is one."""
    if isinstance(data, FRF):
        return "FRFs do not hold the references that a simulation would have to play"
    if direct:
        return "nothing else was asked for"
    if data.r is None:
        return "the records hold no reference"
    if robot.controller is None:
        return f"the controller of {robot.name} is not known"
    if not data.period:
        return "the records are not periodic"
    check_fit(robot, data.fs, data.r.shape[3], "record")
    return ""


def _amplitude(data: Experiment) -> np.ndarray | None:
    """Of a sine that moves as fast as the motors did, (axis,), rad/s."""
    if data.r is None or data.r_quantity != "velocity" or data.r.shape[-1] != data.n_in:
        return None
    rms = np.sqrt(np.mean(np.square(data.r), axis=(0, 1, 2)))
    return np.sqrt(2) * rms if np.all(rms > 0) else None
