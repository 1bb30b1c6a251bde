"""Minimisers of the cost, through optimistix, with every step kept."""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Float, Int

from .._errors import input_error
from .._types import Array
from .cost import Target, gram
from .model import AbstractModel
from .parameter import Coordinates

_REJECTED = 12  # steps refused one after the other: rounding is all that is left


class Descent(eqx.Module):
    """One minimisation.

    **Fields:** `x`: where it ended, (parameter,). `cost`: there. `steps`: taken. `converged`: whether it ended by
    itself. `path_x`: x after every step, (max_steps + 1, parameter), the start first; rows behind `steps` repeat the
    end. `path_cost`: the same for the cost.
    """

    x: Float[Array, "parameter"]
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Array
    path_x: Float[Array, "step parameter"]
    path_cost: Float[Array, "step"]


class AbstractSolver(eqx.Module):
    """How the cost is minimised. `tolerance`: a relative change of every parameter below it ends the search."""

    max_steps: eqx.AbstractVar[int]
    tolerance: eqx.AbstractVar[float]

    @abc.abstractmethod
    def optimistix(self):
        """The optimistix solver."""

    @abc.abstractmethod
    def function(self, model: AbstractModel, coordinates: Coordinates, target: Target, scale):
        """What it minimises: (x, args) -> (residual or cost, V)."""


class LevenbergMarquardt(AbstractSolver):
    """Levenberg-Marquardt with exact Jacobians.

    The residuals are handed to optimistix as the last column of the symmetric root S of [J r]^T [J r], with the rest of
    S as their Jacobian. Cost, gradient and Gauss-Newton matrix are those of the full problem, at a thousandth of the
    size, so that a step costs what the Jacobian costs.

    **Arguments:** `max_steps`: at most. `tolerance`: see `AbstractSolver`.
    """

    max_steps: int = eqx.field(static=True, default=80)
    tolerance: float = eqx.field(static=True, default=1e-10)

    def optimistix(self):
        return optx.LevenbergMarquardt(rtol=self.tolerance, atol=self.tolerance)

    def function(self, model, coordinates, target, scale):
        @jax.custom_jvp
        def residual(x):
            return _root(gram(model, coordinates, target, x))[:, -1] * scale

        @residual.defjvp
        def slope(primals, tangents):
            root = _root(gram(model, coordinates, target, primals[0])) * scale
            return root[:, -1], root[:, :-1] @ tangents[0]

        def function(x, _):
            r = residual(x)
            return r, jnp.sum(jnp.square(r)) / scale**2

        return function


class BFGS(AbstractSolver):
    """The Broyden-Fletcher-Goldfarb-Shanno method, as the paper uses it (fminunc); slower, and less often successful.

    **Arguments:** as of `LevenbergMarquardt`.
    """

    max_steps: int = eqx.field(static=True, default=500)
    tolerance: float = eqx.field(static=True, default=1e-8)

    def optimistix(self):
        return optx.BFGS(rtol=self.tolerance, atol=self.tolerance)

    def function(self, model, coordinates, target, scale):
        @jax.custom_jvp
        def cost(x):
            return gram(model, coordinates, target, x)[-1, -1] * scale**2

        @cost.defjvp
        def slope(primals, tangents):
            full = gram(model, coordinates, target, primals[0]) * scale**2
            return full[-1, -1], 2.0 * full[-1, :-1] @ tangents[0]

        def function(x, _):
            V = cost(x)
            return V, V / scale**2

        return function


def _root(matrix):
    """The symmetric square root S = sqrt of the scaled matrix times its scales, so that S^T S = matrix; S is continuous
    in the matrix and needs no full rank."""
    scale = jnp.sqrt(jnp.maximum(jnp.diagonal(matrix), 1e-300))
    values, vectors = jnp.linalg.eigh(matrix / scale[:, None] / scale[None, :])
    return (vectors * jnp.sqrt(jnp.maximum(values, 0.0))) @ vectors.T * scale


@eqx.filter_jit
def descend(
    model: AbstractModel,
    coordinates: Coordinates,
    target: Target,
    x: Float[Array, "parameter"],
    solver: AbstractSolver,
    max_steps: Int[Array, ""] | int,
) -> Descent:
    """Minimise the cost from one start, at most `max_steps` and the solver's own limit."""
    # In these units the cost is a weighted mean square of E: optimistix starts with a damping of 1.
    total = jnp.sum(jnp.square(target.magnitude)) + jnp.sum(jnp.square(target.phase))
    scale = _GAIN / jnp.sqrt(total) if target.whitener is None else _GAIN / math.sqrt(target.log_G.size)
    inner, tags = solver.optimistix(), frozenset()
    function = solver.function(model, coordinates, target, scale)
    f_struct, aux_struct = jax.eval_shape(lambda y: function(y, None), x)
    state = inner.init(function, x, None, {}, f_struct, aux_struct, tags)
    n, p = solver.max_steps, coordinates.size
    path_x, path_cost = jnp.zeros((n + 1, p)).at[0].set(x), jnp.full(n + 1, jnp.inf)

    def proceed(carry):
        _, _, step, stop, *_ = carry
        return (step < jnp.minimum(n, max_steps) + 1) & ~stop

    # A state holds a traced function too, the same at every step.
    state, static = eqx.partition(state, eqx.is_array)

    def advance(carry):
        x, state, step, _, refused, path_x, path_cost = carry
        new, state, _ = inner.step(function, x, None, {}, eqx.combine(state, static), tags)
        change = jnp.max(jnp.abs(new - x))
        cost = state.aux
        moved = change > 0
        refused = jnp.where(moved, 0, refused + 1)
        small = moved & (change < solver.tolerance)
        stop = (step > 0) & (small | (refused > _REJECTED) | ~jnp.isfinite(cost))
        path_x, path_cost = path_x.at[step].set(new), path_cost.at[step].set(cost)
        state = eqx.filter(state, eqx.is_array)
        return new, state, step + 1, stop, refused, path_x, path_cost

    start = (x, state, jnp.array(0), jnp.array(False), jnp.array(0), path_x, path_cost)
    x, _, count, stop, _, path_x, path_cost = jax.lax.while_loop(proceed, advance, start)
    last = count - 1
    behind = jnp.arange(n + 1) > last
    cost = path_cost[last]
    return Descent(
        x,
        cost,
        last,
        stop & jnp.isfinite(cost),
        jnp.where(behind[:, None], x, path_x),
        jnp.where(behind, cost, path_cost),
    )


_GAIN = 3.0


def check_solver(solver) -> None:
    if not isinstance(solver, AbstractSolver):
        raise input_error("solver", repr(solver), "LevenbergMarquardt() or BFGS()", "Give one of them.")
