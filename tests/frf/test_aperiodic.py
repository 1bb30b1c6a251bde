"""Records without a period: windows by themselves, Welch's method as SciPy has it, segments."""

import numpy as np
import plants
import pytest
import scipy.signal

import jaxfrf as jf
from jaxfrf.frf import adapted
from jaxfrf.pipeline import summary

FS = 500.0


@pytest.fixture(scope="module")
def noise_record():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(6000)
    y = scipy.signal.lfilter(*scipy.signal.butter(2, 0.2), u) + 0.1 * rng.standard_normal(u.size)
    return u, y


def test_welch_is_scipys(noise_record):
    u, y = noise_record
    frf = jf.estimate(jf.Experiment(u, y, FS), jf.Welch(segment=256))
    options = {"fs": FS, "nperseg": 256}
    f, cross = scipy.signal.csd(u, y, **options)
    expected = cross / scipy.signal.welch(u, **options)[1]
    np.testing.assert_allclose(frf.frequency, f[1:128], rtol=1e-12)
    np.testing.assert_allclose(frf.G[0, :, 0, 0], expected[1:128], rtol=1e-10)
    coherence = jf.coherence(jf.segment_spectra(jf.Experiment(u, y, FS), 256))
    np.testing.assert_allclose(coherence[0, :, 0, 0], scipy.signal.coherence(u, y, **options)[1][1:128], rtol=1e-9)


def test_welch_marks_its_first_lines(noise_record):
    u, y = noise_record
    frf = jf.estimate(jf.Experiment(u, y, FS), jf.Welch(segment=256))
    assert list(np.flatnonzero(frf.status[0] & jf.Status.EDGE_WINDOW)) == [0, 1, 2, 3]


def test_the_summary_of_welch_is_of_the_excited_band():
    rng = np.random.default_rng(2)
    u = scipy.signal.lfilter(*scipy.signal.butter(6, 0.2), rng.standard_normal(20_000))
    data = jf.Experiment(u, u + 0.01 * rng.standard_normal(u.size), FS)
    method = jf.Welch(segment=256)
    about = summary(jf.segment_spectra(data, 256), jf.estimate(data, method))
    low, high = about.as_dict()["median_band_hz"]
    assert low < 5.0 and 45.0 < high < 70.0 and about.as_dict()["median_relative_std"] < 0.01
    assert "where the input has its power" in about.lines()[2]


def test_welch_covers(noise_record):
    """Segments that overlap are not independent: the regions know."""
    rng = np.random.default_rng(1)
    b, a = scipy.signal.butter(2, 0.2)
    u = rng.standard_normal((40, 4000))
    y = scipy.signal.lfilter(b, a, u) + 0.3 * rng.standard_normal(u.shape)
    data = jf.Experiment(u[:, None, :, None], y[:, None, :, None], FS)
    frf = jf.estimate(data, jf.Welch(segment=256))
    truth = scipy.signal.freqz(b, a, worN=frf.frequency, fs=FS)[1]
    region = scipy.stats.f.ppf(0.95, 2, 2 * frf.dof) * frf.std[..., 0, 0] ** 2
    assert 0.93 < np.mean(np.abs(frf.G[..., 0, 0] - truth) ** 2 <= region) < 0.97


@pytest.mark.parametrize("wrong", [{"segment": 4}, {"overlap": 1.0}, {"window": "no such"}])
def test_welch_refuses(wrong):
    with pytest.raises(jf.InputError, match=next(iter(wrong))):
        jf.Welch(**wrong)
    with pytest.raises(jf.InputError, match="segment"):
        jf.estimate(jf.Experiment(np.arange(50.0), np.arange(50.0), FS), jf.Welch(segment=60))


def test_what_becomes_of_a_method():
    rng = np.random.default_rng(2)
    u, y = rng.standard_normal((2, 300))
    whole = jf.record_spectra(jf.Experiment(u, y, FS))
    lpm = jf.LPM(transient=2, variable="frequency")
    assert adapted(jf.LogMean(jf.LPM()), whole) == jf.LogMean(jf.Auto(lpm, use_reference=False))
    assert adapted(jf.JointInputOutput(jf.LPM()), whole) == jf.Auto(lpm)
    assert adapted(jf.LPM(width=30), whole) == jf.LPM(width=30, transient=2, variable="frequency")
    assert adapted(jf.H1(), whole) == jf.H1()


@pytest.mark.parametrize("mean", [jf.LogMean, jf.ArithmeticMean])
def test_the_mean_of_one_sweep_is_its_estimate(mean):
    """Doubtful lines, of which a quiet part of a sweep has many, are mended before windows are compared."""
    t = np.arange(6000) / FS
    u = 10 * scipy.signal.chirp(t, 0.5, t[-1], 100)
    b, a = scipy.signal.cont2discrete(([1], [5.0, 8.0]), 1 / FS)[:2]  # one mass
    y = scipy.signal.lfilter(b.ravel(), a, u) + 0.01 * np.random.default_rng(5).standard_normal(t.size)
    data = jf.Experiment(u, y, FS)
    frf = jf.estimate(data, mean(jf.LPM()))
    inside = (frf.frequency > 5) & (frf.frequency < 20)
    error = np.abs(frf.G[0, :, 0, 0] / scipy.signal.freqz(b.ravel(), a, worN=frf.frequency, fs=FS)[1] - 1)
    assert np.median(error[inside]) < 0.06
    np.testing.assert_allclose(frf.G, jf.estimate(data, jf.LPM()).G, rtol=1e-9)
    assert np.isfinite(frf.window).all()


def test_segments_keep_the_units_of_their_record():
    u, y = np.random.default_rng(1).standard_normal((2, 2000))
    spectra = jf.segment_spectra(jf.Experiment(u, y, FS, u_unit="A", y_unit="m"), 256)
    assert (spectra.u_unit, spectra.y_unit, spectra.fs) == ("A", "m", FS)


def test_segments_are_experiments(noise_record):
    u, y = noise_record
    data = jf.segments(jf.Experiment(u, y, FS), 1900)
    assert (data.n_exp, data.n_time) == (3, 1900)
    np.testing.assert_array_equal(data.u[0, 1, :, 0], u[1900:3800])
    with pytest.raises(jf.InputError, match="segment"):
        jf.segments(jf.Experiment(u, y, FS), 7000)
    with pytest.raises(jf.InputError, match="period"):
        jf.segments(jf.Experiment(u, y, FS, 3000), 1000)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sweep", "noise", "steps"])
def test_the_modes_of_a_loop(kind):
    """Antiresonance and resonance where they are, nothing else, and intervals that hold."""
    loop, n = plants.two_mass_loop(1, seed=3), 10000
    rng, t = np.random.default_rng(0), np.arange(n) / FS
    r = {
        "sweep": scipy.signal.chirp(t, 1, t[-1], 100),
        "noise": rng.standard_normal(n),
        "steps": np.repeat(rng.choice([-1.0, 1.0], n // 200), 200),
    }[kind][:, None]
    u, y = plants.simulate(loop, r / r.std(), seed=1, noise=0.02)
    frf = jf.estimate(jf.Experiment(u, y, FS, r=r / r.std()), jf.Auto(jf.LRM(transient=2)))
    inside = (frf.frequency > 4) & (frf.frequency < 60)
    G = loop.plant(frf.frequency)[:, 0, 0]
    error = np.abs(frf.G[0, :, 0, 0] - G)
    region = scipy.stats.f.ppf(0.95, 2, 2 * frf.dof[0]) * frf.std[0, :, 0, 0] ** 2
    assert np.median((error / np.abs(G))[inside]) < 0.05
    # Neighbouring lines share their data: of one record some fifteen regions are independent, of which 12 to 15 hold.
    assert np.mean((error**2 <= region)[inside]) >= 12 / 15
