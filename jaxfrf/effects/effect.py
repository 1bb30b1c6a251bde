"""What an effect is, and what it says of itself: where a search for it begins, what is tried, what its parameters are.

An effect is one module: the truth in a simulation and the candidate in a diagnosis are the same object. Its base class
(`insertion.py`) is its point of insertion.
"""

import abc
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from .._types import Array
from ._place import axis_of

if TYPE_CHECKING:
    from ..robot import Robot

Signal = Float[Array, "*run"]
Joint = int | str


class Reach(eqx.Module):
    """How far a record moves one joint.

    **Fields:** `speed`: the largest of its motor, rad/s. `travel`: range of the motor's angle, rad. `torque`: the
    largest command, N m.
    """

    speed: float = eqx.field(static=True)
    travel: float = eqx.field(static=True)
    torque: float = eqx.field(static=True)


class Swing(eqx.Module):
    """How far a record moves one place of a machine.

    **Fields:** `deflection`, `speed`: rms, rad and rad/s or m and m/s. `force`: N m or N, at which an effect there is
    just visible. `turn`: speed within which friction may change its sign. `sprung`: whether the machine has a spring
    there.
    """

    deflection: float = eqx.field(static=True)
    speed: float = eqx.field(static=True)
    force: float = eqx.field(static=True)
    turn: float = eqx.field(static=True)
    sprung: bool = eqx.field(static=True)


class AbstractEffect(eqx.Module):
    """One effect on one joint.

    **Class attributes:**

    - `name`: as files and reports call it.
    - `units`: of every parameter. `bounds`: lowest and highest plausible value of every parameter, which also say
      its allowed sign.
    - `signature`: what it does to data. `confusable`: names of effects that look alike, each with what separates
      the two.
    - `shapes`: parameters that say how a law turns over, which no diagnosis tells a value of.
    - `nothing`: value of the first parameter with which it is none. `grows`: whether it is more where that is larger.
    - `alike`: names of effects that most data cannot tell from it. `same_law`: names of effects with its law, which
      are told apart by their joint.
    - `imitated_by`: kinds of the joint's own numbers that imitate it, so that a fit alone tells it (`starts`).
    - `is_error`: whether it is no term of its own, but an error of one number that every robot has.
    - `untold`: question to ask where that number is wrong, and this, forgotten, would have made it so; or "".
    - `drive_number`: kind of the number of every drive that its first parameter is (`torque_constant`), or "".
    - `differentiable`: whether a fit can move its parameters.

    `joint` is a driven joint's name, or its number counted from 0; "" where the effect has none. A joint that the robot
    does not have, or that has no motor, is refused in `with_effects` (`jaxfrf.InputError`).
    """

    name: ClassVar[str]
    units: ClassVar[dict[str, str]]
    bounds: ClassVar[dict[str, tuple[float, float]]]
    signature: ClassVar[str]
    confusable: ClassVar[dict[str, str]]
    shapes: ClassVar[tuple[str, ...]] = ("smoothing",)
    nothing: ClassVar[float] = 0.0
    grows: ClassVar[bool] = True
    alike: ClassVar[tuple[str, ...]] = ()
    same_law: ClassVar[tuple[str, ...]] = ()
    imitated_by: ClassVar[tuple[str, ...]] = ()
    is_error: ClassVar[bool] = False
    untold: ClassVar[str] = ""
    drive_number: ClassVar[str] = ""
    differentiable: ClassVar[bool] = True

    joint: eqx.AbstractVar[Joint]

    @classmethod
    @abc.abstractmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        """The effect on this joint of this robot at a magnitude that is just visible: where a search starts."""

    @classmethod
    def plausible(cls, robot: "Robot", joint: Joint) -> tuple[float, float]:
        """Lowest and highest value of the first parameter on this joint of this robot; by default its `bounds`."""
        return cls.bounds.get(next(iter(cls.units)), (-math.inf, math.inf))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple["Candidate", ...]:
        """What a diagnosis tries of the effect on this joint: by default one, linear in the first parameter.

        A class says it itself where a parameter enters nonlinearly (a knee, a width: one candidate for each of some
        values), and where it is found otherwise, (). Without a direction, where the first parameter is no single number
        or typically zero, there is none by default.

        **Arguments:** `largest`: command of the joint's motor in the record, N m.

        **Raises:** `jaxfrf.InputError` where the joint cannot have the effect.
        """
        typical = cls.typical(robot, joint)
        robot.with_effects(typical)
        value = np.asarray(getattr(typical, next(iter(cls.units))))
        if value.size != 1 or not np.all(value):
            return ()
        return (typical.candidate(*cls.plausible(robot, joint)),)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple["Candidate", ...]:
        """What is tried of the effect where a measured motion is compared: by default its `candidates`.

        A class says it itself where what is tried hangs on how far the record reaches.

        **Raises:** `jaxfrf.InputError` where the joint cannot have the effect, or such a comparison cannot see it.
        """
        return cls.candidates(robot, joint, reach.torque)

    @property
    def believable(self) -> bool:
        """Whether fitted parameters are still what the effect is called; by default they always are."""
        return True

    @classmethod
    def over_band(cls, robot: "Robot", joint: Joint, low: float, high: float) -> tuple["Candidate", ...]:
        """What is tried of the effect on an FRF from `low` to `high`, Hz: by default its `candidates`.

        A class says it itself where the fit of a mode needs several starts. **Raises:** as `along_motion`.
        """
        return cls.candidates(robot, joint, math.inf)

    def candidate(self, low: float, high: float, variant: str = "") -> "Candidate":
        """This effect, linear in its first parameter from `low` to `high`: a coefficient counts its value here."""
        first = next(iter(self.units))
        value = float(np.asarray(getattr(self, first)).item())
        bounds = sorted((low / value, high / value))
        make = functools.partial(_times, self, first, value)
        return Candidate(self.name, str(self.joint), (self,), make, (bounds[0],), (bounds[1],), 1.0, variant)

    def own_numbers(self, robot: "Robot") -> tuple["OwnNumber", ...]:
        """What this effect's parameters are among the numbers of a robot that has it; `robot`: the one without.

        By default numbers of its own, one for each parameter that is a plain number; none for waves, whose amplitudes
        and phases belong together."""
        if hasattr(self, "amplitude"):
            return ()
        joint = robot.axis_names[axis_of(robot, self.joint)]
        fitted = [p for p in self.units if p not in self.shapes and np.ndim(getattr(self, p)) == 0]
        return tuple(OwnNumber(f"{joint}.{self.name}.{p}", p) for p in fitted)

    @classmethod
    def in_drive(cls, joint: Joint, value: float, had: Sequence[Self]) -> Self | None:
        """What stands in a drive whose `drive_number` has this value, in the place of those of the kind that it `had`;
        by default the effect, `None` where the value is 0."""
        return None if value == 0.0 else cls(joint, jnp.asarray(value, float))  # type: ignore[call-arg]

    @classmethod
    def of_swing(cls, place: str, swing: Swing) -> Self | None:
        """The effect at a place of a machine of one's own, just visible: where a search starts; by default `None`, it
        is not looked for there."""
        return None

    def against(self, x: Signal, v: Signal, stiffness: Signal, smoothing: float) -> Signal:
        """Force against the motion at a place of a machine of one's own, beside its matrices (`jaxfrf.machine.force`).

        **Raises:** `jaxfrf.InputError`, by default: effects of gears, sensors and drives need a robot.
        """
        raise input_error(
            "effects",
            type(self).__name__,
            "friction, springs, play, or a torque by angle or speed",
            "Effects of gears, sensors and drives need a robot.",
        )

    @classmethod
    def of_readings(cls, joint: Joint, count: float) -> Self | None:
        """The effect whose readings move in whole counts, rad; by default `None`: they do not."""
        return None

    def fitted_beside(self, robot: "Robot", values: Mapping[str, float]) -> "AbstractEffect":
        """The effect beside a robot's numbers, by name, that were fitted with it; `robot`: the one without. By default
        itself: its parameters say all."""
        return self

    def in_numbers(self) -> "AbstractEffect":
        """The same effect, its parameters as plain numbers that a fit can move."""
        return self

    def stated(self) -> "AbstractEffect":
        """The same effect as a robot's file states it; the inverse of `in_numbers`."""
        return self

    def stated_values(
        self, parameters: Sequence[str], covariance: Float[np.ndarray, "parameter parameter"]
    ) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of every parameter of what is `stated`, to first order, from the covariance of
        these parameters; first the one that says how much of the effect there is."""
        stds = np.sqrt(np.diag(covariance))
        return {p: (float(getattr(self, p)), float(std)) for p, std in zip(parameters, stds, strict=True)}

    @classmethod
    def starts(cls, robot: "Robot", fitted: "Robot", joint: Joint) -> "tuple[Self, ...]":
        """Further ones from which a fit begins, beside the one that a residual proposes; the numbers of the joint that
        imitate it begin as they were given, as in `robot`. What numbers imitate, a fit does not find from where they
        stand in its place, as in `fitted`."""
        return ()

    def elsewhere(self, robot: "Robot") -> "tuple[Self, ...]":
        """The same law with other parameters, which do nearly what this one does, and at which a fit that ended here
        begins again: where its cost has several minima."""
        return ()

    def unknown_beside(self, robot: "Robot") -> dict[str, float]:
        """Numbers of a robot that has it of which little is known then, with their relative standard deviations."""
        return {}

    def redefines(self, robot: "Robot") -> tuple[str, ...]:
        """Numbers of a robot that mean something else once it has the effect: how far they are off says nothing."""
        return ()

    def check(self, robot: "Robot") -> None:
        """**Raises:** `jaxfrf.InputError` where the effect cannot act on its joint of this robot."""
        axis_of(robot, self.joint)


def _times(effect, first: str, value: float, c):
    return eqx.tree_at(lambda e: getattr(e, first), effect, float(value * c[0]))


class Candidate(eqx.Module):
    """An effect that may be missing, linear in a few unknowns.

    **Fields:** `name`, `joint`: of the effect. `basis`: effects whose signatures are the columns. `make`: the effect of
    coefficients, one for each column. `low`, `high`: bounds of the coefficients. `visible`: first coefficient of the
    effect that is just visible. `variant`: what tells it from others of the same effect and joint. `start`: of a fit
    of coefficients that the effect is not linear in, one for each; () where it is.
    """

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    basis: tuple[AbstractEffect, ...]
    make: Callable[[np.ndarray], AbstractEffect] = eqx.field(static=True)
    low: tuple[float, ...] = eqx.field(static=True)
    high: tuple[float, ...] = eqx.field(static=True)
    visible: float = eqx.field(static=True, default=1.0)
    variant: str = eqx.field(static=True, default="")
    start: tuple[float, ...] = ()

    @property
    def key(self) -> tuple[str, str]:
        return self.name, self.joint


class OwnNumber(eqx.Module):
    """A parameter of an effect as a number of the robot that has it: parameter = number - `minus`.

    **Fields:** `number`: its name in the robot. `parameter`: its name in the effect. `minus`: in the number's unit.
    `known`: relative standard deviation of where a fit of it begins.
    """

    number: str = eqx.field(static=True)
    parameter: str = eqx.field(static=True)
    minus: float = eqx.field(static=True, default=0.0)
    known: float = eqx.field(static=True, default=math.inf)
