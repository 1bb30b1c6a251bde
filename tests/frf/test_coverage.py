"""Monte Carlo: the 95 % regions hold the true FRF in 95 % of realisations, element by element.

For circular Gaussian noise |G_hat - G|^2 / var follows F(2, 2 dof): the numerator has two real degrees of
freedom, the residual variance two for every complex residual. Realisations stand on the position axis: one
call does them all.
"""

import dataclasses
import types

import numpy as np
import plants
import pytest
import scipy.stats
from marks import slow

import jaxfrf as jf

LEVEL = 0.95
LINES = np.arange(101, 101 + 2 * 31, 2)
CENTRE = 15
FALSE_ALARM = 1e-3  # chance that a correct estimator fails one test, over all of its elements


def assert_covers(found, G, lines=(0,), at_most=LEVEL):
    """The share of hits, element by element and line by line, lies within (two-sided) binomial limits.

    `at_most` above the level allows regions that are too large, never ones that are too small.
    """
    n_pos, _, n_out, n_in = found.G.shape
    dof = np.broadcast_to(found.dof, found.G.shape[:2])
    error = np.abs(np.asarray(found.G) - G) ** 2
    variance = np.einsum("pfvv->pfv", plants.from_residuals(found.cov)).real
    variance = variance.reshape(n_pos, -1, n_in, n_out).swapaxes(-1, -2)  # the columns of G were stacked
    inside = error <= scipy.stats.f.ppf(LEVEL, 2, 2 * dof)[..., None, None] * variance
    tail = FALSE_ALARM / 2 / (len(lines) * n_out * n_in)
    low = scipy.stats.binom.ppf(tail, n_pos, LEVEL) / n_pos
    high = scipy.stats.binom.isf(tail, n_pos, at_most) / n_pos
    share = inside[:, list(lines)].mean(axis=0)
    assert np.all((low <= share) & (share <= high)), f"covers {share.min():.3f} to {share.max():.3f}, not {LEVEL}"


def open_loop(G, n_exp, noise, n_pos=1000, seed=0):
    """One known input for every realisation, and output noise that is correlated between the channels."""
    rng = np.random.default_rng(seed)
    n_freq, n_out, n_in = G.shape
    blocks = plants.orthogonal_multisine(rng, -(-n_exp // n_in), n_freq, n_in)[:n_exp]
    U = np.broadcast_to(blocks, (n_pos, *blocks.shape))
    mix = np.eye(n_out) + 0.5 * np.tri(n_out, k=-1)
    V = plants.circular(rng, (n_pos, n_exp, n_freq, n_out)) @ mix.T
    return plants.spectra(U, plants.open_loop_spectra(G, U) + noise * V, U, LINES, 500.0, 2000)


def local_offset():
    return LINES - LINES[CENTRE]


def estimate_at_centre(spectra, method):
    """G, covariance and dof at the central line, from spectra cut to its window: (pos, 1, ...)."""
    width = getattr(method, "method", method).width
    window = slice(CENTRE - width // 2, CENTRE - width // 2 + width)
    U, Y, R = (X[:, :, window] for X in (spectra.U, spectra.Y, spectra.R))
    found = jf.estimate(plants.spectra(U, Y, R, spectra.lines[window], spectra.fs, spectra.period), method)
    at = slice(width // 2, width // 2 + 1)
    dof = np.broadcast_to(found.dof, found.G.shape[:2])
    return types.SimpleNamespace(G=found.G[:, at], cov=plants.from_residuals(found.cov)[:, at], dof=dof[:, at])


@pytest.mark.parametrize("n_out, n_in, n_exp", [(1, 1, 4), (2, 2, 6), (3, 2, 5)])
def test_h1(n_out, n_in, n_exp):
    rng = np.random.default_rng(1)
    G = plants.modal_response(rng, n_out, n_in, 2 * np.pi * LINES * 0.25)
    found = jf.estimate(open_loop(G, n_exp, 0.1), jf.H1())
    assert_covers(found, G, lines=(0, CENTRE, -1))


def test_h1_of_noise_that_differs_between_lines():
    rng = np.random.default_rng(2)
    G = plants.modal_response(rng, 2, 2, 2 * np.pi * LINES * 0.25)
    noise = np.geomspace(1e-3, 1, len(LINES))[:, None]
    assert_covers(jf.estimate(open_loop(G, 6, noise), jf.H1()), G, lines=(0, CENTRE, -1))


@pytest.mark.parametrize("grows", [True, False])
def test_experiments_of_unequal_amplitude(grows):
    """Noise that grows with it, and noise that does not: the lines are the realisations."""
    rng, lines = np.random.default_rng(7), 3 * np.arange(50, 650)
    U = plants.orthogonal_multisine(rng, 3, len(lines), 2)
    G = plants.modal_response(rng, 2, 2, 2 * np.pi * lines * 0.25)
    amplitude = np.array([0.1, 10.0, 1.0, 0.1, 10.0, 1.0])[:, None, None]
    V = 0.1 * plants.circular(rng, (6, len(lines), 2)) * (amplitude if grows else 1.0)
    found = jf.estimate(
        plants.spectra(amplitude * U, plants.open_loop_spectra(G, amplitude * U) + V, lines=lines), jf.H1()
    )
    by_line = types.SimpleNamespace(G=found.G[0][:, None], cov=plants.from_residuals(found.cov)[0][:, None], dof=4.0)
    assert_covers(by_line, G[:, None])
    assert any("unequal noise" in text for text in found.warnings) == grows


def test_two_experiments_of_which_one_is_loud():
    """Their residuals tell nothing of the loud one's noise, but its periods do: the mean of both ratios Y/U."""
    rng, lines = np.random.default_rng(8), 20 + np.arange(100)
    amplitude = np.array([0.1, 10.0])[:, None, None]
    U = amplitude * np.exp(2j * np.pi * rng.random((2, 100, 1)))
    Y = U * (1 + 0.1 * plants.circular(rng, (2, 100, 1)))
    noise = np.zeros((1, 2, 100, 2, 2))
    noise[0, ..., :1, 0] = 1e-2 * amplitude**2
    unknown = plants.spectra(U, Y, lines=lines)
    assert any("factor of 100 in amplitude" in text for text in jf.estimate(unknown, jf.H1()).warnings)
    known = dataclasses.replace(unknown, noise=noise, n_periods=2)
    np.testing.assert_allclose(jf.estimate(known, jf.H1()).G[0], np.mean(Y / U, axis=0)[..., None], rtol=1e-9)


@pytest.mark.parametrize("n, n_real", [slow(1, 4), slow(2, 3), (2, 6)])
def test_arithmetic_mean(n, n_real):
    G = plants.modal_response(np.random.default_rng(3), n, n, 2 * np.pi * LINES * 0.25)
    assert_covers(jf.estimate(open_loop(G, n * n_real, 0.1), jf.ArithmeticMean()), G, lines=(0, CENTRE, -1))


def test_log_mean_of_small_noise():
    """Where the noise is small the logarithm is linear, and the mean as good as the arithmetic one."""
    G = plants.modal_response(np.random.default_rng(4), 2, 2, 2 * np.pi * LINES * 0.25)
    assert_covers(jf.estimate(open_loop(G, 8, 1e-4), jf.LogMean()), G, lines=(0, CENTRE, -1))


@pytest.mark.parametrize("n_out, n_in, n_exp, width", [slow(1, 1, 1, 8), (2, 2, 1, 10), slow(2, 2, 3, 6)])
def test_lpm(n_out, n_in, n_exp, width):
    """A polynomial plant: no bias, at the centre and in the windows at the ends of the band."""
    G = plants.matrix_polynomial(np.random.default_rng(5), n_out, n_in, local_offset(), 2)
    found = jf.estimate(open_loop(G, n_exp, 0.1), jf.LPM(order=2, width=width, variable="index"))
    assert_covers(found, G, lines=(0, CENTRE, -1))


@pytest.mark.parametrize("n, n_exp, width", [slow(1, 1, 9), (2, 1, 15), slow(2, 4, 8)])
def test_lrm_of_small_noise(n, n_exp, width):
    """A rational plant; its denominator varies little in the window, so that all lines weigh alike."""
    G = plants.matrix_fraction(np.random.default_rng(6), n, n, local_offset(), 2)
    method = jf.LRM(order=2, width=width, variable="index")
    assert_covers(estimate_at_centre(open_loop(G, n_exp, 1e-3), method), G[CENTRE])


def test_miso_lrm_of_small_noise():
    rng = np.random.default_rng(7)
    G = np.concatenate([plants.matrix_fraction(rng, 1, 2, local_offset(), 2) for _ in range(2)], axis=1)
    method = jf.MisoLRM(order=2, width=12, variable="index")
    assert_covers(estimate_at_centre(open_loop(G, 1, 1e-3), method), G[CENTRE])


def closed_loop(n, n_exp, noise, n_pos=1000):
    """u = C (r - y) around a matrix fraction: the noise in y is fed back, so that y and u share it."""
    rng = np.random.default_rng(8)
    G = plants.matrix_fraction(rng, n, n, local_offset(), 2)
    gain = 0.4 * np.eye(n)
    to_u = np.linalg.inv(np.eye(n) + gain @ G) @ gain
    R = plants.orthogonal_multisine(rng, -(-n_exp // n), len(LINES), n)[:n_exp]
    R = np.broadcast_to(R, (n_pos, *R.shape))
    V = noise * plants.circular(rng, R.shape)
    U = plants.open_loop_spectra(to_u, R - V)
    return plants.spectra(U, plants.open_loop_spectra(G, U) + V, R, LINES, 500.0, 2000), G


@pytest.mark.parametrize("n, n_exp", [(1, 4), (2, 6)])
def test_jio(n, n_exp):
    spectra, G = closed_loop(n, n_exp, 1e-2)
    assert_covers(jf.estimate(spectra, jf.JointInputOutput(jf.H1())), G, lines=(0, CENTRE, -1))


@pytest.mark.parametrize("n, n_exp, width", [(1, 1, 10), slow(2, 1, 17), (2, 4, 8)])
def test_jio_lrm(n, n_exp, width):
    spectra, G = closed_loop(n, n_exp, 1e-3)
    method = jf.JointInputOutput(jf.LRM(order=2, width=width, variable="index"))
    assert_covers(estimate_at_centre(spectra, method), G[CENTRE])


def test_common_denominator_of_a_loop():
    """The loop's noise is in y and u, and counts once."""
    spectra, G = closed_loop(1, 1, 1e-3)
    method = jf.JointInputOutput(jf.CommonDenominatorLRM(order=2, width=8, variable="index"))
    assert_covers(estimate_at_centre(spectra, method), G[CENTRE])


def test_common_denominator_of_small_noise():
    """[y; u] share their denominator, and so some of the error: the covariance knows."""
    rng, n, n_pos = np.random.default_rng(9), 2, 1000
    x = local_offset() / np.abs(local_offset()).max()
    d = 1 + 0.1j * x + 0.1 * x**2
    Ny, Nu = (plants.matrix_polynomial(rng, n, n, local_offset(), 2) + 3 * np.eye(n) for _ in range(2))
    R = plants.orthogonal_multisine(rng, 1, len(LINES), n)[:1]
    R = np.broadcast_to(R, (n_pos, *R.shape))
    Y, U = (plants.open_loop_spectra(N / d[:, None, None], R) + 1e-3 * plants.circular(rng, R.shape) for N in (Ny, Nu))
    method = jf.JointInputOutput(jf.CommonDenominatorLRM(order=2, width=14, variable="index"))
    found = estimate_at_centre(plants.spectra(U, Y, R, LINES, 500.0, 2000), method)
    assert_covers(found, (Ny @ np.linalg.inv(Nu))[CENTRE])


@pytest.mark.slow
@pytest.mark.parametrize("width", [10, 14])
@pytest.mark.parametrize("mean", [jf.ArithmeticMean, jf.LogMean])
def test_means_over_single_experiments(mean, width):
    G = plants.matrix_polynomial(np.random.default_rng(5), 2, 2, local_offset(), 2)
    found = jf.estimate(open_loop(G, 4, 1e-3), mean(jf.LPM(order=2, width=width, variable="index")))
    assert_covers(found, G, lines=(0, CENTRE, -1))


@pytest.mark.slow
def test_mean_over_experiments_with_hardly_any_residual():
    """One residual each, and inputs of very different use: the variance is mostly one experiment's.

    Welch-Satterthwaite's degrees of freedom are known to be somewhat too few there.
    """
    G = plants.matrix_polynomial(np.random.default_rng(5), 2, 2, local_offset(), 2)
    method = jf.ArithmeticMean(jf.LPM(order=2, width=7, variable="index"))
    found = jf.estimate(open_loop(G, 4, 1e-3, n_pos=2000), method)
    assert_covers(found, G, lines=(0, CENTRE, -1), at_most=0.97)
