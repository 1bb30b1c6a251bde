"""Figures 3 and 4: the diagonal elements of one position by every method, and an enlargement of G33."""

import pathlib
from collections.abc import Mapping, Sequence

import numpy as np

from ..experiment import Experiment
from ..io._optional import require
from ..plot.bode import confidence_radius
from ..robot import Robot
from .bias import estimates, true_response
from .settings import Settings

SHOWN = {
    "LOG": ("#222222", "-", 1.3),
    "LRM, MISO": ("#b3b300", "-", 0.9),
    "LRM, MIMO": ("#2a7fbf", "-", 0.9),
    "LRM, JIO": ("#c1272d", "-", 1.1),
}
_TICKS = (5, 10, 15, 20, 30, 40, 50, 80)
_ONE = ("#3a9a4a", "-", 0.9)
_TRUE = "#f0a030"
_POSITIONS = 2  # that the picture holds: half a megabyte each
_RADIUS = "radius of "


def example_responses(robot: Robot, data: Experiment, settings: Settings) -> dict[str, np.ndarray]:
    """The truth and every estimate of the figures, at the first positions of a record: name -> (pos, freq, out, in),
    and `radius of` its name -> that of its 95 % region; `frequency`, Hz."""
    found = estimates(data, settings)
    frequency = next(iter(found[6].values())).frequency
    most = settings.experiments[0]
    shown = {f"LOG_{most}": found[most]["LOG"]} | {f"{name}_6": found[6][name] for name in SHOWN}
    shown["LRM, JIO_1"] = found[1]["LRM, JIO"]
    cut = lambda x: np.asarray(x)[:_POSITIONS]
    arrays = {"frequency": np.asarray(frequency), "true": cut(true_response(robot, data, frequency))}
    for name, frf in shown.items():
        arrays[name], arrays[_RADIUS + name] = cut(frf.G), cut(confidence_radius(frf))
    return arrays


def picture_of(arrays: Mapping[str, np.ndarray], position: int) -> str:
    """What both figures show, to choose from: every element, position and estimate, with its 95 % regions.

    **Arguments:** `position`: number of the first one.

    **Returns:** HTML.
    """
    from ..report.picture import Curve, decibel, picture, responses

    curves = [Curve("true", _TRUE, arrays["frequency"], responses(arrays["true"]), points=False)]
    for name, (colour, _) in _estimates(arrays).items():
        layers = responses(arrays[name]) | {"radius": decibel(arrays[_RADIUS + name])}
        curves.append(Curve(_called(name), colour, arrays["frequency"], layers))
    axes = range(1, arrays["true"].shape[-1] + 1)
    return picture(
        curves,
        outputs=[f"acceleration of motor {i} (rad/s²)" for i in axes],
        inputs=[f"torque of motor {i} (N m)" for i in axes],
        positions=[f"position {position + k}" for k in range(len(arrays["true"]))],
        unit="rad/s² per N m",
    )


def _estimates(arrays: Mapping[str, np.ndarray]) -> dict[str, tuple[str, float]]:
    """Names of the estimates with colour and width, that of the most experiments first; LOG of six is paler beside
    it."""
    most = max((n for n in arrays if n.startswith("LOG_")), key=lambda n: int(n[4:]))
    names = dict.fromkeys((most, *(f"{n}_6" for n in SHOWN)))
    found = {name: (SHOWN[name.rpartition("_")[0]][0], SHOWN[name.rpartition("_")[0]][2]) for name in names}
    return found | {"LRM, JIO_1": (_ONE[0], _ONE[2])}


def _called(name: str) -> str:
    method, _, count = name.rpartition("_")
    return f"{method}, {count} experiment{'s' if count != '1' else ''}"


def read_curves(path: pathlib.Path) -> dict[str, np.ndarray]:
    """What `example_responses` gave, from its file."""
    with np.load(path) as stored:
        return {name: stored[name] for name in stored.files}


def draw_figures(arrays: Mapping[str, np.ndarray], folder: pathlib.Path) -> dict[str, str]:
    """Draw both figures into a folder; returns their file names."""
    from ..plot import save

    files = {"figure3": "figure3.png", "figure4": "figure4.png"}
    save(diagonals(arrays), folder / files["figure3"])
    save(enlargement(arrays), folder / files["figure4"])
    return files


def diagonals(arrays: Mapping[str, np.ndarray]):
    """Figure 3: the magnitude of every diagonal element."""
    figure = require("matplotlib.figure", "plot").Figure(figsize=(11, 6.4), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True)
    for i, ax in enumerate(axes.flat[: arrays["true"].shape[-1]]):
        _curves(ax, arrays, i)
        ax.set_title(f"$G_{{{i + 1}{i + 1}}}$", fontsize=10)
    for ax in axes[-1]:
        ax.set_xlabel("frequency, Hz")
    for ax in axes[:, 0]:
        ax.set_ylabel("magnitude, dB (rad/s² per N m)")
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def enlargement(arrays: Mapping[str, np.ndarray]):
    """Figure 4: the third diagonal element around its antiresonance and resonance."""
    figure = require("matplotlib.figure", "plot").Figure(figsize=(8, 4.6), layout="constrained")
    ax = figure.subplots()
    _curves(ax, arrays, 2)
    ax.set_xlabel("frequency, Hz")
    ax.set_ylabel("magnitude of $G_{33}$, dB (rad/s² per N m)")
    frequency, level = arrays["frequency"], 20 * np.log10(np.abs(arrays["true"][0, :, 2, 2]))
    middle = frequency[np.argmin(level)]
    inside = (frequency > 0.6 * middle) & (frequency < 3.2 * middle)
    ax.set_xlim(0.6 * middle, 3.2 * middle)
    ax.set_ylim(level[inside].min() - 6, level[inside].max() + 6)
    ax.legend(frameon=False, fontsize=8)
    return figure


_KINDS = ("stiffness", "damping", "coulomb_friction", "viscous_friction", "mass")
_FITS = {"given": ("#7a7a7a", "x"), "springs": ("#D55E00", "s"), "whole": ("#0072B2", "o")}


def errors_of_numbers(numbers: Sequence[Mapping]) -> list:
    """Relative error of every number of a machine and half of its 95 % interval, a small figure for each kind."""
    groups = {kind: [n for n in numbers if n["kind"] == kind] for kind in _KINDS}
    return [_errors_of(kind, these) for kind, these in groups.items() if these]


def _errors_of(kind: str, these: Sequence[Mapping]):
    figure = require("matplotlib.figure", "plot").Figure(figsize=(3.1, 0.85 + 0.3 * len(these)), layout="constrained")
    ax = figure.subplots()
    for place, number in enumerate(these):
        _number(ax, place, number)
    ax.set_yticks(range(len(these)), [n["name"].removesuffix(f".{kind}").replace("_", " ") for n in these], fontsize=8)
    ax.set_ylim(len(these) - 0.4, -0.6)
    ax.set_xscale("log")
    ax.set_xlim(*_ERRORS)
    ax.set_xticks((0.01, 0.1, 1, 10, 100), (".01", ".1", "1", "10", "100"), fontsize=8)
    ax.set_xticks([], minor=True)
    ax.grid(True, axis="x", color="#dddddd", lw=0.4)
    ax.set_title(kind.replace("coulomb", "Coulomb").replace("_", " "), fontsize=9.5)
    ax.set_xlabel("error, %", fontsize=8)
    return figure


_ERRORS = (0.006, 160.0)  # %: smaller ones stand at the edge


def _number(ax, place: int, number: Mapping) -> None:
    for k, (what, (colour, marker)) in enumerate(_FITS.items()):
        found, at = number[what], place + 0.22 * (k - 1)
        if found is None:
            continue
        value = found if what == "given" else found["value"]
        error = max(100 * abs(value / number["true"] - 1), _ERRORS[0])
        if what != "given":
            half = 100 * (found["high"] - found["low"]) / 2 / abs(number["true"])
            ax.plot([_ERRORS[0], half], [at, at], color=colour, lw=3.5, alpha=0.3, solid_capstyle="butt")
        ax.plot(error, at, marker, color=colour, ms=4.5, ls="")


def _curves(ax, arrays, axis: int) -> None:
    frequency = arrays["frequency"]
    level = lambda name: 20 * np.log10(np.maximum(np.abs(arrays[name][0, :, axis, axis]), 1e-300))
    ax.semilogx(frequency, level("true"), color=_TRUE, lw=2.6, alpha=0.75, label="true")
    most = max((n for n in arrays if n.startswith("LOG_")), key=lambda n: int(n[4:]))
    for name in dict.fromkeys((most, *(f"{n}_6" for n in SHOWN))):
        method, _, count = name.rpartition("_")
        colour, style, width = SHOWN[method]
        style = style if name in (most, "LRM, JIO_6") or method != "LOG" else ":"
        ax.semilogx(frequency, level(name), color=colour, ls=style, lw=width, label=f"{method}$_{{{count}}}$")
    ax.semilogx(frequency, level("LRM, JIO_1"), color=_ONE[0], lw=_ONE[2], label="LRM, JIO$_{1}$")
    ax.set_xlim(frequency[0], frequency[-1])
    ax.set_xticks(_TICKS, [f"{f}" for f in _TICKS])
    ax.set_xticks([], minor=True)
    ax.grid(True, which="both", color="#dddddd", lw=0.4)
