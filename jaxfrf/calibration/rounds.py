"""Rounds of a calibration that were finished, kept until its result stands."""

import dataclasses
import json
import pathlib
from collections.abc import Sequence

import jax
import numpy as np

from .._files import replacing
from ..parts import Parts, files_text, numbers_text
from ..robot import Robot
from ..trajectory.measured import Measured
from ..trajectory.ripple import Order, Wave
from .numbers import Number
from .result import Round

PART_FILES = ("[0-9]" * 3 + ".json",)


@dataclasses.dataclass(frozen=True)
class Kept:
    """A finished round: where the numbers were, the orders of ripple beside them, the floor that it began with (`None`:
    the plain one), what was left, whether the robot was near the truth, the ripple that was simulated, and the part of
    every axis' torque that it missed."""

    x: np.ndarray
    orders: tuple[Order, ...]
    floor: np.ndarray | None
    round: Round
    near: bool
    inside: tuple[Wave, ...]
    missed: np.ndarray


class Rounds:
    """The finished rounds of these data and this robot; keeps nothing without `parts`."""

    def __init__(self, parts: Parts | None, robot: Robot, numbers: Sequence[Number], record: Measured, heldout):
        self.parts = parts
        self.done: list[Kept] = []
        if parts is None:
            return
        parts.begin(_about(robot, numbers, record, heldout), PART_FILES)
        while (found := parts.read(_name(len(self.done)), _read)) is not None:
            self.done.append(found)

    def keep(self, round: Kept) -> None:
        self.done.append(round)
        if self.parts is None:
            return
        said = {
            "x": round.x.tolist(),
            "orders": [o.listed() for o in round.orders],
            "floor": None if round.floor is None else round.floor.tolist(),
            "round": [round.round.misfit, round.round.left, round.round.design_effect],
            "inside": [[o.listed(), wave] for o, wave in round.inside],
            "near": round.near,
            "missed": round.missed.tolist(),
        }
        with replacing(self.parts.path(_name(len(self.done) - 1))) as draft:
            draft.write_text(json.dumps(said), encoding="utf-8")


def _name(number: int) -> str:
    return f"{number:03d}.json"


def _read(path: pathlib.Path) -> Kept:
    said = json.loads(path.read_text(encoding="utf-8"))
    orders = tuple(Order.of(*order) for order in said["orders"])
    inside = tuple((Order.of(*order), (float(sine), float(cosine))) for order, (sine, cosine) in said["inside"])
    x, missed = (np.array(said[name], float) for name in ("x", "missed"))
    floor = None if said["floor"] is None else np.array(said["floor"], float)
    return Kept(x, orders, floor, Round(*said["round"]), bool(said["near"]), inside, missed)


def _about(robot: Robot, numbers: Sequence[Number], record: Measured, heldout) -> dict:
    """What a round depends on."""
    data = record.data
    return {
        "whole robot": True,
        "data": files_text(data.sources),
        "output": data.y_quantity,
        "joints": [*robot.joint_names, *(f"{e.name} of {getattr(e, 'joint', '')}" for e in robot.effects)],
        "numbers": [[n.name, n.given, n.size, n.prior] for n in numbers],
        "numbers of the robot": numbers_text(*jax.tree.leaves(robot)),
        "numbers of the data": numbers_text(*jax.tree.leaves(data)),
        "heldout": list(heldout),
        **({"payloads": numbers_text(*jax.tree.leaves(record.payloads))} if record.payloads else {}),
    }
