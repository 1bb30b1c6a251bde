"""The command line: `jaxfrf COMMAND ...`; every command is a few lines around public functions."""

import argparse
import contextlib
import json
import os
import pathlib
import sys
from collections.abc import Iterable, Iterator, Sequence

from . import __version__, _environment
from ._errors import InputError, input_error


def main(arguments=None) -> int:
    """Run a command; returns 0, or 2 after bad input, with one message on standard error."""
    parser = _parser()
    given = parser.parse_args(arguments)
    if given.command is None:
        parser.print_help()
        return 0
    _environment.prepare()
    try:
        summary = given.run(given)
    except (InputError, ImportError, OSError) as error:
        print(f"jaxfrf {given.command}: {_plain(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"jaxfrf {given.command}: interrupted; what was finished is kept (see --resume)", file=sys.stderr)
        return 130
    _print(json.dumps(summary.pop("json", summary), indent=1) if given.json else "\n".join(summary["text"]))
    return 0


def _print(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:  # the reader has seen enough (`| head`); Python would complain again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _plain(error: Exception) -> str:
    if isinstance(error, FileNotFoundError) and error.filename:
        return f"{error.filename}: no such file or folder"
    return str(error)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="jaxfrf", description=__doc__.split(":")[0] + " of jaxfrf.")
    parser.add_argument("--version", action="version", version=f"jaxfrf {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    _add_example(commands)
    _add_excite(commands)
    _add_simulate(commands)
    _add_estimate(commands)
    return parser


def _command(commands, name: str, run, text: str) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        name, help=text, description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON, and nothing else")
    parser.set_defaults(run=run)
    return parser


def _add_example(commands) -> None:
    parser = _command(commands, "example", _example, "Simulate a small closed-loop experiment and write its record.")
    parser.add_argument("-o", "--output", required=True, help="record to write: .nc, .mat or .npz")
    parser.add_argument("--blocks", type=int, default=2, help="blocks of two experiments (default 2)")
    parser.add_argument("--seed", type=int, default=0)


def _example(given) -> dict:
    from .examples import example
    from .io import write

    data = example(blocks=given.blocks, seed=given.seed)
    write(given.output, data)
    text = [
        f"two flexible axes in closed loop: {data.n_exp} experiments, {data.n_periods} steady periods of "
        f"{data.period / data.fs:g} s, {len(data.lines)} excited lines, seed {given.seed}",
        f"wrote {given.output}",
    ]
    return {"text": text, "output": given.output, "seed": given.seed, "experiments": data.n_exp}


def _add_excite(commands) -> None:
    parser = _command(
        commands, "excite", _excite, "Turn an excitation design into references that a controller can play."
    )
    parser.add_argument("design", metavar="DESIGN.toml")
    parser.add_argument("-o", "--output", required=True, help="reference to write: .nc, .mat or .csv")
    parser.add_argument("--plot", metavar="FILE", help="picture of the design (default: beside the output, .png)")


def _excite(given) -> dict:
    from . import plot
    from .excitation import levels, reference
    from .io import read_design, write_reference

    picture = pathlib.Path(given.plot) if given.plot else pathlib.Path(given.output).with_suffix(".png")
    _check_picture(picture)
    made = reference(read_design(given.design))
    written = write_reference(given.output, made)
    plot.save(plot.multisine(made)[0].figure, picture)
    about = levels(made)
    frequency = made.lines * made.fs / made.period
    text = [
        f"{made.n_exp} experiments of {made.n_in} input(s), {made.n_time / made.fs:g} s each; "
        f"{len(made.lines)} lines from {frequency[0]:.4g} to {frequency[-1]:.4g} Hz",
        *(
            f"  input {i + 1}: rms {about.rms[:, i].max():.3g}, peak speed {about.velocity[:, i].max():.3g} rad/s, "
            f"crest factor {about.crest[:, i].max():.3g}"
            for i in range(made.n_in)
        ),
        f"wrote {', '.join(str(path) for path in (*written, picture))}",
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
        },
    }


def _add_simulate(commands) -> None:
    parser = _command(commands, "simulate", _simulate, "Play a design on a simulated robot in closed loop.")
    parser.add_argument("robot", metavar="ROBOT.toml")
    parser.add_argument("design", metavar="DESIGN.toml")
    parser.add_argument("-o", "--output", required=True, help="record to write: .nc, .mat or .npz")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--positions", type=int, default=None, metavar="N", help="random positions (default 1)")
    place.add_argument(
        "--configurations", metavar="FILE", help="arm angles instead, rad: .csv or .txt, one row for each position"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random positions and the noise (default 0)")
    parser.add_argument(
        "--run-in", type=float, default=5.0, metavar="S", help="seconds before the record (default 5); see --transient"
    )
    parser.add_argument("--transient", action="store_true", help="record the transient periods of the design too")
    parser.add_argument("--noise", type=float, default=5e-5, help="rms of the position noise, rad (default 5e-5)")


def _simulate(given) -> dict:
    import jax.random as jr

    from .io import read_design, write
    from .io.robots import read_robot
    from .simulation import simulate

    target = pathlib.Path(given.output)
    if target.suffix.lower() not in (".nc", ".mat", ".npz"):
        raise InputError(f"{target}: found the suffix {target.suffix!r}; expected .nc, .mat or .npz. Rename it.")
    if not target.absolute().parent.is_dir():
        raise InputError(f"{target}: found no folder {target.parent}; expected one that exists. Make it first.")
    robot, design = read_robot(given.robot), read_design(given.design)
    places, noise = jr.split(jr.key(given.seed))
    data = simulate(
        robot,
        design,
        _positions(given, robot.n_axes, places),
        key=noise,
        run_in=None if given.transient else given.run_in,
        noise=given.noise,
        progress=None if given.json else _Percent("simulated"),
    )
    write(given.output, data)
    runs = data.n_pos * data.n_exp
    text = [
        f"{robot.name}: {runs} runs ({data.n_pos} positions, {data.n_exp} experiments) of "
        f"{data.n_time / data.fs:g} s, {data.n_periods} steady period(s) of {data.period / data.fs:g} s, "
        f"{len(data.lines)} excited lines, seed {given.seed}",
        f"wrote {given.output}",
    ]
    return {
        "text": text,
        "json": {
            "output": given.output,
            "robot": robot.name,
            "positions": data.n_pos,
            "experiments": data.n_exp,
            "samples": data.n_time,
            "lines": len(data.lines),
            "seed": given.seed,
            "y_quantity": data.y_quantity,
        },
    }


def _positions(given, axes: int, key):
    from .simulation import random_positions, read_positions

    if given.configurations:
        return read_positions(given.configurations, axes)
    count = 1 if given.positions is None else given.positions
    if count < 1:
        raise InputError(f"--positions: found {count}; expected 1 or more. Say how many.")
    return random_positions(count, key, axes)


class _Percent:
    """Prints the part that is done, in steps of ten per cent."""

    def __init__(self, what: str):
        self.what, self.said = what, 0

    def __call__(self, done: float) -> None:
        if int(10 * done) > self.said:
            self.said = int(10 * done)
            _say(f"{self.what} {10 * self.said} %")


def _add_estimate(commands) -> None:
    parser = _command(commands, "estimate", _estimate, "Estimate frequency response functions from records.")
    parser.add_argument("data", nargs="+", metavar="DATA", help="experiment files, .nc .mat .npz .csv: one data set")
    parser.add_argument("-o", "--output", required=True, help="FRF to write: .nc, .mat, .npz or .uff")
    parser.add_argument("--method", default="auto", help="estimator (default auto); --methods lists them")
    parser.add_argument("--methods", action=_ListMethods, nargs=0, help="list the estimators and stop")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="e.g. width=34, order=2")
    parser.add_argument(
        "--map", help="names in the files: u=iq_adx,y=omega_max,r=iq_refx; u=[tau1;tau2]; y=rec.act_vel"
    )
    parser.add_argument(
        "--set", help="what the files do not say: fs=2500,period=2500,transient_periods=1,samples=0:18720"
    )
    parser.add_argument("--scale", help="factors to SI units: y=0.0174532925")
    parser.add_argument(
        "--periods", metavar="A:B", help="use only these steady periods, counted from 0, B not included"
    )
    parser.add_argument("--band", metavar="LOW:HIGH", help="use only the lines in this band, Hz")
    parser.add_argument("--plot", metavar="FILE", help="Bode picture to write: .png, .pdf, .svg")
    parser.add_argument("--resume", action="store_true", help="go on with a run that was interrupted")


class _ListMethods(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        from .frf.catalogue import METHODS

        print("\n".join(f"{name:16}  {text}" for name, (text, _) in METHODS.items()))
        parser.exit(0)


def _estimate(given) -> dict:
    from . import io
    from .frf.catalogue import method
    from .pipeline import estimate_resumable, spectra_of, summary

    _check_x64()
    write = _frf_writer(given.output, given.data)
    if given.plot:
        _check_picture(given.plot)
    chosen = method(given.method, _options(given.option))
    periods, band = _range("--periods", given.periods, int), _range("--band", given.band, float)
    data = io.read(
        *given.data,
        names=io.parse_map(given.map) if given.map else None,
        values=io.parse_values(given.set) if given.set else None,
        scale=io.parse_scale(given.scale) if given.scale else None,
    )
    with _naming(given.data):
        spectra = spectra_of(data, chosen, periods=periods, band=band)
        frf = estimate_resumable(spectra, chosen, given.output, resume=given.resume, say=None if given.json else _say)
    write(given.output, frf)
    written = [given.output]
    if given.plot:
        from . import plot

        figure, _ = plot.bode([frf], [given.method], title=", ".join(pathlib.Path(name).name for name in given.data))
        plot.save(figure, given.plot)
        written.append(given.plot)
    about = summary(spectra, frf)
    for warning in frf.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return {
        "text": [*about.lines(), f"wrote {', '.join(written)}"],
        "json": about.as_dict() | {"output": written},
    }


@contextlib.contextmanager
def _naming(files: Sequence[str]) -> Iterator[None]:
    """What is wrong with the data names the files."""
    try:
        yield
    except InputError as error:
        name = pathlib.Path(files[0]).name
        if str(error).startswith(name):
            raise
        more = f" and {len(files) - 1} more" if len(files) > 1 else ""
        raise InputError(f"{name}{more}: {error}") from None


def _check_x64() -> None:
    from ._types import require_x64

    try:
        require_x64("jaxfrf estimate")
    except ValueError as error:
        raise InputError(str(error)) from None


def _frf_writer(path: str, data: Sequence[str]):
    """How to write this file; said before the estimation, not after it."""
    from . import io

    writers = dict.fromkeys((".nc", ".mat", ".npz"), io.write_frf) | dict.fromkeys((".uff", ".unv"), io.write_uff)
    _check_target(path, writers)
    target = pathlib.Path(path)
    if target.resolve() in [pathlib.Path(name).resolve() for name in data]:
        raise input_error(path, "the measurement itself", "another file for the FRF", "Choose another name.")
    return writers[target.suffix.lower()]


def _check_picture(path: str | os.PathLike) -> None:
    from .io._optional import require

    figure = require("matplotlib.figure", "plot").Figure()
    _check_target(path, [f".{kind}" for kind in sorted(figure.canvas.get_supported_filetypes())])


def _check_target(path: str | os.PathLike, suffixes: Iterable[str]) -> None:
    """Refuse what could not be written, before anything is estimated or written."""
    target = pathlib.Path(path)
    if target.suffix.lower() not in suffixes:
        raise input_error(str(path), f"the suffix {target.suffix!r}", f"one of {', '.join(suffixes)}", "Rename it.")
    if not target.absolute().parent.is_dir():
        raise input_error(str(path), f"no folder {target.parent}", "one that exists", "Make it first.")


def _options(pairs) -> dict[str, str]:
    options = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--option: found {pair!r}; expected KEY=VALUE. Write e.g. --option width=34.")
        options[key.strip()] = value.strip()
    return options


def _range(option: str, text: str | None, kind) -> tuple | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        if not colon:
            raise ValueError
        return kind(first) if first else None, kind(last) if last else None
    except ValueError:
        raise input_error(option, repr(text), "FROM:TO", "Write e.g. --periods 0:1 or --band 4:80.") from None


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
