"""Parameters of a gray-box model: what is fitted, from where, in which coordinates."""

import fnmatch
import math
from collections.abc import Iterable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._arguments import expect, expect_number, expect_text, said
from .._errors import input_error
from .._text import nearest
from .._types import Array

_ROUND = 0.05  # width of the corner at a bound, in ln
_SHARE = 0.02  # and at most this part of the range
_BEYOND = 3.0  # corners beyond a bound that a solver may go: further out it would not feel the parameter any more
_SPAN = 1e4  # default bounds of a positive parameter: this factor from its start


class Parameter(eqx.Module):
    """A number that a gray-box model depends on.

    A positive parameter is fitted as its logarithm, so that it stays positive and its steps, spreads and standard
    deviations are relative; any other in units of `scale`.

    **Arguments:**

    - `start`: where the fit starts, in `unit`.
    - `unit`: of the value, for reports.
    - `positive`: whether it is positive by its nature.
    - `free`: whether it is fitted.
    - `nuisance`: fitted, but not what the user asked for (effective friction): not counted in summaries.
    - `spread`: standard deviation of perturbed starts, of ln(value) or in units of `scale`.
    - `bounds`: (lowest, highest) value; a result there is reported. Default: a factor of 1e4 from a positive start,
      none otherwise.
    - `scale`: size of a parameter that may be negative.
    - `same_as`: name of another parameter whose value this one takes (a shared parameter).

    **Raises:** `jaxfrf.InputError` for a start that is not finite (positive, where it should be) or outside the bounds,
    for bounds that are no pair, and for a `scale` or `spread` of no sense.
    """

    start: Float[np.float64, ""]
    unit: str = eqx.field(static=True)
    positive: bool = eqx.field(static=True)
    free: bool = eqx.field(static=True)
    nuisance: bool = eqx.field(static=True)
    spread: float = eqx.field(static=True)
    bounds: tuple[Float[np.float64, ""], Float[np.float64, ""]] | None
    scale: float = eqx.field(static=True)
    same_as: str | None = eqx.field(static=True)

    def __init__(
        self,
        start: float,
        unit: str = "",
        *,
        positive: bool = True,
        free: bool = True,
        nuisance: bool = False,
        spread: float = 0.25,
        bounds: tuple[float, float] | None = None,
        scale: float = 1.0,
        same_as: str | None = None,
    ):
        for name, value in (("start of a parameter", start), ("spread", spread), ("scale", scale)):
            expect_number(name, value)
        # Numbers are arrays: a fit from another start is not compiled again.
        self.start = np.float64(start)
        self.unit, self.positive, self.free, self.nuisance = unit, positive, free, nuisance
        self.spread, self.scale, self.same_as = float(spread), float(scale), same_as
        self.bounds = None if bounds is None else _pair(bounds)

    def __check_init__(self):
        if not math.isfinite(self.start) or (self.positive and not self.start > 0):
            raise input_error(
                "start of a parameter",
                f"{self.start:g}",
                "a positive number" if self.positive else "a finite number",
                "Give another start, or say positive=False.",
            )
        if not self.scale > 0 or not self.spread >= 0:
            raise input_error("scale and spread", f"{self.scale}, {self.spread}", "positive numbers", "Correct them.")
        low, high = self.limits
        if not low < high or not low <= self.start <= high or (self.positive and low < 0):
            raise input_error(
                "bounds of a parameter",
                f"{low:g} to {high:g} with the start {self.start:g}",
                "lowest < highest with the start between them",
                "Widen them, or move the start.",
            )

    @property
    def limits(self) -> tuple[np.float64, np.float64]:
        """Lowest and highest value."""
        if self.bounds is not None:
            return self.bounds
        if self.positive:
            return self.start / _SPAN, self.start * _SPAN
        return np.float64(-np.inf), np.float64(np.inf)

    def accepts(self, value: float) -> bool:
        """Whether it may have this value (beyond a bound it is moved inside)."""
        return math.isfinite(value) and (value > 0 or not self.positive)

    def coordinate(self, value: float) -> float:
        """x of a value, the inverse of `value`; one at or beyond a bound is moved inside it."""
        (low, high), corner = self._ends()
        y = math.log(value) if self.positive else float(value) / self.scale
        x = high - corner * _inverse_softplus((high - y) / corner) if math.isfinite(high) else y
        x = low + corner * _inverse_softplus((x - low) / corner) if math.isfinite(low) else x
        return self.inside(float(x))

    def inside(self, x: float) -> float:
        """The nearest x that is not beyond a bound: a solver that starts there still sees which way to go."""
        (low, high), _ = self._ends()
        return float(min(max(x, low), high))

    def reach(self) -> tuple[Array, Array]:
        """Lowest and highest x that a solver may try."""
        (low, high), corner = self._ends()
        return low - _BEYOND * corner, high + _BEYOND * corner

    def value(self, x):
        """The value at x: the identity (or exp) away from the bounds, bending over where they come near."""
        (low, high), corner = self._ends()
        below, above = (jnp.where(jnp.isfinite(end), end, x) for end in (low, high))
        y = jnp.where(jnp.isfinite(low), below + corner * jax.nn.softplus((x - below) / corner), x)
        y = jnp.where(jnp.isfinite(high), above - corner * jax.nn.softplus((above - y) / corner), y)
        return jnp.exp(y) if self.positive else self.scale * y

    def stands_at_bound(self, x: float) -> bool:
        (low, high), corner = self._ends()
        return bool(x < low + 2 * corner or x > high - 2 * corner)

    def _ends(self):
        """The bounds in x, and the width of the corners at them."""
        low, high = self.limits
        xp = np if isinstance(low, np.generic) else jnp  # a number of NumPy's, or one of a program being made
        if self.positive:
            low, high = xp.where(low > 0, xp.log(xp.maximum(low, 1e-300)), -xp.inf), xp.log(high)
        else:
            low, high = low / self.scale, high / self.scale
        return (low, high), xp.minimum(_ROUND, _SHARE * (high - low))


def _pair(bounds: tuple[float, float]) -> tuple[np.float64, np.float64]:
    try:
        both = np.asarray(bounds)
    except ValueError:
        both = np.zeros(0)  # of other lengths
    if both.shape != (2,) or both.dtype.kind not in "iuf":
        raise input_error("bounds of a parameter", said(bounds), "(lowest, highest)", "Leave them out for none.")
    return np.float64(both[0]), np.float64(both[1])


def _inverse_softplus(t: float) -> float:
    return t + math.log(-math.expm1(-t)) if t > 0 else -math.inf


def as_parameters(given: Mapping[str, Parameter | float]) -> dict[str, Parameter]:
    """Parameters by name, where a number is a positive one that starts there."""
    if not isinstance(given, Mapping):
        raise input_error("parameters", said(given), "a table {name: start}", 'E.g. {"k": 1e4, "d": 10.0}.')
    for name, p in given.items():
        expect_text("name of a parameter", name)
        if isinstance(p, Parameter):
            continue
        expect_number(f"start of {name}", p)
        if not p > 0:
            raise input_error(
                f"start of {name}",
                f"{float(p):g}",
                "a positive number",
                "Give another start, or say Parameter(start, positive=False).",
            )
    return {n: p if isinstance(p, Parameter) else Parameter(float(p)) for n, p in given.items()}


class Coordinates(eqx.Module):
    """From the vector x that a solver changes to the parameters by name.

    x holds the free parameters that are not shared, in the order of `names` (stiffnesses, dampings, others, nuisances):
    ln(value) of positive ones, value/scale of others. Near a bound the map bends over within 5 % of it, so that a
    solver can run into it without harm.

    **Arguments:** `parameters`: name -> `Parameter`.
    """

    parameters: dict[str, Parameter]
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, parameters: Mapping[str, Parameter]):
        self.parameters = dict(parameters)
        for name, p in self.parameters.items():
            expect(name, p, Parameter)
        _check_shared(self.parameters)
        free = [n for n, p in self.parameters.items() if p.free and p.same_as is None]
        # The same order whatever was done to the model: JAX sorts dictionaries.
        self.names = tuple(sorted(free, key=lambda n: (self.parameters[n].nuisance, _kind(n), n)))
        if not self.names:
            raise input_error("parameters", "none that is free", "at least one to fit", "Set free=True on some.")

    @property
    def size(self) -> int:
        return len(self.names)

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the values that depend on x: free and shared parameters."""
        return tuple(n for n, p in self.parameters.items() if (p.same_as or n) in self.names)

    @property
    def units(self) -> dict[str, str]:
        return {name: p.unit for name, p in self.parameters.items()}

    def start(self) -> np.ndarray:
        """The coordinates of all starts, (parameter,)."""
        return self.coordinates({})

    def coordinates(self, values: Mapping[str, float]) -> np.ndarray:
        """x of values by name; parameters that are not named stay at their start."""
        own = self.parameters
        return np.array([own[n].coordinate(values.get(n, own[n].start)) for n in self.names])

    def inside(self, x: Float[Array, "parameter"]) -> np.ndarray:
        """The nearest x that is not beyond a bound, (parameter,)."""
        return np.array([self.parameters[n].inside(float(xi)) for n, xi in zip(self.names, x, strict=True)])

    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest x that a solver may try, (parameter,) each."""
        low, high = zip(*(self.parameters[name].reach() for name in self.names), strict=True)
        return np.array(low), np.array(high)

    def values(self, x: Float[Array, "parameter"]) -> dict[str, jax.Array]:
        """Every parameter of the model at x: free, shared and fixed."""
        x = jnp.asarray(x)
        at = {name: self.parameters[name].value(x[i]) for i, name in enumerate(self.names)}
        fixed = {n: jnp.asarray(p.start, x.dtype) for n, p in self.parameters.items() if not p.free}
        own = fixed | at
        return {n: own[p.same_as or n] for n, p in self.parameters.items()}

    def at_bound(self, x: Float[Array, "parameter"]) -> tuple[str, ...]:
        """Names of the parameters that stand at a bound."""
        ends = zip(self.names, np.asarray(x), strict=True)
        return tuple(name for name, xi in ends if self.parameters[name].stands_at_bound(float(xi)))

    def spreads(self) -> np.ndarray:
        """Standard deviation of perturbed starts, in x, (parameter,)."""
        return np.array([self.parameters[name].spread for name in self.names])

    def wanted(self) -> np.ndarray:
        """Which of the fitted parameters are no nuisance, (parameter,)."""
        return np.array([not self.parameters[name].nuisance for name in self.names])


def _kind(name: str) -> tuple[int, str]:
    kind = name.rpartition(".")[2] if "." in name else ""
    known = ("stiffness", "damping")
    return (known.index(kind) if kind in known else len(known), kind)


def _check_shared(parameters: Mapping[str, Parameter]) -> None:
    for name, p in parameters.items():
        if p.same_as is None:
            continue
        if p.same_as not in parameters or parameters[p.same_as].same_as is not None or p.same_as == name:
            raise input_error(
                f"parameter {name!r}: same_as",
                repr(p.same_as),
                "the name of a parameter that is not shared itself",
                f"Choose one of {', '.join(n for n, q in parameters.items() if q.same_as is None and n != name)}.",
            )


def matching(parameters: Mapping[str, Parameter], names: str | Iterable[str]) -> tuple[str, ...]:
    """Names of the parameters that are named (one, or several), in which `*` may stand for any text: `*.damping`.

    **Raises:** `jaxfrf.InputError` for a name that is not there, with the nearest one.
    """
    names = [names] if isinstance(names, str) else names
    if not isinstance(names, Iterable):
        raise input_error("parameters", said(names), "a name, or a list of names", 'E.g. ["*.damping"].')
    found: dict[str, None] = {}
    for name in names:
        expect_text("parameter", name)
        these = [n for n in parameters if n == name or fnmatch.fnmatchcase(n, name)]
        if not these:
            near = nearest(name, parameters)
            raise input_error("parameter", repr(name), f"one of {', '.join(parameters)}", f"Did you mean {near!r}?")
        found |= dict.fromkeys(these)
    return tuple(found)
