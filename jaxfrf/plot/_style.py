"""What all pictures share: colours, axes, the rule for joining points, the legend outside the data,
saving."""

import itertools
import os
import pathlib
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool

from .._arguments import expect_path, said
from .._errors import input_error
from .._files import replacing
from .._types import Array, Frequency
from ..io._optional import require

# Of matplotlib, which is imported where something is drawn:
Figure: TypeAlias = Any
Axes: TypeAlias = Any

# Okabe & Ito (2008): told apart by all common kinds of colour vision; the order keeps neighbours far apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DOUBTFUL = "#9A9A9A"
SMALL, NORMAL = 7.5, 9.0  # font sizes, points
_ROW = 0.14  # inches of a row of small text

_GAP = 2.2  # steps of quantised logarithmic grids differ by up to a factor of 2
_NEIGHBOURS = 4  # steps on each side that say what is regular
_WIDE = 5.0  # a band this many times as high as its lowest frequency gets a logarithmic axis


def save(figure: Figure, path: str | os.PathLike) -> None:
    """Save a `figure` to `path`, whole or not at all; the suffix says the format (`.png`, `.pdf`, `.svg`, ...).

    **Arguments:** `figure`: of matplotlib. `path`: of the file; pictures made of pixels have 200 of them an inch.

    **Raises:** `jaxfrf.InputError` if `figure` is none, matplotlib does not know the format, or the folder is not
    there.
    """
    expect_path("path", path)
    if not hasattr(figure, "savefig"):
        raise input_error("figure", said(figure), "a figure of matplotlib", "Functions of jaxfrf.plot give it first.")
    path = pathlib.Path(path)
    known = figure.canvas.get_supported_filetypes()
    if path.suffix.lower().lstrip(".") not in known:
        raise input_error(
            str(path),
            f"the suffix {path.suffix or '(none)'}",
            f"one of {', '.join('.' + k for k in sorted(known))}",
            "Name the file accordingly.",
        )
    with replacing(path) as draft:
        figure.savefig(draft, dpi=200, facecolor="white")


def breaks(frequency: Frequency) -> Bool[Array, "step"]:
    """Where a gap stands between neighbouring frequencies, so that no line may join them.

    A step is a gap if it is more than 2.2 times the (lower) median of the steps around it, four to each side.
    Steps are measured in frequency or in its logarithm, whichever is more even there: linear and logarithmic
    grids are both regular. One missing line is still bridged, two are not.

    **Arguments:** `frequency`: (freq,), ascending. **Returns:** one truth value per step.
    """
    frequency = np.asarray(frequency, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        measures = [_around(np.diff(x)) for x in (frequency, np.log(frequency))]
    (linear, linear_spread), (logarithmic, logarithmic_spread) = measures
    return np.where(logarithmic_spread < linear_spread, logarithmic, linear) > _GAP


def _around(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every step over the typical one around it, and how uneven (median deviation of the logarithm) these
    are."""
    ratio, spread = np.ones(len(steps)), np.full(len(steps), np.inf)
    for k, step in enumerate(steps):
        near = np.sort(steps[max(k - _NEIGHBOURS, 0) : k + _NEIGHBOURS + 1])
        typical = near[(len(near) - 1) // 2]
        if typical > 0 and np.isfinite(near).all():
            ratio[k], spread[k] = step / typical, np.median(np.abs(np.log(near / typical)))
    return ratio, spread


def pieces(frequency: Frequency, joinable: Bool[Array, "freq"], apart=None) -> list[slice]:
    """Runs of points that a line may join: all `joinable`, without a gap, and not `apart` (a bool per
    step)."""
    cut = breaks(frequency) | ~joinable[:-1] | ~joinable[1:]
    if apart is not None:
        cut = cut | apart
    edges = [0, *(np.flatnonzero(cut) + 1), len(frequency)]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a and joinable[a:b].all()]


def polyline(frequency, value, runs: Sequence[slice]) -> tuple[np.ndarray, np.ndarray]:
    """x and y of one line that is interrupted (by NaN) between the runs."""
    x = [np.append(frequency[run], np.nan) for run in runs]
    y = [np.append(value[run], np.nan) for run in runs]
    return np.concatenate([[], *x]), np.concatenate([[], *y])


def marker_size(n_points: int, width: float) -> float:
    """Points: about as wide as the distance of neighbours on an axis of `width` inches, within what can be
    seen."""
    return float(np.clip(0.8 * 72 * width / max(n_points, 1), 1.3, 3.4))


def look(k: int) -> tuple[str, str]:
    """Colour and marker of the k-th curve."""
    return COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]


def new_figure(width: float, height: float):
    """A figure of so many inches that belongs to no window and no global state."""
    return require("matplotlib.figure", "plot").Figure(figsize=(width, height))


def add_axes(figure, left: float, bottom: float, width: float, height: float):
    """Axes at a place that is given in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def width(axes) -> float:
    """Width of axes, inches."""
    return float(axes.get_position().width * axes.figure.get_figwidth())


def frequency_axis(axes, frequency: Frequency) -> None:
    """A logarithmic axis where the band is wide, with plain numbers (1, 2, 5, 10, ...)."""
    ticker = require("matplotlib.ticker", "plot")
    frequency = np.asarray(frequency, float)
    positive = frequency[frequency > 0]
    if positive.size and positive.max() > _WIDE * positive.min():
        ratio = positive.max() / positive.min()
        margin = ratio**0.02
        axes.set_xscale("log")
        axes.set_xlim(positive.min() / margin, positive.max() * margin)
        room = width(axes) / 0.33  # labels that stand side by side
        subs = (1.0, 2.0, 5.0) if 3 * np.log10(ratio) < room else (1.0,)
        axes.xaxis.set_major_locator(ticker.LogLocator(subs=subs, numticks=20))
        axes.xaxis.set_major_formatter(ticker.FuncFormatter(lambda f, _: f"{f:g}"))
        axes.xaxis.set_minor_formatter(ticker.NullFormatter())
    elif frequency.size:
        margin = 0.02 * (np.ptp(frequency) or 1.0)
        axes.set_xlim(frequency.min() - margin, frequency.max() + margin)


def dress(axes) -> None:
    """Grid, thin frame and small numbers."""
    axes.grid(True, which="major", color="#D9D9D9", linewidth=0.5)
    axes.grid(True, which="minor", axis="x", color="#EEEEEE", linewidth=0.35)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", labelsize=SMALL, length=2.5, width=0.5, color="#666666")
    axes.tick_params(which="minor", length=1.5)
    for spine in axes.spines.values():
        spine.set(linewidth=0.5, color="#666666")


def decibel(magnitude) -> np.ndarray:
    """20 log10 of a magnitude; NaN where there is none (0 or NaN)."""
    magnitude = np.asarray(magnitude, float)
    return 20 * np.log10(np.where(magnitude > 0, magnitude, np.nan))


def decibel_limits(*values) -> tuple[float, float] | None:
    """Limits that show all finite values with some air, at least 6 dB; `None` without values."""
    x = np.concatenate([np.ravel(v) for v in values]) if values else np.empty(0)
    x = x[np.isfinite(x)]
    if not x.size:
        return None
    margin = max(0.06 * np.ptp(x), 3.0)
    return float(x.min() - margin), float(x.max() + margin)


def header_height(handles: Sequence, width: float, note: str, title: str) -> float:
    """Inches that title, note and legend take above the data."""
    rows = -(-len(handles) // _legend_columns(handles, width))
    return 0.08 + (0.24 if title else 0.0) + _ROW * (rows + bool(note))


def header(figure, handles: Sequence, note: str, title: str) -> None:
    """Above the data, from the top: a title, one legend for the whole figure, a note (units)."""
    width, height = figure.get_size_inches()
    left, top = 0.1, height - 0.05
    if title:
        figure.text(left / width, top / height, title, fontsize=NORMAL + 1, va="top", ha="left")
        top -= 0.24
    if handles:
        columns = _legend_columns(handles, width)
        figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(left / width, top / height),
            ncols=columns,
            fontsize=SMALL,
            frameon=False,
            handletextpad=0.5,
            columnspacing=1.2,
            labelspacing=0.3,
            borderpad=0.0,
            borderaxespad=0.0,
        )
        top -= _ROW * -(-len(handles) // columns)
    if note:
        figure.text(left / width, top / height, note, fontsize=SMALL, color="#444444", va="top", ha="left")


def _legend_columns(handles: Sequence, width: float) -> int:
    """How many entries fit side by side: all of them, or as many as the longest allows."""
    entries = [0.055 * len(h.get_label()) + 0.5 for h in handles]
    if not entries or sum(entries) <= width - 0.2:
        return max(1, len(entries))
    return max(1, int((width - 0.2) / max(entries)))
