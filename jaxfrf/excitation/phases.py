"""How the phases of a multisine are chosen: at random, by Schroeder's rule, or for a low crest factor.

In block m the reference is R_m(k) = A(k) diag(exp(j phi)) F diag(exp(j psi)): `phi` belongs to the inputs,
`psi` to the experiments, one value each per line. Every choice of them keeps R R^H = A A^H.
"""

import abc
from typing import ClassVar

import equinox as eqx
import numpy as np
import scipy  # its modules load when they are used: scipy.optimize is not there for an estimate
from equinox import AbstractClassVar
from jaxtyping import Float, Int, PRNGKeyArray

from .._annotated import checked
from .._types import Array
from ._draw import uniform

Phases = Float[np.ndarray, "in freq"]

_EXPONENTS = (2, 4, 8, 16, 32)  # p of the L2p norms, each starting from the optimum of the one before
_ITERATIONS = 60  # quasi-Newton steps for each exponent; more gain less than 1 %
_OVERSAMPLING = 8  # samples in a period of the highest line


class AbstractPhases(eqx.Module):
    """How phi and psi of one block are chosen; `random` tells whether another block is a new realisation."""

    name: AbstractClassVar[str]
    random: AbstractClassVar[bool]

    @abc.abstractmethod
    def draw(self, amplitude: Float[Array, "freq in"], lines: Int[Array, "freq"], key: PRNGKeyArray):
        """phi of the inputs (in, freq) and psi of the experiments (exp = in, freq), rad."""


class RandomPhases(AbstractPhases):
    """Independent, uniform phases: with many lines the signal is nearly Gaussian.

    The FRF of a nonlinear system then tends to the best linear approximation for Gaussian signals of this
    spectrum, and averaging over blocks averages its nonlinear distortion out. Crest factors are about 3 to 4.

    **Source:** Dobrowiecki & Schoukens, IEEE Trans. Instrum. Meas. 56 (2007).
    """

    name: ClassVar[str] = "random"
    random: ClassVar[bool] = True

    def draw(self, amplitude, lines, key) -> tuple[Phases, Phases]:
        phi, psi = random_phases((2, *np.shape(amplitude)[::-1]), key)
        return phi, psi


class SchroederPhases(AbstractPhases):
    """Schroeder's rule for every input, nothing random: see `schroeder_phases`.

    There is one realisation only, so that nonlinear distortion looks like the system; and all inputs of one
    experiment are nearly in proportion from line to line, which starves the local methods of a single
    experiment.

    **Source:** Schroeder, IEEE Trans. Inform. Theory 16 (1970) 85-89; distances of lines as in `schroeder_phases`.
    """

    name: ClassVar[str] = "schroeder"
    random: ClassVar[bool] = False

    def draw(self, amplitude, lines, key) -> tuple[Phases, Phases]:
        phi = np.stack([schroeder_phases(a, lines) for a in np.asarray(amplitude).T])
        return phi, np.zeros_like(phi)


class CrestOptimisedPhases(AbstractPhases):
    """Random phases, then moved to the lowest peak of all signals of the block: see `optimise_crest`.

    Crest factors of about 1.5 for one input, 1.7 for three, 2.0 for six: the n phases per line of the
    inputs and n of the experiments serve n^2 signals. The signal leaves the Gaussian-like class that
    defines the best linear approximation: the FRF of a nonlinear system then depends on this very signal.
    Blocks are different realisations.

    **Source:** Guillaume, Schoukens, Pintelon & Kollar, IEEE Trans. Instrum. Meas. 40 (1991) 982-989, the L2p norm of
    one signal, here of all signals of a block.
    """

    name: ClassVar[str] = "crest-optimised"
    random: ClassVar[bool] = True

    def draw(self, amplitude, lines, key) -> tuple[Phases, Phases]:
        phi, psi = random_phases((2, *np.shape(amplitude)[::-1]), key)
        return optimise_crest(amplitude, lines, phi, psi)


PHASES: dict[str, type[AbstractPhases]] = {
    kind.name: kind for kind in (RandomPhases, SchroederPhases, CrestOptimisedPhases)
}
"""The choices by the name that files use."""


@checked
def random_phases(shape: tuple[int, ...], key: PRNGKeyArray) -> Float[np.ndarray, "..."]:
    """Independent phases of this shape, uniform on [0, 2 pi), rad.

    **Arguments:** `shape`: of the array. `key`: of the draw, `jax.random.key`.

    **Returns:** an array of this shape, rad.

    **Source:** the definition.
    """
    return 2 * np.pi * uniform(key, shape)


@checked
def schroeder_phases(amplitude: Float[Array, "freq"], lines: Int[Array, "freq"]) -> Float[np.ndarray, "freq"]:
    """Phases that make the signal a sweep which stays at each frequency in proportion to its power.

        phi_{n+1} - phi_n = -2 pi (k_{n+1} - k_n)/g sum_{l<=n} p_l,

    p the relative power of the lines and g the greatest common divisor of their distances; on evenly spaced
    lines this is Schroeder's rule. The crest factor is about 1.7 for flat spectra that start at the first
    line. Fails on uneven sparse (logarithmic) grids: the sweep repeats within the period, and random phases
    are as good.

    **Arguments:** `amplitude`: of each line, (freq,), of any unit. `lines`: (freq,), increasing.

    **Returns:** (freq,), rad, the first one 0.

    **Source:** Schroeder, IEEE Trans. Inform. Theory 16 (1970) 85-89.
    """
    power = np.asarray(amplitude, float) ** 2
    steps = np.diff(np.asarray(lines))
    if steps.size == 0:
        return np.zeros(1)
    delay = np.cumsum(power)[:-1] / power.sum()
    return np.concatenate([[0.0], -2 * np.pi * np.cumsum(steps / np.gcd.reduce(steps) * delay)])


@checked
def optimise_crest(
    amplitude: Float[Array, "freq in"], lines: Int[Array, "freq"], phi: Phases, psi: Phases
) -> tuple[Phases, Phases]:
    """Lower the crest factors of the n^2 signals (input p in experiment e) of an orthogonal block together.

        minimise over phi, psi   log || x_pe(t)/rms_p ||_{2p},   p = 2, 4, ..., 32,

    each from the optimum of the one before: the L2p norm tends to the peak. Amplitudes, and with them R R^H
    = A A^H, stay as they are. A local optimum, which depends on the start. Takes about a second for one
    input and several hundred lines, and n^2 times that for n inputs.

    **Arguments:** `amplitude`: of each line and input, (freq, in), of any unit. `lines`: (freq,), line numbers of one
    period, increasing. `phi`, `psi`: starting phases of the inputs and of the experiments, (in, freq), rad.

    **Returns:** `phi` and `psi`, (in, freq), rad, in [0, 2 pi).

    **Source:** Guillaume, Schoukens, Pintelon & Kollar, IEEE Trans. Instrum. Meas. 40 (1991) 982-989 (the
    L2p norm; here with a quasi-Newton method and gradients by FFT).
    """
    lines = np.asarray(lines)
    a = np.asarray(amplitude, float).T
    relative = (a / np.sqrt(np.sum(a**2, axis=1, keepdims=True) / 2))[:, None, :]
    fourier = fourier_phases(len(a))[:, :, None]
    size = scipy.fft.next_fast_len(_OVERSAMPLING * int(lines[-1]) + 1, real=True)

    def split(x):
        phi, psi = x.reshape(2, *a.shape)
        return phi, psi

    def cost(x, p):
        phi, psi = split(x)
        turn = np.exp(1j * (phi[:, None, :] + fourier + psi[None, :, :]))
        norm, slope = _norm_and_slope(relative, turn, lines, size, p)
        return norm, np.stack([slope.sum(axis=1), slope.sum(axis=0)]).ravel()

    x = np.stack([phi, psi]).ravel()
    for p in _EXPONENTS:
        x = scipy.optimize.minimize(cost, x, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": _ITERATIONS}).x
    return split(np.mod(x, 2 * np.pi))


def _norm_and_slope(amplitude, turn, lines, size: int, p: int):
    """log of the L2p norm over all signals (row, column, time), and its derivative by each phase."""
    X = np.zeros((*turn.shape[:2], size // 2 + 1), complex)
    X[:, :, lines] = amplitude * turn * (size / 2)
    x = scipy.fft.irfft(X, n=size, axis=-1)
    peak = np.max(np.abs(x))
    x /= peak
    odd = x * _power(x * x, p - 1)  # x^(2p - 1)
    total = np.sum(odd * x)
    W = scipy.fft.rfft(odd, axis=-1)[:, :, lines] / (total * peak)
    slope = -amplitude * np.imag(turn * W.conj())
    return np.log(peak) + np.log(total / x.size) / (2 * p), slope


def _power(x, n: int):
    """x**n by repeated squaring: several times faster than the general power."""
    result = np.ones_like(x)
    while n:
        if n & 1:
            result *= x
        x = x * x
        n >>= 1
    return result


def fourier_phases(n: int) -> Float[np.ndarray, "in exp"]:
    """Angles of the unitary n-point DFT matrix F = exp(-2 pi j p e / n)/sqrt(n), which exists for every n."""
    index = np.arange(n)
    return -2 * np.pi * (np.outer(index, index) % n) / n
