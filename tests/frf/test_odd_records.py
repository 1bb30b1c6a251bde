"""Records that are no textbook's: dead sensors, lines that inputs share, references of another number, odd units."""

import dataclasses

import jax.random as jr
import numpy as np
import pytest
from marks import slow

import jaxfrf as jf

G_TRUE = np.array([[1.0, 0.5], [0.3, 2.0]])  # (out, in)


def with_(data, **changes):
    return dataclasses.replace(data, **changes)


@pytest.fixture(scope="module")
def data():
    return jf.example(noise=0.1)


@pytest.mark.parametrize("method", [jf.LRM(width=24), slow(jf.Auto())], ids=["lrm", "auto"])
def test_a_dead_output_leaves_the_others(data, method):
    """All zeros: said, and the response of the other output is that without it."""
    y = np.array(data.y)
    y[..., 1] = 0.0
    found, alone = (jf.estimate(with_(data, y=x), method) for x in (y, y[..., :1]))
    assert np.isfinite(found.G).all() and any("sensor or drive dead" in text for text in found.warnings)
    off = np.abs(found.G[0, :, 0] - alone.G[0, :, 0]) / np.sqrt(found.cov[0, :, 0, 0].real)[:, None]
    assert np.median(off) < 1.0
    np.testing.assert_allclose(found.G[0, :, 1], 0.0, atol=1e-12)


def test_outputs_that_say_the_same_are_told_apart_from_poor_excitation(data):
    """A copy and a sum of the others: the response of both is right, and what lacks rank is said."""
    y = np.concatenate([data.y, data.y[..., :1] + data.y[..., 1:]], axis=-1)
    method = jf.LRM(width=24)
    found, alone = jf.estimate(with_(data, y=y), method), jf.estimate(data, method)
    assert any(text.startswith("of 3 outputs only 2 are independent") for text in found.warnings)
    np.testing.assert_allclose(found.G[..., 2, :], found.G[..., 0, :] + found.G[..., 1, :], atol=1e-9)
    off = np.abs(found.G[..., :2, :] - alone.G) / alone.std
    assert np.median(off) < 0.5
    assert not any("independent" in text for text in alone.warnings)


def zippered(n_exp=1):
    """Two inputs on every other line each, five periods."""
    period, rng = 400, np.random.default_rng(0)
    X = np.zeros((n_exp, period // 2 + 1, 2), complex)
    for channel in range(2):
        lines = np.arange(1 + channel, 150, 2)
        X[:, lines, channel] = np.exp(2j * np.pi * rng.random((n_exp, len(lines))))
    u = np.tile(np.fft.irfft(X, axis=1) * 20, (1, 5, 1))
    y = u @ G_TRUE.T + 1e-3 * rng.standard_normal(u.shape)
    return jf.Experiment(u, y, 1000.0, period, transient_periods=1, y_quantity="velocity")


def test_lines_that_inputs_share():
    """A zippered design: no channel has power at every line, local methods need none to."""
    found = jf.estimate(zippered())
    assert np.abs(found.G[0] - G_TRUE).max() < 5e-3
    assert not found.warnings and not np.any(found.status & int(jf.Status.LOW_EXCITATION))
    with pytest.raises(jf.InputError, match="rank 1 at every line"):
        jf.estimate(zippered(n_exp=3), jf.H1())


@pytest.mark.parametrize(
    ("wrong", "says"), [("channel", "no power in channel 1 at 5 of"), ("line", "in any channel at 1")]
)
def test_lines_without_power(wrong, says):
    rng = np.random.default_rng(1)
    X = np.zeros((1, 51, 2), complex)
    X[:, 1:6] = np.exp(2j * np.pi * rng.random((1, 5, 2)))
    if wrong == "channel":
        X[..., 1] = 0.0
    r = np.tile(np.fft.irfft(X, axis=1), (1, 3, 1))
    lines = [1, 2, 3, 4, 5] if wrong == "channel" else [1, 2, 3, 4, 5, 9]
    data = jf.Experiment(r @ G_TRUE, r @ G_TRUE, 100.0, 100, r=r, lines=lines, y_quantity="velocity")
    with pytest.raises(jf.InputError, match=says):
        jf.dft(data)


def test_welch_takes_no_transient_periods(data):
    """What stands in them moves nothing, as with the other methods."""
    y = np.array(data.y)
    y[:, :, : data.period] += 50.0 * np.random.default_rng(0).standard_normal(y[:, :, : data.period].shape)
    clean, disturbed = (jf.estimate(x, jf.Welch(segment=1000)).G for x in (data, with_(data, y=y)))
    np.testing.assert_allclose(disturbed, clean, rtol=1e-12)


def test_a_reference_of_other_channels_is_said_to_be_unused(data):
    more = with_(data, r=np.concatenate([data.r, data.r[..., :1]], axis=-1))
    found = jf.estimate(more)
    assert any(text.startswith("r has 3 channels, u has 2: the reference was not used") for text in found.warnings)
    assert not any("was not used" in text for text in jf.estimate(data).warnings)


def test_coherence_of_inputs_of_other_units():
    """y = u1 + u2 without noise is coherent, whatever the units of the two."""
    U = np.array(jr.normal(jr.key(0), (1, 8, 20, 2))) + 1j * np.array(jr.normal(jr.key(1), (1, 8, 20, 2)))
    U[..., 1] *= 1e-9
    Y = (U[..., :1] + 1e9 * U[..., 1:]) / 2
    spectra = jf.Spectra(
        U=U, Y=Y, R=None, lines=np.arange(1, 21), frequency=np.arange(1.0, 21.0), noise=None, period=64
    )
    np.testing.assert_allclose(jf.multiple_coherence(spectra), 1.0, atol=1e-9)


def test_clean_records_of_a_noisy_loop_have_lost_nothing():
    """What differs between periods of a loop that resonates is alike over some samples; seeds not looked at before."""
    for seed in range(20, 26):
        found = jf.examine(jf.example(noise=0.2 if seed % 2 else 0.4, seed=seed))
        assert not [f for f in found if f.kind == "lost"], seed


def test_samples_lost_near_the_end_of_a_noisy_loop():
    for seed in range(20, 23):
        data = jf.example(noise=0.1, seed=seed)
        u, y, at = np.array(data.u), np.array(data.y), data.n_time - 400
        for x in (u, y):
            x[0, 0, at:-24] = x[0, 0, at + 24 :]
            x[0, 0, -24:] = x[0, 0, -25]
        assert any(f.kind == "lost" for f in jf.examine(with_(data, u=u, y=y))), seed
