"""Local rational method with one scalar denominator shared by all outputs."""

import equinox as eqx
import numpy as np

from ..spectra import Spectra
from .combine import direct, through_ratio
from .inverse import inverse
from .least_squares import regress
from .local import AbstractLocal
from .method import Estimate, dense
from .regression import Equation, Solution
from .window import Columns


class CommonDenominatorLRM(AbstractLocal):
    """Local rational method with one scalar denominator polynomial for all outputs: D(x) = (1 + sum_s d_s x^s) I.

    Used by `jaxfrf.JointInputOutput` on [y; u] together, where the denominator cancels in the ratio N_y N_u^-1: the
    closed loop has one set of poles. Fewer unknowns than `LRM`: the least width is (R+1) n_in + R/n_out lines
    over n_exp (6 axes, R = 2: 19 instead of 30). Biased where more poles than R matter within one window.
    Fields: see `AbstractLocal`.

    The numerators are eliminated first; the d_s then solve the normal equations of what is left over all outputs, each
    divided by its rms in the window. Cov
    (vec G) has the part of `LRM` at fixed denominator and, uncorrelated with it, the part of the d_s.
    """

    @property
    def has_denominator(self) -> bool:
        return False

    def fractions(self, n_target: int):
        return (tuple(range(n_target)),)

    def n_parameters(self, spectra: Spectra, n_top: int, n_target: int) -> int:
        return super().n_parameters(spectra, n_top, n_target) + -(-self.order // n_target)

    def shared_parameters(self, n_target: int) -> float:
        return self.order / n_target

    def model(self, n_exp: int, n_top: int, n_targets: list[int]) -> tuple[Columns, tuple[Equation, ...]]:
        """One equation: the numerator columns explain every x^s z, s = 0..R (s by s)."""
        columns, (numerator,) = super().model(n_exp, n_top, [sum(n_targets)])
        kept = len(numerator.regressors)
        target = range(n_top, n_top + sum(n_targets))
        power = columns.power[:kept] + tuple(s for s in range(self.order + 1) for _ in target)
        signal = columns.signal[:kept] + tuple(i for _ in range(self.order + 1) for i in target)
        equation = Equation(numerator.regressors, tuple(range(kept, len(power))), n_top)
        return Columns(power, signal), (equation,)

    def estimate(self, spectra: Spectra) -> Estimate:
        return regress(self, spectra, spectra.U, (spectra.Y,), _SharedDenominator(self.order, direct))

    def joint(self, spectra: Spectra) -> Estimate:
        return regress(self, spectra, spectra.R, (spectra.Y, spectra.U), _SharedDenominator(self.order, through_ratio))


class _SharedDenominator(eqx.Module):
    """Fit the denominator to what the numerators leave of every x^s z, then combine as usual."""

    order: int = eqx.field(static=True)
    combine: object = eqx.field(static=True)

    def __call__(self, solution: Solution, of_target, dof):
        terms, n_target = self.order + 1, solution.G.shape[-2] // (self.order + 1)
        batch = solution.G.shape[:-2]
        G = solution.G.reshape(*batch, terms, n_target, -1)
        E = solution.E.reshape(*batch, terms, n_target, terms, n_target)
        weight = 1 / solution.power[..., :n_target]
        d = _denominator(E, weight)
        whole = Solution(
            G=np.sum(d[..., :, None, None] * G, axis=-3),
            S=solution.S,
            E=np.sum(d[..., :, None, None, None] * d.conj()[..., None, None, :, None] * E, axis=(-4, -2)),
            power=solution.power[..., :n_target],
            pivot=solution.pivot,
            residual=solution.residual,
        )
        result, cov = self.combine(whole, of_target[:n_target], dof)
        if self.order == 0:
            return result, cov
        return result, dense(cov) + self._from_denominator(whole, G, E, weight, dof)

    def _from_denominator(self, whole: Solution, G, E, weight, dof):
        """The part of Cov(vec G) that comes from the uncertain denominator."""
        C = whole.E / np.where(dof > 0, dof, np.nan)[..., None, None]
        weighted = C * weight[..., :, None] * weight[..., None, :]
        normal = _normal(E, weight)[..., 1:, 1:]
        noise = np.einsum("...tjsi,...ij->...st", E, weighted)[..., 1:, 1:]
        solved = inverse(normal)
        cov_d = solved @ noise @ solved.conj().mT
        effect = self._effect(whole, G[..., 1:, :, :])
        columns = np.moveaxis(effect.mT.reshape(*effect.shape[:-2], -1), -2, -1)
        return columns @ cov_d @ columns.conj().mT

    def _effect(self, whole: Solution, G):
        """dG/dd_s: (*batch, s, out, in)."""
        if self.combine is direct:
            return G
        n_in = whole.G.shape[-1]
        W = inverse(whole.G[..., -n_in:, :])
        ratio = whole.G[..., :-n_in, :] @ W
        through = G[..., :-n_in, :] - ratio[..., None, :, :] @ G[..., -n_in:, :]
        return through @ W[..., None, :, :]


def _normal(E, weight):
    """sum_i e_(s,i)^H e_(t,i) / power_i: (*batch, s, t), from E = sum_rows e conj(e)^T."""
    return np.einsum("...tisi,...i->...st", E, weight)


def _denominator(E, weight):
    """(1, d_1, ..., d_R) that leave the least: (*batch, R+1)."""
    normal = _normal(E, weight)
    one = np.ones((*normal.shape[:-2], 1), dtype=normal.dtype)
    if normal.shape[-1] == 1:
        return one
    d = -(inverse(normal[..., 1:, 1:]) @ normal[..., 1:, :1])[..., 0]
    return np.concat([one, d], axis=-1)
