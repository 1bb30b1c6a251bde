"""What several commands share: options, checks before long work, progress."""

import argparse
import contextlib
import os
import pathlib
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from .._errors import InputError, OutputError, input_error
from .._files import check_readable, check_writable
from ..io._toml import read_toml
from .known_methods import check_method
from .progress import wipe_progress

_SMALLEST = 1e9  # bytes, that Python, JAX and a block take
_QUICK = 5e6  # bytes that are read twice without being noticed


def command(commands, name: str, run, text: str) -> argparse.ArgumentParser:
    parser = commands.add_parser(
        name,
        help=text,
        description=text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,  # --heldout 5 would be taken as --heldout-count 5
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON, and nothing else")
    parser.set_defaults(run=run)
    return parser


def add_record_options(parser: argparse.ArgumentParser, method: str | None, default: str) -> None:
    """How records are read and turned into an FRF."""
    estimator = parser.add_argument(
        "--method", default=method, help=f"estimator (default {default}); --methods lists them"
    )
    estimator.completer = _methods  # type: ignore[attr-defined]
    parser.add_argument("--methods", action=_ListMethods, nargs=0, help="list the estimators and stop")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="e.g. width=34, order=2")
    add_reading_options(parser)
    parser.add_argument(
        "--periods", metavar="A:B", help="use only these steady periods, counted from 0, B not included"
    )
    parser.add_argument("--band", metavar="LOW:HIGH", help="use only the lines in this band, Hz")


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """What files call their signals, and what they do not say of them."""
    parser.add_argument(
        "--map",
        action=_Joined,
        help="names in the files: u=iq_adx,y=omega_max,r=iq_refx; u=[tau1;tau2]; y=rec.act_vel; u=a.csv:tau1; columns "
        "without headings by number, from 1",
    )
    parser.add_argument(
        "--set",
        action=_Joined,
        help="what the files do not say: fs=2500,period=2500,transient_periods=1,samples=0:18720,y_unit=deg/s",
    )
    parser.add_argument("--factor", action=_Joined, help="factors to SI units: y=0.0174532925")
    add_renamed_option(parser, "--scale", "--factor")
    add_anyway_option(parser)


def add_renamed_option(parser: argparse.ArgumentParser, before: str, now: str) -> None:
    """An option by the name that it had: told, since that means something else in another command."""
    parser.add_argument(before, action=_Renamed, const=now, dest=argparse.SUPPRESS, help=argparse.SUPPRESS)


class _Renamed(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        parser.error(f"{option_string}: found a name of before; expected {self.const}. Write {self.const} {values}.")


class _Joined(argparse.Action):
    """Settings of several such options add up: `--factor u=10 --factor y=2` is `--factor u=10,y=2`."""

    def __call__(self, parser, namespace, values, option_string=None):
        before = getattr(namespace, self.dest)
        setattr(namespace, self.dest, values if before is None else f"{before},{values}")


def _methods(**asked) -> list[str]:
    """What the shell completes `--method` with."""
    from ..frf.catalogue import METHODS

    return list(METHODS)


def add_anyway_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--anyway", action="store_true", help="use records that were found useless, e.g. with a period they contradict"
    )


def add_resume_option(parser: argparse.ArgumentParser) -> None:
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--resume", action="store_true", help="go on with a run of the same options that was interrupted (OUTPUT.parts)"
    )
    group.add_argument(
        "--restart", action="store_true", help="delete what an interrupted run left in OUTPUT.parts and begin anew"
    )


def add_memory_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--memory", type=_bytes, metavar="SIZE", help="that a process may take, e.g. 2GB (default: by what is free)"
    )


def check_whole(given: argparse.Namespace, program: float, copies: float) -> None:
    """Refuse records that are read whole and take more than `--memory` says, or, without it, more than is free.

    **Arguments:** `program`: bytes that the command takes beside them. `copies`: of the records, that it holds."""
    from .._memory import available_memory, size_text
    from ..io._container import size_in

    size = sum(size_in(path) for path in given.data)
    needed = copies * size + (0.0 if given.memory is None else program)
    limit = available_memory() if given.memory is None else given.memory
    if needed > limit:
        allowed = f"the {size_text(limit)} that are free" if given.memory is None else f"--memory {size_text(limit)}"
        names, held = [pathlib.Path(path).name for path in given.data], f"it holds them whole, {copies:g} times"
        raise input_error(
            ", ".join(names[:3]) + (" ..." if len(names) > 3 else ""),
            f"{size_text(size)} of records, for which `{given.command}` takes some {size_text(needed)} ({held})",
            f"at most {allowed}",
            "Give fewer positions or experiments at a time, or more memory; `estimate` takes any size.",
        )


_UNITS = {"": 1.0, "B": 1.0, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "MIB": 2.0**20, "GIB": 2.0**30}


def _bytes(text: str) -> float:
    found = re.fullmatch(r"\s*([0-9.]+)\s*([A-Za-z]*)\s*", text) or ("", "", "")
    try:
        size = float(found[1]) * _UNITS[found[2].upper()]
    except (TypeError, KeyError, ValueError):
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a size. Write e.g. 2GB or 500MB.") from None
    if size < _SMALLEST:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected {_SMALLEST / 1e9:g}GB or more.")
    return size


def kept_parts(given: argparse.Namespace, about=None):
    """Where a command keeps what it has finished, as --resume and --restart say."""
    from ..parts import Parts

    return Parts(given.output, given.command, resume=given.resume, restart=given.restart, about=about, say=say)


class _ListMethods(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        from ..frf.catalogue import METHODS

        print("\n".join(f"{name:16}  {text}" for name, (text, _) in METHODS.items()))
        parser.exit(0)


def read_records(given: argparse.Namespace, files: Sequence[str]):
    """The experiment in these files, as `--map`, `--set` and `--factor` say."""
    from .. import io

    return io.read(*files, **_how(given))


def _how(given: argparse.Namespace) -> dict[str, Any]:
    from .. import io

    return {
        "names": io.parse_map(given.map) if given.map else None,
        "values": io.parse_values(given.set) if given.set else None,
        "factor": io.parse_factor(given.factor) if given.factor else None,
        "anyway": given.anyway,
    }


def data_set(given: argparse.Namespace):
    """The same, to be read some positions at a time."""
    from .. import io
    from ..io.blocks import data_set, in_memory

    how = _how(given)
    return data_set(*given.data, **how) or in_memory(io.read(*given.data, **how))


def read_each(given: argparse.Namespace) -> list:
    """One record a file; one of all files where `--map` says which file a signal is in."""
    from ..io.records import read_each

    return read_each(*given.data, **_how(given))


def reading_words(given: argparse.Namespace) -> list[str]:
    """The words that say how the files are read, for another command on them."""
    words = [x for name in ("map", "set", "factor") if (said := getattr(given, name)) for x in (f"--{name}", said)]
    return [*words, "--anyway"] if given.anyway else words


@contextlib.contextmanager
def naming(files: Sequence[str]) -> Iterator[None]:
    """What is wrong with the data names the files."""
    try:
        yield
    except OutputError:
        raise
    except InputError as error:
        name = pathlib.Path(files[0]).name
        if str(error).startswith(name):
            raise
        more = f" and {len(files) - 1} more" if len(files) > 1 else ""
        raise InputError(f"{name}{more}: {error}") from None


def check_x64(who: str) -> None:
    from .._types import require_x64

    try:
        require_x64(who)
    except ValueError as error:
        raise InputError(str(error)) from None


_READ = {
    "data": "a measurement file",
    "frf": "an FRF",
    "robot": "a robot, .toml or .urdf",
    "design": "a design, .toml",
    "effects": "a Python file (.py) that defines effects",
    "configurations": "arm angles, .csv or .txt",
}


_TOML = {
    "robot": ("a robot in TOML", "`jaxfrf example -o run.nc --robot-out ROBOT.toml` writes one."),
    "design": ("a design in TOML", "The page keys.md of the book shows every key."),
}


def check_inputs(given: argparse.Namespace) -> None:
    """Files that are not there, and the syntax of options, before anything large is imported."""
    if hasattr(given, "method"):
        check_method(given.method, options_of(given.option))
    for name, kind in (("periods", int), ("band", float)):
        range_of(f"--{name}", getattr(given, name, None), kind)
    for name, what in _READ.items():
        paths = getattr(given, name, None) or ()
        for path in [paths] if isinstance(paths, str) else paths:
            check_readable(pathlib.Path(path), what)
            if name in _TOML and str(path).lower().endswith(".toml"):
                read_toml(pathlib.Path(path), *_TOML[name])
    _check_variables(given)


def _check_variables(given: argparse.Namespace) -> None:
    """Names of `--map` in files that are quickly read, before JAX is imported."""
    files = getattr(given, "data", None)
    if not files or not hasattr(given, "map"):
        return
    from ..io.record_arguments import parse_factor, parse_map, parse_values

    names = parse_map(given.map) if given.map else {}
    for text, parse in ((given.set, parse_values), (given.factor, parse_factor)):
        if text:
            parse(text)
    path = pathlib.Path(files[0])
    if len(files) > 1 or path.suffix.lower() not in (".csv", ".npz", ".mat", ".txt") or path.stat().st_size > _QUICK:
        return
    from ..io._container import load
    from ..io._select import missing, select

    variables = load(path)
    if {"G", "frequency"} <= set(variables):  # some commands take FRFs; the others say so when they read it
        return
    for key in ("u", "y", *(k for k in names if k not in ("u", "y"))):
        if names.get(key, key) == key and key not in variables:
            raise missing(path, variables, key, key)
        select(path, variables, key, names.get(key, key))


def check_seed(seed: int) -> None:
    if not 0 <= seed < 2**53:
        raise input_error("--seed", f"{seed}", "a whole number from 0 to 2^53", "Choose another.")


def check_picture(path: str | os.PathLike) -> None:
    from ..io._optional import require

    figure = require("matplotlib.figure", "plot").Figure()
    check_target(path, [f".{kind}" for kind in sorted(figure.canvas.get_supported_filetypes())])


def check_target(path: str | os.PathLike, suffixes: Iterable[str]) -> None:
    """Refuse what could not be written, by trying, before anything long is done: for every output of every command."""
    suffix = pathlib.Path(path).suffix
    if suffix.lower() not in suffixes:
        raise input_error(str(path), f"the suffix {suffix!r}", f"one of {', '.join(suffixes)}", "Rename it.")
    check_writable(path)


def check_result(path: str, inputs: Iterable[str], what: str) -> None:
    """Refuse to put a result in the place of what it is made from."""
    if os.path.realpath(path) in [os.path.realpath(name) for name in inputs]:
        raise input_error(path, f"the {what} itself", "another file for the result", "Choose another name.")


def options_of(pairs) -> dict[str, str]:
    options = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--option: found {pair!r}; expected KEY=VALUE. Write e.g. --option width=34.")
        options[key.strip()] = value.strip()
    return options


def range_of(option: str, text: str | None, kind) -> tuple | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        if not colon:
            raise ValueError
        return kind(first) if first else None, kind(last) if last else None
    except ValueError:
        raise input_error(option, repr(text), "FROM:TO", "Write e.g. --periods 0:1 or --band 4:80.") from None


def add_tolerance_option(parser) -> None:
    parser.add_argument(
        "--tolerance",
        metavar="KEY=VALUE,...",
        help="how well numbers are known, before what the robot's file says: links=0.02,friction=0.3, "
        'joint6.mass=unknown, "joint6.mass=0.1 kg", all=0',
    )


def with_tolerances(robot, text: str | None):
    """The robot with what --tolerance says of it."""
    if text is None:
        return robot
    from ..robot.tolerances import tolerances_from

    table: dict[str, float | str] = {}
    for pair in text.split(","):
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals or not key or not value:
            raise InputError(f"--tolerance: found {pair!r}; expected KEY=VALUE. Write e.g. --tolerance links=0.02.")
        try:
            table[key] = float(value)
        except ValueError:
            table[key] = value
    return robot.with_tolerances(tolerances_from(table, robot.joint_names, "--tolerance"))


def say(text: str) -> None:
    wipe_progress()
    print(text, file=sys.stderr, flush=True)
