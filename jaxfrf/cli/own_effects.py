"""Effects of the user's own, from a Python file."""

import argparse
import importlib.util
import inspect
import os
import pathlib
import sys
import traceback
from typing import TYPE_CHECKING

from .._errors import input_error

if TYPE_CHECKING:
    from ..effects import AbstractEffect

_HELP = "effects of your own, a Python file: it is executed, with all that stands in it"
_STATED = ("name", "units", "bounds", "signature", "confusable")


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--effects", metavar="FILE.py", help=_HELP)


def robot_of(given):
    """The robot that a command is given, with the effects that `--effects` defines known."""
    from ..io.robots import read_robot

    return read_robot(given.robot, own_effects(given.effects) if given.effects else ())


def about(given) -> dict[str, str]:
    """What finished parts of a command depend on, that no robot shows: the laws in the file."""
    if not given.effects:
        return {}
    from ..io.responses import source
    from ..parts import files_text

    return {"--effects": files_text([source(given.effects)])}


def own_effects(path: str | os.PathLike) -> tuple[type["AbstractEffect"], ...]:
    """Every effect (subclass of `jaxfrf.effects.AbstractEffect`) that a Python file defines. The file is executed.

    **Raises:** `jaxfrf.InputError` if the file is missing or fails, defines no effect, or one that is not complete or
    has a name that is taken.
    """
    from ..effects import AbstractEffect

    path = pathlib.Path(path)
    module = _imported(path)
    kinds = [x for x in vars(module).values() if inspect.isclass(x) and issubclass(x, AbstractEffect)]
    kinds = [x for x in dict.fromkeys(kinds) if x.__module__ == module.__name__]
    whole = tuple(x for x in kinds if not _lacking(x))
    if not whole:
        lacks = "; ".join(f"{x.__name__} lacks {', '.join(_lacking(x))}" for x in kinds)
        raise input_error(
            str(path),
            f"no complete effect ({lacks})" if lacks else "no effect",
            "a subclass of jaxfrf.effects.AbstractFriction or another base class there",
            "See `jaxfrf.effects.AbstractEffect` for what it states.",
        )
    _check_whole(path, whole)
    return whole


def _imported(path: pathlib.Path):
    if not path.is_file() or path.suffix != ".py":
        found = "no such file" if not path.is_file() else f"the suffix {path.suffix!r}"
        raise input_error(
            str(path), found, "a Python file (.py) that defines effects", "Check the name and the folder."
        )
    name = f"jaxfrf_own_effects_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # of a file that is there and ends with .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look for the module of a class
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # what a user's file may raise is anybody's guess
        line = getattr(error, "lineno", None) or _line(error, path)
        raise input_error(
            str(path),
            f"{type(error).__name__} in line {line}: {str(error).splitlines()[0] if str(error) else ''}".rstrip(": "),
            "a file that Python can import",
            "Correct it there.",
        ) from error
    return module


def _line(error: Exception, path: pathlib.Path) -> int | str:
    own = [x.lineno for x in traceback.extract_tb(error.__traceback__) if pathlib.Path(x.filename) == path]
    return own[-1] or "?" if own else "?"


def _lacking(kind: type) -> list[str]:
    """What keeps a class from being an effect."""
    methods = sorted(getattr(kind, "__abstractmethods__", ()))
    fields = sorted(getattr(kind, "__abstractvars__", ()))
    return [*methods, *fields, *(name for name in _STATED if not hasattr(kind, name))]


def _check_whole(path: pathlib.Path, kinds: tuple[type["AbstractEffect"], ...]) -> None:
    from ..effects import library

    taken = dict.fromkeys(library(), "the library's")
    for kind in kinds:
        if kind.name in taken:
            owner = taken[kind.name]
            raise input_error(
                f"{path}: {kind.__name__}", f"the name {kind.name!r}, which is {owner}", "another name", "Rename it."
            )
        taken[kind.name] = f"{kind.__name__}'s"
        unbounded = sorted(set(kind.units) - set(kind.bounds))
        if unbounded or not kind.units:
            raise input_error(
                f"{path}: {kind.__name__}",
                f"no bounds of {', '.join(unbounded)}" if unbounded else "no parameter in units",
                "units and bounds of every parameter",
                "State them as class attributes.",
            )
