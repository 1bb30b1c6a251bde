"""Whole robots from records: columns against simulations, the step against stacked least squares, and what is found."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy.stats
from _mujoco_records import mujoco_experiment
from book_tables import keys, told
from small_arm import Q, small_robot
from uncertain_arm import WIDE, design, machine, model, played

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.calibration import Calibration, rounds
from jaxfrf.calibration.columns import near_rest_columns, number_columns
from jaxfrf.calibration.descent import Descent
from jaxfrf.calibration.least_squares import Posterior, solve, with_bands
from jaxfrf.calibration.numbers import Number, numbers, with_numbers
from jaxfrf.calibration.result import Round
from jaxfrf.calibration.ripple import found_waves, other_share, sure_orders, waves_to_simulate
from jaxfrf.calibration.search import Search, _misfit
from jaxfrf.parts import Parts
from jaxfrf.robot import operating_point, parameters, r3x, tolerances_from
from jaxfrf.robot.regressor import link_parameters, link_regressor
from jaxfrf.robot.tolerances import KINDS
from jaxfrf.simulation import fine_steps, smoothing_factor
from jaxfrf.trajectory.alike import alike
from jaxfrf.trajectory.evidence import Evidence, Gram, Weighed, precise, scattered
from jaxfrf.trajectory.joined import joined, places
from jaxfrf.trajectory.measured import measured
from jaxfrf.trajectory.ripple import Order

# --- numbers


def test_numbers_are_those_that_are_not_exact():
    names = [n.name for n in numbers(model())]
    assert "elbow.stiffness_knee" in names and "shoulder.stiffness_knee" not in names
    assert {"shoulder.mass", "elbow.com.z", "elbow.inertia.yz", "friction.smoothing"} <= set(names)
    assert "shoulder.delay" not in names and "shoulder.torque_constant" in names
    assert len(set(names)) == len(names)
    exact = model().with_tolerances(tolerances_from({"all": 0, "damping": 0.5}, ()))
    assert [n.name for n in numbers(exact)] == ["shoulder.damping", "elbow.damping"]


def test_numbers_go_there_and_back():
    robot, uncertain = model(), numbers(model())
    x = np.random.default_rng(0).standard_normal(len(uncertain)) * 0.5
    moved = with_numbers(robot, uncertain, x)
    there = {n.name: n for n in numbers(moved)}
    for number, at in zip(uncertain, x, strict=True):
        assert there[number.name].given == pytest.approx(number.value(at), rel=1e-12, abs=1e-15)
        assert number.coordinate(number.value(at)) == pytest.approx(at)
    back = with_numbers(moved, uncertain, np.zeros(len(uncertain)))
    for kind in ("mass", "com", "inertia", "stiffness", "coulomb_friction"):
        for name, value in parameters(robot, [kind]).items():
            np.testing.assert_allclose(parameters(back, [kind])[name], value, rtol=1e-12)
    assert not back.effects


def with_effects(level, gap, lag):
    """The small robot with effects in its file, whose numbers a data sheet may state wrongly."""
    return model().with_effects(
        fx.StribeckFriction("elbow", level, 3.0), fx.Backlash("shoulder", gap), fx.CurrentLoopLag("elbow", lag)
    )


def test_numbers_of_effects():
    table = {"backlash": "unknown", "elbow.stribeck_friction.width": 0, "effect": 0.2}
    robot = with_effects(0.06, 3e-4, 6e-4).with_tolerances(tolerances_from(table, robot_names()))
    uncertain = {n.name: n for n in numbers(robot)}
    assert uncertain["shoulder.backlash"].prior == 0.0 and uncertain["shoulder.backlash"].unit == "rad"
    assert uncertain["elbow.current_loop_lag.time_constant"].size == pytest.approx(0.2)
    assert "elbow.stribeck_friction.width" not in uncertain
    turns = uncertain["elbow.stribeck_friction.smoothing"]
    assert (turns.kind, turns.joint, turns.unit) == ("smoothing", "elbow", "rad/s")
    moved = with_numbers(robot, list(uncertain.values()), np.full(len(uncertain), 0.3))
    again = {n.name: n.given for n in numbers(moved)}
    for name in ("shoulder.backlash", "elbow.stribeck_friction.level", "elbow.current_loop_lag.time_constant"):
        assert again[name] == pytest.approx(uncertain[name].value(0.3)) != uncertain[name].given
    with pytest.raises(jf.InputError, match=r"unknown key 'elbow\.backlash\.gap'"):
        tolerances_from({"elbow.backlash.gap": 0.1}, robot_names())


@pytest.mark.slow
def test_effects_that_a_robot_has_are_calibrated():
    """MuJoCo's records of a machine whose effects are 20 to 30 % from what the robot's file says."""
    q = np.concatenate([Q, Q[:, ::-1] + 0.2])
    truth = {  # with how well it is known: Stribeck's level leans on Coulomb friction beside it, its interval is 6 %
        "shoulder.backlash": (3.6e-4, 0.01),
        "elbow.stribeck_friction.level": (0.078, 0.07),
        "elbow.current_loop_lag.time_constant": (4.2e-4, 0.01),
    }
    true = with_effects(0.078, 3.6e-4, 4.2e-4)
    data = mujoco_experiment(true, design(0), q, seed=0, run_in=3.0, noise=2e-5, ripple=None)
    found = jf.calibrate(with_effects(0.06, 3e-4, 6e-4), data)
    for name, (value, known) in truth.items():
        assert found.values[name] == pytest.approx(value, rel=known), name


@pytest.mark.slow
def test_friction_a_moment_later():
    """Its column against the same friction of a motion shifted by a sample to both sides."""
    record = measured(played())
    scene = Evidence(machine(), record).scenes[0]
    smoothing = float(machine().drives.friction.smoothing)
    friction = lambda shift: scene.by_motor(1, np.tanh(np.roll(scene.speed[..., 1], shift, axis=1) / smoothing))
    later, low = near_rest_columns(machine(), record)[-1](scene), scene.still.frequency < 0.05 * scene.fs
    shifted = (friction(1) - friction(-1)) * scene.fs / 2
    np.testing.assert_allclose(later[:, low], shifted[:, low], atol=0.02 * np.abs(shifted).max())


@pytest.mark.slow
def test_no_record_tells_how_heavy_all_is():
    """All of a robot heavier by one part, its motors stronger by as much, moves alike, ripple and all: not a part in
    1e8 of what motors give is left, or a record seems to know it, 2 to 4 % off on R3X."""
    waves = [(Order("torque", 0, 2.0), (0.05, 0.02)), (Order("torque", 1, 3.0), (0.0, 0.03))]
    robot = alike(model(), [*waves, (Order("resolver", 1, 2.0), (1e-3, 0.0))])
    scene, uncertain = Evidence(robot, measured(played())).scenes[0], numbers(model())
    asked, given = 0.0, 0.0
    for number, column in zip(uncertain, number_columns(robot, uncertain, np.zeros(len(uncertain))), strict=True):
        if number.kind == "torque_constant":
            given += column(scene) / number.size
        elif number.kind in ("mass", "inertia", "motor_inertia", "stiffness", "damping") or "friction" in number.kind:
            asked += column(scene) * ((1.0 if number.positive else number.given) / number.size)
    for order, wave in waves:
        asked += sum(size * column for size, column in zip(wave, order.columns(scene), strict=True))
    np.testing.assert_allclose(asked, -given, rtol=0, atol=1e-8 * np.abs(given).max())


def test_what_nothing_is_known_of_costs_nothing():
    robot = model().with_tolerances(tolerances_from({"stiffness": "unknown", "elbow.mass": "0.4 kg"}, robot_names()))
    uncertain = {n.name: n for n in numbers(robot)}
    assert uncertain["elbow.stiffness"].prior == 0.0
    assert uncertain["elbow.mass"].size == pytest.approx(0.4 / 10.0)


def robot_names():
    return model().joint_names


# --- the links' regressor


def test_regressor_against_the_dynamics():
    """Torques of the chain's own mass matrix and bias, of a robot with joints about every axis."""
    chain = r3x().chain
    rng = np.random.default_rng(1)
    q, v, a = rng.uniform(-2, 2, (3, chain.n_joints, 5))
    Y = link_regressor(chain, q, v, a)
    pi = np.stack([link_parameters(*rows) for rows in zip(chain.mass, chain.com, chain.inertia, strict=True)])
    M, bias = jf.robot.chain.mass_and_bias(chain, jnp.asarray(q.T), jnp.asarray(v.T))
    wanted = np.einsum("tij,jt->it", np.asarray(M), a) + np.asarray(bias).T
    np.testing.assert_allclose(np.einsum("ijpt,jp->it", Y, pi), wanted, rtol=1e-9, atol=1e-9)


# --- columns


@pytest.mark.slow
def test_columns_against_simulations():
    check_columns(model())


@pytest.mark.slow
def test_a_motor_gives_more_of_what_effects_ask_too():
    """Were its column without them, an effect's torque would be known better than the constant of its motor."""
    beside = fx.DressPack("shoulder", 40.0, -0.3, 2.0), fx.FrictionAsymmetry("elbow", 0.05)
    check_columns(model().with_effects(*beside), ("torque_constant",))


def check_columns(robot, kinds=tuple(KINDS)):
    """A column is the change of the residual between two simulated robots, but for what the robot that is frozen at the
    position and linear about it leaves out; that of the friction's smoothing, of a few samples, is coarse."""
    uncertain = numbers(robot)
    record = measured(jf.simulate(robot, design(0), Q[:1], key=jr.key(0), run_in=3.0, noise=0.0))
    x = np.zeros(len(uncertain))
    scene = Evidence(robot, record).scenes[0]
    for i, (number, column) in enumerate(zip(uncertain, number_columns(robot, uncertain, x), strict=True)):
        if number.kind not in kinds:
            continue
        h = 0.02 / number.size if number.positive else 0.1
        sides = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[i] = sign * h
            sides.append(Evidence(with_numbers(robot, uncertain, moved), record).residual[0])
        wanted, ours = -(sides[0] - sides[1]) / (2 * h), column(scene)
        if np.linalg.norm(wanted) < 1e-9:  # what a planar arm does not show
            assert np.linalg.norm(ours) < 1e-9, number.name
        elif number.kind != "smoothing":
            assert np.linalg.norm(ours - wanted) < 0.12 * np.linalg.norm(wanted), number.name
            assert np.vdot(wanted, ours).real == pytest.approx(np.vdot(wanted, wanted).real, rel=0.05), number.name


# --- the step


def products(J, r, position):
    A = np.einsum("rnk,rnl->rkl", J, J)
    return Gram(A, np.einsum("rnk,rn->rk", J, r), np.einsum("rn,rn->r", r, r), position, J.shape[1])


def plain(prior, count):
    return [Number(f"n{i}.mass", "mass", "kg", 0.0, 1.0, False, p) for i, p in zip(range(count), prior, strict=True)]


def test_the_step_against_stacked_least_squares():
    rng = np.random.default_rng(3)
    J, r = rng.standard_normal((6, 50, 4)), rng.standard_normal((6, 50))
    x = np.array([0.3, -0.2])
    found = solve(products(J, r, np.arange(6)), plain([1.0, 0.0], 2), x)
    weight = found.effect**-0.5
    rows = np.concatenate([J.reshape(-1, 4) * weight, [[1.0, 0, 0, 0]]])
    wanted = np.linalg.lstsq(rows, np.append(r.reshape(-1) * weight, -x[0]), rcond=None)[0]
    np.testing.assert_allclose(found.change, wanted, atol=1e-7)


def test_intervals_hold_where_errors_repeat_from_line_to_line():
    """Errors that are the same in all lines of a position: 50 lines tell no more than one. And a number that only the
    prior knows keeps the prior's interval."""
    rng, held, pulled = np.random.default_rng(5), [], []
    for _ in range(300):
        truth = np.array([rng.standard_normal(), rng.standard_normal()])
        J = np.ones((8, 50, 2)) * np.array([1.0, 1e-6])
        J[:, :, 0] += 0.3 * rng.standard_normal((8, 1))
        r = J @ truth + 0.5 * rng.standard_normal((8, 1)) + 0.05 * rng.standard_normal((8, 50))
        found = solve(products(J, r, np.arange(8)), plain([1.0, 1.0], 2), np.zeros(2))
        half = found.half_width()
        held.append(abs(found.change[0] - truth[0]) < half[0])
        pulled.append(abs(found.change[1] - truth[1]) < half[1])
        assert found.data_share[0] > 0.9 and found.data_share[1] < 0.01
    for hits in (held, pulled):
        low, high = scipy.stats.binomtest(sum(hits), len(hits)).proportion_ci(0.99)
        assert low < 0.95 < high or np.mean(hits) > 0.95


@pytest.mark.slow
def test_intervals_hold_where_errors_repeat_from_position_to_position():
    """Errors of 24 bands of lines that are the same at all positions show between bands; where there are none, bands
    add next to nothing. Scores of so few bands are known to be a little short (MacKinnon & White 1985): .914."""
    rng, held, alone, wider = np.random.default_rng(6), [], [], []
    each = lambda x: np.tile(np.repeat(x, 10, axis=-1), 2)  # of every line, real and imaginary parts
    for repeats in [1.0] * 200 + [0.0] * 20:
        truth, bands = rng.standard_normal(2), rng.standard_normal((2, 24))
        J = rng.standard_normal((8, 1, 2, 480)) + each(bands)
        error = each(0.3 * repeats * rng.standard_normal(24)) + 0.1 * rng.standard_normal((8, 1, 480))
        r = np.einsum("pekn,k->pen", J, truth) + error
        weighed = Weighed(tuple(np.concatenate([J, r[:, :, None]], axis=2)), None)
        plainly = solve(precise(weighed.parts).gram, plain([0.0, 0.0], 2), np.zeros(2))
        found, miss = with_bands(plainly, weighed, 24), np.abs(plainly.change - truth)
        if repeats:
            held += list(miss < found.half_width())
            alone += list(miss < plainly.half_width())
        else:
            wider.append(np.median(found.half_width() / plainly.half_width()))
    assert 0.87 < np.mean(held) < 0.96 and np.mean(alone) < 0.8  # three standard deviations about that
    assert np.median(wider) < 1.1


def test_bands_of_lines_stand_for_runs():
    """Products of all bands together are those of the run, whatever their number."""
    rng = np.random.default_rng(0)
    parts = tuple(rng.standard_normal((2, 5, 2 * 30 * 3)).astype(np.float32) for _ in range(2))
    whole, cut = (precise(parts, bands).gram for bands in (1, 4))
    assert whole.A.shape == (4, 4, 4) and cut.A.shape == (16, 4, 4)
    for name in ("A", "b", "rr"):
        np.testing.assert_allclose(getattr(cut, name).sum(axis=0), getattr(whole, name).sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(whole.rr, [np.sum(run[-1].astype(float) ** 2) for x in parts for run in x])
    assert list(whole.position) == [0, 0, 1, 1] and len(set(cut.position)) == 16
    same_place = np.zeros(2, int)
    assert list(scattered(parts, same_place).gram.position) == [0, 0, 0, 0]
    few = scattered(parts[:1], same_place[:1]).gram.position
    assert len(set(few)) == len(few) == 16


# --- ripple, which is simulated near the truth


def test_orders_that_are_told_together_only():
    """Two whose columns are nearly alike: neither is sure, and without both of them much more is left."""
    A = np.eye(4) + np.array([[0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0]]) * (1 - 1e-4)
    orders, change = [Order("torque", 0, 2.0), Order("torque", 0, 3.0)], np.array([3.0, 0.0, 4.0, 0.0])
    alike = np.array([1.0, 0.0, -1.0, 0.0])  # what only their difference tells
    clusters = change + 6.0 * np.random.default_rng(0).standard_normal((5, 1)) * alike
    told = lambda left: Posterior(change, 1.0, A, clusters, np.zeros(4), left)
    together = change @ A @ change
    assert sure_orders(orders, told(np.inf)) == [False, False]
    assert sure_orders(orders, told(4.0 * together)) == [False, False]
    assert any(sure_orders(orders, told(0.5 * together)))
    assert sure_orders([], told(1.0)) == []


def test_ripple_as_it_is_written():
    """Orders that are there beyond chance, and those that were simulated, corrected by their columns."""
    orders = [Order("torque", 0, 2.0), Order("torque", 1, 3.0), Order("resolver", 1, 2.0)]
    change = np.array([0.4, 0.1, -0.2, 1e-4, 0.0, 3e-4, 2e-4])  # of one number, then of sines and cosines
    scatter = 1e-3 * np.random.default_rng(0).standard_normal((8, 7))
    posterior = Posterior(change, 1.0, np.eye(7), change + scatter, np.zeros(7))
    kept = found_waves(orders, posterior)
    assert [o for o, _ in kept] == orders[:1]
    (first, one), (second, other) = found_waves(orders, posterior, [(orders[1], (0.05, 0.0))])
    assert (first, second) == tuple(orders[:2])
    np.testing.assert_allclose([one, other], [[0.1, -0.2], [0.0501, 0.0]])


def test_what_other_ripple_matters():
    """Orders that are sure and were not simulated, and those that were and are not sure, by what they take away."""
    orders = [Order("torque", 0, 2.0), Order("torque", 1, 3.0), Order("resolver", 1, 2.0)]
    change = np.array([0.4, 0.1, -0.2, 1e-4, 0.0, 0.3, 0.2])
    scatter = 1e-3 * np.random.default_rng(0).standard_normal((8, 7))
    posterior = Posterior(change, 1.0, np.diag(np.arange(1.0, 8.0)), change + scatter, np.zeros(7), 2.0)
    alone = waves_to_simulate(orders, posterior)
    assert [o for o, _ in alone] == [orders[0], orders[2]]
    assert other_share(orders, posterior, alone) == 0.0
    assert other_share(orders, posterior, []) == pytest.approx((2 * 0.01 + 3 * 0.04 + 6 * 0.09 + 7 * 0.04) / 2.0)
    gone = [*alone, (orders[1], (0.0, 0.0))]  # simulated, and not there
    assert other_share(orders, posterior, gone) == pytest.approx(4 * 1e-8 / 2.0)


def test_finished_rounds_come_back(tmp_path, monkeypatch):
    monkeypatch.setattr(rounds, "_about", lambda *what: {})
    order = Order("torque", 1, 6.0)
    done = rounds.Kept(
        np.array([0.1, -2.0]),
        (order, Order("resolver", 0, 2.0)),
        np.full((3, 2), 0.25),
        Round(1.5, 1.25, 3.0),
        True,
        ((order, (1e-3, -2e-3)),),
        np.array([0.1, 0.2]),
    )
    with pytest.raises(KeyboardInterrupt), Parts(tmp_path / "fit.json", "identify") as parts:
        rounds.Rounds(parts, None, (), None, ()).keep(done)
        raise KeyboardInterrupt
    with Parts(tmp_path / "fit.json", "identify", resume=True) as parts:
        (back,) = rounds.Rounds(parts, None, (), None, ()).done
    for field in dataclasses.fields(rounds.Kept):
        np.testing.assert_equal(getattr(back, field.name), getattr(done, field.name))


@pytest.mark.slow
def test_friction_meets_motors_that_turn_unevenly():
    """Ripple of known waves, own simulator: all that scales with torque is as true as its scale, which no motion tells,
    and the speed over which friction turns comes out right."""
    waves = [
        fx.TorqueRipple("shoulder", [0.05, 0.03], (2, 6), [0.3, 1.0]),
        fx.TorqueRipple("elbow", [0.03, 0.03], (3, 8), [0.7, -1.0]),
        fx.ResolverRipple("elbow", [1e-3], (2,), [0.4]),
    ]
    data = jf.simulate(machine().with_effects(*waves), design(1), Q, key=jr.key(2), run_in=3.0, noise=2e-5)
    found = jf.calibrate(model(), data)
    assert found.converged
    truth = {n.name: n.given for n in numbers(machine())}
    scale = found.values["shoulder.stiffness"] / truth["shoulder.stiffness"]
    for kind in ("stiffness", "damping", "coulomb_friction", "viscous_friction", "motor_inertia"):
        for name in (n for n in truth if n.endswith(f".{kind}")):
            assert found.values[name] / truth[name] == pytest.approx(scale, rel=2e-3), name
    assert found.values["friction.smoothing"] == pytest.approx(truth["friction.smoothing"], rel=0.03)
    amplitude = {(o.kind, o.axis, o.order): np.hypot(*wave) for o, wave in zip(found.orders, found.waves, strict=True)}
    for wave in waves:
        kind, axis = wave.name.removesuffix("_ripple"), found.given.axis_names.index(wave.joint)
        for size, order in zip(np.asarray(wave.amplitude), wave.order, strict=True):
            expected = size * (scale if kind == "torque" else 1.0)
            assert amplitude[kind, axis, float(order)] == pytest.approx(expected, rel=3e-3), (wave.joint, order)


@pytest.mark.slow
def test_ripple_that_is_not_there_goes():
    """A robot that was fitted with a wrong order and without a right one, as beside an effect that was missing."""
    wave = fx.TorqueRipple("elbow", [0.03, 0.03], (3, 8), [0.7, -1.0])
    data = jf.simulate(machine().with_effects(wave), design(1), Q, key=jr.key(2), run_in=3.0, noise=2e-5)
    record, robot = measured(data), machine().with_tolerances(WIDE)
    fit = Descent(robot, record, numbers(robot), lambda text: None)
    wrong = [(Order("torque", 1, 5.0), (0.004, 0.0)), (Order("torque", 1, 3.0), (0.02, 0.02))]
    start = rounds.Kept(
        np.zeros(len(fit.numbers)), tuple(o for o, _ in wrong), None, Round(np.inf, np.inf, 1.0), True, wrong, []
    )
    kept = rounds.Rounds(None, robot, fit.numbers, record, ())
    kept.done = [start]
    fit.begin(kept)
    before = fit.iterate.misfit
    for _ in range(3):
        fit.advance(kept)
    inside = {o.order: np.hypot(*wave) for o, wave in fit.inside if (o.kind, o.axis) == ("torque", 1)}
    assert 5.0 not in inside
    assert {3.0, 8.0} <= set(inside)
    np.testing.assert_allclose([inside[3.0], inside[8.0]], 0.03, rtol=0.02)
    assert fit.iterate.misfit < 0.5 * before


# --- the whole


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_machine_that_is_off_everywhere():
    """MuJoCo's records of a machine with springs 20 %, dampers 40 %, friction 30 % and links 5 % off."""
    found = jf.calibrate(model(), played(), heldout=[3])
    assert found.converged
    truth = {n.name: n.given for n in numbers(machine().with_tolerances(WIDE))}
    for kind, limit in {"stiffness": 0.02, "coulomb_friction": 0.03, "damping": 0.1}.items():
        for name in (n for n in truth if n.endswith(f".{kind}")):
            assert found.values[name] == pytest.approx(truth[name], rel=limit), name
    determined = [n for n in truth if n != "friction.smoothing" and found.determined_by(n) == "data"]
    hits = [low <= truth[n] <= high for n in determined for low, high in [found.interval(n)]]
    assert len(determined) >= 8 and np.mean(hits) >= 0.7
    before, after = found.heldout
    assert np.all(after < 0.2 * before)


@pytest.mark.slow
def test_one_run():
    """One position, one experiment: springs and friction are still found, with intervals that know no other run."""
    data = jf.simulate(machine(), design(1), Q[:1], key=jr.key(2), run_in=3.0, noise=2e-5)
    one = eqx.tree_at(lambda d: (d.u, d.y, d.r), data, tuple(np.asarray(x)[:, :1] for x in (data.u, data.y, data.r)))
    found = jf.calibrate(model(), one)
    truth = {n.name: n.given for n in numbers(machine())}
    for name in ("shoulder.stiffness", "elbow.damping", "shoulder.coulomb_friction"):
        low, high = found.interval(name)
        assert np.isfinite([low, high]).all() and found.values[name] == pytest.approx(truth[name], rel=0.05), name


def test_what_cannot_be_calibrated():
    data = jf.simulate(small_robot(), design(0), Q[:1], key=jr.key(0), run_in=0.5)
    exact = small_robot().with_tolerances(tolerances_from({"all": 0}, ()))
    with pytest.raises(jf.InputError, match="0 for every number"):
        jf.calibrate(exact, data)
    with pytest.raises(jf.InputError, match="springs at shoulder, elbow, and a record that is not periodic"):
        jf.calibrate(small_robot(), dataclasses.replace(data, period=0, lines=None))
    with pytest.raises(jf.InputError, match="positions 4 of 1"):
        jf.calibrate(small_robot(), data, heldout=[4])


# --- several records

HAND = jf.effects.Payload(3.0, [0.3, 0.02, 0.0])


@pytest.mark.slow
def test_records_with_payloads_and_other_numbers_of_experiments():
    """A machine that is as the model says leaves nothing, whatever it carries where."""
    robot, options = small_robot(), dict(key=jr.key(0), run_in=3.0, noise=0.0)
    two = jf.simulate(robot, design(0), Q[:1], **options)
    one = jf.simulate(robot.with_effects(HAND), design(1), Q[:2], **options)
    one = dataclasses.replace(one, **{name: getattr(one, name)[:, :1] for name in ("u", "y", "r")})
    data = joined([two, one])
    assert (data.n_pos, data.n_exp, places(data).tolist()) == (4, 1, [1, 1, 1, 0])
    told = Evidence(robot, measured(data, (None, None, HAND, HAND)))
    untold = Evidence(robot, measured(data))
    size = lambda evidence: np.sqrt(np.mean(np.abs(evidence.residual) ** 2, axis=(1, 2, 3)))
    assert np.all(size(told) < 1e-4 * size(untold)[2:].min())
    with pytest.raises(jf.InputError, match="payloads: found 1 of 2 records"):
        jf.calibrate(robot, [two, one], payloads=[HAND])
    with pytest.raises(jf.InputError, match="one without a place"):
        jf.calibrate(robot, [two, one], payloads=[None, jf.effects.Payload(1.0)])


@pytest.mark.slow
def test_friction_need_not_follow_its_speed():
    """MuJoCo's turns over about a ms before its motor does: without a column for that, rotors come out .1 % heavy."""
    q = np.concatenate([Q, Q[:, ::-1] + 0.2])
    data = mujoco_experiment(machine(), design(0), q, seed=0, run_in=3.0, noise=2e-5, ripple=None, substeps=8)
    sure = tolerances_from({"torque_constant": 0}, robot_names())
    given = model().with_tolerances(model().tolerances.updated(sure))
    found = jf.calibrate(given, data)
    truth = {n.name: n.given for n in numbers(machine())}
    for kind, known in (("motor_inertia", 1e-4), ("coulomb_friction", 1e-3), ("stiffness", 5e-3)):
        for name in (n for n in truth if n.endswith(f".{kind}")):
            assert found.values[name] / truth[name] == pytest.approx(1.0, abs=known), name


@pytest.mark.slow
def test_a_payload_tells_masses():
    """A known weight in the hand, MuJoCo's records: the scale of all torques, which no motion tells, is told."""
    q = np.concatenate([Q, Q[:, ::-1] + 0.2])
    carrying = mujoco_experiment(
        machine().with_effects(HAND), design(3), q, seed=7, run_in=3.0, noise=2e-5, ripple=None
    )
    found = jf.calibrate(model(), [played(), carrying], payloads=[None, HAND])
    truth = {n.name: n.given for n in numbers(machine())}
    for name in ("shoulder.stiffness", "elbow.stiffness", "elbow.coulomb_friction", "elbow.motor_inertia"):
        assert abs(found.values[name] / truth[name] - 1.0) < 0.005, name
    alone = jf.calibrate(model(), played())
    assert found.std["elbow.torque_constant"] < 0.1 * alone.std["elbow.torque_constant"]


# --- the command


@pytest.fixture(scope="module")
def commanded(tmp_path_factory):
    """`jaxfrf identify` on a record of the project's own simulator, three rounds."""
    from jaxfrf.__main__ import main

    out = tmp_path_factory.mktemp("whole")
    data = jf.simulate(machine(), design(1), Q[:3], key=jr.key(2), run_in=3.0, noise=2e-5)
    jf.io.write(out / "run.npz", data)
    jf.io.write_robot(out / "robot.toml", model())
    command = ["identify", str(out / "run.npz"), "--robot", str(out / "robot.toml"), "-o", str(out / "fit.json")]
    more = ["--report", str(out / "fit.html"), "--robot-out", str(out / "found.toml"), "--tolerance", "links=0.04"]
    assert main([*command, *more, "--rounds", "3"]) == 0
    return out


def test_the_command_fits_the_whole_robot(commanded):
    found = jf.io.read_fit(commanded / "fit.json")
    assert found["kind"].startswith("whole robot")
    truth = {n.name: n.given for n in numbers(machine())}
    for name in (
        "shoulder.stiffness",
        "elbow.stiffness",
        "shoulder.damping",
        "elbow.damping",
        "elbow.coulomb_friction",
    ):
        entry = found["parameters"][name]
        assert entry["value"] == pytest.approx(truth[name], rel=0.05), name
        assert entry["interval95"][0] < entry["value"] < entry["interval95"][1]
        assert entry["determined_by"] == "data" and entry["start"] != truth[name]
    assert np.all(np.array(found["torque_missed"]["after"]) < 0.2 * np.array(found["torque_missed"]["before"]))
    robot = jf.io.read_robot(commanded / "found.toml")
    stiffness = float(parameters(robot)["elbow.stiffness"])
    assert stiffness == pytest.approx(found["parameters"]["elbow.stiffness"]["value"])
    assert robot.tolerances.of("elbow.mass").std == 0.04


def test_the_book_tells_every_field(commanded):
    found = jf.io.read_fit(commanded / "fit.json")
    fields = keys(found, but=("parameters",)) | set(found["parameters"]["elbow.mass"])
    assert fields | {"joint", "kind", "order", "sine", "cosine"} <= told("files.md", "fit.json")


def test_the_page_shows_every_number(commanded):
    page, found = (commanded / "fit.html").read_text(), jf.io.read_fit(commanded / "fit.json")
    for name in found["parameters"]:
        assert name in page
    assert "<img" in page and 'src="http' not in page
    assert "not explained" not in page


def doubted(**fields):
    """A calibration of which only what `doubts` looks at is known."""
    bare = {"unexplained": (), "hints": (), "numbers": (), "x": (), "misplaced": (), "orders": (), "turned": ()}
    names = SimpleNamespace(axis_names=("shoulder", "elbow"))
    return SimpleNamespace(given=names, _of_part_of_a_turn=lambda: [], **(bare | fields))


@pytest.mark.parametrize("missed", [0.41, np.nan])
def test_intervals_beside_torque_that_is_missed_are_doubted(missed):
    found = doubted(missed_before=[0.018, 0.5], missed_after=[0.02, missed])
    assert Calibration.unexplained.fget(found) == ("elbow",)
    found.unexplained = ("elbow",)
    (text,) = Calibration.doubts(found)
    assert "of elbow" in text and "shoulder" not in text and "units" in text


def test_a_fit_that_misses_more_than_it_began_with_says_so():
    found = doubted(missed_before=[0.028, 0.02], missed_after=[0.053, 0.021])
    (text,) = Calibration.doubts(found)
    assert "than by the robot as given: shoulder (2.8 % -> 5.3 %)" in text and "elbow" not in text


def test_numbers_that_are_far_off_are_doubted():
    """As those of a last link are that carries what nobody told."""
    every = numbers(model())
    at = np.zeros(len(every))
    found = doubted(missed_before=[0.5, 0.5], missed_after=[0.01, 0.01], numbers=every, x=at)
    assert Calibration.doubts(found) == []
    place = [n.name for n in every].index("elbow.mass")
    at[place] = 4.1
    (text,) = Calibration.doubts(found)
    assert "4 tolerances" in text and f"for {every[place].given:.4g}" in text and "carrying" in text


def test_springs_have_options_of_their_own(commanded, capsys):
    from jaxfrf.__main__ import main

    files = [str(commanded / "run.npz"), "--robot", str(commanded / "robot.toml"), "-o", str(commanded / "no.json")]
    assert main(["identify", *files, "--starts", "3"]) == 2
    assert "--starts: found the whole robot to be fitted; expected --springs" in capsys.readouterr().err
    assert main(["identify", *files, "--tolerance", "lnks=3"]) == 2
    assert "Did you mean 'links'?" in capsys.readouterr().err


def test_what_a_fit_writes_can_be_read(tmp_path):
    """Hoses that were given as none, to 3 N m/rad: a fit may have them pull the other way, which no file may."""
    robot = model().with_effects(fx.DressPack("elbow", 0.0))
    key = "elbow.dress_pack.stiffness"
    robot = robot.with_tolerances(tolerances_from({key: "3 N m/rad"}, robot.axis_names))
    every = numbers(robot)
    x = np.where([n.name == key for n in every], -1.0, 0.0)
    assert every[int(np.argmin(x))].value(-1.0) == pytest.approx(-3.0)
    jf.io.write_robot(tmp_path / "fitted.toml", with_numbers(robot, every, x))
    assert float(jf.io.read_robot(tmp_path / "fitted.toml").effects[0].stiffness) == 0.0


# --- the turn of friction


def test_friction_is_simulated_as_sharp_as_steps_follow():
    robot = model()
    point = operating_point(robot, Q)
    smoothing = smoothing_factor(robot, like=robot) * float(robot.drives.friction.smoothing)
    turned = lambda eps: eqx.tree_at(lambda r: r.drives.friction.smoothing, robot, jnp.asarray(eps))
    steps = fine_steps(robot, point)
    assert fine_steps(turned(1.001 * smoothing), point) == steps < fine_steps(turned(0.9 * smoothing), point)


def test_a_law_that_is_too_sharp_leaves_the_others_as_they_are():
    """Friction and an effect of its own smoothing: what the effect asks for made the friction's wider, round by round,
    until there was none; nor goes the last step, behind which nothing is simulated, further than a column holds."""
    robot = model().with_effects(jf.effects.LoadDependentFriction("elbow", 0.1))
    every = numbers(robot)
    search = Search(robot, measured(played()), every, print, by_difference=True)
    friction, own = (
        next(i for i, n in enumerate(every) if n.name == name)
        for name in ("friction.smoothing", "elbow.load_dependent_friction.smoothing")
    )
    margin = np.log(1.04) / every[friction].size
    for asked in (-1.0, -8.0):
        x = np.zeros(len(every))
        x[own] = asked
        for _ in range(4):
            x[own] = asked
            x = search.followed(x)
        robots_own = with_numbers(robot, every, x)
        assert smoothing_factor(robots_own, like=robot) <= 1.0 and abs(x[friction]) < margin and x[own] < margin
    change = np.zeros(len(every))
    change[own], change[friction] = 20.0, -20.0
    far = SimpleNamespace(x=np.zeros(len(every)), posterior=SimpleNamespace(change=change))
    assert 0.2 < every[own].size * search.end(far)[own] < 0.4


def test_the_turn_of_no_friction_tells_nothing():
    """An asymmetry without a level of its own turns over at no speed: the difference of two simulations is rounding,
    of which no multiple, however large, explains anything."""
    rng = np.random.default_rng(0)
    part = rng.standard_normal((1, 3, 8)).astype(np.float32)  # two columns and the residual: real, then imaginary parts
    part[:, 1] *= 1e-22
    precise_part = part.astype(float)
    J, r = precise_part[:, :2], precise_part[:, 2]
    gram = Gram(np.einsum("rkn,rln->rkl", J, J), np.einsum("rkn,rn->rk", J, r), np.sum(r * r, axis=1), np.zeros(1), 2)
    evidence = SimpleNamespace(residual=np.zeros((1, 1, 4, 1), complex), floor=1.0, plain=1.0)
    with np.errstate(all="raise", under="ignore"):
        misfit = _misfit(evidence, Weighed((part,), gram), np.array([0, 1]))
    left = r[0] - J[0, 0] * (J[0, 0] @ r[0]) / (J[0, 0] @ J[0, 0])
    assert misfit == pytest.approx(0.5 * np.sum(left**2) / 4, rel=1e-5)


def turning_slowly(robot, smoothing):
    """The robot whose friction needs that many rad/s to turn over."""
    return eqx.tree_at(lambda r: r.drives.friction.smoothing, robot, smoothing)


def test_near_rest_is_well_below_the_speed_of_a_motor():
    """Wider shapes are viscous friction by another name."""
    record = measured(played())
    counts = [len(near_rest_columns(turning_slowly(machine(), s), record)) for s in (0.2, 1.0, 50.0)]
    assert counts == sorted(counts, reverse=True) and counts[0] == 8 and counts[-1] == 2


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_friction_that_turns_over_slowly():
    """Shapes as wide as its motors are fast hide how it does, twenty times; elsewhere they kept a fit from its end."""
    q = np.concatenate([Q, Q[:, ::-1] + 0.2])
    data = jf.simulate(turning_slowly(machine(), 8.0), design(0), q, key=jr.key(3), run_in=3.0, noise=2e-5)
    found = jf.calibrate(turning_slowly(model(), 8.0), data)
    assert found.converged
    low, high = found.interval("friction.smoothing")
    assert abs(found.values["friction.smoothing"] - 8.0) < 0.005 and high - low < 0.01
    truth = {n.name: n.given for n in numbers(machine().with_tolerances(WIDE))}
    for name in ("shoulder.viscous_friction", "elbow.viscous_friction"):
        assert found.values[name] == pytest.approx(truth[name], rel=0.01), name
