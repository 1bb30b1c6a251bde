"""Universal files, python-control and SDyPy, each read back by the other program or by hand."""

import control
import numpy as np
import pytest
import pyuff

from jaxfrf import FRF, InputError, Status
from jaxfrf.io.control import from_control, to_control
from jaxfrf.io.frf_or_record import holds_frf, read_frfs
from jaxfrf.io.responses import frf_from_arrays, read_frf, write_frf
from jaxfrf.io.sdypy import from_sdypy, from_sep005
from jaxfrf.io.uff import frf_from_uff, read_uff, write_uff


def random_frf(shape=(2, 6, 3, 2), frequency=None, y_quantity="velocity") -> FRF:
    rng = np.random.default_rng(3)
    G = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    frequency = np.sort(rng.uniform(1, 80, shape[1])) if frequency is None else frequency
    return frf_from_arrays(G, frequency, y_quantity=y_quantity, q=rng.standard_normal((shape[0], 6)), method="H1()")


# --- universal files ---

QUANTITIES = {"position": (8, "rad"), "velocity": (11, "rad/s"), "acceleration": (12, "rad/s^2")}


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_pyuff_reads_one_record_per_element_and_position(tmp_path, quantity):
    frf = random_frf(y_quantity=quantity)
    write_uff(tmp_path / "frf.unv", frf)
    units, *records = pyuff.UFF(str(tmp_path / "frf.unv")).read_sets()
    assert (units["type"], units["units_code"], units["length"], units["force"]) == (164, 1, 1.0, 1.0)
    assert len(records) == 2 * 3 * 2
    data_type, unit = QUANTITIES[quantity]
    for record in records:
        pos, out, ref = record["ver_num"] - 1, record["rsp_node"] - 1, record["ref_node"] - 1
        np.testing.assert_allclose(record["data"], frf.G[pos, :, out, ref], rtol=1e-11)
        np.testing.assert_allclose(record["x"], frf.frequency, rtol=1e-5)  # E13.5
        assert record["func_type"] == 4 and record["load_case_id"] == 0
        assert (record["ordinate_spec_data_type"], record["ordinate_axis_units_lab"]) == (data_type, unit)
        assert (record["orddenom_spec_data_type"], record["orddenom_axis_units_lab"]) == (13, "N m")
        assert (record["abscissa_spec_data_type"], record["abscissa_axis_units_lab"]) == (18, "Hz")
        assert record["id4"].startswith("q = ")
    assert len({(r["ver_num"], r["rsp_node"], r["ref_node"]) for r in records}) == 12


@pytest.mark.parametrize("regular", [True, False])
def test_grids_with_and_without_a_step(tmp_path, regular):
    frequency = 2.5 + 0.5 * np.arange(40) if regular else np.geomspace(4, 80, 40)
    frf = random_frf((1, 40, 1, 1), frequency)
    write_uff(tmp_path / "frf.uff", frf)
    back = read_uff(tmp_path / "frf.uff")
    assert pyuff.UFF(str(tmp_path / "frf.uff")).read_sets(1)["abscissa_spacing"] == int(regular)
    np.testing.assert_allclose(back.frequency, frequency, rtol=0 if regular else 1e-5)


def test_universal_files_are_read_and_written_like_every_other(tmp_path):
    """What `estimate -o frf.uff` writes, `view`, `modal` and `identify` read."""
    frf, path = random_frf((2, 40, 2, 2), 2.5 + 0.5 * np.arange(40)), tmp_path / "frf.uff"
    write_frf(path, frf)
    assert holds_frf(path)
    for back in (read_frf(path), read_frfs(path)):
        np.testing.assert_allclose(back.G, frf.G, rtol=1e-10)


def test_universal_file_comes_back_with_its_name_and_hash(tmp_path):
    import hashlib

    frf = random_frf(y_quantity="acceleration")
    write_uff(tmp_path / "frf.unv", frf)
    back = read_uff(tmp_path / "frf.unv")
    np.testing.assert_allclose(back.G, frf.G, rtol=1e-11)
    assert (back.y_quantity, back.method) == ("acceleration", "H1()")
    assert back.sources[0].sha256 == hashlib.sha256((tmp_path / "frf.unv").read_bytes()).hexdigest()
    assert (back.status == Status.NO_COVARIANCE).all()


def record(out, ref, values, **changes):
    fields = {"type": 58, "func_type": 4, "rsp_node": out, "rsp_dir": 3, "ref_node": ref, "ref_dir": 3}
    fields |= {
        "ver_num": 0,
        "ordinate_spec_data_type": 12,
        "x": np.arange(1.0, 4.0),
        "data": np.asarray(values),
    }
    return fields | changes


def test_records_of_another_program_in_any_order():
    """Roving hammer: one response, references 7 and 2; the version number merely counts the records."""
    sets = [record(5, 7, [1, 2, 3j], ver_num=1), record(5, 2, [4, 5, 6j], ver_num=2), {"type": 151}]
    frf = frf_from_uff(sets)
    np.testing.assert_array_equal(frf.G, np.array([[4, 1], [5, 2], [6j, 3j]])[None, :, None, :])


def test_universal_files_that_do_not_fit(tmp_path):
    with pytest.raises(InputError, match="no FRF"):
        frf_from_uff([{"type": 15}])
    with pytest.raises(InputError, match=r"3 FRFs: 2 responses, 2 references.*\(4 FRFs\)"):
        frf_from_uff([record(1, 1, [1, 1, 1]), record(2, 1, [1, 1, 1]), record(1, 2, [1, 1, 1])])
    with pytest.raises(InputError, match="different frequencies"):
        frf_from_uff([record(1, 1, [1, 1, 1]), record(2, 1, [1, 1, 1], x=np.arange(3.0))])
    with pytest.raises(InputError, match=r"\[11, 12\]"):
        frf_from_uff([record(1, 1, [1, 1, 1]), record(2, 1, [1, 1, 1], ordinate_spec_data_type=11)])
    with pytest.raises(InputError, match="no such file"):
        read_uff(tmp_path / "frf.unv")
    (tmp_path / "frf.unv").write_text("not a universal file\n")
    with pytest.raises(InputError, match=r"frf\.unv"):
        read_uff(tmp_path / "frf.unv")


def test_frequencies_that_the_format_cannot_hold(tmp_path):
    with pytest.raises(InputError, match="agree in 6 digits"):
        write_uff(tmp_path / "frf.unv", random_frf((1, 3, 1, 1), np.array([100.0, 100.0001, 100.0002])))
    with pytest.raises(InputError, match="one frequency"):
        write_uff(tmp_path / "frf.unv", random_frf((1, 1, 1, 1)))
    assert not list(tmp_path.iterdir())


# --- python-control ---


def state_space():
    """Two outputs, three inputs, four states, stable."""
    rng = np.random.default_rng(7)
    A = rng.standard_normal((4, 4)) - 4 * np.eye(4)
    return A, rng.standard_normal((4, 3)), rng.standard_normal((2, 4)), rng.standard_normal((2, 3))


def by_hand(A, B, C, D, points):
    return np.array([C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D for s in points])


def test_control_evaluates_the_frf_at_its_lines():
    frf = random_frf()
    frd = to_control(frf, pos=1)
    assert (frd.noutputs, frd.ninputs) == (3, 2)
    for k, f in enumerate(frf.frequency):
        np.testing.assert_array_equal(control.evalfr(frd, 2j * np.pi * f, squeeze=False), frf.G[1, k])


def test_round_trip_through_control():
    frf = random_frf((1, 6, 3, 2), y_quantity="acceleration")
    back = from_control(to_control(frf), y_quantity="acceleration")
    np.testing.assert_array_equal(back.G, frf.G)
    np.testing.assert_allclose(back.frequency, frf.frequency, rtol=1e-15)
    assert back.y_quantity == "acceleration" and np.isnan(back.cov).all()


@pytest.mark.parametrize("dt", [0, 0.01])
def test_a_state_space_model_at_given_frequencies_in_rising_order(dt):
    A, B, C, D = state_space()
    frequency = np.array([3.0, 0.5, 20.0])
    A = A / 10 if dt else A
    frf = from_control(control.ss(A, B, C, D, dt), frequency)
    frequency = np.sort(frequency)
    points = np.exp(2j * np.pi * frequency * dt) if dt else 2j * np.pi * frequency
    np.testing.assert_allclose(frf.G[0], by_hand(A, B, C, D, points), rtol=1e-12)
    np.testing.assert_array_equal(frf.frequency, frequency)


def test_a_transfer_function():
    frequency = np.array([1.0, 2.0])
    s = 2j * np.pi * frequency
    frf = from_control(control.tf([1, 2], [1, 3, 5]), frequency)
    np.testing.assert_allclose(frf.G[0, :, 0, 0], (s + 2) / (s**2 + 3 * s + 5), rtol=1e-14)


def test_what_control_cannot_give():
    with pytest.raises(InputError, match="frequency: found none"):
        from_control(control.tf([1], [1, 1]))
    with pytest.raises(InputError, match="bring their own"):
        from_control(to_control(random_frf()), [1.0])
    with pytest.raises(InputError, match="sampling time"):
        from_control(control.tf([1], [1, 1], True), [1.0])
    with pytest.raises(InputError, match="list"):
        from_control([1, 2], [1.0])
    with pytest.raises(InputError, match=r"pos: found 2.*0 to 1"):
        to_control(random_frf(), 2)


# --- SDyPy ---


def oscillator(frequency, power):
    """Receptance of a damped oscillator at 100 Hz, differentiated `power` times."""
    s = 2j * np.pi * frequency
    return s**power / (s**2 + 20 * s + (2 * np.pi * 100) ** 2)


FORMS = {"receptance": ("position", 0), "mobility": ("velocity", 1), "accelerance": ("acceleration", 2)}
GRID = np.arange(1, 1001) * 0.25


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["frf_form", "frf_type"])
def test_the_dictionary_of_ema(form, name):
    quantity, power = FORMS[form]
    G = np.stack([oscillator(GRID, power), 2 * oscillator(GRID, power)])
    frf = from_sdypy({"frf": G, "freq": GRID, name: form})
    np.testing.assert_array_equal(frf.G[0, :, :, 0], G.T)
    assert (frf.y_quantity, frf.warnings) == (quantity, ())
    assert (frf.status == Status.NO_COVARIANCE).all() and np.isnan(frf.cov).all()


def test_response_excitation_frequency_and_radians():
    G = np.arange(24.0).reshape(2, 3, 4) + 1j
    frf = from_sdypy({"frf": G, "freq_rad": 2 * np.pi * np.arange(1, 5), "frf_form": "mobility"})
    np.testing.assert_allclose(frf.frequency, np.arange(1, 5))
    assert frf.G[0, 3, 1, 2] == G[1, 2, 3]


@pytest.mark.parametrize("form", FORMS)
def test_a_conjugated_frf_is_noticed_and_can_be_turned_round(form):
    G = oscillator(GRID, FORMS[form][1])
    data = {"frf": G.conj(), "freq": GRID, "frf_form": form}
    (warning,) = from_sdypy(data).warnings
    assert "complex conjugate" in warning and "change `conjugated`" in warning
    turned = from_sdypy(data, conjugated=True)
    assert turned.warnings == ()
    np.testing.assert_array_equal(turned.G[0, :, 0, 0], G)


def test_no_alarm_without_a_direction_of_time():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(1000) + 1j * rng.standard_normal(1000)
    mass_line = np.ones(1000, complex)
    for G in (noise, mass_line):
        assert from_sdypy({"frf": G, "freq": GRID, "frf_form": "accelerance"}).warnings == ()
    irregular = np.geomspace(1, 250, 1000)
    G = oscillator(irregular, 2).conj()
    assert from_sdypy({"frf": G, "freq": irregular, "frf_form": "accelerance"}).warnings == ()


class Measured:
    """As pyFRF from 1.5 on names its arguments; up to 1.4 they were `type` and `form`."""

    exc_type = "f"

    def __init__(self, resp_type):
        self.resp_type = resp_type

    def get_f_axis(self):
        return GRID

    def get_FRF(self, frf_estimator="default", frf_form="receptance"):
        assert frf_estimator == "default"
        return oscillator(GRID, FORMS[frf_form][1])[None, None]


@pytest.mark.parametrize(("kind", "power"), [("d", 0), ("v", 1), ("a", 2)])
def test_a_pyfrf_object_is_asked_for_what_it_measured(kind, power):
    frf = from_sdypy(Measured(kind))
    np.testing.assert_array_equal(frf.G[0, :, 0, 0], oscillator(GRID, power))
    assert frf.y_quantity == ("position", "velocity", "acceleration")[power]


def test_what_sdypy_forgot():
    with pytest.raises(InputError, match=r"keys freq.*a key 'frf'"):
        from_sdypy({"freq": GRID})
    with pytest.raises(InputError, match="receptance, mobility, accelerance"):
        from_sdypy({"frf": np.ones(1000), "freq": GRID})
    with pytest.raises(InputError, match=r"shape \(1000, 2\) with 1000"):
        from_sdypy({"frf": np.ones((1000, 2)), "freq": GRID, "frf_form": "mobility"})
    with pytest.raises(InputError, match="list"):
        from_sdypy([1, 2])
    with pytest.raises(InputError, match="response 'e'"):
        from_sdypy(Measured("e"))


def channel(name, data, **fields):
    return {"name": name, "data": np.asarray(data, float), "fs": 100, "unit_str": "?"} | fields


def test_sep005_channels_become_an_experiment():
    t = np.arange(8.0)
    channels = [
        channel("hammer", t, quantity="f"),
        channel("tip", 2 * t, quantity="a"),
        channel("z", -t, quantity="a"),
    ]
    data = from_sep005(channels, period=4)
    assert (data.fs, data.period, data.y_quantity) == (100.0, 4, "acceleration")
    np.testing.assert_array_equal(data.u[0, 0], t[:, None])
    np.testing.assert_array_equal(data.y[0, 0], np.stack([2 * t, -t], -1))


def test_sep005_channels_by_name_and_with_time():
    t = np.arange(8.0)
    channels = [
        {"name": n, "data": k * t, "time": t / 50, "unit_str": "V"} for k, n in enumerate(("ref", "torque", "speed"))
    ]
    data = from_sep005(channels, u=["torque"], y=["speed"], r=["ref"], y_quantity="velocity")
    assert data.fs == pytest.approx(50)
    np.testing.assert_array_equal(data.y[0, 0, :, 0], 2 * t)
    np.testing.assert_array_equal(data.r[0, 0, :, 0], 0 * t)


def test_sep005_units_are_converted():
    """Degrees a second and kilonewtons; a unit that nobody knows is kept, and said."""
    t = np.arange(8.0)
    channels = [channel("f", t, quantity="f", unit_str="kN"), channel("v", t, unit_str="deg/s")]
    data = from_sep005(channels, u=["f"], y=["v"])
    assert (data.u_unit, data.y_unit, data.y_quantity) == ("N", "rad/s", "velocity") and len(data.warnings) == 2
    np.testing.assert_allclose(data.u[0, 0, :, 0], 1000.0 * t)
    np.testing.assert_allclose(data.y[0, 0, :, 0], np.pi / 180 * t)
    odd = from_sep005([channels[0] | {"unit_str": "furlong"}, channels[1]], u=["f"], y=["v"])
    assert odd.u_unit == "furlong" and "no unit that is known" in odd.warnings[0]
    with pytest.raises(InputError, match=r"unit_str of y: found deg/s, deg; expected one quantity"):
        from_sep005([*channels, channel("x", t, unit_str="deg")], u=["f"], y=["v", "x"])


def test_sep005_channels_that_do_not_fit():
    t = np.arange(8.0)
    force, motion = channel("f", t, quantity="f"), channel("a", t, quantity="a")
    with pytest.raises(InputError, match=r"1 inputs and 0 outputs among f"):
        from_sep005(force)
    with pytest.raises(InputError, match=r"no 'v' among f, a"):
        from_sep005([force, motion], u=["v"], y=["a"])
    with pytest.raises(InputError, match=r"\[50\.0, 100\.0\]"):
        from_sep005([force, motion | {"fs": 50}])
    with pytest.raises(InputError, match="equal length"):
        from_sep005([force, channel("a", t[:5], quantity="a"), channel("b", t, quantity="a")])
    with pytest.raises(InputError, match="irregular"):
        from_sep005([force | {"fs": None, "time": t**2}, motion | {"fs": None, "time": t**2}])
    with pytest.raises(InputError, match="unknown"):
        from_sep005([force, channel("a", t)], u=["f"], y=["a"])


def test_without_the_library_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxfrf\[control\]'"):
        to_control(random_frf())
