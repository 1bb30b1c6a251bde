"""The page about a calibrated robot: what was found, how each number is known, and what is still missed."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._text import percent
from ..calibration import Calibration, Number
from ..io.fits import plain_data
from ..plot.calibration import draw_numbers
from .page import facts, figure, number, page, paragraph, section, table, verdict, wrapped, write_page
from .recorded import finite, reading


def write_calibration(path: str | os.PathLike, found: Calibration | Mapping[str, Any]) -> None:
    """Write the page about a calibration, one HTML file that needs nothing beside itself.

    **Arguments:** `path`: of the file. `found`: what `jaxfrf.calibrate` returned, or what its fit.json holds
    (`jaxfrf.io.read_fit`).

    **Raises:** `ImportError` without matplotlib; `jaxfrf.InputError` if the folder is not there.
    """
    write_page(path, calibration_page(found))


def calibration_page(found: Calibration | Mapping[str, Any]) -> str:
    """The page about a calibration, or about what its fit.json holds, as HTML text.

    **Arguments:** `found`: what `jaxfrf.calibrate` returned, or what its fit.json holds (`jaxfrf.io.read_fit`).

    **Returns:** the HTML of the page.

    **Raises:** `jaxfrf.InputError` if the file lacks what the page shows; `ImportError` without matplotlib.
    """
    if not isinstance(found, Mapping):
        return _page(plain_data(found.as_dict()))
    with reading("fit.json", "identify"):
        return _page(found)


def _page(held: Mapping[str, Any]) -> str:
    names = ", ".join(s["name"] for s in held["sources"]) or "data in memory"
    sections = [_result(held), _missed(held), _numbers(held), _ripple(held), _rounds(held), _provenance(held)]
    return page(f"{held['robot']}: calibrated", [s for s in sections if s], f"whole robot from {names}")


def _result(held: Mapping[str, Any]) -> str:
    by = [p["determined_by"] for p in held["parameters"].values()]
    count = lambda word: sum(b == word for b in by)
    converged, doubts, effect = held["converged"], held["doubts"], held["rounds"][-1]["design_effect"]
    word = "Converged" if converged else "Not converged"
    if doubts:
        word += ", and not explained"
    texts = [
        f"{count('data')} of {len(by)} numbers are determined by the records, {count('data in combination')} only "
        f"together with others, {count('prior') + count('nothing')} are as they were known before.",
    ]
    if finite(effect) > 1.05:
        texts.append(f"{number(effect, 3)} lines count as one: errors of the model repeat from line to line.")
    if not converged:
        texts.append("The numbers still moved in the last round: more rounds may help, or the robot lacks an effect.")
    texts += [text[0].upper() + text[1:] for text in doubts]
    return verdict(word, texts, converged and not doubts)


def _missed(held: Mapping[str, Any]) -> str:
    missed = held["torque_missed"]
    columns = [missed["before"], missed["after"], *(missed["heldout"] or ())]
    headers = ["axis", "as given", "calibrated", *(["held out, as given", "held out"] if missed["heldout"] else [])]
    rows = [[name, *(percent(finite(c[i]), 3) for c in columns)] for i, name in enumerate(held["axes"])]
    note = (
        "Torque that the robot misses, of the measured torque without its mean; where lines are compared, referred to "
        "the measured motion, rms over all of them up to the highest excited one. Compared " + held["compared"] + "."
    )
    return section("What is missed", table(headers, rows), paragraph(note))


def _numbers(held: Mapping[str, Any]) -> str:
    own = held["parameters"]
    determined = [name for name, p in own.items() if p["determined_by"] == "data"]
    numbers, x, half = zip(*(_coordinates(name, p) for name, p in own.items()), strict=True)
    drawn = figure(
        draw_numbers(numbers, x, half, determined)[0],
        "Change from what was given. Grey: what was known before, one and two standard deviations; dots with their "
        "95 % intervals; hollow and grey where the records alone do not determine the number.",
    )
    headers = ["number", "value", "95 % interval", "unit", "given", "determined by", "together with"]
    rows = []
    for name, p in own.items():
        low, high = p["interval95"]
        interval = f"{number(finite(low))} to {number(finite(high))}"
        rows.append([name, p["value"], interval, p["unit"], p["start"], p["determined_by"], ", ".join(p["with"])])
    note = (
        "Intervals come from the scatter between positions (of few records: between runs, or bands of lines), and from "
        "what was known before so far as a number leans on it. An error of the model that is the same everywhere is "
        "not in them."
    )
    return section("Numbers", drawn, wrapped(table(headers, rows)), paragraph(note))


def _coordinates(name: str, held: Mapping[str, Any]) -> tuple[Number, float, float]:
    """A number, where it is and half its interval, in tolerances; off the scale where its interval has no end."""
    own = Number(
        name=name,
        kind=held["kind"],
        unit=held["unit"],
        given=held["start"],
        size=held["size"],
        positive=held["logarithmic"],
        prior=float(held["known_before"]),
    )
    at, high = own.coordinate(held["value"]), held["interval95"][1]
    return own, at, float("nan") if high is None else own.coordinate(high) - at


def _ripple(held: Mapping[str, Any]) -> str:
    if not held["ripple"]:
        return ""
    units = {"torque": "N m", "resolver": "rad"}
    rows = [
        [o["joint"], o["kind"], o["order"], float(np.hypot(o["sine"], o["cosine"])), units[o["kind"]]]
        for o in held["ripple"]
    ]
    return section("Ripple", table(["axis", "of", "order", "amplitude", "unit"], rows))


def _rounds(held: Mapping[str, Any]) -> str:
    root = lambda x: finite(x) ** 0.5
    rows = [[i, root(r["misfit"]), root(r["left"]), r["design_effect"]] for i, r in enumerate(held["rounds"], 1)]
    headers = ["round", "missed, floors", "after its step", "lines that count as one"]
    return section("The search", table(headers, rows))


def _provenance(held: Mapping[str, Any]) -> str:
    sources = {s["name"]: f"sha256 {s['sha256']}" for s in held["sources"]}
    return section("Provenance", facts({"jaxfrf": held["version"], **sources}))
