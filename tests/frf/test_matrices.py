"""Matrices of windows, one by one or side by side in lanes, against NumPy's, window by window."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from jaxfrf.frf import lanes
from jaxfrf.frf.lanes import Lanes
from jaxfrf.frf.matrices import Whole, each_window

N_WINDOW = 8


def matrices(rng, *shape):
    return rng.normal(size=(N_WINDOW, *shape)) + 1j * rng.normal(size=(N_WINDOW, *shape))


def positive(rng, n, rows):
    """A positive definite matrix on top of some rows, of every window."""
    X = matrices(rng, n, n)
    return np.concatenate([X @ X.conj().swapaxes(-1, -2) + np.eye(n), matrices(rng, rows, n)], axis=1)


def in_lanes(X):
    parts = jnp.moveaxis(jnp.stack([X.real, X.imag]), 1, -1)
    return Lanes(parts)


def of_both_kinds(function, *arrays, program=jax.jit):
    """What a function of matrices makes of every window: window by window, and of all of them in lanes."""

    def one_by_one(*arrays):
        return jax.tree.map(
            lambda x: x.by_window, function(*map(Whole, arrays)), is_leaf=lambda x: isinstance(x, Whole)
        )

    def together(*arrays):
        return jax.tree.map(
            lambda x: x.by_window, function(*map(in_lanes, arrays)), is_leaf=lambda x: isinstance(x, Lanes)
        )

    return program(jax.vmap(one_by_one))(*arrays), program(together)(*arrays)


@pytest.mark.parametrize("n_term", [3, 53])
def test_products(n_term):
    rng = np.random.default_rng(0)
    A, B, C = matrices(rng, 4, n_term), matrices(rng, n_term, 2), matrices(rng, 5, n_term)

    def ours(A, B, C):
        return A.times(B), A.times_adjoint(C), A.adjoint.adjoint_times(B), A[1:3, :].times(B)

    expected = (A @ B, A @ C.conj().swapaxes(1, 2), A @ B, A[:, 1:3] @ B)
    for found in of_both_kinds(ours, A, B, C):
        for ours_, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours_, theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("n, unit, rows", [(1, 1, 2), (5, 3, 4), (13, 6, 3), (15, 8, 2)])
def test_elimination(n, unit, rows):
    rng = np.random.default_rng(1)
    A, Y = positive(rng, n, rows), matrices(rng, n, 2)

    def ours(A, Y):
        found = A.eliminated(unit)
        return found.rows, found.end, found.back(Y)

    def pivots(A):
        return in_lanes(A).eliminated(unit).pivot, jax.vmap(lambda A: Whole(A).eliminated(unit).pivot)(A)

    L = np.linalg.cholesky(A[:, :n])
    solve = lambda L, X: np.array([scipy.linalg.solve_triangular(l, x, lower=True) for l, x in zip(L, X, strict=True)])
    adjoint = lambda X: X.conj().swapaxes(1, 2)
    below = adjoint(solve(L, adjoint(A[:, n:])))
    end = adjoint(np.linalg.inv(L[:, n - unit :, n - unit :]))
    for found in of_both_kinds(ours, A, Y):
        for ours_, theirs in zip(found, (below, end, np.linalg.inv(adjoint(L)) @ Y), strict=True):
            np.testing.assert_allclose(ours_, theirs, rtol=1e-10, atol=1e-11)
    expected = np.diagonal(L, axis1=1, axis2=2).real ** 2
    of_lanes, of_one = jax.jit(pivots)(A)
    np.testing.assert_allclose(of_lanes.T, expected, rtol=1e-10)
    np.testing.assert_allclose(of_one, expected, rtol=1e-10)


@pytest.mark.parametrize("n", [1, 4, 30])
def test_inverse_where_pivots_differ_from_window_to_window(n):
    rng = np.random.default_rng(2)
    A = matrices(rng, n, n)
    A[1] = np.eye(n)[rng.permutation(n)]  # which has no inverse without exchanges of rows
    A[2] *= 10.0 ** rng.uniform(-6, 6, size=(n, 1))
    A[3, -1] = A[3, 0] if n > 1 else 0.0
    A[4] = np.exp(2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n)  # elements of one size, but for rounding
    regular = np.arange(N_WINDOW) != 3
    for found in of_both_kinds(lambda A: A.inverse, A):
        expected = np.linalg.inv(A[regular])
        error = np.linalg.norm(found[regular] - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
        assert error.max() < 1e-11
        assert not (np.abs(found[3]) < 1e12).all()  # NaN, or as large as rounding makes it


def test_parts_of_a_matrix_and_what_is_made_of_them():
    rng = np.random.default_rng(3)
    A = matrices(rng, 6, 5)
    some = np.array([4, 0])

    def ours(A):
        part = A[1:5, 2:]
        return (
            part[1:, :2],
            A[some, some],
            type(A).joined([part, A[:4, :1]], -1),
            type(A).joined([part, A[:1, 2:]], -2),
            type(A).stacked([part, part + part]).at(1),
            A.reshaped(2, 3, 5).moved(-2, -3),
            (A.conjugate - A).transpose,
            A.plus_diagonal(np.arange(5.0)),
            A[:5, :].hermitian,
        )

    part, whole = A[:, 1:5, 2:], A[:, :5]
    expected = (
        part[:, 1:, :2],
        A[:, some[:, None], some],
        np.concatenate([part, A[:, :4, :1]], axis=2),
        np.concatenate([part, A[:, :1, 2:]], axis=1),
        2 * part,
        A.reshape(-1, 2, 3, 5).swapaxes(1, 2),
        (A.conj() - A).swapaxes(1, 2),
        A + np.diag(np.arange(6.0))[:, :5] * (np.arange(6) < 5)[:, None],
        (whole + whole.conj().swapaxes(1, 2)) / 2,
    )
    for found in of_both_kinds(ours, A):
        for ours_, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours_, theirs, rtol=1e-15)


def test_several_matrices_of_a_window_broadcast():
    """Every pair of three and two of them."""
    rng = np.random.default_rng(4)
    A, B = matrices(rng, 3, 4, 2), matrices(rng, 2, 5, 4)
    ours = lambda A, B: A.reshaped(3, 1, 4, 2).adjoint_times(B.reshaped(1, 2, 5, 4).adjoint)
    expected = np.einsum("kawc,kbrw->kabcr", A.conj(), B.conj())
    for found in of_both_kinds(ours, A, B):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_window_by_window():
    A = matrices(np.random.default_rng(5), 3, 3)
    trace = lambda A: A.trace()
    np.testing.assert_allclose(each_window(trace, in_lanes(A)), np.trace(A, axis1=1, axis2=2), rtol=1e-14)
    np.testing.assert_allclose(each_window(trace, Whole(A[0])), np.trace(A[0]), rtol=1e-14)


def test_products_are_compiled_apart():
    """As a call of its own; were it ignored, XLA would work products out once for every reading."""
    A = lanes.of_lines(np.ones((16, 3, 3), complex))
    text = jax.jit(lambda A: A.times(A).times(A)).lower(A).compile().as_text()
    assert sum(" call(" in line for line in text.splitlines()) == 2
