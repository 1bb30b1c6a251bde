"""`jaxfrf excite`."""

import pathlib

from .._text import counted, number
from .arguments import check_picture, check_target, command

EXAMPLES = (
    "jaxfrf excite design.toml -o reference.nc",
    "jaxfrf excite design.toml -o reference.csv --plot design.png",
)


def add(commands) -> None:
    parser = command(commands, "excite", run, "Turn an excitation design into references that a controller can play.")
    parser.add_argument("design", metavar="DESIGN.toml")
    parser.add_argument("-o", "--output", required=True, help="reference to write: .nc, .mat or .csv")
    parser.add_argument("--plot", metavar="FILE", help="picture of the design (default: beside the output, .png)")


def run(given) -> dict:
    from .. import plot
    from .._files import check_writable
    from ..excitation import reference, reference_levels
    from ..io import read_design, write_reference
    from ..io.references import reference_files

    check_target(given.output, (".nc", ".mat", ".csv"))
    picture = pathlib.Path(given.plot) if given.plot else pathlib.Path(given.output).with_suffix(".png")
    check_picture(picture)
    design = read_design(given.design)
    for path in reference_files(given.output, design.n_exp):
        check_writable(path)
    made = reference(design)
    written = write_reference(given.output, made)
    plot.save(plot.multisine(made)[0].figure, picture)
    about = reference_levels(made)
    frequency = made.lines * made.fs / made.period
    text = [
        f"{made.n_exp} experiments of {counted(made.n_in, 'input')}, {made.n_time / made.fs:g} s each; "
        f"{len(made.lines)} lines from {number(frequency[0], 4)} to {number(frequency[-1], 4)} Hz",
        *(
            f"  input {i + 1}: rms {number(about.rms[:, i].max())}, peak speed {number(about.velocity[:, i].max())} "
            f"rad/s, crest factor {number(about.crest[:, i].max())}, up to {number(about.position[:, i].max())} rad "
            f"from rest and {number(about.acceleration[:, i].max())} rad/s^2"
            for i in range(made.n_in)
        ),
        *_step(made),
        f"wrote {', '.join(str(path) for path in (*written, picture))}",
        "next: play it, log r, u and y, then jaxfrf estimate",
    ]
    return {
        "text": text,
        "json": {
            "output": [str(path) for path in written],
            "plot": str(picture),
            "experiments": made.n_exp,
            "lines": len(made.lines),
            "band_hz": [float(frequency[0]), float(frequency[-1])],
            "crest_factor": about.crest.max(axis=0).tolist(),
            "first_speed": abs(made.r[:, 0]).max(axis=0).tolist(),
            "peak_speed": about.velocity.max(axis=0).tolist(),
            "peak_travel": about.position.max(axis=0).tolist(),
            "peak_acceleration": about.acceleration.max(axis=0).tolist(),
        },
    }


def _step(made) -> list[str]:
    """What a machine at rest is asked at once, where the design has no ramp."""
    speed, position = (float(abs(x[:, 0]).max()) for x in (made.r, made.position))
    if speed == 0.0 and position == 0.0:
        return []
    more = "" if made.transient_periods else " and transient_periods = 1"
    return [
        f"the reference begins with a step: up to {number(speed)} rad/s and {number(position)} rad at once; ramp = 2.0 "
        f"(s){more} in the design lets it start from rest"
    ]
