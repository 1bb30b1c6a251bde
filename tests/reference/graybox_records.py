"""FRFs with a known covariance, and draws from it."""

import graybox_reference as reference
import numpy as np
import plants

import jaxfrf as jf

FREQUENCY = np.geomspace(0.5, 8.0, 24)

ARMS = np.array([[0.0], [0.8]])  # the arm's inertia is 1.6 (1 + .3 q)


def frf_of(G, cov=None, frequency=FREQUENCY, q=ARMS, window=1.0):
    G = np.asarray(G)
    n_pos, n_freq, n_out, n_in = G.shape
    vec = n_out * n_in
    shape = (n_pos, n_freq)
    cov = np.zeros((*shape, vec, vec), complex) if cov is None else cov
    dof, status = np.full(shape, np.inf), np.zeros(shape, int)
    return jf.FRF(G=G, frequency=frequency, cov=cov, dof=dof, status=status, window=np.full(shape, window), q=q)


def random_covariance(rng, G, size):
    """A full covariance at every line, relative standard deviations about `size`."""
    g = reference.vec(G)
    n = g.shape[-1]
    mix = np.eye(n) + 0.4 * (rng.standard_normal((*g.shape, n)) + 1j * rng.standard_normal((*g.shape, n)))
    root = size * np.abs(g)[..., None] * mix
    return root @ root.swapaxes(-1, -2).conj()


def noisy(rng, G, cov):
    root = np.linalg.cholesky(cov + 1e-30 * np.eye(cov.shape[-1]))
    z = plants.circular(rng, (*G.shape[:2], cov.shape[-1]))
    change = np.einsum("pfab,pfb->pfa", root, z)
    return G + change.reshape(*G.shape[:2], G.shape[3], G.shape[2]).swapaxes(-1, -2)
