"""What the book's pages have tables of, to be held against what is read and written."""

import pathlib
import re

import jaxfrf

_BOOK = pathlib.Path(jaxfrf.__file__).parents[1] / "notebooks"


def told(page: str, section: str, after: str = "") -> set[str]:
    """The names in code marks of a page's section, up to the next of its depth; of what stands `after` a text in it,
    up to the next table."""
    text = (_BOOK / page).read_text(encoding="utf-8").split(f"\n## {section}\n")[1].split("\n## ")[0]
    if after:
        part = text[text.index(after) :] + "\n\n"
        first = part.index("\n|")
        text = part[: part.index("\n\n", first + 2)]
    return {name for code in re.findall(r"`([^`]+)`", text) for name in re.findall(r"\w+", code)}


def row_names(page: str, begins: str) -> set[str]:
    """The names in code marks of the only line of a page that begins so."""
    (line,) = (x for x in (_BOOK / page).read_text(encoding="utf-8").splitlines() if x.startswith(begins))
    return {name for code in re.findall(r"`([^`]+)`", line) for name in re.findall(r"\w+", code)}


def keys(found, but: tuple[str, ...] = ()) -> set[str]:
    """All keys of plain data, in depth but for what stands under keys that are data themselves (names of joints)."""
    if isinstance(found, list):
        return set().union(*(keys(x, but) for x in found))
    if not isinstance(found, dict):
        return set()
    inner = [keys({} if name in but else value, but) for name, value in found.items()]
    return set(found).union(*inner)
