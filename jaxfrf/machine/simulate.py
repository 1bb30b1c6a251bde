"""The motion of a machine under a measured input."""

import math
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import scipy.interpolate
import scipy.signal
from jaxtyping import Float

from .._arguments import expect, expect_whole
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
_SMOOTH = 0.7  # rad of the highest line of an input that is not held, in a step: Simpson's rule is 1e-4 off
_PLAYED = 1e-4  # of the strongest line's power, that an input plays
_MOST_STEPS = 200  # in a sample


def simulate_machine(
    machine: Machine,
    data: Experiment,
    values: Mapping[str, float | Array] | None = None,
    *,
    steps: int | None = None,
    settle: int | None = None,
    hold: bool = True,
) -> Float[Array, "exp time out"]:
    """The output of a machine that the input of a record drives.

    A periodic record is played as its mean steady period, `settle` times before the one that is kept (by default until
    a thousandth of the start is left); any other once, from rest. Integrated by the classical Runge-Kutta method in
    `steps` steps a sample (by default as many as the fastest mode asks for, springs along their motion included).

    Fails where the machine never settles (rigid motion without a damper): 50 periods are waited at most. Biased where
    the input is not what `hold` says: a held one acts half a sample later than the same samples of a smooth one.

    **Arguments:** `machine`: with its effects. `data`: whose `u` drives it, in N m, N or what its inputs take.
    `values`: parameters by name, in their units; by default where they start. `steps`: Runge-Kutta steps in a sample.
    `settle`: periods that are waited. `hold`: whether u is held from one sample to the next, as a commanded one is;
    `False`: u is sampled from a smooth signal, as a measured one is. Between its samples it is then what the lines of
    its period say, exact below half the sampling frequency; a cubic spline where there is no period.

    **Returns:** (exp, time, out), in the machine's quantity, of the first operating point.

    **Raises:** `jaxfrf.InputError` if `machine` or `data` are none; `ValueError` in 32 bit.

    **Source:** the classical Runge-Kutta method of fourth order on M q'' + D q' + K q = B u - effects.
    """
    require_x64("A simulation")
    expect("machine", machine, Machine)
    expect("data", data, Experiment)
    check_steps(settle, steps)
    values = {n: jnp.asarray(p.start) for n, p in machine.parameters.items()} if values is None else values
    before = 0
    if data.period:
        before = settling(machine, values, data.period / data.fs, _SETTLED) if settle is None else settle
    steps = needed_steps(machine, values, data, before, hold) if steps is None else steps
    y = motion(machine, values, jnp.asarray(between(data, steps, hold)), data.fs, steps, before + 1)
    return y[:, -driving(data).shape[1] :]


def check_steps(settle: int | None, steps: int | None) -> None:
    """Refuse numbers of periods and steps that are none."""
    if settle is not None:
        expect_whole("settle", settle)
    if steps is not None:
        expect_whole("steps", steps, 1)


def driving(data: Experiment) -> Float[np.ndarray, "exp time in"]:
    """The mean steady period of u, or all of it."""
    u = np.asarray(data.u)[0]
    if not data.period:
        return u
    return u[:, data.transient_periods * data.period :].reshape(len(u), -1, data.period, u.shape[2]).mean(axis=1)


def between(data: Experiment, steps: int, hold: bool) -> Float[np.ndarray, "exp time point in"]:
    """`driving` at the start of every sample, and where it is not held at the middle and the end of its steps, too."""
    u = driving(data)
    if hold:
        return u[:, :, None]
    n, points = u.shape[1], 2 * steps
    if data.period:
        fine = scipy.signal.resample(u, n * points, axis=1)  # by its Fourier series
        fine = np.concatenate([fine, fine[:, :1]], axis=1)
    else:
        fine = scipy.interpolate.CubicSpline(np.arange(n), u, axis=1)(np.arange(n * points + 1) / points)
    return fine[:, np.arange(n)[:, None] * points + np.arange(points + 1)]


def settling(machine: Machine, values, duration: float, part: float) -> int:
    """Periods of `duration` s until the slowest mode of the matrices has fallen to `part`, from 1 to 50. Friction that
    an effect adds is not counted; what drifts (rigid motion without a damper) never settles and is not waited for."""
    M, D, K = (np.asarray(x, float) for x in machine.matrices_at(values))
    n = len(M)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    poles = np.linalg.eigvals(state)
    decay = -poles.real[np.abs(poles) > 1e-6 * np.abs(poles).max()]
    slowest = decay[decay > 0].min(initial=np.inf)
    return int(np.clip(np.ceil(np.log(1 / part) / (slowest * duration)), 1, _MOST_PERIODS))


def needed_steps(machine: Machine, values, data: Experiment, before: int, hold: bool) -> int:
    """`fine_steps` with the springs that effects are along the motion; and what an input that is not held asks for."""
    steps = fine_steps(machine, values, data.fs)
    if not hold:
        steps = max(steps, math.ceil(np.pi * _highest(data) / _SMOOTH))
    if not machine.effects:
        return steps
    while True:
        u = jnp.asarray(between(data, steps, hold))
        slopes = np.asarray(_slopes(machine, values, u, data.fs, steps, before + 1))
        if np.isfinite(slopes).all():
            return max(steps, fine_steps(machine, values, data.fs, slopes))
        if 2 * steps > _MOST_STEPS:
            return steps  # it diverges, which the caller tells
        steps *= 2


def _highest(data: Experiment) -> float:
    """The highest line that u plays, over half the sampling frequency."""
    power = np.sum(np.abs(np.fft.rfft(driving(data), axis=1)) ** 2, axis=(0, 2))
    return float(np.max(np.flatnonzero(power >= _PLAYED * power.max()))) / max(len(power) - 1, 1)


def _slopes(machine: Machine, values, u, fs: float, steps: int, periods: int) -> Float[Array, "effect *run"]:
    """d force/d deflection of every effect along the last period."""
    places = jnp.stack([jnp.asarray(machine.places[str(e.joint)]) for e in machine.effects])
    along = _run(machine, values, u, fs, steps, periods, lambda q, v, _: jnp.stack([places @ q, places @ v]))
    found = []
    for i, (effect, own) in enumerate(zip(machine.effects_at(values), _own(machine, values), strict=True)):
        x, v = along[-u.shape[1] :, :, i].swapaxes(0, 1)
        found.append(
            jax.grad(lambda x, v=v, e=effect, k=own: jnp.sum(force(e, x, v, k, machine.smoothing)))(x)  # one by one
        )
    return jnp.stack(found)


def fine_steps(machine: Machine, values, fs: float, slopes=()) -> int:
    """Steps in a sample that the modes at these values ask for: those that the samples show, to be followed.

    `slopes`: (effect, *run) of the effects' forces along a motion, whose rms is a spring to be followed, and the
    largest one that must not make it diverge."""
    M, D, K = (np.asarray(x, float) for x in machine.matrices_at(values))
    usual, most = K, K
    for effect, slope in zip(machine.effects, slopes, strict=False):
        p = machine.places[str(effect.joint)]
        usual = usual + np.sqrt(np.mean(np.square(slope))) * np.outer(p, p)
        most = most + np.max(slope, initial=0.0) * np.outer(p, p)
    rates, fastest = (np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(M, k)))) for k in (usual, most))
    shown, rate = (float(np.max(x, initial=0.0)) for x in (rates[rates < np.pi * fs], fastest))
    decay = np.max(np.abs(np.linalg.eigvals(np.linalg.solve(M, D))), initial=0.0)
    for effect in machine.effects:
        p = machine.places[str(effect.joint)]
        inverse = float(p @ np.linalg.solve(M, p))
        turning = float(np.asarray(getattr(effect, "smoothing", machine.smoothing)))
        slope = abs(float(np.asarray(getattr(effect, "level", 0.0)))) / turning
        decay = max(decay, inverse * slope)
    needed = max(shown / _TURN, rate / _STABLE, decay / _STABLE) / fs
    if not needed < _MOST_STEPS:
        raise input_error(
            "machine",
            f"a mode or friction at a rate of {number(max(rate, decay))}/s",
            f"what {_MOST_STEPS} steps in a sample of {1 / fs:g} s can follow",
            "Raise the smoothing of friction, or make that spring rigid.",
        )
    return max(1, math.ceil(needed))


def motion(machine: Machine, values, u: Float[Array, "exp time point in"], fs: float, steps: int, periods: int):
    """(exp, periods * time, out) under u of `between`; differentiable by `values`."""

    def seen(q, v, acceleration):
        known = {"position": q, "velocity": v}.get(machine.quantity)
        return jnp.asarray(machine.outputs) @ (acceleration(q, v) if known is None else known)

    return jnp.moveaxis(_run(machine, values, u, fs, steps, periods, seen), -1, 0)


def _own(machine: Machine, values) -> list[Float[Array, ""]]:
    """Stiffness of the machine's own spring at the place of every effect."""
    inverse = jnp.linalg.pinv(machine.matrices_at(values)[2])
    places = (jnp.asarray(machine.places[str(e.joint)]) for e in machine.effects)
    return [1.0 / jnp.maximum(p @ inverse @ p, 1e-30) for p in places]


def _run(machine: Machine, values, u, fs: float, steps: int, periods: int, seen):
    """What `seen(q, v, acceleration of q and v)` makes of the motion at every sample, (time, ..., exp)."""
    M, D, K = machine.matrices_at(values)
    effects = [(e, jnp.asarray(machine.places[str(e.joint)])) for e in machine.effects_at(values)]
    own = _own(machine, values)

    def acceleration(q, v, pull):
        total = pull - D @ v - K @ q
        for (effect, p), stiffness in zip(effects, own, strict=True):
            total = total - p[:, None] * force(effect, p @ q, p @ v, stiffness, machine.smoothing)
        return jnp.linalg.solve(M, total)

    h = 1.0 / (fs * steps)

    def step(state, first, middle, last):
        q, v = state
        a1 = acceleration(q, v, first)
        a2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * a1, middle)
        v2 = v + 0.5 * h * a2
        a3 = acceleration(q + 0.5 * h * (v + 0.5 * h * a1), v2, middle)
        v3 = v + h * a3
        a4 = acceleration(q + h * v2, v3, last)
        moved = q + h * (v + h / 6 * (a1 + a2 + a3))
        return moved, v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    pulls = jnp.einsum("di,etpi->tpde", jnp.asarray(machine.inputs), u)
    held = u.shape[2] == 1

    def sample(state, now):
        pull = pulls[now]
        at = lambda i, k: pull[0] if held else pull[2 * i + k]
        found = seen(*state, lambda q, v: acceleration(q, v, pull[0]))
        state = jax.lax.fori_loop(0, steps, lambda i, x: step(x, *(at(i, k) for k in range(3))), state)
        return state, found

    rest = jnp.zeros((len(machine.inputs), u.shape[0]))
    return jax.lax.scan(sample, (rest, rest), jnp.tile(jnp.arange(u.shape[1]), periods))[1]
