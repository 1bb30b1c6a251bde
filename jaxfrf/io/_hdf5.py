"""What HDF5's library does not survive: damaged files, and a full disk.

It trusts what a damaged file states of itself, and has then run for ever or brought the process down: another process
walks through it first, one for all files of this one. Where a write fails it leaves objects open and ends the process
when that ends: it writes to `Disk`, where no write fails.
"""

import atexit
import contextlib
import io
import os
import pathlib
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import IO

from .._errors import InputError, input_error


class Disk(io.RawIOBase):
    """A file for `h5py.File(disk, "w")`; after a write that fails (`check`) all goes nowhere."""

    def __init__(self, path: pathlib.Path):
        self._file = open(path, "w+b", buffering=0)
        self._path = path
        self._error: OSError | None = None

    def check(self) -> None:
        """**Raises:** the `OSError` of the first write that failed."""
        if self._error is not None:
            raise OSError(self._error.errno, self._error.strerror, str(self._path)) from self._error

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, buffer) -> int | None:
        return self._file.readinto(buffer)

    def write(self, data) -> int:
        left = memoryview(data).cast("B")
        size = len(left)
        while len(left) and self._error is None:
            self._try(lambda left=left: self._file.write(left))
            left = left[self._done :]
        return size

    def truncate(self, size: int | None = None) -> int:
        self._try(lambda: self._file.truncate(size))
        return self.tell() if size is None else size

    def close(self) -> None:
        if not self.closed:
            self._try(self._file.close)
        super().close()

    def _try(self, work) -> None:
        self._done = 0
        try:
            self._done = work() or 0
        except OSError as error:
            self._error = self._error or error


@contextlib.contextmanager
def surviving(path: pathlib.Path) -> Iterator[Disk]:
    """A new file for HDF5 to write to.

    **Raises:** `OSError` at the end, where not all of it could be written.
    """
    with Disk(path) as disk:
        try:
            yield disk
        except Exception:  # what HDF5 finds missing then is no news
            disk.check()
            raise
    disk.check()


_START = 30.0  # s to import h5py on a busy machine
_RATE = 20e6  # bytes/s that every disk reads
_WALK = """
import sys, h5py

def look(name, node):
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

for line in sys.stdin:
    try:
        with h5py.File(bytes.fromhex(line).decode(errors="surrogateescape"), "r") as file:
            for key in file.attrs:
                file.attrs[key]
            file.visititems(look)
        said = ""
    except Exception as error:
        said = f"{type(error).__name__}: {error}".encode(errors="replace").hex()
    print(said, flush=True)
"""


class _Walker:
    """The other process; it is started when the first file comes, and again after it ended."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._answers: queue.Queue[str | None] = queue.Queue()
        self._owner = 0

    def ask(self, path: pathlib.Path, limit: float) -> str:
        """What is wrong with a file, or nothing.

        **Raises:** `TimeoutError`; `ChildProcessError` with the signal that ended the process.
        """
        with self._lock:
            process = self._running()
            try:
                requests = _piped(process.stdin)
                requests.write(os.fsencode(path.absolute()).hex() + "\n")
                requests.flush()
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
            return bytes.fromhex(answer).decode(errors="replace")

    def _running(self) -> subprocess.Popen:
        if self._process is None or self._owner != os.getpid():  # a forked process has the pipes of another
            self._owner, self._answers = os.getpid(), queue.Queue()
            self._process = subprocess.Popen(
                [sys.executable, "-c", _WALK],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            threading.Thread(target=_listen, args=(self._process.stdout, self._answers), daemon=True).start()
        return self._process

    def stop(self) -> None:
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            process.wait()
            _piped(process.stdin).close()


def _piped(stream: IO[str] | None) -> IO[str]:
    """A stream of a process that was started with pipes."""
    assert stream is not None
    return stream


def _listen(lines, answers: queue.Queue) -> None:
    with lines:
        for line in lines:
            answers.put(line.strip())
    answers.put(None)


_WALKER = _Walker()
atexit.register(_WALKER.stop)


def check_walkable(path: pathlib.Path) -> None:
    """Walk through all objects, attributes and beginnings of arrays of an HDF5 file, in another process.

    **Raises:** `jaxfrf.InputError` where that fails, ends the process, or takes for ever.
    """
    if not sys.executable:  # embedded: nothing to try it with
        return
    limit = _START + path.stat().st_size / _RATE
    try:
        said = _WALKER.ask(path, limit)
    except TimeoutError:
        raise _damaged(path, f"an HDF5 file that cannot be walked through in {limit:.0f} s") from None
    except ChildProcessError as error:
        if error.args[0] >= 0:  # it could not start, or was told to end: nothing is known about the file
            return
        raise _damaged(path, f"an HDF5 file that ends the process that opens it (signal {-error.args[0]})") from None
    if said:
        raise _damaged(path, f"an HDF5 file that cannot be read ({said.splitlines()[0][:200]})")


def _damaged(path: pathlib.Path, found: str) -> InputError:
    do = "It may be truncated, damaged, still being written, or have the wrong extension: copy or export it again."
    return input_error(str(path), found, "a whole file", do)
