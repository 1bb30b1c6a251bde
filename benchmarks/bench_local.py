"""Speed and memory of the public `jaxfrf.estimate`, against NumPy and SciPy as users write it.

    python benchmarks/bench_local.py [--quick] [--cases lrm lpm ...] [--cores 1 2] [--json FILE] [--sdynpy PYTHON]

Six inputs and outputs, 336 lines, 12 experiments; local methods with R = 2 and windows of 34 lines. From spectra in
memory to an FRF with covariance; the baselines compute G alone. Every measurement runs in a process of its own that is
pinned to its cores, with one BLAS thread. Contenders take turns, and ratios are taken turn by turn, so that
other load on the machine hits all of them; the time of compilation is told apart. "Processor" is the same ratio in
processor time, which other load hardly touches.

SDynPy (GPL, no dependency of this project) is measured in an environment of its own, whose Python `--sdynpy` names:
`python3 -m venv sdynpy && sdynpy/bin/pip install sdynpy psutil joblib 'numpy<2.3'`.
"""

import argparse
import dataclasses
import json
import os
import pathlib
import resource
import statistics
import subprocess
import sys
import time

from _pinned import ROOT, available_cores, commit, load_text, machine, machine_text, run_pinned

SEED = 1
DISTURBANCE = 0.02
ORDER, WIDTH, N_EXP = 2, 34, 12
TIME_LIMIT = 900  # s, of a measuring process: batched LAPACK has been seen to hang
LEAST = 1.0  # s, that a contender runs in one turn: the first call after another is slower where memory is new

CASES = {
    "h1": "H1",
    "jio-h1": "JIO, by H1",
    "log": "LOG, two blocks of six",
    "lpm": "LPM, every experiment",
    "miso": "LRM-MISO, every experiment",
    "lrm": "LRM-MIMO, every experiment",
    "jio": "JIO-LRM, every experiment",
    "log-lpm": "LPM, logarithmic mean of 12",
    "log-miso": "LRM-MISO, logarithmic mean of 12",
    "log-lrm": "LRM-MIMO, logarithmic mean of 12",
    "log-jio": "JIO-LRM, logarithmic mean of 12",
    "stacked": "LRM-MIMO, 12 experiments stacked",
    "stacked-jio": "JIO-LRM, 12 experiments stacked",
    "auto": "auto, against JIO-LRM stacked",
}
LOOP, SCIPY, QR, NORMAL = "NumPy loop", "SciPy loop, gelsy", "NumPy batched QR", "NumPy batched normal eq."
BATCHED, STACKED = "NumPy, all lines at once", "jaxfrf.estimate, JIO-LRM"
RATIO = "NumPy, two H1 and their ratio"
FULL = "jaxfrf.estimate with Cov"
SDYNPY = "SDynPy"


def main() -> None:
    arguments = _arguments()
    if arguments.worker:
        request = json.loads(arguments.worker)
        print(json.dumps(_WORKERS[request.pop("measure")](**request)))
        return
    result = {"machine": machine(), "commit": commit(), "seed": SEED, "speed": [], "memory": [], "growth": {}}
    print(machine_text(result["machine"]), f"commit {result['commit']}", sep="\n")
    rounds = 3 if arguments.quick else 5
    for case in arguments.cases:
        for cores in arguments.cores:
            found = _run(cores, measure="speed", case=case, rounds=rounds)
            result["speed"].append(found)
            print(_speed_table(found), flush=True)
    print(_summary_table(result["speed"]), flush=True)
    for contender in (LOOP, NORMAL, FULL):
        result["memory"].append(_run(max(arguments.cores), measure="memory", case="lrm", contender=contender))
    print(_memory_table(result["memory"]), flush=True)
    result["rate"] = _run(1, measure="rate")
    print(_rate_line(result["rate"]), flush=True)
    if arguments.sdynpy:
        result["sdynpy"] = _run(1, measure="sdynpy", python=arguments.sdynpy, rounds=rounds)
        print(_speed_table(result["sdynpy"]), flush=True)
    result["start"] = _run(max(arguments.cores), measure="start")
    print(_start_table(result["start"]), flush=True)
    for name, sizes in _growth_sizes(arguments.quick).items():
        result["growth"][name] = _run(max(arguments.cores), measure="growth", sizes=sizes)
        print(_growth_table(name, result["growth"][name]), flush=True)
    result["machine"]["load_after"] = os.getloadavg()
    print(f"load average at the end: {load_text(result['machine']['load_after'])}")
    if arguments.json:
        from jaxfrf.io._json import write_json

        write_json(arguments.json, result)


def _arguments():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="the headline case only, in less than a minute")
    parser.add_argument("--cases", nargs="+", choices=CASES, help="default: all")
    parser.add_argument("--cores", nargs="+", type=int, help="default: 1 and 2, as far as there are so many")
    parser.add_argument("--json", type=pathlib.Path, help="also write the results to this file")
    parser.add_argument(
        "--sdynpy", metavar="PYTHON", help="interpreter of an environment with SDynPy, to be measured too"
    )
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    available = len(available_cores())
    arguments.cases = arguments.cases or (["lrm"] if arguments.quick else list(CASES))
    arguments.cores = arguments.cores or [n for n in (1, 2) if n <= available]
    if max(arguments.cores) > available or min(arguments.cores) < 1:
        parser.error(f"--cores: from 1 to {available}, which this process may use")
    return arguments


# Measuring processes -------------------------------------------------------------------------------------------------


def _run(cores: int, **request) -> dict:
    """What a fresh process on `cores` cores measures."""
    # One thread of BLAS: what small matrices gain by more is less than they cost.
    return run_pinned(__file__, available_cores()[:cores], 1, TIME_LIMIT, request)


def _measure_speed(case: str, rounds: int) -> dict:
    n_windows, contenders = contenders_of(case)
    began = time.perf_counter()
    contenders[FULL]()
    first = time.perf_counter() - began
    base = next(iter(contenders))
    reference = contenders[base]()
    results = {name: difference(f(), reference) for name, f in contenders.items()}
    turns = [{name: _time(f) for name, f in contenders.items()} for _ in range(rounds)]
    rows = [_summary(name, base, turns, n_windows) | {"difference": results[name]} for name in contenders]
    compile_time = first - statistics.median(turn[FULL][0] for turn in turns)
    return {"case": case, "windows": n_windows, "baseline": base, "compile_s": compile_time, "contenders": rows}


def _summary(name: str, base: str, turns, n_windows: int) -> dict:
    wall = statistics.median(turn[name][0] for turn in turns)
    ratios = [turn[base][0] / turn[name][0] for turn in turns]
    cpu = statistics.median(turn[base][1] / turn[name][1] for turn in turns)
    return {
        "name": name,
        "ms": wall * 1e3,
        "us_per_window": wall / n_windows * 1e6,
        "windows_per_s": n_windows / wall,
        "ratio": statistics.median(ratios),
        "ratio_min": min(ratios),
        "ratio_max": max(ratios),
        "ratio_of_cpu_time": cpu,
    }


def _time(f) -> tuple[float, float]:
    """Wall and processor time of one call, the mean over the calls that fit into `LEAST` seconds."""
    began, began_cpu, calls = time.perf_counter(), time.process_time(), 0
    while calls == 0 or time.perf_counter() - began < LEAST:
        f()
        calls += 1
    return (time.perf_counter() - began) / calls, (time.process_time() - began_cpu) / calls


def _measure_memory(case: str, contender: str) -> dict:
    n_windows, contenders = contenders_of(case)
    before = _peak_mb()
    contenders[contender]()
    return {"name": contender, "windows": n_windows, "before_mb": before, "peak_mb": _peak_mb()}


def _measure_growth(sizes) -> dict:
    """Sizes (positions, experiments, lines, axes), smallest first: the peak of a process only rises."""
    rows = []
    for size in sizes:
        n_pos, n_exp, n_lines, n_axes = size
        spectra = spectra_of(n_pos, n_exp, n_lines, n_axes)
        width = WIDTH if n_axes == 6 else None
        rows.append(_grown(spectra, size, width, stacked=True))
        if n_axes == 6 and n_exp > 1:
            rows.append(_grown(one_by_one(spectra), size, width, stacked=False))
    return {"sizes": rows}


def _grown(spectra, size, width, stacked: bool) -> dict:
    import jaxfrf as jf

    method = jf.LRM(order=ORDER, width=width)
    began = time.perf_counter()
    jf.estimate(spectra, method)
    first = time.perf_counter() - began
    wall = statistics.median(_time(lambda: jf.estimate(spectra, method))[0] for _ in range(3))
    n_windows = spectra.n_pos * len(spectra.lines)
    return {
        **dict(zip(("positions", "experiments", "lines", "axes"), size, strict=True)),
        "stacked": stacked,
        "windows": n_windows,
        "ms": wall * 1e3,
        "us_per_window": wall / n_windows * 1e6,
        "compile_s": first - wall,
        "peak_mb": _peak_mb(),
    }


def _measure_rate() -> dict:
    """What LRM's windows need at least, beside what NumPy's complex matrix product does on the same core."""
    spectra = one_by_one(spectra_of(1, N_EXP))
    import numpy as np

    import jaxfrf as jf

    X = np.ones((600, 600), complex)
    product = 8 * 600**3 / min(_time(lambda: X @ X)[1] for _ in range(3)) / 1e9
    method = jf.LRM(order=ORDER, width=WIDTH)
    jf.estimate(spectra, method)
    n_windows, n = spectra.n_pos * len(spectra.lines), (ORDER + 1) * spectra.n_in + ORDER * spectra.n_out
    pairs = (spectra.n_in + spectra.n_out) * (spectra.n_in + spectra.n_out + 1) // 2
    moments = 2 * WIDTH * (2 * ORDER + 1) * 2 * pairs
    solved = 4 * n**3 / 3 + 4 * n**2 * (spectra.n_out + spectra.n_in) + 8 * n * spectra.n_out**2
    seconds = min(_time(lambda: jf.estimate(spectra, method))[1] for _ in range(3))
    return {"product_gflops": product, "estimate_gflops": n_windows * (moments + solved) / seconds / 1e9}


def _measure_sdynpy(python: str, rounds: int) -> dict:
    """SDynPy's LRM of one experiment after the other, beside the NumPy loop and the public call, in turns."""
    import tempfile

    import numpy as np

    n_windows, contenders = contenders_of("lrm")
    contenders[FULL]()
    with tempfile.TemporaryDirectory() as folder:
        spectra = spectra_of(1, N_EXP)
        np.savez(f"{folder}/spectra.npz", U=spectra.U[0, :2], Y=spectra.Y[0, :2], width=WIDTH, order=ORDER)
        command = [python, str(ROOT / "benchmarks/_sdynpy.py"), f"{folder}/spectra.npz"]

        def theirs():
            environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
            found = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
            return float(found.stdout.split()[-1]) * N_EXP / 2  # two of the experiments are measured

        turns = []
        for _ in range(rounds):
            turn = {name: _time(contenders[name]) for name in (LOOP, FULL)}
            wall = theirs()
            turns.append(turn | {SDYNPY: (wall, wall)})
    rows = [_summary(name, LOOP, turns, n_windows) | {"difference": float("nan")} for name in (LOOP, SDYNPY, FULL)]
    return {"case": "lrm", "windows": n_windows, "baseline": LOOP, "compile_s": 0.0, "contenders": rows}


def _measure_start() -> dict:
    """Seconds of whole processes: the best of three."""
    import tempfile

    run = [sys.executable, "-m", "jaxfrf"]
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder, "JAX_ENABLE_COMPILATION_CACHE": "1"}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)

        def seconds(command):
            began = time.perf_counter()
            subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, check=True)
            return time.perf_counter() - began

        seconds([*run, "example", "-o", "record.npz"])
        estimate = [*run, "estimate", "record.npz", "-o", "frf.npz"]
        return {
            "import jaxfrf": min(seconds([sys.executable, "-c", "import jaxfrf"]) for _ in range(3)),
            "an empty Python": min(seconds([sys.executable, "-c", ""]) for _ in range(3)),
            "jaxfrf --help": min(seconds([*run, "--help"]) for _ in range(3)),
            "jaxfrf estimate, auto, nothing compiled before": seconds(estimate),
            "the same again": min(seconds(estimate) for _ in range(3)),
        }


def _peak_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1024 if sys.platform != "darwin" else peak / 1024**2


_WORKERS = {
    "speed": _measure_speed,
    "memory": _measure_memory,
    "growth": _measure_growth,
    "rate": _measure_rate,
    "sdynpy": _measure_sdynpy,
    "start": _measure_start,
}


# Data and contenders -------------------------------------------------------------------------------------------------


def spectra_of(n_pos: int, n_exp: int, n_lines: int = 336, n_axes: int = 6):
    from jaxfrf._environment import prepare

    prepare()
    import _plants
    import numpy as np

    rng = np.random.default_rng(SEED)
    plants = [_plants.random_axes(n_axes, rng) for _ in range(n_pos)]
    lines = _plants.paper_lines() if n_lines == 336 else np.arange(n_lines) + 112
    return _plants.experiment(plants, n_exp, DISTURBANCE, rng, lines)[0]


def one_by_one(spectra):
    """Every experiment as an operating point of its own."""
    return dataclasses.replace(
        spectra, **{name: getattr(spectra, name).reshape(-1, 1, *spectra.U.shape[2:]) for name in ("U", "Y", "R")}
    )


def method_of(case: str):
    """The method of one of `CASES`."""
    import jaxfrf as jf

    local = {"order": ORDER, "width": WIDTH}
    if case == "auto":
        return jf.Auto()
    classical = {"h1": jf.H1, "jio-h1": jf.JointInputOutput, "log": jf.LogMean}
    if case in classical:
        return classical[case]()
    rational = jf.LRM(**local)
    kinds = {"lpm": jf.LPM(**local), "miso": jf.MisoLRM(**local), "lrm": rational, "jio": jf.JointInputOutput(rational)}
    method = kinds[_kind(case)]
    return jf.LogMean(method) if case.startswith("log-") else method


def _kind(case: str) -> str:
    """The local method in one of `CASES`."""
    return {"stacked": "lrm", "stacked-jio": "jio"}.get(case, case.removeprefix("log-"))


def contenders_of(case: str):
    """How many windows there are, and functions by name that return G (pos, freq, out, in), the baseline first."""
    spectra = spectra_of(1, N_EXP)
    import _baselines as baselines

    import jaxfrf as jf

    U, Y, R = spectra.U, spectra.Y, spectra.R
    method = method_of(case)

    def public(spectra, method):
        return lambda: jf.estimate(spectra, method).G

    n_lines = len(spectra.lines)
    if case == "h1":
        return n_lines, {BATCHED: lambda: baselines.classical(U, Y), FULL: public(spectra, method)}
    if case == "jio-h1":
        return n_lines, {
            BATCHED: lambda: baselines.classical(U, Y, R),
            RATIO: lambda: baselines.two_responses(U, Y, R),
            FULL: public(spectra, method),
        }
    if case == "log":
        return n_lines, {LOOP: lambda: baselines.log_loop(U, Y), FULL: public(spectra, method)}
    if case == "auto":
        stacked = jf.JointInputOutput(jf.LRM())
        return n_lines, {STACKED: public(spectra, stacked), FULL: public(spectra, method)}

    each, kind = spectra if case.startswith("stacked") else one_by_one(spectra), _kind(case)
    X, targets = (each.R, (each.Y, each.U)) if kind == "jio" else (each.U, (each.Y,))
    problem = baselines.Problem(X, targets, WIDTH, ORDER, rational=kind != "lpm", shared=kind != "miso")
    if case.startswith("log-"):
        found = public(spectra, method)
        return problem.n_windows, {LOOP: lambda: baselines.log_means(baselines.loop(problem))[None], FULL: found}
    return problem.n_windows, {
        LOOP: lambda: baselines.loop(problem),
        SCIPY: lambda: baselines.scipy_loop(problem),
        QR: lambda: baselines.batched_qr(problem),
        NORMAL: lambda: baselines.batched_normal(problem),
        FULL: public(each, method),
    }


def difference(G, reference) -> float:
    """Largest relative difference of a window's response."""
    import numpy as np

    return float(np.max(np.linalg.norm(G - reference, axis=(2, 3)) / np.linalg.norm(reference, axis=(2, 3))))


def _growth_sizes(quick: bool) -> dict:
    experiments = (1, 12) if quick else (1, 3, 6, 12, 24)
    positions = (1, 4) if quick else (1, 4, 16, 49)
    lines = (336, 3360) if quick else (336, 1000, 3360, 20000)
    axes = (2, 12) if quick else (2, 6, 12, 40)
    return {
        "experiments": [(1, n, 336, 6) for n in experiments],
        "positions": [(n, N_EXP, 336, 6) for n in positions],
        "lines": [(1, 1, n, 6) for n in lines],
        "axes (as many experiments, windows of 24 lines)": [(1, n, 336, n) for n in axes],
    }


# Printing ------------------------------------------------------------------------------------------------------------


def _speed_table(found: dict) -> str:
    cores = f"{found['cores']} core{'s' if found['cores'] > 1 else ''}"
    lines = [
        f"\n{CASES[found['case']]}: {found['windows']} windows, {cores}; compiled in {found['compile_s']:.1f} s",
        f"  {'':28}{'ms':>9}{'us/window':>11}{'times the first (min-max)':>27}{'processor':>11}{'difference':>12}",
    ]
    for row in found["contenders"]:
        ratio = f"{row['ratio']:.2f} ({row['ratio_min']:.2f}-{row['ratio_max']:.2f})"
        lines.append(
            f"  {row['name']:28}{row['ms']:9.1f}{row['us_per_window']:11.1f}{ratio:>27}"
            f"{row['ratio_of_cpu_time']:11.2f}{row['difference']:12.0e}"
        )
    return "\n".join(lines)


def _summary_table(found) -> str:
    """The public call of every method beside its baseline."""
    lines = [f"\n{FULL}, times its baseline: median (min-max), in processor time", ""]
    for case in found:
        row = next(row for row in case["contenders"] if row["name"] == FULL)
        ratio = f"{row['ratio']:.2f} ({row['ratio_min']:.2f}-{row['ratio_max']:.2f})"
        lines.append(
            f"  {CASES[case['case']]:36}{case['baseline']:28}{case['cores']} core{'s' if case['cores'] > 1 else ' '}"
            f"{row['ms']:9.1f} ms{ratio:>22}{row['ratio_of_cpu_time']:8.2f}"
        )
    return "\n".join(lines)


def _memory_table(rows) -> str:
    lines = [f"\nPeak memory, {rows[0]['windows']} windows of LRM, MB"]
    lines += [
        f"  {row['name']:28}{row['peak_mb']:8.0f}, of which {row['before_mb']:.0f} before the estimate" for row in rows
    ]
    return "\n".join(lines)


def _rate_line(found) -> str:
    share = found["estimate_gflops"] / found["product_gflops"]
    return (
        f"\nArithmetic that LRM's windows need: {found['estimate_gflops']:.1f} Gflop/s, {share:.0%} of NumPy's complex "
        f"matrix product ({found['product_gflops']:.0f} Gflop/s, one core, processor time)"
    )


def _start_table(found) -> str:
    lines = [f"\nWhole processes, {found['cores']} core(s), wall time, s"]
    return "\n".join(lines + [f"  {name:48}{value:7.2f}" for name, value in found.items() if name != "cores"])


def _growth_table(name: str, found: dict) -> str:
    lines = [
        f"\nGrowth with {name}, LRM, {found['cores']} core(s) (the peak is that of the process so far)",
        f"  {'axes':>4}{'positions':>11}{'experiments':>13}{'':12}{'windows':>9}{'ms':>9}{'us/window':>11}"
        f"{'compile s':>11}{'peak MB':>9}",
    ]
    for row in found["sizes"]:
        kind = "stacked" if row["stacked"] else "one by one"
        lines.append(
            f"  {row['axes']:4}{row['positions']:11}{row['experiments']:13}{kind:>12}{row['windows']:9}{row['ms']:9.1f}"
            f"{row['us_per_window']:11.1f}{row['compile_s']:11.1f}{row['peak_mb']:9.0f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
