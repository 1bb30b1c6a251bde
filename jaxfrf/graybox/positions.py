"""Where to measure: Fisher information of every position, a D-optimal choice, and the accuracy to expect of it."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, PyTree

from .._arguments import expect, expect_number, expect_real, expect_whole, said
from .._errors import input_error
from .._types import Array
from .cost import at_position
from .model import AbstractModel
from .own import response_shape
from .parameter import Coordinates
from .uncertainty import _correlation, _inverse

_SWEEPS = 50


_DRAWS = 100  # random choices that the D-optimal one is compared with


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

    **Arguments:** `model`: with start values. `frequency`: (freq,), Hz. `points`: operating points with a leading axis
    (pos), e.g. arm angles (pos, axis), rad. `noise`: see above. `weights`: of the elements, (out, in), 1 by default; 0
    for elements that are not measured.

    **Returns:** (pos, parameter, parameter), in coordinates x: relative for positive parameters.

    **Raises:** `jaxfrf.InputError` for no lines or points, a `noise` that is not above 0, shapes that do not fit, and
    naming operating points at which the response is not finite.

    **Source:** closed form for Gaussian errors, e.g. Ljung, System Identification, 2nd ed. 1999, section 7.4.
    """
    expect("model", model, AbstractModel)
    expect_real("frequency", frequency)
    coordinates = Coordinates(model.parameters)
    frequency = jnp.atleast_1d(jnp.asarray(frequency, float))
    points = _as_points(points)
    n_pos = len(jax.tree.leaves(points)[0])
    first = jax.tree.map(lambda a: a[0], points)
    x = jnp.asarray(coordinates.start())
    shape = response_shape(model, coordinates, frequency, first)
    noise = _broadcast("noise", noise, shape)
    if np.any(noise <= 0):
        raise input_error("noise", f"{noise.min():g}", "a relative standard deviation above 0", "E.g. 0.05.")
    precision = _broadcast("weights", 1.0 if weights is None else weights, shape[1:]) / np.square(noise)
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


def _as_points(given: PyTree) -> PyTree:
    """Operating points as arrays with a leading axis (pos); a list of rows becomes one array."""
    try:
        points = jax.tree.map(np.asarray, np.asarray(given) if isinstance(given, list) else given)
        sizes = {len(leaf) for leaf in jax.tree.leaves(points) if leaf.dtype.kind in "iufc"}
    except (TypeError, ValueError):  # rows of other lengths, single numbers
        sizes = set()
    if len(sizes) != 1 or not min(sizes):
        raise input_error("points", said(given), "operating points, one or more", "Give arm angles, (pos, axis), rad.")
    return jax.tree.map(jnp.asarray, points)


def _as_information(given) -> np.ndarray:
    """(pos, parameter, parameter)"""
    information = np.asarray(given)
    if information.ndim != 3 or information.shape[1] != information.shape[2] or information.dtype.kind not in "iuf":
        expected = "an array (pos, parameter, parameter)"
        raise input_error("information", said(given), expected, "Take what position_information gives.")
    return information


def _broadcast(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    expect_real(name, value)
    try:
        return np.broadcast_to(np.asarray(value, float), shape)
    except ValueError:
        raise input_error(
            name, f"shape {np.shape(value)}", f"one number, or numbers for each of {shape}", "Check the axes."
        ) from None


@eqx.filter_jit
def _information(model, coordinates, frequency, x, points, precision):
    def one(point):
        _, slope = at_position(model, coordinates, frequency, x, point)
        root = jnp.sqrt(2.0 * precision)[..., None]
        stacked = jnp.concatenate([(root * slope.real), (root * slope.imag)]).reshape(-1, coordinates.size)
        return stacked.T @ stacked

    return jax.lax.map(one, points)


def d_optimal(
    information: Float[np.ndarray, "pos parameter parameter"], count: int, repeat: bool = False, starts: int = 8
) -> tuple[int, ...]:
    """The `count` positions whose information together has the largest determinant, by greedy choice and exchange.

    Fedorov's exchange from a greedy start (Fedorov, Theory of Optimal Experiments, 1972): every chosen position is
    exchanged for the best other one until none improves, from the `starts` best first positions in turn. The best of
    them is a local optimum: no single exchange improves it, two at once might. The choice does not depend on the units
    of the parameters.

    **Arguments:** `information`: of `jaxfrf.position_information`, (pos, parameter, parameter). `count`: how many.
    `repeat`: whether a position may be chosen more than once. `starts`: first positions that are tried.

    **Returns:** indices, ascending.

    **Raises:** `jaxfrf.InputError` for more positions than candidates, and for information that is not finite.

    **Source:** Fedorov, Theory of Optimal Experiments, 1972 (the exchange).
    """
    information = _as_information(information)
    n = len(information)
    expect_whole("count of positions", count, None)
    if not 1 <= count or (count > n and not repeat):
        raise input_error("count of positions", f"{count}", f"1 to {n}, the candidates", "Offer more candidates.")
    finite = np.isfinite(information).all(axis=(1, 2))
    if not finite.all():
        raise input_error(
            "information",
            f"numbers that are not finite at position {np.flatnonzero(~finite)[0]}",
            "finite numbers",
            "Leave out positions where the model does not hold.",
        )
    scale = np.sqrt(np.maximum(np.diagonal(information.sum(axis=0)), 1e-300))
    scaled = information / scale[:, None] / scale[None, :]
    alone = np.linalg.slogdet(_prior(scaled) + scaled)[1]
    firsts = np.argsort(-alone, kind="stable")[: max(starts, 1)]
    found = [_exchanged(scaled, _greedy(scaled, int(first), count, repeat), repeat) for first in firsts]
    best = max(found, key=lambda chosen: np.linalg.slogdet(_prior(scaled) + scaled[chosen].sum(axis=0))[1])
    return tuple(sorted(int(i) for i in best))


def _prior(scaled):
    """A little of everything: the first positions alone may not show every parameter."""
    return 1e-9 * np.eye(scaled.shape[-1])


def _greedy(scaled, first: int, count: int, repeat: bool) -> list[int]:
    chosen = [first]
    while len(chosen) < count:
        chosen.append(_best(scaled, _prior(scaled) + scaled[chosen].sum(axis=0), [] if repeat else chosen)[0])
    return chosen


def _exchanged(scaled, chosen: list[int], repeat: bool) -> list[int]:
    for _ in range(_SWEEPS):
        before = list(chosen)
        for i in range(len(chosen)):
            others = chosen[:i] + chosen[i + 1 :]
            rest = _prior(scaled) + scaled[others].sum(axis=0)
            best, value = _best(scaled, rest, [] if repeat else others)
            if value > np.linalg.slogdet(rest + scaled[chosen[i]])[1] + 1e-12:
                chosen = [*chosen[:i], best, *chosen[i + 1 :]]
        if chosen == before:
            break
    return chosen


def _best(scaled, rest, taken) -> tuple[int, float]:
    values = np.linalg.slogdet(rest + scaled)[1]
    values[list(taken)] = -np.inf
    best = int(np.argmax(values))
    return best, float(values[best])


def expected_accuracy(
    information: Float[np.ndarray, "pos parameter parameter"], names: tuple[str, ...], blocks: float = 1.0
) -> Accuracy:
    """Standard deviations and correlations of the parameters from these positions together.

    A bound: what an efficient fit reaches when the noise is all that is wrong.

    **Arguments:** `information`: of the chosen positions, in the coordinates of a fit (logarithms of positive
    parameters, so that deviations are relative), (pos, parameter, parameter). `names`: of the parameters. `blocks`: how
    many times the experiment whose noise it assumed.

    **Returns:** `Accuracy`: standard deviations, (parameter,), relative for positive parameters, and correlations.

    **Raises:** `jaxfrf.InputError` for `information` of another shape, and for another number of names.

    **Source:** the Cramér-Rao bound, e.g. Ljung, System Identification, 2nd ed. 1999, section 7.4.
    """
    information = _as_information(information)
    expect_number("blocks", blocks)
    if isinstance(names, str) or not isinstance(names, Sequence) or len(names) != information.shape[1]:
        raise input_error("names", said(names), f"{information.shape[1]}, one for each parameter", "See Coordinates.")
    total = blocks * information.sum(axis=0)
    cov = _inverse(total)
    return Accuracy(tuple(names), np.sqrt(np.diagonal(cov)), _correlation(cov))


class PositionPlan(eqx.Module):
    """Where to measure, and what to expect of it. Standard deviations are in x: relative for positive parameters.

    **Fields:**

    - `chosen`: D-optimal candidates, ascending. `points`: their operating points, leading axis (pos).
    - `accuracy`: of them together.
    - `names`: of the parameters. `wanted`: which of them are no nuisance, (parameter,).
    - `counts`: numbers of positions, (count,). `optimal`, `random`: standard deviation with so many positions, chosen
      D-optimally or drawn from the candidates (median over draws), (count, parameter).
    - `blocks`: numbers of blocks of experiments at the chosen positions, (block,). `by_blocks`: standard deviation with
      them, (block, parameter).
    """

    chosen: tuple[int, ...] = eqx.field(static=True)
    points: PyTree
    accuracy: Accuracy
    names: tuple[str, ...] = eqx.field(static=True)
    wanted: Bool[np.ndarray, "parameter"]
    counts: Int[np.ndarray, "count"]
    optimal: Float[np.ndarray, "count parameter"]
    random: Float[np.ndarray, "count parameter"]
    blocks: Int[np.ndarray, "block"]
    by_blocks: Float[np.ndarray, "block parameter"]


def plan_positions(
    model: AbstractModel,
    frequency: Float[Array, "freq"],
    candidates: PyTree,
    count: int,
    *,
    noise: Float[Array, "..."] | float = 0.05,
    weights: Float[Array, "out in"] | None = None,
    beyond: int = 5,
    blocks: Sequence[int] = (1, 2, 4, 8, 16),
    seed: int = 0,
) -> PositionPlan:
    """Choose operating points before anyone measures, and say how well the parameters will be known.

    D-optimal at the model's start values: right as far as they are, though a choice of positions forgives wrong ones
    better than the accuracy does. It knows noise alone: the bias of estimator, friction and nonlinear springs is often
    larger, and does not fall with more blocks.

    **Arguments:**

    - `model`: e.g. `jaxfrf.RobotModel(robot)`; fix what is not going to be fitted.
    - `frequency`: lines that the design excites, Hz.
    - `candidates`: operating points with a leading axis (pos), e.g. `jaxfrf.random_positions(200, key)`, or a
      list of rows.
    - `count`: how many to choose.
    - `noise`: relative standard deviation of the FRF from one block of experiments, a number or broadcastable to (freq,
      out, in), lines independent. `weights`: of the elements, see `position_information`.
    - `beyond`: how many positions more than `count` the comparison goes to. `blocks`: numbers of blocks of experiments
      to state the accuracy for. `seed`: of the random choices.

    **Returns:** a `PositionPlan`: the chosen points, and standard deviations, relative for positive parameters.

    **Raises:** `jaxfrf.InputError` for more positions than candidates, for candidates that are no points or have no
    finite response, and for numbers of blocks that are none.

    **Source:** Fedorov, Theory of Optimal Experiments, 1972, as of `jaxfrf.d_optimal`. The comparison with random
    choices is this project's own.
    """
    candidates = _as_points(candidates)
    n = len(jax.tree.leaves(candidates)[0])
    expect_whole("count of positions", count, None)
    if not 1 <= count <= n:
        raise input_error("count of positions", f"{count}", f"1 to {n}, the candidates", "Offer more candidates.")
    expect_whole("beyond", beyond)
    expect_whole("seed", seed)
    expect_real("blocks", blocks)
    if np.ndim(blocks) != 1:
        raise input_error("blocks", said(blocks), "a list of numbers of 1 or more", "Leave it out for 1 to 16.")
    for several in blocks:
        expect_whole("blocks", several, 1)
    information = position_information(model, frequency, candidates, noise, weights)
    coordinates = Coordinates(model.parameters)
    std = lambda chosen, blocks=1: expected_accuracy(information[list(chosen)], coordinates.names, blocks).std
    counts = np.arange(1, min(count + beyond, n) + 1)
    best = {int(k): d_optimal(information, int(k)) for k in counts}
    rng = np.random.default_rng(seed)
    drawn = [[std(rng.choice(n, k, replace=False)) for _ in range(_DRAWS)] for k in counts]
    chosen = best[count]
    return PositionPlan(
        chosen=chosen,
        points=jax.tree.map(lambda x: np.asarray(x)[list(chosen)], candidates),
        accuracy=expected_accuracy(information[list(chosen)], coordinates.names),
        names=coordinates.names,
        wanted=coordinates.wanted(),
        counts=counts,
        optimal=np.stack([std(best[int(k)]) for k in counts]),
        random=np.median(drawn, axis=1),
        blocks=np.asarray(blocks, int),
        by_blocks=np.stack([std(chosen, m) for m in blocks]),
    )
