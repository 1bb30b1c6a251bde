"""Period and excited lines from the signals alone."""

import re

import numpy as np
import pytest
import scipy.signal

import jaxfrf as jf
from jaxfrf.periodic import find_lines, find_period

PERIOD = 1000
DESIGNS = {
    "every line": np.arange(11, 120),
    "odd": np.arange(11, 160, 2),
    "odd-odd": np.arange(13, 160, 4),
    "random odd": np.delete(np.arange(11, 251, 2), np.arange(30) * 4 + np.random.default_rng(3).integers(0, 4, 30)),
    "log": np.unique(2 * np.floor(np.geomspace(5, 330, 60) / 2).astype(int) + 1),
    "sparse": np.sort(np.random.default_rng(4).choice(np.arange(20, 300), 30, replace=False)),
}


def record(lines, n, snr, channels=2, slow=0.0, seed=0):
    """n samples of a random-phase multisine of variance 1, with white noise and a slow sine: (time, channel)."""
    rng = np.random.default_rng(seed)
    half = np.zeros((PERIOD // 2 + 1, channels), complex)
    half[lines] = np.exp(2j * np.pi * rng.random((len(lines), channels)))
    x = np.fft.irfft(half, axis=0)
    x = x / x.std(axis=0) + slow * np.sin(4 * np.pi * np.arange(PERIOD) / PERIOD)[:, None]
    x = np.tile(x, (n // PERIOD + 1, 1))[:n]
    return x + 10 ** (-snr / 20) * rng.standard_normal(x.shape)


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize(("snr", "slow"), [(3, 0), (10, 0), (30, 0), (60, 10), (np.inf, 10)])
@pytest.mark.parametrize("n", [1700, 2000, 5300])
def test_period(design, snr, slow, n):
    found = find_period(record(DESIGNS[design], n, snr, slow=slow))
    if n < 2 * PERIOD and snr <= 10 and found is None:
        return  # .7 of a period to compare, and noise: nothing is said
    assert found.period == PERIOD


@pytest.mark.parametrize("seed", range(8))
def test_no_period(seed):
    """Noise, wide and narrow, a random walk, a chirp and a transient repeat nowhere."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2000, 9000))
    white, t = rng.standard_normal((n, 2)), np.arange(n) / n
    narrow = scipy.signal.lfilter(*scipy.signal.butter(2, 0.05), white, axis=0)
    chirp = np.sin(2 * np.pi * (5 * t + rng.uniform(20, 200) * t**2))[:, None]
    transient = (np.exp(-20 * t) * np.sin(150 * t))[:, None]
    for x in (white, narrow, np.cumsum(white, axis=0), chirp, transient):
        assert find_period(x) is None


@pytest.mark.parametrize("hold", [50, 100, 400])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_steps_at_random(hold, noise):
    """Of so few values halves agree by chance at many lags: no period, and where they are repeated there is one."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        steps = np.repeat(rng.choice([-1.0, 1.0], 20_000 // hold), hold)[:, None]
        assert find_period(steps + noise * rng.standard_normal(steps.shape)) is None
        twice = np.tile(steps[:8200], (3, 1))
        assert find_period(twice + noise * rng.standard_normal(twice.shape)).period == 8200


def test_a_blow():
    """Beside it there is nothing that could be compared."""
    rng = np.random.default_rng(0)
    for n, at in ((400, 200), (3000, 200), (3000, 2500)):
        x = 0.01 * rng.standard_normal((n, 1))
        x[at : at + 4] += 1.0
        assert find_period(x) is None


def spectra(design, snr, n_periods, channels=1, n_exp=1, seed=0):
    x = np.stack([record(design, n_periods * PERIOD, snr, channels, seed=seed + e) for e in range(n_exp)])
    X = np.fft.rfft(x.reshape(n_exp, n_periods, PERIOD, channels), axis=2)[:, :, 1 : PERIOD // 2] / PERIOD
    noise = X.var(axis=1, ddof=1).sum(axis=0) / n_periods if n_periods > 1 else None
    return np.arange(1, PERIOD // 2), np.sum(np.abs(X.mean(axis=1)) ** 2, axis=0), noise


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("snr", [10, 20, 40, 60, np.inf])
@pytest.mark.parametrize("n_periods", [1, 2, 8])
def test_lines(design, snr, n_periods):
    found = find_lines(*spectra(DESIGNS[design], snr, n_periods, channels=2))
    if found.confidence > 0.9:
        assert list(found.lines) == list(DESIGNS[design])
    assert found.confidence > 0.9 or snr + 10 * np.log10(n_periods) < 17


def test_lines_say_their_design():
    grids = {name: find_lines(*spectra(x, 40, 2)).design for name, x in DESIGNS.items()}
    assert grids["every line"] == "every line from 11 to 119" and grids["odd"] == "every other line from 11 to 159"
    assert grids["odd-odd"] == "every 4th line from 13 to 157" and grids["random odd"] == "some of every other line"


def test_lines_of_a_zippered_design():
    """Each input has lines of its own: those of all inputs count."""
    odd = DESIGNS["odd"]
    (k, a, _), (_, b, _) = spectra(odd[::2], 40, 1), spectra(odd[1::2], 40, 1, seed=5)
    found = find_lines(k, np.hstack([a, b]))
    assert list(found.lines) == list(odd) and found.design.startswith("zippered") and found.confidence > 0.9


@pytest.mark.parametrize("tones", [[40], [40, 77], [40, 77, 120]])
@pytest.mark.parametrize("rounded", ["not", "24 bits", "float32"])
def test_tones_beside_rounding(tones, rounded):
    """What samples round to is no line, however few there are; the default method takes them line by line."""
    t = np.arange(4 * PERIOD)[:, None] / PERIOD
    u = np.sum([np.cos(2 * np.pi * k * t + k) for k in tones], axis=0)
    u = {"not": u, "24 bits": np.round(u * 2**22) / 2**22, "float32": u.astype(np.float32).astype(float)}[rounded]
    y = 0.5 * u + 0.01 * np.random.default_rng(0).standard_normal(u.shape)
    data = jf.Experiment(u, y, 500.0, PERIOD, y_quantity="velocity")
    assert list(jf.excited_lines(data)) == tones
    found = jf.estimate(data)
    assert found.method.startswith("H1") and np.max(np.abs(found.G - 0.5)) < 2e-3


def test_lines_of_noise_are_not_sure():
    rng = np.random.default_rng(6)
    power = np.abs(rng.standard_normal((800, 2)) @ [1, 1j])[:, None] ** 2
    assert find_lines(np.arange(1, 801), power).confidence == 0.0


def test_a_period_is_proposed():
    x = record(DESIGNS["odd"], 5300, 40)
    data = jf.Experiment(x, x, 500.0)
    with pytest.raises(
        jf.InputError, match=re.escape("u repeats every 1000 samples: --set period=1000,samples=0:5000.")
    ):
        jf.dft(data)
    with pytest.raises(
        jf.InputError, match=re.escape("u repeats every 1000 samples: --set period=1000,samples=0:5000.")
    ):
        jf.Experiment(x, x, 500.0, 999)


@pytest.mark.data
def test_bench_and_emps(measured):
    """The input alone shows what the design records say: 11 to 250 Hz, and every other odd line; EMPS' reference."""
    for kind, design in (("A", "every line from 11 to 250"), ("B", "every 4th line from 13 to 249")):
        data = jf.io.read(
            measured / "two_mass_bench" / f"MultisineType{kind}.mat",
            names={"u": "iq_adx", "y": "omega_max"},
            values={"fs": 2500, "period": 2500, "transient_periods": 1},
        )
        assert find_period(data.u[0, 0]).period == find_period(data.y[0, 0]).period == 2500
        found = jf.spectra.found_lines(data)
        assert found.design == design and found.confidence > 0.95
    emps = jf.io.read(
        measured / "emps" / "DATA_EMPS.mat", names={"r": "qg", "u": "vir", "y": "qm"}, values={"fs": 1000}
    )
    assert find_period(emps.r[0, 0]).period == find_period(emps.u[0, 0]).period == 6240
