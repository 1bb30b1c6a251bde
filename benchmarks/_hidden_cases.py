"""Cases in which an effect is hidden, or none, or one that has no name: which they are, and their data.

    for case in cases("report"):
        make(case, folder)

writes `folder/cases/NNN/data.nc` and `robot.toml` (the nominal robot), which is all that a diagnosis may see, and
`folder/truth/NNN.json`, which only the scorer opens.

Half of the records come from `jaxfrf.simulate` (with twice the fine steps that it would choose), half from MuJoCo. In
all of them, "none" too, the machine differs from the nominal robot by

- up to 3 % in every stiffness, damping and friction, 1 % in masses, centres of mass and inertias, .5 % in the motors'
  inertias (uniform);
- the small ripple of R3X, with phases of its own, and noise of 5e-5 rad.

The payload is drawn and known. The excitation is not the study's: 8 s, odd lines of which a quarter is left out at
random, other lines of the slow sine. 36 runs: six random arm configurations, six experiments.
"""

import collections
import dataclasses
import math
import pathlib
import shutil
import tempfile

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from _hidden_effects import JOINTS, MAIN, Circumstances, Hidden, hidden_effect
from _mujoco_records import mujoco_experiment, r3x_ripple

import jaxfrf as jf
from jaxfrf import effects
from jaxfrf.effects.catalogue import effect_to_table, library
from jaxfrf.io._json import write_json
from jaxfrf.io.records import write
from jaxfrf.io.robots import write_robot
from jaxfrf.robot import Robot, operating_point, parameters, r3x, tolerances_from, with_parameters
from jaxfrf.simulation.steps import fine_steps

FS, PERIOD, RUN_IN, NOISE, POSITIONS = 2000.0, 16000, 5.0, 5e-5, 6
CLASSES = (("torque_delay", "current_loop_lag"), ("counterbalance", "dress_pack"))
"""Effects that such data cannot tell apart: two equations with one response in 4-80 Hz, two names of one spring."""

_SPREAD = {
    "stiffness": 0.03,
    "damping": 0.03,
    "viscous_friction": 0.03,
    "coulomb_friction": 0.03,
    "mass": 0.01,
    "com": 0.01,
    "inertia": 0.01,
    "motor_inertia": 0.005,
}
KNOWN = tolerances_from({"links": 0.02, "rotors": 0.01, "friction": 0.05}, ())
"""What the nominal robot's file says of its numbers: more than they are off."""
_SLOW_LINES, _SLOW_AMPLITUDE = np.array([5, 7, 9, 11, 13, 15]), np.array([30.0, 30.0, 30.0, 40.0, 40.0, 40.0])
_TRIES, _WEAKER = 6, 0.7  # of a level at which the closed loop fails
_CLIPPED = 1e-3  # part of the samples at the controller's torque limit from which on a run counts as failed


@dataclasses.dataclass(frozen=True)
class Case:
    """One machine: `kind` is "none", "single", "double" or "outside", `simulator` "jaxfrf" or "mujoco"."""

    part: str
    number: int
    kind: str
    simulator: str
    hidden: tuple[Hidden, ...]

    @property
    def name(self) -> str:
        return f"{self.number:03d}"

    @property
    def seed(self) -> int:
        return 1000 * _PARTS[self.part].seed + self.number


@dataclasses.dataclass(frozen=True)
class _Part:
    """How many of each kind; outsiders with their simulators."""

    seed: int
    none: int
    single: int
    double: int
    outside: tuple[tuple[str, str], ...]


_PARTS = {
    "tune": _Part(
        seed=41,
        none=8,
        single=16,
        double=4,
        outside=(
            ("presliding_friction", "mujoco"),
            ("gain_drift", "jaxfrf"),
            ("bumper", "jaxfrf"),
            ("bumper", "mujoco"),
        ),
    ),
    "report": _Part(
        seed=73,
        none=16,
        single=30,
        double=8,
        outside=(
            *3 * (("presliding_friction", "mujoco"),),
            *3 * (("gain_drift", "jaxfrf"),),
            ("gain_drift", "mujoco"),
            *2 * (("bumper", "jaxfrf"),),
            ("bumper", "mujoco"),
        ),
    ),
}
PARTS = tuple(_PARTS)


def cases(part: str) -> tuple[Case, ...]:
    """All cases of a part, in an order that tells nothing; the same whenever it is asked.

    Singles and doubles go through all effects in a random order, again and again, so that each comes as often as any
    other but for one. Levels are spread evenly over the logarithm from 1 to 8.
    """
    plan = _PARTS[part]
    rng = np.random.default_rng(plan.seed)
    singles, doubles = _names(plan, rng)
    levels = iter(_levels(len(singles) + 2 * len(doubles) + len(plan.outside), rng))
    used: collections.Counter[str] = collections.Counter()

    def one(name: str, taken: str | None = None) -> Hidden:
        joint = _joint(name, used, taken, rng)
        used[joint] += 1
        return Hidden(name, joint, float(next(levels)))

    found = [("none", simulator, ()) for simulator in _alternately(plan.none)]
    found += [("single", simulator, (one(name),)) for name, simulator in _with(singles)]
    found += [("outside", simulator, (one(name),)) for name, simulator in plan.outside]
    for (a, b), simulator in _with(doubles):
        first = one(a)
        found.append(("double", simulator, (first, one(b, first.joint))))
    order = rng.permutation(len(found))
    return tuple(Case(part, n, *found[i]) for n, i in enumerate(order))


def _names(plan: _Part, rng) -> tuple[list[str], list[tuple[str, str]]]:
    """Effects of the singles and of the doubles, whose two are of different classes."""
    names = list(MAIN)
    needed = plan.single + 2 * plan.double
    stream = [names[i] for _ in range(math.ceil(needed / len(names))) for i in rng.permutation(len(names))]
    singles, rest = stream[: plan.single], stream[plan.single : needed]
    while True:
        rest = [rest[i] for i in rng.permutation(len(rest))]
        pairs = list(zip(rest[::2], rest[1::2], strict=True))
        if all(class_of(a) != class_of(b) for a, b in pairs):
            return singles, pairs


def class_of(name: str) -> tuple[str, ...]:
    """The effects that look like this one, itself among them."""
    return next((alike for alike in CLASSES if name in alike), (name,))


def _joint(name: str, used, taken: str | None, rng) -> str:
    """One of those that were chosen least often, at random."""
    possible = [joint for joint in JOINTS[name] if joint != taken]
    least = min(used[joint] for joint in possible)
    return str(rng.choice([joint for joint in possible if used[joint] == least]))


def _levels(n: int, rng) -> np.ndarray:
    return 8.0 ** ((rng.permutation(n) + rng.uniform(size=n)) / n)


def _alternately(n: int) -> list[str]:
    return [("jaxfrf", "mujoco")[i % 2] for i in range(n)]


def _with(what: list) -> list:
    return list(zip(what, _alternately(len(what)), strict=True))


def nominal_robot(case: Case) -> Robot:
    """R3X with a payload of the case's own, which is known."""
    rng = _random(case, 0)
    robot = r3x().with_tolerances(KNOWN)
    mass = rng.uniform(4.0, 13.0)
    values = {
        "joint6.mass": mass,
        "joint6.com": rng.uniform([-0.06, 0.10, -0.06], [0.06, 0.22, 0.06]),
        "joint6.inertia": parameters(robot, ["inertia"])["joint6.inertia"] * mass / 10.0,
    }
    return with_parameters(robot, values)


def design(case: Case) -> jf.Multisine:
    """Six experiments of 8 s: three of four odd lines from 4 to 80 Hz, over slow sines of .6 to 1.9 Hz."""
    return jf.Multisine(
        FS,
        PERIOD,
        jf.random_odd_lines(32, 640, key=jr.fold_in(jr.key(case.seed), 1)),
        rms=[2.0, 2.0, 2.0, 4.0, 4.0, 6.0],
        slow=jf.SlowSine(_SLOW_LINES, _SLOW_AMPLITUDE),
        seed=case.seed,
    )


def positions(case: Case) -> np.ndarray:
    return jf.random_positions(POSITIONS, jr.fold_in(jr.key(case.seed), 2))


def disturbed(robot: Robot, rng) -> Robot:
    """The machine itself, whose numbers nobody knows better than `_SPREAD`. One factor for all of an inertia, so that a
    body stays one."""
    values = {}
    for kind, spread in _SPREAD.items():
        for name, value in parameters(robot, [kind]).items():
            shape = np.shape(value) if kind == "com" else ()
            values[name] = value * jnp.asarray(rng.uniform(1.0 - spread, 1.0 + spread, shape))
    return with_parameters(robot, values)


def background(case: Case) -> tuple[effects.AbstractEffect, ...]:
    """The small ripple of R3X with the phases of this machine."""
    ripple = r3x_ripple(case.seed)
    rows = lambda table, axis: [table[0][axis], tuple(table[1][axis].astype(int)), table[2][axis]]
    torque = (effects.TorqueRipple(axis, *rows(ripple.torque, axis)) for axis in range(6))
    resolver = (effects.ResolverRipple(axis, *rows(ripple.resolver, axis)) for axis in range(6))
    return (*torque, *resolver)


def can_be_made(case: Case) -> bool:
    """Whether the library has the effects of the case."""
    return all(hidden.name not in MAIN or hidden.name in library() for hidden in case.hidden)


def make(case: Case, folder, processes: int = 2) -> None:
    """Write data and truth of a case unless they are there. `processes`: of MuJoCo.

    A level at which the closed loop fails is lowered by steps of .7; the truth states the one that was played.
    """
    folder = pathlib.Path(folder)
    place, truth = folder / "cases" / case.name, folder / "truth" / f"{case.name}.json"
    if place.exists() and truth.exists():
        return
    place.parent.mkdir(parents=True, exist_ok=True)
    truth.parent.mkdir(parents=True, exist_ok=True)
    nominal = nominal_robot(case)
    data, described = _played(case, nominal, processes)
    draft = pathlib.Path(tempfile.mkdtemp(prefix=f".{case.name}-", dir=place.parent))
    try:
        write(draft / "data.nc", data)
        write_robot(nominal, draft / "robot.toml")
        draft.chmod(0o755)
        write_json(truth, described)
        if place.exists():
            shutil.rmtree(place)
        draft.rename(place)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _played(case: Case, nominal: Robot, processes: int):
    """The record, and what is true of it."""
    around = _around(case, nominal)
    weaker = 1.0
    for _ in range(_TRIES):
        machine = disturbed(nominal, _random(case, 1))
        added, described = [], []
        for k, hidden in enumerate(case.hidden):
            tamed = dataclasses.replace(hidden, level=hidden.level * weaker)
            effect, level = hidden_effect(nominal, tamed, around, _random(case, 2 + k))
            added.append(effect)
            described.append(_described(effect, hidden, level))
        try:
            data = _simulated(case, machine.with_effects(*added, *background(case)), processes)
        except (jf.InputError, RuntimeError) as error:
            if not case.hidden or not any(text in str(error) for text in ("leave", "equilibrium")):
                raise
        else:
            if not case.hidden or _clipped(nominal, data) < _CLIPPED:
                return data, _truth(case, described)
        weaker *= _WEAKER
    raise RuntimeError(f"case {case.name} of {case.part}: the loop fails at any level ({case.hidden})")


def _described(effect, hidden: Hidden, level: float) -> dict:
    table = effect_to_table(effect, hidden.joint)
    named = {key: table.pop(key) for key in ("name", "joint")}
    return named | {"level": level, "drawn_level": hidden.level, "parameters": table}


def _truth(case: Case, described: list[dict]) -> dict:
    return {
        "part": case.part,
        "number": case.number,
        "kind": case.kind,
        "simulator": case.simulator,
        "seed": case.seed,
        "effects": described,
    }


def _around(case: Case, nominal: Robot) -> Circumstances:
    plan, q = design(case), positions(case)
    gear = np.asarray(nominal.drives.gear_ratio)
    swing = _SLOW_AMPLITUDE / (2 * np.pi * _SLOW_LINES * FS / PERIOD * gear)

    def largest_torque():
        data = jf.simulate(nominal, plan, q, key=jr.key(case.seed), run_in=RUN_IN, noise=NOISE)
        return np.max(np.abs(data.u), axis=(0, 1, 2))

    return Circumstances(q, swing, RUN_IN, PERIOD / FS, largest_torque)


def _simulated(case: Case, machine: Robot, processes: int) -> jf.Experiment:
    plan, q = design(case), positions(case)
    if case.simulator == "mujoco":
        return mujoco_experiment(
            machine, plan, q, seed=case.seed, run_in=RUN_IN, noise=NOISE, ripple=None, processes=processes
        )
    steps = 2 * fine_steps(machine, operating_point(machine, q))
    key = jr.fold_in(jr.key(case.seed), 3)
    return jf.simulate(machine, plan, q, key=key, run_in=RUN_IN, noise=NOISE, steps=steps)


def _clipped(nominal: Robot, data: jf.Experiment) -> float:
    """Largest part of the samples of any motor at the limit of its controller."""
    limit = np.asarray(nominal.drives.torque_limit) * (1.0 - 1e-9)
    return float(np.max(np.mean(np.abs(data.u) >= limit, axis=(0, 1, 2))))


def _random(case: Case, stream: int) -> np.random.Generator:
    return np.random.default_rng([case.seed, stream])
