"""`jaxfrf positions`."""

from .._errors import input_error
from .._text import percent
from . import own_effects
from .arguments import add_renamed_option, check_picture, check_seed, check_target, check_x64, command

EXAMPLES = ("jaxfrf positions robot.toml design.toml --positions 7 -o positions.csv --plot accuracy.png",)


def add(commands) -> None:
    parser = command(commands, "positions", run, "Choose arm configurations to measure a robot at, before measuring.")
    parser.add_argument("robot", metavar="ROBOT", help=".toml, or .urdf with its drives in a .toml beside it")
    parser.add_argument("design", metavar="DESIGN.toml")
    own_effects.add_effects_option(parser)
    parser.add_argument("-n", "--positions", type=int, default=7, metavar="N", help="how many to choose (default 7)")
    add_renamed_option(parser, "--count", "--positions")
    parser.add_argument(
        "--candidates",
        default="200",
        metavar="N|FILE",
        help="to choose from: a file of arm angles that you know to be free (rad, a row each, as -o writes), or so "
        "many random ones, between the joint limits where the robot's file states any (default 200)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the candidates (default 0)")
    parser.add_argument(
        "--relative-noise",
        type=float,
        default=0.05,
        metavar="PART",
        help="standard deviation over size of the FRF (.05)",
    )
    add_renamed_option(parser, "--noise", "--relative-noise")
    parser.add_argument("-o", "--output", required=True, help="arm angles to write, for `simulate`: .csv or .txt")
    parser.add_argument("--plot", metavar="FILE", help="picture of the accuracy to expect: .png, .pdf, .svg")


def run(given) -> dict:
    from ..graybox import RobotModel, plan_positions
    from ..io import read_design
    from ..io.positions import write_positions

    check_x64("jaxfrf positions")
    check_seed(given.seed)
    check_target(given.output, (".csv", ".txt"))
    if given.plot:
        check_picture(given.plot)
    robot, design = own_effects.robot_of(given), read_design(given.design)
    model = RobotModel(robot, slow_amplitude=None if design.slow is None else design.slow.amplitude)
    candidates, drawn = _candidates(given, robot, _travel(design, robot))
    plan = plan_positions(model, design.frequency, candidates, given.positions, noise=given.relative_noise)
    about = (
        f"{robot.name}: {given.positions} of {len(candidates)} positions ({drawn}), D-optimal for springs and dampers "
        f"at {100 * given.relative_noise:g} % noise"
    )
    write_positions(given.output, plan.points, robot.axis_names, [about], robot.axis_units)
    written = [given.output]
    if given.plot:
        from .. import plot

        plot.save(plot.plan(plan, title=robot.name)[0], given.plot)
        written.append(given.plot)
    at = list(plan.counts).index(given.positions)
    rows = [i for i, wanted in enumerate(plan.wanted) if wanted]
    return {
        "text": [
            about,
            "expected standard deviation (at random positions):",
            *(f"  {plan.names[i]}: {percent(plan.optimal[at, i])} ({percent(plan.random[at, i])})" for i in rows),
            f"wrote {', '.join(written)}",
            f"look at every one before you drive there: nothing here knows {_unknown(robot)}the floor or the cell",
            f"next: measure there, or jaxfrf simulate {given.robot} {given.design} --configurations {given.output} ...",
        ],
        "json": {
            "output": written,
            "chosen": list(plan.chosen),
            "q": plan.points.tolist(),
            "std": {plan.names[i]: float(plan.optimal[at, i]) for i in rows},
            "std_random": {plan.names[i]: float(plan.random[at, i]) for i in rows},
            "counts": plan.counts.tolist(),
            "std_by_count": {plan.names[i]: plan.optimal[:, i].tolist() for i in rows},
            "blocks": plan.blocks.tolist(),
            "std_by_blocks": {plan.names[i]: plan.by_blocks[:, i].tolist() for i in rows},
        },
    }


def _candidates(given, robot, travel):
    """Arm angles to choose from, (pos, axis), and where they come from."""
    import jax.random as jr

    from ..simulation.positions import check_within, positions_of, read_positions

    if not given.candidates.isdecimal():
        q = read_positions(given.candidates, robot.n_axes)
        check_within(given.candidates, q, robot, travel)
        return q, f"from {given.candidates}"
    if not 1 <= int(given.candidates) <= 100_000:
        raise input_error("--candidates", given.candidates, "1 to 100000, or a file", "Some hundreds are enough.")
    return positions_of(robot, int(given.candidates), jr.key(given.seed), travel), f"seed {given.seed}"


def _travel(design, robot):
    """How far the design moves every axis from where it stands, arm side; 0 where no limit asks."""
    import numpy as np

    from ..excitation import reference, reference_levels

    if not robot.limits or design.n_in != robot.n_axes:
        return np.zeros(robot.n_axes)
    motors = reference_levels(reference(design)).position.max(axis=0)
    return motors / np.abs(np.asarray(robot.drives.gear_ratio))


def _unknown(robot) -> str:
    if not robot.limits:
        return "joint limits, "
    without = [name for name, limits in zip(robot.axis_names, robot.limits, strict=True) if limits[0] == -float("inf")]
    return f"the limits of {', '.join(without)}, " if without else ""
