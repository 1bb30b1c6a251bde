"""The gray-box cost in plain NumPy, from its formulas: nothing here comes from jaxfrf.

    V(theta) = sum_{pos, freq} e^H W e,   e = log|G_hat/G| + j Arg(G_hat/G)

with W diagonal, user weight / (var/|G_hat|^2 + floor^2), or the inverse of C = cov(vec log G_hat) + floor^2 I (with
user weights D between its Hermitian roots: C^-1/2 D C^-1/2).
FRFs are (pos, freq, out, in), vec() stacks columns, cov is that of vec(G_hat) (Zimmermann & Moberg, eq. (22)).
"""

import dataclasses

import numpy as np
import scipy.linalg


def vec(G):
    """(..., out, in) to (..., in*out): columns stacked."""
    return np.swapaxes(G, -1, -2).reshape(*G.shape[:-2], -1)


@dataclasses.dataclass(frozen=True)
class Rule:
    """What counts: see `weights`. `focus`: bands (lowest, highest) Hz of every axis at every position, [pos][axis]."""

    floor: float = 0.03
    off_diagonal: float = 0.2
    reject: float = 0.25
    elements: np.ndarray | None = None
    bands: tuple = ()
    focus: tuple = ()
    focus_factor: float = 1.0
    correlated: bool = False


def relative_covariance(G, cov):
    """cov of vec(log G_hat), to first order: cov_ab / (G_a conj(G_b))."""
    g = vec(G)
    with np.errstate(all="ignore"):
        return cov / (g[..., :, None] * g[..., None, :].conj())


def user_weights(rule, frequency, n_pos, n_out, n_in):
    out = np.empty((n_pos, len(frequency), n_out, n_in))
    own = np.where(np.eye(n_out, n_in, dtype=bool), 1.0, rule.off_diagonal)
    out[:] = own if rule.elements is None else rule.elements
    for low, high, factor in rule.bands:
        for k, f in enumerate(frequency):
            if low <= f <= high:
                out[:, k] *= factor
    for p, axes in enumerate(rule.focus):
        for k, f in enumerate(frequency):
            near = [low <= f <= high for low, high in axes]
            for i in range(n_out):
                for j in range(n_in):
                    if near[i] or near[j]:
                        out[p, k, i, j] *= rule.focus_factor
    return vec(out)


def weight_matrices(rule, G_hat, cov, frequency):
    """W (pos, freq, vec, vec): e^H W e is the cost of a line; zero rows where an element is left out."""
    n_pos, n_freq, n_out, n_in = G_hat.shape
    user = user_weights(rule, frequency, n_pos, n_out, n_in)
    relative = relative_covariance(G_hat, cov)
    W = np.zeros((n_pos, n_freq, n_out * n_in, n_out * n_in))
    W = W.astype(complex)
    for p in range(n_pos):
        for k in range(n_freq):
            g, C, w = vec(G_hat[p, k]), relative[p, k], user[p, k]
            var = np.real(np.diagonal(C))
            with np.errstate(invalid="ignore"):
                use = np.isfinite(g) & (np.abs(g) > 0) & np.isfinite(var) & (var <= rule.reject) & (w > 0)
            use = np.flatnonzero(use)
            if rule.correlated and len(use):
                white = np.linalg.inv(scipy.linalg.sqrtm(C[np.ix_(use, use)] + rule.floor**2 * np.eye(len(use))))
                W[p, k][np.ix_(use, use)] = white @ np.diag(w[use]) @ white
            else:
                W[p, k][use, use] = w[use] / (var[use] + rule.floor**2)
    return W


def errors(G_hat, G, W):
    """E (pos, freq, vec), 0 where the weight is 0."""
    with np.errstate(all="ignore"):
        ratio = vec(G_hat) / vec(G)
        E = np.log(np.abs(ratio)) + 1j * np.angle(ratio)
    return np.where(np.real(np.einsum("pfvv->pfv", W)) > 0, E, 0)


def cost(W, G_hat, G):
    E = errors(G_hat, G, W)
    return np.real(np.einsum("pfa,pfab,pfb->", E.conj(), W, E))


def residuals(W, G_hat, G):
    """Real residuals with sum of squares = cost, for `scipy.optimize.least_squares`."""
    E = errors(G_hat, G, W)
    values, vectors = np.linalg.eigh(W)
    root = np.sqrt(np.maximum(values, 0))[..., None] * np.swapaxes(vectors, -1, -2).conj()
    white = np.einsum("pfab,pfb->pfa", root, E).ravel()
    return np.concatenate([white.real, white.imag])


def jacobian(response, x, step=1e-5):
    """d log G/dx by central differences of the ratio, (pos, freq, vec, parameter)."""
    columns = []
    for i in range(len(x)):
        h = step * np.eye(len(x))[i]
        ratio = vec(response(x + h)) / vec(response(x - h))
        columns.append((np.log(np.abs(ratio)) + 1j * np.angle(ratio)) / (2 * step))
    return np.stack(columns, axis=-1)


def normal_equations(W, G_hat, response, x):
    """V, half its gradient and the Gauss-Newton matrix Re(J^H W J), e = log(G_hat/G), J = de/dx = -dlog G/dx."""
    E = errors(G_hat, response(x), W)
    J = -jacobian(response, x)
    V = np.real(np.einsum("pfa,pfab,pfb->", E.conj(), W, E))
    gradient = np.real(np.einsum("pfai,pfab,pfb->i", J.conj(), W, E))
    hessian = np.real(np.einsum("pfai,pfab,pfbj->ij", J.conj(), W, J))
    return V, gradient, hessian


def two_mass(omega, values, arm=1.6):
    """Torque on motor and arm to the speed of both, (freq, 2, 2): a motor of inertia 1 with viscous friction f, a
    spring k, d and an arm with friction .05; the torque on the motor is late by tau."""
    k, d, f, tau = (values[n] for n in ("k", "d", "f", "tau"))
    out = np.empty((len(omega), 2, 2), complex)
    for n, w in enumerate(omega):
        s = 1j * w
        z = k / s + d  # of the spring, force over speed
        D = np.array([[s + f + z, -z], [-z, arm * s + 0.05 + z]])
        out[n] = np.linalg.inv(D) @ np.diag([np.exp(-s * tau), 1.0])
    return out
