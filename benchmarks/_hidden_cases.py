"""The data of a case in which an effect is hidden, or none, or one that has no name.

    for case in cases("report"):
        make(case, folder)

writes `folder/cases/NNN/data.nc` and `robot.toml` (the robot as its user knows it), which is all that a diagnosis may
see, and `folder/truth/NNN.json`, which only the scorer opens. The machines, the experiments and what is known of them
stand in `_hidden_robots`, which cases there are in `_hidden_plan`. Half of the records come from `jaxfrf.simulate`
(with twice the fine steps that it would choose), half from MuJoCo.

Some effects are errors of numbers that the given robot has wrong anyway. What is then true of the number is the whole
difference between machine and given robot, the hidden part and the drawn one, which points the same way; the truth
states it beside what was hidden ("true"), and how many default tolerances it is ("tolerances"): within some of them, a
diagnosis that says nothing has believed what it may.
"""

import dataclasses
import math
import pathlib
import shutil
import tempfile

import jax.random as jr
import numpy as np
from _hidden_effects import MAIN, NUMBERS, Circumstances, Hidden, hidden_effect
from _hidden_plan import CLASSES, PARTS, Case, cases, class_of
from _hidden_robots import Plant, background, given, logged, machine
from _mujoco_records import mujoco_experiment

import jaxfrf as jf
from jaxfrf.effects import AbstractEffect, AbstractStructure
from jaxfrf.effects.catalogue import effect_to_table, library
from jaxfrf.io._json import write_json
from jaxfrf.io.records import write
from jaxfrf.io.robots import write_robot
from jaxfrf.robot import Robot, operating_point, parameters
from jaxfrf.robot.tolerances import DEFAULTS
from jaxfrf.simulation.steps import fine_steps

__all__ = ["CLASSES", "PARTS", "Case", "can_be_made", "cases", "class_of", "make"]

_TRIES, _WEAKER = 6, 0.7  # of a level at which the closed loop fails
_CLIPPED = 1e-3  # part of the samples at the controller's torque limit from which on a run counts as failed


def can_be_made(case: Case) -> bool:
    """Whether the library has the effects of the case."""
    return all(hidden.name not in MAIN or hidden.name in library() for hidden in case.hidden)


def make(case: Case, folder, processes: int = 2, plant: Plant | None = None) -> None:
    """Write data and truth of a case unless they are there. `processes`: of MuJoCo; `plant`: instead of the case's.

    A level at which the closed loop fails is lowered by steps of .7; the truth states the one that was played.
    """
    folder = pathlib.Path(folder)
    place, truth = folder / "cases" / case.name, folder / "truth" / f"{case.name}.json"
    if place.exists() and truth.exists():
        return
    place.parent.mkdir(parents=True, exist_ok=True)
    truth.parent.mkdir(parents=True, exist_ok=True)
    data, known, described = played(case, plant or case.plant, processes)
    draft = pathlib.Path(tempfile.mkdtemp(prefix=f".{case.name}-", dir=place.parent))
    try:
        write(draft / "data.nc", data)
        write_robot(draft / "robot.toml", known)
        draft.chmod(0o755)
        write_json(truth, described)
        if place.exists():
            shutil.rmtree(place)
        draft.rename(place)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def played(case: Case, plant: Plant, processes: int = 2) -> tuple[jf.Experiment, Robot, dict]:
    """The record, the robot that is given, and what is true."""
    own = machine(plant, case.seed)
    around = _around(case, plant, own)
    weaker = 1.0
    for _ in range(_TRIES):
        hidden = [dataclasses.replace(h, level=h.level * weaker) for h in case.hidden]
        drawn = [hidden_effect(own, h, around, _random(case, 20 + k)) for k, h in enumerate(hidden)]
        acting = [effect for effect, _ in drawn]
        try:
            data = _simulated(case, plant, own.with_effects(*acting, *background(own, case.seed)), processes)
        except (jf.InputError, RuntimeError) as error:
            if not case.hidden or not any(text in str(error) for text in ("leave", "equilibrium")):
                raise
        else:
            if not case.hidden or _clipped(own, data) < _CLIPPED:
                known = given(own, case.seed, _toward(own, acting))
                return logged(data, case.log, case.seed), known, _truth(case, own, known, drawn)
        weaker *= _WEAKER
    raise RuntimeError(f"case {case.name} of {case.part}: the loop fails at any level ({case.hidden})")


def _toward(own: Robot, acting: list[AbstractEffect]) -> dict[str, float]:
    """Which of the robot's numbers the hidden effects change, and the signs of that."""
    return {
        _number(own, effect): float(np.sign(getattr(effect, MAIN[effect.name])))
        for effect in acting
        if effect.name in NUMBERS
    }


def _number(own: Robot, effect: AbstractEffect) -> str:
    return f"{effect.joint or own.joint_names[-1]}.{NUMBERS[effect.name]}"


def _truth(case: Case, own: Robot, known: Robot, drawn: list[tuple[AbstractEffect, float]]) -> dict:
    described = [
        _described(effect, hidden, level) | _true(own, known, effect)
        for (effect, level), hidden in zip(drawn, case.hidden, strict=True)
    ]
    names = ("part", "number", "kind", "robot", "log", "simulator", "seed")
    return {name: getattr(case, name) for name in names} | {"last": own.axis_names[-1], "effects": described}


def _described(effect: AbstractEffect, hidden: Hidden, level: float) -> dict:
    table = effect_to_table(effect, hidden.joint)
    named = {key: table.pop(key) for key in ("name", "joint")}
    return named | {"level": level, "drawn_level": hidden.level, "parameters": table}


def _true(own: Robot, known: Robot, effect: AbstractEffect) -> dict:
    """The main parameter as it is seen from the given robot, and how many default tolerances that is; `None` of them
    where the effect is a term that no number of the robot stands for."""
    value = getattr(effect, MAIN.get(effect.name) or next(iter(effect.units)))
    if effect.name == "torque_constant":  # of which nothing was drawn wrong
        return {"true": float(value), "tolerances": abs(float(value)) / DEFAULTS["torque_constant"].std}
    if effect.name not in NUMBERS:
        return {"true": np.ravel(np.asarray(value, float)).tolist(), "tolerances": None}
    name = _number(own, effect)
    kind = NUMBERS[effect.name]
    now, before = (float(parameters(robot, [kind])[name]) for robot in (_changed(own, effect), known))
    return {"true": now - before, "tolerances": abs(math.log(now / before)) / DEFAULTS[kind].std}


def _changed(own: Robot, effect: AbstractEffect) -> Robot:
    assert isinstance(effect, AbstractStructure)
    return effect.apply(own)


def _around(case: Case, plant: Plant, own: Robot) -> Circumstances:
    plan, q = plant.design(case.seed), plant.configurations(case.seed)

    def largest_torque():
        data = jf.simulate(own, plan, q, key=jr.key(case.seed), run_in=plant.run_in, noise=plant.noise)
        return np.max(np.abs(data.u), axis=(0, 1, 2))

    return Circumstances(q, plant.swing(), plant.run_in, plant.seconds, largest_torque, plant.hinge, plant.rest)


def _simulated(case: Case, plant: Plant, acting: Robot, processes: int) -> jf.Experiment:
    plan, q = plant.design(case.seed), plant.configurations(case.seed)
    run = {"run_in": plant.run_in, "noise": plant.noise}
    if case.simulator == "mujoco":
        return mujoco_experiment(acting, plan, q, seed=case.seed, ripple=None, processes=processes, **run)
    steps = 2 * fine_steps(acting, operating_point(acting, q))
    return jf.simulate(acting, plan, q, key=jr.fold_in(jr.key(case.seed), 3), steps=steps, **run)


def _clipped(own: Robot, data: jf.Experiment) -> float:
    """Largest part of the samples of any motor at the limit of its controller."""
    limit = np.asarray(own.drives.torque_limit) * (1.0 - 1e-9)
    return float(np.max(np.mean(np.abs(data.u) >= limit, axis=(0, 1, 2))))


def _random(case: Case, stream: int) -> np.random.Generator:
    return np.random.default_rng([case.seed, stream])
