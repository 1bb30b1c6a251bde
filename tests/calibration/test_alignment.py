"""Signals that stand late in a log: MuJoCo's record of an arm of which nothing is known well, moved in time."""

import dataclasses
import functools

import numpy as np
import pytest
from _mujoco_records import mujoco_experiment
from small_arm import FS, Q
from uncertain_arm import design, machine, model, played

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.calibration.alignment import aligned
from jaxfrf.trajectory.log_times import LogTimes, speeds_of_differences
from jaxfrf.trajectory.measured import fewer, measured


def few(data):
    return measured(fewer(data, 1)).at([0, 1, 2])


def rolled(data, **samples):
    """A log whose signals stand so many samples late."""
    moved = {n: np.roll(np.asarray(getattr(data, n)), k, axis=2) for n, k in samples.items()}
    return dataclasses.replace(data, **moved)


def without_reference(data):
    return dataclasses.replace(data, r=None)


def test_times_are_taken_back():
    """Sines of each axis, whole and broken samples, in the steady periods alone."""
    k, period = np.arange(800), 200
    late = np.array([2.0, -0.37])
    course = lambda shift: np.sin(2 * np.pi * 7 * (k[:, None] - shift) / period)[None, None] + 3.0
    data = jf.Experiment(course(late), course(0.0 * late), 100.0, period, transient_periods=1, y_quantity="position")
    back = LogTimes(late / 100.0, 0.0 * late, 100.0).taken_back(data)
    np.testing.assert_allclose(back.u[:, :, period:], course(0.0 * late)[:, :, period:], atol=1e-12)
    np.testing.assert_array_equal(back.u[:, :, :period], data.u[:, :, :period])
    np.testing.assert_array_equal(back.y, data.y)


@pytest.mark.parametrize(
    ("samples", "says"),
    [
        ({"u": 1}, "u is 1 ms late (1 sample)"),
        pytest.param({"y": 2}, "y is 2 ms late (2 samples)", marks=pytest.mark.slow),
        ({"r": 1}, "r is 1 ms late (1 sample)"),
        pytest.param(
            {"u": 2, "y": -1}, "u is 2 ms late (2 samples) and y is 1 ms early (1 sample)", marks=pytest.mark.slow
        ),
    ],
)
def test_law_and_motion_tell(samples, says):
    found = aligned(rolled(played(), **samples), model(), few, lambda parts: parts)
    assert found.late == says and says in found.compared() and says in found.sentence()
    assert not np.any(found.shown.contradicted) and found.shown.robot.controller is not None
    both = {"u", "y"} if "r" not in samples else {"r"}
    for name in both:
        np.testing.assert_array_equal(getattr(found.data, name), getattr(played(), name))


@pytest.mark.slow
def test_what_is_taken_back_leaves_nothing_behind():
    """Numbers from the late log are those from the one in time."""
    late, there = (jf.calibrate(model(), data, rounds=3) for data in (rolled(played(), u=1), played()))
    assert "in the log u is 1 ms late (1 sample), which was taken back" in late.compared
    assert "in the log" not in there.compared
    np.testing.assert_allclose(late.x, there.x, atol=1e-9)


@pytest.mark.slow
def test_parts_of_a_sample_and_axes_of_their_own():
    late = np.array([0.0, 0.4e-3])
    found = aligned(LogTimes(-late, 0.0 * late, FS).taken_back(played()), model(), few, lambda parts: parts)
    assert found.late == "u of elbow is 0.4 ms late (0.4 samples)"
    np.testing.assert_allclose(found.data.u, played().u, atol=2e-3 * np.abs(played().u).max())


def test_nothing_is_late():
    found = aligned(played(), model(), few, lambda parts: parts)
    assert found.data is played() and not found.late and not found.commands and not found.sentence()


def test_speeds_behind_differences():
    """Of a sine of 7 cycles a period, whose differences are known in closed form."""
    phase = 2 * np.pi * 7 / 200 * np.arange(800)[None, None, :, None]
    step = 2 * np.pi * 7 / 200
    y = 100.0 * (np.sin(phase) - np.sin(phase - step)) + 2.0
    data = jf.Experiment(0.0 * y, y, 100.0, 200, transient_periods=1, y_quantity="velocity")
    found = speeds_of_differences(data).y
    np.testing.assert_allclose(found[:, :, 200:], (100.0 * step * np.cos(phase) + 2.0)[:, :, 200:], atol=1e-9)
    np.testing.assert_array_equal(found[:, :, :200], y[:, :, :200])


@pytest.mark.slow
def test_speeds_that_are_differences_of_positions():
    """They are half a sample late on all axes; what comes back is the derivative of the positions, line by line."""
    data, positions = without_reference(played()), np.asarray(played().y)
    differences = (positions - np.roll(positions, 1, axis=2)) * FS
    found = aligned(dataclasses.replace(data, y=differences, y_quantity="velocity"), model(), few, lambda parts: parts)
    assert found.late.startswith("y is 0.5 ms late (half a sample), as a difference of positions is")
    lines = lambda x: np.fft.rfft(np.asarray(x)[:, :, -data.period :], axis=2)[:, :, 1 : max(data.lines) + 1]
    omega = 2 * np.pi * np.arange(1, max(data.lines) + 1)[:, None] * FS / data.period
    speeds = 1j * omega * lines(positions)
    np.testing.assert_allclose(lines(found.data.y), speeds, atol=1e-3 * np.abs(speeds).max())


@functools.cache
def commanded_late():
    """A drive that applies its command a sample later, and a log of what it applies."""
    robot = machine().with_effects(*(fx.TorqueDelay(joint, 1e-3) for joint in ("shoulder", "elbow")))
    data = mujoco_experiment(robot, design(0), Q, seed=0, run_in=3.0, noise=2e-5, ripple=None)
    return rolled(data, u=1)


@pytest.mark.slow
def test_a_controller_that_commands_late_is_no_late_log():
    data = commanded_late()
    found = aligned(data, model(), few, lambda parts: parts)
    assert found.data is data and not found.late
    assert found.commands == "u is 1 ms late (1 sample)" and "it does, where u is 1 ms late" in found.compared()
    assert found.shown.robot.controller is None


@pytest.mark.slow
@pytest.mark.parametrize("late", [1, 3, 0, -1])
def test_the_motion_alone_tells_commands_that_come_late(late):
    """Behind the motion no torque can be; before it is a delay of the robot's."""
    found = aligned(rolled(without_reference(played()), u=late), model(), few, lambda parts: parts)
    if late < 1:
        assert not found.late
        return
    assert found.late == f"u is {late} ms late ({late} sample{'s' if late > 1 else ''})"
    np.testing.assert_array_equal(found.data.u, played().u)
