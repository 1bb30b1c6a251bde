"""DESIGN.toml and the files that a controller plays."""

import csv
import dataclasses
import json
import pathlib

import jax.random as jr
import numpy as np
import pytest
import scipy.io

from jaxfrf import InputError, excitation as ex
from jaxfrf.io.designs import read_design
from jaxfrf.io.references import read_reference, write_reference

PAPER = pathlib.Path(__file__).parents[2] / "benchmarks" / "paper_design.toml"

SMALL = """
fs = 100.0
period = 400
inputs = 2
blocks = 2
seed = 7
periods = 2
transient_periods = 1
ramp = 1.5
velocity_limit = 30.0
travel_limit = [9.0, 8.0]

[lines]
grid = "random-odd"
band = [2.0, 20.0]
group = 3

[multisine]
rms = [1.0, 2.0]

[multisine.spectrum]
frequency = [2.0, 20.0]
amplitude = [1.0, 0.1]

[slow_sine]
lines = [1, 3]
amplitude = [10.0, 10.0]
"""


@pytest.fixture
def design_file(tmp_path):
    def write(text):
        path = tmp_path / "design.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def small(design_file):
    return ex.reference(read_design(design_file(SMALL)))


def test_paper_design():
    design = read_design(PAPER)
    assert (design.fs, design.period, design.n_in, design.blocks, design.n_exp) == (2000.0, 56000, 6, 4, 24)
    assert len(design.lines) == 336
    assert np.round(design.frequency[[0, -1]], 3).tolist() == [4.036, 79.321]
    assert np.allclose(design.rms, [2, 2, 2, 4, 4, 6])
    assert design.slow.lines.tolist() == [21, 23, 25, 27, 29, 31]
    assert design.slow.amplitude.tolist() == [30, 30, 30, 40, 40, 40]
    assert design.periods == design.transient_periods == 1
    assert isinstance(design.phases, ex.RandomPhases)


def test_small_design(design_file):
    design = read_design(design_file(SMALL))
    odd = ex.odd_lines(8, 80)
    assert len(design.lines) == len(odd) - len(odd) // 3
    assert (design.seed, design.periods, design.transient_periods, design.ramp) == (7, 2, 1, 1.5)
    assert design.velocity_limit.tolist() == [30.0, 30.0] and design.travel_limit.tolist() == [9.0, 8.0]
    assert np.allclose(design.rms, [1.0, 2.0])
    slope = np.diff(np.log(design.amplitude), axis=0) / np.diff(np.log(design.frequency))[:, None]
    assert np.allclose(slope, -1.0)
    assert np.array_equal(read_design(design_file(SMALL)).lines, design.lines)
    other = read_design(design_file(SMALL.replace("seed = 7", "seed = 8")))
    assert not np.array_equal(other.lines, design.lines)


@pytest.mark.parametrize(
    ("table", "lines"),
    [
        ('grid = "full"\nband = [1.0, 2.0]', [4, 5, 6, 7, 8]),
        ('grid = "odd"\nband = [1.0, 2.0]', [5, 7]),
        ('grid = "log-odd"\nband = [1.0, 20.0]\npoints = 4', [5, 11, 29]),
        ('grid = "list"\nlist = [3, 8, 9]', [3, 8, 9]),
    ],
)
def test_grids(design_file, table, lines):
    design = read_design(design_file(f"fs = 100\nperiod = 400\n[lines]\n{table}\n"))
    assert design.lines.tolist() == lines
    assert design.n_in == design.blocks == 1


@pytest.mark.parametrize("name", ["random", "schroeder", "crest-optimised"])
def test_phases(design_file, name):
    text = f'fs = 100\nperiod = 400\n[lines]\ngrid = "list"\nlist = [3, 5]\n[multisine]\nphases = "{name}"\n'
    assert read_design(design_file(text)).phases.name == name


BAD = [
    (
        "fs = 100.0",
        "ffs = 100.0",
        r"design: found the key 'ffs'; expected one of name, .* Did you mean 'fs'\?",
    ),
    ("fs = 100.0", "", "design: found no 'fs'; expected this key"),
    ("fs = 100.0", "fs = 'fast'", "fs: found 'fast'; expected finite numbers"),
    ("fs = 100.0", "fs = = 1", "found no valid TOML .*line 2"),
    ("period = 400", "period = 4.5", "period: found 4.5; expected a whole number"),
    (
        "inputs = 2",
        "inputs = 3",
        "channels: found 3 in n_in, 2 in rms, 2 in slow, 2 in travel_limit; expected the same number everywhere",
    ),
    ("blocks = 2", "block = 2", r"found the key 'block'; .* Did you mean 'blocks'\?"),
    ("seed = 7", "seed = -1", "seed: found -1; expected a whole number, 0 or more"),
    ("ramp = 1.5", "ramp = 5.0", r"ramp: found 5 s with 1 transient periods \(4 s\)"),
    (
        'grid = "random-odd"',
        'grid = "randomodd"',
        r"\[lines\] grid: found 'randomodd'; .* Did you mean 'random-odd'\?",
    ),
    ('grid = "random-odd"', "", r"\[lines\]: found no 'grid'"),
    (
        'grid = "random-odd"',
        'grid = "odd"',
        r"\[lines\] with grid 'odd': found the key 'group'; expected one of grid, band",
    ),
    ('grid = "random-odd"', 'grid = "log-odd"', r"\[lines\] with grid 'log-odd': found the key 'group'"),
    ("group = 3", "gruop = 3", r"\[lines\]: found the key 'gruop'; .* Did you mean 'group'\?"),
    ("group = 3", "group = 2.5", r"\[lines\] group: found 2.5; expected a whole number"),
    ("band = [2.0, 20.0]", "", r"\[lines\] with grid 'random-odd': found no 'band'"),
    (
        "band = [2.0, 20.0]",
        "band = [2.0]",
        r"\[lines\] band: found \[2.0\]; expected two numbers \[low, high\], Hz",
    ),
    ("band = [2.0, 20.0]", "band = [60.0, 70.0]", "band: found 60 to 70 Hz with lines every 0.25 Hz"),
    (
        "rms = [1.0, 2.0]",
        "rms = [1.0, -2.0]",
        r"rms: found \[1.0, -2.0\]; expected one positive number, or one for each",
    ),
    (
        "rms = [1.0, 2.0]",
        "phase = 'random'",
        r"\[multisine\]: found the key 'phase'; .* Did you mean 'phases'\?",
    ),
    (
        "rms = [1.0, 2.0]",
        "phases = 'shroeder'",
        r"\[multisine\] phases: found 'shroeder'; .* mean 'schroeder'\?",
    ),
    ("rms = [1.0, 2.0]", "phases = 3", r"\[multisine\] phases: found 3; expected one of random, schroeder"),
    ("frequency = [2.0, 20.0]", "", r"\[multisine.spectrum\]: found no 'frequency'"),
    (
        "frequency = [2.0, 20.0]",
        "frequency = [20.0, 2.0]",
        "spectrum: found frequencies .*; expected positive, increasing",
    ),
    ("lines = [1, 3]", "lines = [1]", "slow sine: found lines of shape"),
    ("lines = [1, 3]", "line = [1, 3]", r"\[slow_sine\]: found the key 'line'; .* Did you mean 'lines'\?"),
    ("velocity_limit = 30.0", "rms = 2.0", r"found the key 'rms'; .* It stands in \[multisine\]\."),
    ("rms = [1.0, 2.0]", "seed = 2", r"\[multisine\]: found the key 'seed'; .* It stands at the top"),
    ("velocity_limit = 30.0", "slow_sines = 3", r"found the key 'slow_sines'; .* Did you mean 'slow_sine'\?"),
]


@pytest.mark.parametrize(("good", "bad", "message"), BAD)
def test_bad_designs(design_file, good, bad, message):
    path = design_file(SMALL.replace(good, bad, 1))
    with pytest.raises(InputError, match=rf"^.*design\.toml: .*{message}"):
        read_design(path)


def test_no_file_and_no_table(tmp_path, design_file):
    with pytest.raises(InputError, match=r"nowhere.toml: found no such file; expected a design in TOML"):
        read_design(tmp_path / "nowhere.toml")
    with pytest.raises(InputError, match=r"lines: found 3; expected a table \[lines\]"):
        read_design(design_file("fs = 100\nperiod = 400\nlines = 3"))


# --- what a controller plays


@pytest.mark.parametrize("kind", ["nc", "mat"])
def test_written_and_read_again(tmp_path, small, kind):
    if kind == "nc":
        pytest.importorskip("h5netcdf")
    (path,) = write_reference(tmp_path / f"reference.{kind}", small)
    again = read_reference(path)
    assert np.array_equal(again.r, small.r)
    assert np.array_equal(again.position, small.position)
    for field in dataclasses.fields(small.design):
        if field.name not in ("slow", "phases"):
            assert np.array_equal(getattr(again.design, field.name), getattr(small.design, field.name)), field.name
    assert np.array_equal(again.design.slow.lines, small.design.slow.lines)
    assert again.design.phases.name == "random"
    # What the file says of the design is enough to make the same signals again.
    assert np.allclose(ex.reference(again.design).r, small.r, atol=1e-12)
    assert {p.name for p in tmp_path.iterdir()} == {"design.toml", f"reference.{kind}"}


@pytest.mark.parametrize("kind", ["nc", "mat"])
def test_one_experiment_of_one_input(tmp_path, kind):
    if kind == "nc":
        pytest.importorskip("h5netcdf")
    played = ex.reference(ex.Multisine(100.0, 50, [3, 5], periods=2))
    (path,) = write_reference(tmp_path / f"reference.{kind}", played)
    assert np.array_equal(read_reference(path).r, played.r)


def test_matlab_names(tmp_path, small):
    (path,) = write_reference(tmp_path / "reference.mat", small)
    found = scipy.io.loadmat(path)
    assert found["r"].shape == (4, 1200, 2)
    assert np.array_equal(found["r_position"], small.position)
    assert np.array_equal(found["lines"].ravel(), small.lines)
    assert (found["fs"].item(), found["period"].item(), found["transient_periods"].item()) == (100.0, 400, 1)
    assert found["r_quantity"].item() == "velocity"


def test_netcdf_names(tmp_path, small):
    pytest.importorskip("h5netcdf")
    xarray = pytest.importorskip("xarray")
    (path,) = write_reference(tmp_path / "reference.nc", small)
    with xarray.open_dataset(path, engine="h5netcdf", decode_timedelta=False) as found:
        assert found["r"].dims == ("experiment", "time", "input")
        assert found["r"].attrs["units"] == "rad/s"
        assert np.array_equal(found["r"].values, small.r)
        assert np.array_equal(found["lines"].values, small.lines)
        assert found.attrs["fs"] == 100.0
        assert found.attrs["period"] == 400
        assert found.attrs["r_quantity"] == "velocity"


def test_csv_is_one_file_per_experiment(tmp_path, small):
    files = write_reference(tmp_path / "move.csv", small)
    assert [f.name for f in files] == [*(f"move_0{i}.csv" for i in (1, 2, 3, 4)), "move_design.json"]
    for exp, name in enumerate(files[:-1]):
        with name.open(newline="") as file:
            headings, *rows = csv.reader(file)
        assert headings == ["time", "velocity1", "velocity2", "position1", "position2"]
        table = np.array(rows, float)
        assert np.allclose(table[:, 0], small.time, atol=1e-9)
        assert np.allclose(table[:, 1:3], small.r[exp], rtol=1e-11, atol=1e-300)
        assert np.allclose(table[:, 3:], small.position[exp], rtol=1e-11, atol=1e-300)
    said = json.loads(files[-1].read_text())
    assert said["files"] == [f.name for f in files[:-1]]
    assert said["lines"] == small.lines.tolist()
    assert said["seed"] == 7


def test_csv_of_a_single_experiment_keeps_its_name(tmp_path):
    files = write_reference(tmp_path / "move.csv", ex.reference(ex.Multisine(100.0, 50, [3, 5])))
    assert [f.name for f in files] == ["move.csv", "move_design.json"]


def test_nothing_is_left_when_writing_fails(tmp_path, small, monkeypatch):
    from jaxfrf.io import references

    written = []

    def fail(path, *_):
        written.append(path)
        path.write_text("half")
        if len(written) == 3:
            raise OSError("disk full")

    monkeypatch.setattr(references, "_write_table", fail)
    target = tmp_path / "out"
    target.mkdir()
    with pytest.raises(OSError, match="disk full"):
        write_reference(target / "move.csv", small)
    assert list(target.iterdir()) == []


def test_wrong_names(tmp_path, small):
    with pytest.raises(InputError, match=r"found the extension '.txt'; expected one of .nc, .mat, .csv"):
        write_reference(tmp_path / "move.txt", small)
    for kind in ("mat", "csv"):
        with pytest.raises(InputError, match="nowhere"):
            write_reference(tmp_path / "nowhere" / f"move.{kind}", small)
    scipy.io.savemat(tmp_path / "other.mat", {"r": np.zeros((5, 1)), "fs": 1.0})
    with pytest.raises(InputError, match=r"other.mat: found no r_position, lines, .*; expected a reference written"):
        read_reference(tmp_path / "other.mat")


def test_a_reference_that_does_not_fit_its_design(tmp_path, small):
    (path,) = write_reference(tmp_path / "reference.mat", small)
    found = {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__")}
    scipy.io.savemat(path, found | {"periods": 1.0})
    with pytest.raises(
        InputError, match=r"reference.mat: reference: found shapes .*; expected \(4, 800, 2\) \(experiment"
    ):
        read_reference(path)
    scipy.io.savemat(path, found | {"phases": "wavy"})
    with pytest.raises(InputError, match=r"reference.mat: phases: found 'wavy'; expected one of random"):
        read_reference(path)


def test_lines_and_phases_draw_apart(design_file):
    """The lines left out come from the seed, but from another stream than the phases of any block."""
    design = read_design(design_file(SMALL))
    for block in range(3):
        key = jr.fold_in(jr.key(7), block)
        assert not np.array_equal(ex.random_odd_lines(8, 80, group=3, key=key), design.lines)
