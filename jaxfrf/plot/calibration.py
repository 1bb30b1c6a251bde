"""The picture of a calibration: where every number was thought to be, and where the records put it."""

from collections.abc import Collection, Sequence

import numpy as np

from .._annotated import checked
from ..calibration import Calibration, Number
from ..io._optional import require
from . import _style

_ROW, _HEAD, _WIDTH = 0.17, 0.75, 3.4  # inches: of a number, above an axes, of an axes
_COLUMNS = 3
_PER_CENT = 100.0


@checked
def numbers_found(found: Calibration, kinds: Sequence[str] | None = None, title: str = ""):
    """Draw every number as a change from what was given, per cent: grey what was known before (one and two standard
    deviations), a dot with its 95 % interval what is known now; hollow where the data did not tell it.

    Numbers that may be zero (centres, inertias) are drawn in tolerances. One axes for each kind.

    **Arguments:** `found`: of `jaxfrf.calibrate`. `kinds`: to draw, all of the calibration by default. `title`: set
    above the figure.

    **Returns:** the figure, and its axes by kind.

    **Raises:** `jaxfrf.InputError` if `found` is no calibration; `ImportError` without matplotlib.
    """
    determined = {n.name for n in found.numbers if found.determined_by(n.name) == "data"}
    return draw_numbers(found.numbers, found.x, found.half_width, determined, kinds=kinds, title=title)


def draw_numbers(
    numbers: Sequence[Number],
    x: Sequence[float] | np.ndarray,
    half_width: Sequence[float] | np.ndarray,
    determined: Collection[str],
    *,
    kinds: Sequence[str] | None = None,
    title: str = "",
):
    """The same from its numbers: where each is and half its 95 % interval, in tolerances, and the names of those that
    the records determine."""
    groups: dict[str, list[int]] = {}
    for i, number in enumerate(numbers):
        if kinds is None or number.kind in kinds:
            groups.setdefault(number.kind, []).append(i)
    columns = min(_COLUMNS, len(groups))
    rows = [list(groups.items())[i : i + columns] for i in range(0, len(groups), columns)]
    heights = [_HEAD + _ROW * max(len(members) for _, members in row) for row in rows]
    figure = require("matplotlib.figure", "plot").Figure(
        figsize=(_WIDTH * columns, sum(heights) + 0.3 * bool(title)), layout="constrained"
    )
    grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
    axes = {}
    for line, row in zip(grid, rows, strict=True):
        for ax in line[len(row) :]:
            ax.set_axis_off()
        for ax, (kind, members) in zip(line, row, strict=False):
            _draw(ax, [(numbers[i], float(x[i]), float(half_width[i])) for i in members], kind, determined)
            axes[kind] = ax
    if title:
        figure.suptitle(title)
    return figure, axes


def _draw(ax, members: Sequence[tuple[Number, float, float]], kind: str, determined: Collection[str]) -> None:
    for row, (number, x, half) in enumerate(members):
        scale = _scale(number)
        if number.prior:
            for width, shade in ((2.0, "0.93"), (1.0, "0.85")):
                low, high = (scale(s * width) for s in (-1.0, 1.0))
                ax.barh(row, high - low, 0.8, left=low, color=shade, zorder=0)
        known = number.name in determined
        colour = _style.COLOURS[0] if known else _style.DOUBTFUL
        ax.plot([scale(x - half), scale(x + half)], [row, row], color=colour, lw=1.2)
        ax.plot(scale(x), row, "o", ms=3.6, color=colour, mfc=colour if known else "white")
    ax.set_yticks(range(len(members)), [_label(number) for number, _, _ in members], fontsize=6.5)
    ax.set_ylim(len(members) - 0.4, -0.6)
    ax.axvline(0.0, color="0.4", lw=0.6, zorder=1)
    ax.set_title(kind.replace("_", " "), fontsize=8)
    ax.set_xlabel("change, %" if members[0][0].positive else "change, tolerances", fontsize=7)
    _style.dress(ax)


def _scale(number: Number):
    if number.positive:
        return lambda x: _PER_CENT * float(np.expm1(number.size * x))
    return lambda x: x


def _label(number: Number) -> str:
    return number.name.replace(f".{number.kind}", "")
