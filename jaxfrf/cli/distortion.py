"""`jaxfrf distortion`."""

import pathlib

from ..io._formats import RECORDS, SAVED
from .arguments import (
    add_record_options,
    check_picture,
    check_result,
    check_target,
    check_x64,
    command,
    naming,
    options_of,
    range_of,
    read_records,
)
from .remarks import warn

EXAMPLES = ("jaxfrf distortion run.nc -o frf.nc --plot levels.png",)


def add(commands) -> None:
    parser = command(
        commands,
        "distortion",
        run,
        "Estimate the best linear approximation, and tell noise, even and odd distortion apart.",
    )
    parser.add_argument("data", nargs="+", metavar="DATA", help=f"periodic records, one data set: {' '.join(RECORDS)}")
    parser.add_argument("-o", "--output", help=f"FRF to write, with the total level: {' '.join(SAVED)}")
    parser.add_argument("--plot", metavar="FILE", help="picture of the levels to write: .png, .pdf, .svg")
    add_record_options(parser, method="auto", default="auto")


def run(given) -> dict:
    from ..experiment import select_periods
    from ..frf.catalogue import method
    from ..frf.distortion import distortion_of
    from ..frf.estimate import estimate
    from ..frf.from_record import spectra_of
    from ..pipeline import distortion_summary

    check_x64("jaxfrf distortion")
    if given.output:
        check_target(given.output, SAVED)
        check_result(given.output, given.data, "measurement")
    if given.plot:
        check_picture(given.plot)
    chosen = method(given.method, options_of(given.option))
    periods, band = range_of("--periods", given.periods, int), range_of("--band", given.band, float)
    data = read_records(given, given.data)
    with naming(given.data):
        if periods is not None:
            data = select_periods(data, periods[0] or 0, periods[1])
        found = distortion_of(estimate(spectra_of(data, chosen, band=band), chosen), data)
    written = _write(given, found)
    warn(found.frf.warnings)
    about = distortion_summary(found)
    return {
        "text": [*about.lines(), *([f"wrote {', '.join(written)}"] if written else []), *_next(given, about)],
        "json": about.as_dict() | {"output": written},
    }


def _write(given, found) -> list[str]:
    from .. import io, plot

    written = []
    if given.output:
        io.write_frf(given.output, found.frf)
        written.append(given.output)
    if given.plot:
        figure, _ = plot.distortion(found, title=", ".join(pathlib.Path(name).name for name in given.data))
        plot.save(figure, given.plot)
        written.append(given.plot)
    return written


def _next(given, about) -> list[str]:
    cause = (
        ["which spring or friction it may be: jaxfrf.machine, howto/machine.md in the book"] if about.is_clear else []
    )
    if given.output:
        return [f"next: {'; '.join([f'jaxfrf view {given.output}', *cause])}"]
    look = f"look at {given.plot}" if given.plot else "--plot levels.png shows the levels"
    return [f"next: {'; '.join([look, '-o frf.nc keeps the FRF with its total level', *cause])}"]
