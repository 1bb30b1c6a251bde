"""Gains from a record's commands, against a cascade in NumPy that moves two inertias: no arm of the library acts."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from loop_reference import NumPyController
from small_arm import FS, Q, small_robot

import jaxfrf as jf
from jaxfrf.examples import example_robot
from jaxfrf.robot.tolerances import Tolerance, Tolerances
from jaxfrf.trajectory.controller import shown_controller
from jaxfrf.trajectory.measured import measured

PERIOD, PERIODS, EXPERIMENTS = 1000, 12, 2
LINES = np.arange(4, 48, 4)
INERTIA = np.array([4e-3, 2e-3])
OFF = {"position_gain": [1.03, 0.97], "velocity_gain": [0.98, 1.02], "integral_time": [1.04, 1.05]}
NAMES = tuple(OFF)


def scaled(robot, by):
    c = robot.controller
    gains = {name: jnp.asarray(np.broadcast_to(getattr(c, name), (2,)) * np.array(by[name])) for name in NAMES}
    return dataclasses.replace(robot, controller=dataclasses.replace(c, **gains))


def logged(robot, reading_noise=0.0, ahead=None):
    """Two motors under the cascade in steady state: torque held over a sample, friction, references of random phase."""
    rng = np.random.default_rng(5)
    time = np.arange(PERIOD * PERIODS) / FS
    u, y, v = (np.zeros((1, EXPERIMENTS, len(time), 2)) for _ in range(3))
    for run in range(EXPERIMENTS):
        phase = 2 * np.pi * (LINES * FS / PERIOD * time[:, None, None] + rng.uniform(size=(2, len(LINES))))
        v[0, run] = np.sum(np.cos(phase), axis=2)
        position = np.sum(np.sin(phase) / (2 * np.pi * LINES * FS / PERIOD), axis=2)
        controller = NumPyController(robot, np.zeros(2), np.zeros(2))
        angle, speed = np.zeros(2), np.zeros(2)
        for k in range(len(time)):
            reading = angle + reading_noise * rng.normal(size=2)
            torque = controller(reading, position[k], v[0, run, k])
            if ahead is not None:
                torque = torque + ahead * (v[0, run, k] - v[0, run, k - 1]) * FS
            y[0, run, k], u[0, run, k] = angle, torque
            acceleration = (torque - 2e-3 * speed - 0.02 * np.tanh(speed / 0.2)) / INERTIA
            angle, speed = angle + speed / FS + acceleration / FS**2 / 2, speed + acceleration / FS
    return jf.Experiment(
        u, y, FS, PERIOD, r=v, q=Q[:1], lines=LINES, transient_periods=10, y_quantity="position", r_quantity="velocity"
    )


def found(robot, data):
    return shown_controller(robot, measured(data))


def gains(robot):
    return np.array([np.broadcast_to(getattr(robot.controller, name), (2,)) for name in NAMES])


@pytest.mark.parametrize("corner", [None, 120.0])
def test_gains_that_are_off(corner):
    written = small_robot()
    written = dataclasses.replace(written, controller=dataclasses.replace(written.controller, speed_filter=corner))
    true = scaled(written, OFF)
    shown = found(written, logged(true))
    np.testing.assert_allclose(gains(shown.robot), gains(true), rtol=2e-4)
    assert np.all(shown.left < 1e-3) and "velocity gain" not in shown.says() and "above the written" in shown.says()
    assert shown.restored(shown.robot) is shown.robot


@pytest.mark.parametrize(("time", "told"), [(0.15, True), (2.0, False)])
def test_gains_that_are_hardly_told_apart(time, told):
    """A position gain of 6 beside 1/integral time, 6.7 or .5."""
    shown = found(small_robot(), logged(small_robot()))
    near = dataclasses.replace(shown.robot.controller, position_gain=jnp.full(2, 6.0), integral_time=jnp.full(2, time))
    change, std = np.array([[-0.16, 0.0], [0.0, 0.0], [0.1, 0.0]]), np.full((3, 2), 1e-3)
    said = dataclasses.replace(
        shown, robot=dataclasses.replace(shown.robot, controller=near), change=change, std=std
    ).says()
    assert "position gain of shoulder 17 % below the written one" in said
    assert ("as far as it is told from the integral time" in said) == told


def test_gains_of_which_nothing_is_known():
    true = scaled(small_robot(), {name: [2.0, 0.4] for name in NAMES})
    unknown = Tolerances((("controller_gain", Tolerance(np.inf)),))
    shown = found(dataclasses.replace(small_robot(), tolerances=unknown), logged(true))
    assert np.all(shown.left < 2e-3)
    (kp, kv, ti), (kp_true, kv_true, ti_true) = gains(shown.robot), gains(true)
    np.testing.assert_allclose(kv, kv_true, rtol=0.02)
    np.testing.assert_allclose(
        kp / ti, kp_true / ti_true, rtol=0.05
    )  # they may have changed places: (s + kp)(s + 1/ti)


def test_noise_that_the_log_does_not_hold():
    """The controller reads it, the log does not: the gains stay within three of their deviations."""
    true = scaled(small_robot(), OFF)
    shown = found(small_robot(), logged(true, reading_noise=2e-5))
    off = np.log(gains(shown.robot) / gains(true))
    assert np.all(np.abs(off) < 3.0 * shown.std) and np.all(shown.std[1] < 5e-3) and not np.any(shown.contradicted)


def test_another_law():
    """A feed-forward of torque that the written controller has not: motors are then moved as measured."""
    shown = found(small_robot(), logged(small_robot(), ahead=INERTIA))
    assert np.all(shown.contradicted) and shown.robot.controller is None
    assert "does not command what was logged" in shown.compared(logged(small_robot()))
    assert shown.restored(shown.robot).controller is small_robot().controller


def test_what_stays_as_written():
    data = logged(scaled(small_robot(), {name: [1.005, 0.995] for name in NAMES}))
    exact = dataclasses.replace(small_robot(), tolerances=Tolerances((("controller_gain", Tolerance(0.0)),)))
    assert found(exact, data).robot.controller is exact.controller
    free = dataclasses.replace(small_robot(), controller=None)
    assert found(free, data).robot is free
    assert not np.any(found(exact, data).contradicted)
    idle = np.asarray(data.u) * [1.0, 0.0]  # a motor without power
    shown = found(small_robot(), dataclasses.replace(data, u=idle))
    assert np.all(shown.change[:, 0]) and not np.any(shown.change[:, 1]) and not np.any(shown.contradicted)
    most = np.max(np.abs(data.u), axis=(0, 1, 2))
    limits = dataclasses.replace(small_robot().drives, torque_limit=jnp.asarray([most[0], 2.0 * most[1]]))
    shown = found(dataclasses.replace(small_robot(), drives=limits), data)
    assert not np.any(shown.change[:, 0]) and np.all(shown.change[:, 1])


def test_the_example_follows_its_file(tmp_path):
    """Its machine reads a speed, with noise that the log holds as well; differences of positions do not do."""
    (tmp_path / "robot.toml").write_text(example_robot())
    written = jf.io.read_robot(tmp_path / "robot.toml")
    shown = found(written, jf.example())
    np.testing.assert_allclose(gains(shown.robot), gains(written), rtol=2e-3)
    assert not shown.says() and np.all(shown.left < 2e-3)
    other = dataclasses.replace(written, controller=dataclasses.replace(written.controller, speed_sensor=False))
    assert np.any(found(other, jf.example()).contradicted)
