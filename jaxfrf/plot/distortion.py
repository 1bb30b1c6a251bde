"""The output of a record line by line: linear response, noise, even and odd distortion."""

import numpy as np

from .._annotated import checked
from .._arguments import expect_index
from ..frf import Distortion
from ..io._optional import require
from . import _style

_WIDTH, _HEIGHT, _GAP = 6.2, 2.1, 0.2  # inches of the axes
_LEFT, _RIGHT, _BOTTOM = 0.62, 0.14, 0.46


@checked
def distortion(found: Distortion, *, position: int = 0, axes: _style.Axes | None = None, title: str = ""):
    """Draw the level of every output at one operating point, decibels, against frequency.

    Points: the output at the excited lines, and what the linear response leaves unexplained at even and odd unexcited
    lines. Lines: noise, and noise and distortion together as they fall on the excited lines.

    **Arguments:** `found`: of `jaxfrf.best_linear_approximation`. `position`: which operating point. `axes`: one for
    every output, or a new figure. `title`: set above a new figure.

    **Returns:** the figure, and its axes (out,).

    **Raises:** `jaxfrf.InputError` if `found` is no distortion, or there is no such operating point.
    """
    n_pos, _, n_out = found.output.shape
    expect_index("position", position, n_pos)
    lines = require("matplotlib.lines", "plot")
    series = _series(found, position)
    handles = [lines.Line2D([], [], label=name, **{"ms": 3.4} | look) for name, _, _, look in series]
    axes = _new(n_out, handles, title) if axes is None else np.atleast_1d(axes)
    for out, each in enumerate(axes):
        for _, frequency, level, look in series:
            order = np.argsort(frequency)
            size = {"ms": _style.marker_size(len(frequency), _style.width(each))} if "marker" in look else {}
            each.plot(frequency[order], _style.decibel(level[order, out]), **look | size)
        _style.dress(each)
        _style.frequency_axis(each, np.asarray(found.frf.frequency))
        each.set_ylabel(f"$y_{{{out + 1}}}$ (dB)", fontsize=_style.SMALL)
        each.tick_params(labelbottom=out + 1 == n_out)
    axes[-1].set_xlabel("Frequency (Hz)", fontsize=_style.SMALL, labelpad=2)
    return axes[0].figure, axes


def _series(found: Distortion, position: int) -> list:
    """Name, frequency, level (line, out) and look of all that is known."""
    at, quiet = np.asarray(found.frf.frequency), found.unexcited
    points = {"ls": "none", "mec": "none"}
    colours = [_style.look(k)[0] for k in range(3)]
    every = [
        ("output, excited lines", at, found.output[position], points | {"marker": "o", "color": colours[0]}),
        (
            "unexplained, even lines",
            quiet[found.is_even],
            found.detected[position][found.is_even],
            points | {"marker": "s", "color": colours[1]},
        ),
        (
            "unexplained, odd lines",
            quiet[~found.is_even],
            found.detected[position][~found.is_even],
            points | {"marker": "^", "color": colours[2]},
        ),
        ("noise", at, found.noise[position], {"color": _style.DOUBTFUL, "lw": 0.9, "ls": ":"}),
        ("noise and distortion", at, found.total[position], {"color": "black", "lw": 0.9, "ls": "--"}),
    ]
    return [x for x in every if len(x[1]) and np.isfinite(x[2]).any()]


def _new(n_out: int, handles, title: str):
    width = _LEFT + _WIDTH + _RIGHT
    note = "level of one experiment's mean period, dB"
    header = _style.header_height(handles, width, note, title) + 0.06
    height = _BOTTOM + n_out * _HEIGHT + (n_out - 1) * _GAP + header
    figure = _style.new_figure(width, height)
    _style.header(figure, handles, note, title)
    bottoms = [_BOTTOM + (n_out - 1 - k) * (_HEIGHT + _GAP) for k in range(n_out)]
    return np.array([_style.add_axes(figure, _LEFT, bottom, _WIDTH, _HEIGHT) for bottom in bottoms], object)
