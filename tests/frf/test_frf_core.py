"""The estimators as pure functions: derivatives, composition, doubtful windows, covariances as factors."""

import dataclasses
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import plants
import pytest
import scipy.linalg
from marks import slow

import jaxfrf as jf
from jaxfrf._device import at_once, on_accelerator
from jaxfrf.frf import KroneckerSum, OuterSum, Signals
from jaxfrf.frf.covariance import dense
from jaxfrf.frf.method import arrays_of, over_points
from jaxfrf.frf.scaled import Widened
from jaxfrf.frf.two_stage import _one_regression
from jaxfrf.frf.window import windows

LINES = np.arange(41, 41 + 2 * 24, 2)


def records(n=2, n_real=2, n_pos=2, noise=0.02):
    return plants.steady_spectra(
        plants.two_mass_loop(n), LINES, 1000, n_real, n_pos=n_pos, process_noise=noise, measurement_noise=0.003
    )


def response(method, data):
    """G (freq, out, in) of one operating point as a function of its signals."""
    return lambda U, Y, R: method.at_point(Signals(U, Y, R, None, data.frequency)).G


def row_wise(U, Y, R, width, order=2):
    """Joint input-output matrix fractions of one position, window by window, by SciPy's QR with pivoting: G."""
    n_exp, n_freq, n = U.shape
    G = np.empty((n_freq, n, n), complex)
    for k in range(n_freq):
        start = min(max(k - width // 2, 0), n_freq - width)
        x = np.repeat(np.arange(start, start + width)[None] - k, n_exp, axis=0).ravel()[:, None] / width
        r, y, u = (X[:, start : start + width].reshape(-1, n) for X in (R, Y, U))
        of = []
        for z in (y, u):
            K = np.hstack([x**s * r for s in range(order + 1)] + [-(x**s) * z for s in range(1, order + 1)])
            size = np.linalg.norm(K, axis=0)
            q, upper, order_of = scipy.linalg.qr(K / size, mode="economic", pivoting=True)
            theta = np.empty((K.shape[1], n), complex)
            theta[order_of] = scipy.linalg.solve_triangular(upper, q.conj().T @ z)
            of.append((theta / size[:, None])[:n].T)
        G[k] = of[0] @ np.linalg.inv(of[1])
    return G


def side_by_side(monkeypatch, lines: int):
    """Windows go side by side through the processor from so many lines on; tests have fewer than users."""
    monkeypatch.setattr("jaxfrf.frf.window._MANY", lines)


@pytest.mark.parametrize(
    "method, lines",
    [
        (jf.JointInputOutput(jf.LRM(width=12, order=1)), 1),
        slow(jf.JointInputOutput(jf.LRM(width=12)), 1),
        slow(jf.JointInputOutput(jf.LRM(width=12)), 1000),
        slow(jf.MisoLRM(width=10), 1),
        slow(jf.LogMean(), 1),
        slow(jf.LogMean(jf.JointInputOutput(jf.LPM(width=10))), 1000),
    ],
    ids=["jio-lrm, order 1", "jio-lrm", "jio-lrm one by one", "miso", "log", "log-jio-lpm"],
)
def test_derivative_of_the_response(monkeypatch, method, lines):
    """d G / d(U, Y, R) along a random direction: forwards against central differences, backwards against forwards."""
    side_by_side(monkeypatch, lines)
    data, rng = records(), np.random.default_rng(0)
    at = tuple(jnp.asarray(X[0]) for X in (data.U, data.Y, data.R))
    along = tuple(jnp.asarray(plants.circular(rng, x.shape)) * jnp.std(x) for x in at)
    f = jax.jit(response(method, data))
    G, slope = jax.jvp(f, at, along)
    h = 1e-6
    ends = [f(*(x + sign * h * d for x, d in zip(at, along, strict=True))) for sign in (1, -1)]
    difference = (ends[0] - ends[1]) / (2 * h)
    assert np.linalg.norm(slope - difference) < 1e-6 * np.linalg.norm(difference)

    weight = jnp.asarray(rng.standard_normal(G.shape))
    gradient = jax.grad(lambda *x: jnp.sum(weight * jnp.abs(f(*x)) ** 2), argnums=(0, 1, 2))(*at)
    backwards = sum(jnp.sum(g * d).real for g, d in zip(gradient, along, strict=True))
    np.testing.assert_allclose(backwards, jnp.sum(2 * weight * (G.conj() * slope).real), rtol=1e-8)


def test_composed_in_a_program_of_the_users(monkeypatch):
    """`vmap` over operating points inside `jit` is what `estimate` returns."""
    side_by_side(monkeypatch, 1)
    data = records()
    method = jf.JointInputOutput(jf.LRM(width=12))
    G = jax.jit(jax.vmap(response(method, data)))(data.U, data.Y, data.R)
    expected = jf.estimate(data.spectra(), method).G
    assert np.linalg.norm(G - expected) < 1e-11 * np.linalg.norm(expected)


@pytest.mark.parametrize(
    "method",
    [
        slow(jf.LPM(width=10)),
        jf.LRM(width=13, transient=1),
        jf.MisoLRM(width=10),
        slow(jf.JointInputOutput(jf.LPM(width=9))),
        slow(jf.JointInputOutput(jf.LRM(width=12, order=1))),
        slow(jf.JointInputOutput(jf.MisoLRM(width=12))),
        slow(jf.JointInputOutput(jf.CommonDenominatorLRM(width=12))),
        slow(jf.CommonDenominatorLRM(width=12)),
        jf.JointInputOutput(jf.LRM(width=14)),
    ],
)
@pytest.mark.parametrize("lines", [1, 1000], ids=["side by side", "one by one"])
def test_windows_against_their_rows(monkeypatch, method, lines):
    """Gram matrices in either kind of matrices, against singular values of every window's rows."""
    side_by_side(monkeypatch, lines)
    data = records(n=3 if "LPM" in str(method) else 2)
    signals = Signals(*(jnp.asarray(X[0]) for X in (data.U, data.Y, data.R)), None, jnp.asarray(data.frequency))
    every = np.arange(len(LINES))
    found, expected = jax.jit(lambda signals: (method.at_point(signals), method.at_point(signals, every)))(signals)
    assert not found.doubtful.any()
    np.testing.assert_array_equal(found.dof, expected.dof)
    np.testing.assert_array_equal(found.status, expected.status)
    for ours, theirs in ((found.G, expected.G), (dense(found.cov), dense(expected.cov))):
        np.testing.assert_array_less(
            np.linalg.norm(ours - theirs, axis=(1, 2)), 1e-7 * np.linalg.norm(theirs, axis=(1, 2))
        )


@pytest.mark.parametrize("n_exp, width", [(1, 36), (6, 12)])
def test_six_axes_at_their_resonances_against_qr_of_the_rows(monkeypatch, n_exp, width):
    """R3X between its first antiresonance and resonance, in a velocity loop with noise."""
    side_by_side(monkeypatch, 1)
    robot, rng = jf.robot.r3x(), np.random.default_rng(1)
    lines = np.arange(200, 500, 6)
    f = lines / 28
    q = np.array([[0.0, 0.3, -0.4, 0.5, 0.8, 0.2]])
    G = np.asarray(jf.robot.frf(jf.robot.linearise(robot, jf.robot.operating_point(robot, q)), f))[0]
    gain = 1 / np.median(np.abs(np.diagonal(G, axis1=1, axis2=2)), axis=0)
    C = np.eye(6) * gain
    to_u = np.linalg.solve(np.eye(6) + C @ G, C)
    R = plants.orthogonal_multisine(rng, 1, len(lines), 6)[:n_exp]
    size = np.abs(np.einsum("fab,efb->efa", G @ to_u, R)).mean()
    V = 0.02 * size * plants.circular(rng, R.shape)
    U = np.einsum("fab,efb->efa", to_u, R - V)
    Y = np.einsum("fab,efb->efa", G, U) + V
    found = jf.estimate(plants.spectra(U, Y, R, lines, 2000.0, 56000), jf.JointInputOutput(jf.LRM(width=width)))
    expected = row_wise(U, Y, R, width)
    error = np.linalg.norm(found.G[0] - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
    assert error.max() < 1e-8


def test_several_windows_at_once_against_qr_of_the_rows():
    """More lines than are multiplied together, and not a multiple of them."""
    data, method, widths = records(n_pos=1), jf.LRM(), (9, 14, 24)
    signals = Signals(data.U[0], data.Y[0], data.R[0], None, data.frequency)
    several = [windows(np.arange(len(LINES)), width) for width in widths]
    plan = method.plan(signals, joint=True)
    found = jax.jit(lambda signals: method.regressed_with(signals, True, plan, several))(signals)
    np.testing.assert_array_equal(found.window[:, 0], widths)
    np.testing.assert_array_equal(found.dof[:, 0], 4 * np.array(widths) - 10)
    for G, width in zip(found.G, widths, strict=True):
        expected = row_wise(data.U[0], data.Y[0], data.R[0], width)
        assert np.linalg.norm(G - expected) < 1e-8 * np.linalg.norm(expected)


def in_two_stages(R, Y, U, frequency, width):
    """The joint fraction of one position in two stages, by NumPy's least squares of the rows: G and its variances.

    The larger one of y and u is predicted by a fraction of its own, and what was predicted stands in the denominators
    of both."""
    n_freq, n_in, n_out = len(frequency), R.shape[-1], Y.shape[-1]

    def fitted(targets, in_denominators, k):
        start = min(max(k - width // 2, 0), n_freq - width)
        x = frequency[start : start + width] - frequency[k]
        x = np.tile(x / np.abs(x).max(), len(R))[:, None]
        r, z, carried = (X[:, start : start + width].reshape(len(x), -1) for X in (R, targets, in_denominators))
        K = np.hstack([r, x * r, x**2 * r, x * carried, x**2 * carried])
        theta, *_ = np.linalg.lstsq(K, z, rcond=None)
        v = z - K @ theta
        S = np.linalg.inv(K.conj().T @ K)[:n_in, :n_in]
        return theta[:n_in].T, S, v.T @ v.conj() / (len(x) - K.shape[1])

    Z = Y if n_out >= n_in else U
    first = np.stack([fitted(Z, Z, k)[0] for k in range(n_freq)])
    predicted = np.einsum("fzr,efr->efz", first, R)
    G, variances = np.empty((n_freq, n_out, n_in), complex), np.empty((n_freq, n_out, n_in))
    for k in range(n_freq):
        both, S, C = fitted(np.concatenate([Y, U], axis=-1), predicted, k)
        inverse = np.linalg.inv(both[n_out:])
        G[k] = both[:n_out] @ inverse
        rest = np.hstack([np.eye(n_out), -G[k]])
        variances[k] = np.outer(
            np.diagonal(rest @ C @ rest.conj().T).real, np.diagonal(inverse.T @ S @ inverse.conj()).real
        )
    return G, variances


@pytest.mark.parametrize("outputs", [[0, 1], [0], [0, 1, 0]])
def test_two_stages_against_least_squares_of_the_rows(outputs):
    """As many outputs as inputs, fewer, and more: what carries the denominators is the larger side."""
    data, rng = records(n_pos=1, n_real=1), np.random.default_rng(3)  # no more experiments than inputs: windows alone
    Y = data.Y[..., outputs]
    Y = Y + 1e-3 * np.abs(Y).max() * plants.circular(rng, Y.shape)
    found = jf.estimate(dataclasses.replace(data.spectra(), Y=Y), jf.Auto(widths=(18,)))
    G, variances = in_two_stages(data.R[0], Y[0], data.U[0], data.frequency, 18)
    np.testing.assert_allclose(found.G[0], G, rtol=1e-7)
    np.testing.assert_allclose(found.std[0] ** 2, variances, rtol=1e-5)


@pytest.mark.parametrize("transient", [None, 1, 3])
def test_one_regression_has_the_unknowns_that_each_of_two_had(transient):
    data, method = records(n_pos=1), jf.LRM(width=20, transient=transient)
    signals = Signals(data.U[0], data.Y[0], data.R[0], None, data.frequency)
    two = method.plan(signals, joint=True)
    one = _one_regression(two, 2, max(two.columns.signal) + 1, 2)
    constants = 0 if transient is None else transient + 1  # of each of the four experiments
    assert one.equations.n_regressor == two.equations.n_regressor == 3 * 2 + 2 * 2 + 4 * constants
    assert one.equations.targets == ((0, 1, 2, 3),)


@pytest.mark.parametrize("through, apart", [("U", 1e-6), ("R", 1e-9)])
def test_classical_lines_with_nearly_dependent_inputs_are_solved_again(through, apart):
    """One line where two channels are nearly the same, one where they are the same."""
    data = records(noise=0.01)
    X = getattr(data, through).copy()
    X[:, :, 5, 1] = X[:, :, 5, 0] + apart * X[:, :, 5, 1]
    X[:, :, 9, 1] = X[:, :, 9, 0]
    spectra = dataclasses.replace(data.spectra(), **{through: X})
    found = jf.estimate(spectra, jf.H1() if through == "U" else jf.JointInputOutput())
    np.testing.assert_array_equal(np.flatnonzero(found.status[0] & jf.Status.REFINED), [5, 9])
    np.testing.assert_array_equal(np.flatnonzero(found.status[0] & jf.Status.RANK_DEFICIENT), [9])
    U, Y = (np.asarray(x)[0, :, 5] for x in (spectra.U, spectra.Y))
    y, u = (np.linalg.lstsq(X[0, :, 5], z, rcond=None)[0].T for z in (Y, U))
    expected = y @ np.linalg.inv(u)
    assert np.linalg.norm(found.G[0, 5] - expected) < 1e-6 * np.linalg.norm(expected)


def test_doubtful_windows_are_solved_again_from_their_rows(monkeypatch):
    """A reference that nearly repeats itself over half of the band: the Gram matrix is not accurate there."""
    side_by_side(monkeypatch, 1)
    data = records(noise=0.01)
    R = data.R.copy()
    R[:, :, :12, 1] = R[:, :, :12, 0] * (1 + 1e-5 * np.arange(12)) + 1e-6 * R[:, :, :12, 1]
    method = jf.JointInputOutput(jf.LPM(width=8, order=1))
    spectra = dataclasses.replace(data.spectra(), R=R)
    found = jf.estimate(spectra, method)
    again = (found.status & jf.Status.REFINED) > 0
    fast = jax.jit(method.at_point)(Signals(data.U[0], data.Y[0], R[0], None, data.frequency))
    np.testing.assert_array_equal(again[0], fast.doubtful)
    assert again.any() and not again.all() and not np.any(found.status & jf.Status.RANK_DEFICIENT)
    for pos in range(2):
        for k in np.flatnonzero(again[pos]):
            start = min(max(k - 4, 0), len(LINES) - 8)
            x = np.tile(np.arange(start, start + 8) - k, data.U.shape[1])[:, None] / 8
            r, y, u = (X[pos][:, start : start + 8].reshape(-1, 2) for X in (R, data.Y, data.U))
            theta = scipy.linalg.lstsq(np.hstack([r, x * r]), np.hstack([y, u]), lapack_driver="gelsy", cond=1e-14)[0]
            expected = theta[:2, :2].T @ np.linalg.inv(theta[:2, 2:].T)
            assert np.linalg.norm(found.G[pos, k] - expected) < 1e-6 * np.linalg.norm(expected)


def test_a_covariance_of_factors_is_the_array_it_stands_for():
    rng = np.random.default_rng(2)
    left, right = plants.circular(rng, (2, 3, 4, 2, 2)), plants.circular(rng, (2, 3, 4, 3, 3))
    cov = KroneckerSum(left, right)
    expected = sum(np.einsum("pfab,pfij->pfaibj", left[:, :, t], right[:, :, t]).reshape(2, 3, 6, 6) for t in range(4))
    np.testing.assert_allclose(np.asarray(cov), expected)
    np.testing.assert_allclose(cov.diagonal(), np.diagonal(expected, axis1=-2, axis2=-1).real)
    np.testing.assert_allclose(cov[1, 2, :, 3], expected[1, 2, :, 3])
    np.testing.assert_allclose(cov[[0, 1], [1, 2]], expected[[0, 1], [1, 2]])
    np.testing.assert_allclose(2 * cov.conj() + 1, 2 * expected.conj() + 1)
    assert isinstance(cov[1:], KroneckerSum) and cov[1:].shape == (1, 3, 6, 6) == cov[[1]].shape
    columns = plants.circular(rng, (3, 6, 2))
    np.testing.assert_allclose(np.asarray(OuterSum(columns)), columns @ columns.conj().mT)
    np.testing.assert_allclose(OuterSum(columns).diagonal(), np.sum(np.abs(columns) ** 2, axis=-1))


def test_estimates_keep_their_covariance_as_factors(tmp_path):
    """Stacked estimates take a few factors a line; positions are joined, cut and written without a loss."""
    frf = jf.estimate(records().spectra(), jf.JointInputOutput(jf.LRM(width=12)))
    assert isinstance(frf.cov, Widened) and isinstance(frf.cov.of, KroneckerSum)
    assert isinstance(jf.concatenate_positions([frf, frf]).cov.of, KroneckerSum)
    jf.io.write_frf(tmp_path / "frf.npz", frf)
    np.testing.assert_array_equal(jf.io.read_frf(tmp_path / "frf.npz").cov, np.asarray(frf.cov))
    variance = np.diagonal(np.asarray(frf.cov), axis1=-2, axis2=-1).real.reshape(2, -1, 2, 2).swapaxes(-1, -2)
    np.testing.assert_allclose(frf.std, np.sqrt(variance))


def test_positions_in_threads_are_those_one_by_one(monkeypatch):
    """Three positions for two threads: groups of two, the last filled up."""
    module = importlib.import_module("jaxfrf.frf.estimate")
    monkeypatch.setattr(module, "_SHARED", 1)
    monkeypatch.setattr(module, "_threads", lambda spectra, method: 2)
    spectra, told = records(n_pos=3).spectra(), []
    with jax.default_device(jax.devices("cpu")[0]):  # a GPU takes them all at once
        for _ in range(2):  # compiled by the first group, then by none
            together = jf.estimate(spectra, jf.H1(), progress=lambda *now: told.append(now))
        monkeypatch.undo()
        alone = jf.estimate(spectra, jf.H1())
    assert told == [(2, 3), (3, 3)] * 2
    np.testing.assert_allclose(together.G, alone.G, rtol=1e-12)
    np.testing.assert_allclose(np.asarray(together.cov), np.asarray(alone.cov), rtol=1e-10)


@pytest.mark.parametrize(
    "method", [jf.LRM(width=11), slow(jf.LogMean(jf.MisoLRM(width=14))), jf.JointInputOutput(jf.LPM())]
)
def test_all_windows_at_once_as_a_gpu_takes_them(monkeypatch, method):
    """Positions, blocks and windows side by side, in one tile or several: the same numbers as one after the other."""
    points, frequency = arrays_of(records(n_pos=3).spectra())

    def estimated():
        def at_point(point):
            return method.at_point(Signals(**point, frequency=frequency))

        return jax.jit(lambda points: over_points(at_point, points))(points)

    one_by_one = estimated()
    for module in map(importlib.import_module, ("jaxfrf.frf.window", "jaxfrf.frf.method", "jaxfrf.frf.average")):
        monkeypatch.setattr(module, "on_accelerator", lambda: True)
    for count in (10_000, 40):
        monkeypatch.setattr("jaxfrf.frf.window.at_once", lambda n_column, count=count: count)
        monkeypatch.setattr("jaxfrf.frf.method.at_once", lambda n_column, count=count: count)
        together = estimated()
        np.testing.assert_allclose(together.G, one_by_one.G, rtol=1e-9)
        np.testing.assert_allclose(dense(together.cov), dense(one_by_one.cov), rtol=1e-7, atol=1e-18)
        np.testing.assert_array_equal(together.status, one_by_one.status)


def test_whether_a_gpu_is_meant():
    assert not on_accelerator()
    with jax.default_device("cpu"):
        assert not on_accelerator()
    assert at_once(100) == 6250 and at_once(10**6) == 1


def test_logarithmic_mean_of_what_has_no_logarithm():
    """A block that is singular, by an output or input that is dead: no number is made up."""
    rng = np.random.default_rng(3)
    n = 3
    G = rng.normal(size=(4 * n, 2, n, n)) + 1j * rng.normal(size=(4 * n, 2, n, n))
    for line in range(4 * n):
        block, channel, of_input = line % 2, line // 4, line // 2 % 2
        G[line, block, *((slice(None), channel) if of_input else (channel,))] = 0.0
    G = np.concatenate([G, np.eye(n) + 0.1 * G[:1]])
    G[-1] += np.eye(n)
    mean, _ = jax.jit(jf.LogMean().mean)(G)
    assert np.isnan(mean[:-1]).all() and np.isfinite(mean[-1]).all()


def test_logarithmic_mean_without_eigenvectors():
    """Blocks that are Jordan's."""
    G = np.stack([np.eye(3) + np.eye(3, k=1), np.eye(3)]).astype(complex)
    assert jax.jit(jf.LogMean().mean)(G[None])[1].all() and jax.jit(jf.LogMean().mean)(G[None, ::-1])[1].all()
