"""What is known of a robot's numbers before an experiment."""

import math

import numpy as np
import pytest

import jaxfrf as jf
import jaxfrf.robot as jr
from jaxfrf.calibration.numbers import numbers
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
    jf.io.write_robot(tmp_path / "robot.toml", robot)
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


@pytest.mark.parametrize(("gear", "inertia", "friction"), [(1.0, "kg", "N s/m"), (400.0, "kg m^2", "N m s/rad")])
def test_units_of_a_joint_that_slides(gear, inertia, friction):
    """Those of its motor are of a slide, too, where it moves as the joint does."""
    joint = {"name": "axis", "type": "driven", "slides": True, "axis": [1.0, 0.0, 0.0], "offset": [0.0] * 3}
    joint |= {"mass": 0.0, "com": [0.0] * 3, "inertia": [0.0] * 6, "gear_ratio": gear, "motor_inertia": 50.0}
    joint |= {"viscous_friction": 100.0, "coulomb_friction": 10.0, "stiffness": np.inf}
    table = {"name": "slide", "gravity": [0.0, 0.0, -9.81], "sampling_frequency": 1e3, "joint": [joint]}
    said = {"rotors": "unknown", "friction": "unknown", "axis.motor_inertia": f"5 {inertia}"}
    robot = jr.robot_from_table(table | {"tolerance": said, "friction": {"smoothing": 1e-4}})
    units = {n.name: n.unit for n in numbers(robot, np.ones(1))}
    assert (units["axis.motor_inertia"], units["axis.viscous_friction"]) == (inertia, friction)
    slides = gear == 1.0
    assert (units["axis.coulomb_friction"], units["axis.torque_offset"]) == (("N", "N") if slides else ("N m", "N m"))
    assert units["friction.smoothing"] == ("m/s" if slides else "rad/s")
    assert jr.parameter_unit(robot, "axis", "stiffness") == "N/m"
    assert jr.parameter_unit(robot, "axis", "gear_ratio") == ("1" if slides else "rad/m")
