"""Data sets that are read, estimated and simulated some positions at a time: the same numbers, the same words."""

import argparse
import dataclasses
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
import tomllib

import jax.random as jr
import numpy as np
import pytest
import two_axes
from gap_examples import OWN

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.batch import estimated, simulated
from jaxfrf.cli.arguments import _bytes
from jaxfrf.cli.progress import Progress
from jaxfrf.frf.catalogue import method
from jaxfrf.io.blocks import data_set, file_warnings
from jaxfrf.parts import Parts
from jaxfrf.screening import across_all

N = 200  # samples of a period
LINES = np.arange(1, 60, 2)


def record(seed=0, n_pos=4, periods=2, lines=LINES, shift=0.0):
    """A closed-loop-like record of two axes: y is u filtered and a little bent, the reference is what was played."""
    rng = np.random.default_rng(seed)
    R = np.zeros((n_pos, 3, N // 2 + 1, 2), complex)
    R[:, :, LINES] = np.exp(2j * np.pi * rng.random((n_pos, 3, len(LINES), 2)))
    G = 1 / (1 + 0.3 * np.exp(-2j * np.pi * np.arange(N // 2 + 1) / N))
    r, y = (np.tile(N * np.fft.irfft(x, axis=2), (1, 1, periods, 1)) for x in (R, R * G[:, None]))
    u, y = (x + 0.02 * rng.standard_normal(x.shape) for x in (r, y + 0.1 * np.tanh(y)))
    q = 0.1 * np.arange(2 * n_pos).reshape(n_pos, 2) + shift
    return jf.Experiment(u, y, 100.0, N, r=r, q=q, lines=lines, y_quantity="position")


@pytest.fixture(autouse=True)
def one_by_one(monkeypatch):
    """Positions of any size are taken one by one."""
    monkeypatch.setattr(estimated, "_BLOCK", 1.0)
    monkeypatch.setattr(simulated, "_TOGETHER", 1)


def files(tmp_path, *records):
    paths = [tmp_path / f"run{i}.nc" for i in range(len(records))]
    for path, data in zip(paths, records, strict=True):
        jf.io.write(path, data)
    return paths


def faulty():
    """With a channel that is held for a while at position 2, and an experiment that is given twice."""
    data = record(periods=3)
    y, u = data.y.copy(), data.u.copy()
    y[2, 1, 250:300, 0] = y[2, 1, 250, 0]
    y[3, 0], u[3, 0] = y[0, 1], u[0, 1]
    return dataclasses.replace(data, y=y, u=u)


@pytest.mark.parametrize(
    "shift",
    [None, pytest.param(0.0, marks=pytest.mark.slow), pytest.param(5.0, marks=pytest.mark.slow)],
    ids=["one file", "same positions", "other positions"],
)
def test_blocks_are_the_record_and_say_the_same(tmp_path, shift):
    more = [] if shift is None else [record(1, periods=3, shift=shift)]
    paths = files(tmp_path, faulty(), *more)
    data, whole = data_set(*paths).named(), jf.io.read(*paths)
    blocks = [data.read(at) for at in data.blocks(1)]
    assert len(blocks) == data.n_pos == whole.n_pos and all(x.data.n_pos == 1 for x in blocks)
    for name in "uyrq":
        joined = np.concatenate([getattr(x.data, name) for x in blocks])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    told = (*file_warnings(data.files, [x.told for x in blocks]), *across_all([x.told.screened for x in blocks]))
    assert data.sources == whole.sources and whole.warnings
    plain = lambda texts: [re.sub(r", file [^)]*", "", text) for text in texts]
    assert plain(told) == plain(whole.warnings)


def same(path, frf, rounding: float = 0.0):
    """`rounding`: relative to the largest element."""
    found = jf.io.read_frf(path)
    for field in dataclasses.fields(frf):
        a, b = getattr(found, field.name), getattr(frf, field.name)
        if b is None or isinstance(b, str | tuple):
            assert a == b, field.name
        elif rounding:
            largest = np.nanmax(np.abs(np.asarray(b)))
            np.testing.assert_allclose(
                np.asarray(a), np.asarray(b), rtol=0, atol=rounding * largest, err_msg=field.name
            )
        else:
            np.testing.assert_array_equal(np.asarray(a), np.asarray(b), err_msg=field.name)


def estimate(paths, output, *more):
    return main(["estimate", *map(str, paths), "-o", str(output), *more])


@pytest.mark.parametrize(
    ("name", "suffix", "lines", "others"),
    [
        pytest.param("lrm-jio", ".nc", LINES, 0, marks=pytest.mark.slow),
        ("h1", ".nc", None, 1),
        ("h1", ".mat", LINES, 0),
    ],
)
def test_an_estimate_is_that_of_the_whole_in_memory(tmp_path, name, suffix, lines, others):
    """Bit for bit, whatever the format, the files, and whether the lines are listed or found over all positions; up to
    rounding where a logarithmic mean of one position is compiled otherwise than that of several."""
    paths = files(tmp_path, *(record(i, lines=lines, shift=2.0 * i) for i in range(1 + others)))
    assert estimate(paths, tmp_path / f"frf{suffix}", "--method", name) == 0
    data = jf.io.read(*paths)
    frf = jf.with_distortion(jf.estimate(data, method(name, {})), data)
    same(tmp_path / f"frf{suffix}", frf, rounding=1e-13 if name == "lrm-jio" else 0.0)


def test_lines_that_are_silent_at_some_positions_are_no_fault(tmp_path, capsys):
    """Only where they are silent at all."""
    data = record(lines=np.arange(1, 62, 2))
    (path,) = files(tmp_path, data)
    assert estimate([path], tmp_path / "frf.nc", "--method", "h1") == 2
    assert "no power in any channel at 1 of the 31 excited lines" in capsys.readouterr().err
    extra = np.cos(2 * np.pi * 61 / N * np.arange(2 * N))[:, None]
    at_last = np.arange(4)[:, None, None, None] == 3
    (path,) = files(tmp_path, dataclasses.replace(data, **{n: getattr(data, n) + at_last * extra for n in "ury"}))
    assert estimate([path], tmp_path / "frf.nc", "--method", "h1") == 0


def test_bad_samples_at_a_later_position_are_named(tmp_path, capsys):
    (path,) = files(tmp_path, record())
    import h5py

    with h5py.File(path, "r+") as file:
        file["u"][2, 0, 7, 1] = np.nan
    assert estimate([path], tmp_path / "frf.nc", "--method", "h1") == 2
    said = capsys.readouterr().err
    assert "1 NaN or Inf samples" in said and "count from number 2 of the file on" in said
    assert sorted(x.name for x in tmp_path.iterdir()) == ["run0.nc"]


@pytest.mark.slow
def test_zarr_there_and_back(tmp_path):
    pytest.importorskip("zarr")
    data = record()
    jf.io.write(tmp_path / "run.zarr", data)
    again = jf.io.read(tmp_path / "run.zarr")
    for name in "uyrq":
        np.testing.assert_array_equal(getattr(again, name), getattr(data, name))
    assert estimate([tmp_path / "run.zarr"], tmp_path / "frf.zarr", "--method", "h1") == 0
    jf.io.write(tmp_path / "run.nc", data)
    assert estimate([tmp_path / "run.nc"], tmp_path / "frf.nc", "--method", "h1") == 0
    one, two = jf.io.read_frf(tmp_path / "frf.zarr"), jf.io.read_frf(tmp_path / "frf.nc")
    np.testing.assert_array_equal(one.cov, two.cov)
    assert data_set(tmp_path / "run.zarr").blocks(1) == [range(i, i + 1) for i in range(4)]
    assert estimate([tmp_path / "run.nc"], tmp_path / "frf.zarr", "--method", "h1") == 2  # nothing of that name goes


@pytest.mark.slow
def test_a_simulation_in_blocks_is_that_of_all_at_once(tmp_path, monkeypatch):
    """And it goes on where it was interrupted."""
    robot = jf.robot.robot_from_table(tomllib.loads(two_axes.ROBOT))
    plan = jf.Multisine(500.0, 200, np.arange(5, 40, 6), n_in=2, rms=1.0)
    q = jf.random_positions(3, jr.key(0), 2)
    whole = jf.simulate(robot, plan, q, key=jr.key(1), run_in=0.2)
    real, calls = simulated.record, []

    def record(*given, **more):
        calls.append(more["positions"])
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*given, **more)

    def simulate(**more):
        with Parts(tmp_path / "run.nc", "simulate", **more) as parts:
            options = {"key": jr.key(1), "run_in": 0.2, "parts": parts}
            return simulated.simulate_to(tmp_path / "run.nc", robot, plan, q, **options)

    monkeypatch.setattr(simulated, "record", record)
    with pytest.raises(KeyboardInterrupt) as stopped:
        simulate()
    assert "1 finished part kept" in stopped.value.__notes__[0]
    made = simulate(resume=True)
    assert calls == [range(0, 1), range(1, 2), range(1, 2), range(2, 3)]
    assert (made.positions, made.experiments, made.warnings) == (3, 2, whole.warnings)
    data = jf.io.read(tmp_path / "run.nc")
    for name in "uyr":
        np.testing.assert_allclose(getattr(data, name), getattr(whole, name), atol=1e-9)
    np.testing.assert_array_equal(data.q, q)
    assert not (tmp_path / "run.nc.parts").exists()


@pytest.mark.slow
def test_workers_simulate_the_same(tmp_path, monkeypatch):
    """A robot with an effect that only a user's file knows, its positions shared by two processes."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(simulated, "_EACH", 2)
    effect = '\n[[effect]]\nname = "quadratic_friction"\njoint = "elbow"\nlevel = 1e-5\n'
    for name, text in {"robot.toml": two_axes.ROBOT + effect, "design.toml": DESIGN, "own.py": OWN}.items():
        (tmp_path / name).write_text(text)
    given = [str(tmp_path / "robot.toml"), str(tmp_path / "design.toml"), "--effects", str(tmp_path / "own.py")]
    for name, workers in {"one.nc": "1", "two.nc": "2"}.items():
        more = ["--positions", "3", "--workers", workers, "-o", str(tmp_path / name)]
        assert main(["simulate", *given, *more]) == 0
    one, two = _simulated(tmp_path / "one.nc"), _simulated(tmp_path / "two.nc")
    for name in one:
        np.testing.assert_allclose(two[name], one[name], atol=1e-9, err_msg=name)
    assert not (tmp_path / "two.nc.parts").exists()


class TestProgress:
    class Screen:
        def __init__(self, terminal):
            self.text, self.isatty = "", lambda: terminal

        def write(self, text):
            self.text += text

        def flush(self):
            pass

    def shown(self, terminal, as_json):
        screen = self.Screen(terminal)
        with Progress("work", as_json, screen) as progress:
            progress(0.5)
            progress.say("half")
            progress(1.0)
        return screen.text

    def test_a_line_that_changes_on_a_terminal(self):
        text = self.shown(True, False)
        assert "work: 50 %" in text and "\n" not in text and text.endswith("\r\x1b[K")

    def test_nothing_elsewhere(self):
        assert self.shown(False, False) == ""

    def test_events(self):
        events = [json.loads(line) for line in self.shown(False, True).splitlines()]
        assert [x["done"] for x in events] == [0.5, None, 1.0] and events[1]["says"] == "half"

    def test_what_is_left(self, monkeypatch):
        now = [0.0]
        monkeypatch.setattr(time, "monotonic", lambda: now[0])
        screen = self.Screen(False)
        with Progress("work", True, screen) as progress:
            for now[0], done in ((30.0, 0.1), (40.0, 0.2), (60.0, 0.4)):  # 20 s of compiling
                progress(done)
        assert [json.loads(x)["seconds_left"] for x in screen.text.splitlines()] == [270.0, 80.0, 60.0]


def test_sizes():
    assert (_bytes("2GB"), _bytes("1.5 gib"), _bytes("3000000000")) == (2e9, 1.5 * 2**30, 3e9)
    for text in ("2 parsec", "much", "5MB", "-1GB"):
        with pytest.raises(argparse.ArgumentTypeError, match="found '"):
            _bytes(text)


# --- processes


def started(*words, **more):
    environment = os.environ | {"JAX_ENABLE_X64": "1", "PYTHONPATH": str(pathlib.Path(jf.__file__).parents[1])}
    command = [sys.executable, "-m", "jaxfrf", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, **more)


def children(pid):
    """Processes below one, by what /proc says."""
    found = []
    for path in pathlib.Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(path.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
        if parent == pid:
            found += [int(path.parent.name), *children(int(path.parent.name))]
    return found


def command_line(pid):
    try:
        return pathlib.Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.timeout(900)
def test_a_worker_is_killed_and_the_estimate_is_the_same(tmp_path):
    pytest.importorskip("distributed")
    rng = np.random.default_rng(0)
    x = rng.standard_normal((12, 6, 40_000, 2))
    paths = files(tmp_path, jf.Experiment(x, x + 0.1 * rng.standard_normal(x.shape), 1e3, 20_000, r=x, lines=LINES))
    assert estimate(paths, tmp_path / "one.nc", "--method", "h1") == 0
    process = started("estimate", *paths, "-o", tmp_path / "two.nc", "--method", "h1", "--workers", "2")
    while not list(tmp_path.glob("two.nc.parts/*.npz")):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    workers = [pid for pid in children(process.pid) if "spawn_main" in command_line(pid)]
    os.kill(workers[0], signal.SIGKILL)
    said = process.communicate(timeout=600)[1].decode()
    assert process.returncode == 0, said
    same(tmp_path / "two.nc", jf.io.read_frf(tmp_path / "one.nc"))


def _estimated(path):
    frf = jf.io.read_frf(path)
    return {f.name: getattr(frf, f.name) for f in dataclasses.fields(frf)}


def _simulated(path):
    data = jf.io.read(path)
    return {name: getattr(data, name) for name in "uyrq"}


def _json(path):
    return json.loads(path.read_text())


def _each(path):
    return {x.name: _estimated(x) for x in sorted(path.glob("*.nc"))}


def _prepared(command, tmp_path):
    """Words of a long command, its output, and how it is read."""
    robot, design = tmp_path / "robot.toml", tmp_path / "design.toml"
    robot.write_text(two_axes.ROBOT)
    design.write_text(DESIGN)
    runs = [tmp_path / "runs.nc"]
    if command in ("identify", "diagnose"):
        assert main(["simulate", *map(str, (robot, design)), "--positions", "3", "-o", str(runs[0])]) == 0
    elif command != "simulate":
        files(tmp_path, *(record(i, shift=3.0 * i) for i in range(4)))
        runs = sorted(tmp_path.glob("run*.nc"))
    return {
        "estimate": (["estimate", *runs, "--method", "lrm-jio"], "out.nc", _estimated),
        "simulate": (["simulate", robot, design, "--positions", "40"], "out.nc", _simulated),
        "identify": (["identify", *runs, "--robot", robot, "--springs", "--starts", "3"], "out.json", _json),
        "diagnose": (["diagnose", *runs, "--robot", robot], "out.json", _json),
        "each": (["estimate", *runs, "--method", "lrm-jio", "--each"], "out", _each),
        "study": (["study"], "study", lambda path: _json(path / "study.json")["parameters"]),
    }[command]


DESIGN = """
fs = 500.0
period = 2000
inputs = 2
blocks = 1
periods = 1
transient_periods = 1
[lines]
grid = "log-odd"
band = [1.0, 60.0]
points = 40
[multisine]
rms = 1.0
"""


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "command",
    [
        "estimate",
        "simulate",
        *(pytest.param(x, marks=pytest.mark.long) for x in ("each", "identify", "diagnose", "study")),
    ],
)
def test_killed_at_any_moment_it_goes_on_to_the_same_result(tmp_path, command):
    """Ten times, by SIGKILL and SIGTERM in turn; no half file stands there in between."""
    words, output, read = _prepared(command, tmp_path)
    began = time.monotonic()
    whole = started(*words, "-o", tmp_path / f"whole-{output}")
    said = whole.communicate()[1].decode()
    assert whole.returncode == 0, said
    spent, out = time.monotonic() - began, tmp_path / output
    rng = np.random.default_rng(0)
    for kill in [signal.SIGKILL, signal.SIGTERM] * 5:
        before = _kept(out)
        process = started(*words, "-o", out, "--resume")
        try:
            said = process.communicate(timeout=spent * rng.uniform(0.3, 1.0))[1].decode()
            assert process.returncode == 0, said
        except subprocess.TimeoutExpired:
            process.send_signal(kill)
            said = process.communicate()[1].decode()
            begun = "taken over from" in said or _kept(out) - before  # it may be told before it has read anything
            left = _kept(out)  # none where it was told to end after the result stood
            if kill == signal.SIGTERM and process.returncode == 143 and begun and left:
                assert "--resume goes on from there" in said, said
            if command not in ("each", "study"):
                assert not out.exists() or read(out)
    process = started(*words, "-o", out, "--resume")
    said = process.communicate()[1].decode()
    assert process.returncode == 0, said
    np.testing.assert_equal(_plain(read(out)), _plain(read(tmp_path / f"whole-{output}")))
    assert not pathlib.Path(f"{out}.parts").exists()


def _kept(out):
    """Names of finished parts."""
    return {path.name for path in pathlib.Path(f"{out}.parts").glob("[!.]*") if path.name != "jaxfrf-parts.json"}


def _plain(found):
    if isinstance(found, dict):
        return {name: _plain(x) for name, x in found.items() if name not in ("seconds", "minutes")}
    return np.asarray(found) if hasattr(found, "shape") else found
