"""`jaxfrf modal`."""

import pathlib

from .._errors import input_error
from .._text import NORMAL_95, counted, number, plus_minus
from ..io._formats import FRFS
from .arguments import check_picture, check_result, check_target, command, naming, range_of

EXAMPLES = (
    "jaxfrf modal frf.nc -o modes.json --plot stabilisation.png",
    "jaxfrf modal frf.nc -o modes.json --near 24,32 --band 5:60",
)


def add(commands) -> None:
    parser = command(commands, "modal", run, "Find the modes of an FRF: frequencies, damping, residues, intervals.")
    parser.add_argument("frf", metavar="FRF", help=f"FRF: {' '.join(FRFS)}")
    parser.add_argument("-o", "--output", required=True, help="modes to write: .json")
    parser.add_argument("--plot", metavar="FILE", help="stabilisation diagram to write: .png, .pdf, .svg")
    parser.add_argument("--band", metavar="LOW:HIGH", help="use only the lines in this band, Hz")
    parser.add_argument("--order", type=int, metavar="N", help="highest model order (default 30, or what lines allow)")
    parser.add_argument("--near", metavar="HZ,...", help="take the modes near these, not the automatic choice")
    parser.add_argument("--delay", type=float, metavar="S", help="dead time, where it is known (default: found)")
    parser.add_argument("--position", type=int, default=0, metavar="P", help="operating point, from 0 (default 0)")


def run(given) -> dict:
    from ..frf.modal import modal
    from ..io._json import write_json
    from ..io.responses import read_frf

    check_target(given.output, (".json",))
    check_result(given.output, [given.frf], "FRF")
    if given.plot:
        check_picture(given.plot)
    near, band = _frequencies(given.near), range_of("--band", given.band, float)
    frf = read_frf(given.frf)
    with naming([given.frf]):
        found = modal(frf, position=given.position, band=band, max_order=given.order, near=near, delay=given.delay)
    contents = _contents(found, given.frf)
    write_json(given.output, contents)
    written = [given.output]
    if given.plot:
        from .. import plot

        plot.save(plot.stabilisation(found, title=pathlib.Path(given.frf).name)[0], given.plot)
        written.append(given.plot)
    next_step = f"look at {given.plot}: do the modes stay from order to order?" if given.plot else "--plot shows them"
    text = [*_lines(found), f"wrote {', '.join(written)}", f"next: {next_step}"]
    return {"text": text, "json": contents | {"output": written}}


def _contents(found, source: str) -> dict:
    return {
        "frf": source,
        "misfit": found.misfit,
        "delay_s": found.delay,
        "delay_std": found.delay_std,
        "modes": [
            {
                "frequency_hz": m.frequency,
                "frequency_std": m.frequency_std,
                "damping": m.damping,
                "damping_std": m.damping_std,
                "residue_real": m.residue.real,
                "residue_imag": m.residue.imag,
                "residue_std": m.residue_std,
                "significance": m.significance,
            }
            for m in found.modes
        ],
        "lags": [{"frequency_hz": m.frequency, "damping": m.damping} for m in found.lags],
        "outside_hz": [m.frequency for m in found.outside],
        "dropped_hz": found.dropped,
    }


def _lines(found) -> list[str]:
    failed = not found.modes and found.misfit > 2
    what = "no mode could be fitted" if failed else counted(len(found.modes), "mode")
    lines = [f"{what} from {number(found.frequency[0], 4)} to {number(found.frequency[-1], 4)} Hz (95 %)"]
    lines += [
        f"  {plus_minus(m.frequency, NORMAL_95 * m.frequency_std)} Hz, damping "
        f"{plus_minus(100 * m.damping, 100 * NORMAL_95 * m.damping_std)} %"
        for m in found.modes
    ]
    lines += [f"  a lag at {number(m.frequency, 2)} Hz, damped too much to be a mode" for m in found.lags]
    if found.outside:
        at = ", ".join(f"{number(m.frequency, 3)} Hz" for m in found.outside)
        lines.append(f"  beside the band something at {at}: widen it to see what")
    if found.delay_std:
        lines.append(f"  a delay of {plus_minus(1e3 * found.delay, 1960 * found.delay_std)} ms")
    if found.doubt:
        lines.append(found.doubt)
    return lines


def _frequencies(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(x) for x in text.split(",")]
    except ValueError:
        raise input_error("--near", repr(text), "frequencies in Hz", "Write e.g. --near 12.5,31.") from None
