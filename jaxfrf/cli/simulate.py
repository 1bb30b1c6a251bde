"""`jaxfrf simulate`."""

from .._errors import InputError
from .._text import counted
from ..io._formats import SAVED
from . import own_effects
from .arguments import (
    add_memory_option,
    add_resume_option,
    check_seed,
    check_target,
    command,
    kept_parts,
    say,
)
from .each import add_worker_options, sharing
from .progress import Progress
from .remarks import warn

_MOST = 100_000  # positions

EXAMPLES = (
    "jaxfrf simulate robot.toml design.toml --positions 3 -o run.nc",
    "jaxfrf simulate robot.toml design.toml --configurations positions.csv --noise 1e-5 -o run.nc",
    "jaxfrf simulate robot.toml design.toml --positions 49 --workers 4 -o run.nc",
)


def add(commands) -> None:
    parser = command(commands, "simulate", run, "Play a design on a simulated robot in closed loop.")
    parser.add_argument("robot", metavar="ROBOT", help=".toml, or .urdf with its drives in a .toml beside it")
    parser.add_argument("design", metavar="DESIGN.toml")
    own_effects.add_effects_option(parser)
    parser.add_argument("-o", "--output", required=True, help=f"record to write: {' '.join(SAVED)}")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--positions", type=int, default=None, metavar="N", help="how many, drawn at random (default 1)")
    place.add_argument(
        "--configurations", metavar="FILE", help="arm angles instead, rad: .csv or .txt, one row for each position"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random positions and the noise (default 0)")
    parser.add_argument(
        "--run-in", type=float, default=5.0, metavar="S", help="seconds before the record (default 5); see --transient"
    )
    parser.add_argument("--transient", action="store_true", help="record the transient periods of the design too")
    parser.add_argument("--noise", type=float, default=5e-5, help="rms of the position noise, rad (default 5e-5)")
    add_memory_option(parser)
    add_worker_options(parser)
    add_resume_option(parser)


def run(given) -> dict:
    import jax.random as jr

    from ..batch.simulated import simulate_to
    from ..io import read_design

    check_target(given.output, SAVED)
    robot, design = own_effects.robot_of(given), read_design(given.design)
    check_seed(given.seed)
    places, noise = jr.split(jr.key(given.seed))
    positions = _positions(given, robot, places)
    with kept_parts(given, own_effects.about(given)) as parts, Progress("simulate", given.json) as progress:
        made = simulate_to(
            given.output,
            robot,
            design,
            positions,
            key=noise,
            parts=parts,
            run_in=None if given.transient else given.run_in,
            noise=given.noise,
            memory=given.memory,
            **sharing(given),
            progress=progress,
            say=say,
        )
    warn(made.warnings)
    text = [
        f"{robot.name}: {made.positions * made.experiments} runs ({made.positions} positions, {made.experiments} "
        f"experiments) of {made.samples / design.fs:g} s, {counted(made.periods, 'steady period')} of "
        f"{design.period / design.fs:g} s, {len(design.lines)} excited lines, seed {given.seed}",
        f"wrote {given.output}",
        f"next: jaxfrf estimate {given.output} -o frf.nc --report frf.html",
    ]
    return {
        "text": text,
        "json": {
            "output": given.output,
            "robot": robot.name,
            "positions": made.positions,
            "experiments": made.experiments,
            "samples": made.samples,
            "lines": len(design.lines),
            "seed": given.seed,
            "y_quantity": "position",
            "warnings": list(made.warnings),
        },
    }


def _positions(given, robot, key):
    from ..simulation import positions_of, read_positions

    if given.configurations:
        return read_positions(given.configurations, robot.n_axes)
    count = 1 if given.positions is None else given.positions
    if count < 1:
        raise InputError(f"--positions: found {count}; expected 1 or more. Say how many.")
    if count > _MOST:
        raise InputError(f"--positions: found {count}; expected at most {_MOST}. Simulate them in several files.")
    return positions_of(robot, count, key)
