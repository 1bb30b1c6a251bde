"""Records made by MuJoCo: they agree with jaxfrf's simulator where both have the same laws, and only there."""

import dataclasses

import equinox as eqx
import jax.random as jr
import numpy as np
import pytest
from _mujoco_records import R3X_RIPPLE, mujoco_experiment, r3x_ripple

import jaxfrf as jf
from jaxfrf import effects

KEY = jr.key(3)


def changed(robot, value, *kinds):
    return jf.robot.with_parameters(robot, {name: value for name in jf.robot.parameters(robot, kinds)})


def design(period=1000):
    """Two thirds of the paper's speeds, lines from 9 Hz on."""
    slow = jf.SlowSine([1, 2, 3, 1, 2, 3], [20.0, 20.0, 20.0, 30.0, 30.0, 30.0])
    lines = np.arange(5, 5 + period // 50, 2)
    return jf.Multisine(2000.0, period, lines, rms=[2.0, 2.0, 2.0, 4.0, 4.0, 6.0], slow=slow)


def relative(found, expected):
    """Largest relative rms of any channel."""
    rms = lambda x: np.sqrt(np.mean(x**2, axis=(0, 1, 2)))
    return np.max(rms(found - expected) / rms(expected))


def speed(data):
    return np.diff(data.y, axis=2)


def play(robot, ripple=None, **options):
    q = jf.random_positions(1, KEY)
    return mujoco_experiment(robot, design(), q, seed=0, run_in=0.5, noise=0.0, ripple=ripple, **options)


def both(robot, **options):
    ours = jf.simulate(robot, design(), jf.random_positions(1, KEY), key=KEY, run_in=0.5, noise=0.0)
    return play(robot, **options), ours


@pytest.fixture(scope="module")
def smooth():
    """Without Coulomb friction, the one law that differs."""
    return changed(jf.robot.r3x(), 0.0, "coulomb_friction")


@pytest.mark.slow
def test_linear_springs(smooth):
    """What MuJoCo does alone; `u`, `y`, `r` and the rest of the record stand for the same."""
    found, ours = both(changed(smooth, 1.0, "stiffness_ratio"))
    assert relative(found.u, ours.u) < 3e-5
    assert relative(speed(found), speed(ours)) < 1e-5
    np.testing.assert_allclose(found.r, ours.r, atol=1e-12)
    np.testing.assert_allclose(found.y, ours.y, atol=1e-4)
    same = lambda d: (d.fs, d.period, d.transient_periods, d.y_quantity, d.lines.tolist(), d.q.tolist())
    assert same(found) == same(ours)


@pytest.mark.slow
def test_effects(smooth):
    """Nonlinear springs, ripple and the effects of motors and gears, by laws written a second time."""
    torque, resolver = R3X_RIPPLE.torque, R3X_RIPPLE.resolver
    rows = lambda table, axis: [column[axis] for column in table]
    robot = smooth.with_effects(
        *(effects.TorqueRipple(axis, *rows(torque, axis)) for axis in range(6)),
        *(effects.ResolverRipple(axis, *rows(resolver, axis)) for axis in range(6)),
        effects.TorqueDelay(0, 4e-4),
        effects.CurrentLoopLag(1, 3e-4),
        effects.TorqueDelay(4, 1e-4),
        effects.CurrentLoopLag(4, 2e-4),
        effects.TorqueConstant(2, 0.02),
        effects.TorqueSaturation(3, 0.4),
        effects.FrictionAsymmetry(0, 0.05, 0.02),
        effects.StribeckFriction(1, 0.15),
        effects.LoadDependentFriction(2, 0.02),
        effects.DressPack(0, 50.0),
        effects.Counterbalance(1, 20.0),
        effects.ArmViscousFriction(2, 2.0),
        effects.Backlash(5, 1e-4),
    )
    found, ours = both(robot, substeps=4)
    assert relative(found.u, ours.u) < 1e-3
    assert relative(speed(found), speed(ours)) < 3e-4
    again = play(dataclasses.replace(robot, effects=robot.effects[12:]), ripple=R3X_RIPPLE, substeps=4)
    np.testing.assert_allclose(again.u, found.u, atol=1e-8)  # the same ripple, not as effects


@pytest.mark.slow
def test_friction():
    """Two laws of Coulomb friction, each of which tends to c sgn(v): their difference does with both widths."""
    robot = changed(jf.robot.r3x(), 1.0, "stiffness_ratio")
    differences = []
    for smoothing, stick, substeps in ((0.2, 1e-3, 2), (0.05, 2.5e-4, 4)):
        law = eqx.tree_at(lambda r: r.drives.friction.smoothing, robot, np.asarray(smoothing))
        found, ours = both(law, stick=stick, substeps=substeps)
        differences.append(relative(found.u, ours.u))
    without = play(changed(robot, 0.0, "coulomb_friction"))
    assert 3e-3 < differences[0] < 0.03 < 0.1 < relative(without.u, found.u)
    assert differences[1] < 0.4 * differences[0]


@pytest.mark.slow
def test_runs_do_not_depend_on_their_company(smooth):
    plan, q = design(500), jf.random_positions(2, KEY)
    play = lambda q, **options: mujoco_experiment(smooth, plan, q, seed=5, run_in=0.1, **options)
    done = []
    data = play(q, progress=done.append)
    alone = play(q, chunk=5, processes=1)
    np.testing.assert_allclose(data.u, alone.u, atol=1e-9)
    np.testing.assert_allclose(play(q[:1]).y, data.y[:1], atol=1e-9)
    assert done == sorted(done) and done[-1] == pytest.approx(1.0)
    silent = play(q, noise=0.0)
    counts = mujoco_experiment(
        smooth.with_effects(effects.EncoderQuantisation(3, 1e-3)), plan, q, seed=5, run_in=0.1, noise=0.0
    )
    np.testing.assert_allclose(counts.y[..., 3] / 1e-3, np.round(counts.y[..., 3] / 1e-3), atol=1e-6)
    assert np.std(counts.y[..., 3] - silent.y[..., 3]) < 0.02 * np.std(silent.y[..., 3])
    assert np.std(np.diff(data.y - silent.y, axis=2)[..., 0]) == pytest.approx(np.sqrt(2) * 5e-5, rel=0.1)


def test_errors(smooth):
    plan, q = design(500), jf.random_positions(1, KEY)
    play = lambda robot, **options: mujoco_experiment(robot, plan, q, seed=0, **options)
    with pytest.raises(ValueError, match="two substeps"):
        play(smooth, stick=1e-4)
    with pytest.raises(ValueError, match="twice"):
        play(smooth.with_effects(*2 * [effects.CurrentLoopLag(0, 1e-4)]))
    with pytest.raises(ValueError, match="5 axes"):
        short = [[x[:5] for x in table] for table in (r3x_ripple().torque, r3x_ripple().resolver)]
        play(smooth, ripple=dataclasses.replace(R3X_RIPPLE, torque=short[0], resolver=short[1]))
    reversed_motor = smooth.with_effects(effects.TorqueConstant(1, -2.0))
    with pytest.raises(RuntimeError, match=r"position 0, experiment \d leaves its reference"):
        play(reversed_motor, run_in=1.0)
