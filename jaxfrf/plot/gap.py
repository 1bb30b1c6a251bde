"""Pictures of a diagnosis: where model and measurement differ, and what became of it."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .._arguments import as_names, expect_each, wrong_kind
from .._errors import input_error
from .._text import number
from ..frf import FRF
from ..io._optional import require
from . import _style
from .bode import bode
from .fit import _model_line

BEFORE, AFTER = _style.COLOURS[1], _style.COLOURS[2]
_GROUNDS = ("#F4F6F8", "#FBE3BE", "#F7B267", "#E4662A", "#A62408", "#5A0A0A")  # of a map, from the floor up
_SOFT = "#5C6670"
_SIGNALS = {"speed": "motor speed (rad/s)", "angle": "arm angle (rad)", "load": "load on the motor (N m)"}
_FLAT = 0.02  # of the largest load: a residual that small is drawn flat

Numbers = Float[np.ndarray, "axis"]


def gap_maps(
    before: Float[np.ndarray, "pos axis band"],
    after: Float[np.ndarray, "pos axis band"] | None,
    bands: Float[np.ndarray, "edge"],
    axis_names: Sequence[str],
    *,
    marked: Sequence[str] = (),
    heldout: Sequence[int] = (),
):
    """Torque residuals over their floor before and after, side by side: a block for every axis, a row of it for every
    position, a column for every band.

    **Arguments:** `before`, `after`: over the floor, (pos, axis, band); `after` is `None` where nothing was changed.
    `bands`: edges, Hz. `axis_names`: one for each axis. `marked`: axes in bold. `heldout`: positions in bold.

    **Returns:** the figure and its axes, one or two.

    **Raises:** `jaxfrf.InputError` for shapes that do not fit each other; `ImportError` without matplotlib.
    """
    panels = [_values("before", before, ("pos", "axis", "band"))]
    n_pos, n_axes, n_bands = panels[0].shape
    panels += [] if after is None else [_values("after", after, panels[0].shape)]
    axis_names = as_names("axis_names", axis_names, n_axes, "axes")
    bands = _values("bands", bands, (n_bands + 1,))
    block, gap = float(np.clip(0.1 * n_pos, 0.3, 0.8)), 0.07
    height, width, left, bottom = n_axes * (block + gap), 3.75 if len(panels) > 1 else 5.5, 1.0, 0.42
    figure = _style.new_figure(left + len(panels) * (width + 0.3) + 0.7, bottom + height + 0.3)
    colours = require("matplotlib.colors", "plot")
    top = max(4.0, float(np.nanmax(np.stack(panels), initial=1.0)))
    norm = colours.LogNorm(1.0, top)
    ground = colours.LinearSegmentedColormap.from_list("gap", _GROUNDS).with_extremes(bad="#FFFFFF")
    axes = []
    for k, values in enumerate(panels):
        axis = _style.add_axes(figure, left + k * (width + 0.3), bottom, width, height)
        axes.append(axis)
        for n in range(n_axes):
            rows = n * (block + gap) + np.linspace(0, block, n_pos + 1)
            cells = np.ma.masked_invalid(np.clip(values[:, n], 1.0, None))
            image = axis.pcolormesh(
                range(n_bands + 1), rows, cells, cmap=ground, norm=norm, edgecolor="white", linewidth=0.3
            )
            if k == 0:
                _name_block(axis, axis_names[n], n * (block + gap), block, n_pos, axis_names[n] in marked, heldout)
        axis.set(xlim=(0, n_bands), ylim=(height - gap, 0), yticks=[])
        axis.set_xticks(range(n_bands + 1), [number(f) for f in bands])
        axis.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL)
        if len(panels) > 1:
            own = {"fontsize": _style.NORMAL, "fontweight": "bold", "color": (BEFORE, AFTER)[k]}
            axis.set_title(("before", "after")[k], loc="left", pad=4, **own)
        axis.tick_params(labelsize=_style.SMALL, length=2.5, width=0.5, color=_SOFT)
        axis.spines[:].set_visible(False)
    _bar(figure, image, left + len(panels) * (width + 0.3) - 0.1, bottom, min(height, 2.6), top)
    return figure, axes


def _values(name: str, values, shape: tuple[int | str, ...]) -> np.ndarray:
    """Numbers of this shape, of which axes that have a name may be of any length."""
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError):
        raise wrong_kind(name, values, "numbers") from None
    lengths = [n if isinstance(n, int) else m for n, m in zip(shape, found.shape, strict=False)]
    if found.ndim != len(shape) or list(found.shape) != lengths:
        wanted = ", ".join(str(n) for n in shape) + ("," if len(shape) == 1 else "")
        raise input_error(name, f"shape {found.shape}", f"({wanted})", "Check it and the order of the arguments.")
    return found


def _name_block(axis, name: str, top: float, block: float, n_pos: int, bold: bool, heldout: Sequence[int]) -> None:
    """Names of an axis and its positions, left of its block."""
    place = {"transform": axis.get_yaxis_transform(), "ha": "right", "va": "center", "clip_on": False}
    weight = "bold" if bold else "normal"
    axis.text(-0.055, top + block / 2, name, fontsize=_style.SMALL + 1, fontweight=weight, **place)
    step = max(1, -(-n_pos * 7 // int(72 * block)))  # rows that a number of 7 points takes
    for p in range(0, n_pos, step):
        own = {"fontweight": "bold", "color": "black"} if p in heldout else {"color": _SOFT}
        axis.text(-0.012, top + (p + 0.5) * block / n_pos, str(p), fontsize=5.5, **own, **place)


def _bar(figure, image, left: float, bottom: float, height: float, top: float) -> None:
    axis = _style.add_axes(figure, left, bottom, 0.13, height)
    bar = figure.colorbar(image, cax=axis)
    ticks = [t for t in (1, 2, 3, 5, 10, 20, 50, 100, 200, 500, 1000) if t <= top]
    bar.set_ticks(ticks, labels=[str(t) for t in ticks])
    axis.yaxis.set_minor_locator(require("matplotlib.ticker", "plot").NullLocator())
    axis.set_ylabel("rms / floor", fontsize=_style.SMALL)
    axis.tick_params(labelsize=_style.SMALL, length=2.5, width=0.5, color=_SOFT)
    bar.outline.set_visible(False)


def torque_courses(
    courses: Mapping[str, Sequence[np.ndarray] | np.ndarray],
    axis_names: Sequence[str],
    shown: Sequence[str],
    *,
    row: float = 1.6,
):
    """Mean torque residual against speed, angle and load, before and after; a row for every axis of `shown`.

    All pictures of an axis share their scale, which never goes below 2 % of its largest load.

    **Arguments:** `courses`: {signal: (values, before, after)}, each (axis, bin); without the last where nothing was
    changed. `axis_names`: one for each axis. `shown`: those of them that get a row. `row`: height of a row, inches.

    **Returns:** the figure and its axes, (row, signal).

    **Raises:** `jaxfrf.InputError` for no courses, and for an axis that has no name; `ImportError` without matplotlib.
    """
    if not isinstance(courses, Mapping) or not courses:
        raise wrong_kind("courses", courses, "{signal: (values, before, after)}")
    axis_names = list(axis_names)
    for name in shown:
        if name not in axis_names:
            raise input_error("shown", repr(name), f"some of {', '.join(axis_names)}", "Correct the name.")
    signals = [s for s in (*_SIGNALS, *courses) if s in courses]
    signals = list(dict.fromkeys(signals))
    left = 0.6 + 0.08 * max((len(name) for name in shown), default=0)  # room for the name and for small numbers
    right, top, bottom, across, down = 0.18, 0.42, 0.42, 0.16, 0.3
    width = (9.9 - left - right - across * (len(signals) - 1)) / len(signals)
    figure = _style.new_figure(9.9, top + bottom + len(shown) * (row + down) - down)
    axes = np.empty((len(shown), len(signals)), object)
    full = figure.get_figheight()
    for r, name in enumerate(shown):
        place = axis_names.index(name)
        limit = _limit(courses, place)
        for c, signal in enumerate(signals):
            axis = _style.add_axes(
                figure, left + c * (width + across), full - top - (r + 1) * row - r * down, width, row
            )
            _course(axis, *(np.asarray(x)[place] for x in courses[signal]), large=row > 1)
            axis.set_ylim(-limit, limit)
            axis.tick_params(labelleft=c == 0)
            axis.yaxis.set_major_locator(require("matplotlib.ticker", "plot").MaxNLocator(4 if row > 1 else 2))
            if r + 1 == len(shown):
                axis.set_xlabel(_SIGNALS.get(signal, signal), fontsize=_style.SMALL, labelpad=2)
            axes[r, c] = axis
        middle = full - top - r * (row + down) - row / 2
        figure.text(0.08 / 9.9, middle / full, name, fontsize=_style.SMALL + 1, fontweight="bold", va="center")
    figure.text((left - 0.42) / 9.9, (full - top + 0.06) / full, "N m", fontsize=_style.SMALL, color=_SOFT, va="bottom")
    if len(courses[signals[0]]) > 2:
        _key(figure, left)
    return figure, axes


def _course(axis, x, *residuals, large: bool) -> None:
    axis.axhline(0, color="#888888", lw=0.6)
    thick, size = (1.3, 2.6) if large else (0.9, 0)
    for y, colour in zip(residuals, (BEFORE, AFTER), strict=False):
        axis.plot(x, y, color=colour, lw=thick, marker="o", ms=size, mec="none")
    _style.dress(axis)
    known = x[np.isfinite(x)]
    if known.size > 1 and np.ptp(known):
        axis.set_xlim(known.min(), known.max())
    axis.xaxis.set_major_locator(require("matplotlib.ticker", "plot").MaxNLocator(5))


def _limit(courses, place: int) -> float:
    values = [np.abs(np.asarray(y)[place]) for _, *residuals in courses.values() for y in residuals]
    largest = np.nanmax(np.concatenate(values), initial=0.0)
    load = np.nanmax(np.abs(courses["load"][0][place]), initial=0.0) if "load" in courses else 0.0
    return 1.12 * max(float(largest), _FLAT * float(load), 1e-12)


def _key(figure, left: float) -> None:
    line = require("matplotlib.lines", "plot").Line2D
    handles = [line([], [], color=c, lw=1.5, label=n) for c, n in ((BEFORE, "before"), (AFTER, "after"))]
    place = (left / figure.get_figwidth(), 1.0)
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=place, ncols=2, fontsize=_style.SMALL, frameon=False
    )


def gap_dumbbells(
    before: Numbers,
    after: Numbers | None,
    axis_names: Sequence[str],
    *,
    marked: Sequence[str] = (),
    label: str = "torque residual, % of the torque (rms)",
):
    """Rms torque residual over the rms torque, axis by axis, before and after; or another part that `label` says.

    **Arguments:** `before`, `after`: (axis,), parts without a unit; `None` where nothing was changed. `axis_names`: one
    for each axis. `marked`: axes in bold. `label`: below the picture.

    **Returns:** the figure and its axes.

    **Raises:** `jaxfrf.InputError` for shapes that do not fit each other; `ImportError` without matplotlib.
    """
    changed, before = after is not None, 100 * _values("before", before, ("axis",))
    after = 100 * _values("after", after, before.shape) if changed else before
    axis_names = as_names("axis_names", axis_names, len(before), "axes")
    left, width, row = 0.8, 3.0, 0.27
    height = row * len(axis_names)
    figure = _style.new_figure(left + width + 1.15, height + 0.85)
    axis = _style.add_axes(figure, left, 0.45, width, height)
    y = np.arange(len(axis_names))
    top = 1.08 * max(float(np.nanmax(np.stack([before, after]), initial=0.0)), 1e-3)
    axis.hlines(y, np.minimum(before, after), np.maximum(before, after), color="#B9C0C7", lw=3.2, zorder=1)
    inside = "white" if changed else BEFORE
    axis.plot(before, y, "o", ms=6.5, mfc=inside, mec=BEFORE, mew=1.6, ls="none", label="before", zorder=2)
    if changed:
        axis.plot(after, y, "o", ms=6.5, color=AFTER, mec="none", ls="none", label="after", zorder=3)
        own = {"ncols": 2, "fontsize": _style.SMALL, "frameon": False}
        axis.legend(loc="lower left", bbox_to_anchor=(-0.03, 1.0), **own)
    for k in y:
        text = "not known" if not np.isfinite(before[k]) else _change(before[k], after[k])
        axis.text(1.03, k, text, transform=axis.get_yaxis_transform(), fontsize=_style.SMALL, va="center")
    axis.set_yticks(y, axis_names)
    for tick in axis.get_yticklabels():
        tick.set_fontweight("bold" if tick.get_text() in marked else "normal")
    axis.set(xlim=(0, top), ylim=(len(y) - 0.5, -0.5))
    axis.set_xlabel(label, fontsize=_style.SMALL)
    _style.dress(axis)
    axis.grid(False, axis="y")
    axis.tick_params(axis="y", length=0, labelsize=_style.SMALL + 1)
    axis.spines[["top", "right", "left"]].set_visible(False)
    return figure, axis


def _change(before: float, after: float) -> str:
    if f"{before:.1f}" == f"{after:.1f}":
        return f"{after:.1f} %"
    return f"{before:.1f} → {after:.1f} %"


def gap_bode(frfs: Sequence[FRF], axis: int, position: int):
    """A diagonal element of the measured FRF with the model's before and after, and their relative errors.

    **Arguments:** `frfs`: measured, before, after, at the same lines; without the last where nothing was changed.
    `axis`, `position`: from 0.

    **Returns:** the figure and its axes: magnitude, phase, error.

    **Raises:** `jaxfrf.InputError` where the measured FRF has no such axis or position, or a model is not of its lines
    and elements; `ImportError` without matplotlib.
    """
    expect_each("frfs", frfs, FRF, least=2)
    measured, *models = frfs
    for name, model in zip(("before", "after"), models, strict=False):
        if np.shape(model.G) != np.shape(measured.G):
            raise input_error(
                f"FRF {name}", f"shape {np.shape(model.G)}", f"{np.shape(measured.G)} as measured", "Take its lines."
            )
    figure = _style.new_figure(9.9, 3.5)
    pair = _style.add_axes(figure, 0.6, 1.5, 4.9, 1.6), _style.add_axes(figure, 0.6, 0.42, 4.9, 0.98)
    error = _style.add_axes(figure, 6.2, 0.42, 3.6, 2.68)
    bode(measured, axes=pair, elements=[(axis, axis)], position=position)
    pair[0].tick_params(labelbottom=False)
    G = np.asarray(measured.G)[position, :, axis, axis]
    largest = []
    for model, colour in zip(models, (BEFORE, AFTER), strict=False):
        own = np.asarray(model.G)[position, :, axis, axis]
        _model_line(pair, measured.frequency, own, colour)
        off = 100 * np.abs(own / G - 1)
        largest.append(off)
        error.plot(measured.frequency, off, color=colour, lw=1.2)
    radius = 100 * np.asarray(measured.std)[position, :, axis, axis] / np.abs(G)
    if np.isfinite(radius).any():
        error.fill_between(measured.frequency, 0, radius, color=_style.COLOURS[0], alpha=0.2, lw=0)
    _style.dress(error)
    _style.frequency_axis(error, measured.frequency)
    top = np.nanmax(np.concatenate(largest), initial=1.0)
    error.set_ylim(0, 1.05 * min(top, 200.0))
    error.set_title("relative error (%)", fontsize=_style.NORMAL, pad=3)
    for below in (pair[1], error):
        below.set_xlabel("Frequency (Hz)", fontsize=_style.SMALL, labelpad=2)
    line, patch = require("matplotlib.lines", "plot").Line2D, require("matplotlib.patches", "plot").Patch
    dots = line([], [], color=_style.COLOURS[0], marker="o", ms=3.4, lw=0.7, label="measured")
    named = ((BEFORE, "model before"), (AFTER, "model after")) if len(models) > 1 else ((BEFORE, "model"),)
    lines = [line([], [], color=c, lw=1.2, label=n) for c, n in named]
    band = [patch(color=_style.COLOURS[0], alpha=0.2, lw=0, label="uncertainty of the measurement")]
    _style.header(figure, [dots, *lines, *(band if np.isfinite(radius).any() else [])], "", "")
    return figure, (*pair, error)
