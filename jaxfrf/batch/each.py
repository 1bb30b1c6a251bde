"""A command for each of many files: one result a file, a table of all, a page."""

import argparse
import contextlib
import glob
import hashlib
import io
import json
import os
import pathlib
import time
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx

from .. import __version__
from .._errors import InputError, input_error, output_error
from .._files import replacing
from .engine import outcomes
from .overview import write_page, write_table

_STAMP = "jaxfrf-batch.json"
_OUTCOMES = "outcomes"
_NEITHER = ("data", "output", "json", "resume", "each", "workers", "cluster", "run")  # changes a result
_FILES = ("robot", "effects")  # options that name files, whose contents count
_EVERY = 5.0  # seconds between two lines of progress

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
    client=None,
    say: Say | None = None,
) -> Batch:
    """A command's run for each of its files by itself.

    Results stand in the folder `given.output`: `NAME.nc` (or `.json`) with picture or page of every file, `table.csv`
    and `index.html` of all, and `outcomes/NAME.json`, written last, which says what a result was made from. Run again,
    it makes what is new or was made otherwise (another file under that name, other options, another version), and
    tries again what did not fail by bad input. Files that fail stop no others.

    **Arguments:** `given`: a command's options as the command line parses them, `data` its files or patterns
    (`logs/*.mat`), `output` the folder. `workers`, `cluster`, `client`: as of `jaxfrf.batch.outcomes`; on other
    machines paths must mean the same files.

    **Raises:** `jaxfrf.InputError` where there is no file, or the folder is someone else's.
    """
    say = say or (lambda text: None)
    files = _files(given.data)
    folder = _folder(pathlib.Path(given.output), given.command)
    names = _names(files)
    jobs = {name: _job(given, folder, name, file) for name, file in zip(names, files, strict=True)}
    made = {name: outcome for name in names if (outcome := _standing(folder, name, jobs[name])) is not None}
    if made:
        say(f"{len(made)} of {len(files)} files stand in {folder} already")
    todo = [name for name in names if name not in made]
    began = told = time.monotonic()
    for count, done in enumerate(
        outcomes(_work, [jobs[name] for name in todo], workers=workers, cluster=cluster, client=client), 1
    ):
        name = todo[done.number]
        made[name] = done.result or {
            "file": jobs[name].given.data[0],
            "ok": False,
            "message": done.error,
            "again": True,
        }
        _keep(folder, name, made[name] | {"made_from": jobs[name].made_from})
        if time.monotonic() - told > _EVERY or count == len(todo):
            told = time.monotonic()
            say(_progress(count, len(todo), [o for o in made.values() if not o["ok"]], told - began))
    batch = Batch(folder, {name: made[name] for name in names})
    write_table(folder / "table.csv", batch.outcomes)
    write_page(folder / "index.html", f"jaxfrf {given.command}", batch.outcomes)
    return batch


def _progress(count: int, total: int, failed: list, spent: float) -> str:
    left = spent / count * (total - count)
    bad = f", {len(failed)} failed" if failed else ""
    rest = "" if count == total else f", {left:.0f} s left" if left < 90 else f", {left / 60:.0f} min left"
    return f"{count} of {total} files{bad}{rest}"


def _files(patterns: Sequence[str]) -> list[pathlib.Path]:
    """The files that names and patterns mean, each once."""
    found: dict[pathlib.Path, None] = {}
    for pattern in patterns:
        path = pathlib.Path(pattern)
        matching = [path] if path.exists() else sorted(map(pathlib.Path, glob.glob(str(pattern), recursive=True)))
        files = [p for p in matching if p.is_file()]
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


def _folder(path: pathlib.Path, command: str) -> pathlib.Path:
    """The folder of the results: a new one, an empty one, or one of the same command."""
    own = {"program": "jaxfrf", "command": command}
    try:
        path.mkdir(exist_ok=True)
        _check_ours(path, own)
        with replacing(path / _STAMP) as draft:
            draft.write_text(json.dumps(own) + "\n", encoding="utf-8")
        (path / _OUTCOMES).mkdir(exist_ok=True)
    except FileExistsError:
        raise output_error(str(path), "a file", "a folder, or nothing of that name", "Choose another -o.") from None
    except OSError as error:
        raise output_error(
            str(path), error.strerror or str(error), "a folder to write to", "Write elsewhere."
        ) from None
    return path


def _check_ours(path: pathlib.Path, own: Mapping[str, str]) -> None:
    if not any(path.iterdir()):
        return
    try:
        stamp = json.loads((path / _STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        stamp = None
    if stamp != own:
        found = f"results of `jaxfrf {stamp['command']}`" if isinstance(stamp, dict) and "command" in stamp else "files"
        raise output_error(
            str(path), f"{found} in it", f"results of `jaxfrf {own['command']} --each`, or none", "Choose another -o."
        )


class _Job(eqx.Module):
    """A command on one file: all that a worker needs."""

    given: argparse.Namespace
    made_from: str


def _job(given: argparse.Namespace, folder: pathlib.Path, name: str, file: pathlib.Path) -> _Job:
    output = str(folder / f"{name}{given.result}")
    own = vars(given) | {"data": [str(file)], "output": output, "json": True, "each": False}
    for option, suffix in given.beside.items():
        own[option] = str(folder / f"{name}{suffix}")
    return _Job(argparse.Namespace(**own), _made_from(given, file))


def _made_from(given: argparse.Namespace, file: pathlib.Path) -> str:
    """A digest of all that a result depends on."""
    options = {name: value for name, value in vars(given).items() if name not in _NEITHER and not callable(value)}
    digest = hashlib.sha256(json.dumps([__version__, options], sort_keys=True, default=str).encode())
    for path in (file, *(getattr(given, name, None) for name in _FILES)):
        if path is not None and pathlib.Path(path).is_file():
            with open(path, "rb") as opened:
                digest.update(hashlib.file_digest(opened, "sha256").digest())
    return digest.hexdigest()[:32]


def _standing(folder: pathlib.Path, name: str, job: _Job) -> dict | None:
    """The outcome that stands, if it is of these files and options and would not end otherwise now."""
    try:
        outcome = json.loads((folder / _OUTCOMES / f"{name}.json").read_text(encoding="utf-8"))
        fits = outcome.pop("made_from") == job.made_from and not outcome.get("again")
        return outcome if fits and (not outcome["ok"] or pathlib.Path(job.given.output).is_file()) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _keep(folder: pathlib.Path, name: str, outcome: dict) -> None:
    with replacing(folder / _OUTCOMES / f"{name}.json") as draft:
        draft.write_text(json.dumps(outcome, indent=1) + "\n", encoding="utf-8")


def _work(job: _Job) -> dict:
    """The command on one file, in whatever process: what came out, or why nothing did."""
    from .. import _environment

    _environment.prepare()
    job.given.resume = pathlib.Path(f"{job.given.output}.parts").exists()
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
