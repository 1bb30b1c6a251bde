"""What people log: several files, units, structs of other programs, tables without headings, MDF, Parquet."""

import datetime as dt
import re

import numpy as np
import pytest
import scipy.io

import jaxfrf as jf
from jaxfrf.io._container import load
from jaxfrf.io.blocks import data_set
from jaxfrf.units import differentiated, known_unit, response_unit

RNG = np.random.default_rng(0)
T = np.arange(80) * 1e-3
U = np.tile(RNG.standard_normal(20), 4)
Y = np.roll(U, 2)
PERIOD = {"period": 20}


def table(path, heading, *columns):
    rows = [",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([*([heading] if heading else []), *rows]))
    return path


def test_one_record_in_several_files(tmp_path):
    u, y = table(tmp_path / "u.csv", "t,a,b", T, U, 2 * U), table(tmp_path / "y.csv", "t,a", T, Y)
    data = jf.io.read(u, y, names={"u": "u.csv:[a;b]", "y": "y.csv:a"}, values={**PERIOD, "y_quantity": "position"})
    np.testing.assert_array_equal(data.u[0, 0], np.stack([U, 2 * U], axis=1))
    np.testing.assert_array_equal(data.y[0, 0, :, 0], Y)
    assert data.fs == 1000.0 and [s.name for s in data.sources] == ["u.csv", "y.csv"]
    with pytest.raises(jf.InputError, match=r"found 'a'; expected FILE:NAME with one of u\.csv, y\.csv"):
        jf.io.read(u, y, names={"u": "u.csv:a", "y": "a"})
    late = table(tmp_path / "y.csv", "t,a", T + 0.002, Y)
    with pytest.raises(jf.InputError, match="one time for all files"):
        jf.io.read(u, late, names={"u": "u.csv:a", "y": "y.csv:a"})


@pytest.mark.parametrize("shape", [(2, 80), (3, 2, 80), (2, 1, 2, 80)])
def test_axes_that_are_swapped(tmp_path, shape):
    """The map that is proposed swaps what has to be swapped, of any number of axes."""
    x = np.random.default_rng(1).standard_normal((2, *shape))
    file = tmp_path / "a.npz"
    what = {"values": {**PERIOD, "fs": 1000.0, "y_quantity": "velocity"}, "anyway": True}
    np.savez(file, v=x[0], y=x[1])
    with pytest.raises(jf.InputError, match=re.escape("""Transpose them: --map "u=v',y=y'".""")):
        jf.io.read(file, names={"u": "v"}, **what)
    data = jf.io.read(file, names={"u": "v'", "y": "y'"}, **what)
    np.testing.assert_array_equal(data.u, x[0].swapaxes(-1, -2).reshape(data.u.shape))
    np.savez(file, v=x[0], y=x[1].swapaxes(-1, -2))
    with pytest.raises(jf.InputError, match=re.escape("""Transpose it: --map "u=v'".""")):
        jf.io.read(file, names={"u": "v"}, **what)
    np.savez(file, v=np.ones((80, 3, 2)), y=np.ones((80, 3, 2)))
    with pytest.raises(jf.InputError, match="Reorder the axes"):
        jf.io.read(file, names={"u": "v"}, **what)


def test_files_that_could_be_one_record(tmp_path):
    """Where each holds a part of what a record needs, the map that joins them is told; not where one is whole."""
    u, y = table(tmp_path / "a.csv", "t,tau1,tau2", T, U, U), table(tmp_path / "b.csv", "t,speed", T, Y)
    both = table(tmp_path / "c.csv", "tau,speed", U, Y)
    told = re.escape('--map "u=a.csv:[tau1;tau2],y=b.csv:speed" joins these files.')
    for files in ((u, y), (y, u)):
        for read in (jf.io.read, data_set):
            with pytest.raises(jf.InputError, match=told):
                read(*files)
    for files in ((both, y), (u, y, both), (u, u)):
        with pytest.raises(jf.InputError, match="no such variable") as error:
            jf.io.read(*files)
        assert "joins" not in str(error.value)


@pytest.mark.parametrize("names", [("time", "Zeit"), ("Time [s]", "timestamp"), ("t", "time [ms]"), ("time", "t")])
def test_files_of_one_record_by_clocks_that_differ(tmp_path, names):
    a, b = names
    other = 1e3 if "ms" in b else 1.0
    u = table(tmp_path / "u.csv", f"{a},tau", T, U)
    what = {"names": {"u": "u.csv:tau", "y": "y.csv:w"}, "values": {**PERIOD, "fs": 1000.0, "y_quantity": "velocity"}}
    y = table(tmp_path / "y.csv", f"{b},w", T * other, Y)
    assert jf.io.read(u, y, **what).n_time == len(T)
    for time, says in (
        (2 * T, "steps of 0.002 s, which are 0.001 s by"),
        (T * 1.01, "steps of 0.00101 s, which are"),
        (T + 0.3, "a beginning at 0.3 s, which is 0 s by"),
        (T[:-10], f"{len(T) - 10} samples, which are {len(T)}"),
        (T + 0.0006 * (T > 0.03) * (T < 0.06), "times that are others"),
    ):
        y = table(tmp_path / "y.csv", f"{b},w", time * other, Y[: len(time)])
        with pytest.raises(jf.InputError, match=re.escape(says)):
            jf.io.read(u, y, **what)
        if len(time) == len(T) and "t" not in names:
            assert jf.io.read(u, y, anyway=True, **what).n_time == len(T)


@pytest.mark.parametrize("heading", ["time [ms],M [mNm],n [rpm]", "time,M,n\nms,mNm,rpm"])
def test_units_are_converted(tmp_path, heading):
    path = table(tmp_path / "a.csv", heading, 1e3 * T, 1e3 * U, Y * 30 / np.pi)
    data = jf.io.read(path, names={"t": "time", "u": "M", "y": "n"}, values=PERIOD)
    np.testing.assert_allclose(data.u[0, 0, :, 0], U, rtol=1e-12)
    np.testing.assert_allclose(data.y[0, 0, :, 0], Y, rtol=1e-12)
    assert data.fs == 1000.0 and data.y_quantity == "velocity" and (data.u_unit, data.y_unit) == ("", "")
    scaled = jf.io.read(path, names={"t": "time", "u": "M", "y": "n"}, values=PERIOD, factor={"u": 1.0})
    np.testing.assert_allclose(scaled.u[0, 0, :, 0], 1e3 * U, rtol=1e-12)


_FULL = {"u1": "Torque-1 (Nm)", "u2": "Torque-2 (mNm)", "y": "MotAng A1 [°]", "r": "Axis 1 RefVel [deg/s]"}


@pytest.mark.parametrize("several", [False, True], ids=["one file", "files of one record"])
@pytest.mark.parametrize("pick", ["", "[0]"])
def test_units_of_headings_as_they_are_written(tmp_path, several, pick):
    """With the unit in the name, alone and stacked, of u, y and r, with and without picks of channels."""
    path = table(tmp_path / "a.csv", ",".join(["t [s]", *_FULL.values()]), T, U, 1e3 * U, np.rad2deg(Y), np.rad2deg(Y))
    clock = table(tmp_path / "t.csv", "t", T)
    files, at = ((path, clock), "a.csv:") if several else ((path,), "")
    name = {key: f"{at}{heading}{pick}" for key, heading in _FULL.items()}
    alone = {"u": name["u2"], "y": name["y"], "r": name["r"]}
    stacked = {"u": name["u2"], "y": f"[{name['y']};{name['y']}]", "r": f"[ {name['r']} ; {name['r']} ]"}
    for names in (alone, stacked):
        data = jf.io.read(*files, names=names, values=PERIOD)
        np.testing.assert_allclose(data.u[0, 0, :, 0], U, rtol=1e-12)
        for x in (data.y, data.r):
            np.testing.assert_allclose(x[0, 0], np.tile(Y[:, None], x.shape[-1]), rtol=1e-12)
        assert (data.y_quantity, data.r_quantity) == ("position", "velocity")
        assert sum("converted to" in text for text in data.warnings) == 3
    both = {"u": f"[{name['u1']};{name['u2']}]", "y": name["y"]}
    data = jf.io.read(*files, names=both, values=PERIOD)
    np.testing.assert_allclose(data.u[0, 0], np.tile(U[:, None], 2), rtol=1e-12)
    assert data.u_unit == "" and any("converted to N m" in text for text in data.warnings)  # the usual one


def test_units_go_with_the_data(tmp_path):
    path = table(tmp_path / "a.csv", "t,u,y\ns,N,mm", T, U, 1e3 * Y)
    data = jf.io.read(path, values=PERIOD)
    assert (data.y_quantity, data.u_unit, data.y_unit) == ("position", "N", "m")
    spectra = jf.with_output_quantity(jf.dft(data), "acceleration")
    frf = jf.estimate(spectra, jf.H1())
    assert response_unit(frf) == "(m/s^2)/N"
    for name in ("a.nc", "a.npz"):
        jf.io.write_frf(tmp_path / name, frf)
        assert response_unit(jf.io.read_frf(tmp_path / name)) == "(m/s^2)/N"
        jf.io.write(tmp_path / name, data)
        assert jf.io.read(tmp_path / name).y_unit == "m" or name == "a.npz"
    figure, _ = jf.plot.bode(frf)
    assert any("(m/s^2)/N" in text.get_text() for text in figure.texts)
    asked = jf.io.read(path, values={**PERIOD, "u_unit": "kN"})
    np.testing.assert_allclose(asked.u[0, 0, :, 0], 1e3 * U)


def test_known_units():
    assert known_unit("[N m]") == ("N m", 1.0) and known_unit("Deg/s")[0] == "rad/s" and known_unit("furlong") is None
    assert differentiated("m", 2) == "m/s^2" and differentiated("V", 1) == "V/s" and differentiated("V", -1) == "V s"
    assert differentiated("rad", -5) == "rad s^5"


def test_a_quantity_that_nobody_states(tmp_path):
    data = jf.io.read(table(tmp_path / "a.csv", "t,u,y", T, U, Y), values=PERIOD)
    assert any("does not say what y is" in text for text in data.warnings)


def test_columns_are_counted_from_one(tmp_path):
    path = table(tmp_path / "a.csv", None, T, U, Y)
    data = jf.io.read(path, names={"t": "1", "u": "2", "y": "2:3"}, values=PERIOD)
    np.testing.assert_array_equal(data.y[0, 0], np.stack([U, Y], axis=1))
    for names in ({"t": "1", "u": "0", "y": "2"}, {"t": "1", "u": "0:2", "y": "2"}):
        with pytest.raises(jf.InputError, match="counted from 1"):
            jf.io.read(path, names=names)


def test_columns_of_one_of_several_files(tmp_path):
    u, y = table(tmp_path / "u.csv", None, T, U, Y, U), table(tmp_path / "y.csv", None, T, Y)
    asked = {**PERIOD, "y_quantity": "velocity", "fs": 1000.0}
    data = jf.io.read(u, y, names={"u": "u.csv:2:3", "y": "y.csv:2"}, values=asked)
    np.testing.assert_array_equal(data.u[0, 0], np.stack([U, Y], axis=1))
    data = jf.io.read(u, y, names={"u": "u.csv:[2:3;4]", "y": "y.csv:2:2"}, values=asked)
    np.testing.assert_array_equal(data.u[0, 0], np.stack([U, Y, U], axis=1))
    for wrong in ("0:2", "3:2", "2:5"):
        with pytest.raises(jf.InputError, match=f"columns {wrong}; expected a part of 1:4, the last included"):
            jf.io.read(u, y, names={"u": f"u.csv:{wrong}", "y": "y.csv:2"}, values=asked)


def test_structs_of_dspace(tmp_path):
    rows = np.zeros((1, 2), dtype=[("Name", object), ("Data", object)])
    rows[0, 0], rows[0, 1] = ("Model Root/torque", U[None]), ("Model Root/speed", Y[None])
    scipy.io.savemat(tmp_path / "a.mat", {"rec": {"X": {"Data": T[None]}, "Y": rows}})
    for y in ("rec.Y.speed", "rec.Y(2).Data"):
        names = {"t": "rec.X.Data", "u": "rec.Y.torque", "y": y}
        np.testing.assert_array_equal(jf.io.read(tmp_path / "a.mat", names=names, values=PERIOD).y[0, 0, :, 0], Y)


def test_time_series_of_simulink(tmp_path):
    """A vector signal is logged as (channel, 1, time)."""
    scipy.io.savemat(tmp_path / "a.mat", {"ts": {"Time": T[:, None], "Data": np.stack([U, Y])[:, None]}})
    data = jf.io.read(tmp_path / "a.mat", names={"t": "ts.Time", "u": "ts.Data[0]", "y": "ts.Data[1]"}, values=PERIOD)
    np.testing.assert_array_equal(data.y[0, 0, :, 0], Y)


def test_tables_of_labview(tmp_path):
    head = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t2\t\t\n"
    head += "Samples\t80\t80\t\n***End_of_Header***\t\t\t\nX_Value\tM\tn\tComment\n"
    rows = [f"{t!r}\t{u!r}\t{y!r}\t" for t, u, y in zip(T.tolist(), U.tolist(), Y.tolist(), strict=True)]
    (tmp_path / "a.lvm").write_text(head + "\n".join(rows))
    data = jf.io.read(tmp_path / "a.lvm", names={"t": "X_Value", "u": "M", "y": "n"}, values=PERIOD)
    np.testing.assert_array_equal(data.y[0, 0, :, 0], Y)


def test_parquet(tmp_path):
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    units = {"t": "s", "u": "N", "y": "g"}
    schema = pa.schema([pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in units.items()])
    parquet.write_table(pa.table([T, U, Y], schema=schema), tmp_path / "a.parquet")
    data = jf.io.read(tmp_path / "a.parquet", values=PERIOD)
    assert (data.y_quantity, data.u_unit, data.y_unit) == ("acceleration", "N", "m/s^2")
    np.testing.assert_allclose(data.y[0, 0, :, 0], 9.80665 * Y)


def test_mdf(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    signals = [asammdf.Signal(x, T, name=n, unit=w) for n, x, w in (("M", 1e3 * U, "mNm"), ("n", Y, "rad/s"))]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.save(tmp_path / "a.mf4")
    data = jf.io.read(tmp_path / "a.mf4", names={"u": "M", "y": "n"}, values=PERIOD)
    np.testing.assert_allclose(data.u[0, 0, :, 0], U, rtol=1e-12)
    assert abs(data.fs - 1000) < 1e-6


def _comma(x):
    return f"{x:.6f}".replace(".", ",")


@pytest.mark.parametrize("separator", [",", ";", "\t", " ; "])
@pytest.mark.parametrize("written", [repr, _comma, "{:,.6f}".format], ids=["points", "commas", "thousands"])
@pytest.mark.parametrize("first", ["", "sep=;\n"])
def test_numbers_in_quotes(tmp_path, separator, written, first):
    path = tmp_path / "a.csv"
    if "," in written(1000.5) and separator != " ; " and first:
        first = ""
    columns = [T, 3000.0 * U, Y]
    rows = [separator.join(f'"{written(float(x))}"' for x in row) for row in zip(*columns, strict=True)]
    path.write_text(first + "\n".join([separator.join(['"t"', '"torque, motor"', '"y"']), *rows]))
    data = jf.io.read(path, names={"u": "torque, motor"}, values=PERIOD)
    np.testing.assert_allclose(data.u[0, 0, :, 0], 3000 * U, atol=1e-6)
    np.testing.assert_allclose(data.y[0, 0, :, 0], Y, atol=1e-6)


@pytest.mark.parametrize("heading", ["t,1,2", '"t","1","2"', "t;1;2", "t\t1\t2", '"0","1","2"', 't,"1",2'])
def test_headings_of_which_some_are_numbers(tmp_path, heading):
    path = table(tmp_path / "a.csv", heading, T, U, Y)
    names = {"t": "0" if "0" in heading else "t", "u": "1", "y": "2"}
    data = jf.io.read(path, names=names, values=PERIOD)
    assert data.n_time == len(T)
    np.testing.assert_array_equal(data.u[0, 0, :, 0], U)


def test_a_broken_first_row_is_no_heading(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,u,y\nOVL,1,2\n" + "\n".join(f"{a},{b},{c}" for a, b, c in zip(T, U, Y, strict=True)))
    with pytest.raises(jf.InputError, match="line 2, column 1: found 'OVL'"):
        jf.io.read(path, values=PERIOD)


def rows(*columns, separator=",", point="."):
    """Lines of a table whose columns are numbers or texts."""
    written = ([x if isinstance(x, str) else repr(x).replace(".", point) for x in column] for column in columns)
    return "\n".join(separator.join(row) for row in zip(*written, strict=True)) + "\n"


_TIMES = [f"2026-03-01T23:59:{58 + t:02.0f}" for t in T]  # of a clock that is coarser than the sampling
_EMPTY, _HOLE = [""] * len(T), [1.5 if i != 7 else "" for i in range(len(T))]
_BESIDE = {
    "dates": _TIMES,
    "times": [x[11:] for x in _TIMES],
    "states": ["OK"] * len(T),
    "words and numbers": ["Phase 1", "2.5"] * (len(T) // 2),
    "empty": _EMPTY,
    "a hole": _HOLE,
    "one comment": ["", *_EMPTY[2:], '"start, slowly; then on"'],
}


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("beside", _BESIDE)
@pytest.mark.parametrize(("separator", "point"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")])
@pytest.mark.parametrize("before", ["", "Recorder, version 2\n\n"])
def test_columns_that_are_no_numbers(tmp_path, before, separator, point, beside, place):
    """They may hold anything, and who asks for one is told where it is no number."""
    path = tmp_path / "a.csv"
    names, columns = ["tau", "w"], [U.tolist(), Y.tolist()]
    names.insert(place, "Other")
    columns.insert(place, _BESIDE[beside])
    path.write_text(f"{before}{separator.join(names)}\n{rows(*columns, separator=separator, point=point)}")
    asked = {"values": {**PERIOD, "fs": 1000.0, "y_quantity": "velocity"}}
    data = jf.io.read(path, names={"u": "tau", "y": "w"}, **asked)
    np.testing.assert_array_equal(data.u[0, 0, :, 0], U)
    np.testing.assert_array_equal(data.y[0, 0, :, 0], Y)
    line = 2 + 2 * bool(before) + (7 if beside == "a hole" else 0)
    cell = "''" if beside in ("a hole", "one comment") else repr(_BESIDE[beside][0])
    for key in ("u", "y", "t", "q"):
        with pytest.raises(jf.InputError, match=re.escape(f"line {line}, column {place + 1}: found {cell}; expected")):
            jf.io.read(path, names={"u": "tau", "y": "w", key: "Other"}, **asked)
    with pytest.raises(jf.InputError, match=rf"The file has .*w \(80,\), Other \(no number in line {line}\)"):
        jf.io.read(path, **asked)


def test_no_column_is_chosen_that_is_no_numbers(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "Torque state,Time,torque,Speed note,speed\n" + rows(["OK"] * 80, _TIMES, U.tolist(), _HOLE, Y.tolist())
    )
    with pytest.raises(jf.InputError, match='--map "u=torque,y=speed"'):
        jf.io.read(path)


_MIDNIGHT = dt.datetime(2026, 3, 1, 23, 59, 59, 960000)


@pytest.mark.parametrize(
    "form",
    [
        "%Y-%m-%dT%H:%M:%S.%fZ",
        "%Y-%m-%dT%H:%M:%S.%f+01:00",
        "%Y-%m-%d %H:%M:%S.%f",
        "%d.%m.%Y %H:%M:%S.%f",
        "%m/%d/%Y %I:%M:%S.%f %p",
        "%H:%M:%S.%f",
        "%H:%M:%S,%f",
    ],
)
@pytest.mark.parametrize("separator", [";", "\t"])
def test_times_of_day_past_midnight(tmp_path, form, separator):
    path = tmp_path / "a.csv"
    times = [(_MIDNIGHT + dt.timedelta(seconds=t)).strftime(form) for t in T]
    path.write_text(
        separator.join(["Clock [hh:mm:ss]", "u", "y"]) + "\n" + rows(times, U.tolist(), Y.tolist(), separator=separator)
    )
    data = jf.io.read(path, names={"t": "Clock"}, values=PERIOD)
    assert data.fs == 1000.0
    np.testing.assert_array_equal(data.u[0, 0, :, 0], U)
    assert jf.io.read(path, values={**PERIOD, "fs": 1000.0}).fs == 1000.0
    with pytest.raises(jf.InputError, match="500 Hz against 1000 Hz by the time vector"):
        jf.io.read(path, names={"t": "Clock"}, values={**PERIOD, "fs": 500.0})


@pytest.mark.parametrize(
    "times", [["12:00:00.001"] * 80, ["12:00:00.5", "later", "12:00:01.5", "12:00:02.5"] * 20, ["25:61:00"] * 80]
)
def test_what_is_no_clock(tmp_path, times):
    path = tmp_path / "a.csv"
    path.write_text("Clock,u,y\n" + rows(times, U.tolist(), Y.tolist()))
    assert jf.io.read(path, values={**PERIOD, "fs": 1000.0}).fs == 1000.0
    with pytest.raises(jf.InputError, match="column 1: found"):
        jf.io.read(path, names={"t": "Clock"}, values=PERIOD)


def test_a_time_of_day_is_needed_where_no_rate_is_said(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,u,y\n" + rows(_TIMES, U.tolist(), Y.tolist()))
    assert jf.io.read(path, values={**PERIOD, "fs": 1000.0}).fs == 1000.0
    for what in ({"values": PERIOD}, {"values": {**PERIOD, "fs": 1000.0}, "names": {"t": "t"}}):
        with pytest.raises(jf.InputError, match=r"line 2, column 1: found '2026.*Write seconds, or .* --set fs=RATE\."):
            jf.io.read(path, **what)


@pytest.mark.parametrize(
    ("separator", "cell", "advice"),
    [
        (";", "-47.131,98", "Remove the thousands separators."),
        (";", "1,234.5", "Remove the thousands separators."),
        ("\t", "1.234.567", "Remove the thousands separators."),
        (";", "1'234.5", "Remove the thousands separators."),
        (";", "1 234,5", "Remove the thousands separators."),
        (";", "12:00:01", "Write seconds, or leave that column out and say the rate: --set fs=RATE."),
        (";", "1,5 V", "Fill or cut that line, or name a column of numbers."),
        (",", "OVL", "Fill or cut that line, or name a column of numbers."),
        (",", "5 2", "Fill or cut that line; write decimal points, or separate columns by semicolons."),
    ],
)
def test_what_to_do_about_a_cell(tmp_path, separator, cell, advice):
    path = tmp_path / "a.csv"
    point = "." if separator == "," else ","
    columns = T.tolist(), [*U[:-1].tolist(), cell], Y.tolist()
    path.write_text(separator.join("tuy") + "\n" + rows(*columns, separator=separator, point=point))
    with pytest.raises(jf.InputError) as error:
        jf.io.read(path, values=PERIOD)
    assert f"line 81, column 2: found {cell!r}; expected a number" in str(error.value)
    assert str(error.value).endswith(f". {advice}")


@pytest.mark.parametrize("at", ["first", "last"])
@pytest.mark.parametrize("first", [T.tolist(), _TIMES], ids=["numbers", "dates"])
def test_a_line_with_a_name_of_its_own_is_no_sample(tmp_path, first, at):
    """`Sensitivity` below the headings, `Maximum` below the table: they are no words of a column that is not needed."""
    path = tmp_path / "a.csv"
    table = rows(first, U.tolist(), Y.tolist())
    text = f"time,u,y\nSensitivity,10.2,9.8\n{table}" if at == "first" else f"time,u,y\n{table}Maximum,10.2,9.8\n"
    path.write_text(text)
    line, word = (2, "Sensitivity") if at == "first" else (82, "Maximum")
    with pytest.raises(jf.InputError, match=f"line {line}, column 1: found '{word}'"):
        jf.io.read(path, values={**PERIOD, "fs": 1000.0})


def test_empty_columns_of_spreadsheets(tmp_path):
    """Separators behind the last column end the lines where no heading names what they separate."""
    path = tmp_path / "a.csv"
    for ends in (",", ",,", ",,,,"):
        path.write_text(f"t,u,y{ends}\n" + rows(T.tolist(), U.tolist(), [f"{y!r}{ends}" for y in Y.tolist()]))
        np.testing.assert_array_equal(jf.io.read(path, values=PERIOD).y[0, 0, :, 0], Y)


def test_a_column_of_one_of_several_files_that_is_no_numbers(tmp_path):
    u, y = tmp_path / "u.csv", table(tmp_path / "y.csv", "t,w", T, Y)
    u.write_text("t,tau,state\n" + rows(T.tolist(), U.tolist(), ["OK"] * 80))
    names = {"u": "u.csv:tau", "y": "y.csv:w"}
    np.testing.assert_array_equal(jf.io.read(u, y, names=names, values=PERIOD).u[0, 0, :, 0], U)
    with pytest.raises(jf.InputError, match=r"u\.csv: line 2, column 3: found 'OK'"):
        jf.io.read(u, y, names={**names, "u": "u.csv:[tau;state]"}, values=PERIOD)


def test_a_large_table_with_a_text_in_every_line(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,u,y,state\n" + 200_000 * "0.001,1.5,-2.25,OK\n")
    np.testing.assert_array_equal(load(path)["y"], np.full(200_000, -2.25))
