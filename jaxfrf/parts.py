"""Finished parts of a long run, kept in a folder beside its output until the result stands."""

import contextlib
import datetime
import fnmatch
import functools
import hashlib
import json
import pathlib
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

import numpy as np

from . import __version__
from ._errors import OutputError, output_error
from ._files import replacing

_STAMP = "jaxfrf-parts.json"
_PACKAGE = pathlib.Path(__file__).parent
_PROGRAM = "jaxfrf"
_OUTCOMES = "outcomes"
_DRAFT = re.compile(r"\.(.+)-[0-9a-f]{8}(\.\w+)")  # what a killed process leaves of `replacing`
BESIDE = "jaxfrf, a part beside"  # name of threads that make parts beside the main one

Say = Callable[[str], None]


class Parts:
    """The parts of one run, in the folder `<output>.parts`:

        with Parts("fit.json", "identify", resume=True) as parts:
            found = identify_springs(robot, data, parts=parts)
            jaxfrf.io.write_fit("fit.json", found.as_dict())

    The folder goes when the block ends well, so write the result inside it. After an error or an interruption it stays
    with what was finished, and the error says so in a note. A stamp in the folder says which program made it and for
    what; only files that such a run writes are ever deleted, and the folder only if nothing else is in it.

    **Arguments:**

    - `output`: of the run. `command`: what is done; parts of another command are not taken.
    - `resume`: take over what an interrupted run of the same `about` (here and in `begin`) has finished. `restart`:
      delete what an interrupted run left, whatever it was about, and begin anew.
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
        restart: bool = False,
        about: Mapping[str, Any] | None = None,
        say: Say | None = None,
    ):
        self.folder = pathlib.Path(f"{output}.parts")
        self._command, self._resume, self._restart, self._about = command, resume, restart, dict(about or {})
        self._say = say or (lambda text: None)
        self._files: tuple[str, ...] = ()  # none before `begin`: then nothing is ours to delete
        self._beside: tuple[str, ...] = ()
        self._begun: dict[str, str] | None = None
        self._later: Future[tuple[Any, ...]] | None = None

    def __enter__(self) -> "Parts":
        self._stamp()
        return self

    def __exit__(self, kind, error, trace) -> None:
        if not self._files:
            return
        finished = len(self.finished)
        if error is not None and finished:
            with contextlib.suppress(Exception):  # the error is what counts
                self.settle(wait=False)
            kept = f"{_count(finished)} kept in {self.folder}"
            error.add_note(f"{kept}: the same command with --resume goes on from there.")
            return
        try:
            self.discard()
        except KeyboardInterrupt as stopped:
            self.discard()
            if error is None:
                stopped.add_note("The result stands already.")
            raise

    def begin(
        self,
        about: Mapping[str, Any],
        files: Sequence[str],
        beside: Sequence[str] = (),
        data: tuple[str, Future[tuple[Any, ...]]] | None = None,
    ) -> None:
        """Make the folder, or take over what an interrupted run left; once, before the work.

        **Arguments:** `about`: all that the parts depend on, by names that tell a user what to look at; numbers, texts,
        lists. `files`: patterns of the names that parts have, e.g. `round-[0-9].json`. `beside`: of files that belong
        to parts and are none. `data`: what is known of large files at once, and a future of their `jaxfrf.Source`s,
        with digests: waited for only where parts are taken over that were stamped with digests; else `settle` writes
        them down.

        **Raises:** `jaxfrf.InputError` if the folder holds parts of another run, or any without `resume`; they are left
        as they are.
        """
        about = made_by(self._command) | {name: _text(x) for name, x in {**self._about, **about}.items()}
        stamp = self._stamp()
        if stamp is not None and self._restart:
            self._delete_left(stamp, files)
        left = [] if stamp is None else self._left_by(stamp, files)
        if data is not None:
            about["data"], self._later = data
            if stamp is not None and left and stamp["about"].get("data") != about["data"]:
                about["data"], self._later = files_text(self._later.result()), None
        if left:
            self._check_same(stamp, about, len(left))
        elif self._resume:
            self._say(f"nothing to resume in {self.folder}: starting from the beginning")
        try:
            self._make(about, (*files, *beside), new=stamp is None, stamped=bool(left))
        except OSError as error:
            raise output_error(
                str(self.folder), f"no way to write there ({error.strerror})", "a folder for parts", "Write elsewhere."
            ) from error
        self._files, self._beside, self._begun = tuple(files), tuple(beside), about
        if self.finished:
            self._say(f"{_count(len(self.finished))} taken over from {self.folder}")

    def settle(self, wait: bool = True) -> None:
        """Write down the digests of the data that `begin` was told to come; without `wait`, if they are known."""
        if self._later is None or not (wait or self._later.done()) or not self._is_mine():
            return
        about = {**(self._begun or {}), "data": files_text(self._later.result())}
        _write_json(self.folder / _STAMP, {**(self._stamp() or {}), "about": about})
        self._begun, self._later = about, None

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
        if not _matches(name, (*self._files, *self._beside)):
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
            ours = (*self._files, *self._beside)
            for path in self.folder.iterdir():
                if (_matches(path.name, ours) or _draft_of(path.name, ours)) and _plain(path):
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
        """Finished parts of an earlier run, by its own patterns and by these."""
        patterns = _patterns(stamp, files)
        return [p for p in self.folder.iterdir() if _matches(p.name, patterns) and _plain(p)]

    def _delete_left(self, stamp, files: Sequence[str]) -> None:
        """Parts of whatever run made the folder."""
        try:
            gone = self._left_by(stamp, files)
            for path in gone:
                path.unlink()
        except OSError as error:
            raise output_error(
                str(self.folder), f"parts that cannot be deleted ({error.strerror})", "rights to do so", "Grant them."
            ) from error
        if gone:
            self._say(f"{_count(len(gone))} of an earlier run deleted from {self.folder}, as --restart says")

    def _make(self, about: Mapping[str, str], files: Sequence[str], new: bool, stamped: bool) -> None:
        if new:
            self.folder.mkdir()
        try:
            if not stamped:
                self._write_stamp(about, files)
        except OSError:
            if new:
                self.folder.rmdir()
            raise

    def _write_stamp(self, about: Mapping[str, str], files: Sequence[str]) -> None:
        stamp = {
            "program": _PROGRAM,
            "what": "Finished parts of a run. The same command with --resume goes on from them.",
            "begun": f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
            "about": about,
            "files": list(files),
        }
        _write_json(self.folder / _STAMP, stamp)

    def _check_same(self, stamp, about: Mapping[str, str], count: int) -> None:
        """Refuse parts that another run made, and those of this run if it is not to go on."""
        other = differences(stamp["about"], about)
        found = f"{_count(count)} of a run begun {stamp.get('begun', 'earlier')}"
        if other:
            raise output_error(
                str(self.folder),
                f"{found} with other options or data ({'; '.join(other)})",
                "those of this run, or none",
                "They are kept: give --resume and what was given then, or choose another output, or give --restart to "
                "delete them and begin anew.",
            )
        if not self._resume:
            raise output_error(
                str(self.folder),
                found,
                "none, or --resume",
                "They are kept: give --resume to go on from them, or --restart to delete them and begin anew.",
            )


class Results:
    """Results that stay in a folder, one a name, each with what it was made from: those of `--each`.

    What became of `NAME` stands in `outcomes/NAME.json`, written last: a result without it is none.

    **Arguments:** `folder`: a new one, an empty one, or one that this has made for the same `command`. `say` as of
    `Parts`.

    **Raises:** `jaxfrf.InputError` where it is someone else's, or cannot be written to.
    """

    def __init__(self, folder: pathlib.Path, command: str, *, restart: bool = False, say: Say | None = None):
        self.folder, self._restart = folder, restart
        self._say = say or (lambda text: None)
        own = {"program": _PROGRAM, "what": "Results of many files.", "about": {"command": command}}
        try:
            folder.mkdir(exist_ok=True)
            self._check_ours(command)
            _write_json(folder / _STAMP, own)
            (folder / _OUTCOMES).mkdir(exist_ok=True)
        except FileExistsError:
            raise output_error(
                str(folder), "a file", "a folder, or nothing of that name", "Choose another -o."
            ) from None
        except OSError as error:
            raise output_error(
                str(folder), error.strerror or str(error), "a folder to write to", "Write elsewhere."
            ) from None

    def standing(self, jobs: Mapping[str, tuple[pathlib.Path, Mapping[str, str]]]) -> dict[str, dict]:
        """Outcomes that stand, by name, of those asked for: `jobs` says where each result is and what it would be made
        from now. Says which were made otherwise."""
        found, reasons = {}, []
        for name, (path, about) in jobs.items():
            outcome = None if self._restart else self._read(name)
            if outcome is None:
                continue
            other = differences(outcome.pop("made_from"), about)
            if other:
                reasons.append("; ".join(other))
            elif not outcome.get("again") and (not outcome["ok"] or path.is_file()):
                found[name] = outcome
        if found:
            self._say(f"{len(found)} of {len(jobs)} files stand in {self.folder} already")
        if reasons:
            self._say(f"{len(reasons)} of {len(jobs)} were made otherwise and are made again ({reasons[0]})")
        self._tidy({name for name in jobs if name not in found} | {"table", "index"})
        return found

    def _tidy(self, names: Collection[str]) -> None:
        """Without what a killed process left of files that are written again."""
        for path in [*self.folder.iterdir(), *(self.folder / _OUTCOMES).iterdir()]:
            draft = _DRAFT.fullmatch(path.name)
            if draft is not None and draft[1] in names and _plain(path):
                path.unlink(missing_ok=True)

    def keep(self, name: str, outcome: Mapping[str, Any], about: Mapping[str, str]) -> None:
        _write_json(self.folder / _OUTCOMES / f"{name}.json", {**outcome, "made_from": dict(about)})

    def _read(self, name: str) -> dict | None:
        try:
            outcome = json.loads((self.folder / _OUTCOMES / f"{name}.json").read_text(encoding="utf-8"))
            return outcome if isinstance(outcome["made_from"], dict) and isinstance(outcome["ok"], bool) else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _check_ours(self, command: str) -> None:
        if not any(self.folder.iterdir()):
            return
        try:
            stamp = json.loads((self.folder / _STAMP).read_text(encoding="utf-8"))
            made = stamp["about"]["command"] if stamp["program"] == _PROGRAM else None
        except (OSError, ValueError, KeyError, TypeError):
            made = None
        if made != command:
            found = "files in it" if made is None else f"results of `jaxfrf {made}` in it"
            raise output_error(str(self.folder), found, f"results of `jaxfrf {command}`, or none", "Choose another -o.")


@functools.cache
def program() -> str:
    """A digest of the package's own files: another program may find other numbers, whatever its version says."""
    return _digest(_PACKAGE)


def _digest(package: pathlib.Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(p for kind in ("*.py", "*.toml") for p in package.rglob(kind)):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def made_by(command: str) -> dict[str, str]:
    """What everything depends on that a command finishes."""
    return {"command": command, "version": __version__, "program": program()}


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


def _write_json(path: pathlib.Path, contents: Mapping[str, Any]) -> None:
    with replacing(path) as draft:
        draft.write_text(json.dumps(contents, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _text(value) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True, ensure_ascii=False)


def differences(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """What is told of two runs that differ, one text for every name in `about`."""
    names = [n for n in dict.fromkeys((*then, *now)) if then.get(n) != now.get(n)]
    told = [f"{n}: {then.get(n, 'none')} then, {now.get(n, 'none')} now" for n in names if n != "program"]
    return told + (["the program's files have changed since"] if "program" in names else [])


def _patterns(stamp, files: Sequence[str]) -> tuple[str, ...]:
    """Of the names that the run wrote down and that this one would, none of which is the stamp's."""
    known = stamp.get("files")
    told = [x for x in known if isinstance(x, str)] if isinstance(known, list) else []
    return tuple(x for x in (*told, *files) if not fnmatch.fnmatchcase(_STAMP, x))


def _count(number: int) -> str:
    return "1 finished part" if number == 1 else f"{number} finished parts"


def _matches(name: str, files: Sequence[str]) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in files)


def _draft_of(name: str, files: Sequence[str]) -> bool:
    draft = _DRAFT.fullmatch(name)
    return draft is not None and (_matches("".join(draft.groups()), files) or "".join(draft.groups()) == _STAMP)


def _plain(path: pathlib.Path) -> bool:
    return path.is_file() and not path.is_symlink()
