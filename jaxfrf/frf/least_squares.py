"""Estimators that are one linear least-squares problem in every window: the model, its solution, its covariance."""

import abc

import equinox as eqx
import jax
import numpy as np

from .._errors import input_error
from .._status import Status
from ..spectra import Spectra
from .combine import direct, through_ratio
from .method import AbstractMethod, Estimate
from .regression import PIVOT, RESIDUAL, Equation, Solution, equation_of_target, solve_gram, solve_rows
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

    def shared_parameters(self, n_target: int) -> float:
        """Unknowns per target that the equations do not count, because all targets share them."""
        return 0.0

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
    spent = n_parameters + method.shared_parameters(sum(z.shape[-1] for z in targets))
    dof = spectra.n_exp * windows.width - spent
    place = (windows.coordinate, windows.start, windows.start + windows.width)
    solution = jax.device_get(_solve(signals, place, span_of(windows), columns, equations))
    shape = solution.pivot.shape
    doubtful = ~((solution.pivot > PIVOT) & ((solution.residual > RESIDUAL) | (dof <= 0)))
    solution, missing = _refined(solution, doubtful, signals, windows, columns, equations)
    dofs = dof + missing
    G, cov = combine(solution, tuple(equation_of_target(equations)), dofs)
    flags = {
        Status.EDGE_WINDOW: np.broadcast_to(~windows.centred, shape),
        Status.REFINED: doubtful,
        Status.RANK_DEFICIENT: missing > 0,
        Status.NO_COVARIANCE: dofs <= 0,
    }
    return Estimate(
        G=G,
        cov=cov,
        dof=dofs,
        status=sum(np.where(where, int(flag), 0) for flag, where in flags.items()),
        window=np.full(shape, float(windows.width)),
    )


def _refined(solution: Solution, doubtful, signals, windows: Windows, columns: Columns, equations):
    """The solution with its doubtful windows solved again from their rows, and the rank missing there: (pos, freq)."""
    missing = np.zeros(doubtful.shape, int)
    if not doubtful.any():
        return solution, missing
    solution = jax.tree.map(np.array, solution)
    for pos in np.flatnonzero(doubtful.any(axis=1)):
        for lines in _batches(np.flatnonzero(doubtful[pos])):
            again, missing[pos, lines] = solve_rows(signals[pos], windows, columns, equations, lines)
            jax.tree.map(lambda old, new, at=(pos, lines): old.__setitem__(at, new), solution, again)
    return solution, missing


def _batches(lines, size: int = 64):
    return (lines[i : i + size] for i in range(0, len(lines), size))


@eqx.filter_jit
def _solve(signals, place, span: int, columns: Columns, equations) -> Solution:
    """Every window of every operating point, one point after the other: their moments fit the cache then."""
    return jax.lax.map(lambda s: gram(s, *place, span, columns, lambda A: solve_gram(A, equations)), signals)


def _signals(X, targets, transient: int | None) -> np.ndarray:
    """All signals side by side, with one constant per experiment where a transient is wanted: (pos, exp, freq, sig)."""
    parts = [np.asarray(X), *(np.asarray(z) for z in targets)]
    if transient is not None:
        n_pos, n_exp, n_freq = parts[0].shape[:3]
        own = np.broadcast_to(np.eye(n_exp)[:, None], (n_pos, n_exp, n_freq, n_exp))
        parts.append(own.astype(complex))
    return np.concatenate(parts, axis=-1)
