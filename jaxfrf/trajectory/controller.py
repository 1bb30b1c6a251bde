"""The controller that a record shows: its torque commands against what its law makes of references and motion.

References, measured motion and commanded torque meet in the controller alone, whatever the arm does. A gain that is a
few per cent off is seen there to some hundredths; left as written, it would be sought in the arm, whose numbers then
all move a little. A log that follows another law (a torque feed-forward, signals that were taken at different times)
is seen there, too.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
import scipy.optimize
from jaxtyping import Complex, Float

from .._text import percent
from ..experiment import Experiment
from ..robot import Controller, Robot
from ..robot.quantity import derivatives
from ..simulation.checks import check_data, check_fit
from ..spectra import known_lines
from .following import compared, why_followed
from .log_times import LogTimes
from .measured import Measured, lines_of

_GAINS = ("position_gain", "velocity_gain", "integral_time")
_ANOTHER = 0.02  # of the torque command left unexplained, and several times what noise leaves: another law
_OVER_NOISE = 5.0
_TOLD = 1e-3  # relative change of a gain that is worth a word, where it is three of its deviations
_UNKNOWN = 10.0  # of the logarithm: a gain of which nothing is known
_NEAR = 2.0  # times: a position gain and 1/integral time that are nearer are hardly told apart
_LIMITED = 0.999  # of the torque limit: clipped commands follow no linear law
_LEAST = 1e-5  # of the command: rounding of logs
_TIMES = 3  # fits, each weighed by what the one before left
_LINES = 9  # lines over which that is smoothed
_FARTHEST = 10.0  # that a gain is changed by, ln: where another law holds, a fit without bounds runs off
_LATEST = 4  # samples that a log is looked through for late signals
_TIMES_UNKNOWN = 10.0  # samples: a time of which nothing is known
_SURE = 3.0  # standard deviations of a time that is one


class ShownController(eqx.Module):
    """What a record says of a robot's controller.

    **Fields:** `robot`: with the gains that the record shows; without a controller where the record contradicts its
    law. `given`: the controller as written. `change`, `std`: of position gain, velocity gain and integral time,
    logarithms, (3, axis); 0 where nothing was fitted. `left`: rms of the torque command that the law leaves, over the
    command, (axis,). `noise`: what the noise of the motion accounts for of that, (axis,).
    """

    robot: Robot
    given: Controller | None
    change: Float[np.ndarray, "3 axis"]
    std: Float[np.ndarray, "3 axis"]
    left: Float[np.ndarray, "axis"]
    noise: Float[np.ndarray, "axis"]

    @property
    def contradicted(self) -> Float[np.ndarray, "axis"]:
        """Whether the law does not command what was logged."""
        return (self.left > _ANOTHER) & (self.left > _OVER_NOISE * self.noise)

    def restored(self, robot: Robot) -> Robot:
        """A robot that was fitted without its controller, with it again."""
        return dataclasses.replace(robot, controller=self.given) if np.any(self.contradicted) else robot

    def compared(self, data: Experiment) -> str:
        """What of the robot is compared with a record, in words."""
        why = self.says()
        if np.any(self.contradicted):
            return f"by the torque that the model needs for the measured motion: {why}"
        return compared(self.robot, data) + (f", whose {why}" if why else "")

    def says(self) -> str:
        """What is worth a word, empty where nothing is."""
        if np.any(self.contradicted):
            axis = int(np.argmax(np.where(self.contradicted, self.left, 0.0)))
            return (
                f"the written controller does not command what was logged ({percent(self.left[axis])} of the torque "
                f"of {self.robot.axis_names[axis]} is left)"
            )
        told = (np.abs(self.change) > _TOLD) & (np.abs(self.change) > 3.0 * self.std)
        if not np.any(told):
            return ""
        gain, axis = divmod(int(np.argmax(np.where(told, np.abs(self.change), 0.0))), told.shape[1])
        way = "above" if self.change[gain, axis] > 0 else "below"
        return (
            f"gains are those that the record shows ({_GAINS[gain].replace('_', ' ')} of {self.robot.axis_names[axis]} "
            f"{percent(np.expm1(abs(self.change[gain, axis])))} {way} the written one{self._hardly_told(gain, axis)})"
        )

    def _hardly_told(self, gain: int, axis: int) -> str:
        """Where a position gain and 1/integral time are nearly the same, in words."""
        other = {"position_gain": "integral_time", "integral_time": "position_gain"}.get(_GAINS[gain])
        if other is None or self.robot.controller is None:
            return ""
        position, _, time = _gains(self.robot.controller, self.robot.n_axes)[:, axis]
        near = 1.0 / _NEAR < position * time < _NEAR
        return f", as far as it is told from the {other.replace('_', ' ')}" if near else ""


def shown_controller(robot: Robot, record: Measured) -> ShownController:
    """The gains of a robot's controller from the lines of a record's torque commands.

    U(k) = K_v E(k) (1 + 1/(f_s T_i (1 - z^-1))), E = K_p (R_q - Y) + R_v - Y (1 - z^-1) f_s, at the excited lines of
    all runs, axis by axis; least squares, weighed by what is left around a line, with what is known of the gains
    (tolerance `controller_gain`) as prior. Axes whose torque was clipped, and gains of 0 or without an end, stay as
    written.

    **Arguments:** `record`: of a robot that plays references under its own controller; any other stays as it is.

    Where the speed reference is fed forward the law is K_v (s + K_p)(s + 1/T_i)/s^2 of the speed error, but for its
    sampling: K_p and 1/T_i may change places, and are told badly where they are equal. The commands are the same.

    **Biased** where the motion's noise is not small against the motion: the controller reads it, too, and a log of
    speeds or accelerations does not hold it.

    **Source:** `jaxfrf.robot.Controller`; least squares with errors of known size are textbook statistics.
    """
    axes, controller = robot.n_axes, robot.controller
    change, std, left, noise = np.zeros((3, axes)), np.zeros((3, axes)), np.zeros(axes), np.zeros(axes)
    if controller is None or why_followed(robot, record.data):
        return ShownController(robot, controller, change, std, left, noise)
    law = _Law.of(robot, controller, record)
    for axis in map(int, np.flatnonzero(~_clipped(robot, record) & law.commands)):
        prior = _priors(robot, law.gains[:, axis], axis)
        change[:, axis], std[:, axis], left[axis], noise[axis] = law.fitted(axis, prior)
    now = _controller(controller, law.gains * np.exp(change)) if np.any(change) else controller
    shown = ShownController(dataclasses.replace(robot, controller=now), controller, change, std, left, noise)
    if np.any(shown.contradicted):
        return dataclasses.replace(shown, robot=dataclasses.replace(robot, controller=None))
    return shown


def law_times(robot: Robot, record: Measured, contradicted) -> LogTimes | None:
    """How late commands and motion would have to stand in a log for the controller's law to hold on axes where it is
    `contradicted`; `None` where no times make it hold."""
    controller, axes = robot.controller, robot.n_axes
    assert controller is not None
    law, late = _Law.of(robot, controller, record), np.zeros((2, axes))
    seen = ~_clipped(robot, record) & law.commands
    for axis in map(int, np.flatnonzero(seen)):
        if not contradicted[axis]:
            continue
        found = law.times(axis, _priors(robot, law.gains[:, axis], axis))
        if found is None:
            return None
        late[:, axis] = found
    late[:, ~seen] = np.median(late[:, seen], axis=1, keepdims=True)
    return LogTimes(late[0], late[1], record.data.fs)


def _priors(robot: Robot, gains, axis: int) -> Float[np.ndarray, "3"]:
    """Tolerance of an axis' gains, 0 where they are exact or cannot move."""
    tolerance = min(robot.tolerances.of(f"{robot.axis_names[axis]}.controller_gain").std, _UNKNOWN)
    acts = gains[_GAINS.index("velocity_gain")] > 0
    return np.where(acts & (gains > 0) & np.isfinite(gains), tolerance, 0.0)


def _gains(controller: Controller, axes: int) -> Float[np.ndarray, "3 axis"]:
    return np.array([np.broadcast_to(np.asarray(getattr(controller, gain)), (axes,)) for gain in _GAINS])


def _clipped(robot: Robot, record: Measured):
    """Axes whose torque command reached its limit somewhere."""
    limit = np.broadcast_to(np.asarray(robot.drives.torque_limit), (robot.n_axes,))
    return np.max(np.abs(record.data.u), axis=(0, 1, 2)) >= _LIMITED * limit


class _Law(eqx.Module):
    """Excited lines of a record around its controller: what it was given, what it read, what it commanded."""

    controller: Controller
    gains: Float[np.ndarray, "3 axis"]
    fs: float
    frequency: Float[np.ndarray, "line"]
    position: Complex[np.ndarray, "pos exp line axis"]
    velocity: Complex[np.ndarray, "pos exp line axis"]
    Y: Complex[np.ndarray, "pos exp line axis"]
    U: Complex[np.ndarray, "pos exp line axis"]
    read: Float[np.ndarray, "line axis"]  # torque that noise of the motion makes

    @classmethod
    def of(cls, robot: Robot, controller: Controller, record: Measured) -> "_Law":
        data, references = record.data, np.asarray(record.data.r)
        check_data(robot, data)
        check_fit(robot, data.fs, references.shape[3], "record")
        count = len(record.frequency)
        lines = np.array([k for k in known_lines(data) if 0 < k < count])
        frequency, order = record.frequency[lines], derivatives(data.r_quantity)
        R = lines_of(references, data, count)[:, :, lines]
        s = 2j * np.pi * frequency[:, None]
        feedback = controller.feedback(frequency, robot.sampling_frequency)
        return cls(
            controller,
            _gains(controller, robot.n_axes),
            robot.sampling_frequency,
            frequency,
            R / s**order,
            R / s ** (order - 1),
            record.Y[:, :, lines],
            record.U[:, :, lines],
            np.abs(feedback) * record.noise[lines],
        )

    @property
    def commands(self) -> np.ndarray:
        """Axes that were told anything, (axis,)."""
        return np.any(self.U != 0, axis=(0, 1, 2))

    def left(self, axis: int, change, late=(0.0, 0.0)) -> Complex[np.ndarray, "pos exp line"]:
        """Of an axis' torque command, what the law with these gains does not make, N m; where command and motion were
        logged so `late`, s."""
        gains = self.gains.copy()
        gains[:, axis] *= np.exp(np.clip(change, -_FARTHEST, _FARTHEST))
        controller = _controller(self.controller, gains)
        s = 2j * np.pi * self.frequency[:, None]
        U, Y = (x * np.exp(s * t) for x, t in zip((self.U, self.Y), late, strict=True))
        made = controller.command(self.frequency, self.fs, self.position, self.velocity, Y)
        return (U - made)[..., axis]

    def fitted(self, axis: int, prior: Float[np.ndarray, "3"]):
        """Changes of the gains, their standard deviations, what is left of the command and what noise leaves of it."""
        size, read = _rms(self.U[..., axis]), self.read[:, axis]
        free = np.flatnonzero(prior > 0)
        change, std = np.zeros(3), np.zeros(3)
        scatter = np.hypot(read, _LEAST * size)
        for _ in range(_TIMES if len(free) else 0):

            def whitened(x, scatter=scatter):
                change[free] = x
                return (self.left(axis, change) / scatter).ravel().view(float)

            change[free], std[free] = _posterior(whitened, prior[free])
            scatter = _around(self.left(axis, change)) + _LEAST * size
        return change, std, _rms(self.left(axis, change)) / size, _rms(read) / size

    def times(self, axis: int, prior: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"] | None:
        """How late command and motion of an axis are where its law holds then, s; `None` where it does not."""
        size, read = _rms(self.U[..., axis]), self.read[:, axis]
        some = range(-_LATEST, _LATEST + 1)
        start = min(
            ((a / self.fs, b / self.fs) for a in some for b in some),
            key=lambda late: _rms(self.left(axis, np.zeros(3), late)),
        )
        free = np.flatnonzero(prior > 0)
        scatter = np.hypot(read, _LEAST * size)

        def left(x):
            change = np.zeros(3)
            change[free] = x[:-2]
            return self.left(axis, change, start + x[-2:] / self.fs)

        x = np.zeros(len(free) + 2)
        for _ in range(_TIMES):
            whitened = lambda x, scatter=scatter: (left(x) / scatter).ravel().view(float)
            x, std = _posterior(whitened, np.array([*prior[free], _TIMES_UNKNOWN, _TIMES_UNKNOWN]))
            scatter = _around(left(x)) + _LEAST * size
        if _rms(left(x)) > max(_ANOTHER, _OVER_NOISE * _rms(read) / size) * size:
            return None
        late = start + x[-2:] / self.fs
        return np.where(np.abs(late) * self.fs > _SURE * std[-2:], late, 0.0)


def _around(left) -> Float[np.ndarray, "line"]:
    """rms of the real and of the imaginary part, smoothed over neighbouring lines."""
    power = 0.5 * np.mean(np.abs(left) ** 2, axis=(0, 1))
    return np.sqrt(scipy.ndimage.uniform_filter1d(power, _LINES, mode="nearest"))


def _rms(lines) -> float:
    return float(np.sqrt(np.mean(np.abs(lines) ** 2)))


def _controller(controller: Controller, gains) -> Controller:
    position, velocity, integral = map(jnp.asarray, gains)
    return dataclasses.replace(controller, position_gain=position, velocity_gain=velocity, integral_time=integral)


def _posterior(whitened, prior):
    """Least squares with a prior about zero, and standard deviations; the residual's scale is that of a first fit."""
    first = scipy.optimize.least_squares(whitened, np.zeros(len(prior)), x_scale=0.01)
    scale = max(float(np.sqrt(2.0 * first.cost / max(len(first.fun) - len(prior), 1))), 1e-300)
    both = lambda x: np.concatenate([whitened(x) / scale, x / prior])
    found = scipy.optimize.least_squares(both, first.x, x_scale=0.01)
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
