"""Nothing is damaged: folders of someone else stay, finished work stays until its result stands, outputs are tried
before the work."""

import dataclasses
import errno
import json
import os
import pathlib
import re
import sys
from concurrent.futures import Future

import numpy as np
import pytest
from gap_examples import example as diagnosis
from two_axes import ROBOT

import jaxfrf as jf
import jaxfrf.gap
import jaxfrf.identification
from jaxfrf import _files, parts
from jaxfrf.__main__ import main
from jaxfrf.batch import estimated
from jaxfrf.gap.simulated.rounds import PART_FILES, KeptRound, keep_round, read_round
from jaxfrf.graybox import Correction
from jaxfrf.identification.rounds import kept_rounds
from jaxfrf.io.robots import read_robot
from jaxfrf.parts import Parts
from jaxfrf.trajectory.ripple import Order

FILES = ("part-[0-9].txt",)
STAMP = "jaxfrf-parts.json"


def begun(output, command="work", about=None, resume=False, say=None):
    made = Parts(output, command, resume=resume, say=say)
    made.begin({"method": "H1()", **(about or {})}, FILES)
    return made


def finish(made, *numbers):
    for k in numbers:
        made.path(f"part-{k}.txt").write_text(f"{k}")


def interrupted(output, *finished, **more):
    """The folder that a run leaves which was stopped after these parts."""
    with pytest.raises(KeyboardInterrupt) as stopped, begun(output, **more) as made:
        finish(made, *finished)
        raise KeyboardInterrupt
    return made.folder, getattr(stopped.value, "__notes__", [])


def names(folder):
    return sorted(p.name for p in folder.iterdir())


class TestWhoseFolderItIs:
    def test_it_says_whose_it_is(self, tmp_path):
        with begun(tmp_path / "fit.json", about={"seed": 3}) as made:
            stamp = json.loads((made.folder / STAMP).read_text())
            assert made.folder == tmp_path / "fit.json.parts"
        assert stamp["program"] == "jaxfrf" and "--resume" in stamp["what"]
        version = {"version": jf.__version__, "program": parts.program()}
        assert stamp["about"] == {"command": "work", **version, "method": "H1()", "seed": "3"}
        assert list(tmp_path.iterdir()) == []

    def test_only_its_own_files_are_deleted(self, tmp_path):
        (tmp_path / "elsewhere").mkdir()
        (tmp_path / "elsewhere" / "part-0.txt").write_text("mine")
        said = []
        with begun(tmp_path / "out", say=said.append) as made:
            finish(made, 0, 1)
            (made.folder / ".part-2-0a1b2c3d.txt").write_text("left by a killed run")
            (made.folder / "notes.txt").write_text("mine")
            (made.folder / "deep").mkdir()
            (made.folder / "deep" / "part-0.txt").write_text("mine")
            (made.folder / "part-9.txt").symlink_to(tmp_path / "elsewhere" / "part-0.txt")
            (made.folder / "part-8.txt").mkdir()
        assert names(made.folder) == ["deep", STAMP, "notes.txt", "part-8.txt", "part-9.txt"]
        assert (made.folder / "deep" / "part-0.txt").read_text() == "mine"
        assert (tmp_path / "elsewhere" / "part-0.txt").read_text() == "mine"
        assert said == [f"{made.folder} is left: it holds files of someone else"]
        # It is in nobody's way: the next run begins there, and leaves the same.
        with begun(tmp_path / "out") as again:
            finish(again, 0)
        assert names(made.folder) == ["deep", STAMP, "notes.txt", "part-8.txt", "part-9.txt"]

    @pytest.mark.parametrize("resume", [False, True])
    @pytest.mark.parametrize(
        "inside",
        [
            {},
            {"precious.txt": "mine"},
            {"run-2024": "a day of measurements", "00000.npz": "mine"},
            {STAMP: "{", "part-0.txt": "mine"},
            {STAMP: "[]"},
            {STAMP: '{"program": "another", "about": {}}', "part-0.txt": "mine"},
        ],
        ids=["empty", "file", "run", "truncated stamp", "no stamp", "stamp of another"],
    )
    def test_a_folder_of_someone_else(self, tmp_path, inside, resume):
        folder = tmp_path / "out.parts"
        folder.mkdir()
        for name, text in inside.items():
            (folder / name).write_text(text)
        refused = r"out\.parts: found a folder that this program did not make .*; expected .*\. Rename it"
        with pytest.raises(jf.InputError, match=refused), Parts(tmp_path / "out", "work", resume=resume):
            pytest.fail("it was taken")
        with pytest.raises(jf.InputError, match=refused):
            begun(tmp_path / "out", resume=resume)
        assert {p.name: p.read_text() for p in folder.iterdir()} == inside

    def test_links_are_not_followed(self, tmp_path):
        """Neither one that stands there before, nor one that takes the folder's place during the work."""
        folder, _ = interrupted(tmp_path / "real", 0, 1)
        (tmp_path / "out.parts").symlink_to(folder, target_is_directory=True)
        with pytest.raises(jf.InputError, match="found a link"):
            begun(tmp_path / "out", resume=True)
        with begun(tmp_path / "other") as made:
            made.folder.rename(tmp_path / "moved")
            made.folder.symlink_to(folder, target_is_directory=True)
        assert names(folder) == [STAMP, "part-0.txt", "part-1.txt"]

    def test_a_file_of_that_name(self, tmp_path):
        (tmp_path / "out.parts").write_text("mine")
        with pytest.raises(jf.InputError, match=r"out\.parts: found a file"):
            begun(tmp_path / "out")
        assert (tmp_path / "out.parts").read_text() == "mine"

    def test_a_folder_that_cannot_be_made(self, tmp_path, monkeypatch):
        def refuse(self, **more):
            raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

        monkeypatch.setattr(pathlib.Path, "mkdir", refuse)
        with pytest.raises(jf.InputError, match=r"out\.parts: found no way to write there"):
            begun(tmp_path / "out")

    def test_a_stamp_that_cannot_be_written(self, tmp_path, monkeypatch):
        def full(source, destination):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr(_files.os, "replace", full)
            with pytest.raises(jf.InputError, match=r"out\.parts: found no way to write there \(No space left"):
                begun(tmp_path / "out")
        assert list(tmp_path.iterdir()) == []

    def test_parts_of_two_runs_do_not_mix(self, tmp_path):
        """A second run with the same output, before the first has finished a part: the first stops, and deletes
        nothing."""
        with pytest.raises(jf.InputError, match="taken by another run"), begun(tmp_path / "out") as first:
            second = begun(tmp_path / "out", about={"method": "H2()"})
            finish(second, 0)
            first.read("part-0.txt", pathlib.Path.read_text)
        assert names(second.folder) == [STAMP, "part-0.txt"]

    def test_names_of_parts_are_known(self, tmp_path):
        with begun(tmp_path / "out") as made, pytest.raises(ValueError, match=r"\.\./x is none of part"):
            made.path("../x")


class TestWhenPartsGo:
    @pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError("disk full"), jf.InputError("bad"), RuntimeError()])
    def test_finished_parts_stay_after_an_error(self, tmp_path, error):
        with pytest.raises(type(error)) as stopped, begun(tmp_path / "out") as made:
            finish(made, 0, 1)
            raise error
        assert made.finished == ["part-0.txt", "part-1.txt"]
        (note,) = stopped.value.__notes__
        assert note == f"2 finished parts kept in {made.folder}: the same command with --resume goes on from there."

    def test_nothing_finished_leaves_nothing_and_promises_nothing(self, tmp_path):
        assert interrupted(tmp_path / "out")[1] == []
        assert list(tmp_path.iterdir()) == []

    def test_told_to_end_while_they_go(self, tmp_path, monkeypatch):
        """The result stands: parts go all the same, and nothing is said of going on."""
        real, told = pathlib.Path.unlink, []

        def unlink(path, **more):
            real(path, **more)
            if path.name == "part-0.txt" and not told:
                told.append(path)
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt) as stopped, begun(tmp_path / "out") as made:
            finish(made, 0, 1)
            monkeypatch.setattr(pathlib.Path, "unlink", unlink)
        assert told and list(tmp_path.iterdir()) == [] and stopped.value.__notes__ == ["The result stands already."]

    def test_goes_on(self, tmp_path):
        folder, _ = interrupted(tmp_path / "out", 0, 1)
        said = []
        with begun(tmp_path / "out", resume=True, say=said.append) as made:
            assert made.read("part-1.txt", pathlib.Path.read_text) == "1"
            assert made.read("part-2.txt", pathlib.Path.read_text) is None
        assert said == [f"2 finished parts taken over from {folder}"] and not folder.exists()

    def test_nothing_to_resume_is_said(self, tmp_path):
        said = []
        with begun(tmp_path / "out", resume=True, say=said.append):
            pass
        assert said == [f"nothing to resume in {tmp_path / 'out.parts'}: starting from the beginning"]

    def test_a_killed_run_that_finished_nothing_is_in_nobodys_way(self, tmp_path):
        made = begun(tmp_path / "out")  # its end never comes
        (made.folder / ".part-0-0a1b2c3d.txt").write_text("half a par")
        with begun(tmp_path / "out", about={"method": "H2()"}) as again:
            assert "H2()" in (again.folder / STAMP).read_text()
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("now", "says"),
        [
            (
                {},
                r"found 2 finished parts of a run begun \d{4}-.*; expected none, or --resume\. .* --restart to",
            ),
            ({"about": {"method": "H2()"}}, r"\(method: H1\(\) then, H2\(\) now\)"),
            ({"about": {"method": "H2()"}, "resume": True}, r"\(method: H1\(\) then, H2\(\) now\)"),
            ({"about": {"seed": 4, "a": None}, "resume": True}, r"\(seed: none then, 4 now; a: none then, none now\)"),
            ({"command": "other", "resume": True}, r"\(command: work then, other now\)"),
        ],
    )
    def test_parts_of_another_run_stay(self, tmp_path, now, says):
        folder, _ = interrupted(tmp_path / "out", 0, 1)
        before = {p.name: p.read_bytes() for p in folder.iterdir()}
        with pytest.raises(jf.InputError, match=says) as refused, begun(tmp_path / "out", **now):
            pytest.fail("they were taken")
        assert "They are kept: " in str(refused.value) and not hasattr(refused.value, "__notes__")
        assert {p.name: p.read_bytes() for p in folder.iterdir()} == before

    def test_versions_are_not_mixed(self, tmp_path, monkeypatch):
        interrupted(tmp_path / "out", 0)
        monkeypatch.setattr(parts, "__version__", "99.0")
        with pytest.raises(jf.InputError, match=rf"version: {re.escape(jf.__version__)} then, 99\.0 now"):
            begun(tmp_path / "out", resume=True)

    def test_the_program_is_known_by_its_files(self, tmp_path):
        (tmp_path / "a.py").write_text("x = 1")
        first = parts._digest(tmp_path)
        (tmp_path / "notes.txt").write_text("nothing that is run")
        assert parts._digest(tmp_path) == first
        (tmp_path / "robot.toml").write_text("mass = 1.0")
        assert parts._digest(tmp_path) != first

    def test_restart_deletes_what_an_earlier_run_left_and_nothing_else(self, tmp_path):
        folder, _ = interrupted(tmp_path / "out", 0, 1)
        (folder / "notes.txt").write_text("mine")
        said = []
        with pytest.raises(KeyboardInterrupt), Parts(tmp_path / "out", "other", restart=True, say=said.append) as made:
            made.begin({}, ("round-[0-9].json",))
            assert names(folder) == [STAMP, "notes.txt"] and made.finished == []
            made.path("round-0.json").write_text("{}")
            raise KeyboardInterrupt
        assert said == [f"2 finished parts of an earlier run deleted from {folder}, as --restart says"]
        assert names(folder) == [STAMP, "notes.txt", "round-0.json"]

    def test_numbers_and_files_are_told_apart(self):
        x = np.arange(6.0)
        assert parts.numbers_text(x, None) == parts.numbers_text(x.copy(), None)
        others = [(x,), (None, x), (x.reshape(2, 3), None), (x.astype(np.float32), None), (x + 1e-15, None)]
        assert len({parts.numbers_text(*arrays) for arrays in [(x, None), *others]}) == 6
        run = jf.Source("run.nc", "0123456789abcdef0123")
        assert parts.files_text([run]) == "run.nc (sha256 0123456789abcdef)"


class TestDigestsToCome:
    """Work begins before the digests of large files are known."""

    SEEN = "run.nc (9 bytes, changed at 1.5)"

    def begun(self, output, digested, seen=SEEN, resume=False):
        made = Parts(output, "work", resume=resume)
        made.begin({"method": "H1()"}, FILES, data=(seen, digested))
        return made

    def stopped(self, output, digested):
        with pytest.raises(KeyboardInterrupt), self.begun(output, digested) as made:
            finish(made, 0)
            raise KeyboardInterrupt

    def known(self, sha256="0123456789abcdef0123"):
        digested = Future()
        digested.set_result((jf.Source("run.nc", sha256),))
        return digested

    def test_stopped_before_they_are_known(self, tmp_path):
        self.stopped(tmp_path / "out", Future())
        waits_for_ever = Future()
        with self.begun(tmp_path / "out", waits_for_ever, resume=True) as made:
            assert made.finished == ["part-0.txt"]
        assert names(tmp_path) == []

    def test_another_file_then(self, tmp_path):
        self.stopped(tmp_path / "out", Future())
        with pytest.raises(
            jf.InputError, match=r"data: run.nc \(9 bytes, .*\) then, run.nc \(sha256 0123456789abcdef\) now"
        ):
            self.begun(tmp_path / "out", self.known(), seen="run.nc (9 bytes, changed at 2.5)", resume=True)

    def test_known_they_count_and_not_the_times(self, tmp_path):
        self.stopped(tmp_path / "out", self.known())
        with self.begun(tmp_path / "out", self.known(), seen="run.nc (9 bytes, changed at 2.5)", resume=True) as made:
            assert made.finished == ["part-0.txt"]
        self.stopped(tmp_path / "out", self.known())
        with pytest.raises(jf.InputError, match=r"data: run.nc \(sha256 0123.*\) then, run.nc \(sha256 fedc.*\) now"):
            self.begun(tmp_path / "out", self.known("fedcba9876543210"), seen="run.nc (9 bytes)", resume=True)

    def test_written_down_as_soon_as_they_are_known(self, tmp_path):
        digested = Future()
        with self.begun(tmp_path / "out", digested) as made:
            stamped = lambda: json.loads((made.folder / STAMP).read_text())["about"]["data"]
            made.settle(wait=False)
            assert stamped() == self.SEEN
            digested.set_result((jf.Source("run.nc", "0123456789abcdef0123"),))
            made.settle(wait=False)
            assert stamped() == "run.nc (sha256 0123456789abcdef)"
            finish(made, 1)  # still this run's folder


class TestDamagedParts:
    """They are told, and made again."""

    def test_reader_that_fails(self, tmp_path):
        interrupted(tmp_path / "out", 0)
        said = []
        with begun(tmp_path / "out", resume=True, say=said.append) as made:
            assert made.read("part-0.txt", lambda path: json.loads(path.read_text() + "{")) is None
            assert said[1] == f"{made.path('part-0.txt')} is damaged (JSONDecodeError) and is made again"
            with pytest.raises(MemoryError):
                made.read("part-0.txt", lambda path: (_ for _ in ()).throw(MemoryError))

    def test_rounds_of_a_fit(self, tmp_path):
        (tmp_path / "robot.toml").write_text(ROBOT)
        rng = np.random.default_rng(0)
        u, y, r = rng.standard_normal((3, 1, 2, 100, 2))
        data = jf.Experiment(u, y, 500.0, 50, r=r, q=np.zeros((1, 2)))
        model = jf.RobotModel(read_robot(tmp_path / "robot.toml"))
        rounds = [Correction(rng.standard_normal(4), rng.standard_normal(4), 1.5 - k, 0.1) for k in range(3)]
        begin = lambda kept: kept_rounds(kept, model, data, {"rounds": 12, "starts": 3})
        out, said = tmp_path / "fit.json", []
        with pytest.raises(KeyboardInterrupt), Parts(out, "identify") as kept:
            done, keep = begin(kept)
            assert done == []
            for one in rounds:
                keep(one)
            raise KeyboardInterrupt
        text = kept.path("00001.json").read_text()
        kept.path("00001.json").write_text(text[: len(text) // 2])
        with Parts(out, "identify", resume=True, say=said.append) as again:
            (done,), keep = begin(again)
            np.testing.assert_array_equal(done.x, rounds[0].x)
            assert (done.gap_db, done.gap_deg) == (1.5, 0.1) and "00001.json is damaged" in said[-1]
            keep(rounds[1])
            assert again.path("00001.json").read_text() == text

    def test_rounds_of_a_search(self, tmp_path):
        details = {"rivals": [["torque_delay", "elbow", 1.5, True]]}
        effect, orders = jf.effects.CoulombFriction("elbow", 0.15), (Order("torque", 1, 6.0),)
        found = KeptRound(effect, "elbow", {"elbow.stiffness": 3e4}, orders, np.array([[0.1, 0.2]]), details=details)
        with Parts(tmp_path / "gap.json", "diagnose") as kept:
            kept.begin({}, PART_FILES)
            keep_round(kept, 0, found)
            again = read_round(kept, 0)
            assert (again.effect.name, again.joint, again.details) == ("coulomb_friction", "elbow", details)
            assert (again.values, again.orders) == (found.values, orders)
            np.testing.assert_array_equal(again.floor, found.floor)
            text = kept.path("round-0.json").read_text()
            for damaged in (text[:-9], text.replace("coulomb", "columb"), "null", ""):
                kept.path("round-0.json").write_text(damaged)
                assert read_round(kept, 0) is None
        assert read_round(None, 0) is None


# --- the commands


@pytest.fixture
def data(tmp_path):
    """A record of four positions; `data(seed=1)` others under the same name."""

    def make(seed=0):
        rng = np.random.default_rng(seed)
        u, y, r = rng.standard_normal((3, 4, 2, 40, 1))
        np.savez(tmp_path / "run.npz", u=u, y=y, r=r, q=np.zeros((4, 1)), fs=40.0, period=20, lines=[2, 3, 5, 7])
        return str(tmp_path / "run.npz")

    make()
    return make


class Estimating:
    """Stands in for `estimate` of one position: counts the calls, and is interrupted at call number `at`."""

    def __init__(self, monkeypatch, at=None):
        self.real, self.at, self.calls = jf.estimate, at, 0
        monkeypatch.setattr(estimated, "estimate", self)

    def __call__(self, spectra, method):
        self.calls += 1
        if self.calls == self.at:
            raise KeyboardInterrupt
        return self.real(spectra, method)


def estimate(data, out, *more):
    return main(["estimate", data, "-o", str(out), *(more or ("--method", "h1"))])


def same_frf(one, two):
    one, two = jf.io.read_frf(one), jf.io.read_frf(two)
    for field in dataclasses.fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(two, field.name), err_msg=field.name)


class TestEstimate:
    @pytest.fixture
    def stopped(self, tmp_path, data, monkeypatch, capsys):
        """A run of H1 that was interrupted at the third of four positions; what it left."""
        with monkeypatch.context() as patch:
            Estimating(patch, at=3)
            assert estimate(data(), tmp_path / "frf.npz") == 130
        folder = tmp_path / "frf.npz.parts"
        says = (
            f"jaxfrf estimate: interrupted. 2 finished parts kept in {folder}: the same command with --resume goes on"
        )
        assert says in capsys.readouterr().err
        return folder

    @pytest.mark.parametrize(
        ("seed", "arguments", "says"),
        [
            (0, ["--method", "h1"], r"expected none, or --resume"),
            (0, ["--method", "h2"], r"\(method: H1\(\) then, H2\(.*\) now\)"),
            (0, ["--method", "h2", "--resume"], r"\(method: H1\(\) then, H2\(.*\) now\)"),
            (0, ["--method", "h1", "--resume", "--band", "5:20"], r"lines: 4 from 4 to 14 Hz then, 3 from 6 to 14 Hz"),
            (0, ["--method", "h1", "--resume", "--set", "y_quantity=position"], r"output: velocity then, position now"),
            (0, ["--method", "h1", "--resume", "--factor", "y=2"], r"\(--factor: none then, y=2 now\)"),
            (1, ["--method", "h1", "--resume"], r"data: run\.npz \(sha256 \w+\) then, run\.npz \(sha256 \w+\) now"),
        ],
    )
    def test_another_run_leaves_the_parts(self, tmp_path, data, stopped, monkeypatch, capsys, seed, arguments, says):
        before = {p.name: p.read_bytes() for p in stopped.iterdir()}
        counted = Estimating(monkeypatch)
        assert estimate(data(seed), tmp_path / "frf.npz", *arguments) == 2
        out, error = capsys.readouterr()
        assert out == "" and error.count("\n") == 1 and re.search(says, error), error
        assert re.search(r"^jaxfrf estimate: \S*frf\.npz\.parts: found 2 finished parts of a run begun ", error)
        assert counted.calls == 0 and not (tmp_path / "frf.npz").exists()
        assert {p.name: p.read_bytes() for p in stopped.iterdir()} == before

    def test_goes_on_all_the_same(self, tmp_path, data, stopped, monkeypatch, capsys):
        """After a refusal; and a part that was damaged meanwhile is estimated again."""
        assert estimate(data(), tmp_path / "frf.npz") == 2
        damaged = stopped / "00001.npz"
        damaged.write_bytes(damaged.read_bytes()[:-200])
        counted = Estimating(monkeypatch)
        assert estimate(data(), tmp_path / "frf.npz", "--method", "h1", "--resume") == 0
        error = capsys.readouterr().err
        assert "2 finished parts taken over" in error and "00001.npz is damaged" in error
        assert counted.calls == 3 and not stopped.exists()
        assert estimate(data(), tmp_path / "whole.npz") == 0
        same_frf(tmp_path / "frf.npz", tmp_path / "whole.npz")

    def test_nothing_to_resume(self, tmp_path, data, capsys):
        assert estimate(data(), tmp_path / "frf.npz", "--method", "h1", "--resume", "--json") == 0
        out, error = capsys.readouterr()
        assert error.startswith("nothing to resume in ") and json.loads(out)["positions"] == 4
        assert names(tmp_path) == ["frf.npz", "run.npz"]

    def test_interrupted_before_anything_was_finished(self, tmp_path, data, monkeypatch, capsys):
        Estimating(monkeypatch, at=1)
        assert estimate(data(), tmp_path / "frf.npz") == 130
        assert capsys.readouterr().err == "jaxfrf estimate: interrupted.\n"
        assert names(tmp_path) == ["run.npz"]

    def test_a_command_without_parts_promises_nothing(self, tmp_path, monkeypatch, capsys):
        def stop(**more):
            raise KeyboardInterrupt

        import jaxfrf.examples

        monkeypatch.setattr(jaxfrf.examples, "example", stop)
        assert main(["example", "-o", str(tmp_path / "run.nc")]) == 130
        assert capsys.readouterr().err == "jaxfrf example: interrupted.\n"


class Identifying:
    """Stands for `jaxfrf.identify_springs`: keeps a round, returns what can be written."""

    makes = "0.json"
    measured = type("Measured", (), {"warnings": ()})()

    def __call__(self, robot, data, *, parts, **more):
        parts.begin({"robot": robot.name}, ("[0-9].json",))
        self.found = parts.finished
        parts.path(self.makes).write_text("{}")
        return self

    def as_dict(self):
        return {"parameters": {}, "starts": {}}

    def lines(self):
        return ["found"]


class Diagnosing:
    """Stands for `jaxfrf.gap.diagnose`."""

    makes = "round-0.json"

    def __call__(self, robot, data, *, parts, **more):
        self.found = parts.finished
        parts.path(self.makes).write_text("{}")
        return diagnosis("two")


class TestWriting:
    """Where the result cannot be written at the end, the work is not lost."""

    @pytest.fixture
    def work(self, tmp_path, data, monkeypatch):
        """Command line and stand-in for every command with parts."""
        monkeypatch.setattr(jaxfrf.identification, "identify_springs", identifying := Identifying())
        monkeypatch.setattr(jaxfrf.gap, "diagnose", diagnosing := Diagnosing())
        (tmp_path / "robot.toml").write_text(ROBOT)
        robot = ("--robot", str(tmp_path / "robot.toml"))
        return {
            "estimate": (["estimate", data(), "--method", "h1", "-o", str(tmp_path / "out.npz")], None),
            "identify": (["identify", data(), "--springs", *robot, "-o", str(tmp_path / "out.json")], identifying),
            "diagnose": (["diagnose", data(), *robot, "-o", str(tmp_path / "out.json")], diagnosing),
        }

    @pytest.mark.parametrize("command", ["estimate", "identify", "diagnose"])
    def test_disk_full(self, tmp_path, work, monkeypatch, capsys, command):
        arguments, fake = work[command]
        target = pathlib.Path(arguments[-1])
        folder = pathlib.Path(f"{target}.parts")
        finished = [f"0000{k}.npz" for k in range(4)] if fake is None else [fake.makes]
        real = os.replace

        def full(source, destination):
            if pathlib.Path(destination) == target:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            real(source, destination)

        with monkeypatch.context() as patch:
            patch.setattr(_files.os, "replace", full)
            assert main(arguments) == 2
        out, error = capsys.readouterr()
        assert out == "" and "Traceback" not in error
        assert f"No space left on device. {target} was not written. {len(finished)} finished part" in error
        assert f"kept in {folder}: the same command with --resume goes on from there." in error
        beside = [] if fake else ["00000.json"]
        assert names(folder) == sorted([*finished, *beside, STAMP]) and not target.exists()
        counted = Estimating(monkeypatch)
        assert main([*arguments, "--resume"]) == 0
        assert target.exists() and not folder.exists()
        assert counted.calls == 0 and (fake is None or fake.found == finished)

    def test_picture_that_fails(self, tmp_path, data, monkeypatch, capsys):
        """All that was asked for is part of the result."""
        from jaxfrf import plot

        def full(figure, path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        arguments = (data(), tmp_path / "frf.npz", "--method", "h1", "--plot", str(tmp_path / "bode.png"))
        with monkeypatch.context() as patch:
            patch.setattr(plot, "save", full)
            assert estimate(*arguments) == 2
        assert "--resume" in capsys.readouterr().err
        counted = Estimating(monkeypatch)
        assert estimate(*arguments, "--resume") == 0 and counted.calls == 0
        assert names(tmp_path) == ["bode.png", "frf.npz", "run.npz"]


OUTPUTS = {
    "example": ([], {"-o": ".nc"}),
    "excite": (["no.toml"], {"-o": ".nc", "--plot": ".png"}),
    "positions": (["no.toml", "no.toml"], {"-o": ".csv", "--plot": ".png"}),
    "simulate": (["no.toml", "no.toml"], {"-o": ".nc"}),
    "estimate": (["no.nc"], {"-o": ".nc", "--plot": ".png"}),
    "identify": (
        ["no.nc", "--robot", "no.toml"],
        {"-o": ".json", "--report": ".html", "--plot": ".png", "--robot-out": ".toml"},
    ),
    "diagnose": (["no.nc", "--robot", "no.toml"], {"-o": ".json", "--report": ".html", "--robot-out": ".toml"}),
}


@pytest.mark.parametrize(
    ("command", "option"), [(command, option) for command, (_, outputs) in OUTPUTS.items() for option in outputs]
)
class TestOutputsAreTriedFirst:
    """Before anything is read: the inputs of these commands hold nothing."""

    @pytest.fixture(autouse=True)
    def inputs(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        for name in ("no.toml", "no.nc"):
            (tmp_path / name).write_text("nothing = 0")

    def refused(self, capsys, tmp_path, command, option, place, says):
        given, outputs = OUTPUTS[command]
        here = {"-o": str(tmp_path / f"fine{outputs['-o']}"), option: str(place) + outputs[option]}
        before = sorted(tmp_path.rglob("*"))
        code = main([command, *given, *(text for pair in here.items() for text in pair)])
        out, error = capsys.readouterr()
        assert code == 2 and out == "" and error.count("\n") == 1, error
        assert error.startswith(f"jaxfrf {command}: {here[option]}: ") and re.search(says, error), error
        assert re.search(r"found .+; expected .+\. \S", error)
        assert sorted(tmp_path.rglob("*")) == before

    def test_a_folder(self, capsys, tmp_path, command, option):
        (tmp_path / f"result{OUTPUTS[command][1][option]}").mkdir()
        self.refused(capsys, tmp_path, command, option, tmp_path / "result", "found a folder; expected the name of a f")

    def test_no_parent(self, capsys, tmp_path, command, option):
        self.refused(capsys, tmp_path, command, option, tmp_path / "no" / "result", "found no folder")

    def test_a_parent_that_is_a_file(self, capsys, tmp_path, command, option):
        (tmp_path / "file").write_text("mine")
        self.refused(capsys, tmp_path, command, option, tmp_path / "file" / "result", "found no folder")

    def test_a_file_that_is_write_protected(self, capsys, tmp_path, command, option):
        mine = tmp_path / f"result{OUTPUTS[command][1][option]}"
        mine.write_text("mine")
        mine.chmod(0o444)
        self.refused(capsys, tmp_path, command, option, tmp_path / "result", "found a file that is write-protected")
        assert mine.read_text() == "mine"

    def test_a_name_that_is_too_long(self, capsys, tmp_path, command, option):
        """The file itself could be made, but not the one beside it that it is written to first."""
        place = tmp_path / ("x" * 245)
        self.refused(capsys, tmp_path, command, option, place, r"found that nothing can be written there \(.*too long")

    @pytest.mark.skipif(sys.platform != "linux", reason="a folder in which nobody can write")
    def test_a_folder_that_cannot_be_written(self, capsys, tmp_path, command, option):
        self.refused(capsys, tmp_path, command, option, "/proc/result", "found that nothing can be written there")


def test_trying_changes_nothing(tmp_path):
    mine = tmp_path / "frf.nc"
    mine.write_text("mine")
    before = mine.stat()
    _files.check_writable(mine)
    assert mine.stat().st_mtime_ns == before.st_mtime_ns and names(tmp_path) == ["frf.nc"]
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(jf.InputError, match="found a device or a pipe"):
        _files.check_writable(tmp_path / "pipe")


# --- an FRF straight from a record


WRONG = {
    "array": (
        np.zeros((2, 100, 1)),
        r"found an array of shape \(2, 100, 1\).*jaxfrf\.Experiment\(u, y, fs, period",
    ),
    "arrays": ([np.zeros(3), np.zeros(4)], r"found a list of 2, the first an array of shape \(3,\).*Experiment\("),
    "path": ("run.nc", r"found 'run\.nc'; .*jaxfrf\.io\.read\(path"),
    "paths": ([pathlib.Path("a.nc"), "b.nc"], r"found a list of 2, the first 'a\.nc'; .*jaxfrf\.io\.read\(path"),
    "records": ((jf.Experiment(np.zeros((9, 1)), np.zeros((9, 1)), 1.0),), r"an Experiment; .*jaxfrf\.concatenate"),
    "none": (None, r"found NoneType; .*jaxfrf\.io\.read"),
    "empty": ([], r"found list; .*jaxfrf\.io\.read"),
    "ragged": ([[1.0], [1.0, 2.0]], r"found a list of 2, the first list; .*jaxfrf\.Experiment\("),
    "FRF": (jf.io.frf_from_arrays(np.ones(3), np.arange(1.0, 4.0)), r"found an FRF; .*It is estimated already"),
}


class TestEstimateOfARecord:
    @pytest.mark.parametrize("method", [jf.H1(), jf.LRM(order=1, width=20)], ids=["h1", "lrm"])
    def test_periodic(self, method):
        """The truth comes back: y is u filtered by 1 / (1 + 0.3 z^-1), in steady state."""
        rng = np.random.default_rng(0)
        lines, period = np.arange(1, 100), 256
        spectrum = np.zeros((4, period // 2 + 1), complex)
        spectrum[:, lines] = np.exp(2j * np.pi * rng.random((4, 99)))
        G = 1 / (1 + 0.3 * np.exp(-2j * np.pi * lines / period))
        u = np.tile(np.fft.irfft(spectrum), (1, 3))[..., None]
        spectrum[:, lines] *= G
        y = np.tile(np.fft.irfft(spectrum), (1, 3))[..., None]
        frf = jf.estimate(jf.Experiment(u, y, 100.0, period, lines=lines), method)
        np.testing.assert_allclose(frf.frequency, lines * 100 / period)
        np.testing.assert_allclose(frf.G[0, :, 0, 0], G, rtol=1e-3)

    def test_whole_where_it_is_not_periodic(self):
        rng = np.random.default_rng(1)
        u = rng.standard_normal((3, 600, 1))
        y = np.stack([np.convolve(x[:, 0], [0.5, 0.25, 0.125])[:600] for x in u])[..., None]
        record = jf.Experiment(u, y, 100.0)
        frf = jf.estimate(record, jf.LPM(order=2, width=30, transient=2))
        z = np.exp(-2j * np.pi * frf.frequency / 100)
        assert np.median(np.abs(frf.G[0, :, 0, 0] - (0.5 + 0.25 * z + 0.125 * z**2))) < 1e-3
        assert any("not periodic, taken whole" in text for text in frf.warnings)
        with pytest.raises(jf.InputError, match=r"period: found 0: the record is not periodic.*transient"):
            jf.estimate(record, jf.H1())

    @pytest.mark.parametrize("case", WRONG)
    def test_anything_else_is_one_clear_error(self, case):
        data, says = WRONG[case]
        with pytest.raises(jf.InputError, match=r"^data: found .*; expected jaxfrf\.Spectra or a jaxfrf\.Exp") as error:
            jf.estimate(data, jf.H1())
        assert re.search(says, str(error.value)), error.value
