"""Matrices of groups of lines against NumPy's, line by line."""

import jax
import numpy as np
import pytest

from jaxfrf.frf import lanes


@pytest.mark.parametrize(("n_line", "n_lane"), [(1, 8), (8, 8), (21, 8), (21, 16)])
def test_lines_in_groups(n_line, n_lane):
    rng = np.random.default_rng(0)

    def matrices(*shape):
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    A, B = matrices(n_line, 4, 3), matrices(n_line, 3, 2)
    some = np.array([0, n_line - 1])

    @jax.jit
    def ours(A, B):
        A, B = lanes.of_lines(A, n_lane), lanes.of_lines(B, n_lane)
        squares = A.power.swapaxes(1, 2).reshape(-1, 4)[:n_line]
        half = lanes.inverse_of_products(B.adjoint)
        return lanes.lines(A.times(B), n_line), squares, lanes.some_lines(A, some), lanes.lines(half, n_line)

    product, squares, of_some, inverse = ours(A, B)
    np.testing.assert_allclose(product, A @ B, rtol=1e-12)
    np.testing.assert_allclose(squares, np.sum(np.abs(A) ** 2, axis=2), rtol=1e-12)
    np.testing.assert_array_equal(of_some, A[some])
    np.testing.assert_allclose(inverse @ (B.conj().mT @ B), np.broadcast_to(np.eye(2), (n_line, 2, 2)), atol=1e-10)


@pytest.mark.parametrize(
    ("n_line", "n_element", "expected"),
    [(336, 36, 112), (512, 36, 104), (5632, 36, 112), (1, 36, 8), (40, 4, 40), (100, 576, 8)],
)
def test_how_many_lines_go_side_by_side(n_line, n_element, expected):
    """Whole registers of 8, about 4096 elements in a group, and groups of one size."""
    assert lanes.lane_count(n_line, n_element, 4096) == expected


def test_products_of_more_channels_than_lanes_are_meant_for():
    X = np.random.default_rng(1).normal(size=(2, 3, 40, 60)) * (1 + 1j)
    X = X[0] + 1j * X[1].real
    inverse = jax.jit(lambda X: lanes.lines(lanes.inverse_of_products(lanes.of_lines(X)), 3))(X)
    np.testing.assert_allclose(inverse, np.linalg.inv(X @ X.conj().mT), rtol=1e-9, atol=1e-12)


def test_a_signal_has_its_experiments_as_columns():
    X = np.arange(2 * 10 * 3).reshape(2, 10, 3) * (1 + 2j)
    np.testing.assert_array_equal(lanes.lines(lanes.of_signal(X), 10), X.transpose(1, 2, 0))
