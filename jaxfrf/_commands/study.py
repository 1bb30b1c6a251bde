"""`jaxfrf study`."""

import os
import shlex
import threading

from .arguments import command, say

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
    parser.add_argument("--resume", action="store_true", help="go on with a study that was interrupted")


def run(given) -> dict:
    from ..study import SCALES, run_study
    from ..study.run import BESIDE
    from ..study.summary import summary_lines

    try:
        results = run_study(SCALES[given.scale], given.output, say=None if given.json else say, resume=given.resume)
    except KeyboardInterrupt:
        again = f"jaxfrf study --scale {given.scale} -o {shlex.quote(given.output)} --resume"
        say(f"interrupted; finished steps are kept in {given.output}/parts, go on with: {again}")
        if any(thread.name == BESIDE for thread in threading.enumerate()):
            os._exit(130)  # Python would abort in the middle of that thread's compiled code; files are whole anyway
        raise
    text = [*summary_lines(results), f"wrote {given.output}/index.html and study.json"]
    return {"text": [*text, f"next: look at {given.output}/index.html"], "json": results}
