"""Minimisers of the cost: optimistix, with every step kept."""

import abc
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array as JaxArray, Float, PyTree

from .._errors import input_error
from .._types import Array
from .cost import Cost

_TOGETHER = 4  # starts of one call
_GAIN = 3.0  # of the cost's root: damping starts at 1
_ROUNDING = 1e-15  # of the cost: less of it cannot be seen


class Minimisation(eqx.Module):
    """One minimisation.

    **Fields:** `x`: where it ended, (parameter,). `cost`: there. `steps`: taken. `converged`: whether it ended by
    itself. `path_x`, `path_cost`: x and cost after every step, the start first, (steps + 1, ...); refused steps repeat.
    """

    x: Float[np.ndarray, "parameter"]
    cost: float
    steps: int
    converged: bool
    path_x: Float[np.ndarray, "step parameter"]
    path_cost: Float[np.ndarray, "step"]


class AbstractSolver(eqx.Module):
    """How the cost is minimised. `tolerance`: a change of every parameter below it, in x, ends the search."""

    max_steps: eqx.AbstractVar[int]
    tolerance: eqx.AbstractVar[float]

    @abc.abstractmethod
    def minimiser(self, tolerance: Float[Array, ""]) -> optx.AbstractMinimiser:
        """The optimistix solver."""

    @abc.abstractmethod
    def function(self, cost: Cost, gain: Float[Array, ""]):
        """What it minimises, (x, args) -> (gain^2 times half the cost, aux)."""


class LevenbergMarquardt(AbstractSolver):
    """Levenberg-Marquardt with exact Jacobians, through `optimistix.minimise`.

    It ends where the next step is below `tolerance`, or promises less than the rounding of the cost.

    **Arguments:** `max_steps`: at most. `tolerance`: see `AbstractSolver`.

    Finds a local minimum, which depends on the start; `fit` makes several.

    **Source:** Levenberg, Quarterly of Applied Mathematics 2 (1944) 164-168; Marquardt, J. SIAM 11 (1963) 431-441;
    damping and trust region as optimistix has them, the end of the search is this project's own.
    """

    max_steps: int = eqx.field(static=True, default=80)
    tolerance: float = eqx.field(static=True, default=1e-10)

    def minimiser(self, tolerance):
        return _GaussNewton(tolerance)

    def function(self, cost, gain):
        def half(x, _):
            gram = jnp.square(gain) * cost.gram(x)
            return 0.5 * gram[-1, -1], (gram[-1, :-1], gram[:-1, :-1])

        return half


class BFGS(AbstractSolver):
    """The Broyden-Fletcher-Goldfarb-Shanno method, as the paper uses it (fminunc); slower, and less often successful.

    **Arguments:** `max_steps`: at most. `tolerance`: in x, as of `LevenbergMarquardt`.

    Finds a local minimum, which depends on the start.

    **Source:** Nocedal & Wright, Numerical Optimization, 2nd ed. 2006, chapter 6; as optimistix has it. Zimmermann &
    Moberg, section III.B, use `fminunc`.
    """

    max_steps: int = eqx.field(static=True, default=500)
    tolerance: float = eqx.field(static=True, default=1e-8)

    def minimiser(self, tolerance):
        return optx.BFGS(rtol=0.0, atol=tolerance)

    def function(self, cost, gain):
        return lambda x, _: (0.5 * jnp.square(gain) * cost(x), None)


def descend(
    cost: Cost,
    x: Float[Array, "parameter"],
    solver: AbstractSolver,
    tolerance: float | None = None,
) -> Minimisation:
    """Minimise the cost from one start; `tolerance` of the solver unless it is given."""
    return descents(cost, [x], solver, tolerance)[0]


def descents(
    cost: Cost,
    starts: Sequence[Float[Array, "parameter"]],
    solver: AbstractSolver,
    tolerance: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Minimisation]:
    """Minimise the cost from each start, block by block, so that one program serves any number of them; `progress` is
    called with how many are done."""
    ends: list[Minimisation] = []
    within = jnp.asarray(solver.tolerance if tolerance is None else tolerance)
    reach = tuple(jnp.asarray(end) for end in cost.coordinates.reach())
    while len(ends) < len(starts):
        block = np.full((_TOGETHER, cost.coordinates.size), np.nan)  # a start that is no number ends at once
        some = starts[len(ends) : len(ends) + _TOGETHER]
        block[: len(some)] = some
        found = jax.tree.map(np.asarray, _minimised(cost, solver, jnp.asarray(block), reach, within))
        ends += [_descent(*(part[i] for part in found)) for i in range(len(some))]
        if progress is not None:
            progress(len(ends))
    return ends


@eqx.filter_jit
def _minimised(cost: Cost, solver: AbstractSolver, starts, reach, tolerance):
    """(success, steps, x after each, cost after each) of every start.

    One start after the other: under `jax.vmap` all wait for the slowest, and what a step needs leaves the cache; that
    took half as long again."""
    # In these units the cost is a weighted mean square of E: optimistix starts with a damping of 1.
    gain = _GAIN / jnp.sqrt(jnp.maximum(cost.total, 1e-300))
    minimiser = solver.minimiser(tolerance)
    kept = _Kept(minimiser, *reach, tolerance, solver.max_steps + 1)  # type: ignore[call-arg, arg-type]
    function = solver.function(cost, gain)

    def one(x):
        found = optx.minimise(function, kept, x, has_aux=True, max_steps=solver.max_steps + 1, throw=False)
        path_x, path_value = found.stats["path"]
        path_cost = path_value / (0.5 * jnp.square(gain))
        return found.result == optx.RESULTS.successful, found.stats["num_steps"], path_x, path_cost

    return jax.lax.map(one, starts)


def _descent(success, count, path_x, path_cost) -> Minimisation:
    path_x, path_cost = path_x[: max(int(count), 1)], path_cost[: max(int(count), 1)]
    converged = bool(success and np.isfinite(path_cost[-1]))
    return Minimisation(path_x[-1], float(path_cost[-1]), len(path_x) - 1, converged, path_x, path_cost)


class _GaussNewtonState(eqx.Module):
    first: JaxArray
    y_eval: JaxArray
    f_info: optx.FunctionInfo.EvalGradHessian  # type: ignore[valid-type]
    aux: tuple[JaxArray, JaxArray]
    search: object
    ended: JaxArray


class _GaussNewton(optx.AbstractMinimiser):
    """Levenberg-Marquardt from optimistix's damped Newton descent and trust region, for a function that gives its
    gradient and Gauss-Newton matrix beside its value: (x, args) -> (value, (gradient, matrix)).

    `optimistix.LevenbergMarquardt` takes residuals. It writes their whole Jacobian at every step, accepted or not, and
    that is what a step then costs: 130 ms by its normal equations, more by its QR, where this takes 55 (7 positions,
    336 lines, 36 elements, 22 parameters, one core).
    """

    atol: JaxArray  # type: ignore[misc, assignment]  # an array: another tolerance compiles nothing
    rtol: float = 0.0
    norm: Callable[[PyTree], JaxArray] = optx.max_norm
    search: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion()
    descent: optx.DampedNewtonDescent = optx.DampedNewtonDescent()

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        blank = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), aux_struct)
        f_info = _quadratic(jnp.zeros(f_struct.shape, f_struct.dtype), blank)
        no, yes = jnp.array(False), jnp.array(True)
        return _GaussNewtonState(yes, y, f_info, blank, self.search.init(y, f_info), no)

    def step(self, fn, y, args, options, state, tags):
        value, aux = fn(state.y_eval, args)
        there = _quadratic(value, aux)
        size, accept, _, search = self.search.step(state.first, y, state.y_eval, state.f_info, there, state.search)
        promised = self.search.predict_reduction(state.y_eval - y, state.f_info)
        # A step that promises less than the rounding of the cost, and is refused, is the last.
        lost = jnp.abs(promised) <= _ROUNDING * jnp.abs(state.f_info.f)
        ended = ~state.first & ~accept & lost
        pick = lambda new, old: jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)
        y, f_info, aux = pick(state.y_eval, y), pick(there, state.f_info), pick(aux, state.aux)
        # What cannot be solved gives no number, is refused as such, and comes again with more damping.
        change, _ = self.descent.step(size, self.descent.query(y, f_info, self.descent.init(y, f_info)))
        return y, _GaussNewtonState(jnp.array(False), y + change, f_info, aux, search, ended), aux

    def terminate(self, fn, y, args, options, state, tags):
        return state.ended, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {}


def _quadratic(value, aux):
    gradient, matrix = aux
    return optx.FunctionInfo.EvalGradHessian(
        value, gradient, lx.MatrixLinearOperator(matrix, lx.positive_semidefinite_tag)
    )


class _KeptState(eqx.Module):
    inner: eqx.Module
    path_y: JaxArray
    path_f: JaxArray
    taken: JaxArray
    still: JaxArray


class _Kept(optx.AbstractMinimiser):
    """Another solver, with every step kept, trials within `low` and `high`, and an end where the next step is below the
    tolerance."""

    solver: optx.AbstractMinimiser
    low: JaxArray
    high: JaxArray
    tolerance: JaxArray
    length: int = eqx.field(static=True)

    @property  # type: ignore[misc]
    def rtol(self):
        return self.solver.rtol

    @property  # type: ignore[misc]
    def atol(self):
        return self.solver.atol

    @property  # type: ignore[misc]
    def norm(self):
        return self.solver.norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        inner = self.solver.init(fn, y, args, options, f_struct, aux_struct, tags)
        path_y, path_f = jnp.zeros((self.length, *y.shape), y.dtype).at[0].set(y), jnp.full(self.length, jnp.nan)
        return _KeptState(inner, path_y, path_f, jnp.array(0), jnp.array(False))

    def step(self, fn, y, args, options, state, tags):
        y, inner, aux = self.solver.step(fn, y, args, options, state.inner, tags)
        # A trial far behind a bound, where the response stands still, would never come back.
        inner = eqx.tree_at(lambda s: s.y_eval, inner, jnp.clip(inner.y_eval, self.low, self.high))
        value = inner.f_info.f
        still = self.norm(inner.y_eval - y) < self.tolerance
        path_y, path_f = state.path_y.at[state.taken].set(y), state.path_f.at[state.taken].set(value)
        return y, _KeptState(inner, path_y, path_f, state.taken + 1, still | ~jnp.isfinite(value)), aux

    def terminate(self, fn, y, args, options, state, tags):
        ended, result = self.solver.terminate(fn, y, args, options, state.inner, tags)
        return ended | state.still, result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {"path": (state.path_y, state.path_f)}


def check_solver(solver) -> None:
    if not isinstance(solver, AbstractSolver):
        raise input_error("solver", repr(solver), "LevenbergMarquardt() or BFGS()", "Give one of them.")
