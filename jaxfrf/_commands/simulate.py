"""`jaxfrf simulate`."""

import sys

from .._errors import InputError
from . import own_effects
from .arguments import RECORD_FILES, Percent, check_seed, check_target, command

EXAMPLES = (
    "jaxfrf simulate robot.toml design.toml --positions 3 -o run.nc",
    "jaxfrf simulate robot.toml design.toml --configurations positions.csv --noise 1e-5 -o run.nc",
)


def add(commands) -> None:
    parser = command(commands, "simulate", run, "Play a design on a simulated robot in closed loop.")
    parser.add_argument("robot", metavar="ROBOT", help=".toml, or .urdf with its drives in a .toml beside it")
    parser.add_argument("design", metavar="DESIGN.toml")
    own_effects.add_effects_option(parser)
    parser.add_argument("-o", "--output", required=True, help="record to write: .nc, .mat or .npz")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--positions", type=int, default=None, metavar="N", help="random positions (default 1)")
    place.add_argument(
        "--configurations", metavar="FILE", help="arm angles instead, rad: .csv or .txt, one row for each position"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random positions and the noise (default 0)")
    parser.add_argument(
        "--run-in", type=float, default=5.0, metavar="S", help="seconds before the record (default 5); see --transient"
    )
    parser.add_argument("--transient", action="store_true", help="record the transient periods of the design too")
    parser.add_argument("--noise", type=float, default=5e-5, help="rms of the position noise, rad (default 5e-5)")


def run(given) -> dict:
    import jax.random as jr

    from ..io import read_design, write
    from ..simulation import simulate

    check_target(given.output, RECORD_FILES)
    robot, design = own_effects.robot_of(given), read_design(given.design)
    check_seed(given.seed)
    places, noise = jr.split(jr.key(given.seed))
    data = simulate(
        robot,
        design,
        _positions(given, robot.n_axes, places, design),
        key=noise,
        run_in=None if given.transient else given.run_in,
        noise=given.noise,
        progress=None if given.json else Percent("simulated"),
    )
    write(given.output, data)
    for text in data.warnings:
        print(f"warning: {text}", file=sys.stderr)
    runs = data.n_pos * data.n_exp
    text = [
        f"{robot.name}: {runs} runs ({data.n_pos} positions, {data.n_exp} experiments) of "
        f"{data.n_time / data.fs:g} s, {data.n_periods} steady period(s) of {data.period / data.fs:g} s, "
        f"{len(data.lines)} excited lines, seed {given.seed}",
        f"wrote {given.output}",
        f"next: jaxfrf estimate {given.output} -o frf.nc --report frf.html",
    ]
    return {
        "text": text,
        "json": {
            "output": given.output,
            "robot": robot.name,
            "positions": data.n_pos,
            "experiments": data.n_exp,
            "samples": data.n_time,
            "lines": len(data.lines),
            "seed": given.seed,
            "y_quantity": data.y_quantity,
            "warnings": list(data.warnings),
        },
    }


def _positions(given, axes: int, key, design):
    from ..simulation import random_positions, read_positions
    from ..simulation.checks import check_runs

    if given.configurations:
        return read_positions(given.configurations, axes)
    count = 1 if given.positions is None else given.positions
    if count < 1:
        raise InputError(f"--positions: found {count}; expected 1 or more. Say how many.")
    check_runs(design, count)
    return random_positions(count, key, axes)
