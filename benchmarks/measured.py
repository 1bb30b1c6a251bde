"""Writes the tables of notebooks/measured.md from the results that are kept in `results/`.

    python benchmarks/measured.py [--check]

A table stands in the page between `<!-- table: NAME -->` and `<!-- end of table -->`, NAME being one of `TABLES`; the
text around it is written by hand. `--check` writes nothing and ends with 1 where the page is not what the results say.
"""

import argparse
import json
import pathlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

HERE = pathlib.Path(__file__).parent
PAGE = HERE.parent / "notebooks" / "measured.md"
LINK = "../benchmarks/results/"
KINDS = {
    "stiffness": "stiffness",
    "damping": "damping",
    "coulomb_friction": "Coulomb friction",
    "viscous_friction": "viscous friction",
    "payload": "payload (the last link's mass)",
    "motor_inertia": "rotors",
    "stiffness_ratio": "spring ratio",
    "stiffness_knee": "spring knee",
}
CALIBRATED = {
    "r3x 6": "R3X",
    "r3x 6 torque_constant=0": "R3X, torque constants known",
    "r3x 1 torque_constant=0": "the same, 1 experiment",
    "small 6": "small",
    "light 6 torque_constant=0": "light, torque constants known",
    "pallet 6 torque_constant=0": "palletiser, the same",
}
HIDDEN_ROBOTS = {"small": "small arm", "pallet": "palletiser", "r3x": "R3X"}
HIDDEN: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "one effect, clear (twice the just visible size or more, beyond what a number's tolerance believes): effect "
        "and joint named",
        ("single_clear", "effect_and_joint"),
    ),
    ("... class and joint", ("single_clear", "class_and_joint")),
    ("one effect of any size: effect and joint", ("single", "effect_and_joint")),
    ("two effects: both named", ("double", "both")),
    ("nothing hidden: false alarms", ("false_alarm",)),
    ("... called *unexplained*", ("false_unexplained",)),
    ("... a number said to be off by more than its tolerance", ("false_numbers",)),
    ("outside the library: *unexplained* or *ambiguous*", ("outside_honest",)),
    ("named: an axis is missed by a tenth more on held-out positions", ("grows",)),
    ("named: *sufficient* with the robot that was written", ("again",)),
    ("95 % intervals of main parameters that hold", ("parameter_error", "covered")),
)


def results(name: str) -> str:
    return (HERE / "results" / name).read_text(encoding="utf-8")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    line = lambda cells: f"| {' | '.join(cells)} |"
    return "\n".join([line(head), line(["---"] * len(head)), *map(line, rows)])


def calibration() -> str:
    """Mean and largest error of each kind of number, the newest run of every robot (it stands first)."""
    row = re.compile(r"(\w+ \d(?: torque_constant=0)?) +(\w+) +([\d.]+) \(([\d.]+)-([\d.]+)\) +([\d.]+)")
    held = re.compile(r"(\w+ \d(?: torque_constant=0)?) +95 %.*?: (\d+ of \d+) hold")
    missed = re.compile(r"(\w+ \d(?: torque_constant=0)?) +torque missed ([\d.]+) %")
    found: dict[tuple[str, str], str] = {}
    newest, _, _ = results("calibration.txt").partition("# all that follows")
    for line in newest.splitlines():
        if this := row.match(line):
            found.setdefault((this[1], this[2]), f"{this[3]} ({this[6]})")
        elif this := held.match(line):
            found.setdefault((this[1], "held"), this[2])
        elif this := missed.match(line):
            found.setdefault((this[1], "missed"), this[2])
    rows = {**KINDS, "held": '95 % intervals of what "the data tell" that hold', "missed": "torque missed after it"}
    cells = [[text, *(found.get((run, kind), "") for run in CALIBRATED)] for kind, text in rows.items()]
    return table(["mean (largest) error, %", *CALIBRATED.values()], cells)


def hidden() -> str:
    """What the diagnosis found: in all cases, MuJoCo's, each robot's, and those that nobody had seen."""
    found = json.loads(results("gap.json"))
    groups = {"all": found["all"], "MuJoCo's": found["simulator"]["mujoco"]}
    groups |= {text: found["robot"][name] for name, text in HIDDEN_ROBOTS.items()}
    groups["unseen"] = json.loads(results("gap_unseen.json"))["all"]
    rows = [[text, *(_share(_inside(group, path)) for group in groups.values())] for text, path in HIDDEN]
    return table(["with 95 % intervals", *(f"{name}, {group['cases']} cases" for name, group in groups.items())], rows)


def _share(its: Mapping[str, Any]) -> str:
    return f"{its['k']} of {its['n']} ({100 * its['low']:.0f}-{100 * its['high']:.0f} %)" if its["n"] else ""


def _inside(found: Any, path: Sequence[str]) -> Any:
    for key in path:
        found = found[key]
    return found


def speed(cores: int = 1, file: str = "local.txt") -> str:
    """`jaxfrf.estimate` with covariance against the contender that its table begins with."""
    case = re.compile(rf"(.+): (\d+) windows, ({cores}) cores?; compiled in ([\d.]+) s")
    row = re.compile(r" +(.+?) +([\d.]+) +([\d.]+) +([\d.]+) \(([\d.]+)-([\d.]+)\) +([\d.]+) +\S+$")
    found: dict[str, list[str]] = {}
    commit, now, first = "", None, ""
    for line in results(file).splitlines():
        if line.lower().startswith("commit "):
            commit = line.split()[1]
        elif this := case.match(line):
            now, first = this, ""
        elif now is not None and (this := row.match(line)):
            if not first:
                first = f"{this[1]}: {_three(this[2])}"
            elif this[1].startswith("jaxfrf.estimate"):
                times = f"{float(this[4]):.2g} ({float(this[5]):.2g}-{float(this[6]):.2g})"
                ours = _three(this[2])
                origin = f"[{commit}]({LINK}{file})"
                found[now[1]] = [first, ours, times, f"{float(this[7]):.2g}", now[4], origin]
        elif not line.strip():
            now = None
    head = [
        "method",
        "baseline, ms",
        "jaxfrf, ms",
        "times, by the clock",
        "by processor time",
        "compiled in, s",
        "commit",
    ]
    return table(head, [[name, *cells] for name, cells in found.items()])


def growth() -> str:
    """How LRM grows with axes and lines, the machine's rate, and whole processes."""
    text = results("local.txt")
    origin = (_origin("local.txt", text),)
    row = re.compile(r"^ +(\d+) +1 +\d+ +stacked +(\d+) +([\d.]+) +[\d.]+ +\S+ +(\d+)$", flags=re.MULTILINE)
    of = lambda title: row.findall(text.partition(f"Growth with {title}")[2].partition("\n\n")[0])
    joined = lambda cells: " / ".join(cells)
    axes, lines = of("axes"), of("lines")
    rate, whole = _found(r"windows need: ([\d.]+) Gflop/s, \d+% .*\((\d+) Gflop/s", text)
    seconds = lambda name: _found(rf"^  {name} +([\d.]+)$", text)[0]
    begun = [seconds(name) for name in ("import jaxfrf", "jaxfrf --help", "an empty Python")]
    made = [seconds(name) for name in ("jaxfrf estimate, auto, nothing compiled before", "the same again")]
    rows = [
        (
            f"stacked LRM, as many experiments as axes, 336 lines: {joined([x[0] for x in axes])} axes",
            f"{joined([_three(x[2]) for x in axes])} ms",
        ),
        (
            f"LRM, 6 axes, one experiment: {joined([x[1] for x in lines])} lines",
            f"{joined([_three(x[2]) for x in lines])} ms, {lines[0][3]}-{lines[-1][3]} MB",
        ),
        ("arithmetic that LRM's windows need, beside NumPy's complex matrix product", f"{rate} of {whole} Gflop/s"),
        (
            "`import jaxfrf` / `jaxfrf --help` (an empty Python), whole processes",
            f"{begun[0]} / {begun[1]} ({begun[2]}) s",
        ),
        ("`jaxfrf estimate` on the example record, nothing compiled before / again", f"{made[0]} / {made[1]} s"),
    ]
    return table(["what", "one core", "commit"], [(*cells, *origin) for cells in rows])


def _three(text: str) -> str:
    """A number to three digits, without an exponent."""
    return f"{float(f'{float(text):.3g}'):g}"


def coverage() -> str:
    """Share of 95 % regions that hold: all lines / at resonances, first run of every plant."""
    plants: dict[str, dict[str, str]] = {}
    now: dict[str, str] | None = None
    title = re.compile(r"(.+?),.* n_e = (\d+), (\d+) seeds$")
    for line in results("coverage.txt").splitlines():
        if this := title.match(line):
            name = f"{this[1]}, {this[2]}"
            now = plants.setdefault(name, {}) if name not in plants else None
        elif (cells := line.split()) and now is not None and len(cells) == 7 and line.startswith("  "):
            now[cells[0]] = f"{float(cells[1]):.2f} / {float(cells[2]):.2f}".replace("0.", ".")
        elif not cells:
            now = None
    methods = dict.fromkeys(m for found in plants.values() for m in found)
    return table(["method", *plants], [[f"`{m}`", *(found.get(m, "") for found in plants.values())] for m in methods])


def faults() -> str:
    """The last lines of the table of faults."""
    lines = results("faults.txt").splitlines()
    of = re.compile(r"nothing said though|nothing said, FRF|clean records with|^\d+ faults:")
    pairs = [
        line.rsplit(": ", 1) if "faults:" not in line else line.split(": ", 1) for line in lines if of.search(line)
    ]
    return table(["records with something wrong", lines[0].split("; ")[0]], pairs)


def large() -> str:
    """The first runs of the largest data set: of one process with all cores, and of a core for every worker."""
    text = results("scale.txt").partition("\n\nbefore")[0]
    when, size = text.splitlines()[1:3]
    rows = []
    for line in text.splitlines():
        if line.startswith("estimate"):
            name, *told = re.split(r" {2,}", line)
            rows.append([name, ", ".join(told)])
        elif "times as fast" in line:
            rows.append(["two workers", line.strip()])
    return table([f"{size.split(',')[0].removeprefix('data: ')}, {when.split(', ')[1]}", "time"], rows)


def kept() -> str:
    """What a fit and a simulation take, by processor time."""
    fit, simulation = results("fit.txt"), results("simulation.txt")
    whole = _found(r"jaxfrf\.fit\(starts=20\) +[\d.]+ +([\d.]+) +\d+ +(\d+)/20 +(\d+) times / (\d+) times", fit)
    one = fit.partition("One start")[2]
    times = [_found(rf"^ *{name}, differences .*\s([\d.]+) \([\d.-]+\)$", one)[0] for name in ("BFGS", "least_squares")]
    steps = max(float(x) for x in re.findall(r"([\d.]+) times as fast per core", simulation))
    runs, of, minutes = _found(r"(\d+) of (\d+) runs.*or ([\d.]+) min with 1", simulation)
    of_fit, of_simulation = (
        (_origin(name, text),) for name, text in (("fit.txt", fit), ("simulation.txt", simulation))
    )
    model = "7 positions, 336 lines, 36 elements, 22 parameters"
    rivals = "SciPy's BFGS / `least_squares` with differences on vectorised NumPy"
    rows = [
        (f"gray-box fit, {model}: twenty starts", f"{whole[0]} s ({whole[1]} of 20 at the best cost)", *of_fit),
        (f"the same, a start: against {rivals}", f"{whole[2]} / {whole[3]} times", *of_fit),
        ("one descent on all lines against the same", f"{' / '.join(times)} times", *of_fit),
        (
            "simulated R3X, against MuJoCo's steps alone (RK4, .25 ms, its fastest as exact)",
            f"{steps:g} times",
            *of_simulation,
        ),
        (f"the paper's {of} experiments of 28 s, from a run of {runs} of them", f"{minutes} min", *of_simulation),
    ]
    return table(["what", "processor time, one core", "commit"], rows)


def _found(pattern: str, text: str) -> tuple[str, ...]:
    found = re.search(pattern, text, flags=re.MULTILINE)
    if found is None:
        raise SystemExit(f"results: nothing like {pattern}.")
    return found.groups()


def _origin(name: str, text: str) -> str:
    (commit,) = _found(r"^commit (\w+)", text)
    return f"[{commit}]({LINK}{name})"


TABLES: dict[str, Callable[[], str]] = {
    "kept": kept,
    "speed": speed,
    "two_cores": lambda: speed(2),
    "jax12": lambda: speed(1, "local_jax12.txt"),
    "jax12_two_cores": lambda: speed(2, "local_jax12.txt"),
    "xeon": lambda: speed(1, "local_xeon.txt"),
    "xeon_two_cores": lambda: speed(2, "local_xeon.txt"),
    "growth": growth,
    "coverage": coverage,
    "calibration": calibration,
    "hidden": hidden,
    "faults": faults,
    "large": large,
}


def filled(page: str) -> str:
    """The page with its tables made anew."""
    return re.sub(r"<!-- table: (\w+) -->\n.*?<!-- end of table -->", _block, page, flags=re.DOTALL)


def _block(found: re.Match[str]) -> str:
    name = found[1]
    if name not in TABLES:
        raise SystemExit(f"measured.md: no table {name!r}; those there are: {', '.join(TABLES)}.")
    return f"<!-- table: {name} -->\n\n{TABLES[name]()}\n\n<!-- end of table -->"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; 1 where the page is another")
    check = parser.parse_args().check
    page = PAGE.read_text(encoding="utf-8")
    made = filled(page)
    if check and made != page:
        print("measured.md does not say what benchmarks/results holds: run `python benchmarks/measured.py`.")
        return 1
    if not check:
        PAGE.write_text(made, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
