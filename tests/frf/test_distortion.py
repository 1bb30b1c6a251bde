"""Noise, even and odd distortion of simulated nonlinear records, and what becomes of the covariance."""

import dataclasses
import re

import numpy as np
import plants
import pytest

import jaxfrf as jf
from jaxfrf.frf.distortion import distortion_of
from jaxfrf.pipeline import distortion_summary

FS, PERIOD = 1000.0, 1000
LINES = np.setdiff1d(np.arange(5, 200, 2), np.arange(9, 200, 8))  # odd, every fourth of them left out


def record(even=0.0, odd=0.0, noise=0.0, n_exp=1, n_periods=4, gain=0.0, lines=LINES):
    """y = x + even x^2 + odd x^3 with x = u, static; with `gain`, u = r - gain y of the period before (a slow loop)."""
    rng = np.random.default_rng(4)
    u, y = [], []
    for _ in range(n_exp):
        phases = np.exp(2j * np.pi * rng.uniform(size=(len(lines), 1)))
        r = plants.multisine_record(phases / np.sqrt(2 * len(lines)), lines, PERIOD)
        x = r
        for _ in range(60):
            x = r - gain * (x + even * x**2 + odd * x**3)
        clean = x + even * x**2 + odd * x**3
        u.append(np.tile(x, (n_periods, 1)))
        y.append(np.tile(clean, (n_periods, 1)) + noise * rng.standard_normal((n_periods * PERIOD, 1)))
    return jf.Experiment(np.stack(u), np.stack(y), FS, PERIOD, lines=lines)


def relative(level, found):
    return 20 * np.log10(np.sqrt(np.mean(level**2) / np.mean(found.output**2)))


def test_even_and_odd_are_told_apart():
    even = jf.best_linear_approximation(record(even=0.1, noise=1e-4), jf.H1())
    odd = jf.best_linear_approximation(record(odd=0.1, noise=1e-4), jf.H1())
    assert relative(even.even, even) > relative(even.odd, even) + 20
    assert relative(odd.odd, odd) > relative(odd.even, odd) + 20
    assert even.way == odd.way == "fast"


def test_the_noise_is_the_noise():
    found = jf.best_linear_approximation(record(noise=0.01, n_periods=8), jf.H1())
    expected = 0.01 / np.sqrt(PERIOD * 8)
    assert np.sqrt(np.mean(found.noise**2)) == pytest.approx(expected, rel=0.15)
    assert np.sqrt(np.mean(found.total**2)) == pytest.approx(expected, rel=0.3)


def test_what_a_loop_plays_at_unexcited_lines_is_no_distortion():
    """The level is that of the nonlinearity as it stands in the output, not smaller by what the loop takes back."""
    found = jf.best_linear_approximation(record(even=0.05, gain=0.5, noise=1e-6), jf.H1())
    x = record(even=0.05, gain=0.5).u[0, 0, :PERIOD, 0]
    squares = 0.05 * np.fft.rfft(x**2)[6:200:2] / PERIOD
    assert relative(found.even, found) == pytest.approx(
        20 * np.log10(np.sqrt(np.mean(np.abs(squares) ** 2) / np.mean(found.output**2))), abs=1.0
    )


def test_lines_in_a_dip_of_the_input_are_no_detection_lines(monkeypatch):
    """Three excited lines that are not found: their input stands out of the unexcited ones, and they are told."""
    rng = np.random.default_rng(6)
    whole = record(odd=0.1, noise=1e-4)
    u = whole.u + 2e-3 * np.tile(rng.standard_normal((PERIOD, 1)), (4, 1))  # what a drive distorts
    given = dataclasses.replace(whole, u=u)
    missed = LINES[30:33]
    monkeypatch.setattr("jaxfrf.spectra.steady.known_lines", lambda data: np.setdiff1d(LINES, missed))
    found = jf.best_linear_approximation(dataclasses.replace(given, lines=None), jf.H1())
    (said,) = [x for x in found.frf.warnings if x.startswith("distortion: ")]
    assert "3 lines that count as unexcited" in said
    assert not np.isin(missed * FS / PERIOD, found.unexcited).any()


def test_robust_way_where_all_lines_are_excited():
    lines = np.arange(5, 150)
    found = jf.best_linear_approximation(record(odd=0.1, noise=1e-3, n_exp=6, lines=lines), jf.H1())
    assert found.way == "robust" and np.isnan(found.odd).all()
    assert relative(found.total, found) > relative(found.noise, found) + 10


def test_levels_in_words():
    """Of a linear machine: what is left when the noise is taken off is told as that, not as a level."""
    found = distortion_summary(jf.best_linear_approximation(record(noise=1e-3), jf.H1()))
    levels = [line for line in found.lines() if line.startswith("y1, ")]
    assert levels and all("even within the noise, odd within the noise" in line for line in levels)
    assert min(band["even"] for bands in found.as_dict()["outputs"] for band in bands) >= -300
    crooked = distortion_summary(jf.best_linear_approximation(record(odd=0.1, noise=1e-3), jf.H1()))
    assert re.search(r"even within the noise, odd -\d\d dB", crooked.lines()[-1])
    assert crooked.is_clear and not found.is_clear
    blind = distortion_summary(jf.best_linear_approximation(record(noise=1e-3, lines=np.arange(5, 200, 2)), jf.H1()))
    assert 'leave some of them out (grid = "random-odd"' in blind.lines()[1]


def test_one_experiment_of_several_periods_has_a_covariance():
    """H1 of as many experiments as inputs has no residual: the noise between periods, and with unexcited lines the
    distortion, is its covariance."""
    data = record(odd=0.1, noise=1e-3)
    frf = jf.estimate(jf.dft(data), jf.H1())
    assert np.all(frf.status == int(jf.Status.NOISE_ONLY)) and np.all(frf.dof == 3)
    told = jf.with_distortion(frf, data)
    assert np.all(told.status == 0) and np.all(told.std > 2 * frf.std)
    np.testing.assert_array_equal(told.G, frf.G)


def test_every_method_tells_the_noise_apart():
    data = record(odd=0.1, noise=1e-3)
    for method in (jf.LPM(), jf.LogMean(jf.MisoLRM())):
        frf = jf.estimate(jf.dft(data), method)
        noise = dataclasses.replace(frf, cov=frf.cov_noise).std
        assert np.median(noise / frf.std) < 0.3
    quiet = jf.estimate(jf.dft(record(noise=1e-3)), jf.LPM())
    assert np.median(dataclasses.replace(quiet, cov=quiet.cov_noise).std / quiet.std) > 0.6


def test_nothing_to_tell():
    with pytest.raises(jf.InputError, match="distortion"):
        jf.best_linear_approximation(record(n_periods=1, lines=np.arange(5, 50)), jf.LPM())


# --- averages in which odd periods and experiments do not count


def test_an_odd_period_does_not_count():
    data = record(noise=1e-3, n_periods=6)
    y = data.y.copy()
    y[0, 0, 2 * PERIOD : 2 * PERIOD + 40] += 3.0
    hit = jf.Experiment(data.u, y, FS, PERIOD, lines=LINES)
    clean, plain, robust = (np.asarray(jf.dft(x, robust=k).Y) for x, k in ((data, False), (hit, False), (hit, True)))
    assert np.abs(robust - clean).max() < 0.05 * np.abs(plain - clean).max()
    np.testing.assert_allclose(jf.dft(data, robust=True).Y, clean, atol=1e-4)
    with pytest.raises(jf.InputError, match="robust"):
        jf.dft(record(n_periods=2), robust=True)


def test_an_odd_experiment_does_not_count():
    rng = np.random.default_rng(5)
    U = plants.orthogonal_multisine(rng, 5, 40, 2)
    G = np.array([[1.0, 0.2], [0.1, 2.0]]) * np.ones((40, 1, 1))
    Y = plants.open_loop_spectra(G, U, 0.01)
    Y[2:4] = Y[2:4, :, ::-1]
    spectra = plants.spectra(U, Y)
    plain, robust = (jf.estimate(spectra, m) for m in (jf.ArithmeticMean(), jf.RobustMean()))
    assert np.median(np.abs(robust.G - G)) < 0.02 < np.median(np.abs(plain.G - G))
    assert np.median(robust.std) < 0.02
    with pytest.raises(jf.InputError, match="at least three"):
        jf.estimate(plants.spectra(U[:4], Y[:4]), jf.RobustMean())


@pytest.mark.parametrize("enters", ["beside the input", "at the sensor"])
def test_levels_beside_a_resonance(enters):
    """Known levels of odd lines, with the plant's resonance at 50 Hz or flat, as a mean over 20 records: a mean over
    neighbouring lines that does not know the resonance tells several times too much beside it."""
    k = np.arange(PERIOD // 2 + 1)
    G = 1.0 / (1.0 - (k / 50.0) ** 2 + 2j * 0.02 * k / 50.0)
    level = 1e-3 * (np.abs(G) if enters == "beside the input" else np.full(len(k), 1.0))
    odd, power = (k % 2 == 1) & (k < 200), np.zeros(len(LINES))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        U, D = np.zeros((2, len(k)), complex)
        U[LINES] = np.exp(2j * np.pi * rng.uniform(size=len(LINES)))
        D[odd] = level[odd] * plants.circular(rng, (odd.sum(),))
        u, y = (np.tile(PERIOD * np.fft.irfft(X, PERIOD), 2)[None, None, :, None] for X in (U / 2, (G * U + D) / 2))
        y = y + 1e-6 * rng.standard_normal(y.shape)
        frf = jf.estimate(jf.Experiment(u, y, FS, PERIOD, lines=LINES), jf.LRM(order=2, width=12))
        true = dataclasses.replace(frf, G=G[LINES][None, :, None, None])
        found = distortion_of(true, jf.Experiment(u, y, FS, PERIOD, lines=LINES))
        power += found.odd[0, :, 0] ** 2 / (level[LINES] / 2) ** 2 / 20
    ratio = np.sqrt(power)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1) and ratio.max() < 1.3
