"""`jaxfrf view`."""

import json
import pathlib
import tempfile
import webbrowser
from collections.abc import Sequence
from typing import Any

from .._errors import input_error
from .._files import check_readable
from .._text import counted
from ..io._formats import FRFS
from .arguments import check_result, check_target, command, naming

EXAMPLES = (
    "jaxfrf view frf.nc",
    "jaxfrf view before.nc after.nc -o both.html",
    "jaxfrf view fit.json -o fit.html",
)


def add(commands) -> None:
    parser = command(
        commands, "view", run, "Look at FRFs (a page to choose, zoom and read values on), a fit or a diagnosis."
    )
    parser.add_argument(
        "frf",
        nargs="+",
        metavar="FILE",
        help=f"FRFs ({' '.join(FRFS)}), several beside each other; or one fit.json of `identify`, one gap.json of "
        "`diagnose`",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="page to write, .html, not opened then")


def run(given) -> dict:
    if given.output:
        check_target(given.output, (".html", ".htm"))
        check_result(given.output, given.frf, "file")
    labels = _labels(given.frf)
    page = given.output or str(
        pathlib.Path(tempfile.mkdtemp(prefix="jaxfrf-")) / f"{pathlib.Path(labels[0]).stem}.html"
    )
    _write(page, given.frf, labels)
    opened = not given.output and webbrowser.open(pathlib.Path(page).resolve().as_uri())
    text = [f"opened {page}", *_next(given.frf)] if opened else [f"wrote {page}", f"next: open {page} in a browser"]
    return {"text": text, "json": {"output": [page], "opened": bool(opened)}}


def _write(page: str, paths: Sequence[str], labels: Sequence[str]) -> None:
    """The page of these files: FRFs together, anything else alone."""
    from ..io import read_frf

    results = [path for path in paths if pathlib.Path(path).suffix.lower() == ".json"]
    if results and len(paths) > 1:
        others = len(paths) - 1
        raise input_error(
            results[0], f"a result beside {counted(others, 'other file')}", "FRFs, or one result", "View it alone."
        )
    if results:
        _write_result(page, results[0])
        return
    from ..report.response import write_frf_page

    write_frf_page(page, [read_frf(path) for path in paths], labels if len(paths) > 1 else None)


def _write_result(page: str, path: str) -> None:
    """The page of what `identify` or `diagnose` wrote."""
    from .. import io

    expected = f"an FRF ({' '.join(FRFS)}), a fit.json of `identify` or a gap.json of `diagnose`"
    check_readable(pathlib.Path(path), expected)
    fields = _fields(path)
    if "verdict" not in fields and "parameters" not in fields:
        raise input_error(path, "JSON of something else", expected, "Name what it was made from.")
    from .. import report

    with naming([path]):
        if "verdict" in fields:
            report.write_gap_report(page, io.read_gap(path))
        elif fields.get("kind") == "whole robot":
            report.write_calibration(page, io.read_fit(path))
        else:
            report.write_identification(page, io.read_fit(path))


def _next(paths: Sequence[str]) -> list[str]:
    """What to do with what is on the page; a page of a diagnosis says it itself."""
    fields = _fields(paths[0]) if pathlib.Path(paths[0]).suffix.lower() == ".json" else None
    if fields is None:
        return [f"next: jaxfrf modal {paths[0]} -o modes.json"]
    return [] if "verdict" in fields else ["next: what is missing? jaxfrf diagnose DATA --robot ROBOT -o gap.json"]


def _fields(path: str) -> dict[str, Any]:
    try:
        found = json.loads(pathlib.Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        found = None
    return found if isinstance(found, dict) else {}


def _labels(paths) -> list[str]:
    """File names, with as many folders as tell them apart."""
    parts = [pathlib.Path(path).parts for path in paths]
    for depth in range(1, max(map(len, parts)) + 1):
        labels = ["/".join(p[-depth:]) for p in parts]
        if len(set(labels)) == len(labels):
            break
    return labels
