"""Rounds of a selection that were finished, kept, so that an interrupted run need not simulate them again."""

import dataclasses
import json
import pathlib

import numpy as np

from ..._files import replacing
from ...effects import AbstractEffect, library
from ...effects.catalogue import effect_from_table, effect_to_table
from ...parts import Parts
from ...trajectory.ripple import Order, Wave
from .fitted import Fitted

PART_FILES = ("round-[0-9]*.json",)


@dataclasses.dataclass(frozen=True)
class KeptRound:
    """Where a round ended: the effect as its fit began, `None` where nothing more was found, or of the base; the
    numbers by name, orders of ripple beside them, the floor, whether the robot was near the truth and the ripple that
    was simulated then; `details` of the step; why nothing was taken."""

    effect: AbstractEffect | None = None
    joint: str = ""
    values: dict[str, float] = dataclasses.field(default_factory=dict)
    orders: tuple[Order, ...] = ()
    floor: np.ndarray | None = None
    near: bool = False
    inside: tuple[Wave, ...] = ()
    details: dict = dataclasses.field(default_factory=dict)
    refused: str = ""

    @classmethod
    def of(cls, found: Fitted, effect=None, joint: str = "", details=None) -> "KeptRound":
        at = zip(found.numbers, found.iterate.x, strict=True)
        values = {n.name: n.value(float(x)) for n, x in at}
        return cls(
            effect,
            joint,
            values,
            found.iterate.orders,
            found.iterate.start_floor,
            found.near,
            found.inside,
            details or {},
        )


def read_round(parts: Parts | None, number: int) -> KeptRound | None:
    """A finished round; `None` where there is none."""
    return None if parts is None else parts.read(_name(number), _read)


def _name(number: int) -> str:
    return f"round-{number}.json"


def _read(path: pathlib.Path) -> KeptRound:
    said = json.loads(path.read_text(encoding="utf-8"))
    effect = effect_from_table(said["effect"]) if said["effect"] else None
    orders = tuple(Order.of(*order) for order in said["orders"])
    inside = tuple((Order.of(*order), (float(sine), float(cosine))) for order, (sine, cosine) in said["inside"])
    floor = None if said["floor"] is None else np.array(said["floor"], float)
    where = said["joint"], said["values"], orders, floor, bool(said["near"]), inside
    return KeptRound(effect, *where, said["details"], said["refused"])


def keep_round(parts: Parts | None, number: int, found: KeptRound) -> bool:
    """Keep a round, whole or not at all; one that found an effect of the user's own is found again instead. Whether
    it was kept."""
    if parts is None or (found.effect is not None and type(found.effect) is not library().get(found.effect.name)):
        return False
    said = {
        "effect": None if found.effect is None else effect_to_table(found.effect, found.joint),
        "joint": found.joint,
        "values": found.values,
        "orders": [o.listed() for o in found.orders],
        "floor": None if found.floor is None else np.asarray(found.floor).tolist(),
        "near": found.near,
        "inside": [[o.listed(), wave] for o, wave in found.inside],
        "details": found.details,
        "refused": found.refused,
    }
    with replacing(parts.path(_name(number))) as draft:
        draft.write_text(json.dumps(said), encoding="utf-8")
    return True
