"""Spectra of reference, input and output, with the levels of noise and nonlinear distortion."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from .._annotated import checked
from .._arguments import expect_index, expect_whole
from .._errors import input_error
from .._types import Array
from ..io._optional import require
from ..spectra import Spectra
from ..units import input_unit, output_unit
from . import _style

_WIDTHS = {1: 5.6, 2: 3.1, 3: 2.3, 4: 2.0}  # inches of a panel, by the number of panels side by side
_SMALLEST, _HEIGHT = 1.6, 1.6
_LEFT, _RIGHT, _BOTTOM, _ACROSS, _DOWN = 0.62, 0.14, 0.46, 0.14, 0.30  # margins and gaps, inches
_ROUNDING = 200.0  # decibels below the strongest line, where only rounding is left


class _Look(NamedTuple):
    label: str
    colour: str
    marker: str


_EXCITED = _Look("excited lines", _style.COLOURS[0], "o")
_EVEN = _Look("unexcited even lines", _style.COLOURS[4], "v")
_ODD = _Look("unexcited odd lines", _style.COLOURS[1], "^")
_NOISE = _Look("noise (std of the mean)", "#777777", ".")


@checked
def spectrum(
    spectra: Spectra,
    unexcited: Spectra | None = None,
    *,
    position: int = 0,
    channels: Sequence[int] | Int[Array, "channel"] | None = None,
    axes: _style.Axes | None = None,
    title: str = "",
):
    """Draw the spectra of reference (where there is one), input and output: a row per signal, a column per
    channel.

    Levels are rms over the experiments of the Fourier coefficients' magnitude, in dB. What stands at
    unexcited lines is noise and nonlinear distortion: above the noise at even lines it is even, at odd lines
    odd distortion. In closed loop the input's distortion is also the loop's reaction, and the output's
    contains G times it. The noise is that of the mean over the periods, as the scatter between them shows it.

    **Arguments:**

    - `spectra`: at the excited lines (`jaxfrf.dft`); `unexcited`: at the detection lines
      (`jaxfrf.unexcited_spectra`).
    - `position`: which operating point. `channels`: which channels of every signal, from 0; all by default.
    - `axes`: where to draw, an array (signal, channel) of matplotlib axes; by default a new figure.
    - `title`: set above a new figure.

    **Returns:** the figure, and its axes (signal, channel); panels of channels that a signal does not have
    are hidden.

    **Raises:** `jaxfrf.InputError` if `spectra` are none, and if a channel or operating point does not exist.
    """
    expect_index("position", position, spectra.n_pos)
    signals = [name for name in ("R", "U", "Y") if getattr(spectra, name) is not None]
    most = max(getattr(spectra, name).shape[-1] for name in signals)
    channels = list(range(most)) if channels is None else list(channels)
    for channel in channels:
        expect_whole("channels", channel)
    if not channels or max(channels) >= most:
        raise input_error("channels", f"{channels}", f"some of 0 to {most - 1}", "Count from 0.")
    panels = [[_levels(spectra, unexcited, s, c, position) for c in channels] for s in signals]
    looks = [look for look in (_EXCITED, _ODD, _EVEN, _NOISE) if any(look in p for row in panels for p in row if p)]
    shape = (len(signals), len(channels))
    if axes is None:
        figure, axes = _new(shape, looks, title)
    else:
        figure, axes = _given(axes, shape)
    band = np.concatenate([s.frequency for s in (spectra, unexcited) if s is not None])
    for row, signal in enumerate(signals):
        limits = _style.decibel_limits(*(level for panel in panels[row] for _, level in panel.values()))
        for column, channel in enumerate(channels):
            axis, panel = axes[row, column], panels[row][column]
            axis.set_visible(bool(panel))
            if panel:
                _draw(axis, panel, len(spectra.lines))
                axis.set_title(f"${signal.lower()}_{{{channel + 1}}}$", fontsize=_style.NORMAL, pad=3)
                _finish(axis, band, limits, bottom=row == len(signals) - 1)
        unit = {"R": "unit of r", "U": input_unit(spectra), "Y": output_unit(spectra)}[signal]
        axes[row, 0].set_ylabel(f"dB re 1 {unit}", fontsize=_style.SMALL, labelpad=2)
        for axis in axes[row, 1:]:
            axis.tick_params(labelleft=False)
    return figure, axes


def _levels(spectra: Spectra, unexcited: Spectra | None, signal: str, channel: int, position: int) -> dict:
    """Curves (frequency, level in dB) of one panel by their looks; empty where the signal has no such
    channel."""
    if channel >= getattr(spectra, signal).shape[-1]:
        return {}
    curves = {_EXCITED: (np.asarray(spectra.frequency), _rms(spectra, signal, channel, position))}
    if unexcited is not None and getattr(unexcited, signal) is not None:
        level, odd = _rms(unexcited, signal, channel, position), np.asarray(unexcited.lines) % 2 == 1
        for look, chosen in ((_ODD, odd), (_EVEN, ~odd)):
            if chosen.any():
                curves[look] = (np.asarray(unexcited.frequency)[chosen], level[chosen])
    known = [s for s in (spectra, unexcited) if s is not None and s.noise is not None]
    if known and signal != "R":
        frequency = np.concatenate([s.frequency for s in known])
        level = np.concatenate([_noise(s, signal, channel, position) for s in known])
        order = np.argsort(frequency)
        curves[_NOISE] = (frequency[order], level[order])
    top = np.nanmax(curves[_EXCITED][1], initial=-np.inf)
    return {look: curve for look, curve in curves.items() if np.any(curve[1] > top - _ROUNDING)}


def _rms(spectra: Spectra, signal: str, channel: int, position: int) -> np.ndarray:
    x = np.asarray(getattr(spectra, signal))[position, :, :, channel]
    return _style.decibel(np.sqrt(np.mean(np.abs(x) ** 2, axis=0)))


def _noise(spectra: Spectra, signal: str, channel: int, position: int) -> np.ndarray:
    """From the covariance of [Y; U]."""
    k = channel if signal == "Y" else spectra.n_out + channel
    return _style.decibel(np.sqrt(np.mean(np.real(np.asarray(spectra.noise)[position, :, :, k, k]), axis=0)))


def _draw(axis, panel: dict, n_lines: int) -> None:
    size = max(_style.marker_size(n_lines, _style.width(axis)), 1.8)  # triangles must be told apart
    for look, (frequency, level) in panel.items():
        points = {"ls": "none", "marker": look.marker, "ms": size, "mec": "none", "color": look.colour}
        if look is _NOISE:
            runs = _style.pieces(frequency, np.isfinite(level))
            axis.plot(*_style.polyline(frequency, level, runs), color=look.colour, lw=0.6, alpha=0.6, zorder=1)
        axis.plot(frequency, level, zorder=1.5 if look is _NOISE else 3, **points)


def _finish(axis, band, limits, bottom: bool) -> None:
    _style.dress(axis)
    _style.frequency_axis(axis, band)
    if limits is not None:
        axis.set_ylim(*limits)
    axis.tick_params(labelbottom=bottom)
    if bottom:
        axis.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL, labelpad=2)


def _new(shape: tuple[int, int], looks: Sequence[_Look], title: str):
    lines = require("matplotlib.lines", "plot")
    handles = [
        lines.Line2D([], [], ls="none", color=x.colour, marker=x.marker, ms=4, mec="none", label=x.label) for x in looks
    ]
    rows, columns = shape
    panel = _WIDTHS.get(columns, _SMALLEST)
    width = _LEFT + columns * panel + (columns - 1) * _ACROSS + _RIGHT
    header = _style.header_height(handles, width, "", title) + 0.2
    height = _BOTTOM + rows * _HEIGHT + (rows - 1) * _DOWN + header
    figure = _style.new_figure(width, height)
    axes = np.full(shape, None, object)
    for row, column in np.ndindex(shape):
        left, bottom = _LEFT + column * (panel + _ACROSS), height - header - (row + 1) * _HEIGHT - row * _DOWN
        axes[row, column] = _style.add_axes(figure, left, bottom, panel, _HEIGHT)
    _style.header(figure, handles, "", title)
    return figure, axes


def _given(axes, shape: tuple[int, int]):
    axes = np.asarray(axes, object)
    if axes.size != np.prod(shape):
        raise input_error("axes", f"{axes.size} axes", f"an array of shape {shape} (signal, channel)", "Make them.")
    axes = axes.reshape(shape)
    return axes[0, 0].figure, axes
