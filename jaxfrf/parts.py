"""Finished parts of a long run, kept in a folder beside its output until the result stands."""

import datetime
import fnmatch
import hashlib
import json
import pathlib
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from . import __version__
from ._errors import OutputError, output_error
from ._files import replacing

_STAMP = "jaxfrf-parts.json"
_PROGRAM = "jaxfrf"
_DRAFT = re.compile(r"\.(.+)-[0-9a-f]{8}(\.\w+)")  # what a killed process leaves of `replacing`

Say = Callable[[str], None]


class Parts:
    """The parts of one run, in the folder `<output>.parts`:

        with Parts("fit.json", "identify", resume=True) as parts:
            found = identify(robot, data, parts=parts)
            jaxfrf.io.write_fit("fit.json", found.as_dict())

    The folder goes when the block ends well, so write the result inside it. After an error or an interruption it stays
    with what was finished, and the error says so in a note. A stamp in the folder says which program made it and for
    what; only files that such a run writes are ever deleted, and the folder only if nothing else is in it.

    **Arguments:**

    - `output`: of the run. `command`: what is done; parts of another command are not taken.
    - `resume`: take over what an interrupted run of the same `about` (here and in `begin`) has finished.
    - `about`: what the run depends on beside what `begin` is told.
    - `say`: called with a line of text about parts that were taken over, or could not be.

    **Raises:** `jaxfrf.InputError` at the beginning of the block, if something else has that name.
    """

    def __init__(
        self,
        output,
        command: str,
        *,
        resume: bool = False,
        about: Mapping[str, Any] | None = None,
        say: Say | None = None,
    ):
        self.folder = pathlib.Path(f"{output}.parts")
        self._command, self._resume, self._about = command, resume, dict(about or {})
        self._say = say or (lambda text: None)
        self._files: tuple[str, ...] = ()  # none before `begin`: then nothing is ours to delete
        self._begun: dict[str, str] | None = None

    def __enter__(self) -> "Parts":
        self._stamp()
        return self

    def __exit__(self, kind, error, trace) -> None:
        if not self._files:
            return
        finished = len(self.finished)
        if error is None or not finished:
            self.discard()
        else:
            kept = f"{_count(finished)} kept in {self.folder}"
            error.add_note(f"{kept}: the same command with --resume goes on from there.")

    def begin(self, about: Mapping[str, Any], files: Sequence[str]) -> None:
        """Make the folder, or take over what an interrupted run left; once, before the work.

        **Arguments:** `about`: all that the parts depend on, by names that tell a user what to look at; numbers, texts,
        lists. `files`: patterns of the names that parts have, e.g. `round-[0-9].json`.

        **Raises:** `jaxfrf.InputError` if the folder holds parts of another run, or any without `resume`; they are left
        as they are.
        """
        about = {"command": self._command, "version": __version__, **self._about, **about}
        about = {name: _text(x) for name, x in about.items()}
        stamp = self._stamp()
        left = [] if stamp is None else self._left_by(stamp, files)
        if left:
            self._check_same(stamp, about, len(left))
        elif self._resume:
            self._say(f"nothing to resume in {self.folder}: starting from the beginning")
        try:
            self._make(about, new=stamp is None, stamped=bool(left))
        except OSError as error:
            raise output_error(
                str(self.folder), f"no way to write there ({error.strerror})", "a folder for parts", "Write elsewhere."
            ) from error
        self._files, self._begun = tuple(files), about
        if self.finished:
            self._say(f"{_count(len(self.finished))} taken over from {self.folder}")

    @property
    def finished(self) -> list[str]:
        """Names of the parts that are there."""
        if not self.folder.is_dir():
            return []
        return sorted(p.name for p in self.folder.iterdir() if _matches(p.name, self._files) and _plain(p))

    def path(self, name: str) -> pathlib.Path:
        """Where a part belongs; to be written whole or not at all.

        **Raises:** `jaxfrf.InputError` if another run has taken the folder meanwhile: parts of two must not mix.
        """
        if not _matches(name, self._files):
            raise ValueError(f"{name} is none of {', '.join(self._files) or 'the parts: begin comes first'}.")
        if not self._is_mine():
            raise output_error(
                str(self.folder),
                "that it was deleted or taken by another run meanwhile",
                "the parts of this run alone",
                "Give every run an output of its own.",
            )
        return self.folder / name

    def read(self, name: str, read: Callable[[pathlib.Path], Any]) -> Any:
        """`read(path)` of a finished part; `None` where there is none, or one that is damaged (which is said)."""
        path = self.path(name)
        if not _plain(path):
            return None
        try:
            return read(path)
        except (MemoryError, ImportError):
            raise
        except Exception as error:  # what the reader of a broken file raises is anybody's guess
            self._say(f"{path} is damaged ({type(error).__name__}) and is made again")
            return None

    def discard(self) -> None:
        """Delete what this program wrote there; files of someone else stay, and the folder with them."""
        try:
            if not self._is_mine():
                return
            for path in self.folder.iterdir():
                if (_matches(path.name, self._files) or _draft_of(path.name, self._files)) and _plain(path):
                    path.unlink()
            if {p.name for p in self.folder.iterdir()} == {_STAMP}:
                (self.folder / _STAMP).unlink()
                self.folder.rmdir()
            else:
                self._say(f"{self.folder} is left: it holds files of someone else")
        except OSError as error:  # the result stands already
            self._say(f"{self.folder} is left ({error})")

    def _is_mine(self) -> bool:
        try:
            stamp = self._stamp()
        except OutputError:
            return False
        return stamp is not None and stamp["about"] == self._begun

    def _stamp(self) -> dict[str, Any] | None:
        """What the folder says of itself; `None` where there is none."""
        folder = self.folder
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            found = "a link" if folder.is_symlink() else "a file"
            raise output_error(str(folder), found, "nothing of that name, or parts of a run", "Rename it.")
        if not folder.exists():
            return None
        try:
            stamp = json.loads((folder / _STAMP).read_text(encoding="utf-8"))
            if stamp["program"] == _PROGRAM and isinstance(stamp["about"], dict):
                return stamp
        except (OSError, ValueError, KeyError, TypeError):
            pass
        raise output_error(
            str(folder),
            f"a folder that this program did not make (no {_STAMP} of its own)",
            "nothing of that name, or parts of a run",
            "Rename it, or choose another output.",
        )

    def _left_by(self, stamp, files: Sequence[str]) -> list[pathlib.Path]:
        """Finished parts of an earlier run; of another command, whatever may be one."""
        found = [p for p in self.folder.iterdir() if p.name != _STAMP and not _draft_of(p.name, files)]
        mine = stamp["about"].get("command") == self._command
        return [p for p in found if _matches(p.name, files) and _plain(p)] if mine else found

    def _make(self, about: Mapping[str, str], new: bool, stamped: bool) -> None:
        if new:
            self.folder.mkdir()
        try:
            if not stamped:
                self._write_stamp(about)
        except OSError:
            if new:
                self.folder.rmdir()
            raise

    def _write_stamp(self, about: Mapping[str, str]) -> None:
        stamp = {
            "program": _PROGRAM,
            "what": "Finished parts of a run. The same command with --resume goes on from them.",
            "begun": f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
            "about": about,
        }
        with replacing(self.folder / _STAMP) as draft:
            draft.write_text(json.dumps(stamp, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    def _check_same(self, stamp, about: Mapping[str, str], count: int) -> None:
        """Refuse parts that another run made, and those of this run if it is not to go on."""
        other = _differences(stamp["about"], about)
        found = f"{_count(count)} of a run begun {stamp.get('begun', 'earlier')}"
        if other:
            raise output_error(
                str(self.folder),
                f"{found} with other options or data ({'; '.join(other)})",
                "those of this run, or none",
                "They are kept: give --resume and what was given then, or choose another output, or delete that folder "
                "to start anew.",
            )
        if not self._resume:
            raise output_error(
                str(self.folder),
                found,
                "none, or --resume",
                "They are kept: give --resume to go on from them, or delete that folder to start anew.",
            )


def numbers_text(*arrays) -> str:
    """A short text that is another one where any number is: for `about`."""
    digest = hashlib.sha256()
    for x in arrays:
        if x is not None:
            x = np.ascontiguousarray(x)
            digest.update(x.tobytes())
            x = (x.shape, x.dtype.str)
        digest.update(repr(x).encode())
    return digest.hexdigest()[:16]


def files_text(sources) -> str:
    """Names and digests of files (`jaxfrf.Source`): for `about`."""
    return ", ".join(f"{s.name} (sha256 {s.sha256[:16]})" for s in sources)


def _text(value) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True, ensure_ascii=False)


def _differences(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    names = [n for n in dict.fromkeys((*then, *now)) if then.get(n) != now.get(n)]
    return [f"{n}: {then.get(n, 'none')} then, {now.get(n, 'none')} now" for n in names]


def _count(number: int) -> str:
    return "1 finished part" if number == 1 else f"{number} finished parts"


def _matches(name: str, files: Sequence[str]) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in files)


def _draft_of(name: str, files: Sequence[str]) -> bool:
    draft = _DRAFT.fullmatch(name)
    return draft is not None and (_matches("".join(draft.groups()), files) or "".join(draft.groups()) == _STAMP)


def _plain(path: pathlib.Path) -> bool:
    return path.is_file() and not path.is_symlink()
