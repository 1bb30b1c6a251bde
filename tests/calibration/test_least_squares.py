"""A step of all numbers at once, where the columns are not exact."""

import types

import numpy as np

from jaxfrf.calibration.least_squares import solve, with_another, with_column_errors
from jaxfrf.trajectory.evidence import Gram

ERROR, RUNS, ROWS = 0.01, 8, 200


def _record(rng):
    """Two columns that are the same, each seen with an error of less than a hundredth, about the noise, and the
    numbers that are true: one of which nothing is known, and one that is known to a standard deviation of 1."""
    shape, true = rng.standard_normal((RUNS, ROWS)) / ERROR, np.array([rng.normal(), rng.normal()])
    exact = np.stack([shape, shape], axis=1)
    seen = exact + 0.7 * rng.standard_normal(exact.shape)
    right = np.einsum("rjn,j->rn", exact, true) + rng.standard_normal(shape.shape)
    products = np.einsum("rjn,rkn->rjk", seen, seen)
    b = np.einsum("rjn,rn->rj", seen, right)
    return Gram(products, b, np.sum(right**2, axis=1), np.arange(RUNS), ROWS), true


def test_what_cancels_is_told_by_what_was_known_where_columns_have_errors():
    """Without, what is left of the columns, their error, passes for knowledge."""
    rng, numbers = np.random.default_rng(5), [types.SimpleNamespace(prior=p) for p in (0.0, 1.0)]
    held, naive = [], []
    for _ in range(100):
        gram, true = _record(rng)
        posterior = solve(gram, numbers, np.zeros(2))
        off = np.abs(posterior.change - true)
        naive.append(off < posterior.half_width())
        held.append(off < with_column_errors(posterior, gram, np.full(2, ERROR)).half_width())
    assert np.mean(naive) < 0.6
    assert np.mean(held) >= 0.9


def test_what_neither_the_data_nor_anybody_knows_is_told_as_that():
    """Two columns that are one but for rounding, and one that is nothing: their sum is known, each of them is not; one
    of which something was known before is known as well as that."""
    rng = np.random.default_rng(7)
    x = 1e3 * rng.standard_normal((RUNS, ROWS))
    X = np.stack([x, x * (1 + 1e-5 * rng.standard_normal(x.shape)), 0 * x, 0 * x], axis=1)
    y = 2 * x + rng.standard_normal(x.shape)
    gram = Gram(X @ X.swapaxes(1, 2), np.einsum("rjn,rn->rj", X, y), np.sum(y**2, axis=1), np.arange(RUNS), ROWS)
    posterior = solve(gram, [types.SimpleNamespace(prior=p) for p in (0.0, 0.0, 0.0, 1.0)], np.zeros(4))
    assert np.all(posterior.half_width()[:3] > 100)
    np.testing.assert_allclose(posterior.half_width()[3], 1.96, rtol=1e-3)
    both = np.array([1.0, 1.0, 0.0, 0.0])
    assert both @ posterior.covariance @ both < 1e-4
    np.testing.assert_allclose(both @ posterior.change, 2.0, atol=1e-3)


def test_columns_that_do_not_cancel_are_told_as_before():
    rng = np.random.default_rng(6)
    X, y = rng.standard_normal((RUNS, 2, ROWS)), rng.standard_normal((RUNS, ROWS))
    products, b = X @ X.swapaxes(1, 2), np.einsum("rjn,rn->rj", X, y)
    gram = Gram(products, b, np.sum(y**2, axis=1), np.arange(RUNS), ROWS)
    numbers = [types.SimpleNamespace(prior=1.0)] * 2
    posterior = solve(gram, numbers, np.zeros(2))
    widened = with_column_errors(posterior, gram, np.full(2, ERROR))
    np.testing.assert_allclose(widened.half_width(), posterior.half_width(), rtol=1e-3)


def test_another_minimum_that_is_as_likely_is_reached():
    """Its interval by this one's; where both are the same, nothing changes."""
    rng, numbers = np.random.default_rng(9), [types.SimpleNamespace(prior=1.0)] * 2

    def fitted(noise):
        X, y = rng.standard_normal((RUNS, 2, ROWS)), noise * rng.standard_normal((RUNS, ROWS))
        b = np.einsum("rjn,rn->rj", X, y)
        return solve(Gram(X @ X.swapaxes(1, 2), b, np.sum(y**2, 1), np.arange(RUNS), ROWS), numbers, np.zeros(2))

    one, other, apart = fitted(1.0), fitted(3.0), np.array([0.7, 0.0])
    both = with_another(one, apart, other).half_width()
    assert np.all(both >= np.abs(apart) + other.half_width())
    assert np.all(both <= np.abs(apart) + other.half_width() + one.half_width())
    np.testing.assert_allclose(with_another(one, np.zeros(2), one).half_width(), one.half_width())


def test_one_run_has_no_other():
    """A step from one run is that of regularised least squares; without it nothing is left, which is no error."""
    rng, prior = np.random.default_rng(7), np.where(np.arange(40) < 20, 1.0, 0.0)
    columns, right = rng.standard_normal((1, 40, 300)) * np.logspace(-3, 3, 40)[:, None], rng.standard_normal((1, 300))
    gram = Gram(
        columns @ columns.swapaxes(1, 2), np.einsum("rjn,rn->rj", columns, right), np.sum(right**2, 1), np.zeros(1), 300
    )
    posterior = solve(gram, [types.SimpleNamespace(prior=p) for p in prior], np.zeros(40))
    rows = np.concatenate([columns[0].T, np.diag(np.sqrt(prior))])
    theirs = np.linalg.lstsq(rows, np.concatenate([right[0], np.zeros(40)]), rcond=None)[0]
    np.testing.assert_allclose(posterior.change, theirs, rtol=1e-6)
    assert posterior.effect == 1.0 and posterior.by_cluster.shape == (1, 40)


def test_rounding_is_no_variance():
    """Products in single precision of columns that hardly differ, of which nothing is known: their errors take nothing
    away."""
    rng, numbers = np.random.default_rng(8), [types.SimpleNamespace(prior=0.0)] * 6
    columns = rng.standard_normal((RUNS, 1, ROWS)) + 1e-5 * rng.standard_normal((RUNS, 6, ROWS))
    right = rng.standard_normal((RUNS, ROWS))
    products = np.einsum("rjn,rkn->rjk", columns, columns).astype(np.float32).astype(float)
    b = np.einsum("rjn,rn->rj", columns, right)
    gram = Gram(products, b, np.sum(right**2, axis=1), np.arange(RUNS), ROWS)
    posterior = solve(gram, numbers, np.zeros(6))
    for errors in (np.zeros(6), np.array([0.0, 0.0, 0.0, 0.0, 0.0, ERROR])):
        assert np.all(np.diag(with_column_errors(posterior, gram, errors).beyond) >= 0.0)
