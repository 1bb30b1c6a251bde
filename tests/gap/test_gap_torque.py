"""Diagnosis by inverse dynamics, by deflection and by the FRF of a drive, where the truth is known in closed form."""

import dataclasses
import re

import equinox as eqx
import numpy as np
import pytest
from marks import slow

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.effects import (
    CoulombFriction,
    Counterbalance,
    LoadDependentFriction,
    Reach,
    ResolverRipple,
    StribeckFriction,
    TorqueDelay,
    TorqueRipple,
)
from jaxfrf.gap import diagnose
from jaxfrf.gap.channels import State
from jaxfrf.gap.channels.channel import makes_sense
from jaxfrf.gap.channels.deflection import DeflectionChannel
from jaxfrf.gap.channels.torque import TorqueChannel
from jaxfrf.gap.significance import covariance, family_wise, held_out, numbered, projector, summed
from jaxfrf.io.gaps import gap_contents
from jaxfrf.trajectory.needed_torque import added_torque, needed_torque
from jaxfrf.trajectory.rigid_motion import MeasuredMotion, measured_motions, thinned

# --- a planar arm of two links, its equations as textbooks write them

L1, M1, C1, I1, M2, C2, I2 = 0.5, 8.0, 0.25, 0.3, 4.0, 0.2, 0.1
GEAR, ROTOR = np.array([50.0, 40.0]), np.array([1e-3, 8e-4])
VISCOUS, COULOMB, SMOOTHING = np.array([4e-3, 3e-3]), np.array([0.3, 0.2]), 0.2


def arm(stiffness=float("inf"), damping=0.0, tolerance=0.0):
    def joint(axis, name, offset, mass, com, inertia):
        return {
            "name": name,
            "type": "driven",
            "axis": [0.0, 0.0, 1.0],
            "offset": [offset, 0.0, 0.0],
            "mass": mass,
            "com": [com, 0.0, 0.0],
            "inertia": [inertia / 2, inertia / 2, inertia, 0.0, 0.0, 0.0],
            "gear_ratio": GEAR[axis],
            "motor_inertia": float(ROTOR[axis]),
            "stiffness": stiffness,
            "damping": damping,
            "viscous_friction": float(VISCOUS[axis]),
            "coulomb_friction": float(COULOMB[axis]),
        }

    joints = [joint(0, "shoulder", 0.0, M1, C1, I1), joint(1, "elbow", L1, M2, C2, I2)]
    table = {"name": "arm", "gravity": [0.0, -9.81, 0.0], "friction": {"smoothing": SMOOTHING}, "joint": joints}
    return jf.robot.robot_from_table(table | {"tolerance": {"all": tolerance}})


def path(t, seed):
    """Six sines a joint: angles, speeds and accelerations, exact."""
    rng, q = np.random.default_rng(seed), np.zeros((3, len(t), 2))
    for axis in range(2):
        for f in rng.uniform(0.1, 1.5, 6):
            w, phase = 2 * np.pi * f, rng.uniform(0, 2 * np.pi)
            for order in range(3):
                q[order, :, axis] += 0.35 / (1 + 2 * f) * w**order * np.sin(w * t + phase + order * np.pi / 2)
    return q


def torque(q, v, a, m2=M2):
    cosine, sine, g, h = np.cos(q[:, 1]), np.sin(q[:, 1]), 9.81, m2 * L1 * C2
    m22 = I2 + m2 * C2**2
    m12 = m22 + h * cosine
    m11 = I1 + M1 * C1**2 + m2 * L1**2 + m22 + 2 * h * cosine
    low, high = M1 * C1 * np.cos(q[:, 0]) + m2 * L1 * np.cos(q[:, 0]), m2 * C2 * np.cos(q[:, 0] + q[:, 1])
    first = m11 * a[:, 0] + m12 * a[:, 1] - h * sine * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2) + g * (low + high)
    second = m12 * a[:, 0] + m22 * a[:, 1] + h * sine * v[:, 0] ** 2 + g * high
    motor = v * GEAR
    rubbing = VISCOUS * motor + COULOMB * np.tanh(motor / SMOOTHING)
    return np.stack([first, second], axis=1) / GEAR + ROTOR * GEAR * a + rubbing


def record(seed, more=lambda q, v, a: 0.0, fs=250.0, seconds=12.0):
    """Coloured torque noise of 2 %, a 16-bit encoder; the torque is held from sample to sample, so that the command is
    the torque half a sample later."""
    t = np.arange(int(seconds * fs)) / fs
    later = path(t + 0.5 / fs, seed)
    u = torque(*later) + more(*later)
    noise = np.random.default_rng(seed + 1000).standard_normal(u.shape)
    for k in range(1, len(noise)):
        noise[k] = 0.9 * noise[k - 1] + np.sqrt(1 - 0.9**2) * noise[k]
    count = 2 * np.pi / 2**16
    y = np.round(path(t, seed)[0] * GEAR / count) * count
    return jf.Experiment(u + 0.02 * u.std(axis=0) * noise, y, fs, y_quantity="position")


def exact(seed=0, fs=500.0, seconds=4.0):
    q, v, a = path(np.arange(int(seconds * fs)) / fs, seed)
    return (q, v, a), MeasuredMotion(q * GEAR, v * GEAR, a * GEAR, torque=torque(q, v, a), fs=fs, cutoff=0.45 * fs)


def test_needed_torque_is_the_textbook_s():
    (q, v, a), motion = exact()
    np.testing.assert_allclose(needed_torque(arm(), motion), torque(q, v, a), rtol=1e-10, atol=1e-10)


def test_slopes_are_what_the_parameters_multiply():
    """Of the channel, over the rms torque; the motion of the record is the exact one within its filter."""
    channel = TorqueChannel.opened(arm(), [record(3)])
    state = State(arm(), channel.own())
    assert list(state.own) == [f"{j}.{k}" for k in ("motor_inertia", "viscous_friction") for j in ("shoulder", "elbow")]
    slopes = channel.slopes(state).reshape(-1, 2, 4)
    (motion,) = channel.motions
    for column, axis, signal in ((0, 0, motion.acceleration), (3, 1, motion.speed)):
        expected = thinned(motion, signal)[:, axis] / channel.size[axis]
        np.testing.assert_allclose(slopes[:, axis, column], expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
        np.testing.assert_allclose(slopes[:, 1 - axis, column], 0.0, atol=1e-9)


def test_effects_add_what_their_equations_say():
    robot, ((q, v, _), motion) = arm(), exact()
    # The load goes through a filter, which would round the steps of Coulomb friction.
    steps = COULOMB * np.tanh(v * GEAR / SMOOTHING)
    motion = eqx.tree_at(lambda m: m.torque, motion, motion.torque - steps)
    needed = needed_torque(robot, motion)
    motor, angle = v[:, 1] * GEAR[1], q[:, 1] * GEAR[1]
    cases = [
        (CoulombFriction("elbow", 0.1), 0.1 * np.tanh(motor / SMOOTHING)),
        (LoadDependentFriction("elbow", 0.05, 0.3), 0.05 * np.abs(motion.torque[:, 1]) * np.tanh(motor / 0.3)),
        (TorqueRipple("elbow", [0.02], (6,), [0.3]), -0.02 * np.sin(6 * angle + 0.3)),
    ]
    for effect, expected in cases:
        added = added_torque(robot, effect, motion, needed)
        inner = slice(200, -200)
        np.testing.assert_allclose(added[inner, 1], expected[inner], atol=2e-5)
        np.testing.assert_allclose(added[:, 0], 0.0, atol=1e-12)


def test_a_late_torque_is_commanded_earlier():
    """u(t) = tau(t + delay): the torque of the same motion, looked up later."""
    names = ("shoulder.coulomb_friction", "elbow.coulomb_friction")
    robot, (_, motion) = jf.robot.with_parameters(arm(), dict.fromkeys(names, 0.0)), exact()
    delay, t = 1e-3, np.arange(len(motion.angle)) / motion.fs

    def smooth_torque(t):
        q, v, a = path(t, 0)
        return (torque(q, v, a) - COULOMB * np.tanh(v * GEAR / SMOOTHING))[300:-300, 0]

    expected = smooth_torque(t + delay) - smooth_torque(t)
    added = added_torque(robot, TorqueDelay("shoulder", delay), motion, needed_torque(robot, motion))[300:-300, 0]
    np.testing.assert_allclose(added, expected, atol=0.01 * np.abs(expected).max())


def test_a_resolver_error_adds_an_acceleration():
    """a h^2 v^2 at order h of the motor's angle, to first order (the docstring of the effect)."""
    robot, (_, motion) = arm(), exact(fs=4000.0, seconds=2.0)
    effect = ResolverRipple("elbow", [1e-5], (2,))
    added = added_torque(robot, effect, motion, needed_torque(robot, motion))[:, 1]
    inertia = ROTOR[1] + (I2 + M2 * C2**2) / GEAR[1] ** 2
    angle, speed = motion.angle[:, 1], motion.speed[:, 1]
    expected = inertia * 1e-5 * 4 * speed**2 * np.sin(2 * angle)
    fast = np.abs(speed) > 0.5 * np.abs(speed).max()
    assert np.corrcoef(added[fast], expected[fast])[0, 1] > 0.98


@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration"])
def test_motion_from_any_quantity(quantity):
    """Sines of whole periods about the configuration q: all three quantities give the same motion, ends apart, of a
    wrist and behind encoders that begin elsewhere, too; speeds alone tell no angle."""
    fs, t = 500.0, np.arange(5000) / 500.0
    w, amplitude = 2 * np.pi * np.array([0.5, 1.1]), np.array([0.3, 0.2])
    q = np.array([[0.4, -0.7]])
    waves = [amplitude * w**k * np.sin(np.outer(t, w) + k * np.pi / 2) for k in range(3)]
    wrist, zero = np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([3.0, -20.0])
    robot = eqx.tree_at(lambda r: r.drives.zero, arm(), zero, is_leaf=lambda x: x is None)
    robot = robot.with_effects(jf.effects.WristCoupling("elbow", 0.5))
    exact_motion = [(x @ wrist.T) * GEAR for x in (waves[0] + q, waves[1], waves[2])]
    y = exact_motion[("position", "velocity", "acceleration").index(quantity)] + zero * (quantity == "position")
    data = jf.Experiment(np.zeros_like(y), y, fs, q=q, y_quantity=quantity)
    (found,) = measured_motions(robot, data, 40.0)
    if quantity != "position":
        with pytest.raises(jf.InputError, match="the mean angles of the joints"):
            measured_motions(robot, dataclasses.replace(data, q=None), 40.0)
    for got, expected in zip((found.angle, found.speed, found.acceleration), exact_motion, strict=True):
        size = np.abs(expected - expected.mean(axis=0)).max()
        np.testing.assert_allclose(got[50:-50], expected[50:-50], atol=5e-3 * size)


HIDDEN = {
    "coulomb_friction": (lambda q, v, a: 0.08 * np.tanh(v * GEAR / SMOOTHING) * [0, 1], "elbow", {"level": 0.08}),
    "friction_asymmetry": (lambda q, v, a: 0.1 + 0 * q * [1, 0] - 0.1 * np.array([0, 1]), "shoulder", {"offset": 0.1}),
    "payload": (lambda q, v, a: torque(q, v, a, M2 + 0.5) - torque(q, v, a), "", {"mass": 0.5}),
    "torque_ripple": (lambda q, v, a: -0.05 * np.sin(6 * q * GEAR + 0.4) * [0, 1], "elbow", {"amplitude": 0.05}),
}


@pytest.mark.parametrize(
    "name", ["coulomb_friction", *(pytest.param(n, marks=pytest.mark.slow) for n in HIDDEN if n != "coulomb_friction")]
)
def test_hidden_effects_are_named(name):
    more, joint, values = HIDDEN[name]
    found = diagnose(arm(), [record(3, more), record(4, more)], heldout_count=1)
    assert found.verdict == "named"
    assert [(e.name, e.joint) for e in found.effects] == [(name, joint)]
    for key, true in values.items():
        value = found.effects[0].parameters[key]
        assert abs(value.value - true) < min(4 * value.std, 0.1 * true)
    assert found.gap.shrink > 0.9 and found.gap.after < 0.85 * found.gap.before
    # The robot that comes back has it.
    (_, motion) = exact()
    assert np.std(needed_torque(found.extended, motion) - motion.torque - more(*path(np.arange(2000) / 500, 0))) < 0.02


@pytest.mark.slow
def test_it_is_written_as_any_diagnosis():
    """gap.json of it, as `jaxfrf diagnose` writes it."""
    more, joint, _ = HIDDEN["coulomb_friction"]
    whole = diagnose(arm(), record(3, more))
    contents = gap_contents(whole)
    assert contents["verdict"] == "named" and "coulomb_friction (elbow)" in contents["says"]
    assert contents["effects"][0]["joint"] == joint
    level = contents["effects"][0]["parameters"]["level"]
    assert level["unit"] == "N m" and level["interval95"][0] < 0.08 < level["interval95"][1]
    assert set(contents["gap"]) >= {"before", "after", "floor", "shrink", "unit", "on"}
    assert contents["parameters"]["elbow.motor_inertia"]["start"] == ROTOR[1]
    # The maps: most of the gap is in the elbow, and gone afterwards; all bands together are the residual.
    before, after = whole.maps.before[0], whole.maps.after[0]
    assert before[1].max() > 3 * after.max() and before[0].max() < 2 * after[0].max() + 1
    # The step of .08 N m at the turn of the speed, of which viscous friction took the slope away from it.
    speed, course, gone = (x[1] for x in whole.maps.courses["speed"])
    forward, backward = np.searchsorted(speed, 0) + np.array([1, -2])
    assert course[forward] > 0.03 and course[backward] < -0.03 and np.abs(gone).max() < 0.01


def test_nothing_is_named_where_nothing_is_missing():
    found = diagnose(arm(), [record(5), record(6)], heldout_count=1)
    assert found.verdict == "sufficient" and not found.effects
    assert found.gap.before == found.gap.after < 0.03
    for key, true in (("shoulder.motor_inertia", ROTOR[0]), ("elbow.viscous_friction", VISCOUS[1])):
        assert abs(found.parameters[key].value - true) < 4 * found.parameters[key].std
    left_out = found.settings["left_out"]
    assert "rigid" in left_out["backlash"]
    assert set(left_out) >= {"wrist_coupling", "torque_saturation", "extra_flexibility", "sensor_delay"}
    with pytest.raises(jf.InputError, match="a gear that turns with another axis"):
        diagnose(arm().with_effects(jf.effects.WristCoupling(1, 1.0)), record(5))


def test_wrong_numbers_are_no_missing_effect():
    """Rotors 30 % off: the refit says so, and nothing is named."""
    wrong = jf.robot.with_parameters(arm(), {"shoulder.motor_inertia": 1.3e-3, "elbow.motor_inertia": 5e-4})
    found = diagnose(wrong, record(7))
    assert not found.effects
    told = [text for text in found.settings["remarks"] if "wrong numbers, no missing effect" in text]
    nominal, before = map(float, re.search(r"from ([\d.]+) to ([\d.]+) of the torque", told[0]).groups())
    assert nominal > 2 * before


def test_numbers_within_their_tolerance_are_no_missing_effect():
    """Masses and Coulomb friction off by a tolerance."""
    named = {"shoulder.mass": 1.05 * M1, "elbow.mass": 0.95 * M2, "elbow.coulomb_friction": 0.95 * COULOMB[1]}
    wrong = jf.robot.with_parameters(arm(tolerance=0.05), named)
    found = diagnose(wrong, record(5))
    assert found.verdict == "sufficient" and found.gap.before < 0.03


@pytest.mark.slow
def test_identify_asks_after_signs_and_channels():
    data = record(3)
    opposite, exchanged = (dataclasses.replace(data, u=u) for u in (data.u * np.array([1.0, -1.0]), data.u[..., ::-1]))
    assert not jf.calibrate(arm(tolerance=0.05), data).hints
    assert "elbow is like the opposite" in "".join(jf.calibrate(arm(tolerance=0.05), opposite).doubts())
    assert "shoulder is like that of elbow" in "".join(jf.calibrate(arm(tolerance=0.05), exchanged).doubts())


@pytest.mark.slow
def test_what_the_library_lacks_is_not_named():
    """A torque that depends on both angles, as no effect does."""
    more = lambda q, v, a: 0.3 * (np.sin(9 * q[:, :1]) * np.cos(11 * q[:, 1:])) * [0, 1]
    found = diagnose(arm(), record(8, more, seconds=24.0))
    assert not found.effects and found.verdict in ("unexplained", "inconclusive")
    assert found.gap.after > 0.05


def test_values_must_make_sense():
    """Levels only have to keep their sign and the size of the torque; times keep their bounds."""
    robot, reach = arm(), Reach(30.0, 40.0, 9.0)
    of = lambda kind: kind.along_motion(robot, "elbow", reach)[0]

    def sensible(kind, value, most=9.0):
        candidate = of(kind)
        unit = float(getattr(candidate.basis[0], next(iter(kind.units))))
        return makes_sense(robot, candidate, np.array([value / unit]), most)

    assert sensible(StribeckFriction, 20.0, 100.0)  # far outside bounds that are for a robot of R3X's size
    assert not sensible(StribeckFriction, 200.0, 100.0) and not sensible(StribeckFriction, -0.1)
    assert sensible(CoulombFriction, -0.15) and not sensible(CoulombFriction, -0.25)
    assert sensible(TorqueDelay, 1e-3)
    assert not sensible(TorqueDelay, -1e-4) and not sensible(TorqueDelay, 0.1)


def test_shapes_follow_the_motion():
    """Widths of friction in parts of the speed, whole orders that the travel holds, springs at rest anywhere."""
    robot, slow, far = arm(), Reach(0.5, 0.2, 9.0), Reach(50.0, 2 * np.pi * 3, 9.0)
    widths = lambda reach: [c.basis[0].width for c in StribeckFriction.along_motion(robot, "elbow", reach)]
    np.testing.assert_allclose(widths(slow), [0.01, 0.025, 0.05, 0.1])
    np.testing.assert_allclose(widths(far), [1.0, 2.5, 5.0, 10.0])
    with pytest.raises(jf.InputError, match="tells no orders"):
        TorqueRipple.along_motion(robot, "elbow", slow)
    ripple = TorqueRipple.along_motion(robot, "elbow", far)
    assert ripple[0].basis[0].order == (1,) and ripple[-1].basis[0].order == (48,)
    wave = ripple[2].make(np.array([3.0, 4.0]))
    unit = ripple[2].basis[0].amplitude[0]
    angle = np.linspace(0, 7, 50)
    expected = unit * (3 * np.sin(3 * angle) + 4 * np.cos(3 * angle))
    np.testing.assert_allclose(wave.torque(angle), expected, atol=1e-12)
    (spring,) = Counterbalance.along_motion(robot, "shoulder", far)
    assert spring.make(np.array([2.0, 1.0])).rest == -0.5


# --- scores


def coloured(rng, n, memory=0.9):
    e = rng.standard_normal(n)
    for k in range(1, n):
        e[k] = memory * e[k - 1] + np.sqrt(1 - memory**2) * e[k]
    return e


def test_family_wise_level_in_coloured_noise():
    """Twelve candidates that add nothing: 5 % of the records may name one (200 records: fewer than 21 at 99.9 %)."""
    rng, n = np.random.default_rng(0), 1200
    t = np.arange(n)
    block = numbered([n], 40, 1)
    S = np.stack([np.ones(n), np.sin(0.05 * t)], axis=1)
    pool = [
        np.stack([np.sin(w * t), np.cos(w * t)][: 1 + i % 2], axis=1) for i, w in enumerate(0.02 + 0.01 * np.arange(12))
    ]
    rejected, project = 0, projector(S)
    own = [project(P) for P in pool]
    for seed in range(200):
        r = coloured(rng, n)
        rejected += family_wise([summed(P * project(r)[:, None], block) for P in own], 199, seed).min() <= 0.05
    assert rejected < 21


def test_covariance_in_coloured_noise():
    """Against the scatter of 400 estimates; white-noise formulas are three times too small here."""
    rng, n = np.random.default_rng(1), 1500
    S = np.stack([np.ones(n), np.sin(0.01 * np.arange(n))], axis=1)
    block, values, said = numbered([n], 60, 1), [], []
    for _ in range(400):
        y = S @ [1.0, 2.0] + coloured(rng, n)
        theta = np.linalg.lstsq(S, y, rcond=None)[0]
        values.append(theta)
        said.append(np.diag(covariance(y - S @ theta, S, block)))
    true, mean = np.var(values, axis=0), np.mean(said, axis=0)
    np.testing.assert_allclose(mean, true, rtol=0.3)
    assert np.all(true > 4 * np.diag(np.linalg.inv(S.T @ S)))


def test_held_out_rows_are_those_of_fits_to_the_others():
    rng = np.random.default_rng(2)
    X, r, fold = rng.standard_normal((60, 3)), rng.standard_normal(60), np.arange(60) % 4
    left = held_out(X, r, fold)
    for k in range(4):
        theta = np.linalg.lstsq(X[fold != k], r[fold != k], rcond=None)[0]
        np.testing.assert_allclose(left[fold == k], r[fold == k] - X[fold == k] @ theta, atol=1e-12)


# --- deflections


def deflection_runs(more, n=3, fs=250.0):
    """A gear of 256:1 with a linear spring of 5e6 N m/rad; `more(u, v)` is added to the deflection. The torque is held,
    as in `record`."""
    runs = []
    for seed in range(n):
        t = np.arange(int(10 * fs)) / fs
        (q, v, u), (*_, command) = (_pulled(*path(x, seed)[..., :1]) for x in (t, t + 0.5 / fs))
        link = q - 256 * u / 5e6 - more(u, v)
        runs.append(jf.Experiment(command, np.concatenate([q, link], axis=1), fs, y_quantity="position"))
    return runs


def _pulled(q, v, a):
    return q, v, 3 * np.sin(q) + 0.4 * a + 2 * np.tanh(v / 0.02)


def test_deflections_of_a_wrist_with_dampers():
    """Springs and dampers behind viscous motors, their deflections given: what is left of these is nothing."""
    fs, k, d, wrist = 250.0, 5e4, 100.0, np.array([[1.0, 0.0], [0.8, 1.0]])
    robot = jf.robot.with_parameters(arm(k, d), {f"{j}.coulomb_friction": 0.0 for j in ("shoulder", "elbow")})
    robot = robot.with_effects(jf.effects.WristCoupling("elbow", 0.8))

    def signals(t, seed):
        q, x = path(t, seed), 1e-3 * path(t, seed + 100)
        motor, speed, acceleration = (q @ wrist.T + x) * GEAR
        return q[0], motor, (k * x[0] + d * x[1]) / GEAR + ROTOR * acceleration + VISCOUS * speed

    runs = []
    for seed in (0, 1):
        t = np.arange(int(10 * fs)) / fs
        (link, motor, _), (*_, u) = signals(t, seed), signals(t + 0.5 / fs, seed)
        runs.append(jf.Experiment(u, np.concatenate([motor, link], axis=1), fs, y_quantity="position"))
    channel = DeflectionChannel.opened(robot, runs)
    assert np.sqrt(np.mean(channel.residual(State(robot, dict.fromkeys(channel.own(), k))) ** 2)) < 5e-3


def alone(found, axis, name):
    """What is left of the deflection on every run by a fit to the others, with one candidate or none."""
    return np.array(found.settings["alone"][axis][name])


@pytest.mark.slow
def test_friction_before_the_gear_is_named():
    """Readings as of 16-bit encoders."""
    rng = np.random.default_rng(0)
    noise = lambda u: 1e-5 * rng.standard_normal(u.shape)
    found = diagnose(None, deflection_runs(lambda u, v: -256 * 2 * np.tanh(v / 0.02) / 5e6 + noise(u)))
    assert found.verdict == "named" and [e.name for e in found.effects] == ["coulomb_friction"]
    assert abs(found.effects[0].parameters["level"].value / 2 - 1) < 0.05  # N m of the motor
    assert abs(found.parameters["axis1.stiffness"].value / (5e6 / 256) - 1) < 0.05
    assert np.all(alone(found, "axis1", "result") < 0.1 * alone(found, "axis1", "base") + 0.1)


@pytest.mark.slow
def test_a_late_link_encoder_is_named():
    found = diagnose(None, deflection_runs(lambda u, v: 2e-3 * v))
    assert [e.name for e in found.effects] == ["sensor_delay"] and found.verdict == "named"
    assert abs(found.effects[0].parameters["delay"].value - 2e-3) < 1e-5
    viscous = next(x for x in found.ranking if x.name == "viscous_friction")
    assert viscous.expected["coefficient"] < 0 and "a sign or size that no such effect has" in viscous.why


@pytest.mark.slow
def test_a_linear_spring_needs_nothing():
    rng = np.random.default_rng(0)
    found = diagnose(None, deflection_runs(lambda u, v: 1e-6 * rng.standard_normal(u.shape)))
    assert found.verdict == "sufficient" and not found.effects
    assert np.all(alone(found, "axis1", "base") < 0.05)


def test_deflections_need_both_sides():
    runs = deflection_runs(lambda u, v: 0.0)
    with pytest.raises(jf.InputError, match="no robot"):
        diagnose(None, [jf.Experiment(x.u, x.y[..., :1], 250.0, y_quantity="position") for x in runs])
    with pytest.raises(jf.InputError, match="two or more"):
        diagnose(None, runs[:1])


# --- the FRF of a drive


def drive_frf(effects, seed=0, noise=0.01):
    """Speed of an inertia, and what else it is said to have; relative noise, known."""
    f, rng = np.arange(10.0, 250.0), np.random.default_rng(seed)
    s = 2j * np.pi * f
    G = 100.0 / (s + effects.get("friction", 0.0))
    if "mode" in effects:
        for w, sign in zip(effects["mode"], (1, -1), strict=True):
            G = G * (1 + 0.06 * s / (2 * np.pi * w) + (s / (2 * np.pi * w)) ** 2) ** sign
    G = G * np.exp(-s * effects.get("delay", 0.0)) / (1 + s * effects.get("lag", 0.0))
    G = G * (1 + noise * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))) / np.sqrt(2))
    cov = (noise * np.abs(G)) ** 2
    one = np.ones((1, len(f)))
    return jf.FRF(G[None, :, None, None], f, cov[None, :, None, None] + 0j, 20 * one, 0 * one.astype(int), one)


@pytest.mark.parametrize(
    ("truth", "names"),
    [
        ({}, []),
        slow({"friction": 40.0}, ["viscous_friction"]),
        slow({"lag": 2e-3}, ["current_loop_lag"]),
        slow({"delay": 1e-3}, ["torque_delay"]),
        slow({"mode": (50.0, 75.0), "lag": 3e-3}, ["current_loop_lag", "elastic_load"]),
    ],
)
def test_drives(truth, names):
    found = diagnose(None, [drive_frf(truth), drive_frf(truth, seed=1)], heldout_count=1)
    assert sorted(e.name for e in found.effects) == names
    assert found.verdict == ("named" if names else "sufficient")
    values = {k: v.value for e in found.effects for k, v in e.parameters.items()}
    assert abs(found.parameters["drive.motor_inertia"].value * 100.0 - 1) < 0.02
    inertia = found.parameters["drive.motor_inertia"].value
    for key, name, unit in (("friction", "coefficient", inertia), ("lag", "time_constant", 1), ("delay", "delay", 1)):
        if key in truth:
            assert abs(values[name] / unit / truth[key] - 1) < 0.05
    if "mode" in truth:
        assert abs(values["antiresonance"] - 50) < 0.5 and abs(values["resonance"] - 75) < 0.5
    np.testing.assert_allclose(found.gap.after, found.gap.floor, rtol=0.1)


@pytest.mark.slow
def test_a_drive_by_the_command(tmp_path):
    """Its FRF, another held out: result, page and the drive with what was missing, which is sufficient then."""
    files = [str(tmp_path / name) for name in ("a.nc", "b.nc")]
    for seed, path in enumerate(files):
        jf.io.write_frf(path, drive_frf({"lag": 2e-3}, seed))
    out = [str(tmp_path / name) for name in ("gap.json", "gap.html", "drive.toml")]
    arguments = ["diagnose", *files, "--heldout-count", "1", "-o", out[0], "--report", out[1], "--robot-out", out[2]]
    assert main(arguments) == 0
    (effect,) = jf.io.read_gap(out[0])["effects"]
    assert (
        effect["name"] == "current_loop_lag" and abs(effect["parameters"]["time_constant"]["value"] / 2e-3 - 1) < 0.05
    )
    page = (tmp_path / "gap.html").read_text()
    assert "log FRF residual" in page and "orque residual" not in page
    drive = jf.io.read_robot(out[2])
    assert [e.name for e in drive.effects] == ["current_loop_lag"]
    assert main(["diagnose", files[1], "--robot", out[2], "-o", out[0]]) == 0
    assert jf.io.read_gap(out[0])["verdict"] == "sufficient"


@pytest.mark.slow
def test_deflections_by_the_command(tmp_path):
    """Text files of motor and link positions, one held out, as the guide has it; no robot."""
    rng, files = np.random.default_rng(0), []
    for i, run in enumerate(deflection_runs(lambda u, v: -256 * 2 * np.tanh(v / 0.02) / 5e6)):
        files.append(str(tmp_path / f"sides{i}.csv"))
        sides = run.y[0, 0] + 1e-5 * rng.standard_normal(run.y[0, 0].shape)
        np.savetxt(
            files[-1], np.column_stack([run.u[0, 0], sides]), delimiter=",", header="torque,motor,link", comments=""
        )
    out = str(tmp_path / "gap.json")
    named = ["--map", "u=torque,y=[motor;link]", "--set", "fs=250,y_quantity=position"]
    assert main(["diagnose", *files, *named, "--heldout-count", "1", "-o", out]) == 0
    found = jf.io.read_gap(out)
    assert found["verdict"] == "named" and [e["name"] for e in found["effects"]] == ["coulomb_friction"]
    assert abs(found["effects"][0]["parameters"]["level"]["value"] / 2 - 1) < 0.05


def driven(seed, fs=1000.0, period=2000, fine=20):
    """Three periods of an inertia of .01 kg m^2 with viscous friction of .02 N m s/rad, its torque held: explicit Euler
    steps. Odd lines, of which a quarter is left out."""
    rng = np.random.default_rng(seed)
    lines = np.arange(11, 180, 2)
    lines = lines[rng.uniform(size=len(lines)) > 0.25]
    U = np.zeros(period // 2 + 1, complex)
    U[lines] = np.exp(2j * np.pi * rng.uniform(size=len(lines)))
    u = np.fft.irfft(U)
    u *= 2.0 / u.std()
    speed, y = 0.0, []
    for torque in np.tile(u, 4):
        y.append(speed)
        for _ in range(fine):
            speed += (torque - 0.02 * speed) / 0.01 / (fs * fine)
    y = np.array(y)[period:] + 1e-3 * rng.standard_normal(3 * period)
    return jf.Experiment(np.tile(u, 3)[:, None], y[:, None], fs, period=period, lines=lines, y_quantity="velocity")


@pytest.mark.slow
def test_a_drive_s_records_by_the_command(tmp_path):
    """A torque that is held acts half a sample late; friction of a linear kind distorts nothing."""
    files = [str(tmp_path / name) for name in ("a.nc", "b.nc")]
    for seed, path in enumerate(files):
        jf.io.write(path, driven(seed))
    assert main(["diagnose", *files, "--heldout-count", "1", "-o", str(tmp_path / "gap.json")]) == 0
    found = jf.io.read_gap(tmp_path / "gap.json")
    values = {e["name"]: next(iter(e["parameters"].values()))["value"] for e in found["effects"]}
    assert sorted(values) == ["torque_delay", "viscous_friction"]
    assert abs(values["torque_delay"] / 5e-4 - 1) < 0.01 and abs(values["viscous_friction"] / 0.02 - 1) < 0.02
    assert "Distortion: none stands clear of the noise" in found["says"]


def test_one_kind_of_data_at_a_time(tmp_path, capsys):
    jf.io.write_frf(tmp_path / "frf.nc", drive_frf({}))
    jf.io.write(tmp_path / "run.nc", deflection_runs(lambda u, v: 0.0, n=1)[0])
    assert main(["diagnose", str(tmp_path / "frf.nc"), str(tmp_path / "run.nc"), "-o", str(tmp_path / "gap.json")]) == 2
    assert "FRFs and records; expected either" in capsys.readouterr().err
