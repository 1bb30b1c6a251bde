"""Linear robot-like plants in closed loop, as spectra in steady state: the data of the benchmarks."""

import dataclasses

import numpy as np

import jaxfrf as jf

FS = 2000.0
PERIOD = 56000
PAPER_LINES = (112, 2240, 366)  # 336 log-spaced odd lines, 4.04 to 79.3 Hz


@dataclasses.dataclass(frozen=True)
class Axes:
    """n motors, each behind a spring; the arms are coupled by their inertia. Torque in, motor speed out.

    A velocity controller C = diag(gain) (1 + 1/(integral_time s)) closes the loop. The plant is passive, so any such
    controller stabilises it.
    """

    motor: np.ndarray  # kg m^2, (axis,)
    arm: np.ndarray  # kg m^2, (axis, axis)
    stiffness: np.ndarray  # N m/rad, (axis,)
    damping: np.ndarray  # N m s/rad, (axis,), of the springs
    friction: np.ndarray  # N m s/rad, (axis,), of the motors
    gain: np.ndarray  # N m s/rad, (axis,)
    integral_time: float = 0.1  # s

    @property
    def n(self) -> int:
        return len(self.motor)

    def response(self, frequency) -> np.ndarray:
        """From motor torque to motor speed: (freq, out, in)."""
        s = 2j * np.pi * np.asarray(frequency)[:, None, None]
        spring = np.diag(self.stiffness) / s + np.diag(self.damping)
        arm = self.arm * s
        seen = spring - spring @ np.linalg.solve(arm + spring, spring)
        return np.linalg.inv(np.diag(self.motor) * s + np.diag(self.friction) + seen)

    def controller(self, frequency) -> np.ndarray:
        """From speed error to torque: (freq, in, out)."""
        s = 2j * np.pi * np.asarray(frequency)[:, None]
        return (self.gain * (1 + 1 / (self.integral_time * s)))[..., None] * np.eye(self.n)


def random_axes(n: int, rng: np.random.Generator, damping: float = 0.03, bandwidth: float = 2.0) -> Axes:
    """Antiresonances from 8 to 30 Hz, relative damping as said, controller bandwidth in Hz."""
    motor = rng.uniform(0.8, 1.2, n)
    scale = np.sqrt(rng.uniform(0.8, 2.0, n))
    mix = rng.uniform(-0.6, 0.6, (n, n)) / np.sqrt(n)
    arm = scale[:, None] * (np.eye(n) + mix @ mix.T + 0.5 * (mix + mix.T)) * scale
    assert np.linalg.eigvalsh(arm).min() > 0
    stiffness = (2 * np.pi * rng.uniform(8, 30, n)) ** 2 * np.diag(arm)
    return Axes(
        motor=motor,
        arm=arm,
        stiffness=stiffness,
        damping=2 * damping * np.sqrt(stiffness * np.diag(arm)),
        friction=0.5 * motor,
        gain=2 * np.pi * bandwidth * (motor + np.diag(arm)),
    )


def multisines(rng: np.random.Generator, n_exp: int, n_freq: int, n: int) -> np.ndarray:
    """Orthogonal random-phase multisines of unit amplitude: (exp, freq, channel)."""
    fourier = np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n)
    turn = np.exp(2j * np.pi * rng.uniform(size=(2, -(-n_exp // n), n_freq, n)))
    blocks = turn[0][..., :, None] * fourier * turn[1][..., None, :]
    return np.moveaxis(blocks, 3, 1).reshape(-1, n_freq, n)[:n_exp]


def paper_lines() -> np.ndarray:
    return jf.log_odd_lines(*PAPER_LINES)


def experiment(
    plants: list[Axes], n_exp: int, disturbance: float, rng: np.random.Generator, lines=None, at: str = "output"
) -> tuple[jf.Spectra, np.ndarray]:
    """Spectra of one operating point per plant, and their true FRFs (pos, freq, out, in).

    y = G u + v, u = C (r - y): the disturbance v is circular, white, independent between channels, its rms
    `disturbance` times that of the undisturbed output of its channel (over lines and experiments); the controller
    feeds it back, so that u holds it too. `at` "input" it is a torque w beside u, v = G w, each channel's w of the same
    rms, and u = C (r - y).
    """
    lines = paper_lines() if lines is None else np.asarray(lines)
    frequency = lines * FS / PERIOD
    G = np.stack([plant.response(frequency) for plant in plants])
    C = np.stack([plant.controller(frequency) for plant in plants])
    n = G.shape[-1]
    R = np.stack([multisines(rng, n_exp, len(lines), n) for _ in plants])
    to_u = np.linalg.solve(np.eye(n) + C @ G, C)
    clean = _apply(G @ to_u, R)
    level = np.sqrt(np.mean(np.abs(clean) ** 2, axis=(1, 2), keepdims=True))
    V = disturbance * level * (rng.standard_normal(R.shape) + 1j * rng.standard_normal(R.shape)) / np.sqrt(2)
    if at == "input":
        torque = V / level / np.sqrt(np.mean(np.abs(G) ** 2, axis=(1, 2, 3)))[:, None, None, None]
        V = _apply(G, torque * np.sqrt(np.mean(level**2, axis=-1, keepdims=True)))
    U = _apply(to_u, R - V)
    Y = _apply(G, U) + V
    return jf.Spectra(U=U, Y=Y, R=R, lines=lines, frequency=frequency, noise=None, fs=FS, period=PERIOD), G


def record(spectra: jf.Spectra) -> jf.Experiment:
    """The samples of spectra of one period, as a record that has none."""

    def samples(X):
        whole = np.zeros((*X.shape[:2], PERIOD // 2 + 1, X.shape[-1]), complex)
        whole[:, :, spectra.lines] = X
        return np.fft.irfft(whole, PERIOD, axis=2) * PERIOD

    return jf.Experiment(samples(spectra.U), samples(spectra.Y), FS, r=samples(spectra.R), y_quantity="velocity")


def _apply(G, X):
    return np.einsum("pfab,pefb->pefa", G, X)
