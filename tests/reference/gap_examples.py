"""Diagnoses with made-up numbers, one for every verdict: what the report, the file and the command are tried with."""

import dataclasses
import functools

import numpy as np

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.experiment import Source
from jaxfrf.frf import FRF
from jaxfrf.gap.result import Cell, Diagnosis, EstimatedValue, Gap, Maps, Named, Ranked

BANDS = np.array([0.5, 4.0, 8.0, 14.0, 20.0, 30.0, 45.0, 80.0])
AXES = tuple(f"joint{k}" for k in range(1, 7))
FREQUENCY = np.geomspace(4.0, 80.0, 140)
SPEED, ANGLE, LOAD = np.array([60, 60, 60, 40, 40, 30.0]), np.full(6, 0.35), np.array([4, 9, 5, 1.2, 0.8, 0.3])


@functools.cache
def robot():
    return jf.robot.r3x()


def example(name: str) -> Diagnosis:
    """`coulomb`, `two`, `ambiguous`, `unexplained`, `sufficient`, `inconclusive`."""
    return _EXAMPLES[name]()


NAMES = ("coulomb", "two", "ambiguous", "unexplained", "sufficient", "inconclusive")


def _maps(hot: dict[int, np.ndarray], left: dict[int, np.ndarray], steps, positions: int = 7) -> Maps:
    """`hot`, `left`: (band,) rms over the floor that an axis has more, before and after; nothing was changed
    where they are the same. `steps`: {signal: {axis: course before}}; after, noise is left."""
    rng = np.random.default_rng(0)
    shape = (positions, 6, len(BANDS) - 1)
    quiet = 1.0 + 0.12 * rng.standard_normal((2, *shape))
    by_position = rng.uniform(0.6, 1.25, (positions, 1))
    maps = []
    for noise, added in zip(quiet, (hot, left), strict=True):
        maps.append(noise)
        for axis, z in added.items():
            maps[-1][:, axis] = np.hypot(maps[-1][:, axis], z * by_position)
    if hot == left:
        maps[1] = maps[0]
    courses = {}
    for signal, span in (("speed", SPEED), ("angle", ANGLE), ("load", LOAD)):
        x = np.linspace(-1, 1, 25) * span[:, None]
        noise = 0.006 * SPEED[:, None] / 60 * rng.standard_normal((2, 6, 25))
        before, after = noise
        for axis, law in steps.get(signal, {}).items():
            before[axis] += law(x[axis])
        courses[signal] = (x, before, before if hot == left else after)
    return Maps(*maps, BANDS, courses)


def _response(shift: float = 0.0, delay: float = 0.0, gain: float = 1.0) -> np.ndarray:
    """Two held-out positions of six axes with an antiresonance and a resonance each, (2, freq, 6, 6)."""
    s = 2j * np.pi * FREQUENCY
    G = np.zeros((2, len(FREQUENCY), 6, 6), complex)
    for p in range(2):
        for i in range(6):
            low, high = 2 * np.pi * (7 + 2.5 * i + p) * (1 + shift), 2 * np.pi * (13 + 4 * i + p) * (1 + shift)
            own = (s**2 + 0.06 * low * s + low**2) / (s**2 + 0.06 * high * s + high**2) * (high / low) ** 2 / s
            G[p, :, i, i] = gain * 40 * (i + 1) * own * np.exp(-delay * s * (i == 1))
    return G


def frf(G: np.ndarray, std: float = 0.0) -> FRF:
    cov = np.zeros((*G.shape[:2], 36, 36), complex)
    size = np.abs(G.swapaxes(-1, -2).reshape(*G.shape[:2], 36)) ** 2
    cov[..., range(36), range(36)] = std**2 * size if std else np.nan
    n = G.shape[:2]
    return FRF(G, FREQUENCY, cov, np.full(n, 30.0), np.zeros(n, int), np.ones(n), method="lrm-jio-stacked(width=36)")


def _frfs(shift=0.0, delay=0.0, gain=1.0, after=None):
    rng = np.random.default_rng(1)
    truth = _response()
    noise = 1 + 0.01 * (rng.standard_normal(truth.shape) + 1j * rng.standard_normal(truth.shape))
    before = frf(_response(shift, delay, gain))
    return frf(truth * noise, 0.012), before, before if after == "same" else frf(_response(0.001))


def _parameters(shift: dict[str, float]) -> tuple[dict[str, EstimatedValue], dict[str, float]]:
    given = jf.robot.parameters(robot(), ("stiffness", "damping"))
    rng = np.random.default_rng(2)
    changed = {n: shift.get(n, 0.012 * float(rng.standard_normal())) for n in given}
    units = {"stiffness": "N m/rad", "damping": "N m s/rad"}
    values = {n: float(x) * (1 + changed[n]) for n, x in given.items()}
    found = {n: EstimatedValue(v, 0.004 * v, units[n.split(".")[1]]) for n, v in values.items()}
    return found, changed


_SAID = {
    "compared": (
        "The robot was simulated in closed loop with the record's own references; measured and simulated torque were "
        "compared line by line, referred to the motor."
    ),
    "fitted": (0, 1, 2, 3, 4),
    "heldout": (5, 6),
    "sources": (Source("cell4_run1.nc", "3f" * 32), Source("cell4_run2.nc", "a9" * 32)),
    "settings": {"lines": "0.5 to 80 Hz", "bootstrap": 200, "family-wise level": 0.05, "seed": 0},
}


def _diagnosis(verdict, says, *, effects=(), gap, maps, ranking, where, frf=None, next_experiment, shift=(), **more):
    found, changed = _parameters(dict(shift))
    for named in effects:
        for name, x in named.parameters.items():
            found[f"{named.joint or 'arm'}.{named.name}.{name}"] = x
    base = jf.robot.with_parameters(robot(), {n: float(found[n].value) for n in changed})
    extended = base.with_effects(*(x.effect for x in effects))
    return Diagnosis(
        verdict=verdict,
        says=says,
        effects=tuple(effects),
        ranking=tuple(ranking),
        where=tuple(where),
        gap=gap,
        maps=maps,
        parameters=found,
        changed=changed,
        given=robot(),
        base=base,
        extended=extended,
        frf=frf,
        next_experiment=next_experiment,
        **(_SAID | more),
    )


def _gap(before, after, floor, axes_before, axes_after, on="held-out positions 5 and 6") -> Gap:
    shrink = 1 - (after - floor) / (before - floor)
    unit = "over its floor"
    return Gap(before, after, floor, shrink, unit, on, np.array(axes_before), np.array(axes_after))


def _coulomb() -> Diagnosis:
    level = {"level": EstimatedValue(0.2087, 0.0061, "N m")}
    named = Named(
        fx.CoulombFriction("joint3", 0.2087),
        "joint3",
        level,
        1e-9,
        (),
        "",
        explains=0.94,
        visible=1.5,
    )
    ranking = [
        Ranked("coulomb_friction", "joint3", 0.881, 1e-9, {"level": 0.214}, 1.53, "taken: explains most, first"),
        Ranked(
            "viscous_friction",
            "joint3",
            0.672,
            1e-9,
            {"coefficient": 0.0081},
            10.8,
            "nothing left to explain once coulomb_friction of joint3 is in (p = .61)",
        ),
        Ranked(
            "stribeck_friction",
            "joint3",
            0.218,
            2e-6,
            {"level": 0.39, "width": 4.0},
            1.9,
            "fits worse by 46 % on the positions of selection",
        ),
        Ranked("torque_constant", "joint3", 0.043, 0.031, {"error": 0.012}, 0.6, "below what is visible"),
        Ranked("gear_hysteresis", "joint3", 0.036, 0.17, {"torque": 3.1}, 0.4, "not significant"),
    ]
    where = [
        Cell(
            None, "torque of joint3", (0.5, 4.0), 8.6, "Torque of joint3 steps with the sign of its speed, everywhere."
        ),
        Cell(4, "torque of joint3", (4.0, 8.0), 4.1, "Torque of joint3, 4 to 8 Hz at position 4."),
    ]
    curve = np.array([9.0, 4.2, 3.1, 2.2, 1.4, 0.8, 0.3])
    maps = _maps({2: curve}, {}, {"speed": {2: lambda v: 0.21 * np.tanh(v / 1.5)}})
    return _diagnosis(
        "named",
        "Coulomb friction of joint3 is larger than the model's by 0.21 N m. On the held-out positions that closes 97 % "
        "of the gap that a model can close.",
        effects=[named],
        gap=_gap(4.82, 1.11, 1.0, [0.021, 0.024, 0.164, 0.031, 0.028, 0.044], [0.02, 0.022, 0.025, 0.03, 0.028, 0.043]),
        maps=maps,
        ranking=ranking,
        where=where,
        frf=_frfs(gain=0.97),
        next_experiment=(
            "Nothing is needed to name the effect. To tell the level from its smoothing, run joint3 below 1 rad/s."
        ),
    )


def _two() -> Diagnosis:
    effects = [
        Named(
            fx.Payload(1.42),
            "",
            {"mass": EstimatedValue(1.42, 0.05, "kg")},
            1e-9,
            (),
            "",
            explains=0.71,
            visible=5.6,
        ),
        Named(
            fx.TorqueDelay("joint2", 3.6e-4),
            "joint2",
            {"delay": EstimatedValue(3.6e-4, 2.1e-5, "s")},
            4e-5,
            ("current_loop_lag",),
            "A step of torque, or lines above 300 Hz.",
            explains=0.17,
            visible=1.2,
        ),
    ]
    ranking = [
        Ranked("payload", "", 0.822, 1e-9, {"mass": 1.39}, 5.6, "taken first"),
        Ranked("torque_delay", "joint2", 0.21, 4e-5, {"delay": 3.4e-4}, 1.1, "taken second"),
        Ranked("current_loop_lag", "joint2", 0.209, 4e-5, {"time_constant": 3.4e-4}, 1.1, "same as torque_delay here"),
        Ranked("torque_constant", "joint3", 0.18, 1e-4, {"error": 0.041}, 2.0, "nothing left beside the payload"),
    ]
    where = [
        Cell(None, "torque of joint3", (0.5, 4.0), 5.3, "Static torque of joints 2, 3 and 5 grows with their load."),
        Cell(2, "torque of joint2", (20.0, 45.0), 3.4, "Phase of joint2 falls with frequency: its torque comes late."),
    ]
    low = np.array([5.5, 2.6, 1.4, 0.7, 0.4, 0.2, 0.1])
    hot = {1: low + np.array([0, 0.2, 0.5, 1.1, 2.2, 2.9, 2.4]), 2: low, 4: 0.6 * low}
    load = {k: lambda x, k=k: 0.07 * x * (1 if k != 4 else 0.5) for k in (1, 2, 4)}
    after = [0.022, 0.025, 0.024, 0.031, 0.03, 0.043]
    return _diagnosis(
        "named",
        "The arm carries 1.4 kg more than the model, and the torque of joint2 comes 0.36 ms late.",
        effects=effects,
        gap=_gap(3.9, 1.06, 1.0, [0.024, 0.092, 0.121, 0.036, 0.074, 0.05], after),
        maps=_maps(hot, {}, {"load": load, "angle": {1: lambda q: 0.25 * q, 2: lambda q: 0.3 * q}}),
        ranking=ranking,
        where=where,
        frf=_frfs(shift=0.015, delay=4e-4),
        next_experiment="Weigh the tool; a step of torque on joint2 would tell a delay from a lag.",
        shift={"joint3.damping": -0.31},
    )


def _ambiguous() -> Diagnosis:
    named = Named(
        fx.TorqueDelay("joint2", 3.6e-4),
        "joint2",
        {"delay": EstimatedValue(3.6e-4, 2.1e-5, "s")},
        3e-8,
        ("current_loop_lag",),
        "Excite joint2 above 300 Hz, or command a step of torque.",
        explains=0.88,
        visible=1.2,
    )
    ranking = [
        Ranked("torque_delay", "joint2", 0.551, 3e-8, {"delay": 3.6e-4}, 1.2, "best, but not by a standard error"),
        Ranked("current_loop_lag", "joint2", 0.549, 3e-8, {"time_constant": 3.7e-4}, 1.2, "within one standard error"),
        Ranked("motor_inertia", "joint2", 0.041, 0.2, {"increase": 1.1e-5}, 0.4, "not significant"),
    ]
    where = [Cell(None, "torque of joint2", (20.0, 80.0), 5.2, "Error of joint2's torque grows with frequency.")]
    hot = {1: np.array([0.2, 0.4, 0.9, 1.8, 3.2, 5.1, 6.2])}
    return _diagnosis(
        "ambiguous",
        "The torque of joint2 comes late by 0.36 ms. A delay and a lag of the current loop explain the data equally "
        "well.",
        effects=[named],
        gap=_gap(3.1, 1.14, 1.0, [0.02, 0.07, 0.03, 0.03, 0.03, 0.05], [0.02, 0.03, 0.03, 0.03, 0.03, 0.05]),
        maps=_maps(hot, {}, {"speed": {1: lambda v: 0.03 * np.cos(v / 20)}}),
        ranking=ranking,
        where=where,
        frf=_frfs(delay=1.2e-3),
        next_experiment="Excite joint2 above 300 Hz, or command a step of torque.",
    )


def _unexplained() -> Diagnosis:
    ranking = [
        Ranked("backlash", "joint4", 0.18, 1e-6, {"gap": 2.1e-4}, 2.0, "explains 18 % where 70 % could be explained"),
        Ranked("gear_hysteresis", "joint4", 0.12, 1e-4, {"torque": 4.1}, 1.4, "explains less than half"),
        Ranked("torque_constant", "joint4", 0.05, 0.02, {"error": -0.09}, 4.5, "at its bound"),
    ]
    where = [
        Cell(
            None,
            "torque of joint4",
            (8.0, 20.0),
            11.2,
            "Torque of joint4 is off from 8 to 20 Hz wherever its angle is above 0.1 rad, and nowhere else.",
        ),
        Cell(6, "torque of joint4", (8.0, 14.0), 13.9, "The largest error of all: position 6."),
        Cell(3, "torque of joint5", (14.0, 20.0), 2.8, "Joint5 feels some of it."),
    ]
    hot = {3: np.array([2.0, 5.0, 11.0, 9.0, 4.0, 1.5, 0.6]), 4: np.array([0.2, 0.6, 1.9, 2.4, 0.9, 0.3, 0.1])}
    bump = {"angle": {3: lambda q: 0.05 * np.maximum(q - 0.1, 0) ** 2 * 60}}
    return _diagnosis(
        "unexplained",
        "Torque of joint4 differs from the model's far above the floor, but no known effect, alone or with another, "
        "explains half of what is systematic. Nothing was added to the model.",
        gap=_gap(3.6, 3.6, 1.0, [0.02, 0.03, 0.03, 0.21, 0.08, 0.05], [0.02, 0.03, 0.03, 0.21, 0.08, 0.05]),
        maps=_maps(hot, hot, bump),
        ranking=ranking,
        where=where,
        frf=_frfs(shift=0.03, after="same"),
        next_experiment="Move joint4 slowly through its range without the other joints: the error begins at 0.1 rad.",
    )


def _sufficient() -> Diagnosis:
    each = [0.02, 0.023, 0.025, 0.03, 0.028, 0.044]
    ranking = [Ranked("current_loop_lag", "joint5", 0.012, 0.61, {"time_constant": 3e-5}, 0.1, "not significant")]
    return _diagnosis(
        "sufficient",
        "After its stiffnesses and dampings were refitted the model explains the data: no test rejects it, and what a "
        "missing effect could still add is below 0.3 dB and 2 degrees.",
        gap=_gap(1.04, 1.04, 1.0, each, each),
        maps=_maps({}, {}, {}),
        ranking=ranking,
        where=[],
        frf=_frfs(shift=0.001, after="same"),
        next_experiment="None. To look closer, record another amplitude.",
        shift={"joint2.stiffness": 0.027, "joint5.damping": -0.22},
    )


def _inconclusive() -> Diagnosis:
    """From a single position: nothing is held out, there is no FRF, and some numbers are not known."""
    each = [0.05, 0.06, np.nan, 0.09, 0.08, 0.1]
    ranking = [
        Ranked("viscous_friction", "joint1", 0.06, 0.21, {"coefficient": 4e-4}, 1.0, "not significant"),
    ]
    d = _diagnosis(
        "inconclusive",
        "No effect is significant, but these data could not have shown one: a Coulomb friction 4 times the just "
        "visible one would have stayed below the floor.",
        gap=_gap(1.3, 1.3, 1.2, each, each, on="the positions of the fit (none was held out)"),
        maps=_maps({}, {}, {}, positions=1),
        ranking=ranking,
        where=[],
        next_experiment="Record four more positions, six experiments each, with the slow motion twice as fast.",
        fitted=(0,),
        heldout=(),
    )
    unknown = dataclasses.replace(d.parameters["bearing2.damping"], std=float("nan"))
    return dataclasses.replace(d, parameters=d.parameters | {"bearing2.damping": unknown})


_EXAMPLES = {
    "coulomb": _coulomb,
    "two": _two,
    "ambiguous": _ambiguous,
    "unexplained": _unexplained,
    "sufficient": _sufficient,
    "inconclusive": _inconclusive,
}


OWN = '''
import equinox as eqx
import jax.numpy as jnp
from typing import ClassVar
from jaxfrf.effects import AbstractFriction, CoulombFriction


class Quadratic(AbstractFriction):
    """Friction that grows with the square of the speed, tau = level v |v|."""

    name: ClassVar = "quadratic_friction"
    units: ClassVar = {"level": "N m s^2"}
    bounds: ClassVar = {"level": (0.0, 1.0)}
    signature: ClassVar = "a torque residual that grows with the square of the speed"
    confusable: ClassVar = {}

    joint: int | str = eqx.field(static=True)
    level: float

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint, 1e-5)

    def torque(self, speed, load):
        return self.level * speed * jnp.abs(speed)
'''
"""A file with an effect of one's own."""
