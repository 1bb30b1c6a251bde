"""Experiment files: every format there and back against another reader, names, units, every wrong file."""

import hashlib
import pathlib
import pickle
import re

import h5py
import numpy as np
import pymatreader
import pytest
import scipy.io
import xarray
from hypothesis import HealthCheck, given, settings, strategies as st

import jaxfrf as jf
from jaxfrf.io import _matlab
from jaxfrf.io.record_arguments import parse_factor, parse_map, parse_values
from jaxfrf.io.records import read, write

FS, PERIOD = 500.0, 50
FORMATS = ("nc", "mat", "npz")


def signals(n_time=200, n_in=2, n_out=2, seed=0, lead=()):
    """u and y, periodic with a little noise: (*lead, time, channel)."""
    rng = np.random.default_rng(seed)
    t = np.arange(n_time)[:, None] / FS
    u = sum(np.sin(2 * np.pi * k * FS / PERIOD * t + rng.uniform(0, 6, (*lead, 1, n_in))) for k in (1, 3, 5))
    y = u @ rng.standard_normal((n_in, n_out))
    return u, y + 1e-3 * rng.standard_normal(y.shape)


def experiment(n_pos=2, n_exp=3, n_in=2, n_out=2, n_ref=2, n_periods=4, **fields):
    u, y = signals(n_periods * PERIOD, n_in, n_out, lead=(n_pos, n_exp))
    r = np.random.default_rng(1).standard_normal((n_pos, n_exp, n_periods * PERIOD, n_ref)) if n_ref else None
    q = np.linspace(-1, 1, 3 * n_pos).reshape(n_pos, 3)
    fields = {"lines": [1, 3, 5], "transient_periods": 1, "y_quantity": "acceleration"} | fields
    return jf.Experiment(u, y, FS, PERIOD, r=r, q=q, **fields)


def assert_same(a, b):
    for name in ("u", "y", "r", "q", "lines"):
        x, z = getattr(a, name), getattr(b, name)
        assert (x is None) == (z is None), name
        if x is not None:
            np.testing.assert_array_equal(np.asarray(x), np.asarray(z), err_msg=name)
    for name in ("fs", "period", "transient_periods", "r_quantity", "y_quantity"):
        assert getattr(a, name) == getattr(b, name), name


def message(*paths, **options):
    """The text of the InputError, which names the first file and has the shape of every error here."""
    with pytest.raises(jf.InputError) as caught:
        read(*paths, **options)
    text = str(caught.value)
    assert re.search(r"found .+; expected .+\. \S.+", text, re.DOTALL), text
    assert text.startswith(str(paths[-1])), text
    return text


def saved(path, **variables):
    """A file with these variables, by another writer than ours."""
    path = pathlib.Path(path)
    if path.suffix == ".npz":
        np.savez(path, **variables)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, variables)
    else:
        arrays = {k: v for k, v in variables.items() if np.ndim(v)}
        dims = {k: [f"{k}{i}" for i in range(np.ndim(v))] for k, v in arrays.items()}
        dataset = xarray.Dataset({k: (dims[k], v) for k, v in arrays.items()})
        dataset.attrs = {k: v for k, v in variables.items() if not np.ndim(v)}
        dataset.to_netcdf(path, engine="h5netcdf")
    return path


# --- there and back


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    extension=st.sampled_from(FORMATS),
    shape=st.fixed_dictionaries(
        {
            "n_pos": st.integers(1, 3),
            "n_exp": st.integers(1, 3),
            "n_in": st.integers(1, 3),
            "n_out": st.integers(1, 4),
            "n_ref": st.integers(0, 3),
            "n_periods": st.integers(2, 4),
        }
    ),
    quantity=st.sampled_from(["position", "velocity", "acceleration"]),
)
def test_there_and_back(tmp_path, extension, shape, quantity):
    data = experiment(**shape, y_quantity=quantity, r_quantity=quantity)
    write(tmp_path / f"a.{extension}", data)
    assert_same(read(tmp_path / f"a.{extension}"), data)


@pytest.mark.parametrize("extension", FORMATS)
def test_absent_fields_stay_absent(tmp_path, extension):
    u, y = signals()
    write(tmp_path / f"a.{extension}", jf.Experiment(u, y, FS))
    back = read(tmp_path / f"a.{extension}")
    assert back.r is None and back.q is None and back.lines is None
    assert (back.period, back.transient_periods, back.y_quantity) == (0, 0, "velocity")


def test_netcdf_names_dimensions_and_units(tmp_path):
    data = experiment(n_in=2, n_out=4, n_ref=2)
    write(tmp_path / "a.nc", data)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as file:
        assert file["u"].dims == ("position", "experiment", "time", "input")
        assert file["y"].dims == ("position", "experiment", "time", "output")
        assert file["q"].dims == ("position", "joint") and file["lines"].dims == ("line",)
        assert file["y"].attrs["units"] == "rad/s^2"
        assert (file.attrs["fs"], file.attrs["period"], file.attrs["y_quantity"]) == (
            FS,
            PERIOD,
            "acceleration",
        )
        np.testing.assert_array_equal(file["y"].values, data.y)


def test_matlab_v5_as_scipy_reads_it(tmp_path):
    data = experiment()
    write(tmp_path / "a.mat", data)
    found = scipy.io.loadmat(tmp_path / "a.mat")
    np.testing.assert_array_equal(found["u"], data.u)
    assert found["fs"].shape == (1, 1) and found["period"].dtype == float and found["y_quantity"] == ["acceleration"]


def test_matlab_v73_as_pymatreader_and_h5py_read_it(tmp_path, monkeypatch):
    monkeypatch.setattr(_matlab, "_V5_BYTES", 100)  # so that v5 is too small for it
    data = experiment()
    write(tmp_path / "a.mat", data)
    assert (tmp_path / "a.mat").read_bytes()[:10] == b"MATLAB 7.3"
    assert (tmp_path / "a.mat").read_bytes()[124:128] == b"\x00\x02IM"
    found = pymatreader.read_mat(tmp_path / "a.mat")
    np.testing.assert_array_equal(found["u"], data.u)
    assert found["fs"] == FS and found["y_quantity"] == "acceleration"
    with h5py.File(tmp_path / "a.mat") as file:
        assert file["u"].shape == data.u.shape[::-1]  # column by column, as MATLAB stores
        assert file["y_quantity"].attrs["MATLAB_class"] == b"char"
    assert_same(read(tmp_path / "a.mat"), data)


def test_npz_without_pickle(tmp_path):
    data = experiment()
    write(tmp_path / "a.npz", data)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as found:
        np.testing.assert_array_equal(found["r"], data.r)
        assert found["fs"] == FS and found["r_quantity"] == "velocity"


@pytest.mark.parametrize("extension", FORMATS)
def test_a_failed_write_leaves_what_was_there(tmp_path, extension, monkeypatch):
    path = tmp_path / f"a.{extension}"
    path.write_bytes(b"precious")
    for module, name in ((xarray.Dataset, "dump_to_store"), (scipy.io, "savemat"), (np, "savez")):

        def break_off(*_, **__):
            raise OSError("disk full")

        monkeypatch.setattr(module, name, break_off)
    with pytest.raises(OSError, match="disk full"):
        write(path, experiment())
    assert path.read_bytes() == b"precious"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(("name", "says"), [("a.h5", r"'\.h5'"), ("a.csv", r"\.csv"), ("no/a.nc", "no folder")])
def test_wrong_place_to_write(tmp_path, name, says):
    with pytest.raises(jf.InputError, match=says):
        write(tmp_path / name, experiment())
    assert not list(tmp_path.iterdir())


# --- layouts that mean the same


@pytest.mark.parametrize("extension", FORMATS)
@pytest.mark.parametrize("layout", ["(N,)", "(N, 1)", "(1, N)"])
def test_vectors_either_way_are_one_channel(tmp_path, extension, layout):
    u, y = signals(n_in=1, n_out=1)
    turned = {"(N,)": np.ravel, "(N, 1)": np.asarray, "(1, N)": np.transpose}[layout]
    data = read(saved(tmp_path / f"a.{extension}", u=turned(u), y=turned(y), fs=FS))
    np.testing.assert_array_equal(data.u[0, 0], u)
    np.testing.assert_array_equal(data.y[0, 0], y)


@pytest.mark.parametrize("extension", FORMATS)
def test_fewer_dimensions(tmp_path, extension):
    u, y = signals(lead=(3,))
    data = read(saved(tmp_path / f"a.{extension}", u=u, y=y, fs=FS))
    assert data.u.shape == (1, 3, 200, 2)
    np.testing.assert_array_equal(data.y[0], y)


def test_matlab_drops_trailing_axes(tmp_path):
    """(position, experiment, time, 1) comes back from MATLAB as (position, experiment, time)."""
    u, y = signals(n_in=1, n_out=1, lead=(2, 3))
    data = read(saved(tmp_path / "a.mat", u=u[..., 0], y=y[..., 0], fs=FS, q=np.zeros((2, 6)), y_quantity="velocity"))
    np.testing.assert_array_equal(data.u, u)
    assert not data.warnings
    unsure = read(saved(tmp_path / "a.mat", u=u[..., 0], y=y[..., 0], fs=FS, y_quantity="velocity"))
    np.testing.assert_array_equal(unsure.u, u)
    assert "(2, 3, 200) was taken as (position, experiment, time) of one channel" in unsure.warnings[0]


def test_netcdf_axes_are_told_by_name(tmp_path):
    u, y = signals(lead=(3,))
    dataset = xarray.Dataset(
        {
            "u": (("time", "input", "position"), np.moveaxis(u, 0, -1)),
            "y": (("output", "position", "time"), np.moveaxis(y, -1, 0)),
            "fs": ((), FS),
        }
    )
    dataset.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    data = read(tmp_path / "a.nc")
    np.testing.assert_array_equal(data.u, u[:, None])
    np.testing.assert_array_equal(data.y, y[:, None])


def test_netcdf_times_in_seconds_stay_numbers(tmp_path):
    u, y = signals()
    dataset = xarray.Dataset({"u": (("time", "input"), u), "y": (("time", "output"), y)})
    dataset["t"] = (("time",), np.arange(len(u)) / FS, {"units": "s"})
    dataset.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    assert read(tmp_path / "a.nc").fs == FS


def v73(path, reverse=True, **variables):
    """A v7.3 file as MATLAB writes it (or, without the attribute, plain HDF5 under the name .mat)."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            group, _, leaf = name.rpartition("__")
            parent = file.require_group(group) if group else file
            if isinstance(value, str):
                stored, kind = np.array([[ord(c)] for c in value], np.uint16), "char"
            else:
                stored, kind = np.atleast_2d(np.asarray(value, float)), "double"
                stored = stored.T if reverse else stored
            parent[leaf] = stored
            if reverse:
                parent[leaf].attrs["MATLAB_class"] = np.bytes_(kind)
            if group:
                parent.attrs["MATLAB_class"] = np.bytes_("struct")
    return path


def test_matlab_v73_axes_and_structs(tmp_path):
    u, y = signals(lead=(3,))
    path = v73(tmp_path / "a.mat", u=u, rec__vel=y, fs=FS, y_quantity="position")
    data = read(path, names={"y": "rec.vel"})
    np.testing.assert_array_equal(data.u[0], u)
    np.testing.assert_array_equal(data.y[0], y)
    assert data.y_quantity == "position"


def test_plain_hdf5_named_mat_is_taken_as_it_is(tmp_path):
    u, y = signals(lead=(3,))
    data = read(v73(tmp_path / "a.mat", reverse=False, u=u, y=y, fs=FS))
    np.testing.assert_array_equal(data.u[0], u)


def test_matlab_v73_cells_and_objects_do_not_disturb(tmp_path):
    u, y = signals()
    path = v73(tmp_path / "a.mat", u=u, y=y, fs=FS)
    with h5py.File(path, "r+") as file:
        refs = file.create_group("#refs#")
        refs["a"] = [1.0]
        file.create_dataset("c", data=np.array([[refs["a"].ref]], dtype=h5py.ref_dtype))
        file["c"].attrs["MATLAB_class"] = np.bytes_("cell")
    assert read(path).n_time == len(u)
    assert "MATLAB cell array" in message(path, names={"u": "c"})
    assert "y_quantity (c): found a MATLAB cell" in (text := message(path, names={"y_quantity": "c"}))
    assert "single quotes" in text


def test_matlab_v5_cells_and_struct_arrays_do_not_disturb(tmp_path):
    u, y = signals()
    cell = np.array([u, "text"], dtype=object)
    several = np.zeros((2, 1), dtype=[("x", object)])
    path = saved(tmp_path / "a.mat", rec={"tau": u, "deep": {"vel": y}}, c=cell, s=several, fs=FS)
    data = read(path, names={"u": "rec.tau", "y": "rec.deep.vel"})
    np.testing.assert_array_equal(data.y[0, 0], y)
    assert "cell array" in message(path, names={"u": "c", "y": "rec.tau"})
    assert "struct array" in message(path, names={"u": "s", "y": "rec.tau"})


# --- tables

TABLES = {
    "commas, headings": (",", "t,u,y", "."),
    "semicolons, decimal commas": (";", "t;u;y", ","),
    "tabs": ("\t", "t\tu\ty", "."),
    "blanks": (" ", "t u y", "."),
    "savetxt": (",", "# t,u,y", "."),
    "comment before headings": (",", "# log of today\nt,u,y", "."),
    "none": (",", None, "."),
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables(tmp_path, kind):
    separator, heading, point = TABLES[kind]
    u, y = signals(n_in=1, n_out=1)
    table = np.hstack([np.arange(len(u))[:, None] / FS, u, y])
    lines = [separator.join(repr(float(x)).replace(".", point) for x in row) for row in table]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(([heading] if heading else []) + lines) + "\n")
    data = read(path, names=None if heading else parse_map("t=1,u=2,y=3"))
    np.testing.assert_array_equal(data.u[0, 0], u)
    np.testing.assert_array_equal(data.y[0, 0], y)
    assert data.fs == FS


def test_headings_with_units(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text('"motor torque [Nm]","speed (°/s)"\n' + "\n".join(f"{i},{i % 3}" for i in range(9)))
    data = read(path, names=parse_map("u=motor torque [Nm],y=speed (°/s)"), values={"fs": 10})
    np.testing.assert_array_equal(data.u.ravel(), np.arange(9))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("u,y\n1,2\n3\n", [r"line 3", r"1 columns", r"2 as in"]),
        ("u,y\n1,2\n3,4,5\n", [r"line 3", r"3 columns"]),
        ("u,y\n1,2\n3,lost\n", [r"line 3, column 2", "'lost'", "a number"]),
        ("u,y\n1,2\nNm,rad\n3,4\n", [r"line 3, column 1", "'Nm'", "one line of headings"]),
        ("u,y\n1,\n3,4\n", [r"line 2, column 2", "''"]),
        ("u,y,z\n1,2\n3,4\n", ["headings", "3 names over 2 columns"]),
        ("u,u\n1,2\n3,4\n", ["headings", "'u' more than once"]),
        ("u,y\n", ["headings without numbers"]),
        ("\n\n", ["no lines of numbers"]),
        ("1,2\n3,4\n5,6\n", ["u: found no such variable", r'--map "u=1,y=2"', r"1 \(3,\)"]),
        ("u,y\n1,2\n3,nan\n5,6\n", ["y: found 1 NaN or Inf", "sample 1"]),
    ],
)
def test_wrong_tables(tmp_path, text, says):
    path = tmp_path / "a.csv"
    path.write_text(text)
    found = message(path, values={"fs": 10})
    for pattern in says:
        assert re.search(pattern, found), (pattern, found)


# --- names, values, factors


def test_stacked_picked_and_transposed_channels(tmp_path):
    u, y = signals(n_in=3)
    path = saved(tmp_path / "a.npz", a=u[:, 0], b=u[None, :, 1], c=u[:, 2:], log=np.hstack([u, y]).T, fs=FS)
    data = read(path, names=parse_map("u=[a;b;c],y=log'[3:5],r=[log'[1];a]"))
    np.testing.assert_array_equal(data.u[0, 0], u)
    np.testing.assert_array_equal(data.y[0, 0], y)
    np.testing.assert_array_equal(data.r[0, 0], u[:, [1, 0]])


def test_scale_for_all_or_for_each_channel(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.npz", u=u, y=y, q=np.array([[90.0, 45.0]]), fs=FS)
    data = read(path, factor=parse_factor("u=2,y=[1;-0.5],q=0.0174532925199433"))
    np.testing.assert_allclose(data.u[0, 0], 2 * u)
    np.testing.assert_allclose(data.y[0, 0], y * [1, -0.5])
    np.testing.assert_allclose(data.q, [[np.pi / 2, np.pi / 4]])
    assert "3 factors in --factor for 2 channels" in message(path, factor={"y": (1, 2, 3)})


def test_what_is_set_goes_before_the_file(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.npz", u=u, y=y, fs=FS, period=7, y_quantity="position")
    data = read(path, values=parse_values("period=50,fs=250,lines=1:6:2,q=0;1,y_quantity=acceleration"))
    assert (data.period, data.fs, data.y_quantity) == (50, 250, "acceleration")
    np.testing.assert_array_equal(data.lines, [1, 3, 5])
    np.testing.assert_array_equal(data.q, [[0, 1]])


def test_samples_cuts_the_record(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.npz", u=u, y=y, fs=FS, t=np.arange(200) / FS)
    np.testing.assert_array_equal(read(path, values=parse_values("samples=20:120")).u[0, 0], u[20:120])
    np.testing.assert_array_equal(read(path, values={"samples": slice(20, None)}).y[0, 0], y[20:])
    assert "samples 20:300 of a record of 200" in message(path, values=parse_values("samples=20:300"))


def test_parsed_texts():
    assert parse_map("u=[tau1;tau2], y=rec.act_vel") == {"u": "[tau1;tau2]", "y": "rec.act_vel"}
    assert parse_values("fs=2.5e3,period=2500") == {"fs": 2500.0, "period": 2500.0}
    assert parse_values("samples=0:18720") == {"samples": slice(0, 18720)}
    np.testing.assert_array_equal(parse_values("lines=13;17;21")["lines"], [13, 17, 21])
    assert parse_factor("y=0.5,u=[1;-1]") == {"y": 0.5, "u": (1.0, -1.0)}


@pytest.mark.parametrize(
    ("parse", "text", "says"),
    [
        (parse_map, "u", r"--map: found 'u'; expected NAME=VALUE.*--map u=NAME"),
        (parse_map, "u=", r"found 'u='"),
        (parse_map, "", r"found ''"),
        (parse_map, "u=a,u=b", r"u twice"),
        (parse_map, "z=a", r"unknown name 'z'; expected one of r, u, y"),
        (parse_values, "perod=3", r"Did you mean period\?"),
        (parse_values, "fs=fast", r"--set fs: found 'fast'; expected a number"),
        (parse_values, "samples=18720", r"expected START:STOP"),
        (parse_values, "samples=0:10:2", r"expected START:STOP"),
        (parse_values, "lines=a;b", r"line numbers like 11:251"),
        (parse_factor, "y=0", r"finite factors other than zero"),
        (parse_factor, "y=deg", r"a factor like"),
    ],
)
def test_wrong_texts(parse, text, says):
    with pytest.raises(jf.InputError, match=says):
        parse(text)


# --- sampling frequency


def test_rate_from_a_time_vector(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.npz", u=u, y=y, clock=2000.0 * np.arange(200) + 1e6)
    assert read(path, names={"t": "clock"}, factor={"t": 1e-6}).fs == FS
    assert read(saved(tmp_path / "b.npz", u=u, y=y, Time=np.arange(200) / FS)).fs == FS


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"fs": 0.0}, r"fs: found 0; expected a positive number"),
        ({"fs": -500.0}, r"fs: found -500; expected a positive number"),
        ({"fs": np.nan}, r"fs: found nan"),
        ({"fs": "fast"}, r"fs: found text; expected real numbers"),
        ({"fs": np.array([1.0, 2.0])}, r"fs: found an array of shape \(.*2.*\); expected one number"),
        ({}, r"fs: found neither fs nor a time vector; expected the sampling frequency"),
        ({"clock": np.arange(200) / FS}, r"fs: found no such variable.*--map t=clock"),
        ({"fs": 1000.0, "t": np.arange(200) / FS}, r"fs: found 1000 Hz against 500 Hz.*--set fs=500"),
        ({"fs": FS, "t": np.arange(200) * 2000.0}, r"against 0\.0005 Hz.*microseconds: --factor t=1e-06"),
        (
            {"t": np.delete(np.arange(201), 90) / FS},
            r"t: found 1 sample missing in 1 place, the first behind sample 89;.*--set fs=500,samples=90:200",
        ),
        (
            {"t": np.arange(200) / FS + 0.2 / FS * np.sin(np.arange(200))},
            r"t: found time stamps up to 0\.\d+ sample intervals off a uniform grid;.*jitter",
        ),
        (
            {"t": np.floor(np.arange(200) / FS * 100 + 1e-9) / 100},
            r"t: found time stamps in steps of 0\.01 s, which is coarser than the samples;.*--set fs=500",
        ),
        ({"t": np.arange(199) / FS}, r"t: found shape .*one time stamp for each of the 200 samples"),
        ({"t": np.zeros(200)}, r"t: found times from 0 to 0; expected finite, increasing"),
        (
            {"fs": FS, "period": 50, "lines": [1, 30]},
            r"lines: found 1 to 30; expected lines between 1 and 24",
        ),
    ],
)
def test_wrong_rate(tmp_path, fields, says):
    u, y = signals()
    assert re.search(says, message(saved(tmp_path / "a.npz", u=u, y=y, **fields)))


@pytest.mark.parametrize("t", [np.zeros(200), np.zeros((200, 3)), np.arange(7.0), 4.0])
def test_another_variable_called_t(tmp_path, t):
    u, y = signals()
    assert read(saved(tmp_path / "a.npz", u=u, y=y, t=t, fs=FS)).fs == FS


def test_late_samples_are_remarked_where_the_rate_is_given(tmp_path):
    u, y = signals()
    t = np.arange(200) / FS
    t[100:110] += 0.4 / FS
    data = read(saved(tmp_path / "a.npz", u=u, y=y, t=t, fs=FS))
    assert any("0.4 sample intervals off a uniform grid" in text for text in data.warnings)


@pytest.mark.parametrize(("step", "told"), [(1.0, False), (1e3, False), (0.5, True), (0.0, False)])
def test_a_column_of_times_that_contradicts_the_rate(tmp_path, step, told):
    """In s or ms it is the interval; half of it is another rate; a counter that stands still says nothing."""
    u, y = signals()
    path = tmp_path / "a.csv"
    table = np.column_stack([np.arange(200) * step / FS, np.ravel(u)[:200], np.ravel(y)[:200]])
    path.write_text("Zeit;u;y\n" + "\n".join(";".join(f"{v:.9g}" for v in row) for row in table))
    warnings = read(path, values={"fs": FS}).warnings
    assert any("Zeit goes in steps of 0.001: one of them is wrong" in text for text in warnings) == told


# --- wrong files


@pytest.mark.parametrize("extension", [*FORMATS, "csv"])
def test_empty_missing_and_folder(tmp_path, extension):
    path = tmp_path / f"a.{extension}"
    assert "found no such file" in message(path)
    path.touch()
    assert "an empty file (0 bytes)" in message(path)
    path.unlink()
    path.mkdir()
    assert "found a folder" in message(path)


@pytest.mark.parametrize("extension", [*FORMATS, "v73.mat"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9, 0.99])
def test_truncated_files(tmp_path, extension, share, monkeypatch):
    if extension == "v73.mat":
        monkeypatch.setattr(_matlab, "_V5_BYTES", 100)
    whole, part = tmp_path / f"a.{extension}", tmp_path / f"b.{extension}"
    write(whole, experiment())
    content = whole.read_bytes()
    part.write_bytes(content[: int(share * len(content))])
    assert "truncated" in message(part)


@pytest.mark.parametrize("extension", FORMATS)
def test_other_content_under_a_known_extension(tmp_path, extension):
    path = tmp_path / f"a.{extension}"
    path.write_text("u,y\n1,2\n3,4\n" * 50)
    assert "wrong extension" in message(path)


@pytest.mark.parametrize("name", ["a.h5", "a.xyz", "a", "a.npy"])
def test_unknown_extensions(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    text = message(tmp_path / name)
    assert "extension" in text and all(suffix in text for suffix in (".nc", ".zarr", ".mat", ".npz", ".csv"))


def test_pickles_stay_closed(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pathlib.Path(tmp_path / "sprung").touch, ())

    u, y = signals()
    np.savez(tmp_path / "a.npz", u=np.array([Trap()], dtype=object), y=y, fs=FS)
    assert "u: found a pickled object array; expected an array of real numbers" in message(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", u=u, y=y, fs=FS, notes=np.array([Trap()], dtype=object))
    assert read(tmp_path / "b.npz").n_in == 2
    (tmp_path / "c.npz").write_bytes(pickle.dumps({"u": Trap()}))
    assert "found a Python pickle" in message(tmp_path / "c.npz")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("extension", FORMATS)
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda u, y: {"u": u.T}, r"u: found 2 samples.*swapped.*--map \"u=u'\""),
        (lambda u, y: {"y": np.stack([y, y, y], 1)[None]}, r"y: found 3 samples.*swapped"),
        (
            lambda u, y: {"u": np.where(u == u.max(), np.nan, u)},
            r"u: found 1 NaN or Inf.*sample \d+, channel",
        ),
        (lambda u, y: {"y": np.where(y == y.max(), np.inf, y)}, r"y: found 1 NaN or Inf"),
        (lambda u, y: {"y": y[:-1]}, r"y and u: found \(1, 1, 199\) and \(1, 1, 200\)"),
        (lambda u, y: {"r": u[:150]}, r"r and u: found \(1, 1, 150\)"),
        (lambda u, y: {"period": 60}, r"period: found 200 .* repeats every 50 samples: --set period=50\.$"),
        (lambda u, y: {"period": 400}, r"period: found 200 samples, 0\.5 periods"),
        (lambda u, y: {"period": 2.5}, r"period: found 2\.5; expected a whole number"),
        (lambda u, y: {"transient_periods": 4}, r"transient_periods: found 4 of 4 periods"),
        (lambda u, y: {"lines": [3, 1]}, r"lines: found a list that is not increasing"),
        (lambda u, y: {"lines": [0.5, 1]}, r"lines: found .*whole DFT line numbers"),
        (lambda u, y: {"q": np.zeros((3, 2))}, r"q: found 3 configurations; expected one for each of the 1"),
        (lambda u, y: {"y_quantity": "speed"}, r"y_quantity: found 'speed'; expected position, velocity"),
        (lambda u, y: {"y_quantity": 2.0}, r"y_quantity: found numbers"),
        (lambda u, y: {"u": "text"}, r"u: found text; expected real numbers"),
        (lambda u, y: {"u": np.zeros((1, 1, 1, 200, 2))}, r"u: found the shape \(1, 1, 1, 200, 2\)"),
    ],
)
def test_wrong_variables(tmp_path, extension, change, says):
    u, y = signals()
    fields = {"u": u, "y": y, "fs": FS, "period": PERIOD} | change(u, y)
    found = message(saved(tmp_path / f"a.{extension}", **fields))
    assert re.search(says, found, re.DOTALL), found


@pytest.mark.parametrize("extension", ["mat", "npz"])
def test_complex_records(tmp_path, extension):
    u, y = signals()
    path = saved(tmp_path / f"a.{extension}", u=np.fft.rfft(u, axis=0), y=y, fs=FS)
    assert "u: found complex numbers; expected real numbers" in message(path)


def test_text_records(tmp_path):
    _, y = signals()
    path = saved(tmp_path / "a.npz", u=y.astype("U8"), y=y, fs=FS)
    assert "u: found text; expected real numbers" in message(path)


@pytest.mark.parametrize("extension", FORMATS)
def test_no_samples(tmp_path, extension):
    path = saved(tmp_path / f"a.{extension}", u=np.zeros((0, 2)), y=np.zeros((0, 2)), fs=FS)
    assert "u: found no samples" in message(path)


def test_messages_use_the_names_of_the_file(tmp_path):
    u, y = signals()
    y[7, 1] = np.nan
    path = saved(tmp_path / "a.mat", torque=u, rec={"speed": y}, fs=FS)
    assert "a.mat: y (rec.speed): found 1 NaN" in message(path, names={"u": "torque", "y": "rec.speed"})


def test_a_missing_variable_lists_and_proposes_what_works(tmp_path):
    u, y = signals()
    log = {"motor_speed": y.T, "motor_speed_ref": y, "n": 3.0}
    path = saved(tmp_path / "a.mat", torque_axis=u, log=log, fs=FS)
    text = message(path, names={"u": "torqe_axis", "y": "log.motor_speed'"})
    assert "u (torqe_axis): found no such variable" in text and "Did you mean --map u=torque_axis?" in text
    assert "log.motor_speed (2, 200)" in text and "log.n (one number)" in text
    proposal = re.search(r'--map "([^"]+)"', message(path))[1]
    assert proposal == "u=torque_axis,y=log.motor_speed'"
    np.testing.assert_array_equal(read(path, names=parse_map(proposal)).y[0, 0], y)


def test_what_loggers_call_their_columns(tmp_path):
    """A commanded torque is the input, time is neither; what is proposed is what a shell takes, and works."""
    u, y = signals()
    table = np.column_stack([np.arange(len(u)) / FS, u[:, 0], y[:, 0]])
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header="Time [s],Torque_cmd [Nm],Motor speed [rpm]", comments="")
    proposal = re.search(r'--map "([^"]+)"', message(path))[1]
    assert proposal == "u=Torque_cmd [Nm],y=Motor speed [rpm]"
    assert '--map "t=Time [s]"' in message(path, names=parse_map(proposal))
    assert read(path, names=parse_map(f"{proposal},t=Time [s]")).fs == FS


def test_a_sampling_interval_is_recognised(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.mat", log={"tau": u[:, 0], "spd": y[:, 0], "Ts": 1 / FS})
    text = message(path, names={"u": "log.tau", "y": "log.spd"})
    assert f"Is log.Ts the interval? --set fs={FS:g}." in text
    path = saved(tmp_path / "b.mat", log={"tau": u[:, 0], "spd": y[:, 0]})
    assert "log.tau" not in message(path, names={"u": "log.tau", "y": "log.spd"}).partition("fs:")[2]


def test_a_wrong_channel_number(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.npz", u=u, y=y, fs=FS)
    assert "no channel [2]; expected channels 0 to 1" in message(path, names={"u": "u[2]"})


def test_stacked_records_of_unequal_length(tmp_path):
    u, y = signals()
    path = saved(tmp_path / "a.npz", a=u[:, 0], b=u[:-1, 1], y=y, fs=FS)
    assert "(200, 1), (199, 1); expected as many samples" in message(path, names={"u": "[a;b]"})


# --- several files


def test_several_files_are_one_data_set(tmp_path):
    data = experiment(n_pos=1, n_exp=2)
    write(tmp_path / "a.nc", data)
    write(tmp_path / "b.mat", data)
    both = read(tmp_path / "a.nc", tmp_path / "b.mat")
    assert both.n_exp == 4
    assert [s.name for s in both.sources] == ["a.nc", "b.mat"]
    assert both.sources[1].sha256 == hashlib.sha256((tmp_path / "b.mat").read_bytes()).hexdigest()


def test_no_files():
    with pytest.raises(jf.InputError, match="Name a file"):
        read()


def test_warnings_name_the_file(tmp_path):
    u, y = signals()
    y[:, 1] = 0.25
    data = read(saved(tmp_path / "a.npz", u=u, y=y, fs=FS, y_quantity="velocity"))
    assert len(data.warnings) == 1
    assert data.warnings[0].startswith(f"{tmp_path / 'a.npz'}: y: channel 1 is constant (0.25)")


# --- real measurements

BENCH = {"names": {"u": "iq_adx", "y": "omega_max", "r": "iq_refx"}}


@pytest.mark.parametrize("kind", "AB")
def test_two_mass_bench(measured, kind):
    path = measured / "two_mass_bench" / f"MultisineType{kind}.mat"
    data = read(path, **BENCH, values=parse_values("fs=2500,period=2500,transient_periods=1,y_quantity=velocity"))
    raw = scipy.io.loadmat(path, variable_names=["omega_max"])
    np.testing.assert_array_equal(data.y[0, 0], raw["omega_max"])
    assert (data.u.shape, data.fs, data.n_periods) == ((1, 1, 50000, 1), 2500.0, 19)
    # The last sample of the record is a duplicate, and nothing else is wrong with it.
    assert len(data.warnings) == 1
    assert re.search(r"r: channel 0 .* differs in its last period .* most at sample 49999", data.warnings[0])


def test_two_mass_bench_starts_unsteady(measured):
    data = read(measured / "two_mass_bench" / "MultisineTypeA.mat", **BENCH, values={"period": 2500})
    assert any("not steady in its first used period" in text for text in data.warnings)


def test_two_mass_bench_objects_and_time(measured):
    path = measured / "two_mass_bench" / "MultisineTypeA.mat"
    assert "ms.Hampl): found a MATLAB object" in message(path, names={"u": "ms.Hampl", "y": "omega_max"})
    timed = {"u": "iq_adx", "y": "[omega_max;omega_may]", "t": "time"}
    assert "looks like microseconds: --factor t=1e-06" in message(path, names=timed)
    data = read(path, names=timed, factor=parse_factor("t=1e-6,y=[1;-1]"))
    assert data.fs == 2500.0 and data.n_out == 2


def test_objects_that_share_a_name(measured, tmp_path):
    """MATLAB strings are objects too, and SciPy keeps the last object only: y_quantity may be lost."""
    one, two = (measured / "two_mass_bench" / f"MultisineType{kind}.mat" for kind in "AB")
    (tmp_path / "a.mat").write_bytes(one.read_bytes() + two.read_bytes()[128:])  # two lists of variables
    values = {"period": 2500, "transient_periods": 1}
    remark = "set it: --set y_quantity=position"
    assert any(remark in text for text in read(tmp_path / "a.mat", **BENCH, values=values).warnings)
    said = values | {"y_quantity": "velocity"}
    assert not any(remark in text for text in read(tmp_path / "a.mat", **BENCH, values=said).warnings)
    assert not any(remark in text for text in read(one, **BENCH, values=values).warnings)


@pytest.mark.parametrize("name", ["DATA_EMPS", "DATA_EMPS_PULSES"])
def test_emps(measured, name):
    path = measured / "emps" / f"{name}.mat"
    options = {"names": parse_map("u=vir,y=qm,r=qg")}
    values = "period=6240,y_quantity=position,r_quantity=position"
    text = message(path, **options, values=parse_values(values))
    assert "24841 samples, 3.981 periods of 6240" in text
    cut = re.search(r"--set (samples=\d+:\d+)", text)[1]
    assert cut == "samples=0:18720"
    data = read(path, **options, values=parse_values(f"{values},{cut}"))
    assert (data.fs, data.n_periods, data.r_quantity) == (1000.0, 3, "position")


def test_kuka(measured):
    runs = sorted((measured / "kuka_kr300").glob("*/data.mat"))
    assert len(runs) == 3
    names = parse_map("u=rec.act_torque_abs_nm'[0:3],y=rec.act_vel_mot_deg_per_s'[0:3],t=rec.time_cont")
    data = read(*runs, names=names, factor=parse_factor("y=0.0174532925199433"))
    assert (data.u.shape, data.fs, data.period) == ((1, 3, 2501, 3), 250.0, 0)
    raw = scipy.io.loadmat(runs[2], simplify_cells=True)["rec"]["act_vel_mot_deg_per_s"]
    np.testing.assert_allclose(data.y[0, 2].T, np.deg2rad(raw[:3]), rtol=1e-14)
    swapped = {"u": "rec.act_torque_abs_nm", "y": "rec.act_vel_mot_deg_per_s"}
    turned = """--map "u=rec.act_torque_abs_nm',y=rec.act_vel_mot_deg_per_s'\""""
    assert turned in message(runs[0], names=swapped)


# --- tables as people have them

TABLE = np.column_stack([np.arange(60) / 100, np.sin(np.arange(60)), np.cos(np.arange(60)) * 1e3])


def table(separator, decimal=".", end="", start=""):
    rows = [separator.join(f"{x:.6f}".replace(".", decimal) for x in row) for row in TABLE]
    return "".join(f"{start}{row}{end}\n" for row in rows)


@pytest.mark.parametrize(
    "text",
    [
        "t,u,y\n" + table(","),
        "t,u,y,\n" + table(",", end=","),
        "t;u;y\n" + table(";", ",", end=";"),
        "t\tu\ty\n" + table("\t"),
        "t\tu\ty\n" + table("\t", ",", end="\t"),
        "t   u   y\n" + table("    ", start="  "),
        "t u y\n" + table(" ", ","),
        "t,u,y\ns,N m,rad/s\n" + table(","),
        "t;u;y\n[s];[N m];[rad/s]\n" + table(";"),
        "Test bench 4\nDate;2026-01-31\n\nt;u;y\n(s);(Nm);(rad/s)\n" + table(";", ","),
        "# t u y\n" + table("  \t "),
        "t , u , y\r\n" + table(" , ").replace("\n", "\r\n"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_dialects_of_tables(tmp_path, text, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode(encoding))
    data = jf.io.read(path)
    np.testing.assert_allclose(data.u[0, 0, :, 0], TABLE[:, 1], atol=1e-6)
    np.testing.assert_allclose(data.y[0, 0, :, 0], TABLE[:, 2], atol=1e-6)
    assert data.fs == 100.0


def test_units_that_nobody_knows_are_told(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,u [Nm],y [furlong]\n" + table(","))
    data = jf.io.read(path, values={"y_quantity": "position"})
    (remark,) = (w for w in data.warnings if "furlong" in w)
    assert "--factor y=FACTOR" in remark and data.y_unit == "furlong"
    np.testing.assert_allclose(data.y[0, 0, :, 0], TABLE[:, 2], atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "utf-16"])
def test_units_in_what_loggers_on_windows_write(tmp_path, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes(("t [µs],u [Nm],y [°/s]\n" + table(",")).encode(encoding))
    data = jf.io.read(path)
    np.testing.assert_allclose(data.y[0, 0, :, 0], np.deg2rad(TABLE[:, 2]), atol=1e-6)
    assert data.fs == pytest.approx(100.0e6)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,u,y\n" + table(",").replace("0.010000,", "0.010000,,", 1), r"line 3: found 4 columns; expected 3"),
        ("t,u,y\n" + table(",").replace("0.010000", "1_0", 1), r"line 3, column 1: found '1_0'; expected a number"),
        ("t,u,y\n0.0,1.0\n" + table(","), r"line 3: found 3 columns; expected 2"),
        ("t,u\n" + table(","), r"headings: found 2 names over 3 columns"),
        ("t,u,y\n", "headings without numbers"),
    ],
)
def test_damaged_tables(tmp_path, text, says):
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert re.search(says, message(path))
