"""Local least squares as users of NumPy and SciPy write it: the baselines of `bench_local.py`.

They return G only; jaxfrf's estimates come with their covariance.
"""

import dataclasses

import numpy as np
import scipy.linalg


@dataclasses.dataclass(frozen=True)
class Problem:
    """Local regressions that give G at one line.

    - `X`: (pos, exp, freq, in), the regressed-on signals. `targets`: (pos, exp, freq, channel) each; with two, y and u,
      G is the ratio of their responses.
    - `rational`: whether there is a denominator. `shared`: one matrix denominator for all channels of a target, or a
      scalar one for each.
    """

    X: np.ndarray
    targets: tuple[np.ndarray, ...]
    width: int
    order: int = 2
    rational: bool = True
    shared: bool = True

    @property
    def shape(self) -> tuple[int, int, int, int]:
        n_pos, _, n_freq, n_in = self.X.shape
        return n_pos, n_freq, self.targets[0].shape[-1], n_in

    @property
    def n_windows(self) -> int:
        return self.X.shape[0] * self.X.shape[2]

    @property
    def start(self) -> np.ndarray:
        """First line of every window; near the ends of the band windows are shifted inwards."""
        n_freq = self.X.shape[2]
        return np.clip(np.arange(n_freq) - self.width // 2, 0, n_freq - self.width)

    def groups(self, n_target: int) -> list[np.ndarray]:
        """Channels that are regressed together."""
        every = np.arange(n_target)
        return [every] if self.shared or not self.rational else list(every[:, None])


def loop(problem: Problem, lstsq=None) -> np.ndarray:
    """One window after the other, through `numpy.linalg.lstsq`: (pos, freq, out, in)."""
    solve = _numpy_lstsq if lstsq is None else lstsq
    G = np.empty(problem.shape, complex)
    for pos in range(G.shape[0]):
        for k, start in enumerate(problem.start):
            lines = slice(start, start + problem.width)
            x = np.arange(start, start + problem.width) - k
            x = x / np.abs(x).max()
            X = problem.X[pos, :, lines]
            parts = [_solve_window(problem, x, X, Z[pos, :, lines], solve) for Z in problem.targets]
            G[pos, k] = _combined(parts)
    return G


def scipy_loop(problem: Problem) -> np.ndarray:
    """The same through `scipy.linalg.lstsq`, LAPACK's gelsy."""
    return loop(problem, lambda K, Z: scipy.linalg.lstsq(K, Z, lapack_driver="gelsy", check_finite=False)[0])


def batched_qr(problem: Problem) -> np.ndarray:
    """All windows of an operating point at once: strided views, `numpy.linalg.qr`, `numpy.linalg.solve`."""

    def solve(K, Z):
        q, r = np.linalg.qr(K)
        return np.linalg.solve(r, q.conj().swapaxes(-1, -2) @ Z)

    return _batched(problem, solve)


def batched_normal(problem: Problem) -> np.ndarray:
    """All windows of an operating point at once: strided views, normal equations, `numpy.linalg.solve`."""

    def solve(K, Z):
        adjoint = K.conj().swapaxes(-1, -2)
        return np.linalg.solve(adjoint @ K, adjoint @ Z)

    return _batched(problem, solve)


def _numpy_lstsq(K, Z):
    return np.linalg.lstsq(K, Z, rcond=None)[0]


def _solve_window(problem: Problem, x, X, Z, solve):
    """The response from X to Z (exp, line, channel) at x = 0."""
    n_in = X.shape[-1]
    out = np.empty((Z.shape[-1], n_in), complex)
    for group in problem.groups(Z.shape[-1]):
        target = Z[..., group]
        columns = [x[:, None] ** s * X for s in range(problem.order + 1)]
        if problem.rational:
            columns += [-(x[:, None] ** s) * target for s in range(1, problem.order + 1)]
        K = np.concatenate(columns, axis=-1)
        theta = solve(K.reshape(-1, K.shape[-1]), target.reshape(-1, len(group)))
        out[group] = theta[:n_in].T
    return out


def _batched(problem: Problem, solve) -> np.ndarray:
    G = np.empty(problem.shape, complex)
    offset = problem.start[:, None] + np.arange(problem.width) - np.arange(len(problem.start))[:, None]
    x = (offset / np.abs(offset).max(axis=1, keepdims=True))[:, None, :, None]
    for pos in range(G.shape[0]):
        X = _windows(problem, problem.X[pos])
        parts = [_solve_batch(problem, x, X, _windows(problem, Z[pos]), solve) for Z in problem.targets]
        G[pos] = _combined(parts)
    return G


def _windows(problem: Problem, signal):
    """(window, exp, line, channel) of a signal (exp, freq, channel), without copying until the ends of the band."""
    view = np.lib.stride_tricks.sliding_window_view(signal, problem.width, axis=1)
    return np.moveaxis(view, (1, 3), (0, 2))[problem.start]


def _solve_batch(problem: Problem, x, X, Z, solve):
    n_in, n_window = X.shape[-1], len(X)
    out = np.empty((n_window, Z.shape[-1], n_in), complex)
    for group in problem.groups(Z.shape[-1]):
        target = Z[..., group]
        columns = [X, *(x**s * X for s in range(1, problem.order + 1))]
        if problem.rational:
            columns += [-(x**s) * target for s in range(1, problem.order + 1)]
        K = np.concatenate(columns, axis=-1)
        theta = solve(K.reshape(n_window, -1, K.shape[-1]), target.reshape(n_window, -1, len(group)))
        out[:, group] = theta[:, :n_in].swapaxes(-1, -2)
    return out


def _combined(parts):
    return parts[0] if len(parts) == 1 else parts[0] @ np.linalg.inv(parts[1])


def classical(U, Y, R=None) -> np.ndarray:
    """H1, or with a reference a ratio, all lines at once, (pos, exp, freq, channel) to (pos, freq, out, in)."""
    U, Y, Z = (np.moveaxis(X, 1, -1) for X in (U, Y, U if R is None else R))
    adjoint = Z.conj().swapaxes(-1, -2)
    return (Y @ adjoint) @ np.linalg.inv(U @ adjoint)


def two_responses(U, Y, R) -> np.ndarray:
    """The same ratio as it is written: y and u by H1 from the reference, then one over the other."""
    return classical(R, Y) @ np.linalg.inv(classical(R, U))


def log_means(G) -> np.ndarray:
    """Logarithmic means over the first axis of (real, freq, out, in), one line after the other."""
    return np.stack([_log_mean(G[:, k]) for k in range(G.shape[1])])


def log_loop(U, Y) -> np.ndarray:
    """The logarithmic mean over blocks of as many experiments as inputs, line after line: (1, freq, out, in)."""
    n = U.shape[-1]
    blocks = [slice(m, m + n) for m in range(0, U.shape[1] - n + 1, n)]
    lines = range(U.shape[2])
    return np.stack([_log_mean(np.stack([np.linalg.solve(U[0, b, k], Y[0, b, k]).T for b in blocks])) for k in lines])[
        None
    ]


def _log_mean(G):
    values, V = np.linalg.eig(G[0])
    P = _composed(np.exp(-1j * np.angle(values)), V)
    logs = [_function(np.log, P @ each) for each in G]
    return np.linalg.inv(P) @ _function(np.exp, np.mean(logs, axis=0))


def _function(f, A):
    values, V = np.linalg.eig(A)
    return _composed(f(values), V)


def _composed(values, V):
    return (V * values) @ np.linalg.inv(V)
