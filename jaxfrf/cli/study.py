"""`jaxfrf study`."""

from .arguments import add_resume_option, command, kept_parts
from .progress import Progress

_SCALES = ("demo", "medium", "paper")

EXAMPLES = (
    "jaxfrf study --scale demo -o study",
    "jaxfrf study --scale paper -o paper --resume",
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
    add_resume_option(parser)


def run(given) -> dict:
    from ..study import SCALES, run_study
    from ..study.summary import summary_lines

    with kept_parts(given) as parts, Progress("study", given.json) as progress:
        results = run_study(SCALES[given.scale], given.output, say=progress.say, parts=parts)
    text = [*summary_lines(results), f"wrote {given.output}/index.html and study.json"]
    return {"text": [*text, f"next: look at {given.output}/index.html"], "json": results}
