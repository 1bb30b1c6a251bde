"""Warnings of a command, what several files share being said once."""

import sys
from collections.abc import Iterable

_SHARED = 3  # files, from which on their names are counted


def warn(texts: Iterable[str]) -> None:
    """Print warnings to the error stream; `FILE: text` of several files once, with how many there are."""
    for text in _joined(dict.fromkeys(texts)):
        print(f"warning: {text}", file=sys.stderr)


def _joined(texts: Iterable[str]) -> list[str]:
    files: dict[str, list[str]] = {}  # by what is said of them, in the order in which it was said first
    for text in texts:
        name, colon, said = text.partition(": ")
        is_file = bool(colon) and "." in name and " " not in name
        files.setdefault(said if is_file else text, []).append(name if is_file else "")
    found = []
    for said, names in files.items():
        if len(names) < _SHARED or not all(names):
            found += [f"{name}: {said}" if name else said for name in names]
        else:
            found.append(f"{names[0]} and {len(names) - 1} other files: {said}")
    return found
