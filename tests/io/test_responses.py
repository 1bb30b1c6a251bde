"""FRF files: what was written comes back bit by bit, other programs read it, and wrong files are named."""

import dataclasses
import json

import h5py
import numpy as np
import pytest
import scipy.io

from jaxfrf import FRF, InputError, Source, Status
from jaxfrf.io import responses
from jaxfrf.io.responses import frf_from_arrays, read_frf, write_frf

SUFFIXES = (".nc", ".mat", ".npz")


def make_frf(shape=(2, 7, 3, 2), dtype=complex, seed=0, known=True) -> FRF:
    """Every field filled with different numbers, among them NaN, infinity and negative zero."""
    rng = np.random.default_rng(seed)
    real = np.finfo(dtype).dtype

    def numbers(*shape):
        x = np.empty(shape, dtype)
        x.real, x.imag = rng.standard_normal(shape).astype(real), rng.standard_normal(shape).astype(real)
        return x

    n_pos, n_freq, n_out, n_in = shape
    vec = n_out * n_in
    G, cov = numbers(*shape), numbers(n_pos, n_freq, vec, vec)
    G.real.flat[0], G.imag.flat[0], cov.real.flat[-1] = -0.0, np.inf, np.nan
    return FRF(
        G=G,
        frequency=np.sort(rng.uniform(1, 80, n_freq)),
        cov=cov,
        dof=rng.uniform(1, 9, (n_pos, n_freq)),
        status=rng.integers(0, 128, (n_pos, n_freq)),
        window=rng.integers(1, 40, (n_pos, n_freq)).astype(float),
        cov_noise=numbers(n_pos, n_freq, vec, vec) if known else None,
        cov_total=numbers(n_pos, n_freq, vec, vec) if known else None,
        q=rng.standard_normal((n_pos, 6)) if known else None,
        method="LRM(order=2, width=34, variable='index')" if known else "",
        y_quantity="acceleration" if known else "velocity",
        sources=(Source("Versuch ü.mat", "ab" * 32), Source('quote".nc')) if known else (),
        warnings=("channel 2: 3 % of the samples are clipped – look", "second") if known else (),
        version="0.1.0" if known else "",
    )


def assert_same_bits(a: FRF, b: FRF):
    for field in dataclasses.fields(FRF):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            assert (left.dtype, left.shape) == (right.dtype, right.shape), field.name
            assert left.tobytes() == right.tobytes(), field.name
        else:
            assert left == right, field.name


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("shape", [(2, 7, 3, 2), (1, 1, 1, 1), (1, 5, 1, 1), (3, 5, 1, 2), (1, 4, 2, 1), (5, 5, 2, 2)])
@pytest.mark.parametrize("known", [True, False])
def test_every_field_comes_back_bit_by_bit(tmp_path, suffix, shape, known):
    frf = make_frf(shape, known=known)
    write_frf(tmp_path / f"frf{suffix}", frf)
    assert_same_bits(read_frf(tmp_path / f"frf{suffix}"), frf)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_single_precision_stays_single(tmp_path, suffix):
    frf = make_frf(dtype=np.complex64)
    write_frf(tmp_path / f"frf{suffix}", frf)
    assert_same_bits(read_frf(tmp_path / f"frf{suffix}"), frf)


def test_jax_arrays_are_written_as_their_numbers(tmp_path):
    import jax.numpy as jnp

    frf = make_frf()
    write_frf(tmp_path / "frf.npz", dataclasses.replace(frf, G=jnp.asarray(frf.G), cov=jnp.asarray(frf.cov)))
    assert_same_bits(read_frf(tmp_path / "frf.npz"), frf)


# --- other programs ---


def test_plain_hdf5_reader_sees_complex_numbers_and_named_axes(tmp_path):
    frf = make_frf()
    write_frf(tmp_path / "frf.nc", frf)
    with h5py.File(tmp_path / "frf.nc") as file:
        assert file["G"].dtype == complex
        np.testing.assert_array_equal(file["G"][()], frf.G)
        np.testing.assert_array_equal(file["frequency"][()], frf.frequency)
        axes = [file["G"].dims[k][0].name for k in range(4)]
        assert axes == ["/position", "/frequency", "/output", "/input"]
        assert file["frequency"].attrs["units"] == "Hz"
        assert file["G"].attrs["units"] == "(rad/s^2)/(N m)"
        assert json.loads(file.attrs["provenance"])[0] == {"name": "Versuch ü.mat", "sha256": "ab" * 32}
        assert file.attrs["options"] == "order=2, width=34, variable='index'"
        meanings = dict(
            zip(file["status"].attrs["flag_meanings"].split(), file["status"].attrs["flag_masks"], strict=True)
        )
        assert meanings["rank_deficient"] == Status.RANK_DEFICIENT


def test_xarray_opens_the_file_without_knowing_anything_about_it(tmp_path):
    import xarray

    frf = make_frf()
    write_frf(tmp_path / "frf.nc", frf)
    with xarray.open_dataset(tmp_path / "frf.nc") as data:
        at = data["G"].isel(position=1, output=2, input=0).sel(frequency=frf.frequency[3], method="nearest")
        assert complex(at) == frf.G[1, 3, 2, 0]


def test_matlab_sees_complex_doubles_and_permute_gives_idfrd_its_order(tmp_path):
    frf = make_frf()
    write_frf(tmp_path / "frf.mat", frf)
    names = scipy.io.loadmat(tmp_path / "frf.mat")
    np.testing.assert_array_equal(names["G"], frf.G)
    assert names["frequency"].shape == (7, 1)
    for_idfrd = np.transpose(names["G"][:1], np.array([3, 4, 2, 1]) - 1)[..., 0]  # permute(G(1,:,:,:), [3 4 2 1])
    assert for_idfrd.shape == (3, 2, 7)
    assert for_idfrd[2, 1, 4] == frf.G[0, 4, 2, 1]
    assert names["method"][0] == frf.method


def test_npz_needs_no_pickle(tmp_path):
    frf = make_frf()
    write_frf(tmp_path / "frf.npz", frf)
    with np.load(tmp_path / "frf.npz", allow_pickle=False) as names:
        np.testing.assert_array_equal(names["G"], frf.G)
        assert str(names["y_quantity"]) == "acceleration"
        assert json.loads(str(names["warnings"])) == list(frf.warnings)


@pytest.mark.parametrize("shape", [(1, 5, 1, 1), (2, 5, 3, 1), (1, 5, 2, 1)])
def test_axes_that_matlab_dropped_are_put_back(tmp_path, shape):
    frf = make_frf(shape, known=False)

    def dropped(x):
        while x.ndim > 2 and x.shape[-1] == 1:
            x = x[..., 0]
        return x

    names = {"G": dropped(frf.G), "cov": dropped(frf.cov), "frequency": frf.frequency[None], "dof": frf.dof}
    scipy.io.savemat(tmp_path / "frf.mat", names)
    back = read_frf(tmp_path / "frf.mat")
    np.testing.assert_array_equal(back.G, frf.G)
    np.testing.assert_array_equal(back.cov, frf.cov)
    np.testing.assert_array_equal(back.frequency, frf.frequency)


def test_a_file_with_only_g_and_frequency_is_an_frf_without_covariance(tmp_path):
    G = np.arange(10.0).reshape(5, 2, 1) + 1j
    G[3, 1, 0] = np.nan
    np.savez(tmp_path / "frf.npz", G=G, frequency=np.arange(5.0))
    frf = read_frf(tmp_path / "frf.npz")
    assert frf.G.shape == (1, 5, 2, 1)
    assert np.isnan(frf.cov).all() and (frf.dof == 0).all()
    assert (frf.status & Status.NO_COVARIANCE).all()
    assert [bool(s & Status.NOT_FINITE) for s in frf.status[0]] == [False, False, False, True, False]


def test_bare_numbers_make_an_frf():
    frf = frf_from_arrays(np.ones(4), np.arange(4.0), y_quantity="position", method="by hand")
    assert frf.G.shape == (1, 4, 1, 1) and frf.G.dtype == complex
    assert (frf.y_quantity, frf.method, frf.q) == ("position", "by hand", None)


# --- whole or not at all ---


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"frf{suffix}"
    write_frf(path, make_frf(seed=1))
    before = path.read_bytes()

    def breaks_off(draft, names):
        draft.write_bytes(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setitem(responses._WRITERS, suffix, breaks_off)
    with pytest.raises(KeyboardInterrupt):
        write_frf(path, make_frf(seed=2))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


# --- wrong files ---


def says(path, *words):
    with pytest.raises(InputError) as error:
        read_frf(path)
    for word in (str(path), *words):
        assert word in str(error.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_and_empty_files(tmp_path, suffix):
    path = tmp_path / f"frf{suffix}"
    says(path, "no such file")
    path.touch()
    says(path, "empty file (0 bytes)")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_truncated_files(tmp_path, suffix, share):
    path = tmp_path / f"frf{suffix}"
    write_frf(path, make_frf((2, 50, 2, 2)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    says(path, "cannot be read", "truncated")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_files_of_another_format(tmp_path, suffix):
    path = tmp_path / f"frf{suffix}"
    path.write_text("frequency,magnitude\n1,2\n")
    says(path, "cannot be read")


def test_an_experiment_file_is_recognised(tmp_path):
    np.savez(tmp_path / "run.npz", u=np.ones((8, 1)), y=np.ones((8, 1)), fs=8.0)
    says(tmp_path / "run.npz", "an experiment file", "jaxfrf estimate")


def test_a_file_that_holds_something_else_says_what(tmp_path):
    scipy.io.savemat(tmp_path / "model.mat", {"A": np.eye(2), "B": np.ones((2, 1))})
    says(tmp_path / "model.mat", "it holds A, B", "at least G and frequency")


def test_unknown_suffix_and_missing_folder(tmp_path):
    with pytest.raises(InputError, match=r"'\.h5'.*\.nc, \.mat, \.npz"):
        write_frf(tmp_path / "frf.h5", make_frf())
    with pytest.raises(InputError, match="no suffix"):
        read_frf(tmp_path / "frf")
    with pytest.raises(InputError, match="no folder"):
        write_frf(tmp_path / "nowhere" / "frf.nc", make_frf())
    assert not list(tmp_path.iterdir())


FREQUENCY = np.arange(1.0, 6.0)
WRONG = {
    "order of idfrd": ({"G": np.ones((2, 3, 5))}, ("shape (2, 3, 5) with 5 frequencies", "Transpose")),
    "frequencies missing": ({"G": np.ones((1, 4, 2, 2))}, ("4, 2, 2) with 5 frequencies",)),
    "covariance of another size": (
        {"G": np.ones((5, 2, 2)), "cov": np.ones((1, 5, 2, 2))},
        ("cov", "(1, 5, 4, 4)"),
    ),
    "text": ({"G": np.array(["1+2j"] * 5)}, ("G", "<U4 data", "numbers")),
    "frequency not finite": ({"G": np.ones(5), "frequency": np.full(5, np.nan)}, ("frequency", "NaN")),
    "configurations": ({"G": np.ones(5), "q": np.ones((3, 6))}, ("q", "1 positions")),
    "quantity": ({"G": np.ones(5), "y_quantity": np.array("speed")}, ("y_quantity", "'speed'")),
    "provenance": ({"G": np.ones(5), "provenance": np.array("a.mat")}, ("provenance", "JSON")),
}


@pytest.mark.parametrize("case", WRONG)
def test_contents_that_do_not_fit(tmp_path, case):
    names, words = WRONG[case]
    np.savez(tmp_path / "frf.npz", **({"frequency": FREQUENCY} | names))
    says(tmp_path / "frf.npz", *words)


def test_a_pickle_is_not_opened(tmp_path):
    np.savez(tmp_path / "frf.npz", G=np.array([1j, None], object), frequency=FREQUENCY[:2])
    says(tmp_path / "frf.npz", "G", "pickle")
