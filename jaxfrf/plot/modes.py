"""The stabilisation diagram: which poles stay from order to order, over the response and what its modes make of it."""

import numpy as np

from .._annotated import checked
from .._text import NORMAL_95
from ..frf import ModalModel
from ..io._optional import require
from ..units import response_unit
from . import _style

_SIZE = (6.4, 4.2)  # inches
_LEFT, _RIGHT, _BOTTOM = 0.62, 0.6, 0.46


@checked
def stabilisation(model: ModalModel, *, axes: _style.Axes | None = None, title: str = ""):
    """Draw the poles of every order at their frequency (filled: the order below had them), over the root of the sum of
    squares of all elements, measured and of the modes; the modes that were taken as lines, with their 95 % intervals.

    **Arguments:** `model`: of `jaxfrf.modal`. `axes`: matplotlib axes to draw on; a twin of it holds the orders.
    `title`: set above a new figure.

    **Returns:** the figure and its two axes (magnitude, order).

    **Raises:** `jaxfrf.InputError` if `model` is none; `ImportError` without matplotlib.
    """
    handles = _legend()
    if axes is None:
        figure = _style.new_figure(*_SIZE)
        header = _style.header_height(handles, _SIZE[0], "unit", title) + 0.1
        note = f"magnitude in dB re 1 {response_unit(model)}, all elements together"
        _style.header(figure, handles, note, title)
        width, height = _SIZE[0] - _LEFT - _RIGHT, _SIZE[1] - _BOTTOM - header
        axes = _style.add_axes(figure, _LEFT, _BOTTOM, width, height)
    grid = np.unique(np.concatenate([model.frequency, *(_around(m) for m in model.modes)]))
    grid = grid[(grid >= model.frequency[0]) & (grid <= model.frequency[-1])]
    axes.plot(model.frequency, _level(model.measured), color=_style.DOUBTFUL, lw=1.4)
    axes.plot(grid, _level(model.response(grid)), color=_style.COLOURS[1], lw=0.8)
    for mode in model.modes:
        half = NORMAL_95 * mode.frequency_std
        axes.axvspan(mode.frequency - half, mode.frequency + half, color=_style.COLOURS[0], alpha=0.25, lw=0)
        axes.axvline(mode.frequency, color=_style.COLOURS[0], lw=0.6)
    table, orders = model.stabilisation, axes.twinx()
    for stable, marker in ((False, {"mfc": "white", "ms": 2.4}), (True, {"mfc": _style.COLOURS[0], "ms": 3.0})):
        chosen = table.stable == stable
        orders.plot(
            table.frequency[chosen], table.order[chosen], "o", mec=_style.COLOURS[0], mew=0.4, ls="none", **marker
        )
    _style.dress(axes)
    _style.frequency_axis(axes, model.frequency)
    axes.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL, labelpad=2)
    axes.set_ylabel("dB", fontsize=_style.SMALL, labelpad=2)
    orders.set_ylabel("model order", fontsize=_style.SMALL, labelpad=2)
    orders.tick_params(labelsize=_style.SMALL, length=2.5, width=0.5, color="#666666")
    return axes.figure, (axes, orders)


def _level(G) -> np.ndarray:
    return _style.decibel(np.sqrt(np.sum(np.abs(G) ** 2, axis=(1, 2))))


def _around(mode) -> np.ndarray:
    """More frequencies where a resonance is sharp."""
    return mode.frequency * (1 + mode.damping * np.linspace(-8, 8, 65))


def _legend() -> list:
    lines = require("matplotlib.lines", "plot")
    dots = {"color": _style.COLOURS[0], "marker": "o", "ls": "none", "mew": 0.4}
    return [
        lines.Line2D([], [], color=_style.DOUBTFUL, lw=1.4, label="measured"),
        lines.Line2D([], [], color=_style.COLOURS[1], lw=0.8, label="modes"),
        lines.Line2D([], [], **dots, ms=3.0, label="pole of two orders"),
        lines.Line2D([], [], **dots, ms=2.4, mfc="white", label="of one"),
    ]
