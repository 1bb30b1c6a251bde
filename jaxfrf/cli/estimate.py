"""`jaxfrf estimate`."""

import dataclasses
import pathlib

from ..io._formats import FRFS, RECORDS
from .arguments import (
    add_memory_option,
    add_record_options,
    add_resume_option,
    check_picture,
    check_result,
    check_target,
    check_x64,
    command,
    data_set,
    kept_parts,
    naming,
    options_of,
    range_of,
    say,
)
from .each import add_each_options, sharing
from .progress import Progress
from .remarks import warn

_READ_BY = ("map", "set", "factor", "anyway", "periods", "band", "robust", "segment")  # options

EXAMPLES = (
    "jaxfrf estimate run.nc -o frf.nc --report frf.html",
    'jaxfrf estimate log.mat -o frf.nc --map "u=[tau1;tau2],y=rec.speed,r=v_ref" --set fs=2000,period=56000',
    "jaxfrf estimate run.nc -o frf.mat --method lrm-jio-stacked --option width=34 --band 4:80 --plot bode.png",
    "jaxfrf estimate 'logs/*.mat' --each -o results --workers 4",
)


def add(commands) -> None:
    parser = command(commands, "estimate", run, "Estimate frequency response functions from records.")
    parser.add_argument("data", nargs="+", metavar="DATA", help=f"records, one data set: {' '.join(RECORDS)}")
    parser.add_argument("-o", "--output", required=True, help=f"FRF to write: {' '.join(FRFS)}")
    add_record_options(parser, method="auto", default="auto")
    parser.add_argument(
        "--segment",
        type=int,
        metavar="SAMPLES",
        help="cut a record without a period into pieces of so many samples: experiments more, or Welch's segments",
    )
    parser.add_argument("--report", metavar="FILE", help="page to write, to choose, zoom and read values on: .html")
    parser.add_argument("--plot", metavar="FILE", help="Bode picture to write: .png, .pdf, .svg")
    parser.add_argument("--robust", action="store_true", help="weigh periods: odd ones count less, or not at all")
    add_memory_option(parser)
    add_resume_option(parser)
    add_each_options(parser)


def run(given) -> dict:
    _check_outputs(given)  # before what takes seconds to import

    from ..batch.estimated import estimate_to
    from ..pipeline import summary

    check_x64("jaxfrf estimate")
    chosen = _chosen(given)
    with kept_parts(given) as parts, Progress("estimate", given.json) as progress:
        data = data_set(given)
        with naming(given.data):
            made = estimate_to(
                given.output,
                data,
                chosen,
                parts=parts,
                about={f"--{name}": getattr(given, name) for name in _READ_BY},
                memory=given.memory,
                **sharing(given),
                progress=progress,
                say=say,
            )
        about = summary(made.spectra, made.frf)
        written = [given.output, *_write_picture(given, made.frf), *_write_report(given, made.frf, about)]
    warn(made.frf.warnings)
    return {
        "text": [
            *about.lines(),
            f"wrote {', '.join(written)}",
            f"next: look at {given.report}" if given.report else f"next: jaxfrf view {given.output}",
        ],
        "json": about.as_dict() | {"output": written},
    }


def _chosen(given):
    """What is taken of the record, and how. Welch's segments are its own, for other methods they are experiments."""
    from ..batch.estimated import Chosen
    from ..frf.catalogue import method
    from ..frf.welch import Welch

    chosen, segment = method(given.method, options_of(given.option)), given.segment
    if segment is not None and isinstance(chosen, Welch):
        chosen, segment = dataclasses.replace(chosen, segment=segment), None
    return Chosen(
        chosen,
        range_of("--periods", given.periods, int),
        range_of("--band", given.band, float),
        given.robust,
        segment,
    )


def _write_picture(given, frf) -> list[str]:
    if not given.plot:
        return []
    from .. import plot

    figure, _ = plot.bode([frf], [given.method], title=", ".join(pathlib.Path(name).name for name in given.data))
    plot.save(figure, given.plot)
    return [given.plot]


def _write_report(given, frf, about) -> list[str]:
    if not given.report:
        return []
    from ..report.response import write_frf_page

    write_frf_page(given.report, frf, [given.method], about=about.lines()[:4])
    return [given.report]


def _check_outputs(given) -> None:
    """Everything that could not be written, before anything is read."""
    check_target(given.output, FRFS)
    check_result(given.output, given.data, "measurement")
    if pathlib.Path(given.output).suffix.lower() == ".nc":
        from ..io._optional import require

        require("h5netcdf", "io")
    if given.plot:
        check_picture(given.plot)
    if given.report:
        check_target(given.report, (".html", ".htm"))
