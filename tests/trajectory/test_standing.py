"""Arm configurations that the logged positions of the motors contradict are told; encoders that begin at zero not."""

from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest
from uncertain_arm import model

import jaxfrf as jf
from jaxfrf.calibration.result import Calibration
from jaxfrf.trajectory.measured import measured, turned
from jaxfrf.trajectory.ripple import Order
from jaxfrf.trajectory.standing import misplaced

Q = np.array([[0.3, -0.6], [-0.4, 0.8], [0.9, 0.2]])
N = 200


def record(stands=Q, *, q=Q, amplitude=0.01, quantity="position"):
    """Motors that swing by `amplitude`, rad of the arm, about `stands`, (pos, axis) or (pos, exp, axis)."""
    stands = np.asarray(stands)
    stands = stands[:, None, :] * np.ones((1, 2, 1)) if stands.ndim == 2 else stands
    swing = amplitude * np.sin(2 * np.pi * np.arange(2 * N) / N)[:, None]
    y = (stands[:, :, None] + swing) * np.asarray(model().drives.gear_ratio)
    return jf.Experiment(u=np.ones_like(y) * swing, y=y, fs=500.0, period=N, lines=[1], q=q, y_quantity=quantity)


def one(pos, exp, by):
    stands = np.repeat(Q[:, None], 2, axis=1)
    stands[pos, exp, 1] += by
    return stands


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (record(), ""),
        (record(Q + np.array([0.0, 0.015])), ""),
        (record(Q + np.array([0.0, 0.1]), amplitude=0.06), ""),  # q is where it began
        (record(Q + np.array([0.0, 0.1])), "elbow stands 0.1 rad away at every position"),
        (record(Q * [1.0, -1.0]), "elbow stands up to 1.6 rad away (position 1)"),
        (record(Q[:, ::-1]), "shoulder stands up to 1.2 rad away (position 1); elbow stands up to 1.2"),
        (record(one(2, 1, 0.5)), "elbow stands up to 0.5 rad apart in the experiments at position 2"),
        (record(0.0 * Q), ""),
        (record(Q[:1], q=Q[:1] + 0.3), "elbow stands -0.3 rad away at every position"),
        (record(Q + 1.0, quantity="velocity"), ""),
    ],
)
def test_where_motors_stand(data, expected):
    said = misplaced(model(), data)
    assert expected in "".join(said) and bool(said) == bool(expected)


def test_zeros_and_wrists_that_the_robot_states_are_taken_off():
    zero, wrist = np.array([0.0, 20.0]), np.array([[1.0, 0.0], [0.8, 1.0]])
    robot = eqx.tree_at(lambda r: r.drives.zero, model(), zero, is_leaf=lambda x: x is None)
    robot = robot.with_effects(jf.effects.WristCoupling("elbow", 0.8))
    stands = Q @ wrist.T + zero / np.asarray(model().drives.gear_ratio)
    assert misplaced(model(), record(stands)) and not misplaced(robot, record(stands))


def test_part_of_a_turn():
    """Three positions, each over twice the amplitude at the motor; whole turns count as one."""
    gear = np.asarray(model().drives.gear_ratio)
    found = turned(measured(record(amplitude=0.002)))
    np.testing.assert_allclose(found, np.minimum(3 * 2 * 0.002 * gear / (2 * np.pi), 1.0), rtol=0.05)
    np.testing.assert_array_equal(turned(measured(record(amplitude=1.0))), 1.0)


def test_ripple_of_a_part_of_a_turn_is_doubted():
    orders = [Order("torque", 1, 1.0), Order("torque", 1, 2.0), Order("torque", 0, 3.0)]
    told = SimpleNamespace(given=model(), orders=orders, turned=(0.9, 0.2))
    (doubt,) = Calibration._of_part_of_a_turn(told)
    assert doubt.startswith("ripple of elbow (orders 1, 2) is of 0.2 of a turn")
