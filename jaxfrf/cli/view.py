"""`jaxfrf view`."""

import json
import pathlib
import tempfile
import webbrowser

from .._errors import InputError, input_error
from ..io._formats import FRFS
from .arguments import check_result, check_target, command

EXAMPLES = (
    "jaxfrf view frf.nc",
    "jaxfrf view before.nc after.nc -o both.html",
)


def add(commands) -> None:
    parser = command(commands, "view", run, "Look at FRFs: a page on which to choose, zoom and read values.")
    parser.add_argument("frf", nargs="+", metavar="FRF", help=f"FRFs: {' '.join(FRFS)}")
    parser.add_argument("-o", "--output", metavar="FILE", help="page to write, .html, not opened then")


def run(given) -> dict:
    from ..report.response import write_frf_page

    if given.output:
        check_target(given.output, (".html", ".htm"))
        check_result(given.output, given.frf, "FRF")
    frfs, labels = [_read(path) for path in given.frf], _labels(given.frf)
    page = given.output or str(
        pathlib.Path(tempfile.mkdtemp(prefix="jaxfrf-")) / f"{pathlib.Path(labels[0]).stem}.html"
    )
    write_frf_page(page, frfs, labels if len(frfs) > 1 else None)
    opened = not given.output and webbrowser.open(pathlib.Path(page).resolve().as_uri())
    text = f"opened {page}" if opened else f"wrote {page}" + ("" if given.output else ": open it in a browser")
    return {"text": [text], "json": {"output": [page], "opened": bool(opened)}}


def _read(path: str):
    from ..io import read_frf

    if pathlib.Path(path).suffix.lower() == ".json":
        raise _not_viewed(path)
    return read_frf(path)


def _not_viewed(path: str) -> InputError:
    """Results that have pages of their own, made with them."""
    try:
        fields = set(json.loads(pathlib.Path(path).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        fields = set()
    for field, what, name in (("verdict", "a diagnosis", "diagnose"), ("parameters", "a fit", "identify")):
        if field in fields:
            page = f"{pathlib.Path(path).stem}.html"
            do = f"Its page is made with it: jaxfrf {name} ... -o {path} --report {page}."
            return input_error(path, what, f"an FRF: {' '.join(FRFS)}", do)
    return input_error(path, "JSON", f"an FRF: {' '.join(FRFS)}", "Name the FRF that it was made from.")


def _labels(paths) -> list[str]:
    """File names, with as many folders as tell them apart."""
    parts = [pathlib.Path(path).parts for path in paths]
    for depth in range(1, max(map(len, parts)) + 1):
        labels = ["/".join(p[-depth:]) for p in parts]
        if len(set(labels)) == len(labels):
            break
    return labels
