"""Coherence over frequency: how much of each output the inputs explain linearly."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._arguments import as_names, expect_index
from .._errors import input_error
from .._types import Array, Frequency
from ..io._optional import require
from . import _style

_WIDTH, _HEIGHT = 5.6, 1.9  # inches of the axes
_LEFT, _RIGHT, _BOTTOM = 0.62, 0.14, 0.46


def coherence(
    frequency: Frequency,
    coherence: Float[Array, "pos freq out"],
    labels: Sequence[str] | None = None,
    *,
    position: int = 0,
    axes: _style.Axes | None = None,
    title: str = "",
):
    """Draw the (multiple) coherence of every output at one operating point, between 0 and 1.

    Every line is a point; a faint line joins neighbours only where no gap stands between them.

    **Arguments:**

    - `frequency`: (freq,), Hz.
    - `coherence`: (pos, freq, out); (freq, out) and (freq,) are taken for one operating point.
    - `labels`: a name for each output; `y1`, `y2`, ... by default.
    - `position`: which operating point.
    - `axes`: where to draw; by default a new figure.
    - `title`: set above a new figure.

    **Returns:** the figure, and its axes.

    **Raises:** `jaxfrf.InputError` if shapes do not fit.
    """
    frequency, values = np.asarray(frequency), _values(coherence, len(frequency), position)
    if labels is None:
        labels = [f"$y_{{{k + 1}}}$" for k in range(values.shape[1])]
    labels = as_names("labels", labels, values.shape[1], "outputs")
    if axes is None:
        handles = _legend(labels) if len(labels) > 1 else []
        axes = _new(handles, title)
    style = {
        "ls": "none",
        "ms": _style.marker_size(len(frequency), _style.width(axes)),
        "mec": "none",
        "zorder": 3,
    }
    for k, value in enumerate(values.T):
        colour, marker = _style.look(k)
        runs = _style.pieces(frequency, np.isfinite(value))
        axes.plot(*_style.polyline(frequency, value, runs), color=colour, lw=0.6, alpha=0.35)
        axes.plot(frequency, value, color=colour, marker=marker, label=labels[k], **style)
    _style.dress(axes)
    _style.frequency_axis(axes, frequency)
    axes.set_ylim(-0.02, 1.04)
    axes.set_ylabel("coherence", fontsize=_style.SMALL)
    axes.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL, labelpad=2)
    return axes.figure, axes


def _values(coherence, n_freq: int, position: int) -> np.ndarray:
    """(freq, out) at one operating point."""
    x = np.asarray(coherence, float)
    x = x[:, None] if x.ndim == 1 else x
    x = x[None] if x.ndim == 2 else x
    if x.ndim != 3 or x.shape[1] != n_freq:
        raise input_error(
            "coherence",
            f"shape {x.shape} with {n_freq} frequencies",
            "(position, frequency, output)",
            "Transpose it.",
        )
    expect_index("position", position, len(x))
    return x[position]


def _new(handles, title: str):
    width = _LEFT + _WIDTH + _RIGHT
    header = _style.header_height(handles, width, "", title) + 0.06
    height = _BOTTOM + _HEIGHT + header
    figure = _style.new_figure(width, height)
    _style.header(figure, handles, "", title)
    return _style.add_axes(figure, _LEFT, _BOTTOM, _WIDTH, _HEIGHT)


def _legend(labels: Sequence[str]) -> list:
    lines = require("matplotlib.lines", "plot")
    looks = [_style.look(k) for k in range(len(labels))]
    return [
        lines.Line2D([], [], color=colour, marker=marker, ms=3.4, lw=0.7, label=label)
        for (colour, marker), label in zip(looks, labels, strict=True)
    ]
