"""What stands around the estimators: coherence, noise and distortion levels, features, the catalogue, the automatic
window, and the way from a record to a summary."""

import dataclasses
import json
import re

import numpy as np
import paper_reference as ref
import plants
import pytest
import scipy.signal

import jaxfrf as jf
from jaxfrf.frf.catalogue import METHODS, method
from jaxfrf.frf.features import _peaks
from jaxfrf.frf.from_record import spectra_of
from jaxfrf.frf.scatter import scatter
from jaxfrf.pipeline import summary


def refused(call, *patterns):
    with pytest.raises(jf.InputError) as caught:
        call()
    text = str(caught.value)
    assert re.search(r"found .+; expected .+\. \S", text), text
    for pattern in patterns:
        assert re.search(pattern, text), f"no {pattern!r} in: {text}"


# --- coherence


def test_what_is_not_known_has_no_coherence():
    U = plants.circular(np.random.default_rng(2), (1, 4, 3, 1))
    Y = 2 * U
    Y[0, 0, 1] = np.nan
    known = jf.coherence(plants.spectra(U, Y))[0, :, 0, 0]
    assert np.isnan(known[1]) and np.allclose(known[[0, 2]], 1.0)


def open_loop(G, n_exp, snr=np.inf, n_freq=4, seed=0):
    """Gaussian inputs of unit power, y = G u + v with G (out, in) at every line and noise by the power ratio `snr`."""
    rng = np.random.default_rng(seed)
    G = np.asarray(G, complex)
    U = plants.circular(rng, (1, n_exp, n_freq, G.shape[1]))
    clean = U @ G.T
    power = np.sum(np.abs(G) ** 2, axis=1)
    return plants.spectra(U, clean + np.sqrt(power / snr) * plants.circular(rng, clean.shape))


@pytest.mark.parametrize("snr", [0.3, 1.0, 10.0])
def test_coherence_of_one_input(snr):
    """SNR / (1 + SNR), for ordinary and multiple coherence alike."""
    spectra = open_loop([[2.0 + 1.0j]], 20_000, snr)
    expected = snr / (1 + snr)
    np.testing.assert_allclose(jf.coherence(spectra)[0, :, 0, 0], expected, atol=0.02)
    np.testing.assert_allclose(jf.multiple_coherence(spectra)[0, :, 0], expected, atol=0.02)


def test_ordinary_coherence_shares_the_power_among_inputs():
    """Independent inputs: each explains its own share |G_ij|^2 / sum_j |G_ij|^2 of SNR/(1 + SNR), together they all."""
    G = np.array([[3.0, 1.0j], [1.0, -2.0], [0.0, 1.0]])
    snr = 4.0
    spectra = open_loop(G, 20_000, snr)
    share = np.abs(G) ** 2 / np.sum(np.abs(G) ** 2, axis=1, keepdims=True)
    np.testing.assert_allclose(jf.coherence(spectra)[0], np.broadcast_to(share * 0.8, (4, 3, 2)), atol=0.02)
    np.testing.assert_allclose(jf.multiple_coherence(spectra)[0], np.full((4, 3), 0.8), atol=0.02)


@pytest.mark.parametrize("n_exp", [3, 4, 7])
def test_coherence_without_noise_is_one(n_exp):
    np.testing.assert_allclose(jf.coherence(open_loop([[2.0 - 1.0j]], n_exp)), 1, rtol=1e-12)
    spectra = open_loop(np.array([[3.0, 1.0j], [1.0, -2.0]]), n_exp)
    np.testing.assert_allclose(jf.multiple_coherence(spectra), 1, rtol=1e-12)
    assert np.all(jf.coherence(spectra) < 1)


@pytest.mark.parametrize(("n_exp", "n_in"), [(3, 1), (5, 1), (5, 2), (8, 3)])
def test_coherence_of_unrelated_signals(n_exp, n_in):
    """Biased high: on average 1/n_exp for every pair, and n_in/n_exp for the multiple one (beta distributions)."""
    rng = np.random.default_rng(1)
    U, Y = plants.circular(rng, (1, n_exp, 20_000, n_in)), plants.circular(rng, (1, n_exp, 20_000, 1))
    spectra = plants.spectra(U, Y)
    np.testing.assert_allclose(np.mean(jf.coherence(spectra), axis=1), 1 / n_exp, atol=0.006)
    np.testing.assert_allclose(np.mean(jf.multiple_coherence(spectra)), n_in / n_exp, atol=0.006)


def test_multiple_coherence_from_periods():
    """With as many experiments as inputs the scatter between periods says what a single period explains."""
    rng = np.random.default_rng(2)
    lines, period, n_periods, deviation = np.arange(10, 60), 200, 40, 30.0
    r = plants.multisine_record(plants.circular(rng, (len(lines), 1)), lines, period)
    u = np.tile(r, (n_periods, 1))
    y = 3.0 * u + deviation * rng.standard_normal(u.shape)
    spectra = jf.dft(jf.Experiment(u, y, 100.0, period, lines=lines))
    signal = np.abs(3.0 * np.fft.rfft(r[:, 0])[lines] / period) ** 2
    expected = signal / (signal + deviation**2 / period)
    found = jf.multiple_coherence(spectra)[0, :, 0]
    assert expected.min() < 0.2 and np.median(expected) > 0.5
    assert np.median(np.abs(found - expected)) < 0.06 and abs(np.mean(found - expected)) < 0.02


def test_coherence_of_a_silent_output_is_zero():
    spectra = open_loop([[1.0]], 5)
    silent = dataclasses.replace(spectra, Y=np.zeros_like(spectra.Y))
    assert np.all(jf.coherence(silent) == 0) and np.all(jf.multiple_coherence(silent) == 0)


def test_coherence_needs_experiments():
    refused(lambda: jf.coherence(open_loop([[1.0]], 1)), "coherence: found 1 experiment", "at least 2")
    refused(lambda: jf.multiple_coherence(open_loop([[1.0, 2.0]], 2)), "at least 3 experiments, or several periods")


# --- noise and distortion, over realisations and from unexcited lines

FS, PERIOD, ODD = 200.0, 400, np.arange(3, 120, 2)


def realisations(n_real, n_periods, cubic, noise, seed):
    """y = u + cubic u^3 + v, u random-phase odd multisines of unit rms, one experiment each."""
    rng = np.random.default_rng(seed)
    X = np.sqrt(0.5 / len(ODD)) * np.exp(2j * np.pi * rng.random((n_real, len(ODD), 1)))
    one = np.stack([plants.multisine_record(x, ODD, PERIOD) for x in X])
    u = np.tile(one, (1, n_periods, 1))
    y = u + cubic * u**3 + noise * rng.standard_normal(u.shape)
    return jf.Experiment(u[None], y[None], FS, PERIOD, lines=ODD)


def mean_square(level):
    return np.sqrt(np.mean(level**2))


def test_levels_of_a_cubic_nonlinearity():
    """Noise by theory, sigma/sqrt(N P)/|U|; nonlinear distortion as the same realisations scatter without noise (the
    distortion of neighbouring lines is related: other realisations scatter by some per cent more or less)."""
    noise, cubic = 0.05, 0.05
    found = jf.levels(jf.dft(realisations(60, 4, cubic, noise, seed=3)))
    expected_noise = noise / np.sqrt(PERIOD * 4) / np.sqrt(0.5 / len(ODD))
    clean, other = (jf.dft(realisations(n, 1, cubic, 0.0, seed=seed)) for n, seed in ((60, 3), (1000, 4)))
    scatter, of_others = (np.std(x.Y / x.U, axis=1, ddof=1)[0, :, 0] for x in (clean, other))
    assert found.noise.shape == found.total.shape == found.nonlinear.shape == (1, len(ODD), 1, 1)
    assert abs(mean_square(found.noise) / expected_noise - 1) < 0.03
    assert mean_square(scatter) > 2 * expected_noise
    assert abs(mean_square(found.nonlinear) / mean_square(scatter) - 1) < 0.01
    assert abs(mean_square(found.nonlinear) / mean_square(of_others) - 1) < 0.15
    np.testing.assert_allclose(found.total**2, found.noise**2 + found.nonlinear**2, rtol=1e-10)


def test_levels_of_noise_alone():
    """Linear: total and noise agree, and what is left as distortion is their uncertainty, not a level."""
    found = jf.levels(jf.dft(realisations(60, 4, 0.0, 0.05, seed=5)))
    assert abs(mean_square(found.total) / mean_square(found.noise) - 1) < 0.03
    excess = np.mean(found.total**2 - found.noise**2) / np.mean(found.noise**2)
    assert abs(excess) < 0.1
    assert np.all(found.nonlinear >= 0) and np.median(found.nonlinear) < 0.4 * np.median(found.noise)


def test_levels_of_several_inputs():
    """Two inputs: every element has the noise of its output, spread over orthogonal experiments of known power."""
    rng = np.random.default_rng(6)
    n_real, n_periods, sigma = 40, 3, np.array([0.1, 0.3])
    X = np.stack([plants.orthogonal_multisine(rng, n_real, len(ODD), 2)])
    one = np.stack([plants.multisine_record(x, ODD, PERIOD) for x in X[0]])
    u = np.tile(one, (1, n_periods, 1))
    y = u @ np.array([[1.0, 0.5], [0.2, 2.0]]).T + sigma * rng.standard_normal(u.shape)
    found = jf.levels(jf.dft(jf.Experiment(u[None], y[None], FS, PERIOD, lines=ODD)))
    # U U^H = 2 I in a block of two experiments: var G = var V / 2.
    expected = np.repeat((sigma / np.sqrt(PERIOD * n_periods * 2))[:, None], 2, axis=1)
    np.testing.assert_allclose(np.sqrt(np.mean(found.noise**2, axis=(0, 1))), expected, rtol=0.05)
    np.testing.assert_allclose(np.sqrt(np.mean(found.total**2, axis=(0, 1))), expected, rtol=0.07)


def test_levels_need_realisations_and_periods():
    refused(lambda: jf.levels(jf.dft(realisations(1, 4, 0, 0.1, 0))), r"levels: found 1 realisation of 4 period")
    refused(lambda: jf.levels(jf.dft(realisations(3, 1, 0, 0.1, 0))), r"levels: found 3 realisations of 1 period")


@pytest.mark.parametrize(("power", "parity"), [(3, 1), (2, 0)])
def test_distortion_of_even_and_odd_nonlinearity(power, parity):
    """u^2 shows at even lines only, u^3 at odd ones, exactly as NumPy's FFT of the distortion says."""
    rng = np.random.default_rng(7)
    lines = np.arange(3, 100, 4)
    u = plants.multisine_record(plants.circular(rng, (len(lines), 1)), lines, PERIOD)
    data = jf.Experiment(u, 2 * u + 0.1 * u**power, FS, PERIOD, lines=lines)
    rest = jf.unexcited_spectra(data)
    frf = jf.estimate(jf.dft(data), jf.H1())
    found = jf.distortion(rest, frf)[0, :, 0]
    of_nonlinearity = np.abs(np.fft.rfft(0.1 * u[:, 0] ** power))[rest.lines] / PERIOD
    np.testing.assert_allclose(found, of_nonlinearity, atol=1e-12)
    assert np.median(found[rest.lines % 2 == parity]) > 1e-3
    assert np.max(found[rest.lines % 2 != parity]) < 1e-12


def test_distortion_in_closed_loop():
    """What the controller makes of the distortion is taken off: G U at the unexcited lines, G linear between lines."""
    rng = np.random.default_rng(8)
    lines, between = np.arange(10, 60, 4), np.arange(8, 64, 2)
    U = plants.circular(rng, (1, 3, len(between), 2))
    added = plants.circular(rng, (1, 3, len(between), 2))
    slope, at_zero = plants.circular(rng, (2, 2, 2))

    def G(k):
        return at_zero + slope * np.clip(k, lines[0], lines[-1])[:, None, None]  # outside: the value at the end

    Y = np.einsum("foi,pefi->pefo", G(between), U) + added
    rest = plants.spectra(U, Y, lines=between)
    frf = jf.io.frf_from_arrays(G(lines)[None], lines * 1.0)
    expected = np.sqrt(np.mean(np.abs(added) ** 2, axis=1))
    np.testing.assert_allclose(jf.distortion(rest, frf), expected, rtol=1e-10)


def test_distortion_with_a_single_excited_line():
    rng = np.random.default_rng(9)
    U = plants.circular(rng, (1, 2, 3, 1))
    frf = jf.io.frf_from_arrays(np.full((1, 1, 1, 1), 2.0 + 0j), np.array([21.0]))
    np.testing.assert_allclose(jf.distortion(plants.spectra(U, 2 * U), frf), 0, atol=1e-15)


def test_distortion_wants_the_same_record():
    U = np.ones((1, 1, 3, 2), complex)
    frf = jf.io.frf_from_arrays(np.ones((1, 2, 1, 1), complex), np.array([1.0, 2.0]))
    refused(lambda: jf.distortion(plants.spectra(U, U), frf), "frf: found 1 positions of 1 x 1", "1 positions of 2 x 2")


def test_a_record_says_nothing_of_an_frf_of_other_lines():
    rng = np.random.default_rng(3)
    lines = jf.random_odd_lines(1, 127, key=0)
    X = np.zeros(129, complex)
    X[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    u = np.tile(np.fft.irfft(X)[:, None], (4, 1))
    y = np.roll(u, 1, axis=0) + 1e-3 * rng.standard_normal(u.shape)
    data = jf.Experiment(u, y, 256.0, 256, lines=lines)
    frf = jf.estimate(jf.dft(data), jf.LRM())
    assert jf.with_distortion(frf, data).cov_total is not None
    shifted = dataclasses.replace(frf, frequency=frf.frequency + 0.013)
    refused(lambda: jf.with_distortion(shifted, data), "frf: found other lines", "those of the record")


# --- resonances and antiresonances


def two_mass(frequency, damping=0.05):
    """Motor and load speed over torque: J1 = 1, J2 = 2, k = 5000, with antiresonance sqrt(k/J2), resonance
    sqrt(k (1/J1 + 1/J2))."""
    motor, load, stiffness = 1.0, 2.0, 5000.0
    s = 2j * np.pi * np.asarray(frequency)
    spring = damping + stiffness / s
    common = motor * load * s**2 + (motor + load) * s * spring
    antiresonance, resonance = np.sqrt([stiffness / load, stiffness * (1 / motor + 1 / load)]) / (2 * np.pi)
    return np.stack([(load * s + spring) / common, spring / common], axis=-1)[..., None], antiresonance, resonance


def response(G, frequency, std=None):
    """An FRF of known standard deviation (of one input)."""
    G = np.asarray(G)[None]
    n = G.shape[2]
    shape = G.shape[:2]
    cov = np.full((*shape, n, n), np.nan + 0j) if std is None else np.zeros((*shape, n, n), complex)
    if std is not None:
        cov[..., np.arange(n), np.arange(n)] = np.broadcast_to(np.asarray(std) ** 2, (*shape, n))
    zeros = np.zeros(shape)
    return jf.FRF(G=G, frequency=frequency, cov=cov, dof=zeros + 9, status=zeros.astype(int), window=zeros + 1)


def test_features_of_two_masses():
    f = np.arange(2.0, 40.0, 0.1)
    G, antiresonance, resonance = two_mass(f)
    frf = response(G, f)
    motor, load = jf.features(frf), jf.features(frf, out=1)
    assert {x.kind for x in motor} == {"antiresonance", "resonance"} and len(motor) == 2
    for feature in motor:
        known = {"antiresonance": antiresonance, "resonance": resonance}[feature.kind]
        assert abs(feature.frequency - known) <= 0.1
        level = 20 * np.log10(np.abs(G[:, 0, 0]))
        near = np.abs(f - feature.frequency) < 0.2
        assert np.min(np.abs(feature.magnitude_db - level[near])) < 1e-9
    (only,) = load  # the valley between the slope of the rigid body and the resonance is no antiresonance
    assert only.kind == "resonance" and abs(only.frequency - resonance) <= 0.1
    assert motor[0].prominence_db >= motor[1].prominence_db


def test_features_between_dense_lines():
    """The pole of a speed from a torque lies beside the highest line; with lines of a long record it is many lines
    away, and errors that all of them share hide neither it nor the zeros."""
    f = np.arange(2.0, 40.0, 0.01)
    s = 2j * np.pi * f
    motor, load, stiffness, damping = 1.0, 2.0, 2e4, 6.0
    spring = damping * s + stiffness
    G = (load * s**2 + spring) / (s * (motor * load * s**2 + (motor + load) * spring))
    frf = response(G[:, None, None], f, std=1e-2 * np.abs(G).min())
    found = {x.kind: x for x in jf.features(dataclasses.replace(frf, window=frf.window + 800))}
    for kind, inertia in (("antiresonance", load), ("resonance", motor * load / (motor + load))):
        true = np.sqrt(stiffness / inertia) / 2 / np.pi
        assert abs(found[kind].frequency - true) < 1.96 * found[kind].frequency_std < 0.1
        assert found[kind].damping == pytest.approx(damping / 2 / np.sqrt(stiffness * inertia), rel=0.02)


def test_prominence_of_a_feature():
    """A mode of 26 dB on a level of nearly 0 dB, and a zero pair that is less than 6 dB deep, left out by default."""
    f = np.arange(1.0, 61.0, 0.25)

    def mode(at, damping):
        return at**2 / (at**2 - f**2 + 2j * damping * at * f)

    G = (mode(20.0, 0.025) / mode(40.0, 0.5 * 10 ** (-5 / 20)))[:, None, None]
    (found,) = jf.features(response(G, f))
    assert found.kind == "resonance" and abs(found.frequency - 20.0) < 2e-3 and abs(found.damping - 0.025) < 5e-4
    level = 20 * np.log10(np.abs(G[:, 0, 0]))
    assert abs(found.magnitude_db - level.max()) < 1e-9
    assert abs(found.prominence_db - (level.max() - level[0])) < 1e-9  # the valley before it is the first line
    assert {x.kind for x in jf.features(response(G, f), prominence_db=1.0)} == {"resonance", "antiresonance"}


def test_no_antiresonance_where_no_zero_is():
    """The sum of two modes has a zero pair between them, their difference has a valley and no zero."""
    f = np.arange(5.0, 60.0, 0.1)
    one, two = (at**2 / (at**2 - f**2 + 0.02j * at * f) for at in (20.0, 40.0))
    resonances = {20.0, 40.0}
    for sign, zeros in ((1, 1), (-1, 0)):
        found = jf.features(response((one + sign * two)[:, None, None], f))
        assert {round(x.frequency) for x in found if x.kind == "resonance"} == resonances
        assert sum(x.kind == "antiresonance" and 20 < x.frequency < 40 for x in found) == zeros


def test_peaks_are_scipys():
    rng = np.random.default_rng(0)
    for decimals in (0, 1, 3) * 20:  # with few decimals there are plateaus
        level = np.round(rng.normal(size=rng.integers(3, 60)).cumsum(), decimals)
        peaks, about = scipy.signal.find_peaks(level, prominence=0.5)
        found = _peaks(level, 0.5)
        assert [top for top, _ in found] == list(peaks)
        np.testing.assert_allclose([level[top] - level[base] for top, base in found], about["prominences"], atol=1e-12)


def test_features_that_noise_could_have_made_are_left_out():
    """A flat response with 40 % noise has extrema of 6 dB, and no resonance, whether its deviation is known or seen in
    its scatter; true ones stay."""
    rng = np.random.default_rng(10)
    f = np.arange(2.0, 40.0, 0.1)
    unknown = known = extrema = 0
    for _ in range(10):
        noisy = 1 + 0.4 * plants.circular(rng, (len(f), 1, 1))
        extrema += len(scipy.signal.find_peaks(20 * np.log10(np.abs(noisy[:, 0, 0])), prominence=6.0)[0])
        unknown += len(jf.features(response(noisy, f)))
        known += len(jf.features(response(noisy, f, std=0.4)))
    assert extrema > 200 and unknown < 0.01 * extrema and known < 0.01 * extrema
    G, antiresonance, resonance = two_mass(f)
    sigma = 1e-2 * np.abs(G).min()
    noisy = G + sigma * plants.circular(rng, G.shape)
    for told in (response(noisy, f, std=sigma), response(noisy, f)):
        found = {x.kind: x.frequency for x in jf.features(told)}
        assert abs(found["antiresonance"] - antiresonance) <= 0.2 and abs(found["resonance"] - resonance) <= 0.2


def test_lines_that_tell_nothing_hide_no_feature():
    """Beyond the band of its excitation a record holds noise, whose lowest line is lower than the real valley there."""
    rng = np.random.default_rng(11)
    f = np.arange(2.0, 60.0, 0.1)
    G, antiresonance, resonance = two_mass(f)
    size, known = np.abs(G), (f < 45.0)[:, None, None]
    sigma = np.where(known, 1e-2 * size.min(), size[f > 8.0].max())
    noisy = np.where(known, G, 10 * size.min()) + np.where(known, sigma, 0.0) * plants.circular(rng, G.shape)
    found = {x.kind: x.frequency for x in jf.features(response(noisy, f, std=sigma[..., 0]))}
    assert abs(found["antiresonance"] - antiresonance) <= 0.2 and abs(found["resonance"] - resonance) <= 0.2


def test_scatter_that_the_noise_does_not_hold():
    """H1 of one experiment: the covariance is the noise's, distortion scatters the lines a hundred times as far."""
    rng = np.random.default_rng(12)
    f = np.arange(2.0, 40.0, 0.1)
    G, antiresonance, resonance = two_mass(f)
    smooth = G[:, 0, 0] * (1 + 0.02 * plants.circular(rng, (len(f),)))
    rough = scatter(f, smooth) / np.abs(smooth)
    assert np.all((rough > 0.01) & (rough < 0.06))  # at resonance and antiresonance, too
    frf = response(smooth[:, None, None], f, std=1e-3 * np.abs(smooth)[:, None])
    found = {
        x.kind: x.frequency for x in jf.features(dataclasses.replace(frf, status=frf.status | jf.Status.NOISE_ONLY))
    }
    assert abs(found["antiresonance"] - antiresonance) <= 0.2 and abs(found["resonance"] - resonance) <= 0.2
    dip = np.where(np.arange(len(f)) == 190, 0.2, 1.0) * (1 + 0.5 * plants.circular(rng, (len(f),)))
    frf = response(dip[:, None, None], f, std=1e-4 * np.abs(dip)[:, None])
    assert jf.features(dataclasses.replace(frf, status=frf.status | jf.Status.NOISE_ONLY)) == []


def test_nothing_is_told_where_a_taper_reaches_beyond_the_band():
    f = np.arange(1.0, 40.0)
    G = (1 / (9.0 - f**2 + 0.6j * f))[:, None, None]
    frf = response(G, f)
    marked = dataclasses.replace(frf, status=np.where(np.arange(len(f)) < 4, jf.Status.EDGE_WINDOW, 0)[None])
    assert len(jf.features(frf)) == 1 and jf.features(marked) == []
    assert len(jf.features(dataclasses.replace(marked, window=frf.window * 9))) == 1  # of a local method


def test_features_of_another_position():
    f = np.arange(2.0, 40.0, 0.1)
    G, _, resonance = two_mass(f)
    both = jf.concatenate_positions([response(np.ones_like(G), f), response(G, f)])
    assert jf.features(both) == []
    assert any(abs(x.frequency - resonance) <= 0.1 for x in jf.features(both, position=1))


# --- the catalogue


def test_the_papers_methods_by_name():
    assert method("h1") == jf.H1()
    assert method("jio") == jf.JointInputOutput(jf.H1())
    assert method("lrm-mimo") == jf.LogMean(jf.LRM())
    assert method("lrm-jio", {"order": 3, "width": 40}) == jf.LogMean(jf.JointInputOutput(jf.LRM(order=3, width=40)))
    assert method("auto") == jf.Auto() and next(iter(METHODS)) == "auto"
    for name, (text, value) in METHODS.items():
        assert isinstance(value, jf.AbstractMethod) and len(text) > 10 and method(name) == value


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("lpm-stacked", {"order": "1", "width": " 20 "}, jf.LPM(order=1, width=20)),
        ("lpm-stacked", {"width": "none", "transient": "2"}, jf.LPM(width=None, transient=2)),
        ("lrm-stacked", {"variable": "frequency"}, jf.LRM(variable="frequency")),
        ("log", {"elementwise": "true"}, jf.LogMean(elementwise=True)),
        ("log", {"elementwise": "No"}, jf.LogMean(elementwise=False)),
        ("auto", {"widths": "12;24;48"}, jf.Auto(widths=(12, 24, 48))),
        ("auto", {"widths": "None", "use_reference": "true"}, jf.Auto(widths=None)),
        (
            "auto",
            {"use_reference": "false", "order": "1"},
            jf.Auto(method=jf.LRM(order=1, variable="frequency"), use_reference=False),
        ),
        ("auto", {"widths": (8, 16)}, jf.Auto(widths=(8, 16))),
    ],
)
def test_options_from_text(name, text, expected):
    assert method(name, text) == expected


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("lrm", {}, ["method: found 'lrm'", "auto, h1, h2"]),
        ("lpm", {"ordr": "2"}, ["option of lpm: found ordr", "elementwise, order, transient, variable, width"]),
        ("h1", {"order": "2"}, ["no options for this method"]),
        ("lpm", {"order": "two"}, ["option order: found 'two'", "order=2"]),
        ("lpm", {"order": "2.5"}, ["option order: found '2.5'"]),
        ("lpm", {"width": "0"}, ["width: found 0", "1 or more"]),
        ("lpm", {"order": "-1"}, ["order: found -1", "0 or more"]),
        ("lpm", {"variable": "index2"}, ["variable: found 'index2'", "index or frequency"]),
        ("log", {"elementwise": "maybe"}, ["option elementwise: found 'maybe'", "elementwise=true"]),
        ("auto", {"widths": "12,24"}, ["option widths: found '12,24'", "widths=12;24;48"]),
        ("auto", {"order": "high"}, ["option order: found 'high'"]),
        ("log", {"method": "lpm"}, ["option of log: found method"]),
        ("auto", {"method": "lpm"}, ["option of auto: found method"]),
    ],
)
def test_wrong_options(name, options, says):
    refused(lambda: method(name, options), *says)


# --- the automatic window

LOG_ODD = plants.log_odd_lines(15, 800, 220)


def median_error(G, truth):
    return np.median(np.linalg.norm(G - truth, axis=(-2, -1)) / np.linalg.norm(truth, axis=(-2, -1)))


@pytest.mark.parametrize(
    ("n", "n_real", "noise"),
    [
        (1, 1, 0.05),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in [(2, 1, 0.05), (1, 2, 0.02), (2, 1, 0.01), (3, 1, 0.2), (3, 2, 0.05)]
        ),
    ],
)
def test_auto_is_as_good_as_the_best_fixed_window(n, n_real, noise):
    """Flexible axes in closed loop: the median over the seeds of its error, over that of the best window of those that
    it may choose from, which nobody knows without the truth."""
    ratio = []
    for seed in range(8):
        loop = plants.two_mass_loop(n, seed=seed % 4)
        records = plants.steady_spectra(loop, LOG_ODD, 4000, n_real, process_noise=noise, seed=100 + seed)
        spectra, auto = records.spectra(), jf.Auto()
        signals = spectra.U[0], spectra.Y[0], spectra.R[0]
        fixed = [median_error(ref.response_jio(*signals, 2, w), records.G) for w in auto.candidates(spectra)]
        ratio.append(median_error(jf.estimate(spectra, auto).G[0], records.G) / min(fixed))
    assert np.median(ratio) < 1.15


def auto_window(G, noise, seed=0):
    """Width chosen at every line from two experiments in open loop, and the errors: automatic, narrowest, widest."""
    rng = np.random.default_rng(seed)
    U = plants.circular(rng, (1, 2, len(G), G.shape[-1]))
    spectra = plants.spectra(U, plants.open_loop_spectra(G, U, noise, seed + 100))
    frf = jf.estimate(spectra, jf.Auto())
    widths = jf.Auto().candidates(spectra)
    fixed = [ref.response_lrm(spectra.U[0], spectra.Y[0], 2, w) for w in (widths[0], widths[-1])]
    return frf.window[0], *(np.sqrt(np.mean(np.abs(x - G) ** 2)) for x in (frf.G[0], *fixed))


@pytest.mark.slow
def test_auto_widens_where_the_plant_is_smooth():
    """A nearly constant response under noise: most of what the narrowest window lets through is averaged away."""
    G = (1 + 0.02 * np.linspace(-1, 1, 150))[:, None, None] + 0j
    results = [auto_window(G, 0.3, seed) for seed in range(8)]
    narrowest = jf.Auto().candidates(plants.spectra(*np.ones((2, 1, 2, 150, 1), complex)))[0]
    assert np.median([np.median(x[0]) for x in results]) >= 2 * narrowest
    assert np.median([auto / first for _, auto, first, _ in results]) < 0.65


@pytest.mark.slow
def test_auto_narrows_at_resonances():
    """Three sharp resonances close together, more poles than a wide window can hold: narrow there and wide elsewhere,
    wider again where noise hides how the response bends; with little noise far better than the widest window."""
    f = np.arange(150.0)
    s, centres = 1j * f[:, None], np.array([67.0, 74.0, 81.0])
    G = (1 + np.sum(300.0 / (centres**2 + 2 * 0.008 * centres * s + s**2), axis=1))[:, None, None]
    near, far = np.abs(f - 74) < 12, (f < 35) | (f > 120)
    quiet, noisy = ([auto_window(G, noise, seed) for seed in range(4)] for noise in (1e-3, 3.0))
    width = {"quiet": np.mean([x[0] for x in quiet], axis=0), "noisy": np.mean([x[0] for x in noisy], axis=0)}
    assert np.mean(width["quiet"][near]) < 0.5 * np.mean(width["quiet"][far])
    assert np.mean(width["quiet"][near]) < 0.7 * np.mean(width["noisy"][near])
    assert np.median([auto / widest for _, auto, _, widest in quiet]) < 0.1


@pytest.mark.slow
def test_auto_uses_the_windows_it_is_given():
    records = plants.steady_spectra(plants.two_mass_loop(2), LOG_ODD, 4000, 1, process_noise=0.05)
    frf = jf.estimate(records.spectra(), jf.Auto(widths=(30, 10)))
    assert frf.window.min() >= 10 and frf.window.max() <= 30
    one = jf.estimate(records.spectra(), jf.Auto(jf.LPM(), widths=(16,)))
    same = jf.estimate(records.spectra(), jf.JointInputOutput(jf.LPM(width=16)))
    np.testing.assert_array_equal(one.G, same.G)
    np.testing.assert_array_equal(one.dof, same.dof)


@pytest.mark.slow
def test_auto_in_one_stage():
    """With one window it is the method itself; two stages are another estimate."""
    spectra = plants.steady_spectra(plants.two_mass_loop(2), LOG_ODD, 4000, 1, process_noise=0.05).spectra()
    one, two = (jf.estimate(spectra, jf.Auto(widths=(20,), stages=n)).G for n in (1, 2))
    same = jf.estimate(spectra, jf.JointInputOutput(jf.LRM(width=20, variable="frequency"))).G
    np.testing.assert_array_equal(one, same)
    assert np.abs(two - same).max() > 1e-3 * np.abs(same).max()
    refused(lambda: jf.Auto(stages=3), "stages: found 3")


@pytest.mark.parametrize("with_reference", [True, False])
def test_auto_goes_through_the_reference_where_there_is_one(with_reference):
    records = plants.steady_spectra(plants.two_mass_loop(2), LOG_ODD, 4000, 1, process_noise=0.05)
    spectra = records.spectra(with_reference)
    direct = jf.estimate(spectra, jf.LPM(width=20)).G
    np.testing.assert_array_equal(jf.estimate(spectra, jf.Auto(jf.LPM(), widths=(20,), use_reference=False)).G, direct)
    assert np.array_equal(jf.estimate(spectra, jf.Auto(jf.LPM(), widths=(20,))).G, direct) != with_reference


def test_auto_refuses_windows_that_are_too_narrow():
    spectra = plants.steady_spectra(plants.two_mass_loop(2), LOG_ODD, 4000, 1).spectra()
    refused(lambda: jf.estimate(spectra, jf.Auto(widths=(2, 40))), "width: found a window of 2 lines")


def test_auto_of_few_lines():
    """Fewer lines than the least useful window: one candidate, the whole band."""
    rng = np.random.default_rng(11)
    U = plants.circular(rng, (1, 2, 9, 1))
    spectra = plants.spectra(U, 2 * U + 0.1 * plants.circular(rng, U.shape))
    assert max(jf.Auto().candidates(spectra)) <= 9
    assert np.median(np.abs(jf.estimate(spectra, jf.Auto()).G - 2)) < 0.1


# --- from a record to a summary


def test_which_spectra_a_method_needs():
    rng = np.random.default_rng(12)
    u, y = rng.standard_normal((2, 1, 3, 600, 1))
    periodic, aperiodic = jf.Experiment(u, y, FS, 200, lines=[5, 9, 21]), jf.Experiment(u, y, FS)
    transient = jf.LogMean(jf.LPM(transient=2))
    assert spectra_of(periodic, transient).periodic and spectra_of(periodic, jf.H1()).n_periods == 3
    assert spectra_of(periodic, jf.H1(), periods=(1, None)).n_periods == 2
    assert list(spectra_of(periodic, jf.H1(), band=(4.0, None)).lines) == [5, 9, 21]
    assert list(spectra_of(periodic, jf.H1(), band=(None, 10.0)).lines) == [5, 9]
    whole = spectra_of(aperiodic, transient, band=(10.0, 20.0))
    assert not whole.periodic and whole.frequency[0] >= 10 and whole.frequency[-1] <= 20
    assert not spectra_of(aperiodic, jf.LRM()).periodic and spectra_of(aperiodic, jf.Welch(segment=100)).segments == 11
    refused(lambda: spectra_of(aperiodic, jf.H1()), "period: found 0", "transient=2")
    refused(
        lambda: spectra_of(jf.Experiment(np.tile(u, (1, 1, 3, 1)), np.tile(y, (1, 1, 3, 1)), FS), jf.LRM()),
        "period=600",
    )
    refused(lambda: spectra_of(aperiodic, transient, periods=(0, 1)), r"period: found 0 \(not periodic\)")


def test_summary():
    """What it says agrees with the FRF it is of: features of the diagonal, the standard deviation, and remarks."""
    f = np.arange(2.0, 40.0, 0.1)
    G, antiresonance, resonance = two_mass(f)
    frf = response(G[:, :1], f, std=1e-2 * np.abs(G[:, 0]))
    status = np.zeros((1, len(f)), int)
    status[0, :7] = int(jf.Status.LOW_EXCITATION)
    frf = dataclasses.replace(frf, status=status, method="H1()", warnings=("a remark",))
    U = np.ones((1, 2, len(f), 1), complex)
    about = summary(plants.spectra(U, U, lines=np.arange(1, len(f) + 1)), frf)
    plain = json.loads(json.dumps(about.as_dict()))
    assert abs(plain["median_relative_std"] - 0.01) < 1e-12
    assert (plain["positions"], plain["experiments"], plain["lines"]) == (1, 2, len(f))
    assert plain["warnings"] == ["a remark"] and plain["effective_independent_lines"] == len(f)
    assert {x["kind"]: round(x["hz"], 1) for x in plain["features"]} == {
        "antiresonance": round(antiresonance, 1),
        "resonance": round(resonance, 1),
    }
    text = "\n".join(about.lines())
    assert "standard deviation: 1 % of |G| (median of the diagonal); all lines are independent\n" in text
    told = lambda w: summary(about.spectra, dataclasses.replace(frf, window=np.full(frf.window.shape, w))).lines()[2]
    assert told(10.0).endswith(f"; about {len(f) / 10:.0f} independent lines, the others share their data")
    assert told(np.nan).endswith("(median of the diagonal)")
    assert f"7 of {len(f)} estimates: an input carries almost no power" in text
    assert f"G11: resonance at {resonance:.4g}" in text
