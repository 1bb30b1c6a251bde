"""Ripple of the motors that is louder than motors usually have: named where the data need it."""

import functools
from collections.abc import Mapping

import numpy as np

from ..._text import NORMAL_95
from ..._threads import lapack_threads, shared
from ...effects import AbstractEffect
from ...effects._harmonics import polar_deviation
from ...robot import Robot
from ...trajectory.measured import Measured
from ...trajectory.ripple import Order, kind_of, ripple_effects
from ..result import EstimatedValue, Named
from ..settings import LEAST_SIZE
from .fitted import Fitted, is_loud
from .judge import Comparison, Written, against_it, compared, written


def loud_ripple(
    last: Fitted, extended: Written, there: Written | None, deciding: Measured, judged: Measured
) -> tuple[Named, ...]:
    """Ripple that is more than motors have, and without which more is beyond the floor on positions that chose nothing,
    `deciding`; `there`: the robot on these."""
    if there is None:
        return ()
    robot = last.robot
    loud = [(o, w) for o, w in last.waves if is_loud(robot, o, w)]
    effects = ripple_effects(robot.axis_names, [o for o, _ in loud], np.array([w for _, w in loud]).reshape(-1, 2))
    shows = lambda effect: _loudness(effect, robot) >= LEAST_SIZE and not holds_no_ripple(_told_waves(effect, last))
    found = []
    for effect in filter(shows, effects):
        quiet = _quiet(last, (type(effect), str(effect.joint)))
        before, heldout = shared(functools.partial(written, quiet), (deciding, judged), lapack_threads())
        if before is None or heldout is None:
            continue
        against = against_it(deciding, before, there, str(effect.joint))
        if not against and not against_it(judged, heldout, extended, str(effect.joint)):
            floor, frequency = before.evidence.plain, deciding.frequency
            found.append(_ripple(effect, last, compared(before.residual, there.residual, floor, frequency)))
    return tuple(found)


def without_ripple(last: Fitted, louder, extended: Written, judged: Measured) -> Written | None:
    """The robot as it would be written without the ripple that is named."""
    names = {(type(x.effect), x.joint) for x in louder}
    if not names:
        return extended
    return written(last.written(lambda o, w: _ripple_of(last.robot, o) in names), judged)


def _quiet(last: Fitted, own: tuple[type[AbstractEffect], str]) -> Robot:
    """The robot as it would be written without the loud ripple of one motor."""
    return last.written(lambda o, w: _ripple_of(last.robot, o) == own and is_loud(last.robot, o, w))


def _ripple(effect, last: Fitted, gain: Comparison) -> Named:
    visible = _loudness(effect, last.robot)
    p_value = last.wave_p_value(kind_of(effect), last.robot.axis_names.index(effect.joint))
    explains = float(np.clip(gain.gain, 0.0, 1.0))
    return Named(effect, effect.joint, _told_waves(effect, last), max(p_value, gain.p_value), (), "", explains, visible)


def _told_waves(effect, last: Fitted) -> dict[str, EstimatedValue]:
    """Amplitudes, orders and phases of ripple with their intervals."""
    return stated_waves(effect, last.wave_covariance(kind_of(effect), last.robot.axis_names.index(effect.joint)))


def holds_no_ripple(waves: Mapping[str, EstimatedValue]) -> bool:
    """Whether the interval of every order's amplitude holds nothing: neighbours that only together explain anything,
    where a motor hardly turns."""
    amplitudes = [value for name, value in waves.items() if name.startswith("amplitude")]
    return all(a.value < NORMAL_95 * a.std for a in amplitudes)


def stated_waves(effect, covariance: Mapping[float, np.ndarray] | None = None) -> dict[str, EstimatedValue]:
    """Amplitudes, orders and phases of ripple. `covariance`: of the coefficients of sine and cosine, by order; without
    it intervals are not known."""
    values = {}
    for name in ("amplitude", "teeth", "order", "phase"):
        row = np.ravel(np.asarray(getattr(effect, name, []), float))
        for i, value in enumerate(row):
            place = name if len(row) == 1 else f"{name}_{i + 1}"
            known = (covariance or {}).get(float(effect.order[i])) if name in ("amplitude", "phase") else None
            std = float("nan") if known is None else polar_deviation(effect.amplitude[i], effect.phase[i], known)[name]
            values[place] = EstimatedValue(float(value), std, effect.units[name])
    return values


def _loudness(effect, robot: Robot) -> float:
    """Largest amplitude over the just visible one."""
    typical = type(effect).typical(robot, effect.joint)
    return float(np.max(np.asarray(effect.amplitude)) / np.max(np.asarray(typical.amplitude)))


def _ripple_of(robot: Robot, order: Order) -> tuple[type[AbstractEffect], str]:
    """Class and joint of the effect that an order of ripple is part of."""
    (effect,) = ripple_effects(robot.axis_names, [order], np.ones((1, 2)))
    return type(effect), str(effect.joint)
