"""What every estimator owes its user: units, channel order and the order of experiments change nothing else.

Where y = T y' and u = S u', G = T G' S^-1 and Cov(vec G) = J Cov(vec G') J^H with J = S^-T (x) T.
"""

import functools

import numpy as np
import plants
import pytest
from hypothesis import given, settings, strategies as st
from marks import slow

import jaxfrf as jf

N, N_EXP, N_FREQ = 2, 4, 26
JIO = jf.JointInputOutput

CLASSICAL = [jf.H1(), jf.H2(), JIO(jf.H1()), jf.ArithmeticMean()]
LOCAL = [
    slow(jf.LPM(order=2, width=9)),
    jf.LRM(order=2, width=9),
    slow(JIO(jf.LPM(order=2, width=9))),
    JIO(jf.LRM(order=2, width=9)),
]
BY_CHANNEL = [jf.MisoLRM(order=2, width=9), JIO(jf.MisoLRM(order=2, width=9))]
COMMON = [JIO(jf.CommonDenominatorLRM(order=2, width=9))]
LOGARITHMIC = [
    jf.LogMean(),
    slow(jf.LogMean(jf.LRM(order=2, width=14))),
    jf.LogMean(JIO(jf.LRM(order=2, width=14))),
]
ELEMENTWISE = [jf.LogMean(elementwise=True), jf.LogMean(jf.LRM(order=2, width=14), elementwise=True)]

seeds = st.integers(0, 2**31)
scales = st.lists(st.floats(-3, 3).map(lambda e: 10.0**e), min_size=N, max_size=N).map(np.diag)
orders = st.permutations(range(N)).map(lambda p: np.eye(N)[list(p)])
few = settings(max_examples=5, deadline=None, derandomize=True)


def each(*groups):
    return pytest.mark.parametrize("method", [m for g in groups for m in g], ids=repr)


@functools.lru_cache(maxsize=64)
def data(seed):
    loop = plants.two_mass_loop(N, seed=seed % 5)
    return plants.steady_spectra(
        loop,
        np.arange(91, 91 + 2 * N_FREQ, 2),
        2000,
        N_EXP // N,
        n_pos=2,
        process_noise=0.02,
        measurement_noise=0.005,
        seed=seed,
    )


def estimate(U, Y, R, method):
    return jf.estimate(plants.spectra(U, Y, R, np.arange(91, 91 + 2 * N_FREQ, 2), 500.0, 2000), method)


def invertible(seed):
    """A random complex matrix of condition number at most 3."""
    rng = np.random.default_rng(seed)
    left, _, right = np.linalg.svd(plants.circular(rng, (N, N)))
    return left @ np.diag(rng.uniform(1, 3, N)) @ right


def assert_transforms(method, seed, T=None, S=None):
    """y -> T y and u -> S u (r -> r): the estimate and its covariance follow."""
    T, S = (np.eye(N) if M is None else M for M in (T, S))
    d = data(seed)
    before = estimate(d.U, d.Y, d.R, method)
    after = estimate(d.U @ S.T, d.Y @ T.T, d.R, method)
    back = np.linalg.solve(T, np.asarray(after.G)) @ S
    assert close(back, before.G)
    J = np.kron(S.T, np.linalg.inv(T))
    assert close(J @ plants.from_residuals(after.cov) @ J.conj().T, plants.from_residuals(before.cov), 1e-5)
    return before, after


def close(A, B, tolerance=1e-7):
    A, B = np.asarray(A), np.asarray(B)
    error = np.linalg.norm(A - B, axis=(-2, -1)) / np.linalg.norm(B, axis=(-2, -1))
    return error.max() < tolerance


@each(CLASSICAL, LOCAL)
@few
@given(seed=seeds)
def test_any_invertible_mixture_of_outputs_and_of_inputs(method, seed):
    """The full matrix fraction absorbs it: N -> T N S^-1, D -> T D T^-1."""
    assert_transforms(method, seed, invertible(seed + 1), invertible(seed + 2))


@each(CLASSICAL, LOCAL, BY_CHANNEL, COMMON, ELEMENTWISE)
@few
@given(seed=seeds, T=scales, S=scales)
def test_units_of_outputs_and_inputs(method, seed, T, S):
    before, after = assert_transforms(method, seed, T, S)
    np.testing.assert_allclose(after.dof, before.dof, rtol=1e-5)


@pytest.mark.parametrize(("method", "ratio"), [(LOCAL[1], 1e-6), (CLASSICAL[0], 1e-12)], ids=repr)
def test_one_input_of_another_size(method, ratio):
    """Element by element, and the bias with them: no line is taken for singular, no experiment for a copy."""
    d, size = data(0), np.array([1.0, ratio])
    one, other = estimate(d.U, d.Y, None, method), estimate(d.U * size, d.Y, None, method)
    np.testing.assert_allclose(other.G * size, one.G, rtol=1e-6)
    np.testing.assert_allclose(other.std * size, one.std, rtol=1e-6)
    assert (one.bias is None) == (other.bias is None)
    if one.bias is not None:
        assert one.bias.any()
        np.testing.assert_allclose(other.bias * size, one.bias, rtol=1e-4)


@each(CLASSICAL, LOCAL, BY_CHANNEL, COMMON, ELEMENTWISE)
@few
@given(seed=seeds, T=orders, S=orders)
def test_order_of_outputs_and_inputs(method, seed, T, S):
    before, after = assert_transforms(method, seed, T, S)
    np.testing.assert_allclose(after.dof, before.dof, rtol=1e-5)


@each(LOGARITHMIC)
@few
@given(seed=seeds, S=scales | orders)
def test_the_matrix_logarithm_follows_a_similarity(method, seed, S):
    """log(S A S^-1) = S log(A) S^-1: the same units or order on both sides of the plant, nothing more."""
    before, after = assert_transforms(method, seed, S, S)
    np.testing.assert_allclose(after.dof, before.dof, rtol=1e-5)


@each([jf.LogMean(), jf.LogMean(jf.LRM(order=2, width=14))])
@few
@given(seed=seeds, size=st.floats(-3, 3), phase=st.floats(-np.pi, np.pi))
def test_the_matrix_logarithm_follows_a_complex_factor(method, seed, size, phase):
    assert_transforms(method, seed, 10.0**size * np.exp(1j * phase) * np.eye(N))


@each([JIO(jf.H1()), *LOCAL[2:], *BY_CHANNEL[1:], *COMMON])
@few
@given(seed=seeds, scale=scales, order=orders)
def test_the_reference_may_be_any_mixture(method, seed, scale, order):
    """r -> M r multiplies G_ry and G_ru alike, and their ratio not at all."""
    d = data(seed)
    mixed = d.R @ (scale @ order @ invertible(seed)).T
    before, after = estimate(d.U, d.Y, d.R, method), estimate(d.U, d.Y, mixed, method)
    assert close(after.G, before.G, 1e-6)
    assert close(after.cov, before.cov, 1e-4)


@each([jf.H1(), jf.ArithmeticMean(), JIO(jf.H1()), jf.LPM(order=2, width=9), JIO(jf.LPM(order=2, width=9))])
@few
@given(seed=seeds, a=st.complex_numbers(max_magnitude=10), b=st.complex_numbers(max_magnitude=10))
def test_linear_in_the_output(method, seed, a, b):
    d, other = data(seed), data(seed + 1)
    first, second = estimate(d.U, d.Y, d.R, method), estimate(d.U, other.Y, d.R, method)
    both = estimate(d.U, a * d.Y + b * other.Y, d.R, method)
    expected = a * np.asarray(first.G) + b * np.asarray(second.G)
    size = abs(a) * np.abs(first.G).max() + abs(b) * np.abs(second.G).max()
    assert np.abs(np.asarray(both.G) - expected).max() <= 1e-9 * size


@each([jf.H1(), jf.H2(), JIO(jf.H1()), *LOCAL, *BY_CHANNEL, *COMMON])
@few
@given(seed=seeds, order=st.permutations(range(N_EXP)))
def test_order_of_stacked_experiments(method, seed, order):
    d = data(seed)
    before = estimate(d.U, d.Y, d.R, method)
    after = estimate(d.U[:, order], d.Y[:, order], d.R[:, order], method)
    assert close(after.G, before.G) and close(after.cov, before.cov, 1e-5)


@each([*CLASSICAL, *LOCAL, *BY_CHANNEL, *COMMON, *LOGARITHMIC])
@few
@given(seed=seeds)
def test_positions_do_not_mix(method, seed):
    """Another record at the first position changes nothing at the second, and is estimated as it is elsewhere."""
    d, other = data(seed), data(seed + 1)
    before, elsewhere = estimate(d.U, d.Y, d.R, method), estimate(other.U, other.Y, other.R, method)
    mixed = (np.stack([getattr(other, name)[1], getattr(d, name)[1]]) for name in "UYR")
    found = estimate(*mixed, method)
    assert close(found.G[1], before.G[1]) and close(found.cov[1], before.cov[1], 1e-5)
    assert close(found.G[0], elsewhere.G[1]) and close(found.cov[0], elsewhere.cov[1], 1e-5)


@each(CLASSICAL, LOCAL, BY_CHANNEL, COMMON, LOGARITHMIC, ELEMENTWISE)
@few
@given(seed=seeds)
def test_a_covariance_is_hermitian_and_not_negative(method, seed):
    d = data(seed)
    cov = np.asarray(estimate(d.U, d.Y, d.R, method).cov)
    adjoint = np.swapaxes(cov, -1, -2).conj()
    size = np.abs(cov).max(axis=(-2, -1), keepdims=True)
    assert np.all(np.abs(cov - adjoint) <= 1e-10 * size)
    assert np.all(np.linalg.eigvalsh((cov + adjoint) / 2) >= -1e-9 * size[..., 0])
