"""Units: what files say of them, in every format, and what is refused."""

import dataclasses

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.units import known_unit


@pytest.mark.parametrize("suffix", ["nc", "mat", "npz"])
def test_units_go_with_a_record(tmp_path, suffix):
    data = dataclasses.replace(jf.example(), u_unit="N", y_unit="m/s", y_quantity="velocity")
    jf.io.write(tmp_path / f"run.{suffix}", data)
    again = jf.io.read(tmp_path / f"run.{suffix}")
    assert (again.u_unit, again.y_unit, again.y_quantity) == ("N", "m/s", "velocity")
    np.testing.assert_array_equal(again.y, data.y)


def test_units_that_a_file_states_beside_its_arrays(tmp_path):
    data = jf.example()
    more = {"u_unit": "N", "y_unit": "mm", "y_quantity": "position"}
    np.savez(tmp_path / "run.npz", u=data.u, y=data.y, r=data.r, fs=data.fs, period=data.period, **more)
    found = jf.io.read(tmp_path / "run.npz")
    assert (found.u_unit, found.y_unit) == ("N", "m") and any("converted to m" in text for text in found.warnings)
    np.testing.assert_allclose(found.y, 1e-3 * np.asarray(data.y))


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("MN", ("N", 1e6)),
        ("mN", ("N", 1e-3)),
        ("[MNm]", ("N m", 1e6)),
        ("mNm", ("N m", 1e-3)),
        ("MN m", ("N m", 1e6)),
        ("n m", ("N m", 1.0)),
        ("MV", ("V", 1e6)),
        ("N m", ("N m", 1.0)),
        ("NM", ("N m", 1.0)),
        ("nm", None),
    ],
)
def test_case_tells_mega_from_milli(text, unit):
    """Newton metres and nanometres are not guessed at."""
    assert known_unit(text) == unit


_INCH, _FOOT, _GRAVITY = 0.0254, 12 * 0.0254, 9.80665  # by definition


@pytest.mark.parametrize(
    ("text", "unit", "factor"),
    [
        ("lbf", "N", 0.45359237 * _GRAVITY),
        *((x, "m", _INCH) for x in ("in", "[in]", "(in)")),
        ("ft", "m", _FOOT),
        *(("in/s", "m/s", _INCH), ("ft/s", "m/s", _FOOT)),
        *((x, "m/s^2", _INCH) for x in ("in/s^2", "in/s²", "in/s2", "[IN/S^2]")),
        *((x, "m/s^2", _FOOT) for x in ("ft/s^2", "ft/s²", "ft/s2", "(ft / s^2)")),
        *(("g", "m/s^2", _GRAVITY), ("mg", "m/s^2", _GRAVITY / 1000)),
    ],
)
def test_units_of_inches_feet_pounds_and_g(text, unit, factor):
    """`mg` is a thousandth of g, the acceleration, and no milligram: no masses are read."""
    found = known_unit(text)
    assert found is not None and found[0] == unit
    assert found[1] == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("text", ["Mg", "MG", "IN", "In", "FT", "inf", "min/s", "lb", "1/in"])
def test_what_is_no_inch_foot_or_thousandth_of_g(text):
    """A megagram, an input, a sensor of force and torque."""
    assert known_unit(text) is None


def test_min_is_a_minute():
    assert known_unit("min") == ("s", 60.0)


@pytest.mark.parametrize("heading", ["t [s],F [lbf],a [ft/s²],x [in]", "t,F,a,x\ns,lbf,ft/s²,in"])
def test_imperial_units_of_headings(tmp_path, heading):
    t, x = np.arange(400) / 100.0, np.random.default_rng(0).standard_normal((400, 3))
    lines = [",".join(map(repr, row)) for row in np.column_stack([t, x]).tolist()]
    (tmp_path / "run.csv").write_text("\n".join([heading, *lines]), encoding="utf-8")
    for column, factor, unit in (("a", _FOOT, "m/s^2"), ("x", _INCH, "m")):
        data = jf.io.read(tmp_path / "run.csv", names={"t": "t", "u": "F", "y": column})
        np.testing.assert_allclose(data.u[0, 0, :, 0], 4.4482216152605 * x[:, 0], rtol=1e-14)
        np.testing.assert_allclose(data.y[0, 0, :, 0], factor * x[:, 1 + (column == "x")], rtol=1e-14)
        assert data.u_unit == "N" and data.y_quantity == {"m": "position", "m/s^2": "acceleration"}[unit]


def test_in_beside_out_is_no_inch(tmp_path):
    table = np.random.default_rng(0).standard_normal((400, 2))
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="torque (in),speed (out)", comments="")
    data = jf.io.read(tmp_path / "run.csv", names={"u": "torque", "y": "speed"}, values={"fs": 100.0})
    np.testing.assert_allclose(data.u[0, 0, :, 0], table[:, 0], rtol=1e-15)
    assert data.u_unit == "" and not any("converted" in text for text in data.warnings)


def test_forces_of_several_units(tmp_path):
    """Each by its own; and what factors are given for keeps its unit."""
    table = np.column_stack([np.arange(400) / 100.0, np.random.default_rng(0).standard_normal((400, 3))])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t [s],a [kN],b [N],y [m/s]", comments="")
    names = {"t": "t [s]", "u": "[a [kN];b [N]]", "y": "y [m/s]"}
    for factor, expected in ({}, [1e3, 1.0]), ({"u": [2.0, 3.0]}, [2.0, 3.0]):
        data = jf.io.read(tmp_path / "run.csv", names=names, factor=factor)
        np.testing.assert_allclose(data.u[0, 0], table[:, 1:3] * expected, rtol=1e-14)
        assert data.u_unit == "N"


def test_channels_of_several_quantities_are_refused(tmp_path):
    t, rng = np.arange(400) / 100.0, np.random.default_rng(0)
    table = np.column_stack([t, rng.standard_normal((400, 3))])
    header = "t [s],u [N],a [m/s^2],v [m/s]"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="")
    with pytest.raises(jf.InputError, match=r"channels in m/s, m/s\^2; expected one quantity in all channels"):
        jf.io.read(tmp_path / "run.csv", names={"t": "t [s]", "u": "u [N]", "y": "[a [m/s^2];v [m/s]]"})


def test_rates_of_time_stamps_that_are_rounded(tmp_path):
    """6553.6 Hz, written with six decimals, from two beginnings: one rate."""
    rng = np.random.default_rng(0)
    paths = [tmp_path / f"run{i}.csv" for i in range(2)]
    for path, begin in zip(paths, (0.0, 5.1234), strict=True):
        columns = np.column_stack([begin + np.arange(4000) / 6553.6, rng.standard_normal((4000, 2))])
        np.savetxt(path, columns, delimiter=",", header="t,u,y", comments="", fmt="%.6f")
    assert jf.io.read(*paths).n_exp == 2


def response(**units):
    f = np.arange(1, 101) * 0.5
    G = 1 / (1000 - (2 * np.pi * f) ** 2 + 6j * np.pi * f)
    return jf.io.frf_from_arrays(G, f, y_quantity="position", **units)


def test_units_of_universal_files(tmp_path):
    """Forces and motions along axes stay what they are; numbers in mm are converted by dataset 164."""
    pyuff = pytest.importorskip("pyuff")
    frf = response(u_unit="N", y_unit="m")
    jf.io.write_uff(tmp_path / "si.uff", frf)
    again = jf.io.read_frf(tmp_path / "si.uff")
    assert (again.u_unit, again.y_unit) == ("N", "m")
    sets = pyuff.UFF(str(tmp_path / "si.uff")).read_sets()
    sets[0].update(units_code=5, units_description="mm", length=1000.0, force=1.0)
    for one in sets[1:]:
        one["data"] = one["data"] * 1000
    pyuff.UFF(str(tmp_path / "mm.uff")).write_sets(sets, "overwrite")
    np.testing.assert_allclose(jf.io.read_frf(tmp_path / "mm.uff").G, frf.G, rtol=1e-6)
    metres, first, second = {"type": 164, "length": 1.0, "force": 1.0}, sets[1], sets[1] | {"rsp_node": 2}
    both = jf.io.frf_from_uff([sets[0], first, metres, second]).G[0, :, :, 0]  # units hold for the sets that follow
    np.testing.assert_allclose(both, frf.G[0, :, 0] * [1.0, 1000.0], rtol=1e-6)
    jf.io.write_uff(tmp_path / "joint.uff", response())
    assert jf.io.read_frf(tmp_path / "joint.uff").y_unit == ""
    sets[1]["orddenom_spec_data_type"] = 12
    with pytest.raises(jf.InputError, match="transmissibility"):
        jf.io.frf_from_uff(sets)


def test_angles_beside_lengths_are_of_one_quantity(tmp_path):
    """A robot with a joint that slides; and a channel whose unit nobody states."""
    table = np.column_stack([np.arange(400) / 100.0, np.random.default_rng(0).standard_normal((400, 4))])
    header = "t [s],u [N],a [rad/s],b [m/s],c"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="")
    for y in ("[a [rad/s];b [m/s]]", "[a [rad/s];c]"):
        assert jf.io.read(tmp_path / "run.csv", names={"t": "t [s]", "u": "u [N]", "y": y}).n_out == 2
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t [s],u [N],a [rad],b [m],c", comments="")
    data = jf.io.read(tmp_path / "run.csv", names={"t": "t [s]", "u": "u [N]", "y": "[a [rad];b [m]]"})
    assert data.y_quantity == "position"
