"""Frequency response of the linearised robot, as a sampled experiment sees it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._annotated import check_fields, checked
from .._errors import input_error
from .._types import Array
from .linearise import LinearRobot
from .quantity import derivatives


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

    **Raises:** `jaxfrf.InputError` for another quantity.

    **Source:** Astrom & Wittenmark, Computer-Controlled Systems, 3rd ed. 1997 (sampling behind a zero-order hold, the
    modified z-transform); the sum of the aliases by an expansion in 1/s is this project's own.
    """

    sampling_frequency: float
    measured: str = eqx.field(static=True, default="velocity")
    order: int = eqx.field(static=True, default=4)

    def __check_init__(self):
        check_fields(self)
        if self.measured not in ("position", "velocity"):
            raise input_error(
                "measured",
                repr(self.measured),
                "position or velocity (a held torque makes the acceleration jump at the very samples)",
                "Name what the encoder gives.",
            )


@checked
def frf(
    model: LinearRobot,
    frequency: Float[Array, "freq"],
    quantity: str = "velocity",
    hold: ZeroOrderHold | None = None,
    delay: Float[Array, "axis"] | float = 0.0,
) -> Complex[Array, "*batch freq axis axis"]:
    """FRF from motor torque to motor motion, G = (j w)^n B^T (K + j w D - w^2 M)^{-1} B.

    Differentiable in everything; `frf_and_jacobian` is faster for springs, dampers and friction.

    **Arguments:** `model`: of `linearise`. `frequency`: (freq,), Hz, above 0. `quantity`: `position`, `velocity` or
    `acceleration` of the motors. `hold`: how the torque is held and the motion sampled; `None` = continuous. `delay`:
    of each torque, s, held or not; parts of a sample count.

    **Returns:** (*batch, freq, axis, axis), rad, rad/s or rad/s^2 per N m, motor side.

    **Raises:** `jaxfrf.InputError` for another quantity.

    **Source:** the equation above; held and sampled as `ZeroOrderHold` says.
    """
    return _frf(model, jnp.asarray(frequency), quantity, hold, jnp.asarray(delay))


@eqx.filter_jit
def _frf(model: LinearRobot, frequency, quantity: str, hold: ZeroOrderHold | None, delay):
    omega = 2.0 * jnp.pi * frequency
    position = model.motor.T @ motion(model, omega)
    factor, corrections = actuated_sampling(model, omega, quantity, hold, delay)
    return position * factor + aliases(model, hold, corrections)


@checked
def hold_remainder(
    model: LinearRobot, frequency: Float[Array, "freq"], hold: ZeroOrderHold
) -> Float[Array, "*batch freq"]:
    """Size of what `ZeroOrderHold.order` leaves out, over the largest element of G; (*batch, freq), without unit.

    Above a thousandth or so, use `discretise` and `state_space_frf`, or sample faster.

    **Arguments:** `model`: of `jaxfrf.robot.linearise`. `frequency`: (freq,), Hz, above 0. `hold`: whose `order` is
    judged.

    **Returns:** (*batch, freq), without unit.

    **Source:** the next two terms of the expansion of `ZeroOrderHold`: this project's own.
    """
    omega = 2.0 * jnp.pi * jnp.asarray(frequency)
    longer = dataclasses.replace(hold, order=hold.order + 2)
    _, corrections = sampling(omega, hold.measured, longer, jnp.zeros(()))
    terms = high_frequency(model, longer.order)[-2:]
    # Springs show in every second term, dampers in the others: take the larger of two.
    left_out = [jnp.abs(term[..., None, :, :] * c) for term, c in zip(terms, corrections[-2:], strict=True)]
    G = frf(model, frequency, hold.measured, hold)
    return jnp.max(jnp.maximum(*left_out), axis=(-1, -2)) / jnp.max(jnp.abs(G), axis=(-1, -2))


def motion(model: LinearRobot, omega):
    """X = S(w)^{-1} B, coordinates per unit torque: (*batch, freq, dof, axis)."""
    w = omega[:, None, None]
    mass, damping, stiffness = (x[..., None, :, :] for x in (model.mass, model.damping, model.stiffness))
    dynamic = stiffness - jnp.square(w) * mass + 1j * w * damping
    for loss in model.losses:
        share = jax.vmap(lambda e: e.response(1j * omega))(loss.group.effects)
        dynamic = dynamic + jnp.einsum("ef,...eij->...fij", share, loss.stiffness.astype(share.dtype))
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


def sampling(omega, quantity: str, hold: ZeroOrderHold | None, delay):
    """Factors of the position FRF, (freq, 1, axis), and of its terms in 1/s, (term, freq, 1, axis)."""
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


def actuated_sampling(model: LinearRobot, omega, quantity: str, hold: ZeroOrderHold | None, delay):
    """`sampling` with the robot's actuators: their delays beside `delay`, their responses as factors."""
    if not model.actuators:
        return sampling(omega, quantity, hold, delay)
    s, axes = 1j * omega, model.motor.shape[1]
    total = jnp.broadcast_to(jnp.asarray(delay, omega.dtype), (axes,))
    gain = jnp.ones((axes, omega.size), s.dtype)
    for group in model.actuators:
        total = group.added(total, jax.vmap(lambda e: jnp.asarray(e.dead_time(), omega.dtype))(group.effects))
        gain = group.replaced(gain, group.pick(gain) * jax.vmap(lambda e: e.response(s))(group.effects))
    factor, corrections = sampling(omega, quantity, hold, total)
    gain = gain.T[:, None]
    return factor * gain, None if corrections is None else corrections * gain


def _held_integrators(s, T: float, delay, count: int):
    """FRF between samples of 1/s, 1/s^2, ... behind a zero-order hold whose output is late by `delay`.

    Over one sample x_p grows by sum_i T^i/i! x_{p-i} and by what the held input adds: with delay = (d + g) T,
    the older input acts for g T and the newer one for the rest (the modified z-transform).
    """
    z = jnp.exp(s * T)
    whole = jnp.floor(delay / T + 1e-9)
    rest = 1.0 - (delay / T - whole)
    states: list[Array] = []
    factorial = 1.0
    powers = [1.0]
    for p in range(1, count + 1):
        factorial *= p
        powers.append(T**p / factorial)
        driven = powers[p] * (rest**p + (1.0 - rest**p) / z)
        states.append((sum(powers[i] * states[p - i - 1] for i in range(1, p)) + driven) / (z - 1.0))
    return [x * z**-whole for x in states]


def high_frequency(model: LinearRobot, count: int):
    """Coefficients of s^-2, s^-3, ... of the position FRF, each (*batch, axis, axis)."""
    dof = model.motor.shape[0]
    motor = jnp.broadcast_to(model.motor, (*model.mass.shape[:-2], *model.motor.shape))
    right = jnp.concatenate([model.stiffness, model.damping, motor], axis=-1)
    stiffness, damping, newest = jnp.split(jnp.linalg.solve(model.mass, right), [dof, 2 * dof], axis=-1)
    older, terms = jnp.zeros_like(newest), [newest]
    for _ in range(count - 1):
        older, newest = newest, -(damping @ newest + stiffness @ older)
        terms.append(newest)
    return [model.motor.T @ x for x in terms]


def aliases(model: LinearRobot, hold: ZeroOrderHold | None, corrections):
    """What all aliases together add to the FRF: (*batch, freq, axis, axis)."""
    if hold is None:
        return 0.0
    terms = high_frequency(model, hold.order)
    return sum(term[..., None, :, :] * c for term, c in zip(terms, corrections, strict=True))
