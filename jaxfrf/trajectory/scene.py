"""What moves in a simulated robot at one position, and what a change of the robot would add to the motors' torque."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int

from .._threads import kept
from .._types import arrays
from ..robot import (
    Robot,
    arm_inertia_and_bias_columns,
    mass_matrix,
    motor_directions,
    motor_values,
    spring_directions,
)
from ..robot.drive import Friction, Spring
from ..robot.regressor import PER_LINK, link_regressor
from ..simulation import Motion
from ..simulation.plant import product
from .frozen import Frozen

_SPRINGS = 500.0  # Hz, samples of springs and arm, which move below 100 Hz
_BLOCK = 500  # samples
_LINKS = 250.0  # Hz, samples of the links' forces
_PER_LINE = 3.0  # samples for a cycle of the highest line, at least: their laws make little beyond

Signal = Float[np.ndarray, "exp time"]
Signature = Complex[np.ndarray, "exp line axis"]


class Scene:
    """Signals of all experiments at one position, with what the effects' laws ask for.

    Those of the motors are (exp, time, axis); those of springs and arm, which move slowly, have fewer samples.
    Quantities are computed when they are first needed and kept until `forget`.
    """

    def __init__(self, robot: Robot, motion: Motion, pos: int, still: Frozen, command=None, reading=None):
        self.robot, self.still, self.fs = robot, still, motion.fs
        self.u, self.y, self.z = motion.u[pos], motion.y[pos], motion.z[pos]
        self.period = self.z.shape[1]
        # As measured, if they are known: a drive clips the command, ripple goes by the angle, wherever the model is.
        self.command = self.u if command is None else command
        self.reading = self.y if reading is None else reading
        self.lines = len(still.command)
        self.gear = np.asarray(robot.drives.gear_ratio)
        self._hinges: dict = {}

    def forget(self) -> None:
        """Free what was computed; it is computed again where it is needed."""
        for name in [name for name in vars(self) if isinstance(getattr(type(self), name, None), kept)]:
            del self.__dict__[name]

    @kept
    def _Z(self):
        return scipy.fft.rfft(self.z, axis=1)

    @kept
    def _s(self):
        return (2j * np.pi * np.arange(self.period // 2 + 1) * self.fs / self.period)[:, None]

    @kept
    def _springs(self) -> Float[np.ndarray, "dof spring"]:
        return np.asarray(spring_directions(self.robot))

    # The motors, at every sample: friction turns with the sign of their speed

    @kept
    def angle(self) -> Float[np.ndarray, "exp time axis"]:
        """rad, motor side."""
        return np.asarray(motor_values(self.robot, self.z))

    @kept
    def speed(self) -> Float[np.ndarray, "exp time axis"]:
        return self._motors(1)

    @kept
    def acceleration(self) -> Float[np.ndarray, "exp time axis"]:
        return self._motors(2)

    def _motors(self, derivatives: int):
        Z = self._Z @ np.asarray(motor_directions(self.robot)) * self._s**derivatives
        return scipy.fft.irfft(Z, n=self.period, axis=1)

    @kept
    def turn(self) -> Complex[np.ndarray, "axis exp time"]:
        """e^{j angle} of the motors as they were read."""
        return np.exp(1j * np.moveaxis(self.reading, -1, 0))

    @kept
    def load(self) -> Float[np.ndarray, "exp time axis"]:
        """Torque in the gears on the motor side; the motor's own where the transmission is rigid."""
        load = self.u.copy()
        flexible = list(self.robot.flexible_axes)
        gears = scipy.fft.rfft(self.spring_torque[..., : len(flexible)], axis=1)
        gears = scipy.fft.irfft(gears, n=self.period, axis=1) * (self.period / self.coarse)
        load[..., flexible] = gears / self.gear[flexible]
        return load

    # Springs and arm, coarsely

    @kept
    def coarse(self) -> int:
        """Samples of a period that springs and arm have."""
        return self.samples(_SPRINGS)

    def samples(self, rate: float) -> int:
        """Of a period at this rate, Hz, or what its lines need if that is more."""
        count = max(rate * self.period / self.fs, _PER_LINE * self.lines)
        return min(self.period, 2 * int(np.ceil(0.5 * count)))

    def _coarse(self, derivatives: int, count: int):
        Z = self._Z[:, : count // 2 + 1] * self._s[: count // 2 + 1] ** derivatives * (count / self.period)
        return scipy.fft.irfft(Z, n=count, axis=1)

    @kept
    def _coarse_z(self):
        return self._coarse(0, self.coarse)

    @kept
    def _coarse_rate(self):
        return self._coarse(1, self.coarse)

    @kept
    def deflection(self) -> Float[np.ndarray, "exp sample spring"]:
        return self._coarse_z @ self._springs

    @kept
    def deflection_rate(self) -> Float[np.ndarray, "exp sample spring"]:
        return self._coarse_rate @ self._springs

    @kept
    def spring_torque(self) -> Float[np.ndarray, "exp sample spring"]:
        return np.asarray(self.robot.springs.torque(self.deflection, self.deflection_rate))

    @kept
    def arm_angle(self) -> Float[np.ndarray, "exp sample axis"]:
        return self._coarse_z[..., self.robot.n_motors : self.robot.n_motors + self.robot.n_axes]

    @kept
    def arm_rate(self) -> Float[np.ndarray, "exp sample axis"]:
        return self._coarse_rate[..., self.robot.n_motors : self.robot.n_motors + self.robot.n_axes]

    def spectrum(self, x) -> Complex[np.ndarray, "exp line ..."]:
        """Lines of periodic signals, (exp, time, ...); amplitudes do not depend on the number of samples."""
        return scipy.fft.rfft(x, axis=1)[:, : self.lines] / x.shape[1]

    # What asks for more torque of the motors, as spectra of their commands, (exp, line, axis)

    def by_force(self, d: Complex[np.ndarray, "exp line dof"]) -> Signature:
        """A force on the coordinates."""
        return self.by_forces(d, np.arange(self.robot.dof))

    def by_forces(
        self, d: Complex[np.ndarray, "*more exp line row"], rows: Int[np.ndarray, "row"]
    ) -> Complex[np.ndarray, "*more exp line axis"]:
        """Forces on these coordinates, many at once."""
        lines = np.moveaxis(d, -2, 0)
        asked = lines.reshape(self.lines, -1, len(rows)) @ self.still.to_torque[:, :, rows].swapaxes(1, 2)
        asked /= self.still.command[:, None]
        steady = d[..., 0, :].real @ self.still.compliance[0].real[rows]
        return np.moveaxis(asked.reshape(*lines.shape[:-1], -1), 0, -2) + self._settled(steady)

    def by_direction(self, direction: Float[np.ndarray, "dof"], signal: Signal) -> Signature:
        """A force of this course along one direction of the coordinates."""
        return self._by_course(direction, self.spectrum(signal))

    def _by_course(self, direction, course: Complex[np.ndarray, "exp line"]) -> Signature:
        column = self.still.to_torque @ direction / self.still.command
        steady = course[:, :1].real * (direction @ self.still.compliance[0].real)
        return course[..., None] * column + self._settled(steady)

    def _settled(self, moved: Float[np.ndarray, "*more exp dof"]) -> Complex[np.ndarray, "*more exp line axis"]:
        """What a small shift of the springs' points of rest asks: their stiffness there is another."""
        bent, stiffer = self._settling
        shift = moved @ self._springs[:, bent]
        asked = stiffer.shape[2:]
        pairs = stiffer.reshape(*stiffer.shape[:2], math.prod(asked)).view(float)  # real numbers, so that BLAS is used
        found = np.stack([shift[..., e, :] @ pairs[e] for e in range(shift.shape[-2])], axis=-2)
        return found.view(complex).reshape(*shift.shape[:-1], *asked)

    @kept
    def _settling(self) -> tuple[np.ndarray, Complex[np.ndarray, "exp spring line axis"]]:
        """Which springs are not linear, and what a shift of each asks, N m/rad, less the frozen robot's part of it."""
        law = self.robot.springs
        ratio = np.asarray(law.stiffness_ratio) if isinstance(law, Spring) else np.ones(self._springs.shape[1])
        bent = np.flatnonzero(ratio != 1.0)
        tangent = np.asarray(law.tangent(self.deflection)) if len(bent) else self.deflection
        course = self.spectrum(tangent[..., bent])
        course[:, 0] = 0.0
        columns = self.still.to_torque @ -self._springs[:, bent] / self.still.command[..., None]
        return bent, np.ascontiguousarray(np.einsum("els,las->esla", course, columns))

    def by_motor(self, axis: int, signal: Signal) -> Signature:
        """A torque against one motor."""
        more = np.zeros((len(signal), self.lines, self.robot.n_axes), complex)
        more[..., axis] = self.spectrum(signal) / self.still.command[:, axis]
        return more

    def by_arm(self, axis: int, signal: Signal) -> Signature:
        """A torque against one joint, on the arm side."""
        direction = np.zeros(self.robot.dof)
        direction[self.robot.n_motors + axis] = -1.0
        return self.by_direction(direction, signal)

    def by_spring(self, spring: int, signal: Signal) -> Signature:
        """More torque in one spring."""
        return self.by_direction(-self._springs[:, spring], signal)

    def by_command(self, axis: int, more: Complex[np.ndarray, "exp line"]) -> Signature:
        """More of one command."""
        result = np.zeros((*more.shape, self.robot.n_axes), complex)
        result[..., axis] = more
        return result

    def by_sensor(self, axis: int, error: Signal) -> Signature:
        """An error of one measured motor position."""
        return -self.spectrum(error)[..., None] * self.still.impedance[:, :, axis] / self.still.command

    def by_impedance(self, impedance: Complex[np.ndarray, "line axis axis"]) -> Signature:
        """Another impedance of the robot to the motion of its motors."""
        more = impedance - self.still.impedance
        return np.einsum("lab,elb->ela", more, self.spectrum(self.angle - self.angle[:, :1])) / self.still.command

    def by_shift(self, spring: int, shift: Signal) -> Signature:
        """A shift of one spring's deflection, (exp, time), over which its torque changes by its tangent."""
        fewer = scipy.fft.rfft(shift, axis=1)[:, : self.coarse // 2 + 1] * (self.coarse / self.period)
        s = self._s[: self.coarse // 2 + 1, 0]
        moved, rate = (scipy.fft.irfft(x, n=self.coarse, axis=1) for x in (fewer, fewer * s))
        runs = len(shift)
        x, v = self.deflection[:runs].copy(), self.deflection_rate[:runs].copy()
        x[..., spring] += moved
        v[..., spring] += rate
        more = np.asarray(self.robot.springs.torque(x, v)) - self.spring_torque[:runs]
        return self.by_spring(int(spring), more[..., spring])

    def per_shift(self, spring: int) -> Complex[np.ndarray, "line axis"]:
        """What a small shift of a spring's deflection asks for, by its stiffness and damping at rest, N m/rad."""
        springs, s = self.robot.springs, 2j * np.pi * self.still.frequency
        stiff = float(np.asarray(springs.stiffness)[spring]) + s * float(np.asarray(springs.damping)[spring])
        return stiff[:, None] * (self.still.to_torque @ -self._springs[:, spring]) / self.still.command

    def by_hinge(self, axis: int, direction, stiffness: float, damping: float) -> Signature:
        """A spring hinge in the link just before a joint, about `direction` in its frame at zero.

        Its coordinate is eliminated from the frozen robot; gravity's part of its stiffness is left out."""
        coupling, own = self._hinge(axis, tuple(float(x) for x in direction))
        s = 2j * np.pi * self.still.frequency
        across = s[:, None] ** 2 * coupling
        v = np.einsum("lad,ld->la", self.still.to_torque, across)
        within = np.einsum("ld,lde,le->l", across, self.still.compliance, across)
        stiff = s**2 * own + s * damping + stiffness - within
        impedance = self.still.impedance - v[:, :, None] * v[:, None, :] / stiff[:, None, None]
        return self.by_impedance(impedance)

    def _hinge(self, axis: int, direction):
        """Inertia of a hinge before a joint: against the coordinates z, and its own."""
        if (axis, direction) not in self._hinges:
            self._hinges[axis, direction] = _hinge_inertia(self.robot, self.still.q, axis, np.asarray(direction))
        return self._hinges[axis, direction]

    def by_robot(self, changed: Robot) -> Signature:
        """Another robot in the place of this one, its coordinates the same: what its springs, motors and links ask."""
        if changed.dof != self.robot.dof:
            raise ValueError("The changed robot has other coordinates.")
        total = np.zeros((*self.u.shape[:1], self.lines, self.robot.n_axes), complex)
        for part in self.by_each(changed).values():
            total += part
        if _differ(changed.chain, self.robot.chain):
            arm = np.arange(self.robot.n_motors, self.robot.dof)
            total += self.by_forces(self.spectrum(self._own_links - self._links(changed)), arm)
        return total

    def by_each(self, changed: Robot) -> dict[tuple[str, int], Signature]:
        """What every spring ("spring", number) and motor ("motor", axis) of another robot asks beyond this one's; links
        and effects left out."""
        own, found = self.robot, {}
        springs, law = _where_another(changed.springs, own.springs, self._springs.shape[1])
        if len(springs):
            more = np.asarray(law.torque(self.deflection[..., springs], self.deflection_rate[..., springs]))
            courses = self.spectrum(more - self.spring_torque[..., springs])
            for spring, course in zip(springs, np.moveaxis(courses, -1, 0), strict=True):
                found["spring", int(spring)] = self._by_course(-self._springs[:, spring], course)
        axes, law = _where_another(changed.drives.friction, own.drives.friction, own.n_axes)
        if len(axes):
            more = np.asarray(law.torque(self.speed[..., axes])) - self._friction[..., axes]
            for axis, signal in zip(axes, np.moveaxis(more, -1, 0), strict=True):
                found["motor", int(axis)] = self.by_motor(int(axis), signal)
        inertia = np.asarray(changed.drives.motor_inertia) - np.asarray(own.drives.motor_inertia)
        for axis in np.flatnonzero(inertia):
            key = "motor", int(axis)
            found[key] = found.get(key, 0.0) + self.by_motor(int(axis), inertia[axis] * self.acceleration[..., axis])
        return found

    def resisting(self) -> Signature:
        """What springs, friction, rotors and links resist with, effects left out."""
        d = np.zeros((len(self.z), self.lines, self.robot.dof), complex)
        d -= self.spectrum(self.spring_torque) @ self._springs.T
        d[..., self.robot.n_motors :] -= self.spectrum(self._own_links)
        motors = self._friction + np.asarray(self.robot.drives.motor_inertia) * self.acceleration
        return self.by_force(d) + self.spectrum(motors) / self.still.command

    def by_links(
        self, slopes: Float[np.ndarray, "change joint parameter"]
    ) -> Complex[np.ndarray, "change exp line axis"]:
        """Derivatives of what the links ask, along these changes of their parameters (`link_regressor`)."""
        robot = self.robot
        arm = np.array(robot.arm_joints)
        signals = [np.zeros((robot.chain.n_joints, self._arm[0].shape[1])) for _ in range(3)]
        for whole, moving in zip(signals, self._arm, strict=True):
            whole[arm] = moving
        Y = link_regressor(robot.chain, *signals)
        courses = np.zeros((len(slopes), len(self.z), self.lines, len(arm)), complex)
        for link in range(robot.chain.n_joints):
            changes = np.flatnonzero(np.any(slopes[:, link], axis=-1))
            pushing = np.flatnonzero(arm <= link)  # a joint pushes what hangs on it
            if len(changes) and len(pushing):
                runs = Y[arm[pushing], link].reshape(len(pushing), PER_LINK, len(self.z), -1)
                X = scipy.fft.rfft(runs, axis=-1)[..., : self.lines] / -runs.shape[-1]
                courses[changes[:, None], ..., pushing] += np.tensordot(slopes[changes, link], X, (1, 1))
        return self.by_forces(courses, np.arange(robot.n_motors, robot.dof))

    @kept
    def _friction(self):
        return np.asarray(self.robot.drives.friction.torque(self.speed))

    @kept
    def _own_links(self):
        return self._links(self.robot)

    @kept
    def _arm(self):
        """Angles, rates and accelerations of the arm, (row, exp sample)."""
        count = self.samples(_LINKS)
        rows = slice(self.robot.n_motors, None)
        return tuple(self._coarse(n, count)[..., rows].reshape(-1, self.robot.dof - rows.start).T for n in range(3))

    def _links(self, robot: Robot) -> Float[np.ndarray, "exp sample arm"]:
        """Forces that the links need for the motion."""
        bare = dataclasses.replace(robot, effects=())  # so that many robots share what is compiled
        force = np.asarray(_needed(arrays(bare), *self._arm))
        return force.T.reshape(len(self.z), -1, len(force))


@eqx.filter_jit
def _needed(robot: Robot, angle, rate, acceleration):
    """M_ae q'' + c_ae + g_ae of many samples, (row, sample), in blocks that fit the cache."""

    def force(now):
        matrix, bias = arm_inertia_and_bias_columns(robot, now[0], now[1])
        return product(matrix, now[2]) + bias

    count = angle.shape[1]
    whole = -count % _BLOCK
    block = lambda x: jnp.pad(x, ((0, 0), (0, whole)), mode="edge").reshape(len(x), -1, _BLOCK).swapaxes(0, 1)
    forces = jax.lax.map(force, jnp.stack([block(x) for x in (angle, rate, acceleration)], axis=1))
    return forces.swapaxes(0, 1).reshape(len(angle), -1)[:, :count]


def _hinge_inertia(robot: Robot, q, axis: int, direction):
    chain, at = robot.chain, robot.driven_joints[axis]
    longer = chain.with_hinge(at, direction)
    angles = np.zeros(chain.n_joints)
    angles[list(robot.driven_joints)] = q
    M = np.asarray(mass_matrix(longer, np.insert(angles, at, 0.0)))
    arm = np.array(robot.arm_joints)
    coupling = np.zeros(robot.dof)
    coupling[robot.n_motors :] = M[at, arm + (arm >= at)]
    return coupling, M[at, at]


def _where_another(law, own, count: int):
    """Joints at which a law is another than the own one, and the law of these alone; of all joints, unless both are
    laws whose numbers stand joint by joint."""
    if not _differ(law, own):
        return np.arange(0), law
    values, before = jax.tree.leaves(law), jax.tree.leaves(own)
    if type(law) not in (Spring, Friction) or type(law) is not type(own) or len(values) != len(before):
        return np.arange(count), law
    differs = [np.broadcast_to(np.asarray(a) != np.asarray(b), count) for a, b in zip(values, before, strict=True)]
    places = np.flatnonzero(np.any(differs, axis=0))
    return places, jax.tree.map(lambda x: np.asarray(x)[places] if np.ndim(x) else x, law)


def _differ(one, other) -> bool:
    leaves = jax.tree.leaves(one), jax.tree.leaves(other)
    return len(leaves[0]) != len(leaves[1]) or any(
        np.shape(a) != np.shape(b) or np.any(np.asarray(a) != np.asarray(b)) for a, b in zip(*leaves, strict=True)
    )
