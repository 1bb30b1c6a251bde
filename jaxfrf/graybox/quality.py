"""Where a fit does not follow its data: residuals against the FRF's uncertainty, by element, band and position."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, PyTree

from .._arguments import expect, expect_whole
from .._errors import input_error
from .._text import number
from .._types import Array
from ..frf import FRF
from .cost import Cost
from .fit import Fit
from .target import Target, Weights, assumed_cost, select, target

_DECIBEL = 20 / np.log(10)
_CHANCE = 0.01  # that any cell at all stands out where there is only noise
_WORST = 5


class Quality(eqx.Module):
    """Residuals E = log(G_measured/G_model) in cells of one position, one band and one element.

    **Fields:** (NaN where nothing was used)

    - `edges`: of the bands, Hz, (band + 1,).
    - `chi_square`: mean of |E|^2 over its variance as the FRF's covariance knows it, (pos, band, out, in): 1 for noise
      alone; NaN where the covariance is unknown. The variance is itself an estimate: with few degrees of freedom n
      noise alone makes n/(n - 1).
    - `square`: mean of |E|^2 by magnitude and phase, (pos, band, out, in, 2): squares of nepers and radians.
    - `count`: lines that were used, (pos, band, out, in).
    - `independent`: about as many independent lines as they amount to, (pos, band, out, in).
    - `weighted`: weighted square error at every position, (pos,). `assumed`: what it would be with errors as large as
      the weights allow, floor^2 + var/|G|^2.
    - `error`: sums of weighted squares by magnitude and phase, (pos, 2), and `weight`, the sums of their weights.
    """

    edges: Float[np.ndarray, "edge"]
    chi_square: Float[np.ndarray, "pos band out in"]
    square: Float[np.ndarray, "pos band out in 2"]
    count: Float[np.ndarray, "pos band out in"]
    independent: Float[np.ndarray, "pos band out in"]
    weighted: Float[np.ndarray, "pos"]
    assumed: Float[np.ndarray, "pos"]
    error: Float[np.ndarray, "pos 2"]
    weight: Float[np.ndarray, "pos 2"]

    @property
    def by_element(self) -> Float[np.ndarray, "out in"]:
        """Chi-square of every element, over all positions and lines."""
        return self._mean(self.chi_square, (0, 1))

    @property
    def by_output(self) -> Float[np.ndarray, "out"]:
        """Chi-square of every row of G."""
        return self._mean(self.chi_square, (0, 1, 3))

    @property
    def by_input(self) -> Float[np.ndarray, "in"]:
        """Chi-square of every column of G."""
        return self._mean(self.chi_square, (0, 1, 2))

    @property
    def by_band(self) -> Float[np.ndarray, "band"]:
        """Chi-square of every band."""
        return self._mean(self.chi_square, (0, 2, 3))

    @property
    def by_position(self) -> Float[np.ndarray, "pos"]:
        """Chi-square of every position."""
        return self._mean(self.chi_square, (1, 2, 3))

    @property
    def element_band(self) -> Float[np.ndarray, "band out in"]:
        """Chi-square of every element in every band, over all positions."""
        return self._mean(self.chi_square, (0,))

    @property
    def position_band(self) -> Float[np.ndarray, "pos band"]:
        """Chi-square of every position in every band, over all elements."""
        return self._mean(self.chi_square, (2, 3))

    @property
    def of_noise(self) -> bool:
        """Whether the covariance is known, so that residuals can be told in parts of the noise."""
        return bool(np.isfinite(self.chi_square).any())

    @property
    def maps(self) -> tuple[Float[np.ndarray, "vec band"], Float[np.ndarray, "pos band"]]:
        """Residuals over the noise, sqrt(chi-square), by element (rows of G one after the other) and by position; where
        the covariance is unknown rms errors in dB."""
        if not self.of_noise:
            cells = _DECIBEL * np.sqrt(np.nan_to_num(self.square[..., 0]))
            return cells.mean(axis=0).reshape(len(cells[0]), -1).T, cells.mean(axis=(2, 3))
        with np.errstate(invalid="ignore"):
            by_element = np.sqrt(self.element_band).reshape(len(self.edges) - 1, -1).T
            return by_element, np.sqrt(self.position_band)

    @property
    def cost(self) -> float:
        """Weighted square error over what the weights allow, |E|^2 = floor^2 + var/|G|^2: 1 is floor and noise."""
        return float(np.sum(self.weighted) / np.sum(self.assumed))

    @property
    def position_cost(self) -> Float[np.ndarray, "pos"]:
        """The same at every position."""
        return self.weighted / np.maximum(self.assumed, 1e-300)

    @property
    def rms_db(self) -> Float[np.ndarray, "pos"]:
        """Weighted root mean square error of the magnitude at every position, dB."""
        return _DECIBEL * np.sqrt(self.error[:, 0] / self.weight[:, 0])

    @property
    def rms_degrees(self) -> Float[np.ndarray, "pos"]:
        """Weighted root mean square error of the phase at every position, degrees."""
        return np.rad2deg(np.sqrt(self.error[:, 1] / self.weight[:, 1]))

    @property
    def total_db(self) -> float:
        """Weighted root mean square error of the magnitude, dB."""
        return float(_DECIBEL * np.sqrt(self.error[:, 0].sum() / self.weight[:, 0].sum()))

    @property
    def total_degrees(self) -> float:
        """Weighted root mean square error of the phase, degrees."""
        return float(np.rad2deg(np.sqrt(self.error[:, 1].sum() / self.weight[:, 1].sum())))

    def _mean(self, cells, axes):
        known = np.isfinite(cells)
        weight = self.count * known
        total = np.sum(np.where(known, cells, 0) * weight, axis=axes)
        with np.errstate(invalid="ignore", divide="ignore"):
            return total / np.sum(weight, axis=axes)

    def improbable(self) -> np.ndarray:
        """Cells whose residuals noise alone would hardly make (1 % that any cell does), (pos, band, out, in)."""
        from scipy.stats import chi2

        known = np.isfinite(self.chi_square)
        dof = np.where(known, 2 * self.independent, 1.0)
        chance = chi2.sf(np.where(known, self.chi_square, 0) * dof, dof)
        return known & (chance * max(np.count_nonzero(known), 1) < _CHANCE)

    def worst(self, positions: Sequence[int] | None = None, most: int = _WORST) -> list[str]:
        """Where the residuals stand out of the noise, in words, the worst first; nothing where they do not.

        Elements are counted from 1, positions from 0, or called by the numbers in `positions`. Where the covariance is
        unknown: the largest errors."""
        positions = range(len(self.weighted)) if positions is None else positions
        known = np.isfinite(self.chi_square).any()
        size = self.chi_square if known else self.square.sum(axis=-1)
        chosen = self.improbable() if known else np.isfinite(size)
        order = np.argsort(np.where(chosen, -size, np.inf), axis=None)[: min(most, np.count_nonzero(chosen))]
        return [self._says(positions, *np.unravel_index(k, size.shape)) for k in order]

    def _says(self, positions, pos, band, out, ref) -> str:
        cell = pos, band, out, ref
        size = (
            f"{number(_DECIBEL * np.sqrt(self.square[(*cell, 0)]), 2)} dB, "
            f"{number(np.rad2deg(np.sqrt(self.square[(*cell, 1)])), 2)} degrees"
        )
        separator = "" if max(out, ref) < 9 else ","
        where = (
            f"G{out + 1}{separator}{ref + 1} between {number(self.edges[band])} and {number(self.edges[band + 1])} Hz "
            f"at position {positions[pos]}"
        )
        chi = self.chi_square[cell]
        return f"{where}: {np.sqrt(chi):.1f} times the noise ({size})" if np.isfinite(chi) else f"{where}: {size}"


def quality(fitted: Fit, frf: FRF, weights: Weights | None = None, bands: int = 8) -> Quality:
    """Residuals of a fit on the data that it was made to.

    Of an indirect fit they are those between measurement and simulation. What repeats in both (distortion
    by the same references) cancels there, while the covariance holds it: chi-square below 1.

    Where the FRF's covariance is too small (a bias, lines that share data more than is known), chi-square is above 1
    for a right model.

    **Arguments:** `fitted`: of `jaxfrf.fit`. `frf`, `weights`: that were fitted. `bands`: how many, of equal width in
    the logarithm.

    **Returns:** a `Quality`: chi-square and errors by position, band and element.

    **Raises:** `jaxfrf.InputError` for another FRF than was fitted (see `jaxfrf.graybox.model_quality`), and for less
    than one band.

    **Source:** a definition (chi-square, rms); the cells are this project's own.
    """
    expect("fitted", fitted, Fit)
    expect("frf", frf, FRF)
    _check_fitted(fitted.target, frf)
    E, _ = Cost(fitted.model, fitted.coordinates, fitted.target).errors(jnp.asarray(fitted.x))
    return residual_quality(np.asarray(E), fitted.target, frf, weights, bands)


def _check_fitted(fitted: Target, frf: FRF) -> None:
    """Refuse another FRF than the one that a target was made of."""
    lines = np.shape(fitted.frequency) == np.shape(frf.frequency) and np.allclose(fitted.frequency, frf.frequency)
    G = np.asarray(frf.G)
    g = G.swapaxes(-1, -2).reshape(*G.shape[:2], -1)
    same = lines and g.shape == fitted.log_G.shape
    used = np.asarray(fitted.used)
    if not same or not np.allclose(np.exp(fitted.log_G[used]), g[used], rtol=1e-6, atol=0.0):
        raise input_error(
            "frf",
            "other numbers" if same else "other lines or another shape",
            "the FRF that was fitted",
            "Compare the fit with another one by jaxfrf.graybox.model_quality.",
        )


def model_quality(
    fitted: Fit, frf: FRF, weights: Weights | None = None, points: PyTree | None = None, bands: int = 8
) -> Quality:
    """Errors of a fitted model on another FRF: positions that were not fitted.

    **Arguments:** `fitted`: of `jaxfrf.fit`. `frf`: the other one, (pos, freq, out, in), of the quantity that the model
    gives. `weights`: as in `jaxfrf.fit`; `Weights()` by default. `points`: operating points of the FRF, leading axis
    pos; from its q (rad) by default. `bands`: how many, of equal width in the logarithm.

    **Returns:** a `Quality`: chi-square and errors by position, band and element.

    **Raises:** `jaxfrf.InputError` where weights have another shape, nothing is left to compare, the FRF has no `q`
    that the model could take, and for less than one band.

    **Source:** as of `jaxfrf.quality`.
    """
    points = fitted.model.points(frf.q, frf.n_pos) if points is None else points
    tg = target(frf, Weights() if weights is None else weights, points)
    E, _ = Cost(fitted.model, fitted.coordinates, tg).errors(jnp.asarray(fitted.x))
    return residual_quality(np.asarray(E), tg, frf, weights, bands)


def response_quality(
    G: Complex[Array, "pos freq out in"], frf: FRF, weights: Weights | None = None, bands: int = 8
) -> Quality:
    """Errors of any response G, a simulated one for example, against a measured FRF at the same lines.

    **Arguments:** `G`: (pos, freq, out, in), unit of the FRF. `frf`: the measured one. `weights`: as in `jaxfrf.fit`;
    `Weights()` by default. `bands`: how many, of equal width in the logarithm.

    **Returns:** a `Quality`: chi-square and errors by position, band and element.

    **Raises:** `jaxfrf.InputError` if `G` has another shape than the FRF, nothing is left to compare, and for less than
    one band.

    **Source:** as of `jaxfrf.quality`.
    """
    if np.shape(G) != np.shape(frf.G):
        raise input_error("G", f"shape {np.shape(G)}", f"{np.shape(frf.G)} as the FRF", "Take the same lines.")
    tg = target(frf, Weights() if weights is None else weights, np.zeros((frf.n_pos, 0)))
    g = np.asarray(G).swapaxes(-1, -2).reshape(tg.log_G.shape)
    used = tg.used & np.isfinite(g) & (g != 0)
    E = np.where(used, np.log(np.exp(tg.log_G) / np.where(used, g, 1)), 0)
    return residual_quality(E, dataclasses.replace(tg, used=used), frf, weights, bands)


def residual_quality(
    E: Complex[np.ndarray, "pos freq vec"], tg: Target, frf: FRF, weights: Weights | None = None, bands: int = 8
) -> Quality:
    """`Quality` from residuals, the FRF and its weights, and the target that they made."""
    shape, floor = (frf.n_out, frf.n_in), (Weights() if weights is None else weights).floor
    used = np.asarray(tg.used)
    variance = np.real(np.diagonal(np.asarray(tg.cov), axis1=-2, axis2=-1))
    stated = ~np.isnan(np.asarray(frf.cov)).any(axis=(-1, -2))  # elsewhere something stands in for the variance
    known = used & (variance > 0) & stated[..., None]
    ratio = np.where(known, np.abs(E) ** 2, 0) / np.where(known, variance, 1)
    edges = _edges(np.asarray(tg.frequency)[used.any(axis=(0, 2))], bands)
    inside = _membership(np.asarray(tg.frequency), edges)  # (band, freq)
    total = lambda x: np.einsum("bf,pfv->pbv", inside, x)
    per = lambda x, n: np.where(n > 0, x / np.maximum(n, 1), np.nan)
    count, count_known = total(used.astype(float)), total(known.astype(float))
    square = np.stack([per(total(np.where(used, part, 0) ** 2), count) for part in (E.real, E.imag)], axis=-1)
    E = np.where(used, E, 0)
    parts = ((np.asarray(tg.magnitude) * used, E.real), (np.asarray(tg.phase) * used, E.imag))
    seen = E
    if tg.whitener is not None:
        seen = np.einsum("pfvw,pfw->pfv", tg.whitener, seen)
    weighted = (np.asarray(tg.magnitude) * seen.real) ** 2 + (np.asarray(tg.phase) * seen.imag) ** 2
    return Quality(
        edges=edges,
        chi_square=_cells(per(total(ratio), count_known), shape),
        square=np.stack([_cells(square[..., k], shape) for k in (0, 1)], axis=-1),
        count=_cells(count, shape),
        independent=_cells(_independent(known, tg.overlap, inside), shape),
        error=np.stack([np.sum((m * part) ** 2, axis=(1, 2)) for m, part in parts], axis=-1),
        weight=np.stack([np.sum(np.square(m), axis=(1, 2)) for m, _ in parts], axis=-1),
        weighted=weighted.sum(axis=(1, 2)),
        assumed=np.array([assumed_cost(select(tg, positions=[pos]), floor) for pos in range(tg.n_pos)]),
    )


def _edges(frequency, bands: int) -> np.ndarray:
    expect_whole("bands", bands, 1)
    low, high = float(frequency.min()), float(frequency.max())
    return np.geomspace(max(low, 1e-9), max(high, low * (1 + 1e-9), 1e-9), int(bands) + 1)


def _membership(frequency, edges) -> np.ndarray:
    which = np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, len(edges) - 2)
    within = (frequency >= edges[0] * (1 - 1e-9)) & (frequency <= edges[-1] * (1 + 1e-9))
    return (which[None] == np.arange(len(edges) - 1)[:, None]) & within[None]


def _independent(known, overlap, inside) -> np.ndarray:
    """n^2 / sum of squared correlations of the n lines of a cell: estimates whose windows share data are fewer."""
    n = np.einsum("bf,pfv->pbv", inside, known.astype(float))
    if overlap is None:
        return n
    shared = np.stack([_shared(own, rho, inside) for own, rho in zip(known.astype(float), overlap, strict=True)])
    return np.where(shared > 0, n**2 / np.maximum(shared, 1e-300), 0.0)


def _shared(own, rho, inside) -> np.ndarray:
    """Sum of squared correlations within every band, (band, vec)."""
    alike = bool(np.all(own == own[:, :1]))
    columns = own[:, :1] if alike else own
    found = np.array([[rho.sum_of_squares(band * x) for x in columns.T] for band in inside])
    return np.broadcast_to(found, (len(inside), own.shape[1])) if alike else found


def _cells(x, shape: tuple[int, int]) -> np.ndarray:
    """(pos, band, vec), columns stacked, as (pos, band, out, in)."""
    return x.reshape(*x.shape[:2], shape[1], shape[0]).swapaxes(-1, -2)
