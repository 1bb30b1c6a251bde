"""Machines, their records, and what can go wrong with them: NumPy and SciPy only, nothing from jaxfrf.

A record is a dict of arrays u, y and perhaps r, (exp, time, channel), with fs and period.
"""

import numpy as np
import scipy.linalg
import scipy.signal

FS = 1000.0

# --- machines


def axes(n: int, rng) -> tuple[np.ndarray, ...]:
    """n motors behind springs, arms coupled: state space of held torque to sampled motor speed, and a PI controller."""
    motor, arm = rng.uniform(0.8, 1.2, n), rng.uniform(0.7, 2.0, n)
    mix = rng.uniform(-0.3, 0.3, (n, n))
    M = scipy.linalg.block_diag(np.diag(motor), np.diag(arm) + mix @ mix.T)
    k = (2 * np.pi * rng.uniform(25, 60, n)) ** 2 * arm
    d = 2 * rng.uniform(0.01, 0.05) * np.sqrt(k * arm)
    spring = np.block([[np.diag(k), -np.diag(k)], [-np.diag(k), np.diag(k)]])
    damper = np.block([[np.diag(d), -np.diag(d)], [-np.diag(d), np.diag(d)]])
    damper = damper + np.diag(np.concatenate([rng.uniform(2, 5, n), np.full(n, 0.1)]))
    return M, spring, damper


def simulate(M, spring, damper, r, rng, *, noise=0.0, gain=None, coulomb=0.0, hardening=0.0, ripple=0.0):
    """Motor torque and motor speed of every experiment: r (exp, time, n), speed reference; torque without `gain`.

    One Runge-Kutta step a sample. Coulomb friction is smoothed over .02 rad/s, the hardening is cubic in the
    deflection, the ripple a torque that turns with the motor. White noise of `noise` times its rms is on y.
    """
    n = r.shape[-1]
    inverse = np.linalg.inv(M)
    h = 1 / FS

    def rate(q, v, torque):
        force = -q @ spring.T - v @ damper.T
        force[:, :n] += torque
        if coulomb:
            force[:, :n] -= coulomb * np.tanh(v[:, :n] / 0.02)
        if hardening:
            bend = q[:, :n] - q[:, n:]
            force[:, :n] -= hardening * bend**3
            force[:, n:] += hardening * bend**3
        if ripple:
            force[:, :n] += ripple * np.sin(8 * q[:, :n])
        return force @ inverse.T

    q, v = np.zeros((len(r), 2 * n)), np.zeros((len(r), 2 * n))
    integral = np.zeros((len(r), n))
    u, y = np.empty_like(r), np.empty_like(r)
    seen = noise * rng.standard_normal(r.shape)
    for t in range(r.shape[1]):
        y[:, t] = v[:, :n] + seen[:, t]
        if gain is None:
            u[:, t] = r[:, t]
        else:
            error = r[:, t] - y[:, t]
            integral += error / FS
            u[:, t] = gain * (error + 5.0 * integral)
        a1 = rate(q, v, u[:, t])
        v2 = v + h / 2 * a1
        a2 = rate(q + h / 2 * v, v2, u[:, t])
        v3 = v + h / 2 * a2
        a3 = rate(q + h / 2 * v2, v3, u[:, t])
        v4 = v + h * a3
        a4 = rate(q + h * v3, v4, u[:, t])
        q = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return u, y


def multisine(rng, lines, period, n_exp, n):
    """Random-phase multisines of unit variance, orthogonal between experiments and channels: (exp, period, n)."""
    F = np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n)
    blocks = []
    for _ in range(-(-n_exp // n)):
        a, b = np.exp(2j * np.pi * rng.random((2, len(lines), n)))
        blocks.append(np.moveaxis(a[:, :, None] * F * b[:, None, :], 2, 0))
    X = np.zeros((n_exp, period // 2 + 1, n), complex)
    X[:, lines] = np.concatenate(blocks)[:n_exp]
    x = np.fft.irfft(X, period, axis=1)
    return x / x.std(axis=1, keepdims=True).mean()


def machine_record(kind: str, rng, n_periods: int = 10) -> dict:
    """A clean record of steady periods: `loop` two axes in closed loop, `open` one axis on torque, `rough` one axis
    in closed loop with friction, hardening and ripple, `weak` one axis at little excitation."""
    spec = {
        "loop": dict(n=2, n_exp=4, period=2000, lines=np.arange(7, 240, 2), noise=1e-2),
        "open": dict(n=1, n_exp=1, period=2000, lines=np.arange(9, 260), noise=3e-3),
        "rough": dict(n=1, n_exp=3, period=2000, lines=np.arange(11, 240, 2), noise=3e-3),
        "weak": dict(n=1, n_exp=2, period=1600, lines=np.arange(5, 180, 2), noise=0.3),
    }[kind]
    n, period, lines = spec["n"], spec["period"], spec["lines"]
    M, spring, damper = axes(n, rng)
    one = multisine(rng, lines, period, spec["n_exp"], n)
    more = {}
    if kind == "rough":
        t = np.arange(period) / period
        one = one + 2.5 * np.sin(2 * np.pi * 3 * t)[:, None]
        size = spring[0, 0]
        more = {"coulomb": 4.0, "hardening": size * 2e3 * rng.uniform(0.5, 2), "ripple": 1.0}
    gain = None if kind == "open" else 2 * np.pi * 6.0 * np.diag(M)[:n]
    if kind == "open":
        one = one * 30.0
    played = np.tile(one, (1, n_periods + 2, 1))
    ramp = np.minimum(np.arange(played.shape[1]) / (period / 2), 1.0)[:, None]
    scale = spec["noise"]
    if kind == "open":
        scale = spec["noise"] * 30.0 / (2 * np.pi * 40 * M[0, 0])
    u, y = simulate(M, spring, damper, played * ramp, rng, noise=scale, gain=gain, **more)
    steady = slice(2 * period, None)
    found = {"u": u[:, steady], "y": y[:, steady], "fs": FS, "period": period, "y_quantity": "velocity"}
    if kind == "open":
        found["u"] = found["u"] * (1 + 0.0) + 1e-3 * 30.0 * rng.standard_normal(found["u"].shape)
        found["lines"] = lines
    else:
        found["r"] = played[:, steady]
        found["lines"] = lines
    return found


def periods(record: dict, n: int) -> dict:
    return change(record, lambda x: x[:, : n * record["period"]])


def change(record: dict, function, names=("u", "y", "r")) -> dict:
    return record | {k: function(record[k].copy()) for k in names if k in record}


# --- faults: each takes a record and a generator, and returns another one


def lost(names, at: float, count: int):
    """`count` samples missing (negative: repeated) at a part of the record; the end is filled from the periodic signal,
    as a logger that stops after a number of samples would."""

    def apply(record, rng):
        n = record["u"].shape[1]
        s = int(at * n)
        source = np.arange(n)
        source = np.where(source < s, source, source + count)
        source = np.where(source < n, source, source - record["period"])
        source = np.where((np.arange(n) >= s) & (source < s), s, source) if count < 0 else source
        return change(record, lambda x: x[:, source], names)

    return apply


def stretch(name, at: float, length: int, value: str):
    def apply(record, rng):
        def f(x):
            s = int(at * x.shape[1])
            part = slice(s, s + length)
            if value == "held":
                x[0, part, 0] = x[0, s, 0]
            elif value == "zero":
                x[0, part, 0] = 0.0
            elif value == "noise":
                x[0, part, 0] = x[0, :, 0].std() * rng.standard_normal(length)
            return x

        return change(record, f, (name,))

    return apply


def gain(name, shape: str, size: float):
    def apply(record, rng):
        def f(x):
            t = np.linspace(0, 1, x.shape[1])
            form = {"drift": t, "step": (t > 0.5) * 1.0, "fade": t**2}[shape]
            x[..., 0] *= 1 + size * form
            return x

        return change(record, f, (name,))

    return apply


def offset(name, shape: str, size: float):
    def apply(record, rng):
        def f(x):
            t = np.linspace(0, 1, x.shape[1])
            form = {"drift": t, "step": (t > 0.37) * 1.0, "bend": t**3}[shape]
            x[..., 0] += size * x[..., 0].std() * form
            return x

        return change(record, f, (name,))

    return apply


def clip(name, level: float, noise: float = 0.0):
    def apply(record, rng):
        def f(x):
            limit = level * x[..., 0].std()
            x[..., 0] = np.clip(x[..., 0], -limit, limit) + noise * limit * rng.standard_normal(x[..., 0].shape)
            return x

        return change(record, f, (name,))

    return apply


def quantise(name, levels: int):
    def apply(record, rng):
        def f(x):
            step = np.ptp(x[..., 0]) / levels
            x[..., 0] = np.round(x[..., 0] / step) * step
            return x

        return change(record, f, (name,))

    return apply


def wrap(name, part: float):
    """A counter whose range is a part of the signal's."""

    def apply(record, rng):
        def f(x):
            turn = part * np.ptp(x[..., 0])
            x[..., 0] = (x[..., 0] + turn / 2) % turn - turn / 2
            return x

        return change(record, f, (name,))

    return apply


def spike(name, at: float, size: float, count: int = 1):
    def apply(record, rng):
        def f(x):
            s = (at + 0.6 * rng.random(count) * (count > 1)) * x.shape[1]
            x[0, s.astype(int), 0] += size * x[0, :, 0].std()
            return x

        return change(record, f, (name,))

    return apply


def foreign(kind: str):
    """One experiment that is something else."""

    def apply(record, rng):
        def f(x):
            if kind == "sign":
                x[-1] = -x[-1]
            elif kind == "sign of one channel":
                x[-1, :, 0] = -x[-1, :, 0]
            elif kind == "swapped":
                x[-1] = x[-1][:, ::-1]
            elif kind == "noise":
                x[-1] = x[-1].std(axis=0) * rng.standard_normal(x[-1].shape)
            elif kind == "permuted":
                x[[0, -1]] = x[[-1, 0]]
            elif kind == "late by 1":
                x[-1] = np.roll(x[-1], 1, axis=0)
            elif kind == "late by 5":
                x[-1] = np.roll(x[-1], 5, axis=0)
            elif kind == "gain 1.1":
                x[-1] *= 1.1
            elif kind == "gain 2":
                x[-1] *= 2.0
            return x

        return change(record, f, ("y",))

    return apply


def twice(kind: str):
    def apply(record, rng):
        if kind == "experiment":
            return change(record, lambda x: np.concatenate([x, x[-1:]]))
        if kind == "all":
            return change(record, lambda x: np.concatenate([x, x]))
        return change(record, lambda x: np.concatenate([x, x], axis=1))  # the record after itself

    return apply


def jitter(name, size: float):
    """Samples taken at other times than said: the periodic signal interpolated by its Fourier series."""

    def apply(record, rng):
        def f(x):
            n = x.shape[1]
            slope = np.fft.irfft(2j * np.pi * np.fft.rfftfreq(n)[:, None] * np.fft.rfft(x, axis=1), n, axis=1)
            return x + slope * size * rng.standard_normal((1, n, 1))

        return change(record, f, (name,))

    return apply


def shift(name, by: int):
    """A signal that is late (positive) by whole samples in all experiments."""
    return lambda record, rng: change(record, lambda x: np.roll(x, by, axis=1), (name,))


def period(factor=None, by: int = 0):
    def apply(record, rng):
        given = round(record["period"] * (factor or 1)) + by
        n = record["u"].shape[1] // given * given
        found = change(record, lambda x: x[:, :n]) | {"period": given}
        return {k: v for k, v in found.items() if k != "lines"}

    return apply


def scale(name, by: float):
    return lambda record, rng: change(record, lambda x: x * by, (name,))


def exchange(name):
    return lambda record, rng: change(record, lambda x: x[..., ::-1], (name,))
