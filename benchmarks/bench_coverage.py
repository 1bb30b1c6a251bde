"""Whether the intervals hold: the share of 95 % regions that contain the true FRF, for every method.

    python benchmarks/bench_coverage.py [--tuning] [--methods auto jio] [--seeds 8] [--disturbance-at input]

Three simulated closed loops (one axis with three flexible modes, two coupled axes, six coupled axes), 1, 6 and 24
experiments, on plants, lines and seeds on which nothing was chosen; `--tuning` shows those on which it was. Counted are
elements and lines with a finite region, all of them and those *at resonances*: within two relative dampings of a
maximum or minimum of a diagonal element of the true G. Welch's method takes a record of the same length, loop and
disturbance, excited at every line between, and is counted there. `error`: median of |G_hat - G| / |G|. `width`: median
radius of the regions over the median distance to the truth (2.1 for circular Gaussian errors, many degrees of freedom).
"""

import argparse
import dataclasses
import os
import pathlib
import time

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import _plants
import numpy as np
from _pinned import commit

import jaxfrf as jf
from jaxfrf._environment import prepare
from jaxfrf.frf.catalogue import METHODS
from jaxfrf.plot.bode import confidence_radius

EXPERIMENTS = (1, 6, 24)
BAND = (112, 2241)  # lines of a record, 4 to 80 Hz
CHUNK = 4  # seeds estimated at once: dense covariances of 6 x 6 responses are large


@dataclasses.dataclass(frozen=True)
class Chain:
    """One motor with several appendages, each a mass on a spring: torque in, motor speed out, a velocity controller."""

    motor: float
    mass: np.ndarray
    hertz: np.ndarray
    damping: float
    gain: float
    n: int = 1

    def response(self, frequency) -> np.ndarray:
        s = 2j * np.pi * np.asarray(frequency)[:, None]
        omega = 2 * np.pi * self.hertz
        spring = self.mass * (omega**2 / s + 2 * self.damping * omega)
        seen = np.sum(self.mass * s * spring / (self.mass * s + spring), axis=1)
        return (1 / (self.motor * s[:, 0] + 0.5 * self.motor + seen))[:, None, None]

    def controller(self, frequency) -> np.ndarray:
        s = 2j * np.pi * np.asarray(frequency)[:, None, None]
        return self.gain * (1 + 10.0 / s)


@dataclasses.dataclass(frozen=True)
class Case:
    """A kind of plant with its damping, disturbance, lines and the number that its random numbers start from."""

    name: str
    n: int
    damping: float
    disturbance: float
    lines: str
    start: int
    seeds: int  # that are averaged by default: fewer where there are more elements

    def plant(self, rng):
        if self.n > 1 or "mode" not in self.name:
            return _plants.random_axes(self.n, rng, self.damping)
        hertz = np.sort(rng.uniform([8, 20, 38], [16, 32, 60]))
        mass = rng.uniform(0.2, 0.8, 3)
        return Chain(1.0, mass, hertz, self.damping, 2 * np.pi * 2.0 * (1 + mass.sum()))

    def data(self, seed: int, n_exp: int, at: str):
        rng = np.random.default_rng([self.start, seed])
        plant = self.plant(rng)
        lines = _plants.paper_lines() if self.lines == "log" else np.arange(113, 2240, 6)
        spectra, G = _plants.experiment([plant], n_exp, self.disturbance, rng, lines, at)
        return spectra, G, at_resonances(plant, spectra.frequency, self.damping)

    def record(self, seed: int, n_exp: int, at: str):
        """A record without a period, steady, and its plant."""
        rng = np.random.default_rng([self.start, seed])
        plant = self.plant(rng)
        spectra, _ = _plants.experiment([plant], n_exp, self.disturbance, rng, np.arange(*BAND), at)
        return _plants.record(spectra), plant


CASES = (
    Case("one axis, three modes", 1, 0.01, 0.03, "linear", 7001, 6),
    Case("two axes", 2, 0.02, 0.03, "linear", 7002, 4),
    Case("six axes", 6, 0.03, 0.03, "log", 7003, 2),
)
TUNING = (
    Case("one axis", 1, 0.02, 0.01, "log", 8001, 8),
    Case("two axes, softly damped", 2, 0.01, 0.1, "log", 8002, 8),
    Case("four axes", 4, 0.04, 0.02, "linear", 8003, 4),
)


def at_resonances(plant, frequency, damping: float) -> np.ndarray:
    """(freq, out, in): lines within two relative dampings of an extremum of |G_ii|, for row and column i."""
    grid = np.geomspace(frequency[0] / 1.1, frequency[-1] * 1.1, 20001)
    size = np.abs(np.diagonal(plant.response(grid), axis1=1, axis2=2))
    slope = np.sign(np.diff(np.log(size), axis=0))
    near = np.zeros((len(frequency), plant.n, plant.n), bool)
    for i in range(plant.n):
        extrema = grid[1:-1][slope[1:, i] != slope[:-1, i]]
        if extrema.size:
            close = np.min(np.abs(frequency[:, None] / extrema - 1), axis=1) <= 2 * damping
            near[close, i, :] = near[close, :, i] = True
    return near


def methods(n_exp: int, n: int) -> dict:
    """Every method of the command line that can be used, with its defaults."""
    whole = {"h1", "h2", "hv", "arithmetic", "log", "jio"}
    return {
        k: m
        for k, (_, m) in METHODS.items()
        if (k not in whole or n_exp > n) and (not k.startswith("robust") or n_exp >= 3 * n)
    }


def of_periods(case: Case, n_exp: int, method, seeds, at: str):
    """The FRF of spectra of periods, the true one, and what is at resonances."""
    parts = [case.data(seed, n_exp, at) for seed in seeds]
    join = lambda name: np.concatenate([getattr(p[0], name) for p in parts])
    spectra = dataclasses.replace(parts[0][0], U=join("U"), Y=join("Y"), R=join("R"))
    frf = jf.estimate(spectra, method)
    return (
        np.asarray(frf.G),
        confidence_radius(frf),
        np.concatenate([p[1] for p in parts]),
        np.stack([p[2] for p in parts]),
    )


def of_records(case: Case, n_exp: int, method, seeds, at: str):
    """The same of records without a period, inside the band that is excited."""
    found = []
    for data, plant in (case.record(seed, n_exp, at) for seed in seeds):
        frf = jf.estimate(data, method)
        low, high = (line * _plants.FS / _plants.PERIOD for line in BAND)
        inside = (frf.frequency > low) & (frf.frequency < high)
        frequency = frf.frequency[inside]
        near = at_resonances(plant, frequency, case.damping)
        found.append((frf.G[0, inside], confidence_radius(frf)[0, inside], plant.response(frequency), near))
    return tuple(np.stack(x) for x in zip(*found, strict=True))


def evaluate(case: Case, n_exp: int, method, seeds, at: str) -> dict[str, float]:
    found = []
    for chunk in (list(seeds)[i : i + CHUNK] for i in range(0, len(seeds), CHUNK)):
        make = of_records if isinstance(method, jf.Welch) else of_periods
        G, radius, truth, near = make(case, n_exp, method, chunk, at)
        found.append([x.ravel() for x in (np.abs(G - truth), radius, near, np.abs(truth))])
    error, radius, near, size = (np.concatenate(x) for x in zip(*found, strict=True))
    known = np.isfinite(radius)
    inside = error <= radius
    return {
        "all": float(inside[known].mean()) if known.any() else np.nan,
        "at resonances": float(inside[known & near].mean()) if (known & near).any() else np.nan,
        "error": float(np.median(error / size)),
        "error at resonances": float(np.median((error / size)[near])),
        "width": float(np.median(radius[known]) / np.median(error[known])) if known.any() else np.nan,
    }


def main() -> None:
    prepare()
    arguments = _arguments()
    began, text = time.perf_counter(), [__doc__.partition("\n")[0]]
    _say(text, f"jaxfrf {jf.__version__}, commit {commit()}")
    cases = [case for case in (TUNING if arguments.tuning else CASES) if arguments.case in case.name]
    for case in cases:
        for n_exp in arguments.experiments:
            disturbance = f"disturbance {100 * case.disturbance:g} % at the {arguments.at}"
            head = f"{case.name}, damping {case.damping:g}, {disturbance}, n_e = {n_exp}"
            seeds = arguments.seeds or case.seeds
            _say(text, f"\n{head}, {seeds} seeds")
            _say(text, f"  {'':20}{'all':>8}{'at resonances':>15}{'error':>9}{'at res.':>9}{'width':>7}{'s':>7}")
            for name, method in methods(n_exp, case.n).items():
                if not arguments.methods or name in arguments.methods:
                    _say(text, _row(case, n_exp, name, method, range(seeds), arguments.at))
    _say(text, f"\n{time.perf_counter() - began:.0f} s")
    if arguments.write:
        temporary = arguments.write.with_name(arguments.write.name + ".part")
        temporary.write_text("\n".join(text) + "\n")
        temporary.replace(arguments.write)


def _row(case: Case, n_exp: int, name: str, method, seeds, at: str) -> str:
    start = time.perf_counter()
    try:
        x = evaluate(case, n_exp, method, seeds, at)
    except jf.InputError as error:
        return f"  {name:20}  cannot: {str(error).splitlines()[0][:60]}"
    return (
        f"  {name:20}{x['all']:8.3f}{x['at resonances']:15.3f}{x['error']:9.4f}{x['error at resonances']:9.4f}"
        f"{x['width']:7.2f}{time.perf_counter() - start:7.1f}"
    )


def _say(text: list[str], line: str) -> None:
    text.append(line)
    print(line, flush=True)


def _arguments():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tuning", action="store_true", help="the plants and seeds on which choices were made")
    parser.add_argument("--methods", nargs="+", choices=tuple(METHODS), help="only these")
    parser.add_argument("--case", default="", help="only plants whose name holds this, e.g. 'six axes'")
    parser.add_argument("--experiments", nargs="+", type=int, default=EXPERIMENTS)
    where = "white noise of the output, or of a torque beside the input"
    parser.add_argument("--disturbance-at", dest="at", choices=("output", "input"), default="output", help=where)
    parser.add_argument("--seeds", type=int, help="by default 6, 4 and 2 of one, two and six axes")
    parser.add_argument("--write", type=pathlib.Path, help="also write the table to this file")
    return parser.parse_args()


if __name__ == "__main__":
    main()
