"""Quantities that follow from the parameters, with their intervals."""

import math
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import norm

from .._arguments import expect, expect_probability, said
from .._errors import input_error
from .fit import Fit


class Derived(eqx.Module):
    """A quantity that follows from fitted parameters.

    **Fields:** `value`, `std`: in its unit. `interval`: lowest and highest value.
    """

    value: float
    std: float
    interval: tuple[float, float]


def derived(
    fitted: Fit, function: Callable[[Mapping[str, jax.Array]], Mapping[str, jax.Array]], level: float = 0.95
) -> dict[str, Derived]:
    """Eigenfrequencies, damping ratios, ratios of parameters ... with what the fit knows of them.

    First order in the covariance of the fit (delta method), in the logarithm of quantities that are positive, so that
    their intervals stay so. It fails where a quantity bends over the width of its interval.

    **Arguments:** `fitted`: of `jaxfrf.fit`. `level`: of the intervals. `function`: from every parameter by name, in
    its unit, to scalars by name, in `jax.numpy`:
    `lambda p: {"antiresonance": jnp.sqrt(p["k"] / p["J2"]) / (2 * jnp.pi)}`.

    **Returns:** by name: value, standard deviation and interval, in the unit that the function gives.

    **Raises:** `jaxfrf.InputError` if `fitted` is no fit, `level` no probability, and where `function` gives anything
    but finite real scalars by name.

    **Source:** the delta method, e.g. Casella & Berger, Statistical Inference, 2nd ed. 2002, section 5.5.4.
    """
    expect("fitted", fitted, Fit)
    expect_probability("level", level)
    x, cov = jnp.asarray(fitted.x), np.asarray(fitted.uncertainty.cov)
    at = lambda x: {name: jnp.asarray(v, float) for name, v in function(fitted.coordinates.values(x)).items()}
    values, slopes = _scalars(function, fitted.coordinates.values(x)), jax.jacfwd(at)(x)
    reach = float(norm.ppf(0.5 + level / 2))
    found: dict[str, Derived] = {}
    for name, value in values.items():
        slope = np.asarray(slopes[name])
        std = math.sqrt(max(float(slope @ cov @ slope), 0.0))
        if value > 0:
            factor = math.exp(min(reach * std / value, 700.0))
            found[name] = Derived(value, std, (value / factor, value * factor))
        else:
            found[name] = Derived(value, std, (value - reach * std, value + reach * std))
    return found


def _scalars(function, parameters: Mapping[str, jax.Array]) -> dict[str, float]:
    """What the function gives; an error unless that is finite real scalars by name."""
    try:
        found = function(parameters)
    except KeyError as error:
        raise input_error(
            "function", f"a parameter {error}", f"one of {', '.join(parameters)}", "Take one of the fit's names."
        ) from error
    if not isinstance(found, Mapping):
        raise input_error("function", f"{said(found)} as its result", "scalars by name", 'Return {"name": value}.')
    for name, value in found.items():
        x = np.asarray(value)
        if x.dtype.kind not in "iuf" or x.ndim or not np.isfinite(x):
            shown = said(value) if x.ndim else str(x)
            raise input_error(f"function: {name!r}", shown, "a finite real number", "Derive one number each.")
    return {name: float(value) for name, value in found.items()}
