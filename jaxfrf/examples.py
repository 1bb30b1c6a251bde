"""A small experiment to try everything on: two flexible axes in closed loop, simulated."""

import importlib.resources

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Float

from ._arguments import expect_number, expect_real
from ._types import Array
from .excitation import Multisine, SlowSine, log_odd_lines, reference
from .experiment import Experiment

FS = 500.0
PERIOD = 4000
_MOTOR = np.diag([1.3e-3, 1.1e-3])  # kg m^2
_ARM = np.array([[2.0e-3, 5.0e-4], [5.0e-4, 1.2e-3]])  # kg m^2, coupled
_STIFFNESS = np.diag([18.0, 22.0])  # N m/rad
_DAMPING = np.diag([8e-3, 6e-3])  # N m s/rad
_FRICTION = np.diag([4e-3, 3e-3])  # N m s/rad, motor side
_GAIN = np.array([0.12, 0.09])  # N m s/rad, velocity controller
_INTEGRAL_TIME = 0.1  # s
_POSITION_GAIN = 5.0  # 1/s


def example(*, blocks: int = 2, periods: int = 2, noise: float = 2e-3, seed: int = 0) -> Experiment:
    """Two motors behind springs, the arms coupled by their inertia; P position and PI velocity control at 500 Hz.

    Orthogonal multisines, 93 log-spaced odd lines from 1.9 to 96 Hz, on top of a slow sine. Each block holds two
    experiments; `noise` (N m rms) is white torque noise on the motors, and the measured speed has white noise of 2e-3
    rad/s. The torque is held between samples, so the FRF is the one of `example_response`.

    **Arguments:** `blocks`: of two experiments. `periods`: steady ones of 4000 samples, behind a transient one. `seed`:
    of the phases and the noise.

    **Returns:** an `Experiment` at one position: `u` (N m), `y` and `r` (rad/s), each (1, 2 `blocks`, time, 2).

    **Raises:** `jaxfrf.InputError` for `blocks` or `periods` below 1, and for `noise` or `seed` that is no number.

    **Source:** this project's own; held torques by the matrix exponential as in Van Loan, IEEE Trans. Automatic Control
    23 (1978) 395-404.
    """
    expect_number("noise", noise)
    design = Multisine(
        FS,
        PERIOD,
        log_odd_lines(15, 800, 110),
        blocks=blocks,
        rms=[1.0, 1.0],
        slow=SlowSine([5, 7], [3.0, 3.0]),
        periods=periods,
        transient_periods=1,
        ramp=1.0,
        seed=seed,
    )
    motion = reference(design)
    u, y = _simulate(motion.r, motion.position, noise, np.random.default_rng(seed))
    return Experiment(
        u=u,
        y=y,
        r=motion.r,
        fs=FS,
        period=PERIOD,
        lines=design.lines,
        transient_periods=1,
        q=np.zeros((1, 2)),
    )


def example_response(frequency: Float[Array, "freq"]) -> Complex[np.ndarray, "1 freq out in"]:
    """The true FRF of `example` from held torque to motor speed.

    **Arguments:** `frequency`: (freq,), Hz, or one.

    **Returns:** (1, freq, out, in), rad/s over N m.

    **Raises:** `jaxfrf.InputError` for frequencies that are no finite numbers.

    **Source:** closed form, C (z - A)^-1 B of the sampled system.
    """
    expect_real("frequency", frequency)
    A, B, C = _discrete()
    z = np.exp(2j * np.pi * np.atleast_1d(np.asarray(frequency)) / FS)
    return (C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape))))[None]


def example_robot() -> str:
    """The text of a robot's file (TOML): the axes of `example`, with guesses of springs and viscous friction."""
    return importlib.resources.files(__package__).joinpath("example_robot.toml").read_text(encoding="utf-8")


def _discrete():
    """State [q_m, q_a, rates], sampled with held torque."""
    zero, eye = np.zeros((2, 2)), np.eye(2)
    motor, arm = np.linalg.inv(_MOTOR), np.linalg.inv(_ARM)
    A = np.block(
        [
            [zero, zero, eye, zero],
            [zero, zero, zero, eye],
            [-motor @ _STIFFNESS, motor @ _STIFFNESS, -motor @ (_DAMPING + _FRICTION), motor @ _DAMPING],
            [arm @ _STIFFNESS, -arm @ _STIFFNESS, arm @ _DAMPING, -arm @ _DAMPING],
        ]
    )
    B = np.vstack([zero, zero, motor, zero])
    both = scipy.linalg.expm(np.block([[A, B], [np.zeros((2, 10))]]) / FS)
    return both[:8, :8], both[:8, 8:], np.hstack([zero, zero, eye, zero])


def _simulate(velocity, position, noise: float, rng):
    A, B, _ = _discrete()
    n_exp, n_time, _ = velocity.shape
    x = np.zeros((n_exp, 8))
    x[:, :4] = np.tile(position[:, 0], 2)
    integral = np.zeros((n_exp, 2))
    u, y = np.empty((n_exp, n_time, 2)), np.empty((n_exp, n_time, 2))
    disturbance = noise * rng.standard_normal((n_time, n_exp, 2))
    sensor = 2e-3 * rng.standard_normal((n_time, n_exp, 2))
    for t in range(n_time):
        y[:, t] = x[:, 4:6] + sensor[t]
        error = _POSITION_GAIN * (position[:, t] - x[:, :2]) + velocity[:, t] - y[:, t]
        integral += error / FS
        u[:, t] = _GAIN * (error + integral / _INTEGRAL_TIME)
        x = x @ A.T + (u[:, t] + disturbance[t]) @ B.T
    return u, y
