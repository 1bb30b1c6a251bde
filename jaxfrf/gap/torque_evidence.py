"""Records against a robot whose parameters and effects are free: residual, slopes, least squares, held-out error."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..robot import Robot, parameters, with_parameters
from ..trajectory.rigid_motion import Motion, thinned
from .torque_candidates import Candidate
from .torque_floor import unpredictable
from .torque_model import added_torque, needed_torque, torque_slopes
from .torque_score import block_length, numbered

_STRETCHES = 8  # at least, that selection holds out in turn


class State(eqx.Module):
    """A robot, values of its own parameters, and effects with values of theirs."""

    given: Robot
    own: dict[str, float]
    chosen: tuple[tuple[Candidate, tuple[float, ...]], ...]

    def robot(self) -> Robot:
        effects = [candidate.make(values) for candidate, values in self.chosen]
        return with_parameters(self.given, self.own).with_effects(*effects)

    def moved(self, step) -> "State":
        """The state with all free values changed by `step`, own parameters first."""
        step, own = list(step), {}
        for name, value in self.own.items():
            own[name] = value + float(step.pop(0))
        chosen = tuple((c, tuple(v + float(step.pop(0)) for v in values)) for c, values in self.chosen)
        return State(self.given, own, chosen)

    def having(self, candidate: Candidate, values) -> "State":
        return State(self.given, self.own, (*self.chosen, (candidate, tuple(float(v) for v in values))))

    def with_value(self, place: int, i: int, value: float) -> "State":
        candidate, values = self.chosen[place]
        changed = (candidate, (*values[:i], value, *values[i + 1 :]))
        return State(self.given, self.own, (*self.chosen[:place], changed, *self.chosen[place + 1 :]))

    def without(self, i: int) -> "State":
        return State(self.given, self.own, self.chosen[:i] + self.chosen[i + 1 :])


class Evidence(eqx.Module):
    """Records as rows: torques over the rms torque of their axis, thinned; every row belongs to a stretch."""

    motions: tuple[Motion, ...]
    size: Float[np.ndarray, "axis"]
    torque: Float[np.ndarray, "row axis"]
    feature: Float[np.ndarray, "row feature"]
    stretch: np.ndarray

    def rows(self, torques) -> Float[np.ndarray, "row"]:
        """One vector of all records and axes from torques (time, axis) of every record."""
        thin = [thinned(m, x) for m, x in zip(self.motions, torques, strict=True)]
        return (np.concatenate(thin) / self.size).ravel()

    def residual(self, state: State) -> Float[np.ndarray, "row"]:
        robot = state.robot()
        return self.torque.ravel() - self.needed(robot)

    def needed(self, robot: Robot) -> Float[np.ndarray, "row"]:
        return self.rows([needed_torque(robot, m) for m in self.motions])

    def columns(self, robot: Robot, candidate: Candidate, needed) -> Float[np.ndarray, "row free"]:
        """What a candidate adds to the torque that the robot needs of every record, per unit of its free values."""
        columns = []
        for parts in candidate.directions():
            more = lambda m, x, parts=parts: sum(f * added_torque(robot, e, m, x) for e, f in parts)
            columns.append(self.rows([more(m, x) for m, x in zip(self.motions, needed, strict=True)]))
        return np.stack(columns, axis=1)

    def slopes(self, state: State) -> Float[np.ndarray, "row free"]:
        """d(needed torque)/d(free value), own parameters first."""
        robot, names = state.robot(), tuple(state.own)
        # Effects on the robot's own numbers move them: slopes at the numbers that they have come to.
        now = parameters(robot, {n.rpartition(".")[2] for n in names})
        each = [torque_slopes(robot, names, now, m) for m in self.motions] if names else []
        columns = [self.rows([x[i] for x in each]) for i in range(len(names))]
        rest = self.needed(robot)
        for place, (_, values) in enumerate(state.chosen):
            for i, value in enumerate(values):
                step = 1e-4 * abs(value) or 1e-6
                moved = state.with_value(place, i, value + step).robot()
                columns.append((self.needed(moved) - rest) / step)
        return np.stack(columns, axis=1) if columns else np.zeros((self.torque.size, 0))

    def refitted(self, state: State) -> "Fitted":
        """All free values by least squares (Gauss-Newton; the torque is linear in nearly all of them)."""
        for _ in range(4):
            S, r = self.slopes(state), self.residual(state)
            size = np.maximum(np.linalg.norm(S, axis=0), 1e-300)
            step = np.linalg.lstsq(S / size, r, rcond=1e-10)[0]
            if np.linalg.norm(step) < 1e-9 * np.linalg.norm(r):
                break
            state = state.moved(step / size)
        return Fitted(state, r, S, cross_validated(S, r, self.of_rows()))

    def blocks(self, r) -> np.ndarray:
        shaped = np.split(r.reshape(self.torque.shape), np.cumsum(self.lengths())[:-1])
        return numbered(self.lengths(), block_length(shaped), self.torque.shape[1])

    def lengths(self) -> list[int]:
        return [len(thinned(m, m.torque)) for m in self.motions]

    def of_rows(self):
        return np.repeat(self.stretch, self.torque.shape[1])

    def floor(self, r) -> float:
        """Rms of what no function of the motion explains of the residual."""
        return float(np.sqrt(np.mean(unpredictable(r.reshape(self.torque.shape), self.feature, self.stretch) ** 2)))


class Fitted(eqx.Module):
    """A state fitted to the evidence: its `residual` and `slopes`, and mean squares on stretches held out in turn."""

    state: State
    residual: Float[np.ndarray, "row"]
    slopes: Float[np.ndarray, "row free"]
    squares: Float[np.ndarray, "stretch"]

    @property
    def held_out(self) -> float:
        """Rms of the residual on stretches that the fit did not see."""
        return float(np.sqrt(np.mean(self.squares)))


def gathered(motions: tuple[Motion, ...]) -> Evidence:
    torque = np.concatenate([thinned(m, m.torque) for m in motions])
    size = np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-300)
    fastest = np.max([np.max(np.abs(m.speed), axis=0) for m in motions], axis=0)
    feature = [
        thinned(m, np.concatenate([m.angle, m.speed, np.tanh(m.speed / (0.02 * fastest)), m.acceleration], axis=1))
        for m in motions
    ]
    each, stretch = max(-(-_STRETCHES // len(motions)), 1), []
    for i, x in enumerate(feature):
        stretch.append(i * each + np.arange(len(x)) * each // len(x))
    return Evidence(motions, size, torque / size, np.concatenate(feature), np.concatenate(stretch))


def cross_validated(X, r, stretch) -> Float[np.ndarray, "stretch"]:
    """Mean square on every stretch of the residual of least squares on the others."""
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    X, found = X / size, []
    parts = [(X[stretch == k], r[stretch == k]) for k in np.unique(stretch)]
    G, b = (sum(x.T @ y for x, y in pairs) for pairs in ([(x, x) for x, _ in parts], parts))
    for x, y in parts:
        theta = np.linalg.lstsq(G - x.T @ x, b - x.T @ y, rcond=1e-12)[0] if X.shape[1] else np.zeros(0)
        found.append(np.mean((y - x @ theta) ** 2))
    return np.array(found)
