"""From a design to the record of a simulated experiment."""

import concurrent.futures
import itertools
import math
import os
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._errors import input_error
from .._types import Array, require_x64
from ..excitation import Multisine, reference
from ..excitation.multisine import reference_spectra
from ..excitation.signals import one_period
from ..experiment import Experiment
from ..robot import OperatingPoint, Robot, operating_point
from .closed_loop import ClosedLoop, LoopState, Runs, play
from .steps import fine_steps

_SEGMENT = 2000  # samples between two looks at the runs: bounds the memory and finds divergence early
_ASTRAY = 0.3  # rad on the arm side between reference and motion, which no working controller lets happen

Progress = Callable[[float], None]


def simulate(
    robot: Robot,
    design: Multisine,
    positions: Float[Array, "pos axis"],
    *,
    key: PRNGKeyArray,
    run_in: float | None = 5.0,
    noise: float = 5e-5,
    steps: int | None = None,
    chunk: int = 32,
    progress: Progress | None = None,
) -> Experiment:
    """Play a design on a simulated robot at every position, in closed loop, and record it.

    `r` is the speed reference, `u` the torque command at its sample, held until the next, `y` the measured
    motor *position* (what a resolver gives, ripple and noise included): states differentiate it in frequency,
    `jaxfrf.with_output_quantity(jaxfrf.dft(data), "acceleration")`, which is exact. The motor turns about its
    position at rest in the arm configuration. Reference and phases come from `design.seed`, noise from `key`;
    a run's noise depends on its position's and experiment's number only, not on `chunk`.

    **Arguments:**

    - `robot`: with a controller and the sampling frequency of the design.
    - `positions`: arm angles at rest, (pos, axis), rad.
    - `run_in`: seconds of the periodic motion before the first recorded sample, faded in from rest; the record
      then holds steady periods only. `None`: the transient periods of the design are played and recorded.
    - `noise`: standard deviation of white noise on the measured motor position, rad.
    - `steps`: Runge-Kutta steps in a control sample; as many as `fine_steps` finds necessary by default.
    - `chunk`: runs that are computed together on one core; it changes speed and memory, not the result.
    - `progress`: called with the part that is done, from 0 to 1.

    **Raises:** `jaxfrf.InputError` where robot, design and positions do not fit together, and where runs
    diverge: it names positions and experiments, and nothing is recorded then.
    """
    require_x64("A simulation")
    positions = _check(robot, design, positions)
    point = _equilibria(robot, positions)
    signals = _Signals(design, run_in, robot.sampling_frequency)
    if steps is not None and not (steps == int(steps) and steps >= 1):
        raise input_error("steps", f"{steps}", "a whole number, 1 or more, or None", "None finds it.")
    loop = ClosedLoop.of(robot, noise=noise, steps=fine_steps(robot, point) if steps is None else int(steps))
    study = _Study(loop, signals, point, key, design.n_exp)
    u, y = study.run(_blocks(len(positions) * design.n_exp, chunk), progress)
    shape = (len(positions), design.n_exp, *u.shape[1:])
    recorded = signals.velocity[:, signals.run_in :]
    return Experiment(
        u=u.reshape(shape),
        y=y.reshape(shape),
        r=np.broadcast_to(recorded, (len(positions), *recorded.shape)),
        q=positions,
        fs=design.fs,
        period=design.period,
        lines=design.lines,
        transient_periods=design.transient_periods if run_in is None else 0,
        y_quantity="position",
    )


def _check(robot: Robot, design: Multisine, positions) -> np.ndarray:
    if robot.controller is None:
        raise input_error(
            f"{robot.name}: controller",
            "none",
            "a [controller] table",
            "Without its controller the robot cannot be simulated in closed loop: state position_gain, "
            "integral_time and each joint's velocity_gain.",
        )
    if design.fs != robot.sampling_frequency:
        raise input_error(
            "fs of the design",
            f"{design.fs:g} Hz",
            f"{robot.sampling_frequency:g} Hz, the sampling_frequency of {robot.name}",
            "Change one of them: the controller plays one reference value a sample.",
        )
    if design.n_in != robot.n_axes:
        raise input_error(
            "inputs of the design",
            f"{design.n_in}",
            f"{robot.n_axes}, one for each driven joint of {robot.name}",
            "Set inputs, or complete rms and the slow sine.",
        )
    positions = np.asarray(positions, float)
    if positions.ndim != 2 or positions.shape[1] != robot.n_axes or not len(positions):
        raise input_error(
            "positions",
            f"an array of shape {positions.shape}",
            f"(position, {robot.n_axes}), rad",
            "Give one row of arm angles for each position.",
        )
    if not np.isfinite(positions).all():
        raise input_error("positions", "NaN or Inf", "finite angles, rad", "Correct the file.")
    return positions


def _equilibria(robot: Robot, positions: np.ndarray) -> OperatingPoint:
    point = operating_point(robot, positions)
    lost = np.flatnonzero(~np.asarray(point.converged))
    if lost.size:
        raise input_error(
            f"{robot.name}",
            f"no equilibrium at position {lost[0]}, q = {np.round(positions[lost[0]], 3).tolist()}",
            "springs that carry the arm's weight",
            "Check stiffness, masses and the position.",
        )
    limit, torque = np.asarray(robot.drives.torque_limit), np.abs(np.asarray(point.torque))
    for p, axis in np.argwhere(torque > limit)[:1]:
        raise input_error(
            f"{robot.name}: {robot.axis_names[axis]}",
            f"{torque[p, axis]:.3g} N m to hold the arm at position {p}",
            f"at most the torque_limit of {limit[axis]:.3g} N m",
            "Lower the payload, or choose other positions.",
        )
    return point


class _Signals:
    """References of all experiments from the first simulated sample on: (exp, time, axis), run-in included."""

    def __init__(self, design: Multisine, run_in: float | None, fs: float):
        self.run_in = 0 if run_in is None else _samples(run_in, fs)
        if run_in is None:
            made = reference(design)
            self.velocity, self.position = made.r, made.position
            return
        periods = [one_period(design, X) for X in reference_spectra(design)]
        index = np.arange(-self.run_in, design.periods * design.period) % design.period
        self.velocity, self.position = (np.stack([x[index] for x in xs]) for xs in zip(*periods, strict=True))
        _fade_in(self.velocity, self.position, self.run_in, fs)

    def stretch(self, start: int) -> np.ndarray:
        """Samples `start` to `start + _SEGMENT`, zero beyond the end: (time, 2, axis, exp)."""
        part = np.stack([x[:, start : start + _SEGMENT] for x in (self.velocity, self.position)])
        part = np.pad(part, ((0, 0), (0, 0), (0, _SEGMENT - part.shape[2]), (0, 0)))
        return part.transpose(2, 0, 3, 1)

    @property
    def n_time(self) -> int:
        return self.velocity.shape[1]


def _samples(run_in: float, fs: float) -> int:
    if not (math.isfinite(run_in) and run_in >= 0):
        raise input_error("run_in", f"{run_in}", "seconds, 0 or more", "E.g. run_in=5.0, or None.")
    return math.ceil(run_in * fs)


def _fade_in(velocity, position, n: int, fs: float) -> None:
    """Start from rest over the first 60 % of the run-in, in place: q -> w q, v -> w' q + w v, w a quintic."""
    n = int(0.6 * n)
    x = np.arange(n)[:, None] / max(n, 1)
    weight, rate = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 * fs / max(n, 1)
    velocity[:, :n] = rate * position[:, :n] + weight * velocity[:, :n]
    position[:, :n] *= weight


def _blocks(n_runs: int, chunk: int) -> list[np.ndarray]:
    """Run numbers in blocks of one size, as many as the cores can share; the last is filled up with its last run."""
    if chunk < 1:
        raise input_error("chunk", f"{chunk}", "1 run or more", "The default suits most machines.")
    count = math.ceil(n_runs / chunk)
    if count > 1:
        count = math.ceil(count / _cores()) * _cores()
    size = math.ceil(n_runs / count)
    return [np.minimum(np.arange(first, first + size), n_runs - 1) for first in range(0, n_runs, size)]


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Study:
    """All runs of a study; run number = position * n_exp + experiment."""

    def __init__(self, loop: ClosedLoop, signals: _Signals, point: OperatingPoint, key, n_exp: int):
        self.loop, self.signals, self.point, self.key, self.n_exp = loop, signals, point, key, n_exp

    def run(self, blocks: list[np.ndarray], progress: Progress | None):
        """Torque commands and measured positions, (run, time, axis)."""
        n_runs, kept = blocks[-1].max() + 1, self.signals.n_time - self.signals.run_in
        shape = (n_runs, kept, self.loop.plant.wiring.axes)
        u, y = np.empty(shape), np.empty(shape)
        lost: dict[int, float] = {}
        total, done = len(blocks) * math.ceil(self.signals.n_time / _SEGMENT), itertools.count(1)

        def advance_progress():
            if progress is not None:
                progress(min(next(done) / total, 1.0))

        def work(block):
            for start, stretch in self._segments(block, lost):
                _store(u, y, block, start - self.signals.run_in, stretch)
                yield

        jobs = [work(block) for block in blocks]
        if next(jobs[0], _END) is not _END:  # compiled once, before the threads start
            advance_progress()
        # One thread per core, each with its own block: a block's arrays stay in its core's cache.
        with concurrent.futures.ThreadPoolExecutor(_cores()) as pool:
            waiting = {pool.submit(next, job, _END): job for job in jobs[: _cores()]}
            queue = jobs[_cores() :]
            while waiting:
                finished, _ = concurrent.futures.wait(waiting, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in finished:
                    job = waiting.pop(future)
                    if future.result() is not _END:
                        advance_progress()
                    elif queue:
                        job = queue.pop(0)
                    else:
                        continue
                    waiting[pool.submit(next, job, _END)] = job
        if lost:
            raise self._diverged(lost)
        return u, y

    def _start(self, block: np.ndarray) -> tuple[LoopState, Runs]:
        point = jax.tree.map(lambda x: x[block // self.n_exp], self.point)
        state = self.loop.at_rest(point)
        fold = jax.vmap(lambda p, e: jr.fold_in(jr.fold_in(self.key, p), e))
        keys = fold(block // self.n_exp, block % self.n_exp)
        return state, Runs(jnp.asarray(block % self.n_exp), self.loop.plant.motor(state.z), keys)

    def _segments(self, block: np.ndarray, lost: dict[int, float]) -> Iterator:
        state, runs = self._start(block)
        for start in range(0, self.signals.n_time, _SEGMENT):
            references = self.signals.stretch(start)
            state, *stretch = play(self.loop, state, runs, jnp.asarray(start), references)
            torque, reading = (np.asarray(x) for x in stretch)
            left = min(_SEGMENT, self.signals.n_time - start)
            astray = self._astray(reading[:left], references[:left, 1], runs)
            for run, when in zip(block, astray, strict=True):
                if np.isfinite(when):
                    lost.setdefault(int(run), (start + float(when)) / self.loop.fs)
            yield start, (torque[:left], reading[:left])
            if np.isfinite(astray).all():
                return

    def _astray(self, reading, references, runs: Runs) -> np.ndarray:
        """First sample at which each run has left its reference, inf where it follows; (run,)."""
        expected = references[:, :, np.asarray(runs.experiment)] + np.asarray(runs.rest)
        limit = _ASTRAY * np.abs(np.asarray(self.loop.plant.gear))
        gone = np.any(~(np.abs(reading - expected) <= limit), axis=1)
        return np.where(gone.any(axis=0), gone.argmax(axis=0), np.inf)

    def _diverged(self, lost: dict[int, float]):
        named = [
            f"position {run // self.n_exp}, experiment {run % self.n_exp} at {when:.3g} s"
            for run, when in sorted(lost.items())
        ]
        more = f" and {len(named) - 5} more" if len(named) > 5 else ""
        return input_error(
            "simulation",
            f"{len(named)} runs that leave their reference: {'; '.join(named[:5])}{more}",
            "every motor within .3 rad (arm side) of its reference",
            "Lower the controller's gains, shorten its sample, or soften friction (smoothing); a torque limit that "
            "is reached does it too.",
        )


_END = object()


def _store(u, y, block: np.ndarray, start: int, stretch) -> None:
    """Keep what lies behind the run-in."""
    torque, reading = (x[max(-start, 0) :] for x in stretch)
    if len(torque):
        span = slice(max(start, 0), max(start, 0) + len(torque))
        u[block, span], y[block, span] = torque.transpose(2, 0, 1), reading.transpose(2, 0, 1)
