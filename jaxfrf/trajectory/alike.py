"""Robots made alike, so that all of them share what is compiled: effects that many of them have, and orders of ripple,
are no part of a program then."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..effects import (
    AbstractActuator,
    ResolverRipple,
    TorqueConstant,
    TorqueRipple,
)
from ..effects._harmonics import LARGEST_ORDER
from ..effects._place import axis_of
from ..robot import Robot
from .ripple import RIPPLE, Order, Wave, kind_of, ripple_effects, with_ripple

_ROOM = {TorqueRipple: 8, ResolverRipple: 4}  # orders of a motor, or a multiple of so many


class _AnyTorqueRipple(TorqueRipple):
    """Ripple whose orders are no part of a program."""

    order: Float[np.ndarray, "order"]  # type: ignore[assignment]

    def __init__(self, joint, amplitude, order, phase):
        self.joint, self.amplitude, self.order, self.phase = joint, amplitude, order, phase


class _AnyResolverRipple(ResolverRipple):
    """The same of a resolver."""

    order: Float[np.ndarray, "order"]  # type: ignore[assignment]

    def __init__(self, joint, amplitude, order, phase):
        self.joint, self.amplitude, self.order, self.phase = joint, amplitude, order, phase


_ANY = {TorqueRipple: _AnyTorqueRipple, ResolverRipple: _AnyResolverRipple}


def alike(robot: Robot, waves: Sequence[Wave] = ()) -> Robot:
    """The robot with this ripple beside its own: its numbers as arrays, an error of every torque constant, of nothing
    where it states none, and room for ripple of every motor."""
    constants = {axis_of(robot, e.joint): e for e in robot.effects if isinstance(e, TorqueConstant)}
    if _clips_behind(robot):  # in another order it is another drive
        return jax.tree.map(lambda x: jnp.asarray(x, jnp.asarray(x).dtype), with_ripple(robot, waves))
    more = [constants.get(axis, TorqueConstant(name, 0.0)) for axis, name in enumerate(robot.axis_names)]
    others = tuple(e for e in robot.effects if not any(e is c for c in constants.values()))
    robot = dataclasses.replace(robot, effects=others).with_effects(*more, *_any_ripple(robot.axis_names, waves))
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.asarray(x).dtype), robot)


def _any_ripple(names: Sequence[str], waves: Sequence[Wave]):
    """As `with_ripple`, the orders of every motor in as many places."""
    made = [e for e in ripple_effects(names, *_apart(waves)) if isinstance(e, TorqueRipple | ResolverRipple)]
    found: dict[tuple[type, str], TorqueRipple | ResolverRipple] = {(type(e), str(e.joint)): e for e in made}
    more = []
    for kind, room in _ROOM.items():
        most = max((len(e.order) for (k, _), e in found.items() if k is kind), default=1)
        count = room * -(-most // room)
        for joint in names:
            amplitude, order, phase = np.zeros(count), np.ones(count), np.zeros(count)
            own = found.get((kind, joint))
            if own is not None:
                some = slice(len(own.order))
                amplitude[some], order[some], phase[some] = own.amplitude, own.order, own.phase
            more.append(_ANY[kind](joint, amplitude, order, phase))
    return more


def _clips_behind(robot: Robot) -> bool:
    """Whether behind an error of a drive's torque constant there is an effect that is not the same before it."""
    gains: set[int] = set()
    for effect in robot.effects:
        if isinstance(effect, TorqueConstant):
            gains.add(axis_of(robot, effect.joint))
        elif isinstance(effect, AbstractActuator) and not effect.is_linear:
            if axis_of(robot, effect.joint) in gains:
                return True
    return False


def _apart(waves: Sequence[Wave]):
    return [o for o, _ in waves], np.array([w for _, w in waves]).reshape(-1, 2)


def alike_as_written(robot: Robot) -> Robot:
    """The same, of a robot whose ripple stands in it already, where every motor's stands once."""
    own = [e for e in robot.effects if isinstance(e, TorqueRipple | ResolverRipple)]
    once = len({(type(e), axis_of(robot, e.joint)) for e in own}) == len(own)
    plain = all(type(e) in RIPPLE.values() and max(e.order) <= LARGEST_ORDER for e in own)
    if not (once and plain):
        return alike(robot)
    waves = [
        (Order(kind_of(e), axis_of(robot, e.joint), float(h)), (float(a * np.cos(p)), float(a * np.sin(p))))
        for e in own
        for a, h, p in zip(np.asarray(e.amplitude), e.order, np.asarray(e.phase), strict=True)
    ]
    return alike(
        dataclasses.replace(robot, effects=tuple(e for e in robot.effects if not any(e is o for o in own))), waves
    )
