"""Speed of the public `jaxfrf.estimate` on a GPU, beside the same call on the processor of the same machine.

    python benchmarks/bench_gpu.py [--cases lrm jio ...] [--positions 1 49] [--only GPU] [--json FILE]

Six inputs and outputs, 336 lines, 12 experiments at every position; local methods with R = 2 and windows of 34 lines:
the methods of `bench_local.py`, from spectra in the processor's memory to an FRF with covariance there ("estimate"),
and what of that is the program alone, from arrays on the device to arrays on the device ("program"). Both devices in
one process, in turns; compilation is told apart; results are compared. NumPy's loop is run at one position on one
thread, and counted once for every position. The fit: the cost of `bench_fit.py`, its gradient and J^T W J, at one start
and at 20 at once.

Without a GPU it says so, and measures the processor alone.
"""

import argparse
import os
import pathlib
import statistics
import tempfile
import time

os.environ.setdefault("NPROC", "64")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp()  # a new one: compilation is measured, and done once
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

import bench_local
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from _pinned import commit, machine, machine_text

import jaxfrf as jf
from jaxfrf.frf import method as runs
from jaxfrf.io._json import write_json

EACH = ("lpm", "miso", "lrm", "jio")  # every experiment on its own
CASES = ("h1", "jio-h1", "log", *EACH, "log-lrm", "log-jio", "stacked", "stacked-jio", "auto")
TURNS, LEAST = 3, 0.3  # of every contender; s, that it runs in one
STARTS = 20


def main() -> None:
    arguments = _arguments()
    devices = _devices(arguments.only)
    result = {"machine": machine(), "commit": commit(), "seed": bench_local.SEED, "devices": {}, "rows": [], "fit": []}
    result["devices"] = {name: device.device_kind for name, device in devices.items()}
    print(machine_text(result["machine"]), f"commit {result['commit']}; {result['devices']}", sep="\n", flush=True)
    names = f"{'estimate':>12}{'program':>12}{'NumPy loop':>12}{'compiled':>10}{'difference of G, std':>22}"
    print(f"\n{'':34}{'positions':>10}{'device':>8}{names}")
    for case in arguments.cases:
        for n_pos in arguments.positions:
            rows = _measured(case, n_pos, devices, arguments.loop)
            result["rows"] += rows
            print("\n".join(map(_line, rows)), flush=True)
    if arguments.fit:
        result["fit"] = _fit(devices)
        print("\nThe cost of a fit, its gradient and J^T W J, ms")
        for row in result["fit"]:
            print(
                f"  {row['device']:8}{row['starts']:4} starts{row['ms']:10.1f}   compiled in {row['compile_s']:.1f} s"
            )
    if arguments.json:
        write_json(arguments.json, result)


def _arguments():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--positions", nargs="+", type=int, default=[1, 49])
    parser.add_argument("--only", choices=("CPU", "GPU"), help="measure one kind of device")
    parser.add_argument("--no-loop", dest="loop", action="store_false", help="leave out NumPy's loop")
    parser.add_argument("--no-fit", dest="fit", action="store_false", help="leave out the fit")
    parser.add_argument("--json", type=pathlib.Path, help="also write the results to this file")
    return parser.parse_args()


def _devices(only: str | None) -> dict:
    found = {"CPU": jax.devices("cpu")[0]}
    try:
        found["GPU"] = jax.devices("gpu")[0]
    except RuntimeError:
        print("no GPU here: the processor alone")
    return {name: device for name, device in found.items() if only in (None, name)}


def _measured(case: str, n_pos: int, devices: dict, loop: bool) -> list[dict]:
    """One row a device."""
    method = bench_local.method_of(case)
    spectra = bench_local.spectra_of(n_pos, bench_local.N_EXP)
    spectra = bench_local.one_by_one(spectra) if case in EACH else spectra
    numpy_ms = _loop_ms(case) * n_pos if loop else float("nan")
    rows, found, calls = [], {}, {}
    for name, device in devices.items():
        with jax.default_device(device):
            began = time.perf_counter()
            found[name] = jf.estimate(spectra, method)
            first = time.perf_counter() - began
            calls[name] = _calls(spectra, method, device)
        rows.append({"case": case, "positions": n_pos, "device": name, "numpy_loop_ms": numpy_ms, "first_s": first})
    turns = [{name: _turn(devices[name], calls[name]) for name in devices} for _ in range(TURNS)]
    for row in rows:
        estimate, program = zip(*(turn[row["device"]] for turn in turns), strict=True)
        row |= {"estimate_ms": statistics.median(estimate), "program_ms": statistics.median(program)}
        row["compile_s"] = row["first_s"] - row["estimate_ms"] / 1e3
        row["difference"], row["cov_difference"] = _differences(found[row["device"]], found[next(iter(found))])
    return rows


def _calls(spectra, method, device):
    """The public call; and its program, from arrays on the device to arrays on the device."""
    points, frequency = jax.device_put(runs.arrays_of(spectra), device)

    def program():
        return jax.block_until_ready(runs.compiled(runs._run)(runs._at_point, method, points, frequency))

    program()
    return lambda: jf.estimate(spectra, method), program


def _turn(device, calls) -> list[float]:
    with jax.default_device(device):
        return [_ms(call) for call in calls]


def _ms(call) -> float:
    began, count = time.perf_counter(), 0
    while count == 0 or time.perf_counter() - began < LEAST:
        call()
        count += 1
    return (time.perf_counter() - began) / count * 1e3


def _loop_ms(case: str) -> float:
    """NumPy's loop over the windows of one position."""
    if case == "auto":
        return float("nan")
    loop = next(iter(bench_local.contenders_of(case)[1].values()))
    return min(_ms(loop) for _ in range(2))


def _differences(found, reference) -> tuple[float, float]:
    """Largest relative difference of a window's response, and of a standard deviation."""
    return bench_local.difference(found.G, reference.G), float(np.nanmax(np.abs(found.std / reference.std - 1)))


def _line(row: dict) -> str:
    return (
        f"{bench_local.CASES[row['case']]:34}{row['positions']:10}{row['device']:>8}{row['estimate_ms']:9.1f} ms"
        f"{row['program_ms']:9.1f} ms{row['numpy_loop_ms']:9.0f} ms{row['compile_s']:8.1f} s"
        f"{row['difference']:12.0e}{row['cov_difference']:9.0e}"
    )


def _fit(devices: dict) -> list[dict]:
    import bench_fit

    rows = []
    for name, device in devices.items():
        with jax.default_device(device):
            problem = bench_fit.Problem()
            x = jnp.asarray(problem.true_x)
            many = x + 0.1 * jnp.asarray(np.random.default_rng(bench_fit.SEED_STARTS).normal(size=(STARTS, len(x))))
            one = eqx.filter_jit(lambda x, cost=problem.cost: cost.gram(x))
            every = eqx.filter_jit(lambda x, cost=problem.cost: jax.vmap(cost.gram)(x))
            for starts, gram, at in ((1, one, x), (STARTS, every, many)):
                began = time.perf_counter()
                jax.block_until_ready(gram(at))
                first = time.perf_counter() - began
                ms = statistics.median(
                    _ms(lambda gram=gram, at=at: jax.block_until_ready(gram(at))) for _ in range(TURNS)
                )
                rows.append({"device": name, "starts": starts, "ms": ms, "compile_s": first - ms / 1e3})
    return rows


if __name__ == "__main__":
    main()
