"""Files are written whole or not at all, and whether they can be is tried before the work."""

import contextlib
import os
import pathlib
import secrets
from collections.abc import Iterator

from ._errors import output_error

_WRITABLE = 0o222  # permission bits; they say what is meant to stay even to root, whom they do not stop


@contextlib.contextmanager
def replacing(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """A temporary file beside `path` that takes its place if the block succeeds, and vanishes otherwise.

    **Raises:** `jaxfrf.InputError` if there is no such folder, or `path` is one. An `OSError` of the block says in a
    note which file was not written.
    """
    _check_place(path)
    temporary = path.with_name(draft_name(path.name))
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        error.add_note(f"{path} was not written.")
        raise
    finally:
        temporary.unlink(missing_ok=True)


def draft_name(name: str) -> str:
    """A name for the temporary file beside a file of this name."""
    path = pathlib.PurePath(name)
    return f".{path.stem}-{secrets.token_hex(4)}{path.suffix}"


def check_writable(path: str | os.PathLike) -> None:
    """Refuse a file that could not be written, by writing a temporary one beside it: before hours of work, not after.

    **Raises:** `jaxfrf.InputError` if the path is a folder or no plain file, its folder is missing or cannot be written
    to, or a file stands there that is write-protected.
    """
    path = pathlib.Path(path)
    try:
        _check_place(path)
        if path.exists():
            _check_replaceable(path)
        draft = path.with_name(draft_name(path.name))
        try:
            draft.write_bytes(b"\n")
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise output_error(
            str(path), f"that nothing can be written there ({reason})", "a place for a file", "Write elsewhere."
        ) from error


def _check_place(path: pathlib.Path) -> None:
    if not path.absolute().parent.is_dir():
        raise output_error(
            str(path), f"no folder {path.parent}", "one that exists", "Make it first, or write elsewhere."
        )
    if path.is_dir():
        raise output_error(str(path), "a folder", "the name of a file", "Name a file in it, or write elsewhere.")


def _check_replaceable(path: pathlib.Path) -> None:
    if not path.is_file():
        raise output_error(str(path), "a device or a pipe", "a plain file, or none", "Write elsewhere.")
    if not path.stat().st_mode & _WRITABLE:
        raise output_error(
            str(path), "a file that is write-protected", "one that may be replaced, or none", "Write elsewhere."
        )
    with path.open("r+b"):  # changes nothing
        pass
