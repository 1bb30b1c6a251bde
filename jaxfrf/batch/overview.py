"""All results of a batch at a glance: a table for programs, a page for people."""

import csv
import html
import os
import pathlib
from collections.abc import Mapping
from urllib.parse import quote

from .._files import replacing

_COLUMNS = 200  # of the table, at most
_SHOWN = 8  # of the page


def write_table(path: str | os.PathLike, outcomes: Mapping[str, Mapping]) -> None:
    """One row a file: name, file, whether it went well, seconds, message, and every number and word of its summary."""
    rows = {name: _flat(outcome.get("summary", {})) for name, outcome in outcomes.items()}
    columns = list(dict.fromkeys(key for row in rows.values() for key in row))[:_COLUMNS]
    with replacing(pathlib.Path(path)) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "file", "ok", "seconds", "message", *columns])
        for name, outcome in outcomes.items():
            about = [outcome.get(key, "") for key in ("file", "ok", "seconds", "message")]
            writer.writerow([name, *about, *(rows[name].get(key, "") for key in columns)])


def write_page(path: str | os.PathLike, title: str, outcomes: Mapping[str, Mapping]) -> None:
    """A page with every file's picture, what was found of it, and what went wrong with which."""
    from ..report.page import page, section, verdict, write_page as write_html  # with it come all that is reported

    bad = {name: outcome for name, outcome in outcomes.items() if not outcome["ok"]}
    word = f"{len(outcomes) - len(bad)} of {len(outcomes)} files"
    blocks = [verdict(word, [f"{name}: {outcome['message']}" for name, outcome in bad.items()], good=not bad)]
    good = {name: outcome for name, outcome in outcomes.items() if outcome["ok"]}
    if good:
        blocks.append(section("Every file", *(_entry(pathlib.Path(path).parent, n, o) for n, o in good.items())))
    write_html(path, page(title, blocks, "The same numbers, and all others, stand in table.csv."))


def _entry(folder: pathlib.Path, name: str, outcome: Mapping) -> str:
    from ..report.page import number

    files = [pathlib.Path(file).name for file in outcome["summary"].get("output", [])]
    links = ", ".join(f'<a href="{quote(file)}">{html.escape(file)}</a>' for file in files)
    pictures = [file for file in files if file.endswith((".png", ".svg")) and (folder / file).is_file()]
    shown = "".join(
        f'<img loading="lazy" alt="{html.escape(name)}" src="{quote(file)}" style="max-width:100%">'
        for file in pictures[:1]
    )
    facts = list(_flat(outcome["summary"]).items())[:_SHOWN]
    rows = "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(number(value))}</dd>" for key, value in facts)
    return f"<h3>{html.escape(name)}</h3><dl>{rows}<dt>files</dt><dd>{links}</dd></dl><figure>{shown}</figure>"


def _flat(tree, name: str = "") -> dict[str, object]:
    """Numbers and words by dotted names; lists of at most six with their places, longer ones left out."""
    if isinstance(tree, Mapping):
        items = list(tree.items())
    elif isinstance(tree, list) and len(tree) <= 6 and not any(isinstance(x, Mapping | list) for x in tree):
        items = [(str(place), x) for place, x in enumerate(tree, 1)]
    else:
        return {} if isinstance(tree, list) or name.startswith("output") else {name: tree}
    flat: dict[str, object] = {}
    for key, value in items:
        flat |= _flat(value, f"{name}.{key}" if name else str(key))
    return {key: value for key, value in flat.items() if not key.startswith("output")}
