"""From a design to the signals that a controller plays: speed reference and position reference."""

import equinox as eqx
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int, PRNGKeyArray

from .._annotated import check_fields, checked
from .._arguments import expect
from .._errors import input_error
from .._memory import check_memory
from .._text import number
from .multisine import LIMITS, Multisine, reference_spectra


class Reference(eqx.Module):
    """References of all experiments of a design, through the transient periods to the steady ones.

    With a `ramp` they start from rest; without one they are periodic from the first sample on, which is a step.

    **Fields:**

    - `r`: speed reference, multisine and slow sine together, (exp, time, in), rad/s.
    - `position`: its zero-mean periodic integral, about the position at rest, (exp, time, in), rad. A
      position loop needs it: it would fight the motion around a constant position.
    - `design`: the `Multisine` behind them; `lines`, `fs`, `period`, ... are read from it.
    """

    r: Float[np.ndarray, "exp time in"]
    position: Float[np.ndarray, "exp time in"]
    design: Multisine

    def __check_init__(self):
        check_fields(self)
        design = self.design
        n_time = (design.transient_periods + design.periods) * design.period
        expected = (design.n_exp, n_time, design.n_in)
        if self.r.shape != expected or self.position.shape != expected:
            raise input_error(
                "reference",
                f"shapes {self.r.shape} and {self.position.shape}",
                f"{expected} (experiment, time, input), as the design says",
                "Check periods, blocks and channels.",
            )

    @property
    def fs(self) -> float:
        return self.design.fs

    @property
    def period(self) -> int:
        return self.design.period

    @property
    def lines(self) -> Int[np.ndarray, "freq"]:
        return self.design.lines

    @property
    def transient_periods(self) -> int:
        return self.design.transient_periods

    @property
    def n_exp(self) -> int:
        return self.r.shape[0]

    @property
    def n_time(self) -> int:
        return self.r.shape[1]

    @property
    def n_in(self) -> int:
        return self.r.shape[2]

    @property
    def time(self) -> Float[np.ndarray, "time"]:
        """Time of every sample, s."""
        return np.arange(self.n_time) / self.fs

    @property
    def spectra(self) -> Complex[np.ndarray, "exp freq in"]:
        """Fourier coefficients of the last period at the excited lines, (exp, freq, in)."""
        steady = self.r[:, -self.period :]
        return scipy.fft.rfft(steady, axis=1, workers=-1)[:, self.lines] / self.period


def reference(design: Multisine, *, key: PRNGKeyArray | int | None = None) -> Reference:
    """The references of a design, all periods of all experiments.

    The position is the integral by 1/(j omega) in frequency: exact, periodic, without the drift of a
    running sum. During the ramp it is w(t) q(t) and the speed its derivative w'(t) q(t) + w(t) v(t), w a
    quintic from 0 to 1, so that position, speed and acceleration start from rest. Without a ramp (`ramp = 0`, the
    default) the first sample is that of a period: a step for a machine at rest.

    **Arguments:** `design`: a `Multisine`. `key`: for the random phases, or a whole number, its seed; by default
    `jax.random.key(design.seed)`.

    **Returns:** a `Reference`: speed, rad/s, and position, rad, each (exp, time, in).

    **Raises:** `jaxfrf.InputError` if `design` is none, where a speed, a way or an acceleration
    exceeds the design's limit, or for more samples than fit into memory.

    **Source:** closed form.
    """
    expect("design", design, Multisine)
    samples = (design.transient_periods + design.periods) * design.period
    check_memory(
        f"references of {design.n_exp} experiments of {samples} samples in {design.n_in} channels",
        16.0 * design.n_exp * samples * design.n_in + 64.0 * design.period * design.n_in,
        "Ask for fewer periods or blocks, or a shorter one.",
    )
    return _reference(design, reference_spectra(design, key=key))


def _reference(design: Multisine, R) -> Reference:
    total = design.transient_periods + design.periods
    shape = (design.n_exp, total * design.period, design.n_in)
    r, position = np.empty(shape), np.empty(shape)
    for exp, X in enumerate(R):
        velocity, integral = one_period(design, X)
        r[exp], position[exp] = np.tile(velocity, (total, 1)), np.tile(integral, (total, 1))
    _fade_in(design, r, position)
    _check_limits(design, r, position)
    return Reference(r=r, position=position, design=design)


@checked
def one_period(
    design: Multisine, R: Complex[np.ndarray, "freq in"]
) -> tuple[Float[np.ndarray, "time in"], Float[np.ndarray, "time in"]]:
    """Speed and position of one steady period, slow sine included, from the spectra of one experiment.

    **Arguments:** `design`: with `fs`, `period`, `lines` and its slow sine. `R`: Fourier coefficients at the excited
    lines, (freq, in), rad/s, one experiment of `reference_spectra`.

    **Returns:** speed, (time, in), rad/s, and its zero-mean periodic integral, (time, in), rad.

    **Source:** the inverse DFT; the integral by 1/(j omega).
    """
    X = np.zeros((design.period // 2 + 1, design.n_in), complex)
    X[design.lines] = R
    if design.slow is not None:
        X[design.slow.lines, np.arange(design.n_in)] += design.slow.amplitude / 2
    omega = 2 * np.pi * design.fs / design.period * np.arange(len(X))
    Q = np.zeros_like(X)
    Q[1:] = X[1:] / (1j * omega[1:, None])
    velocity, position = (scipy.fft.irfft(Z * design.period, n=design.period, axis=0) for Z in (X, Q))
    return velocity, position


def _fade_in(design: Multisine, r, position) -> None:
    """Start from rest, in place, where the design has a ramp: q -> w q, v -> w' q + w v."""
    n = int(np.ceil(design.ramp * design.fs))
    if n == 0:
        return
    x = np.arange(n)[:, None] / (design.ramp * design.fs)
    weight = x**3 * (10 - 15 * x + 6 * x**2)
    rate = 30 * x**2 * (1 - x) ** 2 / design.ramp
    r[:, :n] = rate * position[:, :n] + weight * r[:, :n]
    position[:, :n] *= weight


def _check_limits(design: Multisine, r, position) -> None:
    moved = {"velocity_limit": r, "travel_limit": position}
    if design.acceleration_limit is not None:
        moved["acceleration_limit"] = time_derivative(r[:, -design.period :], design.fs)
    for name, x in moved.items():
        limit = getattr(design, name)
        if limit is not None:
            _check_peak(name, np.max(np.abs(x), axis=1), limit)


def _check_peak(name: str, peak, limit) -> None:
    excess = peak / limit
    exp, channel = (int(i) for i in np.unravel_index(np.argmax(excess), excess.shape))
    if excess[exp, channel] > 1:
        share = np.floor(1000 / excess[exp, channel]) / 1000
        raise input_error(
            name,
            f"a peak of {number(peak[exp, channel], 4)} {LIMITS[name]} in experiment {exp}, channel {channel}",
            f"at most {number(limit[channel], 4)} {LIMITS[name]}",
            f"Lower both rms and slow sine (to {share:g} of what they are), or try another seed, or crest-optimised "
            "phases.",
        )


def time_derivative(x: Float[np.ndarray, "exp time in"], fs: float) -> Float[np.ndarray, "exp time in"]:
    """Of whole periods, by j omega in frequency."""
    n = x.shape[1]
    omega = 2 * np.pi * scipy.fft.rfftfreq(n, 1 / fs)[:, None]
    return scipy.fft.irfft(1j * omega * scipy.fft.rfft(x, axis=1), n=n, axis=1)
