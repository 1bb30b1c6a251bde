"""Classical estimators: H1, H2 and Hv, one line at a time."""

import dataclasses

import numpy as np

from .._errors import input_error
from .._status import Status
from ..spectra import Spectra
from .inverse import inverse
from .least_squares import AbstractLeastSquares, check_periodic
from .method import AbstractMethod, Estimate, KroneckerSum
from .window import Windows

_DEPENDENT = 1e-9  # singular values this small, relative to the largest, are rounding


class H1(AbstractLeastSquares):
    """G = Y U^H (U U^H)^-1 over all experiments: least squares with the noise in y.

    Biased low by noise in u; in closed loop biased by the noise that the controller feeds back, however many
    experiments there are. Needs n_exp >= n_in. With n_exp = n_in there is no residual, and `cov` is NaN; with several
    periods `cov_noise` still shows the measurement noise (Guillaume 1998; Zimmermann & Moberg, Eq. (G_H1)).
    """

    @property
    def polynomial_order(self) -> int:
        return 0

    @property
    def has_denominator(self) -> bool:
        return False

    @property
    def transient_order(self) -> None:
        return None

    def fractions(self, n_target: int):
        return (tuple(range(n_target)),)

    def windows(self, spectra: Spectra, n_parameters: int) -> Windows:
        check_experiments(spectra, n_parameters)
        return Windows(np.arange(len(spectra.lines)), 1)

    def block_size(self, spectra: Spectra) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        super().check(spectra)
        check_independent("u", spectra.U)

    def estimate(self, spectra: Spectra) -> Estimate:
        return with_noise(super().estimate(spectra), spectra, spectra.U)

    def joint(self, spectra: Spectra) -> Estimate:
        return with_noise(super().joint(spectra), spectra, spectra.R)


class H2(AbstractMethod):
    """G = Y Y^H (U Y^H)^-1: least squares with the noise in u. As many outputs as inputs.

    Biased high by noise in y; better than `H1` at resonances, where y is large and u small. The covariance is H1's,
    to first order.
    """

    def block_size(self, spectra: Spectra) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        check_periodic(spectra, H1())
        check_experiments(spectra, spectra.n_in)
        check_independent("u", spectra.U)
        if spectra.n_out != spectra.n_in:
            raise input_error(
                "H2",
                f"{spectra.n_out} outputs and {spectra.n_in} inputs",
                "as many outputs as inputs",
                "Use h1 or hv, or choose as many outputs as inputs.",
            )

    def estimate(self, spectra: Spectra) -> Estimate:
        U, Y = by_line(spectra.U), by_line(spectra.Y)
        return _residual_estimate(spectra, Y @ _h(Y) @ inverse(U @ _h(Y)))


class Hv(AbstractMethod):
    """Total least squares, one output at a time: noise in y and in every u, of equal power in the scaled signals.

    Between `H1` and `H2`: G_i from the eigenvector of the smallest eigenvalue of the cross-spectral matrix of [u; y_i],
    each signal scaled to unit power (Rocklin, Crowley & Vold 1985). Without noise all three agree. The covariance is
    H1's, to first order.
    """

    def block_size(self, spectra: Spectra) -> int:
        return spectra.n_in

    def check(self, spectra: Spectra) -> None:
        check_periodic(spectra, H1())
        check_experiments(spectra, spectra.n_in)
        check_independent("u", spectra.U)

    def estimate(self, spectra: Spectra) -> Estimate:
        U, Y = by_line(spectra.U), by_line(spectra.Y)
        G = np.stack([_total_least_squares(U, Y[..., [i], :]) for i in range(spectra.n_out)], axis=-2)
        return _residual_estimate(spectra, G)


def check_experiments(spectra: Spectra, needed: int) -> None:
    if spectra.n_exp < needed:
        raise input_error(
            "experiments",
            f"{spectra.n_exp} at each operating point, with {spectra.n_in} inputs",
            f"at least {needed} for a classical estimate",
            "Add experiments, or use a local method (lpm, lrm-mimo, lrm-jio), which can do with one.",
        )


def check_independent(name: str, X) -> None:
    """Raise if the experiments are linearly dependent at every line, as when one record is repeated."""
    singular = np.linalg.svd(by_line(X), compute_uv=False)
    rank = (singular > _DEPENDENT * singular[..., :1]).sum(axis=-1)
    n = X.shape[-1]
    worst = rank.max(axis=1)
    if worst.min() < n:
        pos = int(np.argmin(worst))
        raise input_error(
            name,
            f"{X.shape[1]} experiments of rank {int(worst[pos])} at every line of position {pos}",
            f"rank {n}: experiments with as many independent excitations as inputs",
            "Use other phase realisations, or orthogonal multisines, in every experiment.",
        )


def by_line(X) -> np.ndarray:
    """Experiments side by side as columns: (pos, exp, freq, channel) -> (pos, freq, channel, exp)."""
    return np.moveaxis(np.asarray(X), 1, -1)


def with_noise(estimate: Estimate, spectra: Spectra, instrument) -> Estimate:
    """Add what the scatter between periods says of the covariance of G = Y Z^H (U Z^H)^-1, Z the instrument."""
    if spectra.noise is None:
        return estimate
    Z = by_line(instrument)
    weight = _h(Z) @ np.linalg.pinv(by_line(spectra.U) @ _h(Z))
    G = np.asarray(estimate.G)
    effect = np.concatenate([np.broadcast_to(np.eye(spectra.n_out), (*G.shape[:-1], spectra.n_out)), -G], axis=-1)
    effect = effect[:, None]
    error = np.moveaxis(effect @ np.asarray(spectra.noise) @ _h(effect), 1, 2)
    left = weight[..., :, :, None] * weight.conj()[..., :, None, :]
    return dataclasses.replace(estimate, cov_noise=KroneckerSum(left=left, right=error).dense())


def _residual_estimate(spectra: Spectra, G) -> Estimate:
    """An estimate given G: covariance from the residuals over experiments, as for H1."""
    U, Y = by_line(spectra.U), by_line(spectra.Y)
    dof = spectra.n_exp - spectra.n_in
    shape = G.shape[:2]
    residual = Y - G @ U
    with np.errstate(invalid="ignore", divide="ignore"):
        C = residual @ _h(residual) / dof if dof else np.full((*shape, spectra.n_out, spectra.n_out), np.nan + 0j)
    S = np.linalg.pinv(U @ _h(U)).swapaxes(-1, -2)
    estimate = Estimate(
        G=G,
        cov=KroneckerSum(left=S[..., None, :, :], right=C[..., None, :, :]),
        dof=np.full(shape, float(dof)),
        status=np.full(shape, 0 if dof else int(Status.NO_COVARIANCE)),
        window=np.ones(shape),
    )
    return with_noise(estimate, spectra, spectra.U)


def _total_least_squares(U, y):
    scale_u, scale_y = (np.sqrt(np.mean(np.abs(x) ** 2, axis=-1, keepdims=True)) for x in (U, y))
    both = np.concatenate([U / scale_u, y / scale_y], axis=-2)
    _, vectors = np.linalg.eigh(both @ _h(both))
    v = vectors[..., :, 0].conj()
    return -v[..., :-1] / v[..., -1:] * scale_y[..., 0] / scale_u[..., 0]


def _h(x):
    return x.conj().swapaxes(-1, -2)
