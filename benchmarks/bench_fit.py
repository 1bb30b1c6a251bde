"""The gray-box fit of R3X: jaxfrf against what a user of NumPy and SciPy has.

    python benchmarks/bench_fit.py [--quick] [--starts-baseline 2] [--limit 120] [--cores 1 2] [--json FILE]

7 D-optimal positions out of 49, the 336 lines of `paper_design.toml`, 36 elements, 22 parameters (8 stiffnesses, 8
dampings, 6 effective frictions), linear springs, the model's own FRF with 5 % noise, weights `jaxfrf.Weights()`.

The baseline is a good one: M, D and K of every position are known as affine functions of the parameters, the cost
takes all positions and lines at once, and the faster of batched solves and an eigendecomposition a position counts.
It holds the point of rest of the true robot, which jaxfrf finds anew at every step; without gravity both costs are the
same to rounding, and that is checked. BFGS and least squares take differences, from the same starts, in the same
coordinates (logarithms), each in turn with jaxfrf. Every measurement runs in a process of its own, pinned to its cores;
processor time stands beside wall time, which other load on the machine hardly touches; compilation is told apart.
"""

import argparse
import dataclasses
import json
import os
import pathlib
import statistics
import sys
import time

from _pinned import ROOT, available_cores, load_text, machine, machine_text, run_pinned

SEED_POSITIONS, SEED_NOISE, SEED_STARTS = 0, 1, 2
CANDIDATES, CHOSEN, NOISE = 49, 7, 0.05
TIME_LIMIT = 3000  # s, of a measuring process
LEAST = 0.2  # s, that a cost runs in one turn
CLOSE = 1.01  # times the best cost

SOLVES, MODES = "NumPy cost, 14 x 14 solves", "NumPy cost, eigenvalues"
DIFFERENCES = "NumPy cost and 22 differences"
OURS_COST, OURS_GRAM = "jaxfrf cost", "jaxfrf cost, gradient, J^T W J"
OURS, QUASI, SQUARES = "jaxfrf, one descent, all lines", "BFGS, differences", "least_squares, differences"


def main() -> None:
    arguments = _arguments()
    if arguments.worker:
        from jaxfrf._environment import prepare

        prepare()
        request = json.loads(arguments.worker)
        print(json.dumps(_WORKERS[request.pop("measure")](**request)))
        return
    seeds = {"positions": SEED_POSITIONS, "noise": SEED_NOISE, "starts": SEED_STARTS}
    result = {"machine": machine(), "seeds": seeds, "costs": [], "fits": []}
    print(machine_text(result["machine"]), flush=True)
    for cores in arguments.cores:
        result["costs"].append(_run(cores, measure="costs", rounds=3 if arguments.quick else 7))
        print(_cost_table(result["costs"][-1]), flush=True)
    cores = min(arguments.cores)
    result["starts"] = _run(cores, measure="starts", count=arguments.starts_baseline, limit=arguments.limit)
    print(_start_table(result["starts"]), flush=True)
    for cores in arguments.cores:
        result["fits"].append(_run(cores, measure="fits", starts=arguments.starts, every=not arguments.quick))
        print(_fit_table(result["fits"][-1], result["starts"]), flush=True)
    result["machine"]["load_after"] = os.getloadavg()
    print(f"\nload average at the end: {load_text(result['machine']['load_after'])}")
    if arguments.json:
        from jaxfrf.io._json import write_json

        write_json(arguments.json, result)


def _arguments():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one core, one baseline start of 60 s, the default fit")
    parser.add_argument("--starts", type=int, default=20, help="of the whole fit")
    parser.add_argument("--starts-baseline", type=int, help="that BFGS and least_squares run too; default: 2")
    parser.add_argument("--limit", type=float, help="processor time of a baseline's start, s; default: 120")
    parser.add_argument("--cores", nargs="+", type=int, help="default: 1 and 2, as far as there are so many")
    parser.add_argument("--json", type=pathlib.Path, help="also write the results to this file")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    available = len(available_cores())
    arguments.starts_baseline = arguments.starts_baseline or (1 if arguments.quick else 2)
    arguments.limit = arguments.limit or (60.0 if arguments.quick else 120.0)
    arguments.cores = arguments.cores or [n for n in ((1,) if arguments.quick else (1, 2)) if n <= available]
    if max(arguments.cores) > available or min(arguments.cores) < 1:
        parser.error(f"--cores: from 1 to {available}, which this process may use")
    return arguments


# Measuring processes -------------------------------------------------------------------------------------------------


def _run(cores: int, **request) -> dict:
    """What a fresh process on `cores` cores measures."""
    return run_pinned(__file__, available_cores()[-cores:], cores, TIME_LIMIT, request)


def _time(f, least: float = 0.0) -> tuple[float, float]:
    """Wall and processor time of one call, the mean over the calls that fit into `least` seconds."""
    began, began_cpu, calls = time.perf_counter(), time.process_time(), 0
    while calls == 0 or time.perf_counter() - began < least:
        f()
        calls += 1
    return (time.perf_counter() - began) / calls, (time.process_time() - began_cpu) / calls


def _measure_costs(rounds: int) -> dict:
    import jax
    import jax.numpy as jnp

    p = Problem()
    compiled = _time(p.gram)[0] - _time(p.gram)[0]
    x = p.true_x + 0.01
    contenders = {
        SOLVES: lambda: p.baseline.cost(x, p.baseline.by_solves),
        MODES: lambda: p.baseline.cost(x, p.baseline.by_modes),
        OURS_COST: lambda: jax.block_until_ready(p.cost(jnp.asarray(x))),
        OURS_GRAM: lambda: jax.block_until_ready(p.gram(jnp.asarray(x))),
    }
    p.cost(jnp.asarray(x))
    checked = _checked(p)
    turns = [{name: _time(f, LEAST) for name, f in contenders.items()} for _ in range(rounds)]
    for turn in turns:
        fastest = min(turn[SOLVES], turn[MODES], key=lambda t: t[1])
        turn[DIFFERENCES] = tuple(23 * t for t in fastest)
    rows = {}
    for name in (SOLVES, MODES, DIFFERENCES, OURS_COST, OURS_GRAM):
        ratios = [turn[name][1] / turn[OURS_GRAM][1] for turn in turns]
        rows[name] = _row([turn[name] for turn in turns]) | {"over_ours": _spread(ratios)}
    return {"rows": rows, "compile_s": compiled, "positions": p.chosen, "lines": len(p.frequency), **checked}


def _checked(p) -> dict:
    """Relative difference of the costs: without gravity anywhere, with gravity at the truth; and away from it."""
    import numpy as np

    light = Problem(gravity=False)
    draws = np.random.default_rng(5).normal(size=(3, len(p.true_x))) * p.spreads
    anywhere = max(_difference(light, light.true_x + d, kind) for d in draws for kind in ("by_solves", "by_modes"))
    truth = max(_difference(p, p.true_x, kind) for kind in ("by_solves", "by_modes"))
    assert anywhere < 1e-8 and truth < 1e-8, f"the costs differ by {anywhere:.1e} and {truth:.1e}"
    away = max(_difference(p, p.true_x + d, "by_modes") for d in draws)
    return {"difference": anywhere, "difference_at_truth": truth, "difference_of_rest": away}


def _difference(p, x, kind: str) -> float:
    ours = float(p.gram(x)[-1, -1])
    return abs(p.baseline.cost(x, getattr(p.baseline, kind)) / ours - 1)


def _measure_starts(count: int, limit: float) -> dict:
    """Every contender from the same starts, in turns; the ratios are taken start by start."""
    import numpy as np

    p = Problem()
    compiled = _time(lambda: p.descend(p.true_x))[0]
    draws = np.random.default_rng(SEED_STARTS).normal(size=(count, len(p.true_x)))
    response = p.baseline.faster(p.true_x)
    best = p.descend(p.true_x)
    turns = []
    for x in p.true_x + p.spreads * draws:
        turn = {OURS: p.descend, SQUARES: lambda x: p.baseline.least_squares(x, response, limit)}
        turn[QUASI] = lambda x: p.baseline.bfgs(x, response, limit)
        turns.append({name: _one_start(f, x, best) for name, f in turn.items()})
        print(_turn_line(len(turns), turns[-1]), file=sys.stderr, flush=True)
    return {
        "starts": turns,
        "compile_s": compiled,
        "best": best["cost"],
        "limit_s": limit,
        "response": response.__name__,
    }


def _one_start(f, x, best) -> dict:
    import numpy as np

    wall, cpu, ended = time.perf_counter(), time.process_time(), f(x)
    spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    off = float(np.abs(np.asarray(ended.pop("x")) - best["x"]).max())
    return spent | ended | {"reached": ended["cost"] <= CLOSE * best["cost"], "largest_ln_error": off}


def _measure_fits(starts: int, every: bool) -> dict:
    import jaxfrf as jf

    p = Problem()
    first = _time(lambda: jf.fit(p.model, p.frf, starts=starts))[0]  # of as many starts: of one it is another program
    rows = []
    for keep in (5, None) if every else (5,):
        wall, cpu = time.perf_counter(), time.process_time()
        found = jf.fit(p.model, p.frf, starts=starts, keep=keep)
        rows.append({"keep": keep, "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu})
        steps = [len(s.path_cost) - 1 for s in found.starts]
        rows[-1] |= {"close": found.close_starts, "starts": starts, "cost": found.cost, "steps": steps}
    return {"rows": rows, "compile_s": first - rows[0]["wall_s"]}


_WORKERS = {"costs": _measure_costs, "starts": _measure_starts, "fits": _measure_fits}


def _row(times) -> dict:
    return {"wall_s": _spread([t[0] for t in times]), "cpu_s": _spread([t[1] for t in times])}


def _spread(values) -> list[float]:
    """Median, least, largest."""
    return [statistics.median(values), min(values), max(values)]


# The problem ---------------------------------------------------------------------------------------------------------


class Problem:
    """The fit, for jaxfrf and for the baseline."""

    def __init__(self, gravity: bool = True):
        import jax.numpy as jnp
        import jax.random as jr
        import numpy as np

        import jaxfrf as jf
        from jaxfrf.graybox.cost import Cost
        from jaxfrf.graybox.target import target
        from jaxfrf.io.designs import read_design

        robot = _linear_robot(gravity)
        design = read_design(ROOT / "benchmarks" / "paper_design.toml")
        self.frequency = np.asarray(design.frequency)
        # In continuous time, as the baseline: the hold would have to be written there too.
        self.model = jf.RobotModel(robot, hold=None)
        self.coordinates = jf.graybox.Coordinates(self.model.parameters)
        self.true_x, self.spreads = self.coordinates.start(), self.coordinates.spreads()
        q = jf.random_positions(CANDIDATES, jr.key(SEED_POSITIONS))
        information = jf.graybox.position_information(self.model, self.frequency, q)
        self.chosen = list(jf.graybox.d_optimal(information, CHOSEN))
        self.frf = _noisy_frf(self.model, self.coordinates.values(self.true_x), self.frequency, q[self.chosen])
        self.target = target(self.frf, jf.Weights(), q[self.chosen])
        self.cost = Cost(self.model, self.coordinates, self.target)
        self.baseline = Baseline(robot, self)
        self._jnp = jnp

    def gram(self, x=None):
        return self.cost.gram(self._jnp.asarray(self.true_x if x is None else x))

    def descend(self, x) -> dict:
        """Levenberg-Marquardt on all lines."""
        import numpy as np

        from jaxfrf.graybox import LevenbergMarquardt
        from jaxfrf.graybox.solver import descend

        end = descend(self.cost, self._jnp.asarray(x), LevenbergMarquardt())
        steps = int(end.steps)
        return {
            "x": np.asarray(end.x),
            "cost": float(end.cost),
            "evaluations": steps + 1,
            "ended": "by itself" if bool(end.converged) else "steps",
        }


def _linear_robot(gravity: bool):
    import numpy as np

    from jaxfrf import robot as jrobot

    robot = jrobot.r3x()
    robot = jrobot.with_parameters(robot, dict.fromkeys(jrobot.parameters(robot, ("stiffness_ratio",)), 1.0))
    return robot if gravity else dataclasses.replace(robot, chain=dataclasses.replace(robot.chain, gravity=np.zeros(3)))


def _noisy_frf(model, values, frequency, q):
    """The model's own FRF with 5 % complex noise on every element, and its covariance."""
    import jax.numpy as jnp
    import numpy as np

    import jaxfrf as jf

    G = np.stack([np.asarray(model.response(jnp.asarray(frequency), values, jnp.asarray(at))) for at in q])
    rng = np.random.default_rng(SEED_NOISE)
    cov = (NOISE * np.abs(G.swapaxes(-1, -2).reshape(*G.shape[:2], -1))) ** 2
    G = G * (1 + NOISE / np.sqrt(2) * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)))
    return jf.FRF(
        G=G,
        frequency=frequency,
        cov=cov[..., None] * np.eye(cov.shape[-1], dtype=complex),
        dof=np.full(G.shape[:2], 30.0),
        status=np.zeros(G.shape[:2], int),
        window=np.ones(G.shape[:2]),
        q=q,
        y_quantity=model.quantity,
    )


# What a user of NumPy and SciPy writes -------------------------------------------------------------------------------


class Baseline:
    """The cost in NumPy. x: ln of stiffnesses (8), dampings (8), effective frictions (6), in the order of the model."""

    def __init__(self, robot, problem):
        import numpy as np

        from jaxfrf import robot as jrobot
        from jaxfrf.robot.jacobian import parameter_names

        at = np.asarray(problem.target.points)
        names = problem.coordinates.names
        self.order = [names.index(n) for n in parameter_names(robot)]
        true = np.exp(np.asarray(problem.true_x)[self.order])
        stiffness, damping, friction = np.split(true, [8, 16])
        linear = jrobot.linearise(robot, jrobot.operating_point(robot, at), friction)
        self.mass, self.motor = np.asarray(linear.mass), np.asarray(linear.motor)
        self.springs = np.asarray(jrobot.spring_directions(robot))
        self.base_K = np.asarray(linear.stiffness) - (self.springs * stiffness) @ self.springs.T
        self.base_D = np.asarray(linear.damping) - self._damping(damping, friction)
        self.inverse_mass = np.linalg.inv(self.mass)
        self.s = 2j * np.pi * problem.frequency
        self.s2M = self.s[:, None, None] ** 2 * self.mass[:, None]
        self.measured = np.exp(np.asarray(problem.target.log_G))
        self.root = np.asarray(problem.target.magnitude)

    def _damping(self, damping, friction):
        return (self.springs * damping) @ self.springs.T + (self.motor * friction) @ self.motor.T

    def _matrices(self, x):
        import numpy as np

        stiffness, damping, friction = np.split(np.exp(np.asarray(x)[self.order]), [8, 16])
        K = self.base_K + (self.springs * stiffness) @ self.springs.T
        return K, self.base_D + self._damping(damping, friction)

    def by_solves(self, x):
        """Acceleration per torque, (pos, freq, vec), from a solve at every position and line."""
        import numpy as np

        K, D = self._matrices(x)
        dynamic = self.s2M + self.s[:, None, None] * D[:, None] + K[:, None]
        X = np.linalg.solve(
            dynamic, np.broadcast_to(self.motor.astype(complex), (*dynamic.shape[:2], *self.motor.shape))
        )
        G = self.s[:, None, None] ** 2 * (self.motor.T @ X)
        return G.swapaxes(-1, -2).reshape(*G.shape[:2], -1)

    def by_modes(self, x):
        """The same from the 28 poles of every position: G = s^2 sum_k c_k b_k / (s - p_k)."""
        import numpy as np

        K, D = self._matrices(x)
        n = len(self.motor)
        A = np.zeros((len(K), 2 * n, 2 * n))
        A[:, :n, n:] = np.eye(n)
        A[:, n:, :n], A[:, n:, n:] = -self.inverse_mass @ K, -self.inverse_mass @ D
        B = np.concatenate([np.zeros((len(K), n, 6)), self.inverse_mass @ self.motor], axis=1)
        poles, V = np.linalg.eig(A)
        inputs, outputs = np.linalg.solve(V, B), self.motor.T @ V[:, :n]
        residues = inputs[:, :, :, None] * outputs.swapaxes(1, 2)[:, :, None]  # (pos, mode, in, out)
        fractions = self.s[:, None] ** 2 / (self.s[:, None] - poles[:, None])
        return fractions @ residues.reshape(*poles.shape, -1)

    def faster(self, x):
        """The cheaper of the two ways, by processor time."""
        return min((self.by_solves, self.by_modes), key=lambda f: min(_time(lambda: f(x))[1] for _ in range(5)))

    def error(self, x, response):
        """Magnitude and phase errors of all elements, weighted."""
        import numpy as np

        ratio = self.measured / response(x)
        return self.root * np.log(np.abs(ratio)), self.root * np.angle(ratio)

    def cost(self, x, response) -> float:
        import numpy as np

        size, phase = (part.ravel() for part in self.error(np.asarray(x), response))
        return float(size @ size + phase @ phase)

    def bfgs(self, x, response, limit: float) -> dict:
        """SciPy's BFGS with forward differences, of the cost over the number of its terms."""
        from scipy.optimize import minimize

        count = 2 * self.root.size
        kept = _Limited(lambda x: self.cost(x, response) / count, lambda v: v * count, limit)
        return kept.run(lambda: minimize(kept, x, method="BFGS"))

    def least_squares(self, x, response, limit: float) -> dict:
        """SciPy's trust-region least squares with forward differences."""
        import numpy as np
        from scipy.optimize import least_squares

        residual = lambda x: np.concatenate([part.ravel() for part in self.error(x, response)])
        kept = _Limited(residual, lambda r: float(r @ r), limit)
        return kept.run(lambda: least_squares(kept, x, method="trf"))


class _Limited:
    """A function that counts its calls, keeps its best point and ends the search after `limit` s of processor time."""

    class Over(Exception):
        pass

    def __init__(self, function, cost, limit: float):
        self.function, self.cost, self.end = function, cost, time.process_time() + limit
        self.calls, self.best, self.x = 0, float("inf"), None

    def __call__(self, x):
        if time.process_time() > self.end:
            raise self.Over
        value = self.function(x)
        self.calls += 1
        if (cost := self.cost(value)) < self.best:
            self.best, self.x = cost, x.copy()
        return value

    def run(self, search) -> dict:
        try:
            ended = "by itself" if search().success else "rounding"
        except self.Over:
            ended = "limit"
        return {"x": self.x, "cost": self.best, "evaluations": self.calls, "ended": ended}


# Printing ------------------------------------------------------------------------------------------------------------


def _cores(found: dict) -> str:
    return f"{found['cores']} core{'s' if found['cores'] > 1 else ''}"


def _cost_table(found: dict) -> str:
    lines = [
        f"\nCost: positions {', '.join(map(str, found['positions']))} of {CANDIDATES}, {found['lines']} lines, "
        f"36 elements, 22 parameters, {_cores(found)}; jaxfrf compiled in {found['compile_s']:.1f} s",
        f"  costs differ by {found['difference']:.0e} without gravity, {found['difference_at_truth']:.0e} with it at "
        f"the truth; by up to {found['difference_of_rest']:.0e} where jaxfrf moves the point of rest",
        f"  {'':32}{'wall ms':>9}{'processor ms (min-max)':>26}{'times jaxfrf (min-max)':>26}",
    ]
    for name, row in found["rows"].items():
        each = "{:.1f} ({:.1f}-{:.1f})".format(*(1e3 * t for t in row["cpu_s"]))
        ratio = "{:.2f} ({:.2f}-{:.2f})".format(*row["over_ours"])
        lines.append(f"  {name:32}{1e3 * row['wall_s'][0]:9.1f}{each:>26}{ratio:>26}")
    return "\n".join([*lines, f"  (times jaxfrf: over '{OURS_GRAM}', processor time, turn by turn)"])


def _turn_line(number: int, turn: dict) -> str:
    each = [
        f"{name} {t['cpu_s']:.1f} s, {t['evaluations']} evaluations, cost {t['cost']:.0f}" for name, t in turn.items()
    ]
    return f"start {number}: " + "; ".join(each)


def _start_table(found: dict) -> str:
    turns = found["starts"]
    lines = [
        f"\nOne start: {len(turns)} of them, {_cores(found)}; jaxfrf compiled in {found['compile_s']:.1f} s; best cost "
        f"{found['best']:.1f}; NumPy's cost {found['response']}; baselines end after {found['limit_s']:.0f} s (>)",
        f"  {'':32}{'wall s':>9}{'processor s (min-max)':>26}{'evaluations':>13}{'best cost':>11}{'times jaxfrf':>26}",
    ]
    for name in (OURS, QUASI, SQUARES):
        rows = [turn[name] for turn in turns]
        cut = ">" if any(r["ended"] == "limit" for r in rows) else ""
        cpu = _spread([r["cpu_s"] for r in rows])
        ratio = _spread([turn[name]["cpu_s"] / turn[OURS]["cpu_s"] for turn in turns])
        lines.append(
            f"  {name:32}{statistics.median(r['wall_s'] for r in rows):9.1f}"
            f"{cut + '{:.1f} ({:.1f}-{:.1f})'.format(*cpu):>26}"
            f"{statistics.median(r['evaluations'] for r in rows):13.0f}"
            f"{sum(r['reached'] for r in rows):7d}/{len(rows):<3d}"
            f"{cut + '{:.1f} ({:.1f}-{:.1f})'.format(*ratio):>26}"
        )
    return "\n".join([*lines, "  (evaluations: of jaxfrf with the Jacobian; best cost: starts within 1 % of it)"])


def _fit_table(found: dict, starts: dict) -> str:
    turns = starts["starts"]
    lines = [
        f"\nWhole fit, uncertainty included, {_cores(found)}; compiled in {found['compile_s']:.1f} s",
        f"  {'':32}{'wall s':>9}{'processor s':>13}{'steps':>8}{'best cost':>11}  a start, vs BFGS / least_squares",
    ]
    for row in found["rows"]:
        name = f"jaxfrf.fit(starts={row['starts']}{', keep=None' if row['keep'] is None else ''})"
        share = row["cpu_s"] / row["starts"]
        against = " / ".join(
            ("> " if any(t[n]["ended"] == "limit" for t in turns) else "")
            + f"{statistics.median(t[n]['cpu_s'] for t in turns) / share:.0f} times"
            for n in (QUASI, SQUARES)
        )
        lines.append(
            f"  {name:32}{row['wall_s']:9.1f}{row['cpu_s']:13.1f}{sum(row['steps']):8d}"
            f"{row['close']:7d}/{row['starts']:<3d}   {against}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
