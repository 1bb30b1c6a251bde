"""A simulated data set of any size: some positions at a time, here or on workers, each kept until the file stands."""

import functools
import importlib.util
import math
import os
import pathlib
import pickle
import sys
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._alive import alive
from .._errors import InputError
from .._files import check_space, replacing
from .._memory import block_memory, check_memory
from .._types import Array
from ..excitation import Multisine
from ..io.records import writing
from ..parts import Parts, numbers_text
from ..robot import Robot
from ..simulation.checks import limit_share, limits_told, soft_springs
from ..simulation.experiment import played, study_of_design
from ..simulation.runs import Progress, Study, record
from .engine import outcomes, positions_text, raised

PART_FILES = ("[0-9]" * 5 + ".npz",)
_TOGETHER = 64  # runs: as many keep the cores busy
_EACH = 32  # runs that a worker takes at a time: it has one core
_COPIES = 3  # of a block's signals, while it is simulated and written


class Simulated(eqx.Module):
    """What was written.

    **Fields:** `positions`, `experiments`, `samples`, `periods`: how many. `warnings`: about the runs.
    """

    positions: int
    experiments: int
    samples: int
    periods: int
    warnings: tuple[str, ...]


class _SimulationJob(eqx.Module):
    """All that a worker needs to know: its study is made there, whose references are large. `robot`: pickled, with
    names and files of the modules that define effects of the user's own. `about`: one text for one job."""

    robot: bytes
    modules: tuple[tuple[str, str], ...]
    design: Multisine
    positions: np.ndarray
    key: np.ndarray
    run_in: float | None
    noise: float
    folder: pathlib.Path
    about: str


def simulate_to(
    path: str | os.PathLike,
    robot: Robot,
    design: Multisine,
    positions: Float[Array, "pos axis"],
    *,
    key: PRNGKeyArray,
    parts: Parts,
    run_in: float | None = 5.0,
    noise: float = 5e-5,
    memory: float | None = None,
    workers: int = 1,
    cluster: str | None = None,
    client: Any = None,
    patience: float | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Simulated:
    """`jaxfrf.simulate` to a file, some positions at a time: within 1e-9 the same numbers, whoever simulates them.

    **Arguments:** `robot`, `design`, `positions` (rad), `key`, `run_in` (s), `noise` (rad) and `progress`: as of
    `jaxfrf.simulate`. `path`: `.nc`, `.zarr` (written as it comes), `.mat` or `.npz` (held in
    memory at the end). `parts` keeps finished positions. `memory`: bytes that every process may take, `None`: by what
    is free. `workers`, `cluster`, `client`, `patience`, `say`: as of `jaxfrf.batch.outcomes`; on other machines paths
    must mean the same files.

    **Returns:** `Simulated`: what was written.

    **Raises:** `jaxfrf.InputError` as `jaxfrf.simulate` does, and where disk or memory have no room for the result.
    """
    positions = np.asarray(positions, float)
    samples = _samples(design, run_in)
    each = 8.0 * design.n_exp * samples * design.n_in
    _check_size(pathlib.Path(path), len(positions), each)
    study = study_of_design(robot, design, positions, key, run_in, noise, None)
    here = workers == 1 and cluster is None and client is None
    blocks = _blocks(study, each, memory, math.ceil(_TOGETHER / design.n_exp) if here else _EACH // design.n_exp)
    parts.begin(
        {
            "numbers of the robot": numbers_text(*jax.tree.leaves(robot)),
            "experiments": f"{design.n_exp} of {samples} samples",
            "numbers of the design": numbers_text(*jax.tree.leaves(study.references)),
            "positions": f"{len(positions)}, {numbers_text(positions)}",
            "positions at a time": len(blocks[0]),
            "noise": f"{noise:g}, {numbers_text(jr.key_data(key))}",
            "run-in": run_in,
        },
        PART_FILES,
    )
    waiting = [block for block in blocks if parts.read(_name(block), _whole) is None]
    done = len(blocks) - len(waiting)

    def advanced(share: float) -> None:
        if progress is not None:
            progress((done + share) / len(blocks))

    if here:
        work = functools.partial(_simulated, study, parts.folder, advanced)
    else:
        work = functools.partial(_work, _job(robot, design, positions, key, run_in, noise, parts))
    shared = {"workers": workers, "cluster": cluster, "client": client, "patience": patience, "say": say}
    for outcome in outcomes(work, waiting, **shared):
        raised(outcome, positions_text(waiting[outcome.number]))
        done += 1
        advanced(0.0)
    shares = _assembled(path, robot, study, design, positions, blocks, parts, run_in)
    warnings = (*soft_springs(robot, study.point, design), *limits_told(robot, shares))
    return Simulated(len(positions), design.n_exp, samples, design.periods, warnings)


def _samples(design: Multisine, run_in: float | None) -> int:
    return (design.periods + (design.transient_periods if run_in is None else 0)) * design.period


def _check_size(path: pathlib.Path, positions: int, each: float) -> None:
    what = f"{positions} positions"
    if path.suffix.lower() in (".mat", ".npz"):
        check_memory(f"{what} in {path.suffix}", 3 * positions * each, "Write .nc, or simulate fewer at a time.")
    check_space(path, 5 * positions * each)  # u and y in parts; u, y and r in the file


def _blocks(study: Study, each: float, memory: float | None, wanted: int) -> list[range]:
    n_pos = len(study.point.z)
    most = int(block_memory(memory) / (2 * _COPIES * each))
    size = max(1, min(wanted, most, n_pos))
    return [range(first, min(first + size, n_pos)) for first in range(0, n_pos, size)]


def _name(block: range) -> str:
    return f"{block[0]:05d}.npz"


def _simulated(study: Study, folder: pathlib.Path, advanced: Progress, block: range) -> InputError | None:
    """Simulate some positions, in whatever process; what is wrong with them."""
    try:
        u, y = record(study, 32, advanced, positions=block)
    except InputError as error:
        return error
    with replacing(folder / _name(block)) as draft:
        np.savez(draft, u=u, y=y)
    return None


def _job(
    robot: Robot, design: Multisine, positions, key: PRNGKeyArray, run_in, noise: float, parts: Parts
) -> _SimulationJob:
    pickled, seed = pickle.dumps(robot), np.asarray(jr.key_data(key))
    about = numbers_text(np.frombuffer(pickled, np.uint8), positions, seed, *jax.tree.leaves(design))
    return _SimulationJob(
        pickled, _own_modules(robot), design, positions, seed, run_in, noise, parts.folder.absolute(), about
    )


def _own_modules(robot: Robot) -> tuple[tuple[str, str], ...]:
    modules = [sys.modules[name] for name in {type(effect).__module__ for effect in robot.effects}]
    files = {x.__name__: getattr(x, "__file__", None) for x in modules if x.__name__.split(".")[0] != "jaxfrf"}
    return tuple((name, str(pathlib.Path(file).absolute())) for name, file in sorted(files.items()) if file)


def _robot_of(job: _SimulationJob) -> Robot:
    for name, file in job.modules:
        if name not in sys.modules:
            spec = importlib.util.spec_from_file_location(name, file)
            if spec is None or spec.loader is None:
                raise ImportError(f"{file}: found no Python file that defines {name}")
            sys.modules[name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(sys.modules[name])
    return pickle.loads(job.robot)


_studies: dict[str, Study] = {}  # of this process, the last one


def _work(job: _SimulationJob, block: range) -> InputError | None:
    if job.about not in _studies:
        robot, key = _robot_of(job), jr.wrap_key_data(jnp.asarray(job.key))
        _studies.clear()
        _studies[job.about] = study_of_design(robot, job.design, job.positions, key, job.run_in, job.noise, None)
    return _simulated(_studies[job.about], job.folder, lambda share: alive(), block)


def _whole(path: pathlib.Path) -> bool:
    with np.load(path) as part:
        return {"u", "y"} <= set(part.files)


def _assembled(path, robot: Robot, study: Study, design: Multisine, positions, blocks, parts: Parts, run_in):
    """The file from its parts, and the share of samples at the torque limits: (pos, exp, axis)."""
    reference = played(study)
    shape = (len(positions), *reference.shape)
    about = {
        "fs": design.fs,
        "period": design.period,
        "transient_periods": design.transient_periods if run_in is None else 0,
        "r_quantity": "velocity",
        "y_quantity": "position",
    }
    shares = []
    with writing(path, dict.fromkeys(("u", "y", "r"), shape), positions, design.lines, about) as put:
        for block in blocks:
            with np.load(parts.path(_name(block))) as part:
                u = part["u"]
                put("u", block[0], u)
                put("y", block[0], part["y"])
            for position in block:
                put("r", position, reference[None])
            shares.append(limit_share(robot, u))
            del u
    return np.concatenate(shares)
