"""The matrix exponential against SciPy's, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from marks import slow

from jaxfrf.frf.matrix_functions import LARGEST_NORM, eigen_on_host, exponentials, matrix_functions


@jax.jit
def exponential(A):
    """Of one matrix."""
    result, norm = exponentials(jnp.asarray(A)[None])
    return result[0], norm[0]


def some(size, seed=0, n=6):
    rng = np.random.default_rng(seed)
    return size * (rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.05, 1.0, 40.0])
def test_exponential(size):
    A = some(size)
    ours, norm = exponential(A)
    theirs = scipy.linalg.expm(A)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())
    assert norm <= 2.0 * np.linalg.norm(A) and norm < LARGEST_NORM


@pytest.mark.parametrize("size", [1e-9, 1.0, 40.0])
def test_units_of_channels_do_not_matter(size):
    """Angles in rad and forces in kN: similar matrices have similar exponentials."""
    A, unit = some(size), np.array([1e-5, 1.0, 1e4, 3e2, 1e-3, 7.0])
    ours, norm = exponential(A * (unit[:, None] / unit))
    np.testing.assert_allclose(ours * (unit / unit[:, None]), exponential(A)[0], rtol=1e-11, atol=1e-13 * np.exp(size))
    assert norm < 4.0 * np.linalg.norm(A)


def test_a_mean_eigenvalue_is_no_norm():
    """A large gain is a factor of the whole."""
    ours, norm = exponential(50.0 * np.eye(3) + some(0.1, n=3))
    assert norm < 1.0
    np.testing.assert_allclose(ours, np.exp(50.0) * scipy.linalg.expm(some(0.1, n=3)), rtol=1e-12)


def test_parallel_eigenvectors():
    """A Jordan block has no eigenvectors to go by: e^(l I + N) = e^l (1 + N + N^2/2)."""
    N = np.diag([1.0, 1.0], 1)
    ours, _ = exponential(2.0 * np.eye(3) + N + 0j)
    np.testing.assert_allclose(ours, np.exp(2.0) * (np.eye(3) + N + N @ N / 2), rtol=1e-14)


def test_derivatives():
    """Along a direction, and those of a real function of it, against SciPy's differences."""
    A, B, step = some(0.5), some(1.0, seed=1), 1e-6
    along = (scipy.linalg.expm(A + step * B) - scipy.linalg.expm(A - step * B)) / (2 * step)
    ours = jax.jit(lambda a, b: jax.jvp(lambda a: exponential(a)[0], (a,), (b,))[1])(A, B)
    np.testing.assert_allclose(ours, along, atol=1e-8 * np.abs(along).max())
    slope = jax.jit(jax.grad(lambda x: jnp.sum(jnp.abs(exponential(A + x * B)[0]) ** 2)))(0.0)
    assert slope == pytest.approx(2.0 * np.sum(np.real(scipy.linalg.expm(A).conj() * along)), rel=1e-7)


@pytest.mark.parametrize("n", [1, 4, slow(25)])  # the largest by LAPACK
def test_functions_of_eigenvalues(n):
    """Several at once, of which a program is told which, against SciPy's logarithm and root."""
    A = np.stack([scipy.linalg.expm(some(0.3 / np.sqrt(n), seed, n)) for seed in range(3)])
    functions = (lambda x: jnp.stack([jnp.log(x), jnp.sqrt(x)]), lambda x: jnp.stack([1 / x, x]))
    each = jax.jit(lambda A, which: matrix_functions(functions, A, which))
    (logs, roots), values, condition = each(A, 0)
    (inverses, same), *_ = each(A, 1)
    for k, one in enumerate(A):
        np.testing.assert_allclose(logs[k], scipy.linalg.logm(one), atol=1e-12)
        np.testing.assert_allclose(roots[k], scipy.linalg.sqrtm(one), atol=1e-12)
        np.testing.assert_allclose(inverses[k], np.linalg.inv(one), atol=1e-12)
        np.testing.assert_allclose(same[k], one, atol=1e-13)
        _, V = np.linalg.eig(one)
        assert condition[k] == pytest.approx(np.linalg.norm(V) * np.linalg.norm(np.linalg.inv(V)), rel=1e-9)
        assert np.prod(values[k]) == pytest.approx(np.linalg.det(one), rel=1e-10)


def test_eigenvalues_by_the_processor():
    """What a GPU asks for, in a program and over two batches: A V = V diag(lambda); NaN where there is none."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((2, 5, 4, 4)) + 1j * rng.standard_normal((2, 5, 4, 4))
    A[1, 2, 0, 3] = np.nan
    values, V = map(np.asarray, jax.jit(jax.vmap(jax.vmap(eigen_on_host)))(A))
    lost = np.zeros((2, 5), bool)
    lost[1, 2] = True
    assert np.isnan(V[lost]).all() and np.isnan(values[lost]).all()
    np.testing.assert_allclose(A[~lost] @ V[~lost], V[~lost] * values[~lost][:, None], atol=1e-12)
