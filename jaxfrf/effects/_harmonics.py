"""Sums of sines at whole orders of an angle."""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._arguments import expect_whole
from .._errors import input_error
from .._text import number
from .effect import Candidate, Joint, Reach

_ORDERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 18, 20, 24, 30, 36, 48)  # of the motor's angle, that are tried
_TURNS = 2.0  # of the motor's angle times the order, that a record must hold to show it


def by_order(kind, joint: Joint, reach: Reach, amplitude: float) -> tuple[Candidate, ...]:
    """Ripple of one order each, linear in its sine and cosine, which count in `amplitude`.

    **Raises:** `jaxfrf.InputError` where the motor turns too little to tell any order."""
    orders = [h for h in _ORDERS if h * reach.travel > 2 * np.pi * _TURNS]
    if not orders:
        raise input_error(
            f"{kind.name} of {joint}",
            f"{number(reach.travel / (2 * np.pi), 2)} turns of the motor",
            "some turns: the record tells no orders of its angle",
            "Move further.",
        )
    waves = lambda h: (kind(joint, [amplitude], (h,)), kind(joint, [amplitude], (h,), [0.5 * np.pi]))
    free = ((-np.inf, -np.inf), (np.inf, np.inf))
    make = lambda h: functools.partial(_wave, kind, joint, h, amplitude)
    return tuple(Candidate(kind.name, str(joint), waves(h), make(h), *free, 1.0, f"order {h}") for h in orders)


def _wave(kind, joint: Joint, order: int, amplitude: float, c):
    return kind(joint, [amplitude * np.hypot(c[0], c[1])], (order,), [np.arctan2(c[1], c[0])])


def checked(name: str, amplitude, order, phase):
    """Amplitudes, whole orders and phases, as many of each."""
    for h in np.atleast_1d(order):
        expect_whole(f"{name}: order", h)
    order = tuple(int(h) for h in np.atleast_1d(order))
    amplitude = jnp.atleast_1d(jnp.asarray(amplitude, float))
    phase = jnp.zeros_like(amplitude) if phase is None else jnp.atleast_1d(jnp.asarray(phase, float))
    if amplitude.shape != (len(order),) or phase.shape != (len(order),):
        raise input_error(
            f"{name}: amplitude, order and phase",
            f"{amplitude.size}, {len(order)} and {phase.size} values",
            "as many of each",
            "Complete the shorter list.",
        )
    return amplitude, order, phase


def polar_deviation(amplitude, phase, covariance: Float[np.ndarray, "2 2"]) -> dict[str, float]:
    """Standard deviations of amplitude and phase, to first order, by the covariance of the coefficients of sine and
    cosine, which are amplitude times cos and sin of the phase."""
    along = np.array([np.cos(phase), np.sin(phase)])
    across = np.array([-along[1], along[0]]) / max(float(amplitude), 1e-300)
    of = lambda slope: float(np.sqrt(slope @ covariance @ slope))
    return {"amplitude": of(along), "phase": of(across)}


_BITS = 6  # of an order that a program learns when it runs
LARGEST_ORDER = 2**_BITS - 1


def harmonics(amplitude, order, phase, angle):
    """sum_h amplitude_h sin(order_h angle + phase_h), by powers of e^{j angle}: one sine for all whole orders.

    `order`: a tuple, or whole numbers up to 63 in an array, which are no part of a program then."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    if not isinstance(order, tuple):
        return _any_harmonics(amplitude, order, phase, cosine, sine)
    powers = {0: (jnp.ones_like(angle), jnp.zeros_like(angle)), 1: (cosine, sine)}

    def power(n: int):
        if n not in powers:
            (a, b), (c, d) = power(n // 2), power(n - n // 2)
            powers[n] = (a * c - b * d, a * d + b * c)
        return powers[n]

    total = jnp.zeros_like(angle)
    for i, h in enumerate(order):
        c, s = power(h)
        total = total + amplitude[i] * (s * jnp.cos(phase[i]) + c * jnp.sin(phase[i]))
    return total


def _any_harmonics(amplitude, order, phase, cosine, sine):
    """By the bits of every order."""
    along = lambda x: jnp.asarray(x).reshape(-1, *[1] * cosine.ndim)
    whole = along(order).astype(int)
    c = jnp.broadcast_to(jnp.ones_like(cosine), (len(order), *cosine.shape))
    s = jnp.zeros_like(c)
    for bit in range(_BITS):
        here = (whole >> bit) & 1 == 1
        c, s = jnp.where(here, c * cosine - s * sine, c), jnp.where(here, c * sine + s * cosine, s)
        cosine, sine = cosine * cosine - sine * sine, 2.0 * cosine * sine
    return jnp.sum(along(amplitude) * (s * jnp.cos(along(phase)) + c * jnp.sin(along(phase))), axis=0)
