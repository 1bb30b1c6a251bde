"""`jaxfrf identify`: what is found, what is written, going on after an interruption, and what is refused."""

import dataclasses
import html.parser
import json
import pathlib
import re

import jax.random as jr
import numpy as np
import pytest
from book_tables import keys, told
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.identification import identify_springs, robot_model
from jaxfrf.io.fits import read_fit, write_fit
from jaxfrf.io.frf_or_record import holds_frf, read_frfs
from jaxfrf.io.robots import read_robot
from jaxfrf.parts import Parts

TRUTH = {"shoulder.stiffness": 2e4, "elbow.stiffness": 8e3, "shoulder.damping": 25.0, "elbow.damping": 8.0}
BEGIN = {"shoulder.stiffness": 2.6e4, "elbow.stiffness": 6.5e3, "shoulder.damping": 25.0, "elbow.damping": 12.0}
FREQUENCY = np.arange(3.0, 60.0, 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A robot, another one to start from, a record of the first, and its exact FRF with a covariance."""
    where = tmp_path_factory.mktemp("identify")
    (where / "true.toml").write_text(ROBOT)
    robot = read_robot(where / "true.toml")
    jf.io.write_robot(where / "start.toml", jf.robot.with_parameters(robot, BEGIN))
    slow = jf.SlowSine([1, 2], [25.0, 25.0])
    design = jf.Multisine(500.0, 1000, np.arange(7, 121, 2), rms=np.array([4.0, 4.0]), slow=slow, blocks=2)
    positions = jf.random_positions(3, jr.key(0), 2)
    data = jf.simulate(robot, design, positions, key=jr.key(1), noise=2e-5)
    jf.io.write(where / "run.npz", data)
    model = jf.RobotModel(robot, quantity="velocity")
    values = {n: float(p.start) for n, p in model.parameters.items()}
    G = np.stack([model.response(FREQUENCY, values, q) for q in positions])
    frf = jf.io.frf_from_arrays(G, FREQUENCY, q=positions)
    variance = (0.01 * np.abs(G.swapaxes(-1, -2).reshape(*G.shape[:2], 4))) ** 2
    frf = dataclasses.replace(frf, cov=variance[..., None] * np.eye(4) + 0j, dof=np.full_like(frf.dof, 40.0))
    jf.io.write_frf(where / "frf.npz", frf)
    return where


def run(folder, *arguments, out="fit.json"):
    return main(
        ["identify", "--springs", *(str(x) for x in arguments), "--robot", str(folder / "start.toml"), "-o", str(out)]
    )


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    """The command with everything that it writes."""
    out = tmp_path_factory.mktemp("out")
    more = ("--report", out / "fit.html", "--plot", out / "fit.png", "--robot-out", out / "found.toml")
    code = run(folder, folder / "run.npz", "--starts", 3, "--heldout", 2, *more, out=out / "fit.json")
    assert code == 0
    return out


def strict(path):
    """JSON as other programs read it: no NaN."""

    def refuse(name):
        raise AssertionError(f"{name} in {path}")

    return json.loads(pathlib.Path(path).read_text(), parse_constant=refuse)


@pytest.mark.slow
class TestIndirect:
    def test_parameters(self, whole):
        found = strict(whole / "fit.json")
        assert found["kind"] == "indirect" and found["why_direct"] == ""
        for name, value in TRUTH.items():
            p = found["parameters"][name]
            assert abs(p["value"] - value) < 2 * p["std"], name
            assert p["interval95"][0] < value < p["interval95"][1]
            assert p["identifiable"] and p["start"] == pytest.approx(BEGIN[name])
        assert found["parameters"]["elbow.stiffness"]["unit"] == "N m/rad"
        assert found["parameters"]["elbow.effective_friction"]["nuisance"]
        assert found["fixed"]["elbow.delay"] == 0.0

    def test_the_rest(self, whole):
        """Verdict, starts, rounds, held-out position and provenance."""
        found = strict(whole / "fit.json")
        assert (found["result"], found["converged"]) == ("unimodal", True)
        assert (
            found["starts"]["number"] == 3 == len(found["starts"]["paths"]) and found["starts"]["within_1_percent"] == 3
        )
        gaps = [r["gap_db"] for r in found["rounds"]]
        assert gaps[-1] < 0.1 * gaps[0]
        assert set(found["rounds"][0]["parameters"]) == set(found["parameters"])
        # A position that was not fitted: the simulation is as good there, the linear model as bad.
        held = found["heldout"]
        assert held["positions"] == [2] and held["rms_db"][0] < 0.02 < found["direct"]["heldout"]["rms_db"][0]
        assert found["frf"]["positions"] == [0, 1] and found["settings"]["heldout"] == [2]
        assert [s["name"] for s in found["sources"]] == ["run.npz"] and len(found["sources"][0]["sha256"]) == 64
        assert found["version"] == jf.__version__ and found["settings"]["seed"] == 0
        assert read_fit(whole / "fit.json") == found
        told_of = keys(found, but=("parameters", "fixed", "chi_square", "settings", "heldout", "worst"))
        assert told_of | set(next(iter(found["parameters"].values()))) <= told("files.md", "fit.json")

    def test_robot(self, whole, folder):
        """The robot with the result: everything else as it was at the start."""
        robot, start = read_robot(whole / "found.toml"), read_robot(folder / "start.toml")
        values = strict(whole / "fit.json")["parameters"]
        for name, value in jf.robot.parameters(robot).items():
            assert float(value) == pytest.approx(values[name]["value"], rel=1e-12)
        kinds = ("gear_ratio", "motor_inertia", "coulomb_friction", "mass")
        assert jf.robot.parameters(robot, kinds) == jf.robot.parameters(start, kinds)

    def test_page(self, whole):
        """Self-contained, well formed, and with every parameter in it."""
        text = (whole / "fit.html").read_text()
        assert not re.search(r"(src|href)=\"(?!data:)|url\(|@import|<script", text)
        checker = Balanced()
        checker.feed(text)
        assert checker.open == [] and checker.ids == len(set(checker.seen))
        for name in TRUTH:
            assert f"<td>{name}</td>" in text
        assert "two axes: identified parameters" in text and "position 1" in text and "Unimodal" in text
        assert (whole / "fit.png").read_bytes().startswith(b"\x89PNG")

    def test_nothing_else_is_left(self, whole):
        assert {p.name for p in whole.iterdir()} == {"fit.json", "fit.html", "fit.png", "found.toml"}

    def test_goes_on(self, folder, whole, tmp_path, capsys):
        """Interrupted after a round, `--resume` simulates only what is missing, and comes to the same end."""
        out, arguments = tmp_path / "fit.json", (folder / "run.npz", "--starts", 3, "--heldout", 2)
        said = []

        def interrupt(text):
            said.append(text)
            if text.startswith("round 1"):
                raise KeyboardInterrupt

        robot, data = read_robot(folder / "start.toml"), jf.io.read(folder / "run.npz")
        with pytest.raises(KeyboardInterrupt) as stopped, Parts(out, "identify") as kept:
            identify_springs(robot, data, starts=3, heldout=[2], parts=kept, say=interrupt)
        parts = kept.folder
        assert kept.finished == ["00000.json"] and not out.exists()
        assert "--resume" in stopped.value.__notes__[0]
        assert run(folder, *arguments, "--resume", out=out) == 0
        says = capsys.readouterr().err
        assert "1 finished part taken over" in says and "round 1:" not in says
        first, second = strict(whole / "fit.json"), strict(out)
        for name, p in first["parameters"].items():
            assert abs(p["value"] - second["parameters"][name]["value"]) < 0.1 * p["std"], name
        assert first["rounds"][0] == second["rounds"][0]
        assert not parts.exists()


class Balanced(html.parser.HTMLParser):
    """Every tag that is opened is closed, in order."""

    VOID = ("meta", "img", "input", "br")

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], []

    @property
    def ids(self):
        return len(self.seen)

    def handle_starttag(self, tag, attrs):
        self.seen += [value for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


class TestDirect:
    @pytest.mark.slow
    def test_exact_frf(self, folder, tmp_path, capsys):
        """The model's own response: the truth comes back, and the summary says why nothing was simulated."""
        assert run(folder, folder / "frf.npz", "--starts", 2, "--json", out=tmp_path / "fit.json") == 0
        printed = json.loads(capsys.readouterr().out)
        assert printed["kind"] == "direct" and "FRFs do not hold the references" in printed["why_direct"]
        found = strict(tmp_path / "fit.json")
        for name, value in TRUTH.items():
            assert found["parameters"][name]["value"] == pytest.approx(value, rel=1e-5)
        assert found["cost"] < 1e-8 and found["rounds"] == [] and found["heldout"] is None
        assert printed["parameters"] == found["parameters"] and "paths" not in printed["starts"]

    def test_held_fixed_and_shared(self, folder):
        robot, frf = read_robot(folder / "start.toml"), jf.io.read_frf(folder / "frf.npz")
        names = {
            "fixed": ["shoulder.*"],
            "freed": ["shoulder.stiffness"],
            "shared": [["shoulder.damping", "elbow.damping"]],
        }
        model = robot_model(robot, frf, **names)
        assert not model.parameters["shoulder.stiffness"].free  # what is fixed stays so
        assert model.parameters["elbow.damping"].same_as == "shoulder.damping"
        assert model.quantity == "velocity"

    def test_several_files(self, folder, tmp_path):
        frf = jf.io.read_frf(folder / "frf.npz")
        rows = ("G", "cov", "dof", "status", "window", "q")
        for k in range(2):
            part = dataclasses.replace(frf, **{n: np.asarray(getattr(frf, n))[[k]] for n in rows})
            jf.io.write_frf(tmp_path / f"{k}.nc", part)
        both = read_frfs(tmp_path / "0.nc", tmp_path / "1.nc")
        np.testing.assert_array_equal(both.G, frf.G[:2])
        np.testing.assert_array_equal(both.q, frf.q[:2])
        assert holds_frf(tmp_path / "0.nc") and not holds_frf(folder / "run.npz") and not holds_frf("nowhere.npz")

    @pytest.mark.parametrize(
        ("change", "why"),
        [
            ({"r": None}, "the records hold no reference"),
            ({"period": 0, "lines": None}, "the records are not periodic"),
        ],
    )
    def test_why(self, folder, change, why):
        from jaxfrf.identification.model import why_direct

        data = jf.io.read(folder / "run.npz")
        data = jf.Experiment(**({f.name: getattr(data, f.name) for f in dataclasses.fields(data)} | change))
        robot = read_robot(folder / "true.toml")
        assert why_direct(robot, data, direct=False) == why
        assert "controller" in why_direct(
            dataclasses.replace(robot, controller=None), jf.io.read(folder / "run.npz"), False
        )


REFUSED = {
    "no folder": (["-o", "nowhere/fit.json"], r"nowhere/fit\.json: found no folder nowhere"),
    "suffix": (["-o", "fit.txt"], r"found the suffix '\.txt'; expected one of \.json"),
    "report": (["--report", "fit.pdf"], r"fit\.pdf: found the suffix '\.pdf'; expected one of \.html"),
    "name": (["--fix", "elbow.stifness"], r"parameter: found 'elbow\.stifness'.*Did you mean 'elbow\.stiffness'\?"),
    "share": (["--share", "elbow.damping"], r"--share: found 'elbow\.damping'; expected A=B"),
    "weights": (["--weights", "of_diagonal=1"], r"--weights: .*Did you mean 'off_diagonal'\?"),
    "weight": (["--weights", "floor=x"], r"--weights floor: found 'x'; expected a number"),
    "heldout": (["--heldout", "0,9"], r"heldout: found positions 0, 9 of 3; expected some of 0 to 2"),
    "all held": (["--heldout", "0,1,2"], r"heldout: found positions 0, 1, 2 of 3"),
    "no number": (["--heldout", "two"], r"--heldout: found 'two'; expected numbers"),
    "band": (["--band", "50:20"], r"band: found \(50.0, 20.0\); expected the lower and the upper end"),
    "not simulated": (["--free", "elbow.torque_gain"], r"parameters to fit: found elbow\.torque_gain"),
    "method": (["--method", "h3"], r"method: found 'h3'"),
    "starts": (["--starts", "0"], r"starts and rounds: found 0 and 12"),
}


class TestBadInput:
    """Exit code 2 and one message, before anything long begins."""

    @pytest.mark.parametrize("case", REFUSED)
    def test_refused(self, folder, tmp_path, monkeypatch, capsys, case):
        monkeypatch.chdir(tmp_path)
        more, message = REFUSED[case]
        self.refused(capsys, message, folder, str(folder / "run.npz"), *more)
        assert list(tmp_path.iterdir()) == []

    def refused(self, capsys, message, folder, *arguments, robot="start.toml"):
        code = main(["identify", "--springs", "-o", "fit.json", "--robot", str(folder / robot), *arguments])
        out, error = capsys.readouterr()
        assert code == 2 and out == "" and error.count("\n") == 1, error
        assert re.search(message, error), error

    def test_wrong_robot(self, folder, tmp_path, capsys):
        (tmp_path / "one.toml").write_text(re.sub(r"(?s)\[\[joint\]\]\nname = \"elbow\".*?(?=\[cont)", "", ROBOT))
        message = r"run\.npz: data and robot: found 2 outputs and 2 inputs with 1 driven joints"
        self.refused(capsys, message, folder, str(folder / "run.npz"), robot=tmp_path / "one.toml")
        (tmp_path / "fast.toml").write_text(ROBOT.replace("500.0", "1000.0"))
        message = r"fs of the record: found 500 Hz; expected 1000 Hz"
        self.refused(capsys, message, folder, str(folder / "run.npz"), robot=tmp_path / "fast.toml")

    def test_no_configuration(self, folder, tmp_path, capsys):
        frf = dataclasses.replace(jf.io.read_frf(folder / "frf.npz"), q=None)
        jf.io.write_frf(tmp_path / "bare.npz", frf)
        self.refused(capsys, r"bare\.npz: q of the data: found none", folder, str(tmp_path / "bare.npz"))

    def test_frf_and_record(self, folder, capsys):
        both = str(folder / "frf.npz"), str(folder / "run.npz")
        self.refused(capsys, r"files: found an FRF, .*frf\.npz, beside a record", folder, *both)
        self.refused(capsys, r"--method: found FRF files; expected records", folder, both[0], "--method", "h1")

    def test_missing_files(self, folder, tmp_path, capsys):
        self.refused(capsys, r"nowhere\.npz: found no such file", folder, str(tmp_path / "nowhere.npz"))
        self.refused(capsys, r"nobody\.toml: found no such file", folder, str(folder / "run.npz"), robot="nobody.toml")


class TestFitFiles:
    def test_what_is_not_finite_is_null(self, tmp_path):
        contents = {
            "parameters": {"a": np.float64("nan")},
            "x": np.array([1.0, np.inf]),
            "n": np.int64(3),
            "b": np.True_,
        }
        write_fit(tmp_path / "fit.json", contents)
        assert strict(tmp_path / "fit.json") == {"parameters": {"a": None}, "x": [1.0, None], "n": 3, "b": True}

    def test_a_kind_as_it_was_called_before(self, tmp_path):
        for kind, now in (("through the experiment", "indirect"), ("direct", "direct"), ("whole robot", "whole robot")):
            write_fit(tmp_path / "fit.json", {"parameters": {}, "kind": kind})
            assert read_fit(tmp_path / "fit.json") == {"parameters": {}, "kind": now}

    @pytest.mark.parametrize(
        ("text", "message"),
        [(None, "no such file"), ("{", "no JSON"), ("[1]", "JSON without parameters")],
    )
    def test_refused(self, tmp_path, text, message):
        if text is not None:
            (tmp_path / "fit.json").write_text(text)
        with pytest.raises(jf.InputError, match=rf"fit\.json: found {message}"):
            read_fit(tmp_path / "fit.json")
