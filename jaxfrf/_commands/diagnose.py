"""`jaxfrf diagnose`."""

import hashlib
import pathlib
import shutil
import sys

from .._errors import InputError, input_error
from .arguments import Percent, check_target, check_x64, command, naming, read_records, say


def add(commands) -> None:
    parser = command(commands, "diagnose", run, "Find the effect that a robot's model lacks, from records.")
    parser.add_argument("data", nargs="+", metavar="DATA", help="records (.nc .mat .npz .csv)")
    parser.add_argument("--robot", required=True, metavar="ROBOT.toml", help="the robot as it is modelled so far")
    parser.add_argument("-o", "--output", required=True, help="diagnosis to write: .json")
    parser.add_argument("--report", metavar="FILE", help="page about the diagnosis to write: .html")
    parser.add_argument("--robot-out", metavar="FILE", help="robot with what was missing to write: .toml")
    parser.add_argument("--effects", metavar="FILE.py", help="effects of your own, tried beside the library's")
    parser.add_argument(
        "--positions-sealed", type=int, metavar="N", help="positions that are kept to judge the result on"
    )
    parser.add_argument("--map", help="names in the files: u=iq_adx,y=omega_max,r=iq_refx; u=[tau1;tau2]")
    parser.add_argument("--set", help="what the files do not say: fs=2500,period=2500,transient_periods=1")
    parser.add_argument("--scale", help="factors to SI units: y=0.0174532925")
    parser.add_argument("--resume", action="store_true", help="go on with a run that was interrupted")


def run(given) -> dict:
    from ..io.gaps import gap_contents, write_gap
    from ..io.robots import read_robot
    from .own_effects import own_effects

    check_x64("jaxfrf diagnose")
    _check_outputs(given)
    own = own_effects(given.effects) if given.effects else ()
    robot = read_robot(given.robot, own)
    data = [read_records(given, [path]) for path in given.data]
    for text in dict.fromkeys(w for x in data for w in x.warnings):
        print(f"warning: {text}", file=sys.stderr)
    found = _diagnosed(given, robot, data, own)
    write_gap(given.output, found)
    written = [given.output, *_write_more(given, found, own)]
    contents = gap_contents(found)
    return {"text": [*_lines(found), f"wrote {', '.join(written)}"], "json": contents | {"output": written}}


def _diagnosed(given, robot, data, own):
    """The diagnosis; what is finished of it is kept beside the output until it is whole."""
    from ..gap import diagnose
    from ..pipeline import folder_of_parts

    parts = folder_of_parts(given.output, _key(given, data), given.resume)
    sealed = {} if given.positions_sealed is None else {"sealed": given.positions_sealed}
    quiet = {"say": None, "progress": None} if given.json else {"say": say, "progress": Percent("diagnosed")}
    try:
        with naming(given.data):
            found = diagnose(robot, data, own=own, parts=parts, **quiet, **sealed)
    except InputError:
        shutil.rmtree(parts)
        raise
    shutil.rmtree(parts)
    return found


def _key(given, data) -> str:
    """What the finished parts depend on."""
    from .. import __version__

    about = (__version__, given.map, given.set, given.scale, given.positions_sealed, [x.sources for x in data])
    digest = hashlib.sha256(repr(about).encode())
    for path in (given.robot, given.effects):
        digest.update(pathlib.Path(path).read_bytes() if path else b"")
    return f"run-{digest.hexdigest()[:16]}"


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
    if given.robot_out and pathlib.Path(given.robot_out).resolve() == pathlib.Path(given.robot).resolve():
        raise input_error(given.robot_out, "the robot itself", "another file for the result", "Choose another name.")
    if given.positions_sealed is not None and given.positions_sealed < 0:
        raise input_error("--positions-sealed", f"{given.positions_sealed}", "0 or more", "Say how many, e.g. 2.")


def _write_more(given, found, own) -> list[str]:
    written = []
    if given.robot_out:
        from ..io.robots import write_robot

        write_robot(found.extended, given.robot_out)
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
        f"gap on {gap.on}: {gap.before:.3g} before, {gap.after:.3g} after, floor {gap.floor:.3g}, {gap_name(gap)}; "
        f"{closed(gap)}"
    )
    if found.next_experiment:
        lines.append(f"next: {found.next_experiment}")
    return lines
