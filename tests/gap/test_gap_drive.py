"""A diagnosis of one drive of which nothing is known: two masses on a spring, linear, in a speed loop."""

import numpy as np
import pytest
import scipy.linalg

import jaxfrf as jf
from jaxfrf.effects import AbstractActuator
from jaxfrf.gap import diagnose

FS, PERIOD, PERIODS = 2000.0, 4000, 5
MOTOR, LOAD, SPRING, DAMPING, FRICTION = 2e-3, 3e-3, 60.0, 0.02, 0.004  # kg m^2, N m/rad, N m s/rad
GAIN, RESET = 0.15, 0.05  # N m s/rad, s
NOISE = 0.02  # of the torque, N m, and of the speed, rad/s


def record(seed):
    """Commands are held to the next sample, exactly."""
    rng, lines = np.random.default_rng(seed), np.arange(3, 301, 2)
    spectrum = np.zeros(PERIOD // 2 + 1, complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.uniform(size=len(lines)))
    r = np.fft.irfft(spectrum)
    r = np.tile(3 * r / r.std(), PERIODS)
    A = np.array(
        [
            [0, 1, -1],
            [-SPRING / MOTOR, -(FRICTION + DAMPING) / MOTOR, DAMPING / MOTOR],
            [SPRING / LOAD, DAMPING / LOAD, -DAMPING / LOAD],
        ]
    )
    whole = scipy.linalg.expm(np.block([[A, np.array([[0], [1 / MOTOR], [0]])], [np.zeros((1, 4))]]) / FS)
    A, b = whole[:3, :3], whole[:3, 3]
    x, integral, u, y = np.zeros(3), 0.0, np.zeros(len(r)), np.zeros(len(r))
    disturbance, noise = NOISE * rng.standard_normal((2, len(r)))
    for t in range(len(r)):
        y[t] = x[1] + noise[t]
        integral += (r[t] - y[t]) / FS / RESET
        u[t] = GAIN * (r[t] - y[t] + integral)
        x = A @ x + b * (u[t] + disturbance[t])
    signals = {name: s[None, None, :, None] for name, s in (("u", u), ("y", y), ("r", r))}
    return jf.Experiment(**signals, fs=FS, period=PERIOD, transient_periods=1, y_quantity="velocity")


@pytest.fixture(scope="module")
def found():
    return diagnose(None, record(0))


def test_noise_of_a_closed_loop_is_no_distortion(found):
    """At lines without excitation the loop moves the motor by less than the noise that it fights: Y - G U is all of
    that noise."""
    assert "Distortion: none stands clear of the noise" in found.says
    assert found.verdict == "named" and found.effects[0].name == "elastic_load"
    mode = found.effects[0].parameters
    true = np.sqrt([SPRING / LOAD, SPRING * (1 / MOTOR + 1 / LOAD)]) / (2 * np.pi)
    assert [mode[n].value for n in ("antiresonance", "resonance")] == pytest.approx(true, rel=5e-3)


def test_a_held_torque_is_late_by_half_a_sample(found):
    (delay,) = [e for e in found.effects if isinstance(e.effect, AbstractActuator) and e.effect.dead_time() > 0]
    assert float(delay.effect.dead_time()) == pytest.approx(0.5 / FS, rel=0.1)
    assert "held to the next sample acts half a sample late (0.25 ms here)" in found.says


@pytest.mark.slow
def test_one_period_shows_no_distortion():
    """Without noise between periods nothing tells the two apart: the FRF alone is compared."""
    data = jf.select_periods(record(0), 1, 2)
    assert "Distortion" not in diagnose(None, data).says
