"""Covariances in files: as the factors they are made of where that is shorter, back bit by bit, read by others, too."""

import dataclasses

import h5py
import jax
import numpy as np
import pytest
from test_responses import make_frf

import jaxfrf as jf
from jaxfrf.frf import KroneckerSum, OuterSum
from jaxfrf.frf.scaled import Scaled, Variances, Widened, scaled
from jaxfrf.io.responses import factors_of, kept_otherwise, writing_frf

SHAPES = [(2, 5, 3, 3), (1, 4, 6, 1), (1, 1, 1, 6), (2, 3, 6, 6)]


def numbers(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def kinds(shape, terms=1):
    """A covariance of every kind for a response of this shape."""
    rng, (n_pos, n_freq, n_out, n_in) = np.random.default_rng(1), shape
    per_line, vec = (n_pos, n_freq), n_out * n_in
    left, right = numbers(rng, *per_line, terms, n_in, n_in), numbers(rng, *per_line, terms, n_out, n_out)
    products = KroneckerSum(left @ left.conj().mT, right @ right.conj().mT)
    size = rng.uniform(0.5, 2.0, (*per_line, vec))
    return {
        "products": products,
        "scaled": Scaled(products, size),
        "widened": Widened(Scaled(products, size), size**2),
        "outer": OuterSum(numbers(rng, *per_line, vec, 2)),
        "variances": Variances(size),
    }


@pytest.mark.parametrize("suffix", [".nc", ".mat", ".npz", ".zarr"])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["products", "scaled", "widened", "outer", "variances"])
def test_factors_come_back(tmp_path, suffix, shape, kind):
    cov = kinds(shape)[kind]
    frf = dataclasses.replace(make_frf(shape), cov=cov, cov_noise=kinds(shape, 2)["products"], cov_total=None)
    path = tmp_path / f"frf{suffix}"
    jf.io.write_frf(path, frf)
    back = jf.io.read_frf(path)
    np.testing.assert_array_equal(np.asarray(back.cov), np.asarray(cov))
    np.testing.assert_array_equal(np.asarray(back.cov_noise), np.asarray(frf.cov_noise))
    if shape[2] * shape[3] > 8:
        assert jax.tree.structure(back.cov) == jax.tree.structure(cov)


def test_a_file_is_as_small_as_the_factors(tmp_path):
    """49 positions, 336 lines, 36 elements: 341 MB written out, here a seventh of that in lines."""
    shape = (49, 48, 6, 6)
    frf = dataclasses.replace(make_frf((1, 48, 6, 6), known=False), cov=None)
    every = {name: np.repeat(getattr(frf, name), 49, axis=0) for name in ("G", "dof", "status", "window")}
    frf = dataclasses.replace(frf, **every, cov=kinds(shape)["widened"])
    jf.io.write_frf(tmp_path / "frf.nc", frf)
    assert (tmp_path / "frf.nc").stat().st_size < 100e6 / 7


def test_others_read_it(tmp_path):
    """By h5py and NumPy alone, as the page on files says."""
    frf = dataclasses.replace(make_frf((2, 5, 4, 4)), cov=kinds((2, 5, 4, 4), 2)["widened"])
    jf.io.write_frf(tmp_path / "frf.nc", frf)
    with h5py.File(tmp_path / "frf.nc") as file:
        left, right, scale, added, std = (
            file[n][:] for n in ("cov_left", "cov_right", "cov_scale", "cov_added", "std")
        )
    cov = sum(np.kron(left[1, 2, t], right[1, 2, t]) for t in range(2))
    cov = cov * np.outer(scale[1, 2], scale[1, 2]) + np.diag(added[1, 2])
    np.testing.assert_allclose(cov, np.asarray(frf.cov)[1, 2], rtol=1e-12)
    np.testing.assert_allclose(std[1, 2].T.ravel() ** 2, np.diag(cov).real, rtol=1e-12)


def test_one_scale_behind_another_is_one():
    cov = kinds((2, 5, 3, 3))["scaled"]
    twice = scaled(cov, 2.0 * np.ones((2, 5, 9)))
    assert isinstance(twice.of, KroneckerSum)
    np.testing.assert_allclose(np.asarray(twice), 4.0 * np.asarray(cov), rtol=1e-12)


def test_positions_that_keep_other_factors_are_written_out(tmp_path):
    """As one file, position by position: what is a product here and a scatter there."""
    shape = (1, 5, 3, 3)
    parts = [dataclasses.replace(make_frf(shape), cov=kinds(shape)[kind]) for kind in ("scaled", "outer")]
    assert kept_otherwise([factors_of(part) for part in parts]) == ["cov"]
    with writing_frf(tmp_path / "frf.nc", parts[0], 2, ["cov"]) as put:
        for pos, part in enumerate(parts):
            put(pos, part)
    back = jf.io.read_frf(tmp_path / "frf.nc")
    for pos, part in enumerate(parts):
        np.testing.assert_array_equal(back.cov[pos], np.asarray(part.cov)[0])


@pytest.mark.parametrize(
    ("name", "of"), [("cov_left", (2, 5, 1, 3, 2)), ("cov_columns", (2, 4, 9, 2)), ("cov_scale", (2, 5, 8))]
)
def test_wrong_factors_are_refused(tmp_path, name, of):
    good = kinds((2, 5, 3, 3))["products"]
    names = {"G": np.ones((2, 5, 3, 3)), "frequency": np.arange(5.0)}
    if name != "cov_columns":
        names |= {"cov_left": good.left, "cov_right": good.right}
    np.savez(tmp_path / "a.npz", **(names | {name: np.ones(of)}))
    with pytest.raises(jf.InputError, match=name):
        jf.io.read_frf(tmp_path / "a.npz")
