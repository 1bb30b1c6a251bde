"""Averages over blocks of experiments: arithmetic and logarithmic."""

import abc
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float

from .._compile import apart, compiled
from .._device import on_accelerator
from .._errors import input_error
from .._status import Status
from .._text import counted
from .._types import Array
from ..spectra import Spectra, changed_signals
from .classical import H1
from .covariance import OuterSum, sum_over, variances
from .inverse import product
from .matrix_functions import LARGEST_NORM, exponentials, is_small, matrix_functions
from .method import AbstractMethod, Estimate, Signals, arrays_of, on_host

_CONDITION = 1e6  # of the eigenvectors: above it the matrix logarithm loses half of the digits
_ROUNDS, _WEIGHT_REACH = 4, 4  # of weighing blocks; lines on either side that share a weight
_CUT = 2.0  # times the usual distance from the others, beyond it, where a block no longer counts
_BLOCK = 512  # lines that are averaged together


class AbstractAverage(AbstractMethod):
    """Estimate every block of experiments on its own, then average.

    The covariance is that of the mean: the blocks' own covariances where they have any, else (classical estimates of
    n_in experiments have no residual) their scatter,

        1/(M (M-1)) sum_m vec(G_m - G) vec(G_m - G)^H,

    which for M blocks has rank M-1 at most, and takes the linear mean for the logarithmic one (first order). The
    paper divides by M^2, which is too small by (M-1)/M. `cov_total` holds the scatter in either case.
    """

    @property
    @abc.abstractmethod
    def inner(self) -> AbstractMethod:
        """What estimates every block."""

    @abc.abstractmethod
    def mean(self, G: Complex[Array, "line block out in"]) -> tuple[Complex[Array, "line out in"], Bool[Array, "line"]]:
        """The mean of the blocks' responses at every line, and whether the branch of a logarithm is unsafe."""

    def block_size(self, spectra: Spectra | Signals) -> int:
        return self.inner.block_size(spectra)

    def check(self, spectra: Spectra) -> None:
        size = self.block_size(spectra)
        self.inner.check(_block_by_block(spectra, size) if spectra.n_exp >= size else spectra)

    def residual_dof(self, signals: Signals) -> float:
        size = self.block_size(signals)
        own = self.inner.residual_dof(_first(signals, size))
        return own * (signals.n_exp // size) if own > 0 else signals.n_exp // size - 1.0

    @property
    def shares_lines(self) -> bool:
        return self.inner.shares_lines

    def calls_lapack(self, spectra: Spectra) -> bool:
        return self.inner.calls_lapack(spectra)

    def n_window(self, spectra: Spectra) -> int:
        return spectra.n_exp // self.block_size(spectra) * self.inner.n_window(spectra)

    def estimate(self, spectra: Spectra, n_part: int = 1) -> Estimate:
        """As everywhere; but a method that mends doubtful lines before it goes on does so for every block."""
        if type(self.inner).estimate is AbstractMethod.estimate:
            return super().estimate(spectra, n_part)
        blocks = _block_by_block(spectra, self.block_size(spectra))
        each = self.inner.estimate(blocks)
        each = jax.tree.map(lambda x: x.reshape(spectra.n_pos, -1, *x.shape[1:]), each)
        return on_host(compiled(_averaged)(self, each, *arrays_of(spectra)))

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        return self.of_blocks(self._blocks(signals, lines), signals)

    def _blocks(self, signals: Signals, lines) -> Estimate:
        """The estimate of every block, which is the leading axis."""
        size = self.block_size(signals)
        n_block = signals.n_exp // size
        if n_block == 1:
            return jax.tree.map(lambda x: x[None], self.inner.at_point(_first(signals, size), lines))
        blocks = jax.tree.map(
            lambda x: x[: n_block * size].reshape(n_block, size, *x.shape[1:]), _by_experiment(signals)
        )
        together = n_block if on_accelerator() else None
        return jax.lax.map(
            lambda b: self.inner.at_point(dataclasses.replace(signals, **b), lines), blocks, batch_size=together
        )

    def of_blocks(self, each: Estimate, signals: Signals) -> Estimate:
        """The mean of the blocks' estimates, (block, freq, ...)."""
        size, n_block = self.block_size(signals), len(each.G)
        G, unsafe = _in_blocks(self.mean, jnp.swapaxes(each.G, 0, 1))
        scatter = _scatter(each.G, G)
        status = jnp.bitwise_or.reduce(each.status, axis=0) | jnp.where(unsafe, int(Status.LOG_BRANCH), 0)
        own = self.inner.residual_dof(_first(signals, size)) > 0
        if not own:
            known = int(Status.NO_COVARIANCE)
            status = status & ~known if n_block > 1 else status | known
        return Estimate(
            G=G,
            cov=sum_over(each.cov, 1 / n_block**2) if own else scatter,
            dof=_joint_dof(each.cov, each.dof) if own else jnp.full(status.shape, n_block - 1.0),
            status=status,
            window=each.window.mean(axis=0),
            doubtful=jnp.any(each.doubtful, axis=0),
            cov_noise=None if each.cov_noise is None else sum_over(each.cov_noise, 1 / n_block**2),
            cov_total=scatter if n_block > 1 else None,
        )


class ArithmeticMean(AbstractAverage):
    """G = 1/M sum_m G_m over blocks of n_in experiments, or over single-experiment estimates of a local method.

    Noise in u makes single estimates scatter with heavy tails, and the mean with them (Guillaume 1998). Biased as the
    estimates are: a mean takes off their scatter alone.

    **Arguments:** `method`: estimates every block; default `H1()`, which on n_in experiments is Y U^-1.

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` where the method does.

    **Source:** Guillaume, IEEE Trans. Instrum. Meas. 47 (1998); Zimmermann & Moberg, section II.A.
    """

    method: AbstractMethod | None = None

    @property
    def inner(self) -> AbstractMethod:
        return H1() if self.method is None else self.method

    def mean(self, G):
        return G.mean(axis=1), jnp.zeros(len(G), bool)


class LogMean(AbstractAverage):
    """G = P^-1 exp(1/M sum_m log(P G_m)): mean of matrix logarithms (Guillaume 1998; Zimmermann & Moberg, Eq. (G_LOG)).

    P turns the eigenvalues of the first estimate to the positive real axis, so that the principal logarithm is
    far from its cut. Where a later eigenvalue comes within a right angle of the cut (|arg| > pi/2), or
    eigenvectors are nearly parallel, the line gets the status `LOG_BRANCH`. Outliers weigh less than in the arithmetic
    mean, and a gain that scatters multiplicatively is averaged without bias. Needs as many outputs as inputs.

    **Arguments:**

    - `method`: estimates every block; default `H1()`. `LogMean(LRM())` is the paper's average of single-experiment
      estimates.
    - `elementwise`: average the logarithm of every element instead, phases turned by the first estimate: for G that
      are not square. Off-diagonal elements that pass through zero are averaged badly.

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` where the method does, and for G that are not square without
    `elementwise`.

    **Source:** Guillaume, IEEE Trans. Instrum. Meas. 47 (1998); Zimmermann & Moberg, Eq. (G_LOG) and section II.C.4.
    The status `LOG_BRANCH` is this project's own.
    """

    method: AbstractMethod | None = None
    elementwise: bool = False

    @property
    def inner(self) -> AbstractMethod:
        return H1() if self.method is None else self.method

    def check(self, spectra: Spectra) -> None:
        averages = spectra.n_exp // self.block_size(spectra) > 1
        if averages and spectra.n_out != spectra.n_in and not self.elementwise:
            raise input_error(
                "LOG",
                f"{spectra.n_out} outputs and {spectra.n_in} inputs",
                "as many outputs as inputs for the matrix logarithm",
                "Average element by element (option elementwise=true), or stack the experiments instead of averaging.",
            )
        super().check(spectra)

    def calls_lapack(self, spectra: Spectra) -> bool:
        large = not self.elementwise and not is_small(spectra.n_out)
        return large or super().calls_lapack(spectra)

    def mean(self, G):
        if G.shape[1] == 1:
            return G[:, 0], jnp.zeros(len(G), bool)
        return jax.vmap(_elementwise_mean)(G) if self.elementwise else _matrix_means(G)


class RobustMean(AbstractAverage):
    """Weighted mean over blocks of experiments, of which some may be odd: sum_m w_m G_m / sum_m w_m.

    The weights are those of Tukey's biweight (Beaton & Tukey 1974) of a block's distance from the others, over all
    elements and some neighbouring lines, in units of the median distance: an experiment with swapped channels, a turned
    sign or a disturbance counts nothing, and of clean ones a few per cent of the information are lost. Needs three
    blocks, most of which agree. The covariance is that of the weighted mean from the scatter of the blocks,
    sum_m w_m^2 d_m d_m^H / ((sum_m w_m)^2 (1 - 1/sum_m w_m)); it holds everything that differs between blocks.
    Biased as the estimates of the blocks are, and useless where most of them are odd.

    **Arguments:** `method`: estimates every block; default `H1()`, which on n_in experiments is Y U^-1.

    **Raises:** (in `jaxfrf.estimate`) `jaxfrf.InputError` where the method does, and for fewer than three blocks.

    **Source:** Beaton & Tukey, Technometrics 16 (1974) 147-185 (the weights); their distance over elements and lines is
    this project's own.
    """

    method: AbstractMethod | None = None

    @property
    def inner(self) -> AbstractMethod:
        return H1() if self.method is None else self.method

    def check(self, spectra: Spectra) -> None:
        super().check(spectra)
        n_block = spectra.n_exp // self.block_size(spectra)
        if n_block < 3:
            raise input_error(
                "experiments",
                f"{counted(n_block, 'block')} of {self.block_size(spectra)}",
                "at least three, of which most agree",
                "Take another mean (log), or add experiments.",
            )

    @property
    def shares_lines(self) -> bool:
        return False  # weights look at neighbours

    def mean(self, G):
        return G.mean(axis=1), jnp.zeros(len(G), bool)

    def residual_dof(self, signals: Signals) -> float:
        return signals.n_exp // self.block_size(signals) - 1.0

    def at_point(self, signals: Signals, lines=None) -> Estimate:
        if lines is not None:  # weights look at neighbours
            every = self._blocks(signals, jnp.arange(signals.U.shape[1]))
            return jax.tree.map(lambda x: x[lines], self.of_blocks(every, signals))
        return self.of_blocks(self._blocks(signals, None), signals)

    def of_blocks(self, each: Estimate, signals: Signals) -> Estimate:
        n_block = len(each.G)
        known = jnp.isfinite(each.G).all(axis=(-2, -1))
        own = jnp.where(known[..., None, None], each.G, 0)
        weight = _block_weights(own, known)
        total = weight.sum(axis=0)
        G = jnp.sum(weight[..., None, None] * own, axis=0) / total[:, None, None]
        norm = jnp.sqrt(total**2 * jnp.maximum(1 - 1 / total, 0.1))
        deviation = jnp.swapaxes(own - G, -1, -2).reshape(*each.G.shape[:2], -1) * (weight / norm)[..., None]
        scatter = OuterSum(jnp.moveaxis(deviation, 0, -1))
        status = jnp.bitwise_or.reduce(each.status, axis=0) & ~int(Status.NO_COVARIANCE)
        return Estimate(
            G=G,
            cov=scatter,
            dof=jnp.maximum(total - 1, 0.5),
            status=status,
            window=each.window.mean(axis=0),
            doubtful=jnp.any(each.doubtful, axis=0),
            cov_noise=None if each.cov_noise is None else sum_over(each.cov_noise, 1 / n_block**2),
            cov_total=scatter,
        )


def _averaged(method: AbstractAverage, each: Estimate, points: dict, frequency) -> Estimate:
    """The mean at every operating point of blocks' estimates, (pos, block, freq, ...)."""

    def one(at):
        return method.of_blocks(at[0], Signals(**at[1], frequency=frequency))

    return jax.lax.map(one, (each, points))


def _block_weights(G, known) -> Float[Array, "block freq"]:
    """Weights of (block, freq, out, in); none where a block is not `known`, (block, freq)."""

    def middle(x):
        there = known.reshape(*known.shape, *[1] * (x.ndim - 2))
        return jnp.nanmedian(jnp.where(there, x, jnp.nan), axis=0)

    centre = middle(G.real) + 1j * middle(G.imag)
    n = G.shape[1]
    line = np.arange(n)
    first, last = np.maximum(line - _WEIGHT_REACH, 0), np.minimum(line + _WEIGHT_REACH + 1, n)
    for _ in range(_ROUNDS):
        power = jnp.abs(G - centre) ** 2
        distance = _nothing(jnp.mean(power / jnp.maximum(middle(power), 1e-300), axis=(-2, -1)), known)
        total = jnp.concatenate([jnp.zeros((len(G), 1)), jnp.cumsum(distance, axis=1)], axis=1)
        count = jnp.concatenate([jnp.zeros((len(G), 1)), jnp.cumsum(known, axis=1)], axis=1)
        count = jnp.maximum(count[:, last] - count[:, first], 1)
        distance = jnp.sqrt(jnp.maximum(total[:, last] - total[:, first], 0) / count)
        distance = distance / jnp.maximum(middle(distance), 1e-300)
        weight = _nothing(jnp.maximum(1 - (jnp.maximum(distance - 1, 0) / _CUT) ** 2, 0) ** 2, known)
        centre = jnp.sum(weight[..., None, None] * G, axis=0) / weight.sum(axis=0)[:, None, None]
    return weight


def _nothing(x, known):
    return jnp.where(known, x, 0.0)


def _in_blocks(mean, G):
    """`mean` of some lines after the others, so that what it needs stays in the cache."""
    whole = len(G) // _BLOCK * _BLOCK
    if len(G) <= _BLOCK:
        return mean(G)
    parts = jax.lax.map(mean, G[:whole].reshape(-1, _BLOCK, *G.shape[1:]))
    parts = jax.tree.map(lambda x: x.reshape(whole, *x.shape[2:]), parts)
    return jax.tree.map(lambda *x: jnp.concatenate(x), parts, mean(G[whole:])) if whole < len(G) else parts


@apart
def _matrix_means(G):
    """P^-1 exp(1/M sum_m log(P G_m)) of (line, block, n, n), and whether it is unsafe; NaN where there is none."""
    dead = ~((G != 0).any(axis=2).all(axis=2) & (G != 0).any(axis=3).all(axis=2)).all(axis=1)  # a row or column
    bad = ~jnp.isfinite(G).all(axis=(1, 2, 3)) | dead
    logs, P_inverse, unsafe = _logarithms(jnp.where(_of_line(bad, G), jnp.eye(G.shape[-1]), G))
    log_mean = logs / G.shape[1]
    finite = jnp.isfinite(log_mean).all(axis=(1, 2))
    mean, norm = exponentials(jnp.where(_of_line(finite, log_mean), log_mean, 0))
    known = ~bad & finite & (norm < LARGEST_NORM)
    return jnp.where(_of_line(known, mean), product(P_inverse, mean), jnp.nan), unsafe


def _logarithms(G):
    """sum_m log(P G_m), P^-1, and whether a branch is unsafe: of one block after the other, the first of which says
    what P is."""
    one = jnp.broadcast_to(jnp.eye(G.shape[-1], dtype=G.dtype), G[:, 0].shape)

    def with_block(before, block):
        turns, logs, unsafe = before
        number, G = block
        is_first = number == 0
        found, values, condition = matrix_functions((_turn, _only_logarithm), product(turns[0], G), 1 - is_first)
        turns = jnp.where(is_first, found[:2], turns)
        unsafe |= ~is_first & jnp.any(jnp.abs(jnp.angle(values)) > jnp.pi / 2, axis=1)
        return (turns, logs + found[2], unsafe | ~(condition <= _CONDITION)), None

    first = jnp.stack([one, one]), jnp.zeros_like(one), jnp.zeros(len(G), bool)
    blocks = jnp.arange(G.shape[1]), jnp.swapaxes(G, 0, 1)
    ((_, P_inverse), logs, unsafe), _ = jax.lax.scan(with_block, first, blocks)
    return logs, P_inverse, unsafe


def _of_line(x, like):
    """What every line has, beside arrays that have more axes."""
    return x.reshape(-1, *[1] * (like.ndim - 1))


def _turn(values):
    """Of an eigenvalue: what turns it to the positive real axis, the same backwards, and the logarithm there."""
    size = jnp.abs(values)
    turn = values.conj() / size
    return jnp.stack([turn, turn.conj(), jnp.log(size).astype(turn.dtype)])


def _only_logarithm(values):
    """Of one that is turned: beside two that are not asked for."""
    return jnp.stack([jnp.ones_like(values), jnp.ones_like(values), jnp.log(values)])


def _elementwise_mean(G):
    turned = G * jnp.exp(-1j * jnp.angle(G[:1]))
    mean = jnp.exp(jnp.log(turned).mean(axis=0)) * jnp.exp(1j * jnp.angle(G[0]))
    return mean, jnp.any(jnp.abs(jnp.angle(turned)) > jnp.pi / 2)


def _scatter(blocks, mean) -> OuterSum:
    """Covariance of the mean from the scatter of (block, freq, out, in) about it; NaN for one block."""
    n_block, n_freq = blocks.shape[:2]
    factor = np.sqrt(1 / (n_block * (n_block - 1))) if n_block > 1 else np.nan
    deviation = jnp.swapaxes(blocks - mean, -1, -2).reshape(n_block, n_freq, -1)
    return OuterSum(jnp.moveaxis(deviation, 0, -1) * factor)


def _joint_dof(cov, dof):
    """Degrees of freedom of a mean of variances of unequal size, the size of a block being its mean share in the
    variance of an element (Welch-Satterthwaite): (freq,)."""
    each = variances(cov)
    whole = each.sum(axis=0)
    share = jnp.where(whole > 0, each / jnp.where(whole > 0, whole, 1.0), 1 / each.shape[0]).mean(axis=-1)
    return 1 / (share**2 / dof).sum(axis=0)


def _by_experiment(signals: Signals) -> dict:
    names = [name for name in ("U", "Y", "R", "noise") if getattr(signals, name) is not None]
    return {name: getattr(signals, name) for name in names}


def _first(signals: Signals, size: int) -> Signals:
    """The first experiments."""
    return dataclasses.replace(signals, **{name: x[:size] for name, x in _by_experiment(signals).items()})


def _block_by_block(spectra: Spectra, size: int) -> Spectra:
    """Blocks of `size` experiments as operating points of their own: (pos*block, size, freq, channel)."""
    n_block = spectra.n_exp // size

    def split(x):
        x = np.asarray(x)[:, : n_block * size]
        return x.reshape(-1, size, *x.shape[2:])

    return dataclasses.replace(spectra, **changed_signals(spectra, split), q=None)
