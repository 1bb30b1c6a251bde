"""Records played again on a robot: simulated ones come back, MuJoCo agrees, and what does not fit is said."""

import dataclasses
import logging
import tomllib
from typing import ClassVar

import jax
import jax.random as jr
import numpy as np
import pytest
from loop_reference import mujoco_loop
from marks import slow
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf.simulation import replay, simulate

KEY = jr.key(3)
SETTINGS = {"run_in": 0.6, "steps": 3}
SPACING = 0.5  # of the lines, Hz


def design(**options):
    slow = jf.SlowSine([1, 2], [20.0, 30.0])
    return jf.Multisine(500.0, 1000, np.arange(5, 45, 2), rms=[2.0, 4.0], slow=slow, **options)


def changed(data, **changes):
    """A record with some fields replaced."""
    fields = {f.name: getattr(data, f.name) for f in dataclasses.fields(data)}
    return jf.Experiment(**(fields | changes))


def at_position(data, p):
    return changed(data, **{name: getattr(data, name)[p : p + 1] for name in ("u", "y", "r", "q")})


def close(ours, theirs, rtol=1e-10):
    for x, y in ((ours.u, theirs.u), (ours.y, theirs.y)):
        np.testing.assert_allclose(x, y, rtol=0, atol=rtol * np.abs(y).max())


@pytest.fixture(scope="module")
def robot():
    return jf.robot.robot_from_table(tomllib.loads(ROBOT))


@pytest.fixture(scope="module")
def recorded(robot):
    """A record without noise at two positions."""
    return simulate(robot, design(), jf.random_positions(2, KEY, 2), key=KEY, noise=0.0, **SETTINGS)


class TestSimulatedRecords:
    def test_comes_back(self, robot, recorded):
        again = replay(robot, recorded, **SETTINGS)
        close(again, recorded)
        np.testing.assert_allclose(again.r, recorded.r, atol=1e-12)
        assert again.r.strides[0] == 0  # no copies for every position
        assert (again.period, again.transient_periods, again.fs) == (1000, 0, 500.0)
        assert (again.r_quantity, again.y_quantity) == ("velocity", "position")
        np.testing.assert_array_equal(again.lines, recorded.lines)
        np.testing.assert_array_equal(again.q, recorded.q)

    def test_another_robot(self, robot, recorded):
        """Only r and q are taken from the record: the answer is that of the robot which plays it."""
        other = jf.robot.with_parameters(robot, {"shoulder.stiffness": 1e4, "elbow.coulomb_friction": 0.3})
        expected = simulate(other, design(), recorded.q, key=KEY, noise=0.0, **SETTINGS)
        close(replay(other, recorded, **SETTINGS), expected)
        assert np.abs(expected.u - recorded.u).max() > 0.1 * np.abs(recorded.u).max()

    def test_noise(self, robot, recorded):
        """The noise of a run is that which `simulate` gives it."""
        noisy = simulate(robot, design(), recorded.q, key=jr.key(7), **SETTINGS)
        close(replay(robot, recorded, key=jr.key(7), noise=5e-5, **SETTINGS), noisy)
        assert np.abs(noisy.y - recorded.y).max() > 1e-4

    @pytest.mark.slow
    def test_references_of_every_position(self, robot, recorded):
        """Another realisation at the second position, in blocks that hold a part of the runs."""
        other = simulate(robot, design(seed=5), recorded.q[1:], key=KEY, noise=0.0, **SETTINGS)
        both = jf.concatenate([at_position(recorded, 0), other])
        again = replay(robot, both, chunk=2, **SETTINGS)
        close(again, both)
        np.testing.assert_allclose(again.r, both.r, atol=1e-12)

    def test_steady_periods(self, robot, recorded):
        """The mean of the steady periods counts, the transient one does not; a small offset is no motion."""
        rng = np.random.default_rng(0)
        disturbance = rng.normal(size=recorded.r.shape)
        r = np.concatenate([rng.normal(size=recorded.r.shape), recorded.r + disturbance, recorded.r - disturbance], 2)
        data = changed(recorded, u=0 * r, y=0 * r, r=r + 0.1, transient_periods=1)
        again = replay(robot, data, **SETTINGS)
        close(again, recorded, 1e-9)
        np.testing.assert_allclose(again.r, recorded.r, atol=1e-12)

    def test_positions_as_references(self, robot, recorded):
        """A recorded position reference, about wherever the motors are: its derivative is the speed."""
        one = at_position(recorded, 0)
        R = np.fft.rfft(one.r, axis=2)[:, :, 1:500]
        s = 2j * np.pi * SPACING * np.arange(1, 500)[:, None]
        phase = np.exp(2j * np.pi * np.outer(np.arange(1000), np.arange(1, 500)) / 1000)
        angle = 2 / 1000 * np.einsum("tf,pefc->petc", phase, R / s).real
        rest = recorded.y[:1].mean(axis=(1, 2), keepdims=True)
        again = replay(robot, changed(one, r=angle + rest, r_quantity="position"), **SETTINGS)
        close(again, one, 1e-9)
        assert again.r_quantity == "position"
        np.testing.assert_allclose(again.r, angle, atol=1e-10)


def wriggle(n=1200, fs=2000.0):
    """Speeds and angles of six motors, each from rest over its own few oscillations, by their closed form."""
    t = np.arange(n)[:, None] / fs
    rate, size = np.array([5.0, 7.0, 9.0, 11.0, 6.0, 13.0]), np.array([2.0, 1.5, 1.0, 2.0, 2.0, 1.5])
    fade, slope = 1 - np.exp(-((8 * t) ** 2)), 128 * t * np.exp(-((8 * t) ** 2))
    angle = size * fade * np.sin(2 * np.pi * rate * t)
    speed = size * (slope * np.sin(2 * np.pi * rate * t) + fade * 2 * np.pi * rate * np.cos(2 * np.pi * rate * t))
    return speed, angle


@pytest.mark.parametrize("quantity", ["velocity", slow("position")])
def test_once_against_mujoco(quantity):
    """A record that is not periodic, from rest at q, beside MuJoCo with the references in closed form."""
    robot = jf.robot.r3x()
    names = jf.robot.parameters(robot, ("coulomb_friction", "viscous_friction"))
    straight = jf.robot.parameters(robot, ("stiffness_ratio",))
    smooth = jf.robot.with_parameters(robot, dict.fromkeys(names, 0.0) | dict.fromkeys(straight, 1.0))
    speed, angle = wriggle()
    q = jf.random_positions(1, KEY)
    r = speed if quantity == "velocity" else angle + 3.0
    data = replay(smooth, jf.Experiment(0 * r, 0 * r, 2000.0, r=r, q=q, r_quantity=quantity), run_in=7.0)
    assert data.u.shape == (1, 1, 1200, 6) and data.period == 0
    point = jax.tree.map(lambda x: np.asarray(x)[0], jf.robot.operating_point(smooth, q))
    motor, torque = mujoco_loop(smooth, point, speed, angle)
    rms = lambda x: np.sqrt(np.mean(x**2, axis=0))
    assert np.all(rms(np.diff(data.y[0, 0] - motor, axis=0)) < 1e-4 * rms(np.diff(motor, axis=0)))
    assert np.all(rms(data.u[0, 0] - torque) < 1e-3 * rms(torque))


def test_values_do_not_recompile(robot, recorded, caplog):
    """Robots that differ in numbers, of effects too, share everything that is compiled."""

    def play(stiffness, friction):
        changed = jf.robot.with_parameters(robot, {"elbow.stiffness": stiffness})
        caplog.clear()
        with jax.log_compiles(), caplog.at_level(logging.WARNING):
            data = replay(
                changed.with_effects(jf.effects.StribeckFriction(1, friction, 2.0, 0.2)), recorded, **SETTINGS
            )
        return data, [record.getMessage() for record in caplog.records if "ompil" in record.getMessage()]

    first, compiled = play(8e3, 0.05)
    assert compiled
    second, compiled = play(9e3, 0.06)
    assert not compiled
    assert np.abs(second.y - first.y).max() > 1e-6


class TestTrouble:
    CASES: ClassVar = {
        "reference": (lambda d: changed(d, r=None), {}, "r: found none; expected the references"),
        "configuration": (lambda d: changed(d, q=None), {}, "q: found none; expected the arm configuration"),
        "joints": (lambda d: changed(d, q=d.q[:, :1]), {}, r"positions: found an array of shape \(2, 1\)"),
        "rate": (lambda d: changed(d, fs=1000.0), {}, "fs of the record: found 1000 Hz; expected 500 Hz"),
        "axes": (lambda d: changed(d, r=d.r[..., :1]), {}, "inputs of the record: found 1; expected 2"),
        "acceleration": (lambda d: changed(d, r_quantity="acceleration"), {}, "r_quantity: found acceleration"),
        "noise": (lambda d: d, {"noise": 1e-5}, "key: found none; expected a key for a noise of 1e-05 rad"),
        "run_in": (lambda d: d, {"run_in": np.inf}, "run_in: found inf"),
        "steps": (lambda d: d, {"steps": 2.5}, "steps: found 2.5"),
        "drift": (
            lambda d: changed(d, r=d.r + np.where(np.arange(2) == 1, -20.0, 0.0)),
            {},
            r"mean of -20 rad/s at position 0, experiment 0, channel 1: elbow drifts by 0\.\d+ rad \(arm side\)",
        ),
    }

    @pytest.mark.parametrize("case", CASES)
    def test_bad_input(self, robot, recorded, case):
        change, options, message = self.CASES[case]
        with pytest.raises(jf.InputError, match=message):
            replay(robot, change(recorded), **options)

    def test_no_controller(self, robot, recorded):
        with pytest.raises(jf.InputError, match="two axes: controller: found none"):
            replay(dataclasses.replace(robot, controller=None), recorded)

    def test_divergence_is_named(self, robot, recorded):
        """A reference that no motor can follow: the runs that play it are named, by position and experiment."""
        r = np.array(recorded.r)
        r[1, 1] *= 100.0
        with pytest.raises(jf.InputError, match=r"1 runs that leave .*: position 1, experiment 1 at 0\.\d"):
            replay(robot, changed(recorded, r=r), **SETTINGS)
