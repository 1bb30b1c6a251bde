"""Closed-loop simulation of R3X: microseconds per control sample and robot, beside MuJoCo at equal error.

    PYTHONPATH=tests/reference python benchmarks/bench_simulation.py [--cores 1] [--fraction 0.08]

1. jaxfrf with 1 and 300 runs, noise and ripple of torque and resolver included, compile time apart.
2. The smooth robot (linear springs, no friction, no noise: what both can do) in jaxfrf and in MuJoCo with several
   fine steps: time beside error, the relative rms of the motor speeds against MuJoCo RK4 at 10 us.
3. The study of 1176 runs of 28 s, extrapolated from the stated fraction of its runs.

MuJoCo is timed twice: with the controller in a Python loop, and its steps alone in one call; jaxfrf always with its
controller. Times are wall clock of the best of several repeats; processor time stands beside it, for shared machines.
"""

import argparse
import os
import pathlib
import time

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--cores", type=int, default=2)
parser.add_argument("--fraction", type=float, default=0.08, help="of the 1176 runs of the study to simulate")
parser.add_argument("--seconds", type=float, default=1.0, help="simulated in part 1")
options = parser.parse_args()
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.cores])
os.environ["OMP_NUM_THREADS"] = "1"
os.environ.setdefault("NPROC", "64")
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax  # noqa: E402
import jax.random as jr  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from loop_reference import mujoco_loop  # noqa: E402
from mujoco_reference import MuJoCoRobot  # noqa: E402

import jaxfrf as jf  # noqa: E402
from jaxfrf import effects, robot as jrobot  # noqa: E402
from jaxfrf.io.designs import read_design  # noqa: E402
from jaxfrf.simulation.closed_loop import ClosedLoop, Runs, play  # noqa: E402

RIPPLE = np.array([0.03, 0.02, 0.05, 0.03])
SCALE = (1.0, 1.0, 1.0, 0.2, 0.2, 0.07)


def rippled(robot):
    """With torque ripple and resolver ripple on all axes."""
    torque = [effects.TorqueRipple(axis, scale * RIPPLE) for axis, scale in enumerate(SCALE)]
    resolver = [effects.ResolverRipple(axis, [5e-4, 1e-3]) for axis in range(6)]
    return robot.with_effects(*torque, *resolver)


def smooth(robot):
    """Linear springs, no friction."""
    kinds = {"coulomb_friction": 0.0, "viscous_friction": 0.0, "stiffness_ratio": 1.0}
    return jrobot.with_parameters(
        robot, {name: value for kind, value in kinds.items() for name in jrobot.parameters(robot, (kind,))}
    )


def one_second(samples):
    slow = jf.SlowSine([1, 2, 3, 1, 2, 3], [20.0, 20.0, 20.0, 30.0, 30.0, 30.0])
    return jf.Multisine(2000.0, samples, np.arange(9, 49, 2), rms=[2.0, 2.0, 2.0, 4.0, 4.0, 6.0], slow=slow)


def timed(run, repeats):
    """Least wall and processor time of several repeats, s."""
    wall, cpu = [], []
    for _ in range(repeats):
        start, busy = time.perf_counter(), time.process_time()
        run()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - busy)
    return min(wall), min(cpu)


def report(name, wall, cpu, count, compile_time=None):
    """Per control sample and robot."""
    compiled = "" if compile_time is None else f"   compiled in {compile_time:.1f} s"
    print(f"  {name:44} {wall / count * 1e6:8.2f} us   ({cpu / count * 1e6:.2f} us of processor){compiled}", flush=True)


def speed_of_many_runs():
    print(f"R3X with friction, noise and ripple, {options.cores} core(s):")
    robot, plan = rippled(jrobot.r3x()), one_second(int(2000 * options.seconds))
    for positions in (1, 50):
        q = jf.random_positions(positions, jr.key(0))
        runs = 6 * positions
        run = lambda q=q: jf.simulate(robot, plan, q, key=jr.key(1), run_in=0.0)
        start = time.perf_counter()
        run()
        first = time.perf_counter() - start
        wall, cpu = timed(run, 3)
        report(f"{runs} runs", wall, cpu, runs * plan.period, first - wall)


def single(robot, q, references, steps):
    """One run, compiled: motor positions, and what it takes."""
    loop = ClosedLoop.of(robot, noise=0.0, steps=steps)
    state = loop.at_rest(jrobot.operating_point(robot, q))
    runs = Runs(np.zeros(len(q), int), loop.plant.motor(state.z), jr.split(jr.key(0), len(q)))
    start = time.perf_counter()
    compiled = play.lower(loop, state, runs, np.asarray(0), references).compile()
    took = time.perf_counter() - start
    return (lambda: jax.block_until_ready(compiled(loop, state, runs, np.asarray(0), references)[2])), took


def steps_alone(robot, point, steps, integrator):
    """2000 control samples of MuJoCo without any controller, in one call: the time of its integrator alone."""
    twin = MuJoCoRobot(robot)
    model, data = twin.model, twin.data
    model.opt.timestep, model.opt.integrator = 1.0 / (robot.sampling_frequency * steps), integrator

    def run():
        data.qpos[twin.order], data.qvel[:] = point.z, 0.0
        data.ctrl[:] = point.torque
        mujoco.mj_step(model, data, 2000 * steps)

    return run


def beside_mujoco():
    print("Smooth R3X, 1 s from rest: time beside error of the motor speed against MuJoCo RK4 at 10 us:")
    robot, plan = (
        smooth(jrobot.r3x()),
        jf.Multisine(
            2000.0, 2000, np.arange(9, 49, 2), rms=[2.0, 2.0, 2.0, 4.0, 4.0, 6.0], transient_periods=1, ramp=1.0
        ),
    )
    q = jf.random_positions(32, jr.key(0))
    points = jrobot.operating_point(robot, q)
    point = jax.tree.map(lambda x: np.asarray(x)[0], points)
    played = jf.reference(plan)
    velocity, position = played.r[0, :2000], played.position[0, :2000]
    reference = np.diff(mujoco_loop(robot, point, velocity, position, steps=50)[0], axis=0)
    error = lambda angle: np.sqrt(np.mean((np.diff(angle, axis=0) - reference) ** 2) / np.mean(reference**2))
    kinds = {"RK4": mujoco.mjtIntegrator.mjINT_RK4, "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST}
    alone = []
    for name, steps in (("RK4", 5), ("RK4", 2), ("RK4", 1), ("implicitfast", 5), ("implicitfast", 1)):
        found = {}
        run = lambda name=name, steps=steps, found=found: found.update(
            angle=mujoco_loop(robot, point, velocity, position, steps, kinds[name])[0]
        )
        wall, cpu = timed(run, 2)
        text = f"MuJoCo {name}, {0.5 / steps:.2g} ms, error {error(found['angle']):.1e}"
        report(text + ", Python loop", wall, cpu, 2000)
        wall, cpu = timed(steps_alone(robot, point, steps, kinds[name]), 3)
        report(text + ", steps alone", wall, cpu, 2000)
        alone.append((cpu / 2000, error(found["angle"]), text))
    references = np.stack([velocity, position], axis=1)[..., None]
    for steps in (5, 2):
        for count in (32, 1):
            run, took = single(robot, q[:count], references, steps)
            angle = np.asarray(run())[:, :, 0]
            wall, cpu = timed(run, 3)
            report(f"jaxfrf, {count} runs, {steps} steps, error {error(angle):.1e}", wall, cpu, 2000 * count, took)
            equal = [x for x in alone if x[1] <= error(angle)]
            if equal:
                time_alone, _, text = min(equal)
                print(
                    f"    {time_alone / (cpu / 2000 / count):.1f} times as fast per core as the steps alone of {text}"
                )


def study():
    """The paper's excitation on R3X with friction, noise and ripple."""
    plan = read_design(pathlib.Path(__file__).parent / "paper_design.toml")
    positions = max(1, round(options.fraction * 49))
    start, busy = time.perf_counter(), time.process_time()
    data = jf.simulate(rippled(jrobot.r3x()), plan, jf.random_positions(positions, jr.key(0)), key=jr.key(1))
    took, busy = time.perf_counter() - start, time.process_time() - busy
    runs = data.n_pos * data.n_exp
    print(
        f"Study: {runs} of 1176 runs of 28 s (5 s of run-in, noise, ripple, compilation) took {took:.0f} s on "
        f"{options.cores} core(s), {busy:.0f} s of processor; all of them {took * 1176 / runs / 60:.1f} min, or "
        f"{busy * 1176 / runs / 60 / options.cores:.1f} min with {options.cores} core(s) of their own"
    )


if __name__ == "__main__":
    speed_of_many_runs()
    beside_mujoco()
    if options.fraction > 0:
        study()
