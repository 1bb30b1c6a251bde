"""The steps of a study, one file each, so that an interrupted one goes on where it stopped."""

import functools
import json
import pathlib
import threading
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np

from .. import __version__
from .._alive import alive
from .._types import require_x64
from ..batch.engine import outcomes, raised
from ..experiment import Experiment
from ..io._container import replacing
from ..io._json import write_json
from ..io._optional import require
from ..parts import BESIDE, Parts
from ..robot import parameters
from .bias import bias_at, first_experiments, measure, measure_all
from .figures import draw_figures, example_responses, read_curves
from .folder import prepared
from .hidden import hidden_record, hidden_row
from .page import write_study_page
from .parameters import candidates, direct_rows, fit_positions, indirect_row, records
from .settings import Settings, design, truth
from .uncertain import OFF, compared, uncertain_row
from .why import VARIANTS, variant_row

PART_FILES = (
    *(f"{kind}-*.json" for kind in ("indirect", "uncertain", "bias", "direct", "why", "step")),
    *("example.json", "example.npz", "hidden.json", "hidden.npz"),
)

Say = Callable[[str], None]


class Task(eqx.Module):
    """One step: `work()` gives what is written to `path`; `weight` is about how long it takes, in seconds."""

    path: pathlib.Path = eqx.field(static=True)
    label: str = eqx.field(static=True)
    weight: float = eqx.field(static=True)
    work: Callable[[], dict] = eqx.field(static=True)


def run_study(
    settings: Settings,
    output: str | pathlib.Path,
    say: Say | None = None,
    *,
    parts: Parts | None = None,
    workers: int = 1,
    cluster: str | None = None,
    client: Any = None,
    patience: float | None = None,
) -> dict:
    """Make the whole study and write it to a folder: `index.html`, `study.json`, both figures.

    **Arguments:**

    - `settings`: sizes and seeds. `output`: the folder, new, empty or of a study.
    - `say`: called with a line of progress.
    - `parts`: keeps every finished step (`jaxfrf.Parts`); by default in `<output>.parts`, until the study stands.
    - `workers`, `cluster`, `client`, `patience` (s): as of `jaxfrf.batch.outcomes`: who shares the steps; on other
      machines paths must mean the same files.

    **Returns:** what `study.json` holds.

    **Raises:** `jaxfrf.InputError` if the folder holds something else than a study, and where it cannot be written;
    `ImportError` without matplotlib; `ValueError` if JAX is set to 32 bit.
    """
    shared = {"workers": workers, "cluster": cluster, "client": client, "patience": patience}
    require_x64("A study")
    require("matplotlib.figure", "plot")
    if parts is None:
        with Parts(output, "study", say=say) as parts:
            return run_study(settings, output, say, parts=parts, **shared)
    folder = prepared(pathlib.Path(output))
    say = say or (lambda text: None)
    parts.begin(settings.as_dict(), PART_FILES)
    return _made(settings, folder, parts.folder.absolute(), say, shared)


def _made(settings: Settings, folder: pathlib.Path, parts: pathlib.Path, say: Say, shared: dict) -> dict:
    began = time.monotonic()
    if shared["workers"] == 1 and shared["cluster"] is None and shared["client"] is None:
        _work(study_tasks(settings, parts, say), settings.together, say)
    else:
        _share(settings, parts, say, shared)
    results = collect(settings, parts)
    results["minutes"] = _minutes(parts, time.monotonic() - began, settings.together)
    # Only now, so that plain numbers never wait for pictures.
    curves, courses = read_curves(parts / "example.npz"), read_curves(parts / "hidden.npz")
    results["figures"] = draw_figures(curves, folder)
    write_json(folder / "study.json", results)
    write_study_page(folder / "index.html", results, curves, courses)
    return results


class _Records:
    """Records of the study's robot. Where a study simulates all of its positions at once they are one record, which is
    kept: every step asks for it."""

    def __init__(self, settings: Settings):
        self._settings, self._lock = settings, threading.Lock()
        self._kept: dict[int, Experiment] = {}

    def at(self, number: int) -> Experiment:
        """Of Table I, at the position of this number; at all positions where they are simulated at once."""
        settings = self._settings
        if settings.at_once:
            return self.fitted(settings.seeds[0], settings.blocks)
        return measure(truth(), candidates(settings)[number], number, settings.blocks, settings.seeds[0])

    def fitted(self, seed: int, blocks: int) -> Experiment:
        """At the fit positions."""
        settings = self._settings
        if not settings.at_once:
            return records(settings, truth(), blocks, seed)
        with self._lock:
            if seed not in self._kept:
                self._kept = {seed: measure_all(truth(), candidates(settings), settings.blocks, seed)}
            return first_experiments(self._kept[seed], 6 * blocks)


def study_tasks(settings: Settings, parts: pathlib.Path, say: Say) -> list[Task]:
    """All steps in the order in which they are begun: long ones first, since a study may make two at a time."""
    made, runs = _Records(settings), 6 * settings.blocks
    hidden = Task(parts / "hidden.json", "a hidden effect", 40.0, lambda: _hidden(settings, parts, say))
    example = Task(
        parts / "example.json",
        "responses at the example position",
        5.0 if settings.at_once else 1.5 * runs + 20,
        lambda: _example(settings, parts, made),
    )
    why = [
        Task(parts / f"why-{name}.json", f"why: {name}", 60.0, functools.partial(variant_row, settings, name))
        for name in (VARIANTS if settings.ablations else ())
    ]
    return [
        *_indirect_tasks(settings, parts, made, say),
        *_uncertain_tasks(settings, parts, say),
        hidden,
        *_bias_tasks(settings, parts, made, runs),
        example,
        *_direct_tasks(settings, parts, made, runs, say),
        *why,
    ]


def _indirect_tasks(settings: Settings, parts: pathlib.Path, made: _Records, say: Say) -> list[Task]:
    one = lambda seed, n: indirect_row(settings, seed, n, first_experiments(made.fitted(seed, 1), n), say)
    return [
        Task(
            parts / f"indirect-{n}-{seed}.json",
            f"indirect fit, n_e = {n}, seed {seed}",
            settings.fit_positions * (4 + 1.5 * n) + 30,
            functools.partial(one, seed, n),
        )
        for seed in settings.seeds
        for n in settings.indirect
    ]


def _uncertain_tasks(settings: Settings, parts: pathlib.Path, say: Say) -> list[Task]:
    return [
        Task(
            parts / f"uncertain-{n}-{seed}.json",
            f"nothing known exactly, n_e = {n}, machine {seed}",
            80.0 if settings.uncertain_robot != "R3X" else 120.0 + 40.0 * n,
            functools.partial(uncertain_row, settings, seed, n, say),
        )
        for seed in settings.machines
        for n in settings.uncertain
    ]


def _bias_tasks(settings: Settings, parts: pathlib.Path, made: _Records, runs: int) -> list[Task]:
    robot, places = truth(), range(1 if settings.at_once else settings.positions)
    count = settings.positions if settings.at_once else 1
    one = lambda i: {"positions": bias_at(robot, made.at(i), settings)}
    return [
        Task(
            parts / f"bias-{i:03d}.json",
            f"FRFs at {count} positions" if settings.at_once else f"FRFs at position {i + 1} of {len(places)}",
            count * (0.6 * runs + 6),
            functools.partial(one, i),
        )
        for i in places
    ]


def _direct_tasks(settings: Settings, parts: pathlib.Path, made: _Records, runs: int, say: Say) -> list[Task]:
    one = lambda seed: {"rows": direct_rows(settings, seed, made.fitted(seed, settings.blocks), say)}
    fits = 1 + len(settings.fitted) * (len(settings.experiments) - 1) + len(settings.fitted_single)
    simulated = 0.0 if settings.at_once else settings.fit_positions * (0.6 * runs + 6)
    return [
        Task(
            parts / f"direct-{seed}.json",
            f"direct fits, seed {seed}",
            9.0 * fits + simulated,
            functools.partial(one, seed),
        )
        for seed in settings.seeds
    ]


def _example(settings: Settings, parts: pathlib.Path, made: _Records) -> dict:
    """FRFs of the position that the figures show."""
    number = fit_positions(settings)[0]
    arrays = example_responses(truth(), made.at(number), settings)
    _save(parts / "example.npz", arrays)
    return {"position": number, "q": candidates(settings)[number].tolist()}


def _hidden(settings: Settings, parts: pathlib.Path, say: Say) -> dict:
    """The diagnosis of a machine that hides an effect."""
    numbers, courses = hidden_row(hidden_record(settings.seeds[0]), say)
    _save(parts / "hidden.npz", courses)
    return numbers


def _save(path: pathlib.Path, arrays: dict[str, np.ndarray]) -> None:
    with replacing(path) as draft:
        np.savez(draft, **arrays)  # type: ignore[arg-type]  # an array could be called allow_pickle


def _work(tasks: list[Task], together: int, say: Say) -> None:
    """Make what is not there yet, so many steps at a time: while one simulates, another one's programs are compiled."""
    waiting = [t for t in tasks if not _finished(t.path)]
    if len(waiting) < len(tasks):
        say(f"{len(tasks) - len(waiting)} of {len(tasks)} steps are done already")
    total, began = len(waiting), time.monotonic()
    done: list[float] = []
    failed: list[BaseException] = []
    lock = threading.Lock()

    def lane() -> None:
        while True:
            with lock:
                if failed or not waiting:
                    return
                task = waiting.pop(0)
            start = time.monotonic()
            result = task.work()
            write_json(task.path, {"seconds": time.monotonic() - start, "result": result})
            with lock:
                done.append(task.weight)
                rest = sum(t.weight for t in tasks if not t.path.exists())
                left = (time.monotonic() - began) * rest / sum(done)
                say(f"[{len(done)}/{total}] {task.label}" + (f"; {_clock(left)} left" if rest else ""))

    def aside() -> None:
        try:
            lane()
        except BaseException as error:
            failed.append(error)

    # Where the main thread is interrupted nobody waits for these.
    beside = [threading.Thread(target=aside, name=BESIDE, daemon=True) for _ in range(together - 1)]
    for thread in beside:
        thread.start()
    try:
        lane()
    except Exception as error:  # the steps that are under way beside it are still finished and kept
        failed.append(error)
    for thread in beside:
        thread.join()
    if failed:
        raise failed[0]


def _share(settings: Settings, parts: pathlib.Path, say: Say, shared: dict) -> None:
    """The same on workers, each step by its name: what it is made of is known there."""
    tasks = study_tasks(settings, parts, say)
    waiting = [t for t in tasks if not _finished(t.path)]
    if len(waiting) < len(tasks):
        say(f"{len(tasks) - len(waiting)} of {len(tasks)} steps are done already")
    work = functools.partial(_step, settings, parts)
    for count, outcome in enumerate(outcomes(work, [t.path.name for t in waiting], **shared, say=say), 1):
        label = waiting[outcome.number].label
        raised(outcome, label)
        say(f"[{count}/{len(waiting)}] {label}")


def _step(settings: Settings, parts: pathlib.Path, name: str) -> None:
    (task,) = (t for t in _tasks_of(settings, parts) if t.path.name == name)
    start = time.monotonic()
    result = task.work()
    write_json(task.path, {"seconds": time.monotonic() - start, "result": result})


@functools.lru_cache(maxsize=1)
def _tasks_of(settings: Settings, parts: pathlib.Path) -> list[Task]:
    """Of a worker, which keeps the records."""
    return study_tasks(settings, parts, lambda text: alive())


def _finished(path: pathlib.Path) -> bool:
    """Whether a step is there, and whole."""
    try:
        return "result" in json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def _clock(seconds: float) -> str:
    return f"about {seconds / 60:.0f} min" if seconds > 90 else f"about {seconds:.0f} s"


def collect(settings: Settings, parts: pathlib.Path) -> dict:
    """Everything that was found, as plain data."""
    read = lambda name: json.loads((parts / name).read_text())["result"]
    groups = 1 if settings.at_once else settings.positions
    bias = [x for i in range(groups) for x in read(f"bias-{i:03d}.json")["positions"]]
    rows = [row for seed in settings.seeds for row in read(f"direct-{seed}.json")["rows"]]
    indirect = [read(f"indirect-{count}-{seed}.json") for seed in settings.seeds for count in settings.indirect]
    place = lambda row: (row["experiments"], row["method"], row["seed"])
    made = {place(row) for row in rows}
    rows += [row["direct"] for row in indirect if place(row["direct"]) not in made] + indirect
    uncertain = [read(f"uncertain-{n}-{seed}.json") for seed in settings.machines for n in settings.uncertain]
    plan = design(settings.blocks, settings.seeds[0])
    return {
        "settings": settings.as_dict(),
        "version": __version__,
        "lines": len(plan.lines),
        "period_s": plan.period / plan.fs,
        "fit_positions": list(fit_positions(settings)),
        "example": read("example.json"),
        "true": {name: float(v) for name, v in parameters(truth()).items()},
        "bias": mean_bias(bias),
        "parameters": rows,
        "summary": summarise(rows),
        "uncertain": {"off": OFF, "machines": uncertain, "summary": compared(uncertain)},
        "hidden": read("hidden.json"),
        "why": {name: read(f"why-{name}.json") for name in VARIANTS} if settings.ablations else {},
    }


def mean_bias(positions: list[dict]) -> dict:
    """Table I: means over positions, and their standard error."""

    def over(measure, truth, count, method):
        values = np.array([np.mean(p[measure][truth][count][method]) for p in positions])
        spread = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None
        return {"mean": float(values.mean()), "standard_error": spread}

    first = positions[0]
    return {
        measure: {
            truth: {
                count: {method: over(measure, truth, count, method) for method in methods}
                for count, methods in counts.items()
            }
            for truth, counts in truths.items()
        }
        for measure, truths in first.items()
    }


def summarise(rows: list[dict]) -> list[dict]:
    """Table II: medians and ranges over the seeds, one entry for each method and number of experiments."""
    keys = dict.fromkeys((row["experiments"], row["method"]) for row in rows)
    found = []
    for experiments, method in keys:
        these = [r for r in rows if (r["experiments"], r["method"]) == (experiments, method)]
        entry = {"experiments": experiments, "method": method, "seeds": len(these)}
        for name in ("mean_bias", "stiffness_bias", "damping_bias", "largest_stiffness_bias", "largest_damping_bias"):
            values = [r[name] for r in these]
            entry[name] = {"median": float(np.median(values)), "least": min(values), "largest": max(values)}
        entry["covered"] = float(np.mean([r["covered"] for r in these]))
        found.append(entry)
    return found


def _minutes(parts: pathlib.Path, now: float, together: int) -> float:
    """Of all steps; of an interrupted study about what they took together."""
    spent = [json.loads(p.read_text()).get("seconds", 0.0) for p in parts.glob("*.json")]
    return max(sum(spent) / together, now) / 60
