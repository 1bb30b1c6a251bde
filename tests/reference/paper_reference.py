"""The estimators of Zimmermann & Moberg, Section II, as plain NumPy loops: slow, obvious, and without jaxfrf.

Everything is for one operating point. Spectra U, Y, R are (exp, freq, channel), FRFs G are (freq, out, in).
The covariance of vec(G) has the columns of G stacked: element j*n_out + i belongs to G[i, j].

A regression is written as in the paper, one row per line (and per experiment, where several are stacked):

    Z_w = K_w Theta + E,   K_w = [x^0 X, ..., x^R X, -x^1 Z, ..., -x^R Z]

so that the first n_in rows of Theta are G^T at the central line.
"""

import dataclasses

import numpy as np


@dataclasses.dataclass
class Estimate:
    """FRF, covariance of vec(G), and residual degrees of freedom per line (NaN where nothing is left)."""

    G: np.ndarray
    cov: np.ndarray
    dof: np.ndarray


# --- classical estimators ---


def blocks(X, n_in):
    """X^[m] of the paper: a list over M blocks of (freq, channel, n_in), one column per experiment."""
    M = len(X) // n_in
    return [np.moveaxis(X[m * n_in : (m + 1) * n_in], 0, -1) for m in range(M)]


def block_responses(U, Y):
    """G^[m] = Y^[m] (U^[m])^-1 for every block: (M, freq, out, in)."""
    n_in = U.shape[-1]
    return np.array(
        [
            [Yb[k] @ np.linalg.inv(Ub[k]) for k in range(U.shape[1])]
            for Ub, Yb in zip(blocks(U, n_in), blocks(Y, n_in), strict=True)
        ]
    )


def h1(U, Y):
    """G = [1/M sum Y U^H] [1/M sum U U^H]^-1, with the covariance of the least squares that it is."""
    n_exp, n_freq, n_in = U.shape
    n_out = Y.shape[-1]
    G = np.empty((n_freq, n_out, n_in), complex)
    cov = np.full((n_freq, n_out * n_in, n_out * n_in), np.nan + 0j)
    q = n_exp - n_in
    for k in range(n_freq):
        SYU = sum(np.outer(Y[e, k], U[e, k].conj()) for e in range(n_exp)) / n_exp
        SUU = sum(np.outer(U[e, k], U[e, k].conj()) for e in range(n_exp)) / n_exp
        G[k] = SYU @ np.linalg.inv(SUU)
        if q > 0:
            C = np.zeros((n_out, n_out), complex)
            for e in range(n_exp):
                v = Y[e, k] - G[k] @ U[e, k]
                C += np.outer(v, v.conj()) / q
            gram = sum(np.outer(U[e, k].conj(), U[e, k]) for e in range(n_exp))
            cov[k] = np.kron(np.linalg.inv(gram), C)
    return Estimate(G, cov, np.full(n_freq, q))


def h2(U, Y):
    """G = [sum Y Y^H] [sum U Y^H]^-1, for as many outputs as inputs."""
    n_exp, n_freq, _ = U.shape
    G = []
    for k in range(n_freq):
        SYY = sum(np.outer(Y[e, k], Y[e, k].conj()) for e in range(n_exp))
        SUY = sum(np.outer(U[e, k], Y[e, k].conj()) for e in range(n_exp))
        G.append(SYY @ np.linalg.inv(SUY))
    return np.array(G)


def hv(U, Y):
    """Total least squares output by output: [U; Y_i], each channel in units of its rms, has the least power
    along the equation error. With one input and one output it is sqrt(H1 H2).
    """
    _, n_freq, n_in = U.shape
    n_out = Y.shape[-1]
    G = np.empty((n_freq, n_out, n_in), complex)
    for k in range(n_freq):
        for i in range(n_out):
            data = np.column_stack([U[:, k], Y[:, k, i]])
            rms = np.sqrt(np.mean(np.abs(data) ** 2, axis=0))
            v = np.linalg.svd(data / rms, full_matrices=True)[2][-1].conj() / rms
            G[k, i] = -v[:n_in] / v[n_in]
    return G


def jio(U, Y, R):
    """G = [1/M sum Y R^H] [1/M sum U R^H]^-1, its covariance from the joint residual of [y; u] on r."""
    n_out = Y.shape[-1]
    joint = h1(R, np.concatenate([Y, U], axis=-1))
    return through_jio(joint, n_out)


def arithmetic_mean(responses):
    """G = 1/M sum G^[m]; covariance of the mean from the scatter of the G^[m], 1/(M (M - 1)) sum."""
    M = len(responses)
    G = sum(responses) / M
    cov = scatter(responses, G, M * (M - 1)) if M > 1 else np.full(_cov_shape(G), np.nan + 0j)
    return Estimate(G, cov, np.full(len(G), M - 1))


def log_mean(responses):
    """Eq. G_LOG with the matrix functions by eigendecomposition; the paper's uncertainty, 1/M^2 sum.

    That sum of M deviations from their own mean is too small by (M - 1)/M: see `unbiased`.
    """
    M, n_freq = len(responses), responses.shape[1]
    G = np.empty(responses.shape[1:], complex)
    for k in range(n_freq):
        lam, V = np.linalg.eig(responses[0, k])
        P = V @ np.diag(np.exp(-1j * np.angle(lam))) @ np.linalg.inv(V)
        mean = sum(_matrix_function(np.log, P @ responses[m, k]) for m in range(M)) / M
        G[k] = np.linalg.inv(P) @ _matrix_function(np.exp, mean)
    return Estimate(G, scatter(responses, G, M**2), np.full(n_freq, M - 1))


def log_mean_elementwise(responses):
    """The same element by element, each turned by the phase of the first block's, so that no phase wraps."""
    M = len(responses)
    G = np.empty(responses.shape[1:], complex)
    for index in np.ndindex(G.shape):
        turn = np.exp(-1j * np.angle(responses[0][index]))
        G[index] = np.exp(sum(np.log(turn * responses[m][index]) for m in range(M)) / M) / turn
    return Estimate(G, scatter(responses, G, M**2), np.full(len(G), M - 1))


def unbiased(estimate):
    """The same with 1/(M (M - 1)) in place of 1/M^2 in the covariance, M - 1 its degrees of freedom."""
    M = estimate.dof[0] + 1
    return dataclasses.replace(estimate, cov=estimate.cov * M / (M - 1))


def scatter(responses, G, divisor):
    """1/divisor sum_m vec(G^[m] - G) vec(G^[m] - G)^H: (freq, vec, vec)."""
    cov = np.zeros(_cov_shape(G), complex)
    for response in responses:
        for k in range(len(G)):
            d = (response[k] - G[k]).flatten(order="F")
            cov[k] += np.outer(d, d.conj()) / divisor
    return cov


def _matrix_function(f, A):
    lam, V = np.linalg.eig(A)
    return V @ np.diag(f(lam.astype(complex))) @ np.linalg.inv(V)


def _cov_shape(G):
    n = G.shape[-1] * G.shape[-2]
    return (len(G), n, n)


# --- local estimators ---


def window(k, width, n_freq):
    """The window around line k: r = -b..b-1 (even width) or -b..b (odd), pushed inwards at the ends."""
    first = min(max(k - width // 2, 0), n_freq - width)
    return np.arange(first, first + width)


def local_variable(k, window_lines, frequency, variable):
    """The r of the paper (difference of line indices), or the difference of frequencies; at most 1."""
    x = (window_lines - k).astype(float) if variable == "index" else frequency[window_lines] - frequency[k]
    return x / max(np.abs(x).max(), np.finfo(float).tiny) if len(x) > 1 else x


def regressor(X, Z_denominator, order, x, transient=None):
    """K_w (exp*width, columns), experiment after experiment, from X (exp, width, in) and Z or None.

    `transient` adds a polynomial of that degree for every experiment by itself.
    """
    columns = [x[None, :, None] ** s * X for s in range(order + 1)]
    if Z_denominator is not None:
        columns += [-(x[None, :, None] ** s) * Z_denominator for s in range(1, order + 1)]
    if transient is not None:
        n_exp, width, _ = X.shape
        own = np.zeros((n_exp, width, n_exp * (transient + 1)), complex)
        for e in range(n_exp):
            for s in range(transient + 1):
                own[e, :, e * (transient + 1) + s] = x**s
        columns.append(own)
    K = np.concatenate(columns, axis=-1)
    return K.reshape(-1, K.shape[-1])


@dataclasses.dataclass
class Fit:
    """One least squares: G^T, the rows of K^+ that give it, the residual and its degrees of freedom."""

    GT: np.ndarray  # (in, outputs)
    pinv: np.ndarray  # (in, rows), the first n_in rows of K^+
    residual: np.ndarray  # (rows, outputs)
    q: int


def least_squares(K, Z, n_in):
    """Theta = (K^H K)^-1 K^H Z, computed by the SVD of K with columns of unit length."""
    scale = np.linalg.norm(K, axis=0)
    scale[scale == 0] = 1.0
    pinv = np.linalg.pinv(K / scale, rcond=1e-13) / scale[:, None]
    theta = pinv @ Z
    q = len(K) - np.linalg.matrix_rank(K / scale)
    return Fit(theta[:n_in], pinv[:n_in], Z - K @ theta, q)


def _fits_lpm(X, Z, order, x, transient):
    K = regressor(X, None, order, x, transient)
    fit = least_squares(K, _rows(Z), X.shape[-1])
    return [(fit, i) for i in range(Z.shape[-1])]


def _fits_miso(X, Z, order, x, transient):
    fits = []
    for i in range(Z.shape[-1]):
        Zi = Z[..., i : i + 1]
        fits.append((least_squares(regressor(X, Zi, order, x, transient), _rows(Zi), X.shape[-1]), 0))
    return fits


def _fits_mimo(X, Z, order, x, transient):
    K = regressor(X, Z, order, x, transient)
    fit = least_squares(K, _rows(Z), X.shape[-1])
    return [(fit, i) for i in range(Z.shape[-1])]


FITS = {"lpm": _fits_lpm, "lrm-miso": _fits_miso, "lrm-mimo": _fits_mimo}


def _rows(Z):
    return Z.reshape(-1, Z.shape[-1])


def covariance(fits):
    """Cov of vec(G), every output with its own regressor: (K_i^+)(K_l^+)^H [s = 0 block] times C_il."""
    n_out, n_in = len(fits), len(fits[0][0].GT)
    cov = np.empty((n_in * n_out, n_in * n_out), complex)
    for i, (a, ia) in enumerate(fits):
        for l, (b, ib) in enumerate(fits):
            q = np.sqrt(a.q * b.q)
            C_il = (a.residual[:, ia] @ b.residual[:, ib].conj()) / q if q > 0 else np.nan
            cov[i::n_out, l::n_out] = (a.pinv @ b.pinv.conj().T) * C_il
    return cov


def local(kind, X, Z, order, width, variable="index", frequency=None, transient=None):
    """LPM, LRM-MISO or LRM-MIMO at every line; all experiments given are stacked in one least squares."""
    return _over_lines(lambda Xw, Zw, x: FITS[kind](Xw, Zw, order, x, transient), X, Z, width, variable, frequency)


def local_jio(kind, U, Y, R, order, width, variable="index", frequency=None, transient=None):
    """JIO-LRM: r -> y and r -> u by two local regressions, and their ratio; joint covariance of both."""

    def fits(Xw, Zw, x):
        n_out = Y.shape[-1]
        of_y = FITS[kind](Xw, Zw[..., :n_out], order, x, transient)
        of_u = FITS[kind](Xw, Zw[..., n_out:], order, x, transient)
        return of_y + of_u

    joint = _over_lines(fits, R, np.concatenate([Y, U], axis=-1), width, variable, frequency)
    return through_jio(joint, Y.shape[-1])


def response_lrm(X, Z, order, width):
    """The response of LRM-MIMO alone, all experiments stacked: (freq, channel of Z, in)."""
    n_freq, n_in = X.shape[1:]
    G = np.empty((n_freq, Z.shape[2], n_in), complex)
    for k in range(n_freq):
        lines = window(k, width, n_freq)
        K = regressor(X[:, lines], Z[:, lines], order, local_variable(k, lines, None, "index"))
        G[k] = np.linalg.lstsq(K, _rows(Z[:, lines]), rcond=None)[0][:n_in].T
    return G


def response_jio(U, Y, R, order, width):
    """The same of JIO-LRM."""
    of_y, of_u = (response_lrm(R, Z, order, width) for Z in (Y, U))
    return of_y @ np.linalg.inv(of_u)


def _over_lines(fits_of, X, Z, width, variable, frequency):
    n_freq, n_in, n_out = X.shape[1], X.shape[2], Z.shape[2]
    G = np.empty((n_freq, n_out, n_in), complex)
    cov = np.empty((n_freq, n_out * n_in, n_out * n_in), complex)
    dof = np.empty(n_freq)
    for k in range(n_freq):
        lines = window(k, width, n_freq)
        x = local_variable(k, lines, frequency, variable)
        fits = fits_of(X[:, lines], Z[:, lines], x)
        for i, (fit, column) in enumerate(fits):
            G[k, i] = fit.GT[:, column]
        cov[k] = covariance(fits)
        dof[k] = min(fit.q for fit, _ in fits)
    return Estimate(G, cov, dof)


def through_jio(joint, n_out):
    """G = G_ry G_ru^-1, Cov(vec G) = J Cov(vec [G_ry; G_ru]) J^H with J = G_ru^-T (x) [I, -G]."""
    G, cov = [], []
    for k in range(len(joint.G)):
        Gry, Gru = joint.G[k, :n_out], joint.G[k, n_out:]
        G.append(Gry @ np.linalg.inv(Gru))
        J = np.kron(np.linalg.inv(Gru).T, np.hstack([np.eye(n_out), -G[-1]]))
        cov.append(J @ joint.cov[k] @ J.conj().T)
    return Estimate(np.array(G), np.array(cov), joint.dof)


def common_denominator(X, Z, order, width, variable="index", frequency=None, n_noises=None):
    """Z = N X / d with one scalar polynomial d shared by every channel of Z, of which `n_noises` have one of their own.

    The channels share unknowns, so that their units matter: each is divided by its rms over the window.
    Covariance: independent lines, covariance C between the channels of one line.
    """
    n_exp, n_freq, n_in = X.shape
    n_z = Z.shape[-1]
    p = (order + 1) * n_in
    G = np.empty((n_freq, n_z, n_in), complex)
    cov = np.empty((n_freq, n_z * n_in, n_z * n_in), complex)
    dof = np.empty(n_freq)
    for k in range(n_freq):
        lines = window(k, width, n_freq)
        x = local_variable(k, lines, frequency, variable)
        N = regressor(X[:, lines], None, order, x)
        rows = len(N)
        rms = np.sqrt(np.mean(np.abs(Z[:, lines]) ** 2, axis=(0, 1)))
        Zw = _rows(Z[:, lines]) / rms
        xs = np.tile(x, n_exp)
        K = np.zeros((n_z * rows, n_z * p + order), complex)
        for i in range(n_z):
            K[i * rows : (i + 1) * rows, i * p : (i + 1) * p] = N
            for s in range(1, order + 1):
                K[i * rows : (i + 1) * rows, n_z * p + s - 1] = -(xs**s) * Zw[:, i]
        fit = least_squares(K, Zw.T.reshape(-1, 1), K.shape[1])
        theta, e = fit.GT[:, 0], fit.residual[:, 0].reshape(n_z, rows)
        centre = [i * p + j for j in range(n_in) for i in range(n_z)]
        q = (fit.q + order) / n_z - order / (n_noises or n_z)
        C = e @ e.conj().T / q if q > 0 else np.full((n_z, n_z), np.nan)
        A = fit.pinv[centre]
        unit = np.tile(rms, n_in)
        G[k] = (theta[centre] * unit).reshape(n_in, n_z).T
        cov[k] = unit[:, None] * (A @ np.kron(C, np.eye(rows)) @ A.conj().T) * unit
        dof[k] = q
    return Estimate(G, cov, dof)


def common_denominator_jio(U, Y, R, order, width, variable="index", frequency=None):
    """[y; u] on r with one denominator; it cancels in the ratio N_y N_u^-1. The noise of u is that of y, fed back."""
    joint = common_denominator(R, np.concatenate([Y, U], axis=-1), order, width, variable, frequency, Y.shape[-1])
    return through_jio(joint, Y.shape[-1])


def average_experiments(mean, estimate, *spectra):
    """A mean of the local estimates of every experiment by itself (Section II-C.4).

    `mean` is `arithmetic_mean`, `log_mean` or `log_mean_elementwise`. The experiments are independent and each
    knows its covariance from its residual: the mean has 1/M^2 sum Cov_m.
    """
    each = [estimate(*(X[e : e + 1] for X in spectra)) for e in range(len(spectra[0]))]
    G = mean(np.array([e.G for e in each])).G
    return Estimate(G, sum(e.cov for e in each) / len(each) ** 2, welch_satterthwaite(each))


def welch_satterthwaite(each):
    """(sum_m v_m)^2 / sum_m(v_m^2 / dof_m), v_m the share of experiment m in the variance of the mean.

    One number for all elements of G: v_m is averaged over them as a share, so that units do not matter.
    """
    dof = np.empty(len(each[0].G))
    for k in range(len(dof)):
        variances = np.array([np.diag(e.cov[k]).real for e in each])  # (experiment, element)
        share = np.mean(variances / variances.sum(axis=0), axis=1)
        dof[k] = share.sum() ** 2 / sum(v**2 / e.dof[k] for v, e in zip(share, each, strict=True))
    return dof
