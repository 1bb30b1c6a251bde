"""The page about FRFs: choose position, output and input, zoom, read values."""

import os
from collections.abc import Sequence

import numpy as np

from .._arguments import expect
from .._errors import input_error
from .._status import SERIOUS
from .._text import NORMAL_95, number, plus_minus
from ..frf import FRF
from ..frf.covariance import variances
from ..frf.features import features
from ..plot._style import COLOURS
from ..plot.bode import confidence_radius
from ..units import input_unit, output_unit, response_unit
from .page import facts, listing, page, paragraph, section, table, write_page
from .picture import Curve, decibel, picture, responses

_NUMBERS = 950_000  # of two bytes each, that a page holds: some 2.6 MB of text
_LINES = 12  # of a table of features


def write_frf_page(
    path: str | os.PathLike,
    frfs: FRF | Sequence[FRF],
    labels: Sequence[str] | None = None,
    *,
    about: Sequence[str] = (),
) -> None:
    """Write the page about one or several FRFs, one HTML file that needs nothing beside itself.

    **Arguments:** `path`: of the file. `frfs`, `labels`, `about`: as of `frf_page`.

    **Raises:** `jaxfrf.InputError` if the FRFs have other outputs and inputs, or the folder is not there.
    """
    write_page(path, frf_page(frfs, labels, about=about))


def frf_page(
    frfs: FRF | Sequence[FRF],
    labels: Sequence[str] | None = None,
    *,
    about: Sequence[str] = (),
    confidence: float = 0.95,
) -> str:
    """The page about FRFs of the same outputs and inputs, as HTML text, below 3 MB.

    A person chooses position, output and input, zooms and reads values. Of FRFs that are too large for a page, the
    first positions are shown, or every n-th line of them; the page says so.

    **Arguments:** `frfs`: one or several, of the same outputs and inputs. `labels`: a name for each, the methods by
    default. `about`: sentences to stand first. `confidence`: probability of the bands.

    **Returns:** the HTML of the page.

    **Raises:** `jaxfrf.InputError` where the FRFs do not fit together.
    """
    frfs = list(frfs) if isinstance(frfs, Sequence) else [frfs]
    for frf in frfs:
        expect("frfs", frf, FRF)
    if not frfs:
        raise input_error("frfs", "none", "at least one FRF", "Estimate one first.")
    labels = (
        [f.method.partition("(")[0] or f"estimate {k + 1}" for k, f in enumerate(frfs)] if labels is None else labels
    )
    _check(frfs, labels)
    positions, stride = _room(frfs)
    first = frfs[0]
    levels = first.cov_total is not None
    drawn = picture(
        [
            _curve(f, label, COLOURS[k % len(COLOURS)], positions, stride, confidence)
            for k, (f, label) in enumerate(zip(frfs, labels, strict=True))
        ],
        outputs=[f"y{i + 1} ({output_unit(first)})" for i in range(first.n_out)],
        inputs=[f"u{j + 1} ({input_unit(first)})" for j in range(first.n_in)],
        positions=[f"position {p}" for p in range(min(positions, max(f.n_pos for f in frfs)))],
        unit=response_unit(first),
        confidence=confidence,
        lines="dotted: noise, dashed: noise and distortion" if levels else "lines join neighbours",
    )
    left_out = _left_out(frfs, positions, stride)
    names = ", ".join(dict.fromkeys(s.name for f in frfs for s in f.sources))
    sections = [
        listing([*about, *left_out]),
        section("Response", drawn),
        _features(frfs, labels),
        _remarks(frfs, labels),
        _provenance(frfs, labels),
    ]
    said = [_extent(f) for f in frfs]
    alike = len(set(said)) == 1
    under = said[0] if alike else "; ".join(f"{label}: {text}" for label, text in zip(labels, said, strict=True))
    return page(f"FRF of {names}" if names else "FRF", [s for s in sections if s], under)


def _extent(frf: FRF) -> str:
    band = f"{len(frf.frequency)} lines from {number(frf.frequency[0], 4)} to {number(frf.frequency[-1], 4)} Hz"
    return f"{frf.n_out} x {frf.n_in}, {frf.n_pos} position{'s' if frf.n_pos > 1 else ''}, {band}"


def _check(frfs: Sequence[FRF], labels: Sequence[str]) -> None:
    if len(labels) != len(frfs):
        raise input_error("labels", f"{len(labels)}", f"one for each of the {len(frfs)} FRFs", "Name them all.")
    shapes = [(f.n_out, f.n_in, response_unit(f)) for f in frfs]
    for shape, label in zip(shapes, labels, strict=True):
        if shape != shapes[0]:
            raise input_error(
                label,
                f"{shape[0]} x {shape[1]} in {shape[2]}",
                f"{shapes[0][0]} x {shapes[0][1]} in {shapes[0][2]}, as the first",
                "Look at them in pages of their own.",
            )


# --- numbers


def _layers(frf: FRF) -> list[str]:
    more = {"noise": frf.cov_noise, "total": frf.cov_total} if frf.cov_total is not None else {}
    return ["level", "phase", "radius", "doubt", *(name for name, cov in more.items() if cov is not None)]


def _room(frfs: Sequence[FRF]) -> tuple[int, int]:
    """How many positions fit, and every how many-th line of them."""
    each = sum(f.G[0].size * len(_layers(f)) for f in frfs)
    most = max(f.n_pos for f in frfs)
    return max(1, min(most, _NUMBERS // each)), max(1, -(-each // _NUMBERS))


def _left_out(frfs: Sequence[FRF], positions: int, stride: int) -> list[str]:
    most, said = max(f.n_pos for f in frfs), []
    if positions < most:
        said.append(f"Positions 0 to {positions - 1} of {most} are shown: more make a page too large to open.")
    if stride > 1:
        said.append(f"One line of {stride} is shown: more make a page too large to open.")
    return said


def _curve(frf: FRF, label: str, colour: str, positions: int, stride: int, confidence: float) -> Curve:
    at = slice(None, positions), slice(None, None, stride)
    G = np.asarray(frf.G)[at]
    found = responses(G) | {
        "radius": decibel(np.asarray(confidence_radius(frf, confidence))[at]),
        "doubt": np.broadcast_to(_doubted(frf)[at][..., None, None], G.shape),
    }
    for name in _layers(frf)[4:]:
        spread = np.asarray(variances(getattr(frf, f"cov_{name}")))
        std = np.sqrt(np.maximum(spread, 0)).reshape(*frf.G.shape[:2], frf.n_in, frf.n_out)[at]
        found[name] = decibel(std).swapaxes(-1, -2)
    return Curve(label, colour, np.asarray(frf.frequency, float)[::stride], found)


def _doubted(frf: FRF) -> np.ndarray:
    return ((np.asarray(frf.status) & int(SERIOUS)) != 0).astype(float)


# --- words


def _features(frfs: Sequence[FRF], labels: Sequence[str]) -> str:
    """Of every one, side by side by element."""
    first, rows = frfs[0], []
    for k in range(min(first.n_out, first.n_in)):
        for frf, label in zip(frfs, labels, strict=True):
            for x in sorted(features(frf, k, k)[:_LINES], key=lambda x: x.frequency):
                known = np.isfinite(x.damping)
                damping = f"{plus_minus(100 * x.damping, 100 * NORMAL_95 * x.damping_std, '±')} %" if known else ""
                at = plus_minus(x.frequency, NORMAL_95 * x.frequency_std, "±")
                rows.append([f"G{k + 1}{k + 1}", *([label] if len(frfs) > 1 else []), x.kind, at, damping])
    if not rows:
        return ""
    where = " at the first position" if first.n_pos > 1 else ""
    headers = ["element", *(["of"] if len(frfs) > 1 else []), "kind", "Hz (95 %)", "damping (95 %)"]
    return section(f"Resonances and antiresonances{where}", table(headers, rows))


def _remarks(frfs: Sequence[FRF], labels: Sequence[str]) -> str:
    from .._status import describe

    said = list(dict.fromkeys(w for f in frfs for w in f.warnings))
    for f, label in zip(frfs, labels, strict=True):
        said += [f"{label}: {text}" if len(frfs) > 1 else text for text in describe(f.status)]
    return section("What to keep in mind", listing(said)) if said else ""


def _provenance(frfs: Sequence[FRF], labels: Sequence[str]) -> str:
    told = {}
    for label, f in zip(labels, frfs, strict=True):
        named = f"{label}: " if len(frfs) > 1 else ""
        told[label] = paragraph(named + (f.method or "method unknown")) + facts(
            {s.name: f"sha256 {s.sha256}" for s in f.sources}
        )
    return section("Provenance", *told.values())
