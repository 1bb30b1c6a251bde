"""Names of methods and of their options, read from the source: to import them takes seconds."""

import ast
import difflib
import pathlib
import sys
from collections.abc import Iterator, Mapping, Sequence

from .._errors import input_error

_LOADED = "jaxfrf.frf.catalogue"
_ROOM = pathlib.Path(__file__).parent.parent / "frf"


def check_method(name: str | None, options: Mapping[str, str]) -> None:
    """Refuse a method that the catalogue does not name, and an option that no method has. Where the catalogue is loaded
    (it says more), or its source not at hand or written otherwise, nothing is refused here.

    **Raises:** `jaxfrf.InputError` with the names there are, as `jaxfrf.frf.catalogue.method` would.
    """
    if _LOADED in sys.modules:
        return
    methods, aliases = _keys("METHODS"), _keys("ALIASES")
    if name is not None and methods and name not in (*methods, *aliases):
        raise input_error("method", repr(name), f"one of {', '.join(methods)}", _nearest(name, [*methods, *aliases]))
    if not options:
        return
    known = set(_fields())
    wrong = [option for option in options if known and option not in known]
    if wrong:
        raise input_error(
            f"option {wrong[0]}", "one that no method has", "an option of the method", _nearest(wrong[0], sorted(known))
        )


def _nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f"Did you mean {near[0]}?" if near else "jaxfrf estimate --methods lists the methods."


def _trees(pattern: str) -> Iterator[ast.Module]:
    for path in sorted(_ROOM.glob(pattern)):
        try:
            yield ast.parse(path.read_text(encoding="utf-8"))
        except (OSError, SyntaxError, ValueError):
            continue


def _keys(name: str) -> list[str]:
    """Keys of a dictionary of the catalogue; none if there is another thing of this name."""
    for statement in (x for tree in _trees("catalogue.py") for x in tree.body):
        targets = [statement.target] if isinstance(statement, ast.AnnAssign) else getattr(statement, "targets", [])
        if any(isinstance(x, ast.Name) and x.id == name for x in targets):
            value = getattr(statement, "value", None)
            if isinstance(value, ast.Dict) and all(isinstance(key, ast.Constant) for key in value.keys):
                return [str(key.value) for key in value.keys if isinstance(key, ast.Constant)]
    return []


def _fields() -> Iterator[str]:
    """Fields of every class of the room."""
    for tree in _trees("*.py"):
        for kind in (x for x in ast.walk(tree) if isinstance(x, ast.ClassDef)):
            for x in kind.body:
                if isinstance(x, ast.AnnAssign) and isinstance(x.target, ast.Name):
                    yield x.target.id
