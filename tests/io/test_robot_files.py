"""Robots from and to files: TOML, URDF, MJCF; every wrong key gets its message."""

import copy
import tomllib
import xml.etree.ElementTree as ET

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco_reference import MuJoCoRobot

import jaxfrf.robot as jr
from jaxfrf import InputError
from jaxfrf.effects import Backlash, TorqueDelay
from jaxfrf.io.mjcf import mjcf, write_mjcf
from jaxfrf.io.robots import read_robot, toml_text, write_robot
from jaxfrf.io.urdf import read_urdf


def same(a, b):
    return jax.tree.structure(a) == jax.tree.structure(b) and all(
        np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    )


@pytest.fixture
def table():
    return jr.table_from_robot(jr.r3x())


class TestToml:
    def test_r3x(self):
        robot = jr.r3x()
        assert robot.name == "R3X" and robot.sampling_frequency == 2000.0
        assert robot.axis_names == tuple(f"joint{i}" for i in range(1, 7))
        assert robot.spring_names == (*robot.axis_names, "bearing2", "upper_arm_torsion")
        assert (robot.n_axes, robot.n_motors, robot.n_elastic, robot.dof) == (6, 6, 2, 14)
        np.testing.assert_array_equal(robot.drives.gear_ratio, [105, 210, 60, 99, 79.2, 99])
        np.testing.assert_array_equal(robot.springs.stiffness, [5e5, 3.7e5, 2.2e5, 3e4, 2.5e4, 1.2e4, 6e5, 4e5])
        low = robot.springs.stiffness * robot.springs.stiffness_ratio
        np.testing.assert_allclose(low, [3e5, 2.22e5, 1.32e5, 3e4, 2.5e4, 1.2e4, 6e5, 4e5], rtol=1e-15)
        np.testing.assert_array_equal(robot.drives.friction.coulomb, [0.4, 0.5, 0.7, 0.06, 0.07, 0.025])
        np.testing.assert_array_equal(robot.drives.torque_limit, [10.45, 10.45, 10.45, 2.1, 2.3, 0.76])
        assert robot.drives.friction.smoothing == 0.2
        assert robot.controller.position_gain == 5.0 and robot.controller.integral_time == 0.05
        assert robot.controller.feedforward
        np.testing.assert_array_equal(robot.controller.velocity_gain, [0.26, 0.2, 0.51, 0.02, 0.024, 0.0049])
        assert robot.chain.mass.sum() == 1 + 56.5 + 26.4 + 28.7 + 5.2 + 10

    def test_round_trip(self, tmp_path, table):
        table["effect"] = [
            {"name": "torque_ripple", "joint": "joint2", "amplitude": [0.03, 0.02], "order": [1, 2]},
            {"name": "torque_delay", "joint": "joint4", "delay": 3e-4},
            {"name": "backlash", "joint": "joint5", "gap": 1e-4},
        ]
        table["controller"] |= {"feedforward": False, "integral_time": np.inf}
        table["joint"][0]["stiffness"] = table["joint"][3]["stiffness"] = np.inf
        for key in ("stiffness_low", "stiffness_knee"):
            del table["joint"][0][key]
        robot = jr.robot_from_table(table)
        assert robot.effects[0].name == "torque_ripple" and robot.effects[0].order == (1, 2)
        assert robot.effects[1].delay == 3e-4 and robot.springs.backlash[3] == 1e-4
        write_robot(tmp_path / "robot.toml", robot)
        assert same(read_robot(tmp_path / "robot.toml"), robot)
        write_robot(tmp_path / "robot.toml", jr.r3x())
        assert same(read_robot(tmp_path / "robot.toml"), jr.r3x())
        assert [path.name for path in tmp_path.iterdir()] == ["robot.toml"]

    def test_nothing_half_written(self, tmp_path, monkeypatch):
        path = tmp_path / "robot.toml"
        path.write_text("kept")
        monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
        with pytest.raises(OSError, match="disk full"):
            write_robot(path, jr.r3x())
        assert [p.name for p in tmp_path.iterdir()] == ["robot.toml"] and path.read_text() == "kept"

    def test_one_joint_and_no_controller(self, table):
        joint = table["joint"][0]
        small = jr.robot_from_table({"gravity": [0.0, 0.0, 0.0], "joint": [joint]})
        assert small.controller is None and small.dof == 2

    def test_rigid_joint_has_no_stiffness_to_identify(self, table):
        table["joint"][0]["stiffness"] = np.inf
        names = jr.parameters(jr.robot_from_table(table))
        assert "joint1.stiffness" not in names and "joint2.stiffness" in names


def changed(table, path, value):
    """A deep copy with the entry at `path` set, or removed where the value is None."""
    table = copy.deepcopy(table)
    inner = table
    for key in path[:-1]:
        inner = inner[key]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return table


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("gravitiy",), 1.0, r"R.toml: found the unknown key 'gravitiy'.*Did you mean 'gravity'\?"),
        (("joint", 1, "stifness"), 1.0, r"'joint2': found the unknown key 'stifness'.*mean 'stiffness'\?"),
        (("joint", 2, "gear_ratio"), 9.0, r"joint 'bearing2': found the unknown key 'gear_ratio'"),
        (("controller", "integral"), 1.0, r"\[controller\]: found the unknown key 'integral'.*_time"),
        (("friction", "smooth"), 1.0, r"\[friction\]: found the unknown key 'smooth'.*'smoothing'"),
        (("joint", 0, "mass"), None, r"joint 'joint1': mass: found nothing; expected a number, 0 or more"),
        (("joint", 0, "motor_inertia"), None, r"joint 'joint1': motor_inertia: found nothing"),
        (("joint", 0, "velocity_gain"), None, r"joint 'joint1': velocity_gain: found nothing"),
        (("controller", "position_gain"), None, r"\[controller\]: position_gain: found nothing"),
        (("joint", 0, "mass"), "heavy", r"mass: found 'heavy'; expected a number"),
        (("joint", 0, "mass"), True, r"mass: found True; expected a number"),
        (("joint", 0, "mass"), -1.0, r"mass: found -1.0; expected a number, 0 or more"),
        (("joint", 0, "mass"), float("nan"), r"mass: found nan"),
        (("joint", 0, "stiffness"), 0.0, r"stiffness: found 0.0; expected a positive number"),
        (("joint", 0, "damping"), float("inf"), r"damping: found inf; expected a number, 0 or more, finite"),
        (("joint", 0, "com"), [0.0, 1.0], r"com: found \[0.0, 1.0\]; expected a list of 3 finite numbers"),
        (("joint", 0, "axis"), [0.0, 2.0, 0.0], r"axis: found .*; expected a vector of length 1"),
        (("joint", 0, "inertia"), [1.0, 1.0, -1.0, 0.0, 0.0, 0.0], r"inertia: .*positive tensor"),
        (("joint", 0, "type"), "prismatic", r"type: found 'prismatic'; expected \"driven\" or \"elastic\""),
        (("joint", 0, "type"), None, r"joint 'joint1': type: found nothing"),
        (("joint", 0, "gear_ratio"), 0.0, r"gear_ratio: found 0.0"),
        (("joint", 0, "stiffness_knee"), None, r"stiffness_knee: found nothing"),
        (("joint", 0, "name"), "joint2", r"two joints named 'joint2'"),
        (("joint", 0, "name"), 7, r"name: found 7; expected a text"),
        (("joint",), [], r"joint: found none"),
        (("joint",), {"mass": 1.0}, r"joint: found .*\[\[joint\]\] tables"),
        (("controller", "feedforward"), "yes", r"feedforward: found 'yes'; expected true or false"),
        (("controller",), 3.0, r"\[controller\]: found 3.0; expected a table"),
        (("effect",), [{"name": "coulomb_friction", "joint": "jiont3"}], r"joint: found 'jiont3'.*'joint3'"),
        (("effect",), [{"joint": "joint3"}], r"effect 1: name: found nothing"),
        (("effect",), [{"name": "torque_delay", "joint": "joint1", "delay": "long"}], r"effect 1: delay: found 'long'"),
        (("effect",), [{"name": "delay", "joint": "joint1"}], r"effect 1: name: found 'delay'.*'torque_delay'"),
        (("effect",), [{"name": "torque_delay", "joint": "joint1"}], r"effect 1: delay: found nothing"),
        (("effect",), [{"name": "torque_delay", "delay": 1e-4}], r"effect 1: joint: found nothing"),
        (("effect",), [{"name": "torque_delay", "joint": "joint1", "delay": [1e-3]}], r"found \[0.001\]; .* a number"),
        (("effect",), [{"name": "payload", "mass": 1.0, "place": 0.1}], r"effect 1: place: found 0.1; .*list of 3 num"),
        (("effect",), [{"name": "sensor_delay", "joint": "joint3", "delay": -1}], r"delay: found -1; .*, 0 or more"),
        (("effect",), [{"name": "encoder_quantisation", "joint": "joint3", "resolution": 0}], r"0; .* above 0 \(rad"),
        (("effect",), [{"name": "torque_ripple", "joint": "joint3", "amplitude": 1, "order": 1.5}], r"1.5; .* whole"),
        (("effect",), [{"name": "payload", "mass": -30.0}], r"with its effects: joint6.mass: found -20.0"),
        (("effect",), [{"name": "viscous_friction", "joint": "joint3", "coefficient": -1}], r"friction: found -0.99"),
        (("effect",), [{"name": "payload", "mass": -3.0, "place": [0.5] * 3}], r"joint6.inertia: .* a positive tensor"),
        (("effect",), [{"name": "payload", "mas": 1.0}], r"effect 1: found the unknown key 'mas'.*'mass'"),
    ],
)  # fmt: skip
def test_wrong_tables(table, path, value, message):
    with pytest.raises(InputError, match=f"(?s)R.toml.*{message}" if "R.toml" not in message else message):
        jr.robot_from_table(changed(table, path, value), "R.toml")


def test_no_toml(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text("name = R3X")
    with pytest.raises(InputError, match=r"robot.toml: found .*expected a robot in TOML"):
        read_robot(path)


def test_toml_text_is_toml():
    table = {
        "name": 'a "b" \\ ü',
        "x": 1e-300,
        "flag": True,
        "rows": [{"v": [1.0, float("inf")]}, {"v": []}],
        "t": {"k": 1},
    }
    assert tomllib.loads(toml_text(table)) == table


class TestParameters:
    def test_names(self):
        robot = jr.r3x()
        assert len(jr.parameters(robot)) == 16
        assert jr.parameters(robot, ["mass"])["joint6.mass"] == 10.0
        heavier = jr.with_parameters(robot, {"joint6.mass": 12.0, "bearing2.damping": 5.0})
        assert heavier.chain.mass[7] == 12.0 and heavier.springs.damping[6] == 5.0 and robot.chain.mass[7] == 10.0

    def test_unknown(self):
        with pytest.raises(InputError, match=r"'joint1.stifness'.*Did you mean 'joint1.stiffness'"):
            jr.with_parameters(jr.r3x(), {"joint1.stifness": 1.0})
        with pytest.raises(InputError, match=r"bearing2\.gear_ratio"):
            jr.with_parameters(jr.r3x(), {"bearing2.gear_ratio": 1.0})
        with pytest.raises(InputError, match="kind of parameter: found 'stifness'"):
            jr.parameters(jr.r3x(), ["stifness"])


URDF = """<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2" rpy="0.3 0 0"/><mass value="4"/>
    <inertia ixx="0.05" ixy="0.002" ixz="0.001" iyy="0.06" iyz="-0.003" izz="0.02"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
  <link name="tool"><inertial><origin xyz="0 0.02 0.05" rpy="0 0.4 0.1"/><mass value="0.7"/>
    <inertia ixx="0.002" ixy="0" ixz="0.0003" iyy="0.003" iyz="0" izz="0.0025"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 0 0.5"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.05 0 0.4" rpy="0.2 -0.7 0.1"/><axis xyz="0 0.6 0.8"/></joint>
  <joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/>
    <origin xyz="0.25 0 0.03" rpy="1.1 0.2 -0.4"/></joint>
</robot>"""

DRIVES = """
[[joint]]
name = "shoulder"
gear_ratio = 100.0
motor_inertia = 1e-4
stiffness = 1e4
damping = 3.0
[[joint]]
name = "elbow"
gear_ratio = 80.0
motor_inertia = 5e-5
stiffness = inf
"""


class TestURDF:
    @pytest.fixture
    def files(self, tmp_path):
        urdf, drives = tmp_path / "two.urdf", tmp_path / "two.toml"
        urdf.write_text(URDF)
        drives.write_text(DRIVES)
        return urdf, drives

    @pytest.mark.parametrize("elbow", ["continuous", "prismatic"])
    def test_links(self, files, elbow):
        """Turned frames, inertial frames and a fixed tool, against MuJoCo reading the same URDF."""
        files[0].write_text(URDF.replace("continuous", elbow))
        robot = read_urdf(*files)
        assert jr.robot_from_table(jr.table_from_robot(robot)).chain.slides == robot.chain.slides
        assert robot.chain.sliding.tolist() == [0.0, float(elbow == "prismatic")]
        assert robot.name == "two" and robot.axis_names == ("shoulder", "elbow") and robot.n_motors == 1
        model = mujoco.MjModel.from_xml_path(str(files[0]))
        data = mujoco.MjData(model)
        rng = np.random.default_rng(0)
        for _ in range(20):
            q, rate, acceleration = rng.uniform(-3, 3, (3, 2))
            data.qpos[:], data.qvel[:], data.qacc[:] = q, rate, acceleration
            mujoco.mj_inverse(model, data)
            ours = jr.inverse_dynamics(robot.chain, q, rate, acceleration)
            np.testing.assert_allclose(ours, data.qfrc_inverse, rtol=1e-9, atol=1e-10)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ('type="revolute"', 'type="planar"', "joint 'shoulder': found type 'planar'"),
            ('<parent link="upper"/>', '<parent link="base"/>', "link 'base': found 2 joints that move"),
            (
                '<axis xyz="0 0.6 0.8"/>',
                '<axis xyz="0 0.6 0.8"/><mimic joint="shoulder"/>',
                "joint 'elbow': found one that follows joint 'shoulder'",
            ),
            (
                '<parent link="upper"/>',
                '<parent link="uper"/>',
                "joint 'elbow': found the parent link 'uper'",
            ),
            ('<mass value="4"/>', "", "link 'upper': found an <inertial> without"),
            ("</inertial></link>", "</inertial><inertial/></link>", "link 'upper': found 2 <inertial>"),
            ('ixx="0.05"', 'ixx="0.5"', "link 'upper': inertia: found principal moments .* and 0.5"),
            (
                "</robot>",
                '<link name="end"/><joint name="wrist" type="revolute"><parent link="tool"/><child link="end"/></joint>'
                "</robot>",
                "link 'end': found no mass that joint 'wrist' moves",
            ),
            ('<mass value="4"/>', '<mass value="four"/>', "link 'upper': mass: found 'four'"),
            ('xyz="0 0 0.3"', 'xyz="0 0"', "xyz: found '0 0'; expected 3 finite numbers"),
            ("</robot>", "", "two.urdf: found .*expected an XML file"),
            ("</joint>", '<limit lower="2" upper="1"/></joint>', "limit: found lower '2', upper '1'"),
            ('name="elbow"', 'name="knee"', "joint 'elbow': found a joint that the URDF does not move"),
        ],
    )
    def test_wrong_urdf(self, files, old, new, message):
        files[0].write_text(URDF.replace(old, new))
        with pytest.raises(InputError, match=message):
            read_urdf(*files)

    def test_dynamics(self, files):
        """Friction of a joint, of the arm: the power that it takes is the motors'; what the TOML states goes before."""
        dynamics = '<axis xyz="0 0.6 0.8"/><dynamics damping="1.6" friction="4"/>'
        files[0].write_text(URDF.replace('<axis xyz="0 0.6 0.8"/>', dynamics))
        friction, rate = read_urdf(*files).drives.friction, np.array([0.3, 0.3])
        motor = rate * np.array([100.0, 80.0])
        power = friction.torque(motor) * motor
        np.testing.assert_allclose(power, [0.0, (1.6 * 0.3 + 4.0) * 0.3], rtol=1e-9)
        files[1].write_text(DRIVES + "coulomb_friction = 0.2\n")
        assert read_urdf(*files).drives.friction.coulomb[1] == 0.2

    def test_limits(self, files):
        limited = '<axis xyz="0 0.6 0.8"/><limit lower="-1" upper="2" effort="9" velocity="1"/>'
        files[0].write_text(URDF.replace('<axis xyz="0 0.6 0.8"/>', limited))
        assert read_urdf(*files).limits == ((-np.inf, np.inf), (-1.0, 2.0))
        files[1].write_text(DRIVES + "limits = [-0.5, 0.5]\n")
        assert read_urdf(*files).limits[1] == (-0.5, 0.5)

    def test_wrong_drives(self, files):
        files[1].write_text(DRIVES.split('[[joint]]\nname = "elbow"')[0])
        with pytest.raises(InputError, match=r"found no \[\[joint\]\] named 'elbow'"):
            read_urdf(*files)
        files[1].write_text(DRIVES + "mass = 3.0\n")
        with pytest.raises(InputError, match="joint 'elbow': found mass, which the URDF states"):
            read_urdf(*files)
        files[1].write_text(DRIVES + "gear = 3.0\n")
        with pytest.raises(InputError, match=r"unknown key 'gear'.*'gear_ratio'"):
            read_urdf(*files)


class TestMJCF:
    def test_file(self, tmp_path):
        robot = jr.with_parameters(jr.r3x(), {n: 1.0 for n in jr.parameters(jr.r3x(), ["stiffness_ratio"])})
        write_mjcf(tmp_path / "r3x.xml", robot)
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "r3x.xml"))
        assert model.nq == 14 and model.nu == 6 and model.ntendon == 6
        np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], robot.drives.torque_limit)

    def test_friction(self):
        robot = jr.with_parameters(jr.r3x(), {n: 1.0 for n in jr.parameters(jr.r3x(), ["stiffness_ratio"])})
        model = mujoco.MjModel.from_xml_string(mjcf(robot))
        motors = [model.joint(f"motor:{name}").dofadr[0] for name in robot.axis_names]
        np.testing.assert_allclose(model.dof_frictionloss[motors], robot.drives.friction.coulomb)
        np.testing.assert_allclose(model.dof_damping[motors], robot.drives.friction.viscous)

    def test_rigid_and_massless(self, table):
        """A rigid transmission, a locked elastic joint and a massless link with an offset, against MuJoCo."""
        table["joint"][0]["stiffness"] = table["joint"][2]["stiffness"] = np.inf
        for i in (0, 1, 4):
            for key in ("stiffness_low", "stiffness_knee"):
                table["joint"][i].pop(key, None)
        table["joint"][1]["offset"] = [0.1, 0.05, -0.2]
        table["joint"][2]["offset"] = [0.0, 0.03, 0.04]
        robot = jr.robot_from_table(table)
        reference = MuJoCoRobot(robot)
        rng = np.random.default_rng(0)
        for _ in range(20):
            z, rate = rng.uniform(-3, 3, (2, robot.dof))
            np.testing.assert_allclose(jr.inertia(robot, z), reference.mass_matrix(z), rtol=1e-8, atol=1e-8)
            _, bias = jr.arm_inertia_and_bias(robot, z[robot.n_motors :], rate[robot.n_motors :])
            np.testing.assert_allclose(bias, reference.bias(z, rate)[robot.n_motors :], rtol=1e-8, atol=1e-8)

    def test_what_mujoco_cannot_do(self, table):
        with pytest.raises(InputError, match="springs: found nonlinear ones"):
            mjcf(jr.r3x())
        linear = jr.with_parameters(jr.r3x(), {n: 1.0 for n in jr.parameters(jr.r3x(), ["stiffness_ratio"])})
        with pytest.raises(InputError, match=r"R3X: effects: found torque_delay; .* effects=\(\)\)"):
            mjcf(linear.with_effects(TorqueDelay(0, 1e-4), TorqueDelay(1, 1e-4)))
        with pytest.raises(InputError, match="springs: found play"):
            mjcf(linear.with_effects(Backlash(0, 1e-4)))
        with pytest.raises(InputError, match="joint6: found a massless link at the tip"):
            mjcf(jr.with_parameters(linear, {"joint6.mass": 0.0, "joint6.inertia": jnp.zeros(6)}))
        with pytest.raises(InputError, match="joint6: found mass 10 kg and principal inertias"):
            mjcf(jr.with_parameters(linear, {"joint6.inertia": jnp.array([1.0, 1.0, 3.0, 0, 0, 0])}))
        assert ET.fromstring(mjcf(linear)).get("model") == "R3X"
