"""Where to measure: Fisher information of every position, a D-optimal choice, and the accuracy to expect of it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree

from .._errors import input_error
from .._types import Array
from .cost import at_position
from .model import AbstractModel
from .parameter import Coordinates
from .uncertainty import _correlation, _inverse

_SWEEPS = 50


class Accuracy(eqx.Module):
    """What an experiment at some positions would know of the parameters.

    **Fields:** `names`; `std`: of every parameter in x, relative for positive ones, (parameter,); `correlation`:
    (parameter, parameter).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    std: Float[np.ndarray, "parameter"]
    correlation: Float[np.ndarray, "parameter parameter"]


def position_information(
    model: AbstractModel,
    frequency: Float[Array, "freq"],
    points: PyTree,
    noise: Float[Array, "..."] | float = 0.05,
    weights: Float[Array, "out in"] | None = None,
) -> Float[np.ndarray, "pos parameter parameter"]:
    """Fisher information about the model's free parameters that the FRF at every operating point would hold.

    At the model's start values, in coordinates x (relative for positive parameters), for an FRF whose elements are
    independent with relative standard deviation `noise` (complex), scalar or broadcastable to (freq, out, in). An
    experiment of n times as many blocks of experiments has n times the information.

    Knows noise only: bias from nonlinearity does not fall with more experiments.

    **Arguments:** `points`: operating points with a leading axis (pos), e.g. arm angles (pos, axis). `weights`: of the
    elements, (out, in), 1 by default; 0 for elements that are not measured.
    """
    coordinates = Coordinates(model.parameters)
    frequency = jnp.asarray(frequency)
    n_pos = len(jax.tree.leaves(points)[0])
    points = jax.tree.map(jnp.asarray, points)
    first = jax.tree.map(lambda a: a[0], points)
    x = jnp.asarray(coordinates.start())
    shape = jax.eval_shape(lambda p: model.response(frequency, coordinates.values(x), p), first).shape
    precision = np.broadcast_to(1.0 / np.square(noise), shape) * (1.0 if weights is None else np.asarray(weights))
    flat = jnp.asarray(np.swapaxes(precision, -1, -2).reshape(shape[0], -1))
    found = np.asarray(_information(model, coordinates, frequency, x, points, flat))
    if not np.isfinite(found).all():
        bad = np.flatnonzero(~np.isfinite(found).all(axis=(1, 2)))
        raise input_error(
            "operating points",
            f"a response that is not finite at {len(bad)} of {n_pos} (first: {bad[0]})",
            "points where the model holds",
            "Leave these points out.",
        )
    return found


@eqx.filter_jit
def _information(model, coordinates, frequency, x, points, precision):
    def one(point):
        _, slope = at_position(model, coordinates, frequency, x, point)
        root = jnp.sqrt(2.0 * precision)[..., None]
        stacked = jnp.concatenate([(root * slope.real), (root * slope.imag)]).reshape(-1, coordinates.size)
        return stacked.T @ stacked

    return jax.lax.map(one, points)


def d_optimal(
    information: Float[np.ndarray, "pos parameter parameter"], count: int, repeat: bool = False
) -> tuple[int, ...]:
    """The `count` positions whose information together has the largest determinant, by greedy choice and exchange.

    Fedorov's exchange from a greedy start (Fedorov, Theory of Optimal Experiments, 1972): every chosen position is
    exchanged for the best other one until none improves. It is a local optimum; starts from every single position
    would cost as many times more.

    **Arguments:** `repeat`: whether a position may be chosen more than once. **Returns:** indices, ascending.
    """
    information = np.asarray(information)
    n = len(information)
    if not 1 <= count or (count > n and not repeat):
        raise input_error("count of positions", f"{count}", f"1 to {n}, the candidates", "Offer more candidates.")
    scale = np.sqrt(np.maximum(np.diagonal(information.sum(axis=0)), 1e-300))
    scaled = information / scale[:, None] / scale[None, :]
    # A little of everything: the first positions alone may not show every parameter.
    prior = 1e-9 * np.eye(len(scale))
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(_best(scaled, prior + scaled[chosen].sum(axis=0), [] if repeat else chosen)[0])
    for _ in range(_SWEEPS):
        before = list(chosen)
        for i in range(count):
            others = chosen[:i] + chosen[i + 1 :]
            rest = prior + scaled[others].sum(axis=0)
            best, value = _best(scaled, rest, [] if repeat else others)
            if value > np.linalg.slogdet(rest + scaled[chosen[i]])[1] + 1e-12:
                chosen[i] = best
        if chosen == before:
            break
    return tuple(sorted(int(i) for i in chosen))


def _best(scaled, rest, taken) -> tuple[int, float]:
    values = np.linalg.slogdet(rest + scaled)[1]
    values[list(taken)] = -np.inf
    best = int(np.argmax(values))
    return best, float(values[best])


def expected_accuracy(
    information: Float[np.ndarray, "pos parameter parameter"], names: tuple[str, ...], blocks: float = 1.0
) -> Accuracy:
    """Standard deviations and correlations of the parameters from these positions together.

    **Arguments:** `information`: of the chosen positions. `blocks`: how many times the experiment whose noise the
    information assumed.
    """
    total = blocks * np.asarray(information).sum(axis=0)
    cov = _inverse(total)
    return Accuracy(tuple(names), np.sqrt(np.diagonal(cov)), _correlation(cov))
