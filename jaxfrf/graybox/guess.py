"""Start values for the springs of a robot that nobody has measured: from its rigid bodies and its FRF."""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import numpy as np

from .._arguments import expect
from .._errors import input_error
from .._text import number
from .._types import require_x64
from ..frf import FRF, features
from ..robot import Robot, arm_inertia
from .cost import Cost, check_shape
from .fit import _coarse, _without_blind
from .model import RobotModel, starting_at
from .parameter import Coordinates, Parameter, matching
from .solver import LevenbergMarquardt, descend
from .target import Target, Weights, target

_ZETA = 0.04  # damping ratio of a spring about which nothing is known
_ZETAS = (0.005, 0.3)  # what is believed of a search
_FARTHEST = 30.0  # factor between rough and refined stiffness that is believed
_SEEN, _UNSEEN = 0.25, 0.6  # spread of ln stiffness of the search's starts
_STARTS, _AGREE, _SAME = 12, 3, 0.02  # starts at most; stop when so many of the best are the same, in x
_FLOOR = 0.1  # relative error of a magnitude below which nothing is gained by a guess
_FAR = 2.0  # dB


class Guess(eqx.Module):
    """Start values and how they were come by.

    **Fields:** `values`: `<joint>.stiffness` and `<joint>.damping` of every spring, arm side, N m/rad and N m s/rad.
    `error_db`: weighted rms error of the magnitudes of the diagonal elements there. `notes`: what had to be assumed, or
    speaks against the guess; empty where nothing does.
    """

    values: dict[str, float]
    error_db: float
    notes: tuple[str, ...] = eqx.field(static=True)


def initial_guess(robot: Robot | RobotModel, frf: FRF) -> Guess:
    """Stiffness and damping of every spring of a robot whose rigid bodies, motors and gears are known.

    With motor i held, the arm swings on its springs at the antiresonances of G_ii. The first one and the inertia J_i
    about joint i give k_i = (2 pi f)^2 J_i, median over the positions, wrong by what the other springs do; of damping
    nothing is known, the ratio of .04 stands for it. From there and from starts about it, Levenberg-Marquardt fits the
    magnitudes of the diagonal elements alone, where no phase misleads, until three starts agree. The springs that the
    robot or the model came with are not looked at, unless the model fixes them.

    Where G_ii shows no antiresonance, its highest resonance f, with motor and arm on the spring, stands for it: k_i =
    (2 pi f)^2 / (1/J_i + 1/(n^2 J_m)). Where that is missing too, and for springs across the transmission, which no
    motor shows, a mode is assumed at half the highest frequency, or at the highest antiresonance of another axis where
    that is higher. `notes` says so.

    It fails with wrong masses, inertias or gear ratios, with an FRF that is not torque to motor motion in the robot's
    units and order of axes, with springs whose modes lie outside the band, and where friction hides the first
    antiresonance: `error_db` is then large, and `notes` says that too, except that a single wrong inertia may hide in
    its spring. It is a start, not a result: damping may be off by a factor.

    **Arguments:** `robot`: or a `jaxfrf.RobotModel` of it, whose fixed and shared parameters stay so. `frf`: with arm
    configurations q; acceleration, velocity or position of all motors.

    **Returns:** a `Guess`: N m/rad and N m s/rad by parameter, the error in dB, notes.

    **Raises:** `jaxfrf.InputError` for a robot without springs, and where FRF and robot do not fit together.

    **Source:** closed form of an inertia on a spring (its eigenfrequency with the motor held, and free); the search
    from there is this project's own.
    """
    expect("robot", robot, Robot, RobotModel)
    expect("frf", frf, FRF)
    require_x64("initial_guess")
    model = robot if isinstance(robot, RobotModel) else RobotModel(robot, quantity=frf.y_quantity)
    _check(model, frf)
    stiffness, inertia, seen, notes = _rough(model.robot, frf)
    rough = _springs(model.robot, stiffness, inertia)
    tg = _magnitudes(model, frf)
    begin = starting_near(model, rough)
    found, error, more = _searched(begin, tg, seen)
    values, doubts = _believed(model.robot, rough, found, inertia)
    return Guess({n: values[n] for n in rough}, error, (*notes, *more, *doubts))


def guessed(model: RobotModel, frf: FRF) -> RobotModel:
    """The same model with its springs starting at `initial_guess`, whose notes say what to doubt.

    Parameters that are fixed keep their value.

    **Arguments:** `model`, `frf`: as of `jaxfrf.initial_guess`, the FRF with arm configurations `q`, rad.

    **Returns:** the model, its parameters in their units.

    **Raises:** as `jaxfrf.initial_guess`.

    **Source:** as of `jaxfrf.initial_guess`.
    """
    expect("model", model, RobotModel)
    expect("frf", frf, FRF)
    return starting_near(model, initial_guess(model, frf).values)


def _check(model: RobotModel, frf: FRF) -> None:
    robot = model.robot
    if not robot.spring_names:
        raise input_error(robot.name, "no springs", "at least one flexible joint", "There is nothing to guess.")
    if model.quantity != frf.y_quantity:
        raise input_error(
            "FRF",
            f"motor {frf.y_quantity}",
            f"motor {model.quantity}, the model's",
            "Make the model with its quantity.",
        )
    if (frf.n_out, frf.n_in) != (robot.n_axes, robot.n_axes):
        raise input_error(
            "FRF",
            f"{frf.n_out} outputs and {frf.n_in} inputs",
            f"{robot.n_axes} of both, the axes of {robot.name}",
            "Estimate it from all motors, in the robot's order.",
        )
    points = model.points(frf.q, frf.n_pos)
    if not np.isfinite(points).all():
        raise input_error("q of the FRF", "angles that are not finite", "finite numbers", "Leave these positions out.")


# --- from antiresonances


def _rough(robot: Robot, frf: FRF):
    """Stiffness and inertia of every spring, whether an antiresonance gave it, and notes."""
    own, free, rotor = _inertias(robot, np.asarray(frf.q))
    dips = {axis: _extremes(frf, axis, "antiresonance") for axis in robot.flexible_axes}
    heard = [np.nanmedian(f) for f in dips.values() if np.isfinite(f).any()]
    # What does not show stands above the others, or above the band, rather than below.
    typical = max([*heard, 0.5 * float(frf.frequency[-1])])
    stiffness, inertia, seen, notes = [], [], [], []
    for axis, f in dips.items():
        name, J = robot.axis_names[axis], own[:, axis]
        if np.isfinite(f).any():
            k = np.nanmedian(_square(f) * J)
        else:
            k, how = _without_dip(_extremes(frf, axis, "resonance"), J, rotor[axis], typical)
            notes.append(f"{name}: no antiresonance in the band; stiffness from {how}")
        stiffness.append(k)
        inertia.append(np.median(J))
        seen.append(bool(np.isfinite(f).any()))
    for name, J in zip(robot.spring_names[robot.n_motors :], free.T, strict=True):
        stiffness.append(_square(typical) * np.median(J))
        inertia.append(np.median(J))
        seen.append(False)
        notes.append(f"{name}: no motor shows this spring; the search began with a mode at {number(typical)} Hz")
    return np.array(stiffness), np.array(inertia), np.array(seen), tuple(notes)


def _inertias(robot: Robot, q):
    """Inertia about every axis with the others held, (pos, axis); about every elastic joint with all motors turning,
    (pos, elastic); of the rotors on the arm side, (axis,); kg m^2."""
    arm = np.concatenate([q, np.zeros((len(q), robot.n_elastic))], axis=1)
    matrix = np.asarray(arm_inertia(robot, arm))
    rotor = np.square(np.asarray(robot.drives.gear_ratio)) * np.asarray(robot.drives.motor_inertia)
    # The rotors of rigid transmissions are in the matrix already.
    flexible = np.isin(np.arange(robot.n_axes), robot.flexible_axes)
    carried = matrix + np.diag(np.concatenate([flexible * rotor, np.zeros(robot.n_elastic)]))
    turning = 1.0 / np.diagonal(np.linalg.inv(carried), axis1=-2, axis2=-1)
    return np.diagonal(matrix, axis1=-2, axis2=-1)[:, : robot.n_axes], turning[:, robot.n_axes :], rotor


def _extremes(frf: FRF, axis: int, kind: str) -> np.ndarray:
    """The first antiresonance or the highest resonance of G_ii at every position, Hz; NaN where there is none."""
    found = [[x for x in features(frf, axis, axis, position=p) if x.kind == kind] for p in range(frf.n_pos)]
    order = (lambda x: x.frequency) if kind == "antiresonance" else (lambda x: -x.magnitude_db)
    return np.array([min(at, key=order).frequency if at else np.nan for at in found])


def _without_dip(peaks, J, rotor: float, typical: float) -> tuple[float, str]:
    if np.isfinite(peaks).any():
        return np.nanmedian(_square(peaks) / (1 / J + 1 / rotor)), f"the resonance at {number(np.nanmedian(peaks))} Hz"
    return _square(typical) * np.median(J), f"an assumed mode at {number(typical)} Hz, as it shows no resonance either"


def _square(frequency):
    return np.square(2 * np.pi * frequency)


def _springs(robot: Robot, stiffness, inertia) -> dict[str, float]:
    damping = 2 * _ZETA * np.sqrt(stiffness * inertia)
    named = lambda kind, values: {f"{n}.{kind}": float(v) for n, v in zip(robot.spring_names, values, strict=True)}
    return named("stiffness", stiffness) | named("damping", damping)


def starting_near(model: RobotModel, values: Mapping[str, float]) -> RobotModel:
    """The model starting there, fixed parameters left alone, all others within their bounds.

    **Arguments:** `model`: of a robot. `values`: {name: value}, names as `joint1.stiffness`, in their units; others
    keep their start.

    **Returns:** the model, its parameters in their units.

    **Raises:** `jaxfrf.InputError` for a name that the model does not have.
    """
    own = model.parameters
    for name in values:
        matching(own, [name])
    return starting_at(model, {n: _inside(own[n], v) for n, v in values.items() if own[n].free})


def _inside(parameter: Parameter, value: float) -> float:
    if parameter.bounds is None:
        return value
    low, high = (float(b) for b in parameter.bounds)
    return min(max(value, low * 1.001), high / 1.001)


# --- and a search on magnitudes


def _magnitudes(model: RobotModel, frf: FRF) -> Target:
    """The magnitudes of the diagonal elements alone, at a part of the lines."""
    weights = Weights(off_diagonal=0.0, floor=_FLOOR)
    tg = _coarse(target(frf, weights, model.points(frf.q, frf.n_pos)), _STARTS)[0]
    check_shape(model, Coordinates(model.parameters), tg, frf)
    return dataclasses.replace(tg, phase=np.zeros_like(tg.phase))


def _searched(begin: RobotModel, tg: Target, seen) -> tuple[dict[str, float], float, tuple[str, ...]]:
    """Values at the best of several descents, their error in dB, and notes."""
    model, blind = _without_blind(begin, tg)
    coordinates, solver = Coordinates(model.parameters), LevenbergMarquardt()
    diagonal = Cost(model, coordinates, tg)
    ends: list[tuple[float, np.ndarray]] = []
    for x in _starts(model, coordinates, seen):
        end = descend(diagonal, x, solver)
        if np.isfinite(end.cost) and np.isfinite(end.x).all():
            ends.append((float(end.cost), end.x))
        if _agreeing(ends, coordinates) >= _AGREE:
            break
    notes = [f"{name} has no effect on the diagonal elements: as assumed" for name in blind]
    if not ends:
        raise input_error("FRF", "no descent with a finite cost", "an FRF of this robot", "Check units and axes.")
    if _agreeing(ends, coordinates) < _AGREE:
        notes.append(f"no {_AGREE} of {len(ends)} starts of the search agree: there may be a better guess")
    cost, x = min(ends, key=lambda end: end[0])
    error = 20 / np.log(10) * np.sqrt(cost / np.sum(np.square(tg.magnitude)))
    if error > _FAR:
        notes.append(
            f"magnitudes are {number(error, 2)} dB off at the guess: check masses, gears, units, order of axes"
        )
    return {n: float(v) for n, v in coordinates.values(x).items()}, float(error), tuple(notes)


def _agreeing(ends, coordinates: Coordinates) -> int:
    """How many ends are the same minimum as the best."""
    if not ends:
        return 0
    stiff = [n.endswith(".stiffness") for n in coordinates.names]
    best = min(ends, key=lambda end: end[0])[1]
    return sum(np.abs(x - best)[stiff].max(initial=0.0) < _SAME for _, x in ends)


def _starts(model: RobotModel, coordinates: Coordinates, seen) -> np.ndarray:
    """The rough guess, and draws about it; (start, parameter)."""
    by_spring = dict(zip(model.robot.spring_names, np.where(seen, _SEEN, _UNSEEN), strict=True))
    spread = [
        {"stiffness": by_spring.get(joint, 0.0), "damping": 0.5}.get(kind, 0.0)
        for joint, _, kind in (name.rpartition(".") for name in coordinates.names)
    ]
    draws = np.random.default_rng(0).standard_normal((_STARTS, coordinates.size))
    draws[0] = 0.0
    return coordinates.start() + draws * np.array(spread)


def _believed(robot: Robot, rough: Mapping[str, float], found: Mapping[str, float], inertia):
    """What the search found, but for springs that ran away from any that a robot could have."""
    values, notes = dict(found), []
    for name, J in zip(robot.spring_names, inertia, strict=True):
        k, d = f"{name}.stiffness", f"{name}.damping"
        if not 1 / _FARTHEST < values[k] / rough[k] < _FARTHEST:
            notes.append(f"{name}: the search ran off to {number(values[k])} N m/rad; the rough guess stands")
            values[k] = rough[k]
        critical = 2 * np.sqrt(values[k] * J)
        if not _ZETAS[0] < values[d] / critical < _ZETAS[1]:
            notes.append(
                f"{name}: the search ran off to {number(values[d])} N m s/rad; damping ratio {_ZETA:g} assumed"
            )
            values[d] = float(_ZETA * critical)
    return values, tuple(notes)
