"""Matrices of groups of lines against NumPy's, line by line."""

import jax
import numpy as np
import pytest

from jaxfrf.frf import lanes


@pytest.mark.parametrize("n_line", [1, 8, 21])
@pytest.mark.parametrize("n_term", [3, 16, 37])
def test_products_are_those_of_numpy(n_line, n_term):
    rng = np.random.default_rng(0)

    def matrices(*shape):
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    A, B, C = matrices(n_line, 4, n_term), matrices(n_line, n_term, 2), matrices(n_line, 5, n_term)
    some = np.array([0, n_line - 1])

    @jax.jit
    def ours(A, B, C):
        in_lanes = [lanes.of_lines(X) for X in (A, B, C)]
        transposed = [lanes.of_lines(X.swapaxes(1, 2)) for X in (A, C)]
        products = lanes.product(*in_lanes[:2]), lanes.times_adjoint(*in_lanes[::2]), lanes.adjoint_times(*transposed)
        squares = lanes.squares(in_lanes[0]).swapaxes(1, 2).reshape(-1, 4)[:n_line]
        return [lanes.lines(X, n_line) for X in products], squares, lanes.some_lines(in_lanes[0], some)

    products, squares, of_some = ours(A, B, C)
    for found, expected in zip(products, (A @ B, A @ C.conj().mT, A.conj() @ C.mT), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(squares, np.sum(np.abs(A) ** 2, axis=2), rtol=1e-12)
    np.testing.assert_array_equal(of_some, A[some])


def test_a_signal_has_its_experiments_as_columns():
    X = np.arange(2 * 10 * 3).reshape(2, 10, 3) * (1 + 2j)
    np.testing.assert_array_equal(lanes.lines(lanes.of_signal(X), 10), X.transpose(1, 2, 0))


def test_products_are_compiled_apart():
    """As a call of its own; were it ignored, XLA would work products out once for every reading."""
    A = lanes.of_lines(np.ones((16, 3, 3), complex))
    text = jax.jit(lambda A: lanes.product(lanes.product(A, A), A)).lower(A).compile().as_text()
    assert sum(" call(" in line for line in text.splitlines()) == 2
