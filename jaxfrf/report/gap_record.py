"""A diagnosis as its page takes it: made from what gap.json holds, so that a file gives the page that its diagnosis
gave."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from ..frf import FRF
from ..gap.result import Cell, EstimatedValue, Gap, Maps, Ranked
from .recorded import finite


class RecordedEffect(eqx.Module):
    """A `jaxfrf.gap.Named` without its class. `signature`: how it shows in data; `equation`: what it is."""

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    parameters: dict[str, EstimatedValue]
    p_value: float = eqx.field(static=True)
    equivalent: tuple[str, ...] = eqx.field(static=True)
    separating_experiment: str = eqx.field(static=True)
    explains: float = eqx.field(static=True)
    visible: float = eqx.field(static=True)
    is_number: bool = eqx.field(static=True)
    signature: str = eqx.field(static=True)
    equation: str = eqx.field(static=True)


class RecordedDiagnosis(eqx.Module):
    """The fields of a `jaxfrf.gap.Diagnosis` with the name of its robot in the place of robots.

    `frf`: measured, base and extended FRF, of a diagnosis that is at hand; no file holds them. `ripple`: {joint:
    orders} that the robot is written with though nobody misses them. `from_file`: whether `frf` could not be."""

    verdict: str = eqx.field(static=True)
    says: str = eqx.field(static=True)
    effects: tuple[RecordedEffect, ...]
    ranking: tuple[Ranked, ...]
    where: tuple[Cell, ...]
    gap: Gap
    maps: Maps
    parameters: dict[str, EstimatedValue]
    changed: dict[str, float]
    robot: str = eqx.field(static=True)
    axis_names: tuple[str, ...] = eqx.field(static=True)
    ripple: dict[str, list[int]] = eqx.field(static=True)
    compared: str = eqx.field(static=True)
    fitted: tuple[int, ...] = eqx.field(static=True)
    heldout: tuple[int, ...] = eqx.field(static=True)
    frf: tuple[FRF, FRF, FRF] | None
    next_experiment: str = eqx.field(static=True)
    sources: tuple[Mapping[str, str], ...] = eqx.field(static=True)
    settings: dict[str, Any] = eqx.field(static=True)
    version: str = eqx.field(static=True)
    from_file: bool = eqx.field(static=True)


def recorded(
    contents: Mapping[str, Any], frf: tuple[FRF, FRF, FRF] | None = None, *, from_file: bool = False
) -> RecordedDiagnosis:
    """What `jaxfrf.io.gaps.gap_contents` gave, or `jaxfrf.io.read_gap` read."""
    maps, names = contents["maps"], tuple(contents["axes"])
    return RecordedDiagnosis(
        verdict=contents["verdict"],
        says=contents["says"],
        effects=tuple(_effect(x) for x in contents["effects"]),
        ranking=tuple(_ranked(x) for x in contents["ranking"]),
        where=tuple(Cell(**x | {"band_hz": tuple(x["band_hz"]), "z": finite(x["z"])}) for x in contents["where"]),
        gap=_gap(contents["gap"], names),
        maps=Maps(
            before=_array(maps["before"]),
            after=_array(maps["after"]),
            bands=_array(maps["bands"]),
            courses={
                s: (_array(x), _array(before), _array(after)) for s, (x, before, after) in maps["courses"].items()
            },
        ),
        parameters={name: _estimate(x) for name, x in contents["parameters"].items()},
        changed={n: finite(x["changed"]) for n, x in contents["parameters"].items()},
        robot=contents["robot"],
        axis_names=names,
        ripple=contents["ripple"],
        compared=contents["compared"],
        fitted=tuple(contents["positions"]["fitted"]),
        heldout=tuple(contents["positions"]["heldout"]),
        frf=frf,
        next_experiment=contents["next_experiment"],
        sources=tuple(contents["sources"]),
        settings=dict(contents["settings"]),
        version=contents["version"],
        from_file=from_file,
    )


def _array(x: Sequence) -> np.ndarray:
    return np.asarray(x, float)


def _estimate(held: Mapping[str, Any]) -> EstimatedValue:
    return EstimatedValue(finite(held["value"]), finite(held["std"]), held["unit"])


def _effect(held: Mapping[str, Any]) -> RecordedEffect:
    return RecordedEffect(
        name=held["name"],
        joint=held["joint"],
        parameters={name: _estimate(x) for name, x in held["parameters"].items()},
        p_value=finite(held["p_value"]),
        equivalent=tuple(held["equivalent"]),
        separating_experiment=held["separating_experiment"],
        explains=finite(held["explains"]),
        visible=finite(held["visible"]),
        is_number=held["kind"] == "a number is wrong",
        signature=held["signature"],
        equation=held["equation"],
    )


def _ranked(held: Mapping[str, Any]) -> Ranked:
    known = {name: finite(held[name]) for name in ("score", "p_value", "visible")}
    return Ranked(
        name=held["name"],
        joint=held["joint"],
        expected={name: finite(x) for name, x in held["expected"].items()},
        why=held["why"],
        **known,
    )


def _gap(held: Mapping[str, Any], names: Sequence[str]) -> Gap:
    each = lambda field: _array([held[field][name] for name in names])
    return Gap(
        before=finite(held["before"]),
        after=finite(held["after"]),
        floor=finite(held["floor"]),
        shrink=finite(held["shrink"]),
        unit=held["unit"],
        on=held["on"],
        torque_before=each("torque_before"),
        torque_after=each("torque_after"),
        quantity=held["quantity"],
    )
