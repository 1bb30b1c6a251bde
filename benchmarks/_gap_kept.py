"""What every case said, in one file: a run goes on where an earlier one ended, be it on another machine."""

import json
import pathlib

from jaxfrf.io._json import write_json

_TOLD = ("verdict", "says", "effects", "wrong_numbers", "gap", "oracle", "placebo", "again", "wall_s", "peak_mb")
_ROUND = 6  # digits; a score needs fewer


def kept(path: pathlib.Path) -> dict[str, dict]:
    """Truth, result and commit of every case in the file by its part and number; none where there is no file."""
    return json.loads(path.read_text())["cases"] if path.exists() else {}


def keep(path: pathlib.Path, folder: pathlib.Path, commit: str) -> int:
    """Add the cases of this folder that are finished; how many there are then. A case stays as it was first kept."""
    rows = kept(path)
    for file in sorted((folder / "results").glob("*.json")):
        truth, result = (json.loads((folder / part / file.name).read_text()) for part in ("truth", "results"))
        written = (folder / "extended" / f"{file.stem}.toml").exists()
        if result["verdict"] == "failed" or (written and "again" not in result):
            continue
        told = {key: result[key] for key in _TOLD if key in result} | {"ranking": result.get("ranking", [])[:1]}
        rows.setdefault(f"{truth['part']} {file.stem}", {"commit": commit, "truth": truth, "result": _short(told)})
    write_json(path, {"cases": dict(sorted(rows.items()))})
    return len(rows)


def _short(value):
    """The same with numbers of a few digits."""
    match value:
        case dict():
            return {key: _short(x) for key, x in value.items()}
        case list():
            return [_short(x) for x in value]
        case float():
            return float(f"{value:.{_ROUND}g}")
        case _:
            return value
