"""Eigenvalues and eigenvectors of many matrices side by side, against LAPACK's of one after the other."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from marks import slow
from scipy.optimize import linear_sum_assignment

from jaxfrf.frf import lanes
from jaxfrf.frf.eigen import ELEMENTS, eigen


@jax.jit
def _eigen(A):
    def of_group(parts):
        values, V, V_inverse = eigen(lanes.Lanes(parts))
        return jax.lax.complex(*values).T, V.by_window, V_inverse.by_window

    groups = jnp.moveaxis(lanes.of_lines(A, lanes.lane_count(len(A), A.shape[1] ** 2, ELEMENTS)).parts, 1, 0)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[: len(A)], jax.lax.map(of_group, groups))


def found(A):
    """(values, V, V^-1) of (line, n, n)."""
    return [np.asarray(x) for x in _eigen(jnp.asarray(A, complex))]


def some(n_line, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n_line, n, n)) + 1j * rng.standard_normal((n_line, n, n))


def farthest(ours, theirs):
    """Of two sets of eigenvalues, in any order."""
    apart = np.abs(ours[:, None] - theirs)
    return apart[linear_sum_assignment(apart)].max()


def assert_eigen(A, values, V, V_inverse, tolerance=1e-13):
    """A V = V diag(values), to what rounding does to A, and V's inverse is one."""
    size = np.linalg.norm(A, axis=(1, 2))
    left = np.linalg.norm(A @ V - V * values[:, None], axis=(1, 2))
    assert np.all(left <= tolerance * size)
    np.testing.assert_allclose(np.linalg.norm(V, axis=1), 1.0, rtol=1e-12)
    condition = np.linalg.norm(V, axis=(1, 2)) * np.linalg.norm(V_inverse, axis=(1, 2))
    assert np.all(np.linalg.norm(V @ V_inverse - np.eye(A.shape[1]), axis=(1, 2)) <= tolerance * condition)


@pytest.mark.parametrize("n", [1, 2, 6, slow(3), slow(12), slow(24)])
def test_any_matrices(n):
    A = some(40, n)
    ours = found(A)
    assert_eigen(A, *ours)
    for k, matrix in enumerate(A):
        assert farthest(ours[0][k], np.linalg.eigvals(matrix)) < 1e-12 * np.linalg.norm(matrix)


@functools.cache
def odd_matrices():
    """By name, those that QR steps, or what is made of them, could stumble over; 6 x 6."""
    rng = np.random.default_rng(5)
    A, n = some(1, 6, seed=5)[0], 6
    Q, _ = np.linalg.qr(A)
    unit = 10.0 ** rng.uniform(-8, 8, n)
    return {
        "zero": np.zeros((n, n)),
        "one": np.eye(n),
        "a diagonal": np.diag([3, 1, 3, 0, -2, 1j]),
        "upper triangle": np.triu(A),
        "lower triangle": np.tril(A),
        "a cycle": np.roll(np.eye(n), 1, axis=0),  # its shift is zero, and a step leaves it as it is
        "two cycles": scipy.linalg.block_diag(np.roll(np.eye(3), 1, axis=0), np.roll(np.eye(3), 1, axis=0)),
        "unitary": Q,
        "Hermitian": A + A.conj().T,
        "three equal eigenvalues": Q @ np.diag([1, 1, 1, 2, 2, 5]) @ Q.conj().T,
        "rank 1": np.outer(A[0], A[1]),
        "real, pairs of eigenvalues": A.real,
        "channels of other units": unit[:, None] * A / unit,
        "graded": A * 10.0 ** -np.arange(n)[:, None] * 10.0 ** -np.arange(n),
        "tiny": 1e-200 * A,
        "huge": 1e140 * A,
        "blocks": scipy.linalg.block_diag(A[:2, :2], A[2:4, 2:4], A[4:, 4:]),
        "nearly a diagonal": np.diag(np.arange(n)) + 1e-9 * A,
        "a companion": scipy.linalg.companion(np.poly(np.arange(1, n + 1))),
    }


def test_odd_matrices():
    """Side by side: what one of them takes is no other's harm."""
    names, A = list(odd_matrices()), np.array(list(odd_matrices().values()), complex)
    values, V, V_inverse = found(A)
    for k, name in enumerate(names):
        size = np.linalg.norm(A[k])
        scaled = A[k] / size if size else A[k]
        one = (values[k] / size if size else values[k], V[k], V_inverse[k])
        if name == "channels of other units":  # its norm is that of the largest unit
            assert farthest(values[k], np.linalg.eigvals(some(1, 6, seed=5)[0])) < 1e-12
            continue
        assert_eigen(scaled[None], *(x[None] for x in one))
        known = scipy.linalg.eigvals(scaled)
        rounded = 1e-6 if name == "a companion" else 1e-12  # Wilkinson's: as LAPACK's
        assert farthest(one[0], known) < rounded, name


def test_parallel_eigenvectors_are_told():
    """A Jordan block has one eigenvector; its neighbours have theirs."""
    A = some(3, 6)
    A[1] = 2 * np.eye(6) + np.eye(6, k=1)
    values, V, V_inverse = found(A)
    np.testing.assert_allclose(values[1], 2.0, rtol=1e-2)
    assert np.linalg.norm(V[1]) * np.linalg.norm(V_inverse[1]) > 1e8
    assert_eigen(A[::2], values[::2], V[::2], V_inverse[::2])


@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize("n", [2, 6])
def test_small_eigenvalues_of_very_different_channels(n, down):
    """D A D with D over eight decades: as exact as those of the inverse, which are large there."""
    D = 10.0 ** np.linspace(0, -8, n)[:: 1 if down else -1]
    A = np.eye(n) + 0.1 * some(20, n)
    values = found(D[:, None] * A * D)[0]
    inverse = np.linalg.inv(A) / D[:, None] / D
    for ours, matrix in zip(values, inverse, strict=True):
        smallest = np.abs(ours).min()
        largest = np.abs(np.linalg.eigvals(matrix)).max()
        assert smallest * largest == pytest.approx(1.0, rel=1e-11)


def test_equal_eigenvalues_of_nothing():
    """Of rank 1, and Hermitian: eigenvectors there are, or it is said that there are none."""
    values, V, V_inverse = found(np.stack([np.ones((6, 6)), np.eye(6, k=1)]))
    np.testing.assert_allclose(np.sort(np.abs(values[0])), [0, 0, 0, 0, 0, 6], atol=1e-14)
    with np.errstate(over="ignore"):
        assert not np.linalg.norm(V[1]) * np.linalg.norm(V_inverse[1]) <= 1e8


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_no_numbers_are_of_one_line_alone(number):
    A = some(9, 4)
    A[4, 1, 2] = number
    ours = found(A)
    assert all(np.isnan(x[4]).all() for x in ours)
    good = np.arange(9) != 4
    assert_eigen(A[good], *(x[good] for x in ours))
