"""Simulated experiments: against MuJoCo under the same controller, against the linearised robot, and their manners."""

import dataclasses
import json
import re
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from loop_reference import NumPyController, mujoco_loop

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.simulation.controller import Cascade
from jaxfrf.simulation.plant import inverse_columns

RMS = np.array([2.0, 2.0, 2.0, 4.0, 4.0, 6.0])
KEY = jr.key(3)


def changed(robot, value, *kinds):
    return jf.robot.with_parameters(robot, {name: value for name in jf.robot.parameters(robot, kinds)})


@pytest.fixture(scope="module")
def smooth():
    """R3X with linear springs and without Coulomb friction or friction of any kind: what MuJoCo can do as well."""
    robot = changed(jf.robot.r3x(), 0.0, "coulomb_friction", "viscous_friction")
    return changed(robot, 1.0, "stiffness_ratio")


def design(period=2000, scale=1.0, slow=True, **options):
    lines = np.arange(9, 9 + 2 * (period // 100), 2)
    slow = jf.SlowSine([1, 2, 3, 1, 2, 3], [20.0, 20.0, 20.0, 30.0, 30.0, 30.0]) if slow else None
    return jf.Multisine(2000.0, period, lines, rms=scale * RMS, slow=slow, **options)


class TestAgainstMuJoCo:
    @pytest.mark.parametrize(
        "rigid",
        [pytest.param(False, id="flexible"), pytest.param(True, id="two rigid gears", marks=pytest.mark.slow)],
    )
    def test_trajectories(self, smooth, rigid):
        """One second at full speed of all axes after a second of fade-in: motor speeds within 1e-4."""
        robot = smooth
        if rigid:
            table = jf.robot.table_from_robot(smooth)
            for joint in (0, 5):
                table["joint"][joint]["stiffness"] = np.inf
            table["controller"] |= {"feedforward": False, "integral_time": np.inf, "position_gain": 25.0}
            robot = jf.robot.robot_from_table(table)
        plan = design(transient_periods=1, ramp=1.0)
        plan = slower(plan, 0.5) if rigid else plan
        q = jf.random_positions(1, KEY)
        data = jf.simulate(robot, plan, q, key=KEY, run_in=None, noise=0.0)
        played = jf.reference(plan)
        point = jax.tree.map(lambda x: np.asarray(x)[0], jf.robot.operating_point(robot, q))
        for e in (0, 4):
            angle, torque = mujoco_loop(robot, point, played.r[e], played.position[e])
            speed, ours = np.diff(angle, axis=0) * 2000, np.diff(data.y[0, e], axis=0) * 2000
            error = np.sqrt(np.mean((ours - speed)[2000:] ** 2, axis=0) / np.mean(speed[2000:] ** 2, axis=0))
            assert error.max() < 1e-4
            assert np.sqrt(np.mean((data.u[0, e] - torque) ** 2)) < 1e-3 * np.sqrt(np.mean(torque**2))


def slower(plan, factor):
    """The same design with a smaller slow sine."""
    slow = jf.SlowSine(plan.slow.lines, factor * plan.slow.amplitude)
    return jf.Multisine(
        plan.fs,
        plan.period,
        plan.lines,
        rms=factor * plan.rms,
        slow=slow,
        transient_periods=plan.transient_periods,
        ramp=plan.ramp,
    )


@pytest.mark.slow
def test_step_halving():
    """With friction and hardening springs: half the fine step, an error that falls with its fourth power."""
    q = jf.random_positions(1, KEY)
    runs = {
        n: np.diff(jf.simulate(jf.robot.r3x(), design(1000), q, key=KEY, noise=0.0, run_in=0.5, steps=n).y, axis=2)
        for n in (4, 8, 16)
    }
    rms = lambda x: np.sqrt(np.mean(x**2, axis=(0, 1, 2)))
    coarse, fine = rms(runs[4] - runs[16]), rms(runs[8] - runs[16])
    assert np.all(coarse < 1e-4 * rms(runs[16]))
    assert np.all(fine < coarse / 6)


@pytest.mark.slow
def test_log_estimate_is_the_linearised_robot(smooth):
    """Small motion: the LOG estimate of a simulated experiment against G with hold and sampling, 4-80 Hz."""
    q = jf.random_positions(1, KEY)
    plan = jf.Multisine(2000.0, 8000, jf.log_odd_lines(17, 320, 50), rms=0.05 * RMS)
    data = jf.simulate(smooth, plan, q, key=KEY, noise=0.0)
    spectra = jf.with_output_quantity(jf.dft(data), "velocity")
    estimate = np.asarray(jf.estimate(spectra, jf.LogMean()).G)
    model = jf.robot.linearise(smooth, jf.robot.operating_point(smooth, q))
    hold = jf.robot.ZeroOrderHold(2000.0, "position")
    G = np.asarray(jf.robot.frf(model, spectra.frequency, hold=hold))
    ratio = np.einsum("pfii->pfi", estimate / G)
    assert plan.frequency[0] < 4.5 and plan.frequency[-1] > 75
    assert np.abs(20 * np.log10(np.abs(ratio))).max() < 0.01
    assert np.abs(np.rad2deg(np.angle(ratio))).max() < 0.1


@pytest.fixture(scope="module")
def recorded():
    return jf.simulate(jf.robot.r3x(), design(), jf.random_positions(2, KEY), key=KEY, run_in=1.0)


class TestRecord:
    def test_contents(self, recorded):
        plan = design()
        assert recorded.u.shape == recorded.y.shape == recorded.r.shape == (2, 6, 2000, 6)
        assert recorded.y_quantity == "position" and recorded.r_quantity == "velocity"
        assert recorded.transient_periods == 0 and recorded.period == 2000
        np.testing.assert_array_equal(recorded.lines, plan.lines)
        np.testing.assert_allclose(recorded.r[1], jf.reference(plan).r, atol=1e-12)
        limit = np.asarray(jf.robot.r3x().drives.torque_limit)
        assert np.all(np.abs(recorded.u) <= limit)

    @pytest.mark.slow
    def test_noise(self, recorded):
        """The noise is 5e-5 rad, white, its own in every run."""
        quiet = jf.simulate(jf.robot.r3x(), design(), recorded.q, key=KEY, run_in=1.0, noise=0.0)
        noise = (recorded.y - quiet.y).reshape(12, 2000, 6)
        # The loop answers the noise by motion too, far below it between samples.
        steps = np.diff(noise, axis=1).std(axis=1) / np.sqrt(2)
        np.testing.assert_allclose(steps, 5e-5, rtol=0.15)
        assert np.abs(np.corrcoef(np.diff(noise, axis=1)[..., 0])[np.triu_indices(12, 1)]).max() < 0.12

    @pytest.mark.slow
    def test_seeds_and_chunks(self, recorded):
        said = []
        again = jf.simulate(jf.robot.r3x(), design(), recorded.q, key=KEY, run_in=1.0, chunk=5, progress=said.append)
        np.testing.assert_allclose(again.u, recorded.u, atol=1e-9)
        np.testing.assert_allclose(again.y, recorded.y, atol=1e-9)
        assert said == sorted(said) and said[-1] == 1.0
        other = jf.simulate(jf.robot.r3x(), design(), recorded.q[:1], key=jr.key(4), run_in=1.0, chunk=5)
        assert np.abs(other.y - recorded.y[:1]).max() > 1e-5


class TestParts:
    def test_inverse(self):
        rng = np.random.default_rng(0)
        A = rng.normal(size=(50, 7, 7)) * 10.0 ** rng.uniform(-1, 1, (50, 7, 1))
        A = A @ A.swapaxes(1, 2) + 1e-3 * np.eye(7)
        ours = np.moveaxis(np.asarray(inverse_columns(jnp.asarray(np.moveaxis(A, 0, -1)))), -1, 0)
        np.testing.assert_allclose(A @ ours, np.broadcast_to(np.eye(7), A.shape), atol=1e-7)

    @pytest.mark.parametrize(
        "settings",
        [
            {},
            {"feedforward": False, "integral_time": np.inf},
            {"position_gain": [5.0, 4.0, 6.0, 8.0, 3.0, 5.0], "integral_time": [0.05, 0.1, 0.2, 0.05, 0.04, 0.3]},
            {"speed_filter": 150.0},
            {"speed_sensor": True, "speed_filter": 90.0},
            {"speed_filter": [50.0, 150.0, 300.0, 80.0, 100.0, 200.0], "anti_windup": True},
        ],
        ids=lambda settings: ", ".join(settings) or "plain",
    )
    def test_controller(self, settings):
        table = jf.robot.table_from_robot(jf.robot.r3x())
        table["controller"] |= settings
        if "anti_windup" in settings:
            for joint in (j for j in table["joint"] if j["type"] == "driven"):
                joint["torque_limit"] /= 50.0
        robot = jf.robot.robot_from_table(table)
        again = jf.robot.robot_from_table(jf.robot.table_from_robot(robot)).controller
        assert again.anti_windup == ("anti_windup" in settings) and again.speed_sensor == ("speed_sensor" in settings)
        rng = np.random.default_rng(0)
        rest, torque = rng.normal(size=6), 0.1 * rng.normal(size=6)
        ours, theirs = Cascade.of(robot), NumPyController(robot, rest, torque)
        state = ours.at_rest(rest[:, None], torque[:, None])
        for _ in range(20):
            reading, position, velocity = rest + 1e-3 * rng.normal(size=6), rest, rng.normal(size=6)
            sensed = rng.normal(size=6)
            u, state = ours.torque(state, *(x[:, None] for x in (reading, sensed, position, velocity)))
            np.testing.assert_allclose(u[:, 0], theirs(reading, position, velocity, sensed), rtol=1e-9, atol=1e-12)

    def test_steps(self):
        """Three for R3X; more for friction that is stiff at rest or a fast mode; an end to it."""
        robot, q = jf.robot.r3x(), jf.random_positions(2, KEY)
        count = lambda r: jf.simulation.fine_steps(r, jf.robot.operating_point(r, q))
        assert count(robot) == 3
        rubbing = jf.robot.with_parameters(robot, {"joint6.coulomb_friction": 0.3})
        assert count(rubbing) == np.ceil(5e-4 * (0.3 / 0.2 + 8e-5) / 4.3e-5 / 2.2)
        with_effect = robot.with_effects(jf.effects.StribeckFriction(5, 0.275, 2.0, 0.2))
        assert count(with_effect) == count(rubbing)
        stiff = jf.robot.with_parameters(robot, {"joint4.stiffness": 3e7})
        # Motor 4 alone against its spring: sqrt(k/J)/n, a little less than the mode.
        assert count(stiff) >= np.ceil(5e-4 * np.sqrt(3e7 / 1.6e-4) / 99 / 0.35)
        with pytest.raises(jf.InputError, match=r"friction that stops .* smoothing"):
            count(jf.robot.with_parameters(robot, {"joint6.coulomb_friction": 3.0}))

    def test_random_positions(self):
        q = np.rad2deg(jf.random_positions(200, jr.key(0)))
        assert np.all(np.abs(q[:, [0, 3, 5]]) <= 150) and np.all(np.abs(q[:, 1]) <= 60)
        assert q[:, 2].min() >= 20 and q[:, 2].max() <= 150
        assert np.abs(q[:, 4]).min() >= 25 and np.abs(q[:, 4]).max() <= 100
        assert 60 < np.sum(q[:, 4] > 0) < 140
        np.testing.assert_array_equal(np.rad2deg(jf.random_positions(3, jr.key(0))), q[:3])


class TestTrouble:
    def test_divergence_is_named(self):
        table = jf.robot.table_from_robot(jf.robot.r3x())
        for joint in table["joint"]:
            if joint["type"] == "driven":
                joint["torque_limit"] = 1e6
        table["joint"][5]["velocity_gain"] = 100.0
        robot = jf.robot.robot_from_table(table)
        with pytest.raises(
            jf.InputError, match=r"6 runs that leave their reference: position 0, experiment 0 at 0\.\d"
        ):
            jf.simulate(robot, design(), jf.random_positions(1, KEY), key=KEY, run_in=1.0)

    CASES: ClassVar = {
        "rate": (lambda r, d, q: (r, jf.Multisine(1000.0, 1000, [9], n_in=6), q), {}, "1000 Hz; expected 2000 Hz"),
        "inputs": (lambda r, d, q: (r, jf.Multisine(2000.0, 2000, [9], n_in=2), q), {}, "found 2; expected 6"),
        "shape": (lambda r, d, q: (r, d, q[:, :5]), {}, r"positions: found an array of shape \(1, 5\)"),
        "nan": (lambda r, d, q: (r, d, q * np.nan), {}, "positions: found NaN"),
        "controller": (
            lambda r, d, q: (dataclasses.replace(r, controller=None), d, q),
            {},
            r"R3X: controller: found none",
        ),
        "run_in": (lambda r, d, q: (r, d, q), {"run_in": -1.0}, "run_in: found -1.0"),
        "steps": (lambda r, d, q: (r, d, q), {"steps": 0}, "steps: found 0"),
        "chunk": (lambda r, d, q: (r, d, q), {"chunk": 0}, "chunk: found 0"),
        "weight": (
            lambda r, d, q: (r.with_effects(jf.effects.Payload(300.0)), d, q),
            {},
            r"joint\d: found .* N m to hold the arm",
        ),
    }

    @pytest.mark.parametrize("case", CASES)
    def test_bad_input(self, case):
        change, options, message = self.CASES[case]
        arguments = change(jf.robot.r3x(), design(), jf.random_positions(1, KEY))
        with pytest.raises(jf.InputError, match=message):
            jf.simulate(*arguments, key=KEY, **options)


DESIGN = """
fs = 2000.0
period = 2000
inputs = 6
[lines]
grid = "list"
list = [9, 11, 13, 15]
"""


class TestCommand:
    @pytest.fixture
    def files(self, tmp_path):
        jf.io.write_robot(tmp_path / "robot.toml", jf.robot.r3x())
        (tmp_path / "design.toml").write_text(DESIGN)
        return tmp_path

    def test_record(self, files, capsys):
        (files / "q.csv").write_text("# rad\n0.1, 0.2, 0.9, 0.3, 0.8, 0.1\n")
        arguments = ["simulate", str(files / "robot.toml"), str(files / "design.toml"), "--run-in", "1", "--json"]
        arguments += ["--configurations", str(files / "q.csv"), "-o", str(files / "data.nc")]
        assert main(arguments) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["positions"] == 1 and said["experiments"] == 6 and said["samples"] == 2000
        data = jf.io.read(files / "data.nc")
        np.testing.assert_allclose(data.q, [[0.1, 0.2, 0.9, 0.3, 0.8, 0.1]])
        assert data.y_quantity == "position" and data.u.shape == (1, 6, 2000, 6)

    BAD: ClassVar = {
        "suffix": (["-o", "data.txt"], r"suffix '.txt'; expected one of .nc"),
        "folder": (["-o", "no/data.nc"], "no folder"),
        "count": (["-o", "data.nc", "--positions", "0"], "--positions: found 0"),
        "angles": (["-o", "data.nc", "--configurations", "bad.csv"], r"bad.csv: found numbers of shape \(1, 2\)"),
        "words": (["-o", "data.nc", "--configurations", "words.csv"], "words.csv: found could not convert"),
    }

    @pytest.mark.parametrize("case", BAD)
    def test_bad_input(self, files, capsys, monkeypatch, case):
        monkeypatch.chdir(files)
        (files / "bad.csv").write_text("1.0, 2.0\n")
        (files / "words.csv").write_text("one two\n")
        arguments, message = self.BAD[case]
        assert main(["simulate", "robot.toml", "design.toml", *arguments]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert re.search(message, said.err), said.err
        assert not (files / "data.nc").exists()


@pytest.mark.slow
@pytest.mark.parametrize("stiction", [False, True], ids=["R3X", "R3X-stiction"])
def test_all_positions_are_stable(stiction):
    """49 positions at the paper's amplitudes: the motion repeats with the period, below the torque limits."""
    robot = jf.robot.r3x()
    if stiction:
        level = {"joint4": 0.22, "joint5": 0.38, "joint6": 0.11}
        robot = jf.robot.with_parameters(robot, {f"{name}.coulomb_friction": x for name, x in level.items()})
    slow = jf.SlowSine([2, 2, 2, 3, 3, 3], [30.0, 30.0, 30.0, 40.0, 40.0, 40.0])
    plan = jf.Multisine(2000.0, 4000, np.arange(9, 160, 6), rms=RMS, slow=slow, periods=2)
    data = jf.simulate(robot, plan, jf.random_positions(49, jr.key(0)), key=KEY, noise=0.0)
    speed = np.diff(data.y, axis=2) * 2000
    change = speed[:, :, 4000:] - speed[:, :, :3999]
    rms = lambda x: np.sqrt(np.mean(x**2, axis=2))
    assert np.all(rms(change) < 1e-2 * rms(speed))
    assert np.mean(np.abs(data.u) >= np.asarray(robot.drives.torque_limit)) < 1e-3
