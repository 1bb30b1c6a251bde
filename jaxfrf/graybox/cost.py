"""The weighted logarithmic cost between measured and modelled frequency responses, a function of the parameters.

    V(theta) = sum_{pos, freq} E^H W E,   E = log(G_hat / G(theta)), element by element, phase by its principal value

(Zimmermann & Moberg, eq. (22); Wernholt & Moberg, IFAC World Congress 2008).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, PyTree

from .._errors import input_error
from .._types import Array, require_x64
from ..frf import FRF
from .model import AbstractModel
from .own import response_shape
from .parameter import Coordinates
from .target import Target, Weights, target

_PLACES = 400  # lines of all positions that are worked on at the same time


class Cost(eqx.Module):
    """V(x), a JAX function of the parameters: `jax.grad`, `jax.hessian`, `jax.vmap` and `jax.jit` take it as it is.

    Made by `cost_function`. x is the vector of `coordinates`: ln(value) of positive parameters, bending over at their
    bounds, so that every x stands for parameters that are allowed.

    **Fields:** `model`, `coordinates`: of x. `frequency`: Hz, (freq,). The others as in `Target`; `log_G` is less its
    shift.
    """

    model: AbstractModel
    coordinates: Coordinates
    frequency: Float[Array, "freq"]
    log_G: Complex[Array, "pos freq vec"]
    magnitude: Float[Array, "pos freq vec"]
    phase: Float[Array, "pos freq vec"]
    whitener: Complex[Array, "pos freq vec vec"] | None
    used: Bool[Array, "pos freq vec"]
    points: PyTree

    def __init__(self, model: AbstractModel, coordinates: Coordinates, target: Target):
        self.model, self.coordinates = model, coordinates
        self.frequency = jnp.asarray(target.frequency)
        self.log_G = jnp.asarray(target.log_G - target.shift)
        self.magnitude, self.phase = jnp.asarray(target.magnitude), jnp.asarray(target.phase)
        self.whitener = None if target.whitener is None else jnp.asarray(target.whitener)
        self.used = jnp.asarray(target.used)
        self.points = jax.tree.map(jnp.asarray, target.points)

    def __hash__(self) -> int:
        """By identity, as functions are: `jax.jit` looks up what it has compiled by it."""
        return id(self)

    def __eq__(self, other) -> bool:
        return self is other

    @eqx.filter_jit
    def __call__(self, x: Float[Array, "parameter"]) -> Float[Array, ""]:
        """V(x)."""

        def one(position):
            residual, constant = self._residual(x, position)
            return jnp.sum(jnp.square(residual)) + constant

        return jnp.sum(jax.lax.map(one, self._positions()))

    @eqx.filter_jit
    def gram(self, x: Float[Array, "parameter"]) -> Float[Array, "column column"]:
        """[J r]^T [J r] of the weighted residuals r, V = r^T r, and J = dr/dx: half the Gauss-Newton matrix, half the
        gradient and V, everything that least squares needs.

        Summed over blocks of positions that fit the cache: J as a whole, 170 000 by 22 for seven positions of a robot,
        takes three times as long.
        """

        def one(position):
            def residual(x):
                r, constant = self._residual(x, position)
                return r, (r, constant)

            jacobian, (r, constant) = jax.jacfwd(residual, has_aux=True)(x)
            both = jnp.concatenate([jacobian, r[:, None]], axis=1)
            return (both.T @ both).at[-1, -1].add(constant)

        together = min(max(1, _PLACES // len(self.frequency)), len(self.log_G))
        return jnp.sum(jax.lax.map(one, self._positions(), batch_size=together), axis=0)

    @eqx.filter_jit
    def errors(
        self, x: Float[Array, "parameter"]
    ) -> tuple[Complex[Array, "pos freq vec"], Complex[Array, "pos freq vec parameter"]]:
        """E and d log G/dx at every position, not weighted, 0 where an element is left out."""

        def one(position):
            log_G, *_, used, point = position
            g, slope = at_position(self.model, self.coordinates, self.frequency, x, point)
            return _error(jnp.where(used, g, 1.0), log_G, used), jnp.where(used[..., None], slope, 0)

        return jax.lax.map(one, self._positions())

    @property
    def total(self) -> Float[Array, ""]:
        """Sum of the weights of all magnitudes and phases."""
        if self.whitener is not None:
            return jnp.asarray(float(self.log_G.size))
        return jnp.sum(jnp.square(self.magnitude)) + jnp.sum(jnp.square(self.phase))

    def _positions(self):
        return self.log_G, self.magnitude, self.phase, self.whitener, self.used, self.points

    def _residual(self, x, position):
        """Weighted residuals of one position, (real,), and what no parameter changes of their sum of squares."""
        log_G, magnitude, phase, whitener, used, point = position
        G = self.model.response(self.frequency, self.coordinates.values(x), point)
        if whitener is None and self.model.reciprocal(self.coordinates.moving):
            return _mirrored(G, log_G, magnitude, phase, used)
        error = _error(jnp.where(used, vec(G), 1.0), log_G, used)
        if whitener is not None:
            error = jnp.squeeze(whitener @ error[..., None], -1)
        return jnp.concatenate([(magnitude * error.real).ravel(), (phase * error.imag).ravel()]), jnp.zeros(())


def cost_function(model: AbstractModel, frf: FRF, weights: Weights | None = None, points: PyTree | None = None) -> Cost:
    """The cost that `jaxfrf.fit` minimises, as a function of the parameters.

    ```python
    cost = jf.graybox.cost_function(model, frf)
    x = cost.coordinates.start()            # at the model's start, in the order of cost.coordinates.names
    slope = jax.grad(cost)(x)
    several = jax.vmap(cost)(x + 0.1 * jax.random.normal(key, (20, x.size)))
    values = cost.coordinates.values(x)     # by name, in their units
    ```

    **Arguments:** `model`, `frf`, `weights`: as of `jaxfrf.fit`. `points`: operating points, leading axis (pos), as the
    model takes them; by default those of the FRF, by its `q` (rad).

    **Returns:** a `Cost`, without unit: the weighted sum of |log(G_measured/G_model)|^2, magnitude and phase apart.

    **Raises:** `jaxfrf.InputError` if FRF, model and weights do not fit together; `ValueError` in 32 bit.

    **Source:** Zimmermann & Moberg, section III.B (logarithmic errors, weighted).
    """
    require_x64("cost_function")
    check_quantity(model, frf)
    points = model.points(frf.q, frf.n_pos) if points is None else points
    tg = target(frf, Weights() if weights is None else weights, points)
    coordinates = Coordinates(model.parameters)
    check_shape(model, coordinates, tg, frf)
    return Cost(model, coordinates, tg)


def check_quantity(model: AbstractModel, frf: FRF) -> None:
    """A robot model says which quantity it gives; a model of the user's own gives what the user says."""
    expected = getattr(model, "quantity", frf.y_quantity)
    if frf.y_quantity != expected:
        raise input_error(
            "FRF",
            f"a response to {frf.y_quantity}",
            f"{expected}, which the model gives",
            f"Make the model with quantity={frf.y_quantity!r}, or convert the spectra (with_output_quantity).",
        )


def check_shape(model, coordinates, tg: Target, frf: FRF) -> None:
    sizes = {np.shape(a)[:1] for a in jax.tree.leaves(tg.points)}
    if sizes - {(frf.n_pos,)}:
        raise input_error(
            "points",
            f"arrays with a leading axis of {', '.join(str(*n) if n else 'none' for n in sizes)}",
            f"{frf.n_pos}, one for every operating point of the FRF",
            "Give one point for every position.",
        )
    point = jax.tree.map(lambda a: jnp.asarray(a)[0], tg.points)
    n_out, n_in = response_shape(model, coordinates, tg.frequency, point)[1:]
    if (n_out, n_in) != (frf.n_out, frf.n_in):
        raise input_error(
            "model",
            f"a response of {n_out} outputs and {n_in} inputs",
            f"{frf.n_out} and {frf.n_in} as in the FRF",
            "Use the model of this machine, or records with the model's channels.",
        )


def vec(G):
    """(..., out, in) to (..., out*in), columns stacked."""
    return jnp.swapaxes(G, -1, -2).reshape(*G.shape[:-2], -1)


def at_position(model: AbstractModel, coordinates: Coordinates, frequency, x, point):
    """G and d log G/dx at one operating point: (freq, vec), (freq, vec, parameter)."""

    def response(x):
        g = vec(model.response(frequency, coordinates.values(x), point))
        return g, g

    slope, g = jax.jacfwd(response, has_aux=True)(x)
    return g, slope / g[..., None]


@jax.custom_jvp
def _error(g, log_G, used):
    """E, zero where an element is left out: the phase of the ratio by its principal value, never a difference of
    angles. Where an element is left out g must be a number that is not 0."""
    size = jnp.where(used, log_G.real - jnp.log(jnp.abs(g)), 0.0)
    return jax.lax.complex(size, jnp.where(used, jnp.angle(jnp.exp(1j * log_G.imag) * jnp.conj(g)), 0.0))


@_error.defjvp
def _error_slope(primals, tangents):
    """dE = d log G_hat - dG/G: analytic, which magnitude and angle apart hide from autodiff."""
    g, log_G, used = primals
    change, measured, _ = tangents
    inverse = -1.0 / g
    real = change.real * inverse.real - change.imag * inverse.imag  # real products are faster than complex ones
    imag = change.real * inverse.imag + change.imag * inverse.real
    slope = jax.lax.complex(jnp.where(used, real, 0.0), jnp.where(used, imag, 0.0))
    return _error(g, log_G, used), slope + jnp.where(used, measured, 0.0)


def _mirrored(G, log_G, magnitude, phase, used):
    """Residuals where an element and its mirror image have the same slopes: their weighted mean, in place of both.

    With w^2 = u^2 + v^2, (u e)^2 + (v f)^2 = (u^2 e + v^2 f)^2 / w^2 + (u v (e - f))^2 / w^2, and e - f is constant.
    """
    n = G.shape[-1]
    out, into = np.triu_indices(n)
    one, other = into * n + out, out * n + into  # their places in vec G
    share = np.where(one == other, 0.5, 1.0)
    error = jax.lax.stop_gradient(_error(jnp.where(used, vec(G), 1.0), log_G, used))
    either = used[:, one] | used[:, other]
    upper = _error(jnp.where(either, G[:, out, into], 1.0), log_G[:, one], either)
    change = upper - jax.lax.stop_gradient(upper)  # 0, with the slopes

    def part(weight, e, change):
        weight = jnp.square(weight)
        both = share * (weight[:, one] + weight[:, other])
        mean = share * ((weight * e)[:, one] + (weight * e)[:, other]) / jnp.where(both > 0, both, 1.0)
        constant = jnp.sum(weight * jnp.square(e)) - jnp.sum(both * jnp.square(mean))
        return (jnp.sqrt(both) * (mean + change)).ravel(), constant

    (real, one_part), (imag, other_part) = (
        part(magnitude, error.real, change.real),
        part(phase, error.imag, change.imag),
    )
    return jnp.concatenate([real, imag]), one_part + other_part
