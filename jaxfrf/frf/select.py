"""The estimator that chooses its window from the data."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from .._errors import input_error
from .._types import Array
from ..spectra import Spectra
from .covariance import variances
from .joint import JointInputOutput
from .local import LRM, AbstractLocal
from .method import AbstractMethod, Estimate, Signals, on_host, run, solved_again


class Auto(AbstractMethod):
    """Stacked local rational estimate through the reference where there is one, its window chosen at every line.

    From narrow to wide, a window is accepted while its estimate agrees with those of all narrower ones: rms over the
    elements of |G_w - G_v| / (s_w + s_v) at most `threshold`, s the standard deviations (intersection of confidence
    intervals: Goldenshluger & Nemirovski 1997). Wide windows average more noise, and are given up where the response
    bends too much for them. The choice is smoothed over neighbouring lines by a median.

    The covariance is that of the chosen window, as if it had been chosen beforehand; what bias the choice lets through
    is at most about `threshold` standard deviations of a narrower window. The default was tuned on plants with 1, 2
    and 6 axes, 1 to 6 experiments, 2 and 10 % disturbance (`benchmarks/bench_accuracy.py`, which reports on other
    seeds). Nearly constant responses are averaged less widely than they could be.

    **Arguments:**

    - `method`: the local method whose `width` is chosen; default `LRM()`, R = 2.
    - `widths`: windows to choose from, in lines; by default six from the narrowest useful one to a third of the band.
    - `threshold`: see above. `use_reference`: estimate through r where it is recorded.
    """

    method: AbstractLocal = LRM()
    widths: tuple[int, ...] | None = None
    threshold: float = 0.85
    use_reference: bool = True

    def __check_init__(self):
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

    def check(self, spectra: Spectra) -> None:
        self._with_width(self.candidates(spectra)[0], spectra).check(spectra)

    def candidates(self, spectra: Spectra | Signals) -> tuple[int, ...]:
        """The windows tried, narrowest first."""
        n_lines = len(spectra.frequency)
        if self.widths is not None:
            return tuple(sorted({int(w) for w in self.widths}))
        n = self.method.n_parameters(spectra, spectra.n_in, max(spectra.n_out, spectra.n_in))
        least = min(-(-n // spectra.n_exp) + max(4, -(-n // (2 * spectra.n_exp))), n_lines)
        most = max(n_lines // 3, least)
        return tuple(sorted({round(w) for w in np.geomspace(least, most, 6)}))

    def residual_dof(self, signals: Signals) -> float:
        return self._with_width(self.candidates(signals)[0], signals).residual_dof(signals)

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        tried = self._tried(signals)
        choice = _choice(tried, self.threshold)
        if lines is None:
            return _chosen(tried, choice)
        again = [self._with_width(w, signals).at_point(signals, lines) for w in self.candidates(signals)]
        return _chosen(jax.tree.map(lambda *x: jnp.stack(x), *again), choice[lines])

    def estimate(self, spectra: Spectra) -> Estimate:
        """As everywhere; but doubtful lines are solved again before the choice, which looks at neighbours."""
        tried = on_host(run(Auto._tried, self, spectra))
        each = [jax.tree.map(lambda x, i=i: x[:, i], tried) for i in range(tried.G.shape[1])]
        methods = [self._with_width(w, spectra) for w in self.candidates(spectra)]
        each = [solved_again(x, method, spectra) for x, method in zip(each, methods, strict=True)]
        tried = jax.tree.map(lambda *x: np.stack(x, axis=1), *each)
        return on_host(_choose(tried, self.threshold))

    def _tried(self, signals: Signals) -> Estimate:
        """The estimates with every width, which is the leading axis."""
        joint = self._through_reference(signals)
        methods = [dataclasses.replace(self.method, width=w) for w in self.candidates(signals)]
        plans = [method.plan(signals, joint) for method in methods]
        span = max(plan.windows.span for plan in plans)
        every = [dataclasses.replace(plan.windows, span=span) for plan in plans]
        windows = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y) for y in x]), *every)
        return self.method.regressed_with(signals, joint, plans[0], windows)

    def _through_reference(self, spectra: Spectra | Signals) -> bool:
        return self.use_reference and spectra.R is not None and spectra.R.shape[-1] == spectra.n_in

    def _with_width(self, width: int, spectra: Spectra | Signals) -> AbstractMethod:
        method = dataclasses.replace(self.method, width=width)
        return JointInputOutput(method) if self._through_reference(spectra) else method


@eqx.filter_jit
def _choose(tried: Estimate, threshold: float) -> Estimate:
    """The chosen estimate at every operating point, from (pos, width, freq, ...)."""
    return jax.vmap(lambda x: _chosen(x, _choice(x, threshold)))(tried)


def _choice(tried: Estimate, threshold: float) -> Int[Array, "freq"]:
    """Number of the widest window that agrees with all narrower ones, smoothed; `tried` is (width, freq, ...)."""
    G = tried.G
    std = jnp.sqrt(jnp.maximum(variances(tried.cov), 0)).reshape(*G.shape[:2], G.shape[3], G.shape[2]).mT
    agreed = jnp.ones(G.shape[1], bool)
    choice = jnp.zeros(G.shape[1], int)
    for wide in range(1, G.shape[0]):
        step = jnp.abs(G[wide] - G[:wide]) / (std[wide] + std[:wide])
        agreed &= ~jnp.any(jnp.sqrt(jnp.mean(step**2, axis=(-2, -1))) > threshold, axis=0)
        choice = jnp.where(agreed, wide, choice)
    return _median(choice, min(9, G.shape[1]))


def _median(x, span: int):
    """Running median of integers over `span` neighbours (for even spans one more before than after), as of the value at
    the ends beyond them."""
    padded = jnp.pad(x, (span // 2, span - 1 - span // 2), mode="edge")
    return jnp.sort(padded[jnp.arange(len(x))[:, None] + jnp.arange(span)], axis=1)[:, span // 2]


def _chosen(tried: Estimate, choice) -> Estimate:
    return jax.tree.map(lambda x: x[choice, jnp.arange(len(choice))], tried)
