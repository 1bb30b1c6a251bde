"""From the commanded torque to the motor's."""

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import input_error
from .._text import number
from .._types import Array
from ._harmonics import by_order, checked, harmonics
from ._place import axis_of, stated
from .effect import Candidate, Joint, OwnNumber, Reach
from .insertion import AbstractActuator, AbstractMotorTorque, AbstractStatelessActuator

if TYPE_CHECKING:
    from ..robot import Robot

Number = Float[Array, ""] | float


_LEAST_ROOM = 2e-3  # s, that a delay is given: a fit moves it
_MOST_ROOM = 2e-2  # s: a longer delay is taken for a wrong unit


def _room(delay: Number) -> float:
    if isinstance(delay, jax.core.Tracer) or not float(delay) > _LEAST_ROOM:
        return _LEAST_ROOM
    return min(math.ceil(1e3 * float(delay) - 1e-9) / 1e3, _MOST_ROOM)


class TorqueDelay(AbstractActuator):
    """The torque comes late, u(t - delay): e^{-s delay}.

    Any delay from 0 to `longest`, not only whole samples; exact on the fine steps of the simulation, between them
    the mean torque of a step is.

    **Arguments:** `joint`: a driven joint, name or number. `delay`: s; 0.3 ms is visible. `longest`: s, how much of the
    past is kept; by default 2 ms, or, where `delay` is a longer one, as many whole ms as hold it, up to 20.

    In data: phase -omega delay in the motor's column of G. In the linearised robot: exactly.

    **Raises:** `jaxfrf.InputError` for a delay below 0 or above `longest`.

    **Source:** a definition; between two fine steps the delayed torque is shared as in the sampling of delayed systems
    in Åström & Wittenmark, Computer-Controlled Systems, 3rd ed. 1997.
    """

    name: ClassVar = "torque_delay"
    units: ClassVar = {"delay": "s"}
    bounds: ClassVar = {"delay": (0.0, 2e-3)}
    signature: ClassVar = "phase -omega delay in one column of G"
    confusable: ClassVar = {"current_loop_lag": "above 300 Hz, or a step of torque; one class in 4-80 Hz"}
    alike: ClassVar = ("current_loop_lag",)
    is_linear: ClassVar = True
    drive_number: ClassVar = "delay"

    joint: Joint = eqx.field(static=True)
    delay: Number
    longest: float = eqx.field(static=True)

    def __init__(self, joint: Joint, delay: Number, longest: float | None = None):
        self.joint, self.delay = joint, delay
        self.longest = _room(delay) if longest is None else longest

    def __check_init__(self):
        if isinstance(self.delay, int | float | np.ndarray) and not 0.0 <= float(self.delay) <= self.longest:
            raise input_error(
                "torque_delay: delay",
                f"{self.delay} s",
                f"0 to longest = {self.longest:g} s",
                "State it in seconds, or raise longest.",
            )

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 3e-4)

    @classmethod
    def in_drive(cls, joint: Joint, value: float, had: Sequence[Self]) -> Self | None:
        if not value > 0.0:
            return None
        late = cls(joint, jnp.asarray(value, float))
        return cls(joint, late.delay, max([late.longest, *(e.longest for e in had)]))

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        had = stated(robot, TorqueDelay, self.joint, "delay")
        return (OwnNumber(f"{robot.axis_names[axis_of(robot, self.joint)]}.delay", "delay", had),)

    def start(self, torque, step):
        kept = math.ceil(self.longest / step) + 1
        return jnp.broadcast_to(torque, (kept, *torque.shape))

    def advance(self, state, torque, step):
        line = jnp.concatenate([state, torque])
        whole = jnp.clip(jnp.floor(self.delay / step + 1e-9), 0, state.shape[0] - 1)
        part = jnp.clip(self.delay / step - whole, 0.0, 1.0)  # beyond what is kept, as late as that
        first = state.shape[0] - 1 - whole.astype(int)
        late = jax.lax.dynamic_slice_in_dim(line, first, torque.shape[0] + 1)
        return (1.0 - part) * late[1:] + part * late[:-1], line[torque.shape[0] :]

    def response(self, s):
        return jnp.ones_like(s)

    def dead_time(self):
        return self.delay


class CurrentLoopLag(AbstractActuator):
    """The current loop follows with a first-order lag, 1/(1 + s time_constant).

    **Arguments:** `joint`: a driven joint, name or number. `time_constant`: s, above 0; 0.3 ms is visible.

    In data: as a delay. In the linearised robot: exactly but for the aliases of a held torque, of which it damps
    none (some 1e-4 of G).

    **Source:** Leonhard, Control of Electrical Drives, 3rd ed. 2001, where a closed current loop is approximated by a
    first-order lag.
    """

    name: ClassVar = "current_loop_lag"
    units: ClassVar = {"time_constant": "s"}
    bounds: ClassVar = {"time_constant": (0.0, 2e-3)}
    signature: ClassVar = "phase -omega time_constant in one column of G"
    confusable: ClassVar = {"torque_delay": "above 300 Hz, or a step of torque; one class in 4-80 Hz"}
    alike: ClassVar = ("torque_delay",)
    is_linear: ClassVar = True

    joint: Joint = eqx.field(static=True)
    time_constant: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 3e-4)

    def start(self, torque, step):
        return torque

    def advance(self, state, torque, step):
        left = jnp.exp(-step / self.time_constant)
        mean = self.time_constant / step * (1.0 - left)

        def fine(old, new):
            return new + (old - new) * left, new + (old - new) * mean

        state, out = jax.lax.scan(fine, state, torque)
        return out, state

    def response(self, s):
        return 1.0 / (1.0 + s * self.time_constant)


class TorqueConstant(AbstractStatelessActuator):
    """An error of the torque constant: the motor gives (1 + error) u.

    **Arguments:** `joint`: a driven joint, name or number. `error`: +-0.1; 0.02 is visible.

    In data: a flat gain of the motor's column of G, no phase. In the linearised robot: exactly.

    **Source:** a definition.
    """

    name: ClassVar = "torque_constant"
    units: ClassVar = {"error": "1"}
    bounds: ClassVar = {"error": (-0.1, 0.1)}
    signature: ClassVar = "a flat gain of one column of G, without phase"
    confusable: ClassVar = {"motor_inertia": "high against low frequencies"}
    is_error: ClassVar = True
    is_linear: ClassVar = True
    drive_number: ClassVar = "torque_constant"

    joint: Joint = eqx.field(static=True)
    error: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.02)

    @classmethod
    def in_drive(cls, joint: Joint, value: float, had: Sequence[Self]) -> Self | None:
        """One of nothing stays: robots then share what is compiled."""
        stays = bool(had) and float(had[0].error) == 0.0
        return cls(joint, jnp.asarray(value, float)) if value != 0.0 or stays else None

    def own_numbers(self, robot: "Robot") -> tuple[OwnNumber, ...]:
        had = stated(robot, TorqueConstant, self.joint, "error")
        return (OwnNumber(f"{robot.axis_names[axis_of(robot, self.joint)]}.{self.name}", "error", had),)

    def drive(self, torque):
        return (1.0 + self.error) * torque

    def response(self, s):
        return (1.0 + self.error) * jnp.ones_like(s)


_CLIPPED = (0.9, 0.8, 0.65, 0.5, 0.4)  # of the largest command, where a drive is tried to clip


def _as_it_is(effect, c):
    return effect


class TorqueSaturation(AbstractStatelessActuator):
    """The drive clips the torque, clip(u, -limit, limit), below the limit that the controller knows.

    **Arguments:** `joint`: a driven joint, name or number. `limit`: N m, motor side; 0.8 of the largest torque is
    visible.

    In data: at high amplitude only, flat tops of the motor's acceleration. In the linearised robot: not at all, it
    is linear below the limit.

    **Source:** a definition, the ideal saturation; Gelb & Vander Velde, Multiple-Input Describing Functions and
    Nonlinear System Design, 1968, have its gain for sines.
    """

    name: ClassVar = "torque_saturation"
    units: ClassVar = {"limit": "N m"}
    bounds: ClassVar = {"limit": (0.0, math.inf)}
    signature: ClassVar = "at high amplitude only: flat tops"
    confusable: ClassVar = {"backlash": "another amplitude"}
    grows: ClassVar = False

    joint: Joint = eqx.field(static=True)
    limit: Number

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 0.5 * robot.drives.torque_limit[axis_of(robot, joint)])

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """At parts of the largest command: whatever it is clipped at, its torque is that of the limit."""
        these = [cls(joint, part * largest) for part in _CLIPPED]
        label = "limit {:.3g} N m".format
        return tuple(
            Candidate(cls.name, str(joint), (e,), functools.partial(_as_it_is, e), (0.3,), (3.0,), 0.3, label(e.limit))
            for e in these
        )

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        raise input_error(
            cls.name, "a measured motion", "a simulated one: a clipped torque has no inverse", "See `jaxfrf.screen`."
        )

    def drive(self, torque):
        return jnp.clip(torque, -self.limit, self.limit)

    def response(self, s):
        return jnp.ones_like(s)


class TorqueRipple(AbstractMotorTorque):
    """Torque that depends on the motor's angle, sum_h amplitude_h sin(order_h theta + phase_h).

    **Arguments:** `joint`: a driven joint, name or number. `amplitude`: (order,), N m, motor side; 0.01 of the torque
    limit is visible. `order`: per motor turn, whole numbers, 1-50. `phase`: (order,), rad; 0 by default.

    In data: lines at orders of the motor's angle, of an amplitude that does not depend on the speed. It repeats
    with the period, so more periods do not average it out. In the linearised robot: not at all.

    **Raises:** `jaxfrf.InputError` unless amplitudes, orders and phases are as many.

    **Source:** a definition, a sum of sines of the motor position as in the paper, section IV.A; where such ripple
    comes from: Holtz & Springob, IEEE Trans. Industrial Electronics 43 (1996) 309-320. Ripple of a real motor may grow
    with its current, this does not.
    """

    name: ClassVar = "torque_ripple"
    units: ClassVar = {"amplitude": "N m", "order": "1", "phase": "rad"}
    bounds: ClassVar = {"amplitude": (0.0, 0.5), "order": (1.0, 50.0), "phase": (-math.pi, math.pi)}
    signature: ClassVar = "orders of the motor's angle, amplitude independent of speed"
    confusable: ClassVar = {"resolver_ripple": "amplitude against speed", "transmission_error": "whole orders"}

    joint: Joint = eqx.field(static=True)
    amplitude: Float[Array, "order"]
    order: tuple[int, ...] = eqx.field(static=True)
    phase: Float[Array, "order"]

    def __init__(self, joint: Joint, amplitude, order=(1, 2, 6, 18), phase=None):
        self.joint = joint
        self.amplitude, self.order, self.phase = checked(self.name, amplitude, order, phase)

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        limit = robot.drives.torque_limit[axis_of(robot, joint)]
        return cls(joint, 0.01 * jnp.where(jnp.isfinite(limit), limit, 1.0)[None], (6,))

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None: the orders are found in the data."""
        return ()

    @classmethod
    def along_motion(cls, robot: "Robot", joint: Joint, reach: Reach) -> tuple[Candidate, ...]:
        return by_order(cls, joint, reach, float(cls.typical(robot, joint).amplitude[0]))

    def torque(self, angle):
        return harmonics(self.amplitude, self.order, self.phase, angle)


_STARTS = 7  # antiresonances over the band
_APART = 1.3  # resonance over antiresonance, at the start
_APART_WITHIN = 0.1, 30.0  # sqrt(1 + load/motor), in a search, where another effect may still be missing
_DAMPED = 0.03  # damping ratio at the start
_DAMPED_WITHIN = 1e-5, 50.0  # in a search
_MODE = 1.005, 0.5  # resonance over antiresonance from which on, and damping ratio up to which a pair is a mode


class ElasticLoad(AbstractActuator):
    """A drive that was taken as rigid has its load behind a spring, as its motor sees it: one more mode,
    (1 + 2 z_a s/w_a + s^2/w_a^2)/(1 + 2 z_r s/w_r + s^2/w_r^2) of the torque that turns all of the inertia.

    Exact for the motor of a single drive, w_r/w_a = sqrt(1 + load/motor); in a robot other axes feel the load otherwise
    (`ExtraFlexibility`, or a stiffness of the joint).

    **Arguments:** `joint`: a driven joint, name or number. `antiresonance`, `resonance`: w/(2 pi), Hz.
    `antiresonance_damping`, `resonance_damping`: z.

    In data: a pair of antiresonance and resonance of a drive's FRF. In the linearised robot: exactly.

    **Source:** closed form of two inertias with a linear spring and damper between them, for which z_r/z_a = w_r/w_a;
    here both dampings are free.
    """

    name: ClassVar = "elastic_load"
    units: ClassVar = {
        "antiresonance": "Hz",
        "resonance": "Hz",
        "antiresonance_damping": "1",
        "resonance_damping": "1",
    }
    bounds: ClassVar = {
        "antiresonance": (0.1, 1e5),
        "resonance": (0.1, 1e5),
        "antiresonance_damping": (0.0, 2.0),
        "resonance_damping": (0.0, 2.0),
    }
    signature: ClassVar = "a pair of antiresonance and resonance in the FRF of a single drive"
    confusable: ClassVar = {"current_loop_lag": "lines above the resonance, where a mode gives back the phase"}
    is_linear: ClassVar = True
    is_mechanical: ClassVar = True

    joint: Joint = eqx.field(static=True)
    antiresonance: Number
    resonance: Number
    antiresonance_damping: Number = _DAMPED
    resonance_damping: Number = _DAMPED

    @classmethod
    def typical(cls, robot: "Robot", joint: Joint) -> Self:
        return cls(joint, 50.0, 50.0 * _APART)

    @classmethod
    def candidates(cls, robot: "Robot", joint: Joint, largest: float) -> tuple[Candidate, ...]:
        """None: its frequencies are found in an FRF."""
        return ()

    @classmethod
    def over_band(cls, robot: "Robot", joint: Joint, low: float, high: float) -> tuple[Candidate, ...]:
        """From antiresonances all over the band, fitted in logarithms: of the antiresonance, of the resonance over it,
        and of both dampings."""
        if robot.n_axes > 1:
            return ()
        found = []
        least, most = (
            tuple(float(np.log(x)) for x in (f, apart, z, z))
            for f, apart, z in zip((low, high), _APART_WITHIN, _DAMPED_WITHIN, strict=True)
        )
        make = functools.partial(_of_logarithms, joint)
        for f in np.geomspace(_APART * low, high / _APART, _STARTS):
            start = tuple(float(np.log(x)) for x in (f, _APART, _DAMPED, _DAMPED))
            found.append(Candidate(cls.name, str(joint), (), make, least, most, 1.0, f"from {number(f)} Hz", start))
        return tuple(found)

    @property
    def believable(self) -> bool:
        """A pair that is damped more, or whose resonance comes first, shapes phases, and is no mode."""
        apart, damping = _MODE
        damped = max(float(self.antiresonance_damping), float(self.resonance_damping))
        return float(self.resonance) > apart * float(self.antiresonance) and damped < damping

    def start(self, torque, step):
        return torque, jnp.zeros_like(torque)

    def advance(self, state, torque, step):
        """State: what the filter follows, and its rate; exact for a torque that is constant within a step, of which the
        mean goes out."""
        w = 2.0 * jnp.pi * self.resonance
        lead = 2.0 * self.antiresonance_damping / (2.0 * jnp.pi * self.antiresonance)
        # [x, x', integral of x] of x'' + 2 z w x' + w^2 x = w^2 torque over a step
        A = jnp.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * self.resonance_damping * w, 0.0], [1.0, 0.0, 0.0]])
        step_matrix = jax.scipy.linalg.expm(A * step)

        def fine(old, new):
            x, rate = old
            x = x - new
            after = step_matrix[0, 0] * x + step_matrix[0, 1] * rate + new
            faster = step_matrix[1, 0] * x + step_matrix[1, 1] * rate
            mean = (step_matrix[2, 0] * x + step_matrix[2, 1] * rate) / step + new
            # torque = x + lead x' + x''/w_a^2, its mean over the step
            turned = (faster - rate) / step / jnp.square(2.0 * jnp.pi * self.antiresonance)
            return (after, faster), mean + lead * (after - x - new) / step + turned

        state, out = jax.lax.scan(fine, state, torque)
        return out, state

    def response(self, s):
        pair = lambda f, z: 1.0 + (2.0 * z + s / (2.0 * math.pi * f)) * s / (2.0 * math.pi * f)
        above = pair(self.antiresonance, self.antiresonance_damping)
        return above / pair(self.resonance, self.resonance_damping)


def _of_logarithms(joint, c):
    antiresonance, apart, *damping = (float(x) for x in np.exp(c))
    return ElasticLoad(joint, antiresonance, apart * antiresonance, *damping)
