"""An FRF made ready for fitting: its logarithm, and what each element of it counts."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, PyTree

from .._arguments import expect, expect_index, expect_number, expect_real, said
from .._errors import input_error
from .._types import Array
from ..frf import FRF, features
from ..frf.overlap import Overlap, overlaps
from ..frf.scatter import scatter

_LEAST = 2.0  # degrees of freedom beyond the size of a covariance: with fewer, its inverse has no variance
_FLOOR = 1e-6  # a variance of zero has no weight


class Weights(eqx.Module):
    """What counts in the fit.

    The weight of an element at a line is user weight / (var/|G|^2 + floor^2): the uncertainty of the FRF together with
    what the model (and the estimator's bias) can be trusted to. Elements more uncertain than `reject` are left out;
    where the covariance is not known (NaN), var is how far lines scatter about fractions through eleven of them, which
    takes a resonance of a line or two for noise (of fewer than eleven lines any).

    **Arguments:**

    - `floor`: relative error that the model itself may have.
    - `off_diagonal`: user weight of off-diagonal elements beside 1 on the diagonal.
    - `focus`: extra user weight of every diagonal element between .8 times its first antiresonance and 1.25 times the
      first resonance behind it; 1 for none. Where no antiresonance is found, none.
    - `reject`: elements with var/|G|^2 above it are dropped: the logarithm of something that uncertain is biased.
    - `elements`: user weight of every element, (out, in), or `None`: 1 and `off_diagonal`.
    - `bands`: (lowest Hz, highest Hz, factor) of bands that count more, less (0: not at all).
    - `correlated`: whiten with the full covariance of all elements of a line, instead of one by one:
      W = S D S, S the Hermitian root of (cov E + floor^2 I)^-1 and D the user weights.

    **Raises:** `jaxfrf.InputError` for numbers below 0, or that are none, and for bands that are none.

    **Source:** Zimmermann & Moberg, section III.B (uncertainty and user choice; antiresonance and resonance weighted
    highest); they state no numbers, the defaults are this project's own.
    """

    floor: float = 0.03
    off_diagonal: float = 0.2
    focus: float = 4.0
    reject: float = 0.25
    elements: Float[Array, "out in"] | None = None
    bands: tuple[tuple[float, float, float], ...] = eqx.field(static=True, default=())
    correlated: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        given = {"floor": self.floor, "off_diagonal": self.off_diagonal, "focus": self.focus}
        if np.ndim(self.reject) or self.reject != np.inf:  # rejects nothing
            given["reject"] = self.reject
        for name, value in given.items():
            expect_number(f"weights.{name}", value)
        if self.elements is not None:
            expect_real("weights.elements", self.elements)
        if isinstance(self.bands, str) or not isinstance(self.bands, Sequence):
            raise input_error("weights.bands", said(self.bands), "a list of bands", "E.g. ((0.0, 5.0, 0.1),).")
        if not self.floor >= 0 or not self.off_diagonal >= 0 or not self.focus > 0 or not self.reject > 0:
            raise input_error(
                "weights",
                f"floor {self.floor}, off_diagonal {self.off_diagonal}, focus {self.focus}, reject {self.reject}",
                "floor and off_diagonal of 0 or more, focus and reject above 0",
                "Correct them.",
            )
        for band in self.bands:
            if not _is_weighed(band):
                raise input_error(
                    "weights.bands",
                    f"{band}",
                    "(lowest Hz, highest Hz, factor), the factor 0 or more",
                    "Correct the band.",
                )


def _is_weighed(band) -> bool:
    """Whether it is a lower and an upper end, which may be infinite, and a factor."""
    try:
        low, high, factor = np.asarray(band, float)
    except (TypeError, ValueError):
        return False
    return bool(low <= high and 0 <= factor < np.inf)


class Target(eqx.Module):
    """An FRF made ready for fitting.

    **Fields:** `frequency`: (freq,), Hz. `log_G`: log of the measured elements, (pos, freq, vec), columns stacked; 0
    where left out. `shift`: what is added to the log of the model's response before it is compared, (pos, freq, vec):
    0, or what a motion makes of the linear response (`jaxfrf.fit_in_motion`). `magnitude`, `phase`: square
    roots of the weights of Re E and Im E, (pos, freq, vec). `whitener`: matrix applied to E before them, (pos, freq,
    vec, vec), or `None`. `cov`: covariance of E, (pos, freq, vec, vec); where it is not known, what stands in for it in
    the weights, the scatter of neighbouring lines. `overlap`: correlation between the estimates of two lines, one for
    each position, or `None` for independent lines. `points`: operating points, leading axis pos. `used`: (pos, freq,
    vec). `scatter`: how much more the cost and the variance of its gradient are than weights from the true covariance
    would make them, because the weights come from a covariance of few degrees of freedom, (pos, freq, 2). `fractions`:
    outputs of G, where windows were fitted by fractions, whose errors at neighbouring lines are alike as the response
    is; 0 otherwise.
    """

    frequency: Float[Array, "freq"]
    log_G: Complex[Array, "pos freq vec"]
    shift: Complex[Array, "pos freq vec"]
    magnitude: Float[Array, "pos freq vec"]
    phase: Float[Array, "pos freq vec"]
    whitener: Complex[Array, "pos freq vec vec"] | None
    cov: Complex[Array, "pos freq vec vec"]
    overlap: tuple[Overlap, ...] | None
    points: PyTree
    used: Bool[Array, "pos freq vec"]
    scatter: Float[Array, "pos freq two"]
    fractions: int = eqx.field(static=True, default=0)

    @property
    def n_pos(self) -> int:
        return self.log_G.shape[0]

    @property
    def n_terms(self) -> int:
        """Real numbers that the cost compares."""
        return 2 * int(np.count_nonzero(self.used))


def shifted(target: Target, shift: Complex[Array, "pos freq vec"], points: PyTree) -> Target:
    """The same target at these operating points, with a `shift`; elements where that is not finite are left out."""
    used = np.asarray(target.used) & np.isfinite(shift)
    return dataclasses.replace(target, shift=np.where(used, shift, 0), used=used, points=points)


def target(frf: FRF, weights: Weights, points: PyTree) -> Target:
    """An FRF with weights, ready for `fit`.

    **Raises:** `jaxfrf.InputError` if weights are none or have another shape, or nothing is left to fit.
    """
    expect("weights", weights, Weights)
    G = np.asarray(frf.G)
    g = G.swapaxes(-1, -2).reshape(*G.shape[:2], -1)
    usable = np.isfinite(g) & (np.abs(g) > 0)
    size = np.where(usable, g, 1.0)
    cov = np.asarray(frf.cov)
    # An infinite variance says that an element is worthless, NaN that nothing is known of the line's covariance.
    worthless = np.isposinf(np.real(np.diagonal(cov, axis1=-2, axis2=-1)))
    cov = np.where(worthless[..., :, None] | worthless[..., None, :], 0, cov)
    known = np.isfinite(cov).all(axis=(-1, -2), keepdims=True)
    relative = np.where(known, cov, 0) / (size[..., :, None] * size.conj()[..., None, :])
    variance = np.real(np.diagonal(relative, axis1=-2, axis2=-1))
    if not known.all():
        off = [scatter(np.asarray(frf.frequency), x) for x in np.where(usable, g, np.nan)]
        variance = np.where(known[..., 0], variance, np.nan_to_num(np.square(off / np.abs(size))))
    relative = np.where(known, relative, variance[..., None] * np.eye(size.shape[-1]))
    user = _user_weights(frf, weights)
    used = usable & ~worthless & (variance <= weights.reject) & (user > 0)
    if not used.any():
        raise input_error(
            "FRF",
            f"no element more certain than var/|G|^2 = {weights.reject:g} with a weight above 0",
            "some elements to fit",
            "More experiments, a wider window, another `reject`, or other weights.",
        )
    floor = max(weights.floor, _FLOOR)
    if weights.correlated:
        whitener = _whitener(relative, used, floor)
        root = np.sqrt(user) * used
    else:
        whitener = None
        root = np.sqrt(user / (variance + floor**2)) * used
    relative = np.where(used[..., :, None] & used[..., None, :], relative, 0)
    return Target(
        frequency=np.asarray(frf.frequency),
        log_G=np.where(used, np.log(np.where(used, g, 1.0)), 0),
        shift=np.zeros_like(g),
        magnitude=root,
        phase=root,
        whitener=whitener,
        cov=relative,
        overlap=overlaps(np.asarray(frf.window)),
        points=points,
        used=used,
        scatter=_scatter(frf, weights, variance, used, floor),
        fractions=frf.n_out if "LRM(" in frf.method else 0,
    )


def _user_weights(frf: FRF, weights: Weights) -> np.ndarray:
    """(pos, freq, vec)"""
    shape = (frf.n_out, frf.n_in)
    if weights.elements is None:
        square = np.full(shape, weights.off_diagonal if min(shape) > 1 else 1.0)
        np.fill_diagonal(square, 1.0)
    else:
        square = np.asarray(weights.elements, float)
        if square.shape != shape or not np.all(square >= 0):
            raise input_error(
                "weights.elements", f"shape {square.shape}", f"{shape}, 0 or more", "One weight for each element."
            )
    user = np.broadcast_to(square, (frf.n_pos, len(frf.frequency), *shape)).copy()
    if weights.focus != 1.0:
        for pos in range(frf.n_pos):
            for axis in range(min(shape)):
                low, high = focus_band(frf, axis, pos)
                inside = (frf.frequency >= low) & (frf.frequency <= high)
                user[pos, inside, axis, axis] *= weights.focus
    for low, high, factor in weights.bands:
        user[:, (frf.frequency >= low) & (frf.frequency <= high)] *= factor
    return user.swapaxes(-1, -2).reshape(*user.shape[:2], -1)


def focus_band(frf: FRF, axis: int, position: int) -> tuple[float, float]:
    """From .8 of the first antiresonance of a diagonal element to 1.25 of the resonance behind it, Hz.

    **Arguments:** `frf`: (pos, freq, out, in). `axis`, `position`: of the element and the operating point, from 0.

    **Returns:** lowest and highest frequency, Hz; infinite where there is no antiresonance. Without a resonance behind
    it, the highest is twice the antiresonance.

    **Raises:** `jaxfrf.InputError` if `frf` is none, or has no such axis or position.

    **Source:** extrema as of `jaxfrf.features`; the factors are this project's own.
    """
    expect("frf", frf, FRF)
    expect_index("axis", axis, min(frf.n_out, frf.n_in))
    expect_index("position", position, frf.n_pos)
    found = features(frf, axis, axis, position=position)
    low = min((x.frequency for x in found if x.kind == "antiresonance"), default=np.inf)
    high = min((x.frequency for x in found if x.kind == "resonance" and x.frequency > low), default=1.6 * low)
    return 0.8 * low, 1.25 * high


def _whitener(relative, used, floor: float):
    """(cov of E + floor^2 I)^-1/2 among the used elements; zero rows and columns elsewhere.

    The Hermitian root: each of its rows stays as near to its element as can be, so that user weights mean what they
    say and the order of the channels does not matter, as it would with a triangular factor.
    """
    both = used[..., :, None] & used[..., None, :]
    eye = np.eye(used.shape[-1])
    matrix = np.where(both, relative, 0) + eye * np.where(used, floor**2, 1.0)[..., None, :]
    values, vectors = np.linalg.eigh(matrix)
    root = (vectors / np.sqrt(np.maximum(values, floor**2))[..., None, :]) @ vectors.swapaxes(-1, -2).conj()
    return np.where(both, root, 0)


def _scatter(frf: FRF, weights: Weights, variance, used, floor: float) -> np.ndarray:
    """Weights W = C_hat^-1 with C_hat a complex Wishart matrix of nu degrees of freedom and size p about C: the cost is
    E tr(W C) = nu/(nu - p) times its size, and E(W C W) / E(W C_hat W) = nu^2/((nu - p)^2 - 1) (Shaman, Journal of
    Multivariate Analysis 10, 1980). A floor takes part of the weight away from C_hat. (pos, freq, 2)"""
    p = frf.n_out if weights.correlated else 1
    dof = np.broadcast_to(np.asarray(frf.dof, float), variance.shape[:2])
    excess = np.maximum(np.where(np.isnan(dof), np.inf, dof) - p, _LEAST)
    nu = excess + p
    count = np.maximum(used.sum(axis=-1), 1)
    share = np.sum(np.where(used, variance / (variance + floor**2), 0), axis=-1) / count
    with np.errstate(invalid="ignore"):
        cost = np.where(np.isfinite(nu), nu / excess, 1.0)
        gradient = np.where(np.isfinite(nu), nu**2 / (excess**2 - 1), 1.0)
    return np.stack([1 + share * (cost - 1), 1 + share**2 * (gradient - 1)], axis=-1)


def assumed_cost(target: Target, floor: float) -> float:
    """The cost to expect where the covariance of E is that of the FRF and floor^2 besides, as the weights assume."""
    spread = np.asarray(target.cov) + max(floor, _FLOOR) ** 2 * np.eye(target.log_G.shape[-1])
    if target.whitener is not None:
        whitener = np.asarray(target.whitener)
        spread = whitener @ spread @ whitener.swapaxes(-1, -2).conj()
    variance = np.real(np.diagonal(spread, axis1=-2, axis2=-1))
    return float(np.sum(np.square(target.magnitude) * target.used * variance))


def select(target: Target, positions=None, lines=None) -> Target:
    """The same target at some positions and lines."""
    positions = slice(None) if positions is None else np.asarray(positions)
    lines = slice(None) if lines is None else np.asarray(lines)
    cut = lambda x: np.asarray(x)[positions][:, lines]
    whole = target.overlap
    shared = None if whole is None else tuple(whole[i].at(lines) for i in np.arange(len(whole))[positions])
    return dataclasses.replace(
        target,
        frequency=np.asarray(target.frequency)[lines],
        log_G=cut(target.log_G),
        shift=cut(target.shift),
        magnitude=cut(target.magnitude),
        phase=cut(target.phase),
        whitener=None if target.whitener is None else cut(target.whitener),
        cov=cut(target.cov),
        used=cut(target.used),
        scatter=cut(target.scatter),
        overlap=shared,
        points=jax.tree.map(lambda x: np.asarray(x)[positions], target.points),
    )
