"""Machines of one's own with effects: against SciPy's integrator, and against what others found on a real axis."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal

import jaxfrf as jf
from jaxfrf.effects import Backlash, CoulombFriction, FrictionAsymmetry
from jaxfrf.machine import CubicSpring, Machine, diagnose_machine, fit_machine, rank_effects, simulate_machine
from jaxfrf.machine.diagnose import _smoothed, _typical
from jaxfrf.machine.simulate import fine_steps, settling

FS, PERIOD = 100.0, 200
TRUE = {"m": 2.0, "d": 3.0, "k": 2000.0}
CUBIC = 3e5


def matrices(v):
    return v["m"] * jnp.eye(1), v["d"] * jnp.eye(1), v["k"] * jnp.eye(1)


def machine(**start):
    return Machine(
        matrices, TRUE | start, inputs=[[1.0]], outputs=[[1.0]], places={"spring": [1.0]}, quantity="position"
    )


def driven(force, fs=FS, cubic=CUBIC):
    """Position of a mass on a cubic spring under a held force, from rest, by SciPy's adaptive integrator."""
    x, found = np.zeros(2), []
    for f in force:
        found.append(x[0])
        law = lambda t, s, f=f: [s[1], (f - TRUE["d"] * s[1] - TRUE["k"] * s[0] - cubic * s[0] ** 3) / TRUE["m"]]
        x = scipy.integrate.solve_ivp(law, (0, 1 / fs), x, rtol=1e-10, atol=1e-14).y[:, -1]
    return np.array(found)


@pytest.fixture(scope="module")
def record():
    """The last two of eight periods."""
    rng = np.random.default_rng(3)
    t = np.arange(PERIOD) / FS
    f = sum(4.0 * np.cos(2 * np.pi * k * t * FS / PERIOD + rng.uniform(0, 6)) for k in range(3, 22, 2))
    u = np.tile(f, 8)
    y = driven(u)[6 * PERIOD :]
    return jf.Experiment(u[: len(y)], y, FS, PERIOD, y_quantity="position", u_unit="N", y_unit="m")


def test_motion_is_that_of_another_integrator(record):
    found = simulate_machine(machine().with_effects(CubicSpring("spring", CUBIC)), record, settle=6, steps=2)
    rms = np.sqrt(np.mean(np.asarray(record.y) ** 2))
    np.testing.assert_allclose(found[0], record.y[0, 0, -PERIOD:], atol=3e-3 * rms)


def test_steps_follow_a_spring_that_an_effect_adds():
    """It is ten times as stiff as the machine's own: with steps for that one alone the motion is up to 6 % off."""
    u = 400.0 * np.cos(np.arange(60) * 0.3)
    stiff = machine().with_effects(CubicSpring("spring", 3e6))
    y, data = driven(u, cubic=3e6), jf.Experiment(u, 0 * u, FS, y_quantity="position")
    np.testing.assert_allclose(simulate_machine(stiff, data)[0, :, 0], y, atol=5e-3 * np.std(y))


@pytest.mark.parametrize("resonance", [15.0, 35.0, 45.0])
def test_steps_follow_every_mode_that_samples_show(resonance):
    """Two masses, their mode at up to .45 of the sampling frequency, against the held input's exact response (matrix
    exponential): a step too long damps the mode, and a fit puts that into the damper."""
    k = 0.5 * (2 * np.pi * resonance) ** 2
    M, D = np.eye(2), np.diag([2.0, 3.0]) + 2.0 * np.array([[1, -1], [-1, 1]])
    K = k * np.array([[1.0, -1.0], [-1.0, 1.0]]) + 20.0 * np.eye(2)
    two = Machine(lambda v: (M, D, v["k"] / k * K), {"k": k}, inputs=[[1.0], [0.0]], outputs=[[1.0, 0.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -D]])
    B = np.array([[0.0], [0.0], [1.0], [0.0]])
    C, zero = np.array([[0.0, 0.0, 1.0, 0.0]]), np.zeros((1, 1))
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, B, C, zero), 1 / FS)
    lines = np.arange(1, 99, 2)
    U = np.zeros(PERIOD // 2 + 1, complex)
    U[lines] = np.exp(2j * np.pi * np.random.default_rng(0).uniform(size=len(lines)))
    z = np.exp(2j * np.pi * np.arange(PERIOD // 2 + 1) / PERIOD)
    Y = np.array([(C @ np.linalg.solve(x * np.eye(4) - Ad, Bd))[0, 0] for x in z]) * U
    u, y = (np.fft.irfft(X, PERIOD)[:, None] for X in (U, Y))
    data = jf.Experiment(u[None, None], y[None, None], FS, PERIOD, lines=lines, y_quantity="velocity")
    found = np.asarray(simulate_machine(two, data))[0, -PERIOD:]
    assert np.std(found - y) < 1e-3 * np.std(y)


def test_linear_part_is_a_gray_box(record):
    f = np.array([1.0, 5.0, 20.0])
    s = 2j * np.pi * f
    G = machine().response(f, TRUE, None)[:, 0, 0]
    np.testing.assert_allclose(G, 1 / (TRUE["m"] * s**2 + TRUE["d"] * s + TRUE["k"]), rtol=1e-12)


def linear(periods, seed, hold=True):
    """Position of the mass on its linear spring under a force held from sample to sample: SciPy's discrete system at
    every line, with noise of 5 %. Or under a smooth force: the continuous system."""
    rng = np.random.default_rng([9, seed])
    period, lines = 4 * PERIOD, np.arange(11, 150, 2)
    U = np.zeros(period // 2 + 1, complex)
    U[lines] = 2.0 * period * np.exp(2j * np.pi * rng.random(len(lines)))
    m, d, k = TRUE.values()
    parts = [[0, 1], [-k / m, -d / m]], [[0], [1 / m]], [[1, 0]], [[0]]
    held = scipy.signal.cont2discrete([np.array(x, float) for x in parts], 1 / FS)
    turn = 2 * np.pi * np.arange(period // 2 + 1) / period
    G = (
        scipy.signal.dfreqresp((*held[:4], 1 / FS), turn)[1].ravel()
        if hold
        else 1 / np.polyval([m, d, k], 1j * turn * FS)
    )
    u, y = (np.tile(np.fft.irfft(x, period), periods) for x in (U, G * U))
    y = y + 0.05 * y.std() * rng.standard_normal(y.shape)
    return jf.Experiment(u, y, FS, period, y_quantity="position", u_unit="N", y_unit="m")


@pytest.mark.parametrize("periods", [1, 2, 3])
def test_few_periods_tell_their_noise(periods):
    """The misfit of a right machine is one, and nothing is missing, however few periods tell what noise is: variances
    of one degree of freedom had made it 2."""
    found = diagnose_machine(machine(k=1700.0), linear(periods, 0), [CubicSpring("spring", 1e5)])
    assert found.verdict == "sufficient" and found.before.misfit == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("hold", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_what_the_input_does_between_its_samples(hold):
    """Taken as it is, values are right; taken as the other, the result says so."""
    data = linear(2, 0, hold)
    right = fit_machine(machine(k=1700.0), data, hold=hold)
    assert right.doubt == "" and max(abs(right.values[n] - TRUE[n]) / right.std[n] for n in TRUE) < 3
    wrong = diagnose_machine(machine(k=1700.0), data, [], hold=not hold)
    assert f"with hold={hold}" in wrong.doubt and wrong.doubt in str(wrong)


def test_a_smooth_input_without_a_period():
    """SciPy's response to the same sine in a hundred steps a sample."""
    t = np.arange(0, 1, 0.01 / FS)
    data = jf.Experiment(np.sin(60 * t[::100]), 0 * t[::100], FS, y_quantity="position")
    _, y, _ = scipy.signal.lsim(([1.0], [TRUE["m"], TRUE["d"], TRUE["k"]]), np.sin(60 * t), t)
    np.testing.assert_allclose(simulate_machine(machine(), data, hold=False)[0, :, 0], y[::100], atol=2e-3 * y.std())


@pytest.mark.slow
def test_intervals_of_two_periods():
    """24 seeds, three numbers: the rms of their errors over their deviations."""
    apart = []
    for seed in range(24):
        found = fit_machine(machine(k=1700.0, d=4.0), linear(2, seed))
        apart.append([(found.values[n] - TRUE[n]) / found.std[n] for n in TRUE])
    assert np.sqrt(np.mean(np.square(apart))) == pytest.approx(1.0, abs=0.25)


def test_names_of_effects():
    with pytest.raises(jf.InputError, match=r"joint: found 'gear'; expected a place of the machine \(spring\)"):
        machine().with_effects(CubicSpring("gear", 1.0))
    both = machine().with_effects(CoulombFriction("spring", 0.1)).held("m")
    assert not both.parameters["m"].free and both.parameters["spring.coulomb_friction.level"].free
    assert float(both.with_values({"k": 3.0}).parameters["k"].start) == 3.0
    with pytest.raises(jf.InputError, match="held: found 'x'"):
        both.held("x")
    with pytest.raises(jf.InputError, match="values: found 'x'"):
        both.with_values({"x": 1.0})


@pytest.mark.slow
def test_a_cubic_spring_is_found_and_fitted(record):
    """From starts that are 20 % off; the one candidate that is true is first, and its number is right."""
    start = machine(m=2.3, d=4.0, k=2400.0)
    candidates = [Backlash("spring", 1e-3), CoulombFriction("spring", 0.5), CubicSpring("spring", 1e5)]
    plain, ranked = rank_effects(start, record, candidates, settle=6)  # it rings for four seconds, two periods
    best = ranked[0]
    assert best.effect.name == "cubic_spring" and best.gain > 5 * ranked[1].gain
    assert plain.residual > 0.02 and best.fit.residual < 0.2 * plain.residual
    for name, value in {**TRUE, "spring.cubic_spring.stiffness": CUBIC}.items():
        assert abs(best.fit.values[name] / value - 1) < 0.02, name


@pytest.mark.slow
@pytest.mark.data
def test_a_real_axis(measured):
    """EMPS: mass 95.11 kg, 203.5 N s/m, Coulomb 20.39 N, offset -3.16 N by its authors (Janot, Gautier & Brunot 2019),
    from the torque along the motion: here from the motion under the measured force."""
    data = jf.io.read(
        measured / "emps" / "DATA_EMPS.mat",
        names={"u": "vir", "y": "qm"},
        values={"fs": 1000, "period": 6240, "samples": slice(6240, 18720), "y_quantity": "position", "y_unit": "m"},
        factor={"u": 35.15},
    )
    slide = Machine(
        lambda v: (v["mass"] * jnp.eye(1), v["damping"] * jnp.eye(1), jnp.zeros((1, 1))),
        {"mass": 80.0, "damping": 300.0},
        inputs=[[1.0]],
        outputs=[[1.0]],
        places={"slide": [1.0]},
        smoothing=1e-3,
    )
    plain = fit_machine(slide, data, settle=1)
    friction = slide.with_effects(CoulombFriction("slide", 5.0), FrictionAsymmetry("slide", 1.0))
    found = fit_machine(
        friction.held("slide.friction_asymmetry.level", "slide.friction_asymmetry.smoothing"), data, settle=1
    )
    assert found.residual < 0.3 * plain.residual and found.residual < 0.06
    known = {"mass": 95.11, "damping": 203.5, "slide.coulomb_friction.level": 20.39}
    for name, value in known.items():
        assert abs(found.values[name] / value - 1) < 0.08, (name, found.values[name])
    assert abs(found.values["slide.friction_asymmetry.offset"] + 3.16) < 0.5


def test_settling():
    """exp(-d/(2 m) t) = part; a rigid motion that has no damper is not waited for."""
    wait = settling(machine(d=0.4), TRUE | {"d": 0.4}, PERIOD / FS, 1e-3)
    assert wait == int(np.ceil(np.log(1e3) * 2 * TRUE["m"] / 0.4 / (PERIOD / FS)))
    assert settling(machine(), TRUE | {"d": 0.0, "k": 0.0}, 2.0, 1e-3) == 1
    assert settling(machine(), TRUE | {"d": 1e-6}, 2.0, 1e-3) == 50


@pytest.mark.slow
def test_what_a_machine_misses(record):
    """The spring is named on lines that no fit saw; with it, nothing is missing."""
    start = machine(m=2.3, d=4.0, k=2400.0)
    found = diagnose_machine(start, record, [CoulombFriction("spring", 0.5), CubicSpring("spring", 1e5)])
    assert found.verdict == "named" and [e.name for e in found.effects] == ["cubic_spring"]
    assert found.heldout[1] < 0.1 * found.heldout[0]
    assert abs(float(found.effects[0].stiffness) / CUBIC - 1) < 0.02
    assert diagnose_machine(found.fit.machine, record, []).verdict == "sufficient"


def test_friction_of_a_fast_record_asks_for_few_steps():
    """Candidates' friction turns within 2 % of the rms speed, and effects with a smoothing of their own by that."""
    m = lambda v: (1e-5 * jnp.eye(1), v["d"] * jnp.eye(1), v["k"] * jnp.eye(1))
    fast = Machine(m, {"d": 1e-4, "k": 1.0}, inputs=[[1.0]], outputs=[[1.0]], places={"spring": [1.0]})
    t = np.arange(600) / 600.0
    u = 0.1 * np.cos(2 * np.pi * 50 * t + 0.3) + 0.1 * np.cos(2 * np.pi * 21 * t)
    data = jf.Experiment(u, np.zeros(600), 600.0, 600, y_quantity="velocity")
    smoothed = _smoothed(fast, data, True)
    assert smoothed.smoothing > fast.smoothing and smoothed.parameters.keys() == fast.parameters.keys()
    steps = lambda one: fine_steps(one, {n: p.start for n, p in one.parameters.items()}, 600.0)
    assert max(steps(smoothed.with_effects(e)) for e in _typical(smoothed, data, True)) <= 3
    assert steps(fast.with_effects(CoulombFriction("spring", 5e-3))) > 30
    slow = fast.with_smoothing(1e3)
    assert _smoothed(slow, data, True) is slow
