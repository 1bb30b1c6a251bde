"""Correlations between local estimates whose windows share data, without a matrix of all pairs of lines."""

import dataclasses

import equinox as eqx
import numpy as np
import scipy.sparse
from jaxtyping import Complex, Float, Int

_RIDGE = 1e-9  # of a column's square
_PAIRS, _SAMPLE = 1_000_000, 40  # of lines, whose squared correlations are summed one by one; lines that at least are


class Overlap(eqx.Module):
    """rho = F F^T: the correlation of two second-order local polynomial fits through windows about (or, at an end of
    the band, beside) their lines.

    Row i of F holds the weights of one fit, a parabola over its window: F and its transpose are applied by running
    sums, in as many operations as there are lines, however wide the windows.

    **Fields:** `first`, `width`: of the windows. `weights`: of 1, l, l^2 in a row of F, l counted from the middle of
    the band. `lines`: which of all lines this is about.
    """

    first: Int[np.ndarray, "line"]
    width: Int[np.ndarray, "line"]
    weights: Float[np.ndarray, "line 3"]
    lines: Int[np.ndarray, "chosen"]

    @property
    def shape(self) -> tuple[int, int]:
        return (len(self.lines), len(self.lines))

    def __matmul__(self, x: Float[np.ndarray, "chosen ..."]) -> Float[np.ndarray, "chosen ..."]:
        """rho x."""
        n = len(self.first)
        powers = _powers(n)
        own = self.weights[self.lines]
        columns = np.reshape(x, (len(self.lines), -1))
        rows = own[:, :, None] * columns[:, None, :]
        at = self._ends @ rows.reshape(len(rows), -1)
        running = np.cumsum(at, axis=0)[:-1].reshape(n, *rows.shape[1:])
        shared = np.einsum("lk,lkc->lc", powers, running)  # F^T x
        total = np.cumsum(powers[:, :, None] * shared[:, None, :], axis=0)
        total = np.concatenate([np.zeros((1, *total.shape[1:])), total])
        window = total[(self.first + self.width)[self.lines]] - total[self.first[self.lines]]
        return np.einsum("lk,lkc->lc", own, window).reshape(np.shape(x))

    @property
    def _ends(self) -> scipy.sparse.csr_array:
        """1 where the window of a chosen line begins, -1 behind its last line: (line + 1, chosen)."""
        first, chosen = self.first[self.lines], np.arange(len(self.lines))
        sign = np.repeat([1.0, -1.0], len(chosen))
        where = np.concatenate([first, first + self.width[self.lines]]), np.concatenate([chosen, chosen])
        return scipy.sparse.csr_array((sign, where), shape=(len(self.first) + 1, len(chosen)))

    def row_sums(self) -> Float[np.ndarray, "chosen"]:
        return self @ np.ones(len(self.lines))

    def sum_of_squares(self, x: Float[np.ndarray, "chosen"]) -> float:
        """sum_ij x_i rho_ij^2 x_j; from evenly spaced lines i where there are many."""
        inside = np.flatnonzero(x)
        if not inside.size:
            return 0.0
        count = min(max(_PAIRS // len(self.lines), _SAMPLE), inside.size)
        some = inside[np.unique(np.linspace(0, inside.size - 1, count).round().astype(int))]
        one = np.zeros((len(self.lines), len(some)))
        one[some, np.arange(len(some))] = 1.0
        squares = np.square(self @ one)
        return float(x @ squares @ x[some]) * float(x.sum() / x[some].sum())

    def at(self, lines) -> "Overlap":
        """That of some of its lines."""
        return dataclasses.replace(self, lines=self.lines[lines])


def overlaps(window: Float[np.ndarray, "pos line"]) -> tuple[Overlap, ...] | None:
    """One for each position, from the widths of windows; `None` where every window is one line wide."""
    if np.all(window <= 1):
        return None
    known, keys = {}, []
    for widths in np.asarray(np.rint(window), int):
        keys.append(widths.tobytes())
        if keys[-1] not in known:
            known[keys[-1]] = _overlap(widths)
    return tuple(known[key] for key in keys)


def of_fractions(
    window: Float[np.ndarray, "line"], G: Complex[np.ndarray, "line out"], lines: Int[np.ndarray, "chosen"]
) -> Complex[np.ndarray, "chosen chosen"]:
    """The same of some lines' fits of a fraction, N and D of second order: beside a pole its errors have the shape of
    the response itself. `G`: of all outputs from the input that the fits are about, known well enough."""
    F = fraction_weights(window, G, lines).toarray()
    return F @ F.conj().T


def fraction_weights(
    window: Float[np.ndarray, "line"], G: Complex[np.ndarray, "line out"], lines: Int[np.ndarray, "chosen"]
) -> scipy.sparse.csr_array:
    """F of `of_fractions`, (chosen, line): the weights of one fit in a row, of length one; rho = F F^H."""
    n = len(window)
    width = np.clip(np.rint(window).astype(int)[lines], 1, n)
    first = np.clip(lines - width // 2, 0, n - width)
    ahead = np.arange(width.max())
    near, inside = np.minimum(first[:, None] + ahead, n - 1), ahead < width[:, None]
    x = np.where(inside, (near - lines[:, None]) / width[:, None], 0.0)[..., None]
    one = inside[..., None].astype(float)
    B = np.concatenate([one, x, x**2, x * G[near], x**2 * G[near]], axis=-1)  # (chosen, line, unknown)
    B = B / np.maximum(np.linalg.norm(B, axis=1, keepdims=True), 1e-300)
    adjoint = B.conj().swapaxes(1, 2)
    centre = np.linalg.solve(adjoint @ B + _RIDGE * np.eye(B.shape[-1]), np.eye(B.shape[-1])[:, :1])
    F = (centre.conj().swapaxes(1, 2) @ adjoint)[:, 0]
    F = F / np.maximum(np.linalg.norm(F, axis=1, keepdims=True), 1e-300)
    rows = np.broadcast_to(np.arange(len(lines))[:, None], near.shape)
    return scipy.sparse.csr_array((F[inside], (rows[inside], near[inside])), shape=(len(lines), n))


def _overlap(widths: Int[np.ndarray, "line"]) -> Overlap:
    n = len(widths)
    line = np.arange(n)
    width = np.clip(widths, 1, n)
    width = np.where(width < 3, 1, width)  # a parabola through two lines is the line itself
    first = np.where(width == 1, line, np.clip(line - width // 2, 0, n - width))
    before, after = line - first, first + width - 1 - line
    counts = np.cumsum(np.arange(n, dtype=float)[:, None] ** np.arange(5), axis=0)
    sign = (-1.0) ** np.arange(5)
    sums = counts[after] + sign * counts[before] - (np.arange(5) == 0)
    sums = sums / width[:, None] ** np.arange(5.0)  # of ((l - i)/width)^k over the window
    gram = sums[:, np.arange(3)[:, None] + np.arange(3)]
    gram = np.where((width == 1)[:, None, None], np.eye(3), gram)
    shape = np.linalg.solve(gram, np.broadcast_to(np.eye(3)[:, :1], (n, 3, 1)))[..., 0]
    shape = shape / np.sqrt(shape[:, :1]) / width[:, None] ** np.arange(3.0)
    i = line - _middle(n)
    weights = np.stack(
        [shape[:, 0] - i * shape[:, 1] + i**2 * shape[:, 2], shape[:, 1] - 2 * i * shape[:, 2], shape[:, 2]], axis=1
    )
    return Overlap(first, width, weights, line)


def _middle(n: int) -> float:
    return 0.5 * (n - 1)


def _powers(n: int) -> Float[np.ndarray, "line 3"]:
    return (np.arange(n) - _middle(n))[:, None] ** np.arange(3)
