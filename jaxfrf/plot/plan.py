"""The picture of a plan: how well parameters will be known, against how much is measured."""

import numpy as np

from .._annotated import checked
from .._errors import input_error
from ..graybox.positions import PositionPlan
from ..io._optional import require
from . import _style

_WIDTH, _HEIGHT = 3.2, 2.9  # inches of an axes
_LEFT, _BETWEEN, _RIGHT, _BOTTOM = 0.62, 0.62, 0.14, 0.46


@checked
def plan(plan: PositionPlan, *, axes: _style.Axes | None = None, title: str = ""):
    """Draw the expected standard deviation against the number of positions, one axes for each kind of parameter.

    Solid with markers: chosen D-optimally; dashed or dotted: drawn at random, median over draws. A vertical line
    stands at the number that was chosen. Nuisance parameters are left out. It knows noise alone.

    **Arguments:** `plan`: of `jaxfrf.plan_positions`. `axes`: one for each kind (the part of a name behind its last
    dot: stiffness, damping); by default a new figure. `title`: set above a new figure.

    **Returns:** the figure, and its axes.

    **Raises:** `jaxfrf.InputError` if `plan` is none, and for another number of axes.
    """
    kinds = _kinds(plan)
    owners = list(dict.fromkeys(owner for rows in kinds.values() for owner, _ in rows))
    if axes is None:
        axes = _new(len(kinds), _legend(owners), title)
    axes = list(np.ravel(np.asarray(axes, object)))
    if len(axes) != len(kinds):
        raise input_error("axes", f"{len(axes)}", f"{len(kinds)}, one for {', '.join(kinds)}", "Give as many.")
    for ax, (kind, rows) in zip(axes, kinds.items(), strict=True):
        for owner, column in rows:
            colour, marker = _style.look(owners.index(owner))
            # Where colours repeat, beyond seven owners, the marker is hollow and dashes become dots.
            first = owners.index(owner) < len(_style.COLOURS)
            face, dashes = (colour, "--") if first else ("white", ":")
            ax.plot(plan.counts, 100 * plan.random[:, column], dashes, color=colour, lw=0.7, alpha=0.7)
            ax.plot(plan.counts, 100 * plan.optimal[:, column], color=colour, lw=0.8, marker=marker, ms=3.4, mfc=face)
        ax.axvline(len(plan.chosen), color=_style.DOUBTFUL, lw=0.7, zorder=0)
        _finish(ax, kind)
    return axes[0].figure, axes


def _kinds(plan: PositionPlan) -> dict[str, list[tuple[str, int]]]:
    """Owner and column of every wanted parameter, by its kind."""
    kinds: dict[str, list[tuple[str, int]]] = {}
    for column in np.flatnonzero(plan.wanted):
        owner, dot, kind = plan.names[column].rpartition(".")
        kinds.setdefault(kind if dot else "parameters", []).append((owner if dot else kind, int(column)))
    return kinds


def _finish(ax, kind: str) -> None:
    ticker = require("matplotlib.ticker", "plot")
    ax.set_yscale("log")
    _style.dress(ax)
    ax.xaxis.set_major_locator(ticker.MaxNLocator(integer=True, min_n_ticks=1))
    ax.yaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(ticker.FuncFormatter(lambda y, _: f"{y:g}"))
    ax.yaxis.set_minor_formatter(ticker.NullFormatter())
    ax.set_xlabel("positions", fontsize=_style.SMALL, labelpad=2)
    ax.set_ylabel(f"standard deviation of {kind} (%)", fontsize=_style.SMALL)


def _new(count: int, handles, title: str):
    width = _LEFT + count * _WIDTH + (count - 1) * _BETWEEN + _RIGHT
    height = _BOTTOM + _HEIGHT + _style.header_height(handles, width, "", title) + 0.06
    figure = _style.new_figure(width, height)
    _style.header(figure, handles, "", title)
    left = [_LEFT + i * (_WIDTH + _BETWEEN) for i in range(count)]
    return [_style.add_axes(figure, x, _BOTTOM, _WIDTH, _HEIGHT) for x in left]


def _legend(owners) -> list:
    lines = require("matplotlib.lines", "plot")
    looks = [(*_style.look(k), k < len(_style.COLOURS)) for k in range(len(owners))]
    return [
        *(
            lines.Line2D([], [], color=c, marker=m, ms=3.4, lw=0.8, mfc=c if full else "white", label=owner)
            for owner, (c, m, full) in zip(owners, looks, strict=True)
        ),
        lines.Line2D([], [], color="black", lw=0.8, label="D-optimal positions"),
        lines.Line2D([], [], color="black", lw=0.7, ls="--", label="random positions"),
    ]
