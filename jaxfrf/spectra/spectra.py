"""Fourier coefficients of an experiment, and parts of them."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float, Int

from .._arguments import as_band, expect, expect_whole
from .._errors import input_error
from .._text import number
from .._types import Array
from ..experiment import QUANTITIES, Source
from ..units import differentiated, expect_quantity


class Spectra(eqx.Module):
    """Fourier coefficients X(k) = 1/N sum_t x(t) exp(-2 pi j k t / N) of the mean steady period.

    **Fields:**

    - `U`, `Y`, `R`: input, output, reference, (pos, exp, freq, channel); `R` is `None` where it was not recorded.
    - `lines`, `frequency`: DFT lines (freq,) and their frequencies, Hz.
    - `noise`: covariance of [Y; U] (mean over the periods) that the scatter between periods shows,
      (pos, exp, freq, sig, sig); `None` with fewer than two periods.
    - `n_periods`: periods averaged. `periodic`: false where the record was taken whole (`record_spectra`).
      `at_rest`: whether runs are taken to begin and end at rest then, so that no transient stands beside G U.
    - `segments`: of every experiment that stand for experiments here (`segment_spectra`); 0 otherwise.
    - `q`, `fs`, `period`, `y_quantity`, `u_unit`, `y_unit`, `sources`, `warnings`: as in `Experiment`.
    """

    U: Complex[Array, "pos exp freq in"]
    Y: Complex[Array, "pos exp freq out"]
    R: Complex[Array, "pos exp freq ref"] | None
    lines: Int[Array, "freq"]
    frequency: Float[Array, "freq"]
    noise: Complex[Array, "pos exp freq sig sig"] | None
    q: Float[Array, "pos joint"] | None = None
    fs: float = eqx.field(static=True, default=1.0)
    period: int = eqx.field(static=True, default=0)
    n_periods: int = eqx.field(static=True, default=1)
    periodic: bool = eqx.field(static=True, default=True)
    at_rest: bool = eqx.field(static=True, default=False)
    segments: int = eqx.field(static=True, default=0)
    y_quantity: str = eqx.field(static=True, default="velocity")
    u_unit: str = eqx.field(static=True, default="")
    y_unit: str = eqx.field(static=True, default="")
    sources: tuple[Source, ...] = eqx.field(static=True, default=())
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        for name in ("Y", "R"):
            x = getattr(self, name)
            if x is not None and x.shape[:3] != self.U.shape[:3]:
                raise ValueError(f"{name} has shape {x.shape}, U {self.U.shape}; expected the same first three axes.")
        if self.U.shape[2] != len(self.lines):
            raise ValueError(f"U holds {self.U.shape[2]} lines, `lines` {len(self.lines)}; expected as many.")

    @property
    def leaks(self) -> bool:
        """Whether a transient stands beside G U; only methods with a transient term can use it."""
        return not self.periodic and not self.at_rest

    @property
    def n_pos(self) -> int:
        return self.U.shape[0]

    @property
    def n_exp(self) -> int:
        return self.U.shape[1]

    @property
    def n_in(self) -> int:
        return self.U.shape[3]

    @property
    def n_out(self) -> int:
        return self.Y.shape[3]

    @property
    def n_real(self) -> int:
        """Blocks M of n_in experiments; experiments beyond the last whole block are not counted."""
        return self.n_exp // self.n_in


def select_band(spectra: Spectra, low: float | None, high: float | None) -> Spectra:
    """The same spectra at the lines from `low` to `high` (Hz) only.

    **Arguments:** `spectra`: (pos, exp, freq, channel). `low`, `high`: Hz, both included; `None`: open.

    **Returns:** `Spectra` with fewer lines, and nothing else changed.

    **Raises:** `jaxfrf.InputError` if `spectra` are none, for ends that are no numbers, or if no line is left.
    """
    expect("spectra", spectra, Spectra)
    low, high = as_band((low, high))
    inside = (spectra.frequency >= low) & (spectra.frequency <= high)
    if not inside.any():
        raise input_error(
            "band",
            f"no excited line between {low:g} and {high:g} Hz",
            f"a part of {number(spectra.frequency[0], 4)} to {number(spectra.frequency[-1], 4)} Hz",
            "Widen the band.",
        )

    signals = changed_signals(spectra, lambda x: x[:, :, inside])
    return dataclasses.replace(spectra, **signals, lines=spectra.lines[inside], frequency=spectra.frequency[inside])


def select_positions(spectra: Spectra, positions: slice | Sequence[int] | Int[Array, "pos"]) -> Spectra:
    """The same spectra at some operating points only, `q` with them.

    **Arguments:** `spectra`: (pos, exp, freq, channel). `positions`: a slice, or a list of indices from 0.

    **Returns:** `Spectra` of these positions, in this order.

    **Raises:** `jaxfrf.InputError` if `spectra` are none, and for no position or one that is not there.
    """
    expect("spectra", spectra, Spectra)
    try:
        there: np.ndarray = np.arange(spectra.n_pos)[
            positions if isinstance(positions, slice) else np.asarray(positions)
        ]
    except (IndexError, TypeError, ValueError):
        there = np.zeros(0, int)
    if np.ndim(there) != 1 or not len(there):
        raise input_error(
            "positions",
            f"{positions}",
            f"one or more of 0 to {spectra.n_pos - 1}, in a list or as a slice",
            "Count from 0.",
        )
    q = None if spectra.q is None else spectra.q[positions]
    return dataclasses.replace(spectra, **changed_signals(spectra, lambda x: x[positions]), q=q)


def changed_signals(spectra: Spectra, change: Callable[[Array], Array]) -> dict[str, Any]:
    """`change` applied to U, Y, R and the noise covariance, as far as they are there, by field name."""
    names = [name for name in ("U", "Y", "R", "noise") if getattr(spectra, name) is not None]
    return {name: change(getattr(spectra, name)) for name in names}


def differentiate(
    X: Complex[Array, "*batch freq channel"], omega: Float[Array, "freq"], times: int
) -> Complex[Array, "*batch freq channel"]:
    """Spectra `X` differentiated `times` times: times (j `omega`)^times, `omega` in rad/s.

    **Arguments:** `X`: Fourier coefficients, (*batch, freq, channel), of any unit. `omega`: (freq,), rad/s. `times`:
    whole number; negative ones integrate, where no `omega` is 0.

    **Returns:** (*batch, freq, channel), unit of `X` by s^-`times`.

    **Raises:** `jaxfrf.InputError` for `times` that are no whole number.

    **Source:** closed form.
    """
    expect_whole("times", times, None)
    return X * ((1j * np.asarray(omega)) ** times)[:, None]


def with_output_quantity(spectra: Spectra, quantity: str) -> Spectra:
    """The same spectra with the output as `position`, `velocity` or `acceleration`, by (j omega)^n.

    **Arguments:** `quantity`: of the new Y. Spectra hold the old one as `y_quantity`.

    **Returns:** `Spectra` with Y, its noise covariance and its unit changed, by (j omega)^n, n the difference of the
    derivatives.

    **Raises:** `jaxfrf.InputError` if `spectra` are none, or for any other quantity.

    **Source:** closed form.
    """
    expect("spectra", spectra, Spectra)
    expect_quantity("quantity", quantity)
    times = QUANTITIES[quantity] - QUANTITIES[spectra.y_quantity]
    factor = (2j * np.pi * np.asarray(spectra.frequency)) ** times
    noise = spectra.noise
    if noise is not None:
        scale = np.ones((len(factor), noise.shape[-1]), complex)
        scale[:, : spectra.n_out] = factor[:, None]
        noise = noise * scale[:, :, None] * scale[:, None, :].conj()
    unit = differentiated(spectra.y_unit, times) if spectra.y_unit else ""
    return dataclasses.replace(spectra, Y=spectra.Y * factor[:, None], noise=noise, y_quantity=quantity, y_unit=unit)
