"""`jaxfrf identify`."""

import pathlib
import shlex
from collections.abc import Sequence
from typing import Any

from .._errors import InputError, input_error
from .._text import nearest
from ..io._formats import FRFS, RECORDS
from . import own_effects
from .arguments import (
    add_memory_option,
    add_record_options,
    add_resume_option,
    add_tolerance_option,
    check_picture,
    check_result,
    check_target,
    check_whole,
    check_x64,
    command,
    kept_parts,
    naming,
    options_of,
    range_of,
    read_each,
    reading_words,
    with_tolerances,
)
from .each import add_each_options
from .progress import Progress
from .remarks import warn

_RECORDS_ONLY = ("method", "option", "map", "set", "factor", "periods")
_SPRINGS_ONLY = (
    "starts", "seed", "guess", "direct", "fix", "free", "share", "weights", "method", "option", "band", "plot"
)  # fmt: skip

_PROGRAM, _COPIES = 1.3e9, 15.0  # bytes beside the records, and how often these are held: R3X, 48 and 194 MB of them

EXAMPLES = (
    "jaxfrf identify run1.nc run2.nc --robot robot.toml -o fit.json --report fit.html --robot-out found.toml",
    "jaxfrf identify run.nc --robot robot.toml -o fit.json --heldout 2,5 --tolerance links=0.02,friction=unknown",
    "jaxfrf identify frf.nc --robot robot.toml --springs -o fit.json --plot bode.png",
    "jaxfrf identify motion.csv --robot arm.urdf --map u=tau,y=theta --set fs=1000,y_quantity=position -o fit.json",
)


def add(commands) -> None:
    parser = command(commands, "identify", run, "Calibrate a robot from records, or its springs from FRFs.")
    parser.add_argument(
        "data", nargs="+", metavar="DATA", help=f"records ({' '.join(RECORDS)}), or FRFs ({' '.join(FRFS)})"
    )
    parser.add_argument(
        "--robot",
        required=True,
        metavar="ROBOT",
        help="the robot, .toml or .urdf (drives beside it); its values are the start",
    )
    parser.add_argument("-o", "--output", required=True, help="fit to write: .json")
    parser.add_argument("--report", metavar="FILE", help="page about the fit to write: .html")
    parser.add_argument(
        "--springs",
        action="store_true",
        help="stiffness and damping alone, from the FRF, everything else taken as exact (what FRF files always give)",
    )
    parser.add_argument("--robot-out", metavar="FILE", help="robot with the result to write: .toml")
    own_effects.add_effects_option(parser)
    parser.add_argument("--heldout", metavar="P,...", help="positions, from 0, to judge the result on: not fitted")
    parser.add_argument("--rounds", type=int, default=12, metavar="N", help="of simulation, at most (default 12)")
    add_tolerance_option(parser)
    whole = parser.add_argument_group("of the whole robot (the default)")
    whole.add_argument(
        "--cutoff", type=float, metavar="HZ", help="of the motion's filter, of a robot with rigid transmissions"
    )
    whole.add_argument(
        "--payload",
        action="append",
        default=[],
        metavar="FILE:mass=KG,place=X;Y;Z",
        help="carried in this record beside what the robot is given with, in the last link's frame, m; exactly known",
    )
    springs = parser.add_argument_group("of the springs alone (--springs), and --method, --option and --band")
    springs.add_argument("--plot", metavar="FILE", help="Bode picture of measurement and models: .png, .pdf, .svg")
    springs.add_argument("--starts", type=int, help="of the direct fit (default 20)")
    springs.add_argument("--seed", type=int, help="of the starts (default 0)")
    springs.add_argument(
        "--guess", action="store_true", help="start from the FRF's antiresonances, not from the robot's values"
    )
    springs.add_argument("--direct", action="store_true", help="the direct fit alone, no simulation of the experiment")
    names: dict[str, Any] = {"action": "append", "default": []}
    springs.add_argument("--fix", **names, metavar="NAME,...", help="hold these at the robot's value: *.damping")
    springs.add_argument("--free", **names, metavar="NAME,...", help="fit these too: joint1.torque_gain (--direct)")
    springs.add_argument("--share", **names, metavar="A=B", help="one value for both: joint5.damping=joint6.damping")
    springs.add_argument(
        "--weights", metavar="KEY=VALUE,...", help="off_diagonal=0.2, focus=4, floor=0.03, reject=0.25 (the defaults)"
    )
    add_record_options(parser, method=None, default="lrm-jio-stacked, auto where there is no reference")
    add_memory_option(parser)
    add_resume_option(parser)
    add_each_options(parser)


def run(given) -> dict:
    from ..experiment import concatenate
    from ..io.fits import write_fit

    check_x64("jaxfrf identify")
    _check_outputs(given)
    check_whole(given, _PROGRAM, _COPIES)
    about = own_effects.about(given)
    with kept_parts(given, about) as parts, Progress("identify", given.json) as progress:
        robot, data, method = _read(given)
        with naming(given.data):
            whole = _is_whole(given, data)
            if not whole and isinstance(data, list):
                data = concatenate(data)
            found = (
                _calibrated(given, robot, data, parts, progress)
                if whole
                else _springs(given, robot, data, method, parts, progress)
            )
        contents = found.as_dict()
        write_fit(given.output, contents)
        written = [given.output, *_write_more(given, found, whole)]
    warnings = [w for record in data for w in record.warnings] if whole else found.measured.warnings
    warn(warnings)
    text = [*found.lines(), f"wrote {', '.join(written)}", f"next: {'; '.join(_next(given, data, robot, whole))}"]
    return {"text": text, "json": (contents if whole else _brief(contents)) | {"output": written}}


def _next(given, data, robot, whole: bool) -> list[str]:
    """The page, and the diagnosis of the same records, where there is one of such a robot."""
    from ..trajectory.needed_torque import turned_by_one_motor

    periodic = whole and all(record.period for record in data)
    asked = whole and (periodic or turned_by_one_motor(robot))
    look = [f"look at {given.report}"] if given.report else [] if asked else ["--report fit.html shows it"]
    return [*look, *([f"what is missing? {_diagnosis(given)}"] if asked else [])]


def _diagnosis(given) -> str:
    """`jaxfrf diagnose` of the same files, read in the same way."""
    effects = ["--effects", given.effects] if given.effects else []
    tolerance = ["--tolerance", given.tolerance] if given.tolerance and not given.robot_out else []
    robot = ["--robot", given.robot_out or given.robot, *effects, *tolerance]
    return shlex.join(["jaxfrf", "diagnose", *given.data, *robot, *reading_words(given), "-o", "gap.json"])


def _is_whole(given, data) -> bool:
    """Whether all of the robot can be fitted; says why, where not."""
    from ..frf import FRF

    if given.springs or isinstance(data, FRF):
        if given.payload:
            raise input_error("--payload", "springs alone", "the whole robot to be fitted", "Leave out --springs.")
        return False
    asked = next((name for name in _SPRINGS_ONLY if getattr(given, name) not in (None, False, [])), None)
    if asked is not None:
        raise input_error(
            f"--{asked}",
            "the whole robot to be fitted",
            "--springs beside it: it belongs to the fit of springs and dampers",
            "Add --springs, or leave it out (what is known of a number: --tolerance).",
        )
    return True


def _calibrated(given, robot, data, parts, progress):
    from ..calibration import calibrate

    records, payloads = _merged(robot, data, _payloads(given, len(data)))
    return calibrate(
        robot,
        records,
        payloads=payloads,
        heldout=_numbers(given.heldout),
        rounds=given.rounds,
        cutoff=given.cutoff,
        parts=parts,
        say=progress.say,
    )


def _merged(robot, records, payloads):
    """Records of one place as further experiments there, where they are alike but for their phases."""
    from ..experiment import concatenate

    rigid = not robot.n_motors and not robot.n_elastic
    if rigid or any(p is not None for p in payloads) or len({(r.n_pos, r.n_exp) for r in records}) > 1:
        return records, payloads
    return [concatenate(records)], ()


def _payloads(given, records: int) -> list:
    """Of every record, in the order of the files: one for each file, or one record that they hold together."""
    import numpy as np

    from ..effects import Payload

    found: dict[str, Payload] = {}
    for text in given.payload:
        path, _, said = text.rpartition(":")
        try:
            table = dict(pair.split("=") for pair in said.split(","))
            mass, place = float(table.pop("mass")), [float(x) for x in table.pop("place").split(";")]
        except (ValueError, KeyError):
            table, place = {"": ""}, []
        if path not in given.data or table or len(place) != 3:
            raise input_error(
                "--payload",
                repr(text),
                f"FILE:mass=KG,place=X;Y;Z with one of {', '.join(given.data)}",
                "Write e.g. --payload 'run2.nc:mass=2.5,place=0;0;0.12' (quoted).",
            )
        found[path] = Payload(mass=mass, place=np.asarray(place))
    if records == len(given.data):
        return [found.get(path) for path in given.data]
    if len(found) > 1:
        raise input_error("--payload", f"{len(found)} of one record", "one", "Give the sum, with one of its files.")
    return [next(iter(found.values()), None)]


def _springs(given, robot, data, method, parts, progress):
    from ..identification import identify_springs

    return identify_springs(
        robot,
        data,
        method=method,
        weights=_weights(given.weights),
        starts=20 if given.starts is None else given.starts,
        seed=given.seed or 0,
        rounds=given.rounds,
        direct=given.direct,
        guess=given.guess,
        fixed=_names(given.fix),
        freed=_names(given.free),
        shared=[_group(text) for text in given.share],
        heldout=_numbers(given.heldout),
        band=range_of("--band", given.band, float),
        parts=parts,
        say=progress.say,
    )


def _brief(contents: dict) -> dict:
    """Without what fills pages."""
    starts = {name: x for name, x in contents["starts"].items() if name not in ("costs", "paths", "polished")}
    return contents | {"starts": starts}


def _write_more(given, found, whole: bool) -> list[str]:
    written = []
    if given.robot_out:
        from ..io.robots import write_robot

        write_robot(given.robot_out, found.robot)
        written.append(given.robot_out)
    if given.plot:
        from ..plot import save
        from ..plot.fit import fit_bode

        title = ", ".join(pathlib.Path(name).name for name in given.data)
        save(fit_bode(found.measured, found.responses(), title=title)[0], given.plot)
        written.append(given.plot)
    if given.report:
        from ..report import write_calibration, write_identification

        (write_calibration if whole else write_identification)(given.report, found)
        written.append(given.report)
    return written


def _check_outputs(given) -> None:
    """Everything that could not be written, before anything is read."""
    wanted = {given.output: (".json",), given.report: (".html", ".htm"), given.robot_out: (".toml",)}
    for path, suffixes in wanted.items():
        if path:
            check_target(path, suffixes)
    if given.plot:
        check_picture(given.plot)
    if given.report:
        from ..io._optional import require

        require("matplotlib.figure", "plot")
    if given.robot_out:
        check_result(given.robot_out, [given.robot], "robot")


def _read(given):
    """Robot, records or FRF, and the estimator that was named."""
    from ..frf.catalogue import method
    from ..io.frf_or_record import holds_frf, read_frfs

    robot = with_tolerances(own_effects.robot_of(given), given.tolerance)
    frfs = [holds_frf(path) for path in given.data]
    if any(frfs) and not all(frfs):
        raise input_error(
            "files",
            f"an FRF, {given.data[frfs.index(True)]}, beside a record, {given.data[frfs.index(False)]}",
            "records alone or FRFs alone",
            "Estimate the FRF of the record first, or leave one of them out.",
        )
    if any(frfs):
        for name in _RECORDS_ONLY:
            if getattr(given, name):
                raise input_error(f"--{name}", "FRF files", "records", "It was decided when the FRF was estimated.")
        return robot, read_frfs(*given.data), None
    options = options_of(given.option)
    data = read_each(given)
    chosen = None
    if given.method or options:
        chosen = method(given.method or ("auto" if data[0].r is None else "lrm-jio-stacked"), options)
    periods = range_of("--periods", given.periods, int)
    if periods is not None:
        from ..experiment import select_periods

        with naming(given.data):
            data = [select_periods(record, periods[0] or 0, periods[1]) for record in data]
    return robot, data, chosen


def _names(texts: Sequence[str]) -> list[str]:
    return [name.strip() for text in texts for name in text.split(",") if name.strip()]


def _group(text: str) -> list[str]:
    names = [name.strip() for name in text.split("=")]
    if len(names) < 2 or not all(names):
        raise InputError(f"--share: found {text!r}; expected A=B. Write e.g. --share joint5.damping=joint6.damping.")
    return names


def _numbers(text: str | None) -> list[int]:
    try:
        return [int(x) for x in text.split(",")] if text else []
    except ValueError:
        raise input_error("--heldout", repr(text), "numbers of positions", "Write e.g. --heldout 2,5.") from None


def _weights(text: str | None):
    import dataclasses

    from ..graybox import Weights

    known = [f.name for f in dataclasses.fields(Weights) if isinstance(f.default, float)]
    found: dict[str, Any] = {}
    for pair in text.split(",") if text else ():
        name, _, value = (x.strip() for x in pair.partition("="))
        if name not in known:
            near = nearest(name, known)
            raise input_error("--weights", repr(name), f"some of {', '.join(known)}", f"Did you mean {near!r}?")
        try:
            found[name] = float(value)
        except ValueError:
            raise input_error(f"--weights {name}", repr(value), "a number", "Write e.g. floor=0.03.") from None
    return Weights(**found)
