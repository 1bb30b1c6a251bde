"""Estimators that are one linear least-squares problem in every window: the model, its solution, its covariance."""

import abc
import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex

from .._errors import input_error
from .._types import Array
from ..spectra import Spectra
from .combine import direct, through_ratio
from .gram import Columns
from .method import AbstractMethod, Estimate, Signals, flags
from .regression import PIVOT, RESIDUAL, Equations, solve_gram, solve_rows
from .window import Windows, over_windows, rows, side_by_side


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
    def windows(self, spectra: Spectra | Signals, n_parameters: int) -> Windows:
        """The windows, given the unknowns of one target."""

    @property
    def shares_lines(self) -> bool:
        return type(self).at_point is AbstractLeastSquares.at_point  # one of the user's may know of no parts

    def calls_lapack(self, spectra: Spectra, joint: bool = False) -> bool:
        return not side_by_side(self.plan(spectra, joint).columns, len(spectra.lines))

    def block_size(self, spectra: Spectra | Signals) -> int:
        return 1

    def check(self, spectra: Spectra) -> None:
        if self.transient_order is None:
            check_steady(spectra)
        self.windows(spectra, self.n_parameters(spectra, spectra.n_in, spectra.n_out))

    def n_parameters(self, spectra: Spectra | Signals, n_top: int, n_target: int) -> int:
        """Unknowns of one target: the number of regressor columns of its equation."""
        order, transient = self.polynomial_order, self.transient_order
        shared = max(len(group) for group in self.fractions(n_target))
        return (
            (order + 1) * n_top
            + (order * shared if self.has_denominator else 0)
            + (0 if transient is None else (transient + 1) * spectra.n_exp)
        )

    def shared_parameters(self, n_target: int) -> float:
        """Unknowns per target that the equations do not count, because all targets share them.

        Targets are those with a noise of their own: in closed loop that of u is that of y, fed back."""
        return 0.0

    def residual_dof(self, signals: Signals) -> float:
        return self.plan(signals, joint=False).dof

    def model(self, n_exp: int, n_top: int, n_targets: list[int]) -> tuple[Columns, Equations]:
        """The columns transient, x^s X, X of the numerators, and with each equation's own x^s Z its targets Z, s >= 1.

        Without denominators all targets are in one equation, and an equation that is alone has nothing of its own."""
        order, transient = self.polynomial_order, self.transient_order
        n_target = sum(n_targets)
        X, Z = range(n_top), range(n_top, n_top + n_target)
        constant = range(n_top + n_target, n_top + n_target + n_exp)
        common = [(p, s) for p in range(0 if transient is None else transient + 1) for s in constant]
        common += [(p, s) for p in range(1, order + 1) for s in X]
        groups = [tuple(Z)] if not self.has_denominator else self._groups(n_top, n_targets)
        own = [[(p, s) for p in range(1, order + 1) for s in group] for group in groups]
        own = own if self.has_denominator else [[]]
        if len(groups) == 1:
            common, own = common + own[0], [[]]
        common += [(0, s) for s in X]
        most, most_targets = max(len(x) for x in own), max(len(x) for x in groups)
        column = list(common)
        for mine, group in zip(own, groups, strict=True):
            column += mine + [(0, -1)] * (most - len(mine))
            column += [(0, s) for s in group] + [(0, -1)] * (most_targets - len(group))
        power, signal = zip(*column, strict=True)
        targets = tuple(tuple(s - n_top for s in group) for group in groups)
        return Columns(power, signal), Equations(len(common), n_top, tuple(len(x) for x in own), targets)

    def _groups(self, first: int, n_targets: list[int]) -> list[tuple[int, ...]]:
        """Signals that share an equation."""
        groups = []
        for n in n_targets:
            groups += [tuple(sorted(first + i for i in group)) for group in self.fractions(n)]
            first += n
        return groups

    def plan(self, data: Spectra | Signals, joint: bool) -> "Plan":
        """What is regressed on what in which windows: y on u, or with `joint` y and u on r."""
        n_targets = [data.n_out, data.n_in] if joint else [data.n_out]
        columns, equations = self.model(data.n_exp, data.n_in, n_targets)
        windows = self.windows(data, equations.n_regressor)
        if isinstance(data, Signals):
            windows = dataclasses.replace(windows, part=data.part)
        spent = equations.n_regressor + self.shared_parameters(data.n_out)
        return Plan(columns, equations, windows, spent, float(data.n_exp * windows.width - spent))

    def combined(self, joint: bool):
        """What takes a `Solution` of one window, the equation of each target and dof to (G, cov)."""
        return through_ratio if joint else direct

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        """The response from u to y."""
        return self.regressed(signals, False, lines)

    def joint(self, signals: Signals, lines=None) -> Estimate:
        """The response from u to y as the ratio of those from r to y and to u; see `jaxfrf.JointInputOutput`."""
        return self.regressed(signals, True, lines)

    def regressed(self, signals: Signals, joint: bool, lines=None) -> Estimate:
        plan = self.plan(signals, joint)
        every = all_signals(signals, joint, self.transient_order)
        return estimate_windows(every, plan, self.combined(joint), lines)

    def regressed_with(self, signals: Signals, joint: bool, plan: "Plan", several: Sequence[Windows]) -> Estimate:
        """The estimates with several `Windows`, stacked along a leading axis that the result has too."""
        every = all_signals(signals, joint, self.transient_order)
        return estimate_several(every, plan, self.combined(joint), several)


class Plan(eqx.Module):
    """Regressions of one operating point: columns, equations and windows.

    `spent`: unknowns of a target. `dof`: residual degrees of freedom where the regressors have full rank."""

    columns: Columns
    equations: Equations
    windows: Windows
    spent: float = eqx.field(static=True)
    dof: float = eqx.field(static=True)


def check_steady(spectra: Spectra) -> None:
    """For methods without a transient term."""
    if spectra.leaks:
        raise input_error(
            "spectra",
            "the spectra of a record that is not periodic",
            "whole steady periods, or a method with a transient term",
            "Use a local method with a transient term (option transient=2).",
        )


def estimate_windows(signals: Complex[Array, "exp freq sig"], plan: Plan, combine, lines=None) -> Estimate:
    """Every window solved and combined to G and its covariance: from Gram matrices, or at `lines` from the rows.

    **Arguments:** `signals`: regressed-on signals, then targets, then constants. `combine`: see
    `AbstractLeastSquares.combined`.
    """
    if lines is None:
        return jax.tree.map(lambda x: x[0], estimate_several(signals, plan, combine, [plan.windows]))
    windows, columns = plan.windows, plan.columns

    def one_window(line):
        solution = solve_rows(rows(signals, windows, columns, line), plan.equations)
        return _of_window(solution, plan, combine, _dof(signals, plan, windows))

    G, cov, dof, deficient, doubtful = jax.vmap(one_window)(lines)
    at_edge = ~jnp.asarray(windows.centred)[lines]
    return _estimate(G, cov, dof, deficient, jnp.zeros_like(doubtful), at_edge, windows.width)


def estimate_several(signals, plan: Plan, combine, several: Sequence[Windows]) -> Estimate:
    """The estimates from Gram matrices with several `Windows` in the place of the plan's, along a leading axis."""
    dofs = jnp.asarray([_dof(signals, plan, windows) for windows in several])

    def one_window(A, number):
        return _of_window(solve_gram(A, plan.equations), plan, combine, dofs[number])

    G, cov, dof, deficient, doubtful = over_windows(one_window, signals, several, plan.columns)
    at_edge = ~jnp.asarray(np.stack([windows.centred for windows in several]))[:, several[0].lines]
    return _estimate(G, cov, dof, deficient, doubtful, at_edge, np.array([[windows.width] for windows in several]))


def _dof(signals, plan: Plan, windows: Windows) -> float:
    return signals.shape[0] * windows.width - plan.spent


def _of_window(solution, plan: Plan, combine, dof) -> tuple:
    """G, its covariance, degrees of freedom, whether rank lacks, and whether the Gram matrix was not enough."""
    dofs = jnp.broadcast_to(dof + solution.missing.astype(float), solution.pivot.shape)
    accurate = (solution.pivot > PIVOT) & ((solution.residual > RESIDUAL) | (dof <= 0))
    deficient = jnp.broadcast_to(solution.missing > 0, dofs.shape)
    return *combine(solution, plan.equations.of_target, dofs), dofs, deficient, ~accurate


def _estimate(G, cov, dof, deficient, doubtful, at_edge, width) -> Estimate:
    return Estimate(
        G=G,
        cov=cov,
        dof=dof,
        status=flags(EDGE_WINDOW=at_edge, RANK_DEFICIENT=deficient, NO_COVARIANCE=dof <= 0),
        window=jnp.broadcast_to(jnp.asarray(width, float), dof.shape),
        doubtful=doubtful,
    )


def all_signals(signals: Signals, joint: bool, transient: int | None):
    """All signals side by side, with one constant per experiment where a transient is wanted: (exp, freq, sig)."""
    parts = [signals.R, signals.Y, signals.U] if joint else [signals.U, signals.Y]
    if transient is not None:
        n_exp, n_freq = signals.U.shape[:2]
        parts.append(jnp.broadcast_to(jnp.eye(n_exp, dtype=complex)[:, None], (n_exp, n_freq, n_exp)))
    return jnp.concatenate([jnp.asarray(x) for x in parts], axis=-1)
