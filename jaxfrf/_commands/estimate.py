"""`jaxfrf estimate`."""

import dataclasses
import pathlib
import sys
from collections.abc import Sequence

from .arguments import (
    RECORD_FILES,
    add_record_options,
    add_resume_option,
    check_picture,
    check_result,
    check_target,
    check_x64,
    command,
    naming,
    options_of,
    range_of,
    read_records,
    say,
)
from .each import add_each_options


def add(commands) -> None:
    parser = command(commands, "estimate", run, "Estimate frequency response functions from records.")
    parser.add_argument("data", nargs="+", metavar="DATA", help="experiment files, .nc .mat .npz .csv: one data set")
    parser.add_argument("-o", "--output", required=True, help="FRF to write: .nc, .mat, .npz or .uff")
    add_record_options(parser, method="auto", default="auto")
    parser.add_argument(
        "--segment",
        type=int,
        metavar="SAMPLES",
        help="cut a record without a period into pieces of so many samples: experiments more, or Welch's segments",
    )
    parser.add_argument("--plot", metavar="FILE", help="Bode picture to write: .png, .pdf, .svg")
    parser.add_argument("--robust", action="store_true", help="weigh periods: odd ones count less, or not at all")
    add_resume_option(parser)
    add_each_options(parser)


def run(given) -> dict:
    from ..experiment import select_periods
    from ..frf.catalogue import method
    from ..frf.distortion import with_distortion
    from ..frf.from_record import spectra_of
    from ..parts import Parts
    from ..pipeline import estimate_in_parts, summary

    check_x64("jaxfrf estimate")
    write = _frf_writer(given.output, given.data)
    if given.plot:
        check_picture(given.plot)
    chosen = method(given.method, options_of(given.option))
    periods, band = range_of("--periods", given.periods, int), range_of("--band", given.band, float)
    with Parts(given.output, "estimate", resume=given.resume, say=say) as parts:
        data = read_records(given, given.data)
        with naming(given.data):
            chosen, data = _in_segments(chosen, data, given.segment)
            spectra = spectra_of(data, chosen, periods=periods, band=band, robust=given.robust)
            frf = estimate_in_parts(spectra, chosen, parts, say=None if given.json else say)
            frf = with_distortion(frf, data if periods is None else select_periods(data, periods[0] or 0, periods[1]))
        write(given.output, frf)
        written = [given.output, *_write_picture(given, frf)]
    about = summary(spectra, frf)
    for warning in frf.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return {
        "text": [*about.lines(), f"wrote {', '.join(written)}"],
        "json": about.as_dict() | {"output": written},
    }


def _in_segments(chosen, data, length: int | None):
    """The method and the record with `--segment`: Welch's segments are its own, for others they are experiments."""
    from ..experiment import segments
    from ..frf.welch import Welch

    if length is None:
        return chosen, data
    if isinstance(chosen, Welch):
        return dataclasses.replace(chosen, segment=length), data
    return chosen, segments(data, length)


def _write_picture(given, frf) -> list[str]:
    if not given.plot:
        return []
    from .. import plot

    figure, _ = plot.bode([frf], [given.method], title=", ".join(pathlib.Path(name).name for name in given.data))
    plot.save(figure, given.plot)
    return [given.plot]


def _frf_writer(path: str, data: Sequence[str]):
    """How to write this file; said before the estimation, not after it."""
    from .. import io

    writers = dict.fromkeys(RECORD_FILES, io.write_frf) | dict.fromkeys((".uff", ".unv"), io.write_uff)
    check_target(path, writers)
    check_result(path, data, "measurement")
    return writers[pathlib.Path(path).suffix.lower()]
