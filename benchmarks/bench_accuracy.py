"""What the estimators are worth: errors against the true FRF of simulated closed loops, and coverage.

    python benchmarks/bench_accuracy.py [--quick] [--only methods auto] [--seeds 20] [--json FILE]

Linear plants of motors, springs and coupled arms under velocity control, on the 336 lines of the paper, one plant,
excitation and disturbance per seed (see `_plants.py`). The error of an estimate is the median over lines and elements
of |G_hat - G| / |G|, its tail the 90 % quantile over the diagonal, where resonances and antiresonances show (elements
off it come close to zero). Tables give the median over seeds and, in brackets, the least and the largest. Coverage is
the share of elements whose 95 % region holds the truth. Seeds 0.. report; choices were made on seeds 100-109.
"""

import argparse
import dataclasses
import os
import pathlib
import time

import numpy as np
import scipy.stats

import jaxfrf as jf
from jaxfrf._environment import prepare
from jaxfrf.io._json import write_json

TUNING_SEEDS = range(100, 110)
MEASURES = ("error", "tail")
CHUNK = 5  # seeds estimated at once: dense covariances of 6 x 6 responses are large


@dataclasses.dataclass(frozen=True)
class Case:
    """A kind of plant, how many experiments, and how large a disturbance."""

    n: int
    n_exp: int
    disturbance: float
    damping: float = 0.03

    def __str__(self) -> str:
        axes, experiments = _count(self.n, "axis", "axes"), _count(self.n_exp, "experiment", "experiments")
        return f"{axes}, damping {self.damping:g}, {experiments}, {100 * self.disturbance:g} % disturbance"

    def data(self, seed: int):
        import _plants

        rng = np.random.default_rng([seed, self.n])
        return _plants.experiment([_plants.random_axes(self.n, rng, self.damping)], self.n_exp, self.disturbance, rng)


PAPER = tuple(Case(6, n_exp, level) for level in (0.02, 0.1) for n_exp in (6, 1))
TUNING = (
    *PAPER,
    Case(6, 6, 0.02, 0.01),
    *(Case(2, n_exp, level, 0.02) for level in (0.002, 0.1) for n_exp in (2, 1)),
    *(Case(1, n_exp, level, 0.01) for level in (0.002, 0.02, 0.1) for n_exp in (3, 1)),
)


def main() -> None:
    prepare()
    arguments = _arguments()
    seeds = range(4 if arguments.quick else arguments.seeds)
    tuning_seeds = TUNING_SEEDS[:3] if arguments.quick else TUNING_SEEDS
    result = {"seeds": list(seeds), "tuning_seeds": list(tuning_seeds)}
    began = time.perf_counter()
    print(f"load average: {' '.join(f'{x:.1f}' for x in os.getloadavg())}")
    if "methods" in arguments.only:
        result["methods"] = [_compare(case, seeds) for case in (PAPER[:1] if arguments.quick else PAPER)]
    if "auto" in arguments.only:
        result["auto"] = _sweep(TUNING[5::3] if arguments.quick else TUNING, tuning_seeds)
    print(f"\n{time.perf_counter() - began:.0f} s")
    if arguments.json:
        write_json(arguments.json, result)


def _arguments():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="few seeds and cases")
    parser.add_argument("--only", nargs="+", choices=("methods", "auto"), default=("methods", "auto"))
    parser.add_argument("--seeds", type=int, default=20, help="how many seeds the comparison of methods takes")
    parser.add_argument("--json", type=pathlib.Path, help="also write the results to this file")
    return parser.parse_args()


# The methods against each other --------------------------------------------------------------------------------------


def _methods(n_exp: int) -> "dict[str, jf.AbstractMethod]":
    """The paper's methods with its window of 36 lines, and this package's with several."""
    lrm = jf.LRM(width=36)
    found = {} if n_exp == 1 else {"h1": jf.H1(), "log": jf.LogMean(), "jio": jf.JointInputOutput(jf.H1())}
    found |= {
        "lpm, w = 36": jf.LogMean(jf.LPM(width=36)),
        "lrm-miso, w = 36": jf.LogMean(jf.MisoLRM(width=36)),
        "lrm-mimo, w = 36": jf.LogMean(lrm),
        "lrm-jio, w = 36": jf.LogMean(jf.JointInputOutput(lrm)),
        "lrm-stacked, w = 36": lrm,
    }
    for width in (36, 50, 69, 97, 140) if n_exp == 1 else (8, 12, 24, 36, 50, 69, 97):
        found[f"lrm-jio-stacked, w = {width}"] = jf.JointInputOutput(jf.LRM(width=width))
    found["lrm-jio-stacked, default width"] = jf.JointInputOutput(jf.LRM())
    for width in (36, 69):
        found[f"lrm-jio-common, w = {width}"] = jf.JointInputOutput(jf.CommonDenominatorLRM(width=width))
    return found | {"auto": jf.Auto()}


def _compare(case: Case, seeds) -> dict:
    print(f"\n{case}, {len(seeds)} seeds\n  {'':34}{'error':>24}{'diagonal':>10}{'tail':>9}{'coverage':>10}")
    rows = []
    for name, method in _methods(case.n_exp).items():
        found = _evaluate(case, method, seeds)
        rows.append({"name": name} | found)
        print(
            f"  {name:34}{_spread(found['error']):>24}{np.median(found['diagonal']):10.4f}"
            f"{np.median(found['tail']):9.4f}{np.median(found['coverage']):10.3f}",
            flush=True,
        )
    return {"case": dataclasses.asdict(case), "rows": rows}


def _evaluate(case: Case, method, seeds) -> dict[str, list[float]]:
    """Error, that of the diagonal and its tail, and coverage, for every seed."""
    scores = []
    for chunk in (list(seeds)[i : i + CHUNK] for i in range(0, len(seeds), CHUNK)):
        spectra, G = _joined([case.data(seed) for seed in chunk])
        scores += [_score(frf, truth) for frf, truth in zip(_each(jf.estimate(spectra, method)), G, strict=True)]
    return {name: [score[name] for score in scores] for name in scores[0]}


def _joined(parts):
    """Seeds as operating points of one data set."""
    first = parts[0][0]
    join = lambda name: np.concatenate([getattr(spectra, name) for spectra, _ in parts])
    return dataclasses.replace(first, U=join("U"), Y=join("Y"), R=join("R")), np.concatenate([G for _, G in parts])


def _each(frf: "jf.FRF"):
    return zip(frf.G, frf.std**2, frf.dof, strict=True)


def _score(estimate, truth) -> dict[str, float]:
    G, variance, dof = estimate
    error = np.abs(G - truth)
    relative = error / np.abs(truth)
    diagonal = np.diagonal(relative, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        region = scipy.stats.f.ppf(0.95, 2, 2 * dof)[:, None, None] * variance
    known = np.isfinite(region)
    return {
        "error": float(np.median(relative)),
        "diagonal": float(np.median(diagonal)),
        "tail": float(np.quantile(diagonal, 0.9)),
        "coverage": float(np.mean(error[known] ** 2 <= region[known])) if known.any() else float("nan"),
    }


# The window that chooses itself --------------------------------------------------------------------------------------


def _sweep(cases, seeds) -> list[dict]:
    """How far `Auto` is from the best fixed window of each case, by local variable."""
    print(f"\nError over that of the best fixed window (seeds {seeds[0]}-{seeds[-1]}, median over seeds)")
    rows = []
    for case in cases:
        for variable in ("index", "frequency"):
            rows.append(_sweep_case(case, variable, seeds))
            _print_sweep(case, rows[-1])
    for variable in ("index", "frequency"):
        _print_summary(variable, [row for row in rows if row["variable"] == variable])
    _print_variables(rows)
    return rows


def _sweep_case(case: Case, variable: str, seeds) -> dict:
    """Median over seeds of the error and the tail: by fixed width, of the default width, of Auto."""
    widths = jf.Auto().candidates(case.data(seeds[0])[0])
    lrm = jf.LRM(variable=variable)
    found = {
        "fixed": {w: jf.JointInputOutput(dataclasses.replace(lrm, width=w)) for w in widths},
        "default": {None: jf.JointInputOutput(lrm)},
        "auto": {None: jf.Auto(lrm)},
    }
    row = {"case": dataclasses.asdict(case), "variable": variable}
    for kind, methods in found.items():
        scores = {option: _evaluate(case, method, seeds) for option, method in methods.items()}
        for measure in MEASURES:
            row[f"{kind} {measure}"] = {option: float(np.median(score[measure])) for option, score in scores.items()}
    return row


def _print_sweep(case: Case, row: dict) -> None:
    print(f"\n{case}; {row['variable']}")
    for measure in MEASURES:
        fixed = row[f"fixed {measure}"]
        best = min(fixed, key=fixed.get)
        print(f"  {measure}: best {fixed[best]:.4f} at w = {best}")
        for kind in ("fixed", "default", "auto"):
            ratios = row[f"{kind} {measure}"].items()
            print(
                f"    {kind:8}" + " ".join(f"{'' if o is None else f'{o:g}:'}{e / fixed[best]:.2f}" for o, e in ratios)
            )
    print(end="", flush=True)


def _print_summary(variable: str, rows) -> None:
    print(f"\n{variable}, all cases: median (and worst) ratio to the best fixed window")
    print(f"  {'':15}" + "".join(f"{measure:>16}" for measure in MEASURES))
    print(f"  {'auto':15}" + "".join(_ratio(rows, f"auto {m}", None, m) for m in MEASURES))
    print(f"  {'default width':15}" + "".join(_ratio(rows, f"default {m}", None, m) for m in MEASURES))


def _ratio(rows, kind: str, option, measure: str) -> str:
    ratios = [row[kind][option] / min(row[f"fixed {measure}"].values()) for row in rows]
    text = f"{np.median(ratios):.2f} ({np.max(ratios):.2f})"
    return f"{text:>16}"


def _print_variables(rows) -> None:
    """Error with the frequency as local variable over that with the index, best fixed window and Auto."""
    print("\nfrequency over index, all cases: median (least-largest)")
    for measure in MEASURES:
        pairs = list(zip(rows[::2], rows[1::2], strict=True))
        name = f"fixed {measure}"
        best = [min(f[name].values()) / min(i[name].values()) for i, f in pairs]
        auto = [f[f"auto {measure}"][None] / i[f"auto {measure}"][None] for i, f in pairs]
        print(f"  {measure:8} best fixed window {_spread(best)}   auto {_spread(auto)}")


def _spread(values) -> str:
    return f"{np.median(values):.4f} ({np.min(values):.4f}-{np.max(values):.4f})"


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


if __name__ == "__main__":
    main()
