"""FRFs of R3X and their Jacobians per second: 49 positions x 336 lines x 22 parameters.

    python benchmarks/bench_robot_frf.py [--cores 1]

Beside jaxfrf, in the same run: a vectorised NumPy solve of the same dynamic stiffness with the same outer
products, and forward differences over the NumPy FRF (what a generic least-squares solver does). Both keep the
equilibrium fixed. Compile time stands apart; the best of several runs counts; results are compared before
they are timed.
"""

import argparse
import os
import time

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--cores", type=int, default=2)
parser.add_argument("--positions", type=int, default=49)
parser.add_argument("--repeats", type=int, default=5)
options = parser.parse_args()
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.cores])
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["NPROC"] = str(options.cores)
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import numpy as np  # noqa: E402

import jaxfrf.robot as jr  # noqa: E402


def positions(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    low, high = np.array([-150, -60, 20, -150, 25, -150]), np.array([150, 60, 150, 150, 100, 150])
    q = rng.uniform(low, high, (count, 6))
    q[:, 4] *= rng.choice([-1, 1], count)
    return np.deg2rad(q)


def best(run) -> float:
    times = []
    for _ in range(options.repeats):
        start = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - start)
    return min(times)


def compiled(function, *arguments):
    start = time.perf_counter()
    run = eqx.filter_jit(function).lower(*arguments).compile()
    return (lambda: run(*arguments)), time.perf_counter() - start


def numpy_motion(mass, damping, stiffness, motor, omega):
    """X = S^{-1} B at every position and line."""
    w = omega[:, None, None]
    dynamic = stiffness[:, None] + 1j * w * damping[:, None] - w**2 * mass[:, None]
    return np.linalg.solve(dynamic, np.broadcast_to(motor.astype(complex), (*dynamic.shape[:2], *motor.shape)))


def numpy_frf(matrices, motor, omega):
    return 1j * omega[:, None, None] * (motor.T @ numpy_motion(*matrices, motor, omega))


def numpy_jacobian(matrices, motor, springs, local, omega):
    """G and its derivatives at a fixed equilibrium, by outer products."""
    X = numpy_motion(*matrices, motor, omega)
    s = 1j * omega[:, None, None]
    across, turned = np.swapaxes(springs.T @ X, -1, -2), np.swapaxes(motor.T @ X, -1, -2)
    left = np.concatenate([across * local[:, None, None], s * across, s * turned], axis=-1) * -s
    right = np.concatenate([across, across, turned], axis=-1)
    return s * (motor.T @ X), left[:, :, :, None] * right[:, :, None]


def numpy_differences(matrices, motor, springs, omega, theta):
    """G and forward differences in 22 parameters, the equilibrium fixed."""
    mass, damping, stiffness = matrices
    directions = np.concatenate([springs, springs, motor], axis=1)
    G = numpy_frf(matrices, motor, omega)
    slopes = np.empty((*G.shape, len(theta)), complex)
    for p, (w, value) in enumerate(zip(directions.T, theta, strict=True)):
        h = 1e-6 * value
        step = h * np.outer(w, w)
        changed = (mass, damping, stiffness + step) if p < springs.shape[1] else (mass, damping + step, stiffness)
        slopes[..., p] = (numpy_frf(changed, motor, omega) - G) / h
    return G, slopes


def report(name: str, seconds: float, lines: int, compile_time: float | None = None) -> None:
    note = "" if compile_time is None else f"   compile {compile_time:5.2f} s"
    each = f"{seconds / lines * 1e6:8.2f} us/FRF {lines / seconds:10.0f} FRF/s"
    print(f"{name:44s} {seconds * 1e3:9.1f} ms {each}{note}")


def main() -> None:
    robot, q = jr.r3x(), positions(options.positions)
    lines = np.unique(2 * np.floor(np.geomspace(112, 2240, 366) / 2) + 1)[:-1]
    frequency = lines * 2000.0 / 56000.0
    omega, count = 2 * np.pi * frequency, len(q) * len(lines)
    friction = jr.effective_friction(robot.drives.friction, 30.0)
    hold = jr.ZeroOrderHold(2000.0)
    print(f"{len(q)} positions x {len(lines)} lines x 22 parameters, {options.cores} cores")

    linear, compile_linear = compiled(lambda r, x: jr.linearise(r, jr.operating_point(r, x), friction), robot, q)
    model = linear()
    report("equilibrium and linearisation", best(linear), count, compile_linear)
    for name, kind in (("FRF", None), ("FRF, held and sampled", hold)):
        run, compile_time = compiled(lambda m, f, kind=kind: jr.frf(m, f, hold=kind), model, frequency)
        report(f"{name}, given the matrices", best(run), count, compile_time)
    for name, kind in (("FRF and Jacobian", None), ("FRF and Jacobian, held and sampled", hold)):
        function = lambda r, x, f, kind=kind: jr.frf_and_jacobian(r, x, f, hold=kind, friction=friction)
        run, compile_time = compiled(function, robot, q, frequency)
        report(name, best(run), count, compile_time)
        if kind is None:
            ours = run()
    print("  (equilibrium, linearisation and its derivatives included)")

    matrices = tuple(np.asarray(x) for x in (model.mass, model.damping, model.stiffness))
    motor, springs = np.asarray(model.motor), np.asarray(jr.spring_directions(robot))
    tangent = robot.springs.stiffness_ratio  # any spring: the shape does not change the cost
    local = np.broadcast_to(np.asarray(tangent), (len(q), springs.shape[1]))
    G, slopes = numpy_jacobian(matrices, motor, springs, local, omega)
    assert np.allclose(G, ours.G, rtol=1e-9, atol=1e-12)
    assert np.allclose(slopes[..., 8:], ours.jacobian[..., 8:], rtol=1e-7, atol=1e-12)
    report("NumPy FRF, given the matrices", best(lambda: numpy_frf(matrices, motor, omega)), count)
    report(
        "NumPy FRF and Jacobian, outer products",
        best(lambda: numpy_jacobian(matrices, motor, springs, local, omega)),
        count,
    )
    theta = np.concatenate([robot.springs.stiffness, robot.springs.damping, friction])
    start = time.perf_counter()
    numpy_differences(matrices, motor, springs, omega, theta)
    report("NumPy FRF and Jacobian, differences", time.perf_counter() - start, count)


if __name__ == "__main__":
    main()
