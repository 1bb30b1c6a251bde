"""Parameters of R3X from seven positions, on records of this project's simulator and of MuJoCo.

    python benchmarks/bench_parameters.py -o parameters.json [--seeds 0 1 2 3 4] [--experiments 6 1] [--simulator both]

Mean relative error of all 16 stiffnesses and dampings (Zimmermann & Moberg's mean parameter bias), of the direct fit
and of the indirect fit, with friction, nonlinear springs, noise and ripple on; noise and ripple are
unknown to the fit. MuJoCo has its own integrator (RK4, .25 ms) and its own friction law (`_mujoco_records.py`).
Positions, start values and settings are those of `jaxfrf study --scale paper`; medians and ranges over the seeds. An
interrupted run is continued: every finished entry is kept in the output file. A seed takes some minutes.
"""

import argparse
import json
import os
import pathlib
import time

os.environ.setdefault("NPROC", "64")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import numpy as np
from _mujoco_records import mujoco_experiment

from jaxfrf.io._json import write_json
from jaxfrf.robot import r3x
from jaxfrf.study.bias import first_experiments
from jaxfrf.study.parameters import candidates, fit_positions, indirect_row, records
from jaxfrf.study.settings import PAPER, design, truth


def record(simulator: str, seed: int):
    """Six experiments at the seven positions."""
    if simulator == "jaxfrf":
        return records(PAPER, truth(), 1, seed)
    q = candidates(PAPER)[list(fit_positions(PAPER))]
    return mujoco_experiment(r3x(), design(1, seed), q, seed=seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(PAPER.seeds))
    parser.add_argument("--experiments", type=int, nargs="+", default=[6, 1])
    parser.add_argument("--simulator", choices=["jaxfrf", "mujoco", "both"], default="both")
    options = parser.parse_args()
    found = json.loads(options.output.read_text()) if options.output.exists() else {}
    for seed in options.seeds:
        for simulator in ["jaxfrf", "mujoco"] if options.simulator == "both" else [options.simulator]:
            wanted = [n for n in options.experiments if f"{simulator} {n} {seed}" not in found]
            if not wanted:
                continue
            began = time.monotonic()
            data = record(simulator, seed)
            print(f"{simulator}, seed {seed}: record made in {time.monotonic() - began:.0f} s", flush=True)
            for count in wanted:
                began = time.monotonic()
                entry = indirect_row(PAPER, seed, count, first_experiments(data, count))
                found[f"{simulator} {count} {seed}"] = entry | {"seconds": time.monotonic() - began}
                write_json(options.output, found)
                print(
                    f"  n_e = {count}: direct {100 * entry['direct']['mean_bias']:.2f} %, indirect "
                    f"{100 * entry['mean_bias']:.2f} % ({100 * entry['stiffness_bias']:.3f} % in the stiffnesses), "
                    f"{len(entry['gap_db'])} rounds, {time.monotonic() - began:.0f} s",
                    flush=True,
                )
    report(found)


def report(found: dict) -> None:
    """Medians and ranges over the seeds."""
    print(f"\n{'':34}{'mean bias, %':>24}{'stiffness, %':>24}{'damping, %':>24}")
    for simulator in ("jaxfrf", "mujoco"):
        for count in (6, 1):
            rows = [v for k, v in found.items() if k.startswith(f"{simulator} {count} ")]
            for label, these in (("direct", [r["direct"] for r in rows]), ("indirect", rows)):
                if not these:
                    continue
                cells = [_spread([100 * r[name] for r in these]) for name in _NAMES]
                print(f"{simulator:8}n_e = {count}  {label:23}" + "".join(f"{c:>24}" for c in cells))


_NAMES = ("mean_bias", "stiffness_bias", "damping_bias")


def _spread(values) -> str:
    return f"{np.median(values):.2f} ({min(values):.2f}-{max(values):.2f})"


if __name__ == "__main__":
    main()
