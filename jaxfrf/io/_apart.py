"""Damaged files, which HDF5's library does not survive: another process opens them, one for all files of this one.

The library trusts what a damaged file states of itself. It has then run for ever, ended the process, or written where
it should not, so that the process ends later. What a file of usual size holds is therefore read by the other process,
which sends it; a large one is walked through there before it is opened here.
"""

import atexit
import importlib
import io
import json
import os
import pathlib
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import IO

import numpy as np

from .._errors import InputError, input_error
from ._container import Leaf, Unreadable, Variables, text
from ._optional import require

_SENT = 2**26  # bytes of a file whose arrays are sent; of larger ones a second copy would cost time and memory
_START = 30.0  # s to import what reads on a busy machine
_RATE = 20e6  # bytes/s that every disk reads
_SERVE = f"from {__name__} import serve; serve()"
_AS_THEY_ARE = {"refused": InputError, "memory": MemoryError, "missing": ImportError}  # errors that are told on

Read = Callable[[pathlib.Path], dict[str, Leaf]]


def load_apart(path: pathlib.Path, read: Read) -> dict[str, Leaf]:
    """What `read`, a function of one of this package's modules, finds in an HDF5 file.

    **Raises:** `jaxfrf.InputError` where that fails, ends the process, or takes for ever.
    """
    whole = path.stat().st_size <= _SENT
    answer = _ask(path, f"{read.__module__}:{read.__qualname__}" if whole else "")
    return read(path) if answer is None or not whole else _unpacked(*answer)


def check_walkable(path: pathlib.Path) -> None:
    """Walk through all objects, attributes and beginnings of arrays of an HDF5 file, in another process.

    **Raises:** as `load_apart`.
    """
    _ask(path, "")


def _ask(path: pathlib.Path, read: str) -> tuple[dict, bytes] | None:
    """The other process's answer; `None` where there is no such process."""
    if not sys.executable:  # embedded: nothing to start
        return None
    limit = _START + path.stat().st_size / _RATE
    try:
        said, sent = _READER.ask({"path": os.fsencode(path.absolute()).hex(), "read": read}, limit)
    except TimeoutError:
        raise _damaged(path, f"an HDF5 file that cannot be read in {limit:.0f} s") from None
    except ChildProcessError as error:
        if error.args[0] >= 0:  # it could not start, or was told to end: nothing is known about the file
            return None
        raise _damaged(path, f"an HDF5 file that ends the process that opens it (signal {-error.args[0]})") from None
    for kind, make in _AS_THEY_ARE.items():
        if kind in said:
            raise make(said[kind])
    if "error" in said:
        raise _damaged(path, f"an HDF5 file that cannot be read ({said['error'].splitlines()[0][:200]})")
    return said, sent


def _damaged(path: pathlib.Path, found: str) -> InputError:
    do = "It may be truncated, damaged, still being written, or have the wrong extension: copy or export it again."
    return input_error(str(path), found, "a whole file", do)


class _Reader:
    """The other process; it is started when the first file comes, and again after it ended."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._answers: queue.Queue[tuple[dict, bytes] | None] = queue.Queue()
        self._owner = 0

    def ask(self, question: Mapping[str, str], limit: float) -> tuple[dict, bytes]:
        """**Raises:** `TimeoutError`; `ChildProcessError` with the signal that ended the process."""
        with self._lock:
            process = self._running()
            try:
                questions = _piped(process.stdin)
                questions.write(json.dumps(question).encode() + b"\n")
                questions.flush()
                answer = self._answers.get(timeout=limit)
            except queue.Empty:
                self.stop()
                raise TimeoutError from None
            except OSError:
                answer = None
            if answer is None:
                code = process.wait()
                self.stop()
                raise ChildProcessError(code)
            return answer

    def _running(self) -> subprocess.Popen:
        if self._process is None or self._owner != os.getpid():  # a forked process has the pipes of another
            self._owner, self._answers = os.getpid(), queue.Queue()
            here = str(pathlib.Path(__file__).parents[2])
            paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
            self._process = subprocess.Popen(
                [sys.executable, "-c", _SERVE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": paths},
            )
            threading.Thread(target=_listen, args=(self._process.stdout, self._answers), daemon=True).start()
        return self._process

    def stop(self) -> None:
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            process.wait()
            _piped(process.stdin).close()


def _piped(stream: IO[bytes] | None) -> IO[bytes]:
    """A stream of a process that was started with pipes."""
    assert stream is not None
    return stream


def _listen(answers, to: queue.Queue) -> None:
    with answers:
        for line in answers:
            said = json.loads(line)
            sent = answers.read(said.get("bytes", 0))
            if len(sent) < said.get("bytes", 0):
                break
            to.put((said, sent))
    to.put(None)


_READER = _Reader()
atexit.register(_READER.stop)


# In the other process


def serve() -> None:
    """Answer questions, a line of JSON each, until there are no more: a line of JSON and the arrays behind it."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin.buffer:
        question = json.loads(line)
        said, sent = _answer(pathlib.Path(os.fsdecode(bytes.fromhex(question["path"]))), question["read"])
        answers.write(json.dumps(said | {"bytes": len(sent)}).encode() + b"\n")
        answers.write(sent)
        answers.flush()


def _answer(path: pathlib.Path, read: str) -> tuple[dict, bytes]:
    try:
        if not read:
            _walk(path)
            return {}, b""
        module, _, name = read.partition(":")
        return _packed(getattr(importlib.import_module(module), name)(path))
    except tuple(_AS_THEY_ARE.values()) as error:
        return {next(kind for kind, of in _AS_THEY_ARE.items() if isinstance(error, of)): str(error)}, b""
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}"}, b""


def _walk(path: pathlib.Path) -> None:
    h5py = require("h5py", "io")

    def look(_, node):
        for key in node.attrs:
            node.attrs[key]
        if not isinstance(node, h5py.Dataset):
            return
        if "DIMENSION_LIST" in node.attrs:
            [len(d) for d in node.dims]
        if node.chunks and node.size and node.id.get_num_chunks():
            node[tuple(slice(0, 1) for _ in node.shape)]
        elif node.size and node.size < 1000:
            node[()]

    with h5py.File(path, "r") as file:
        for key in file.attrs:
            file.attrs[key]
        file.visititems(look)


def _packed(found: dict[str, Leaf]) -> tuple[dict, bytes]:
    arrays, leaves = io.BytesIO(), []
    for name, leaf in found.items():
        if isinstance(leaf, str | Unreadable):
            leaves.append([name, *(("text", leaf) if isinstance(leaf, str) else ("unreadable", leaf.kind))])
            continue
        array = np.asarray(leaf)
        plain = np.vectorize(text, otypes=[str])(array) if array.dtype.hasobject else array
        np.lib.format.write_array(arrays, plain, allow_pickle=False)
        leaves.append([name, "array", ""])
    units = found.units if isinstance(found, Variables) else {}
    return {"leaves": leaves, "units": units}, arrays.getvalue()


def _unpacked(said: dict, sent: bytes) -> Variables:
    arrays = io.BytesIO(sent)

    def leaf(kind: str, value: str) -> Leaf:
        if kind == "array":
            return np.lib.format.read_array(arrays, allow_pickle=False)
        return value if kind == "text" else Unreadable(value)

    return Variables({name: leaf(kind, value) for name, kind, value in said["leaves"]}, said["units"])
