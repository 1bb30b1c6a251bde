"""The command line: `jaxfrf COMMAND ...`; every command is a few lines around public functions."""

import argparse
import contextlib
import difflib
import json
import os
import signal
import sys
import threading
from collections.abc import Mapping
from typing import Any, NoReturn

from . import __version__, _environment
from ._errors import InputError
from .cli import COMMANDS
from .cli.arguments import check_inputs
from .cli.each import check_alone, run_each

_EPILOG = """begin with:
  jaxfrf example -o run.nc
  jaxfrf estimate run.nc -o frf.nc --report frf.html

jaxfrf COMMAND --help shows the options of a command and examples.

exit codes:
  0    done
  1    with --each: some files failed, the others are done; otherwise an
       error of the program itself, with its traceback
  2    bad input or usage: one message on standard error, no result
  130  interrupted (Ctrl-C); finished parts are kept where the message says so
  143  told to end (SIGTERM); finished parts are kept as after Ctrl-C
"""


def main(arguments=None) -> int:
    """Run a command; returns 0, 1 where some files of many failed, or, with one message on standard error, 2 after bad
    input, 130 where it was interrupted and 143 where it was told to end. Errors of the program itself are raised."""
    parser = _parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks for completions
        import argcomplete

        argcomplete.autocomplete(parser)
    given, unknown = parser.parse_known_args(arguments)
    if unknown:
        parser.chosen(given.command).error(f"unrecognized arguments: {' '.join(unknown)}")
    if given.command is None:
        _print(parser.format_help().rstrip())
        return 0
    _environment.prepare()
    try:
        with _told_to_end():
            return _run(given)
    except (InputError, ImportError, OSError) as error:
        return _stopped(given.command, _plain(error), error, 2)
    except (MemoryError, RecursionError) as error:
        return _stopped(given.command, _too_large(error), error, 2)
    except _ToldToEnd as error:
        return _stopped(given.command, "told to end.", error, 143)
    except KeyboardInterrupt as error:
        return _stopped(given.command, "interrupted.", error, 130)


def _run(given) -> int:
    if getattr(given, "each", False):
        summary = run_each(given)
    else:
        check_alone(given)
        check_inputs(given)
        summary = given.run(given)
    code, text = summary.pop("code", 0), summary.pop("text")
    _print(_as_json(summary.pop("json", summary)) if given.json else "\n".join(text))
    return code


def _as_json(summary: Mapping[str, Any]) -> str:
    from .io._json import plain_data

    return json.dumps(plain_data(summary), indent=1, allow_nan=False)


class _ToldToEnd(KeyboardInterrupt):
    """SIGTERM: what schedulers and containers send before they kill. What was finished is kept as after Ctrl-C."""


@contextlib.contextmanager
def _told_to_end():
    def end(number, frame):
        raise _ToldToEnd

    here = threading.current_thread() is threading.main_thread()
    if not here or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:  # someone else's program
        yield
        return
    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _print(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:  # the reader has seen enough (`| head`); Python would complain again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _stopped(command: str, text: str, error: BaseException, code: int) -> int:
    """Say why, with what was noted on the way (what is kept, what was not written)."""
    notes = getattr(error, "__notes__", ())
    print(f"jaxfrf {command}:", f"{text.rstrip('.')}." if notes else text, *notes, file=sys.stderr, flush=True)
    if code > 128:
        _leave_threads(code)
    return code


def _leave_threads(code: int) -> None:
    """End at once where threads go on with steps that nobody waits for: Python would abort in the middle of their
    compiled code, and files are whole at any time."""
    from .parts import BESIDE

    if any(thread.name == BESIDE for thread in threading.enumerate()):
        os._exit(code)


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


class _Parser(argparse.ArgumentParser):
    """Errors say what was probably meant."""

    _asked: list[str]

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[override]
        self._asked = sys.argv[1:] if args is None else list(args)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        super().error(message + "".join(f" (did you mean {x}?)" for x in self._meant()))

    def chosen(self, command: str | None) -> argparse.ArgumentParser:
        """The parser of a command; this one where there is none."""
        return self if command is None else self._commands()[command]

    def _commands(self) -> dict[str, argparse.ArgumentParser]:
        found = (a for a in self._actions if isinstance(a, argparse._SubParsersAction))
        return next((dict(a.choices) for a in found), {})

    def _meant(self) -> list[str]:
        options, commands = list(self._option_string_actions), list(self._commands())
        first = next((x for x in self._asked if not x.startswith("-")), None)
        if commands and first is not None:
            return [] if first in commands else difflib.get_close_matches(first, commands, 1)
        said = [x.partition("=")[0] for x in self._asked if x.startswith("--") and len(x) > 2]
        wrong = [x for x in said if x not in options]
        return [near for x in wrong for near in difflib.get_close_matches(x, options, 1)]


def _parser() -> _Parser:
    parser = _Parser(
        prog="jaxfrf",
        description="From the records of an experiment to frequency response functions, to the parameters of a model, "
        "to what the model is missing.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
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
