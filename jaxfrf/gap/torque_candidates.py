"""What every effect of the library would add to the needed torque, as columns of a regression."""

from collections.abc import Iterable

import equinox as eqx
import numpy as np

from .._errors import InputError
from ..effects import AbstractEffect, library
from ..robot import Robot

_ORDERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 18, 20, 24, 30, 36, 48)
_TURNS = 2.0  # of the motor's angle times the order, that a record must hold to show it

NOT_ASSESSED = {
    "torque_saturation": "a clipped torque cannot be inverted: look for flat tops of u (jaxfrf.screen)",
    "encoder_quantisation": "it is noise here: the filter of y takes it off",
    "extra_flexibility": "the transmissions are taken as rigid",
    "wrist_coupling": "gears that turn with another axis are no candidates here",
}
"""Effects that inverse dynamics cannot see, and why."""


class Candidate(eqx.Module):
    """One effect on one joint with given shape parameters, linear in what is left.

    **Fields:** `name`, `joint`. `fixed`: parameters that are held (shapes: width, smoothing, order). `free`: parameters
    that its torque is linear in. `make(values)` is the effect with these free values.
    """

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    fixed: dict = eqx.field(static=True)
    free: tuple[str, ...] = eqx.field(static=True)

    def make(self, values: Iterable[float]) -> AbstractEffect:
        kind, values = library()[self.name], dict(zip(self.free, map(float, values), strict=True))
        if "constant" in values:  # stiffness (angle - rest) as stiffness angle + constant
            constant, stiffness = values.pop("constant"), values["stiffness"]
            values["rest"] = -constant / stiffness if stiffness else 0.0
        if "sine" in values:
            sine, cosine = values["sine"], values["cosine"]
            values = {"amplitude": [np.hypot(sine, cosine)], "phase": [np.arctan2(cosine, sine)]}
        return kind(joint=self.joint, **self.fixed, **values)

    def directions(self) -> list[tuple[tuple[AbstractEffect, float], ...]]:
        """For every free parameter the effects whose torques add up, with their factors, to its column."""
        step = {"delay": 1e-5, "time_constant": 1e-5, "error": 1e-6}.get(self.free[0], 1.0)
        if "sine" in self.free:
            return [((self.make((1e-6, 0.0)), 1e6),), ((self.make((0.0, 1e-6)), 1e6),)]
        if "constant" in self.free:
            one, shifted = self.make((1.0, 0.0)), self.make((1.0, 1.0))
            return [((one, 1.0),), ((shifted, 1.0), (one, -1.0))]
        unit = np.eye(len(self.free)) * step
        return [((self.make(row), 1.0 / step),) for row in unit]


def candidates(
    robot: Robot, names: Iterable[str], speed: np.ndarray, travel: np.ndarray
) -> tuple[list[Candidate], dict[str, str]]:
    """Candidates of these effects on every axis, their shapes on a grid, and the effects that cannot be assessed.

    **Arguments:** `speed`: the largest motor speed in the records, (axis,), rad/s: widths of friction laws are tried in
    fractions of it, whatever the units. `travel`: range of the motor angle, (axis,), rad.
    """
    found, left_out = [], {}
    for name in names:
        if name in NOT_ASSESSED:
            left_out[name] = NOT_ASSESSED[name]
            continue
        for axis, joint in enumerate(robot.axis_names):
            try:
                new = _on_joint(robot, name, joint, float(speed[axis]), float(travel[axis]))
            except InputError as error:
                left_out[name] = str(error)
                continue
            if not new:
                left_out[name] = "the records hold too few turns of the motor to tell its orders"
            found += new
            if name == "payload":
                break
    return found, left_out


def _on_joint(robot: Robot, name: str, joint: str, speed: float, travel: float) -> list[Candidate]:
    smoothing = {"smoothing": min(float(robot.drives.friction.smoothing), 0.02 * speed)}
    one = lambda free, fixed: [Candidate(name, joint, fixed, free)]
    if name == "friction_asymmetry":
        return one(("offset",), smoothing)
    if name == "stribeck_friction":
        return [Candidate(name, joint, {"width": f * speed, **smoothing}, ("level",)) for f in (0.02, 0.05, 0.1, 0.2)]
    if name == "load_dependent_friction":
        return one(("coefficient",), smoothing)
    if name in ("counterbalance", "dress_pack"):
        return one(("stiffness", "constant"), {})
    if name in ("torque_ripple", "resolver_ripple"):
        orders = [h for h in _ORDERS if h * travel > 2 * np.pi * _TURNS]
        return [Candidate(name, joint, {"order": (h,)}, ("sine", "cosine")) for h in orders]
    if name == "payload":
        return [Candidate(name, robot.axis_names[-1], {}, ("mass",))]
    kind = library()[name]
    robot.with_effects(kind.typical(robot, joint))  # refuses where the effect cannot act
    return one((next(iter(kind.units)),), {})


def allowed(candidate: Candidate, values: np.ndarray, robot: Robot, torque: float) -> bool:
    """Whether fitted values have a sign and a size that make sense for any robot.

    `bounds` of an effect are for robots of some kilowatts. What carries a torque (levels, coefficients, stiffness) is
    only held to the sign that they state, and what it adds to the robot's own torque; times and ratios to the bounds.
    **Arguments:** `torque`: the largest torque on its joint.
    """
    kind = library()[candidate.name]
    try:
        effect = candidate.make(values)
    except InputError:
        return False
    for name in candidate.free:
        if name in ("sine", "cosine", "constant"):
            continue
        low, high = kind.bounds[name]
        value, scales = float(np.max(np.asarray(getattr(effect, name)))), "N m" in kind.units[name]
        if name == "level" and candidate.name == "coulomb_friction":
            low = -float(robot.drives.friction.coulomb[robot.axis_names.index(candidate.joint)])
        elif scales:
            low, high = (0.0 if low >= 0.0 else -np.inf), np.inf
        if scales and kind.units[name] == "N m":
            low, high = max(low, -torque), torque
        if not low <= value <= high:
            return False
    return True
