"""Residuals by element, band and position, beside loops that know nothing of the arrays."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.graybox.quality import model_quality, quality, response_quality

N_POS, FREQUENCY = 3, np.geomspace(4.0, 80.0, 240)
GAIN = np.array([[1.0, 0.3 - 0.1j], [0.2j, 2.0]])
SPREAD = 0.05  # of every element, relative


def response(omega, values):
    rise = 1 / (1 + 1j * omega / (2 * jnp.pi * values["corner"]))
    return values["gain"] * rise[:, None, None] * GAIN


TRUTH = np.asarray(response(2 * np.pi * FREQUENCY, {"gain": 2.0, "corner": 15.0}))


def noisy(seed=0, window=1.0, spread=SPREAD):
    """An FRF with white errors of a known relative variance, the same for all elements."""
    rng = np.random.default_rng(seed)
    draw = rng.standard_normal((2, N_POS, *TRUTH.shape)) / np.sqrt(2)
    bare = jf.io.frf_from_arrays(TRUTH * np.exp(spread * (draw[0] + 1j * draw[1])), FREQUENCY)
    variance = spread**2 * np.abs(TRUTH.swapaxes(-1, -2).reshape(len(TRUTH), -1)) ** 2
    cov = np.broadcast_to(variance[:, :, None] * np.eye(4), bare.cov.shape).astype(complex)
    return dataclasses.replace(
        bare, cov=cov, window=np.full_like(bare.window, window), dof=np.full_like(bare.dof, 50.0)
    )


@pytest.fixture(scope="module")
def fitted():
    return jf.fit(jf.GrayBox(response, {"gain": 1.5, "corner": 20.0}), noisy(), starts=2)


def test_cells_against_loops(fitted):
    frf = noisy()
    found = quality(fitted, frf, bands=5)
    model = np.asarray(response(2 * np.pi * FREQUENCY, fitted.values))
    edges = [4.0 * 20 ** (k / 5) for k in range(6)]
    np.testing.assert_allclose(found.edges, edges)
    for pos, band, out, ref in ((0, 0, 0, 0), (1, 3, 1, 0), (2, 4, 0, 1)):
        total, n = 0.0, 0
        for f, line in enumerate(FREQUENCY):
            last = band == 4 and line >= edges[4]
            if (edges[band] <= line < edges[band + 1]) or last:
                error = np.log(frf.G[pos, f, out, ref] / model[f, out, ref])
                variance = frf.cov[pos, f, 2 * ref + out, 2 * ref + out].real / abs(frf.G[pos, f, out, ref]) ** 2
                total, n = total + abs(error) ** 2 / variance, n + 1
        assert found.count[pos, band, out, ref] == n == found.independent[pos, band, out, ref]
        assert found.chi_square[pos, band, out, ref] == pytest.approx(total / n, rel=1e-9)


def test_means_are_those_of_the_lines(fitted):
    found, whole = quality(fitted, noisy(), bands=6), quality(fitted, noisy(), bands=1)
    np.testing.assert_allclose(found.by_element, whole.by_element, rtol=1e-12)
    np.testing.assert_allclose(found.by_output, whole.by_element.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(found.by_input, whole.by_element.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.by_position, whole.chi_square[:, 0].mean(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(found.position_band.shape, (N_POS, 6))
    assert found.cost == pytest.approx(whole.cost)


def test_noise_alone_is_one(fitted):
    """2880 complex errors: their mean square scatters by 1.9 %."""
    found = quality(fitted, noisy())
    assert abs(found.by_element.mean() - 1) < 0.06
    assert found.worst() == []


def test_an_error_is_named(fitted):
    frf = noisy()
    G = frf.G.copy()
    inside = (FREQUENCY > 14) & (FREQUENCY < 18)
    G[1][np.ix_(inside, [1], [0])] *= 1.3
    frf = dataclasses.replace(frf, G=G)
    found = model_quality(fitted, frf)
    first, *_ = found.worst()
    assert first.startswith("G21 between") and "at position 1: " in first and "times the noise" in first
    assert "at position 7: " in found.worst([5, 7, 9])[0]
    assert np.unravel_index(np.argmax(found.by_element), (2, 2)) == (1, 0)


def test_lines_that_share_data_are_fewer(fitted):
    """Overlapping windows make noise look like a structure; then it takes more to stand out."""
    alone, shared = (model_quality(fitted, noisy(window=w)) for w in (1.0, 30.0))
    np.testing.assert_allclose(alone.independent, alone.count)
    assert np.all(shared.independent < 0.5 * alone.independent) and np.all(shared.independent >= 1)
    np.testing.assert_allclose(shared.chi_square, alone.chi_square)


def test_known_errors_in_decibels(fitted):
    """A response that is 1 dB and 5 degrees off everywhere."""
    frf = dataclasses.replace(noisy(), G=np.broadcast_to(TRUTH, (N_POS, *TRUTH.shape)))
    off = frf.G * 10 ** (1 / 20) * np.exp(1j * np.deg2rad(5.0))
    found = response_quality(off, frf)
    np.testing.assert_allclose(found.rms_db, 1.0, rtol=1e-9)
    np.testing.assert_allclose(found.rms_degrees, 5.0, rtol=1e-9)
    assert (found.total_db, found.total_degrees) == (pytest.approx(1.0), pytest.approx(5.0))


def test_cost_against_a_sum(fitted):
    """Squares over floor and noise together, their mean."""
    other, weights = noisy(seed=3), jf.Weights(focus=1.0, off_diagonal=1.0)
    model = np.asarray(response(2 * np.pi * FREQUENCY, fitted.values))
    relative = (SPREAD * np.abs(TRUTH) / np.abs(other.G)) ** 2
    weighted = np.abs(np.log(other.G / model)) ** 2 / (relative + weights.floor**2)
    assert model_quality(fitted, other, weights).cost == pytest.approx(weighted.mean(), rel=1e-6)


def test_another_frf_is_refused(fitted):
    """Else its numbers would not be looked at: residuals are those of what was fitted."""
    frf = noisy()
    louder = dataclasses.replace(frf, G=3 * frf.G)
    shorter = jf.io.frf_from_arrays(frf.G[:, :100], FREQUENCY[:100])
    for other in (louder, shorter):
        with pytest.raises(jf.InputError, match=r"the FRF that was fitted\. .*model_quality"):
            quality(fitted, other)
    assert model_quality(fitted, louder).total_db == pytest.approx(20 * np.log10(3), abs=0.1)


def test_without_covariance(fitted):
    """Errors are still there, and the largest are named; how they stand to the noise nobody knows."""
    bare = jf.io.frf_from_arrays(noisy().G, FREQUENCY)
    found = model_quality(fitted, bare)
    assert np.isnan(found.chi_square).all() and np.isfinite(found.rms_db).all()
    assert len(found.worst()) == 5 and "noise" not in found.worst()[0]


def test_bands_are_whole(fitted):
    with pytest.raises(jf.InputError, match=r"bands: found 1\.5; expected a whole number, 1 or more"):
        quality(fitted, noisy(), bands=1.5)


def test_other_lines_are_refused(fitted):
    with pytest.raises(jf.InputError, match=r"G: found shape .*expected .*as the FRF"):
        response_quality(TRUTH[:-1], noisy())


@pytest.mark.parametrize("level", [95, -0.5, 0.0, float("nan")])
def test_levels_are_probabilities(fitted, level):
    for asked in (fitted.interval, lambda x: jf.derived(fitted, lambda p: {"gain": p["gain"]}, x)):
        with pytest.raises(jf.InputError, match=r"level: found"):
            asked(level)


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (lambda p: {"x": 1j * p["gain"]}, "'x'"),
        (lambda p: {"x": jnp.log(-p["gain"])}, "nan"),
        (lambda p: {"x": jnp.ones(2) * p["gain"]}, "an array"),
        (lambda p: {"x": p["mass"]}, "'mass'; expected one of gain, corner"),
        (lambda p: p["gain"], "by name"),
    ],
)
def test_what_is_derived_is_real_numbers_by_name(fitted, function, says):
    with pytest.raises(jf.InputError, match=says):
        jf.derived(fitted, function)
