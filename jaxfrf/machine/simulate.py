"""The motion of a machine under a measured input."""

import math
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._arguments import expect
from .._errors import input_error
from .._text import number
from .._types import Array, require_x64
from ..experiment import Experiment
from .forces import force
from .model import Machine

_MOST_PERIODS = 50  # that are waited at most
_SETTLED = 1e-3  # of a start, that is left where nobody says how much may be
_TURN = 0.25  # rad of a mode that the samples show, in a step: Runge and Kutta's damp it by 7e-6, and 3e-5 too slow
_STABLE = 1.5  # rad of a faster mode, or of friction's decay


def simulate_machine(
    machine: Machine,
    data: Experiment,
    values: Mapping[str, float | Array] | None = None,
    *,
    steps: int | None = None,
    settle: int | None = None,
) -> Float[Array, "exp time out"]:
    """The output of a machine that the input of a record drives, held between samples.

    A periodic record is played as its mean steady period, `settle` times before the one that is kept (by default until
    a thousandth of the start is left); any other once, from rest. Integrated by the classical Runge-Kutta method in
    `steps` steps a sample (by default as many as the fastest mode asks for).

    Fails where the machine never settles (rigid motion without a damper): 50 periods are waited at most. What the input
    does between samples is not seen: it is held.

    **Arguments:** `machine`: with its effects. `data`: whose `u` drives it, in N m, N or what its inputs take.
    `values`: parameters by name, in their units; by default where they start. `steps`: Runge-Kutta steps in a sample.
    `settle`: periods that are waited.

    **Returns:** (exp, time, out), in the machine's quantity, of the first operating point.

    **Raises:** `jaxfrf.InputError` if `machine` or `data` are none; `ValueError` in 32 bit.

    **Source:** the classical Runge-Kutta method of fourth order on M q'' + D q' + K q = B u - effects.
    """
    require_x64("A simulation")
    expect("machine", machine, Machine)
    expect("data", data, Experiment)
    values = {n: jnp.asarray(p.start) for n, p in machine.parameters.items()} if values is None else values
    u = driving(data)
    before = 0
    if data.period:
        before = settling(machine, values, data.period / data.fs, _SETTLED) if settle is None else settle
    played = np.tile(u, (1, before + 1, 1))
    steps = fine_steps(machine, values, data.fs) if steps is None else steps
    y = motion(machine, values, jnp.asarray(played), data.fs, steps)
    return y[:, -u.shape[1] :]


def driving(data: Experiment) -> Float[np.ndarray, "exp time in"]:
    """The mean steady period of u, or all of it."""
    u = np.asarray(data.u)[0]
    if not data.period:
        return u
    return u[:, data.transient_periods * data.period :].reshape(len(u), -1, data.period, u.shape[2]).mean(axis=1)


def settling(machine: Machine, values, duration: float, part: float) -> int:
    """Periods of `duration` s until the slowest mode of the matrices has fallen to `part`, from 1 to 50. Friction that
    an effect adds is not counted; what drifts (rigid motion without a damper) never settles and is not waited for."""
    M, D, K = (np.asarray(x, float) for x in machine.matrices(values))
    n = len(M)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    poles = np.linalg.eigvals(state)
    decay = -poles.real[np.abs(poles) > 1e-6 * np.abs(poles).max()]
    slowest = decay[decay > 0].min(initial=np.inf)
    return int(np.clip(np.ceil(np.log(1 / part) / (slowest * duration)), 1, _MOST_PERIODS))


def fine_steps(machine: Machine, values, fs: float) -> int:
    """Steps in a sample that the modes at these values ask for: those that the samples show, to be followed."""
    M, D, K = (np.asarray(x, float) for x in machine.matrices(values))
    rates = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(M, K))))
    rate, shown = (float(np.max(x, initial=0.0)) for x in (rates, rates[rates < np.pi * fs]))
    decay = np.max(np.abs(np.linalg.eigvals(np.linalg.solve(M, D))), initial=0.0)
    for effect in machine.effects:
        p = machine.places[str(effect.joint)]
        inverse = float(p @ np.linalg.solve(M, p))
        turning = float(np.asarray(getattr(effect, "smoothing", machine.smoothing)))
        slope = abs(float(np.asarray(getattr(effect, "level", 0.0)))) / turning
        decay = max(decay, inverse * slope)
    needed = max(shown / _TURN, rate / _STABLE, decay / _STABLE) / fs
    if not needed < 200:
        raise input_error(
            "machine",
            f"a mode or friction at a rate of {number(max(rate, decay))}/s",
            f"what 200 steps in a sample of {1 / fs:g} s can follow",
            "Raise the smoothing of friction, or make that spring rigid.",
        )
    return max(1, math.ceil(needed))


def motion(machine: Machine, values, u: Float[Array, "exp time in"], fs: float, steps: int):
    """(exp, time, out); differentiable by `values`."""
    M, D, K = machine.matrices(values)
    effects = [(e, jnp.asarray(machine.places[str(e.joint)])) for e in machine.effects_at(values)]
    own = [1.0 / jnp.maximum(p @ jnp.linalg.pinv(K) @ p, 1e-30) for _, p in effects]

    def acceleration(q, v, pull):
        total = pull - D @ v - K @ q
        for (effect, p), stiffness in zip(effects, own, strict=True):
            total = total - p[:, None] * force(effect, p @ q, p @ v, stiffness, machine.smoothing)
        return jnp.linalg.solve(M, total)

    h = 1.0 / (fs * steps)

    def step(_, state, pull):
        q, v = state
        a1 = acceleration(q, v, pull)
        a2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * a1, pull)
        v2 = v + 0.5 * h * a2
        a3 = acceleration(q + 0.5 * h * (v + 0.5 * h * a1), v2, pull)
        v3 = v + h * a3
        a4 = acceleration(q + h * v2, v3, pull)
        moved = q + h * (v + h / 6 * (a1 + a2 + a3))
        return moved, v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    def sample(state, now):
        pull = jnp.asarray(machine.inputs) @ now
        q, v = state
        seen = {"position": q, "velocity": v}.get(machine.quantity)
        seen = acceleration(q, v, pull) if seen is None else seen
        state = jax.lax.fori_loop(0, steps, lambda i, x: step(i, x, pull), state)
        return state, jnp.asarray(machine.outputs) @ seen

    rest = jnp.zeros((len(machine.inputs), u.shape[0]))
    _, y = jax.lax.scan(sample, (rest, rest), jnp.moveaxis(u, 0, -1))
    return jnp.moveaxis(y, -1, 0)
