"""Minimisers of the cost, through optimistix, with every step kept."""

import abc
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from .._errors import input_error
from .._types import Array
from .cost import Cost

_REFUSED = 10  # steps refused one after the other: rounding is all that is left


class Descent(eqx.Module):
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
    def optimistix(self):
        """The optimistix solver."""

    @abc.abstractmethod
    def function(self, root):
        """What it minimises, (x, args) -> (residual or cost, V), near a point where `root` is the root of
        [J r]^T [J r]: right in value and derivative there, which is all that a solver asks for."""


class LevenbergMarquardt(AbstractSolver):
    """Levenberg-Marquardt with exact Jacobians.

    optimistix gets the last column of the symmetric root S of [J r]^T [J r] for residuals and the rest of S for their
    Jacobian. Cost, gradient and Gauss-Newton matrix are those of the full problem at a thousandth of its size, so that
    a step costs what the Jacobian costs.

    **Arguments:** `max_steps`: at most. `tolerance`: see `AbstractSolver`.
    """

    max_steps: int = eqx.field(static=True, default=80)
    tolerance: float = eqx.field(static=True, default=1e-10)

    def optimistix(self):
        return optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12)

    def function(self, root):
        @jax.custom_jvp
        def residual(x):
            return root[:, -1]

        @residual.defjvp
        def slope(primals, tangents):
            return root[:, -1], root[:, :-1] @ tangents[0]

        return lambda x, _: (residual(x), jnp.sum(jnp.square(root[:, -1])))


class BFGS(AbstractSolver):
    """The Broyden-Fletcher-Goldfarb-Shanno method, as the paper uses it (fminunc); slower, and less often successful.

    **Arguments:** as of `LevenbergMarquardt`.
    """

    max_steps: int = eqx.field(static=True, default=500)
    tolerance: float = eqx.field(static=True, default=1e-8)

    def optimistix(self):
        return optx.BFGS(rtol=1e-12, atol=1e-12)

    def function(self, root):
        value = jnp.sum(jnp.square(root[:, -1]))

        @jax.custom_jvp
        def cost(x):
            return value

        @cost.defjvp
        def slope(primals, tangents):
            return value, 2.0 * (root[:, -1] @ root[:, :-1]) @ tangents[0]

        return lambda x, _: (cost(x), value)


@jax.jit
def _root(matrix, scale):
    """The symmetric square root S, S^T S = scale^2 matrix, by the eigenvalues of the matrix scaled to a diagonal of
    ones; S is continuous in the matrix and needs no full rank."""
    size = jnp.sqrt(jnp.maximum(jnp.diagonal(matrix), 1e-300))
    values, vectors = jnp.linalg.eigh(matrix / size[:, None] / size[None, :])
    return (vectors * jnp.sqrt(jnp.maximum(values, 0.0))) @ vectors.T * size * scale


@functools.lru_cache(maxsize=32)
def _machine(solver: AbstractSolver, size: int):
    """(start, advance) of a solver for this number of parameters; compiled once, whatever the model is.

    A step of optimistix asks for the function at one point only, which its state names: the Gram matrix there is made
    before, by a program of its own."""
    inner, tags = solver.optimistix(), frozenset()
    blank = solver.function(jnp.zeros((size + 1, size + 1)))
    f_struct, aux_struct = jax.eval_shape(lambda y: blank(y, None), jnp.zeros(size))
    state = inner.init(blank, jnp.zeros(size), None, {}, f_struct, aux_struct, tags)
    _, static = eqx.partition(state, eqx.is_array)  # a state holds a traced function too, the same at every step

    @jax.jit
    def start(x):
        return eqx.filter(inner.init(blank, x, None, {}, f_struct, aux_struct, tags), eqx.is_array)

    @jax.jit
    def advance(x, state, root, low, high):
        state = eqx.combine(state, static)
        x, state, _ = inner.step(solver.function(root), x, None, {}, state, tags)
        # A trial far behind a bound, where the response stands still, would never come back.
        state = eqx.tree_at(lambda s: s.y_eval, state, jnp.clip(state.y_eval, low, high))
        return x, eqx.filter(state, eqx.is_array)

    return start, advance


def descend(
    cost: Cost,
    x: Float[Array, "parameter"],
    solver: AbstractSolver,
    max_steps: int | None = None,
    tolerance: float | None = None,
) -> Descent:
    """Minimise the cost from one start; `max_steps` and `tolerance` of the solver unless they are given."""
    max_steps = solver.max_steps if max_steps is None else max_steps
    tolerance = solver.tolerance if tolerance is None else tolerance
    # In these units the cost is a weighted mean square of E: optimistix starts with a damping of 1.
    scale = _GAIN / float(np.sqrt(max(cost.total, 1e-300)))
    start, advance = _machine(solver, cost.coordinates.size)
    low, high = cost.coordinates.reach()
    x = jnp.asarray(x)
    state = start(x)
    path_x, path_cost, refused, converged = [], [], 0, False
    for step in range(max_steps + 1):
        root = _root(cost(state.y_eval), scale)
        new, state = advance(x, state, root, low, high)
        change, reached = float(jnp.max(jnp.abs(new - x))), float(state.aux) / scale**2
        x = new
        path_x.append(np.asarray(x))
        path_cost.append(reached)
        refused = 0 if change > 0 else refused + 1
        converged = bool(step > 0 and (0 < change < tolerance or refused > _REFUSED))
        if converged or not np.isfinite(reached):
            break
    return Descent(path_x[-1], path_cost[-1], len(path_x) - 1, converged, np.stack(path_x), np.array(path_cost))


_GAIN = 3.0


def check_solver(solver) -> None:
    if not isinstance(solver, AbstractSolver):
        raise input_error("solver", repr(solver), "LevenbergMarquardt() or BFGS()", "Give one of them.")
