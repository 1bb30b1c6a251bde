"""The robots in which effects are hidden: what is played on them, where which effect makes sense, and what was known.

Three that are no scaled copies of one another: R3X (6 axes, 2 kHz, 8 s), `robots/small.toml` (2 axes, 1 kHz, 4 s) and
`robots/pallet.toml` (4 axes, 1 kHz, 6 s, heavy). Every machine is one of a series: springs and friction of its own
(`MADE`), a payload of its own. The robot that a diagnosis is given is off from *that* machine as `bench_calibration`
says (`OFF`), and by `GAINS` in its controller, which is known well. Its file says nothing of tolerances: the defaults
of the library hold, and all of `OFF` is within them.
"""

import dataclasses
import functools
import pathlib

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from bench_calibration import OFF

import jaxfrf as jf
from jaxfrf import effects
from jaxfrf.robot import Robot, parameters, r3x, with_parameters

_FOLDER = pathlib.Path(__file__).parent / "robots"
MADE = {
    "stiffness": 0.1,
    "damping": 0.2,
    "viscous_friction": 0.2,
    "coulomb_friction": 0.2,
}
"""By how much machines of a series differ from what their file says."""
GAINS = 0.02
LOGS = {"position": 0.0, "velocity": 0.02, "acceleration": 5.0}
"""What a log holds, and the white noise that its own sensor adds: rad, rad/s and rad/s^2, rms."""
# Of the background: none that effects start from, or are hidden at.
_TORQUE_ORDERS = (7, 11, 13, 14, 15, 17, 19, 22, 23)
_RESOLVER_ORDERS = (7, 9, 11)


@dataclasses.dataclass(frozen=True)
class Plant:
    """One robot and its experiment.

    **Fields:** `fs`, `period`: Hz, samples. `band`: first and last line. `rms`, `slow_lines`, `slow_amplitude`: of the
    multisine and the slow sines, rad/s, motor side. `low`, `high`: arm configurations, degrees; `None`: the library's
    own. `noise`: of the resolver inside the loop, rad. `joints`: where an effect is hidden; those that are not named
    are hidden on all, those without joints not at all. `hinge`: axis of an extra flexibility. `rest`: rad, about which
    a counterbalance is at rest.
    """

    name: str
    fs: float
    period: int
    blocks: int
    band: tuple[int, int]
    rms: tuple[float, ...]
    slow_lines: tuple[int, ...]
    slow_amplitude: tuple[float, ...]
    low: tuple[float, ...] | None
    high: tuple[float, ...] | None
    noise: float
    joints: dict[str, tuple[str, ...]]
    hinge: tuple[float, float, float] = (0.0, 0.0, 1.0)
    rest: dict[str, float] = dataclasses.field(default_factory=dict)
    positions: int = 6
    run_in: float = 5.0

    @functools.cached_property
    def robot(self) -> Robot:
        return r3x() if self.name == "r3x" else jf.io.read_robot(_FOLDER / f"{self.name}.toml")

    @property
    def seconds(self) -> float:
        return self.period / self.fs

    def joints_of(self, effect: str) -> tuple[str, ...]:
        """Where this effect makes sense, () where it makes none."""
        return self.joints.get(effect, self.robot.axis_names)

    def swing(self) -> np.ndarray:
        """Amplitude of the slow motion of every arm joint, rad, (axis,)."""
        rate = 2 * np.pi * np.array(self.slow_lines) * self.fs / self.period
        return np.array(self.slow_amplitude) / (rate * np.asarray(self.robot.drives.gear_ratio))

    def design(self, seed: int) -> jf.Multisine:
        """Three of four odd lines over slow sines; not the design of any study."""
        lines = jf.random_odd_lines(*self.band, key=jr.fold_in(jr.key(seed), 1))
        slow = jf.SlowSine(np.array(self.slow_lines), np.array(self.slow_amplitude))
        return jf.Multisine(self.fs, self.period, lines, rms=list(self.rms), slow=slow, seed=seed, blocks=self.blocks)

    def configurations(self, seed: int) -> np.ndarray:
        """Random arm configurations, rad, (pos, axis)."""
        if self.low is None:
            return jf.random_positions(self.positions, jr.fold_in(jr.key(seed), 2), self.robot.n_axes)
        rng = np.random.default_rng([seed, 12])
        return np.deg2rad(rng.uniform(self.low, self.high, (self.positions, len(self.low))))


R3X = Plant(
    name="r3x",
    fs=2000.0,
    period=16000,
    blocks=1,
    band=(32, 640),
    rms=(2.0, 2.0, 2.0, 4.0, 4.0, 6.0),
    slow_lines=(5, 7, 9, 11, 13, 15),
    slow_amplitude=(30.0, 30.0, 30.0, 40.0, 40.0, 40.0),
    low=None,
    high=None,
    noise=5e-5,
    joints={
        "load_dependent_friction": ("joint2", "joint3", "joint5"),  # gravity loads their gears
        "backlash": ("joint1", "joint4", "joint5", "joint6"),  # gears that gravity does not preload, or not always
        "stiffness_hardening": ("joint4", "joint5", "joint6"),  # the springs of the others harden already
        "payload": ("",),
        "counterbalance": ("joint2", "joint3"),
        "extra_flexibility": ("joint1", "joint4", "joint5"),
        "wrist_coupling": ("joint5", "joint6"),
        "torque_saturation": ("joint1", "joint4", "joint5", "joint6"),  # no gravity that has to be carried
        "dress_pack": ("joint1", "joint4", "joint6"),
    },
    rest={"joint2": 0.0, "joint3": 1.5},
)
SMALL = Plant(
    name="small",
    fs=1000.0,
    period=4000,
    blocks=3,
    band=(17, 240),
    rms=(2.0, 3.0),
    slow_lines=(3, 5),
    slow_amplitude=(30.0, 30.0),
    low=None,
    high=None,
    noise=3e-5,
    joints={
        "backlash": ("elbow",),
        "stiffness_hardening": ("shoulder",),
        "payload": ("",),
        "counterbalance": ("shoulder",),
        "extra_flexibility": (),  # across its axes nothing moves in the plane
        "wrist_coupling": (),  # there is no wrist
        "torque_saturation": ("elbow",),
        "dress_pack": ("elbow",),
    },
    rest={"shoulder": 0.0},
)
PALLET = Plant(
    name="pallet",
    fs=1000.0,
    period=6000,
    blocks=2,
    band=(24, 300),
    rms=(2.0, 2.0, 2.0, 4.0),
    slow_lines=(3, 4, 5, 7),
    slow_amplitude=(25.0, 25.0, 25.0, 30.0),
    low=(-120.0, -50.0, -35.0, -150.0),
    high=(120.0, 60.0, 55.0, 150.0),
    noise=3e-5,
    joints={
        "load_dependent_friction": ("shoulder", "elbow"),
        "backlash": ("column", "roll"),
        "stiffness_hardening": ("elbow", "roll"),
        "payload": ("",),
        "counterbalance": ("shoulder", "elbow"),
        "extra_flexibility": ("column", "roll"),
        "wrist_coupling": ("roll",),
        "torque_saturation": ("column", "roll"),
        "dress_pack": ("column", "roll"),
    },
    hinge=(0.0, 1.0, 0.0),
    rest={"shoulder": 0.0, "elbow": 0.3},
)
PLANTS = {plant.name: plant for plant in (R3X, SMALL, PALLET)}


def machine(plant: Plant, seed: int) -> Robot:
    """One of the series, with a payload of its own."""
    rng, values = np.random.default_rng([seed, 0]), {}
    for kind, spread in MADE.items():
        for name, value in parameters(plant.robot, [kind]).items():
            values[name] = float(value) * rng.uniform(1.0 - spread, 1.0 + spread)
    last = plant.robot.joint_names[-1]
    own = {name: np.asarray(x) for name, x in parameters(plant.robot, ["mass", "com", "inertia"]).items()}
    factor = rng.uniform(0.5, 1.3)
    values[f"{last}.mass"] = own[f"{last}.mass"] * factor
    values[f"{last}.com"] = own[f"{last}.com"] + rng.uniform(-0.03, 0.03, 3)
    values[f"{last}.inertia"] = own[f"{last}.inertia"] * factor
    return with_parameters(plant.robot, values)


def given(robot: Robot, seed: int, toward: dict[str, float]) -> Robot:
    """What its user would know of a machine: every number off at random, one factor for all of an inertia, so that a
    body stays one; the controller's gains a little.

    `toward`: numbers that a hidden effect changes, and the sign of that: the error drawn for them points the same
    way, so that what is hidden is never made up for by chance.
    """
    rng, values = np.random.default_rng([seed, 1]), {}
    ratio = parameters(robot, ["stiffness_ratio"])
    for kind, most in OFF.items():
        for name, value in parameters(robot, [kind]).items():
            off = rng.uniform(-most, most, np.shape(value) if kind == "com" else ())
            if kind.startswith("stiffness_") and float(ratio[f"{name.rpartition('.')[0]}.stiffness_ratio"]) == 1.0:
                continue
            off = -toward[name] * np.abs(off) if name in toward else off
            values[name] = np.asarray(value) * (1.0 + off)
    gain = lambda x: jnp.asarray(np.asarray(x) * rng.uniform(1.0 - GAINS, 1.0 + GAINS, np.shape(x)))
    robot = with_parameters(robot, values)
    known = dataclasses.replace(
        robot.controller,
        position_gain=gain(robot.controller.position_gain),
        integral_time=gain(robot.controller.integral_time),
        velocity_gain=gain(robot.controller.velocity_gain),
    )
    return dataclasses.replace(robot, controller=known)


def background(robot: Robot, seed: int) -> tuple[effects.AbstractEffect, ...]:
    """Ripple of every motor: three orders of torque, up to .4 % of its limit, and one of its resolver, an apparent
    acceleration of at most that of .5 mrad twice a turn."""
    rng, found = np.random.default_rng([seed, 4]), []
    for axis, limit in enumerate(np.asarray(robot.drives.torque_limit)):
        order = tuple(sorted(rng.choice(_TORQUE_ORDERS, 3, replace=False).tolist()))
        amplitude, phase = rng.uniform(0.1, 1.0, 3) * 4e-3 * limit, rng.uniform(-np.pi, np.pi, 4)
        found.append(effects.TorqueRipple(axis, amplitude, order, phase[:3]))
        turn = int(rng.choice(_RESOLVER_ORDERS))
        found.append(effects.ResolverRipple(axis, [rng.uniform(0.2, 1.0) * 2e-3 / turn**2], (turn,), phase[3:]))
    return tuple(found)


def logged(data: jf.Experiment, quantity: str, seed: int) -> jf.Experiment:
    """The record as a logger of this quantity has it: the resolver's position, or what a drive derives from it, its
    errors and noise included, and the noise of the log."""
    if quantity == "position":
        return data
    y = np.asarray(data.y)
    s = 2j * np.pi * np.fft.rfftfreq(y.shape[2], 1 / data.fs)[:, None]
    order = tuple(LOGS).index(quantity)
    y = np.fft.irfft(np.fft.rfft(y - y[:, :, :1], axis=2) * s**order, n=y.shape[2], axis=2)
    y = y + LOGS[quantity] * np.random.default_rng([seed, 5]).standard_normal(y.shape)
    return dataclasses.replace(data, y=y, y_quantity=quantity)
