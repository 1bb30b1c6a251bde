"""What is known of a robot's numbers before an experiment."""

import math

import pytest

import jaxfrf as jf
from jaxfrf.robot import DEFAULTS, Tolerance, Tolerances, r3x, tolerances_from

NAMES = r3x().joint_names


def stated(**table):
    return tolerances_from(table, NAMES)


def test_defaults_where_nothing_is_said():
    known = r3x().tolerances
    for name, std in {
        "joint3.mass": 0.05,
        "joint3.com.y": 0.05,
        "joint3.motor_inertia": 0.05,
        "joint1.coulomb_friction": 0.5,
        "joint1.stiffness": 0.3,
        "joint1.damping": math.log(2.0),
        "joint1.torque_constant": 0.03,
        "joint1.stiffness_knee": 0.5,
    }.items():
        assert known.of(name).std == std
    assert known.of("joint1.torque_ripple").unknown
    assert all(kind in jf.robot.tolerances.KINDS for kind in DEFAULTS)


def test_the_most_particular_word_counts():
    known = tolerances_from({"links": 0.02, "mass": 0.03, "joint6.mass": "0.1 kg", "all": 0.2}, NAMES)
    assert known.of("joint6.mass") == Tolerance(0.1, relative=False)
    assert known.of("joint5.mass").std == 0.03
    assert known.of("joint5.com.x").std == 0.02
    assert known.of("joint5.stiffness").std == 0.2


def test_a_later_word_takes_the_place_of_what_it_covers():
    known = stated(mass=0.01, stiffness=0.1).updated(stated(links=0.2))
    assert known.of("joint5.mass").std == 0.2 and known.of("joint5.stiffness").std == 0.1
    assert known.updated(stated(all=0)).of("joint5.stiffness").exact


def test_files_keep_them(tmp_path):
    robot = r3x().with_tolerances(
        tolerances_from({"links": 0.02, "joint6.mass": "0.1 kg", "joint2.stiffness": "unknown"}, NAMES)
    )
    jf.io.write_robot(robot, tmp_path / "robot.toml")
    assert jf.io.read_robot(tmp_path / "robot.toml").tolerances == robot.tolerances

    text = (tmp_path / "robot.toml").read_text().replace('"joint6.mass" = "0.1 kg"', 'joint6.mass = "0.2 kg"')
    (tmp_path / "other.toml").write_text(text)
    assert jf.io.read_robot(tmp_path / "other.toml").tolerances.of("joint6.mass") == Tolerance(0.2, relative=False)
    assert r3x().tolerances == Tolerances()


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"lnks": 0.1}, "Did you mean 'links'"),
        ({"joint9.mass": 0.1}, "unknown key 'joint9.mass'"),
        ({"links": -0.1}, "-0.1"),
        ({"links": float("nan")}, "nan"),
        ({"links": True}, "True"),
        ({"links": "much"}, "much"),
        ({"joint6.mass": "100 g"}, '"0.05 kg"'),
    ],
)
def test_what_is_no_tolerance(table, says):
    with pytest.raises(jf.InputError, match=says.replace("(", r"\(")):
        tolerances_from(table, NAMES)
