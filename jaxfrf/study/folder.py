"""The folder of a study: what is in it, and whether it may be continued."""

import hashlib
import json
import pathlib

from .. import __version__
from .._errors import input_error
from ..io._json import plain_data, write_json
from .settings import Settings

_PACKAGE = pathlib.Path(__file__).parents[1]


def program() -> str:
    """A digest of the package's own files: another program may find other numbers, whatever its version says."""
    digest = hashlib.sha256()
    for path in sorted(p for kind in ("*.py", "*.toml") for p in _PACKAGE.rglob(kind)):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def stamp_of(settings: Settings) -> dict:
    """What all parts of a study have in common."""
    return plain_data({"settings": settings.as_dict(), "version": __version__, "program": program()})


def prepared(folder: pathlib.Path, settings: Settings, resume: bool) -> pathlib.Path:
    """The folder of finished steps, made where it is not there yet; nothing is ever deleted.

    **Raises:** `jaxfrf.InputError` for a folder that holds something else, or a study that may not be continued, and
    where nothing can be written.
    """
    parts = folder / "parts"
    if folder.exists() and not folder.is_dir():
        raise input_error(str(folder), "a file", "a folder, or nothing", "Choose another name (-o).")
    if folder.exists() and any(folder.iterdir()):
        _check_may_go_on(folder, parts / "settings.json", settings, resume)
    try:
        parts.mkdir(parents=True, exist_ok=True)
        write_json(parts / "settings.json", stamp_of(settings))
    except OSError as error:
        raise input_error(
            str(folder), f"a place that cannot be written ({error.strerror})", "one that can", "Choose another (-o)."
        ) from error
    return parts


def _check_may_go_on(folder: pathlib.Path, path: pathlib.Path, settings: Settings, resume: bool) -> None:
    known = _read(path)
    if known is None:
        raise input_error(str(folder), "a folder with other files", "an empty one", "Choose another folder (-o).")
    finished = (folder / "study.json").exists()
    if not resume:
        raise input_error(
            str(folder),
            "a finished study" if finished else "an unfinished study",
            "an empty folder, or none",
            "Choose another folder (-o), or "
            + ("make its page again with --resume." if finished else "go on with it: add --resume."),
        )
    other = _differences(known, stamp_of(settings))
    if other:
        raise input_error(
            str(folder),
            f"a study made otherwise: {'; '.join(other)}",
            "the same settings and the same program",
            "Its parts are kept: go on with the settings and the program that it was begun with, or choose another "
            "folder (-o).",
        )


def _read(path: pathlib.Path) -> dict | None:
    """The stamp of a study, if this is one."""
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return known if isinstance(known, dict) and isinstance(known.get("settings"), dict) else None


def _differences(known: dict, wanted: dict) -> list[str]:
    names = dict.fromkeys((*known["settings"], *wanted["settings"]))
    pairs = [(n, known["settings"].get(n), wanted["settings"].get(n)) for n in names]
    pairs.append(("version", known.get("version"), wanted["version"]))
    found = [f"{n} {there} there, {here} here" for n, there, here in pairs if there != here]
    if known.get("program") != wanted["program"]:
        found.append("the program's files have changed since")
    return found
