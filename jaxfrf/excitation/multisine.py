"""The design of an experiment: orthogonal multisines for any number of inputs, and the slow sine below."""

from collections.abc import Sequence

import equinox as eqx
import jax.random as jr
import numpy as np
from jaxtyping import Complex, Float, Int, PRNGKeyArray

from .._annotated import checked
from .._arguments import as_key, expect
from .._errors import input_error
from .._memory import check_memory
from .._text import shortened
from .._types import Array
from .phases import AbstractPhases, RandomPhases, fourier_phases

LIMITS = {"velocity_limit": "rad/s", "travel_limit": "rad", "acceleration_limit": "rad/s^2"}
"""What of a design says how far its motion may go, and in which unit."""

_LARGEST_SEED = 2**53  # larger ones are not exact in every file


class SlowSine(eqx.Module):
    """A sine below the excited band that keeps every joint moving, so that friction does not hide the FRF.

        v_p(t) = amplitude_p cos(2 pi lines_p t/N).

    The linearised gain of Coulomb friction Fc is 2 Fc/(pi amplitude) while the speed is dominated by this
    sine. Give each channel its own odd line, or the channels cannot be told apart there and even lines
    detect less.

    **Arguments:** `lines`: one DFT line per channel; `amplitude`: peak speed per channel, rad/s (0 = none).

    **Raises:** `jaxfrf.InputError` unless lines and amplitudes are as many, lines whole numbers and amplitudes 0 or
    more.

    **Source:** Zimmermann & Moberg, section IV.A (the sine); Gelb & Vander Velde, Multiple-Input Describing Functions
    and Nonlinear System Design, 1968 (the gain of the sign beside a dominating sine).
    """

    lines: Int[np.ndarray, "in"]
    amplitude: Float[np.ndarray, "in"]

    def __init__(self, lines, amplitude):
        self.lines = np.atleast_1d(_whole_numbers("slow sine lines", lines))
        self.amplitude = _numbers("slow sine amplitude", amplitude, least=0.0)
        if self.lines.ndim != 1 or self.amplitude.shape != self.lines.shape:
            raise input_error(
                "slow sine",
                f"lines of shape {self.lines.shape} and amplitudes of shape {self.amplitude.shape}",
                "one line and one amplitude per channel",
                "Give a channel without slow sine the amplitude 0.",
            )


class Multisine(eqx.Module):
    """Orthogonal multisine experiments: `blocks` blocks of as many experiments as there are inputs.

    At line k the references of block m (rows inputs, columns experiments) are

        R_m(k) = A(k) diag(exp(j phi)) F diag(exp(j psi)),   R_m R_m^H = A A^H,

    F the unitary DFT matrix; phi and psi come from `phases` for every block anew. R is Fourier coefficients
    X(k) = 1/N sum_t x(t) exp(-2 pi j k t/N), and A = sqrt(n_in)/2 diag(amplitude). R is orthogonal, the
    plant input in closed loop is not: look at its condition number.

    **Arguments:**

    - `fs`: sampling frequency, Hz. `period`: samples of one period. `lines`: excited DFT lines, increasing.
    - `n_in`: inputs; only needed where `rms`, `amplitude` and `slow` do not tell it.
    - `blocks`: independent realisations M; n_in M experiments.
    - `rms`: rms of the multisine of each channel (without the slow sine), rad/s; one number serves all
      channels.
    - `amplitude`: peak amplitude of the sine at each line, rad/s: (freq,) for all channels, or (freq, in).
      Flat by default. With `rms` only its shape counts. Without both, the rms is 1 rad/s.
    - `phases`: `RandomPhases()`, `SchroederPhases()` or `CrestOptimisedPhases()`.
    - `slow`: `SlowSine`, or `None`.
    - `periods`, `transient_periods`: steady periods to record, and leading ones to drop.
    - `ramp`: seconds over which the motion fades in from rest, within the transient periods; 0: the reference
      begins with a step.
    - `velocity_limit` (rad/s), `travel_limit` (rad from rest), `acceleration_limit` (rad/s^2): highest speed, way and
      acceleration of the motors that `jaxfrf.reference` lets pass, per channel or one for all.
    - `seed`: fixes the random phases where no key is given.

    **Raises:** `jaxfrf.InputError` naming the argument, what was found, what was expected and what to do.

    **Source:** Dobrowiecki & Schoukens, IEEE Trans. Instrum. Meas. 56 (2007).
    """

    lines: Int[np.ndarray, "freq"]
    amplitude: Float[np.ndarray, "freq in"]
    velocity_limit: Float[np.ndarray, "in"] | None
    travel_limit: Float[np.ndarray, "in"] | None
    acceleration_limit: Float[np.ndarray, "in"] | None
    slow: SlowSine | None
    phases: AbstractPhases
    fs: float = eqx.field(static=True)
    period: int = eqx.field(static=True)
    blocks: int = eqx.field(static=True)
    periods: int = eqx.field(static=True)
    transient_periods: int = eqx.field(static=True)
    ramp: float = eqx.field(static=True)
    seed: int = eqx.field(static=True)

    def __init__(
        self,
        fs: float,
        period: int,
        lines,
        *,
        n_in: int | None = None,
        blocks: int = 1,
        rms=None,
        amplitude=None,
        phases: AbstractPhases = RandomPhases(),
        slow: SlowSine | None = None,
        periods: int = 1,
        transient_periods: int = 0,
        ramp: float = 0.0,
        velocity_limit=None,
        travel_limit=None,
        acceleration_limit=None,
        seed: int = 0,
    ):
        self.fs = _number("fs", fs, positive=True)
        self.period = _whole_number("period", period, least=3)
        self.lines = np.atleast_1d(_whole_numbers("lines", lines))
        self.blocks = _whole_number("blocks", blocks, least=1)
        self.periods = _whole_number("periods", periods, least=1)
        self.transient_periods = _whole_number("transient_periods", transient_periods, least=0)
        self.ramp = _number("ramp", ramp)
        self.seed = _whole_number("seed", seed, least=0, most=_LARGEST_SEED)
        self.phases = phases
        self.slow = slow
        if slow is not None:
            expect("slow", slow, SlowSine)
        rms = None if rms is None else _numbers("rms", rms)
        amplitude = None if amplitude is None else _numbers("amplitude", amplitude)
        stated = zip(LIMITS, (velocity_limit, travel_limit, acceleration_limit), strict=True)
        limits = {name: None if limit is None else _numbers(name, limit) for name, limit in stated}
        n_in = _agree(n_in, rms, amplitude, slow, limits)
        check_memory(
            f"a design of {n_in} inputs", 8.0 * n_in * (n_in + len(self.lines)), "Design fewer inputs at once."
        )
        self.amplitude = _amplitude(amplitude, rms, len(self.lines), n_in)
        for name, limit in limits.items():
            setattr(self, name, None if limit is None else _per_channel(name, limit, n_in))

    def __check_init__(self):
        top = (self.period - 1) // 2
        _check_lines("lines", self.lines, top)
        if np.any(np.diff(self.lines) <= 0):
            raise input_error("lines", "a list that is not increasing", "increasing line numbers", "Sort them.")
        if not isinstance(self.phases, AbstractPhases):
            raise input_error("phases", repr(self.phases), "a choice of phases", "E.g. RandomPhases().")
        if self.blocks > 1 and not self.phases.random:
            raise input_error(
                "blocks",
                f"{self.blocks} with {self.phases.name} phases, which are the same in every block",
                "one block",
                "Repeat periods instead, or take random phases.",
            )
        if self.slow is not None:
            self._check_slow(top)
        run_in = self.transient_periods * self.period / self.fs
        if not 0 <= self.ramp <= run_in:
            raise input_error(
                "ramp",
                f"{self.ramp:g} s with {self.transient_periods} transient periods ({run_in:g} s)",
                f"0 to {run_in:g} s: the steady periods must be free of it",
                "Shorten the ramp, or add a transient period.",
            )

    def _check_slow(self, top: int) -> None:
        slow = self.slow
        if slow is None:
            return
        _check_lines("slow sine lines", slow.lines, top)
        shared = np.intersect1d(slow.lines[slow.amplitude > 0], self.lines)
        if shared.size:
            raise input_error(
                "slow sine lines",
                f"line {shared[0]}, which the multisine excites as well",
                "lines outside the excited ones",
                "Move the slow sine below the band.",
            )

    @property
    def n_in(self) -> int:
        return self.amplitude.shape[1]

    @property
    def n_exp(self) -> int:
        return self.blocks * self.n_in

    @property
    def frequency(self) -> Float[np.ndarray, "freq"]:
        """Frequencies of the excited lines, Hz."""
        return self.lines * (self.fs / self.period)

    @property
    def rms(self) -> Float[np.ndarray, "in"]:
        """rms of the multisine of each channel, without the slow sine, rad/s."""
        return np.sqrt(np.sum(self.amplitude**2, axis=0) / 2)


@checked
def reference_spectra(
    design: Multisine, *, key: PRNGKeyArray | int | None = None
) -> Complex[np.ndarray, "exp freq in"]:
    """Fourier coefficients of the multisine references at the excited lines, block after block.

    Experiment e of block m is number m*n_in + e. A block does not depend on how many blocks there are, so
    that a design can be continued.

    **Arguments:** `design`: with lines, amplitudes and phases. `key`: of the random phases, or a whole
    number, its seed; `jax.random.key(design.seed)` by default.

    **Returns:** (exp, freq, in), rad/s: half the peak amplitude of every sine, with its phase.

    **Raises:** `jaxfrf.InputError` for more experiments than fit into memory.

    **Source:** Dobrowiecki & Schoukens, IEEE Trans. Instrum. Meas. 56 (2007).
    """
    key = as_key("key", design.seed if key is None else key)
    check_memory(
        f"references of {design.n_exp} experiments",
        16.0 * design.n_exp * len(design.lines) * design.n_in,
        "Ask for fewer blocks or inputs.",
    )
    blocks = [_block(design, jr.fold_in(key, m)) for m in range(design.blocks)]
    return np.concatenate(blocks)


def _block(design: Multisine, key) -> Complex[np.ndarray, "exp freq in"]:
    phi, psi = design.phases.draw(design.amplitude, design.lines, key)
    angle = phi[:, None, :] + fourier_phases(design.n_in)[:, :, None] + psi[None, :, :]  # (in, exp, freq)
    return design.amplitude / 2 * np.exp(1j * angle).transpose(1, 2, 0)


@checked
def shaped_amplitude(
    frequency: Float[Array, "freq"],
    corners: Sequence[float] | Float[Array, "corner"],
    levels: Sequence[float] | Float[Array, "*channel corner"],
) -> Float[np.ndarray, "..."]:
    """An amplitude spectrum through given corners: straight on logarithmic axes, constant beyond the ends.

    **Arguments:** `frequency`: Hz, (freq,); `corners`: increasing frequencies, Hz; `levels`: amplitude at
    each corner, (corner,) for all channels or (channel, corner).

    **Returns:** (freq,) or (freq, channel): the `amplitude` of a `Multisine`.

    **Raises:** `jaxfrf.InputError` where corners do not increase, or anything is not positive.

    **Source:** straight lines between the corners in log amplitude over log frequency: this project's own.
    """
    corners = _numbers("spectrum frequency", corners)
    levels = _numbers("spectrum amplitude", levels)
    if np.any(corners <= 0) or np.any(np.diff(corners) <= 0) or np.any(levels <= 0) or corners.ndim != 1:
        raise input_error(
            "spectrum",
            f"frequencies {corners.tolist()} and amplitudes {levels.tolist()}",
            "positive, increasing frequencies and positive amplitudes",
            "Every excited line needs power in every channel.",
        )
    if levels.ndim > 2 or levels.shape[-1] != len(corners):
        raise input_error(
            "spectrum amplitude",
            f"shape {levels.shape} for {len(corners)} frequencies",
            "one level per frequency, for all channels or for each",
            "Complete the list.",
        )
    x, y = np.log(corners), np.log(np.atleast_2d(levels))
    shaped = np.exp(np.stack([np.interp(np.log(frequency), x, row) for row in y], axis=1))
    return shaped[:, 0] if levels.ndim == 1 else shaped


def _agree(n_in, rms, amplitude, slow, limits) -> int:
    """The number of channels that the arguments tell together; 1 where none does."""
    stated = {
        "n_in": n_in if n_in is None else _whole_number("n_in", n_in, least=1),
        "rms": np.size(rms) if np.ndim(rms) == 1 else None,
        "amplitude": np.shape(amplitude)[1] if np.ndim(amplitude) == 2 else None,
        "slow": None if slow is None else len(slow.lines),
        **{name: np.size(limit) for name, limit in limits.items() if np.ndim(limit) == 1},
    }
    told = {name: n for name, n in stated.items() if n is not None}
    if len(set(told.values())) > 1:
        raise input_error(
            "channels",
            ", ".join(f"{n} in {name}" for name, n in told.items()),
            "the same number everywhere",
            "Complete the shorter lists.",
        )
    return next(iter(told.values()), 1)


def _amplitude(amplitude, rms, n_lines: int, n_in: int) -> Float[np.ndarray, "freq in"]:
    if amplitude is None:
        shape = np.ones((n_lines, n_in))
        rms = np.ones(1) if rms is None else rms
    else:
        shape = amplitude
        if shape.ndim not in (1, 2) or len(shape) != n_lines:
            raise input_error(
                "amplitude",
                f"shape {shape.shape} for {n_lines} lines",
                "(freq,) or (freq, in)",
                "Give one amplitude per excited line.",
            )
        shape = np.broadcast_to(shape.reshape(n_lines, -1), (n_lines, n_in)).copy()
    if np.any(shape <= 0):
        raise input_error(
            "amplitude",
            f"{int(np.sum(shape <= 0))} values that are not positive",
            "power at every excited line in every channel",
            "Leave these lines out of `lines`.",
        )
    if rms is None:
        return shape
    return shape * _per_channel("rms", rms, n_in) / np.sqrt(np.sum(shape**2, axis=0) / 2)


def _per_channel(name: str, value: np.ndarray, n_in: int) -> Float[np.ndarray, "in"]:
    if value.ndim > 1 or value.size not in (1, n_in) or np.any(value <= 0):
        raise input_error(
            name,
            f"{value.tolist()}",
            f"one positive number, or one for each of the {n_in} channels",
            "Correct the list.",
        )
    return np.broadcast_to(value.ravel(), (n_in,)).copy()


def _check_lines(name: str, lines, top: int) -> None:
    if lines.ndim != 1 or lines.size == 0 or lines.min() < 1 or lines.max() > top:
        found = f"{lines.min()} to {lines.max()}" if lines.size else "none"
        raise input_error(
            name,
            found,
            f"lines between 1 and {top} (below half the sampling frequency)",
            "Check period and fs: line k is k*fs/period Hz.",
        )


def _numbers(name: str, value, least: float = -np.inf) -> np.ndarray:
    try:
        x = np.asarray(value)
    except ValueError:  # lists of unequal length
        x = np.array("")
    if x.dtype.kind not in "iuf" or x.size == 0 or not np.isfinite(x).all() or np.any(x < least):
        bound = "" if least == -np.inf else f" of at least {least:g}"
        raise input_error(name, shortened(value), f"finite numbers{bound}", "Correct it.")
    return x.astype(np.float64)


def _number(name: str, value, positive: bool = False) -> float:
    x = _numbers(name, value)
    if x.size != 1 or (positive and x <= 0):
        raise input_error(name, shortened(value), f"one {'positive ' if positive else ''}number", "Correct it.")
    return float(x.item())


def _whole_numbers(name: str, value) -> np.ndarray:
    x = _numbers(name, value)
    if np.any(x != np.round(x)):
        raise input_error(name, shortened(value), "whole numbers", "Line k is k*fs/period Hz.")
    return x.astype(np.int64)


def _whole_number(name: str, value, least: int, most: float = 2**53) -> int:
    x = _numbers(name, value)
    if x.size != 1 or x != np.round(x) or x < least:
        raise input_error(name, shortened(value), f"a whole number, {least} or more", "Correct it.")
    if x > most:
        raise input_error(name, shortened(value), f"at most {most:g}", "Correct it.")
    return int(x.item())
