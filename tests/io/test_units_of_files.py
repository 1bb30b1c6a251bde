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
        ("MV", ("V", 1e6)),
        ("N m", ("N m", 1.0)),
        ("NM", ("N m", 1.0)),
        ("nm", None),
    ],
)
def test_case_tells_mega_from_milli(text, unit):
    """Newton metres and nanometres are not guessed at."""
    assert known_unit(text) == unit


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
