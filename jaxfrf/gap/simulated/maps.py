"""Where model and measurement differ: by axis, band and position, and against speed, angle and load."""

from collections.abc import Sequence

import numpy as np
import scipy.fft
from jaxtyping import Int

from ...trajectory.evidence import band_edges, by_band
from ...trajectory.measured import Measured
from ..result import Cell, Maps
from ..settings import CELLS, EVERYWHERE, SOMEWHERE
from .judge import Written

_BINS = 24
_SAMPLES = 1024  # of a period, of a course


def maps_of(record: Measured, base: Written, extended: Written) -> Maps:
    """Of the residuals of both robots, on all positions."""
    frequency, floor = record.frequency, base.evidence.plain
    rms = lambda x: np.sqrt(np.mean(by_band(x.residual, floor, frequency), axis=1))
    before = rms(base)
    after = before if extended is base else rms(extended)
    return Maps(before, after, band_edges(frequency), _courses(base, extended))


def shown_samples(period: int) -> Int[np.ndarray, "sample"]:
    """Of a period: those that signals are shown at."""
    return np.arange(_SAMPLES) * period // _SAMPLES


def _courses(base: Written, extended: Written):
    scenes = base.evidence.scenes
    some = shown_samples(scenes[0].period)
    back = lambda X: scipy.fft.irfft(np.swapaxes(X, 1, 2), n=_SAMPLES, axis=2) * _SAMPLES
    signals: dict[str, list[np.ndarray]] = {"speed": [], "angle": [], "load": []}
    for scene in scenes:
        signals["speed"].append(scene.speed[:, some])
        signals["load"].append(scene.load[:, some])
        signals["angle"].append(scene.angle[:, some] / scene.gear)
    courses = [np.concatenate([np.moveaxis(back(x), 1, 2) for x in robot.residual]) for robot in (base, extended)]
    result = {}
    for name, signal in signals.items():
        x = np.concatenate(signal)
        rows = [_binned(x[..., a], [c[..., a] for c in courses]) for a in range(x.shape[-1])]
        result[name] = tuple(np.stack([row[i] for row in rows]) for i in range(3))
    return result


def _binned(x, courses):
    edges = np.quantile(x, np.linspace(0, 1, _BINS + 1))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    number = np.maximum(np.bincount(place.ravel(), minlength=_BINS), 1)
    mean = lambda y: np.bincount(place.ravel(), y.ravel(), _BINS) / number
    return mean(x), mean(courses[0]), mean(courses[1])


def largest_cells(names: Sequence[str], maps: Maps) -> tuple[Cell, ...]:
    """The largest cells, those that hold at all positions as one."""
    overall = np.median(maps.before, axis=0)
    everywhere = ", at all positions" if len(maps.before) > 1 else ""
    cells = []
    for axis, band in np.argwhere(overall > EVERYWHERE):
        edges, z = maps.bands[band : band + 2], float(overall[axis, band])
        cells.append(_cell(names[axis], edges, z, None, everywhere))
    for pos, axis, band in np.argwhere((maps.before > SOMEWHERE) & (maps.before > 2.0 * overall)):
        edges, z = maps.bands[band : band + 2], float(maps.before[pos, axis, band])
        cells.append(_cell(names[axis], edges, z, int(pos), f", at position {pos}"))
    return tuple(sorted(cells, key=lambda c: -c.z)[:CELLS])


def _cell(name: str, band, z: float, position: int | None, where: str) -> Cell:
    lo, hi = (float(x) for x in band)
    return Cell(position, name, (lo, hi), z, f"torque of {name}, {lo:g}-{hi:g} Hz{where}: {z:.3g} times the floor")
