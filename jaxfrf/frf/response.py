"""The frequency response function with its uncertainty."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Complex, Float, Int

from .._arguments import expect_each
from .._errors import input_error
from .._types import Array
from ..experiment import Source
from ..units import response_unit
from .covariance import AbstractFactors, variances


class FRF(eqx.Module):
    """Estimated frequency response functions G = dy/du, with their covariance, at several operating points.

    **Fields:**

    - `G`: (pos, freq, out, in), complex; unit of y over unit of u.
    - `frequency`: (freq,), Hz.
    - `cov`: covariance of vec(G) (columns stacked: element `j*n_out + i` is G[i, j]), (pos, freq, vec, vec),
      E[(g - Eg)(g - Eg)^H]; NaN where the method had no residual degree of freedom. Estimates of local methods
      at neighbouring lines share data: see `window`. It may be kept as factors (`jaxfrf.frf.KroneckerSum`), which
      can be used like the array and are written out by `numpy.asarray(frf.cov)`; files hold them, too.
    - `dof`: residual degrees of freedom behind `cov`, (pos, freq); intervals use them (F quantiles).
    - `status`: bits of `jaxfrf.Status`, (pos, freq).
    - `cov_noise`: part of `cov` that measurement noise explains (scatter between periods); `None` with one period.
    - `cov_total`: noise and nonlinear distortion together, without bias: from the scatter between realisations, or the
      unexcited lines (`jaxfrf.with_distortion`); `None` if unknown.
    - `bias`: smoothing bias that the data show, rms, (pos, freq, out, in), in `cov` already; `None` where none was
      looked for (methods without windows, `Auto`, whose `cov` is a mean square error) or could be.
    - `window`: lines that took part in each estimate, (pos, freq); 1 for classical methods. The band holds about
      `sum(1/window)` independent estimates.
    - `q`: arm configurations, (pos, joint), rad, or `None`.
    - `method`: name and options as text. `y_quantity`: what y is. `u_unit`, `y_unit`: SI units (`jaxfrf.units`),
      those of a robot's motors where empty. `sources`, `version`, `warnings`: provenance.
    """

    G: Complex[Array, "pos freq out in"]
    frequency: Float[Array, "freq"]
    cov: AbstractFactors | Complex[Array, "pos freq vec vec"]
    dof: Float[Array, "pos freq"]
    status: Int[Array, "pos freq"]
    window: Float[Array, "pos freq"]
    cov_noise: AbstractFactors | Complex[Array, "pos freq vec vec"] | None = None
    cov_total: AbstractFactors | Complex[Array, "pos freq vec vec"] | None = None
    bias: Float[Array, "pos freq out in"] | None = None
    q: Float[Array, "pos joint"] | None = None
    method: str = eqx.field(static=True, default="")
    y_quantity: str = eqx.field(static=True, default="velocity")
    u_unit: str = eqx.field(static=True, default="")
    y_unit: str = eqx.field(static=True, default="")
    sources: tuple[Source, ...] = eqx.field(static=True, default=())
    warnings: tuple[str, ...] = eqx.field(static=True, default=())
    version: str = eqx.field(static=True, default="")

    def __check_init__(self):
        shape = self.G.shape
        if len(shape) != 4 or shape[1] != len(self.frequency):
            raise ValueError(
                f"G has shape {shape} with {len(self.frequency)} frequencies; expected (pos, freq, out, in)."
            )
        if isinstance(self.frequency, np.ndarray):
            _check_frequency(self.frequency)
        vec = shape[2] * shape[3]
        for name in ("cov", "cov_noise", "cov_total"):
            value = getattr(self, name)
            if value is not None and value.shape != (*shape[:2], vec, vec):
                raise ValueError(f"{name} has shape {value.shape}; expected {(*shape[:2], vec, vec)}.")
        for name in ("dof", "status", "window"):
            found = np.shape(getattr(self, name))
            if found != shape[:2]:
                raise ValueError(f"{name} has shape {found}; expected (pos, freq), {shape[:2]}.")
        if self.q is not None and (np.ndim(self.q) != 2 or len(self.q) != shape[0]):
            raise ValueError(f"q has shape {np.shape(self.q)}; expected (pos, joint) of {shape[0]} positions.")

    @property
    def n_pos(self) -> int:
        return self.G.shape[0]

    @property
    def n_out(self) -> int:
        return self.G.shape[2]

    @property
    def n_in(self) -> int:
        return self.G.shape[3]

    @property
    def std(self) -> Float[Array, "pos freq out in"]:
        """Standard deviation of every element of G, sqrt(E|G - EG|^2): (pos, freq, out, in)."""
        variance = np.asarray(variances(self.cov))
        return np.sqrt(np.maximum(variance, 0)).reshape(*self.G.shape[:2], self.n_in, self.n_out).swapaxes(-1, -2)


def _check_frequency(frequency: np.ndarray) -> None:
    if len(frequency) and not (frequency[0] >= 0 and frequency[-1] < np.inf and (frequency[1:] > frequency[:-1]).all()):
        raise input_error(
            "frequency",
            "values that are NaN or Inf, below zero, or do not increase",
            "finite frequencies in Hz, each above the one before",
            "Sort them, G and its covariance along.",
        )


def concatenate_positions(frfs: Sequence[FRF]) -> FRF:
    """FRFs of different operating points, same lines and method, as one.

    **Arguments:** `frfs`: each (pos, freq, out, in), at the same frequencies (Hz).

    **Returns:** an FRF of all positions, in this order; what one of them lacks (`None`) none has.

    **Raises:** `jaxfrf.InputError` for what is no list of FRFs, and where lines, inputs, outputs, units or numbers of
    arm angles differ.
    """
    expect_each("frfs", frfs, FRF)
    first = frfs[0]
    for number, other in enumerate(frfs[1:], start=1):
        _check_alike(first, other, number)

    def join(name):
        parts = [getattr(x, name) for x in frfs]
        return None if any(x is None for x in parts) else _joined(parts)

    names = ("G", "cov", "dof", "status", "window", "cov_noise", "cov_total", "bias", "q")
    warnings = tuple(dict.fromkeys(w for x in frfs for w in x.warnings))
    return dataclasses.replace(first, **{name: join(name) for name in names}, warnings=warnings)


def _check_alike(first: FRF, other: FRF, number: int) -> None:
    """Refuse an FRF that cannot stand behind the first one."""
    angles = lambda x: "none" if x.q is None else f"{np.shape(x.q)[-1]}"
    told = {
        "lines": lambda x: f"{len(x.frequency)} from {x.frequency[0]:g} to {x.frequency[-1]:g} Hz",
        "outputs and inputs": lambda x: f"{x.n_out} and {x.n_in}",
        "unit": response_unit,
        "arm angles": angles,
    }
    same_lines = np.shape(first.frequency) == np.shape(other.frequency) and np.allclose(
        first.frequency, other.frequency, rtol=1e-9, atol=0.0
    )
    for what, say in told.items():
        alike = same_lines if what == "lines" else say(first) == say(other)
        if what == "arm angles" and "none" in (say(first), say(other)):
            continue  # then no position has angles
        if not alike:
            raise input_error(
                f"{what} of frfs[{number}]",
                say(other),
                f"{say(first)}, those of frfs[0]",
                "Estimate them alike, or keep them apart.",
            )


def _joined(parts):
    """Arrays, or covariances as factors of the same kind, after each other."""
    structure = jax.tree.structure(parts[0])
    if all(isinstance(x, AbstractFactors) and jax.tree.structure(x) == structure for x in parts):
        shapes = [[leaf.shape[1:] for leaf in jax.tree.leaves(x)] for x in parts]
        if all(shape == shapes[0] for shape in shapes):
            return jax.tree.map(lambda *x: np.concatenate(x), *parts)
    return np.concatenate([np.asarray(x) for x in parts])
