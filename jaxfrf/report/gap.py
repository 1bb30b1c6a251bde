"""The page about a diagnosis: what is missing, where it shows, what it is worth, and what to do next."""

import html
import math
import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._text import NORMAL_95
from ..effects import library
from ..io.gaps import gap_contents
from ..plot.gap import gap_bode, gap_dumbbells, gap_maps, torque_courses
from .gap_record import RecordedDiagnosis, recorded
from .gap_words import (
    axes_of,
    closed,
    estimate,
    gap_name,
    headline,
    joined,
    p_text,
    percent,
    plain,
    ripple_written,
    what,
)
from .page import beside, choice, facts, figure, number, page, paragraph, section, table, wrapped, write_page
from .recorded import reading

_DRAWN = 2  # axes whose FRFs the page holds
_POSITIONS = 4  # of each
_LARGE = 0.2  # relative change of a parameter that asks for a reason
_LETTERS = {"tau": "τ", "theta": "θ", "omega": "ω", "eps": "ε"}
_OPEN = 12  # rows of a table that need no folding
_MOODS = {"sufficient": "good", "named": "found", "ambiguous": "doubt", "inconclusive": "doubt", "unexplained": "bad"}

_STYLE = """<style>
.says { border-left: 5px solid var(--mood); background: var(--wash); padding: 14px 18px; margin: 0 0 18px; }
.says p { font-size: 17px; margin: 6px 0 0; } .says .next { font-size: 15px; color: var(--soft); }
.chip { display: inline-block; background: var(--mood); color: #fff; border-radius: 3px; padding: 1px 10px;
  font-size: 13px; font-weight: 600; letter-spacing: .03em; }
.good { --mood: #0a6b4b; } .found { --mood: #0a5c96; } .doubt { --mood: #8a6100; } .bad { --mood: #b3400a; }
.tiles { display: flex; flex-wrap: wrap; gap: 12px 40px; margin: 0 0 8px; }
.tiles b { display: block; font-size: 23px; font-weight: 600; line-height: 1.25; font-variant-numeric: tabular-nums; }
.tiles span { color: var(--soft); font-size: 13.5px; }
.effect { border: 1px solid var(--line); border-radius: 4px; padding: 12px 18px 10px; margin: 0 0 14px; }
.effect h3 { font-size: 17px; font-weight: 600; margin: 0 0 2px; }
.effect .law { font-family: Georgia, "Times New Roman", serif; font-style: italic; font-size: 16px; margin: 0 0 8px; }
.effect dl { grid-template-columns: 190px 1fr; font-size: 14.5px; } .effect dd b { font-size: 16px; }
.bars { display: grid; grid-template-columns: max-content 320px max-content; gap: 5px 12px; align-items: center;
  font-size: 14px; margin: 14px 0 10px; font-variant-numeric: tabular-nums; }
.bars i { display: block; height: 13px; background: var(--c); min-width: 2px; }
.bars .before { --c: #d55e00; } .bars .after { --c: #009e73; } .bars .floor { --c: #b9c0c7; }
.step { border-left: 5px solid #0a5c96; background: var(--wash); padding: 10px 16px; font-size: 16px; max-width: 88ch; }
details > summary { cursor: pointer; color: #0a5c96; margin: 4px 0 8px; font-size: 14.5px; }
@media (max-width: 560px) { .bars { grid-template-columns: max-content 1fr max-content; } .effect dl {
  grid-template-columns: 1fr; } }
@media print { section { break-inside: avoid-page; } }
</style>"""


def write_gap_report(path: str | os.PathLike, diagnosis: Any) -> None:
    """Write the page about a `diagnosis`, as `jaxfrf.gap.diagnose` returns it, one HTML file that needs nothing else.

    **Arguments:** `path`: of the file. `diagnosis`: a `jaxfrf.gap.Diagnosis`, or what its gap.json holds
    (`jaxfrf.io.read_gap`): the FRFs are in no gap.json, and their pictures then not on the page.

    **Raises:** `ImportError` without matplotlib; `jaxfrf.InputError` if the folder is not there.
    """
    write_page(path, gap_page(diagnosis))


def gap_page(diagnosis: Any) -> str:
    """The page about a `diagnosis`, or about what its gap.json holds, as HTML text.

    **Arguments:** `diagnosis`: a `jaxfrf.gap.Diagnosis`, or what its gap.json holds (`jaxfrf.io.read_gap`).

    **Returns:** the HTML of the page.

    **Raises:** `jaxfrf.InputError` if the file lacks what the page shows; `ImportError` without matplotlib.
    """
    if not isinstance(diagnosis, Mapping):
        return _page(recorded(gap_contents(diagnosis), diagnosis.frf))
    with reading("gap.json", "diagnose"):
        return _page(recorded(diagnosis, from_file=True))


def _page(d: RecordedDiagnosis) -> str:
    names = joined([s["name"] for s in d.sources]) or "data in memory"
    positions = len(d.fitted) + len(d.heldout)
    subtitle = f"Diagnosis of {d.robot} from {names}, {positions} position{'s' if positions != 1 else ''}"
    sections = [
        _STYLE + _verdict(d) + _tiles(d),
        _where(d),
        _what(d),
        _worth(d),
        section("What to do next", f'<div class="step">{html.escape(d.next_experiment)}</div>')
        if d.next_experiment
        else "",
        _parameters(d),
        _provenance(d),
    ]
    return page(headline(d), [s for s in sections if s], subtitle)


# --- the verdict


def _verdict(d) -> str:
    following = f'<p class="next">Next: {html.escape(d.next_experiment)}</p>' if d.next_experiment else ""
    return (
        f'<div class="says {_MOODS.get(d.verdict, "doubt")}"><span class="chip">{html.escape(d.verdict)}</span>'
        f"<p>{html.escape(d.says)}</p>{following}</div>"
    )


def _tiles(d) -> str:
    gap = d.gap
    tiles = []
    for x in d.effects:
        for name, e in list(x.parameters.items())[: 2 if len(d.effects) == 1 else 1]:
            tiles.append((estimate(e), f"{plain(name)}, {what(x, 'named')}"))
    same = not _changed(d)
    tiles.append(
        (
            f"{number(gap.before, 3)}" if same else f"{number(gap.before, 3)} → {number(gap.after, 3)}",
            f"{gap_name(gap)}; floor {number(gap.floor, 3)}",
        )
    )
    if d.effects and math.isfinite(gap.shrink):
        tiles.append((percent(gap.shrink), f"of the gap closed on {gap.on}"))
    elif not d.effects:
        significant = [r.p_value for r in d.ranking if math.isfinite(r.p_value)]
        if significant:
            tiles.append((p_text(min(significant)), "of the best candidate, if nothing were missing (family-wise)"))
    rows = "".join(f"<div><b>{html.escape(a)}</b><span>{html.escape(b)}</span></div>" for a, b in tiles)
    return f'<div class="tiles">{rows}</div>'


# --- where


def _where(d) -> str:
    names, concerned = d.axis_names, axes_of(d)
    rows = [
        [
            "all" if c.position is None else str(c.position),
            c.channel,
            "{:.3g} to {:.3g}".format(*c.band_hz),
            number(c.z, 2),
            c.says,
        ]
        for c in d.where
    ]
    if rows:
        told = wrapped(table(["position", "where", "band, Hz", "rms / floor", "in words"], rows))
    else:
        told = paragraph("No cell stands out of the floor.")
    after = d.maps.after if _changed(d) else None
    maps = figure(
        gap_maps(d.maps.before, after, d.maps.bands, names, marked=concerned, heldout=d.heldout)[0],
        f"{d.gap.quantity[:1].upper()}{d.gap.quantity[1:]} (measured less simulated) over its floor, rms: a block for "
        "each axis, a row for each position"
        f"{' (bold: held out)' if d.heldout else ''}, a column for each band. 1 is what noise and an honest model "
        "leave.",
    )
    heading = "Where the model was wrong" if d.effects else "Where model and measurement differ"
    return section(heading, told, maps, _courses(d, names, concerned))


def _changed(d) -> bool:
    """Whether there is a before and an after."""
    return bool(d.effects) or not np.array_equal(d.maps.before, d.maps.after, equal_nan=True)


def _courses(d, names, concerned) -> str:
    courses = d.maps.courses if _changed(d) else {signal: own[:2] for signal, own in d.maps.courses.items()}
    if not courses:
        return ""
    caption = "Mean torque residual against the motor's speed, the arm's angle and the load; one scale for each axis."
    rest = [n for n in names if n not in concerned]
    blocks = []
    if concerned:
        blocks.append(figure(torque_courses(courses, names, concerned)[0], caption))
    if rest:
        others = figure(torque_courses(courses, names, rest, row=0.6)[0], "" if concerned else caption)
        blocks.append(_folded("The other axes", others) if concerned else others)
    return "\n".join(blocks)


# --- what


def _what(d) -> str:
    if d.effects:
        cards = "".join(_card(x, what(x, d.verdict)) for x in d.effects)
        return section("What is missing", cards, _rivals(d))
    why = {
        "sufficient": "No effect was added: no candidate explains more than chance would.",
        "inconclusive": "No effect was added: no candidate explains more than chance, in data that could hide one.",
        "unexplained": "No effect was added: the best candidates explain less than half of what is systematic.",
    }
    return section("What was tried", paragraph(why.get(d.verdict, "No effect was added.")), _rivals(d))


def _card(x, title: str) -> str:
    values = "<br>".join(
        f"{html.escape(plain(name))} <b>{html.escape(estimate(e))}</b>" for name, e in x.parameters.items()
    )
    rows = [
        ("with 95 % intervals", values),
        ("in data", html.escape(_greek(x.signature))),
        ("evidence", html.escape(_evidence(x))),
    ]
    if x.equivalent:
        alike = html.escape(joined([plain(n) for n in x.equivalent]))
        rows.append(("looks the same here", alike))
    if x.separating_experiment:
        rows.append(("what would separate them", html.escape(x.separating_experiment)))
    body = "".join(f"<dt>{a}</dt><dd>{b}</dd>" for a, b in rows)
    heading = html.escape(title[:1].upper() + title[1:])
    law = html.escape(_greek(x.equation))
    return f'<div class="effect"><h3>{heading}</h3><p class="law">{law}</p><dl>{body}</dl></div>'


def _greek(text: str) -> str:
    """tau, theta and the others as they are written by hand."""
    return re.sub(r"\b(tau|theta|omega|eps)(?![a-z])", lambda m: _LETTERS[m[1]], text).replace("sum_h", "Σ_h")


def _evidence(x) -> str:
    found = [
        f"explains {percent(x.explains)} of the misfit above the floor" if math.isfinite(x.explains) else "",
        f"{number(x.visible, 2)} times the just visible size" if math.isfinite(x.visible) else "",
        f"{p_text(x.p_value)} if nothing were missing (family-wise)" if math.isfinite(x.p_value) else "",
    ]
    return "; ".join(f for f in found if f)


def _rivals(d) -> str:
    if not d.ranking:
        return ""
    named = {(x.name, x.joint): "● " for x in d.effects}
    alike = {(name, x.joint): "○ " for x in d.effects for name in x.equivalent}
    rows = [
        [
            (alike | named).get((r.name, r.joint), "") + plain(r.name),
            r.joint,
            percent(r.score),
            p_text(r.p_value).removeprefix("p ").removeprefix("= "),
            _expected(r),
            r.why,
        ]
        for r in d.ranking
    ]
    headers = ["candidate", "joint", "explains alone", "p", "expected", "why it was taken, or not"]
    kept = [k for k in range(len(headers)) if any(row[k] for row in rows)]
    headers, rows = [headers[k] for k in kept], [[row[k] for k in kept] for row in rows]
    note = paragraph(
        "Candidates by the part of the misfit that each would explain alone, before any refit"
        + (f" (● named{', ○ looks the same' if alike else ''})." if named else ".")
    )
    return note + wrapped(table(headers, rows))


def _expected(ranked) -> str:
    units = library()[ranked.name].units if ranked.name in library() else {}
    pairs = ((plain(name), f"{value:.3g}", units.get(name, "1")) for name, value in ranked.expected.items())
    return ", ".join(" ".join((name, value, *((unit,) if unit != "1" else ()))) for name, value, unit in pairs)


# --- what it is worth


def _worth(d) -> str:
    gap, names = d.gap, d.axis_names
    after = gap.torque_after if _changed(d) else None
    of = gap.unit if gap.unit.startswith("of ") else "of the torque" if "torque" in gap.quantity else ""
    label = f"{gap.quantity}, % {of} (rms)".replace("  ", " ")
    drawn = figure(gap_dumbbells(gap.torque_before, after, names, marked=axes_of(d), label=label)[0])
    says = f"On {gap.on}: {closed(gap)}."
    unit = f'<p style="color:var(--soft)">{html.escape(gap_name(gap))}</p>'
    heading = "What it is worth" if d.effects else "How large the gap is"
    return section(heading, paragraph(says), beside(_bars(gap, _changed(d)) + unit, drawn), _bode(d))


def _bars(gap, changed: bool) -> str:
    shown = (("before", "before"), ("after", "after")) if changed else (("before", "gap"),)
    top = max(x for x in (gap.before, gap.after, gap.floor, 1e-300) if math.isfinite(x))
    rows = []
    for field, name in (*shown, ("floor", "floor")):
        value = getattr(gap, field)
        part = 100 * max(value, 0.0) / top if math.isfinite(value) else 0.0
        rows.append(f'<span>{name}</span><i class="{field}" style="width:{part:.1f}%"></i><b>{number(value, 3)}</b>')
    return f'<div class="bars">{"".join(rows)}</div>'


def _bode(d) -> str:
    if d.from_file:
        return paragraph(
            "Pictures of the FRFs are on the page that `jaxfrf diagnose --report` makes: a gap.json holds none."
        )
    if d.frf is None:
        return paragraph("There are no FRFs on held-out positions to compare.")
    names = d.axis_names
    drawn = [names.index(n) for n in axes_of(d)][:_DRAWN] or [_worst(d.gap)]
    frfs = d.frf if _changed(d) else d.frf[:2]
    many = min(d.frf[0].n_pos, _POSITIONS)
    blocks = {}
    for axis in drawn:
        for k in range(many):
            label = str(d.heldout[k]) if k < len(d.heldout) else str(k)
            blocks[f"{names[axis]}, position {label}"] = figure(gap_bode(frfs, axis, k)[0])
    text = paragraph(
        "FRF of the axis on held-out positions: simulated ones went through the same experiment and estimator as the "
        "measured one."
    )
    more = d.frf[0].n_pos - many
    tail = paragraph(f"{more} more held-out positions are not shown.") if more > 0 else ""
    return text + choice("bode", blocks) + tail


def _worst(gap) -> int:
    before = np.asarray(gap.torque_before, float)
    return int(np.nanargmax(before)) if np.isfinite(before).any() else 0


# --- the model, and where all this comes from


def _parameters(d) -> str:
    order = sorted(d.parameters, key=lambda n: -abs(_finite(d.changed.get(n))))
    rows = []
    for name in order:
        x, change = d.parameters[name], d.changed.get(name, math.nan)
        flags = [
            *(["large: look for a reason"] if abs(_finite(change)) > _LARGE else []),
            *(["new"] if not math.isfinite(change) else []),
            *(["interval not known"] if not math.isfinite(x.std) else []),
        ]
        start = x.value / (1 + change) if math.isfinite(change) and change != -1 else None
        rows.append(
            [
                name,
                start,
                x.value,
                percent(change, signed=True) if math.isfinite(change) else None,
                number(NORMAL_95 * x.std, 2) if math.isfinite(x.std) else None,
                "" if x.unit == "1" else x.unit,
                ", ".join(flags),
            ]
        )
    if not rows:
        return ""
    headers = ["parameter", "given", "found", "change", "± (95 %)", "unit", ""]
    large = [n for n in order if abs(_finite(d.changed.get(n))) > _LARGE]
    said = (
        f"{joined(large)} moved by more than {percent(_LARGE)}: a missing effect can hide in such a shift."
        if large
        else f"No parameter of the given model moved by more than {percent(_LARGE)}."
    )
    shown = table(headers, rows, flags=[len(headers) - 1])
    if len(rows) > _OPEN:
        shown = _folded(f"All {len(rows)} parameters", shown)
    waves = ripple_written(d)
    return section("Parameters of the extended model", paragraph(said), paragraph(waves) if waves else "", shown)


def _finite(x: float | None) -> float:
    return x if x is not None and math.isfinite(x) else 0.0


def _provenance(d) -> str:
    about = {
        "compared": d.compared,
        "positions fitted": ", ".join(map(str, d.fitted)) or "none",
        "positions held out": ", ".join(map(str, d.heldout)) or "none",
        **{str(k): _plain(v) for k, v in d.settings.items()},
        "jaxfrf": d.version,
        **{s["name"]: f"sha256 {s['sha256']}" for s in d.sources},
    }
    return section("Settings and provenance", facts({k: v for k, v in about.items() if v not in ("", None)}))


def _plain(value) -> object:
    if isinstance(value, dict):
        return "; ".join(f"{name}: {_plain(x)}" for name, x in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(str(_plain(x)) for x in value)
    return f"{value:g}" if isinstance(value, float) else value


# --- blocks


def _folded(summary: str, block: str) -> str:
    return f"<details><summary>{html.escape(summary)}</summary>{block}</details>"
