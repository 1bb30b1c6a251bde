"""`jaxfrf diagnose`."""

import sys

from .._errors import InputError, OutputError, input_error
from .._text import number
from ..io._formats import RECORDS
from . import own_effects
from .arguments import (
    add_memory_option,
    add_reading_options,
    add_resume_option,
    add_tolerance_option,
    check_result,
    check_target,
    check_whole,
    check_x64,
    command,
    kept_parts,
    naming,
    read_each,
    with_tolerances,
)
from .each import add_each_options
from .progress import Progress
from .remarks import warn

_PROGRAM, _COPIES = 1.2e9, 23.0  # bytes beside the records, and how often these are held: R3X, friction missing, 193 MB

EXAMPLES = (
    "jaxfrf diagnose run1.nc run2.nc --robot robot.toml -o gap.json --report gap.html --robot-out extended.toml",
    "jaxfrf diagnose run.nc --robot robot.toml --effects my_effects.py -o gap.json",
    "jaxfrf diagnose frf_a.nc frf_b.nc --heldout-count 1 -o gap.json --robot-out drive.toml",
    'jaxfrf diagnose a.csv b.csv --map "u=torque,y=[motor;link]" --set fs=250,y_quantity=position -o gap.json',
)


def add(commands) -> None:
    parser = command(commands, "diagnose", run, "Find the effect that a robot's model lacks, from records.")
    parser.add_argument(
        "data", nargs="+", metavar="DATA", help=f"records: {' '.join(RECORDS)}; or FRFs of a single drive"
    )
    parser.add_argument(
        "--robot",
        metavar="ROBOT",
        help="the robot as it is modelled so far, .toml or .urdf (drives beside it); for a single drive, and for "
        "deflections (y: all motors, then all links), it may be left out",
    )
    parser.add_argument("-o", "--output", required=True, help="diagnosis to write: .json")
    parser.add_argument("--report", metavar="FILE", help="page about the diagnosis to write: .html")
    parser.add_argument("--robot-out", metavar="FILE", help="robot with what was missing to write: .toml")
    own_effects.add_effects_option(parser)
    add_tolerance_option(parser)
    parser.add_argument(
        "--heldout-count",
        type=int,
        metavar="N",
        help="positions that are kept to judge the result on (of FRFs and of records without a period: the last N)",
    )
    add_reading_options(parser)
    add_memory_option(parser)
    add_resume_option(parser)
    add_each_options(parser)


def run(given) -> dict:
    from ..io.gaps import gap_contents, write_gap
    from ..io.robots import read_robot

    check_x64("jaxfrf diagnose")
    _check_outputs(given)
    check_whole(given, _PROGRAM, _COPIES)
    own = own_effects.own_effects(given.effects) if given.effects else ()
    robot = with_tolerances(read_robot(given.robot, own), given.tolerance) if given.robot else None
    with kept_parts(given, own_effects.about(given)) as parts:
        data = _read(given)
        warn(w for x in data for w in x.warnings)
        found = _diagnosed(given, robot, data, own, parts)
        write_gap(given.output, found)
        written = [given.output, *_write_more(given, found, own)]
    contents = gap_contents(found)
    page = f"next: look at {given.report}" if given.report else "next: --report gap.html shows where"
    text = [*_lines(found), f"wrote {', '.join(written)}", page]
    return {"text": text, "json": contents | {"output": written}}


def _read(given) -> list:
    """FRFs, or records."""
    from ..io.frf_or_record import holds_frf
    from ..io.responses import read_frf

    held = [holds_frf(path) for path in given.data]
    if any(held) and not all(held):
        raise input_error("DATA", "FRFs and records", "either", "Diagnose them one after the other.")
    return [read_frf(path) for path in given.data] if any(held) else read_each(given)


def _diagnosed(given, robot, data, own, parts):
    """The diagnosis; bad input leaves nothing, as it would be refused again."""
    from ..gap import diagnose
    from ..gap.simulated.rounds import PART_FILES

    parts.begin(_about(given, data), PART_FILES)
    heldout = {} if given.heldout_count is None else {"heldout_count": given.heldout_count}
    try:
        with naming(given.data), Progress("diagnose", given.json) as progress:
            return diagnose(robot, data, own=own, parts=parts, say=progress.say, progress=progress, **heldout)
    except OutputError:
        raise
    except InputError:
        parts.discard()
        raise


def _about(given, data) -> dict:
    """What the finished parts depend on."""
    from ..io.responses import source
    from ..parts import files_text

    return {
        "--robot": files_text([source(given.robot)] if given.robot else []),
        "data": files_text(s for x in data for s in x.sources),
        "--map": given.map,
        "--set": given.set,
        "--factor": given.factor,
        "--heldout-count": given.heldout_count,
        "--tolerance": given.tolerance,
        "--anyway": given.anyway,
    }


def _check_outputs(given) -> None:
    """Everything that could not be written, before anything is read."""
    for path, suffixes in (
        (given.output, (".json",)),
        (given.report, (".html", ".htm")),
        (given.robot_out, (".toml",)),
    ):
        if path:
            check_target(path, suffixes)
    if given.report:
        from ..io._optional import require

        require("matplotlib.figure", "plot")
    if given.robot_out and given.robot:
        check_result(given.robot_out, [given.robot], "robot")
    if given.tolerance and not given.robot:
        raise input_error("--tolerance", "no robot", "--robot, whose numbers it is about", "Name the robot.")
    if given.heldout_count is not None and given.heldout_count < 0:
        raise input_error("--heldout-count", f"{given.heldout_count}", "0 or more", "Say how many, e.g. 2.")


def _write_more(given, found, own) -> list[str]:
    written = []
    if given.robot_out:
        from ..io.robots import write_robot

        write_robot(given.robot_out, found.extended)
        written.append(given.robot_out)
        names = [x.name for x in found.extended.effects if type(x) in own]
        if names:
            text = f"{given.robot_out} names effects that only {given.effects} knows: {', '.join(names)}"
            print(f"warning: {text}. Give it with --effects wherever you use that robot.", file=sys.stderr)
    if given.report:
        from ..report.gap import write_gap_report

        write_gap_report(given.report, found)
        written.append(given.report)
    return written


def _lines(found) -> list[str]:
    """What a person wants to know first."""
    from ..report.gap_words import closed, estimate, gap_name, headline, p_text

    gap = found.gap
    lines = [f"{found.verdict}: {headline(found)}", found.says]
    for x in found.effects:
        values = ", ".join(f"{name} {estimate(e)}" for name, e in x.parameters.items())
        lines.append(f"  {x.name}{f' {x.joint}' if x.joint else ''}: {values} (95 %), {p_text(x.p_value)}")
        if x.equivalent:
            lines.append(f"    these data cannot tell it from {', '.join(x.equivalent)}; {x.separating_experiment}")
    lines.append(
        f"gap on {gap.on}: {number(gap.before)} before, {number(gap.after)} after, floor {number(gap.floor)}, "
        f"{gap_name(gap)}; {closed(gap)}"
    )
    if found.next_experiment:
        lines.append(f"next experiment: {found.next_experiment}")
    return lines
