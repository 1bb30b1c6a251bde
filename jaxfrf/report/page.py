"""Blocks of a page that needs nothing beside itself: text, tables, figures, in one HTML file.

A block is a piece of HTML; `section` and `page` put blocks together. Text is escaped, figures are embedded.
"""

import base64
import html
import io
import math
import os
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from .._files import replacing
from .._text import number as significant

_STYLE = """
:root { --ink: #1b1f24; --soft: #5c6670; --line: #d8dde2; --paper: #ffffff; --wash: #f5f7f9; --bad: #b3400a;
  --good: #0a6b4b; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); overflow-wrap: break-word;
  font: 15px/1.5 "Source Sans 3", "Helvetica Neue", "Segoe UI", Arial, sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 36px 28px 60px; }
h1 { font-size: 27px; line-height: 1.2; font-weight: 600; margin: 0 0 4px; }
.subtitle { color: var(--soft); margin: 0 0 22px; }
h2 { font-size: 18px; font-weight: 600; margin: 38px 0 10px; padding-top: 12px; border-top: 1px solid var(--line); }
p { margin: 0 0 10px; max-width: 78ch; }
.verdict { border-left: 4px solid var(--good); background: var(--wash); padding: 12px 16px; margin: 0 0 16px; }
.verdict.bad { border-color: var(--bad); }
.verdict strong { display: block; font-size: 17px; }
.verdict ul, ul.plain { margin: 6px 0 0; padding-left: 18px; max-width: 92ch; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; margin: 4px 0 12px; }
th { text-align: left; font-weight: 600; color: var(--soft); border-bottom: 1px solid var(--ink); }
th, td { padding: 4px 14px 4px 0; vertical-align: baseline; white-space: nowrap; }
td { border-bottom: 1px solid var(--line); }
th.number, td.number { text-align: right; }
td.flag { color: var(--bad); white-space: normal; }
.wrapped td:last-child { white-space: normal; min-width: 260px; }
figure { margin: 8px 0 18px; }
figure img { max-width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: 13.5px; max-width: 92ch; margin-top: 4px; }
@media (max-width: 640px) { table { display: block; overflow-x: auto; }
  figure { overflow-x: auto; } figure img { max-width: 720px; } }
.beside { display: flex; flex-wrap: wrap; gap: 8px 36px; align-items: flex-start; }
.beside > div { max-width: 100%; } .beside figure { display: table; }
.beside figcaption { display: table-caption; caption-side: bottom; }
@media (max-width: 640px) { .beside figure, .beside figcaption { display: block; } }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 2px 18px; font-size: 14px; margin: 0; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
.tabs > input { position: absolute; opacity: 0; }
.tabs > label { display: inline-block; padding: 3px 11px; margin: 0 4px 8px 0; border: 1px solid var(--line);
  border-radius: 3px; font-size: 13.5px; cursor: pointer; }
.tabs > input:checked + label { background: var(--ink); color: var(--paper); border-color: var(--ink); }
.tabs > input:focus-visible + label { outline: 2px solid #0072b2; }
.tabs > div { display: none; }
@media print {
  main { max-width: none; padding: 0; }
  .tabs > div { display: block !important; } .tabs > label { display: none; }
  .wide, table, figure { overflow: visible; } th, td { white-space: normal; padding-right: 8px; }
  .wrapped td:last-child { min-width: 0; }
  table { font-size: 12px; max-width: 100%; } thead { display: table-header-group; }
  figure, tr, dl, .verdict { break-inside: avoid; } h2, h3 { break-after: avoid; }
  details::details-content { content-visibility: visible; block-size: auto; }
  .verdict, .tabs { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""


def page(title: str, sections: Sequence[str], subtitle: str = "") -> str:
    """A whole page: a title, a line below it, sections.

    **Arguments:** `title`, `subtitle`: plain text. `sections`: HTML, as of `section`.

    **Returns:** the HTML of the page.
    """
    under = f'<p class="subtitle">{html.escape(subtitle)}</p>' if subtitle else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{html.escape(title)}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{html.escape(title)}</h1>\n{under}\n"
        + "\n".join(sections)
        + "\n</main>\n</body>\n</html>\n"
    )


def write_page(path: str | os.PathLike, text: str) -> None:
    """Write a page, whole or not at all.

    **Arguments:** `path`: of the file. `text`: the HTML of `page`.

    **Raises:** `jaxfrf.InputError` if the folder is not there.
    """
    with replacing(pathlib.Path(path)) as draft:
        draft.write_text(text, encoding="utf-8")


def section(heading: str, *blocks: str) -> str:
    """Blocks below a heading.

    **Arguments:** `heading`: plain text. `blocks`: HTML; empty ones are left out.

    **Returns:** HTML.
    """
    return f"<section>\n<h2>{html.escape(heading)}</h2>\n" + "\n".join(b for b in blocks if b) + "\n</section>"


def paragraph(text: str) -> str:
    """A paragraph of text, escaped.

    **Arguments:** `text`: plain text.

    **Returns:** HTML.
    """
    return f"<p>{html.escape(text)}</p>"


def listing(texts: Sequence[str]) -> str:
    """A list of sentences; nothing where there are none.

    **Arguments:** `texts`: plain text.

    **Returns:** HTML.
    """
    rows = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f'<ul class="plain">{rows}</ul>' if rows else ""


def verdict(word: str, texts: Sequence[str], good: bool) -> str:
    """What came out, in a word and in sentences; green at the edge where it is `good`, red where not.

    **Arguments:** `word`, `texts`: plain text.

    **Returns:** HTML.
    """
    mood = "verdict" if good else "verdict bad"
    return f'<div class="{mood}"><strong>{html.escape(word)}</strong>{listing(texts)}</div>'


def table(headers: Sequence[str], rows: Sequence[Sequence[object]], flags: Sequence[int] = ()) -> str:
    """A table; columns of numbers are right-aligned, with four significant digits.

    **Arguments:** `headers`: one for each column. `rows`: as long each; texts, numbers, or `None` for nothing. `flags`:
    columns that say what is wrong, from 0.

    **Returns:** HTML.
    """
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(headers)
    numeric = [
        bool(c) and all(_is_number(x) for x in c if x not in (None, "")) and any(x is not None for x in c)
        for c in columns
    ]
    kind = [' class="flag"' if k in flags else ' class="number"' if n else "" for k, n in enumerate(numeric)]
    head = "".join(f"<th{c}>{html.escape(name)}</th>" for c, name in zip(kind, headers, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td{c}>{html.escape(number(x))}</td>" for c, x in zip(kind, row, strict=True)) + "</tr>\n"
        for row in rows
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def wrapped(block: str) -> str:
    """A table whose last column holds sentences."""
    return f'<div class="wrapped">{block}</div>'


_NUMBER = re.compile(r"[-+±]?\s?\d[\d.\s]*(e[-+]?\d+)?( %)?( (to|±) .*| \[.*\])?")


def _is_number(x: object) -> bool:
    return isinstance(x, int | float) or (isinstance(x, str) and _NUMBER.fullmatch(x) is not None)


_NOTHING = 1e-60  # what rounding leaves of zero


def number(x: object, digits: int = 4) -> str:
    """A number as people write it: four significant digits, thousands whole, no exponent where there is room.

    **Arguments:** `x`: a number, or what stands for one: a text stays as it is, `None` becomes empty, a number that is
    not finite a dash. `digits`: significant ones.

    **Returns:** plain text.
    """
    if x is None:
        return ""
    if isinstance(x, str):
        return x
    if isinstance(x, bool) or not isinstance(x, int | float):
        return str(x)
    if isinstance(x, int):
        return f"{x}"
    if not math.isfinite(x):
        return "-"
    return "0" if abs(x) < _NOTHING else significant(x, digits, zeros=True)


def facts(pairs: Mapping[str, object]) -> str:
    """Names and values, side by side.

    **Arguments:** `pairs`: {name: value}, texts or numbers.

    **Returns:** HTML.
    """
    rows = "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(number(v))}</dd>" for k, v in pairs.items())
    return f"<dl>{rows}</dl>"


def figure(picture: Any, caption: str = "", kind: str = "svg") -> str:
    """A matplotlib figure, `picture`, embedded: `svg` for few marks, `png` for many.

    **Arguments:** `picture`: a matplotlib figure. `caption`: plain text below it. `kind`: `svg` or `png`.

    **Returns:** HTML with the picture in it.
    """
    buffer = io.BytesIO()
    options = {"dpi": 170} if kind == "png" else {"metadata": {"Date": None}}
    picture.savefig(buffer, format=kind, facecolor="white", **options)
    mime = {"svg": "image/svg+xml", "png": "image/png"}[kind]
    width = round(96 * picture.get_figwidth())
    data = base64.b64encode(buffer.getvalue()).decode()
    text = html.escape(caption)
    under = f"<figcaption>{text}</figcaption>" if caption else ""
    return f'<figure><img width="{width}" alt="{text}" src="data:{mime};base64,{data}">{under}</figure>'


def beside(*blocks: str) -> str:
    """Blocks side by side where there is room.

    **Arguments:** `blocks`: HTML; empty ones are left out.

    **Returns:** HTML.
    """
    return '<div class="beside">' + "".join(f"<div>{b}</div>" for b in blocks if b) + "</div>"


def choice(name: str, blocks: Mapping[str, str]) -> str:
    """One of several blocks at a time, chosen by its label (all of them in print); no script.

    **Arguments:** `name`: its own on the page, letters only. `blocks`: {label: HTML}; the first one is shown at the
    beginning.

    **Returns:** HTML.
    """
    marks, rules = [], []
    for k, label in enumerate(blocks):
        checked = " checked" if k == 0 else ""
        own = f"{name}-{k}"
        marks.append(
            f'<input type="radio" name="{name}" id="{own}"{checked}><label for="{own}">{html.escape(label)}</label>'
        )
        rules.append(f"#{own}:checked ~ #{own}-block {{ display: block; }}")
    shown = "".join(f'<div id="{name}-{k}-block">{block}</div>' for k, block in enumerate(blocks.values()))
    return f'<style>{" ".join(rules)}</style><div class="tabs">{"".join(marks)}{shown}</div>'
