"""A machine by its matrices, with effects at named places."""

import dataclasses
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._arguments import expect, expect_number, expect_real, said
from .._errors import input_error
from .._types import Array
from ..effects import AbstractEffect
from ..graybox import AbstractModel, Parameter
from ..graybox.own import check_callable, told
from ..graybox.parameter import as_parameters
from ..units import expect_quantity

Values = Mapping[str, Array]


class Machine(AbstractModel):
    """A drive or structure of your own, M q'' + D q' + K q = B u - sum of its effects, y = C q or its derivative.

    **Arguments:**

    - `matrices`: called with a dictionary of parameter values, gives M, D, K, (dof, dof) each, written in `jax.numpy`;
      most often an `eqx.Module`.
    - `parameters`: name -> `Parameter` (or a number: a positive parameter that starts there).
    - `inputs`: B, (dof, in). `outputs`: C, (out, dof).
    - `places`: name -> (dof,): the deflection at a place is p . q, and a force against it acts along p. A coupling
      between masses 0 and 1 is `[1, -1]`.
    - `quantity`: what y is: `position`, `velocity` or `acceleration`.
    - `effects`: of `jaxfrf.effects`, or `CubicSpring`, whose `joint` is the name of a place. Their numbers are
      parameters, too: `<place>.<effect>.<number>`.
    - `smoothing`: of Coulomb friction, rad/s or m/s.

    It is a gray-box model: `jaxfrf.fit` fits its linear part to an FRF; `jaxfrf.machine.fit_machine` all of it to the
    record.

    **Raises:** `jaxfrf.InputError` for shapes that do not fit together, effects at places that are not there, and (in a
    fit or simulation) for matrices of another shape, or names that are no parameters.

    **Source:** the equation above.
    """

    parameters: dict[str, Parameter]
    matrices: Callable
    inputs: Float[np.ndarray, "dof in"]
    outputs: Float[np.ndarray, "out dof"]
    places: dict[str, Float[np.ndarray, "dof"]]
    effects: tuple[AbstractEffect, ...]
    quantity: str = eqx.field(static=True)
    smoothing: float = eqx.field(static=True)

    def __init__(
        self,
        matrices: Callable,
        parameters: Mapping[str, Parameter | float],
        *,
        inputs,
        outputs,
        places: Mapping[str, object] | None = None,
        quantity: str = "velocity",
        effects: tuple[AbstractEffect, ...] = (),
        smoothing: float = 1e-2,
    ):
        check_callable("matrices", matrices, "(values)", 1)
        _check_kinds(inputs, outputs, {} if places is None else places, effects, smoothing)
        expect_quantity("quantity", quantity)
        self.matrices = matrices
        self.parameters = as_parameters(parameters)
        self.inputs, self.outputs = np.atleast_2d(np.asarray(inputs, float)), np.atleast_2d(np.asarray(outputs, float))
        self.places = {name: np.asarray(p, float) for name, p in (places or {}).items()}
        self.effects, self.quantity, self.smoothing = (), quantity, float(smoothing)
        for effect in effects:
            self._add(effect)

    def __check_init__(self):
        n = len(self.inputs)
        wrong = [name for name, p in self.places.items() if p.shape != (n,)]
        if self.outputs.shape[1] != n or wrong:
            raise input_error(
                "machine",
                f"inputs {self.inputs.shape}, outputs {self.outputs.shape}"
                + (f", place {wrong[0]!r} {self.places[wrong[0]].shape}" if wrong else ""),
                f"(dof, in), (out, dof) and (dof,) with {n} degrees of freedom",
                "Correct the shapes.",
            )

    def _add(self, effect: AbstractEffect) -> None:
        expect("effect", effect, AbstractEffect)
        if effect.joint not in self.places:
            known = ", ".join(self.places) or "none"
            raise input_error(
                f"{effect.name}: joint", repr(effect.joint), f"a place of the machine ({known})", "Name it in places."
            )
        self.effects = (*self.effects, effect)
        for field in effect.units:
            value = float(np.asarray(getattr(effect, field)))
            name = f"{effect.joint}.{effect.name}.{field}"
            low, _ = effect.bounds[field]
            scale = abs(value) or 1.0
            # What may be of either sign, or nothing, is fitted as it is; shapes as their logarithm.
            positive = low > 0 and value > 0
            unit = effect.units[field]
            self.parameters[name] = Parameter(value, unit, positive=positive, scale=scale)

    def with_effects(self, *effects: AbstractEffect) -> "Machine":
        """The machine with more effects, whose numbers are parameters then."""
        return self._changed(self.parameters, (*self.effects, *effects))

    def with_values(self, values: Mapping[str, float]) -> "Machine":
        """The machine whose parameters start at these values.

        **Raises:** `jaxfrf.InputError` for a name that it does not have.
        """
        self._check_names("values", values)
        moved = {
            n: dataclasses.replace(p, start=np.float64(values.get(n, p.start))) for n, p in self.parameters.items()
        }
        effects = tuple(
            _with_numbers(e, {f: float(moved[f"{e.joint}.{e.name}.{f}"].start) for f in e.units}) for e in self.effects
        )
        return self._changed(moved, effects)

    def held(self, *names: str) -> "Machine":
        """The machine with these parameters fixed where they start.

        **Raises:** `jaxfrf.InputError` for a name that it does not have.
        """
        self._check_names("held", names)
        fixed = {n: dataclasses.replace(p, free=False) if n in names else p for n, p in self.parameters.items()}
        return self._changed(fixed, self.effects)

    def with_smoothing(self, smoothing: float) -> "Machine":
        """The machine whose Coulomb friction turns within this speed, rad/s or m/s."""
        return self._changed(self.parameters, self.effects, smoothing)

    def _check_names(self, argument: str, names: Iterable[str]) -> None:
        for name in names:
            if name not in self.parameters:
                raise input_error(argument, repr(name), f"one of {', '.join(self.parameters)}", "Correct the name.")

    def _changed(
        self, parameters: Mapping[str, Parameter], effects: tuple[AbstractEffect, ...], smoothing: float | None = None
    ) -> "Machine":
        """With these effects; what `parameters` says of their numbers stays."""
        made = Machine(
            self.matrices,
            {n: p for n, p in parameters.items() if n not in self._effect_names()},
            inputs=self.inputs,
            outputs=self.outputs,
            places=self.places,
            quantity=self.quantity,
            effects=effects,
            smoothing=self.smoothing if smoothing is None else smoothing,
        )
        return eqx.tree_at(
            lambda m: m.parameters,
            made,
            made.parameters | {n: p for n, p in parameters.items() if n in made.parameters},
        )

    def _effect_names(self) -> set[str]:
        return {f"{e.joint}.{e.name}.{f}" for e in self.effects for f in e.units}

    def effects_at(self, values: Values) -> tuple[AbstractEffect, ...]:
        """Its effects with these numbers, which may be traced."""
        found = []
        for effect in self.effects:
            for field in effect.units:
                number = values[f"{effect.joint}.{effect.name}.{field}"]
                effect = eqx.tree_at(operator.attrgetter(field), effect, number)
            found.append(effect)
        return tuple(found)

    def matrices_at(self, values: Mapping[str, Any]) -> tuple[Float[Array, "dof dof"], ...]:
        """M, D and K at these values of its parameters.

        **Raises:** `jaxfrf.InputError` where `matrices` gives anything else.
        """
        n, expected = len(self.inputs), "M, D and K, (dof, dof) each"
        with told("matrices", values, expected):
            made = tuple(jnp.asarray(x) for x in self.matrices(values))
        if len(made) != 3 or any(x.shape != (n, n) for x in made):
            shapes = ", ".join(str(x.shape) for x in made)
            raise input_error("result of matrices", f"shapes {shapes}", f"{expected}: ({n}, {n})", "Return M, D, K.")
        return made

    def response(self, frequency, values, point) -> Complex[Array, "freq out in"]:
        """G of the matrices alone, without the effects, under a held input's continuous equivalent: s^n C (M s^2 + D s
        + K)^-1 B."""
        s = 2j * jnp.pi * jnp.asarray(frequency)[:, None, None]
        M, D, K = self.matrices_at(values)
        G = self.outputs @ jnp.linalg.solve(M * s**2 + D * s + K, self.inputs + 0j)
        return G * s ** ("position", "velocity", "acceleration").index(self.quantity)


def _check_kinds(inputs, outputs, places, effects, smoothing) -> None:
    """Refuse arguments of a machine that are no numbers, or no such collections."""
    expect_real("inputs", inputs)
    expect_real("outputs", outputs)
    expect_number("smoothing", smoothing)
    if not isinstance(places, Mapping):
        raise input_error("places", said(places), "a table {name: (dof,)}", 'E.g. {"spring": [1, -1]}.')
    for name, place in places.items():
        expect_real(f"place {name!r}", place)
    if isinstance(effects, str) or not isinstance(effects, Iterable):
        raise input_error("effects", said(effects), "a list of effects", "Leave it out for none.")


def _with_numbers(effect: AbstractEffect, numbers: Mapping[str, Any]) -> AbstractEffect:
    """`numbers`: by the fields of its own class."""
    return dataclasses.replace(effect, **numbers)
