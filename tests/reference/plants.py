"""Linear plants with a known FRF, in open and closed loop: spectra exactly in steady state, or time records.

Nothing here comes from jaxfrf, except `spectra`, which puts arrays into its container.
"""

import dataclasses

import numpy as np
import scipy.signal


def modal_response(rng, n_out, n_in, omega, n_modes=None):
    """A random stable FRF, 2 I + sum_m phi_m psi_m^T w_m^2 / (w_m^2 - w^2 + 2j zeta_m w_m w)."""
    n_modes = 2 * max(n_out, n_in) if n_modes is None else n_modes
    low, high = omega[0], omega[-1]
    natural = np.exp(rng.uniform(np.log(0.7 * low), np.log(1.4 * high), n_modes))
    damping = rng.uniform(0.02, 0.1, n_modes)
    left, right = rng.standard_normal((n_modes, n_out)), rng.standard_normal((n_modes, n_in))
    s = 1j * omega[:, None]
    gain = natural**2 / (natural**2 + 2 * damping * natural * s + s**2)
    return np.einsum("fm,mo,mi->foi", gain, left, right) + 2 * np.eye(n_out, n_in)


def matrix_fraction(rng, n_out, n_in, x, order):
    """G = D(x)^-1 N(x), D and N matrix polynomials with D well away from singular: (freq, out, in)."""
    span = max(np.abs(x).max(), 1.0)
    powers = (x[:, None] / span) ** np.arange(order + 1)
    D = 0.15 / n_out * _complex(rng, order + 1, n_out, n_out)
    D[0] = np.eye(n_out)
    N = _complex(rng, order + 1, n_out, n_in)
    return np.linalg.solve(np.einsum("fs,sab->fab", powers, D), np.einsum("fs,sab->fab", powers, N))


def matrix_polynomial(rng, n_out, n_in, x, order):
    """A matrix polynomial in x, of terms that matter equally over the whole band: (freq, out, in)."""
    powers = (x[:, None] / np.abs(x).max()) ** np.arange(order + 1)
    return np.einsum("fs,sab->fab", powers, _complex(rng, order + 1, n_out, n_in))


def orthogonal_multisine(rng, n_real, n_freq, n_in):
    """Orthogonal random-phase multisines: R^[m] = diag(e^{j phi}) F diag(e^{j psi}), F the DFT matrix.

    R R^H = n_in I at every line of every block. (n_real * n_in, freq, n_in), one row per experiment.
    """
    F = np.exp(-2j * np.pi * np.outer(np.arange(n_in), np.arange(n_in)) / n_in)
    phi = rng.uniform(0, 2 * np.pi, (n_real, n_freq, n_in))
    psi = rng.uniform(0, 2 * np.pi, (n_real, n_freq, n_in))
    block = np.exp(1j * phi)[..., :, None] * F * np.exp(1j * psi)[..., None, :]  # (real, freq, in, exp)
    return np.moveaxis(block, 3, 1).reshape(n_real * n_in, n_freq, n_in)


@dataclasses.dataclass(frozen=True)
class Loop:
    """A sampled plant y = G u + v under u = C (r - y): state space (A, B, Cy) and a diagonal PI controller.

    n axes of motor, spring and arm, the arms coupled by their inertia; torque in and motor speed out.
    """

    A: np.ndarray
    B: np.ndarray
    Cy: np.ndarray
    gain: np.ndarray
    reset: np.ndarray
    fs: float

    @property
    def n(self):
        return self.B.shape[1]

    def plant(self, frequency):
        """G(e^{j w Ts}): (freq, out, in)."""
        z = np.exp(2j * np.pi * np.asarray(frequency) / self.fs)
        eye = np.eye(len(self.A))
        return np.array([self.Cy @ np.linalg.solve(zk * eye - self.A, self.B) for zk in z])

    def controller(self, frequency):
        """C(e^{j w Ts}) = gain + reset / (z - 1): (freq, in, out)."""
        z = np.exp(2j * np.pi * np.asarray(frequency) / self.fs)
        return np.array([np.diag(self.gain + self.reset / (zk - 1)) for zk in z])

    def closed_loop_poles(self):
        n, m = self.n, len(self.A)
        top = np.hstack([self.A - self.B @ np.diag(self.gain) @ self.Cy, self.B])
        bottom = np.hstack([-np.diag(self.reset) @ self.Cy, np.eye(n)])
        assert top.shape[1] == m + n
        return np.linalg.eigvals(np.vstack([top, bottom]))


def two_mass_loop(n, fs=500.0, seed=0, bandwidth=2.0):
    """A random robot-like plant of n axes, (anti)resonances between about 5 and 60 Hz, in a stable loop."""
    rng = np.random.default_rng(seed)
    motor = rng.uniform(0.8, 1.2, n)
    arm = rng.uniform(0.8, 2.0, n)
    mix = 0.25 * rng.standard_normal((n, n))
    arm_inertia = np.diag(arm) @ (np.eye(n) + mix @ mix.T + 0.15 * (np.ones((n, n)) - np.eye(n)))
    arm_inertia = (arm_inertia + arm_inertia.T) / 2 + 0.2 * np.eye(n)
    assert np.linalg.eigvalsh(arm_inertia).min() > 0
    stiffness = (2 * np.pi * rng.uniform(8, 30, n)) ** 2 * arm
    damping = 2 * 0.03 * np.sqrt(stiffness * arm)
    friction = 0.5 * motor
    inverse = np.linalg.inv(np.block([[np.diag(motor), np.zeros((n, n))], [np.zeros((n, n)), arm_inertia]]))
    spring = np.block([[np.diag(stiffness), -np.diag(stiffness)], [-np.diag(stiffness), np.diag(stiffness)]])
    damper = np.block([[np.diag(damping + friction), -np.diag(damping)], [-np.diag(damping), np.diag(damping)]])
    # States: motor-arm deflection and the speeds, so that the free rotation of the whole is no integrator.
    deflection = np.hstack([np.eye(n), -np.eye(n)])
    push = np.vstack([-np.diag(stiffness), np.diag(stiffness)])
    assert np.allclose(push @ deflection, -spring)
    A = np.block([[np.zeros((n, n)), deflection], [inverse @ push, -inverse @ damper]])
    B = np.vstack([np.zeros((n, n)), inverse @ np.vstack([np.eye(n), np.zeros((n, n))])])
    C = np.hstack([np.zeros((n, n)), np.eye(n), np.zeros((n, n))])
    A, B, C, _, _ = scipy.signal.cont2discrete((A, B, C, np.zeros((n, n))), 1 / fs, method="zoh")
    gain = 2 * np.pi * bandwidth * (motor + arm)
    loop = Loop(A, B, C, gain, 2 * np.pi * 0.3 * gain / fs, fs)
    assert np.abs(loop.closed_loop_poles()).max() < 1, "the controller does not stabilise this plant"
    return loop


@dataclasses.dataclass(frozen=True)
class Records:
    """Spectra (pos, exp, freq, channel) of one plant, and its FRF (freq, out, in)."""

    U: np.ndarray
    Y: np.ndarray
    R: np.ndarray
    G: np.ndarray
    frequency: np.ndarray
    lines: np.ndarray
    fs: float
    period: int

    def spectra(self, with_reference=True):
        return spectra(self.U, self.Y, self.R if with_reference else None, self.lines, self.fs, self.period)


def steady_spectra(
    loop,
    lines,
    period,
    n_real,
    *,
    n_pos=1,
    process_noise=0.0,
    measurement_noise=0.0,
    seed=0,
    same_reference=False,
):
    """Closed-loop spectra in steady state, line by line: U = (I + C G)^-1 C (R - V), Y = G U + V + N.

    `process_noise` V is fed back, `measurement_noise` N is not (a second sensor); both are circular, white,
    and given relative to the rms of the noise-free output (all lines, all channels). Positions are
    realisations of the noise (and of the reference, unless `same_reference`).
    """
    rng = np.random.default_rng(seed)
    n, n_freq = loop.n, len(lines)
    frequency = np.asarray(lines) * loop.fs / period
    G, C = loop.plant(frequency), loop.controller(frequency)
    draws = 1 if same_reference else n_pos
    R = np.stack([orthogonal_multisine(rng, n_real, n_freq, n) for _ in range(draws)])
    R = np.broadcast_to(R, (n_pos, *R.shape[1:]))
    to_u = np.linalg.solve(np.eye(n) + C @ G, C)
    clean = _apply(G @ to_u, R)
    level = np.sqrt(np.mean(np.abs(clean) ** 2))
    V = process_noise * level * circular(rng, clean.shape)
    N = measurement_noise * level * circular(rng, clean.shape)
    U = _apply(to_u, R - V)
    return Records(U, _apply(G, U) + V + N, R, G, frequency, np.asarray(lines), loop.fs, period)


def open_loop_spectra(G, U, noise=0.0, seed=0):
    """Y = G U + V for U (..., exp, freq, in), V circular and white of rms `noise`."""
    rng = np.random.default_rng(seed)
    Y = _apply(G, U)
    return Y + noise * circular(rng, Y.shape)


def simulate(loop, reference, seed=0, noise=0.0):
    """The loop sample by sample from rest: reference (time, n) -> u, y (time, n); noise on y is fed back."""
    v = noise * np.random.default_rng(seed).standard_normal(reference.shape)
    x, integral = np.zeros(len(loop.A)), np.zeros(loop.n)
    u, y = np.empty_like(reference), np.empty_like(reference)
    for t in range(len(reference)):
        y[t] = loop.Cy @ x + v[t]
        error = reference[t] - y[t]
        u[t] = loop.gain * error + integral
        integral = integral + loop.reset * error
        x = loop.A @ x + loop.B @ u[t]
    return u, y


def multisine_record(coefficients, lines, period):
    """One period of the real signal with Fourier coefficients (freq, channel) at `lines`: (time, channel)."""
    half = np.zeros((period // 2 + 1, coefficients.shape[-1]), complex)
    half[lines] = coefficients
    return np.fft.irfft(half * period, n=period, axis=0)


def spectra(U, Y, R=None, lines=None, fs=None, period=None, **fields):
    """`jaxfrf.Spectra` of arrays ([pos,] exp, freq, channel), on a linear grid where nothing else is said."""
    import jaxfrf as jf

    U, Y, R = (None if X is None else X[None] if X.ndim == 3 else X for X in (U, Y, R))
    n_freq = U.shape[2]
    lines = np.arange(20, 20 + n_freq) if lines is None else np.asarray(lines)
    fs = 1000.0 if fs is None else fs
    period = 1000 if period is None else period
    frequency = lines * fs / period
    return jf.Spectra(U=U, Y=Y, R=R, lines=lines, frequency=frequency, noise=None, fs=fs, period=period, **fields)


def log_odd_lines(low, high, n):
    """Distinct odd lines, about evenly spaced in log frequency."""
    return np.unique(2 * np.floor(np.geomspace(low, high, n) / 2).astype(int) + 1)


def circular(rng, shape):
    """Circular complex Gaussian numbers of unit variance."""
    return _complex(rng, *shape) / np.sqrt(2)


def _complex(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def _apply(G, X):
    return np.einsum("fab,...fb->...fa", G, X)


def from_residuals(cov):
    """The covariance that a method derives from its residuals, without the bias that the data show."""
    from jaxfrf.frf.scaled import Widened

    return np.asarray(cov.of if isinstance(cov, Widened) else cov)
