"""Frequency response of the linearised robot, as a sampled experiment sees it, and its derivative in the parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Complex, Float

from .._errors import input_error
from .._types import Array
from ..experiment import QUANTITIES
from .linearise import LinearRobot, linearise, local_stiffness, operating_point
from .robot import Robot, spring_directions


class ZeroOrderHold(eqx.Module):
    """The torque is held from sample to sample and the motion is sampled.

    The FRF between the samples is then the sum of the response at all aliases of a frequency,

        G_d(w) = e^{-j w T} sum_m (1 - e^{-s T})/(s T) G(s),   s = j (w + m 2 pi/T),

    exactly the discrete-time G_d(z) = C (z - A_d)^{-1} B_d. The common factor sinc(w T/2) e^{-j w T/2} is its term m = 0
    alone; it is .046 dB off at 80 Hz for a free motor sampled at 2 kHz, and ten times that in an antiresonance. The
    aliases are summed in closed form from the expansion of G in 1/s to `order` terms. That fails where modes come near
    the sampling frequency: the error is about (mode/sampling frequency)^order, see `hold_remainder`; `discrete_frf`
    has no such limit.

    **Arguments:** `sampling_frequency`: Hz. `measured`: the quantity that is sampled, `position` or `velocity`; any other
    is obtained from its spectrum by (j w)^n. `order`: terms of the expansion.
    """

    sampling_frequency: float
    measured: str = eqx.field(static=True, default="velocity")
    order: int = eqx.field(static=True, default=4)

    def __check_init__(self):
        if self.measured not in ("position", "velocity"):
            raise input_error(
                "measured",
                repr(self.measured),
                "position or velocity (a held torque makes the acceleration jump at the very samples)",
                "Name what the encoder gives.",
            )


class ParametricResponse(eqx.Module):
    """An FRF and its derivative in the parameters of the linearised robot.

    **Fields:** `G`: (*batch, freq, axis, axis). `jacobian`: dG/dtheta, (*batch, freq, axis, axis, parameter).
    `names`: of the parameters, as `joint1.stiffness`, `bearing2.damping`, `joint1.effective_friction`.
    """

    G: Complex[Array, "*batch freq axis axis"]
    jacobian: Complex[Array, "*batch freq axis axis parameter"]
    names: tuple[str, ...] = eqx.field(static=True)


def frf(
    model: LinearRobot,
    frequency: Float[Array, "freq"],
    quantity: str = "velocity",
    hold: ZeroOrderHold | None = None,
    delay: Float[Array, "axis"] | float = 0.0,
) -> Complex[Array, "*batch freq axis axis"]:
    """FRF from motor torque to motor position, velocity or acceleration, G = (j w)^n B^T (K + j w D - w^2 M)^{-1} B.

    Differentiable in everything; `frf_and_jacobian` is faster for springs, dampers and friction.

    **Arguments:** `frequency`: Hz, above 0. `hold`: how the torque is held and the motion sampled; `None` = continuous.
    `delay`: of each torque, s, held or not; parts of a sample count. **Returns:** (*batch, freq, axis, axis).
    """
    frequency = jnp.asarray(frequency)
    omega = 2.0 * jnp.pi * frequency
    position = model.motor.T @ _motion(model, omega)
    factor, corrections = _sampling(omega, quantity, hold, delay)
    return position * factor + _aliases(model, hold, corrections)


def frf_and_jacobian(
    robot: Robot,
    arm_angles: Float[Array, "*batch axis"],
    frequency: Float[Array, "freq"],
    quantity: str = "velocity",
    hold: ZeroOrderHold | None = None,
    delay: Float[Array, "axis"] | float = 0.0,
    friction: Float[Array, "axis"] | None = None,
    swing: Float[Array, "sample spring"] | None = None,
) -> ParametricResponse:
    """FRF at operating points under gravity, and its derivative in every stiffness, damping and effective friction.

    A spring between coordinates along w adds k w w^T to the dynamic stiffness S, so with X = S^{-1} B, which G needs anyway,

        dG/dk = -(w^T X)^T (w^T X),   dG/dd = -j w (w^T X)^T (w^T X),

    an outer product. The stiffness of an elastic joint also moves the equilibrium, and with it inertia, gravity and the
    other springs' local stiffness; that part is included. Stiffness means k at high deflection where a spring is nonlinear.

    **Arguments:** `arm_angles`: (*batch, axis), rad. Others as in `frf` and `linearise`.
    """
    arm_angles = jnp.asarray(arm_angles)
    omega = 2.0 * jnp.pi * jnp.asarray(frequency)
    friction = robot.drives.friction.viscous if friction is None else jnp.asarray(friction)
    factor, corrections = _sampling(omega, quantity, hold, delay)

    def at(angles):
        model, slope = _with_slopes(robot, angles, friction, swing)
        X = _motion(model, omega)
        G = (model.motor.T @ X) * factor + _aliases(model, hold, corrections)
        derivative = _rank_one(robot, model, slope, X, omega) * factor[..., None]
        if hold is not None:
            derivative = derivative + _alias_slopes(robot, model, slope, hold, corrections)
        return G, derivative

    G, jacobian = jax.lax.map(at, arm_angles.reshape(-1, arm_angles.shape[-1]))
    batch = arm_angles.shape[:-1]
    return ParametricResponse(
        G.reshape(*batch, *G.shape[1:]), jacobian.reshape(*batch, *jacobian.shape[1:]), parameter_names(robot)
    )


def parameter_names(robot: Robot) -> tuple[str, ...]:
    """Names of the parameters of `frf_and_jacobian`: all stiffnesses, all dampings, all effective frictions."""
    return (
        *(f"{joint}.stiffness" for joint in robot.spring_names),
        *(f"{joint}.damping" for joint in robot.spring_names),
        *(f"{joint}.effective_friction" for joint in robot.axis_names),
    )


def hold_remainder(model: LinearRobot, hold: ZeroOrderHold) -> Float[Array, "*batch"]:
    """How large the first term is that `ZeroOrderHold.order` leaves out, over the first one: (*batch,)."""
    terms = _high_frequency(model, hold.order + 2)
    period = 1.0 / (2.0 * jnp.pi * hold.sampling_frequency)
    size = [jnp.max(jnp.abs(term), axis=(-1, -2)) for term in terms]
    return jnp.maximum(size[-2] * period ** (hold.order - 0), size[-1] * period ** (hold.order + 1)) / size[0]


def _motion(model: LinearRobot, omega):
    """X = S(w)^{-1} B, coordinates per unit torque: (*batch, freq, dof, axis)."""
    w = omega[:, None, None]
    mass, damping, stiffness = (x[..., None, :, :] for x in (model.mass, model.damping, model.stiffness))
    dynamic = stiffness - jnp.square(w) * mass + 1j * w * damping
    return jnp.linalg.solve(dynamic, jnp.broadcast_to(model.motor, (*dynamic.shape[:-1], model.motor.shape[1])))


def _sampling(omega, quantity: str, hold: ZeroOrderHold | None, delay):
    """What multiplies the position FRF, (freq, 1, axis), and the coefficients of the terms in 1/s, (term, freq, 1, axis)."""
    if quantity not in QUANTITIES:
        raise input_error("quantity", repr(quantity), "position, velocity or acceleration", "Choose one of them.")
    s = 1j * omega[:, None, None]
    delay = jnp.asarray(delay)
    late = jnp.exp(-s * delay)
    if hold is None:
        return s ** QUANTITIES[quantity] * late, None
    differentiate = s ** (QUANTITIES[quantity] - QUANTITIES[hold.measured])
    measured = s ** QUANTITIES[hold.measured]
    T = 1.0 / hold.sampling_frequency
    held = -jnp.expm1(-s * T) / (s * T) * late
    first = 2 - QUANTITIES[hold.measured]  # the position falls with s^-2, the velocity with s^-1
    chain = _held_integrators(s, T, delay, first + hold.order - 1)[first - 1 :]
    corrections = [held_power - held * s**-p for p, held_power in enumerate(chain, first)]
    return held * measured * differentiate, jnp.stack(corrections) * differentiate


def _held_integrators(s, T: float, delay, count: int):
    """FRF between samples of 1/s, 1/s^2, ... behind a zero-order hold whose output is late by `delay`.

    Over one sample x_p grows by sum_i T^i/i! x_{p-i} and by what the held input adds: with delay = (d + g) T, the older
    input acts for g T and the newer one for the rest (the modified z-transform).
    """
    z = jnp.exp(s * T)
    whole = jnp.floor(delay / T + 1e-9)
    rest = 1.0 - (delay / T - whole)
    states, factorial = [], 1.0
    powers = [1.0]
    for p in range(1, count + 1):
        factorial *= p
        powers.append(T**p / factorial)
        driven = powers[p] * (rest**p + (1.0 - rest**p) / z)
        states.append((sum(powers[i] * states[p - i - 1] for i in range(1, p)) + driven) / (z - 1.0))
    return [x * z**-whole for x in states]


def _high_frequency(model: LinearRobot, count: int):
    """Coefficients of s^-2, s^-3, ... of the position FRF, each (*batch, axis, axis)."""
    motor = jnp.broadcast_to(model.motor, (*model.mass.shape[:-2], *model.motor.shape))
    terms = [jnp.linalg.solve(model.mass, motor)]
    older = jnp.zeros_like(terms[0])
    for _ in range(count - 1):
        newer = -jnp.linalg.solve(model.mass, model.damping @ terms[-1] + model.stiffness @ older)
        older = terms[-1]
        terms.append(newer)
    return [model.motor.T @ x for x in terms]


def _aliases(model: LinearRobot, hold: ZeroOrderHold | None, corrections):
    """What all aliases together add to the FRF: (*batch, freq, axis, axis)."""
    if hold is None:
        return 0.0
    terms = _high_frequency(model, hold.order)
    return sum(term[..., None, :, :] * c for term, c in zip(terms, corrections, strict=True))


class _Slopes(eqx.Module):
    """Derivatives at one operating point in the springs' stiffness: `local` of each local stiffness in its own k, (spring,);
    `mass`, `stiffness` of the whole matrices in the elastic joints' k, (dof, dof, elastic)."""

    local: jax.Array
    mass: jax.Array
    stiffness: jax.Array


def _with_slopes(robot: Robot, angles, friction, swing) -> tuple[LinearRobot, _Slopes]:
    n_gears = robot.n_motors

    def of(k):
        changed = eqx.tree_at(lambda r: r.springs.stiffness, robot, k)
        point = operating_point(changed, angles)
        model = linearise(changed, point, friction, swing)
        return (local_stiffness(changed, point, swing), model.mass, model.stiffness), model

    (local, mass, stiffness), model = jax.jacfwd(of, has_aux=True)(robot.springs.stiffness)
    return model, _Slopes(jnp.diagonal(local), mass[..., n_gears:], stiffness[..., n_gears:])


def _rank_one(robot: Robot, model: LinearRobot, slope: _Slopes, X, omega):
    """Derivative of the position FRF: (freq, axis, axis, parameter)."""
    n_gears = robot.n_motors
    across = jnp.swapaxes(spring_directions(robot), 0, 1) @ X  # (freq, spring, axis)
    turned = jnp.swapaxes(model.motor, 0, 1) @ X
    spring = -across[:, :, :, None] * across[:, :, None, :]
    friction = -turned[:, :, :, None] * turned[:, :, None, :]
    s = 1j * omega[:, None, None, None]
    gears = spring[:, :n_gears] * slope.local[:n_gears, None, None]
    moved = jnp.moveaxis(slope.stiffness, -1, 0) - jnp.square(omega)[:, None, None, None] * jnp.moveaxis(slope.mass, -1, 0)
    elastic = -jnp.einsum("fio,feij,fja->feoa", X, moved, X)
    columns = jnp.concatenate([gears, elastic, s * spring, s * friction], axis=1)
    return jnp.moveaxis(columns, 1, -1)


def _alias_slopes(robot: Robot, model: LinearRobot, slope: _Slopes, hold: ZeroOrderHold, corrections):
    """Derivative of `_aliases`: (freq, axis, axis, parameter)."""
    springs, n_gears, n_elastic = spring_directions(robot), robot.n_motors, robot.n_elastic
    n_springs, dof = n_gears + n_elastic, robot.dof
    squares = jnp.einsum("is,js->sij", springs, springs)
    turns = jnp.einsum("ia,ja->aij", model.motor, model.motor)
    none = jnp.zeros((n_springs + robot.n_axes, dof, dof))
    gears = squares[:n_gears] * slope.local[:n_gears, None, None]
    mass = jnp.concatenate([jnp.zeros((n_gears, dof, dof)), jnp.moveaxis(slope.mass, -1, 0), none])
    stiffness = jnp.concatenate([gears, jnp.moveaxis(slope.stiffness, -1, 0), none])
    damping = jnp.concatenate([jnp.zeros((n_springs, dof, dof)), squares, turns])

    def along(dm, dd, dk):
        tangent = LinearRobot(dm, dd, dk, jnp.zeros_like(model.motor))
        return jnp.stack(jax.jvp(lambda m: tuple(_high_frequency(m, hold.order)), (model,), (tangent,))[1])

    terms = jax.vmap(along)(mass, damping, stiffness)  # (parameter, term, axis, axis)
    return jnp.einsum("ptoa,tfoa->foap", terms, jnp.broadcast_to(corrections, (*corrections.shape[:2], *terms.shape[2:])))
