"""Files are written whole or not at all, and whether they can be is tried before the work."""

import contextlib
import datetime
import difflib
import errno
import hashlib
import itertools
import os
import pathlib
import secrets
import shutil
import stat
from collections.abc import Iterator

from ._errors import input_error, output_error
from ._text import number

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
        if temporary.is_dir():  # a format that is a folder
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def digest(path: pathlib.Path) -> str:
    """The sha256 of a file, or of names and digests of all files in a folder."""
    if path.is_dir():
        inside = sorted(x for x in path.rglob("*") if x.is_file())
        text = "".join(f"{x.relative_to(path).as_posix()} {digest(x)}\n" for x in inside)
        return hashlib.sha256(text.encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def size_and_time(path: pathlib.Path) -> str:
    """Size and time of the last change of a file, or of all files in a folder: what is known of them at once."""
    inside = [x for x in path.rglob("*") if x.is_file()] if path.is_dir() else [path]
    found = [x.stat() for x in inside]
    changed = max((x.st_mtime_ns for x in found), default=0)
    return f"{sum(x.st_size for x in found)} bytes, changed {datetime.datetime.fromtimestamp(changed / 1e9)}"


def is_folder_format(path: pathlib.Path) -> bool:
    """Whether this is a Zarr folder, by its name and by what is in it."""
    return path.suffix.lower() == ".zarr" and any((path / name).is_file() for name in ("zarr.json", ".zgroup"))


def check_readable(path: pathlib.Path, what: str) -> None:
    """**Raises:** `jaxfrf.InputError` unless `path` is a plain file, or a Zarr folder."""
    if is_folder_format(path):
        return
    try:
        found = path.stat()
    except FileNotFoundError:
        near = _like(path)
        raise input_error(
            str(path), "no such file", what, f"Did you mean {near}?" if near else "Check the name and the folder."
        ) from None
    except OSError as error:  # links that go round, names that are too long
        raise input_error(str(path), error.strerror or "no file", what, "Check the name and the folder.") from None
    except ValueError:  # a zero byte
        raise input_error(repr(str(path)), "a name that no file can have", what, "Correct the name.") from None
    if stat.S_ISDIR(found.st_mode):
        raise input_error(str(path), "a folder", what, "Name the files in it.")
    if not stat.S_ISREG(found.st_mode):
        raise input_error(str(path), "a pipe or a device", f"{what}, a plain file", "Save what comes out of it first.")


def _like(path: pathlib.Path) -> pathlib.Path | None:
    """A file of a name like this one, in the same folder."""
    try:
        names = [x.name for x in itertools.islice(path.parent.iterdir(), 10_000)]
    except OSError:
        return None
    near = difflib.get_close_matches(path.name, names, 1, cutoff=0.75)
    return path.with_name(near[0]) if near else None


def check_room(path: pathlib.Path, n_bytes: int) -> None:
    """Refuse what does not fit on the disk: libraries that write piece by piece may not survive a full one.

    **Raises:** `jaxfrf.InputError` with what is needed.
    """
    try:
        if hasattr(os, "posix_fallocate"):
            with path.open("wb") as file:
                if n_bytes:
                    os.posix_fallocate(file.fileno(), 0, n_bytes)
        elif shutil.disk_usage(path.absolute().parent).free < n_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return  # the file system cannot say; writing will
        raise output_error(
            str(path.parent), f"no room for {number(n_bytes / 1e6)} MB ({error.strerror})", "room", "Write elsewhere."
        ) from None
    finally:
        path.unlink(missing_ok=True)


def check_space(path: str | os.PathLike, n_bytes: float) -> None:
    """Refuse what the disk has no room for beside `path`, before it is made.

    **Raises:** `jaxfrf.InputError` with what is needed and what is free.
    """
    folder = pathlib.Path(path).absolute().parent
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return  # writing will say
    if n_bytes > free:
        raise output_error(
            str(folder),
            f"{number(free / 1e9)} GB free",
            f"{number(n_bytes / 1e9)} GB for the result and its parts",
            "Make room.",
        )


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
    if path.is_dir() and path.suffix.lower() == ".zarr":
        raise output_error(
            str(path), "a folder of this name", "a new one: folders are not overwritten", "Delete it, or name another."
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
