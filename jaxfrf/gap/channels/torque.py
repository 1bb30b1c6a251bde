"""The torque that a rigid robot needs for the measured motion, against the measured one (inverse dynamics).

For records that are no multisine, or whose reference or controller is not known. It sees what changes the *torque*
(friction, static torque, ripple, delay) and nothing of springs; it is the weaker comparison of two, for feedback
carries the noise of the position into the torque.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...effects import Reach
from ...experiment import Experiment
from ...robot import Robot, parameters
from ...robot.equations import arm_angles
from ...trajectory.needed_torque import added_torque, check_one_motor_a_joint, needed_torque
from ...trajectory.rigid_motion import COMPARED, MeasuredMotion, chosen_cutoff, measured_motions, thinned, thinned_rate
from ..result import Cell
from ..settings import LEVEL, OFF, SMALLEST, STRETCHES, TORQUE, WORTH
from ..significance import block_length, projector
from .channel import Outcome, Rows, State
from .giving import GivingNumbers, giving_numbers
from .records import AbstractRecords, reaches, rows_of, stretches

_BINS = 24  # of a course
_TURN = 0.02  # of the largest speed, within which a sign turns over as a feature


class TorqueChannel(AbstractRecords):
    """Torques of robots with rigid transmissions over the rms torque of their axis.

    The motion is filtered without phase and differentiated; torques of both sides go through the same filter. It fails
    where flexible modes within the filter's band dominate the motion, and where the torque came from feedback of a
    noisy position (the derivatives' noise then correlates with it). A payload is biased by as much as the last link's
    numbers give way for it.

    **Fields:** `motions`, `size`: of the torques, N m, (axis,). `cutoff`: of the motion's filter, Hz: 2.5 times the
    band in which y stands 10 dB above its noise floor; torques are compared up to a fifth of it. `giving`: the robot's
    numbers with a tolerance, which go before effects that look like them, to first order and within two tolerances;
    a channel of data that were held out takes them from the `fitted` one.
    """

    compared: ClassVar = "torque that the model needs for the measured motion (inverse dynamics): the weaker comparison"
    quantity: ClassVar = "torque residual"
    unit: ClassVar = "of the torque"
    tolerance: ClassVar = TORQUE
    smallest: ClassVar = SMALLEST

    robot: Robot
    motions: tuple[MeasuredMotion, ...]
    size: Float[np.ndarray, "axis"]
    measured: Rows
    group: Int[np.ndarray, "row"]
    fold: Int[np.ndarray, "row"]
    lengths: tuple[int, ...] = eqx.field(static=True)
    rate: float = eqx.field(static=True)
    feature: Float[np.ndarray, "sample feature"]
    reach: tuple[Reach, ...]
    giving: GivingNumbers
    fitted: "TorqueChannel | None" = None

    @classmethod
    def takes(cls, robot: Robot | None, data: Sequence[Any]) -> bool:
        records = all(isinstance(x, Experiment) and x.n_out == x.n_in for x in data)
        if robot is None or not records or robot.n_motors or robot.n_elastic:
            return False
        return any(not x.period for x in data)

    @classmethod
    def opened(cls, robot, data):
        check_one_motor_a_joint(robot)
        channel = cls._compared(robot, data, min(chosen_cutoff(x) for x in data))
        return dataclasses.replace(channel, giving=channel._priced()) if channel.giving.numbers else channel

    def of(self, data):
        other = self._compared(self.robot, data, self.motions[0].cutoff)
        return dataclasses.replace(other, fitted=self)

    def _priced(self) -> GivingNumbers:
        """A tolerance costs as much as noise that is alike for as long as what all numbers together leave."""
        state = State(self.robot, self.own())
        left = self.measured - self.predicted(state)
        left = projector(np.concatenate([super().slopes(state), self.giving.columns], axis=1))(left)
        alike = block_length(np.split(left.reshape(-1, self.n_axes), np.cumsum(self.lengths)[:-1]))
        return dataclasses.replace(self.giving, price=float(np.mean(left**2)) * alike)

    @classmethod
    def _compared(cls, robot: Robot, data, cutoff: float) -> "TorqueChannel":
        motions = tuple(m for x in data for m in measured_motions(robot, x, cutoff))
        torque = [thinned(m, m.torque) for m in motions]
        size = np.maximum(np.sqrt(np.mean(np.concatenate(torque) ** 2, axis=0)), 1e-300)
        reach = reaches(motions)
        turn = _TURN * np.array([x.speed for x in reach])
        turned = lambda m: np.concatenate([m.angle, m.speed, np.tanh(m.speed / turn), m.acceleration], axis=1)
        lengths = tuple(len(x) for x in torque)
        fold = stretches(lengths, max(-(-STRETCHES // len(motions)), 1))
        n = robot.n_axes
        return cls(
            robot=robot,
            motions=motions,
            size=size,
            measured=rows_of(torque, size),
            group=np.tile(np.arange(n), sum(lengths)),
            fold=np.repeat(fold, n),
            lengths=lengths,
            rate=thinned_rate(motions[0]),
            feature=np.concatenate([thinned(m, turned(m)) for m in motions]),
            reach=reach,
            giving=giving_numbers(robot, motions, size),
        )

    def own(self):
        """Motor inertia and viscous friction of every axis; others give way within their tolerances (`giving`)."""
        return {name: float(v) for name, v in parameters(self.robot, ("motor_inertia", "viscous_friction")).items()}

    def predicted(self, state):
        robot = state.robot()
        return self._rows([needed_torque(robot, m) for m in self.motions])

    def residual(self, state):
        return self._beside(state)[0]

    def _beside(self, state: State):
        """Residual and weight of rows beside numbers that give way, where those of what was fitted have not settled
        them."""
        left = self.measured - self.predicted(state)
        if not self.giving.numbers:
            return left, lambda rows: rows
        if self.fitted is not None:
            return left - self.giving.columns @ self.fitted.given_way(state.robot()), lambda rows: rows
        left, weight = self.giving.beside(left)
        return weight(left), weight

    def given_way(self, robot: Robot) -> Float[np.ndarray, "number"]:
        """How far the numbers of a robot give way, in tolerances."""
        return self.giving.at(self.measured - self._rows([needed_torque(robot, m) for m in self.motions]))

    def slopes(self, state):
        return self._beside(state)[1](super().slopes(state))

    def columns(self, state, candidates):
        weight, robot = self._beside(state)[1], state.robot()
        needed = [needed_torque(robot, m) for m in self.motions]
        more = lambda e: [added_torque(robot, e, m, x) for m, x in zip(self.motions, needed, strict=True)]
        return [weight(np.stack([self._rows(more(e)) for e in c.basis], axis=1)) for c in candidates]

    def _rows(self, torques: Sequence[Float[np.ndarray, "time axis"]]) -> Rows:
        return rows_of([thinned(m, x) for m, x in zip(self.motions, torques, strict=True)], self.size)

    def courses(self, robot, before, after):
        angle = lambda m: np.asarray(arm_angles(self.robot, jnp.asarray(m.angle)))
        signals = {"speed": lambda m: m.speed, "angle": angle, "load": lambda m: m.torque}
        sides = [x.reshape(-1, self.n_axes) * self.size for x in (before, after)]
        over = lambda f: np.concatenate([thinned(m, f(m)) for m in self.motions])
        return {name: _course(over(f), *sides) for name, f in signals.items()}

    def where(self, outcome: Outcome, cells: tuple[Cell, ...]):
        """Beside the largest cells, signatures that the rest goes with; the strongest of each axis."""
        told: list[Cell] = []
        names = list(_SIGNATURES)
        at = [(axis, name) for axis in range(self.n_axes) for name in names]
        tests = outcome.test(np.stack([self._signature(axis, name) for axis, name in at], axis=1))
        for axis in range(self.n_axes):
            own = [(*t, name) for t, (a, name) in zip(tests, at, strict=True) if a == axis]
            own = [x for x in own if x[2] <= LEVEL and x[0] > WORTH]
            if own:
                share, slope, _, name = max(own)
                told.append(self._said(outcome.state.robot(), axis, name, share, slope))
        return (*cells, *told)

    def _signature(self, axis: int, name: str) -> Rows:
        def alone(m):
            x = np.zeros_like(m.speed)
            x[:, axis] = _SIGNATURES[name](m.angle[:, axis], m.speed[:, axis], m.torque[:, axis])
            return x

        return self._rows([alone(m) for m in self.motions])

    def _said(self, robot: Robot, axis: int, name: str, share: float, slope: float) -> Cell:
        joint = self.robot.axis_names[axis]
        text = f"{joint}: what remains goes with {name} ({share:.0%} of it, slope {slope:.4g})."
        if name == "|speed|":
            own = float(robot.drives.friction.viscous[axis])
            text += f" Viscous friction differs by direction: {own + slope:.4g} forward, {own - slope:.4g} backward."
        return Cell(None, joint, (0.0, COMPARED * self.motions[0].cutoff), float("nan"), text)

    def remarks(self, outcome: Outcome):
        cutoff = self.motions[0].cutoff
        said = f"the motion was filtered at {cutoff:.3g} Hz, torques compared up to {COMPARED * cutoff:.3g} Hz."
        away = self.given_way(outcome.state.robot())
        off = [f"{n.name} ({x:+.1f})" for n, x in zip(self.giving.numbers, away, strict=True) if abs(x) > OFF]
        if not off:
            return (said,)
        return said, f"off by more than their tolerance, of which the torques ask so many: {', '.join(off)}."

    def joined(self, found):
        base, extended = (self.giving.of(robot, self.given_way(robot)) for robot in (found.base, found.extended))
        return dataclasses.replace(found, base=base, extended=extended)


_SIGNATURES = {
    "constant": lambda q, v, u: np.ones_like(v),
    "sign of speed": lambda q, v, u: np.sign(v),
    "speed": lambda q, v, u: v,
    "|speed|": lambda q, v, u: np.abs(v),
    "speed |speed|": lambda q, v, u: v * np.abs(v),
    "angle": lambda q, v, u: q,
    "|torque| sign of speed": lambda q, v, u: np.abs(u) * np.sign(v),
}


def _course(signal, before, after):
    """Means in bins of equally many samples, (axis, bin) each."""
    order = np.argsort(signal, axis=0)
    means = lambda x: np.stack(
        [p.mean(axis=0) for p in np.array_split(np.take_along_axis(x, order, axis=0), _BINS)], axis=1
    )
    return means(signal), means(before), means(after)
