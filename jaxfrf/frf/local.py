"""Local parametric estimators: LPM, LRM-MISO, LRM-MIMO, from one experiment or from all of them stacked.

In a window of w lines around line k, with the local variable x (0 at line k), the response from inputs X to outputs Z
is a polynomial N(x) = sum_s N_s x^s or a fraction D(x)^-1 N(x), D(0) = I:

    Z_j = sum_s x_j^s N_s X_j - sum_{s>=1} x_j^s D_s Z_j + T(x_j) + V_j,      G = N_0,

linear in the unknowns (Zimmermann & Moberg, Section II.B-C; Pintelon et al. 2010; Voorhoeve et al. 2018). Several
experiments at one operating point are *stacked*: they share N and D, so the least width falls from
(R+1) n_in + R n_out lines to that number over n_exp. At one line wide and R = 0 the stacked estimator is H1.
"""

import math
import numbers

import numpy as np

from .._annotated import check_fields
from .._errors import input_error
from .._text import counted
from ..spectra import Spectra
from .least_squares import AbstractLeastSquares
from .method import Signals
from .window import Windows, windows


class AbstractLocal(AbstractLeastSquares):
    """Options of every local method.

    - `order`: R, order of the polynomials.
    - `width`: lines in a window; `None` takes a few more than are needed (see `default_width`).
    - `variable`: local variable, `index` of the line in the list of excited lines (the paper's, the default: the
      excitation decides where lines are dense, and lines are as informative as they are dense) or `frequency`.
    - `transient`: order of a transient polynomial for records that are not in steady state; `None` for periodic data.
    """

    order: int = 2
    width: int | None = None
    variable: str = "index"
    transient: int | None = None

    def __check_init__(self):
        check_fields(self)
        for name in ("order", "width", "transient"):
            value = getattr(self, name)
            least = 1 if name == "width" else 0
            if value is not None and (not isinstance(value, numbers.Integral) or value < least):
                raise input_error(
                    name, repr(value), f"a whole number, {least} or more", f"Choose e.g. {name}={least + 2}."
                )
        if self.variable not in ("index", "frequency"):
            raise input_error("variable", repr(self.variable), "index or frequency", "Choose one of them.")

    @property
    def polynomial_order(self) -> int:
        return self.order

    @property
    def transient_order(self) -> int | None:
        return self.transient

    def windows(self, spectra: Spectra | Signals, n_parameters: int) -> Windows:
        n_lines, least = len(spectra.frequency), math.ceil(n_parameters / spectra.n_exp)
        if least > n_lines:
            raise input_error(
                "lines",
                f"{n_lines} lines with {counted(spectra.n_exp, 'experiment')}",
                f"at least {least} for {n_parameters} unknowns in a window",
                "Use more lines (for a record that is not periodic: --band LOW:HIGH), lower the order, or stack more "
                "experiments.",
            )
        width = default_width(n_parameters, spectra.n_exp, n_lines) if self.width is None else self.width
        if width < least:
            raise input_error(
                "width",
                f"a window of {width} lines with {counted(spectra.n_exp, 'experiment')}",
                f"at least {least} ({n_parameters} unknowns); more leave a residual to estimate the noise from",
                "Widen the window, lower the order, or stack more experiments.",
            )
        return windows(np.arange(n_lines) if self.variable == "index" else spectra.frequency, width)


class LPM(AbstractLocal):
    """Local polynomial method: G is a polynomial of order R in every window (Pintelon et al. 2010, Part I).

    Biased where G bends within a window, as at lightly damped resonances and antiresonances; exact on polynomials of
    order R. Least width (R+1) n_in / n_exp lines.

    **Arguments:**

    - `order`: R. `width`: lines in a window; `None` takes a few more than are needed.
    - `variable`: local variable x, `index` of the excited line (the paper's) or `frequency`.
    - `transient`: order of a transient polynomial for records that are not in steady state; `None` for periodic data.
      For a record without a period `jaxfrf.estimate` takes R and, without a `width`, windows as `jaxfrf.Auto` does.

    **Raises:** `jaxfrf.InputError` for options of no sense; in `jaxfrf.estimate` for too few lines or too narrow a
    window.

    **Source:** Pintelon, Schoukens, Vandersteen & Barbé, Mech. Syst. Signal Process. 24 (2010) 573-595; Zimmermann &
    Moberg, section II.B. The paper takes one experiment at a time; here all share a window.
    """

    @property
    def has_denominator(self) -> bool:
        return False

    def fractions(self, n_target: int):
        return (tuple(range(n_target)),)


class LRM(AbstractLocal):
    """Local rational method with the full matrix fraction D(x)^-1 N(x), "LRM-MIMO" (Voorhoeve et al. 2018, no. 3).

    Every output is regressed on all inputs and all outputs. Exact on noise-free rational responses of its orders.
    The linearised residual D V weighs the ends of the window too heavily: with noise, resonances come out too
    damped, and in closed loop, without the reference, the noise in u adds a bias that wide windows make
    worse; `jaxfrf.JointInputOutput` removes that one. Least width ((R+1) n_in + R n_out) / n_exp lines.

    **Arguments:**

    - `order`: R. `width`: lines in a window; `None` takes a few more than are needed.
    - `variable`: local variable x, `index` of the excited line (the paper's) or `frequency`.
    - `transient`: order of a transient polynomial for records that are not in steady state; `None` for periodic data.
      For a record without a period `jaxfrf.estimate` takes R and, without a `width`, windows as `jaxfrf.Auto` does.

    **Raises:** `jaxfrf.InputError` for options of no sense; in `jaxfrf.estimate` for too few lines or too narrow a
    window.

    **Source:** McKelvey & Guérin, SYSID 2012 (local fractions); Voorhoeve, van der Maas & Oomen, Mech. Syst. Signal
    Process. 105 (2018) 129-152; Zimmermann & Moberg, section II.C.2. The paper takes one experiment at a time; here all
    share a window.
    """

    @property
    def has_denominator(self) -> bool:
        return True

    def fractions(self, n_target: int):
        return (tuple(range(n_target)),)


class MisoLRM(AbstractLocal):
    """Local rational method with one scalar denominator per output, "LRM-MISO" (Voorhoeve et al. 2018, no. 2).

    As `LRM`, but outputs do not appear in each other's equations: fewer unknowns, and a bias where the outputs
    share poles that one scalar polynomial of order R cannot hold. Least width ((R+1) n_in + R) / n_exp lines.

    **Arguments:**

    - `order`: R. `width`: lines in a window; `None` takes a few more than are needed.
    - `variable`: local variable x, `index` of the excited line (the paper's) or `frequency`.
    - `transient`: order of a transient polynomial for records that are not in steady state; `None` for periodic data.
      For a record without a period `jaxfrf.estimate` takes R and, without a `width`, windows as `jaxfrf.Auto` does.

    **Raises:** `jaxfrf.InputError` for options of no sense; in `jaxfrf.estimate` for too few lines or too narrow a
    window.

    **Source:** Voorhoeve, van der Maas & Oomen, Mech. Syst. Signal Process. 105 (2018) 129-152; Zimmermann & Moberg,
    section II.C.1. The paper takes one experiment at a time; here all share a window.
    """

    @property
    def has_denominator(self) -> bool:
        return True

    def fractions(self, n_target: int):
        return tuple((i,) for i in range(n_target))


def default_width(n_parameters: int, n_exp: int, n_lines: int) -> int:
    """A window a little wider than needed: for one experiment an eighth more lines than unknowns, at least two (the
    paper: "slightly larger than w_min"); for stacked experiments not below 24 lines or the number of unknowns, because
    the noise of a narrow window outweighs the bias of a wider one there."""
    least = math.ceil(n_parameters / n_exp)
    width = least + max(2, math.ceil(least / 8))
    return min(width if n_exp == 1 else max(width, min(n_parameters, 24)), n_lines)
