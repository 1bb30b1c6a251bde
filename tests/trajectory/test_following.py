"""Motors that are moved as they were measured: against the closed loop, MuJoCo's records, and logs of every kind."""

import dataclasses
import functools

import jax.random as jr
import numpy as np
import pytest
from marks import slow
from small_arm import Q, small_robot
from uncertain_arm import design, machine, model, played

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.robot import parameters
from jaxfrf.trajectory.evidence import Evidence
from jaxfrf.trajectory.following import compared
from jaxfrf.trajectory.measured import measured

ROBOTS = {
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
    return robot, jf.simulate(robot, design(0), Q[:1], key=jr.key(0), run_in=3.0, noise=0.0)


def unknown(robot):
    """Its controller is not known, but for its rate, which the records have."""
    return dataclasses.replace(robot, controller=None)


def missed(robot, data):
    """Torque that the robot needs more or less than measured, relative, by axis, without any correction."""
    record = measured(data)
    evidence = Evidence(robot, record)
    squares = lambda x: np.sum(np.abs(x[:, :, 1:]) ** 2, axis=(0, 1, 2))
    return np.sqrt(squares(evidence.U - record.U) / squares(record.U))


_QUICK = ("springs",)


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in _QUICK else pytest.mark.slow) for n in ROBOTS])
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
