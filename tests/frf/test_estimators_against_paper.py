"""Every estimator against a plain loop written from the paper's equations, in closed and open loop."""

import functools

import numpy as np
import paper_reference as ref
import plants
import pytest
from marks import slow

import jaxfrf as jf

SIX = pytest.param(6, 2, marks=pytest.mark.slow)  # axes, realisations
FREQUENCY_GRIDS = {
    "linear": np.arange(81, 81 + 2 * 40, 2),
    "log": plants.log_odd_lines(41, 401, 40),
}
N_POS = 2


@functools.lru_cache
def closed_loop(n, n_real=2, grid="linear", seed=1):
    """Two positions with different references and noise; 1 % process and .3 % measurement noise."""
    return plants.steady_spectra(
        plants.two_mass_loop(n),
        FREQUENCY_GRIDS[grid],
        2000,
        n_real,
        n_pos=N_POS,
        process_noise=0.01,
        measurement_noise=0.003,
        seed=seed,
    )


@functools.lru_cache
def open_loop(n_out, n_in, n_exp, grid="linear", seed=2):
    """A plant with unequal numbers of inputs and outputs."""
    rng = np.random.default_rng(seed)
    lines = FREQUENCY_GRIDS[grid]
    frequency = lines * 0.25
    G = plants.modal_response(rng, n_out, n_in, 2 * np.pi * frequency)
    U = plants.circular(rng, (N_POS, n_exp, len(lines), n_in))
    Y = plants.open_loop_spectra(G, U, noise=0.01, seed=seed)
    return plants.Records(U, Y, U, G, frequency, lines, 500.0, 2000)


def first_experiments(records, n_exp):
    """The same records, cut to their first experiments (as `jaxfrf.Spectra`, and as U, Y, R)."""
    U, Y, R = (X[:, :n_exp] for X in (records.U, records.Y, records.R))
    return plants.spectra(U, Y, R, records.lines, records.fs, records.period), U, Y, R


def relative(A, B):
    """|A - B| / |B| in the Frobenius norm, per position and line."""
    return np.linalg.norm(np.asarray(A) - B, axis=(-2, -1)) / np.linalg.norm(B, axis=(-2, -1))


def assert_same(found, expected, covariance=True, tolerance=1e-8):
    """`found` a jaxfrf.FRF, `expected` one `Estimate` for each position."""
    error = relative(found.G, np.stack([e.G for e in expected]))
    assert error.max() < tolerance, f"G: median {np.median(error):.1e}, max {error.max():.1e} at {error.argmax()}"
    if covariance:
        dof = np.stack([e.dof for e in expected])
        np.testing.assert_allclose(np.broadcast_to(found.dof, dof.shape), dof)
        error = relative(plants.from_residuals(found.cov), np.stack([e.cov for e in expected]))
        assert error.max() < 1e-6, f"cov: median {np.median(error):.1e}, max {error.max():.1e} at {error.argmax()}"


# --- the loops themselves: exact where they must be ---


@pytest.mark.parametrize("n, n_exp", [(1, 1), (2, 1), (2, 4)])
def test_the_loops_are_exact_without_noise(n, n_exp):
    rng, x = np.random.default_rng(0), np.arange(30.0) - 14
    U = plants.circular(rng, (n_exp, len(x), n))
    for kind, G, width in (
        ("lpm", plants.matrix_polynomial(rng, n, n, x, 2), 3 * n + 2),
        ("lrm-mimo", plants.matrix_fraction(rng, n, n, x, 2), 5 * n + 2),
    ):
        found = ref.local(kind, U, plants.open_loop_spectra(G, U), 2, width)
        assert relative(found.G, G).max() < 1e-12


@pytest.mark.parametrize("n", [1, 3])
def test_the_loops_agree_where_the_equations_do(n):
    data = closed_loop(n, 2)
    U, Y, R = data.U[0], data.Y[0], data.R[0]
    h1, stacked = ref.h1(U, Y), ref.local("lrm-mimo", U, Y, 0, 1)
    assert relative(stacked.G, h1.G).max() < 1e-12
    assert relative(plants.from_residuals(stacked.cov), h1.cov).max() < 1e-10
    jio, stacked = ref.jio(U, Y, R), ref.local_jio("lrm-mimo", U, Y, R, 0, 1)
    assert relative(stacked.G, jio.G).max() < 1e-12
    assert relative(plants.from_residuals(stacked.cov), jio.cov).max() < 1e-10


# --- classical estimators ---


@pytest.mark.parametrize("n, n_real", [(1, 3), (2, 2), (3, 4), SIX])
def test_h1(n, n_real):
    data = closed_loop(n, n_real)
    expected = [ref.h1(U, Y) for U, Y in zip(data.U, data.Y, strict=True)]
    assert_same(jf.estimate(data.spectra(), jf.H1()), expected)


@pytest.mark.parametrize("n_out, n_in, n_exp", [(3, 2, 5), (1, 3, 7), (2, 3, 4)])
def test_h1_with_any_number_of_experiments_inputs_and_outputs(n_out, n_in, n_exp):
    data = open_loop(n_out, n_in, n_exp)
    expected = [ref.h1(U, Y) for U, Y in zip(data.U, data.Y, strict=True)]
    assert_same(jf.estimate(data.spectra(), jf.H1()), expected)


def test_h1_of_one_block_has_no_covariance():
    found = jf.estimate(closed_loop(2, 1).spectra(), jf.H1())
    assert np.all(np.isnan(np.asarray(found.cov)))
    assert np.all(np.asarray(found.status) & jf.Status.NO_COVARIANCE)


@pytest.mark.parametrize("n, n_real", [(1, 3), (2, 2), (3, 4)])
def test_h2(n, n_real):
    data = closed_loop(n, n_real)
    expected = np.stack([ref.h2(U, Y) for U, Y in zip(data.U, data.Y, strict=True)])
    assert relative(jf.estimate(data.spectra(), jf.H2()).G, expected).max() < 1e-8


@pytest.mark.parametrize("n, n_real", [(1, 3), (1, 6), (3, 4)])
def test_hv_is_total_least_squares(n, n_real):
    data = closed_loop(n, n_real)
    expected = np.stack([ref.hv(U, Y) for U, Y in zip(data.U, data.Y, strict=True)])
    assert relative(jf.estimate(data.spectra(), jf.Hv()).G, expected).max() < 1e-8


@pytest.mark.parametrize("n, n_real", [(1, 3), (2, 2), (3, 4), SIX])
def test_jio(n, n_real):
    data = closed_loop(n, n_real)
    expected = [ref.jio(*X) for X in zip(data.U, data.Y, data.R, strict=True)]
    assert_same(jf.estimate(data.spectra(), jf.JointInputOutput(jf.H1())), expected)
    assert_same(jf.estimate(data.spectra(), jf.JointInputOutput()), expected)


@pytest.mark.parametrize("n, n_real", [(1, 3), (2, 2), (3, 4), SIX])
def test_arithmetic_mean(n, n_real):
    data = closed_loop(n, n_real)
    expected = [ref.arithmetic_mean(ref.block_responses(U, Y)) for U, Y in zip(data.U, data.Y, strict=True)]
    assert_same(jf.estimate(data.spectra(), jf.ArithmeticMean()), expected)


@pytest.mark.parametrize("n, n_real", [slow(1, 3), slow(2, 2), (3, 4), SIX])
def test_log_mean(n, n_real):
    """The paper's estimate; its covariance without the factor (M - 1)/M that the paper's is too small by."""
    data = closed_loop(n, n_real)
    responses = [ref.block_responses(U, Y) for U, Y in zip(data.U, data.Y, strict=True)]
    expected = [ref.unbiased(ref.log_mean(g)) for g in responses]
    assert_same(jf.estimate(data.spectra(), jf.LogMean()), expected)


@pytest.mark.parametrize("n_out, n_in", [(3, 3), (3, 2)])
def test_log_mean_elementwise(n_out, n_in):
    data = open_loop(n_out, n_in, 3 * n_in)
    responses = [ref.block_responses(U, Y) for U, Y in zip(data.U, data.Y, strict=True)]
    expected = [ref.unbiased(ref.log_mean_elementwise(g)) for g in responses]
    assert_same(jf.estimate(data.spectra(), jf.LogMean(elementwise=True)), expected)


def test_blocks_leave_out_the_experiments_beyond_the_last_whole_one():
    data = open_loop(2, 2, 5)
    responses = [ref.block_responses(U[:4], Y[:4]) for U, Y in zip(data.U, data.Y, strict=True)]
    expected = [ref.unbiased(ref.log_mean(g)) for g in responses]
    assert_same(jf.estimate(data.spectra(), jf.LogMean()), expected)


# --- local estimators ---

METHODS = {"lpm": jf.LPM, "lrm-miso": jf.MisoLRM, "lrm-mimo": jf.LRM}
CASES = [
    # kind, n, experiments, order, width (odd ones are symmetric windows)
    ("lpm", 1, 1, 2, 6),
    slow("lpm", 3, 1, 2, 14),
    ("lpm", 2, 3, 1, 7),
    slow("lpm", 2, 4, 2, 9),
    ("lrm-miso", 1, 1, 2, 8),
    slow("lrm-miso", 3, 1, 2, 15),
    ("lrm-miso", 2, 4, 2, 8),
    ("lrm-mimo", 1, 1, 2, 7),
    slow("lrm-mimo", 3, 1, 2, 20),
    ("lrm-mimo", 3, 6, 2, 9),
    slow("lrm-mimo", 2, 3, 1, 12),
    slow("lrm-mimo", 2, 4, 3, 40),  # one window holds the whole band
    slow("lrm-mimo", 6, 1, 2, 34),
]


def check_local(kind, n, n_exp, order, width, grid, variable):
    data = closed_loop(n, max(2, -(-n_exp // n)), grid)
    given, U, Y, _ = first_experiments(data, n_exp)
    expected = [ref.local(kind, u, y, order, width, variable, data.frequency) for u, y in zip(U, Y, strict=True)]
    found = jf.estimate(given, METHODS[kind](order=order, width=width, variable=variable))
    assert_same(found, expected)


@pytest.mark.parametrize("kind, n, n_exp, order, width", CASES)
def test_local_methods(kind, n, n_exp, order, width):
    check_local(kind, n, n_exp, order, width, "linear", "index")


@pytest.mark.parametrize("variable", ["index", "frequency"])
@pytest.mark.parametrize(
    "kind, n, n_exp, order, width",
    [slow("lpm", 3, 1, 2, 14), slow("lrm-miso", 2, 4, 2, 8), slow("lrm-mimo", 3, 1, 2, 20), ("lrm-mimo", 3, 6, 2, 9)],
)
def test_local_methods_on_log_spaced_lines(kind, n, n_exp, order, width, variable):
    """The two variables are two estimates where the lines are not evenly spaced."""
    check_local(kind, n, n_exp, order, width, "log", variable)


@pytest.mark.parametrize("kind", ["lpm", slow("lrm-miso"), slow("lrm-mimo")])
def test_local_methods_with_unequal_numbers_of_inputs_and_outputs(kind):
    for n_out, n_in in ((3, 2), (1, 3)):
        data = open_loop(n_out, n_in, 2)
        expected = [ref.local(kind, u, y, 2, 17) for u, y in zip(data.U, data.Y, strict=True)]
        assert_same(jf.estimate(data.spectra(), METHODS[kind](order=2, width=17, variable="index")), expected)


@pytest.mark.parametrize("kind", METHODS)
@pytest.mark.parametrize("n_exp", [slow(1), 3])
def test_transient_terms(kind, n_exp):
    given, U, Y, _ = first_experiments(closed_loop(2), n_exp)
    expected = [ref.local(kind, u, y, 2, 18, transient=2) for u, y in zip(U, Y, strict=True)]
    assert_same(jf.estimate(given, METHODS[kind](order=2, width=18, variable="index", transient=2)), expected)


@pytest.mark.parametrize("kind", METHODS)
@pytest.mark.parametrize("n, n_exp, width", [slow(2, 1, 14), (3, 6, 12)])
def test_joint_input_output_of_local_methods(kind, n, n_exp, width):
    given, U, Y, R = first_experiments(closed_loop(n), n_exp)
    expected = [ref.local_jio(kind, *X, 2, width) for X in zip(U, Y, R, strict=True)]
    method = METHODS[kind](order=2, width=width, variable="index")
    assert_same(jf.estimate(given, jf.JointInputOutput(method)), expected)


@pytest.mark.parametrize("n, n_exp, width, variable", [slow(2, 1, 14, "index"), (3, 6, 12, "frequency")])
def test_joint_input_output_on_log_spaced_lines(n, n_exp, width, variable):
    data = closed_loop(n, 2, "log")
    given, U, Y, R = first_experiments(data, n_exp)
    expected = [ref.local_jio("lrm-mimo", *X, 2, width, variable, data.frequency) for X in zip(U, Y, R, strict=True)]
    method = jf.LRM(order=2, width=width, variable=variable)
    assert_same(jf.estimate(given, jf.JointInputOutput(method)), expected)


@pytest.mark.slow
def test_joint_input_output_lrm_of_six_axes():
    given, U, Y, R = first_experiments(closed_loop(6), 1)
    expected = [ref.local_jio("lrm-mimo", *X, 2, 36) for X in zip(U, Y, R, strict=True)]
    method = jf.LRM(order=2, width=36, variable="index")
    assert_same(jf.estimate(given, jf.JointInputOutput(method)), expected)


@pytest.mark.parametrize(
    "kind, n, n_exp, width", [slow("lpm", 1, 3, 8), slow("lrm-miso", 2, 2, 11), ("lrm-mimo", 3, 3, 18)]
)
def test_log_mean_over_single_experiments(kind, n, n_exp, width):
    data = closed_loop(n, n_exp if n == 1 else 1)
    given, U, Y, _ = first_experiments(data, n_exp)
    one = functools.partial(ref.local, kind, order=2, width=width)
    expected = [ref.average_experiments(ref.log_mean, one, u, y) for u, y in zip(U, Y, strict=True)]
    method = METHODS[kind](order=2, width=width, variable="index")
    assert_same(jf.estimate(given, jf.LogMean(method)), expected)


def test_arithmetic_mean_over_single_experiments():
    given, U, Y, _ = first_experiments(closed_loop(2), 4)
    one = functools.partial(ref.local, "lrm-mimo", order=2, width=13)
    expected = [ref.average_experiments(ref.arithmetic_mean, one, u, y) for u, y in zip(U, Y, strict=True)]
    found = jf.estimate(given, jf.ArithmeticMean(jf.LRM(order=2, width=13, variable="index")))
    assert_same(found, expected)


@pytest.mark.parametrize("n, n_exp, width", [(2, 4, 14), slow(6, 6, 34)])
def test_the_papers_recipe_log_mean_over_joint_input_output_lrm(n, n_exp, width):
    given, U, Y, R = first_experiments(closed_loop(n), n_exp)
    one = functools.partial(ref.local_jio, "lrm-mimo", order=2, width=width)
    expected = [ref.average_experiments(ref.log_mean, one, *X) for X in zip(U, Y, R, strict=True)]
    method = jf.LogMean(jf.JointInputOutput(jf.LRM(order=2, width=width, variable="index")))
    assert_same(jf.estimate(given, method), expected)


@pytest.mark.parametrize("n, n_exp, width", [slow(1, 1, 8), slow(3, 1, 13), (2, 4, 8)])
def test_common_denominator(n, n_exp, width):
    """[y; u] on r with one scalar denominator: every channel counts in units of its rms over the window."""
    given, U, Y, R = first_experiments(closed_loop(n), n_exp)
    expected = [ref.common_denominator_jio(*X, 2, width) for X in zip(U, Y, R, strict=True)]
    method = jf.JointInputOutput(jf.CommonDenominatorLRM(order=2, width=width, variable="index"))
    assert_same(jf.estimate(given, method), expected)
