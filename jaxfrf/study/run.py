"""The steps of a study, one file each, so that an interrupted one goes on where it stopped."""

import hashlib
import json
import pathlib
import time
from collections.abc import Callable

import equinox as eqx
import numpy as np

from .. import __version__
from .._errors import input_error
from .._types import require_x64
from ..io._container import replacing
from ..io._json import plain_data, write_json
from ..robot import parameters
from .bias import bias_at, measure
from .figures import draw_figures, example_responses, read_curves
from .page import write_study_page
from .parameters import candidates, direct_rows, fit_positions, through_row
from .settings import Settings, design, truth
from .why import VARIANTS, variant_row

Say = Callable[[str], None]


class Task(eqx.Module):
    """One step: `work()` gives what is written to `path`; `weight` is about how long it takes, in seconds."""

    path: pathlib.Path = eqx.field(static=True)
    label: str = eqx.field(static=True)
    weight: float = eqx.field(static=True)
    work: Callable[[], dict] = eqx.field(static=True)


def run_study(settings: Settings, output: str | pathlib.Path, say: Say | None = None) -> dict:
    """Make the whole study and write it to a folder: `index.html`, `study.json`, both figures.

    Every finished step is kept in `parts`; a folder that holds an interrupted study of the same settings is continued.

    **Raises:** `jaxfrf.InputError` if the folder holds something else.
    """
    require_x64("A study")
    folder = pathlib.Path(output)
    parts = _folder(folder, settings)
    say = say or (lambda text: None)
    began = time.monotonic()
    tasks = study_tasks(settings, parts, say)
    _work(tasks, say)
    results = collect(settings, parts)
    results["minutes"] = _minutes(parts, time.monotonic() - began)
    # Only now, so that plain numbers never wait for pictures.
    curves = read_curves(parts / "example.npz")
    results["figures"] = draw_figures(curves, folder)
    write_json(folder / "study.json", results)
    write_study_page(folder / "index.html", results, curves)
    return results


def study_tasks(settings: Settings, parts: pathlib.Path, say: Say) -> list[Task]:
    """All steps in the order in which they are done."""
    robot, q = truth(), candidates(settings)
    runs = 6 * settings.blocks

    def bias(i):
        return lambda: bias_at(robot, measure(robot, q[i], i, settings.blocks, settings.seeds[0]), settings.experiments)

    tasks = [
        Task(parts / "example.json", "responses at the example position", 1.5 * runs + 20, _example(settings, parts)),
        *(
            Task(parts / f"bias-{i:03d}.json", f"FRFs at position {i + 1} of {len(q)}", 0.6 * runs + 6, bias(i))
            for i in range(len(q))
        ),
    ]
    for seed in settings.seeds:
        tasks.append(
            Task(
                parts / f"direct-{seed}.json",
                f"direct fits, seed {seed}",
                settings.fit_positions * (0.6 * runs + 6) + 90,
                lambda seed=seed: {"rows": direct_rows(settings, seed, say)},
            )
        )
        for count in settings.through:
            tasks.append(
                Task(
                    parts / f"through-{count}-{seed}.json",
                    f"fit through the experiment, n_e = {count}, seed {seed}",
                    settings.fit_positions * (4 + 1.5 * count) + 30,
                    lambda seed=seed, count=count: through_row(settings, seed, count, say=say),
                )
            )
    if settings.ablations:
        for name in VARIANTS:
            tasks.append(
                Task(parts / f"why-{name}.json", f"why: {name}", 60.0, lambda name=name: variant_row(settings, name))
            )
    return tasks


def _example(settings: Settings, parts: pathlib.Path):
    """FRFs of the position that the figures show."""

    def work():
        number = fit_positions(settings)[0]
        data = measure(truth(), candidates(settings)[number], number, settings.blocks, settings.seeds[0])
        arrays = example_responses(truth(), data, settings.experiments)
        with replacing(parts / "example.npz") as draft:
            np.savez(draft, **arrays)
        return {"position": number, "q": candidates(settings)[number].tolist()}

    return work


def _work(tasks: list[Task], say: Say) -> None:
    waiting = [t for t in tasks if not t.path.exists()]
    if len(waiting) < len(tasks):
        say(f"{len(tasks) - len(waiting)} of {len(tasks)} steps are done already")
    began, done, total = time.monotonic(), 0.0, sum(t.weight for t in waiting)
    for i, task in enumerate(waiting):
        start = time.monotonic()
        result = task.work()
        write_json(task.path, {"seconds": time.monotonic() - start, "result": result})
        done += task.weight
        left = (time.monotonic() - began) * (total / done - 1)
        say(f"[{i + 1}/{len(waiting)}] {task.label}; {_clock(left)} left")


def _clock(seconds: float) -> str:
    return f"about {seconds / 60:.0f} min" if seconds > 90 else f"about {seconds:.0f} s"


def collect(settings: Settings, parts: pathlib.Path) -> dict:
    """Everything that was found, as plain data."""
    read = lambda name: json.loads((parts / name).read_text())["result"]
    bias = [read(f"bias-{i:03d}.json") for i in range(settings.positions)]
    rows = [row for seed in settings.seeds for row in read(f"direct-{seed}.json")["rows"]]
    rows += [read(f"through-{count}-{seed}.json") for seed in settings.seeds for count in settings.through]
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


def _folder(folder: pathlib.Path, settings: Settings) -> pathlib.Path:
    """The folder of finished steps; refuses one that holds another study."""
    parts = folder / "parts"
    stamp = parts / "settings.json"
    about = {"settings": settings.as_dict(), "version": __version__}
    text = json.dumps(plain_data(about), sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    if folder.exists() and not folder.is_dir():
        raise input_error(str(folder), "a file", "a folder, or nothing", "Choose another name (-o).")
    if parts.exists():
        known = json.loads(stamp.read_text())["digest"] if stamp.exists() else None
        if known != digest:
            raise input_error(
                str(folder), "another study", "nothing, or the same study interrupted", "Choose another folder (-o)."
            )
        return parts
    if folder.exists() and any(folder.iterdir()):
        raise input_error(str(folder), "a folder with other files", "an empty one", "Choose another folder (-o).")
    parts.mkdir(parents=True)
    write_json(stamp, about | {"digest": digest})
    return parts


def _minutes(parts: pathlib.Path, now: float) -> float:
    spent = [json.loads(p.read_text()).get("seconds", 0.0) for p in parts.glob("*.json")]
    return max(sum(spent), now) / 60
