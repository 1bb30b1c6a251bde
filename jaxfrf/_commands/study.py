"""`jaxfrf study`."""

from .arguments import command, say

_SCALES = ("demo", "paper")


def add(commands) -> None:
    parser = command(
        commands,
        "study",
        run,
        "Reproduce the paper's study on the reference robot: FRFs, parameters, tables and figures beside the published "
        "ones.\nAn interrupted study goes on where it stopped when the same command is given again.",
    )
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="folder to make or to continue")
    parser.add_argument(
        "--scale", choices=_SCALES, default="demo", help="demo: minutes (default); paper: everything, an hour"
    )


def run(given) -> dict:
    from ..study import SCALES, run_study
    from ..study.summary import summary_lines

    results = run_study(SCALES[given.scale], given.output, say=None if given.json else say)
    return {"text": [*summary_lines(results), f"wrote {given.output}/index.html and study.json"], "json": results}
