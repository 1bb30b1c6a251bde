"""Closed forms: where estimators must agree with each other, with Y U^-1, or with the plant itself."""

import numpy as np
import plants
import pytest
from marks import slow

import jaxfrf as jf

LINES = np.arange(61, 61 + 2 * 40, 2)
FREQUENCY = LINES * 0.25


def relative(A, B):
    return np.linalg.norm(np.asarray(A) - B, axis=(-2, -1)) / np.linalg.norm(B, axis=(-2, -1))


def noisy(n, n_real, n_pos=2, seed=3):
    loop = plants.two_mass_loop(n)
    return plants.steady_spectra(
        loop, LINES, 2000, n_real, n_pos=n_pos, process_noise=0.03, measurement_noise=0.01, seed=seed
    )


@pytest.mark.parametrize("n", [slow(1), 3, slow(6)])
@pytest.mark.parametrize(
    "method",
    [
        jf.H1(),
        jf.H2(),
        jf.Hv(),
        jf.ArithmeticMean(),
        jf.LogMean(),
        jf.LogMean(elementwise=True),
        jf.JointInputOutput(jf.H1()),
    ],
    ids=["h1", "h2", "hv", "arithmetic", "log", "log-elementwise", "jio"],
)
def test_one_block_leaves_no_choice(method, n):
    """M = 1: every classical estimator is Y U^-1."""
    data = noisy(n, 1)
    U, Y = (np.moveaxis(X, 1, -1) for X in (data.U, data.Y))  # (pos, freq, channel, exp)
    found = jf.estimate(data.spectra(), method)
    assert relative(found.G, Y @ np.linalg.inv(U)).max() < 1e-10


@pytest.mark.parametrize("n, n_real", [slow(1, 4), (3, 2)])
@pytest.mark.parametrize("method", [jf.LPM, jf.MisoLRM, jf.LRM])
def test_stacked_window_of_one_line_is_h1(method, n, n_real):
    given = noisy(n, n_real).spectra()
    h1 = jf.estimate(given, jf.H1())
    local = jf.estimate(given, method(order=0, width=1))
    assert relative(local.G, np.asarray(h1.G)).max() < 1e-10
    assert relative(plants.from_residuals(local.cov), np.asarray(h1.cov)).max() < 1e-8
    np.testing.assert_allclose(np.broadcast_to(local.dof, h1.dof.shape), h1.dof)


def test_joint_stacked_window_of_one_line_is_jio():
    given = noisy(2, 3).spectra()
    jio = jf.estimate(given, jf.JointInputOutput(jf.H1()))
    local = jf.estimate(given, jf.JointInputOutput(jf.LRM(order=0, width=1)))
    assert relative(local.G, np.asarray(jio.G)).max() < 1e-10
    assert relative(plants.from_residuals(local.cov), np.asarray(jio.cov)).max() < 1e-8


def test_lpm_and_lrm_of_order_zero_are_one():
    """Without polynomials of degree one or more there is no denominator either."""
    given = noisy(2, 1).spectra()
    lpm, lrm = (jf.estimate(given, method(order=0, width=5)) for method in (jf.LPM, jf.LRM))
    assert relative(lrm.G, np.asarray(lpm.G)).max() < 1e-10
    assert relative(lrm.cov, np.asarray(lpm.cov)).max() < 1e-8


@pytest.mark.parametrize("variable", ["index", "frequency"])
@pytest.mark.parametrize(
    "n_out, n_in, n_exp, order, width", [slow(1, 1, 1, 2, 6), (3, 2, 1, 3, 12), slow(2, 2, 3, 2, 5)]
)
def test_lpm_is_exact_on_polynomials(n_out, n_in, n_exp, order, width, variable):
    rng = np.random.default_rng(order)
    G = plants.matrix_polynomial(rng, n_out, n_in, LINES - LINES.mean(), order)
    U = plants.circular(rng, (n_exp, len(LINES), n_in))
    found = jf.estimate(
        plants.spectra(U, plants.open_loop_spectra(G, U)), jf.LPM(order=order, width=width, variable=variable)
    )
    assert relative(found.G[0], G).max() < 1e-9


@pytest.mark.parametrize("variable", ["index", "frequency"])
@pytest.mark.parametrize(
    "n_out, n_in, n_exp, width", [slow(1, 1, 1, 7), slow(3, 3, 1, 17), (2, 3, 1, 16), (3, 3, 6, 8), slow(6, 6, 1, 34)]
)
def test_lrm_is_exact_on_matrix_fractions(n_out, n_in, n_exp, width, variable):
    rng = np.random.default_rng(7)
    G = plants.matrix_fraction(rng, n_out, n_in, LINES - LINES.mean(), 2)
    U = plants.circular(rng, (n_exp, len(LINES), n_in))
    found = jf.estimate(
        plants.spectra(U, plants.open_loop_spectra(G, U)), jf.LRM(order=2, width=width, variable=variable)
    )
    assert relative(found.G[0], G).max() < 1e-9


def mechanical_acceleration(n, frequency, seed=0):
    """-w^2 (K + j w D - w^2 M)^-1: a matrix fraction of degree two in frequency, resonances in the band."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n)) / np.sqrt(n)
    inertia = np.eye(n) + 0.3 * root @ root.T
    omega = 2 * np.pi * frequency
    stiffness = np.diag(np.linspace(omega[len(omega) // 4], omega[-len(omega) // 4], n) ** 2)
    w = omega[:, None, None]
    return -(w**2) * np.linalg.inv(stiffness + 0.05j * w * np.sqrt(stiffness) - w**2 * inertia)


@pytest.mark.parametrize("n", [slow(1), 3])
def test_lrm_is_exact_on_a_mechanical_system(n):
    """Log-spaced lines and resonances: exact with the variable in which the plant is rational."""
    lines = plants.log_odd_lines(61, 301, 44)
    G = mechanical_acceleration(n, lines * 0.25)
    U = plants.circular(np.random.default_rng(1), (1, len(lines), n))
    given = plants.spectra(U, plants.open_loop_spectra(G, U), None, lines, 500.0, 2000)
    found = jf.estimate(given, jf.LRM(order=2, width=5 * n + 3, variable="frequency"))
    assert relative(found.G[0], G).max() < 1e-9


@pytest.mark.parametrize("n, n_exp", [(1, 1), slow(2, 1), slow(3, 1), (3, 4)])
def test_joint_input_output_lrm_is_exact_in_closed_loop(n, n_exp):
    """u = C (r - y), C constant: [y; u] on r are matrix fractions of the plant's own degree."""
    G = mechanical_acceleration(n, FREQUENCY)
    gain = 0.3 * np.eye(n)
    R = plants.orthogonal_multisine(np.random.default_rng(2), 2, len(LINES), n)
    R = np.concatenate([R, R[:, ::-1]])[:n_exp]
    to_u = np.linalg.inv(np.eye(n) + gain @ G) @ gain
    U = plants.open_loop_spectra(to_u, R)
    Y = plants.open_loop_spectra(G, U)
    method = jf.JointInputOutput(jf.LRM(order=2, width=5 * n + 4))
    assert relative(jf.estimate(plants.spectra(U, Y, R), method).G[0], G).max() < 1e-9


@pytest.mark.parametrize("n_out, n_in", [slow(1, 1), (3, 2)])
def test_miso_lrm_is_exact_where_every_row_has_its_own_denominator(n_out, n_in):
    rng = np.random.default_rng(4)
    x = LINES - LINES.mean()
    rows = [plants.matrix_fraction(rng, 1, n_in, x, 2) for _ in range(n_out)]
    G = np.concatenate(rows, axis=1)
    U = plants.circular(rng, (1, len(LINES), n_in))
    found = jf.estimate(plants.spectra(U, plants.open_loop_spectra(G, U)), jf.MisoLRM(order=2, width=11))
    assert relative(found.G[0], G).max() < 1e-9


def slow_denominator(x):
    """A scalar polynomial of degree two, far from zero over the whole band."""
    x = x / np.abs(x).max()
    return 1 + 0.2j * x + 0.1 * x**2


@pytest.mark.parametrize("n, width", [(1, 6), slow(3, 11), slow(6, 20)])
def test_common_denominator_cancels(n, width):
    """[y; u] = [N_y; N_u] / d r, one scalar d: fewer lines than a full matrix fraction needs are enough."""
    rng = np.random.default_rng(5)
    x = LINES - LINES.mean()
    d = slow_denominator(x)[:, None, None]
    Ny = plants.matrix_polynomial(rng, n, n, x, 2)
    Nu = plants.matrix_polynomial(rng, n, n, x, 2) + 2 * n * np.eye(n)
    R = plants.orthogonal_multisine(rng, 1, len(LINES), n)[:1]
    Y, U = (plants.open_loop_spectra(N / d, R) for N in (Ny, Nu))
    method = jf.JointInputOutput(jf.CommonDenominatorLRM(order=2, width=width))
    G = Ny @ np.linalg.inv(Nu)
    assert relative(jf.estimate(plants.spectra(U, Y, R), method).G[0], G).max() < 1e-9


@pytest.mark.parametrize("method", [jf.LPM, slow(jf.MisoLRM), jf.LRM])
def test_transient_of_the_chosen_order_is_removed(method):
    """Y = (N U + T) / d with a polynomial T of its own for every experiment."""
    rng = np.random.default_rng(6)
    x = LINES - LINES.mean()
    n_exp, n = 2, 2
    N = plants.matrix_polynomial(rng, n, n, x, 2)
    T = np.stack([plants.matrix_polynomial(rng, n, 1, x, 2)[..., 0] for _ in range(n_exp)])
    d = np.ones(len(x)) if method is jf.LPM else slow_denominator(x)
    U = plants.circular(rng, (n_exp, len(x), n))
    Y = (plants.open_loop_spectra(N, U) + T) / d[:, None]
    found = jf.estimate(plants.spectra(U, Y), method(order=2, width=20, transient=2))
    assert relative(found.G[0], N / d[:, None, None]).max() < 1e-9


@pytest.mark.parametrize("n", [slow(1), 3])
@pytest.mark.parametrize("method", [jf.ArithmeticMean, jf.LogMean])
def test_means_of_equal_responses_are_that_response(method, n):
    """Noise-free blocks all give G, and the scatter between them is rounding."""
    loop = plants.two_mass_loop(n)
    data = plants.steady_spectra(loop, LINES, 2000, 3, seed=4)
    found = jf.estimate(data.spectra(), method())
    assert relative(found.G[0], data.G).max() < 1e-10
    variance = np.abs(np.asarray(found.cov[0])).max(axis=(-2, -1))
    assert np.all(variance < 1e-24 * np.abs(data.G).max(axis=(-2, -1)) ** 2)


def test_hv_lies_between_h1_and_h2():
    """One input, one output: noise in y biases H1 not at all and H2 upwards, noise in u H1 downwards."""
    rng = np.random.default_rng(8)
    G = plants.modal_response(rng, 1, 1, 2 * np.pi * FREQUENCY)
    U = plants.circular(rng, (40, len(LINES), 1))
    Y = plants.open_loop_spectra(G, U, noise=0.2)
    given = plants.spectra(U + 0.2 * plants.circular(rng, U.shape), Y)
    h1, hv, h2 = (np.abs(np.asarray(jf.estimate(given, m).G)) for m in (jf.H1(), jf.Hv(), jf.H2()))
    assert np.all(h1 < hv) and np.all(hv < h2)


def test_from_time_records_to_the_frf():
    """A loop simulated sample by sample, its run-in thrown away: the DFT of steady periods gives G."""
    loop, period, n = plants.two_mass_loop(2), 1000, 2
    lines = np.arange(11, 121, 2)
    R = plants.orthogonal_multisine(np.random.default_rng(9), 1, len(lines), n)
    run_in, steady = 6, 2
    reference = np.stack([np.tile(plants.multisine_record(r, lines, period), (run_in + steady, 1)) for r in R])
    records = [plants.simulate(loop, r) for r in reference]
    data = jf.Experiment(
        u=np.stack([u for u, _ in records]),
        y=np.stack([y for _, y in records]),
        r=reference,
        fs=loop.fs,
        period=period,
        lines=lines,
        transient_periods=run_in,
    )
    spectra = jf.dft(data)
    np.testing.assert_allclose(spectra.R[0], R, atol=1e-10)
    G = loop.plant(lines * loop.fs / period)
    for method in (jf.H1(), jf.JointInputOutput(jf.H1())):
        assert relative(jf.estimate(spectra, method).G[0], G).max() < 1e-6
    # A local model has a bias, which 1 Hz between the lines keeps small.
    local = jf.estimate(spectra, jf.JointInputOutput(jf.LRM(order=2, width=8)))
    assert np.median(relative(local.G[0], G)) < 0.02
