"""The deflection of transmissions, motor-side less link-side position, against the torque of their motors.

    q_m/n - C q_a = n (u - losses of the motor)/k + what the spring is not + what the link's sensor makes of it

C is 1 but for wrists whose axes turn each other's gears; u is held from sample to sample. For robots with encoders on
both sides, on any motion.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..._errors import input_error
from ..._types import arrays
from ...effects import (
    AbstractFriction,
    AbstractGearError,
    AbstractGearTorque,
    AbstractLinkSensor,
    AbstractStructure,
    Reach,
)
from ...effects._place import axis_of
from ...experiment import Experiment
from ...robot import Robot, parameters, robot_from_table
from ...robot.equations import arm_angles, gear_angles
from ...robot.parameters import with_values
from ...trajectory.rigid_motion import MeasuredMotion, held, smooth
from ..settings import DEFLECTION, DEFLECTION_CUTOFF, DEFLECTION_DROP, SMALLEST
from .channel import Rows
from .records import AbstractRecords, every_record, reaches, rows_of

_TURN = 0.02  # of the largest speed, over which friction of a robot that is not known changes its sign

_SEEN = (AbstractFriction, AbstractStructure, AbstractGearTorque, AbstractGearError, AbstractLinkSensor)


class DeflectionChannel(AbstractRecords):
    """Deflections over the rms deflection of their axis, about the mean of every run: the encoders' zero may be another
    one in each. Runs are held out in turn.

    All terms go through the same low-pass without phase. It fails where motor torque at the cut-off goes into the
    motor's own inertia, if that is not known. Without a robot, positions of motors are link-side angles.

    **Fields:** `motions`: of the motors, filtered; `u`, `link`: as measured, N m and rad. `size`: rad, (axis,).
    """

    compared: ClassVar = "deflection of the transmissions, motor-side less link-side position, over the motor's torque"
    quantity: ClassVar = "deflection residual"
    unit: ClassVar = "of the deflection"
    tolerance: ClassVar = DEFLECTION
    least_drop: ClassVar = DEFLECTION_DROP
    smallest: ClassVar = SMALLEST

    robot: Robot
    motions: tuple[MeasuredMotion, ...]
    u: tuple[Float[np.ndarray, "time axis"], ...]
    link: tuple[Float[np.ndarray, "time axis"], ...]
    size: Float[np.ndarray, "axis"]
    measured: Rows
    group: Int[np.ndarray, "row"]
    fold: Int[np.ndarray, "row"]
    lengths: tuple[int, ...] = eqx.field(static=True)
    rate: float = eqx.field(static=True)
    feature: Float[np.ndarray, "sample feature"]
    reach: tuple[Reach, ...]

    @classmethod
    def takes(cls, robot: Robot | None, data: Sequence[Any]) -> bool:
        return all(isinstance(x, Experiment) and x.n_out == 2 * x.n_in for x in data)

    @classmethod
    def opened(cls, robot, data):
        if len(every_record(data)) < 2:
            raise input_error("runs", "1", "two or more, to judge on one that was not used", "Name more files.")
        return cls._compared(robot, data)

    def of(self, data):
        return self._compared(self.robot, data)

    def tried(self, kind, joint):
        if not issubclass(kind, _SEEN):
            raise input_error(kind.name, "deflections", "other records: it does not show in these", "Compare torques.")
        return super().tried(kind, joint)

    @property
    def n_parts(self) -> int:
        return self.n_axes

    @classmethod
    def _compared(cls, robot: Robot | None, data) -> "DeflectionChannel":
        n = data[0].n_in
        for x in data:
            if x.y_quantity != "position":
                raise input_error("y_quantity", x.y_quantity, "position", "Set it: --set y_quantity=position.")
        if robot is not None and robot.n_motors != n:
            raise input_error(
                f"transmissions of {robot.name}",
                f"{robot.n_motors} flexible ones",
                f"{n}, as in the records",
                "Say them.",
            )
        u, motor, link = zip(*(_run(x, pos, exp, n) for x, pos, exp in every_record(data)), strict=True)
        motions = tuple(_filtered(a, b, data[0].fs) for a, b in zip(u, motor, strict=True))
        reach = reaches(motions)
        turn = _TURN * np.array([x.speed for x in reach])
        robot = _springs_alone(n, float(turn.min())) if robot is None else robot
        gear, seen_by_gears = np.asarray(robot.drives.gear_ratio), lambda x: np.asarray(gear_angles(robot, x))
        deflection = [_thinned(m, a / gear - seen_by_gears(b)) for m, a, b in zip(motions, motor, link, strict=True)]
        size = np.sqrt(np.mean(np.concatenate(deflection) ** 2, axis=0))
        seen = [np.concatenate([m.angle, m.speed, np.tanh(m.speed / turn), m.torque], axis=1) for m in motions]
        lengths = tuple(len(x) for x in deflection)
        return cls(
            robot=robot,
            motions=motions,
            u=u,
            link=link,
            size=size,
            measured=rows_of(deflection, size),
            group=np.tile(np.arange(n), sum(lengths)),
            fold=np.repeat(np.arange(len(lengths)), np.array(lengths) * n),
            lengths=lengths,
            rate=motions[0].fs / _step(motions[0].fs),
            feature=np.concatenate([_thinned(m, x) for m, x in zip(motions, seen, strict=True)]),
            reach=reach,
        )

    def own(self):
        """Stiffness of every transmission, as a straight line through all runs says it."""
        torque = [
            _thinned(m, x) * np.asarray(self.robot.drives.gear_ratio) for m, x in zip(self.motions, self.u, strict=True)
        ]
        torque, x = np.concatenate(torque), self.measured.reshape(-1, self.n_axes) * self.size
        k = np.sum(torque**2, axis=0) / np.sum(torque * x, axis=0)
        return dict(zip(parameters(self.robot, ("stiffness",)), map(float, k), strict=False))

    def predicted(self, state):
        robot = state.robot()
        return rows_of([_thinned(*one) for one in zip(self.motions, self._deflections(robot), strict=True)], self.size)

    def _deflections(self, robot: Robot):
        """What the link side should be behind the motor side, rad, (time, axis) of every run."""
        gear, k = np.asarray(robot.drives.gear_ratio), np.asarray(robot.springs.stiffness)[: self.n_axes]
        for m, u, link in zip(self.motions, self.u, self.link, strict=True):
            loss = _loss(robot, m)
            slow = gear * (m.torque - loss) / k
            rate = np.asarray(arm_angles(robot, jnp.asarray(m.speed)))
            misread = np.asarray(gear_angles(robot, _misread(robot, link, rate)))
            yield gear * (u - loss) / k + _bend(robot, slow, m, k) - misread

    def remarks(self, outcome):
        late = [c.joint for c, _ in outcome.state.chosen if isinstance(c.basis[0], AbstractLinkSensor)]
        said = (
            f"{', '.join(late)}: the link-side position itself is misread, no property of the gears. Mend that first."
        )
        return (said,) if late else ()


def _run(record: Experiment, pos: int, exp: int, n: int):
    y = np.asarray(record.y[pos, exp])
    return held(np.asarray(record.u[pos, exp])), y[:, :n], y[:, n:]


def _filtered(u, motor, fs: float) -> MeasuredMotion:
    angle = smooth(motor, fs, DEFLECTION_CUTOFF)
    speed = np.gradient(angle, 1.0 / fs, axis=0)
    quiet = smooth(u, fs, DEFLECTION_CUTOFF)
    return MeasuredMotion(angle, speed, np.gradient(speed, 1.0 / fs, axis=0), quiet, fs, DEFLECTION_CUTOFF)


def _step(fs: float) -> int:
    return max(int(0.4 * fs / DEFLECTION_CUTOFF), 1)


def _thinned(motion: MeasuredMotion, x) -> Float[np.ndarray, "sample axis"]:
    fs = motion.fs
    end = int(np.ceil(2.0 * fs / DEFLECTION_CUTOFF))
    low = smooth(np.asarray(x), fs, DEFLECTION_CUTOFF)[end : len(x) - end : _step(fs)]
    return low - low.mean(axis=0)


def _loss(robot: Robot, m: MeasuredMotion):
    """What the motors need of their torque themselves, N m."""
    loss = np.asarray(robot.drives.friction.torque(m.speed)) + np.asarray(robot.drives.motor_inertia) * m.acceleration
    for e in robot.effects:
        if isinstance(e, AbstractFriction):
            axis = axis_of(robot, e.joint)
            loss[:, axis] += np.asarray(e.torque(jnp.asarray(m.speed[:, axis]), jnp.asarray(m.torque[:, axis])))
    return loss


def _bend(robot: Robot, x, m: MeasuredMotion, k):
    """What the transmissions give way beyond their stiffness k where a spring would be deflected by x: first order."""
    none = np.zeros((len(x), len(robot.spring_names) - x.shape[1]))
    rate = np.gradient(x, 1.0 / m.fs, axis=0)
    springs, rates = (jnp.asarray(np.concatenate([signal, none], axis=1)) for signal in (x, rate))
    more = np.array(robot.springs.torque(springs, rates))[:, : x.shape[1]] - k * x
    for e in robot.effects:
        if isinstance(e, AbstractGearTorque | AbstractGearError):
            axis = axis_of(robot, e.joint)
            angle = jnp.asarray(m.angle[:, axis] / float(robot.drives.gear_ratio[axis]))
            effect, with_it = arrays((e, robot))
            more[:, axis] += np.asarray(_along(effect, with_it, x[:, axis], rate[:, axis], angle, 1.0 / m.fs))
    return -more / k


@eqx.filter_jit
def _along(effect, robot: Robot, deflection, rate, angle, step: float):
    return effect.along(robot, jnp.asarray(deflection), rate, angle, step)


def _misread(robot: Robot, link, rate):
    """Error of the link-side positions, rad."""
    error = np.zeros_like(link)
    for e in robot.effects:
        if isinstance(e, AbstractLinkSensor):
            axis = axis_of(robot, e.joint)
            error[:, axis] += np.asarray(e.error(jnp.asarray(link[:, axis]), jnp.asarray(rate[:, axis])))
    return error


def _springs_alone(n: int, smoothing: float) -> Robot:
    """A robot of which nothing is known but that there are springs behind its motors; gears of 1."""
    plain = {"type": "driven", "axis": [0.0, 0.0, 1.0], "offset": [0.0] * 3, "com": [0.0] * 3, "damping": 0.0}
    plain |= {"mass": 1.0, "inertia": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0], "gear_ratio": 1.0, "motor_inertia": 1.0}
    joints = [plain | {"name": f"axis{i + 1}", "stiffness": 1.0} for i in range(n)]
    table = {"name": "transmissions", "gravity": [0.0] * 3, "friction": {"smoothing": smoothing}, "joint": joints}
    robot = robot_from_table(table)
    return with_values(robot, dict.fromkeys(parameters(robot, ("motor_inertia",)), 0.0))
