"""Local parametric estimators: LPM, LRM-MISO, LRM-MIMO, from one experiment or from all of them stacked.

In a window of w lines around line k, with the local variable x (0 at line k), the response from inputs X to outputs Z
is a polynomial N(x) = sum_s N_s x^s or a fraction D(x)^-1 N(x), D(0) = I:

    Z_j = sum_s x_j^s N_s X_j - sum_{s>=1} x_j^s D_s Z_j + T(x_j) + V_j,      G = N_0,

linear in the unknowns (Zimmermann & Moberg, Section II.B-C; Pintelon et al. 2010; Voorhoeve et al. 2018). Several
experiments at one operating point are *stacked*: they share N and D, so the least width falls from
(R+1) n_in + R n_out lines to that number over n_exp. At one line wide and R = 0 the stacked estimator is H1.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import input_error
from .._status import Status
from ..spectra import Spectra
from .combine import direct, through_ratio
from .method import AbstractMethod, Estimate
from .regression import PIVOT, RESIDUAL, Equation, equation_of_target, solve_gram, solve_rows
from .window import Columns, Windows, gram, span_of


class AbstractLeastSquares(AbstractMethod):
    """Estimators that are a linear least-squares problem in every window."""

    @property
    @abc.abstractmethod
    def polynomial_order(self) -> int:
        """R: order of the numerator, and of the denominator where there is one."""

    @abc.abstractmethod
    def fractions(self, n_target: int) -> tuple[tuple[int, ...], ...]:
        """Targets that share an equation, so that their denominators mix them: a partition of range(n_target)."""

    @property
    @abc.abstractmethod
    def has_denominator(self) -> bool:
        """Whether the local model is a fraction (LRM) or a polynomial (LPM)."""

    @property
    @abc.abstractmethod
    def transient_order(self) -> int | None:
        """Order of the transient polynomial T(x); `None`: the record is in steady state."""

    @abc.abstractmethod
    def windows(self, spectra: Spectra, n_parameters: int) -> Windows:
        """The windows, given the unknowns of one target."""

    def block_size(self, spectra: Spectra) -> int:
        return 1

    def check(self, spectra: Spectra) -> None:
        check_periodic(spectra, self)
        self.windows(spectra, self.n_parameters(spectra, spectra.n_in, spectra.n_out))

    def n_parameters(self, spectra: Spectra, n_top: int, n_target: int) -> int:
        """Unknowns of one target: the number of regressor columns of its equation."""
        order, transient = self.polynomial_order, self.transient_order
        shared = max(len(group) for group in self.fractions(n_target))
        return (
            (order + 1) * n_top
            + (order * shared if self.has_denominator else 0)
            + (0 if transient is None else (transient + 1) * spectra.n_exp)
        )

    def model(self, n_exp: int, n_top: int, n_targets: list[int]) -> tuple[Columns, tuple[Equation, ...]]:
        """Columns in the order transient, x^s X, x^s Z, x^0 X, x^0 Z, and the equations that use them."""
        order, transient = self.polynomial_order, self.transient_order
        n_target = sum(n_targets)
        top, target = range(n_top), range(n_top, n_top + n_target)
        constant = range(n_top + n_target, n_top + n_target + n_exp)
        column = [(p, s) for p in range(0 if transient is None else transient + 1) for s in constant]
        column += [(p, s) for p in range(1, order + 1) for s in top]
        if self.has_denominator:
            column += [(p, s) for p in range(1, order + 1) for s in target]
        column += [(0, s) for s in (*top, *target)]
        where = {pair: i for i, pair in enumerate(column)}
        equations = []
        first = n_top
        for n in n_targets:
            for group in self.fractions(n):
                own = {first + i for i in group}
                regressors = [
                    i
                    for i, (p, s) in enumerate(column)
                    if (p > 0 and s in own) or s in constant or (p > 0 and s in top)
                ]
                equations.append(
                    Equation(
                        regressors=tuple(regressors) + tuple(where[0, s] for s in top),
                        targets=tuple(where[0, s] for s in sorted(own)),
                        n_top=n_top,
                    )
                )
            first += n
        power, signal = zip(*column, strict=True)
        return Columns(power=power, signal=signal), tuple(equations)

    def estimate(self, spectra: Spectra) -> Estimate:
        """The response from u to y."""
        return regress(self, spectra, spectra.U, (spectra.Y,), direct)

    def joint(self, spectra: Spectra) -> Estimate:
        """The response from u to y as the ratio of those from r to y and to u; see `jaxfrf.JointInputOutput`."""
        return regress(self, spectra, spectra.R, (spectra.Y, spectra.U), through_ratio)


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
        for name in ("order", "width", "transient"):
            value = getattr(self, name)
            least = 1 if name == "width" else 0
            if value is not None and (value != int(value) or value < least):
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

    def windows(self, spectra: Spectra, n_parameters: int) -> Windows:
        least = math.ceil(n_parameters / spectra.n_exp)
        width = default_width(n_parameters, spectra.n_exp, len(spectra.lines)) if self.width is None else self.width
        if width < least:
            raise input_error(
                "width",
                f"a window of {width} lines with {spectra.n_exp} experiment(s)",
                f"at least {least} ({n_parameters} unknowns); more leave a residual to estimate the noise from",
                "Widen the window, lower the order, or stack more experiments.",
            )
        coordinate = np.arange(len(spectra.lines)) if self.variable == "index" else spectra.frequency
        return Windows(coordinate, width)


class LPM(AbstractLocal):
    """Local polynomial method: G is a polynomial of order R in every window (Pintelon et al. 2010, Part I).

    Biased where G bends within a window, as at lightly damped resonances and antiresonances; exact on polynomials of
    order R. Least width (R+1) n_in / n_exp lines. Fields: see `AbstractLocal`.
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
    Fields: see `AbstractLocal`.
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
    Fields: see `AbstractLocal`.
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


def check_periodic(spectra: Spectra, method: AbstractLeastSquares) -> None:
    if not spectra.periodic and method.transient_order is None:
        raise input_error(
            "spectra",
            "the spectra of a record that is not periodic",
            "whole steady periods, or a method with a transient term",
            "Use a local method with a transient term (option transient=2).",
        )


def regress(method: AbstractLeastSquares, spectra: Spectra, X, targets, combine) -> Estimate:
    """Regress the target signals on X in every window of every operating point, and combine into G and its covariance.

    `targets` is a tuple of spectra (pos, exp, freq, channel), each with a denominator of its own; `combine` takes a
    `Solution` and dof to (G, cov).
    """
    columns, equations = method.model(spectra.n_exp, X.shape[-1], [z.shape[-1] for z in targets])
    n_parameters = max(len(eq.regressors) for eq in equations)
    windows = method.windows(spectra, n_parameters)
    signals = _signals(X, targets, method.transient_order)
    dof = spectra.n_exp * windows.width - n_parameters
    of_target = tuple(equation_of_target(equations))
    place = tuple(jnp.asarray(x) for x in (windows.coordinate, windows.start, windows.start + windows.width))
    solved = _solve_all(
        jnp.asarray(signals), place, span_of(windows), columns, equations, combine, jnp.asarray(float(dof))
    )
    G, cov, pivot, residual = jax.device_get(solved)
    status = np.broadcast_to(np.where(windows.centred, 0, int(Status.EDGE_WINDOW)), G.shape[:2]).copy()
    dofs = np.full(G.shape[:2], float(dof))
    doubtful = ~((pivot > PIVOT) & ((residual > RESIDUAL) | (dof == 0)))
    if doubtful.any():
        G, cov = jax.tree.map(np.array, (G, cov))
        for pos in np.flatnonzero(doubtful.any(axis=1)):
            for lines in _batches(np.flatnonzero(doubtful[pos])):
                solution, missing = solve_rows(signals[pos], windows, columns, equations, lines)
                dofs[pos, lines] += missing
                new = combine(solution, of_target, dofs[pos, lines])
                jax.tree.map(lambda old, x, at=(pos, lines): old.__setitem__(at, x), (G, cov), new)
                status[pos, lines] |= np.where(
                    missing > 0, int(Status.REFINED | Status.RANK_DEFICIENT), int(Status.REFINED)
                )
    return Estimate(
        G=G,
        cov=cov,
        dof=dofs,
        status=np.where(dofs > 0, status, status | int(Status.NO_COVARIANCE)),
        window=np.full(G.shape[:2], float(windows.width)),
    )


def _batches(lines, size: int = 64):
    return (lines[i : i + size] for i in range(0, len(lines), size))


@eqx.filter_jit
def _solve_all(signals, place, span: int, columns: Columns, equations, combine, dof):
    def finish(A):
        solution = solve_gram(A, equations)
        return *combine(solution, tuple(equation_of_target(equations)), dof), solution.pivot, solution.residual

    return jax.lax.map(lambda s: gram(s, *place, span, columns, finish), signals)


def _signals(X, targets, transient: int | None) -> np.ndarray:
    """All signals side by side, with one constant per experiment where a transient is wanted: (pos, exp, freq, sig)."""
    parts = [np.asarray(X), *(np.asarray(z) for z in targets)]
    if transient is not None:
        n_pos, n_exp, n_freq = parts[0].shape[:3]
        own = np.broadcast_to(np.eye(n_exp)[:, None], (n_pos, n_exp, n_freq, n_exp))
        parts.append(own.astype(complex))
    return np.concatenate(parts, axis=-1)
