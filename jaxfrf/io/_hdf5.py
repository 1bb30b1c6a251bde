"""A full disk, which HDF5's library does not survive: where a write fails it leaves objects open and ends the process
when that ends. It writes to `Disk`, where no write fails. (Damaged files: `_apart`.)
"""

import contextlib
import io
import os
import pathlib
from collections.abc import Iterator


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
