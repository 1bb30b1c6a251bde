"""The benchmark of hidden effects: its cases, its second simulator, and its scores against numbers found by hand."""

import collections
import dataclasses
import json
import math
import types

import _hidden_cases
import _hidden_robots
import bench_gap
import jax.random as jr
import numpy as np
import pytest
import scipy.integrate
from _gap_estimates import errors
from _gap_kept import keep, kept
from _gap_picture import draw
from _gap_score import Judged, differences, found, load, rate, report, score, summary
from _hidden_cases import make
from _hidden_effects import MAIN, Hidden, hidden_effect, kind_of
from _hidden_plan import CLASSES, cases
from _hidden_robots import LOGS, OFF, PALLET, PLANTS, SMALL, background, given, logged, machine
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


def counts(some, *names):
    return collections.Counter(tuple(getattr(case, name) for name in names) for case in some)


@pytest.mark.parametrize(("part", "robots", "each"), [("tune", 2, (24, 36, 12, 12)), ("report", 3, (72, 108, 36, 36))])
def test_cases(part, robots, each):
    every = cases(part)
    assert every == cases.__wrapped__(part)
    assert [case.number for case in every] == list(range(len(every)))
    assert tuple(counts(every, "kind")[kind,] for kind in ("none", "single", "double", "outside")) == each
    cells = counts(every, "kind", "robot", "log", "simulator")
    assert len(cells) == 4 * robots * 3 * 2
    assert len({n for (kind, *_), n in cells.items() if kind == "none"}) == 1
    for name in {case.robot for case in every}:
        mine = [case for case in every if case.robot == name]
        inside = collections.Counter(h.name for case in mine for h in case.hidden if h.name in MAIN)
        assert set(inside) == {effect for effect in MAIN if PLANTS[name].joints_of(effect)}
        assert max(inside.values()) - min(inside.values()) <= 2
    assert {h.name for case in every for h in case.hidden} == {*MAIN, *OUTSIDE}
    for case in every:
        names, joints = [h.name for h in case.hidden], [h.joint for h in case.hidden]
        assert len(names) == {"none": 0, "single": 1, "outside": 1, "double": 2}[case.kind]
        assert all(h.joint in PLANTS[case.robot].joints_of(h.name) for h in case.hidden)
        assert len(set(joints)) == len(joints)
        assert not any(set(names) <= set(alike) for alike in CLASSES if len(names) == 2)
        assert "presliding_friction" not in names or case.simulator == "mujoco"
        assert "encoder_quantisation" not in names or case.log == "position"


def test_hidden_effects_are_of_the_library():
    """Not all of it: a new one need not be hidden."""
    library = effects.library()
    assert set(MAIN) <= set(library)
    assert all(main in library[name].units for name, main in MAIN.items())


def test_levels_are_even():
    levels = [case.hidden[0].level for case in cases("report") if case.kind == "single"]
    assert 1.0 <= min(levels) and max(levels) <= 8.0
    for some in (levels, levels[:20], levels[::3]):
        assert np.mean(np.log(some)) == pytest.approx(0.5 * math.log(8.0), abs=0.12)
    assert sum(level >= 2.0 for level in levels) >= 60


@pytest.mark.parametrize("some", [slice(36), slice(90), slice(0, None, 2), slice(1, None, 3), slice(2, None, 5)])
def test_any_stretch_is_a_fair_sample(some):
    """Robots, logs and simulators, and the kinds on each robot and simulator, as in the whole."""
    whole, part = cases("report"), cases("report")[some]
    for names in (["robot"], ["log"], ["simulator"], ["kind"], ["kind", "robot"], ["kind", "simulator"]):
        all_of, here = counts(whole, *names), counts(part, *names)
        for key, count in all_of.items():
            expected = count * len(part) / len(whole)
            assert abs(here[key] - expected) < 1.5 + 0.15 * expected, (key, here[key], expected)


@pytest.mark.parametrize(
    "plant", [pytest.param(p, id=p.name, marks=() if p is SMALL else pytest.mark.slow) for p in PLANTS.values()]
)
def test_what_is_known_of_a_machine(plant):
    """Each is another one of the series; every number is off by up to what `OFF` says, gains a little; tolerances are
    not stated, and an error drawn for a number that is changed adds to that."""
    robot, other = machine(plant, 1), machine(plant, 2)
    assert robot.chain.mass[-1] != other.chain.mass[-1] and robot.effects == ()
    last = robot.joint_names[-1]
    known = given(robot, 1, {f"{last}.mass": 1.0})
    assert known.tolerances == jf.robot.Tolerances() and known.effects == ()
    for kind, most in OFF.items():
        true, said = (jf.robot.parameters(r, [kind]) for r in (robot, known))
        true, said = (np.concatenate([np.ravel(x[name]) for name in true]) for x in (true, said))
        off = said[true != 0.0] / true[true != 0.0] - 1.0
        assert 0.1 * most < np.abs(off).max() <= most * (1 + 1e-9), kind
    assert known.chain.mass[-1] < robot.chain.mass[-1]
    gains = np.asarray(known.controller.velocity_gain) / np.asarray(robot.controller.velocity_gain)
    assert 0.0 < np.abs(gains - 1.0).max() <= 0.02
    assert given(robot, 1, {f"{last}.mass": -1.0}).chain.mass[-1] > robot.chain.mass[-1]


def test_background_is_of_orders_that_no_list_holds():
    from jaxfrf.effects._harmonics import _ORDERS

    for plant in PLANTS.values():
        robot = machine(plant, 3)
        waves = background(robot, 3)
        assert not {h for wave in waves for h in wave.order} & set(_ORDERS)
        torque = [wave for wave in waves if wave.name == "torque_ripple"]
        assert len(torque) == robot.n_axes
        for wave, limit in zip(torque, np.asarray(robot.drives.torque_limit), strict=True):
            assert np.all(np.asarray(wave.amplitude) <= 4e-3 * limit)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=lambda plant: plant.name)
def test_hidden_effects_stay_inside_bounds(plant):
    """At every level and joint; and ripple is not of an order at which a search would start."""
    case = next(c for c in cases("report") if c.robot == plant.name)
    robot = machine(plant, case.seed)
    around = _hidden_cases._around(case, plant, robot)
    around = dataclasses.replace(around, largest_torque=lambda: np.ones(robot.n_axes))
    for name in (*MAIN, *OUTSIDE):
        for joint in plant.joints_of(name):
            for level in (1.0, 8.0):
                effect, played = hidden_effect(robot, Hidden(name, joint, level), around, np.random.default_rng(5))
                assert 0.9 < played <= level * (1 + 1e-9)
                for key, (low, high) in kind_of(name).bounds.items():
                    value = getattr(effect, key)
                    value = low if value is None else np.asarray(value)
                    assert np.all((value >= low) & (value <= high)), (name, key)
                if name.endswith("ripple"):
                    assert not set(effect.order) & set(effects.library()[name].typical(robot, joint).order)


@pytest.mark.parametrize("quantity", LOGS)
def test_logs(quantity):
    """Derivatives of a sine of 50 rad at 10 Hz, with the noise of the log alone."""
    t, w = np.arange(1000) / 1000.0, 2 * np.pi * 10.0
    y = 3.0 + 50.0 * np.sin(w * t)[None, None, :, None]
    data = jf.Experiment(u=np.zeros_like(y), y=y, fs=1000.0, period=1000, y_quantity="position")
    exact = {"position": y, "velocity": 50.0 * w * np.cos(w * t), "acceleration": -50.0 * w**2 * np.sin(w * t)}
    log = logged(data, quantity, 0)
    assert log.y_quantity == quantity
    off = log.y[0, 0, :, 0] - np.ravel(exact[quantity])
    assert np.std(off) == pytest.approx(LOGS[quantity], rel=0.1, abs=1e-12)


def test_truth_of_a_number_is_its_whole_error():
    """What is hidden and what was drawn, which point the same way; in tolerances of what is given."""
    own = machine(SMALL, 5)
    effect = effects.CoulombFriction("elbow", 0.06)
    known = given(own, 5, _hidden_cases._toward(own, [effect]))
    true = _hidden_cases._true(own, known, effect)
    whole, before = own.drives.friction.coulomb[1] + 0.06, known.drives.friction.coulomb[1]
    assert true["true"] == pytest.approx(float(whole - before)) and true["true"] >= 0.06
    assert true["tolerances"] == pytest.approx(math.log(whole / before) / 0.5)
    payload = effects.Payload(-0.5)
    known = given(own, 5, _hidden_cases._toward(own, [payload]))
    assert _hidden_cases._true(own, known, payload)["true"] <= -0.5
    assert _hidden_cases._true(own, known, effects.TorqueDelay("elbow", 1e-3)) == {"true": [1e-3], "tolerances": None}


TINY = dataclasses.replace(SMALL, period=500, blocks=1, band=(5, 21), slow_lines=(1, 2), positions=1, run_in=0.2)


def tiny(kind, simulator, name=""):
    """The first case of the small robot of this kind, made so short that it takes no time."""
    of = lambda c: c.robot == "small" and c.kind == kind and c.simulator == simulator
    return next(c for c in cases("report") if of(c) and (not name or c.hidden[0].name == name))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "simulator"), [("none", "jaxfrf"), ("outside", "mujoco")])
def test_what_is_written(tmp_path, monkeypatch, kind, simulator):
    """A diagnosis finds a record and the robot as it is known, and nothing else; what is there is kept."""
    monkeypatch.setitem(_hidden_robots.PLANTS, "small", TINY)
    monkeypatch.setattr(_hidden_cases, "_CLIPPED", 2.0)  # so short a run accelerates much
    case = tiny(kind, simulator, "presliding_friction" if kind == "outside" else "")
    make(case, tmp_path, 1)
    place = tmp_path / "cases" / case.name
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == sorted(
        ["data.nc", "robot.toml", f"{case.name}.json"]
    )
    assert sorted(path.name for path in place.iterdir()) == ["data.nc", "robot.toml"]
    truth = json.loads((tmp_path / "truth" / f"{case.name}.json").read_text())
    assert (truth["kind"], truth["robot"], truth["log"], truth["simulator"]) == (kind, "small", case.log, simulator)
    assert truth["last"] == "elbow" and len(truth["effects"]) == len(case.hidden)
    text = (place / "robot.toml").read_text()
    assert "effect" not in text and "ripple" not in text and "tolerance" not in text
    data, robot = jf.io.read(place / "data.nc"), jf.io.read_robot(place / "robot.toml")
    assert data.u.shape == (1, 2, 500, 2) and data.u.dtype == np.float64 and data.period == 500
    assert data.y_quantity == case.log
    np.testing.assert_allclose(robot.chain.mass, given(machine(TINY, case.seed), case.seed, {}).chain.mass)
    before = (place / "data.nc").stat().st_mtime_ns
    make(case, tmp_path, 1)
    assert (place / "data.nc").stat().st_mtime_ns == before


@pytest.mark.slow
def test_the_pallet_in_two_simulators():
    """A robot that no other test has, on short runs: smooth, they agree."""
    plant = dataclasses.replace(PALLET, period=600, blocks=1, band=(5, 21), slow_lines=(1, 2, 3, 1), positions=1)
    robot = machine(plant, 1)
    robot = jf.robot.with_parameters(robot, dict.fromkeys(jf.robot.parameters(robot, ["coulomb_friction"]), 0.0))
    robot = robot.with_effects(effects.WristCoupling("roll", 0.05), *background(robot, 1))
    plan, q = plant.design(1), plant.configurations(1)
    found = mujoco_experiment(robot, plan, q, seed=0, run_in=0.3, noise=0.0, ripple=None, substeps=4)
    ours = jf.simulate(robot, plan, q, key=KEY, run_in=0.3, noise=0.0, steps=8)
    assert relative(found.u, ours.u) < 5e-5


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
    simulator, off = more.pop("simulator", "jaxfrf"), more.pop("tolerances", None)
    true = [
        {"name": name, "joint": joint, "level": level, "parameters": {MAIN.get(name, "x"): value}, "tolerances": off}
        for name, joint, level, value in hidden
    ]
    said = [{"name": name, "joint": joint, **rest} for name, joint, rest in named]
    where = {"robot": "r3x", "log": more.pop("log", "position"), "simulator": simulator, "last": "joint6"}
    truth = {"part": "tune", "number": 0, "kind": kind, "effects": true} | where
    return Judged(truth, {"verdict": verdict, "effects": said, **more})


def estimate(name, value, std):
    interval = [value - 1.96 * std, value + 1.96 * std]
    return {"parameters": {MAIN[name]: {"value": value, "std": std, "unit": "", "interval95": interval}}}


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
    assert s["parameter_error"]["n"] == 3 and s["parameter_error"]["median"] == pytest.approx(0.1)
    assert k_of(s["parameter_error"]["covered"]) == (2, 3)
    assert s["wall_s"]["median"] == 20.0 and s["wall_s"]["n"] == 3


def test_numbers_that_may_be_believed():
    """Silence is right there, and they are not among the clear ones; a name is right all the same."""
    coulomb = ("coulomb_friction", "joint1", 3.0, 0.2)
    silent, named, far = (
        judged("single", [coulomb], "sufficient", [], tolerances=1.9),
        judged("single", [coulomb], "named", [("coulomb_friction", "joint1", {})], tolerances=1.9),
        judged("single", [coulomb], "sufficient", [], tolerances=2.1),
    )
    assert (silent.good, named.good, far.good) == (True, True, False)
    s = summary([silent, named, far])
    assert s["single_clear"]["effect"]["n"] == 1 and (s["believed"]["k"], s["believed"]["n"]) == (1, 2)


def test_what_named_cases_leave():
    """Axes that are missed by more, robots that are sufficient when written, shrink over that of the true effect."""
    gap = lambda after: {"shrink": 0.4, "torque_before": {"a": 0.1, "b": 0.02}, "torque_after": {"a": 0.05, "b": after}}
    hidden, named = [("backlash", "b", 2.0, 1.0)], [("backlash", "b", {})]
    case = lambda after, **more: judged("single", hidden, "named", named, gap=gap(after), **more)
    s = summary([case(0.021, again="sufficient", oracle=0.8), case(0.023, again="named"), case(0.0)])
    assert (s["grows"]["k"], s["grows"]["n"]) == (1, 3)
    assert (s["again"]["k"], s["again"]["n"]) == (1, 2)
    assert s["shrink"]["of_oracle"]["median"] == pytest.approx(0.5) and s["shrink"]["of_oracle"]["n"] == 1


def test_errors_of_numbers_and_waves():
    """Of a number against the whole error; of waves order by order, whatever else was found beside them."""
    said = lambda **values: {
        "parameters": {n: {"value": v, "interval95": [v - 0.1, v + 0.1]} for n, v in values.items()}
    }
    number = {"name": "motor_inertia", "parameters": {"increase": 1.0}, "true": 1.25}
    assert errors(number, said(increase=1.2)) == [(pytest.approx(0.04), True)]
    ripple = {"name": "torque_ripple", "parameters": {"amplitude": [1.0, 2.0], "order": [4, 9]}, "true": [1.0, 2.0]}
    named = said(amplitude_1=5.0, order_1=2.0, amplitude_2=1.5, order_2=9.0)
    assert errors(ripple, named) == [(pytest.approx(0.25), False)]
    teeth = {
        "name": "transmission_error",
        "parameters": {"amplitude": [1.0], "order": [1], "teeth": 90.0},
        "true": [1.0],
    }
    assert errors(teeth, said(amplitude=1.0, order=2.0, teeth=45.1)) == [(0.0, True)]
    assert errors(teeth, said(amplitude=1.0, order=1.0, teeth=45.0)) == []


def test_score_by_group_and_failures(made_up, tmp_path):
    scores = score(made_up)
    assert scores["robot"]["r3x"]["cases"] == 16 and scores["log"]["position"]["cases"] == 16
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
        ("", "unexplained", ""),
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
        truth = {"part": "tune", "number": case.number, "kind": case.kind, "effects": true, "last": "joint6"}
        truth |= {key: getattr(case, key) for key in ("robot", "log", "simulator")}
        (folder / "truth" / f"{case.name}.json").write_text(json.dumps(truth))

    class Diagnosed:
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
    monkeypatch.setattr(bench_gap, "_alone", lambda function, *arguments: function(*arguments))
    monkeypatch.setattr(bench_gap, "Diagnosed", Diagnosed)
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
    file = tmp_path / "cases.json"
    assert keep(file, tmp_path, "0123abc") == keep(file, tmp_path, "4567def") == 3  # as they were first kept
    assert {case["commit"] for case in kept(file).values()} == {"0123abc"}
    assert report(score(load(file))) == report(score(load(tmp_path)))
    assert differences(load(file), load(tmp_path)) == ["0 of 3 cases end otherwise"]
    file.write_text(file.read_text().replace('"sufficient"', '"unexplained"', 1))
    told = ["1 of 3 cases end otherwise", "000: unexplained (not asked again); before: sufficient (not asked again)"]
    assert differences(load(file), load(tmp_path)) == told


def test_numbers():
    assert bench_gap._numbers("0-3,7,10-20/5") == {0, 1, 2, 3, 7, 10, 15, 20}
