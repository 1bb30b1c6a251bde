"""What a record says against a robot: the torque that its motors gave beyond what the robot asks of them."""

import itertools
from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
import scipy.ndimage
from jaxtyping import Complex, Float

from .._threads import shared
from ..robot import Robot
from ..simulation.runs import Progress
from .following import moved, torque_rate, unknown_friction
from .frozen import frozen
from .measured import Measured, mean_period
from .scene import Scene

# Of the torque around a line: what two simulators of the same robot differ by, slow motion and resonances.
_SLOW_MISMATCH, _MISMATCH = 0.004, 0.02
_CORNERS = (1.5, 4.0)  # Hz, between the two
_AROUND = 20  # lines
_BANDS = np.array([0.0, 1.5, 4.0, 8.0, 14.0, 22.0, 32.0, 45.0, 60.0])  # Hz
_WIDER = 1.4  # from each of the bands beyond to the next
_FEW, _STAND_INS = 4, 8  # runs whose scatter says too little: so many bands of lines stand for each of them


class Evidence:
    """A robot simulated through the experiment, and the residual of the record, referred to the motors' commands.

    **Arguments:** `robot`: with a controller, or without: its motors then move as they were measured. `record`: of
    `measured`. `steps`, `progress`: as of `jaxfrf.simulate`.

    **Fields:** `residual`: measured less simulated torque, less what the robot asks for the difference in motion, (pos,
    exp, line, axis), N m. `floor`: rms of what noise and an honest model leave of it, (line, axis), N m. `scenes`: one
    for each position. `U`, `Y`: of the simulation.
    """

    def __init__(self, robot: Robot, record: Measured, steps: int | None = None, progress: Progress | None = None):
        self.robot = robot
        self.U, self.Y = np.zeros_like(record.U), np.zeros_like(record.Y)
        self.residual = np.zeros_like(record.U)
        scenes: dict[int, Scene] = {}
        for payload, here in record.by_payload():
            carrying = robot if payload is None else robot.with_effects(payload)
            self._simulate(carrying, record.at(here), here, scenes, steps, progress)
        self.scenes = [scenes[p] for p in range(record.data.n_pos)]
        unknown = unknown_friction(robot, record.data, record.Y)
        self.noise = np.hypot(_noise([s.still for s in self.scenes], record.noise), unknown)
        self.plain = self.floor = _floor(self.U, self.noise, record.frequency)

    def _simulate(self, robot: Robot, record: Measured, here, scenes, steps, progress) -> None:
        """The positions `here`, of which `record` is."""
        data, count = record.data, len(record.frequency)
        motion = moved(robot, data, record.frequency[-1], steps, progress)
        stills = frozen(robot, motion, data.q, record.frequency, torque_rate(robot, data))
        U, Y = (_lines(x, count) for x in (motion.u, motion.y))
        Y[..., 0, :] = 0.0
        self.U[here], self.Y[here] = U, Y
        seen = data.y_quantity == "position"
        for p, (at, s) in enumerate(zip(here, stills, strict=True)):
            moving = np.einsum("lab,elb->ela", s.impedance, record.Y[p] - Y[p])
            self.residual[at] = record.U[p] - U[p] - moving / s.command
            reading = mean_period(data, p, data.y) if seen else None
            scenes[int(at)] = Scene(robot, motion, p, s, mean_period(data, p), reading)

    def forget(self) -> None:
        """Free the signals of the scenes but the motion, of which they are made again: they are most of the memory."""
        for scene in self.scenes:
            scene.forget()


def _lines(x, count):
    return np.stack([np.fft.rfft(run, axis=1)[:, :count] / run.shape[1] for run in x])


def _noise(stills, noise) -> Float[np.ndarray, "line axis"]:
    """rms of the noise of the measured positions in the residual."""
    power = [np.einsum("lab,lb->la", np.abs(s.impedance / s.command[:, :, None]) ** 2, noise**2) for s in stills]
    return np.sqrt(np.mean(power, axis=0))


def _floor(U, noise, frequency):
    around = np.mean(np.abs(U) ** 2, axis=(0, 1))
    smooth = scipy.ndimage.uniform_filter1d(around[1:], _AROUND, axis=0, mode="nearest")
    around[1:] = smooth
    around[0] = np.maximum(around[0], smooth[0])
    mismatch = np.exp(np.interp(frequency, _CORNERS, np.log([_SLOW_MISMATCH, _MISMATCH])))
    return np.sqrt(noise**2 + mismatch[:, None] ** 2 * around)


def band_edges(frequency) -> Float[np.ndarray, "edge"]:
    """Of the bands in which a residual is looked at, Hz; those of each hold a line."""
    more = np.arange(1, max(0.0, np.log(frequency[-1] / _BANDS[-1])) / np.log(_WIDER) + 1)
    bands = np.concatenate([_BANDS, _BANDS[-1] * _WIDER**more])
    bands = bands[bands < frequency[-1]]
    first = np.unique(np.searchsorted(bands, frequency, side="right") - 1)
    return np.append(bands[first], frequency[-1])


def by_band(left, floor, frequency) -> Float[np.ndarray, "pos exp axis band"]:
    """Mean square over the floor in every band, 1 where real and imaginary parts are at their floor."""
    edges = band_edges(frequency)
    first = np.searchsorted(frequency, edges[:-1])
    power = np.add.reduceat(0.5 * np.abs(left / floor) ** 2, first, axis=2)
    count = np.diff(np.append(first, len(frequency)))
    return np.swapaxes(power / count[:, None], 2, 3)


class Gram(eqx.Module):
    """Products of weighted columns and residual, run by run: all that least squares needs.

    **Fields:** `A`: (run, column, column). `b`: (run, column). `rr`: (run,). `position`: of each run, (run,). `count`:
    real numbers in a run.
    """

    A: Float[np.ndarray, "run column column"]
    b: Float[np.ndarray, "run column"]
    rr: Float[np.ndarray, "run"]
    position: np.ndarray
    count: int = eqx.field(static=True)


Column = Callable[[Scene], Complex[np.ndarray, "exp line axis"]]


class Weighed(eqx.Module):
    """Columns and residual over the floor, position by position, and their products.

    **Fields:** `parts`: (exp, column, number) for each position, the residual last. `gram`: products of every run.
    """

    parts: tuple[np.ndarray, ...]
    gram: Gram


def weigh(evidence: Evidence, columns: Sequence[Column], base: Weighed | None = None) -> Weighed:
    """Weighted columns beside those of `base`, whose products run by run are not made again.

    **Arguments:** `evidence`: whose floor weighs. `columns`: each gives what a number adds to the torque of a scene,
    (exp, line, axis), N m per unit of the number. `base`: of the same evidence.

    **Returns:** `Weighed`: columns, residual and their products, without unit.

    **Source:** the normal equations of weighted least squares.
    """
    if base is None:
        parts = tuple(shared(lambda pos: _rows(evidence, pos, columns, True), range(len(evidence.scenes))))
        return Weighed(parts, _gram(np.concatenate(shared(lambda X: _products(X, X), parts)), parts))
    new = _new_parts(evidence, columns)
    across, own = (
        np.concatenate(shared(lambda two: _products(*two), list(zip(left, new, strict=True))))
        for left in (base.parts, new)
    )
    g = base.gram
    A = np.block([[g.A, across[:, :-1]], [across[:, :-1].swapaxes(1, 2), own]])
    gram = Gram(A, np.concatenate([g.b, across[:, -1]], axis=1), g.rr, g.position, g.count)
    return Weighed(_between(base.parts, new), gram)


def parts_beside(evidence: Evidence, columns: Sequence[Column], parts) -> tuple[np.ndarray, ...]:
    """Weighted columns beside those of `parts`, without products."""
    return _between(parts, _new_parts(evidence, columns))


def _new_parts(evidence: Evidence, columns: Sequence[Column]) -> list[np.ndarray]:
    return shared(lambda pos: _rows(evidence, pos, columns, False), range(len(evidence.scenes)))


def _rows(evidence: Evidence, pos: int, columns: Sequence[Column], with_residual: bool):
    """Columns over the floor at one position, (exp, column, number)."""
    scene, weight = evidence.scenes[pos], 1.0 / evidence.floor
    given = [evidence.residual[pos]] if with_residual else []
    signatures = itertools.chain((column(scene) for column in columns), given)
    n_exp, count = len(evidence.residual[pos]), weight.size
    rows = np.empty((n_exp, len(columns) + len(given), 2 * count), np.float32)
    for row, z in enumerate(signatures):
        rows[:, row, :count] = (z.real * weight).reshape(n_exp, count)
        rows[:, row, count:] = (z.imag * weight).reshape(n_exp, count)
    return rows


def _between(parts, new) -> tuple[np.ndarray, ...]:
    """New columns behind the old ones, before the residual."""
    return tuple(np.concatenate([X[:, :-1], N, X[:, -1:]], axis=1) for X, N in zip(parts, new, strict=True))


def put_over_floor(parts, old, new) -> None:
    """Put columns over another floor, in their place: they are most of the memory."""
    factor = np.concatenate([(old / new).ravel()] * 2).astype(np.float32)
    for part in parts:
        part *= factor


def refloored(weighed: Weighed, old, new) -> Weighed:
    """The columns over another floor, in the place of those given, and their products."""
    parts = weighed.parts
    put_over_floor(parts, old, new)
    return Weighed(parts, _gram(np.concatenate(shared(lambda X: _products(X, X), parts)), parts))


def _products(X, Y):
    return (X @ Y.swapaxes(1, 2)).astype(float)


def _gram(every, parts) -> Gram:
    position = np.repeat(np.arange(len(parts)), [len(p) * (len(every) // sum(map(len, parts))) for p in parts])
    return Gram(every[:, :-1, :-1], every[:, :-1, -1], every[:, -1, -1], position, parts[0].shape[-1])


def precise(parts, bands: int = 1) -> Weighed:
    """Columns with their products in double precision: what a few directions of many columns are told by.

    `bands`: of lines that every run is cut into, each of which then counts as a run at a position of its own."""

    def one(X):
        halves = X.reshape(*X.shape[:2], 2, -1)
        cuts = np.array_split(np.arange(halves.shape[-1]), bands)
        wide = [halves[..., cut].reshape(*X.shape[:2], -1).astype(float) for cut in cuts]
        return np.stack([x @ x.swapaxes(1, 2) for x in wide], axis=1).reshape(-1, X.shape[1], X.shape[1])

    gram = _gram(np.concatenate(shared(one, parts)), parts)
    if bands > 1:
        position = np.arange(len(gram.A))
        gram = Gram(gram.A, gram.b, gram.rr, position, gram.count // bands)
    return Weighed(tuple(parts), gram)


def has_few_runs(parts) -> bool:
    """Whether there are too few runs to see how errors of the model scatter between them."""
    return sum(map(len, parts)) < _FEW


def scattered(parts, place: np.ndarray) -> Weighed:
    """Columns with their precise products as errors of the model scatter: between the runs of different places, or,
    where there are few runs, between bands of lines. `place`: of each position, (pos,)."""
    if has_few_runs(parts):
        return precise(parts, _STAND_INS)
    g = precise(parts).gram
    return Weighed(tuple(parts), Gram(g.A, g.b, g.rr, np.asarray(place)[g.position], g.count))
