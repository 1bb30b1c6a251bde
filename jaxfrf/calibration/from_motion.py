"""Robots with rigid transmissions from any motion: the torque that it needs, as a function of all uncertain numbers."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from ..effects import AbstractEffect, AbstractGearCoupling, Payload, library
from ..experiment import Experiment
from ..robot import Friction, Robot
from ..robot.equations import arm_angles
from ..robot.regressor import link_parameters, link_regressor
from ..trajectory.evidence import Gram
from ..trajectory.rigid_motion import MeasuredMotion, check_rigid, chosen_cutoff, measured_motions, thinned
from ..trajectory.wiring import LOST, miswired
from .columns import OF_LINKS, link_slopes
from .heldout import heldout_numbers
from .least_squares import Posterior, solve
from .numbers import Number, numbers, with_numbers
from .result import Calibration, Round

_BLOCKS = 20  # of all records together, at least two of each: what their scatter is seen from
_LONGEST = 0.7  # of a logarithm, in one step
_CONVERGED = 0.05  # of its standard deviation that every number moves less


class Rows(eqx.Module):
    """One record, filtered and thinned.

    **Fields:** `links`: torque of every motor for each parameter of every link, (row, axis, link parameter);
    `acceleration`, `torque`: (row, axis), motor side; `motion`: every sample, for what is not linear in it. `carried`:
    what a payload adds to the links' parameters.
    """

    links: Float[np.ndarray, "row axis parameter"]
    speed: Float[np.ndarray, "row axis"]
    acceleration: Float[np.ndarray, "row axis"]
    torque: Float[np.ndarray, "row axis"]
    motion: MeasuredMotion
    carried: Float[np.ndarray, "parameter"]


def _is_known(kind: type[AbstractEffect]) -> bool:
    """Whether the needed torque has it: what a drive's numbers stand for, and gears that turn each other's."""
    return bool(kind.drive_number) or issubclass(kind, AbstractGearCoupling)


def _check_effects(robot: Robot) -> None:
    """Refuse effects that are in no inverse dynamics here."""
    left_out = [e for e in robot.effects if not _is_known(type(e))]
    if left_out:
        known = sorted(kind.name for kind in library().values() if _is_known(kind))
        raise input_error(
            f"effects of {robot.name}",
            f"{', '.join(e.name for e in left_out)} of a robot with rigid transmissions",
            ", ".join(known),
            "Leave them out here; `jaxfrf diagnose` looks for the others.",
        )


def calibrate_from_motion(
    robot: Robot,
    records: Sequence[Experiment],
    payloads: Sequence[Payload | None],
    heldout: Sequence[int],
    rounds: int,
    cutoff: float | None,
    say,
) -> Calibration:
    """As `calibrate`, for a robot with rigid transmissions: the torque of the measured motion against the measured one.

    Both sides go through the same filters, so that these bias neither (Gautier, Janot & Vandanjon, IEEE Trans. Control
    Syst. Technol. 21, 2013). Every motor's torque may have an offset. Intervals come from the scatter of stretches of
    the records.
    """
    check_rigid(robot)
    _check_effects(robot)
    held = heldout_numbers(heldout, sum(record.n_pos for record in records))
    largest = np.max([np.abs(np.asarray(record.u)).max(axis=(0, 1, 2)) for record in records], axis=0)
    uncertain = numbers(robot, offset_size=0.05 * largest)
    # Filters that have no phase would hide a delay, and how much motors of a wrist turn each other is exact.
    uncertain = tuple(number for number in uncertain if number.kind != "delay" and not number.of_effect)
    rows: list[Rows] = []
    owner: list[int] = []
    for record, payload in zip(records, payloads, strict=True):
        motions = measured_motions(robot, record, chosen_cutoff(record) if cutoff is None else float(cutoff))
        owner += (np.repeat(np.arange(record.n_pos), record.n_exp) + 1 + max(owner, default=-1)).tolist()
        rows += [thinned_rows(robot, motion, payload) for motion in motions]
    judge = np.isin(owner, held)
    fitted = [r for r, h in zip(rows, judge, strict=True) if not h]
    judged = [r for r, h in zip(rows, judge, strict=True) if h]
    x, scale = np.zeros(len(uncertain)), np.sqrt(_by_axis(fitted, lambda r: r.torque))
    done: list[Round] = []
    converged = False
    while len(done) < rounds and not converged:
        left = [r.torque - needed(robot, uncertain, x, r) for r in fitted]
        gram = _gram(robot, uncertain, x, fitted, left, scale)
        posterior = solve(gram, uncertain, x)
        step = posterior.change
        longest = max((abs(n.size * s) for n, s in zip(uncertain, step, strict=True) if n.positive), default=0.0)
        part = min(1.0, _LONGEST / longest) if longest > 0 else 1.0
        std = np.sqrt(np.diag(posterior.covariance))
        converged = bool(np.all(np.abs(step) < _CONVERGED * std))
        before = _square(left, scale)
        x = x + part * step
        left = [r.torque - needed(robot, uncertain, x, r) for r in fitted]
        scale = np.sqrt(_mean_square(left))
        done.append(Round(before, _square(left, scale), posterior.effect))
        say(f"round {len(done)}: torque missed {100 * _all(fitted, left):.3g} %")
    return _result(robot, uncertain, x, posterior, done, converged, fitted, judged, records)


def thinned_rows(robot: Robot, motion: MeasuredMotion, payload: Payload | None) -> Rows:
    """A motion as the torque that it needs is computed from it."""
    out = np.asarray(arm_angles(robot, jnp.eye(robot.n_axes))).T  # arm = out @ motor
    joints = np.zeros((3, robot.chain.n_joints, len(motion.angle)))
    driven = np.array(robot.driven_joints)
    for k, signal in enumerate((motion.angle, motion.speed, motion.acceleration)):
        joints[k, driven] = out @ signal.T
    Y = link_regressor(robot.chain, *joints)[driven].reshape(len(driven), -1, joints.shape[-1])
    links = np.stack([thinned(motion, np.moveaxis(out.T @ Y[:, k], 0, -1)) for k in range(Y.shape[1])], axis=-1)
    thin = lambda signal: thinned(motion, signal)
    own = _parameters_of(robot)
    carried = np.zeros_like(own) if payload is None else _parameters_of(robot.with_effects(payload)) - own
    return Rows(links, thin(motion.speed), thin(motion.acceleration), thin(motion.torque), motion, carried)


def _parameters_of(robot: Robot) -> Float[np.ndarray, "parameter"]:
    """Of all links, in which the torques are linear."""
    links = (np.asarray(getattr(robot.chain, kind)) for kind in OF_LINKS)
    return np.concatenate([link_parameters(*link) for link in zip(*links, strict=True)])


def needed(robot: Robot, numbers: Sequence[Number], x, rows: Rows) -> Float[np.ndarray, "row axis"]:
    """Torque command that the robot needs at these numbers."""
    now = with_numbers(robot, numbers, x)
    drives = now.drives
    torque = rows.links @ (_parameters_of(now) + rows.carried) + np.asarray(drives.motor_inertia) * rows.acceleration
    torque = torque + thinned(rows.motion, np.asarray(drives.friction.torque(rows.motion.speed)))
    return (torque + _offsets(now, numbers, x)) / _gains(now, numbers, x)


def _offsets(robot: Robot, numbers, x):
    return _of_axes(robot, numbers, x, "torque_offset", 0.0)


def _gains(robot: Robot, numbers, x):
    return 1.0 + _of_axes(robot, numbers, x, "torque_constant", 0.0)


def _of_axes(robot: Robot, numbers, x, kind: str, otherwise: float):
    values = np.full(robot.n_axes, otherwise)
    for number, at in zip(numbers, x, strict=True):
        if number.kind == kind:
            values[robot.axis_names.index(number.joint)] = number.value(float(at))
    return values


def _law(robot: Robot) -> Friction:
    law = robot.drives.friction
    if not isinstance(law, Friction):
        raise input_error(
            f"{robot.name}: friction",
            type(law).__name__,
            "viscous and Coulomb friction (jaxfrf.robot.Friction)",
            "Give the drives that law; a level of 0 takes a part of it out.",
        )
    return law


def torque_slopes(robot: Robot, numbers: Sequence[Number], x, rows: Rows) -> Float[np.ndarray, "row axis number"]:
    """Derivatives of the needed torque by x."""
    now = with_numbers(robot, numbers, x)
    friction, speed = _law(now), rows.motion.speed
    corner, level = float(friction.smoothing), np.asarray(friction.coulomb)
    gain, own = _gains(robot, numbers, x), needed(robot, numbers, x, rows)
    sign = thinned(rows.motion, np.tanh(speed / corner))
    found = np.zeros((*rows.torque.shape, len(numbers)))
    links = [i for i, number in enumerate(numbers) if number.kind in OF_LINKS]
    slopes = link_slopes(now, [numbers[i] for i in links], np.asarray(x, float)[links])
    found[..., links] = rows.links @ slopes.reshape(len(links), rows.links.shape[-1]).T
    for i, (number, at) in enumerate(zip(numbers, x, strict=True)):
        by = number.size * (number.value(float(at)) if number.positive else 1.0)
        if number.kind in OF_LINKS:
            continue
        if number.kind == "smoothing":
            bend = 1.0 - np.tanh(speed / corner) ** 2
            found[..., i] = thinned(rows.motion, -level * speed / corner**2 * bend) * by
        elif number.kind == "torque_constant":
            axis = robot.axis_names.index(number.joint)
            found[:, axis, i] = -own[:, axis] * by
        else:
            axis = robot.axis_names.index(number.joint)
            signals = {
                "motor_inertia": rows.acceleration,
                "viscous_friction": rows.speed,
                "coulomb_friction": sign,
                "torque_offset": np.ones_like(sign),
            }
            found[:, axis, i] = signals[number.kind][:, axis] * by
    return found / gain[:, None]


def _gram(robot: Robot, numbers, x, records: Sequence[Rows], left, scale) -> Gram:
    """Products of slopes and residuals of every stretch."""
    each = max(2, -(-_BLOCKS // len(records)))
    A, b, rr = [], [], []
    for rows, rest in zip(records, left, strict=True):
        J = (torque_slopes(robot, numbers, x, rows) / scale[:, None]).reshape(len(rest), -1, len(numbers))
        r = rest / scale
        for part in np.array_split(np.arange(len(r)), each):
            columns, residual = J[part].reshape(-1, len(numbers)), r[part].ravel()
            A.append(columns.T @ columns)
            b.append(columns.T @ residual)
            rr.append(residual @ residual)
    return Gram(np.array(A), np.array(b), np.array(rr), np.arange(len(A)), int(left[0].size // each))


def _result(robot, numbers, x, posterior: Posterior, done, converged, fitted, judged, records) -> Calibration:
    zero = np.zeros(len(numbers))
    before, after = (_missed(robot, numbers, at, fitted) for at in (zero, x))
    lost = np.max(before) > LOST and np.max(after) > LOST
    return Calibration(
        given=robot,
        robot=with_numbers(robot, numbers, x),
        numbers=tuple(numbers),
        x=x,
        covariance=posterior.covariance,
        half_width=posterior.half_width(),
        data_share=posterior.data_share,
        dependence=np.linalg.inv(posterior.normal),
        orders=(),
        waves=np.zeros((0, 2)),
        rounds=tuple(done),
        converged=converged,
        missed_before=before,
        missed_after=after,
        heldout=(_missed(robot, numbers, zero, judged), _missed(robot, numbers, x, judged)) if judged else None,
        compared="by the torque that the model needs for the measured motion: its transmissions are rigid",
        sources=tuple(source for record in records for source in record.sources),
        hints=_hints(robot, numbers, fitted) if lost else (),
    )


def _hints(robot: Robot, numbers, records: Sequence[Rows]) -> tuple[str, ...]:
    """What torques as measured and as the robot as given needs them say of a record's wiring."""
    as_given = np.concatenate([needed(robot, numbers, np.zeros(len(numbers)), r) for r in records])
    pair = (np.concatenate([r.torque for r in records]), as_given)
    return miswired(robot, *(x - x.mean(axis=0) for x in pair))


def _missed(robot: Robot, numbers, x, records: Sequence[Rows]) -> Float[np.ndarray, "axis"]:
    left = [r.torque - needed(robot, numbers, x, r) for r in records]
    return np.sqrt(_mean_square(left) / _by_axis(records, lambda r: r.torque))


def _by_axis(records: Sequence[Rows], signal) -> Float[np.ndarray, "axis"]:
    """Mean square about the mean."""
    whole = np.concatenate([signal(r) for r in records])
    return np.var(whole, axis=0)


def _mean_square(left) -> Float[np.ndarray, "axis"]:
    return np.mean(np.concatenate(left) ** 2, axis=0)


def _square(left, scale) -> float:
    return float(np.mean((np.concatenate(left) / scale) ** 2))


def _all(records: Sequence[Rows], left) -> float:
    """Of all torques together, rms."""
    return float(np.sqrt(np.sum(np.concatenate(left) ** 2) / np.sum(np.concatenate([r.torque for r in records]) ** 2)))
