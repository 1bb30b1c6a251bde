"""To and from python-control, which keeps (out, in, freq) and rad/s."""

from typing import Any

import numpy as np
from jaxtyping import Float

from .._arguments import expect, expect_index
from .._errors import input_error
from .._types import Array
from ..frf import FRF
from ._optional import require
from .responses import frf_from_arrays


def to_control(frf: FRF, pos: int = 0) -> Any:
    """The FRF at one operating point as `control.FrequencyResponseData`: axes (out, in, freq), omega in
    rad/s.

    The covariance has no place there, and NaN at lines without an estimate stay NaN. Inputs are named `u[j]`,
    outputs `y[i]`.

    **Arguments:** `frf`: (pos, freq, out, in), frequencies in Hz. `pos`: operating point, from 0.

    **Returns:** a `control.FrequencyResponseData`.

    **Raises:** `jaxfrf.InputError` if there is no such operating point; `ImportError` without python-control.
    """
    expect("frf", frf, FRF)
    expect_index("pos", pos, frf.n_pos)
    control = require("control", "control")
    return control.FrequencyResponseData(
        np.moveaxis(np.asarray(frf.G[pos]), 0, -1),
        2 * np.pi * np.asarray(frf.frequency),
        inputs=[f"u[{j}]" for j in range(frf.n_in)],
        outputs=[f"y[{i}]" for i in range(frf.n_out)],
    )


def from_control(system: Any, frequency: Float[Array, "freq"] | None = None, *, y_quantity: str = "velocity") -> FRF:
    """An FRF, without a covariance, from a python-control system.

    **Arguments:**

    - `system`: `control.FrequencyResponseData`, or any linear system (`StateSpace`, `TransferFunction`,
      discrete too), which is evaluated at `frequency`: G(j omega), or G(exp(j omega dt)). Frequencies in any
      order.
    - `frequency`: (freq,), Hz; only for systems that are not frequency response data, which bring their own.
    - `y_quantity`: what the output is.

    **Raises:** `jaxfrf.InputError` if `frequency` is missing or surplus, `system` is no linear system, or its
    sampling time is unknown.
    """
    control = require("control", "control")
    if isinstance(system, control.FrequencyResponseData):
        if frequency is not None:
            raise input_error(
                "frequency", "frequencies", "none: frequency response data bring their own", "Leave it out."
            )
        G, frequency = system.frdata, np.asarray(system.omega) / (2 * np.pi)
    elif isinstance(system, control.lti.LTI):
        G, frequency = system(_points(system, frequency), squeeze=False), np.asarray(frequency)
    else:
        raise input_error("system", type(system).__name__, "a linear system of python-control", "Convert it.")
    return frf_from_arrays(np.moveaxis(np.asarray(G), -1, 0), frequency, y_quantity=y_quantity)


def _points(system, frequency) -> np.ndarray:
    """Where in the complex plane to evaluate the system."""
    if frequency is None:
        raise input_error("frequency", "none", "frequencies in Hz at which to evaluate the system", "Give them.")
    s = 2j * np.pi * np.atleast_1d(np.asarray(frequency, float))
    if system.isctime():
        return s
    if system.dt is True:
        raise input_error("dt", "a discrete system without a sampling time", "seconds", "Set system.dt.")
    return np.exp(s * system.dt)
