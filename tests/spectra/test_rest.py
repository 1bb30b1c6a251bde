"""Runs that begin and end at rest have no transient: blows, bursts, fast sweeps."""

import dataclasses

import numpy as np
import pytest
import scipy.signal

import jaxfrf as jf

FS, N = 500.0, 8000
MODES = ((20.0, 0.01, 1.0), (55.0, 0.01, -0.7))


def sampled():
    """Numerator and denominator of the modes, position over force, sampled with a hold."""
    w = 2 * np.pi * np.array([f for f, _, _ in MODES])
    for (_, zeta, part), one in zip(MODES, w, strict=True):
        b, a, _ = scipy.signal.cont2discrete(([part * one**2], [1.0, 2 * zeta * one, one**2]), 1 / FS)
        yield b.ravel(), a


def answer(u):
    return sum(scipy.signal.lfilter(b, a, u) for b, a in sampled())


def truth(frequency):
    return sum(scipy.signal.freqz(b, a, frequency, fs=FS)[1] for b, a in sampled())


def blow(rng, t):
    return np.where(np.abs(t - 0.4) < 0.004, rng.uniform(0.6, 1.4) * np.cos(np.pi * (t - 0.4) / 0.008) ** 2, 0.0)


def burst(rng, t):
    return np.where((t > 0.4) & (t < 2.0), rng.standard_normal(len(t)), 0.0)


def long_burst(rng, t):
    return np.where((t > 0.4) & (t < 10.0), rng.standard_normal(len(t)), 0.0)


def fast_sweep(rng, t):
    return np.where(t < 2.0, scipy.signal.chirp(t, 5.0, 2.0, 100.0), 0.0)


def record(excitation, n_exp=1, noise=0.01, seed=1, n=N):
    rng, t = np.random.default_rng(seed), np.arange(n) / FS
    u = np.stack([excitation(rng, t) for _ in range(n_exp)])
    y = answer(u)
    u, y = (x + noise * x.std() * rng.standard_normal(x.shape) for x in (u, y))
    return jf.Experiment(u[..., None], y[..., None], FS, y_quantity="position")


@pytest.mark.parametrize(
    ("excitation", "n_exp"),
    [
        (blow, 3),
        pytest.param(burst, 1, marks=pytest.mark.slow),
        pytest.param(long_burst, 1, marks=pytest.mark.slow),
        (fast_sweep, 1),
    ],
)
def test_from_rest_to_rest(excitation, n_exp):
    """With a transient term the noise of u alone would tell G: |G| was half of what is true, or a thirtieth."""
    data = record(excitation, n_exp)
    frf = jf.estimate(data)
    at = (frf.frequency > 8) & (frf.frequency < 90)
    G, G_0 = np.asarray(frf.G)[0, at, 0, 0], truth(frf.frequency[at])
    error, std = np.abs(G - G_0), np.asarray(frf.std)[0, at, 0, 0]
    assert np.median(error / np.abs(G_0)) < 0.01
    assert np.median(error / std) < 1.2
    assert any("taken whole without a transient term" in said for said in frf.warnings)
    assert not [f for f in jf.examine(data) if f.kind == "glitch"]
    found = sorted(x.frequency for x in jf.features(frf) if x.kind == "resonance")
    np.testing.assert_allclose(found, [20.0, 55.0], rtol=2e-3)


def test_blows_as_experiments():
    """H1 over blows is what modal analysis has always done."""
    data = record(blow, n_exp=5)
    frf = jf.estimate(data, jf.H1())
    U, Y = (np.fft.rfft(x[0, :, :, 0], axis=1) for x in (data.u, data.y))
    H1 = np.sum(Y * U.conj(), axis=0) / np.sum(np.abs(U) ** 2, axis=0)
    lines = np.rint(frf.frequency * N / FS).astype(int)
    np.testing.assert_allclose(np.asarray(frf.G)[0, :, 0, 0], H1[lines], rtol=1e-9)


def test_a_response_that_is_cut_off():
    """It is said, and G does not go to nothing as it would with a transient term."""
    frf = jf.estimate(record(lambda rng, t: blow(rng, t + 0.36), n_exp=3, n=600))
    said = [x for x in frf.warnings if "left at the end" in x]
    assert len(said) == 1 and "until the response has died out" in said[0]
    at = (frf.frequency > 8) & (frf.frequency < 90)
    ratio = np.abs(np.asarray(frf.G)[0, at, 0, 0] / truth(frf.frequency[at]))
    assert 0.8 < np.median(ratio) < 1.2


def step(rng, t):
    return np.where(t > 2.0, 1.0, 0.0)


def going_on(rng, t):
    return rng.standard_normal(len(t))


@pytest.mark.parametrize("excitation", [step, going_on])
def test_what_is_not_at_rest_keeps_its_transient(excitation):
    spectra = jf.record_spectra(record(excitation))
    assert spectra.leaks and not spectra.periodic


@pytest.mark.parametrize(("of", "at"), [("y", slice(0, 30)), ("y", slice(N - 300, N)), ("u", slice(N - 300, N))])
def test_what_moves_at_an_end(of, at):
    data = record(long_burst)
    moved = np.array(getattr(data, of))
    moved[:, :, at] += 0.5 * moved.std() * np.sin(np.arange(moved[:, :, at].shape[2]) + 1.0)[:, None]
    assert jf.record_spectra(data).at_rest
    assert jf.record_spectra(dataclasses.replace(data, **{of: moved})).leaks
