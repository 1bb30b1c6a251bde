"""The command line: what is printed and written, exit codes, one clear message for every kind of bad input."""

import dataclasses
import json
import os
import pathlib
import re
import subprocess
import sys
import webbrowser

import numpy as np
import plants
import pytest
import scipy.io
from book_tables import keys, row_names, told

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.cli.remarks import warn
from jaxfrf.frf.catalogue import METHODS

FS, PERIOD = 200.0, 400
LINES = np.arange(5, 100, 2)


def record(n_pos=1, n_exp=4, n_in=2, n_periods=2, seed=0, n_time=None, noise=1e-2):
    """Open-loop records of G = [[1, 0.5], [0.2, 2]] / (1 + 0.3 z^-1), with orthogonal multisines and a little noise."""
    rng = np.random.default_rng(seed)
    gain = np.array([[1.0, 0.5], [0.2, 2.0]])[:n_in, :n_in]
    G = gain / (1 + 0.3 * np.exp(-2j * np.pi * LINES / PERIOD))[:, None, None]
    n_real = -(-n_exp // n_in)
    U = np.stack([plants.orthogonal_multisine(rng, n_real, len(LINES), n_in)[:n_exp] for _ in range(n_pos)])
    Y = np.einsum("fab,pefb->pefa", G, U)

    def periods(X):
        one = np.array([[plants.multisine_record(x, LINES, PERIOD) for x in at] for at in X])
        return np.tile(one, (1, 1, n_periods, 1))

    u, y = periods(U), periods(Y)
    y = y + noise * rng.standard_normal(y.shape)
    return {"r": u.copy(), "u": u, "y": y}, G


def write(path, arrays, **fields):
    """A `.npz` as a user would write it: nothing of jaxfrf takes part."""
    fields = {"fs": FS, "period": PERIOD, "lines": LINES} | fields
    np.savez(path, **arrays, **{name: value for name, value in fields.items() if value is not None})
    return str(path)


@pytest.fixture
def data(tmp_path):
    return write(tmp_path / "run.npz", record()[0])


@pytest.fixture
def output(tmp_path):
    (tmp_path / "out").mkdir()
    return str(tmp_path / "out" / "frf.nc")


def estimate(*arguments):
    return main(["estimate", *(str(x) for x in arguments)])


def refused(capsys, output, *arguments):
    """The message of a refused estimate: exit code 2, one line on standard error, and nothing written."""
    assert estimate(*arguments, "-o", output) == 2
    out, error = capsys.readouterr()
    assert out == "" and "Traceback" not in error
    assert error.startswith("jaxfrf estimate: ") and error.count("\n") == 1
    assert re.search(r"found .+; expected .+\. \S", error), error
    folder = pathlib.Path(output).parent
    assert not folder.is_dir() or list(folder.iterdir()) == []
    return error


# --- from a record to files


def test_example_to_files(tmp_path, capsys):
    run, frf, bode = (str(tmp_path / name) for name in ("run.nc", "frf.nc", "bode.png"))
    assert main(["example", "-o", run]) == 0
    assert f"wrote {run}" in capsys.readouterr().out
    assert estimate(run, "-o", frf, "--plot", bode) == 0
    out, error = capsys.readouterr()
    assert f"wrote {frf}, {bode}" in out and error == ""
    assert "2 x 2 FRF at 1 operating point, 93 lines" in out and "standard deviation: " in out
    assert pathlib.Path(bode).read_bytes().startswith(b"\x89PNG")
    written = jf.io.read_frf(frf)
    truth = jf.example_response(written.frequency)
    error = np.abs(written.G - truth) / np.abs(truth)
    assert np.median(error[..., [0, 1], [0, 1]]) < 0.01
    assert written.sources[0].name == "run.nc" and len(written.sources[0].sha256) == 64
    # The summary names what the closed form shows: the antiresonance of the first axis.
    f = np.linspace(10, 20, 2001)
    dip = f[np.argmin(np.abs(jf.example_response(f)[0, :, 0, 0]))]
    found = float(re.search(r"G11: antiresonance at ([\d.]+) \+-", out)[1])
    assert abs(found - dip) <= np.diff(written.frequency).max()


@pytest.mark.parametrize("suffix", ["nc", "mat", "npz"])
def test_frf_files_hold_the_truth(tmp_path, suffix):
    arrays, G = record(noise=0.0)
    target = tmp_path / f"frf.{suffix}"
    assert estimate(write(tmp_path / "run.npz", arrays), "-o", target, "--method", "h1") == 0
    if suffix == "mat":
        # MATLAB drops no axis here: the last one has two elements.
        np.testing.assert_allclose(scipy.io.loadmat(target)["G"][0], G, rtol=1e-9)
    np.testing.assert_allclose(jf.io.read_frf(target).G[0], G, rtol=1e-9)


def test_universal_file(tmp_path, data):
    pyuff = pytest.importorskip("pyuff")
    target = tmp_path / "frf.uff"
    assert estimate(data, "-o", target, "--method", "h1") == 0
    sets = pyuff.UFF(str(target)).read_sets()
    responses = [s for s in sets if s["type"] == 58]
    assert len(responses) == 4 and all(s["func_type"] == 4 for s in responses)
    np.testing.assert_allclose(responses[0]["x"], LINES * FS / PERIOD, rtol=1e-6)


_COMPILES = "auto robust-lrm-jio lrm-miso lrm-mimo lrm-jio lrm-stacked lrm-jio-stacked lrm-jio-common".split()


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(name, marks=pytest.mark.slow if name in _COMPILES else ())
        for name in METHODS
        if name not in ("welch", "robust")  # see test_robust, _aperiodic
    ],
)
def test_every_method_runs(tmp_path, data, method):
    target = tmp_path / "frf.npz"
    assert estimate(data, "-o", target, "--method", method) == 0
    frf = jf.io.read_frf(target)
    G = record()[1]
    assert np.median(np.abs(frf.G[0] - G) / np.abs(G)) < 0.05
    assert frf.method


def test_options_reach_the_method(tmp_path, data):
    target = tmp_path / "frf.npz"
    options = ("--option", "order=1", "--option", "width=17", "--option", "variable=frequency")
    assert estimate(data, "-o", target, "--method", "lpm", *options) == 0
    frf = jf.io.read_frf(target)
    assert "LPM(order=1, width=17, variable='frequency'" in frf.method
    assert np.all(frf.window == 17)


def test_list_of_methods(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["estimate", "--methods"])
    assert stopped.value.code == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    paper = "h1 arithmetic log jio lpm lrm-miso lrm-mimo lrm-jio".split()
    assert set(paper) <= set(names) and "auto" in names and names == list(METHODS)


def test_periods_choose_part_of_the_record(tmp_path):
    """Each period on its own gives that period's ratio, computed here without the package."""
    arrays, _ = record(n_exp=1, n_in=1, n_periods=3, noise=0.3)
    data = write(tmp_path / "run.npz", arrays, transient_periods=1)
    for period in range(2):
        target = tmp_path / "frf.npz"
        assert estimate(data, "-o", target, "--method", "h1", "--periods", f"{period}:{period + 1}") == 0
        part = slice((1 + period) * PERIOD, (2 + period) * PERIOD)
        u, y = (np.fft.rfft(arrays[name][0, 0, part, 0])[LINES] for name in "uy")
        np.testing.assert_allclose(jf.io.read_frf(target).G[0, :, 0, 0], y / u, rtol=1e-10)


@pytest.mark.parametrize(("band", "low", "high"), [("10:20", 10, 20), (":20", 0, 20), ("10:", 10, 100)])
def test_band_chooses_lines(tmp_path, data, band, low, high):
    target = tmp_path / "frf.npz"
    assert estimate(data, "-o", target, "--method", "h1", "--band", band) == 0
    frequency = LINES * FS / PERIOD
    inside = frequency[(frequency >= low) & (frequency <= high)]
    np.testing.assert_allclose(jf.io.read_frf(target).frequency, inside)


def test_several_files_are_one_data_set(tmp_path):
    """Two files of two experiments each give what one file of all four gives."""
    arrays, _ = record(n_exp=4)
    whole = write(tmp_path / "all.npz", arrays)
    first = write(tmp_path / "a.npz", {name: x[:, :2] for name, x in arrays.items()})
    second = write(tmp_path / "b.npz", {name: x[:, 2:] for name, x in arrays.items()})
    assert estimate(whole, "-o", tmp_path / "1.npz", "--method", "h1") == 0
    assert estimate(first, second, "-o", tmp_path / "2.npz", "--method", "h1") == 0
    one, two = (jf.io.read_frf(tmp_path / f"{i}.npz") for i in (1, 2))
    np.testing.assert_array_equal(one.G, two.G)
    assert [source.name for source in two.sources] == ["a.npz", "b.npz"]


def test_other_names_and_units(tmp_path):
    arrays, G = record(noise=0.0)
    names = {"torque": arrays["u"], "speed_deg": np.rad2deg(arrays["y"])}
    data = write(tmp_path / "log.npz", names, fs=None, period=None, lines=None)
    arguments = ("--map", "u=torque,y=speed_deg", "--factor", f"y={np.pi / 180!r}")
    values = ("--set", f"fs={FS:g}", "--set", f"period={PERIOD},lines=5:100:2")  # several of them add up
    assert estimate(data, "-o", tmp_path / "frf.npz", "--method", "h1", *arguments, *values) == 0
    np.testing.assert_allclose(jf.io.read_frf(tmp_path / "frf.npz").G[0], G, rtol=1e-9)


@pytest.mark.slow
def test_six_axes_and_several_positions(tmp_path, capsys):
    """Larger: 3 positions, 6 experiments of 6 axes; the default method, with the FRF within a few per cent."""
    rng = np.random.default_rng(4)
    G = plants.modal_response(rng, 6, 6, 2 * np.pi * LINES * FS / PERIOD)
    U = np.stack([plants.orthogonal_multisine(rng, 1, len(LINES), 6) for _ in range(3)])
    Y = plants.open_loop_spectra(G, U, noise=0.05, seed=5)
    u, y = (np.array([[plants.multisine_record(x, LINES, PERIOD) for x in at] for at in X]) for X in (U, Y))
    data = write(tmp_path / "run.npz", {"u": u, "y": y}, q=rng.uniform(-1, 1, (3, 6)))
    assert estimate(data, "-o", tmp_path / "frf.npz") == 0
    assert "6 x 6 FRF at 3 operating points" in capsys.readouterr().out
    frf = jf.io.read_frf(tmp_path / "frf.npz")
    assert frf.G.shape == (3, len(LINES), 6, 6) and frf.q.shape == (3, 6)
    assert np.median(np.linalg.norm(frf.G - G, axis=(-2, -1)) / np.linalg.norm(G, axis=(-2, -1))) < 0.05
    assert not (tmp_path / "frf.npz.parts").exists()


# --- what is printed


def test_json_is_all_of_standard_output(tmp_path, capsys):
    arrays, _ = record()
    arrays["u"] = np.clip(arrays["u"], -0.4 * arrays["u"].max(), 0.4 * arrays["u"].max())
    data = write(tmp_path / "run.npz", arrays)
    target, picture = str(tmp_path / "frf.nc"), str(tmp_path / "bode.svg")
    assert estimate(data, "-o", target, "--method", "lrm-jio", "--json", "--plot", picture) == 0
    out, error = capsys.readouterr()
    about = json.loads(out, parse_constant=lambda x: pytest.fail(f"{x} is no JSON"))
    assert about["output"] == [target, picture] and about["lines"] == len(LINES)
    assert about["band_hz"] == [2.5, 49.5] and about["positions"] == 1 and about["experiments"] == 4
    assert about["method"].startswith("LogMean(method=JointInputOutput(method=LRM(")
    assert any("looks clipped" in text for text in about["warnings"])
    assert "warning: " in error and "looks clipped" in error  # a person sees it too


def test_json_without_a_standard_deviation(tmp_path, capsys):
    """H1 of as many experiments as inputs has no residual: null, not NaN, which JSON does not have."""
    data = write(tmp_path / "run.npz", record(n_exp=2, n_periods=1)[0])
    assert estimate(data, "-o", tmp_path / "frf.nc", "--method", "h1", "--json") == 0
    about = json.loads(capsys.readouterr().out, parse_constant=lambda x: pytest.fail(f"{x} is no JSON"))
    assert about["median_relative_std"] is None
    assert any("no residual left" in text for text in about["status"])


@pytest.mark.parametrize("command", ["example", "excite"])
def test_json_of_other_commands(tmp_path, capsys, command, design):
    arguments = {"example": ["--blocks", "1"], "excite": [design]}[command]
    assert main([command, *arguments, "-o", str(tmp_path / "a.nc"), "--json"]) == 0
    assert str(tmp_path / "a.nc") in json.loads(capsys.readouterr().out)["output"]


def test_what_json_prints_is_told(tmp_path, capsys, design):
    """Every key of these stands on the page of files, in the row of the command or the section of its file."""
    run, frf = write(tmp_path / "run.npz", record()[0]), str(tmp_path / "frf.nc")
    words = {
        "estimate": [run, "-o", frf, "--method", "lrm-jio"],
        "modal": [frf, "-o", tmp_path / "modes.json"],
        "distortion": [run],
        "excite": [design, "-o", tmp_path / "r.nc", "--plot", tmp_path / "r.svg"],
    }
    for command, arguments in words.items():
        assert main([command, *map(str, arguments), "--json"]) == 0, capsys.readouterr().err
        known = told("files.md", "modes.json") if command == "modal" else row_names("files.md", f"| `{command}` |")
        assert keys(json.loads(capsys.readouterr().out)) - {"output"} <= known, command


def test_help_and_usage(capsys):
    assert main([]) == 0
    assert "COMMAND" in capsys.readouterr().out
    for arguments, code, says in (
        (["--version"], 0, jf.__version__),
        (["--help"], 0, "estimate"),
        (["estimate", "--help"], 0, "--method"),
        (["estimate"], 2, "DATA"),
        (["estimate", "a.nc"], 2, "--output"),
        (["guess"], 2, "guess"),
        (["estmate", "a.nc"], 2, "'estmate'"),
        (["estmate", "a.nc"], 2, "(did you mean estimate?)"),
        (["estimate", "a.nc", "--ouput", "b.nc"], 2, "(did you mean --output?)"),
        (["estimate", "a.nc", "-o", "b.nc", "--mehtod=h1"], 2, "--mehtod=h1 (did you mean --method?)"),
        (["diagnose", "a.nc", "-o", "b.json", "--heldout", "5"], 2, "(did you mean --heldout-count?)"),
        (["--verison"], 2, "(did you mean --version?)"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == code
        assert says in "".join(capsys.readouterr())


def test_examples_of_every_help_are_understood(capsys):
    """Every help has examples; each is a command that the parser takes."""
    import shlex

    from jaxfrf.__main__ import _parser
    from jaxfrf.cli import COMMANDS

    for command in COMMANDS:
        name = command.__name__.rpartition(".")[2]
        assert main_exit([name, "--help"]) == 0 and f"examples:\n  jaxfrf {name} " in capsys.readouterr().out
        for example in command.EXAMPLES:
            program, *arguments = shlex.split(example)
            assert program == "jaxfrf" and _parser().parse_args(arguments).command == name


def main_exit(arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    return stopped.value.code


def test_one_table_of_formats(capsys):
    """Help lists it, FRFs are written as it says, and the book claims nothing else."""
    from jaxfrf.io._formats import FRFS, RECORDS, SAVED
    from jaxfrf.io.responses import _WRITERS

    assert set(_WRITERS) == set(SAVED)
    assert main_exit(["identify", "--help"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert " ".join(RECORDS) in told and " ".join(FRFS) in told
    table = (pathlib.Path(__file__).parents[2] / "notebooks" / "files.md").read_text()
    for what, known in (("records", RECORDS), ("FRFs", FRFS)):
        row = next(line for line in table.splitlines() if line.startswith(f"| {what} |"))
        assert {".nc", ".mat"} < set(re.findall(r"\.\w+", row.split("|")[2])) <= set(known), what


def test_help_tells_exit_codes_and_results_what_is_next(tmp_path, capsys):
    assert main_exit(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(re.search(rf"^  {code} ", out, re.MULTILINE) for code in (0, 1, 2, 130, 143))
    page = (pathlib.Path(__file__).parents[2] / "notebooks" / "command_line.md").read_text()
    assert all(f"\n| {code} | " in page for code in (0, 1, 2, 130, 143))
    assert main(["example", "--blocks", "1", "-o", str(tmp_path / "run.npz")]) == 0
    *_, last = capsys.readouterr().out.splitlines()
    assert last == f"next: jaxfrf estimate {tmp_path / 'run.npz'} -o frf.npz --report frf.html"


@pytest.mark.parametrize(
    ("command", "last"),
    [
        (
            "distortion run.npz --method h1",
            "--plot levels.png shows the levels; -o frf.nc keeps the FRF with its total level",
        ),
        ("distortion run.npz --method h1 -o frf.npz", "jaxfrf view frf.npz"),
        ("estimate run.npz --method h1 --each --plot .png -o all", "look at all/index.html"),
        ("estimate run.npz bad.npz --method h1 --each -o all", "look at all/index.html; where files failed, mend"),
        ("estimate run.npz --method h1 -o frf.npz", "jaxfrf view frf.npz"),
        ("view frf.npz", "jaxfrf modal frf.npz -o modes.json"),
        ("view frf.npz -o page.html", "open page.html in a browser"),
    ],
)
def test_what_is_next(command, last, data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda address: True)
    pathlib.Path("bad.npz").write_text("nothing")
    jf.io.write_frf("frf.npz", jf.estimate(jf.example(blocks=1), jf.H1()))
    assert main(command.split()) == ("bad.npz" in command)
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"next: {last}")


def test_example_writes_the_robot_that_it_simulates(tmp_path, capsys):
    """A file to go on with; its guesses replaced by what it says was simulated, its FRF is the example's."""
    run, path = tmp_path / "run.nc", tmp_path / "robot.toml"
    assert main(["example", "--blocks", "1", "-o", str(run), "--robot-out", str(path)]) == 0
    *_, last = capsys.readouterr().out.splitlines()
    assert last.endswith(f"; jaxfrf identify {run} --robot {path} -o fit.json --report fit.html")
    robot, data = jf.io.read_robot(path), jf.io.read(run)
    said = re.findall(r"[\d.]+e-?\d|\d+(?= and)|\d+(?= N m s)", " ".join(path.read_text().split("\n")[2:4]))
    names = ("stiffness", "damping", "viscous_friction")
    told = dict(zip((f"{axis}.{name}" for name in names for axis in robot.axis_names), map(float, said), strict=True))
    assert told["shoulder.stiffness"] == 1.8e5 and told["elbow.damping"] == 60
    robot = jf.robot.with_parameters(robot, told)
    model = jf.robot.linearise(robot, jf.robot.operating_point(robot, data.q))
    f = np.linspace(2.0, 60.0, 59)
    G = jf.robot.frf(model, f, "velocity", jf.robot.ZeroOrderHold(robot.sampling_frequency))
    truth = jf.example_response(f)
    np.testing.assert_allclose(G, truth, atol=1e-4 * np.abs(truth).max())
    assert main(["example", "-o", str(tmp_path / "other.nc"), "--robot-out", str(tmp_path / "robot.xml")]) == 2
    assert not (tmp_path / "other.nc").exists()


def test_results_in_the_place_of_a_record_or_an_frf(tmp_path, capsys):
    G = np.ones((1, 3, 1, 1), complex)
    frf = jf.FRF(G, np.arange(1.0, 4.0), G + 0, np.ones((1, 3)), np.zeros((1, 3), int), np.ones((1, 3)))
    for name in ("frf.npz", "frf.nc"):
        jf.io.write_frf(tmp_path / name, frf)
        assert estimate(tmp_path / name, "-o", tmp_path / "out.nc") == 2
        error = capsys.readouterr().err
        assert re.search(rf"{name}: found an FRF; .* jaxfrf view .*{name}\. .*: jaxfrf identify .*{name}\.", error), (
            error
        )


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("estimate a.npz -o b.nc --scale y=2", r"--scale: found a name of before; .* Write --factor y=2\."),
        (
            "positions r.toml d.toml -o p.csv --noise 0.1",
            r"--noise: found a name of before; .* --relative-noise 0\.1",
        ),
        ("positions r.toml d.toml -o p.csv --count 7", r"--count: found a name of before; .* Write --positions 7\."),
    ],
)
def test_names_of_before(command, says, capsys):
    with pytest.raises(SystemExit):
        main(command.split())
    assert re.search(says, capsys.readouterr().err)


def test_view_of_what_it_cannot_show(tmp_path, capsys):
    """Files of earlier versions, other JSON, a result beside other files."""
    for text, says in (
        ('{"verdict": "named", "parameters": {}}', "a.json: found JSON without effects, ranking, where and gap"),
        ('{"parameters": {}, "kind": "direct"}', "a.json: .*found no .*; expected what `jaxfrf identify --springs`"),
        ('{"parameters": {}, "kind": "whole robot"}', "a.json: .*found no .*; expected what `jaxfrf identify`"),
        ('{"parameters": 3, "kind": "whole robot", "sources": []}', "a.json: .*found "),
        ("3", "found JSON of something else; expected an FRF"),
        ("{", "found JSON of something else; expected an FRF"),
    ):
        (tmp_path / "a.json").write_text(text)
        assert main(["view", str(tmp_path / "a.json"), "-o", str(tmp_path / "a.html")]) == 2
        error = capsys.readouterr().err
        assert re.search(says, error) and error.count("\n") == 1, error
    assert main(["view", str(tmp_path / "a.json"), *[str(tmp_path / "a.json")] * 2]) == 2
    assert "found a result beside 2 other files; expected FRFs, or one result" in capsys.readouterr().err
    assert not (tmp_path / "a.html").exists()


def test_the_shell_completes_commands_and_options(tmp_path):
    """As argcomplete asks: the line so far in the environment, the answers in a file."""
    pytest.importorskip("argcomplete", reason="argcomplete is not installed: pip install 'jaxfrf[completion]'")
    for line, expected in {
        "jaxfrf est": "estimate",
        "jaxfrf estimate --rep": "--report",
        "jaxfrf estimate --method robu": "robust",
    }.items():
        answers = tmp_path / "answers"
        asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": "bash"}
        asked |= {"_ARGCOMPLETE_STDOUT_FILENAME": str(answers), "COMP_TYPE": "9", "_ARGCOMPLETE_IFS": "\n"}
        subprocess.run([sys.executable, "-m", "jaxfrf"], env=os.environ | asked, check=True, timeout=60)
        assert expected in answers.read_text()


def test_as_a_program(tmp_path):
    """`python -m jaxfrf`: the exit code and the streams of a fresh process, and no traceback when the reader leaves."""
    program = [sys.executable, "-m", "jaxfrf"]
    environment = os.environ | {"PYTHONPATH": str(pathlib.Path(jf.__file__).parents[1])}

    def run(*arguments, **more):
        return subprocess.run(
            [*program, *arguments], capture_output=True, text=True, timeout=200, env=environment | more
        )

    missing = run("estimate", str(tmp_path / "no.nc"), "-o", str(tmp_path / "frf.nc"))
    assert missing.returncode == 2 and missing.stdout == "" and missing.stderr.count("\n") == 1
    assert "no.nc: found no such file" in missing.stderr
    (tmp_path / "it.nc").write_bytes(b"x")
    single = run("estimate", str(tmp_path / "it.nc"), "-o", str(tmp_path / "frf.nc"), JAX_ENABLE_X64="0")
    assert single.returncode == 2 and "needs 64-bit numbers" in single.stderr and "Traceback" not in single.stderr
    reader, writer = os.pipe()
    os.close(reader)
    gone = subprocess.run([*program], stdout=writer, stderr=subprocess.PIPE, text=True, timeout=200, env=environment)
    os.close(writer)
    assert "Traceback" not in gone.stderr


# --- bad input


def _nan(arrays):
    arrays["y"][0, 1, 17, 1] = np.nan


def _inf(arrays):
    arrays["u"][0, 0, 3, 0] = np.inf


def _part_of_a_period(arrays):
    for name in "ruy":
        arrays[name] = arrays[name][:, :, :-7]


def _unequal(arrays):
    arrays["y"] = arrays["y"][:, :, :PERIOD]


def _swapped(arrays):
    arrays["u"] = arrays["u"][0, 0].T


def _complex(arrays):
    arrays["u"] = np.fft.fft(arrays["u"], axis=2)


def _text(arrays):
    arrays["y"] = arrays["y"].astype(str)


def _one_experiment(arrays):
    for name in "ruy":
        arrays[name] = arrays[name][:, :1]


def _copied_input(arrays):
    arrays["u"][..., 1] = arrays["u"][..., 0]


def _repeated_experiment(arrays):
    for name in "ruy":
        arrays[name] = np.repeat(arrays[name][:, :1], 4, axis=1)


def _no_reference(arrays):
    del arrays["r"]


def _four_outputs(arrays):
    arrays["y"] = np.concatenate([arrays["y"], arrays["y"]], axis=-1)


def _no_u(arrays):
    arrays["torque"] = arrays.pop("u")


def _silent(arrays):
    for name in "ruy":
        arrays[name][:] = 0.0


TRANSIENT = ["--method", "lpm", "--option", "transient=2"]

BAD = {
    "NaN": (_nan, {}, [], r"y: found 1 NaN or Inf .* experiment 1, sample 17, channel 1"),
    "Inf": (_inf, {}, [], r"u: found 1 NaN or Inf .* experiment 0, sample 3, channel 0"),
    "part of a period": (_part_of_a_period, {}, [], r"period: found 793 samples, 1\.98\d periods of 400"),
    "unequal lengths": (_unequal, {}, [], r"y and u: found .*400.*800"),
    "swapped axes": (_swapped, {}, [], r"u: found .*2 samples .*axes look swapped"),
    "negative fs": (None, {"fs": -1.0}, [], r"fs: found -1; expected a positive number"),
    "fs against the time vector": (None, {"t": np.arange(800) / 100}, [], r"fs: found 200 Hz against 100 Hz"),
    "no fs": (None, {"fs": None}, [], r"fs: found neither fs nor a time vector; expected the sampling freq"),
    "wrong period": (None, {"period": 399}, [], r"period: found 800 samples, 2\.0\d* periods of 399"),
    "no period": (None, {"period": 0}, ["--method", "h1"], r"period: found 0: the record does not say .*transient"),
    "all transient": (None, {"transient_periods": 2}, [], r"transient_periods: found 2 of 2"),
    "too few experiments": (_one_experiment, {}, ["--method", "h1"], r"experiments: found 1 .*at least 2.*local"),
    "rank-deficient excitation": (_copied_input, {}, [], r"u: found 2 inputs of which only 1 .*independent"),
    "repeated experiment": (_repeated_experiment, {}, ["--method", "h1"], r"experiments: found that all 4 .*same"),
    "other lines": (None, {"lines": np.arange(6, 101, 2)}, [], r"r: found no power in channel \d at 48 of the 48"),
    "a line without power": (None, {"lines": [5, 7, 8, 9]}, [], r"at 1 of the 4 .* line 8 \(4 Hz\)"),
    "no power anywhere": (_silent, {"lines": None}, [], r"r: found no power at any line"),
    "complex data": (_complex, {}, [], r"u: found complex numbers; expected real"),
    "text": (_text, {}, [], r"y: found text; expected real numbers"),
    "lines above half the rate": (None, {"lines": [5, 300]}, [], r"lines: found 5 to 300; expected .* 1 and 199"),
    "no reference": (_no_reference, {}, ["--method", "jio"], r"r: found no reference.*--map r="),
    "more outputs": (_four_outputs, {}, ["--method", "log"], r"LOG: found 4 outputs and 2 inputs"),
    "missing variable": (_no_u, {}, [], r"u.*torque"),
    "unknown method": (None, {}, ["--method", "lrm"], r"method: found 'lrm'; expected one of auto, h1, "),
    "unknown option": (None, {}, ["--method", "lpm", "--option", "windth=9"], r"found windth; .*order, .*width"),
    "option without options": (None, {}, ["--method", "h1", "--option", "order=2"], r"expected no options"),
    "option without a value": (None, {}, ["--option", "order"], r"--option: found 'order'; expected KEY=VALUE"),
    "option of another type": (None, {}, ["--method", "lpm", "--option", "order=two"], r"found 'two'; expected int"),
    "option out of range": (None, {}, ["--method", "lpm", "--option", "order=-1"], r"order: found -1"),
    "a method as an option": (None, {}, ["--method", "log", "--option", "method=lpm"], r"found method; .*elementwise"),
    "narrow window": (_one_experiment, {}, ["--method", "lrm-mimo", "--option", "width=9"], r"9 lines .*at least 10"),
    "wide window": (None, {}, ["--method", "lrm-mimo", "--option", "width=99"], r"99 lines; expected at most the 48"),
    "no such periods": (None, {}, ["--periods", "4:6"], r"periods: found 4:6; .*2 steady periods"),
    "periods of no number": (None, {}, ["--periods", "one"], r"--periods: found 'one'; expected FROM:TO"),
    "periods of none": (None, {"period": 0}, [*TRANSIENT, "--periods", "0:1"], r"period: found 0 \(not periodic\)"),
    "band of no number": (None, {}, ["--band", "4-80"], r"--band: found '4-80'; expected FROM:TO"),
    "empty band": (None, {}, ["--band", "60:80"], r"band: found no excited line between 60 and 80 Hz"),
    "wrong --map": (None, {}, ["--map", "v=torque"], r"--map: found the unknown name 'v'"),
    "wrong --set": (None, {}, ["--set", "fs=fast"], r"--set fs: found 'fast'; expected a number"),
    "wrong --factor": (None, {}, ["--factor", "y=0"], r"--factor y: found '0'; expected finite factors"),
    "unknown picture": (None, {}, ["--plot", "bode.xyz"], r"bode\.xyz: found the suffix '\.xyz'; .*\.png"),
    "picture in no folder": (None, {}, ["--plot", "no/such/bode.png"], r"bode\.png: found no folder no/such"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input(tmp_path, capsys, output, case):
    spoil, fields, arguments, says = BAD[case]
    arrays, _ = record()
    if spoil is not None:
        spoil(arrays)
    message = refused(capsys, output, write(tmp_path / "run.npz", arrays, **fields), *arguments)
    assert re.search(says, message), message
    if spoil is not None or fields:
        assert "run.npz" in message, "the message does not name the file"


def _empty(path):
    path.write_bytes(b"")


def _truncated(path):
    write(path, record()[0])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _pickled(path):
    np.savez(path, u=np.array([{"a": 1}], dtype=object), y=np.zeros((800, 1)), fs=FS)


def _missing(path):
    pass


def _other(path):
    path.write_text("time,u,y\n0,1,2\n")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (_empty, r"run\.npz: found an empty file"),
        (_truncated, r"run\.npz: found .*cannot be read .*truncated"),
        (_pickled, r"run\.npz: u: found .*pickle"),
        (_missing, r"run\.npz: found no such file"),
        (_other, r"run\.npz: found .*cannot be read"),
    ],
)
def test_bad_files(tmp_path, capsys, output, make, says):
    make(tmp_path / "run.npz")
    message = refused(capsys, output, tmp_path / "run.npz")
    assert re.search(says, message), message


def test_files_that_do_not_fit_together(tmp_path, capsys, output, data):
    other = write(tmp_path / "other.npz", record()[0], fs=2 * FS)
    message = refused(capsys, output, data, other)
    assert "other.npz: fs: found 400" in message and "expected 200" in message


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("frf.h5", r"found the suffix '\.h5'; expected one of \.nc, \.mat, \.npz, \.zarr, \.uff"),
        ("no/frf.nc", r"found no folder"),
    ],
)
def test_bad_targets(tmp_path, capsys, data, target, says):
    assert re.search(says, refused(capsys, str(tmp_path / "out" / target), data))


def test_the_measurement_is_never_overwritten(tmp_path, capsys, data):
    before = pathlib.Path(data).read_bytes()
    same = tmp_path / "sub" / ".." / "run.npz"
    (tmp_path / "sub").mkdir()
    assert estimate(data, "-o", same) == 2
    assert "the measurement itself" in capsys.readouterr().err
    assert pathlib.Path(data).read_bytes() == before


def test_suspicious_input_is_estimated_and_remarked(tmp_path, capsys):
    """A dead output: usable, with a warning that names file, channel and place, in the result too."""
    arrays, _ = record()
    arrays["y"][..., 1] = 0.25
    data = write(tmp_path / "run.npz", arrays)
    assert estimate(data, "-o", tmp_path / "frf.npz", "--method", "h1") == 0
    warned = re.search(r"warning: (.*run\.npz: y: channel 1 is constant .*)", capsys.readouterr().err)
    assert warned[1] in jf.io.read_frf(tmp_path / "frf.npz").warnings


# --- interrupted and resumed


def positions(tmp_path, n_pos=4, name="run.npz", **options):
    arrays, _ = record(n_pos=n_pos, **options)
    return write(tmp_path / name, arrays, q=np.arange(n_pos * 2.0).reshape(n_pos, 2))


class Interrupt:
    """Stands in for `estimate` of one position: counts the calls, and is interrupted at call number `at`."""

    def __init__(self, monkeypatch, at=None):
        from jaxfrf.batch import estimated

        self.real, self.at, self.calls = jf.estimate, at, 0
        monkeypatch.setattr(estimated, "estimate", self)

    def __call__(self, spectra, method):
        self.calls += 1
        if self.calls == self.at:
            raise KeyboardInterrupt
        return self.real(spectra, method)


def assert_same_file(one, two):
    one, two = jf.io.read_frf(one), jf.io.read_frf(two)
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(two, field.name)
        np.testing.assert_array_equal(a, b, err_msg=field.name)


def interrupted(tmp_path, monkeypatch, capsys, data, *arguments, at=3):
    with monkeypatch.context() as patch:
        Interrupt(patch, at)
        assert estimate(data, "-o", tmp_path / "frf.npz", *arguments) == 130
    assert "--resume" in capsys.readouterr().err
    assert not (tmp_path / "frf.npz").exists() and (tmp_path / "frf.npz.parts").is_dir()


@pytest.mark.parametrize("method", ["h1", pytest.param("lrm-mimo", marks=pytest.mark.slow)])
def test_resume(tmp_path, monkeypatch, capsys, method):
    data = positions(tmp_path)
    assert estimate(data, "-o", tmp_path / "whole.npz", "--method", method) == 0
    interrupted(tmp_path, monkeypatch, capsys, data, "--method", method)
    counted = Interrupt(monkeypatch)
    assert estimate(data, "-o", tmp_path / "frf.npz", "--method", method, "--resume") == 0
    assert counted.calls == 2  # two of the four were finished
    assert_same_file(tmp_path / "frf.npz", tmp_path / "whole.npz")
    assert not (tmp_path / "frf.npz.parts").exists()


def test_interrupted_twice(tmp_path, monkeypatch, capsys):
    data = positions(tmp_path)
    interrupted(tmp_path, monkeypatch, capsys, data, "--method", "h1", at=2)
    interrupted(tmp_path, monkeypatch, capsys, data, "--method", "h1", "--resume", at=2)
    counted = Interrupt(monkeypatch)
    assert estimate(data, "-o", tmp_path / "frf.npz", "--method", "h1", "--resume") == 0
    assert counted.calls == 2


def test_bad_input_at_a_later_position_leaves_nothing(tmp_path, capsys, output):
    """The inputs are copies of each other at the last position only, which shows when it is estimated."""
    arrays, _ = record(n_pos=3)
    arrays["u"][2, ..., 1] = arrays["u"][2, ..., 0]
    message = refused(capsys, output, write(tmp_path / "run.npz", arrays), "--method", "lpm-stacked")
    assert "only 1 are independent" in message


def test_a_folder_of_someone_else_is_left_alone(tmp_path, capsys):
    kept = tmp_path / "frf.npz.parts" / "precious.txt"
    kept.parent.mkdir()
    kept.write_text("mine")
    assert estimate(positions(tmp_path), "-o", tmp_path / "frf.npz", "--method", "h1") == 2
    assert "frf.npz.parts" in capsys.readouterr().err and kept.read_text() == "mine"


# --- excite

DESIGN = """
fs = 200.0
period = 400
inputs = 2
blocks = 2
periods = 2
transient_periods = 1
seed = 3
[lines]
grid = "odd"
band = [2.0, 50.0]
[multisine]
rms = [1.0, 2.0]
[slow_sine]
lines = [1, 2]
amplitude = [3.0, 4.0]
"""


@pytest.fixture
def design(tmp_path):
    (tmp_path / "design.toml").write_text(DESIGN)
    return str(tmp_path / "design.toml")


@pytest.mark.parametrize("suffix", ["nc", "mat"])
def test_excite(tmp_path, capsys, design, suffix):
    target = tmp_path / f"reference.{suffix}"
    assert main(["excite", design, "-o", str(target)]) == 0
    out = capsys.readouterr().out
    assert "4 experiments of 2 inputs, 6 s each; 48 lines from 2.5 to 49.5 Hz" in out
    assert "the reference begins with a step" in out and "ramp = 2.0" in out
    assert f"wrote {target}, {tmp_path / 'reference.png'}" in out
    assert (tmp_path / "reference.png").read_bytes().startswith(b"\x89PNG")
    r = jf.io.read_reference(target).r
    assert r.shape == (4, 1200, 2)
    power = 2 * np.abs(np.fft.rfft(r[:, 400:800], axis=1)[:, 5:100:2] / 400) ** 2
    np.testing.assert_allclose(power.sum(axis=1), [[1.0, 4.0]] * 4, rtol=1e-9)  # rms squared, of every experiment
    if suffix == "mat":
        np.testing.assert_allclose(scipy.io.loadmat(target)["r"], r)


def test_excite_tables(tmp_path, design):
    picture = tmp_path / "p.pdf"
    assert main(["excite", design, "-o", str(tmp_path / "reference.csv"), "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"%PDF")
    tables = sorted(tmp_path.glob("reference_0?.csv"))
    assert len(tables) == 4 and not (tmp_path / "reference.png").exists()
    rows = np.loadtxt(tables[0], delimiter=",", skiprows=1)
    assert rows.shape == (1200, 5) and tables[0].read_text().startswith("time,velocity1,velocity2,position1,position2")
    # The position reference is the integral of the speed reference, in whole periods.
    t = rows[400:800]
    omega = 2 * np.pi * np.arange(1, 200) * 0.5
    speed, position = (np.fft.rfft(t[:, i], axis=0)[1:200] for i in ([1, 2], [3, 4]))
    np.testing.assert_allclose(1j * omega[:, None] * position, speed, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "text", "more", "says"),
    [
        ("design.toml", DESIGN.replace("fs = 200.0", "fs = -2"), [], r"design\.toml: fs: found -2"),
        ("design.toml", DESIGN + "[lime]\n", [], r"design\.toml: .*'lime'.*Did you mean 'lines'"),
        ("design.toml", "fs = ", [], r"design\.toml: found no valid TOML"),
        ("other.toml", DESIGN, [], r"design\.toml: found no such file"),
        ("design.toml", DESIGN, ["--plot", "a.xyz"], r"a\.xyz: found the suffix"),
        ("design.toml", DESIGN, ["-o", "a.txt"], r"a\.txt: found the suffix"),
    ],
)
def test_excite_refuses(tmp_path, capsys, name, text, more, says):
    (tmp_path / name).write_text(text)
    (tmp_path / "out").mkdir()
    target = tmp_path / "out" / "reference.nc"
    assert main(["excite", str(tmp_path / "design.toml"), "-o", str(target), *more]) == 2
    out, error = capsys.readouterr()
    assert out == "" and re.search(says, error), error
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["-o", "a.h5"], r"a\.h5"),
        (["-o", "no/such/a.nc"], r"no folder"),
        (["-o", "a.nc", "--blocks", "0"], r"blocks: found 0"),
    ],
)
def test_example_refuses(tmp_path, monkeypatch, capsys, arguments, says):
    monkeypatch.chdir(tmp_path)
    assert main(["example", *arguments]) == 2
    assert re.search(says, capsys.readouterr().err) and list(tmp_path.iterdir()) == []


def test_positions_are_chosen_among_those_of_a_file(tmp_path, capsys):
    """What is chosen are rows of the file; a file of another robot, and none, are refused."""
    main(["example", "-o", str(tmp_path / "run.nc"), "--robot-out", str(tmp_path / "robot.toml")])
    (tmp_path / "design.toml").write_text(
        'fs = 500.0\nperiod = 1000\ninputs = 2\nblocks = 1\n[lines]\ngrid = "log-odd"\nband = [3.5, 60.0]\npoints = 9\n'
        "[multisine]\nrms = [4.0, 4.0]\n"
    )
    free = np.array([[0.1, 0.2], [0.5, -1.0], [-0.4, 0.9], [0.0, 1.2]])
    np.savetxt(tmp_path / "free.csv", free, delimiter=",")
    (tmp_path / "six.csv").write_text("0,0,0,0,0,0\n")
    words = ["positions", *(str(tmp_path / name) for name in ("robot.toml", "design.toml")), "-n", "2"]
    capsys.readouterr()
    assert main([*words, "--candidates", str(tmp_path / "free.csv"), "-o", str(tmp_path / "q.csv")]) == 0
    out = capsys.readouterr().out
    assert "2 of 4 positions (from " in out and "nothing here knows joint limits" in out
    chosen = np.loadtxt(tmp_path / "q.csv", delimiter=",")
    assert chosen.shape == (2, 2) and all(any(np.allclose(q, x) for x in free) for q in chosen)
    refused = {"six.csv": "found numbers of shape (1, 6)", "none.csv": "no such file", "0": "1 to 100000"}
    for wrong, says in refused.items():
        other = wrong if wrong == "0" else str(tmp_path / wrong)
        assert main([*words, "--candidates", other, "-o", str(tmp_path / "other.csv")]) == 2
        assert says in capsys.readouterr().err and not (tmp_path / "other.csv").exists()


def test_what_files_have_in_common_is_said_once(capsys):
    """In the order in which it was said first; twice the same is once, and two files are named."""
    converted = [f"log{i}.csv: y: converted" for i in range(4)]
    warn([converted[0], "log0.csv: u: clipped", *converted, "log1.csv: u: clipped", "G: of no file: at all"])
    assert capsys.readouterr().err.splitlines() == [
        "warning: log0.csv and 3 other files: y: converted",
        "warning: log0.csv: u: clipped",
        "warning: log1.csv: u: clipped",
        "warning: G: of no file: at all",
    ]
