"""The estimator that chooses its windows from the data."""

import dataclasses
import functools
import math
import numbers

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from .._annotated import check_fields
from .._compile import after, compiled
from .._errors import input_error
from .._text import counted
from .._types import Array
from ..spectra import Spectra
from .classical import H1
from .covariance import KroneckerSum, dense, variances
from .inverse import squares
from .joint import JointInputOutput
from .local import LRM, AbstractLocal
from .method import AbstractMethod, Estimate, Signals, arrays_of, on_host, run, run_in_parts, solve_again
from .part import joined
from .scaled import Scaled
from .two_stage import has_second_stage, prediction, second_stage

_STEP = 2.6  # least ratio of neighbouring windows, where there are many lines
_PILOT_LINES = 2  # on either side, over which the noise of the narrowest estimate is averaged
_NEAR, _FAR = 16, 4  # part of a window over which bias is averaged: for the estimate, and for its interval
_LEAST_NEAR = 2  # lines on either side
_OTHERS = 0.25  # weight of all elements together beside the element itself, for the interval
_UNSEEN = 0.1  # bias that no test sees, of the variance of the difference of two windows
_LEAST = 0.1  # of the narrower estimate's variance: what a difference of two estimates at least varies by
_LOCAL, _LEAST_LOCAL = 16, 2  # part of a window, and lines on either side, over which noise counts as of one size


class Auto(AbstractMethod):
    """Stacked local rational estimate through the reference where there is one, its window chosen at every line.

    From narrow to wide, every window's estimate G_w (variance s_w^2) is set against what was found before it, G with
    variance s^2. Without bias their difference has the variance s^2 - s_w^2, since a wider window holds what the
    narrower one does and more (Hausman 1978); what |G - G_w|^2 has beyond, averaged over some lines, is the
    bias^2 of the wider window. The best mean of both then is

        G <- G_w + lambda (G - G_w),   s^2 <- s_w^2 + lambda (s^2 - s_w^2),   lambda = bias^2/(bias^2 + s^2 - s_w^2),

    element by element: a resonance keeps its narrow windows, smooth responses and nearly constant ones get the widest.
    s^2 is the mean square error, bias included, that is stated as variance; for it bias is averaged over more lines,
    and a tenth of s^2 - s_w^2 is added for what no test sees. s_w^2 counts as larger where a window's noise is: at
    resonances, if torques are disturbed. Where there are more experiments than inputs, the first
    of all is `H1` (through the reference), which has no window and no bias of one.

    Fractions are fitted in two stages, which removes the bias of the noise in their regressors; from a reference, y and
    u are targets of one regression then (`jaxfrf.frf.two_stage`). The choices were made on the tuning plants of
    `benchmarks/bench_coverage.py`, which reports on others. In closed loop without a reference, the noise in u biases
    every window alike, and nothing of that is seen.

    **Arguments:**

    - `method`: the local method whose `width` is chosen; default LRM, R = 2, with the distance of lines in Hz: lines
      that are rounded to a grid are not equally spaced on any scale, and G is not smooth over their index.
    - `widths`: windows to choose from, in lines; by default at least six from the narrowest useful one to a third of
      the band.
    - `use_reference`: estimate through r where it is recorded.
    - `stages`: 2 suits noise that y has beside the response; of disturbances that enter where the input does (torques)
      it errs about as much as 1. R3X, whose error is friction's distortion and an arm that moves, is a tenth to a
      fifth nearer to the truth with 1 (`notebooks/paper.md`).

    **Raises:** `jaxfrf.InputError` for other `stages`, and for a method with a `width`; in `jaxfrf.estimate` where
    there are too few lines for the narrowest window.

    **Source:** Hausman, Econometrica 46 (1978) 1251-1271 (variance of the difference); Theil 1953 and Basmann 1957
    (two-stage least squares); the local fractions as of `LRM`. The mean of windows is this project's own.
    """

    method: AbstractLocal = LRM(variable="frequency")
    widths: tuple[int, ...] | None = None
    use_reference: bool = True
    stages: int = 2

    def __check_init__(self):
        check_fields(self)
        if self.widths is not None and not (self.widths and all(isinstance(w, numbers.Integral) for w in self.widths)):
            raise input_error("widths", repr(self.widths), "whole numbers, one or more", "Give e.g. (12, 24, 48).")
        if self.stages not in (1, 2):
            raise input_error("stages", repr(self.stages), "1 or 2", "Leave it out for 2.")
        if self.method.width is not None:
            raise input_error(
                "width",
                f"width={self.method.width} for a method that chooses its windows",
                "no width",
                f"Say which windows to choose from (widths={self.method.width}), or take a method with a fixed one, "
                "e.g. lrm-jio-stacked.",
            )

    def block_size(self, spectra: Spectra | Signals) -> int:
        return 1

    def remarks(self, spectra: Spectra) -> tuple[str, ...]:
        if not self.use_reference or spectra.R is None or self.through_reference(spectra):
            return ()
        return (
            f"r has {counted(spectra.R.shape[-1], 'channel')}, u has {spectra.n_in}: the reference was not used, which "
            "in closed loop biases the FRF by the noise that drives u. Choose as many channels of it (--map r=...).",
        )

    def check(self, spectra: Spectra) -> None:
        self._with_width(self.candidates(spectra)[0], spectra).check(spectra)

    def candidates(self, spectra: Spectra | Signals) -> tuple[int, ...]:
        """The windows tried, narrowest first."""
        n_lines = len(spectra.frequency)
        if self.widths is not None:
            return tuple(sorted({int(w) for w in self.widths}))
        return _widths(self._n_parameters(spectra), spectra.n_exp, n_lines)

    def _n_parameters(self, spectra: Spectra | Signals) -> int:
        return self.method.n_parameters(spectra, spectra.n_in, max(spectra.n_out, spectra.n_in))

    def without_windows(self, spectra: Spectra) -> AbstractMethod:
        """This, or the estimate line by line where there are too few lines for any window and experiments enough."""
        n = self._n_parameters(spectra)
        if len(spectra.frequency) * spectra.n_exp >= n or spectra.n_exp < spectra.n_in:
            return self
        return JointInputOutput(H1()) if self.through_reference(spectra) else H1()

    def residual_dof(self, signals: Signals) -> float:
        return self._with_width(self.candidates(signals)[0], signals).residual_dof(signals)

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        predicted, pilot = self._before(signals)
        if pilot is not None:
            signals = dataclasses.replace(signals, U=after(signals.U, pilot.G))
        tried, widths = _Tried(pilot, self._tried(signals, predicted)), self._reach(signals)
        blended = _blend(tried, widths, _local_noise(tried, signals.U, signals.Y, widths))
        return blended if lines is None else jax.tree.map(lambda x: x[lines], blended)

    @property
    def shares_lines(self) -> bool:
        return True

    def calls_lapack(self, spectra: Spectra) -> bool:
        if self.method.transient is not None:  # the prediction can have more columns than the windows
            return True
        return H1().calls_lapack(spectra) or self.method.calls_lapack(spectra, self.through_reference(spectra))

    def n_window(self, spectra: Spectra) -> int:
        return len(self.candidates(spectra))

    def estimate(self, spectra: Spectra, n_part: int = 1) -> Estimate:
        """As everywhere; but doubtful lines are solved again before the windows are compared."""
        predicted, pilot = run(Auto._before, self, spectra)
        parts = run_in_parts(Auto._tried, self, spectra, n_part, predicted)
        if any(np.asarray(part.doubtful).any() for part in parts):
            parts = [self._solved_again(joined(parts, len(spectra.frequency), axis=2), predicted, spectra)]
        arrays = np.asarray(spectra.U), np.asarray(spectra.Y)
        return on_host(compiled(_blended)(pilot, parts, *arrays, self._reach(spectra)))

    def _solved_again(self, tried: Estimate, predicted, spectra: Spectra) -> Estimate:
        tried, (points, frequency) = jax.tree.map(np.array, tried), arrays_of(spectra)
        widths = self.candidates(spectra)
        for pos, number in np.argwhere(tried.doubtful.any(axis=-1)):
            point, here = (jax.tree.map(lambda x, pos=pos: x[pos], x) for x in (points, predicted))
            one_width = _OneWidth(self, widths[number], here)
            estimate = jax.tree.map(lambda x, at=(pos, number): x[at], tried)
            solve_again(estimate, one_width, Signals(**point, frequency=frequency))
        return tried

    def _reach(self, spectra: Spectra | Signals) -> tuple[int, ...]:
        widths = self.candidates(spectra)
        return (1, *widths) if self._has_pilot(spectra) else widths

    def _has_pilot(self, spectra: Spectra | Signals) -> bool:
        return self.method.transient is None and spectra.n_exp > spectra.n_in

    def _before(self, signals: Signals) -> tuple[Array | None, Estimate | None]:
        """What is there before windows are tried: the prediction for fits in two stages, and the pilot, which has no
        window; `None` where there is none."""
        joint = self.through_reference(signals)
        predicted = self._prediction(signals, joint) if self._two_stages else None
        if not self._has_pilot(signals):
            return predicted, None
        if predicted is not None:
            signals = dataclasses.replace(signals, U=after(signals.U, predicted))
        return predicted, _pilot(JointInputOutput(H1()) if joint else H1(), signals)

    def _tried(self, signals: Signals, predicted: Array | None) -> Estimate:
        """The estimates with every width, which is the leading axis."""
        joint = self.through_reference(signals)
        methods = [dataclasses.replace(self.method, width=w) for w in self.candidates(signals)]
        plans = [method.plan(signals, joint) for method in methods]
        windows = [plan.windows for plan in plans]
        if predicted is not None:
            return second_stage(methods[0], signals, joint, predicted, windows)
        return self.method.regressed_with(signals, joint, plans[0], windows)

    @property
    def _two_stages(self) -> bool:
        return self.stages == 2 and has_second_stage(self.method)

    def _prediction(self, signals: Signals, joint: bool):
        widths = self.candidates(signals)
        return prediction(dataclasses.replace(self.method, width=widths[min(1, len(widths) - 1)]), signals, joint)

    def through_reference(self, spectra: Spectra | Signals) -> bool:
        """Whether the response from the reference is estimated."""
        return self.use_reference and spectra.R is not None and spectra.R.shape[-1] == spectra.n_in

    def _with_width(self, width: int, spectra: Spectra | Signals) -> AbstractMethod:
        method = dataclasses.replace(self.method, width=width)
        return JointInputOutput(method) if self.through_reference(spectra) else method


@functools.lru_cache(maxsize=64)
def _widths(n_parameters: int, n_exp: int, n_lines: int) -> tuple[int, ...]:
    least = min(-(-n_parameters // n_exp) + max(4, -(-n_parameters // (2 * n_exp))), n_lines)
    most = max(n_lines // 3, least)
    count = max(6, 1 + math.ceil(math.log(most / least, _STEP)))
    return tuple(sorted({round(w) for w in np.geomspace(least, most, count)}))


class _OneWidth(AbstractMethod):
    """The estimate of `Auto` with one of its windows, for lines that are solved again.

    `predicted`: what its fits in two stages have for a prediction; `None` where it has one stage."""

    of: Auto
    width: int
    predicted: Complex[Array, "exp freq target"] | None

    def block_size(self, spectra) -> int:
        return 1

    def check(self, spectra) -> None:
        self.of.check(spectra)

    def residual_dof(self, signals: Signals) -> float:
        return self.of.residual_dof(signals)

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        method = dataclasses.replace(self.of.method, width=self.width)
        joint = self.of.through_reference(signals)
        if self.predicted is not None:
            return second_stage(method, signals, joint, self.predicted, lines=lines)
        return method.regressed(signals, joint, lines)


def _pilot(method: AbstractMethod, signals: Signals) -> Estimate:
    """H1 with its noise averaged over some lines."""
    found = method.at_point(signals)
    assert isinstance(found.cov, KroneckerSum)
    right = _mean(found.cov.right, _neighbours(signals.U.shape[1], _PILOT_LINES))
    return dataclasses.replace(
        found,
        cov=KroneckerSum(found.cov.left, right),
        dof=found.dof * min(2 * _PILOT_LINES + 1, len(right)),
        doubtful=jnp.zeros_like(found.doubtful),
        alike=None,
        cov_noise=None,
    )


class _Tried(eqx.Module):
    """The estimates with every window, (width, freq, ...): a pilot where there is one, then the others, which are not
    copied to stand behind it."""

    pilot: Estimate | None
    windows: Estimate

    def every(self, of):
        """`of(estimate)` of all."""
        found = of(self.windows)
        return found if self.pilot is None else jnp.concatenate([of(self.pilot)[None], found])

    def chosen(self, number: Int[Array, "freq"]) -> Estimate:
        """One at every line."""
        line = np.arange(len(number))
        if self.pilot is None:
            return jax.tree.map(lambda x: x[number, line], self.windows)
        assert isinstance(self.pilot.cov, KroneckerSum)
        pilot = dataclasses.replace(self.pilot, cov=_of_kind(self.pilot.cov, self.windows.cov))

        def one(first, others):
            is_pilot = (number == 0).reshape(-1, *[1] * (first.ndim - 1))
            return jnp.where(is_pilot, first, others[jnp.maximum(number - 1, 0), line])

        return jax.tree.map(one, pilot, self.windows)


def _of_kind(cov: KroneckerSum, like):
    """The same covariance with as many terms, or written out, as `like`."""
    if not isinstance(like, KroneckerSum):
        return dense(cov)
    missing = like.left.shape[-3] - cov.left.shape[-3]
    wide = lambda x: jnp.concatenate([x, jnp.zeros((x.shape[0], missing, *x.shape[2:]), x.dtype)], axis=1)
    return KroneckerSum(wide(cov.left), wide(cov.right)) if missing else cov


def _blended(pilot: Estimate | None, parts: list[Estimate], U, Y, widths: tuple[int, ...]) -> Estimate:
    """`_blend` at every operating point, from (pos, width, line, ...) of every part of the lines."""

    def one_point(pilot, found, u, y):
        tried = _Tried(pilot, found)
        return _blend(tried, widths, _local_noise(tried, u, y, widths))

    return jax.vmap(one_point)(pilot, joined(parts, U.shape[2], axis=2), U, Y)


def _local_noise(tried: _Tried, U, Y, widths: tuple[int, ...]):
    """How much more noise a line has than the mean of each window around it, at least 1: (width, freq, out).

    A window takes its noise as of one size. That of a torque's disturbance is largest at resonances, where a window
    knows less of G than it states then.
    """
    narrow = tried.windows.G[:2][-1]
    left = squares(Y - jnp.einsum("foi,efi->efo", narrow, U))
    power = jnp.where(jnp.isfinite(left), left, 0.0).mean(axis=0)
    n_exp, n_freq = Y.shape[:2]

    def more(width: int):
        reach = max(_LEAST_LOCAL, width // _LOCAL)
        local, whole = (_mean(power, _neighbours(n_freq, lines)) for lines in (reach, max(width // 2, 1)))
        chance = 1 + 1 / math.sqrt((2 * reach + 1) * n_exp)  # as far as a mean of so few strays
        return jnp.maximum(local / jnp.where(whole > 0, whole, 1.0) / chance, 1.0)

    return jnp.stack([more(width) if width > 1 else jnp.ones_like(power) for width in widths])


def _blend(tried: _Tried, widths: tuple[int, ...], noise) -> Estimate:
    """From narrow to wide windows, the mean that errs least; see `Auto`.

    `noise`: by which the variance of each output's row is larger than stated, (width, freq, out)."""
    if len(widths) == 1:
        only = jax.tree.map(lambda x: x[0], tried.windows)
        return dataclasses.replace(only, cov=_as_it_is(only.cov))
    own = jnp.maximum(tried.every(lambda x: variances(x.cov)), 0)
    G, dof, window = (tried.every(of) for of in (lambda x: x.G, lambda x: x.dof, lambda x: x.window))
    every = own.reshape(*own.shape[:2], G.shape[3], G.shape[2]).mT * noise[..., None]
    every = jnp.where(jnp.isfinite(every), every, jnp.inf)
    n_freq = G.shape[1]
    near, far = (
        jnp.asarray([_neighbours(n_freq, max(_LEAST_NEAR, width // part)) for width in widths[1:]], int)
        for part in (_NEAR, _FAR)
    )

    def wider(before, found):
        G, variance, stated, dof, window, choice = before
        k, G_wide, own, dof_wide, window_wide, near, far = found
        wide = jnp.minimum(own, variance)
        known = jnp.isfinite(variance) & (variance > 0)  # that of a channel without any signal is zero
        between = jnp.where(known, jnp.maximum(variance - wide, _LEAST * variance), 1.0)
        excess = jnp.where(known, squares(G_wide - G) / between, 0.0)
        bias = jnp.maximum(_mean(excess, near) - 1, 0)
        keep = bias / (1 + bias)
        told = (1 - _OTHERS) * excess + _OTHERS * excess.mean(axis=(-2, -1), keepdims=True)
        told = jnp.maximum(_mean(told, far) - 1, 0) + _UNSEEN
        told = told / (1 + told)
        keep_stated = (told + jnp.maximum(told, keep)) / 2
        share = keep.mean(axis=(-2, -1))
        mixed = 1 / ((1 - share) / dof_wide + share / jnp.where(dof > 0, dof, 1.0))
        after = (
            jnp.where(keep > 0, G_wide + keep * (G - G_wide), G_wide),
            _between(wide, variance, keep),
            _between(jnp.minimum(own, stated), stated, keep_stated),
            jnp.where(dof > 0, mixed, dof_wide),
            (1 - share) * window_wide + share * window,
            jnp.where(share < 0.5, k, choice),
        )
        return after, None

    first = (G[0], every[0], every[0], dof[0], window[0], jnp.zeros(n_freq, int))
    found = (jnp.arange(1, len(widths)), *(x[1:] for x in (G, every, dof, window)), near, far)
    (G, _, stated, dof, window, choice), _ = jax.lax.scan(wider, first, found)
    chosen = tried.chosen(choice)
    of = jnp.take_along_axis(own, choice[None, :, None], axis=0)[0]
    scale = jnp.sqrt(stated.mT.reshape(of.shape) / jnp.where(of > 0, of, 1.0))
    return dataclasses.replace(
        chosen, G=G, cov=Scaled(chosen.cov, jnp.where(of > 0, scale, 1.0)), dof=dof, window=window
    )


def _as_it_is(cov) -> Scaled:
    return Scaled(cov, jnp.ones(cov.shape[:-1]))


def _between(wide, narrow, keep):
    """wide + keep (narrow - wide), where the narrow one may be infinite: unknown."""
    return jnp.where(keep > 0, wide + keep * jnp.where(jnp.isfinite(narrow), narrow - wide, 0.0), wide)


def _neighbours(n: int, reach: int) -> np.ndarray:
    """The first line within `reach` of every line, and the one after the last: (2, freq)."""
    return np.stack([np.maximum(np.arange(n) - reach, 0), np.minimum(np.arange(n) + reach + 1, n)])


def _mean(x: Float[Array, "freq ..."], near):
    """Mean over `_neighbours`."""
    first, last = near
    total = jnp.concatenate([jnp.zeros((1, *x.shape[1:]), x.dtype), jnp.cumsum(x, axis=0)])
    return (total[last] - total[first]) / (last - first).reshape(-1, *[1] * (x.ndim - 1))
