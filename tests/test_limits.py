"""Sizes, wrong arguments and impossible machines: one message each, before memory or time is spent."""

import importlib
import os
import pathlib
import tomllib
import zipfile

import numpy as np
import pytest
import two_axes

import jaxfrf as jf
from jaxfrf import _environment
from jaxfrf.__main__ import main
from jaxfrf._memory import available_memory, check_memory
from jaxfrf.io import _container
from jaxfrf.simulation.checks import at_limits


def npy(shape):
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (64 - (len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


def test_memory():
    assert 0 < available_memory() < 2**50
    with pytest.raises(jf.InputError, match="found 1000000 TB to hold; expected at most"):
        check_memory("x", 1e18, "Cut it.")


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.parametrize("suffix", [".nc", ".npz"])
def test_records_that_are_held_whole_and_do_not_fit_are_refused_unread(tmp_path, capsys, command, suffix):
    x = np.zeros((1, 1, 250_000, 2))
    jf.io.write(tmp_path / f"run{suffix}", jf.Experiment(x, x, 500.0, r=x))
    (tmp_path / "robot.toml").write_text(two_axes.ROBOT)
    options = ["--robot", str(tmp_path / "robot.toml"), "-o", str(tmp_path / "x.json"), "--memory", "1GB"]
    assert main([command, str(tmp_path / f"run{suffix}"), *options]) == 2
    error = capsys.readouterr().err
    assert f"run{suffix}: found 12 MB of records, for which `{command}` takes some " in error, error
    assert "expected at most --memory 1 GB. Give fewer" in error and not (tmp_path / "x.json").exists()


class Glibc:
    def __init__(self, _=None):
        self.asked = []

    def mallopt(self, option, value):
        self.asked.append((option, value))
        return 1


def test_memory_goes_back_unless_the_user_says_otherwise(monkeypatch):
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    monkeypatch.delenv("MALLOC_ARENA_MAX", raising=False)
    library = Glibc()
    monkeypatch.setattr(_environment.ctypes, "CDLL", lambda name: library)
    _environment._give_memory_back()
    assert dict(library.asked)[-3] == 4 * 2**20  # M_MMAP_THRESHOLD
    monkeypatch.setenv("MALLOC_ARENA_MAX", "4")
    _environment._give_memory_back()
    assert len(library.asked) == 3
    monkeypatch.delenv("MALLOC_ARENA_MAX")
    monkeypatch.setattr(_environment.ctypes, "CDLL", lambda name: object())  # another C library
    _environment._give_memory_back()


def test_a_header_that_lies(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("u.npy", npy((10**12, 6)))
    with pytest.raises(jf.InputError, match="a header that states the shape"):
        jf.io.read(path)


def test_links_that_go_round(tmp_path, capsys):
    one, two = tmp_path / "one.nc", tmp_path / "two.nc"
    os.symlink(two, one)
    os.symlink(one, two)
    assert main(["estimate", str(one), "-o", str(tmp_path / "frf.nc")]) == 2
    assert "one.nc: found" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"blocks": 10**9}, "references of .* experiments of .*: found .* to hold"),
        ({"periods": 10**9}, "found .* to hold; expected at most"),
        ({"seed": 2**60}, "seed: found .*; expected at most"),
    ],
)
def test_designs_that_are_too_large(change, says):
    with pytest.raises(jf.InputError, match=says):
        jf.reference(jf.Multisine(1000.0, 1000, [3, 5], n_in=2, **change))


def test_numbers_of_any_length(tmp_path):
    path = tmp_path / "a.toml"
    for text, says in (("fs = 1" + "0" * 5000, "4300 digits"), ("a = " + "[" * 5000 + "]" * 5000, "too deep")):
        path.write_text(text)
        for read in (jf.io.read_design, jf.io.read_robot):
            with pytest.raises(jf.InputError, match=says):
                read(path)


LINK = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="0 0 1"/></joint>'


@pytest.mark.parametrize(
    ("joints", "says"),
    [
        ([("a", "revolute", 0, 1), ("b", "revolute", 1, 2), ("c", "revolute", 2, 1)], "two joints that carry it"),
        ([("a", "revolute", 0, 1), ("b", "revolute", 1, 2), ("c", "revolute", 2, 0)], "0 links without a parent"),
        ([("", "revolute", 0, 1), ("b", "revolute", 1, 2)], "joint 1: found no name"),
        ([("a", "revolute", 0, 1), ("a", "revolute", 1, 2)], "joint 'a': found the name twice"),
    ],
)
def test_urdf_that_is_no_tree(tmp_path, joints, says):
    text = "".join(LINK.format(i) for i in range(3)) + "".join(JOINT.format(*x) for x in joints)
    (tmp_path / "arm.urdf").write_text(f"<robot>{text}</robot>")
    (tmp_path / "arm.toml").write_text('[[joint]]\nname = "a"\n')
    with pytest.raises(jf.InputError, match=says):
        jf.io.read_robot(tmp_path / "arm.urdf")


def test_urdf_with_its_drives_beside_it(tmp_path):
    text = "".join(LINK.format(i) for i in range(3)) + JOINT.format("a", "revolute", 0, 1)
    (tmp_path / "arm.urdf").write_text(f"<robot>{text + JOINT.format('b', 'fixed', 1, 2)}</robot>")
    with pytest.raises(jf.InputError, match=r'no arm.toml beside it.*name = "a"'):
        jf.io.read_robot(tmp_path / "arm.urdf")
    (tmp_path / "arm.toml").write_text('[[joint]]\nname="a"\ngear_ratio=9.0\nmotor_inertia=1.0\nstiffness=inf\n')
    assert jf.io.read_robot(tmp_path / "arm.urdf").joint_names == ("a",)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda x, d: jf.dft(x), "data: found an array of shape .*jaxfrf.Experiment\\(u, y, fs, period\\)"),
        (lambda x, d: jf.dft("run.nc"), r"found 'run.nc'; expected .*jaxfrf.io.read\('run.nc'\)"),
        (lambda x, d: jf.features(d), "frf: found an Experiment; expected an? jaxfrf.FRF. Estimate first"),
        (lambda x, d: jf.plot.bode(d), "frfs: found an Experiment"),
        (lambda x, d: jf.estimate(d, jf.H1), r"method: found the class H1.*Call it: H1\(\)"),
        (lambda x, d: jf.simulate("r3x.toml", None, x, key=None), "read_robot"),
        (lambda x, d: jf.LPM(order=float("nan")), "order: found nan"),
        (lambda x, d: jf.Experiment([[1, 2], [3]], x, 1.0), "u: found lists of unequal length"),
        (lambda x, d: jf.Experiment(np.ma.masked_greater(x, 0.5), x, 1.0), "u: found a masked array that hides"),
        (lambda x, d: jf.io.read(["a.nc"]), "files: found list"),
        (lambda x, d: jf.io.read("a.nc", names="u=x"), "names: found str 'u=x'; expected a dictionary"),
        (lambda x, d: jf.concatenate(["a.nc"]), "records: found 'a.nc'"),
    ],
)
def test_wrong_arguments(call, says):
    x = np.linspace(0, 1, 20)
    with pytest.raises(jf.InputError, match=says):
        call(x, jf.Experiment(x, x, 10.0, 10))


def test_runs_at_a_limit_are_told():
    robot = jf.robot.robot_from_table(tomllib.loads(two_axes.ROBOT))
    torque = np.random.default_rng(0).uniform(-20, 20, (2, 1, 100, 2))
    assert at_limits(robot, torque) == ()
    torque[1, 0, :30, 1] = -50.0
    (said,) = at_limits(robot, torque)
    assert said.startswith("elbow: the motor is at its torque limit of 50 N m for 30 % of the samples of position 1")
    assert "15 % of all" in said


def test_no_room(tmp_path):
    from jaxfrf._files import check_room

    check_room(tmp_path / "a", 1000)
    assert not (tmp_path / "a").exists()
    with pytest.raises(jf.InputError, match="no room for"):
        check_room(pathlib.Path(tmp_path / "a"), 2**62)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk that is full")
def test_a_full_disk_is_an_error_and_no_signal():
    """HDF5 would end the process, at the latest when that ends."""
    import h5py

    from jaxfrf.io._hdf5 import surviving

    with pytest.raises(OSError, match="No space left"):
        with surviving(pathlib.Path("/dev/full")) as disk, h5py.File(disk, "w") as file:
            file["x"] = np.zeros(300_000)


def test_what_is_read_apart_is_what_is_read_here(tmp_path, monkeypatch):
    """Numbers bit for bit, texts, units, and what no reader opens; with a file that ends the other process between."""
    import h5py

    from jaxfrf.io import _matlab, _netcdf
    from jaxfrf.io._apart import _READER, load_apart

    (tmp_path / "of_a_test.py").write_text("import os\n\ndef end(path):\n    os.abort()\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    _READER.stop()  # the next one has this path
    end = importlib.import_module("of_a_test").end

    x = np.random.default_rng(0).standard_normal((200, 2)) * [1, np.nan]
    one, two = tmp_path / "a.nc", tmp_path / "a.mat"
    _netcdf.save(one, {"u": _container.Variable(("time", "in"), x, "N m")}, {"fs": 10.0, "y_quantity": "velocity"})
    with h5py.File(two, "w") as file:
        file["z"] = x + 1j
        file["words"] = np.array([b"a", b"bc"], dtype=object)
    for path, read in ((one, _netcdf._load), (two, _matlab._load_v73)):
        here, apart = read(path), load_apart(path, read)
        with pytest.raises(jf.InputError, match="ends the process that opens it \\(signal 6\\)"):
            load_apart(path, end)
        assert list(here) == list(apart) and getattr(here, "units", {}) == apart.units
        for name, leaf in here.items():
            assert type(leaf) is type(apart[name])
            np.testing.assert_array_equal(leaf, apart[name])


def test_a_damaged_sample_is_noticed(tmp_path):
    import h5py

    path = tmp_path / "a.nc"
    x = np.random.default_rng(0).standard_normal((200, 1))
    jf.io.write(path, jf.Experiment(x, x, 10.0, 50))
    with h5py.File(path) as file:
        place = file["u"].id.get_chunk_info(0).byte_offset
    data = bytearray(path.read_bytes())
    data[place + 100] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(jf.InputError, match="cannot be read"):
        jf.io.read(path)
