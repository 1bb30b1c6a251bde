"""Local rational method with one scalar denominator shared by all outputs."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..spectra import Spectra
from .covariance import dense
from .gram import Columns
from .inverse import adjoint, inverse
from .local import AbstractLocal, default_width
from .matrices import Whole
from .method import Signals
from .regression import Equations, Solution
from .residuals import Residuals
from .window import Windows


class CommonDenominatorLRM(AbstractLocal):
    """Local rational method with one scalar denominator polynomial for all outputs: D(x) = (1 + sum_s d_s x^s) I.

    Used by `jaxfrf.JointInputOutput` on [y; u] together, where the denominator cancels in the ratio N_y N_u^-1: the
    closed loop has one set of poles. Fewer unknowns than `LRM`: the least width is (R+1) n_in + R/n_out lines
    over n_exp (6 axes, R = 2: 19 instead of 30). Biased where more poles than R matter within one window.

    **Arguments:**

    - `order`: R. `width`: lines in a window; `None` takes a few more than are needed.
    - `variable`: local variable x, `index` of the excited line (the paper's) or `frequency`.
    - `transient`: order of a transient polynomial for records that are not in steady state; `None` for periodic data.
      For a record without a period `jaxfrf.estimate` takes R and, without a `width`, windows as `jaxfrf.Auto` does.

    The numerators are eliminated first; the d_s then solve the normal equations of what is left over all outputs, each
    divided by its rms in the window. Cov(vec G) has the part of `LRM` at fixed denominator and, uncorrelated with it,
    the part of the d_s.

    **Raises:** `jaxfrf.InputError` for options of no sense; in `jaxfrf.estimate` for too few lines or too narrow a
    window.

    **Source:** Voorhoeve, van der Maas & Oomen, Mech. Syst. Signal Process. 105 (2018) 129-152 (a common denominator);
    that it cancels between y and u is a closed form.
    """

    @property
    def has_denominator(self) -> bool:
        return False

    def fractions(self, n_target: int):
        return (tuple(range(n_target)),)

    def windows(self, spectra: Spectra | Signals, n_parameters: int) -> Windows:
        """Where none is given, a window wider by the order: what the loop feeds back makes the noise of y and u the
        same, and of few lines the denominator fits that."""
        if self.width is not None:
            return super().windows(spectra, n_parameters)
        width = default_width(n_parameters + self.order, spectra.n_exp, len(spectra.frequency))
        return dataclasses.replace(self, width=width).windows(spectra, n_parameters)

    def n_parameters(self, spectra: Spectra | Signals, n_top: int, n_target: int) -> int:
        return super().n_parameters(spectra, n_top, n_target) + -(-self.order // n_target)

    def shared_parameters(self, n_target: int) -> float:
        return self.order / n_target

    def calls_lapack(self, spectra: Spectra, joint: bool = False) -> bool:
        return True  # for the denominator

    def model(self, n_exp: int, n_top: int, n_targets: list[int]) -> tuple[Columns, Equations]:
        """One equation: the numerator columns explain every x^s z, s = 0..R (s by s)."""
        columns, numerator = super().model(n_exp, n_top, [sum(n_targets)])
        kept = numerator.n_common
        target = range(n_top, n_top + sum(n_targets))
        power = columns.power[:kept] + tuple(s for s in range(self.order + 1) for _ in target)
        signal = columns.signal[:kept] + tuple(i for _ in range(self.order + 1) for i in target)
        every = tuple(range(len(power) - kept))
        return Columns(power, signal), Equations(kept, n_top, (0,), (every,))

    def combined(self, joint: bool):
        return _SharedDenominator(self.order, joint, super().combined(joint))


class _SharedDenominator(eqx.Module):
    """Fit the denominator to what the numerators leave of every x^s z, then combine as usual."""

    order: int = eqx.field(static=True)
    joint: bool = eqx.field(static=True)
    combine: Callable = eqx.field(static=True)

    def __call__(self, solution: Solution, of_target, dof):
        def one_window(G, S, E, power, dof):
            return self._of_window(G, E, 1 / power, lambda G, E: _replaced(solution, G, S, E), of_target, dof)

        arrays = [x.by_window for x in (solution.G, solution.S, solution.E.whole)]
        each: Callable = one_window if isinstance(solution.G, Whole) else jax.vmap(one_window)
        return each(*arrays, solution.power.T, dof)

    def _of_window(self, G, E, weight, solved, of_target, dof):
        """From the coefficients G and products of residuals E of every x^s z; `solved(G, E)`: the solution with those
        of z alone."""
        terms, n_target = self.order + 1, len(G) // (self.order + 1)
        G, weight = G.reshape(terms, n_target, -1), weight[:n_target]
        E = E.reshape(terms, n_target, terms, n_target)
        d = _denominator(E, weight)
        G_whole, E_whole = jnp.einsum("s,sia->ia", d, G), jnp.einsum("s,sitj,t->ij", d, E, d.conj())
        result, cov = self.combine(solved(G_whole, E_whole), of_target[:n_target], dof)
        if self.order == 0:
            return result, cov
        C = E_whole / jnp.where(dof > 0, dof, jnp.nan)
        return result, dense(cov) + self._from_denominator(G_whole, C, G, E, weight)

    def _from_denominator(self, whole, C, G, E, weight):
        """The part of Cov(vec G) that comes from the uncertain denominator."""
        normal = _normal(E, weight)[1:, 1:]
        noise = jnp.einsum("tjsi,ij->st", E, C * weight[:, None] * weight)[1:, 1:]
        solved = inverse(normal)
        effect = self._effect(whole, G[1:])
        columns = effect.mT.reshape(self.order, -1).T
        return columns @ (solved @ noise @ adjoint(solved)) @ adjoint(columns)

    def _effect(self, whole, G):
        """dG/dd_s: (s, out, in)."""
        if not self.joint:
            return G
        n_in = whole.shape[-1]
        W = inverse(whole[-n_in:])
        ratio = whole[:-n_in] @ W
        return (G[:, :-n_in] - ratio @ G[:, -n_in:]) @ W


def _replaced(solution: Solution, G, S, E) -> Solution:
    return dataclasses.replace(solution, G=Whole(G), S=Whole(S), E=Residuals(Whole(E)))


def _normal(E, weight):
    """sum_i e_(s,i)^H e_(t,i) / power_i: (s, t), from E = sum_rows e conj(e)^T."""
    return jnp.einsum("tisi,i->st", E, weight)


def _denominator(E, weight):
    """(1, d_1, ..., d_R) that leave the least: (R+1,)."""
    normal = _normal(E, weight)
    d = -(inverse(normal[1:, 1:]) @ normal[1:, :1])[:, 0] if normal.shape[0] > 1 else np.zeros(0)
    return jnp.concatenate([jnp.ones(1, dtype=normal.dtype), d])
