"""Records of another simulator in which nothing is hidden, or a delay: logs of angle, speed and acceleration.

The machine is off from the model by 1 to 3 % in every number; nothing here is shared with the search but the robot.
"""

import dataclasses
import functools

import numpy as np
import pytest
from _mujoco_records import mujoco_experiment
from small_arm import small_robot
from uncertain_arm import design, machine as off, model

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.__main__ import main
from jaxfrf.gap import diagnose
from jaxfrf.gap.simulated.judge import over_floor
from jaxfrf.io.gaps import gap_contents
from jaxfrf.robot import Tolerances, parameters, with_parameters
from jaxfrf.trajectory.evidence import Evidence
from jaxfrf.trajectory.measured import measured

FS, PERIOD = 1000.0, 4000
Q = np.array([[0.3, 0.9], [-0.5, 1.4], [1.5, -1.1], [0.9, 0.4], [2.2, -0.6]])
KINDS = ("stiffness", "damping", "viscous_friction", "coulomb_friction", "mass", "com", "inertia", "motor_inertia")
SENSOR = {"position": 0.0, "velocity": 0.02, "acceleration": 5.0}  # rms of what the log adds, rad, rad/s, rad/s^2
LOGS = tuple(SENSOR)


def machine(seed: int):
    """As built: every number is off by 1 to 3 %."""
    rng, values = np.random.default_rng([seed, 77]), {}
    for kind in KINDS:
        for name, value in parameters(small_robot(), [kind]).items():
            values[name] = value * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.03))
    return with_parameters(small_robot(), values)


@functools.cache
def played(seed: int, delay: float):
    slow = jf.SlowSine([3, 5], [30.0, 30.0])
    plan = jf.Multisine(FS, PERIOD, np.arange(17, 240, 2), rms=[2.0, 3.0], slow=slow, seed=seed)
    robot = machine(seed)
    robot = robot.with_effects(fx.TorqueDelay("shoulder", delay)) if delay else robot
    return mujoco_experiment(robot, plan, Q, seed=seed, run_in=3.0, noise=2e-5, ripple=None, processes=2)


def logged(data, quantity: str, seed: int):
    """The record with its angles, or with their derivative and what such a sensor adds."""
    if quantity == "position":
        return data
    y = np.asarray(data.y)
    s = 2j * np.pi * np.fft.rfftfreq(y.shape[2], 1 / FS)[:, None]
    order = LOGS.index(quantity)
    y = np.fft.irfft(np.fft.rfft(y - y[:, :, :1], axis=2) * s**order, n=y.shape[2], axis=2)
    y = y + SENSOR[quantity] * np.random.default_rng([seed, 5]).standard_normal(y.shape)
    return dataclasses.replace(data, y=y, y_quantity=quantity)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", LOGS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nothing_hidden(quantity, seed):
    found = diagnose(small_robot(), logged(played(seed, 0.0), quantity, seed))
    assert found.verdict in ("sufficient", "inconclusive"), found.says
    assert found.effects == () and found.gap.after == found.gap.before


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("quantity", LOGS)
def test_a_delay_is_still_found(quantity, tmp_path):
    """And the gap that is reported is that of the robot that is written: read from its file and simulated again."""
    data = logged(played(1, 8e-4), quantity, 1)
    found = diagnose(small_robot(), data)
    (named,) = found.effects
    assert "torque_delay" in (named.name, *named.equivalent) and named.joint == "shoulder", found.says
    (late,) = named.parameters.values()
    assert late.value == pytest.approx(8e-4, rel=0.1)
    assert found.gap.after < found.gap.floor < found.gap.before and found.gap.shrink == 1.0
    assert np.all(found.gap.torque_after < found.gap.torque_before)

    jf.io.write_robot(tmp_path / "extended.toml", found.extended)
    record = measured(data).at(found.heldout)
    evidence = Evidence(jf.io.read_robot(tmp_path / "extended.toml"), record)
    axes = over_floor(evidence.residual, Evidence(found.base, record).plain)
    np.testing.assert_allclose(np.sqrt(np.mean(axes**2)), found.gap.after, rtol=0.02)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_encoder_that_counts_coarsely_is_written(tmp_path):
    """It is seen in the readings, and the robot that is written states it: asked again, nothing is missing."""
    data = logged(played(1, 0.0), "position", 1)
    size = float(fx.EncoderQuantisation.typical(small_robot(), 1).resolution)
    readings = np.array(data.y)
    readings[..., 1] = np.round(readings[..., 1] / (3.0 * size)) * 3.0 * size
    data = dataclasses.replace(data, y=readings)
    found = diagnose(small_robot(), data)
    assert [(x.name, x.joint) for x in found.effects] == [("encoder_quantisation", "elbow")], found.says
    assert "leaves" not in found.says and "seen in their readings" in found.says
    jf.io.write_robot(tmp_path / "extended.toml", found.extended)
    again = diagnose(jf.io.read_robot(tmp_path / "extended.toml"), data)
    assert (again.verdict, again.effects) == ("sufficient", ()), again.says


def stated_nothing():
    """The small robot, whose file says nothing of how well it is known: the defaults hold."""
    return dataclasses.replace(small_robot(), tolerances=Tolerances())


OFF = {"links": (["mass"], 1.05), "friction": (["coulomb_friction", "viscous_friction"], 1.3)}


def played_by(robot, seed: int = 3):
    slow = jf.SlowSine([3, 5], [30.0, 30.0])
    plan = jf.Multisine(FS, PERIOD, np.arange(17, 240, 2), rms=[2.0, 3.0], slow=slow, seed=seed)
    return mujoco_experiment(robot, plan, Q, seed=seed, run_in=3.0, noise=2e-5, ripple=None, processes=2)


@pytest.mark.slow
@pytest.mark.parametrize("what", OFF)
def test_numbers_that_are_off_by_a_tolerance_are_no_effect(what):
    """Every mass by 5 %, or every friction by 30 %: an earlier search named friction that was not there."""
    kinds, factor = OFF[what]
    values = {name: factor * np.asarray(x) for name, x in parameters(stated_nothing(), kinds).items()}
    found = diagnose(stated_nothing(), played_by(with_parameters(stated_nothing(), values)))
    assert found.verdict in ("sufficient", "inconclusive") and found.effects == (), found.says


@pytest.mark.slow
def test_a_delay_is_found_beside_wide_tolerances():
    found = diagnose(stated_nothing(), played_by(stated_nothing().with_effects(fx.TorqueDelay("shoulder", 8e-4))))
    (named,) = found.effects
    assert "torque_delay" in (named.name, *named.equivalent) and named.joint == "shoulder", found.says
    (late,) = named.parameters.values()
    assert late.value == pytest.approx(8e-4, rel=0.1)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_wrong_numbers_are_no_missing_effect(seed):
    """Everything off as a data sheet is (springs and their shape 20 %, friction 30 %, links 5 %), default tolerances:
    nothing is missing, and a friction level that is off by more than is known of it is told."""
    given = dataclasses.replace(model(), tolerances=Tolerances())
    level = float(parameters(given, ["coulomb_friction"])["elbow.coulomb_friction"])
    machine = with_parameters(off(seed), {"elbow.coulomb_friction": 1.9 * level})
    data = mujoco_experiment(machine, design(seed), Q, seed=seed, run_in=3.0, noise=2e-5, ripple=None)
    found = diagnose(given, data)
    assert (found.verdict, found.effects) == ("sufficient", ()), found.says
    assert "elbow.coulomb_friction by +9" in found.says or "elbow.coulomb_friction by +8" in found.says
    (wrong,) = [number for number in found.wrong_numbers if number.name == "elbow.coulomb_friction"]
    assert wrong.value == pytest.approx(1.9 * level, rel=0.05) and wrong.given == pytest.approx(level)
    assert gap_contents(found)["wrong_numbers"][0]["interval95"][0] < wrong.value
    assert found.gap.before < 1.0 and found.given is given


@pytest.mark.slow
def test_few_runs_at_one_position(tmp_path):
    """The example: four runs, which bands of lines stand for; nothing is missing."""
    data, robot = str(tmp_path / "run.nc"), str(tmp_path / "robot.toml")
    assert main(["example", "-o", data, "--robot-out", robot]) == 0
    found = diagnose(jf.io.read_robot(robot), jf.io.read(data))
    assert found.verdict == "sufficient" and not found.effects
