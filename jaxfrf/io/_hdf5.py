"""Whether an HDF5 file can be walked through: its library trusts what a damaged file states of itself, and has then run
for ever or brought the process down. Another process tries it first, one for all files of this one."""

import atexit
import os
import pathlib
import queue
import subprocess
import sys
import threading

from .._errors import InputError, input_error

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

    def __init__(self):
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
                process.stdin.write(os.fsencode(path.absolute()).hex() + "\n")
                process.stdin.flush()
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
            process.stdin.close()


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
