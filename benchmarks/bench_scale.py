"""Large data sets and many small ones: memory, time and processor time of `simulate` and `estimate`.

    python benchmarks/bench_scale.py                         # 0.2 GB: a minute or two
    python benchmarks/bench_scale.py --gigabytes 10 --folder /data --workers 1 2    # half an hour of two idle cores
    python benchmarks/bench_scale.py --data scale-10.nc --workers 1 2 --pin    # one worker on one core, two on two
    python benchmarks/bench_scale.py --files 500             # one --each call beside each file's work alone

Every step is a command of its own, as a user gives it; its peak of resident memory and its times are what the system
says of that process (of the largest of all, where there are workers). Data that are there already are not made again.
The clock compares numbers of workers only where nobody else works: the machine's load is told with every step.
"""

import argparse
import contextlib
import io
import json
import os
import pathlib
import platform
import resource
import subprocess
import sys
import tempfile
import time

from _pinned import available_cores, commit, pin_to

BENCHMARKS = pathlib.Path(__file__).parent
ROBOT = BENCHMARKS.parent / "jaxfrf" / "robot" / "r3x.toml"
RUN = 56000 * 18 * 8  # bytes of a run of the paper's design: r, u and y of six axes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=0.2, help="of the data set (default .2)")
    parser.add_argument("--folder", type=pathlib.Path, help="for the data (default: a temporary one)")
    parser.add_argument("--data", nargs="+", type=pathlib.Path, help="files to take instead of simulating any")
    parser.add_argument("--method", default="auto")
    parser.add_argument("--memory", default="2GB")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--pin", action="store_true", help="every number of workers on as many cores, one as well")
    parser.add_argument("--files", type=int, help="so many small files and one --each call instead")
    parser.add_argument("--alone", nargs="+", help=argparse.SUPPRESS)
    parser.add_argument("--results", type=pathlib.Path, help="file to append the table to")
    given = parser.parse_args()
    if given.alone:
        print(json.dumps(alone([pathlib.Path(name) for name in given.alone], given.method)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or pathlib.Path(temporary)
        lines = many(given, folder) if given.files else measured(given, folder)
    text = "\n".join([heading(given), *lines, ""])
    print(text)
    if given.results:
        with given.results.open("a", encoding="utf-8") as file:
            file.write(text + "\n")


def measured(given, folder: pathlib.Path) -> list[str]:
    data, lines = given.data, []
    if data is None:
        path = folder / f"scale-{given.gigabytes:g}.nc"
        blocks = 4 if given.gigabytes >= 1 else 1
        positions = max(2, round(given.gigabytes * 1e9 / (6 * blocks * RUN)))
        if not path.exists():
            design = folder / "design.toml"
            text = (BENCHMARKS / "paper_design.toml").read_text()
            design.write_text(text.replace("blocks = 4", f"blocks = {blocks}"))
            made = run("simulate", ROBOT, design, "--positions", positions, "--memory", given.memory, "-o", path)
            lines.append(row(f"simulate {positions} x {6 * blocks} runs of 28 s", made))
        data = [path]
    size = sum(path.stat().st_size for path in data)
    lines.append(f"data: {size / 1e9:.2f} GB")
    first = None
    for workers in given.workers:
        output = folder / f"frf-{workers}.nc"
        options = ("--method", given.method, "--memory", given.memory, "-o", output)
        shared = ("--workers", workers) if workers > 1 else ()
        made = run("estimate", *data, *options, *shared, cores=workers if given.pin else None)
        where = f" on {workers} core(s)" if given.pin else ""
        lines.append(row(f"estimate ({given.method}), {workers} worker(s){where}", made))
        if first is None:
            first = made, output
        else:
            same = "equal bit for bit" if equal(first[1], output) else "NOT EQUAL"
            lines.append(
                f"  {first[0]['wall'] / made['wall']:.2f} times as fast, {made['cpu'] / first[0]['cpu']:.2f} times the "
                f"processor time, {same}"
            )
    return lines


def many(given, folder: pathlib.Path) -> list[str]:
    """One call for many small files, beside what each of them takes in a process that has compiled all there is."""
    from jaxfrf import _environment

    _environment.prepare()
    from jaxfrf.examples import example
    from jaxfrf.io import write

    runs = folder / "runs"
    runs.mkdir(exist_ok=True)
    paths = [runs / f"{seed:04d}.nc" for seed in range(given.files)]
    for seed, path in enumerate(paths):
        if not path.exists():
            write(path, example(blocks=1, seed=seed))
    each = run("estimate", runs / "*.nc", "--each", "--method", given.method, "-o", folder / "each")
    words = (__file__, "--method", given.method, "--alone", *paths)
    by_itself = json.loads(subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True).stdout)
    ratio = {kind: each[kind] / by_itself[kind] for kind in ("wall", "cpu")}
    return [
        row(f"estimate --each of {given.files} files", each),
        row("their work alone, after compilation", by_itself),
        f"  {ratio['wall']:.2f} times by the clock, {ratio['cpu']:.2f} times the processor time",
    ]


def alone(paths: list[pathlib.Path], method: str) -> dict[str, float]:
    """Times of the command for every file by itself, with what --each writes beside it, the first one made before."""
    from jaxfrf.__main__ import main as command

    def made(path: pathlib.Path, folder: str) -> None:
        target = pathlib.Path(folder) / path.stem
        words = ["estimate", path, "--method", method, "-o", f"{target}.nc"]
        words += ["--plot", f"{target}.png", "--report", f"{target}.html"]
        with contextlib.redirect_stdout(io.StringIO()):
            if command([*map(str, words)]):
                raise SystemExit(f"{path} failed")

    with tempfile.TemporaryDirectory() as folder:
        made(paths[0], folder)
        load, began, spent = os.getloadavg()[0], time.monotonic(), time.process_time()
        for path in paths:
            made(path, folder)
        times = {"wall": time.monotonic() - began, "cpu": time.process_time() - spent}
    return times | {"peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9, "load": load}


def run(*words, cores: int | None = None) -> dict[str, float]:
    """A command in a process of its own: seconds, seconds of processor time, the peak of resident memory, GB, and how
    many programs the machine had to run before it. `cores`: that it and its workers may use, all by default."""
    mine = available_cores()[:cores]
    load, began = os.getloadavg()[0], time.monotonic()
    with tempfile.TemporaryFile() as said:
        command = [sys.executable, "-m", "jaxfrf", *map(str, words)]
        process = subprocess.Popen(command, stdout=said, stderr=said, preexec_fn=lambda: pin_to(mine))
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise SystemExit(said.read().decode()[-2000:])
    return {
        "wall": time.monotonic() - began,
        "cpu": used.ru_utime + used.ru_stime,
        "peak": used.ru_maxrss * 1024 / 1e9,
        "load": load,
    }


def row(what: str, made: dict[str, float]) -> str:
    times = f"{made['wall']:8.1f} s {made['cpu']:8.1f} s of processor"
    return f"{what:40} {times} {made['peak']:6.2f} GB at most, load {made['load']:.1f} before"


def equal(one: pathlib.Path, two: pathlib.Path) -> bool:
    """Whether two FRF files hold the same numbers, position by position."""
    import h5py

    with h5py.File(one) as a, h5py.File(two) as b:
        names = [name for name in a if isinstance(a[name], h5py.Dataset) and a[name].shape]
        return set(a) == set(b) and all(
            a[name].shape == b[name].shape and a[name][i].tobytes() == b[name][i].tobytes()
            for name in names
            for i in range(len(a[name]))
        )


def heading(given) -> str:
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{time.strftime('%Y-%m-%d')}, commit {commit()}, {platform.machine()}, {os.cpu_count()} cores{load}"


if __name__ == "__main__":
    main()
