"""A command for each of many files: one result a file, a table of all, a page."""

import argparse
import contextlib
import glob
import io
import json
import os
import pathlib
import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx

from .._errors import InputError, input_error
from .._files import is_folder_format
from ..io.responses import source
from ..parts import Results, files_text, made_by
from .engine import outcomes
from .overview import write_page, write_table

_NEITHER = (  # changes a result
    "data", "output", "json", "resume", "restart", "each", "workers", "cluster", "patience", "memory", "run"
)  # fmt: skip
_FILES = ("robot", "effects")  # options that name files, whose contents count

Say = Callable[[str], None]


class Batch(eqx.Module):
    """What became of every file.

    **Fields:** `folder`: of the results. `outcomes`: by the name of the result: `file`, `ok`, `seconds`, `summary` (as
    `--json` gives it) or `message`.
    """

    folder: pathlib.Path
    outcomes: dict[str, dict]

    @property
    def failed(self) -> list[str]:
        """Names of those without a result."""
        return [name for name, outcome in self.outcomes.items() if not outcome["ok"]]

    def as_dict(self) -> dict:
        """For `--json`."""
        failed = {self.outcomes[name]["file"]: self.outcomes[name]["message"] for name in self.failed}
        return {"folder": str(self.folder), "files": len(self.outcomes), "failed": failed}

    def lines(self) -> list[str]:
        """For a person."""
        good = len(self.outcomes) - len(self.failed)
        text = [f"{good} of {len(self.outcomes)} files done, results in {self.folder}, all of them in index.html"]
        told = [f"failed: {_named(file, message)}" for file, message in self.as_dict()["failed"].items()]
        return text + told[:20] + ([f"and {len(told) - 20} more: see table.csv"] if len(told) > 20 else [])


def _named(file: str, message: str) -> str:
    return message if message.startswith((file, pathlib.Path(file).name)) else f"{file}: {message}"


def each(
    given: argparse.Namespace,
    *,
    workers: int = 1,
    cluster: str | None = None,
    client: Any = None,
    patience: float | None = None,
    say: Say | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Batch:
    """A command's run for each of its files by itself.

    Results stand in the folder `given.output`: `NAME.nc` (or `.json`) with picture or page of every file, `table.csv`
    and `index.html` of all, and `outcomes/NAME.json`, written last, which says what a result was made from. Run again,
    it makes what is new or was made otherwise (another file under that name, other options, another program), and
    tries again what did not fail by bad input; with `given.restart`, everything. Files that fail stop no others.

    **Arguments:** `given`: a command's options as the command line parses them, `data` its files or patterns
    (`logs/*.mat`), `output` the folder. `workers`, `cluster`, `client`, `patience`: as of `jaxfrf.batch.outcomes`; on
    other machines paths must mean the same files. `say`: called with a line of text. `progress`: called with the part
    that is done, and a few words.

    **Returns:** a `Batch`: what became of every file.

    **Raises:** `jaxfrf.InputError` where there is no file, or the folder is someone else's.
    """
    say = say or (lambda text: None)
    files = _files(given.data)
    folder, restart = pathlib.Path(given.output), getattr(given, "restart", False)
    results = Results(folder, f"{given.command} --each", restart=restart, say=say)
    names = _names(files)
    jobs = {name: _job(given, folder, name, file) for name, file in zip(names, files, strict=True)}
    made = results.standing({name: (pathlib.Path(job.given.output), job.made_from) for name, job in jobs.items()})
    todo = [name for name in names if name not in made]
    pieces = [jobs[name] for name in todo]
    shared = {"workers": workers, "cluster": cluster, "client": client, "patience": patience, "say": say}
    try:
        for count, done in enumerate(outcomes(_work, pieces, **shared), 1):
            name = todo[done.number]
            made[name] = done.result or {
                "file": jobs[name].given.data[0],
                "ok": False,
                "message": done.error,
                "again": True,
            }
            results.keep(name, made[name], jobs[name].made_from)
            if progress is not None:
                failed = sum(not outcome["ok"] for outcome in made.values())
                progress(count / len(todo), f"{count} of {len(todo)} files" + (f", {failed} failed" if failed else ""))
    except KeyboardInterrupt as error:
        if made:
            error.add_note(f"{len(made)} of {len(files)} files stand in {folder}: the same command goes on from there.")
        raise
    batch = Batch(folder, {name: made[name] for name in names})
    write_table(folder / "table.csv", batch.outcomes)
    write_page(folder / "index.html", f"jaxfrf {given.command}", batch.outcomes)
    return batch


def _files(patterns: Sequence[str]) -> list[pathlib.Path]:
    """The files that names and patterns mean, each once."""
    found: dict[pathlib.Path, None] = {}
    for pattern in patterns:
        path = pathlib.Path(pattern)
        matching = [path] if path.exists() else sorted(map(pathlib.Path, glob.glob(str(pattern), recursive=True)))
        files = [p for p in matching if p.is_file() or is_folder_format(p)]
        if not files:
            raise input_error(str(pattern), "no such file", "a file, or a pattern that fits some", "Check the folder.")
        found.update(dict.fromkeys(files))
    return list(found)


def _names(files: Sequence[pathlib.Path]) -> list[str]:
    """A name for the results of every file: its own, with folders and suffix where several would be the same."""
    stems = [file.stem for file in files]
    if len(set(stems)) == len(stems):
        return stems
    root = os.path.commonpath([file.absolute().parent for file in files])
    whole = ["-".join(file.absolute().relative_to(root).with_suffix("").parts) for file in files]
    return [
        f"{name}-{file.suffix[1:]}" if whole.count(name) > 1 else name for name, file in zip(whole, files, strict=True)
    ]


class _FileJob(eqx.Module):
    """A command on one file: all that a worker needs."""

    given: argparse.Namespace
    made_from: dict[str, str]


def _job(given: argparse.Namespace, folder: pathlib.Path, name: str, file: pathlib.Path) -> _FileJob:
    output = str(folder / f"{name}{given.result}")
    own = vars(given) | {"data": [str(file)], "output": output, "json": True, "each": False}
    own |= {"workers": 1, "cluster": None}  # these share the files, not what is in one
    for option, suffix in given.beside.items():
        own[option] = str(folder / f"{name}{suffix}")
    return _FileJob(argparse.Namespace(**own), _made_from(given, file))


def _made_from(given: argparse.Namespace, file: pathlib.Path) -> dict[str, str]:
    """All that a result depends on."""
    options = {name: value for name, value in vars(given).items() if name not in _NEITHER and not callable(value)}
    about = made_by(f"{given.command} --each") | {f"--{name}": _text(value) for name, value in options.items()}
    for name in _FILES:
        path = getattr(given, name, None)
        if path is not None and pathlib.Path(path).is_file():
            about[f"--{name}"] = files_text([source(path)])
    return about | {"file": files_text([source(file)])}


def _text(value) -> str:
    return json.dumps(value, sort_keys=True, default=str)


def _work(job: _FileJob) -> dict:
    """The command on one file, in whatever process: what came out, or why nothing did."""
    from .. import _environment

    _environment.prepare()
    job.given.restart = getattr(job.given, "restart", False)
    job.given.resume = not job.given.restart and pathlib.Path(f"{job.given.output}.parts").exists()
    outcome, began, said = {"file": job.given.data[0]}, time.monotonic(), io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            found = {"ok": True, "summary": job.given.run(job.given)["json"]}
    except InputError as error:
        found = {"ok": False, "message": str(error), "again": False}
    except Exception as error:  # one file of many: the others go on
        found = {"ok": False, "message": f"{type(error).__name__}: {error}", "again": True}
    warnings = [text.partition(" ")[2] for text in said.getvalue().splitlines() if text.startswith("warning: ")]
    return outcome | {"seconds": round(time.monotonic() - began, 3), "warnings": warnings} | found
