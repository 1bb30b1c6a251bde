"""Robots with rigid transmissions calibrated from real motions: EMPS and a Staubli TX40 with its coupled wrist.

With `pytest -s` the figures are printed.
"""

import argparse
import dataclasses
import shlex

import numpy as np
import pytest
from emps import COULOMB, MASS, NEWTON_PER_VOLT, OFFSET, VISCOUS, emps_record

import jaxfrf as jf
from jaxfrf.calibration import from_motion as fm
from jaxfrf.robot import robot_from_table, tolerances_from
from jaxfrf.robot.regressor import link_regressor

# --- EMPS


def emps_robot(inertia=80.0, viscous=300.0, coulomb=10.0):
    """Guesses of which nothing is known; N and m in the place of N m and rad, about the vertical."""
    joint = {
        "name": "axis",
        "type": "driven",
        "axis": [0.0, 0.0, 1.0],
        "offset": [0.0, 0.0, 0.0],
        "mass": 0.0,
        "com": [0.0, 0.0, 0.0],
        "inertia": [0.0] * 6,
        "gear_ratio": 1.0,
        "motor_inertia": inertia,
        "viscous_friction": viscous,
        "coulomb_friction": coulomb,
        "stiffness": np.inf,
    }
    table = {
        "name": "EMPS",
        "gravity": [0.0, 0.0, -9.81],
        "sampling_frequency": 1000.0,
        "joint": [joint],
        "friction": {"smoothing": 1e-4},
        "tolerance": {"rotors": "unknown", "friction": "unknown", "smoothing": 0, "torque_constant": 0},
    }
    return robot_from_table(table)


@pytest.mark.data
@pytest.mark.parametrize("guess", [(80.0, 300.0, 10.0), (40.0, 100.0, 60.0)])
def test_emps_published_values(measured, guess):
    found = jf.calibrate(emps_robot(*guess), emps_record(measured, "DATA_EMPS"))
    print(f"EMPS: {found.values}, torque missed {100 * found.missed_after[0]:.2f} %")
    assert found.converged
    kinds = ("motor_inertia", "viscous_friction", "coulomb_friction", "torque_offset")
    for kind, value in zip(kinds, (MASS, VISCOUS, COULOMB, OFFSET), strict=True):
        assert found.values[f"axis.{kind}"] == pytest.approx(value, rel=0.02), kind
        assert found.determined_by(f"axis.{kind}") == "data"
    assert NEWTON_PER_VOLT == 35.15


# --- TX40

RATIO = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
# What the data's own file states, arm side: friction, rotors times ratio squared.
VISCOUS_ARM, COULOMB_ARM = [8.05, 5.53, 1.97, 1.11, 1.86, 0.65], [7.14, 8.26, 6.34, 2.48, 3.03, 0.282]
ROTORS = [0.362, 0.362, 0.0988, 0.0313, 0.0468, 0.0105]
ZERO = [0.0, 16 * np.pi, -22.5 * np.pi, 0.0, 0.0, 0.0]  # readings at joint angles of zero


def drives():
    """The drive trains that the URDF does not state, as a user would write them."""
    lines = ["gravity = [0.0, 0.0, -9.81]", "sampling_frequency = 5000.0"]
    for i in range(6):
        size = abs(RATIO[i])
        lines += [
            "[[joint]]",
            f'name = "joint_{i + 1}"',
            f"gear_ratio = {RATIO[i]}",
            f"motor_inertia = {ROTORS[i] / size**2}",
            f"viscous_friction = {VISCOUS_ARM[i] / size**2}",
            f"coulomb_friction = {COULOMB_ARM[i] / size}",
            "stiffness = inf",
            f"zero = {ZERO[i]}",
        ]
    lines += ["[friction]", "smoothing = 1.0"]
    lines += ["[tolerance]", "links = 0.3", "rotors = 0.5", 'friction = "unknown"', "torque_constant = 0"]
    lines += ["[[effect]]", 'name = "wrist_coupling"', 'joint = "joint_6"', "ratio = 1.0"]
    return "\n".join(lines)


@pytest.fixture(scope="module")
def tx40(measured, tmp_path_factory):
    """The robot, and torque and motor angles."""
    folder = measured / "staubli_tx40"
    path = tmp_path_factory.mktemp("tx40") / "drives.toml"
    path.write_text(drives())
    robot = jf.io.read_urdf(folder / "tx40_mdh_modified.urdf", path)
    u, y = (np.loadtxt(folder / f"{n}.csv", delimiter=",", skiprows=1) for n in ("curr_data", "pos_read_data"))
    return robot, u, y


def in_parts(u, y, parts):
    shape = (parts, 1, len(u) // parts, 6)
    return jf.Experiment(u=u.reshape(shape), y=y.reshape(shape), fs=5000.0, y_quantity="position")


def least_squares(robot, rows, more=None):
    """Torque that plain least squares misses of all rows, and its coefficients: links, rotors, friction, offsets, and
    what `more` makes of the motor speeds, (sample, axis)."""

    def columns(r):
        sign = fm.thinned(r.motion, np.sign(r.motion.speed))
        signals = (r.acceleration, r.speed, sign, np.ones_like(sign))
        own = [signal[..., None] * np.eye(6) for signal in signals]
        if more is not None:
            own.append(fm.thinned(r.motion, more(r.motion.speed))[..., None])
        return np.concatenate([r.links, *own], axis=-1)

    X, y = (np.concatenate(x) for x in zip(*((columns(r), r.torque) for r in rows), strict=True))
    w = 1.0 / np.std(y, axis=0)
    theta = np.linalg.lstsq((X * w[:, None]).reshape(-1, X.shape[-1]), (y * w).ravel(), rcond=1e-9)[0]
    return lambda others: [r.torque - columns(r) @ theta for r in others]


@pytest.mark.data
@pytest.mark.slow
def test_tx40(tx40):
    """Beside plain least squares with the same filters: as good on all of it, better on what was not fitted.

    In the mean over axes, each over its own torque: 12.3 and 18.7 % (12.2 and 20.6-21 % are published beside the data).
    """
    robot, u, y = tx40
    whole = jf.calibrate(robot, in_parts(u, y, 1))
    assert whole.converged
    data = in_parts(u, y, 1)
    cutoff = fm.chosen_cutoff(data)
    rows = [fm.thinned_rows(robot, m, None) for m in fm.measured_motions(robot, data, cutoff)]
    ours = fm._all(rows, [r.torque - fm.needed(robot, whole.numbers, whole.x, r) for r in rows])
    plain = fm._all(rows, least_squares(robot, rows)(rows))

    halves = in_parts(u, y, 2)
    fitted = jf.calibrate(robot, halves, heldout=[1], cutoff=cutoff)
    first, second = ([fm.thinned_rows(robot, m, None)] for m in fm.measured_motions(robot, halves, cutoff))
    left = [r.torque - fm.needed(robot, fitted.numbers, fitted.x, r) for r in second]
    by_axis = [100 * np.sqrt(np.mean(x**2)) for x in (whole.missed_after, fitted.heldout[1])]
    ours_later, plain_later = fm._all(second, left), fm._all(second, least_squares(robot, first)(second))
    print(
        f"TX40, torque missed: whole record {100 * ours:.1f} % (least squares {100 * plain:.1f}), second half of a "
        f"calibration on the first {100 * ours_later:.1f} % ({100 * plain_later:.1f}); by axis {by_axis[0]:.1f} and "
        f"{by_axis[1]:.1f} %"
    )
    assert ours < 1.01 * plain and ours_later < plain_later
    assert by_axis[0] < 12.5 and by_axis[1] < 20.0


@pytest.mark.data
@pytest.mark.slow
def test_what_changes_between_the_halves_of_tx40(tx40):
    """Joint 6 has friction of its own behind the coupled gear, of the speed q6' where motor 6 turns by q5 + q6. A fit
    to the first half, where the wrist is fast and rotors and motors' friction are most of the torque, does not see it;
    in the second, slower one it is a third of what even a fit to that half alone misses."""
    robot, u, y = tx40
    halves = in_parts(u, y, 2)
    first, second = ([fm.thinned_rows(robot, m, None)] for m in fm.measured_motions(robot, halves, 50.0))

    def behind_the_gear(speed):
        return np.sign(speed[:, 5] / RATIO[5] - speed[:, 4] / RATIO[4])[:, None] * np.eye(6)[5]

    missed = {}
    for name, rows in (("first", first), ("second", second)):
        for more in (None, behind_the_gear):
            (left,) = least_squares(robot, rows, more)(rows)
            missed[name, more is not None] = 100 * np.sqrt(np.mean(left[:, 5] ** 2) / np.var(rows[0].torque[:, 5]))
    told = "; ".join(
        f"{name} half {missed[name, False]:.1f} %, with Coulomb friction of its own {missed[name, True]:.1f} %"
        for name in ("first", "second")
    )
    print(f"TX40, torque of axis 6 missed by least squares of each half: {told}")
    assert missed["first", True] > 0.9 * missed["first", False]
    assert missed["second", True] < 0.75 * missed["second", False]


# --- a motion of which everything is known

COUPLED = {
    "name": "arm",
    "gravity": [0.0, -9.81, 0.0],
    "sampling_frequency": 1000.0,
    "friction": {"smoothing": 0.5},
    "joint": [
        {
            "name": f"axis{i}",
            "type": "driven",
            "axis": [0.0, 0.0, 1.0],
            "offset": [0.4 * i, 0.0, 0.0],
            "mass": 5.0 - i,
            "com": [0.2, 0.02, 0.0],
            "inertia": [0.02, 0.2, 0.2, 0.0, 0.0, 0.0],
            "gear_ratio": 50.0,
            "motor_inertia": 2e-4,
            "viscous_friction": 2e-3,
            "coulomb_friction": 0.1,
            "stiffness": np.inf,
            "zero": 10.0 * i,
        }
        for i in range(2)
    ],
    "effect": [{"name": "wrist_coupling", "joint": "axis1", "ratio": 1.0}],
}


def test_a_simulated_rigid_arm():
    """Two coupled axes moved at will; torque by the textbook's chain, `link_regressor` against `mass_and_bias`."""
    true = robot_from_table(COUPLED)
    t = np.arange(8000) / 1000.0
    waves = lambda seed: sum(
        a * np.sin(2 * np.pi * f * t + p)
        for a, f, p in np.random.default_rng(seed).uniform([0.2, 0.2, 0], [0.6, 1.5, 6], (4, 3))
    )
    q = np.stack([waves(1), waves(2)], axis=-1)
    rate = np.gradient(q, 1e-3, axis=0)
    acceleration = np.gradient(rate, 1e-3, axis=0)
    M, bias = jf.robot.chain.mass_and_bias(true.chain, q, rate)
    arm = np.einsum("tij,tj->ti", np.asarray(M), acceleration) + np.asarray(bias)
    C = np.array([[1.0, 0.0], [1.0, 1.0]])
    motor, speed = 50 * q @ C.T + [0.0, 10.0], 50 * rate @ C.T
    u = arm @ np.linalg.inv(C) / 50 + 2e-4 * 50 * acceleration @ C.T + np.asarray(true.drives.friction.torque(speed))
    u = np.concatenate([0.5 * (u[1:] + u[:-1]), u[-1:]])  # of a command that is held: the mean about a sample acts
    rng = np.random.default_rng(3)
    u = u + [0.05, -0.03] + 0.02 * rng.standard_normal(u.shape)
    data = jf.Experiment(u=u, y=motor + 1e-5 * rng.standard_normal(u.shape), fs=1000.0, y_quantity="position")

    known = {"links": 0.1, "rotors": 0.2, "torque_constant": 0, "smoothing": 0}
    given = true.with_tolerances(tolerances_from(known, true.joint_names))
    start = {"axis0.mass": 5.4, "axis1.mass": 3.7, "axis0.coulomb_friction": 0.15, "axis1.motor_inertia": 1.8e-4}
    found = jf.calibrate(jf.robot.with_parameters(given, start), data)
    assert found.converged and np.all(found.missed_after < 0.1)
    for name, value in {
        "axis0.coulomb_friction": 0.1,
        "axis1.coulomb_friction": 0.1,
        "axis0.viscous_friction": 2e-3,
        "axis0.torque_offset": 0.05,
        "axis1.torque_offset": -0.03,
        "axis1.motor_inertia": 2e-4,
    }.items():
        low, high = found.interval(name)
        assert low < value < high and found.values[name] == pytest.approx(value, rel=0.1), name
    assert link_regressor(true.chain, q.T[:, :1], rate.T[:, :1], acceleration.T[:, :1]).shape == (2, 2, 10, 1)


# --- from a URDF and a CSV file, as the guide shows it

PENDULUM = """<robot name="pendulum">
<link name="base"/>
<link name="rod"><inertial><mass value="2.0"/><origin xyz="0.3 0 0"/>
<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="rod"/>
<origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint></robot>"""

DRIVES = """urdf = "pendulum.urdf"
sampling_frequency = 500.0
[[joint]]
name = "swing"
gear_ratio = 20.0
motor_inertia = 1e-4
viscous_friction = 1e-3
coulomb_friction = 0.03
stiffness = inf
[friction]
smoothing = 0.5
[tolerance]
friction = "unknown"
torque_constant = 0
"""


@pytest.fixture
def pendulum(tmp_path):
    """A folder with the robot and a motion of it: mass 2.2 kg, friction twice what the file says."""
    (tmp_path / "pendulum.urdf").write_text(PENDULUM)
    (tmp_path / "robot.toml").write_text(DRIVES)
    t = np.arange(6000) / 500.0
    waves = [(1.2, 0.35, 0.0), (0.5, 0.9, 1.0), (0.2, 2.1, 2.0)]
    q = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves)
    v = sum(a * 2 * np.pi * f * np.cos(2 * np.pi * f * t + p) for a, f, p in waves)
    a = -sum(a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * t + p) for a, f, p in waves)
    arm = (0.02 + 2.2 * 0.09) * a - 2.2 * 9.81 * 0.3 * np.cos(q)
    u = arm / 20 + 1e-4 * 20 * a + 2e-3 * 20 * v + 0.06 * np.tanh(20 * v / 0.5)
    u = np.append(0.5 * (u[1:] + u[:-1]), u[-1]) + 0.005 * np.random.default_rng(0).standard_normal(len(t))
    np.savetxt(tmp_path / "motion.csv", np.column_stack([u, 20 * q]), delimiter=",", header="tau,theta", comments="")
    return tmp_path


def test_from_a_urdf_and_a_csv(pendulum, monkeypatch, capsys):
    from jaxfrf.__main__ import main

    monkeypatch.chdir(pendulum)
    command = ["identify", "motion.csv", "--robot", "robot.toml", "--map", "u=tau,y=theta"]
    command += ["--set", "fs=500,y_quantity=position", "-o", "fit.json", "--report", "fit.html"]
    assert main([*command, "--robot-out", "found.toml"]) == 0, capsys.readouterr().err
    found = jf.io.read_fit("fit.json")["parameters"]
    for name, value in {"swing.coulomb_friction": 0.06, "swing.viscous_friction": 2e-3}.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.02) and found[name]["determined_by"] == "data"
    robot = jf.io.read_robot("found.toml")
    moment = float(robot.chain.mass[0]) * float(robot.chain.com[0, 0])
    assert moment == pytest.approx(2.2 * 0.3, rel=0.02)
    assert "swing.mass" in (pendulum / "fit.html").read_text()


@pytest.mark.slow
def test_a_record_in_two_files(pendulum, monkeypatch, capsys):
    """Calibrated and diagnosed as one; what is next reads it in the same way."""
    from jaxfrf.__main__ import main

    monkeypatch.chdir(pendulum)
    u, y = np.loadtxt("motion.csv", delimiter=",", skiprows=1, max_rows=3000).T
    np.savetxt("u.csv", u, header="tau in Nm", comments="")
    np.savetxt("y.csv", y, header="theta", comments="")
    command = ["identify", "u.csv", "y.csv", "--robot", "robot.toml", "-o", "fit.json", "--robot-out", "found.toml"]
    assert main(command) == 2
    assert '--map "u=u.csv:tau in Nm,y=y.csv:theta" joins these files.' in capsys.readouterr().err
    command += ["--map", "u=u.csv:tau in Nm,y=y.csv:theta", "--set", "fs=500,y_quantity=position", "--rounds", "2"]
    assert main(command) == 0, capsys.readouterr().err
    alone = jf.io.read_fit("fit.json")["parameters"]
    assert alone["swing.coulomb_friction"]["value"] == pytest.approx(0.06, rel=0.02)
    (_, told) = capsys.readouterr().out.splitlines()[-1].split("what is missing? ")
    program, *words = shlex.split(told)
    assert program == "jaxfrf" and words[words.index("--map") + 1] == "u=u.csv:tau in Nm,y=y.csv:theta"
    assert "'u=u.csv:tau in Nm,y=y.csv:theta'" in told and "--robot found.toml --map" in told
    assert main(words) == 0, capsys.readouterr().err
    assert jf.io.read_gap("gap.json")["verdict"] == "sufficient"


def test_two_files_are_calibrated_as_one_record(pendulum, monkeypatch):
    """And the payloads of a rigid robot are those of the record."""
    from jaxfrf import calibration
    from jaxfrf.__main__ import main

    monkeypatch.chdir(pendulum)
    u, y = np.loadtxt("motion.csv", delimiter=",", skiprows=1).T
    np.savez("u.npz", u=u)
    np.savez("y.npz", y=y)
    found = []

    def calibrate(robot, records, *, payloads, **more):
        found.append((records, payloads))
        raise jf.InputError("enough")

    monkeypatch.setattr(calibration, "calibrate", calibrate)
    command = ["identify", "u.npz", "y.npz", "--robot", "robot.toml", "-o", "fit.json"]
    assert main([*command, "--map", "u=u.npz:u,y=y.npz:y", "--set", "fs=500,y_quantity=position"]) == 2
    (((record,), payloads),) = found
    np.testing.assert_array_equal(record.u.ravel(), u)
    assert list(payloads) == [None]


def test_the_payload_of_a_record_in_two_files():
    from jaxfrf.cli.identify import _payloads

    said = [f"{name}.csv:mass={mass},place=0.3;0;0" for name, mass in (("y", 1.5), ("u", 2.0))]
    given = argparse.Namespace(data=["u.csv", "y.csv"], payload=said[:1])
    (carried,) = _payloads(given, 1)
    assert float(carried.mass) == 1.5
    assert [p and float(p.mass) for p in _payloads(given, 2)] == [None, 1.5]
    with pytest.raises(jf.InputError, match=r"--payload: found 2 of one record; expected one\."):
        _payloads(argparse.Namespace(data=given.data, payload=said), 1)


def test_a_wrist_that_a_diagnosis_refuses_is_not_sent_there(pendulum):
    from jaxfrf.cli.identify import _next

    robot = jf.io.read_robot(pendulum / "robot.toml")
    given = argparse.Namespace(data=["a b.csv"], robot="r.toml", robot_out=None, report=None, effects="own.py")
    vars(given).update(tolerance="links=0.1", map=None, set="fs=500", factor=None, anyway=True)
    record = jf.Experiment(np.ones(100), np.ones(100), 500.0, y_quantity="position")
    (asked,) = _next(given, [record], robot, True)
    assert asked == (
        "what is missing? jaxfrf diagnose 'a b.csv' --robot r.toml --effects own.py --tolerance links=0.1 "
        "--set fs=500 --anyway -o gap.json"
    )
    arm = robot_from_table(COUPLED)
    assert _next(given, [record], arm, True) == ["--report fit.html shows it"]
    with pytest.raises(jf.InputError, match=r"Calibrate it \(`jaxfrf identify`"):
        jf.diagnose(arm, dataclasses.replace(record, u=np.ones((1, 1, 100, 2)), y=np.ones((1, 1, 100, 2))))


def test_a_urdf_alone_says_too_little(pendulum, capsys):
    from jaxfrf.__main__ import main

    files = [str(pendulum / name) for name in ("motion.csv", "pendulum.urdf", "fit.json")]
    read = ["--map", "u=tau,y=theta", "--set", "fs=500,y_quantity=position"]
    assert main(["identify", files[0], "--robot", files[1], "-o", files[2], *read]) == 2
    assert "found no pendulum.toml beside it" in capsys.readouterr().err
    (pendulum / "robot.toml").write_text(DRIVES.replace("pendulum.urdf", "other.urdf"))
    assert main(["identify", files[0], "--robot", str(pendulum / "robot.toml"), "-o", files[2], *read]) == 2
    assert "other.urdf: found no such file" in capsys.readouterr().err


def test_positions_that_are_not_there(pendulum, capsys):
    from jaxfrf.__main__ import main

    command = [
        "identify",
        str(pendulum / "motion.csv"),
        "--robot",
        str(pendulum / "robot.toml"),
        "--map",
        "u=tau,y=theta",
    ]
    command += ["--set", "fs=500,y_quantity=position", "-o", str(pendulum / "fit.json"), "--heldout", "4"]
    assert main(command) == 2
    assert "heldout: found positions 4 of 1; expected some of 0 to 0" in capsys.readouterr().err
