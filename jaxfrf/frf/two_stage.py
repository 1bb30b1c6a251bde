"""Local fractions in two stages: without the bias that noise in their own regressors makes.

In Z = N X - sum_s x^s D_s Z + D V the regressors x^s Z hold the noise V of the targets, and the error D V is larger the
farther a line is from the poles: both bias G, the more the wider the window, however many experiments there are. With
the prediction Z^ = G^ X + T^ of a first fit in the place of Z on the right,

    Z_j = sum_s x_j^s N_s X_j - sum_{s>=1} x_j^s D_s Z^_j + T(x_j) + V_j,

the regressors hold next to no noise, and the error is V itself, of equal size at all lines of a window: two-stage least
squares (Theil 1953; Basmann 1957). It needs X without noise: a reference, or a known input. Polynomials (LPM) have no
such regressors, and nothing to gain.

From a reference, y and u both answer with the poles of the closed loop, so that what predicts y, x^s Y^, stands for the
denominators of both: y and u are targets of one regression, of as many unknowns as each of two has otherwise. (Where
there are fewer outputs than inputs, it is u that is predicted.) On the tuning plants of `benchmarks/bench_coverage.py`
it errs as much as two regressions do, each with its own, and takes half of the time.
"""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Complex

from .._compile import after
from .._types import Array
from .gram import Columns
from .least_squares import Plan, all_signals, estimate_several, estimate_windows
from .local import AbstractLocal
from .method import Estimate, Signals
from .regression import Equations
from .window import Windows


def has_second_stage(method: AbstractLocal) -> bool:
    return method.has_denominator and method.order > 0


def prediction(method: AbstractLocal, signals: Signals, joint: bool) -> Complex[Array, "exp freq carrier"]:
    """What a first fit with `method` says that those targets that stand in denominators would be without noise; what
    was measured where it fails."""
    X = signals.U if signals.R is None or not joint else signals.R
    n_exp, n_freq = X.shape[:2]
    if method.transient is not None:
        each = jnp.broadcast_to(jnp.eye(n_exp, dtype=complex)[:, None], (n_exp, n_freq, n_exp))
        X = jnp.concatenate([X, each], axis=-1)  # a transient is the answer to 1 in one experiment
        method = dataclasses.replace(method, transient=None)
    found: list[Array] = []
    for Z in _in_denominators(method, signals, joint):
        Z = after(Z, found[-1]) if found else Z
        G = method.at_point(Signals(X, Z, None, None, signals.frequency)).G
        said = jnp.einsum("fzi,efi->efz", G, X)
        found.append(jnp.where(jnp.isfinite(said), said, Z))
    return jnp.concatenate(found, axis=-1)


def _in_denominators(method: AbstractLocal, signals: Signals, joint: bool) -> tuple:
    if _is_one_regression(method, signals, joint):
        return (signals.Y if signals.n_out >= signals.n_in else signals.U,)
    return (signals.Y, signals.U) if joint else (signals.Y,)


def _is_one_regression(method: AbstractLocal, signals: Signals, joint: bool) -> bool:
    """Whether y and u are targets of one regression: fractions that mix all outputs."""
    return joint and len(method.fractions(signals.n_out)) == 1 == len(method.fractions(signals.n_in))


def second_stage(
    method: AbstractLocal,
    signals: Signals,
    joint: bool,
    predicted,
    several: Sequence[Windows] | None = None,
    lines=None,
) -> Estimate:
    """The estimate of the second stage, with the method's own window at `lines` (all by default), or with each of
    `several` windows, stacked, as a leading axis of the result."""
    every = all_signals(signals, joint, method.transient)
    changed = _one_regression if _is_one_regression(method, signals, joint) else _on_prediction
    plan = changed(method.plan(signals, joint), signals.n_in, every.shape[-1], predicted.shape[-1])
    every = jnp.concatenate([every, predicted], axis=-1)
    combine = method.combined(joint)
    if several is None:
        return estimate_windows(every, plan, combine, lines)
    return estimate_several(every, plan, combine, several)


def _one_regression(plan: Plan, n_top: int, n_signal: int, n_carrier: int) -> Plan:
    """All targets on what their equations have in common and x^s Z^, s >= 1, whose signals stand behind all others."""
    columns, n = plan.columns, plan.equations.n_common
    common, targets = list(zip(columns.power, columns.signal, strict=True))[:n], range(len(plan.equations.of_target))
    order = max(p for p, s in common if s < n_top)  # of the numerators; a transient has one of its own
    carried = [(p, n_signal + k) for p in range(1, order + 1) for k in range(n_carrier)]
    regressors = common[:-n_top] + carried + common[-n_top:]
    power, signal = zip(*regressors, *((0, n_top + k) for k in targets), strict=True)
    equations = Equations(len(regressors), n_top, (0,), (tuple(targets),))
    return dataclasses.replace(plan, columns=Columns(power, signal), equations=equations)


def _on_prediction(plan: Plan, n_top: int, n_signal: int, n_target: int) -> Plan:
    """x^s Z, s >= 1, by x^s Z^, whose signals stand behind all others."""

    def place(power: int, signal: int) -> int:
        return signal - n_top + n_signal if power and n_top <= signal < n_top + n_target else signal

    power, signal = plan.columns.power, plan.columns.signal
    moved = tuple(place(p, s) for p, s in zip(power, signal, strict=True))
    return dataclasses.replace(plan, columns=Columns(power, moved))
