"""The verb of this package: a gray-box model and FRFs to parameters."""

import dataclasses
import numbers
from collections.abc import Callable, Iterable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Float, PRNGKeyArray, PyTree

from .._arguments import as_key, expect, expect_callable, expect_probability, expect_whole, said
from .._errors import input_error
from .._threads import one_blas_thread
from .._types import require_x64
from ..frf import FRF
from .cost import Cost, check_quantity, check_shape
from .model import AbstractModel, Model, RobotModel, fix
from .parameter import Coordinates, matching
from .solver import AbstractSolver, LevenbergMarquardt, Minimisation, check_solver, descents
from .target import Target, Weights, select, target
from .uncertainty import Uncertainty, products, uncertainty, without_sensitivity

_COARSE = 28  # lines that the search for the valley needs at least
_PLACES = 200  # and lines of all positions together
_NEAR = 1e-3  # where it ends, in x
_LARGE = 300_000  # numbers to fit, of all starts: below, all lines cost less than compiling the search apart
_SAME = 0.02  # two ends nearer than this, in x, are the same minimum
_CLOSE = 1.01  # times the best cost
_AGREE = 3  # starts that should come that close
_MUCH = 3.0  # times what the uncertainty explains: noise and a little bias are not enough
_LOST, _ANOTHER = 50.0, 0.3  # of the same, and rms of ln G (2.6 dB, 17 degrees): nothing of it is believed

ELSEWHERE = (
    "is the machine nonlinear? `jaxfrf distortion` tells it from noise; springs that harden, friction and play beside "
    "a model of your own: `jaxfrf.machine` (`rank_effects`; howto/machine.md in the book)"
)

Progress = Callable[[int, int], None]


class Start(eqx.Module):
    """One start of a fit.

    **Fields:** `x`: where it ended, (parameter,). `cost`: there, all lines. `path_x`, `path_cost`: every step, the
    start first; the search uses a part of the lines, whose cost `path_cost` is, scaled to all of them. `polished`:
    whether it was followed to the end with all lines; others were left in their valley (`x` of the search).
    `converged`: whether the solver ended by itself, not at its last step.
    """

    x: Float[np.ndarray, "parameter"]
    cost: float
    path_x: Float[np.ndarray, "step parameter"]
    path_cost: Float[np.ndarray, "step"]
    polished: bool = eqx.field(static=True)
    converged: bool = eqx.field(static=True)


class Fit(eqx.Module):
    """The parameters of a gray-box model, and what is known about them.

    **Fields:** `model`: with its parameters at the result. `coordinates`: of `x`. `x`: the result, (parameter,).
    `uncertainty`: see there. `starts`: every start, in the order in which they were made. `target`: what was fitted.
    `without_sensitivity`: parameters that did not change the response and were left at their start.
    """

    model: AbstractModel
    coordinates: Coordinates
    x: Float[np.ndarray, "parameter"]
    uncertainty: Uncertainty
    starts: tuple[Start, ...]
    target: Target
    without_sensitivity: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def values(self) -> dict[str, float]:
        """Every parameter of the model, fixed ones included."""
        return {name: float(v) for name, v in self.coordinates.values(self.x).items()}

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of the fitted parameters, in their units."""
        return scaled(self.coordinates, self.x, self.uncertainty.std)

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Confidence interval of every fitted parameter; of a positive one symmetric in its logarithm. `level`: between
        0 and 1, or `jaxfrf.InputError`."""
        from scipy.stats import norm

        expect_probability("level", level)
        reach = float(norm.ppf(0.5 + level / 2)) * self.uncertainty.std
        low, high = (self.coordinates.values(self.x + sign * reach) for sign in (-1, 1))
        return {n: (float(low[n]), float(high[n])) for n in self.coordinates.names}

    def _is_lost(self) -> bool:
        """Whether the response is another one than the measured: not a model that lacks a little beside small noise."""
        if self.uncertainty.misfit < _LOST**2:
            return False
        errors = np.asarray(Cost(self.model, self.coordinates, self.target).errors(jnp.asarray(self.x))[0])
        return bool(np.sqrt(np.mean(np.abs(errors[np.asarray(self.target.used)]) ** 2)) > _ANOTHER)

    def _is_high(self, name: str) -> bool:
        """Whether a parameter at a bound is at its upper one."""
        low, high = (float(x) for x in self.model.parameters[name].limits)
        value = float(self.values[name])
        return high - value < value - low if low < 0 else value > np.sqrt(max(low, 1e-300) * high)

    @property
    def cost(self) -> float:
        return self.uncertainty.cost

    @property
    def close_starts(self) -> int:
        """Starts whose cost came within 1 % of the best."""
        best = min(s.cost for s in self.starts)
        return sum(s.cost <= _CLOSE * best + _tiny(self.target) for s in self.starts)

    @property
    def verdict(self) -> str:
        """`unimodal`, `multimodal`, `at a bound` or `not identifiable`: the most serious that holds."""
        wanted = self.coordinates.wanted()
        held = np.isin(self.coordinates.names, self.coordinates.at_bound(self.x))
        if not self.uncertainty.identifiable[wanted & ~held].all() or self.without_sensitivity:
            return "not identifiable"
        if np.any(held & wanted):
            return "at a bound"
        return "unimodal" if self.close_starts >= min(_AGREE, len(self.starts)) else "multimodal"

    def explain(self) -> list[str]:
        """The verdict in words, the most important first."""
        names, said = np.array(self.coordinates.names), []
        if self._is_lost():
            said.append(
                f"no start came near: the best leaves {np.sqrt(self.uncertainty.misfit):.0f} times what the FRF's "
                "uncertainty explains, and what follows is of a wrong place: begin elsewhere, or the model is another"
            )
        for name in self.without_sensitivity:
            said.append(f"{name} has no effect on the response: it was left at its start")
        held = self.coordinates.at_bound(self.x)
        for name in names[~self.uncertainty.identifiable & ~np.isin(names, held)]:
            said.append(f"{name} is not identifiable from these data (standard deviation above 50 %)")
        said += self.uncertainty.directions(without=held)
        for name in held:
            short = name.rpartition(".")[2]
            wish = f"more {short} than it may have" if self._is_high(name) else f"no {short}"
            said.append(f"{name} is at its bound: the data ask for {wish}, or the model is wrong")
        n, close = len(self.starts), self.close_starts
        if n > 1 and close >= min(_AGREE, n):
            said.append(f"{close} of {n} starts ended within 1 % of the best cost: one minimum")
        elif n > 1:
            said.append(
                f"only {close} of {n} starts ended within 1 % of the best cost: more starts, or a better first guess, "
                "may find a better minimum"
            )
        for (a, b), rho in self.uncertainty.correlations().items():
            said.append(f"{a} and {b} are correlated ({rho:+.2f}): only a combination of them is well known")
        if self.uncertainty.misfit > 2:
            said.append(
                f"residuals are {np.sqrt(self.uncertainty.misfit):.1f} times what the FRF's uncertainty explains: the "
                "model lacks something, or the FRF is biased; intervals are widened by that factor"
            )
        if self.uncertainty.misfit > _MUCH**2 and not isinstance(self.model, RobotModel):
            said.append(ELSEWHERE)
        return said


def scaled(coordinates: Coordinates, x, std) -> dict[str, float]:
    """Standard deviations in the units of the parameters from those in x."""
    slope = jax.jacfwd(coordinates.values)(jnp.asarray(x))
    return {n: float(abs(slope[n][i]) * std[i]) for i, n in enumerate(coordinates.names)}


def _tiny(tg: Target) -> float:
    return 1e-16 * float(np.sum(np.square(tg.magnitude)))


@one_blas_thread
def fit(
    model: AbstractModel,
    frf: FRF,
    *,
    weights: Weights | None = None,
    solver: AbstractSolver | None = None,
    starts: int | Sequence[Mapping[str, float]] = 20,
    key: PRNGKeyArray | None = None,
    points: PyTree | None = None,
    keep: int | None = 5,
    progress: Progress | None = None,
) -> Fit:
    """Fit the parameters of a gray-box model to frequency response functions.

    Minimises the weighted logarithmic cost from several starts: every start descends on a part of the lines, ends that
    are the same minimum are merged, and the `keep` best are followed to the end with all lines.

    Biased where the FRF is: a local estimator smooths sharp resonances (damping comes out too high), friction and
    nonlinear springs change the response with the amplitude. `fit_indirectly` takes that out.

    **Arguments:**

    - `model`: e.g. `jaxfrf.RobotModel(robot)`, `jaxfrf.GrayBox(my_module, {"k": 1e5, "d": 10.0})`.
    - `frf`: from `jaxfrf.estimate`; all its operating points are fitted together.
    - `weights`: `jaxfrf.Weights()` by default. `solver`: `jaxfrf.LevenbergMarquardt()`, or `jaxfrf.BFGS()`.
    - `starts`: how many; the first is the model's own, the others are drawn about it (`Parameter.spread`) with `key`
      (default key 0). Or the starts themselves, as dictionaries of values.
    - `points`: operating points, leading axis (pos); from the arm configurations q by default.
    - `keep`: minima that are followed to the end; `None`: every start, by itself.
    - `progress`: called with (descents done, of how many).

    **Returns:** a `Fit`: values in the units of the parameters, their covariance, every start.

    **Raises:** `jaxfrf.InputError` if FRF, model and weights do not fit together, a model of your own is not written in
    `jax.numpy` or asks for other parameters, or no start gives a finite cost; `ValueError` if JAX is set to 32 bit.

    **Source:** Zimmermann & Moberg, section III.B (the logarithmic cost, random starts); sandwich covariance: Huber,
    Proc. Fifth Berkeley Symposium 1 (1967) 221-233. The choice among starts is this project's own.
    """
    expect("model", model, AbstractModel)
    expect("frf", frf, FRF)
    require_x64("fit")
    expect_callable("progress", progress)
    if keep is not None:
        expect_whole("keep", keep)
    solver = LevenbergMarquardt() if solver is None else solver
    check_solver(solver)
    check_quantity(model, frf)
    points = model.points(frf.q, frf.n_pos) if points is None else points
    tg = target(frf, Weights() if weights is None else weights, points)
    coordinates = Coordinates(model.parameters)
    check_shape(model, coordinates, tg, frf)
    return fit_target(model, tg, solver, starts, key, keep, progress)


def fit_target(
    model: AbstractModel,
    tg: Target,
    solver: AbstractSolver,
    starts: int | Sequence[Mapping[str, float]] = 1,
    key: PRNGKeyArray | None = None,
    keep: int | None = 5,
    progress: Progress | None = None,
) -> Fit:
    """`fit` for a target that is already made."""
    model, blind = _without_blind(model, tg)
    coordinates = Coordinates(model.parameters)
    begin = _starts(coordinates, starts, as_key("key", 0 if key is None else key))
    part, share = _coarse(tg, len(begin))
    whole, coarse = Cost(model, coordinates, tg), Cost(model, coordinates, part)
    total = len(begin) + (len(begin) if keep is None else min(keep, len(begin)))
    say = lambda done: None if progress is None else progress(done, total)
    ends = descents(coarse, begin, solver, max(_NEAR, solver.tolerance), say)
    made = [_searched(end, share) for end in ends]
    chosen = _chosen(made, keep)
    ends = descents(whole, [made[i].x for i in chosen], solver, progress=lambda done: say(len(begin) + done))
    for (i, members), end in zip(chosen.items(), ends, strict=True):
        for member in members:
            made[member] = _polished(made[member], end, alone=member == i)
    say(total)
    made = [_left(whole, start) for start in made]
    best = min(made, key=lambda s: s.cost)
    if not np.isfinite(best.cost):
        raise input_error("fit", "no start with a finite cost", "a model that is finite at its start", "Check it.")
    known = uncertainty(model, coordinates, tg, best.x)
    return Fit(model, coordinates, best.x, known, tuple(made), tg, blind)


def _without_blind(model: Model, tg: Target) -> tuple[Model, tuple[str, ...]]:
    """The model with parameters that do not change the response fixed, and their names."""
    coordinates = Coordinates(model.parameters)
    errors, slopes = Cost(model, coordinates, tg).errors(jnp.asarray(coordinates.start()))
    full = products(tg, np.asarray(errors), np.asarray(slopes))
    if not np.isfinite(full).all():
        raise input_error(
            "model", "a response that is not finite at its start", "finite numbers", "Correct the start values."
        )
    blind = without_sensitivity(coordinates, full[:-1, :-1])
    if len(blind) == coordinates.size:
        raise input_error("parameters", "none that changes the response", "at least one that does", "Free others.")
    return (fix(model, blind) if blind else model), blind


def _starts(coordinates: Coordinates, starts, key) -> list[np.ndarray]:
    if not isinstance(starts, numbers.Real):
        return _named_starts(coordinates, starts)
    expect_whole("starts", starts, 1)
    first = coordinates.start()
    draws = np.array(jr.normal(key, (int(float(starts)), coordinates.size)))
    draws[0] = 0.0
    return [coordinates.inside(first + coordinates.spreads() * draw) for draw in draws]


def _named_starts(coordinates: Coordinates, starts) -> list[np.ndarray]:
    listed = isinstance(starts, Iterable) and not isinstance(starts, str)
    given, starts = starts, [starts] if isinstance(starts, Mapping) else list(starts) if listed else []
    if not starts or not all(isinstance(values, Mapping) for values in starts):
        wrong = next((v for v in starts if not isinstance(v, Mapping)), None)
        raise input_error(
            "starts",
            said(given) if not listed else "an empty list" if not starts else f"a list with {said(wrong)}",
            "a number, or dictionaries of values by name",
            "Give at least one; {} is the model's own start.",
        )
    for values in starts:
        matching(coordinates.parameters, values)  # says which name is wrong
        bad = {n: v for n, v in values.items() if n in coordinates.names and not coordinates.parameters[n].accepts(v)}
        if bad:
            raise input_error(
                "starts",
                ", ".join(f"{n} = {v}" for n, v in bad.items()),
                "values that the parameter may have",
                "Correct them.",
            )
    return [coordinates.coordinates(values) for values in starts]


def _coarse(tg: Target, starts: int) -> tuple[Target, float]:
    """Part of the lines, and how many times more all of them weigh."""
    enough = max(_COARSE, _PLACES // tg.n_pos)
    step = max(1, len(tg.frequency) // enough) if starts * tg.n_terms > _LARGE else 1
    part = select(tg, lines=np.arange(0, len(tg.frequency), step)) if step > 1 else tg
    return part, float(np.sum(np.square(tg.magnitude)) / max(np.sum(np.square(part.magnitude)), 1e-300))


def _searched(end: Minimisation, share: float) -> Start:
    cost = end.cost * share
    known = np.isfinite(cost) and np.isfinite(end.x).all()
    return Start(end.x, cost if known else np.inf, end.path_x, end.path_cost * share, False, end.converged)


def _left(whole: Cost, start: Start) -> Start:
    """A start that was not followed to the end, with its cost over all lines."""
    if start.polished or not np.isfinite(start.cost):
        return start
    cost = float(whole(jnp.asarray(start.x)))
    return dataclasses.replace(start, cost=cost if np.isfinite(cost) else np.inf)


def _chosen(made: list[Start], keep: int | None) -> dict[int, list[int]]:
    """Starts to follow to the end, and the starts whose end is the same minimum."""
    order = [i for i in np.argsort([s.cost for s in made]) if np.isfinite(made[i].cost)]
    if keep is None:
        return {i: [i] for i in order}
    groups: dict[int, list[int]] = {}
    for i in order:
        near = next((k for k in groups if np.abs(made[k].x - made[i].x).max() < _SAME), None)
        if near is not None:
            groups[near].append(i)
        elif len(groups) < keep:
            groups[i] = [i]
    return groups


def _polished(start: Start, end: Minimisation, alone: bool) -> Start:
    path = end.path_x[1:] if alone else end.x[None]
    cost = end.path_cost[1:] if alone else [end.cost]
    return dataclasses.replace(
        start,
        x=end.x,
        cost=end.cost,
        path_x=np.concatenate([start.path_x, path]),
        path_cost=np.concatenate([start.path_cost, cost]),
        polished=True,
        converged=end.converged,
    )
