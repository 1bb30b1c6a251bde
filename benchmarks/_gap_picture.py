"""The confusion matrix of the diagnosis: what was hidden, and what was named."""

import numpy as np
from _hidden_effects import MAIN
from _hidden_plan import CLASSES
from _outside_effects import OUTSIDE

from jaxfrf.effects import library
from jaxfrf.plot._style import COLOURS, NORMAL, SMALL, add_axes, new_figure, save

_SILENT = ("sufficient", "inconclusive", "unexplained", "failed")
_CELL = 0.235  # inches
_LEFT, _BOTTOM, _TOP, _RIGHT = 1.95, 0.75, 1.55, 0.4


def draw(confusion: dict[str, dict[str, int]], path) -> None:
    """A square for every end of every truth, the darker the more often of its row, with the number of cases in it.

    Blue: the effect or its class. Green: rightly silent. Grey: silent where something was to be said,
    or "unexplained" where nothing is hidden. Red: a wrong name.
    Joints are not looked at here. Rows without cases are left out.
    """
    rows = [name for name in (*MAIN, "none", *OUTSIDE) if confusion.get(name)]
    ends = {end for row in confusion.values() for end in row}
    named = [*MAIN, *(name for name in library() if name in ends and name not in MAIN)]  # what is never hidden, too
    columns = [*named, *(v for v in _SILENT if v != "failed" or v in ends)]
    width, height = _CELL * len(columns), _CELL * max(len(rows), 1)
    figure = new_figure(_LEFT + width + _RIGHT, _TOP + height + _BOTTOM)
    axes = add_axes(figure, _LEFT, _BOTTOM, width, height)
    axes.set_xlim(-0.5, len(columns) - 0.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    _grid(axes, rows, columns)
    for y, truth in enumerate(rows):
        total = sum(confusion[truth].values())
        for end, count in confusion[truth].items():
            if end in columns:
                _square(axes, columns.index(end), y, _colour(truth, end), count, count / total)
    _labels(axes, rows, columns, confusion)
    _key(figure)
    save(figure, path)


def _colour(truth: str, end: str) -> str:
    if end in _SILENT:
        right = ("sufficient", "inconclusive") if truth == "none" else ("unexplained",) if truth in OUTSIDE else ()
        return COLOURS[2] if end in right else "#6E6E6E"
    same = end == truth or any(truth in alike and end in alike for alike in CLASSES)
    return COLOURS[0] if same else COLOURS[1]


def _square(axes, x: int, y: int, colour: str, count: int, share: float) -> None:
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Rectangle

    depth = 0.25 + 0.75 * share
    face = 1.0 - depth * (1.0 - np.array(to_rgb(colour)))
    axes.add_patch(Rectangle((x - 0.46, y - 0.46), 0.92, 0.92, facecolor=face, linewidth=0))
    axes.text(x, y + 0.02, str(count), ha="center", va="center", fontsize=SMALL, color="white" if share > 0.4 else "k")


def _grid(axes, rows, columns) -> None:
    from matplotlib.patches import Rectangle

    for x in range(len(columns) + 1):
        axes.axvline(x - 0.5, color="#E4E4E4", linewidth=0.5, zorder=0)
    for y in range(len(rows) + 1):
        axes.axhline(y - 0.5, color="#E4E4E4", linewidth=0.5, zorder=0)
    for y, truth in enumerate(rows):  # where the right answer stands
        right = next((alike for alike in CLASSES if truth in alike), (truth,)) if truth in MAIN else ()
        for name in right:
            place = (columns.index(name) - 0.46, y - 0.46)
            axes.add_patch(Rectangle(place, 0.92, 0.92, fill=False, edgecolor="#9FB8C9", linewidth=0.7, zorder=0.5))
    axes.axvline(sum(name not in _SILENT for name in columns) - 0.5, color="#555555", linewidth=0.9)
    known = sum(name in MAIN for name in rows)
    if 0 < known < len(rows):
        axes.axhline(known - 0.5, color="#555555", linewidth=0.9)


def _labels(axes, rows, columns, confusion) -> None:
    plain = lambda name: name.replace("_", " ")
    totals = [sum(confusion[name].values()) for name in rows]
    axes.set_yticks(range(len(rows)), [f"{plain(n)}  ({t})" for n, t in zip(rows, totals, strict=True)])
    axes.set_xticks(range(len(columns)), [plain(name) for name in columns], rotation=55, ha="left")
    axes.xaxis.tick_top()
    for label in axes.get_xticklabels():
        label.set_rotation_mode("anchor")
    axes.tick_params(labelsize=SMALL, length=0, pad=3)
    axes.set_ylabel("hidden (cases)", fontsize=NORMAL)
    axes.set_xlabel("named first, or the verdict where nothing was named", fontsize=NORMAL)
    axes.xaxis.set_label_position("bottom")
    for spine in axes.spines.values():
        spine.set(linewidth=0.5, color="#666666")


def _key(figure) -> None:
    from matplotlib.patches import Patch

    entries = {
        "right (the effect, or its class)": COLOURS[0],
        "rightly silent": COLOURS[2],
        "wrongly silent": "#6E6E6E",
        "wrong name": COLOURS[1],
    }
    handles = [Patch(facecolor=colour, label=label) for label, colour in entries.items()]
    figure.legend(handles=handles, loc="lower center", ncols=4, fontsize=SMALL, frameon=False, handlelength=1.0)
