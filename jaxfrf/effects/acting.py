"""The effects of a robot put to work: those of one kind on several joints are computed together."""

import dataclasses
from typing import TYPE_CHECKING, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._types import arrays
from ._place import axis_of
from .effect import AbstractEffect

if TYPE_CHECKING:
    from ..robot import Robot

Kind = TypeVar("Kind", bound=AbstractEffect)


class Group(eqx.Module, Generic[Kind]):
    """Effects of one class, their parameters stacked along a first axis, and the axes that they act on."""

    effects: Kind
    axes: tuple[int, ...] = eqx.field(static=True)
    n_axes: int = eqx.field(static=True)

    def __call__(self, law, *signals):
        """`law(effect, *signals of its axis)` of all effects, from signals (axis, ...); (effect, ...)."""
        return jax.vmap(law)(self.effects, *(self.pick(x) for x in signals))

    def pick(self, rows):
        return rows if self.axes == tuple(range(self.n_axes)) else rows[np.array(self.axes)]

    def added(self, rows, values):
        """`rows` (axis, ...) with values (effect, ...) added on the axes of the effects."""
        return rows + values if self.axes == tuple(range(self.n_axes)) else rows + self._spread(values)

    def replaced(self, rows, values):
        """`rows` with those of the effects' axes replaced."""
        if self.axes == tuple(range(self.n_axes)):
            return values
        here = np.zeros(self.n_axes, bool)
        here[list(self.axes)] = True
        return jnp.where(here.reshape(-1, *[1] * (rows.ndim - 1)), self._spread(values), rows)

    def _spread(self, values):
        """Values at their axes, zero elsewhere: a stack of rows, not a scatter, which is slow in loops."""
        zero = jnp.zeros_like(values[0])
        return jnp.stack([values[self.axes.index(i)] if i in self.axes else zero for i in range(self.n_axes)])


def groups(robot: "Robot", kind: type[Kind]) -> tuple[Group[Kind], ...]:
    """The robot's effects of this kind, in the order in which they were added; two on one axis stand in two groups."""
    found: list[tuple[object, list[AbstractEffect], list[int]]] = []
    for effect in robot.effects:
        if not isinstance(effect, kind):
            continue
        axis, alike = axis_of(robot, effect.joint), _likeness(effect)
        for key, effects, axes in found:
            if key == alike and axis not in axes:
                effects.append(effect)
                axes.append(axis)
                break
        else:
            found.append((alike, [effect], [axis]))
    return tuple(_group(effects, axes, robot.n_axes) for _, effects, axes in found)


def _anywhere(effect):
    """The same effect without its joint, so that effects on different joints have one structure."""
    anywhere = object.__new__(type(effect))
    for field in dataclasses.fields(effect):
        object.__setattr__(anywhere, field.name, 0 if field.name == "joint" else getattr(effect, field.name))
    return arrays(anywhere)


def _likeness(effect):
    plain = _anywhere(effect)
    return type(effect), jax.tree.structure(plain), tuple(jnp.shape(x) for x in jax.tree.leaves(plain))


def _group(effects, axes, n_axes: int) -> Group:
    order = np.argsort(axes)
    plain = [_anywhere(effects[i]) for i in order]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *plain)
    return Group(stacked, tuple(int(axes[i]) for i in order), n_axes)
