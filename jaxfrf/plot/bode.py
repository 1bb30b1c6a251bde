"""Bode matrix: magnitude above phase for every element of G, several estimates on top of each other."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from .._arguments import as_names, expect, expect_index, expect_probability
from .._errors import input_error
from .._status import SERIOUS
from .._types import Array
from ..frf import FRF
from ..frf.covariance import variances
from ..io._optional import require
from ..units import response_unit
from . import _style

_WIDTHS = {1: 5.6, 2: 3.1, 3: 2.3, 4: 2.0}  # inches of a cell, by the number of cells side by side
_HEIGHTS = {1: 3.3, 2: 2.5, 3: 2.1}
_SMALLEST = 1.6
_LEFT, _RIGHT, _BOTTOM, _ACROSS, _DOWN = 0.62, 0.14, 0.46, 0.14, 0.30  # margins and gaps, inches
_ENDLESS = 1000.0  # decibels that no picture shows
_TOP = 190.0  # degrees at the edge of the picture
_AMBIGUOUS = 120.0  # degrees between neighbours: from here on a line would only guess which way round


def confidence_radius(frf: FRF, level: float = 0.95) -> Float[Array, "pos freq out in"]:
    """Radius of the disc about every estimated element of G that holds the true value with probability
    `level`.

        rho_ij = std_ij sqrt(F_level(2, 2 dof)),    magnitude |G| -+ rho,    phase arg G -+ asin(rho / |G|)

    since |G - G_true|^2 / std^2 is F-distributed with 2 and 2 dof degrees of freedom for a circular complex
    Gaussian error. Magnitude and phase interval hold *together* with (at least) that probability; each by
    itself holds more often, the magnitude with 2 T(sqrt(2 F)) - 1, T Student's distribution with 2 dof
    degrees of freedom: 98.6 % for 95 % and many of them. Where rho >= |G| the phase is unknown.

    Biased: it knows the scatter behind `cov` only, not the smoothing bias of local methods nor what repeats
    with the period; and estimates at neighbouring lines share data. NaN where `cov` is, or without degrees of
    freedom.

    **Arguments:** `frf`: with its covariance. `level`: between 0 and 1.

    **Returns:** (pos, freq, out, in), unit of G.

    **Source:** Pintelon & Schoukens 2012, System Identification, ch. 2.

    **Raises:** `jaxfrf.InputError` if `frf` is none, and for a level that is no probability.
    """
    expect("frf", frf, FRF)
    expect_probability("confidence", level)
    dof = np.asarray(frf.dof, float)
    quantile = scipy.stats.f.ppf(level, 2, 2 * np.where(dof > 0, dof, np.nan))
    return np.asarray(frf.std) * np.sqrt(quantile)[..., None, None]


def bode(
    frfs: FRF | Sequence[FRF],
    labels: Sequence[str] | None = None,
    *,
    elements: Sequence[tuple[int, int]] | None = None,
    position: int = 0,
    confidence: float | None = 0.95,
    size: tuple[float, float] | None = None,
    axes: _style.Axes | None = None,
    title: str = "",
):
    """Draw magnitude (dB) above phase (degrees) of elements of G at one operating point.

    Every line of the estimate is a point. A faint line joins neighbours only where no gap stands between them (more
    than one line missing on a regular grid), both are sound, and the phase steps by less than 120 degrees. Points that
    their status doubts are hollow and grey. Bands are those of `confidence_radius`. Where that disc holds zero, the
    magnitude's band runs out of the picture below, and the phase is unknown: its points are faint, without line and
    band. Where an estimate knows noise and nonlinear distortion apart (`FRF.cov_total`), dotted lines show the standard
    deviation from noise alone, dashed ones that from both.

    **Arguments:**

    - `frfs`: one or several estimates with as many outputs and inputs; frequencies may differ.
    - `labels`: a name for each, for the legend; the methods' names by default.
    - `elements`: pairs (out, in), counted from 0; by default the whole matrix.
    - `position`: which operating point.
    - `confidence`: probability of the band, or `None` for no band.
    - `size`: width and height of a new figure, inches; by default so that every element can be read.
    - `axes`: where to draw, an array (row, column, 2) of matplotlib axes (magnitude, phase); by default a new
      figure.
    - `title`: set above a new figure.

    **Returns:** the figure, and its axes (row, column, 2).

    **Raises:** `jaxfrf.InputError` if an element or operating point does not exist, or the estimates do not
    fit together.
    """
    frfs = list(frfs) if isinstance(frfs, Sequence) and not isinstance(frfs, str) else [frfs]
    for frf in frfs:
        expect("frfs", frf, FRF)
    _check(frfs, elements, position)
    labels = _labels(frfs) if labels is None else as_names("labels", labels, len(frfs), "estimates")
    cells = _cells(frfs[0], elements)
    radii = [None if confidence is None else confidence_radius(f, confidence)[position] for f in frfs]
    handles = _legend(frfs, labels, radii, confidence, position)
    if axes is None:
        note = f"magnitude in dB re 1 {response_unit(frfs[0])}"
        figure, axes = _new(cells, handles, note, title, size)
    else:
        figure, axes = _given(axes, cells)
    frequency = np.concatenate([np.asarray(f.frequency) for f in frfs])
    for row, row_of_cells in enumerate(cells):
        curves = [[_curve(f, r, position, cell) for f, r in zip(frfs, radii, strict=True)] for cell in row_of_cells]
        known = [_style.decibel(x) for f in frfs for cell in row_of_cells for x in _levels(f, position, cell).values()]
        limits = _style.decibel_limits(*(c.magnitude for column in curves for c in column), *known)
        for column, cell in enumerate(row_of_cells):
            pair = axes[row, column]
            _draw(pair, curves[column])
            for k, f in enumerate(frfs):
                _draw_levels(pair[0], f, position, cell, _style.look(k)[0])
            _finish(pair, cell, frequency, limits, leftmost=column == 0)
    return figure, axes


# --- one element ---


class _Curve(NamedTuple):
    """One element of one estimate, as it is drawn."""

    frequency: np.ndarray
    magnitude: np.ndarray  # dB
    phase: np.ndarray  # degrees, wrapped
    relative: np.ndarray  # radius of the confidence disc over |G|; NaN where there is none
    sound: np.ndarray  # neither missing nor doubted

    @property
    def phase_known(self) -> np.ndarray:
        return self.sound & ~(self.relative >= 1)


def _curve(frf: FRF, radius, position: int, cell: tuple[int, int]) -> _Curve:
    out, ref = cell
    g, status = (np.asarray(x) for x in (frf.G[position, :, out, ref], frf.status[position]))
    size = np.where(np.isfinite(g) & (g != 0), np.abs(g), np.nan)
    return _Curve(
        frequency=np.asarray(frf.frequency),
        magnitude=_style.decibel(size),
        phase=np.where(np.isfinite(size), np.degrees(np.angle(g)), np.nan),
        relative=np.full(len(g), np.nan) if radius is None else radius[:, out, ref] / size,
        sound=np.isfinite(size) & ((status & int(SERIOUS)) == 0),
    )


def _draw(pair, curves: Sequence[_Curve]) -> None:
    size = _style.marker_size(max(len(c.frequency) for c in curves), _style.width(pair[0]))
    for k, curve in enumerate(curves):
        colour, marker = _style.look(k)
        _draw_magnitude(pair[0], curve, colour)
        _draw_phase(pair[1], curve, colour)
        known = (curve.sound, curve.phase_known)
        for axis, value, sure in zip(pair, (curve.magnitude, curve.phase), known, strict=True):
            points = {"ls": "none", "marker": marker, "ms": size, "mec": "none", "color": colour}
            axis.plot(curve.frequency[sure], value[sure], zorder=3, **points)
            faint = curve.sound & ~sure
            axis.plot(curve.frequency[faint], value[faint], alpha=0.3, zorder=2, **points)
            hollow = {
                "ls": "none",
                "marker": marker,
                "ms": size,
                "mfc": "white",
                "mec": _style.DOUBTFUL,
                "mew": 0.5,
            }
            axis.plot(curve.frequency[~curve.sound], value[~curve.sound], zorder=2.5, **hollow)


_LEVELS = {"cov_noise": (":", "noise"), "cov_total": ("--", "noise and distortion")}


def _levels(frf: FRF, position: int, cell: tuple[int, int]) -> dict[str, np.ndarray]:
    """Standard deviations of an element by cause, as far as they are known and tell more than the band does."""
    if frf.cov_total is None:
        return {}
    place = cell[1] * frf.n_out + cell[0]
    found = {name: getattr(frf, name) for name in _LEVELS if getattr(frf, name) is not None}
    found = {name: np.sqrt(np.maximum(np.asarray(variances(x))[position, :, place], 0)) for name, x in found.items()}
    return {name: std for name, std in found.items() if np.isfinite(std).any()}


def _draw_levels(axis, frf: FRF, position: int, cell: tuple[int, int], colour: str) -> None:
    for name, std in _levels(frf, position, cell).items():
        style = {"color": colour, "lw": 0.8, "alpha": 0.8, "ls": _LEVELS[name][0]}
        axis.plot(np.asarray(frf.frequency), _style.decibel(std), zorder=1.5, **style)


def _draw_magnitude(axis, curve: _Curve, colour: str) -> None:
    above = curve.magnitude + _style.decibel(1 + curve.relative)
    down = np.where(curve.relative < 1, _style.decibel(1 - curve.relative), -_ENDLESS * np.sign(curve.relative))
    drawn = np.stack([curve.frequency, curve.magnitude, curve.magnitude + down, above])
    _draw_runs(axis, [drawn[:, run] for run in _style.pieces(curve.frequency, curve.sound)], colour)


def _draw_phase(axis, curve: _Curve, colour: str) -> None:
    """Every run with its phase unwound, once for every whole turn that brings a part of it into the picture.

    A line that leaves the picture at 180 degrees enters it again at -180: no vertical line, and no break.
    """
    step = np.abs((np.diff(curve.phase) + 180) % 360 - 180)
    half = np.degrees(np.arcsin(np.where(curve.relative < 1, curve.relative, np.nan)))
    turned = []
    for run in _style.pieces(curve.frequency, curve.phase_known, apart=~(step < _AMBIGUOUS)):
        phase, reach = np.degrees(np.unwrap(np.radians(curve.phase[run]))), half[run]
        highest, lowest = (phase + np.nan_to_num(reach)).max(), (phase - np.nan_to_num(reach)).min()
        for turn in range(math.ceil((-_TOP - highest) / 360), math.floor((_TOP - lowest) / 360) + 1):
            y = phase + 360 * turn
            turned.append(np.stack([curve.frequency[run], y, y - reach, y + reach]))
    _draw_runs(axis, turned, colour)


def _draw_runs(axis, runs: Sequence[np.ndarray], colour: str) -> None:
    """Lines with their bands: rows of a run are x, y and the band's lower and upper edge.

    All runs are one line and one area, interrupted by NaN; a bar is the band of a point that stands alone.
    """
    if not runs:
        return
    apart = [np.pad(run, ((0, 0), (0, 1)), constant_values=np.nan) for run in runs]
    x, y, below, above = np.concatenate(apart, axis=1)
    axis.plot(x, y, color=colour, lw=0.7, alpha=0.5)
    if not np.isfinite(above).any():
        return
    axis.fill_between(x, below, above, color=colour, alpha=0.2, lw=0, zorder=1)
    alone = [run for run in runs if run.shape[1] == 1]
    if alone:
        x, _, below, above = np.concatenate(alone, axis=1)
        axis.vlines(x, below, above, color=colour, alpha=0.3, lw=1.2, zorder=1)


# --- the matrix of elements ---


def _labels(frfs: Sequence[FRF]) -> list[str]:
    return [f.method or f"estimate {k + 1}" for k, f in enumerate(frfs)]


def _check(frfs: Sequence[FRF], elements, position: int) -> None:
    if not frfs:
        raise input_error("frfs", "none", "at least one FRF", "Estimate one first.")
    for f in frfs:
        if (f.n_out, f.n_in, f.y_quantity) != (frfs[0].n_out, frfs[0].n_in, frfs[0].y_quantity):
            raise input_error(
                "frfs",
                f"{f.n_out} x {f.n_in} of {f.y_quantity} beside {frfs[0].n_out} x {frfs[0].n_in} of "
                f"{frfs[0].y_quantity}",
                "estimates of the same outputs and inputs",
                "Draw them in pictures of their own.",
            )
        expect_index("position", position, f.n_pos)
    for element in () if elements is None else elements:
        if not _is_element(element, frfs[0]):
            raise input_error(
                "elements",
                f"{element}",
                f"(output, input), from (0, 0) to ({frfs[0].n_out - 1}, {frfs[0].n_in - 1})",
                "Count from 0.",
            )


def _is_element(element, frf: FRF) -> bool:
    there = np.shape(element) == (2,) and zip(element, (frf.n_out, frf.n_in), strict=True)
    return bool(there) and all(isinstance(k, int | np.integer) and 0 <= k < n for k, n in there)


def _cells(frf: FRF, elements) -> list[list[tuple[int, int]]]:
    """Rows of (out, in): the matrix itself, or the chosen elements one after the other."""
    if elements is None:
        return [[(out, ref) for ref in range(frf.n_in)] for out in range(frf.n_out)]
    columns = len(elements) if len(elements) <= 3 else math.ceil(math.sqrt(len(elements)))
    return [list(elements[k : k + columns]) for k in range(0, len(elements), columns)]


def _new(cells, handles, note: str, title: str, size):
    """A figure with a pair of axes for every cell, made to measure (inches)."""
    rows, columns = len(cells), len(cells[0])
    across, down = _LEFT + _RIGHT + (columns - 1) * _ACROSS, _BOTTOM + (rows - 1) * _DOWN
    full_width = size[0] if size else across + columns * _WIDTHS.get(columns, _SMALLEST)
    header = _style.header_height(handles, full_width, note, title) + 0.2
    full_height = size[1] if size else header + down + rows * _HEIGHTS.get(rows, _SMALLEST)
    width, height = (full_width - across) / columns, (full_height - header - down) / rows
    if min(width, height) <= 0:
        raise input_error("size", f"{size} inches", "room for every element", "Leave it out, or choose elements.")
    figure = _style.new_figure(full_width, full_height)
    axes = np.full((rows, columns, 2), None, object)
    for row, row_of_cells in enumerate(cells):
        for column in range(len(row_of_cells)):
            left = _LEFT + column * (width + _ACROSS)
            bottom = full_height - header - (row + 1) * height - row * _DOWN
            above = _style.add_axes(figure, left, bottom + 0.4 * height, width, 0.6 * height)
            below = _style.add_axes(figure, left, bottom, width, 0.36 * height)
            axes[row, column] = above, below
            lowest = row + 1 == rows or column >= len(cells[row + 1])
            above.tick_params(labelbottom=False)
            below.tick_params(labelbottom=lowest)
            if lowest:
                below.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL, labelpad=2)
    _style.header(figure, handles, note, title)
    return figure, axes


def _given(axes, cells):
    shape = (len(cells), len(cells[0]), 2)
    axes = np.asarray(axes, object)
    if axes.size != np.prod(shape):
        raise input_error("axes", f"{axes.size} axes", f"an array of shape {shape} (magnitude, phase)", "Make them.")
    axes = axes.reshape(shape)
    return axes[0, 0, 0].figure, axes


def _finish(pair, cell: tuple[int, int], frequency, limits, leftmost: bool) -> None:
    ticker = require("matplotlib.ticker", "plot")
    separator = "" if max(cell) < 9 else ","
    pair[0].set_title(f"$G_{{{cell[0] + 1}{separator}{cell[1] + 1}}}$", fontsize=_style.NORMAL, pad=3)
    if limits is not None:
        pair[0].set_ylim(*limits)
    pair[0].yaxis.set_major_locator(ticker.MaxNLocator(5, steps=[1, 2, 4, 5, 10]))
    pair[1].set_ylim(-_TOP, _TOP)
    pair[1].yaxis.set_major_locator(ticker.FixedLocator([-180, -90, 0, 90, 180]))
    for axis, name in zip(pair, ("dB", "degrees"), strict=True):
        _style.dress(axis)
        _style.frequency_axis(axis, frequency)
        axis.tick_params(labelleft=leftmost)
        if leftmost:
            axis.set_ylabel(name, fontsize=_style.SMALL, labelpad=2)


def _legend(frfs, labels, radii, confidence, position: int) -> list:
    lines, patches = require("matplotlib.lines", "plot"), require("matplotlib.patches", "plot")
    handles = []
    for k, label in enumerate(labels):
        colour, marker = _style.look(k)
        handles.append(lines.Line2D([], [], color=colour, marker=marker, ms=3.4, lw=0.7, label=label))
    if any(r is not None and np.isfinite(r).any() for r in radii):
        band = patches.Patch(color=_style.DOUBTFUL, alpha=0.35, lw=0, label=f"{100 * confidence:g} % confidence")
        handles.append(band)
    told = {name for f in frfs for name in _levels(f, position, (0, 0))}
    for name, (style, label) in _LEVELS.items():
        if name in told:
            look = {"color": _style.DOUBTFUL, "lw": 0.8, "ls": style}
            handles.append(lines.Line2D([], [], label=f"{label} (std)", **look))
    if any((np.asarray(f.status[position]) & int(SERIOUS)).any() for f in frfs):
        mark = {"ls": "none", "marker": "o", "ms": 3.4, "mfc": "white", "mec": _style.DOUBTFUL}
        handles.append(lines.Line2D([], [], **mark, label="doubtful (status)"))
    return handles
