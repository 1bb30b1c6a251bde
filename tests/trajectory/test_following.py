"""Motors that are moved as they were measured: against the closed loop, MuJoCo's records, and logs of every kind."""

import dataclasses
import functools

import jax.random as jr
import numpy as np
import pytest
from _mujoco_records import mujoco_experiment
from marks import slow
from small_arm import FS, PERIOD, Q, small_robot
from uncertain_arm import design, machine, model, played

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.robot import parameters, with_parameters
from jaxfrf.trajectory.evidence import Evidence
from jaxfrf.trajectory.following import compared, unknown_friction
from jaxfrf.trajectory.measured import measured
from jaxfrf.trajectory.remainder import excess


def light():
    """Gears that hardly damp: on motors that are held the arm swings for half a minute."""
    robot = small_robot()
    return with_parameters(robot, {n: 0.1 * float(v) for n, v in parameters(robot, ["damping"]).items()})


ROBOTS = {
    "light damping": light,
    "springs": lambda: small_robot(),
    "an elbow that slides": lambda: small_robot(slides=True, gear_ratio=200.0, stiffness=3e5, damping=200.0),
    "rigid transmissions": lambda: small_robot(stiffness=np.inf),
    "resolver ripple, hysteresis, gear error": lambda: small_robot().with_effects(
        fx.ResolverRipple("elbow", [1e-3], [2], [0.3]),
        fx.GearHysteresis("shoulder", 2.0),
        fx.TransmissionError("elbow", [1e-4, 1e-4], 7.0),
    ),
    "delay and lag": lambda: small_robot().with_effects(
        fx.TorqueDelay("shoulder", 1.2e-3), fx.CurrentLoopLag("elbow", 8e-4), fx.TorqueConstant("elbow", 0.05)
    ),
}


@functools.cache
def simulated(name: str):
    robot = ROBOTS[name]()
    return robot, jf.simulate(robot, design(0), Q[:1], key=jr.key(0), run_in=30.0, noise=0.0)


def unknown(robot):
    """Its controller is not known, but for its rate, which the records have."""
    return dataclasses.replace(robot, controller=None)


def missed(robot, data):
    """Torque that the robot needs more or less than measured, relative, by axis, without any correction."""
    record = measured(data)
    evidence = Evidence(robot, record)
    squares = lambda x: np.sum(np.abs(x[:, :, 1:]) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(evidence.U - record.U) / squares(record.U))


@pytest.mark.parametrize("name", ["springs", *(slow(n) for n in ROBOTS if n != "springs")])
def test_torque_of_a_measured_motion(name):
    """What a closed loop commanded, from the motion that came of it: friction that turns over included."""
    robot, data = simulated(name)
    assert np.all(missed(unknown(robot), data) < 2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("order", [slow(1), 2])
def test_logs_of_speeds_and_accelerations(order):
    robot, data = simulated("springs")
    steady = data.period // 2 + 1
    s = (2j * np.pi * np.arange(steady) * data.fs / data.period)[:, None]
    y = np.fft.irfft(np.fft.rfft(data.y, axis=2) * s**order, n=data.period, axis=2)
    other = dataclasses.replace(data, y=y, y_quantity=("velocity", "acceleration")[order - 1])
    assert np.all(missed(unknown(robot), other) < 2e-3)


def test_log_at_half_the_controllers_rate():
    robot, data = simulated("springs")
    half = {name: getattr(data, name)[:, :, ::2] for name in ("u", "y", "r")}
    data = dataclasses.replace(data, **half, fs=data.fs / 2, period=data.period // 2)
    assert "the log has 500 Hz" in compared(robot, data)
    assert np.all(missed(robot, data) < 1e-2)  # torque between the log's samples is not in it


@pytest.mark.slow
def test_calibration_without_controller():
    """MuJoCo's records: as good as with the controller known."""
    found = jf.calibrate(unknown(model()), dataclasses.replace(played(), r=None))
    assert "hold no reference" in found.compared
    for name, true in parameters(machine(), ["stiffness", "damping", "coulomb_friction"]).items():
        assert abs(found.values[name] / true - 1.0) < 0.02, name
        low, high = found.interval(name)
        assert low < true < high, name


def hard(much: float):
    """MuJoCo's motors that stick, with this many times the friction, and whose motion is all that is known."""
    robot = rubbing(machine(), much)
    slow = jf.SlowSine([3, 5], [15.0, 15.0])
    plan = jf.Multisine(FS, PERIOD, np.arange(17, 240, 2), rms=[2.0, 3.0], slow=slow, seed=0)
    record = mujoco_experiment(robot, plan, Q[:2], seed=0, run_in=3.0, noise=1e-7, ripple=None, substeps=16, stick=2e-4)
    return unknown(robot), dataclasses.replace(record, r=None)


@pytest.mark.slow
def test_friction_that_a_motion_does_not_tell():
    """The true robot leaves what its motors stood still for, which is many times the floor of one whose motion says
    all; it is known how much that may be."""
    robot, data = hard(2.0)
    record = measured(data)
    evidence = Evidence(robot, record)
    free = with_parameters(robot, dict.fromkeys(parameters(robot, ["coulomb_friction"]), 1e-9))
    bare = Evidence(free, record).plain
    beyond = lambda floor: excess(evidence.residual, floor, record.frequency)
    assert beyond(bare) > 5.0
    assert 0.3 < beyond(evidence.plain) < 2.0


def test_friction_is_known_where_references_are_played():
    robot, data = simulated("springs")
    angle = measured(data).Y
    assert not np.any(unknown_friction(robot, data, angle))
    once, twice = (unknown_friction(unknown(x), data, angle) for x in (robot, rubbing(robot, 2.0)))
    assert np.all(once > 0) and np.all(twice > 1.5 * once)


def rubbing(robot, much: float):
    return with_parameters(robot, {k: much * v for k, v in parameters(robot, ["coulomb_friction"]).items()})
