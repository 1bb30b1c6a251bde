"""Many files by one command: what is made, kept, made again, refused; workers that die."""

import argparse
import csv
import json
import os
import pathlib
import time

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf._alive import alive
from jaxfrf.batch import each, engine, outcomes
from jaxfrf.examples import example


def doubled(given):
    """A command that writes twice the number in its file."""
    text = pathlib.Path(given.data[0]).read_text()
    if text == "broken":
        raise OSError("the disk")
    if not text.isdigit():
        raise jf.InputError(f"{given.data[0]}: found {text!r}; expected a number. Write one.")
    result = {"twice": 2 * int(text), "times": given.times, "output": [given.output]}
    pathlib.Path(given.output).write_text(json.dumps(result))
    return {"json": result, "text": []}


def asked(folder, *patterns, times=1):
    return argparse.Namespace(
        command="double", run=doubled, data=patterns, output=str(folder), result=".json", beside={}, times=times
    )


@pytest.fixture
def logs(tmp_path):
    (tmp_path / "logs").mkdir()
    for name, text in {"a": "1", "b": "x", "c": "3"}.items():
        (tmp_path / "logs" / f"{name}.txt").write_text(text)
    return tmp_path / "logs"


def made_at(folder):
    return {p.name: p.stat().st_mtime_ns for p in (folder / "outcomes").iterdir()}


def test_one_result_a_file_and_a_table_of_all(logs, tmp_path):
    batch = each(asked(tmp_path / "out", f"{logs}/*.txt"))
    assert batch.failed == ["b"] and "found 'x'" in batch.outcomes["b"]["message"]
    assert json.loads((tmp_path / "out" / "c.json").read_text())["twice"] == 6
    with open(tmp_path / "out" / "table.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["name"], row["ok"], row["twice"]) for row in rows] == [
        ("a", "True", "2"),
        ("b", "False", ""),
        ("c", "True", "6"),
    ]
    page = (tmp_path / "out" / "index.html").read_text()
    assert "2 of 3 files" in page and "found &#x27;x&#x27;" in page and 'href="a.json"' in page


def test_again_makes_what_is_new_or_different(logs, tmp_path):
    folder = tmp_path / "out"
    each(asked(folder, f"{logs}/*.txt"))
    first = made_at(folder)
    (logs / "d.txt").write_text("4")
    (logs / "c.txt").write_text("5")
    (folder / "a.json").unlink()
    left = [folder / ".a-0123abcd.json", folder / "outcomes" / ".c-0123abcd.json"]  # by a killed process
    for draft in (*left, folder / ".mine.json"):
        draft.write_text("{")
    batch = each(asked(folder, f"{logs}/*.txt"))
    again = made_at(folder)
    assert not any(draft.exists() for draft in left) and (folder / ".mine.json").exists()
    assert again["b.json"] == first["b.json"] and batch.failed == ["b"]  # bad input stays bad
    assert all(again[name] > first.get(name, 0) for name in ("a.json", "c.json", "d.json"))
    assert json.loads((folder / "c.json").read_text())["twice"] == 10
    said = []
    assert each(asked(folder, f"{logs}/*.txt", times=2), say=said.append).outcomes["a"]["summary"]["times"] == 2
    assert said[0] == "4 of 4 were made otherwise and are made again (--times: 1 then, 2 now)"
    first = made_at(folder)
    options = vars(asked(folder, f"{logs}/*.txt", times=2)) | {"restart": True}
    each(argparse.Namespace(**options))
    assert all(x > first[name] for name, x in made_at(folder).items())


def test_what_may_pass_is_tried_again(logs, tmp_path):
    (logs / "b.txt").write_text("broken")
    assert each(asked(tmp_path / "out", f"{logs}/*.txt")).failed == ["b"]
    before = made_at(tmp_path / "out")["b.json"]
    each(asked(tmp_path / "out", f"{logs}/*.txt"))
    assert made_at(tmp_path / "out")["b.json"] > before


def test_interrupted_it_says_that_the_same_command_goes_on(logs, tmp_path):
    def interrupted(given):
        if "c.txt" in given.data[0]:
            raise KeyboardInterrupt
        return doubled(given)

    given = asked(tmp_path / "out", f"{logs}/*.txt")
    with pytest.raises(KeyboardInterrupt) as stopped:
        each(argparse.Namespace(**vars(given) | {"run": interrupted}))
    assert "2 of 3 files stand in" in stopped.value.__notes__[0]
    assert len(made_at(tmp_path / "out")) == 2


def test_names_that_would_be_the_same(logs, tmp_path):
    (logs / "more").mkdir()
    (logs / "more" / "a.txt").write_text("7")
    (logs / "a.dat").write_text("8")
    batch = each(asked(tmp_path / "out", f"{logs}/**/a.*"))
    found = {pathlib.Path(o["file"]).relative_to(logs).as_posix(): name for name, o in batch.outcomes.items()}
    assert found == {"a.dat": "a-dat", "a.txt": "a-txt", "more/a.txt": "more-a"}


@pytest.mark.parametrize(
    ("there", "message"),
    [
        ({"holiday.jpg": ""}, "files in it"),
        ({"jaxfrf-parts.json": '{"program": "jaxfrf", "about": {"command": "other --each"}}'}, "`jaxfrf other --each`"),
    ],
)
def test_someone_elses_folder_is_left(logs, tmp_path, there, message):
    for name, text in there.items():
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text(text)
    with pytest.raises(jf.InputError, match=message):
        each(asked(tmp_path / "out", f"{logs}/*.txt"))
    assert {p.name for p in (tmp_path / "out").iterdir()} == set(there)


def test_no_file_of_that_pattern(tmp_path):
    with pytest.raises(jf.InputError, match="no such file"):
        each(asked(tmp_path / "out", str(tmp_path / "*.mat")))


def test_the_command(tmp_path, capsys):
    """Estimates of two files are those of `jaxfrf.estimate`; one that is no record fails alone."""
    for seed in (1, 2):
        jf.io.write(tmp_path / f"run{seed}.npz", example(blocks=1, seed=seed))
    (tmp_path / "none.npz").write_bytes(b"no record")
    out = tmp_path / "out"
    code = main(["estimate", str(tmp_path / "*.npz"), "--each", "--method", "h1", "-o", str(out), "--json"])
    about = json.loads(capsys.readouterr().out)
    assert code == 1 and about["files"] == 3 and [pathlib.Path(f).name for f in about["failed"]] == ["none.npz"]
    expected = jf.estimate(jf.io.read(tmp_path / "run2.npz"), jf.H1())
    np.testing.assert_array_equal(jf.io.read_frf(out / "run2.nc").G, expected.G)
    assert (out / "run1.png").is_file()


@pytest.mark.parametrize("options", [["--workers", "2"], ["--cluster", "tcp://nowhere:1"]])
def test_workers_are_for_many_files_where_positions_belong_together(tmp_path, capsys, options):
    arguments = ["identify", "none.nc", "--robot", "none.toml", "-o", str(tmp_path / "x.json")]
    assert main([*arguments, *options]) == 2
    assert "Add --each" in capsys.readouterr().err


def fragile(piece):
    """Dies with its process the first time that it comes to a marked piece."""
    number, marker = piece
    time.sleep(0.05)
    if marker is not None and not os.path.exists(marker):
        pathlib.Path(marker).write_text("")
        os._exit(1)
    if number == 7:
        raise ValueError("seven")
    return number**2


def test_pieces_here(tmp_path):
    done = {x.number: x for x in outcomes(fragile, [(n, None) for n in (1, 7, 2)])}
    assert done[0].result == 1 and done[2].result == 4 and done[1].error == "ValueError: seven"


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced(tmp_path):
    """A scheduler and two processes; one is lost in mid-run, and nothing of the result with it."""
    pytest.importorskip("distributed")
    pieces = [(n, str(tmp_path / "died") if n == 5 else None) for n in range(12)]
    done = {x.number: x for x in outcomes(fragile, pieces, workers=2)}
    assert (tmp_path / "died").exists() and sorted(done) == list(range(12))
    assert {n: x.result for n, x in done.items() if n != 7} == {n: n**2 for n in range(12) if n != 7}
    assert done[7].error == "ValueError: seven"


@pytest.mark.slow
def test_a_cluster_that_runs(tmp_path, logs):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, processes=True, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        there = each(asked(tmp_path / "there", f"{logs}/*.txt"), client=client)
        address = each(asked(tmp_path / "address", f"{logs}/*.txt"), cluster=cluster.scheduler_address)
    here = each(asked(tmp_path / "here", f"{logs}/*.txt"))
    for batch in (there, address):
        assert {n: o.get("summary", {}).get("twice") for n, o in batch.outcomes.items()} == {
            n: o.get("summary", {}).get("twice") for n, o in here.outcomes.items()
        }


class Hung:
    """A client of two workers, of which the second never gives a sign."""

    def __init__(self):
        self.restarted = []

    def processing(self):
        return {"one": ["a"], "two": ["b", "c"], "idle": []}

    def run_on_scheduler(self, function, address):
        self.restarted.append(address)


def test_workers_without_a_sign_are_replaced_and_what_they_hang_at_fails_in_the_end(monkeypatch):
    now, client, said = [0.0], Hung(), []
    monkeypatch.setattr(engine.time, "monotonic", lambda: now[0])
    watch, failed = engine._Watch(client, 100.0, said.append), []
    for now[0] in np.arange(0.0, 400.0, 10.0):
        watch.sign((0, {"worker": "one", "number": 0}))
        if now[0] % 110.0 == 0:  # it begins, and is heard of no more
            watch.sign((0, {"worker": "two", "number": 1}))
        failed.append(watch.replace_hung())
    assert client.restarted == ["two"] * 3 and [x for x in failed if x] == [[1]]
    assert said[0] == "no sign of the worker at two for 100 s: it is replaced, its work done again"


def hanging(piece):
    """Sleeps the first time that it comes to a marked piece, for longer than anyone waits."""
    number, marker = piece
    if marker is not None and not os.path.exists(marker):
        pathlib.Path(marker).write_text("")
        time.sleep(1000)
    for _ in range(30 if number == 4 else 0):  # long, and heard of
        time.sleep(1.0)
        alive()
    return number**2


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_worker_that_hangs_is_replaced(tmp_path):
    pytest.importorskip("distributed")
    said, pieces = [], [(n, str(tmp_path / "hung") if n == 3 else None) for n in range(6)]
    done = {x.number: x.result for x in outcomes(hanging, pieces, workers=2, patience=20.0, say=said.append)}
    assert (tmp_path / "hung").exists() and done == {n: n**2 for n in range(6)}
    assert sum("it is replaced, its work done again" in text for text in said) == 1
