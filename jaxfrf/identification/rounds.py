"""Rounds of an indirect fit, kept until the result stands."""

import json
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from .._files import replacing
from ..experiment import Experiment
from ..frf import FRF
from ..graybox import Correction, RobotModel
from ..io.fits import plain_data
from ..parts import Parts, files_text, numbers_text

_PART_FILES = ("[0-9]" * 5 + ".json",)
_ROUND_FIELDS = ("x", "update", "gap_db", "gap_deg")


def kept_rounds(
    parts: Parts, model: RobotModel, data: Experiment | FRF, settings: Mapping[str, Any]
) -> tuple[list[Correction], Callable[[Correction], None]]:
    """The rounds that an interrupted run finished, and how to keep another."""
    parts.begin(_about(model, data, settings), _PART_FILES)
    done: list[Correction] = []
    while (found := parts.read(_name(len(done)), _read_round)) is not None:
        done.append(found)
    count = len(done)

    def keep(correction: Correction) -> None:
        nonlocal count
        with replacing(parts.path(_name(count))) as draft:
            draft.write_text(json.dumps({n: np.asarray(getattr(correction, n)).tolist() for n in _ROUND_FIELDS}))
        count += 1

    return done, keep


def _name(number: int) -> str:
    return f"{number:05d}.json"


def _read_round(path: pathlib.Path) -> Correction:
    found = json.loads(path.read_text(encoding="utf-8"))
    return Correction(np.array(found["x"]), np.array(found["update"]), found["gap_db"], found["gap_deg"])


def _about(model: RobotModel, data: Experiment | FRF, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What a round depends on: not how many there may be."""
    robot = model.robot
    chosen = {name: x for name, x in plain_data(settings).items() if name != "rounds"}
    return chosen | {
        "indirect": settings["rounds"] is not None,
        "data": files_text(data.sources),
        "output": data.y_quantity,
        "joints": [*robot.joint_names, *(f"{e.name} of {getattr(e, 'joint', '')}" for e in robot.effects)],
        "parameters": sorted(model.parameters),
        "numbers of the robot": numbers_text(*jax.tree.leaves(model)),
        "numbers of the data": numbers_text(*jax.tree.leaves(data)),
        "kind of the data": _kind(data),
    }


def _kind(data: Experiment | FRF) -> str:
    if isinstance(data, FRF):
        return "FRF"
    return f"records at {data.fs:g} Hz, period {data.period}, reference {data.r_quantity}"
