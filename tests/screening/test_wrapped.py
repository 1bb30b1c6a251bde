"""Counters that overflow are found in broadband signals, and designed signals are none."""

import numpy as np
import pytest
import scipy.signal

import jaxfrf as jf
from jaxfrf.screening.wrapped import wrapped

FS, PERIOD = 1000.0, 1500


def broadband(rng, part, n_periods, noise=0.0):
    """Random-phase multisine up to a part of half the sampling frequency, with white noise."""
    X = np.zeros(PERIOD // 2 + 1, complex)
    lines = np.arange(3, int(part * PERIOD / 2))
    X[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    x = np.tile(np.fft.irfft(X), n_periods)
    return x / x.std() + noise * rng.standard_normal(len(x))


def folded(x, part):
    """A counter whose range is a part of the signal's."""
    turn = part * np.ptp(x)
    return (x + turn / 2) % turn - turn / 2


def found(x, period=PERIOD, signal="u", y_quantity="velocity"):
    """What is said of x where it is u, y or r."""
    other = np.random.default_rng(99).standard_normal(len(x))
    given = {"u": other, "y": np.roll(other, 1), "r": other} | {signal: x}
    data = jf.Experiment(
        *(given[k][None, None, :, None] for k in "uy"),
        FS,
        period,
        r=given["r"][None, None, :, None],
        y_quantity=y_quantity,
    )
    return [f for f in jf.examine(data, (wrapped,)) if f.signal == signal]


@pytest.mark.parametrize(
    ("signal", "band", "noise"),
    [
        ("uyr"[(i + j) % 3], band, noise)
        for i, band in enumerate((0.1, 0.4, 0.7))
        for j, noise in enumerate((0.0, 0.01, 0.1))
    ],
)
def test_broadband_signals_that_wrap(signal, band, noise):
    for n_periods in (1, 2, 6):
        for part in (0.7, 0.85):
            x = broadband(np.random.default_rng([3, n_periods]), band, n_periods, noise)
            assert not found(x, signal=signal)
            (finding,) = found(folded(x, part), signal=signal)
            assert abs(finding.size / (part * np.ptp(x)) - 1) < 0.02


@pytest.mark.parametrize("part", [0.5, 0.6])
def test_signals_that_wrap_at_one_end(part):
    """Half of the samples of a counter from 0 on may have come in at its lower end."""
    for band in (0.1, 0.25):
        x = broadband(np.random.default_rng(7), band, 2, 0.003)
        x = x - x.min()
        (finding,) = found(x % (part * np.ptp(x)))
        assert abs(finding.size / (part * np.ptp(x)) - 1) < 0.02


def test_samples_and_place_of_a_wrap():
    x = broadband(np.random.default_rng(4), 0.5, 4, 0.01)
    bad = folded(x, 0.75)
    moved = np.flatnonzero(np.abs(bad - x) > 1e-9)
    (finding,) = found(bad)
    assert abs(int(finding.says.split("holds ")[1].split()[0]) - len(moved)) <= 0.1 * len(moved)
    assert finding.samples[0] in moved and "overflowed" in finding.says


def test_noise_that_is_white_shows_between_periods():
    x = broadband(np.random.default_rng(5), 0.97, 6, 0.03)
    assert not found(x)
    (finding,) = found(folded(x, 0.75))
    assert "opposite ends" in finding.says


def test_a_small_share_without_period():
    rng = np.random.default_rng(6)
    x = scipy.signal.sosfilt(scipy.signal.butter(6, 0.4, output="sos"), rng.standard_normal(50_000))
    assert not found(x, 0) and found(folded(x, 0.8), 0)


T = np.arange(PERIOD)
DESIGNED = {
    "prbs": lambda rng: np.repeat(np.where(rng.random(PERIOD // 3) > 0.5, 1.0, -1.0), 3),
    "white prbs": lambda rng: np.where(rng.random(PERIOD) > 0.5, 1.0, -1.0),
    "levels": lambda rng: np.repeat(rng.integers(-3, 4, PERIOD // 25), 25).astype(float),
    "uniform": lambda rng: rng.uniform(-1, 1, PERIOD),
    "stairs": lambda rng: np.repeat(rng.uniform(-1, 1, PERIOD // 25), 25),
    "square": lambda rng: np.sign(np.sin(2 * np.pi * (5 * T + 0.3) / PERIOD)),
    "square and lines": lambda rng: 3 * np.sign(np.sin(2 * np.pi * (2 * T + 0.3) / PERIOD)) + broadband(rng, 0.4, 1),
    "saw": lambda rng: (7 * T / PERIOD + 0.3) % 1.0 - 0.5,
    "one saw tooth": lambda rng: (T / PERIOD + 0.3) % 1.0 - 0.5,
    "triangle": lambda rng: np.abs((33 * T / PERIOD) % 1.0 - 0.5),
    "clipped": lambda rng: np.clip(broadband(rng, 0.7, 1), -1.2, 1.2),
    "limits and white": lambda rng: np.clip(broadband(rng, 0.97, 1), -1.6, 1.6),
    "schroeder": lambda rng: np.fft.irfft(
        np.exp(-1j * np.pi * T[: PERIOD // 2 + 1] ** 2 / 1200) * (T[:751] > 2) * (T[:751] < 600)
    ),
    "chirp": lambda rng: scipy.signal.chirp(T / FS, 2.0, 1.5, 475.0),
    "sine": lambda rng: np.sin(2 * np.pi * 0.45 * T + 0.3),
    "hammer": lambda rng: np.where(T == 100, 1.0, 0.0),
    "spikes": lambda rng: broadband(rng, 0.5, 1) + 6 * (rng.random(PERIOD) < 0.005),
    "tanh": lambda rng: np.tanh(3 * broadband(rng, 0.4, 1)),
    "three levels": lambda rng: rng.integers(-1, 2, PERIOD).astype(float),
    "sign and lines": lambda rng: np.sign(broadband(rng, 0.1, 1)) + 0.2 * broadband(rng, 0.5, 1),
    "saw and lines": lambda rng: (7 * T / PERIOD) % 1.0 - 0.5 + 0.1 * broadband(rng, 0.3, 1),
    "gauss": lambda rng: rng.standard_normal(PERIOD),
}


@pytest.mark.parametrize("name", DESIGNED)
def test_designed_signals_are_no_counters(name):
    for seed, noise in ((1, 0.0), (2, 1e-3), (3, 0.03)):
        for n_periods in (1, 4):
            rng = np.random.default_rng(seed)
            x = np.tile(DESIGNED[name](rng), n_periods)
            x = x + noise * x.std() * rng.standard_normal(len(x))
            signal = "ur"[(seed + n_periods) % 2]
            assert not found(x, signal=signal), (seed, n_periods)


def test_a_position_that_turns_at_one_speed_wraps():
    angle = (7 * np.arange(4 * PERIOD) / PERIOD + 0.3) % 1.0
    assert found(angle, 0, "y", "position") and not found(angle, 0, "y", "velocity")
