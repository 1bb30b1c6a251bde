"""A machine fitted through the experiment: its motion under the measured input against the measured output."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.optimize
import scipy.stats
from jaxtyping import Bool, Complex, Float

from .._arguments import as_band, expect, expect_each, expect_number
from .._errors import input_error
from .._text import percent
from .._threads import one_blas_thread
from .._types import require_x64
from ..effects import AbstractEffect
from ..experiment import QUANTITIES, Experiment
from .model import Machine
from .simulate import between, check_steps, driving, motion, needed_steps, settling

FLOOR = 1e-3  # of the output's rms at a line: below it no model is right
_REACH = np.log(1e4)  # that a positive parameter may move from its start
ENOUGH = 1.3  # misfit of a machine that misses nothing
_RETRIES = 2  # of a fit whose machine turns out to ring for longer than was waited, or to ask for shorter steps
_FEW, _MANY = 10, 60  # simulations with their slopes: to see whether another hold explains a record; to fit it
_CLEARLY = 0.5  # of what is left with one hold, that another leaves, and is told then
_SCATTER = 24  # complex degrees of freedom behind a variance of noise: 4 % of what such weights tell is lost
_BEYOND = 1.5  # times the highest excited line: distortion shows there, too


class MachineFit(eqx.Module):
    """A machine fitted to a record.

    **Fields:** `machine`: at the result. `values`, `std`: of every free parameter; std by the curvature, widened by the
    misfit. `residual`: root of the power of measured less simulated output over that of the measured one, at the lines
    of the fit. `misfit`: root mean square of the residual over its standard deviation. `lines`: those of the fit.
    `left`, `measured`: what is left of the measured output's Fourier coefficients at these lines, and the coefficients,
    (exp, line, out). `settle`: periods that were waited. `converged`. `hold`: whether u was taken as held between its
    samples. `doubt`: in words, where the record looks as if that were not so; else empty.
    """

    machine: Machine
    values: dict[str, float] = eqx.field(static=True)
    std: dict[str, float] = eqx.field(static=True)
    residual: float = eqx.field(static=True)
    misfit: float = eqx.field(static=True)
    lines: np.ndarray
    left: Complex[np.ndarray, "exp line out"]
    measured: Complex[np.ndarray, "exp line out"]
    settle: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)
    hold: bool = eqx.field(static=True, default=True)
    doubt: str = eqx.field(static=True, default="")


@one_blas_thread
def fit_machine(
    machine: Machine,
    data: Experiment,
    *,
    band: tuple[float, float] | None = None,
    settle: int | None = None,
    steps: int | None = None,
    floor: float = FLOOR,
    used: Bool[np.ndarray, "exp line"] | None = None,
    hold: bool = True,
) -> MachineFit:
    """Fit masses, springs, dampers and effects of a machine to a record, by simulating it under the measured input.

    The mean steady period of the measured output, in the machine's quantity, is compared with the simulated one at all
    lines of `band`, excited or not: what a nonlinear spring or friction adds there is part of the answer. Least squares
    by a trust-region method with the Jacobian by forward differentiation through the simulation.

    Biased by noise of the measured input (it drives the model), where the machine drifts by what is not measured, and
    where the input is not what `hold` says: masses and springs then take half a sample on, some per cent where modes
    are above a twentieth of the sampling frequency. Where more than noise is left the other one is tried, and `doubt`
    of the result tells if it leaves less than half.

    **Arguments:**

    - `machine`: its `effects` are fitted, too, from the numbers that they have.
    - `data`: a periodic record; its output in any quantity.
    - `band`: Hz; by default from the first line, or 0 where the machine's quantity is a derivative of the measured one
      (of which a period's mean is then known to be 0), to 1.5 times the highest excited one.
    - `settle`: periods before the one that is compared; by default as many as the slowest mode needs to fall to a third
      of `floor`, at the start and at the result (what is left of a start counts as misfit). `steps`: see
      `simulate_machine`.
    - `floor`: standard deviation of the model itself, over the rms of the output.
    - `used`: which experiments and lines (of `MachineFit.lines`) count; by default all.
    - `hold`: whether u is held between its samples (a commanded one), or smooth (`False`: a measured one); see
      `simulate_machine`.

    **Returns:** a `MachineFit`: the machine at the result, its free parameters with their standard deviations, in their
    units, and what is left at every line.

    **Raises:** `jaxfrf.InputError` for records without a period or of other inputs and outputs, a `band` without lines,
    `used` of another shape, and where the simulation diverges at the start; `ValueError` in 32 bit.

    **Source:** output-error least squares on the mean period's Fourier coefficients, with weights from the scatter
    between periods (Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012); that the
    distortion's lines count as well is this project's own.
    """
    fitting = functools.partial(fitted, data=data, band=band, settle=settle, steps=steps, floor=floor, used=used)
    found = fitting(machine, hold=hold)
    return dataclasses.replace(found, doubt=of_hold(found, fitting))


def of_hold(found: MachineFit, fitting: Callable[..., MachineFit]) -> str:
    """What to doubt of the `hold` of a fit that `fitting` made."""
    if found.misfit <= ENOUGH:
        return ""
    other = fitting(found.machine, hold=not found.hold, most=_FEW)
    if not other.misfit < _CLEARLY * found.misfit:
        return ""
    taken, rather = ("held", "smooth") if found.hold else ("smooth", "held")
    return (
        f"u looks {rather} between its samples, and was taken as {taken}: with hold={other.hold} "
        f"{percent(other.residual, 2)} are left, not {percent(found.residual, 2)}"
    )


def fitted(
    machine: Machine,
    data: Experiment,
    *,
    band: tuple[float, float] | None = None,
    settle: int | None = None,
    steps: int | None = None,
    floor: float = FLOOR,
    used: Bool[np.ndarray, "exp line"] | None = None,
    hold: bool = True,
    most: int = _MANY,
) -> MachineFit:
    """`fit_machine` without its doubt, in `most` simulations with their slopes."""
    require_x64("fit_machine")
    expect("machine", machine, Machine)
    expect("data", data, Experiment)
    if not data.period:
        raise input_error("period", "0", "a periodic record", "Say its period, or cut it to whole periods.")
    if (data.n_in, data.n_out) != (machine.inputs.shape[1], len(machine.outputs)):
        raise input_error(
            "data and machine",
            f"{data.n_out} outputs of {data.n_in} inputs",
            f"{len(machine.outputs)} of {machine.inputs.shape[1]}",
            "Choose channels (names=), or correct inputs and outputs of the machine.",
        )
    check_steps(settle, steps)
    expect_number("floor", floor)
    lines, measured, sigma = measured_lines(machine, data, band, floor)
    used = np.ones(measured.shape[:2], bool) if used is None else np.asarray(used, bool)
    if used.shape != measured.shape[:2] or not used.any():
        raise input_error("used", f"{used.shape}, {used.sum()} of them", f"{measured.shape[:2]}, some", "Correct it.")

    def asked(machine: Machine) -> tuple[int, int]:
        """Periods to wait, steps in a sample."""
        start = _starts(machine)
        wait = settling(machine, start, data.period / data.fs, floor / 3) if settle is None else settle
        return wait, needed_steps(machine, start, data, wait, hold) if steps is None else steps

    count = asked(machine)
    found = _fitted(machine, data, lines, measured, sigma, used, *count, hold, most)
    for _ in range(_RETRIES):
        wait, fine = asked(found.machine)
        more = max(wait, count[0]), max(fine, count[1])
        if more == count:
            break
        count = more
        found = _fitted(found.machine, data, lines, measured, sigma, used, *count, hold, most)
    return found


def _starts(machine: Machine) -> dict[str, float]:
    return {n: float(p.start) for n, p in machine.parameters.items()}


class _Problem:
    """What a fit moves, and what is left of a record there.

    Positive parameters move in their logarithm, others in their scale from where they start.
    """

    def __init__(self, machine: Machine, data: Experiment, lines, measured, counted, settle: int, steps: int, hold):
        self.machine, self.data = machine, data
        self.lines, self.measured, self.counted = lines, measured, counted
        self.names = [n for n, p in machine.parameters.items() if p.free and p.same_as is None]
        self.start = _starts(machine)
        self.positive = np.array([machine.parameters[n].positive for n in self.names])
        self.scale = np.array([machine.parameters[n].scale for n in self.names])
        self.x0 = np.array([np.log(self.start[n]) if machine.parameters[n].positive else 0.0 for n in self.names])
        self.steps, self.periods = steps, settle + 1
        self.u = jnp.asarray(between(data, steps, hold))
        self.left, self.errors = jax.jit(self._left), jax.jit(self._errors)
        self.jacobian = jax.jit(jax.jacfwd(self._errors))

    def values(self, x):
        """Of all parameters by name, at coordinates x."""
        found = {n: jnp.asarray(v) for n, v in self.start.items()}
        for i, n in enumerate(self.names):
            found[n] = jnp.exp(x[i]) if self.positive[i] else self.start[n] + self.scale[i] * x[i]
        return found | {n: found[p.same_as] for n, p in self.machine.parameters.items() if p.same_as}

    def spread(self, values, std) -> dict[str, float]:
        """Standard deviations of the parameters, from those of the coordinates."""
        own = np.where(self.positive, [values[n] for n in self.names], self.scale)
        return {n: float(s * d) for n, s, d in zip(self.names, std, own, strict=True)}

    def _left(self, x):
        y = motion(self.machine, self.values(x), self.u, self.data.fs, self.steps, self.periods)
        return jnp.fft.rfft(y[:, -self.data.period :], axis=1)[:, self.lines] / self.data.period - self.measured

    def _errors(self, x):
        e = (self._left(x) * self.counted).ravel()
        return jnp.concatenate([e.real, e.imag]) * jnp.sqrt(2.0)


def _fitted(machine, data, lines, measured, sigma, used, settle: int, steps: int, hold: bool, most: int) -> MachineFit:
    problem = _Problem(machine, data, lines, measured, used[..., None] / sigma, settle, steps, hold)
    solved = _solved(problem, most)
    dof = max(2 * used.sum() * measured.shape[2] - len(problem.names), 1)
    # Twice the sum of both parts is one complex residual: mean square 1 each where the model is right.
    misfit = np.sqrt(np.sum(solved.fun**2) / dof)
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac) * max(misfit, 1.0) ** 2
    found = {n: float(v) for n, v in problem.values(jnp.asarray(solved.x)).items()}
    rest = np.asarray(problem.left(solved.x))
    return MachineFit(
        machine=machine.with_values(found),
        values={n: found[n] for n in problem.names},
        std=problem.spread(found, np.sqrt(np.maximum(np.diag(covariance), 0.0))),
        residual=share_left(rest, measured, used),
        misfit=float(misfit),
        lines=lines,
        left=rest,
        measured=measured,
        settle=settle,
        converged=bool(solved.status > 0),
        hold=hold,
    )


def _solved(problem: _Problem, most: int):
    """Least squares from the start, positive parameters within `_REACH` of it, in `most` simulations."""
    x0, positive = problem.x0, problem.positive
    if not np.isfinite(np.asarray(problem.errors(x0))).all():
        raise input_error("machine", "a simulation that diverges at its start", "a finite motion", "Correct the start.")
    return scipy.optimize.least_squares(
        lambda x: np.nan_to_num(np.asarray(problem.errors(x)), nan=1e6, posinf=1e6, neginf=-1e6),
        x0,
        jac=lambda x: np.nan_to_num(np.asarray(problem.jacobian(x))),
        bounds=(np.where(positive, x0 - _REACH, -np.inf), np.where(positive, x0 + _REACH, np.inf)),
        x_scale="jac",
        max_nfev=most,
        xtol=1e-8,
        ftol=1e-10,
    )


def share_left(left, measured, where: Bool[np.ndarray, "exp line"]) -> float:
    """Root of the power of what is left over that of what was measured, there."""
    return float(np.sqrt(np.sum(np.abs(left[where]) ** 2) / np.sum(np.abs(measured[where]) ** 2)))


def measured_lines(machine: Machine, data: Experiment, band, floor: float):
    """Lines, the mean period's Fourier coefficients there in the machine's quantity, and their standard deviation."""
    y = np.asarray(data.y)[0][:, data.transient_periods * data.period :]
    periods = y.reshape(len(y), -1, data.period, y.shape[2])
    Y = scipy.fft.rfft(periods, axis=2) / data.period
    times = QUANTITIES[machine.quantity] - QUANTITIES[data.y_quantity]
    omega = 2 * np.pi * data.fs / data.period * np.arange(Y.shape[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(omega > 0, (1j * omega) ** times, 1.0 if times == 0 else 0.0)[:, None]
    mean = Y.mean(axis=1) * factor
    power = np.abs(scipy.fft.rfft(driving(data), axis=1)) ** 2
    top = int(np.max(np.flatnonzero(power.sum(axis=(0, 2)) > 1e-4 * power.sum(axis=(0, 2)).max())))
    step = data.fs / data.period
    usual = (0.0 if times > 0 else step, _BEYOND * top * step)
    low, high = usual if band is None else as_band(band)
    lines = np.flatnonzero((omega >= 2 * np.pi * low) & (omega <= 2 * np.pi * high))
    lines = lines[lines > 0] if times <= 0 else lines
    if not lines.size:
        raise input_error("band", f"no line from {low:g} to {high:g} Hz", "some", "Widen the band.")
    noise = _noise(Y, top) * np.abs(factor) ** 2
    rms = np.sqrt(np.mean(np.abs(mean[:, lines]) ** 2, axis=1, keepdims=True))
    return lines, mean[:, lines], np.sqrt(noise[:, lines] + (floor * rms) ** 2)


def _noise(Y: Complex[np.ndarray, "exp period line out"], top: int) -> Float[np.ndarray, "exp line out"]:
    """Variance of the mean period's lines.

    From the scatter between periods, over as many lines as make `_SCATTER` degrees of freedom: a variance of one or two
    is now and then next to nothing, and its line would outweigh all others. A single period shows its noise beyond
    twice the highest excited line, `top`, where distortion is weak, as if it were white."""
    n, n_lines = Y.shape[1:3]
    if n > 1:
        each = np.var(Y, axis=1, ddof=1) / n
        return scipy.ndimage.uniform_filter1d(each, min(-(-_SCATTER // (n - 1)), n_lines), axis=1, mode="reflect")
    beyond = np.abs(Y[:, 0, 2 * top + 1 :]) ** 2
    if beyond.shape[1] < _SCATTER:
        return np.zeros(Y[:, 0].shape)
    return np.broadcast_to(np.median(beyond, axis=1, keepdims=True) / np.log(2.0), Y[:, 0].shape)


class RankedEffect(eqx.Module):
    """A candidate of `rank_effects`.

    **Fields:** `effect`: as it was given, with its first numbers. `fit`: the machine with it, all numbers fitted.
    `gain`: factor by which the power of the residual fell. `p_value`: of an F test, the probability of a gain as large
    where the effect is not there and what is left is noise.
    """

    effect: AbstractEffect
    fit: MachineFit
    gain: float = eqx.field(static=True)
    p_value: float = eqx.field(static=True)


def rank_effects(
    machine: Machine,
    data: Experiment,
    candidates: Sequence[AbstractEffect],
    *,
    band: tuple[float, float] | None = None,
    settle: int | None = None,
    floor: float = FLOOR,
    hold: bool = True,
) -> tuple[MachineFit, list[RankedEffect]]:
    """The fit without any, and every candidate by how much of the residual it takes, the best first.

    Each is fitted together with all other parameters. `p_value` is that of an F test with as many degrees of freedom as
    lines that were compared: a guide, not a verdict, as what is left is mostly not noise.

    Biased to what has more numbers: no line is held out, as `diagnose_machine` does.

    **Arguments:** `machine`: as it is known. `data`: a periodic record of it. `candidates`: effects at places of the
    machine, with the numbers that their fits start from. `band` (Hz), `settle` (periods), `floor`, `hold`: as of
    `fit_machine`.

    **Returns:** the fit without a candidate, and `RankedEffect`s, the largest gain first.

    **Raises:** `jaxfrf.InputError` as `fit_machine`, and for a candidate that no place of the machine takes.

    **Source:** F test between nested least-squares fits, (chi_0^2/chi_1^2 - 1) dof/more of the mean squares; this
    project's own order.
    """
    expect_each("candidates", candidates, AbstractEffect, least=0)
    plain = fit_machine(machine, data, band=band, settle=settle, floor=floor, hold=hold)
    ranked = []
    for effect in candidates:
        changed = plain.machine.with_effects(effect)
        found = fitted(changed, data, band=band, settle=settle, floor=floor, hold=hold)
        more, dof = len(found.values) - len(plain.values), max(2 * len(found.lines) * data.n_exp - len(found.values), 1)
        before, after = plain.misfit**2, found.misfit**2
        statistic = max(before / max(after, 1e-300) - 1.0, 0.0) * dof / max(more, 1)
        ranked.append(
            RankedEffect(effect, found, before / max(after, 1e-300), float(scipy.stats.f.sf(statistic, more, dof)))
        )
    return plain, sorted(ranked, key=lambda x: -x.gain)
