"""Frequency response of the linearised robot, as a sampled experiment sees it, and its derivatives."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._errors import input_error
from .._types import Array
from .linearise import LinearRobot, gravity_stiffness, linearise, local_stiffness, operating_point
from .quantity import derivatives
from .robot import Robot, arm_inertia, spring_directions


class ZeroOrderHold(eqx.Module):
    """The torque is held from sample to sample and the motion is sampled.

    The FRF between the samples is then the sum of the response at all aliases of a frequency,

        G_d(w) = e^{-j w T} sum_m (1 - e^{-s T})/(s T) G(s),   s = j (w + m 2 pi/T),

    exactly the discrete-time G_d(z) = C (z - A_d)^{-1} B_d. The common factor sinc(w T/2) e^{-j w T/2} is its
    term m = 0 alone: for a motor speed sampled at 2 kHz it is .05 dB off at 80 Hz. The aliases are summed in
    closed form from the expansion of G in 1/s to `order` terms. That fails where modes come near the sampling
    frequency: the error is about (mode/sampling frequency)^order, see `hold_remainder`; `discretise` and
    `state_space_frf` have no such limit.

    **Arguments:** `sampling_frequency`: Hz. `measured`: the quantity that is sampled, `position` or
    `velocity`; any other is obtained from its spectrum by (j w)^n. `order`: terms of the expansion.
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
    """FRF from motor torque to motor position, velocity or acceleration, G = (j w)^n B^T (K + j w D - w^2
    M)^{-1} B.

    Differentiable in everything; `frf_and_jacobian` is faster for springs, dampers and friction.

    **Arguments:** `frequency`: Hz, above 0. `hold`: how the torque is held and the motion sampled; `None` =
    continuous. `delay`: of each torque, s, held or not; parts of a sample count. **Returns:** (*batch, freq,
    axis, axis).
    """
    return _frf(model, jnp.asarray(frequency), quantity, hold, jnp.asarray(delay))


@eqx.filter_jit
def _frf(model: LinearRobot, frequency, quantity: str, hold: ZeroOrderHold | None, delay):
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
    """FRF at operating points under gravity, and its derivative in every stiffness, damping and effective
    friction.

    A spring between coordinates along w adds k w w^T to the dynamic stiffness S, so with X = S^{-1} B, which
    G needs anyway,

        dG/dk = -(w^T X)^T (w^T X),   dG/dd = -j w (w^T X)^T (w^T X),

    an outer product. The stiffness of an elastic joint also moves the equilibrium, and with it inertia,
    gravity and the other springs' local stiffness; that part is included. Stiffness means k at high
    deflection where a spring is nonlinear.

    **Arguments:** `arm_angles`: (*batch, axis), rad. Others as in `frf` and `linearise`.
    """
    friction = robot.drives.friction.viscous if friction is None else friction
    arrays = (jnp.asarray(x) for x in (arm_angles, frequency, delay, friction))
    return _frf_and_jacobian(robot, *arrays, quantity, hold, swing)


@eqx.filter_jit
def _frf_and_jacobian(robot: Robot, arm_angles, frequency, delay, friction, quantity, hold, swing):
    omega = 2.0 * jnp.pi * frequency
    factor, corrections = _sampling(omega, quantity, hold, delay)

    flat = arm_angles.reshape(-1, arm_angles.shape[-1])

    model, slopes = _with_slopes(robot, flat, friction, swing)
    motor, partners = model.motor, model.partners

    def at(position):
        (mass, damping, stiffness), slope = position
        model = LinearRobot(mass, damping, stiffness, motor, partners)
        X = _motion(model, omega)
        G = (motor.T @ X) * factor + _aliases(model, hold, corrections)
        derivative = _rank_one(robot, model, slope, X, omega, factor)
        if hold is not None:
            derivative = derivative + _alias_slopes(robot, model, slope, hold, corrections)
        return G, derivative

    # One position after the other: what a position needs then stays in the cache.
    G, jacobian = jax.lax.map(at, ((model.mass, model.damping, model.stiffness), slopes))
    batch = arm_angles.shape[:-1]
    return ParametricResponse(
        G.reshape(*batch, *G.shape[1:]), jacobian.reshape(*batch, *jacobian.shape[1:]), parameter_names(robot)
    )


def parameter_names(robot: Robot) -> tuple[str, ...]:
    """Names of the parameters of `frf_and_jacobian`: all stiffnesses, all dampings, all effective
    frictions."""
    return (
        *(f"{joint}.stiffness" for joint in robot.spring_names),
        *(f"{joint}.damping" for joint in robot.spring_names),
        *(f"{joint}.effective_friction" for joint in robot.axis_names),
    )


def hold_remainder(
    model: LinearRobot, frequency: Float[Array, "freq"], hold: ZeroOrderHold
) -> Float[Array, "*batch freq"]:
    """Size of what `ZeroOrderHold.order` leaves out, over the largest element of G; (*batch, freq).

    Above a thousandth or so, use `discretise` and `state_space_frf`, or a higher sampling frequency.
    """
    omega = 2.0 * jnp.pi * jnp.asarray(frequency)
    longer = dataclasses.replace(hold, order=hold.order + 2)
    _, corrections = _sampling(omega, hold.measured, longer, jnp.zeros(()))
    terms = _high_frequency(model, longer.order)[-2:]
    # Springs show in every second term, dampers in the others: take the larger of two.
    left_out = [jnp.abs(term[..., None, :, :] * c) for term, c in zip(terms, corrections[-2:], strict=True)]
    G = frf(model, frequency, hold.measured, hold)
    return jnp.max(jnp.maximum(*left_out), axis=(-1, -2)) / jnp.max(jnp.abs(G), axis=(-1, -2))


def _motion(model: LinearRobot, omega):
    """X = S(w)^{-1} B, coordinates per unit torque: (*batch, freq, dof, axis)."""
    w = omega[:, None, None]
    mass, damping, stiffness = (x[..., None, :, :] for x in (model.mass, model.damping, model.stiffness))
    dynamic = stiffness - jnp.square(w) * mass + 1j * w * damping
    return _solve(dynamic, model.motor, model.partners)


def _solve(dynamic, motor, partners: tuple[int, ...]):
    """S^{-1} B of a symmetric S, first eliminating the leading coordinates, each tied to its partner alone:
    what is left is half the size, and its matrix differs from that block of S on the diagonal only."""
    n = len(partners)
    right = jnp.broadcast_to(motor, (*dynamic.shape[:-1], motor.shape[1])).astype(dynamic.dtype)
    if not n:
        return jnp.linalg.solve(dynamic, right)
    leading, partner = np.arange(n), np.array(partners)
    tie = dynamic[..., leading, partner]
    own = dynamic[..., leading, leading]
    ratio = tie / own
    kept = dynamic[..., n:, n:].at[..., partner - n, partner - n].add(-tie * ratio)
    rest = right[..., n:, :].at[..., partner - n, :].add(-ratio[..., None] * right[..., :n, :])
    rest = jnp.linalg.solve(kept, rest)
    first = (right[..., :n, :] - tie[..., None] * rest[..., partner - n, :]) / own[..., None]
    return jnp.concatenate([first, rest], axis=-2)


def _sampling(omega, quantity: str, hold: ZeroOrderHold | None, delay):
    """What multiplies the position FRF, (freq, 1, axis), and the coefficients of the terms in 1/s, (term,
    freq, 1, axis)."""
    s = 1j * omega[:, None, None]
    late = jnp.exp(-s * delay)
    if hold is None:
        return s ** derivatives(quantity) * late, None
    differentiate = s ** (derivatives(quantity) - derivatives(hold.measured))
    measured = s ** derivatives(hold.measured)
    T = 1.0 / hold.sampling_frequency
    held = -jnp.expm1(-s * T) / (s * T) * late
    first = 2 - derivatives(hold.measured)  # the position falls with s^-2, the velocity with s^-1
    chain = _held_integrators(s, T, delay, first + hold.order - 1)[first - 1 :]
    corrections = [held_power - held * s**-p for p, held_power in enumerate(chain, first)]
    return held * measured * differentiate, jnp.stack(corrections) * differentiate


def _held_integrators(s, T: float, delay, count: int):
    """FRF between samples of 1/s, 1/s^2, ... behind a zero-order hold whose output is late by `delay`.

    Over one sample x_p grows by sum_i T^i/i! x_{p-i} and by what the held input adds: with delay = (d + g) T,
    the older input acts for g T and the newer one for the rest (the modified z-transform).
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
    """Derivatives in the springs' stiffness k: `local` of each local stiffness in its own k, (*batch,
    spring).

    The stiffness of elastic joints moves the equilibrium: `others`, of all local stiffnesses, (*batch,
    spring, elastic); `mass` and `gravity`, of the inertia of the arm and of its gravity stiffness, (*batch,
    arm, arm, elastic).
    """

    local: jax.Array
    others: jax.Array
    mass: jax.Array
    gravity: jax.Array


def _with_slopes(robot: Robot, arm_angles, friction, swing) -> tuple[LinearRobot, _Slopes]:
    motors, first = robot.n_motors, robot.n_motors + robot.n_axes

    def rest(k):
        changed = eqx.tree_at(lambda r: r.springs.stiffness, robot, k)
        point = operating_point(changed, arm_angles)
        return local_stiffness(changed, point, swing), point.z[..., first:]

    def carried(elastic):
        arm = jnp.concatenate([arm_angles, elastic], axis=-1)
        return arm_inertia(robot, arm), gravity_stiffness(robot, arm)

    point = operating_point(robot, arm_angles)
    local, elastic = jax.jacfwd(rest)(robot.springs.stiffness)
    along = lambda tangent: jax.jvp(carried, (point.z[..., first:],), (tangent,))[1]
    mass, gravity = jax.vmap(along, in_axes=-1, out_axes=-1)(elastic[..., motors:])
    own = jnp.diagonal(local, axis1=-2, axis2=-1)
    return linearise(robot, point, friction, swing), _Slopes(own, local[..., motors:], mass, gravity)


def _rank_one(robot: Robot, model: LinearRobot, slope: _Slopes, X, omega, factor):
    """Derivative of `factor` times the position FRF: (freq, axis, axis, parameter)."""
    springs, n_gears, n_springs = spring_directions(robot), robot.n_motors, robot.n_motors + robot.n_elastic
    directions = jnp.concatenate([springs, springs, model.motor], axis=1)
    across = jnp.einsum("fia,ip->fap", X, directions.astype(X.dtype))
    gears = jnp.arange(n_springs) < n_gears
    static = jnp.broadcast_to(jnp.where(gears, slope.local, 0.0), (omega.size, n_springs))
    moving = jnp.broadcast_to(1j * omega[:, None], (omega.size, n_springs + robot.n_axes))
    left = -across * jnp.concatenate([static, moving], axis=1)[:, None]
    late = jnp.swapaxes(jnp.broadcast_to(factor, (omega.size, 1, robot.n_axes)), 1, 2)
    columns = left[:, :, None] * (across * late)[:, None]
    if not robot.n_elastic:
        return columns
    elastic = _moved_equilibrium(slope, X[:, n_gears:], across[..., :n_springs], omega) * late[:, None]
    return columns + jnp.pad(elastic, ((0, 0), (0, 0), (0, 0), (n_gears, n_springs + robot.n_axes)))


def _moved_equilibrium(slope: _Slopes, X, across, omega):
    """Derivative of the position FRF in the elastic joints' stiffness, -X^T (dK - w^2 dM) X: (freq, out, in,
    elastic)."""
    parts = jnp.stack([X.real, X.imag])  # a real product each: half the work of a complex one
    matrices = jnp.concatenate([slope.gravity, slope.mass], axis=-1)
    products = jnp.einsum("cfja,ije->cfiae", parts, matrices)
    n = slope.mass.shape[-1]
    products = products[..., :n] - jnp.square(omega)[:, None, None, None] * products[..., n:]
    moved = jax.lax.complex(products[0], products[1])
    arm = jnp.sum(X[:, :, :, None, None] * moved[:, :, None], axis=1)
    tight = jnp.einsum("fos,fas,se->foae", across, across, slope.others.astype(across.dtype))
    return -(arm + tight)


def _alias_slopes(robot: Robot, model: LinearRobot, slope: _Slopes, hold: ZeroOrderHold, corrections):
    """Derivative of `_aliases`: (freq, axis, axis, parameter)."""
    springs, n_gears, n_elastic, dof = spring_directions(robot), robot.n_motors, robot.n_elastic, robot.dof
    squares = jnp.einsum("is,js->sij", springs, springs)
    turns = jnp.einsum("ia,ja->aij", model.motor, model.motor)
    none = lambda count: jnp.zeros((count, dof, dof))
    arm = lambda x: jnp.pad(jnp.moveaxis(x, -1, 0), ((0, 0), (n_gears, 0), (n_gears, 0)))
    gears = squares[:n_gears] * slope.local[:n_gears, None, None]
    elastic = jnp.einsum("sij,se->eij", squares, slope.others) + arm(slope.gravity)
    after = none(n_gears + n_elastic + robot.n_axes)
    mass = jnp.concatenate([none(n_gears), arm(slope.mass), after])
    stiffness = jnp.concatenate([gears, elastic, after])
    damping = jnp.concatenate([none(n_gears + n_elastic), squares, turns])

    def along(dm, dd, dk):
        tangent = LinearRobot(dm, dd, dk, jnp.zeros_like(model.motor), model.partners)
        return jnp.stack(jax.jvp(lambda m: tuple(_high_frequency(m, hold.order)), (model,), (tangent,))[1])

    terms = jnp.moveaxis(jax.vmap(along)(mass, damping, stiffness), 0, -1)  # (term, axis, axis, parameter)
    return sum(c[..., None] * term for c, term in zip(corrections, terms, strict=True))
