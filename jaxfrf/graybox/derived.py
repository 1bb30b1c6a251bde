"""Quantities that follow from the parameters, with their intervals."""

import math
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import norm

from .._arguments import expect
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

    **Raises:** `jaxfrf.InputError` if `fitted` is no fit.

    **Source:** the delta method, e.g. Casella & Berger, Statistical Inference, 2nd ed. 2002, section 5.5.4.
    """
    expect("fitted", fitted, Fit)
    x, cov = jnp.asarray(fitted.x), np.asarray(fitted.uncertainty.cov)
    at = lambda x: {name: jnp.asarray(v, float) for name, v in function(fitted.coordinates.values(x)).items()}
    values, slopes = at(x), jax.jacfwd(at)(x)
    reach = float(norm.ppf(0.5 + level / 2))
    found: dict[str, Derived] = {}
    for name, traced in values.items():
        slope, value = np.asarray(slopes[name]), float(traced)
        std = math.sqrt(max(float(slope @ cov @ slope), 0.0))
        if value > 0:
            factor = math.exp(min(reach * std / value, 700.0))
            found[name] = Derived(value, std, (value / factor, value * factor))
        else:
            found[name] = Derived(value, std, (value - reach * std, value + reach * std))
    return found
