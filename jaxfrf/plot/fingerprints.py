"""What effects look like in data: a card for each, with what it asks of a motor along one motion."""

import itertools
import textwrap
from collections.abc import Sequence
from typing import Protocol

import equinox as eqx
import numpy as np
import scipy.ndimage
from jaxtyping import Complex, Float

from ..effects import AbstractEffect, library
from ..effects._place import axis_of
from ..io._optional import require
from ..io.gaps import equation
from ..robot import Robot
from . import _style

# In the library's order of families: dark enough for words, neighbours apart.
_COLOURS = (*(_style.COLOURS[i] for i in (0, 1, 3)), "#6A51A3", _style.COLOURS[2], "#B07D00", "#8C2D04", "#3E7C8F")
_OTHER = "#444444"  # of effects of one's own
_BASE, _SOFT = "#C9CED4", "#5C6670"
_SAMPLES = 2048  # of the courses
_BINS = 24
_FAINT = 0.05  # part of the variance: less is no law
_AROUND = 1.0  # Hz, over which a spectrum is averaged
_DECADES = 5.0  # of an amplitude spectrum
_CARD, _TEXT, _PANEL, _BETWEEN, _GUTTER, _HEAD = 1.62, 2.8, 1.28, 0.44, 0.3, 0.34  # inches
_WRAP = 40  # characters of a line of text


class Along(Protocol):
    """One position's motion, such as `jaxfrf.trajectory.scene.Scene`: signals are (exp, time, axis), motor side."""

    period: int
    fs: float
    gear: np.ndarray
    robot: Robot

    @property
    def speed(self) -> np.ndarray: ...
    @property
    def acceleration(self) -> np.ndarray: ...
    @property
    def angle(self) -> np.ndarray: ...
    @property
    def load(self) -> np.ndarray: ...
    @property
    def command(self) -> np.ndarray: ...


class Fingerprint(eqx.Module):
    """What one effect adds to one motor's torque along one experiment.

    **Fields:** `axis`: number of the motor. `more`, `base`: lines of the added and of the whole torque, N m,
    `frequency` in Hz. `course`: added torque, N m; `signals`: what it may depend on, at the same instants, by a name
    with its unit.
    """

    effect: AbstractEffect
    axis: int = eqx.field(static=True)
    frequency: Float[np.ndarray, "line"]
    more: Complex[np.ndarray, "line"]
    base: Complex[np.ndarray, "line"]
    course: Float[np.ndarray, "sample"]
    signals: dict[str, Float[np.ndarray, "sample"]]

    def share(self, signal: str) -> float:
        """Part of the course's variance that is a function of this signal alone, by bins; 0 to 1."""
        _, mean, place = _binned(self.signals[signal], self.course)
        total = float(np.var(self.course))
        return 0.0 if self.constant else float(np.var(mean[place]) / total)

    @property
    def constant(self) -> bool:
        """Whether the added torque does not change at all."""
        return bool(np.ptp(self.course) <= 1e-9 * np.max(np.abs(self.course)))


def fingerprint(effect: AbstractEffect, torque: Complex[np.ndarray, "exp line axis"], scene: Along) -> Fingerprint:
    """The fingerprint of an effect in the first experiment of a scene, on the motor of its joint, or on that whose
    torque it changes most where it has none.

    **Arguments:** `torque`: what `jaxfrf.trajectory.signature` gives for the effect in this scene.
    """
    command = np.asarray(scene.command)[0]
    lines = np.asarray(torque).shape[1]
    base = np.fft.rfft(command, axis=0)[:lines] / len(command)
    own = np.asarray(torque)[0]
    axis = int(np.argmax(np.sum(np.abs(own) ** 2, axis=0)))
    if effect.joint != "":
        axis = axis_of(scene.robot, effect.joint)
    course = lambda line: np.fft.irfft(line, n=_SAMPLES) * _SAMPLES
    frequency = np.arange(lines) * scene.fs / scene.period
    some = np.round(np.arange(_SAMPLES) * scene.period / _SAMPLES).astype(int)
    pick = lambda x: np.asarray(x)[0, some, axis]
    angle = pick(scene.angle)
    signals = {
        "motor speed (rad/s)": pick(scene.speed),
        "motor acceleration (rad/s²)": pick(scene.acceleration),
        "arm angle (rad)": angle / scene.gear[axis],
        "within a motor turn (rad)": np.mod(angle, 2 * np.pi),
        "load on the motor (N m)": pick(scene.load),
        "torque command (N m)": course(base[:, axis]),
        "rate of the command (N m/s)": course(2j * np.pi * frequency * base[:, axis]),
    }
    return Fingerprint(effect, axis, frequency, own[:, axis], base[:, axis], course(own[:, axis]), signals)


def fingerprints(prints: Sequence[Fingerprint], names: Sequence[str], *, columns: int = 2):
    """A card for every effect: its equation, what it does to data and what looks like it; its spectrum over that of the
    motor's whole torque (grey; rms within 1 Hz); its course against the motor's speed and against the other signal that
    tells most of it, with the part of its variance that each tells.

    **Arguments:** `names`: of the robot's axes.

    **Returns:** the figure and its axes, (card, 3).
    """
    rows = -(-len(prints) // columns)
    wide = _TEXT + 3 * _PANEL + 2 * _BETWEEN + _GUTTER
    figure = _style.new_figure(columns * wide + 0.1, rows * _CARD + _HEAD)
    colours = families()
    _key(figure, colours)
    axes = np.empty((len(prints), 3), object)
    for k, this in enumerate(prints):
        left, top = 0.1 + (k // rows) * wide, figure.get_figheight() - _HEAD - (k % rows) * _CARD
        colour = colours.get(family(type(this.effect)), _OTHER)
        _text(figure, this, names, left, top, colour)
        for n in range(3):
            at = left + _TEXT + n * (_PANEL + _BETWEEN)
            axes[k, n] = _style.add_axes(figure, at, top - _CARD + 0.42, _PANEL, _CARD - 0.66)
        speed, *others = this.signals
        _spectrum(axes[k, 0], this, colour)
        _course(axes[k, 1], this, speed, colour)
        _course(axes[k, 2], this, max(others, key=this.share), colour)
    return figure, axes


def family(kind: type[AbstractEffect]) -> str:
    """What an effect belongs to: the module that it stands in, e.g. friction."""
    return kind.__module__.rpartition(".")[2]


def families() -> dict[str, str]:
    """The families of the library in its order, and the colour of each; colours come again where there are too few."""
    names = dict.fromkeys(family(kind) for kind in library().values())
    return dict(zip(names, itertools.cycle(_COLOURS), strict=False))


def _key(figure, colours: dict[str, str]) -> None:
    """Names of the families in their colours, and what the grey is."""
    across, up = figure.get_size_inches()
    left = 0.1
    for name, colour in (*colours.items(), ("the motor's whole torque", "#8A929B")):
        text = f"\u25a0 {name}"
        figure.text(left / across, 1 - 0.08 / up, text, color=colour, fontsize=_style.NORMAL, va="top")
        left += 0.085 * len(text) + 0.15


def _text(figure, this: Fingerprint, names: Sequence[str], left: float, top: float, colour: str) -> None:
    """The words of a card, left of its pictures, behind a bar in the colour of its family."""
    across, up = figure.get_size_inches()
    line = require("matplotlib.lines", "plot").Line2D
    bar = [(top - 0.06) / up, (top - _CARD + 0.14) / up]
    figure.add_artist(line([left / across] * 2, bar, color=colour, lw=3, solid_capstyle="butt"))
    left += 0.09
    effect = this.effect
    title = f"{effect.name.replace('_', ' ')}, {names[this.axis]}"
    figure.text(left / across, (top - 0.05) / up, title, fontsize=_style.NORMAL, fontweight="bold", va="top")
    top -= 0.23
    alike = "; ".join(x.replace("_", " ") for x in effect.confusable)
    told = [
        (equation(effect), "black", "italic", 4),
        (effect.signature, colour, "normal", 3),
        (f"like: {alike}" if alike else "", _SOFT, "normal", 2),
    ]
    for text, own, style, most in told:
        rows = textwrap.wrap(text, _WRAP, max_lines=most, placeholder=" ...")
        place = {"fontsize": _style.SMALL - 0.5, "va": "top", "linespacing": 1.15}
        figure.text(left / across, top / up, "\n".join(rows), color=own, fontstyle=style, **place)
        top -= 0.122 * len(rows) + 0.03


def _spectrum(axis, this: Fingerprint, colour: str) -> None:
    step = float(this.frequency[1])
    base, more = (_smooth(x[1:], step) for x in (this.base, this.more))
    frequency = this.frequency[1:]
    top = 3.0 * max(float(base.max()), float(more.max()))
    low = top * 10.0**-_DECADES
    axis.fill_between(frequency, low, base, color=_BASE, lw=0)
    axis.plot(frequency, np.maximum(more, low), color=colour, lw=1.1)
    axis.set(yscale="log", ylim=(low, top), xlim=(0, frequency[-1]))
    _style.dress(axis)
    ticker = require("matplotlib.ticker", "plot")
    axis.yaxis.set_major_locator(ticker.LogLocator(numticks=4))
    axis.yaxis.set_minor_locator(ticker.NullLocator())
    axis.set_xlabel("frequency (Hz)", fontsize=_style.SMALL - 1, labelpad=1)
    axis.set_title("N m", fontsize=_style.SMALL - 1, loc="left", pad=2, color=_SOFT)


def _smooth(lines, step: float):
    """rms of the lines within 1 Hz."""
    count = max(1, round(_AROUND / step))
    return np.sqrt(np.maximum(scipy.ndimage.uniform_filter1d(np.abs(lines) ** 2, count, mode="nearest"), 0.0))


def _course(axis, this: Fingerprint, signal: str, colour: str) -> None:
    x, y = this.signals[signal], this.course
    at, mean, _ = _binned(x, y)
    axis.axhline(0, color="#888888", lw=0.5)
    axis.plot(x[::2], y[::2], ".", ms=1.1, color="#AEB4BB", mew=0, rasterized=True)
    share = this.share(signal)
    axis.plot(at, mean, color=colour, lw=1.5, alpha=1.0 if share >= _FAINT or this.constant else 0.4)
    low, high = np.quantile(y, [0.002, 0.998])
    reach = max(high - min(low, 0.0), max(high, 0.0) - low) or 1.0
    axis.set_ylim(min(low, 0.0) - 0.08 * reach, max(high, 0.0) + 0.08 * reach)
    _style.dress(axis)
    ticker = require("matplotlib.ticker", "plot")
    axis.xaxis.set_major_locator(ticker.MaxNLocator(3))
    axis.yaxis.set_major_locator(ticker.MaxNLocator(3))
    axis.set_xlabel(signal, fontsize=_style.SMALL - 1, labelpad=1)
    axis.set_title("N m", fontsize=_style.SMALL - 1, loc="left", pad=2, color=_SOFT)
    told = "constant" if this.constant else f"{100 * share:.0f} %"
    axis.set_title(told, fontsize=_style.SMALL - 1, loc="right", pad=2, color=_SOFT)


def _binned(x, y):
    """Means of x and y in bins of equally many samples, and the bin of every sample."""
    edges = np.quantile(x, np.linspace(0, 1, _BINS + 1))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    number = np.maximum(np.bincount(place, minlength=_BINS), 1)
    return *(np.bincount(place, v, _BINS) / number for v in (x, y)), place
