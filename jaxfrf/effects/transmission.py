"""What happens inside a transmission, beside its spring."""

import functools
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from .._text import number
from .._types import Array
from ._harmonics import checked, harmonics, polar_deviation
from ._place import arm_torque_limit, axis_of, own_spring, spring_of
from .effect import AbstractEffect, Candidate, Joint, OwnNumber, Reach
from .insertion import AbstractGearCoupling, AbstractGearError, AbstractGearTorque

if TYPE_CHECKING:
    from ..robot import Robot

Number = Float[Array, ""] | float

WAVES = ("sine_1", "cosine_1", "sine_2", "cosine_2")  # of `ToothWaves`
_TEETH = 1e-3  # relative standard deviation
_NOTHING = 0.02  # of the second order's amplitude


class TransmissionError(AbstractGearError):
    """The gear's output leads by an error of its teeth, e = sum_h amplitude_h sin(order_h N q_m/n + phase_h).

    The spring's deflection is x = q_m/n + e(q_m) - q_a then, and x' its rate; the motor feels tau (1/n + de/dq_m).

    **Arguments:** `joint`: a driven joint, name or number. `amplitude`: (order,), rad, arm side; 3e-5 is visible.
    `teeth`: N, errors per turn of the arm, not necessarily a multiple of the ratio n. `order`: of the teeth's
    frequency, whole numbers. `phase`: (order,), rad; 0 by default.

    In data: torque and acceleration at orders N/n of the motor's angle, which are mostly not whole, strongest where
    they meet a mode. In the linearised robot: not at all, but the point of rest knows it.

    **Raises:** `jaxfrf.InputError` unless amplitudes, orders and phases are as many; on a rigid transmission in
    `with_effects`.

    **Source:** Tuttle & Seering, IEEE Trans. Robotics and Automation 12 (1996) 368-374: the kinematic error of a
    harmonic drive as a sum of sines, here of any gear. The torque on the motor follows by virtual work.
    """

    name: ClassVar = "transmission_error"
    units: ClassVar = {"amplitude": "rad", "teeth": "1", "order": "1", "phase": "rad"}
    bounds: ClassVar = {
        "amplitude": (0.0, 3e-4),
        "teeth": (1.0, 1000.0),
        "order": (1.0, 50.0),
        "phase": (-math.pi, math.pi),
    }
    signature: ClassVar = "orders of the gear, mostly not whole orders of the motor's angle; strongest at the modes"
    confusable: ClassVar = {"torque_ripple": "orders of the motor's angle that are not whole"}

    joint: Joint = eqx.field(static=True)
    amplitude: Float[Array, "order"]
    teeth: Number
    order: tuple[int, ...] = eqx.field(static=True)
    phase: Float[Array, "order"]

    def __init__(self, joint: Joint, amplitude, teeth: Number, order=(1, 2), phase=None):
        self.joint, self.teeth = joint, teeth
        self.amplitude, self.order, self.phase = checked(self.name, amplitude, order, phase)

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        """Two errors a turn between motor and output, as of a strain-wave gear: 2 + 2/n per turn of the motor."""
        return cls(joint, [3e-5], 2.0 * jnp.abs(robot.drives.gear_ratio[axis_of(robot, joint)] + 1.0), (1,))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None: the orders are found in the data."""
        return ()

    @classmethod
    def candidates_at(cls, robot: "Robot", joint: Joint, orders: Iterable[float]) -> tuple[Candidate, ...]:
        """An error of the teeth at each of these orders of the motor's turn."""
        own_spring(robot, joint)
        ratio = abs(float(robot.drives.gear_ratio[axis_of(robot, joint)]))
        return tuple(cls(joint, [3e-5], order * ratio, (1,))._waves() for order in orders)

    def _waves(self) -> Candidate:
        """Sines and cosines of the first two orders, in parts of the first's amplitude: teeth are no sines, and the
        second order often meets a mode where the first does not."""
        size, zeros = float(self.amplitude[0]), dict.fromkeys(WAVES, 0.0)
        make = functools.partial(_geared, self.joint, self.teeth, size)
        basis = tuple(ToothWaves(self.joint, **zeros | {wave: size}, teeth=self.teeth) for wave in WAVES)
        wide, low = (math.inf,) * len(WAVES), (-math.inf,) * len(WAVES)
        return Candidate(self.name, str(self.joint), basis, make, low, wide, 1.0, f"{number(self.teeth, 4)} a turn")

    def lead(self, angle):
        return harmonics(self.amplitude, self.order, self.phase, self.teeth * angle)

    def in_numbers(self) -> AbstractEffect:
        """Sines and cosines of the first two orders; the effect as it is where it has others."""
        if not set(self.order) <= {1, 2}:
            return self
        waves = {1: (0.0, 0.0), 2: (0.0, 0.0)}
        for order, amplitude, phase in zip(self.order, self.amplitude, self.phase, strict=True):
            waves[order] = float(amplitude * np.cos(phase)), float(amplitude * np.sin(phase))
        return ToothWaves(self.joint, *waves[1], *waves[2], float(self.teeth))

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        now = self.in_numbers()
        return () if now is self else now.own_numbers(robot)


class ToothWaves(AbstractGearError):
    """`TransmissionError` of the first two orders, as a fit moves it: by sine and cosine, rad, arm side."""

    name: ClassVar = TransmissionError.name
    units: ClassVar = {"sine_1": "rad", "cosine_1": "rad", "sine_2": "rad", "cosine_2": "rad", "teeth": "1"}
    bounds: ClassVar = {name: (-3e-4, 3e-4) for name in WAVES} | {"teeth": (1.0, 1000.0)}
    signature: ClassVar = TransmissionError.signature
    confusable: ClassVar = TransmissionError.confusable

    joint: Joint = eqx.field(static=True)
    sine_1: Number
    cosine_1: Number
    sine_2: Number
    cosine_2: Number
    teeth: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        sine, teeth = 3e-5, TransmissionError.typical(robot, joint).teeth
        return cls(joint, sine, 0.0, 0.0, 0.0, teeth)

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        """The teeth are known from where a residual is in phase at all positions."""
        return tuple(
            OwnNumber(own.number, own.parameter, known=_TEETH if own.parameter == "teeth" else math.inf)
            for own in super().own_numbers(robot)
        )

    def lead(self, angle):
        turn = self.teeth * angle
        first = self.sine_1 * jnp.sin(turn) + self.cosine_1 * jnp.cos(turn)
        return first + self.sine_2 * jnp.sin(2.0 * turn) + self.cosine_2 * jnp.cos(2.0 * turn)

    def stated(self) -> TransmissionError:
        return self._stated()[0]

    def stated_values(self, parameters, covariance):
        error, rows = self._stated()
        waves = []
        for i, (amplitude, phase) in enumerate(zip(error.amplitude, error.phase, strict=True)):
            pair = [parameters.index(wave) for wave in WAVES[rows[i]]]
            std = polar_deviation(amplitude, phase, covariance[np.ix_(pair, pair)])
            place = f"_{i + 1}" if len(error.order) > 1 else ""
            values = {"amplitude": float(amplitude), "order": float(error.order[i]), "phase": float(phase)}
            waves.append({f"{name}{place}": (value, std.get(name, 0.0)) for name, value in values.items()})
        waves.sort(key=lambda wave: -next(value / max(std, 1e-300) for value, std in wave.values()))
        teeth = parameters.index("teeth")
        std = float(error.teeth / self.teeth) * float(np.sqrt(covariance[teeth, teeth]))
        return {name: value for wave in waves for name, value in wave.items()} | {"teeth": (float(error.teeth), std)}

    def _stated(self) -> tuple[TransmissionError, tuple[slice, ...]]:
        """With the places of its waves; the second order alone is an error of twice as many teeth."""
        rows = slice(0, 2), slice(2, 4)
        waves = np.array([float(getattr(self, wave)) for wave in WAVES]).reshape(2, 2)
        amplitude, phase = np.hypot(*waves.T), np.arctan2(waves[:, 1], waves[:, 0])
        if amplitude[0] < _NOTHING * amplitude[1]:
            return TransmissionError(self.joint, amplitude[1:], 2.0 * self.teeth, (1,), phase[1:]), rows[1:]
        return TransmissionError(self.joint, amplitude, self.teeth, (1, 2), phase), rows


def _geared(joint: Joint, teeth: Number, size: float, c) -> TransmissionError:
    waves = {wave: size * float(x) for wave, x in zip(WAVES, c, strict=True)}
    return ToothWaves(joint, **waves, teeth=teeth).stated()


_CORNERS = np.array([3.0, 17.3, 100.0])  # Hz, of the Maxwell elements
_WEIGHTS = np.array([1.5, 1.0, 1.5])  # their stiffness over loss k: the loss is within .75 % of it from 4 to 80 Hz
_TIMES = 1.0 / (2.0 * np.pi * _CORNERS)
_KEPT = 20.0  # Hz, where the stiffness is k
_SOFTER = float(np.sum(_WEIGHTS / (1.0 + np.square(_CORNERS / _KEPT))))  # times loss: at rest


class StructuralDamping(AbstractGearTorque):
    """Loss inside the gear's material, a stiffness k (1 + j loss) at every frequency.

    Causal by three Maxwell elements beside the transmission's spring, springs of 1.5, 1 and 1.5 loss k in series with
    dampers, corners at 3, 17.3 and 100 Hz: the loss is within .75 % of `loss` k from 4 to 80 Hz and falls beyond, to
    half at .95 and 320 Hz. The real part stays k at 20 Hz and rises by loss k (2/pi) ln(f/20 Hz), as causality asks;
    at rest the gear is softer by 2.1 loss k. A nonlinear spring loses `loss` of its local stiffness.

    **Arguments:** `joint`: a driven joint, name or number. `loss`: eta, 0-0.1; 0.02 is visible.

    In data: the same damping ratio over modes of all frequencies; two thirds of it hide in the damping d. In the
    linearised robot: exactly, as a complex stiffness (some 1e-9 of G in the aliases of a held torque); its state space
    does without.

    **Raises:** (in `with_effects`) `jaxfrf.InputError` on a rigid transmission.

    **Source:** a definition, the complex stiffness k (1 + j loss); the three Maxwell elements and their weights are
    this project's own fit to it.
    """

    name: ClassVar = "structural_damping"
    units: ClassVar = {"loss": "1"}
    bounds: ClassVar = {"loss": (0.0, 0.1)}
    signature: ClassVar = "the same damping ratio over modes of all frequencies"
    confusable: ClassVar = {
        "damping error": "positions with other mode frequencies",
        "arm_viscous_friction": "positions with other mode frequencies",
    }

    joint: Joint = eqx.field(static=True)
    loss: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.02)

    def start(self, deflection, tension):
        return tension, jnp.zeros((len(_TIMES), *tension.shape), tension.dtype)

    def advance(self, state, deflection, tension, elapsed):
        """State: the tension, and how much of it the damper of each element has not yet let go of."""
        before, stretch = state
        each = lambda x: jnp.reshape(jnp.asarray(x), (-1, *[1] * tension.ndim))
        part = elapsed / each(_TIMES)
        ramp = jnp.where(part > 0.0, -jnp.expm1(-part) / jnp.where(part > 0.0, part, 1.0), 1.0)
        stretch = jnp.exp(-part) * stretch + ramp * (tension - before)
        torque = self.loss * (jnp.sum(each(_WEIGHTS) * stretch, axis=0) - _SOFTER * tension)
        return torque, (tension, stretch)

    def response(self, s):
        elements = sum(weight * s * time / (1.0 + s * time) for weight, time in zip(_WEIGHTS, _TIMES, strict=True))
        return self.loss * (elements - _SOFTER)

    def stiffness(self, tangent):
        return self.loss * (_WEIGHTS.sum() - _SOFTER) * tangent


_YIELDS = np.array([0.25, 0.75, 1.25, 1.75])  # of `slip`: where each of the elements slips
_SLIPS = (3e-5, 1e-4, 3e-4)  # rad, that are tried
_STRONGEST = 20.0  # times the visible torque


class GearHysteresis(AbstractGearTorque):
    """Rate-independent friction inside the gear, between its output and its input.

    Four springs in series with a dry slider each (Jenkin elements, a Maxwell-slip model) beside the transmission's
    spring, each torque/(4 slip) stiff; they slip at 1/4, 3/4, 5/4 and 7/4 of `slip`. The torque rises with the slope
    torque/slip and bends over to `torque`; after a reversal it does so from the other side, over twice the way.

    **Arguments:** `joint`: a driven joint, name or number. `torque`: N m, arm side, where all slip, 0 or more; 2 % of
    the torque limit (n times the motor's) is visible. `slip`: rad, arm side, above 0; deflection at which they slip on
    average.

    In data: a loop of the gear's torque over its deflection that is the same at all speeds; odd distortion; damping
    and resonance fall with amplitude. In the linearised robot: not at all, its stiffness and damping are those of an
    amplitude. At rest it has relaxed: the spring carries all.

    **Raises:** (in `with_effects`) `jaxfrf.InputError` on a rigid transmission.

    **Source:** Iwan, J. Applied Mechanics 33 (1966) 893-900: elements in parallel, here four.
    """

    name: ClassVar = "gear_hysteresis"
    units: ClassVar = {"torque": "N m", "slip": "rad"}
    bounds: ClassVar = {"torque": (0.0, 500.0), "slip": (1e-5, 2e-3)}
    signature: ClassVar = "a loop of torque over deflection that is the same at all speeds; odd distortion"
    confusable: ClassVar = {
        "coulomb_friction": "slow runs of small amplitude: the torque bends over within the deflection `slip`",
        "stribeck_friction": "slow runs",
        "backlash": "positions with preload, where backlash vanishes",
    }

    joint: Joint = eqx.field(static=True)
    torque: Number
    slip: Number = 1e-4

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        limit = arm_torque_limit(robot, joint)
        return cls(joint, 0.02 * (limit if math.isfinite(limit) else 1000.0))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        spring_of(robot, joint)
        torque = float(cls.typical(robot, joint).torque)
        return tuple(cls(joint, torque, s).candidate(0.0, _STRONGEST * torque, f"slip {s:g} rad") for s in _SLIPS)

    def start(self, deflection, tension):
        return deflection, jnp.zeros((len(_YIELDS), *deflection.shape), deflection.dtype)

    def advance(self, state, deflection, tension, elapsed):
        """State: the deflection, and that of every element's spring."""
        before, stretch = state
        most = self.slip * jnp.reshape(jnp.asarray(_YIELDS), (-1, *[1] * deflection.ndim))
        stretch = jnp.clip(stretch + (deflection - before), -most, most)
        return self.torque / self.slip * jnp.mean(stretch, axis=0), (deflection, stretch)

    def response(self, s):
        return jnp.zeros_like(s)

    def stiffness(self, tangent):
        return jnp.broadcast_to(self.torque / self.slip, jnp.shape(tangent))


class WristCoupling(AbstractGearCoupling):
    """A gear that the axis before turns too, as in wrists whose shafts run through one another.

    q_m = n (q_a + ratio q_(a, before)) of a stiff gear: `joint` is the axis whose motor is turned, the axis before it
    is the one that turns it. Its spring is deflected by x = q_m/n - q_a - ratio q_(a, before) and pulls the axis before
    by ratio times its torque.

    **Arguments:** `ratio`: turns of the gear's output for a turn of the axis before, +-0.1; 0.02 is visible.

    In data: the off-diagonal elements of G between the two axes, at all frequencies and positions. In the linearised
    robot: exactly.

    On a rigid transmission it is used where torques are compared along a measured motion; simulations refuse it.

    **Raises:** (in `with_effects`) `jaxfrf.InputError` on the first axis.

    **Source:** a definition: an element beside the diagonal of the gear ratios r_g of the paper, section III.A; the
    torques follow by virtual work.
    """

    name: ClassVar = "wrist_coupling"
    units: ClassVar = {"ratio": "1"}
    bounds: ClassVar = {"ratio": (-0.1, 0.1)}
    signature: ClassVar = "the off-diagonal elements between neighbouring axes (G45, G56) at all frequencies"
    confusable: ClassVar = {"inertia error": "positions: the coupling does not depend on them"}

    joint: Joint = eqx.field(static=True)
    ratio: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.02)

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        raise input_error(
            cls.name, "a measured motion", "a simulated one: gears have one motor each here", "See `jaxfrf.calibrate`."
        )

    def check(self, robot: "Robot"):
        if axis_of(robot, self.joint) == 0:
            raise input_error(
                f"wrist_coupling on {robot.name}",
                f"{robot.axis_names[0]}, the first axis",
                "an axis with another one before it",
                "Name the axis whose motor is turned by the one before.",
            )
