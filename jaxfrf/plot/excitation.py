"""The picture of an experiment's reference: what it looks like in time, and which lines it excites."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from .._annotated import checked
from .._arguments import expect_index, expect_whole
from .._errors import input_error
from .._text import number
from .._types import Array
from ..excitation import Reference, detection_lines, reference_levels
from . import _style


@checked
def multisine(
    reference: Reference,
    *,
    experiment: int = 0,
    channels: Sequence[int] | Int[Array, "channel"] | None = None,
    axes: _style.Axes | None = None,
):
    """Speed over one steady period, and amplitude per line with the excited, slow and detection lines.

    Lines are single points: between excited lines there is nothing. The detection lines stand below the
    spectrum, where nonlinear distortion will show. The legend gives the rms and the crest factor of the
    multisine alone, and the peak of what is played.

    **Arguments:** `reference`: of `jaxfrf.reference`. `experiment`: which one (all have the same amplitudes).
    `channels`: which inputs, all by default. `axes`: two matplotlib axes to draw on, for time and spectrum; new ones by
    default.

    **Returns:** the two axes; `axes[0].figure.savefig("design.png")` saves the picture.

    **Raises:** `jaxfrf.InputError` if `reference` is none, or has no such experiment or channel; `ImportError` without
    matplotlib.
    """
    channels = list(range(reference.n_in) if channels is None else channels)
    _check(reference, experiment, channels)
    axes = _new_axes() if axes is None else axes
    _draw_time(axes[0], reference, experiment, channels)
    _draw_spectrum(axes[1], reference, experiment, channels)
    return axes


def _check(reference: Reference, experiment: int, channels) -> None:
    expect_index("experiment", experiment, reference.n_exp)
    if not channels:
        raise input_error("channels", "none", "at least one input", "Leave it out to see all.")
    for channel in channels:
        expect_whole("channels", channel)
        if not channel < reference.n_in:
            raise input_error("channels", f"{channel}", f"0 to {reference.n_in - 1}", "Choose inputs that are there.")


def _new_axes():
    figure = _style.new_figure(10.0, 8.0)
    figure.set_layout_engine("constrained")
    return figure.subplots(2, 1)


def _draw_time(ax, reference: Reference, experiment: int, channels) -> None:
    """One row per input, all to the same scale: drawn on top of each other they would hide each other."""
    start = reference.transient_periods * reference.period
    time = np.arange(reference.period) / reference.fs
    steady = reference.r[experiment, start : start + reference.period][:, channels]
    distance = 2.1 * np.max(np.abs(steady))
    rows = -distance * np.arange(len(channels))
    for channel, row, speed in zip(channels, rows, steady.T, strict=True):
        ax.plot(time, speed + row, color=_colour(channel), linewidth=0.5)
    ax.set_yticks(rows, [f"input {channel + 1}" for channel in channels])
    ax.set_ylim(rows[-1] - distance / 2, distance / 2)
    ax.set_xlim(0, reference.period / reference.fs)
    ax.set_xlabel("time in a steady period (s)")
    ax.set_ylabel(f"speed reference ({number(distance)} rad/s a row)")
    ax.set_title(f"experiment {experiment + 1} of {reference.n_exp}")
    _style.dress(ax)


def _draw_spectrum(ax, reference: Reference, experiment: int, channels) -> None:
    design = reference.design
    amplitude = 2 * np.abs(reference.spectra[experiment])
    labels = _labels(reference, experiment)
    for depth, channel in enumerate(channels):
        # Larger below, smaller above: equal amplitudes stay visible.
        look = {"color": _colour(channel), "markersize": 3 + 2.5 * (len(channels) - 1 - depth)}
        ax.plot(design.frequency, amplitude[:, channel], ".", label=labels[channel], **look)
    slow_frequency, slow_amplitude = _draw_slow_sines(ax, reference, channels)
    shown = amplitude[:, channels]
    _draw_detection_lines(ax, reference, shown.min())
    ax.set_yscale("log")
    ax.set_ylim(shown.min() / 12, 2 * max([shown.max(), *slow_amplitude]))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    ax.set_xlabel("frequency (Hz)")
    ax.set_ylabel("amplitude per line (rad/s)")
    _style.frequency_axis(ax, np.concatenate([slow_frequency, design.frequency]))
    _style.dress(ax)
    band = f"{number(design.frequency[0], 4)}-{number(design.frequency[-1], 4)} Hz"
    slow = ", slow sines (triangles)" if len(slow_amplitude) else ""
    ax.set_title(f"{len(design.lines)} excited lines, {band}{slow}")
    ax.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)


def _labels(reference: Reference, experiment: int) -> list[str]:
    level = reference_levels(reference)
    per_channel = zip(level.rms[experiment], level.velocity[experiment], level.crest[experiment], strict=True)
    return [
        f"input {i}: rms {number(rms)}, peak {number(peak)} rad/s, crest {crest:.2f}"
        for i, (rms, peak, crest) in enumerate(per_channel, 1)
    ]


def _draw_slow_sines(ax, reference: Reference, channels) -> tuple[np.ndarray, np.ndarray]:
    """Their frequencies (Hz) and amplitudes, those of amplitude 0 left out."""
    slow = reference.design.slow
    moved = [] if slow is None else [i for i in channels if slow.amplitude[i] > 0]
    if slow is None or not moved:
        return np.zeros(0), np.zeros(0)
    frequency, amplitude = slow.lines[moved] * reference.fs / reference.period, slow.amplitude[moved]
    for channel, x, y in zip(moved, frequency, amplitude, strict=True):
        ax.plot(x, y, "^", color=_colour(channel), markersize=5)
    return frequency, amplitude


def _draw_detection_lines(ax, reference: Reference, lowest: float) -> None:
    """Below the spectrum, as there is nothing at them."""
    resolution = reference.fs / reference.period
    odd, even = detection_lines(reference.lines)
    for lines, name, level, grey in ((odd, "odd", lowest / 4, "0.2"), (even, "even", lowest / 7, "0.6")):
        if lines.size:
            label = f"{lines.size} {name} lines left silent"
            ax.plot(lines * resolution, np.full(lines.size, level), "|", color=grey, markersize=6, label=label)


def _colour(channel: int) -> str:
    colour, _ = _style.look(channel)
    return colour
