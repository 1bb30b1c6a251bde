"""What a reference asks of the machine: rms, peaks, crest factor and power per line."""

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from .._annotated import checked
from .._types import Array
from .signals import Reference, one_period, time_derivative


class ExcitationLevels(eqx.Module):
    """Levels of every experiment and channel, (exp, in).

    **Fields:** `rms` (rad/s) and `crest`: of the multisine alone, over one steady period; `velocity`
    (rad/s), `position` (rad, about the position at rest): highest absolute values of what is played, slow
    sine and ramp included; `acceleration` (rad/s^2): highest absolute value over a steady period.
    """

    rms: Float[np.ndarray, "exp in"]
    crest: Float[np.ndarray, "exp in"]
    velocity: Float[np.ndarray, "exp in"]
    position: Float[np.ndarray, "exp in"]
    acceleration: Float[np.ndarray, "exp in"]


@checked
def rms(x: Float[Array, "*batch time channel"]) -> Float[np.ndarray, "*batch channel"]:
    """Root mean square over time, in the unit of x.

    **Arguments:** `x`: (*batch, time, channel), evenly sampled.

    **Returns:** (*batch, channel), unit of x.

    **Source:** the definition.
    """
    return np.sqrt(np.mean(np.square(x), axis=-2))


@checked
def crest_factor(x: Float[Array, "*batch time channel"]) -> Float[np.ndarray, "*batch channel"]:
    """Highest absolute value over rms, over whole periods: sqrt(2) for a sine, 3 to 4 for random phases.

    Peaks between samples are not seen: with n samples in a period of the highest line it is low by up to
    1 - cos(pi/n), 1 % at n = 22.

    **Arguments:** `x`: whole periods, (*batch, time, channel), of any unit, evenly sampled.

    **Returns:** (*batch, channel), without unit.

    **Source:** Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, chapter 5.
    """
    return np.max(np.abs(x), axis=-2) / rms(x)


@checked
def line_power(R: Complex[Array, "*batch freq channel"]) -> Float[np.ndarray, "*batch freq channel"]:
    """Mean square that each line carries, 2 |R(k)|^2, R Fourier coefficients; the sum over lines is rms^2.

    **Arguments:** `R`: (*batch, freq, channel), of any unit, without the line 0.

    **Returns:** (*batch, freq, channel), unit of R squared.

    **Source:** Parseval's theorem.
    """
    return 2 * np.abs(R) ** 2


@checked
def reference_levels(reference: Reference) -> ExcitationLevels:
    """The levels of every experiment and channel of a reference.

    **Arguments:** `reference`: of `jaxfrf.reference`.

    **Returns:** `ExcitationLevels`, each (exp, in), in rad, rad/s and rad/s^2.

    **Source:** definitions; the acceleration by j omega in frequency.
    """
    design = reference.design
    steady = reference.r[:, -design.period :]
    slow, _ = one_period(design, np.zeros(design.amplitude.shape))
    return ExcitationLevels(
        rms=rms(steady - slow),
        crest=crest_factor(steady - slow),
        velocity=np.max(np.abs(reference.r), axis=1),
        position=np.max(np.abs(reference.position), axis=1),
        acceleration=np.max(np.abs(time_derivative(steady, design.fs)), axis=1),
    )
