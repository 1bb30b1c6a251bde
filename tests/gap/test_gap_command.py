"""`jaxfrf diagnose`: what it hands to the diagnosis and what it does with the result; the diagnosis is made up."""

import dataclasses
import json
import re

import numpy as np
import pytest
from book_tables import keys, told
from gap_examples import NAMES, OWN, example

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.cli.own_effects import own_effects
from jaxfrf.io.gaps import read_gap
from jaxfrf.report.gap_words import headline


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two records of a two-axis machine, R3X, and an effect of the user's own."""
    where = tmp_path_factory.mktemp("diagnose")
    rng = np.random.default_rng(0)
    for k, positions in enumerate((2, 1)):
        u, y, r = rng.standard_normal((3, positions, 2, 200, 2))
        jf.io.write(where / f"run{k}.npz", jf.Experiment(u, y, 500.0, 100, r=r, q=np.zeros((positions, 2))))
    jf.io.write_robot(where / "robot.toml", jf.robot.r3x())
    (where / "own.py").write_text(OWN)
    return where


class Diagnosing:
    """Stands for `jaxfrf.gap.diagnose`: remembers what it was given, returns an example."""

    def __init__(self, name="two", error=None):
        self.name, self.error, self.calls = name, error, []

    def __call__(self, robot, data, *, own, parts, say, progress, **more):
        self.calls.append({"robot": robot, "data": data, "own": own, "parts": parts, **more})
        self.found = parts.finished
        parts.path("round-0.json").write_text("{}")
        if say is not None:
            say("fitting the base")
            progress(0.5)
        if self.error is not None:
            raise self.error
        found = example(self.name)
        mine = [kind.typical(robot, "joint1") for kind in own]
        return dataclasses.replace(found, extended=found.extended.with_effects(*mine))

    @property
    def given(self):
        (call,) = self.calls
        return call


@pytest.fixture
def diagnosing(monkeypatch):
    import jaxfrf.gap

    fake = Diagnosing()
    monkeypatch.setattr(jaxfrf.gap, "diagnose", fake, raising=False)
    return fake


def run(folder, out, *arguments, data=("run0.npz", "run1.npz"), robot="robot.toml"):
    files = [str(folder / name) for name in data]
    return main(["diagnose", *files, "--robot", str(folder / robot), "-o", str(out), *(str(x) for x in arguments)])


class TestWhatIsHandedOver:
    def test_every_file_is_an_experiment(self, folder, tmp_path, diagnosing):
        assert run(folder, tmp_path / "gap.json") == 0
        given = diagnosing.given
        assert [x.u.shape for x in given["data"]] == [(2, 2, 200, 2), (1, 2, 200, 2)]
        assert [x.sources[0].name for x in given["data"]] == ["run0.npz", "run1.npz"]
        assert given["robot"].axis_names == jf.robot.r3x().axis_names
        assert given["own"] == () and "heldout_count" not in given

    def test_names_units_and_heldout_positions(self, folder, tmp_path, diagnosing):
        raw = np.load(folder / "run0.npz")
        np.savez(tmp_path / "log.npz", current=raw["u"], speed=raw["y"], wanted=raw["r"], rate=500.0)
        options = ["--map", "u=current,y=speed,r=wanted,fs=rate", "--set", "period=100", "--factor", "y=0.5"]
        more = ["--heldout-count", "1"]
        assert run(tmp_path, tmp_path / "gap.json", *options, *more, data=["log.npz"], robot=folder / "robot.toml") == 0
        (data,) = diagnosing.given["data"]
        np.testing.assert_array_equal(data.y, 0.5 * raw["y"])
        assert data.period == 100 and diagnosing.given["heldout_count"] == 1

    def test_a_record_in_two_files(self, folder, tmp_path, diagnosing):
        raw = np.load(folder / "run0.npz")
        for name in "uy":
            np.savez(tmp_path / f"{name}.npz", **{name: raw[name], "q": raw["q"]})
        more = ["--map", "u=u.npz:u,y=y.npz:y", "--set", "fs=500,period=100,y_quantity=velocity"]
        data = [str(tmp_path / f"{name}.npz") for name in "uy"]
        assert run(folder, tmp_path / "gap.json", *more, data=data) == 0
        (record,) = diagnosing.given["data"]
        np.testing.assert_array_equal(record.y, raw["y"])
        assert [x.name for x in record.sources] == ["u.npz", "y.npz"]

    def test_own_effects(self, folder, tmp_path, diagnosing):
        assert run(folder, tmp_path / "gap.json", "--effects", folder / "own.py") == 0
        (kind,) = diagnosing.given["own"]  # not the imported CoulombFriction
        assert kind.name == "quadratic_friction" and issubclass(kind, jf.effects.AbstractFriction)
        assert float(kind.typical(None, "joint1").torque(np.array(-2.0), 0.0)) == pytest.approx(-4e-5)


class TestWhatIsWritten:
    def test_everything(self, folder, tmp_path, capsys, diagnosing):
        more = ("--report", tmp_path / "gap.html", "--robot-out", tmp_path / "extended.toml")
        assert run(folder, tmp_path / "gap.json", *more) == 0
        assert sorted(p.name for p in tmp_path.iterdir()) == ["extended.toml", "gap.html", "gap.json"]
        assert read_gap(tmp_path / "gap.json")["effects"][0]["name"] == "payload"
        assert headline(example("two")) in (tmp_path / "gap.html").read_text()
        robot, extended = jf.io.read_robot(tmp_path / "extended.toml"), example("two").extended
        np.testing.assert_allclose(robot.chain.mass, extended.chain.mass, rtol=1e-12)
        assert [e.name for e in robot.effects] == ["torque_delay"]
        out, error = capsys.readouterr()
        assert out.splitlines()[0] == "named: Missing: payload and torque delay of joint2."
        assert "  payload: mass 1.420 ± 0.098 kg (95 %), p < 1e-6" in out
        assert "  torque_delay joint2: delay 0.360 ± 0.041 ms (95 %), p = 4e-5" in out
        assert "these data cannot tell it from current_loop_lag; A step of torque, or lines above 300 Hz." in out
        assert "gap on held-out positions 5 and 6: 3.9 before, 1.06 after, floor 1, torque residual (rms), over" in out
        assert "; 98 % of the reducible gap is gone" in out
        assert "next experiment: Weigh the tool" in out and out.splitlines()[-2].startswith("wrote ")
        assert "fitting" not in error  # nobody watches

    def test_the_book_tells_every_field(self, folder, tmp_path, diagnosing):
        assert run(folder, tmp_path / "gap.json") == 0
        found = read_gap(tmp_path / "gap.json")
        names = "parameters", "expected", "torque_before", "torque_after", "settings"
        (estimate, *_) = found["parameters"].values()
        assert keys(found, but=names) | set(estimate) <= told("files.md", "gap.json")

    def test_a_robot_with_an_own_effect_is_remarked(self, folder, tmp_path, capsys, diagnosing):
        more = ("--effects", folder / "own.py", "--robot-out", tmp_path / "extended.toml")
        assert run(folder, tmp_path / "gap.json", *more) == 0
        assert re.search(r"warning: .*names effects that only .*own\.py knows: quadr", capsys.readouterr().err)
        assert 'name = "quadratic_friction"' in (tmp_path / "extended.toml").read_text()
        with pytest.raises(jf.InputError, match="found 'quadratic_friction'"):
            jf.io.read_robot(tmp_path / "extended.toml")
        (kind,) = own_effects(folder / "own.py")
        robot = jf.io.read_robot(tmp_path / "extended.toml", own=[kind])
        assert "quadratic_friction" in [e.name for e in robot.effects]
        (tmp_path / "no.toml").write_text("nothing = 0")
        design = str(tmp_path / "no.toml")
        assert main(["positions", str(tmp_path / "extended.toml"), design, "-o", str(tmp_path / "q.csv")]) == 2
        assert "found 'quadratic_friction'" in capsys.readouterr().err
        more = ("--effects", str(folder / "own.py"), "-o", str(tmp_path / "q.csv"))
        assert main(["positions", str(tmp_path / "extended.toml"), design, *more]) == 2
        assert "no.toml" in capsys.readouterr().err  # the robot was read, the design is next

    @pytest.mark.parametrize("name", NAMES)
    def test_json_is_all_of_standard_output(self, folder, tmp_path, capsys, diagnosing, name):
        diagnosing.name = name
        assert run(folder, tmp_path / "gap.json", "--json") == 0
        out, error = capsys.readouterr()
        found = json.loads(out, parse_constant=lambda x: pytest.fail(x))
        assert found.pop("output") == [str(tmp_path / "gap.json")]
        assert found == read_gap(tmp_path / "gap.json")
        events = [json.loads(line) for line in error.splitlines() if line.startswith("{")]
        assert [x["done"] for x in events] == [None, 0.5] and events[0]["says"] == "fitting the base"
        assert all((x["event"], x["command"]) == ("progress", "diagnose") for x in events)

    @pytest.mark.parametrize("name", NAMES)
    def test_every_verdict_has_a_summary(self, folder, tmp_path, capsys, diagnosing, name):
        diagnosing.name = name
        assert run(folder, tmp_path / "gap.json") == 0
        out = capsys.readouterr().out
        d = example(name)
        assert out.startswith(f"{d.verdict}: {headline(d)}\n{d.says}\n") and not re.search(r"\bnan\b", out)


class TestInterrupted:
    """What is finished is kept beside the output until all is done."""

    def interrupted(self, folder, out, diagnosing, capsys, *more):
        diagnosing.error = KeyboardInterrupt()
        assert run(folder, out, *more) == 130
        assert "--resume" in capsys.readouterr().err
        diagnosing.error = None

    def test_goes_on(self, folder, tmp_path, capsys, diagnosing):
        out = tmp_path / "gap.json"
        self.interrupted(folder, out, diagnosing, capsys)
        assert (tmp_path / "gap.json.parts" / "round-0.json").exists() and not out.exists()
        assert run(folder, out, "--resume") == 0
        assert diagnosing.found == ["round-0.json"]
        assert [p.name for p in tmp_path.iterdir()] == ["gap.json"]

    @pytest.mark.parametrize(
        ("again", "says"),
        [
            ([], r"1 finished part of a run begun .*; expected none, or --resume"),
            (
                ["--resume", "--heldout-count", "1"],
                r"other options or data \(--heldout-count: none then, 1 now",
            ),
            (["--resume", "--effects", "own.py"], r"--effects: none then, own\.py \(sha256 \w{16}\) now"),
            (["--resume", "--robot", "other.toml"], r"--robot: robot\.toml .* then, other\.toml .* now"),
        ],
        ids=["anew", "heldout", "effects", "robot"],
    )
    def test_another_run_leaves_it(self, folder, tmp_path, monkeypatch, capsys, diagnosing, again, says):
        monkeypatch.chdir(folder)
        (folder / "other.toml").write_text((folder / "robot.toml").read_text() + "\n# another\n")
        out = tmp_path / "gap.json"
        self.interrupted(folder, out, diagnosing, capsys)
        diagnosing.calls.clear()
        assert run(folder, out, *again) == 2
        assert re.search(says, capsys.readouterr().err) and not diagnosing.calls
        assert (tmp_path / "gap.json.parts" / "round-0.json").read_text() == "{}"

    def test_bad_data_leaves_nothing(self, folder, tmp_path, capsys, diagnosing):
        diagnosing.error = jf.InputError("u: found no period; expected one. Set it.")
        assert run(folder, tmp_path / "gap.json") == 2
        out, error = capsys.readouterr()
        assert out == "" and "jaxfrf diagnose: run0.npz and 1 more: u: found no period" in error
        assert list(tmp_path.iterdir()) == []


REFUSED = {
    "no folder": (["-o", "nowhere/gap.json"], r"nowhere/gap\.json: found no folder nowhere"),
    "suffix": (["-o", "gap.txt"], r"found the suffix '\.txt'; expected one of \.json"),
    "report": (["--report", "gap.pdf"], r"gap\.pdf: found the suffix '\.pdf'; expected one of \.html"),
    "robot": (["--robot-out", "gap.json"], r"gap\.json: found the suffix '\.json'; expected one of \.toml"),
    "heldout": (["--heldout-count", "-1"], r"--heldout-count: found -1; expected 0 or more"),
    "effects": (["--effects", "nobody.py"], r"nobody\.py: found no such file; expected a Python file"),
    "map": (["--map", "u"], r"--map"),
}


class TestBadInput:
    """Exit code 2 and one message, before anything long begins."""

    def refused(self, capsys, diagnosing, message, *arguments):
        code = main(["diagnose", "-o", "gap.json", *(str(x) for x in arguments)])
        out, error = capsys.readouterr()
        assert code == 2 and out == "" and error.count("\n") == 1, error
        assert re.search(message, error), error
        assert not diagnosing.calls

    @pytest.mark.parametrize("case", REFUSED)
    def test_refused(self, folder, tmp_path, monkeypatch, capsys, diagnosing, case):
        monkeypatch.chdir(tmp_path)
        more, message = REFUSED[case]
        self.refused(capsys, diagnosing, message, folder / "run0.npz", "--robot", folder / "robot.toml", *more)
        assert list(tmp_path.iterdir()) == []

    def test_files(self, folder, tmp_path, monkeypatch, capsys, diagnosing):
        monkeypatch.chdir(tmp_path)
        robot = ("--robot", folder / "robot.toml")
        self.refused(capsys, diagnosing, r"nowhere\.npz: found no such file", "nowhere.npz", *robot)
        self.refused(capsys, diagnosing, r"no\.toml: found no such file", folder / "run0.npz", "--robot", "no.toml")
        same = ("--robot-out", folder / "robot.toml")
        self.refused(capsys, diagnosing, r"found the robot itself", folder / "run0.npz", *robot, *same)


OWN_REFUSED = {
    "nothing": ("x = 1", r"found no effect; expected a subclass"),
    "only imported": ("from jaxfrf.effects import CoulombFriction", r"found no effect; expected"),
    "syntax": ("def (", r"found SyntaxError in line 1: invalid syntax"),
    "fails": ("import jaxfrf\n\n1 / 0\n", r"found ZeroDivisionError in line 3: division by zero"),
    "no method": (OWN.replace("def torque", "def force"), r"no complete effect \(Quadratic lacks torque\)"),
    "no name": (OWN.replace("    name:", "    title:"), r"no complete effect \(Quadratic lacks name\)"),
    "taken": (OWN.replace("quadratic_", "coulomb_"), r"the name 'coulomb_friction', which is the library's"),
    "bounds": (OWN.replace('{"level": (0.0, 1.0)}', "{}"), r"Quadratic: found no bounds of level"),
}


class TestOwnEffects:
    @pytest.mark.parametrize("command", ["simulate", "positions", "identify", "diagnose"])
    def test_help_says_that_the_file_is_executed(self, capsys, command):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert re.search(
            r"--effects FILE\.py\s+effects of your own, .* executed", " ".join(capsys.readouterr().out.split())
        )

    @pytest.mark.parametrize("case", OWN_REFUSED)
    def test_refused(self, tmp_path, case):
        text, message = OWN_REFUSED[case]
        (tmp_path / "own.py").write_text(text)
        with pytest.raises(jf.InputError, match=message):
            own_effects(tmp_path / "own.py")

    def test_an_abstract_base_and_two_of_it(self, tmp_path):
        more = (
            "\n\nclass Twice(Quadratic):\n    name: ClassVar = 'twice'\n\n\nclass Base(AbstractFriction):\n    pass\n"
        )
        (tmp_path / "own.py").write_text(OWN + more)
        assert [kind.name for kind in own_effects(tmp_path / "own.py")] == ["quadratic_friction", "twice"]
