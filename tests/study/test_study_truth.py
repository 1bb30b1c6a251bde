"""The truth of Table I: a two-axis arm in slow motion, against its equations written out and against a simulation."""

import functools

import jax.random as jr
import numpy as np
import pytest
import scipy.signal

import jaxfrf as jf
from jaxfrf.robot import with_parameters
from jaxfrf.study.bias import amplitude_bias, true_response
from jaxfrf.study.hidden import model

FS, PERIOD, LINES = 1000.0, 4000, np.arange(17, 240, 6)
SLOW, SPEED = [3, 5], (90.0, 90.0)  # lines; rad/s: the arm turns by 11 and 8 degrees to either side
REST = np.array([0.3, 0.9])
GEAR, ROTOR = np.array([100.0, 80.0]), np.array([1e-3, 5e-4])
STIFFNESS, DAMPING, VISCOUS = np.array([9e4, 3e4]), np.array([30.0, 10.0]), np.array([1e-3, 8e-4])
FREQUENCY = LINES * FS / PERIOD


@functools.cache
def robot():
    """The study's small robot with light damping and without what has no linear response."""
    light = {"shoulder.damping": DAMPING[0], "elbow.damping": DAMPING[1]}
    return with_parameters(model(), light | {"shoulder.coulomb_friction": 0.0, "elbow.coulomb_friction": 0.0})


def written_out(q):
    """Motor acceleration per motor torque of two links in a plane on elastic gears, torque held between samples."""
    mass, length, gravity = np.array([20.0, 10.0]), 0.5, 9.81
    com, about_com = np.array([[0.25, 0.0], [0.2, 0.05]]), np.array([1.0, 0.4])
    turned = lambda angle, p: np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ p
    tip = turned(q[1], com[1])
    far = np.array([length, 0.0]) + tip  # the second centre of mass from the first joint
    M22 = about_com[1] + mass[1] * tip @ tip
    M12 = about_com[1] + mass[1] * far @ tip
    M11 = about_com.sum() + mass[0] * com[0] @ com[0] + mass[1] * far @ far
    M = np.array([[M11, M12], [M12, M22]])
    heights = turned(q[0], com[0])[1], turned(q[0], far)[1], turned(q[0], tip)[1]
    K22 = -gravity * mass[1] * heights[2]
    falling = np.array([[-gravity * (mass[0] * heights[0] + mass[1] * heights[1]), K22], [K22, K22]])

    def across(of_spring, at_motor, at_arm):
        G = np.diag(1 / GEAR)
        return np.block([[G @ of_spring @ G + at_motor, -G @ of_spring], [-of_spring @ G, of_spring + at_arm]])

    zero = np.zeros((2, 2))
    inverse = np.linalg.inv(np.block([[np.diag(ROTOR), zero], [zero, M]]))
    K = across(np.diag(STIFFNESS), zero, falling)
    D = across(np.diag(DAMPING), np.diag(VISCOUS), zero)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ K, -inverse @ D]])
    B = np.vstack([np.zeros((4, 2)), inverse[:, :2]])
    A, B, *_ = scipy.signal.cont2discrete((A, B, np.eye(2, 8), np.zeros((2, 2))), 1 / FS)
    s, z = 2j * np.pi * FREQUENCY, np.exp(2j * np.pi * FREQUENCY / FS)
    return np.stack([x**2 * np.linalg.solve(y * np.eye(8) - A, B)[:2] for x, y in zip(s, z, strict=True)])


def feedback():
    """Torque per motor acceleration that the sampled controller takes back: its file's gains, written out."""
    z = np.exp(2j * np.pi * FREQUENCY / FS)[:, None]
    speed = (1 - 1 / z) * FS
    law = np.array([0.2, 0.1]) * (10.0 + speed) * (1 + 1 / (0.1 * FS * (1 - 1 / z)))
    return law / (2j * np.pi * FREQUENCY[:, None]) ** 2


def turning(t):
    """Arm angles in the slow motion, (time, axis), rad."""
    w = 2 * np.pi * np.array(SLOW) * FS / PERIOD
    return REST + np.array(SPEED) / w / GEAR * np.sin(w * t[:, None] + np.array([0.4, 1.9]))


def record():
    """A log of the slow motion alone: what the places and weights of the truth come from."""
    y = GEAR * (turning(np.arange(PERIOD) / FS) - REST)
    signals = {name: x[None, None] for name, x in (("y", y), ("u", 0.01 * y), ("r", y))}
    return jf.Experiment(**signals, q=REST[None], fs=FS, period=PERIOD, lines=LINES, y_quantity="position")


@pytest.mark.slow
def test_the_equations_written_out_are_the_robots():
    from jaxfrf.robot import discretise, linearise, operating_point, state_space, state_space_frf

    linear = linearise(robot(), operating_point(robot(), REST[None]), VISCOUS)
    G = np.asarray(state_space_frf(discretise(state_space(linear, "position"), FS), FREQUENCY))[0]
    s = 2j * np.pi * FREQUENCY[:, None, None]
    np.testing.assert_allclose(s**2 * G, written_out(REST), rtol=1e-6)


@pytest.mark.slow
def test_the_truth_of_an_arm_in_slow_motion():
    """<G W> <W>^-1 over 400 moments of the motion, against the study's own places of it; the arm at rest is off by
    twenty times as much and more."""
    eye, C, mean, through = np.eye(2), feedback(), 0.0, 0.0
    for q in turning(np.linspace(0, PERIOD / FS, 400, endpoint=False)):
        G = written_out(q)
        W = np.linalg.inv(eye + C[:, :, None] * G)
        mean, through = mean + W, through + G @ W
    expected = through @ np.linalg.inv(mean)
    off = lambda G: amplitude_bias(G, expected) / amplitude_bias(0 * expected, expected)
    found = true_response(robot(), record(), FREQUENCY, SPEED)[0]
    assert off(found) < 1e-3 and off(written_out(REST)) > 20 * off(found)


@pytest.mark.slow
def test_an_estimate_is_nearer_to_the_moving_arm():
    """Friction-free, noise-free, many experiments: what is left of the distance is the motion's own distortion."""
    plan = jf.Multisine(
        FS, PERIOD, np.arange(17, 240, 2), rms=[2.0, 3.0], slow=jf.SlowSine(SLOW, SPEED), blocks=6, seed=4
    )
    data = jf.simulate(robot(), plan, REST[None], key=jr.key(0), noise=0.0, run_in=3.0, chunk=6)
    spectra = jf.with_output_quantity(jf.dft(data), "acceleration")
    frf = jf.estimate(spectra, jf.JointInputOutput(jf.H1()))
    G, k = np.asarray(frf.G)[0], np.isin(data.lines, LINES)
    moving = true_response(robot(), data, frf.frequency, SPEED)[0]
    assert amplitude_bias(G, moving) < 0.4 * amplitude_bias(G[k], written_out(REST))
