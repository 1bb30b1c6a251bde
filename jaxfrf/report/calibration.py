"""The page about a calibrated robot: what was found, how each number is known, and what is still missed."""

import os

import numpy as np

from .._text import percent
from ..calibration import Calibration
from ..plot.calibration import numbers_found
from .page import facts, figure, number, page, paragraph, section, table, verdict, write_page

_OF_LINKS = ("mass", "com", "inertia")


def write_calibration(path: str | os.PathLike, found: Calibration) -> None:
    """Write the page about a calibration, one HTML file that needs nothing beside itself.

    **Arguments:** `path`: of the file. `found`: what `jaxfrf.calibrate` returned.

    **Raises:** `ImportError` without matplotlib; `jaxfrf.InputError` if the folder is not there.
    """
    write_page(path, calibration_page(found))


def calibration_page(found: Calibration) -> str:
    """The page about a calibration as HTML text."""
    names = ", ".join(s.name for s in found.sources) or "data in memory"
    sections = [_result(found), _missed(found), _numbers(found), _ripple(found), _rounds(found), _provenance(found)]
    return page(f"{found.given.name}: calibrated", [s for s in sections if s], f"whole robot from {names}")


def _result(found: Calibration) -> str:
    by = [found.determined_by(n.name) for n in found.numbers]
    count = lambda word: sum(b == word for b in by)
    word = "Converged" if found.converged else "Not converged"
    if found.unexplained:
        word += ", and not explained"
    texts = [
        f"{count('data')} of {len(by)} numbers are determined by the records, {count('data in combination')} only "
        f"together with others, {count('prior') + count('nothing')} are as they were known before.",
    ]
    if found.rounds[-1].design_effect > 1.05:
        texts.append(
            f"{number(found.rounds[-1].design_effect, 3)} lines count as one: errors of the model repeat from line to "
            "line."
        )
    if not found.converged:
        texts.append("The numbers still moved in the last round: more rounds may help, or the robot lacks an effect.")
    texts += [text[0].upper() + text[1:] for text in found.doubts()]
    return verdict(word, texts, found.converged and not found.unexplained)


def _missed(found: Calibration) -> str:
    columns = [found.missed_before, found.missed_after, *(found.heldout or ())]
    headers = ["axis", "as given", "calibrated", *(["held out, as given", "held out"] if found.heldout else [])]
    rows = [[name, *(percent(float(c[i]), 3) for c in columns)] for i, name in enumerate(found.given.axis_names)]
    note = (
        "Torque that the robot misses, of the measured torque without its mean; where lines are compared, referred to "
        "the measured motion, rms over all of them up to the highest excited one. Compared " + found.compared + "."
    )
    return section("What is missed", table(headers, rows), paragraph(note))


def _numbers(found: Calibration) -> str:
    drawn = figure(
        numbers_found(found)[0],
        "Change from what was given. Grey: what was known before, one and two standard deviations; dots with their "
        "95 % intervals; hollow and grey where the records alone do not determine the number.",
    )
    headers = ["number", "value", "95 % interval", "unit", "given", "determined by", "together with"]
    rows = []
    for n in found.numbers:
        low, high = found.interval(n.name)
        by = found.determined_by(n.name)
        partners = ", ".join(found.partners(n.name)[:3]) if by == "data in combination" else ""
        interval = f"{number(low)} to {number(high)}"
        rows.append([n.name, found.values[n.name], interval, n.unit, n.given, by, partners])
    note = (
        "Intervals come from the scatter between positions, and from what was known before so far as a number leans on "
        "it. An error of the model that is the same at every position is not in them."
    )
    return section("Numbers", drawn, table(headers, rows), paragraph(note))


def _ripple(found: Calibration) -> str:
    if not found.orders:
        return ""
    units = {"torque": "N m", "resolver": "rad"}
    rows = [
        [found.given.axis_names[o.axis], o.kind, o.order, float(np.hypot(*c)), units[o.kind]]
        for o, c in zip(found.orders, found.waves, strict=True)
    ]
    return section("Ripple", table(["axis", "of", "order", "amplitude", "unit"], rows))


def _rounds(found: Calibration) -> str:
    rows = [[i, r.misfit**0.5, r.left**0.5, r.design_effect] for i, r in enumerate(found.rounds, 1)]
    headers = ["round", "missed, floors", "after its step", "lines that count as one"]
    return section("The search", table(headers, rows))


def _provenance(found: Calibration) -> str:
    from .. import __version__

    return section(
        "Provenance", facts({"jaxfrf": __version__, **{s.name: f"sha256 {s.sha256}" for s in found.sources}})
    )
