"""Rounds of a fit through the experiment, kept until all are done."""

import hashlib
import json
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from .. import __version__
from ..experiment import Experiment
from ..graybox import Correction, RobotModel
from ..io._container import replacing
from ..io.fits import plain_data
from ..pipeline import folder_of_parts

Say = Callable[[str], None]


def kept_rounds(output, key: str, resume: bool, say: Say | None):
    """The folder of finished rounds, those that are there, and how to keep another."""
    if output is None:
        return None, (), None
    folder = folder_of_parts(output, key, resume)
    files = sorted(folder.glob("*.json"))
    done = [_read_round(path) for path in files]
    if done and say is not None:
        say(f"{len(done)} round(s) of an interrupted run taken over")
    count = len(done)

    def keep(correction: Correction) -> None:
        nonlocal count
        with replacing(folder / f"{count:05d}.json") as draft:
            draft.write_text(json.dumps({n: np.asarray(getattr(correction, n)).tolist() for n in _ROUND_FIELDS}))
        count += 1

    return folder, done, keep


_ROUND_FIELDS = ("x", "answer", "gap_db", "gap_deg")


def _read_round(path: pathlib.Path) -> Correction:
    found = json.loads(path.read_text())
    return Correction(np.array(found["x"]), np.array(found["answer"]), found["gap_db"], found["gap_deg"])


def fingerprint(model: RobotModel, data: Experiment, settings: Mapping[str, Any]) -> str:
    """What a round depends on: not how many there may be."""
    about = {n: v for n, v in plain_data(settings).items() if n != "rounds"}
    digest = hashlib.sha256(repr((about, __version__, data.y_quantity, data.r_quantity, data.fs, data.period)).encode())
    digest.update(repr((model.robot.joint_names, model.robot.driven, sorted(model.parameters))).encode())
    for x in (*jax.tree.leaves(model), data.r, data.u, data.y, data.q, data.lines):
        if x is not None:
            digest.update(np.ascontiguousarray(x).tobytes())
    return f"run-{digest.hexdigest()[:16]}"
