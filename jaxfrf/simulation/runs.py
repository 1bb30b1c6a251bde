"""All runs of a study, in blocks that the cores share, and what is kept of them."""

import concurrent.futures
import itertools
import math
from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._errors import InputError, input_error
from .._text import number
from .._threads import cores, with_settings
from ..robot import OperatingPoint
from .closed_loop import ClosedLoop, LoopState, Runs, play
from .imposed import Imposed, ImposedState
from .references import References

_SEGMENT = 2000  # samples between two looks at the runs: bounds the memory and finds divergence early
_ALIKE = 12  # runs: fewer in a block cost as much, and blocks of one size share what is compiled
_ASTRAY = 0.3  # rad on the arm side between reference and motion, which no working controller lets happen

Progress = Callable[[float], None]
Player = Callable[..., tuple]  # as `closed_loop.play`
Records = Float[np.ndarray, "pos exp time axis"]


class Study(eqx.Module):
    """`n_exp` runs from each of the equilibria in `point`; run number = position * n_exp + experiment.

    A run's noise comes from `key`, its position's and its experiment's number.
    """

    loop: ClosedLoop | Imposed
    references: References
    point: OperatingPoint
    key: PRNGKeyArray
    n_exp: int = eqx.field(static=True)

    @property
    def n_runs(self) -> int:
        return len(self.point.z) * self.n_exp


def record(
    study: Study, chunk: int, progress: Progress | None, player: Player = play, positions: range | None = None
) -> tuple[Records, ...]:
    """Torque commands and measured positions behind the run-in, `chunk` runs or fewer together on a core.

    `player`: `closed_loop.play`, or one that gives more signals after these two; all that it gives are recorded.
    `positions`: these in a row alone, all by default.

    **Raises:** `jaxfrf.InputError` where runs diverge, naming them.
    """
    positions = range(len(study.point.z)) if positions is None else positions
    first, n_runs = positions.start * study.n_exp, len(positions) * study.n_exp
    blocks = [first + block for block in _blocks(n_runs, chunk)]
    kept: dict[int, Records] = {}
    lost: dict[int, float] = {}
    total, done = len(blocks) * math.ceil(study.references.n_time / _SEGMENT), itertools.count(1)

    def advanced():
        if progress is not None:
            progress(min(next(done) / total, 1.0))

    def work(block):
        for start, stretch in _segments(study, block, lost, player):
            for part, signal in enumerate(stretch):
                shape = (n_runs, study.references.recorded, signal.shape[1])
                whole = kept.setdefault(part, np.empty(shape))
                _store(whole, block - first, start - study.references.run_in, signal)
            yield

    _share([work(block) for block in blocks], advanced)
    if lost:
        raise _diverged(study, lost)
    return tuple(kept[i].reshape(-1, study.n_exp, *kept[i].shape[1:]) for i in sorted(kept))


def _blocks(n_runs: int, chunk: int) -> list[np.ndarray]:
    """Run numbers in blocks of one size, as many as the cores can share; the last is filled up with its last run."""
    if chunk < 1:
        raise input_error("chunk", f"{chunk}", "1 run or more", "The default suits most machines.")
    count = math.ceil(n_runs / chunk)
    if count > 1:
        count = math.ceil(count / cores()) * cores()
    size = math.ceil(n_runs / count)
    size = min(max(size, _ALIKE), max(size, chunk))
    return [np.minimum(np.arange(first, first + size), n_runs - 1) for first in range(0, n_runs, size)]


_END = object()


def _share(jobs: list[Iterator], advanced: Callable[[], None]) -> None:
    """Exhaust all jobs, one thread per core, each with its own: a block's arrays stay in its core's cache."""
    if next(jobs[0], _END) is not _END:  # compiled once, before the threads start
        advanced()

    @with_settings
    def further(job: Iterator) -> object:
        return next(job, _END)

    with concurrent.futures.ThreadPoolExecutor(cores()) as pool:
        waiting = {pool.submit(further, job): job for job in jobs[: cores()]}
        queue = jobs[cores() :]
        while waiting:
            finished, _ = concurrent.futures.wait(waiting, return_when=concurrent.futures.FIRST_COMPLETED)
            for future in finished:
                job = waiting.pop(future)
                if future.result() is not _END:
                    advanced()
                elif queue:
                    job = queue.pop(0)
                else:
                    continue
                waiting[pool.submit(further, job)] = job


def _segments(study: Study, block: np.ndarray, lost: dict[int, float], player: Player) -> Iterator:
    """Number of the first sample, and torque commands, readings and what else is played, (time, row, run)."""
    loop, references = study.loop, study.references
    tracks, track = references.tracks(block)
    state, runs = _start(study, block, track)
    for start in range(0, references.n_time, _SEGMENT):
        played = references.stretch(start, _SEGMENT, tracks)
        state, *played_out = player(loop, state, runs, jnp.asarray(start), played)
        left = min(_SEGMENT, references.n_time - start)
        stretch = tuple(np.asarray(x)[:left] for x in played_out)
        astray = _astray(loop, stretch[1], played[:left, 1], runs)
        for run, when in zip(block, astray, strict=True):
            if np.isfinite(when):
                lost.setdefault(int(run), (start + float(when)) / loop.fs)
        yield start, stretch
        if np.isfinite(astray).all():
            return


def _start(study: Study, block: np.ndarray, track: np.ndarray) -> tuple[LoopState | ImposedState, Runs]:
    position, experiment = np.divmod(block, study.n_exp)
    state = study.loop.at_rest(jax.tree.map(lambda x: x[position], study.point))
    keys = jax.vmap(lambda p, e: jr.fold_in(jr.fold_in(study.key, p), e))(position, experiment)
    return state, Runs(jnp.asarray(track), study.loop.plant.motor(state.z), keys)


def _astray(loop: ClosedLoop | Imposed, reading, references, runs: Runs) -> Float[np.ndarray, "run"]:
    """First sample at which each run has left its reference, inf where it follows."""
    expected = references[:, :, np.asarray(runs.track)] + np.asarray(runs.rest)
    limit = _ASTRAY * np.abs(np.asarray(loop.plant.gear))
    gone = np.any(~(np.abs(reading - expected) <= limit), axis=1)
    return np.where(gone.any(axis=0), gone.argmax(axis=0), np.inf)


def _diverged(study: Study, lost: dict[int, float]) -> InputError:
    named = [
        f"position {run // study.n_exp}, experiment {run % study.n_exp} at {number(when)} s"
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


def _store(whole, block: np.ndarray, start: int, signal) -> None:
    """Keep what lies behind the run-in."""
    signal = signal[max(-start, 0) :]
    if len(signal):
        whole[block, max(start, 0) : max(start, 0) + len(signal)] = signal.transpose(2, 0, 1)
