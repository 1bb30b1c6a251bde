"""Averages over blocks of experiments: arithmetic and logarithmic."""

import numpy as np

from .._errors import input_error
from .._status import Status
from ..spectra import Spectra
from .classical import H1
from .inverse import inverse
from .method import AbstractMethod, Estimate, KroneckerSum, dense, split_blocks, variances

_CONDITION = 1e6  # of the eigenvectors: above it the matrix logarithm loses half of the digits


class AbstractAverage(AbstractMethod):
    """Estimate every block of experiments on its own, then average.

    The covariance is that of the mean: the blocks' own covariances where they have any, else (classical estimates of
    n_in experiments have no residual) their scatter,

        1/(M (M-1)) sum_m vec(G_m - G) vec(G_m - G)^H,

    which for M blocks has rank M-1 at most, and takes the linear mean for the logarithmic one (first order). The
    paper divides by M^2, which is too small by (M-1)/M. `cov_total` holds the scatter in either case.
    """

    def block_size(self, spectra: Spectra) -> int:
        return self._inner.block_size(spectra)

    def check(self, spectra: Spectra) -> None:
        size = self.block_size(spectra)
        self._inner.check(split_blocks(spectra, size) if spectra.n_exp >= size else spectra)

    @property
    def _inner(self) -> AbstractMethod:
        return H1() if self.method is None else self.method

    def estimate(self, spectra: Spectra) -> Estimate:
        size = self.block_size(spectra)
        n_block = spectra.n_exp // size
        each = self._inner.estimate(split_blocks(spectra, size))

        def blocks(x):
            return np.asarray(x).reshape(spectra.n_pos, n_block, *x.shape[1:])

        G, flags = self._mean(blocks(each.G))
        scatter = _scatter(blocks(each.G), G)
        dof = blocks(each.dof)
        own = bool(np.all(dof > 0))
        status = np.bitwise_or.reduce(blocks(each.status), axis=1) | flags
        if not own:
            known = int(Status.NO_COVARIANCE)
            status = status & ~known if n_block > 1 else status | known
        return Estimate(
            G=G,
            cov=_mean_covariance(each.cov, spectra.n_pos, n_block) if own else scatter,
            dof=_joint_dof(each.cov, dof) if own else np.full(G.shape[:2], n_block - 1.0),
            status=status,
            window=blocks(each.window).mean(axis=1),
            cov_noise=None if each.cov_noise is None else blocks(each.cov_noise).sum(axis=1) / n_block**2,
            cov_total=scatter if n_block > 1 else None,
        )


class ArithmeticMean(AbstractAverage):
    """G = 1/M sum_m G_m over blocks of n_in experiments, or over single-experiment estimates of a local method.

    Noise in u makes single estimates scatter with heavy tails, and the mean with them (Guillaume 1998).

    **Arguments:** `method`: estimates every block; default `H1()`, which on n_in experiments is Y U^-1.
    """

    method: AbstractMethod | None = None

    def _mean(self, G):
        return G.mean(axis=1), np.zeros((G.shape[0], G.shape[2]), int)


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
    """

    method: AbstractMethod | None = None
    elementwise: bool = False

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

    def _mean(self, G):
        if G.shape[1] == 1:
            return G[:, 0], np.zeros((G.shape[0], G.shape[2]), int)
        return _elementwise_mean(G) if self.elementwise else _matrix_mean(G)


def _matrix_mean(G):
    """Logarithmic mean over axis 1 of (pos, block, freq, n, n), and the flags; NaN where a block is not finite."""
    bad = ~np.isfinite(G).all(axis=(1, 3, 4))[:, None, :, None, None]
    G = np.where(bad, np.eye(G.shape[-1]), G)
    values, V = np.linalg.eig(G[:, 0])
    P = _similar(np.exp(-1j * np.angle(values)), V)
    turned_values, vectors = np.linalg.eig(np.nan_to_num(P)[:, None] @ G)
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = _similar(np.log(turned_values), vectors)
        mean_values, mean_vectors = np.linalg.eig(np.nan_to_num(logs.mean(axis=1)))
        mean = inverse(P) @ _similar(np.exp(mean_values), mean_vectors)
        unsafe = np.any(np.abs(np.angle(turned_values)) > np.pi / 2, axis=(1, 3))
        unsafe |= np.any(np.linalg.cond(vectors) > _CONDITION, axis=1) | (np.linalg.cond(V) > _CONDITION)
    return np.where(bad[:, 0], np.nan, mean), np.where(unsafe, int(Status.LOG_BRANCH), 0)


def _elementwise_mean(G):
    turned = G * np.exp(-1j * np.angle(G[:, :1]))
    with np.errstate(divide="ignore"):
        mean = np.exp(np.log(turned).mean(axis=1)) * np.exp(1j * np.angle(G[:, 0]))
    unsafe = np.any(np.abs(np.angle(turned)) > np.pi / 2, axis=(1, 3, 4))
    return mean, np.where(unsafe, int(Status.LOG_BRANCH), 0)


def _similar(values, V):
    """V diag(values) V^-1."""
    return (V * values[..., None, :]) @ inverse(V)


def _scatter(blocks, mean):
    """Covariance of the mean from the scatter of (pos, block, freq, out, in) about it; NaN for one block."""
    n_pos, n_block, n_freq, n_out, n_in = blocks.shape
    deviation = (blocks - mean[:, None]).swapaxes(-1, -2).reshape(n_pos, n_block, n_freq, n_in * n_out)
    deviation = np.moveaxis(deviation, 1, -1)
    factor = 1 / (n_block * (n_block - 1)) if n_block > 1 else np.nan
    return (deviation @ deviation.conj().swapaxes(-1, -2)) * factor


def _joint_dof(cov, dof):
    """Degrees of freedom of a mean of variances of unequal size, the size of a block being its mean share in the
    variance of an element (Welch-Satterthwaite): (pos, freq)."""
    n_pos, n_block = dof.shape[:2]
    each = np.asarray(variances(cov)).reshape(n_pos, n_block, dof.shape[2], -1)
    whole = each.sum(axis=1, keepdims=True)
    share = np.divide(each, whole, out=np.full_like(each, 1 / n_block), where=whole > 0).mean(axis=-1)
    return 1 / (share**2 / dof).sum(axis=1)


def _mean_covariance(cov, n_pos: int, n_block: int):
    """Covariance of the mean of independent estimates: their covariances' sum over n_block^2."""
    if not isinstance(cov, KroneckerSum):
        return dense(cov).reshape(n_pos, n_block, *cov.shape[1:]).sum(axis=1) / n_block**2

    def terms(x):
        x = np.asarray(x).reshape(n_pos, n_block, *x.shape[1:])
        x = np.moveaxis(x, 1, 2)
        return x.reshape(n_pos, x.shape[1], -1, *x.shape[4:])

    return KroneckerSum(left=terms(cov.left) / n_block**2, right=terms(cov.right))
