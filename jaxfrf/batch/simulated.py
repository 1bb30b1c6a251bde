"""A simulated data set of any size: some positions at a time, each kept until the file stands."""

import math
import os
import pathlib

import equinox as eqx
import jax
import jax.random as jr
import numpy as np
from jaxtyping import PRNGKeyArray

from .._files import check_space, replacing
from .._memory import block_memory, check_memory
from ..excitation import Multisine
from ..io.records import writing
from ..parts import Parts, numbers_text
from ..robot import Robot
from ..simulation.checks import limit_share, limits_told, soft_springs
from ..simulation.experiment import played, study_of_design
from ..simulation.runs import Progress, Study, record

PART_FILES = ("[0-9]" * 5 + ".npz",)
_TOGETHER = 64  # runs: as many keep the cores busy
_COPIES = 3  # of a block's signals, while it is simulated and written


class Simulated(eqx.Module):
    """What was written. **Fields:** `positions`, `experiments`, `samples`, `periods`, and `warnings` about the runs."""

    positions: int
    experiments: int
    samples: int
    periods: int
    warnings: tuple[str, ...]


def simulate_to(
    path: str | os.PathLike,
    robot: Robot,
    design: Multisine,
    positions,
    *,
    key: PRNGKeyArray,
    parts: Parts,
    run_in: float | None = 5.0,
    noise: float = 5e-5,
    memory: float | None = None,
    progress: Progress | None = None,
) -> Simulated:
    """`jaxfrf.simulate` to a file, some positions at a time: within 1e-9 the same numbers.

    **Arguments:** as of `jaxfrf.simulate`. `path`: `.nc`, `.zarr` (written as it comes), `.mat` or `.npz` (held in
    memory at the end). `parts` keeps finished positions. `memory`: bytes that this may take, `None`: by what is free.

    **Raises:** `jaxfrf.InputError` as `jaxfrf.simulate` does, and where disk or memory have no room for the result.
    """
    positions = np.asarray(positions, float)
    samples = _samples(design, run_in)
    each = 8.0 * design.n_exp * samples * design.n_in
    _check_size(pathlib.Path(path), len(positions), each)
    study = study_of_design(robot, design, positions, key, run_in, noise, None)
    blocks = _blocks(study, each, memory)
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
    for number, block in enumerate(blocks):
        ours = None if progress is None else lambda done, n=number: progress((n + done) / len(blocks))
        name = f"{block[0]:05d}.npz"
        if parts.read(name, _whole) is None:
            u, y = record(study, 32, ours, positions=block)
            with replacing(parts.path(name)) as draft:
                np.savez(draft, u=u, y=y)
            del u, y
        if progress is not None:
            progress((number + 1) / len(blocks))
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


def _blocks(study: Study, each: float, memory: float | None) -> list[range]:
    n_pos = len(study.point.z)
    most = int(block_memory(memory) / (2 * _COPIES * each))
    size = max(1, min(math.ceil(_TOGETHER / study.n_exp), most, n_pos))
    return [range(first, min(first + size, n_pos)) for first in range(0, n_pos, size)]


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
            with np.load(parts.path(f"{block[0]:05d}.npz")) as part:
                u = part["u"]
                put("u", block[0], u)
                put("y", block[0], part["y"])
            for position in block:
                put("r", position, reference[None])
            shares.append(limit_share(robot, u))
            del u
    return np.concatenate(shares)
