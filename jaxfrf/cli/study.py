"""`jaxfrf study`."""

import dataclasses

from .._errors import input_error
from .arguments import add_resume_option, command, kept_parts
from .each import add_worker_options, sharing
from .progress import Progress

_SCALES = ("demo", "medium", "paper")

EXAMPLES = (
    "jaxfrf study --scale demo -o study",
    "jaxfrf study --scale paper -o paper --resume",
    "jaxfrf study --scale paper --positions 4 --workers 4 -o four",
)


def add(commands) -> None:
    parser = command(
        commands,
        "study",
        run,
        "Reproduce the paper's study on the reference robot, from excitation to parameters, with tables and figures "
        "beside the published ones; calibrate robots of which nothing is known exactly; find an effect that is hidden "
        "in a small one.",
    )
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="folder to make")
    parser.add_argument(
        "--scale",
        choices=_SCALES,
        default="demo",
        help="demo: the shortest run that shows every part, three minutes (default); medium: all of the paper's "
        "comparisons from fewer positions and experiments, half an hour; paper: everything, hours",
    )
    parser.add_argument("--positions", type=int, metavar="N", help="how many, fewer than the scale has")
    add_worker_options(parser)
    add_resume_option(parser)


def run(given) -> dict:
    from ..study import SCALES, run_study
    from ..study.summary import summary_lines

    settings = _settings(SCALES[given.scale], given.positions)
    with kept_parts(given) as parts, Progress("study", given.json) as progress:
        results = run_study(settings, given.output, say=progress.say, parts=parts, **sharing(given))
    text = [*summary_lines(results), f"wrote {given.output}/index.html and study.json"]
    return {"text": [*text, f"next: look at {given.output}/index.html"], "json": results}


def _settings(whole, positions: int | None):
    """Those of a scale, at fewer positions."""
    if positions is None:
        return whole
    if not 2 <= positions <= whole.positions:
        raise input_error("--positions", f"{positions}", f"2 to {whole.positions}", "Or take another --scale.")
    return dataclasses.replace(whole, positions=positions, fit_positions=min(positions, whole.fit_positions))
