"""One new file and one line: an estimator, an effect, a diagnosis channel and a record format, up to the command line.

A copy of the package gets the files that a person would write and a line for each, and is imported in the place of the
package.
"""

import importlib
import pathlib
import shutil
import sys

import numpy as np
import pytest
from two_axes import ROBOT

import jaxfrf

ESTIMATOR = '''
"""H1 with a ridge."""

import jax.numpy as jnp

from .method import AbstractMethod, Estimate


class RidgeH1(AbstractMethod):
    """G = Y U^H (U U^H + ridge I)^-1, biased low by the ridge."""

    ridge: float = 1e-12

    def check(self, spectra):
        pass

    def block_size(self, spectra):
        return spectra.n_in

    def residual_dof(self, signals):
        return float(signals.n_exp - signals.n_in)

    def at_point(self, signals, lines=None):
        U, Y = (jnp.moveaxis(x, 0, -1) for x in (signals.U, signals.Y))
        G = Y @ jnp.conj(U.mT) @ jnp.linalg.inv(U @ jnp.conj(U.mT) + self.ridge * jnp.eye(signals.n_in))
        n, vec = len(G), G.shape[1] * G.shape[2]
        cov = jnp.full((n, vec, vec), jnp.nan + 0j)
        none, all_lines = jnp.zeros(n, int), jnp.ones(n)
        return Estimate(G, cov, self.residual_dof(signals) * all_lines, none, all_lines, none > 0)
'''

EFFECT = '''
"""Drag against a motor."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from .effect import Joint
from .insertion import AbstractFriction


class Drag(AbstractFriction):
    """Drag that grows with the square of the speed, tau = coefficient v |v|.

    **Arguments:** `joint`: a driven joint, name or number. `coefficient`: N m s^2/rad^2, motor side; 2e-5 is visible.

    In data: a torque residual against the motion that is a parabola of the speed. Confusable with viscous friction,
    until the slow motion has another amplitude.

    **Source:** the drag of a body in a turbulent flow, e.g. White, Fluid Mechanics, 2011.
    """

    name: ClassVar = "drag"
    units: ClassVar = {"coefficient": "N m s^2/rad^2"}
    bounds: ClassVar = {"coefficient": (0.0, 1e-2)}
    signature: ClassVar = "a torque residual that grows with the square of the speed"
    confusable: ClassVar = {"viscous_friction": "another amplitude of the slow motion"}

    joint: Joint = eqx.field(static=True)
    coefficient: float

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint, 2e-5)

    def torque(self, speed, load):
        return self.coefficient * speed * jnp.abs(speed)
'''

FORMAT = '''
"""Records of a logger that writes `name;unit` lines above columns of numbers."""

import numpy as np

from ._container import Variables

KIND = "a log of numbers"


def load(path):
    text = path.read_text(encoding="utf-8").splitlines()
    names = [line[1:].split(";") for line in text if line.startswith("#")]
    columns = np.loadtxt([line for line in text if not line.startswith("#")], ndmin=2)
    units = {name: unit for name, unit in names if unit}
    return Variables({name: columns[:, i] for i, (name, _) in enumerate(names)}, units)
'''


CHANNEL = '''
"""What motors hold at rest, position by position."""

import equinox as eqx
import numpy as np

from ...effects import Reach
from ...experiment import Experiment
from ...robot import Robot
from ...trajectory.needed_torque import needed_torque
from ...trajectory.rigid_motion import MeasuredMotion
from .channel import AbstractChannel, makes_sense


class HoldingChannel(AbstractChannel):
    """Mean torques over their rms, (position, axis); positions are held out in turn."""

    compared = "torque that holds the arm"
    quantity = "holding torque residual"
    unit = "of the torque"
    tolerance = 0.02

    robot: Robot
    motion: MeasuredMotion
    scatter: np.ndarray
    size: float
    measured: np.ndarray
    group: np.ndarray
    fold: np.ndarray

    @classmethod
    def takes(cls, robot, data):
        return robot is not None and all(isinstance(x, Experiment) and not np.any(x.y) for x in data)

    @classmethod
    def opened(cls, robot, data):
        u = np.concatenate([np.asarray(x.u)[:, 0] for x in data])
        angle = np.concatenate([np.asarray(x.q) for x in data]) * np.asarray(robot.drives.gear_ratio)
        mean, n = u.mean(axis=1), robot.n_axes
        size, scatter = np.sqrt(np.mean(mean**2)), u.std(axis=1) / np.sqrt(u.shape[1])
        motion = MeasuredMotion(angle, 0 * angle, 0 * angle, torque=mean, fs=data[0].fs, cutoff=1.0)
        group, place = np.tile(np.arange(n), len(u)), np.repeat(np.arange(len(u)), n)
        return cls(robot, motion, scatter, size, (mean / size).ravel(), group, place % 5)

    def of(self, data):
        return HoldingChannel.opened(self.robot, data)

    def own(self):
        return {}

    def tried(self, kind, joint):
        return kind.along_motion(self.robot, joint, Reach(1.0, 1.0, float(self.size)))

    def predicted(self, state):
        return (needed_torque(state.robot(), self.motion) / self.size).ravel()

    def floor(self, residual):
        return (self.scatter / self.size).ravel()

    def blocks(self, residual):
        return np.repeat(np.arange(len(self.scatter)), self.robot.n_axes)

    def sensible(self, candidate, values):
        return makes_sense(self.robot, candidate, values, np.inf)

    def spectra(self, rows):
        power = np.mean(rows.reshape(-1, self.robot.n_axes) ** 2, axis=0)
        return [(np.array([0.0, 1.0]), np.stack([power, 0 * power]))]
'''


NEW = {
    "frf/ridge.py": ESTIMATOR,
    "effects/drag.py": EFFECT,
    "io/_log.py": FORMAT,
    "gap/channels/holding.py": CHANNEL,
}
LINES = {
    "frf/catalogue.py": ('    "ridge": ("H1 with a ridge", _in("ridge").RidgeH1()),', '    "arithmetic": ('),
    "effects/__init__.py": ("from .drag import Drag as Drag", "from .effect import ("),
    "io/_formats.py": ('    ".log": "_log",', '    ".csv": '),
    "gap/channels/__init__.py": ('    _in("holding").HoldingChannel,', '    _in("torque")'),
}
"""The line in each file, and what the one below it begins with."""


def ours(name):
    """The package, and a reference that is made with it."""
    return name.partition(".")[0] in ("jaxfrf", "small_arm")


@pytest.fixture(scope="module")
def jf(tmp_path_factory):
    """The package with the new files and lines."""
    root = tmp_path_factory.mktemp("extended")
    shutil.copytree(pathlib.Path(jaxfrf.__file__).parent, root / "jaxfrf", ignore=shutil.ignore_patterns("*.pyc"))
    for name, text in NEW.items():
        (root / "jaxfrf" / name).write_text(text)
    for name, (line, below) in LINES.items():
        path = root / "jaxfrf" / name
        text = path.read_text()
        assert text.count(f"\n{below}") == 1
        path.write_text(text.replace(f"\n{below}", f"\n{line}\n{below}"))
    before = {name: sys.modules.pop(name) for name in list(sys.modules) if ours(name)}
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(root)
        package = importlib.import_module("jaxfrf")
        assert pathlib.Path(package.__file__).is_relative_to(root)
        yield package
    for name in [name for name in sys.modules if ours(name)]:
        del sys.modules[name]
    sys.modules.update(before)


@pytest.fixture
def main(jf):
    return importlib.import_module("jaxfrf.__main__").main


def test_an_estimator(jf, main, tmp_path, capsys):
    """Its name, its option and its place in means are known to the command line."""
    from jaxfrf.frf.catalogue import method

    run, frf = str(tmp_path / "run.npz"), str(tmp_path / "frf.npz")
    data = jf.example(blocks=2)
    jf.io.write(run, data)
    assert main(["estimate", run, "-o", frf, "--method", "ridge", "--option", "ridge=1e-9"]) == 0
    assert "RidgeH1(ridge=1e-09)" in capsys.readouterr().out
    np.testing.assert_allclose(jf.io.read_frf(frf).G, jf.estimate(data, jf.H1()).G, rtol=1e-3)
    assert main(["estimate", run, "-o", frf, "--method", "ridge", "--option", "ridgee=1"]) == 2
    assert "some of ridge" in capsys.readouterr().err
    mean = jf.estimate(data, jf.ArithmeticMean(method("ridge")))
    np.testing.assert_allclose(mean.G, jf.estimate(data, jf.ArithmeticMean()).G, rtol=1e-3)


def test_an_effect(jf, tmp_path):
    """It is in the library, in files of robots, and a candidate of both comparisons on every joint that can have it."""
    from jaxfrf.gap.simulated.candidates import candidates

    drag = jf.effects.Drag
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT + '[[effect]]\nname = "drag"\njoint = "elbow"\ncoefficient = 1e-4\n')
    robot = jf.io.read_robot(path)
    assert jf.effects.library()["drag"] is drag and isinstance(robot.effects[0], drag)
    found = [c for c in candidates(robot, np.ones(2)) if c.name == drag.name]
    assert [c.joint for c in found] == ["shoulder", "elbow"]
    for c in found:
        assert (c.low, *c.high) == ((0.0,), pytest.approx(500.0))
        assert c.make(np.array([3.0])).coefficient == pytest.approx(6e-5)
    along = [drag.along_motion(robot, joint, jf.effects.Reach(1.0, 1.0, 1.0)) for joint in robot.axis_names]
    assert [c.joint for found in along for c in found] == ["shoulder", "elbow"]


@pytest.mark.slow
def test_an_effect_that_is_hidden(jf):
    """The diagnosis tries it, names it and tells its size, on a machine whose own numbers are off."""
    from small_arm import record, small_robot

    off = {"stiffness": 1.02, "damping": 0.95, "mass": 1.006, "viscous_friction": 1.02}
    built = {n: f * x for kind, f in off.items() for n, x in jf.robot.parameters(small_robot(), [kind]).items()}
    machine = jf.robot.with_parameters(small_robot(), built).with_effects(jf.effects.Drag("elbow", 1e-4))
    found = jf.gap.diagnose(small_robot(), record(machine))
    assert found.verdict == "named", found.says
    assert (found.effects[0].name, found.effects[0].joint) == ("drag", "elbow")
    assert found.effects[0].parameters["coefficient"].value == pytest.approx(1e-4, rel=0.1)


def test_a_record_format(jf, main, tmp_path, capsys):
    """Names, units, other files beside it and messages come with it, and the FRF is that of the numbers in it."""
    rng = np.random.default_rng(0)
    u = np.tile(rng.standard_normal(200), 5)
    y = 3.0 * np.roll(u, 1) + 2.0 * np.roll(u, 2)  # mNm and deg/s
    table = np.column_stack([u, y, np.arange(1000.0)])
    rows = "\n".join(" ".join(map(repr, row.tolist())) for row in table)
    path, frf = tmp_path / "motor.log", tmp_path / "frf.npz"
    path.write_text("#torque;mNm\n#speed;deg/s\n#odd;\n" + rows)
    data = jf.io.read(path, names={"u": "torque", "y": "speed"}, values={"fs": 500})
    np.testing.assert_allclose(np.asarray(data.u)[0, 0, :, 0], 1e-3 * u, rtol=1e-12)
    np.testing.assert_allclose(np.asarray(data.y)[0, 0, :, 0], np.radians(y), rtol=1e-12)
    assert data.y_quantity == "velocity" and data.sources[0].name == "motor.log"
    arguments = ["estimate", str(path), "-o", str(frf), "--method", "h1", "--set", "fs=500,period=200"]
    assert main([*arguments, "--map", "u=torque,y=speed"]) == 0
    found = jf.io.read_frf(frf)
    z = np.exp(-2j * np.pi * found.frequency / 500.0)
    expected = np.pi / 180.0 / 1e-3 * (3.0 * z + 2.0 * z**2)
    np.testing.assert_allclose(found.G[0, :, 0, 0], expected, rtol=1e-9)
    assert main([*arguments, "--map", "u=torqe,y=speed"]) == 2
    assert "The file has torque (1000,), speed (1000,)" in capsys.readouterr().err


def test_a_channel(jf, main, tmp_path, capsys):
    """The diagnosis compares what only it sees, searches and reports it as all others, by the command, too."""
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT)
    robot, rng = jf.io.read_robot(path), np.random.default_rng(0)
    q = rng.uniform([-1.0, -2.0], [1.0, 2.0], (20, 2))
    # Gravity of two links and a mass at the second one's centre, by hand.
    first, second = np.cos(q[:, 0]), np.cos(q.sum(axis=1))
    arm = np.stack(
        [-9.81 * (8 * 0.25 * first + 4.8 * (0.5 * first + 0.2 * second)), -9.81 * 4.8 * 0.2 * second], axis=1
    )
    u = (arm / [100.0, 80.0])[:, None, None] + 1e-4 * rng.standard_normal((20, 1, 100, 2))
    record = jf.Experiment(u, np.zeros_like(u), 100.0, q=q)
    found = jf.gap.diagnose(robot, record)
    assert found.verdict == "named" and [x.name for x in found.effects] == ["payload"], found.says
    assert found.effects[0].parameters["mass"].value == pytest.approx(0.8, rel=0.01)
    assert found.compared == "torque that holds the arm" and "holding torque residual" in found.says
    run, gap = str(tmp_path / "run.npz"), str(tmp_path / "gap.json")
    jf.io.write(run, record)
    assert main(["diagnose", run, "--robot", str(path), "-o", gap, "--anyway"]) == 0
    assert jf.io.read_gap(gap)["effects"][0]["name"] == "payload" and "holding torque" in capsys.readouterr().out
