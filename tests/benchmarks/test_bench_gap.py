"""The benchmark of hidden effects: its cases, its second simulator, and its scores against numbers found by hand."""

import collections
import dataclasses
import json
import math
import types

import _hidden_cases
import bench_gap
import jax.random as jr
import numpy as np
import pytest
import scipy.integrate
from _gap_picture import draw
from _gap_score import Judged, found, load, rate, report, score, summary
from _hidden_cases import CLASSES, cases, make, nominal_robot
from _hidden_effects import JOINTS, MAIN, Hidden, kind_of
from _mujoco_loop import Bristles
from _mujoco_records import mujoco_experiment
from _outside_effects import OUTSIDE, Bumper, GainDrift, PreslidingFriction

import jaxfrf as jf
from jaxfrf import effects

KEY = jr.key(3)


def short_design(period=1000):
    slow = jf.SlowSine([1, 2, 3, 1, 2, 3], [20.0, 20.0, 20.0, 30.0, 30.0, 30.0])
    rms = [2.0, 2.0, 2.0, 4.0, 4.0, 6.0]
    return jf.Multisine(2000.0, period, np.arange(5, 5 + period // 50, 2), rms=rms, slow=slow)


def relative(found, expected):
    """Largest relative rms of any channel."""
    rms = lambda x: np.sqrt(np.mean(x**2, axis=(0, 1, 2)))
    return np.max(rms(found - expected) / rms(expected))


def test_truth_keeps_a_parameter_called_level():
    """Coulomb friction has a parameter of the name that the truth gives to how visible an effect is."""
    described = _hidden_cases._described(effects.CoulombFriction("joint2", 0.03), Hidden("coulomb", "joint2", 2.0), 2.1)
    assert described["parameters"] == {"level": 0.03}
    assert (described["level"], described["drawn_level"], described["joint"]) == (2.1, 2.0, "joint2")


@pytest.mark.parametrize(("part", "counts"), [("tune", (8, 16, 4, 4)), ("report", (16, 30, 8, 10))])
def test_cases(part, counts):
    every = cases(part)
    assert every == cases(part)
    assert [case.number for case in every] == list(range(len(every)))
    kinds = collections.Counter(case.kind for case in every)
    assert tuple(kinds[kind] for kind in ("none", "single", "double", "outside")) == counts
    for kind in kinds:
        by = collections.Counter(case.simulator for case in every if case.kind == kind)
        assert by["jaxfrf"] == by["mujoco"]
    inside = collections.Counter(h.name for case in every for h in case.hidden if h.name in MAIN)
    assert set(inside) == set(MAIN) == set(effects.library()) - {"sensor_delay", "elastic_load"}  # of other records
    assert max(inside.values()) - min(inside.values()) <= 1
    outside = {h.name for case in every for h in case.hidden if h.name not in MAIN}
    assert outside == set(OUTSIDE)
    levels = np.array([h.level for case in every for h in case.hidden])
    assert levels.min() >= 1.0 and levels.max() <= 8.0
    assert np.median(np.log(levels)) == pytest.approx(0.5 * math.log(8.0), abs=0.2)
    for case in every:
        names = [h.name for h in case.hidden]
        assert len(names) == {"none": 0, "single": 1, "outside": 1, "double": 2}[case.kind]
        assert all(h.joint in JOINTS[h.name] for h in case.hidden)
        assert not any(set(names) <= set(alike) for alike in CLASSES if len(names) == 2)
        assert "presliding_friction" not in names or case.simulator == "mujoco"


def test_machines_are_what_they_are_said_to_be():
    """Within their tolerances, different from case to case, and the nominal robot knows the payload only."""
    a, b = cases("tune")[:2]
    robot, other = nominal_robot(a), nominal_robot(b)
    assert 4.0 <= float(robot.chain.mass[-1]) <= 13.0 and robot.chain.mass[-1] != other.chain.mass[-1]
    np.testing.assert_array_equal(robot.chain.mass[:-1], jf.robot.r3x().chain.mass[:-1])
    assert robot.effects == ()
    machine = _hidden_cases.disturbed(robot, np.random.default_rng(1))
    for kind, most in (("stiffness", 0.03), ("mass", 0.01), ("inertia", 0.01), ("motor_inertia", 0.005)):
        values = jf.robot.parameters(machine, [kind])
        off = [np.ravel(x / jf.robot.parameters(robot, [kind])[n] - 1.0)[np.ravel(x) != 0.0] for n, x in values.items()]
        size = np.abs(np.concatenate(off))
        assert 0.3 * most < size.max() <= most * (1 + 1e-9)
    np.testing.assert_array_equal(machine.springs.stiffness_ratio, robot.springs.stiffness_ratio)
    assert len(np.unique([_hidden_cases.design(case).lines[:40] for case in (a, b)], axis=0)) == 2


def test_hidden_effects_stay_inside_bounds():
    """At every level and joint; and ripple is not of an order at which a search would start."""
    robot = nominal_robot(cases("tune")[0])
    around = _hidden_cases._around(cases("tune")[0], robot)
    around = dataclasses.replace(around, largest_torque=lambda: np.ones(6))
    for name, joints in JOINTS.items():
        for joint in joints:
            for level in (1.0, 8.0):
                hidden = _hidden_cases.Hidden(name, joint, level)
                effect, played = _hidden_cases.hidden_effect(robot, hidden, around, np.random.default_rng(5))
                assert 0.9 < played <= level * (1 + 1e-9)
                for key, (low, high) in kind_of(name).bounds.items():
                    value = getattr(effect, key)
                    value = low if value is None else np.asarray(value)
                    assert np.all((value >= low) & (value <= high)), (name, key)
                if name.endswith("ripple"):
                    assert not set(effect.order) & {1, 2, 6, 18} or name == "resolver_ripple"
                    assert not set(effect.order) & set(effects.library()[name].typical(robot, joint).order)


def test_what_is_written(tmp_path, monkeypatch):
    """A diagnosis finds a record and the nominal robot, and nothing else; what is there is kept."""
    monkeypatch.setattr(_hidden_cases, "design", lambda case: short_design(500))
    monkeypatch.setattr(_hidden_cases, "positions", lambda case: jf.random_positions(1, KEY))
    monkeypatch.setattr(_hidden_cases, "RUN_IN", 0.2)
    monkeypatch.setattr(_hidden_cases, "_CLIPPED", 2.0)  # so short a run accelerates much
    case = next(c for c in cases("tune") if c.hidden and c.hidden[0].name == "presliding_friction")
    make(case, tmp_path)
    place = tmp_path / "cases" / case.name
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == sorted(
        ["data.nc", "robot.toml", f"{case.name}.json"]
    )
    assert sorted(path.name for path in place.iterdir()) == ["data.nc", "robot.toml"]
    truth = json.loads((tmp_path / "truth" / f"{case.name}.json").read_text())
    assert truth["kind"] == "outside" and truth["simulator"] == "mujoco"
    assert truth["effects"][0]["parameters"]["distance"] == pytest.approx(0.1 * case.hidden[0].level)
    text = (place / "robot.toml").read_text()
    assert "effect" not in text and "presliding" not in text
    data, robot = jf.io.read(place / "data.nc"), jf.io.read_robot(place / "robot.toml")
    assert data.u.shape == (1, 6, 500, 6) and data.u.dtype == np.float64 and data.period == 500
    np.testing.assert_array_equal(robot.springs.stiffness, jf.robot.r3x().springs.stiffness)
    before = (place / "data.nc").stat().st_mtime_ns
    make(case, tmp_path)
    assert (place / "data.nc").stat().st_mtime_ns == before


@pytest.mark.slow
def test_two_simulators_agree():
    """Effects inside gears, a drifting gain and a bumper, by laws written twice; each is seen on its own motor."""
    smooth, plan, q = jf.robot.r3x(), short_design(600), jf.random_positions(1, KEY)
    smooth = jf.robot.with_parameters(smooth, dict.fromkeys(jf.robot.parameters(smooth, ["coulomb_friction"]), 0.0))
    robot = smooth.with_effects(
        effects.TransmissionError(0, [1e-4, 5e-5], 233.0, (1, 2), [0.3, 1.0]),
        effects.StructuralDamping(1, 0.05),
        effects.GearHysteresis(2, 30.0, 1e-4),
        GainDrift(3, 0.2, 0.3, 0.3),
        effects.WristCoupling(4, 0.05),
        Bumper(5, float(q[0, 5] + 0.002), 1.0, 1e3),
    )
    play = lambda robot: mujoco_experiment(robot, plan, q, seed=0, run_in=0.3, noise=0.0, ripple=None, substeps=4)
    found, plain = play(robot), play(smooth)
    ours = jf.simulate(robot, plan, q, key=KEY, run_in=0.3, noise=0.0, steps=8)
    assert relative(found.u, ours.u) < 5e-5
    assert relative(np.diff(found.y, axis=2), np.diff(ours.y, axis=2)) < 2e-5
    assert all(relative(found.u[..., i : i + 1], plain.u[..., i : i + 1]) > 0.01 for i in range(6))


@pytest.mark.slow
def test_presliding_friction():
    """The bristles against SciPy's integration of the law; in a run they take the place of Coulomb friction."""
    level, distance, damping, step = 0.4, 0.3, 0.01, 1e-3
    speed = lambda t: 3.0 * np.sin(7.0 * t)
    slope = lambda t, z: speed(t) - abs(speed(t)) * z / distance
    time = np.arange(2000) * step
    exact = scipy.integrate.solve_ivp(slope, (0, 2.1), [0.0], t_eval=time + 0.5 * step, rtol=1e-9, atol=1e-12).y[0]
    expected = level / distance * exact + damping * slope(time + 0.5 * step, exact)
    bristles = Bristles(np.array([[0, level, distance, damping]]), 1)
    torque = np.array([bristles(np.array([[speed(t + 0.5 * step)]]), step)[0, 0] for t in time])
    np.testing.assert_allclose(torque, expected, atol=1e-3 * level)
    robot, plan, q = jf.robot.r3x(), short_design(600), jf.random_positions(1, KEY)
    play = lambda *effects: mujoco_experiment(
        robot.with_effects(*effects), plan, q, seed=0, run_in=0.2, noise=0.0, ripple=None
    )
    rigid = play()
    soft, hard = (relative(play(PreslidingFriction(0, d)).u[..., :1], rigid.u[..., :1]) for d in (0.3, 0.02))
    assert hard < 0.4 * soft and soft > 0.02


def test_interval():
    """Of Clopper and Pearson: at its ends the tails of the binomial hold 2.5 %."""
    tail = lambda p, n, ks: sum(math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in ks)
    nothing = rate([False] * 16)
    assert nothing["low"] == 0.0 and nothing["high"] == pytest.approx(1 - 0.025 ** (1 / 16))
    assert rate([True] * 5)["low"] == pytest.approx(0.025**0.2) and rate([True] * 5)["high"] == 1.0
    some = rate([True] * 3 + [False] * 7)
    assert (some["k"], some["n"], some["rate"]) == (3, 10, 0.3)
    assert tail(some["low"], 10, range(3, 11)) == pytest.approx(0.025)
    assert tail(some["high"], 10, range(4)) == pytest.approx(0.025)


def judged(kind, hidden, verdict, named, **more):
    """One made-up case; `hidden` of (name, joint, level, main parameter), `named` of (name, joint, more)."""
    simulator = more.pop("simulator", "jaxfrf")
    true = [
        {"name": name, "joint": joint, "level": level, "parameters": {MAIN.get(name, "x"): value}}
        for name, joint, level, value in hidden
    ]
    said = [{"name": name, "joint": joint, **rest} for name, joint, rest in named]
    truth = {"part": "tune", "number": 0, "kind": kind, "simulator": simulator, "effects": true}
    return Judged(truth, {"verdict": verdict, "effects": said, **more})


def estimate(name, value, std):
    return {"parameters": {MAIN[name]: {"value": value, "std": std, "unit": ""}}}


@pytest.fixture
def made_up():
    delay, coulomb = ("torque_delay", "joint2", 3.0, 1e-3), ("coulomb_friction", "joint1", 1.5, 0.2)
    single = lambda *rest, **more: judged("single", *rest, **more)
    right = [("coulomb_friction", "joint1", estimate("coulomb_friction", 0.22, 0.02))]
    return [
        single([coulomb], "named", right, wall_s=10.0),
        single([coulomb], "named", [("coulomb_friction", "joint4", {})], wall_s=30.0),
        single([coulomb], "unexplained", [("coulomb_friction", "joint1", {})], oracle=0.9, placebo=0.1, wall_s=20.0),
        single([delay], "ambiguous", [("current_loop_lag", "joint2", {})], gap={"shrink": 0.8}, simulator="mujoco"),
        single([delay], "named", [("viscous_friction", "joint2", {"equivalent": ["torque_delay joint2"]})]),
        single([delay], "named", [("viscous_friction", "joint2", {}), ("torque_delay", "joint2", {})]),
        single([("payload", "", 2.0, 1.0)], "named", [("payload", "joint6", estimate("payload", 0.8, 0.01))]),
        judged("double", [coulomb, delay], "named", [("torque_delay", "joint2", {}), *right]),
        judged("double", [coulomb, delay], "named", [("torque_delay", "joint2", {})], gap={"shrink": 0.4}),
        judged("none", [], "sufficient", []),
        judged("none", [], "ambiguous", [("torque_ripple", "joint1", {})]),
        judged("none", [], "inconclusive", []),
        judged("none", [], "unexplained", []),
        judged("outside", [("bumper", "joint3", 4.0, 1.0)], "unexplained", []),
        judged("outside", [("bumper", "joint3", 4.0, 1.0)], "named", [("backlash", "joint3", {})]),
        judged("outside", [("bumper", "joint3", 4.0, 1.0)], "inconclusive", []),
    ]


def test_scores(made_up):
    found_of = [len(found(case)) for case in made_up[:9]]
    assert found_of == [1, 0, 0, 1, 1, 1, 1, 2, 1]
    s = summary(made_up)
    k_of = lambda x: (x["k"], x["n"])
    assert {key: k_of(value) for key, value in s["single"].items()} == {
        "effect": (3, 7),  # coulomb twice, payload
        "class": (5, 7),  # and the lag, and what is called equivalent
        "effect_and_joint": (2, 7),
        "class_and_joint": (4, 7),
        "ranked_first": (0, 7),
    }
    assert {key: k_of(value) for key, value in s["single_clear"].items()} == {
        "effect": (1, 4),
        "class": (3, 4),
        "effect_and_joint": (1, 4),
        "class_and_joint": (3, 4),
        "ranked_first": (0, 4),
    }
    assert {key: k_of(value) for key, value in s["double"].items()} == {
        "both": (1, 2),
        "one_or_both": (2, 2),
        "effects": (3, 4),
    }
    assert k_of(s["false_alarm"]) == (1, 4) and s["false_alarm_ripple"] == 1
    assert k_of(s["outside_honest"]) == (1, 3) and k_of(s["outside_named"]) == (1, 3)
    assert k_of(s["abstained"]) == (1, 9) and k_of(s["abstained_clear"]) == (0, 4)
    assert s["superfluous"] == pytest.approx(2 / 8)
    assert s["shrink"]["named"]["median"] == pytest.approx(0.6) and s["shrink"]["named"]["low"] == pytest.approx(0.44)
    assert s["shrink"]["every"]["median"] == pytest.approx(0.4) and s["shrink"]["every"]["n"] == 3  # silence is 0
    assert s["shrink"]["oracle"]["median"] == 0.9 and s["shrink"]["placebo"]["n"] == 1
    assert s["parameter_error"]["n"] == 2 and s["parameter_error"]["median"] == pytest.approx(0.15)
    assert k_of(s["parameter_error"]["covered"]) == (1, 2)
    assert s["wall_s"]["median"] == 20.0 and s["wall_s"]["n"] == 3


def test_score_by_group_and_failures(made_up, tmp_path):
    scores = score(made_up)
    assert scores["simulator"]["mujoco"]["cases"] == 1 and scores["simulator"]["jaxfrf"]["cases"] == 15
    assert scores["confusion"] == {
        "coulomb_friction": {"coulomb_friction": 2, "unexplained": 1},
        "torque_delay": {"current_loop_lag": 1, "viscous_friction": 2},
        "payload": {"payload": 1},
        "none": {"sufficient": 1, "torque_ripple": 1, "inconclusive": 1, "unexplained": 1},
        "bumper": {"unexplained": 1, "backlash": 1, "inconclusive": 1},
    }
    failed = [(row["truth"], row["verdict"], row["named"]) for row in scores["failures"]]
    assert failed == [
        ("coulomb_friction joint1 1.5x", "named", "coulomb_friction joint4"),
        ("coulomb_friction joint1 1.5x", "unexplained", ""),
        ("torque_delay joint2 3.0x", "named", "viscous_friction joint2, torque_delay joint2"),
        ("coulomb_friction joint1 1.5x, torque_delay joint2 3.0x", "named", "torque_delay joint2"),
        ("", "ambiguous", "torque_ripple joint1"),
        ("bumper joint3 4.0x", "named", "backlash joint3"),
        ("bumper joint3 4.0x", "inconclusive", ""),
    ]
    text = report(scores)
    assert "3/7" in text and "torque_delay joint2 3.0x" in text
    draw(scores["confusion"], tmp_path / "confusion.png")
    assert (tmp_path / "confusion.png").stat().st_size > 1e4


def test_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """The diagnosis sees a folder without the truth; results are kept, errors are told and tried again."""
    chosen = [case for case in cases("tune") if case.kind in ("none", "single")][:3]
    seen = []

    def made(case, folder, processes):
        (folder / "cases" / case.name).mkdir(parents=True, exist_ok=True)
        (folder / "truth").mkdir(exist_ok=True)
        true = [{"name": h.name, "joint": h.joint, "level": h.level, "parameters": {}} for h in case.hidden]
        truth = {"part": "tune", "number": case.number, "kind": case.kind, "simulator": case.simulator, "effects": true}
        (folder / "truth" / f"{case.name}.json").write_text(json.dumps(truth))

    class Looked:
        """A diagnosis that fails once."""

        def __init__(self, place):
            seen.append(place)
            if len(seen) == 2:
                raise ValueError("no")
            self.found = types.SimpleNamespace(effects=(), gap=types.SimpleNamespace(shrink=0.0))
            self.robot = None

        def shrink(self, effects):
            return 0.5

        linear_shrink = shrink

    monkeypatch.setattr(bench_gap, "make", made)
    monkeypatch.setattr(bench_gap, "Looked", Looked)
    monkeypatch.setattr(bench_gap, "gap_contents", lambda found: {"verdict": "sufficient", "effects": []})
    monkeypatch.setattr(bench_gap, "_hidden", lambda effect: None)
    monkeypatch.setattr(bench_gap, "_others", lambda case, robot: [])
    bench_gap.run(chosen, tmp_path)
    assert seen == [tmp_path / "cases" / case.name for case in chosen]
    assert not any("truth" in str(path.relative_to(tmp_path)) for path in seen)
    verdicts = lambda: [case.result["verdict"] for case in load(tmp_path)]
    assert verdicts() == ["sufficient", "failed", "sufficient"]
    bench_gap.run(chosen, tmp_path)
    assert len(seen) == 4 and seen[3] == seen[1] and verdicts() == ["sufficient"] * 3


def test_numbers():
    assert bench_gap._numbers("0-3,7") == {0, 1, 2, 3, 7}
