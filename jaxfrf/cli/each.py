"""`--each`: a command for every file by itself."""

import argparse
import importlib.util
from collections.abc import Mapping

from .._errors import input_error
from .arguments import check_inputs, check_x64, say
from .progress import Progress

_BESIDE = {"plot": ".png", "report": ".html", "robot_out": ".toml"}  # what a command can write beside its result


def add_each_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--each",
        action="store_true",
        help="every file by itself ('logs/*.mat' too), OUTPUT a folder: a result, a picture or a page for each, "
        "table.csv and index.html; run again, it makes what is new",
    )
    add_worker_options(parser)


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes that share the work")
    parser.add_argument("--cluster", metavar="ADDRESS", help="a running Dask scheduler instead, tcp://host:8786")
    parser.add_argument(
        "--patience",
        type=float,
        metavar="S",
        help="seconds without a sign of a worker until it is replaced and its work done again (default 1800)",
    )


def run_each(given) -> dict:
    """The command for every file of `given.data`."""
    check_inputs(argparse.Namespace(**vars(given) | {"data": ()}))  # patterns are for `each` to look at
    check_x64(f"jaxfrf {given.command} --each")
    frf = ".nc" if _is_there("h5netcdf") else ".npz"
    given.result = frf if given.command == "estimate" else ".json"
    given.beside = _beside(given)
    from ..batch import each

    with Progress(f"{given.command} --each", given.json) as progress:
        batch = each(given, **sharing(given), say=say, progress=progress)
    text = [*batch.lines(), f"next: {_next(batch)}"]
    return {"text": text, "json": batch.as_dict(), "code": 1 if batch.failed else 0}


def _next(batch) -> str:
    look = f"look at {batch.folder / 'index.html'}"
    return f"{look}; where files failed, mend them and run the same again: what is done stays" if batch.failed else look


def sharing(given) -> dict:
    """Who shares the work, as `jaxfrf.batch` takes it."""
    return {"workers": given.workers, "cluster": given.cluster, "patience": given.patience}


def check_alone(given) -> None:
    """Refuse what belongs to `--each` without it; positions are shared by `estimate` and `simulate` alone."""
    if given.command in ("estimate", "simulate", "study"):
        return
    for option, default in (("workers", 1), ("cluster", None), ("patience", None)):
        if getattr(given, option, default) != default:
            raise input_error(f"--{option}", "no --each", "--each beside it", "Add --each, or leave it out.")


def _beside(given) -> Mapping[str, str]:
    """Suffixes of what is written beside every result: those asked for, and the picture or page that a person wants."""
    chosen = {}
    for option, usual in _BESIDE.items():
        if not hasattr(given, option):
            continue
        asked = getattr(given, option)
        if asked is not None and not (asked.startswith(".") and asked.count(".") == 1 and "/" not in asked):
            raise input_error(
                f"--{option.replace('_', '-')}", repr(asked), "a kind of file, with --each", f"Write e.g. {usual}."
            )
        wanted = given.command == "estimate" if option == "plot" else option == "report"
        if asked is not None or (wanted and _is_there("matplotlib")):
            chosen[option] = asked or usual
    return chosen


def _is_there(module: str) -> bool:
    return importlib.util.find_spec(module) is not None
