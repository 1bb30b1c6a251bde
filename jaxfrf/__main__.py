"""The command line: `jaxfrf COMMAND ...`; every command is a few lines around public functions."""

import argparse
import json
import os
import sys

from . import __version__, _environment
from ._commands import COMMANDS
from ._commands.arguments import check_inputs
from ._commands.each import check_alone, run_each
from ._errors import InputError

_EPILOG = """begin with:
  jaxfrf example -o run.nc
  jaxfrf estimate run.nc -o frf.nc --report frf.html

jaxfrf COMMAND --help shows the options of a command and examples.

exit codes:
  0    done
  1    with --each: some files failed, the others are done
  2    bad input or usage: one message on standard error, no result
  130  interrupted; finished parts are kept where the message says so
"""


def main(arguments=None) -> int:
    """Run a command; returns 0, 1 where some files of many failed, or 2 after bad input, with one message on standard
    error."""
    parser = _parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks for completions
        import argcomplete

        argcomplete.autocomplete(parser)
    given = parser.parse_args(arguments)
    if given.command is None:
        _print(parser.format_help().rstrip())
        return 0
    _environment.prepare()
    try:
        if getattr(given, "each", False):
            summary = run_each(given)
        else:
            check_alone(given)
            check_inputs(given)
            summary = given.run(given)
    except (InputError, ImportError, OSError) as error:
        return _stopped(given.command, _plain(error), error, 2)
    except (MemoryError, RecursionError) as error:
        return _stopped(given.command, _too_large(error), error, 2)
    except KeyboardInterrupt as error:
        return _stopped(given.command, "interrupted.", error, 130)
    code = summary.pop("code", 0)
    _print(json.dumps(summary.pop("json", summary), indent=1) if given.json else "\n".join(summary["text"]))
    return code


def _print(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:  # the reader has seen enough (`| head`); Python would complain again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _stopped(command: str, text: str, error: BaseException, code: int) -> int:
    """Say why, with what was noted on the way (what is kept, what was not written)."""
    notes = getattr(error, "__notes__", ())
    print(f"jaxfrf {command}:", f"{text.rstrip('.')}." if notes else text, *notes, file=sys.stderr)
    return code


def _too_large(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return "the input is nested too deeply to be read. Simplify it."
    return (
        f"there is not enough memory ({str(error) or 'MemoryError'}). Cut the record, or take fewer lines or positions."
    )


def _plain(error: Exception) -> str:
    if isinstance(error, FileNotFoundError) and error.filename:
        return f"{error.filename}: no such file or folder"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="jaxfrf",
        description=__doc__.split(":")[0] + " of jaxfrf.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"jaxfrf {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
        shown = "\n".join(f"  {example}" for example in command.EXAMPLES)
        commands.choices[command.__name__.rpartition(".")[2]].epilog = f"examples:\n{shown}"
    return parser


if __name__ == "__main__":
    sys.exit(main())
