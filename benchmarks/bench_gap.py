"""How often a hidden effect is found and named, and how often one is named that is not there.

    python benchmarks/bench_gap.py --part report -o report [--cases 0-63] [--robots small] [--make-only] [--no-refits]
    python benchmarks/bench_gap.py --again -o report
    python benchmarks/bench_gap.py --score -o report [tune ...] [--against cases.json]
    python benchmarks/bench_gap.py --keep cases.json --commit 0123abc -o report   # and --score -o cases.json
    python benchmarks/bench_gap.py --cost -o cost

Every case (`_hidden_plan.py`) is a simulated machine that differs from the robot that the diagnosis is given: in every
number, as `_hidden_robots.py` says, and by one effect of the library, two, one that the library does not hold, or none.
Half of the records are MuJoCo's. The diagnosis sees `FOLDER/cases/NNN` (record and robot); what was hidden stands in
`FOLDER/truth/NNN.json`, what it found in `FOLDER/results/NNN.json`: gap.json with the wall time and the peak of memory,
and the shrink of the gap on the held-out positions if the true effect is refitted ("oracle") or some other one
("placebo"). `FOLDER/extended/NNN.toml` is the robot that it wrote; `--again` diagnoses the record once more with it.

Data and results that are there are kept, so an interrupted run goes on; a diagnosis that ended in an error is made
again. Every diagnosis runs in a process of its own, so that its time and its memory are those of a user's call, with
programs kept from earlier runs. `--make-only` makes the data. The cases stand in an order in which the first few, or
every second or third one (`--cases 0-251/3`), are a fair sample. `--score` prints the tables, and writes `score.json`,
`score.txt` and `confusion.png` into the (first) folder, or beside the file. Tune on "tune", report on "report";
"unseen" is as the latter, of another seed, for a state of the code that was finished before anybody saw one of it.

`--keep` adds what the finished cases of a folder said to a file, with the commit that made them; cases that such a file
holds already are not run again with `--kept FILE`, and `--against FILE` tells which of them end otherwise.

`--cost` diagnoses one R3X with 12 positions, 6 experiments and 8 s each by `jaxfrf diagnose`, twice, and prints the
time and the memory of both runs.
"""

import argparse
import concurrent.futures
import contextlib
import dataclasses
import functools
import json
import multiprocessing
import os
import pathlib
import sys
import time
import traceback

os.environ.setdefault("NPROC", "64")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import numpy as np
from _gap_kept import keep, kept
from _gap_picture import draw
from _gap_score import NAMING, differences, load, report, score
from _hidden_cases import PARTS, Case, can_be_made, cases, class_of, make
from _hidden_effects import MAIN, kind_of
from _hidden_robots import PLANTS
from _pinned import commit

from jaxfrf.effects import AbstractEffect
from jaxfrf.effects.catalogue import effect_from_table
from jaxfrf.gap.diagnose import diagnose
from jaxfrf.gap.settings import EXPERIMENTS, JUDGING
from jaxfrf.gap.simulated.assemble import gap_between
from jaxfrf.gap.simulated.fitted import fitted, fitted_from
from jaxfrf.gap.simulated.hypothesis import hypothesis
from jaxfrf.gap.simulated.judge import written
from jaxfrf.gap.simulated.records import split
from jaxfrf.io._json import write_json
from jaxfrf.io.gaps import gap_contents
from jaxfrf.io.records import read
from jaxfrf.io.robots import read_robot, write_robot
from jaxfrf.trajectory.measured import fewer, measured

_ROUNDS = 8  # of an oracle's fit
_COST_POSITIONS = 12


class Diagnosed:
    """A case, and what the diagnosis found."""

    def __init__(self, folder: pathlib.Path):
        self.robot, self._record = read_robot(folder / "robot.toml"), read(folder / "data.nc")
        self.found = diagnose(self.robot, self._record)

    @functools.cached_property
    def _fitted(self):
        """The record's positions, the robot with its own numbers fitted, and that written."""
        records = split(measured(fewer(self._record, EXPERIMENTS)), measured(fewer(self._record, JUDGING)), None)
        base, _ = fitted(self.robot, records.fitted, _silent)
        return records, base, written(base.written(), records.every.at(records.judged))

    def shrink(self, effects: list[AbstractEffect]) -> float | None:
        """Shrink of the gap on the held-out positions once these effects, started from these values, are fitted with
        the robot's own numbers; `None` where that cannot be told."""
        records, now, before = self._fitted
        for effect in effects:
            start = hypothesis(now, effect, str(effect.joint))
            if start is None:
                return None
            now = fitted_from(start.robot, start.unknown, records.fitted, now, _silent, _ROUNDS)
        after = written(now.written(), records.every.at(records.judged))
        return None if after is None or before is None else gap_between(records, before, after).shrink


def _silent(text: str) -> None:
    pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=pathlib.Path, nargs="+", required=True, metavar="FOLDER")
    parser.add_argument("--part", choices=PARTS, default="report")
    parser.add_argument("--cases", type=_numbers, metavar="0-63", help="numbers, ranges, ranges/step, behind commas")
    parser.add_argument("--robots", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--make-only", action="store_true")
    parser.add_argument("--score", action="store_true", help="tables only")
    parser.add_argument("--against", type=pathlib.Path, metavar="FILE", help="kept cases; which ones end otherwise")
    parser.add_argument("--no-refits", action="store_true", help="neither oracle nor placebo: a third of the time")
    parser.add_argument("--again", action="store_true", help="diagnose the robots that were written, too")
    parser.add_argument("--keep", type=pathlib.Path, metavar="FILE", help="add the finished cases to it, run nothing")
    parser.add_argument("--commit", default="", help="that made them, for --keep; this one by default")
    parser.add_argument("--kept", type=pathlib.Path, metavar="FILE", help="leave out the cases that it holds")
    parser.add_argument("--jobs", type=int, default=1, help="processes of MuJoCo")
    parser.add_argument("--cost", action="store_true", help="time and memory of one large case only")
    options = parser.parse_args()
    folder = options.output[0]
    if options.cost:
        return cost(folder, options.jobs)
    if options.keep:
        return print(f"{keep(options.keep, folder, options.commit or commit())} cases in {options.keep}")
    if not options.score:
        chosen = [c for c in cases(options.part) if c.robot in options.robots]
        chosen = [c for c in chosen if options.cases is None or c.number in options.cases]
        done = kept(options.kept) if options.kept else {}
        chosen = [c for c in chosen if f"{options.part} {c.name}" not in done]
        run(chosen, folder, options.make_only, options.jobs, not options.no_refits)
        if options.again:
            diagnose_again(chosen, folder)
    if not options.make_only:
        tell(options.output)
    if options.against:
        print("", *differences(load(*options.output), load(options.against)), sep="\n")


def run(chosen: list[Case], folder: pathlib.Path, make_only: bool = False, jobs: int = 1, refits: bool = True) -> None:
    """Data of all these cases and, unless `make_only`, what the diagnosis says of them."""
    began, done = time.monotonic(), 0
    for k, case in enumerate(chosen):
        result = folder / "results" / f"{case.name}.json"
        if not can_be_made(case):
            print(f"{case.name}: left out, the library does not have its effects", flush=True)
            continue
        if (make_only and (folder / "cases" / case.name).exists()) or (not make_only and _finished(result)):
            continue
        start = time.monotonic()
        make(case, folder, jobs)
        said = "made" if make_only else _alone(_diagnosed, case, folder, result, refits)
        done += 1
        now = time.monotonic()
        left = (now - began) / done * (len(chosen) - k - 1)
        print(f"{case.name}: {said}, {now - start:.0f} s; {_duration(left)} left", flush=True)


def diagnose_again(chosen: list[Case], folder: pathlib.Path) -> None:
    """Of every case in which something was named: the verdict on the robot that was written, for the same record."""
    for case in chosen:
        result, written_to = folder / "results" / f"{case.name}.json", folder / "extended" / f"{case.name}.toml"
        found = json.loads(result.read_text()) if result.exists() and written_to.exists() else {}
        if not _names(found) or "again" in found:
            continue
        try:
            found["again"] = _alone(_verdict, written_to, folder / "cases" / case.name / "data.nc")
        except Exception as error:  # as below
            found["again"], found["again_error"] = "failed", traceback.format_exc()
            print(f"{case.name}: {error}", flush=True)
        write_json(result, found)
        print(f"{case.name}: {found['again']} with the robot that was written", flush=True)


def cost(folder: pathlib.Path, jobs: int) -> None:
    """Time and memory of `jaxfrf diagnose` on the report part's first single effect of R3X, with more positions."""
    case = next(c for c in cases("report") if (c.robot, c.kind, c.simulator) == ("r3x", "single", "mujoco"))
    make(case, folder, jobs, dataclasses.replace(case.plant, positions=_COST_POSITIONS))
    place = folder / "cases" / case.name
    shape = read(place / "data.nc").y.shape
    print(f"{case.name}: {', '.join(h.name for h in case.hidden)}; {shape} samples of positions, experiments, axes")
    call = ["-m", "jaxfrf", "diagnose", str(place / "data.nc"), "--robot", str(place / "robot.toml")]
    for run in ("first", "second"):
        start = time.monotonic()
        child = os.posix_spawn(sys.executable, [sys.executable, *call, "-o", str(folder / f"{run}.json")], os.environ)
        _, status, used = os.wait4(child, 0)
        print(
            f"{run} run: {time.monotonic() - start:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of processor, "
            f"{used.ru_maxrss / 1024:.0f} MB, ended with {os.waitstatus_to_exitcode(status)}",
            flush=True,
        )


def _names(found: dict) -> bool:
    return found.get("verdict") in NAMING and bool(found.get("effects"))


def _alone(function, *arguments):
    """Its value, from a process of its own."""
    own = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, own) as pool:
        return pool.submit(function, *arguments).result()


def _verdict(robot: pathlib.Path, record: pathlib.Path) -> str:
    return diagnose(read_robot(robot), read(record)).verdict


def _finished(result: pathlib.Path) -> bool:
    return result.exists() and json.loads(result.read_text())["verdict"] != "failed"


def _diagnosed(case: Case, folder: pathlib.Path, result: pathlib.Path, refits: bool) -> str:
    """Diagnose a case, then refit the true effects and others in their place; a few words about the end."""
    place = folder / "cases" / case.name
    start = time.monotonic()
    diagnosed = None
    try:
        diagnosed = Diagnosed(place)
        found = gap_contents(diagnosed.found)
    except Exception as error:  # one case must not end the others; it counts as failed
        found = {"verdict": "failed", "error": f"{type(error).__name__}: {error}", "where": traceback.format_exc()}
    found |= {"wall_s": round(time.monotonic() - start, 2), "peak_mb": _peak_mb()}
    if diagnosed is not None and _names(found):
        (folder / "extended").mkdir(exist_ok=True)
        write_robot(folder / "extended" / f"{case.name}.toml", diagnosed.found.extended)
    truth = json.loads((folder / "truth" / f"{case.name}.json").read_text())
    if refits and case.kind in ("single", "double") and diagnosed is not None:
        found["oracle"] = _oracle(diagnosed, truth["effects"])
        found["placebo"] = diagnosed.shrink(_others(case, diagnosed.robot))
    result.parent.mkdir(parents=True, exist_ok=True)
    write_json(result, found)
    named = ", ".join(f"{e['name']} {e.get('joint') or ''}".strip() for e in found.get("effects") or ())
    return f"{found['verdict']} {named}".strip()


def _oracle(diagnosed: Diagnosed, hidden: list[dict]) -> float | None:
    """Shrink with the true effects, fitted from their true values."""
    return diagnosed.shrink([_hidden(effect) for effect in hidden])


def _hidden(effect: dict) -> AbstractEffect:
    return effect_from_table({"name": effect["name"], "joint": effect["joint"], **effect["parameters"]})


def _others(case: Case, robot) -> list[AbstractEffect]:
    """As many typical effects of other classes, on joints of their own choice."""
    rng = np.random.default_rng([case.seed, 9])
    hidden = {name for effect in case.hidden for name in class_of(effect.name)}
    names = rng.permutation([n for n in MAIN if n not in hidden and case.plant.joints_of(n)])[: len(case.hidden)]
    return [kind_of(name).typical(robot, str(rng.choice(case.plant.joints_of(name)))) for name in names]


def _peak_mb() -> float | None:
    """Largest memory of this process so far, MB; `None` where the system does not say."""
    with contextlib.suppress(OSError, StopIteration):
        lines = pathlib.Path("/proc/self/status").read_text().splitlines()
        return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024
    return None


def tell(folders: list[pathlib.Path]) -> None:
    """Print and write the scores of all results in these folders."""
    scores = score(load(*folders))
    if not scores["all"]["cases"]:
        print("No results yet.")
        return
    text = report(scores)
    print(text)
    place = folders[0].parent if folders[0].is_file() else folders[0]
    write_json(place / "score.json", scores)
    (place / "score.txt").write_text(text + "\n", encoding="utf-8")
    draw(scores["confusion"], place / "confusion.png")


def _numbers(text: str) -> set[int]:
    """ "0-3,7,10-20/5" as {0, 1, 2, 3, 7, 10, 15, 20}."""
    found: set[int] = set()
    for part in text.split(","):
        span, _, step = part.partition("/")
        first, _, last = span.partition("-")
        found |= set(range(int(first), int(last or first) + 1, int(step or 1)))
    return found


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


if __name__ == "__main__":
    main()
