"""Torques that look like those of the robot as given, but for a sign, a factor or an exchange of channels."""

import numpy as np
from jaxtyping import Complex, Float

from .._text import number
from ..robot import Robot

LOST = 0.5  # part of a torque, missed, from which on this is asked: chosen, not tuned
_ALIKE = 0.8  # squared correlation of a measured torque with a simulated one: numbers that are a third off keep .9
_FACTOR = 2.5  # more than any tolerance of a robot's numbers makes


def miswired(
    robot: Robot, measured: Complex[np.ndarray, "*runs axis"], simulated: Complex[np.ndarray, "*runs axis"]
) -> tuple[str, ...]:
    """What torques of a robot suggest where they are missed by far, in sentences; none where nothing is that simple.

    **Arguments:** `measured`, `simulated`: the motors' torques, of the record and of the robot as it was given in the
    same experiment, their lines (but the mean) or samples (about the mean)."""
    slope, likeness = _each_by_each(*(x.reshape(-1, robot.n_axes) for x in (measured, simulated)))
    said = []
    for axis, name in enumerate(robot.axis_names):
        own, other = slope[axis, axis], int(np.argmax(likeness[axis]))
        if likeness[axis, axis] >= _ALIKE:
            factor = abs(own)
            if own < 0:
                said.append(f"the torque of {name} is like the opposite of what it needs: is its sign wrong?")
            if not 1 / _FACTOR < factor < _FACTOR:
                said.append(
                    f"the torque of {name} is {number(factor, 3)} times what it needs (its gear: "
                    f"{number(abs(float(np.asarray(robot.drives.gear_ratio)[axis])), 4)}): is it the motor's, in N m?"
                )
        elif other != axis and likeness[axis, other] >= _ALIKE:
            said.append(f"the torque of {name} is like that of {robot.axis_names[other]}: are channels exchanged?")
    return tuple(said)


def _each_by_each(measured, simulated) -> tuple[Float[np.ndarray, "axis axis"], Float[np.ndarray, "axis axis"]]:
    """Real factor by which each simulated torque stands in each measured one, and their squared correlation."""
    together = (measured.T @ simulated.conj()).real
    power = lambda x: np.sum(np.abs(x) ** 2, axis=0)
    own, theirs = power(measured)[:, None], power(simulated)[None]
    nothing = np.finfo(float).tiny
    return together / np.maximum(theirs, nothing), together**2 / np.maximum(own * theirs, nothing)
