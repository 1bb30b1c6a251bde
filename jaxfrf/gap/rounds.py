"""Rounds of a search that were finished, kept, so that an interrupted run need not simulate them again."""

import json
import pathlib

import equinox as eqx
import numpy as np

from .._files import replacing
from ..effects import AbstractEffect, library
from ..effects.catalogue import effect_from_table, effect_to_table
from ..parts import Parts

PART_FILES = ("round-[0-9]*.json",)


class Round(eqx.Module):
    """What one round found: an effect, standard deviations of its parameters, the knobs' changes, and of each rival the
    name, joint, misfit and whether it is near. `None` for an effect: nothing more was found."""

    effect: AbstractEffect | None
    joint: str = eqx.field(static=True)
    std: tuple[float, ...] = eqx.field(static=True)
    turns: np.ndarray
    rivals: tuple[tuple, ...] = eqx.field(static=True)


def read_round(parts: Parts | None, number: int) -> Round | None:
    """A finished round; `None` where there is none."""
    return None if parts is None else parts.read(_name(number), _read)


def _name(number: int) -> str:
    return f"round-{number}.json"


def _read(path: pathlib.Path) -> Round:
    said = json.loads(path.read_text(encoding="utf-8"))
    effect = effect_from_table(said["effect"]) if said["effect"] else None
    rivals = tuple(tuple(row) for row in said["rivals"])
    return Round(effect, said["joint"], tuple(said["std"]), np.array(said["turns"], float), rivals)


def keep_round(parts: Parts | None, number: int, found: Round) -> None:
    """Keep a round, whole or not at all; one that found an effect of the user's own is found again instead."""
    if parts is None or (found.effect is not None and type(found.effect) is not library().get(found.effect.name)):
        return
    table = None if found.effect is None else effect_to_table(found.effect, found.joint)
    said = {"effect": table, "joint": found.joint, "std": list(found.std), "rivals": found.rivals}
    said["turns"] = np.asarray(found.turns).tolist()
    with replacing(parts.path(_name(number))) as draft:
        draft.write_text(json.dumps(said), encoding="utf-8")
