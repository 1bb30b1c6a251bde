"""Start values of springs: against a two-mass closed form, and against the robots that made the FRFs."""

import dataclasses
import functools

import equinox as eqx
import jax.random as jr
import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.graybox import Coordinates
from jaxfrf.graybox.guess import guessed, initial_guess
from jaxfrf.robot import parameters, r3x, robot_from_table, with_parameters

FREQUENCY = np.linspace(2, 80, 100)


def frf_of(G, q, noise=0.0, quantity="acceleration", frequency=FREQUENCY):
    """An FRF whose elements err independently with this relative standard deviation."""
    rng = np.random.default_rng(1)
    error = rng.standard_normal((*G.shape, 2)) @ [1, 1j] / np.sqrt(2)
    variance = np.square(noise * np.abs(G)).swapaxes(-1, -2).reshape(*G.shape[:2], -1)
    shape = G.shape[:2]
    return jf.FRF(
        G=G * (1 + noise * error),
        frequency=frequency,
        cov=variance[..., None] * np.eye(variance.shape[-1], dtype=complex),
        dof=np.full(shape, 20.0),
        status=np.zeros(shape, int),
        window=np.ones(shape),
        q=q,
        y_quantity=quantity,
    )


def planar(masses, stiffness=1.0, damping=1.0):
    """Links of .6 m that turn about vertical axes: gravity has no part in it."""
    joints = [
        {
            "name": f"j{i}",
            "type": "driven",
            "axis": [0.0, 0.0, 1.0],
            "offset": [0.6 if i else 0.0, 0.0, 0.0],
            "mass": mass,
            "com": [0.3, 0.0, 0.0],
            "inertia": [0.1, 0.5, 0.5, 0.0, 0.0, 0.0],
            "gear_ratio": 100.0,
            "motor_inertia": 1e-3,
            "viscous_friction": 1e-3,
            "stiffness": stiffness,
            "damping": damping,
        }
        for i, mass in enumerate(masses)
    ]
    return robot_from_table({"name": "planar", "gravity": [0.0, 0.0, -9.81], "joint": joints})


def two_masses(k, d, arm=20 * 0.3**2 + 0.5, n=100.0, motor=1e-3, f=1e-3):
    """Torque to motor motion of a motor, a gear, a spring and an arm, (1, freq, 1, 1)."""
    s = 2j * np.pi * FREQUENCY
    spring = (k + d * s) * arm * s**2 / (arm * s**2 + k + d * s)  # what the arm puts against the gear
    return (s**2 / (motor * s**2 + f * s + spring / n**2))[None, :, None, None]


def test_one_axis_against_its_closed_form():
    frf = frf_of(two_masses(5e4, 30.0), np.zeros((1, 1)))
    found = initial_guess(jf.RobotModel(planar([20.0]), hold=None), frf)
    assert found.values == pytest.approx({"j0.stiffness": 5e4, "j0.damping": 30.0}, rel=1e-6)
    assert found.notes == () and found.error_db < 1e-6


def test_an_axis_too_stiff_for_the_band_is_said_to_be_assumed():
    """Free resonance at 180 Hz, antiresonance at 147 Hz."""
    frf = frf_of(two_masses(2e6, 30.0), np.zeros((1, 1)), noise=0.01)
    found = initial_guess(jf.RobotModel(planar([20.0]), hold=None), frf)
    assert "j0: no antiresonance in the band" in found.notes[0]
    assert found.values["j0.stiffness"] == pytest.approx(2e6, rel=0.2)


def test_a_model_that_does_not_fit_is_said_so():
    """An FRF in other units of torque."""
    frf = frf_of(5 * two_masses(5e4, 30.0), np.zeros((1, 1)))
    found = initial_guess(jf.RobotModel(planar([20.0]), hold=None), frf)
    assert found.error_db > 3 and "check masses" in " ".join(found.notes)


def made_by(robot, q, frequency=FREQUENCY, noise=0.0):
    model = jf.RobotModel(robot)
    values = (coordinates := Coordinates(model.parameters)).values(coordinates.start())
    G = np.stack([np.asarray(model.response(frequency, values, x)) for x in q])
    return frf_of(G, q, noise, frequency=frequency)


SPRINGS = {"j0.stiffness": 2e4, "j1.stiffness": 4e5, "j0.damping": 100.0, "j1.damping": 60.0}


@functools.cache
def two_axes(noise=0.0):
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 2))
    return made_by(with_parameters(planar([20.0, 12.0]), SPRINGS), q, noise=noise)


@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 0.05])
@pytest.mark.slow
def test_two_axes_one_of_which_shows_no_antiresonance(noise):
    found = initial_guess(planar([20.0, 12.0], 1e9, 1e9), two_axes(noise))
    assert any(note.startswith("j1: no antiresonance") for note in found.notes)
    off = {name: abs(np.log(found.values[name] / value)) for name, value in SPRINGS.items()}
    # Noise hides the damping of the mode outside the band.
    determined = SPRINGS if not noise else [name for name in SPRINGS if name != "j1.damping"]
    assert max(off[name] for name in determined) < (0.1 if noise else 1e-3)


@pytest.mark.slow
def test_what_the_model_fixes_and_bounds_stays():
    model = jf.RobotModel(planar([20.0]), hold=None)
    changed = model.parameters | {
        "j0.damping": jf.Parameter(25.0, free=False),
        "j0.stiffness": jf.Parameter(2e6, bounds=(1e5, 1e7)),
    }
    model = eqx.tree_at(lambda m: m.parameters, model, changed, is_leaf=lambda x: isinstance(x, dict))
    held = guessed(model, frf_of(two_masses(5e4, 30.0), np.zeros((1, 1))))
    assert held.parameters["j0.damping"].start == 25.0 and not held.parameters["j0.damping"].free
    assert 1e5 < held.parameters["j0.stiffness"].start < 1.5e5
    assert held.parameters["j0.effective_friction"].start == model.parameters["j0.effective_friction"].start


LINEAR = {
    **{f"joint{i}.stiffness_ratio": 1.0 for i in (1, 2, 3)},
    "joint1.stiffness": 4.74e5,
    "joint2.stiffness": 3.53e5,
    "joint3.stiffness": 2.09e5,
}


@functools.cache
def linear_r3x(noise):
    robot = with_parameters(r3x(), LINEAR)
    return robot, made_by(robot, jf.random_positions(7, jr.key(3)), np.geomspace(4.0, 79.0, 84), noise)


def placeholder(robot, value):
    return with_parameters(robot, dict.fromkeys(parameters(robot), value))


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "value"), [(0.0, 1.0), (0.05, 1e9)])
def test_fit_from_the_guess_finds_the_truth(noise, value):
    robot, frf = linear_r3x(noise)
    true = {name: float(v) for name, v in parameters(robot).items()}
    begin = guessed(jf.RobotModel(placeholder(robot, value)), frf)
    found = jf.fit(begin, frf, starts=6)
    assert found.verdict == "unimodal" and found.close_starts >= 5
    error = {name: abs(found.values[name] / v - 1) for name, v in true.items()}
    if not noise:
        assert max(error.values()) < 1e-6
        return
    # Chi-square of what is left, by the uncertainty that the fit states: a minimum elsewhere would be far away.
    names = list(found.coordinates.names)
    index = [names.index(name) for name in true]
    distance = np.array([np.log(found.values[name] / v) for name, v in true.items()])
    cov = np.asarray(found.uncertainty.cov)[np.ix_(index, index)]
    assert distance @ np.linalg.solve(cov, distance) < 40  # 16 parameters: 99.9 % below 39.3
    assert max(v for name, v in error.items() if name.endswith("stiffness")) < 0.005


R3X = pytest.param(linear_r3x, {"joint6", "bearing2", "upper_arm_torsion"}, id="R3X")
SMALL = pytest.param(lambda noise: (planar([20.0, 12.0]), two_axes(noise)), {"j1"}, id="two axes")


@pytest.mark.slow
@pytest.mark.parametrize(("made", "assumed"), [SMALL, R3X])
def test_the_robots_own_springs_are_not_looked_at(made, assumed):
    robot, frf = made(0.0)
    some, others = (initial_guess(placeholder(robot, value), frf) for value in (1.0, 1e9))
    assert some.values == others.values and some.notes == others.notes
    assert {note.split(":")[0] for note in some.notes} == assumed


def test_what_cannot_be_guessed():
    frf, robot = frf_of(np.ones((3, len(FREQUENCY), 2, 2), complex), np.zeros((3, 2))), planar([20.0, 12.0])
    with pytest.raises(jf.InputError, match="no springs"):
        initial_guess(planar([20.0, 12.0], np.inf), frf)
    with pytest.raises(jf.InputError, match=r"motor acceleration.*motor velocity"):
        initial_guess(jf.RobotModel(robot, quantity="velocity"), frf)
    with pytest.raises(jf.InputError, match=r"2 outputs and 2 inputs.*1 of both"):
        initial_guess(planar([20.0]), frf)
    with pytest.raises(jf.InputError, match="q of the FRF"):
        initial_guess(robot, dataclasses.replace(frf, q=None))
    with pytest.raises(jf.InputError, match="not finite"):
        initial_guess(robot, dataclasses.replace(frf, q=np.full((3, 2), np.nan)))
