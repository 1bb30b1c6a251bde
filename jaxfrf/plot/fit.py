"""Pictures of a fit: measurement and models, residuals, starts, correlations, rounds."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Complex

from .._annotated import checked
from .._arguments import expect, said
from .._errors import input_error
from .._text import number
from .._types import Array
from ..frf import FRF
from ..graybox import Fit
from ..graybox.quality import Quality
from ..io._optional import require
from ..units import response_unit
from . import _style
from .bode import _cells, _check, _legend, _new, bode

_JUMP = 180.0  # degrees between neighbours at which a drawn phase goes round
_MARGIN = (0.6, 1.0, 0.15, 0.5)  # inches: left, right, top, bottom of a map


def fit_bode(
    measured: FRF,
    models: Mapping[str, Complex[Array, "pos freq out in"]],
    *,
    elements: Sequence[tuple[int, int]] | None = None,
    position: int = 0,
    confidence: float | None = 0.95,
    size: tuple[float, float] | None = None,
    title: str = "",
):
    """Draw a measured FRF as points with its band, and models as lines over it.

    **Arguments:**

    - `models`: name -> G at the lines of `measured`.
    - `elements`: pairs (out, in), counted from 0; the diagonal by default.
    - `position`, `confidence`, `size`, `title`: as in `bode`.

    **Returns:** the figure, and its axes (row, column, 2).

    **Raises:** `jaxfrf.InputError` if an element or operating point does not exist, or a model is not of the same lines
    and elements.
    """
    expect("measured", measured, FRF)
    _check([measured], elements, position)
    if not isinstance(models, Mapping):
        raise input_error("models", said(models), "a table {name: G}", "Name them, e.g. {'fit': G}.")
    for name, G in models.items():
        if np.shape(G) != np.shape(measured.G):
            raise input_error(
                f"models[{name!r}]",
                f"shape {np.shape(G)}",
                f"{np.shape(measured.G)}, that of the measured FRF",
                "Evaluate it at the same positions and lines.",
            )
    elements = [(i, i) for i in range(min(measured.n_out, measured.n_in))] if elements is None else list(elements)
    cells = _cells(measured, elements)
    handles = _legend([measured], ["measured"], [np.asarray(measured.std)], confidence or 0, position)
    if confidence is None:
        handles = [h for h in handles if "confidence" not in h.get_label()]
    line = require("matplotlib.lines", "plot").Line2D
    handles += [line([], [], color=_colour(k), lw=1.2, label=name) for k, name in enumerate(models)]
    figure, axes = _new(cells, handles, f"magnitude in dB re 1 {response_unit(measured)}", title, size)
    kept = np.array([axis for row in axes for pair in row for axis in pair if axis is not None], object)
    if kept.size == axes.size:
        bode(measured, axes=axes, elements=elements, position=position, confidence=confidence)
    else:  # a last row that is not full
        for row, row_of_cells in enumerate(cells):
            for column, cell in enumerate(row_of_cells):
                pair = axes[row, column]
                bode(measured, axes=pair, elements=[cell], position=position, confidence=confidence)
                for axis in pair:
                    if column:
                        axis.tick_params(labelleft=False)
                        axis.set_ylabel("")
    for row, row_of_cells in enumerate(cells):
        for column, (out, ref) in enumerate(row_of_cells):
            for k, G in enumerate(models.values()):
                _model_line(axes[row, column], measured.frequency, np.asarray(G)[position, :, out, ref], _colour(k))
    return figure, axes


def _colour(k: int) -> str:
    return _style.look(k + 1)[0]


def _model_line(pair, frequency, g, colour: str) -> None:
    pair[0].plot(frequency, _style.decibel(np.abs(g)), color=colour, lw=0.9, alpha=0.9, zorder=4)
    phase = np.degrees(np.angle(g))
    jump = np.flatnonzero(np.abs(np.diff(phase)) > _JUMP)
    x, y = (np.insert(np.asarray(v, float), jump + 1, np.nan) for v in (frequency, phase))
    pair[1].plot(x, y, color=colour, lw=0.9, alpha=0.9, zorder=4)


@checked
def residual_maps(quality: Quality, positions: Sequence[int] | None = None):
    """Residuals over the noise, sqrt(chi-square), element by band and position by band; the errors in dB where the
    covariance is unknown.

    **Arguments:** `quality`: of `jaxfrf.graybox.quality`. `positions`: names of the rows by position; their numbers by
    default.

    **Returns:** the figure and its two axes.

    **Raises:** `jaxfrf.InputError` if `quality` is none; `ImportError` without matplotlib.
    """
    positions = range(len(quality.weighted)) if positions is None else positions
    return draw_residual_maps(
        *quality.maps, quality.edges, positions, n_in=quality.chi_square.shape[3], of_noise=quality.of_noise
    )


def draw_residual_maps(by_element, by_position, edges, positions: Sequence[object], *, n_in: int, of_noise: bool):
    """The same from its numbers, those of `Quality.maps`, as fit.json holds them."""
    names = [f"$G_{{{k // n_in + 1}{k % n_in + 1}}}$" for k in range(len(by_element))]
    row, left, right, top, bottom = 0.17, *_MARGIN
    heights = [max(row * len(names), 0.9), max(row * len(positions), 0.6)]
    width = 3.1
    full = 2 * (left + width) + 0.3 + right
    figure = _style.new_figure(full, top + max(heights) + bottom)
    axes = []
    what = "residual / noise" if of_noise else "rms error, dB"
    for k, (values, labels, name) in enumerate(
        ((by_element, names, "element"), (by_position, [str(p) for p in positions], "position"))
    ):
        axis = _style.add_axes(
            figure, left + k * (left + width + 0.1), bottom + max(heights) - heights[k], width, heights[k]
        )
        image = _map(axis, np.asarray(values, float), edges, labels, name)
        axes.append(axis)
    bar = _style.add_axes(figure, full - right + 0.1, bottom + max(heights) - 0.9, 0.12, 0.9)
    colours = figure.colorbar(image, cax=bar)
    ticker = require("matplotlib.ticker", "plot")
    colours.set_ticks([0.2, 0.5, 1, 2, 5], labels=["0.2", "0.5", "1", "2", "5"])
    bar.yaxis.set_minor_locator(ticker.NullLocator())
    colours.set_label(what, fontsize=_style.SMALL)
    bar.tick_params(labelsize=_style.SMALL, length=2)
    return figure, axes


def _map(axis, values, edges, labels, name: str):
    """A map of ratios about 1: blue below, red above, on a logarithmic scale from 1/5 to 5."""
    colours = require("matplotlib.colors", "plot")
    y = np.arange(len(labels) + 1)
    norm = colours.LogNorm(0.2, 5.0)
    image = axis.pcolormesh(edges, y, np.ma.masked_invalid(np.clip(values, 0.2, 5)), cmap="RdBu_r", norm=norm)
    axis.set_xscale("log")
    ticker = require("matplotlib.ticker", "plot")
    axis.xaxis.set_major_locator(ticker.FixedLocator(list(edges)))
    axis.xaxis.set_minor_locator(ticker.NullLocator())
    axis.xaxis.set_major_formatter(ticker.FuncFormatter(lambda f, _: number(f)))
    step = max(1, len(labels) // 36)
    axis.set_yticks(y[:-1:step] + 0.5, labels[::step])
    axis.invert_yaxis()
    axis.tick_params(labelsize=_style.SMALL - 1, length=2)
    axis.tick_params(axis="x", rotation=45)
    axis.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL)
    axis.set_ylabel(name, fontsize=_style.SMALL)
    return image


@checked
def start_paths(fitted: Fit):
    """Cost of every start over its steps, and where it ended beside the best.

    **Arguments:** `fitted`: of `jaxfrf.fit`, from one start or several.

    **Returns:** the figure and its axes.

    **Raises:** `jaxfrf.InputError` if `fitted` is none; `ImportError` without matplotlib.
    """
    return draw_start_paths([s.cost for s in fitted.starts], [s.path_cost for s in fitted.starts])


def draw_start_paths(costs: Sequence[float], paths: Sequence[Sequence[float] | np.ndarray]):
    """The same from the cost at which every start ended, and after every step."""
    figure = _style.new_figure(5.6, 2.5)
    axis = _style.add_axes(figure, 0.65, 0.45, 4.8, 1.9)
    best = np.nanmin(np.asarray(costs, float))
    for cost, steps in zip(np.asarray(costs, float), paths, strict=True):
        close = cost <= 1.01 * best + 1e-300
        path = np.maximum(np.asarray(steps, float), 1e-12)
        axis.plot(np.arange(len(path)), path, color=_style.COLOURS[0 if close else 1], lw=0.8, alpha=0.7)
        axis.plot(len(path) - 1, path[-1], "o", ms=3, color=_style.COLOURS[0 if close else 1])
    axis.set_yscale("log")
    axis.set_xlabel("step", fontsize=_style.SMALL)
    axis.set_ylabel("cost", fontsize=_style.SMALL)
    _style.dress(axis)
    return figure, axis


@checked
def correlation_map(fitted: Fit):
    """Correlations of the fitted parameters.

    **Arguments:** `fitted`: of `jaxfrf.fit`.

    **Returns:** the figure and its axes.

    **Raises:** `jaxfrf.InputError` if `fitted` is none; `ImportError` without matplotlib.
    """
    return draw_correlation_map(fitted.coordinates.names, fitted.uncertainty.correlation)


def draw_correlation_map(names: Sequence[str], rho):
    """The same from the names and their correlation matrix."""
    rho = np.asarray(rho, float)
    side = max(1.2, 0.17 * len(names))
    left = 0.25 + 0.05 * max(len(n) for n in names)
    figure = _style.new_figure(left + side + 0.8, side + left + 0.1)
    axis = _style.add_axes(figure, left, left, side, side)
    image = axis.imshow(rho, vmin=-1, vmax=1, cmap="RdBu_r")
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize=_style.SMALL - 1)
    axis.set_yticks(range(len(names)), names, fontsize=_style.SMALL - 1)
    axis.tick_params(length=2)
    bar = _style.add_axes(figure, left + side + 0.12, left, 0.12, side)
    figure.colorbar(image, cax=bar)
    bar.tick_params(labelsize=_style.SMALL, length=2)
    return figure, axis


def round_gaps(gap_db: Sequence[float], gap_degrees: Sequence[float]):
    """Difference of measured and simulated FRF in every round of an indirect fit.

    **Arguments:** `gap_db`, `gap_degrees`: rms of magnitude, dB, and phase, degrees, one for each round.

    **Returns:** the figure and its axes.

    **Raises:** `ImportError` without matplotlib.
    """
    figure = _style.new_figure(4.2, 2.3)
    axis = _style.add_axes(figure, 0.65, 0.45, 3.4, 1.7)
    rounds = np.arange(1, len(gap_db) + 1)
    for k, (value, name) in enumerate(((gap_db, "dB"), (gap_degrees, "degrees"))):
        colour, marker = _style.look(k)
        axis.plot(rounds, value, marker=marker, ms=3.4, lw=0.8, color=colour, label=name)
    axis.set_yscale("log")
    axis.set_xlabel("round", fontsize=_style.SMALL)
    axis.set_ylabel("rms gap", fontsize=_style.SMALL)
    axis.xaxis.set_major_locator(require("matplotlib.ticker", "plot").MaxNLocator(integer=True))
    axis.legend(fontsize=_style.SMALL, frameon=False)
    _style.dress(axis)
    return figure, axis
