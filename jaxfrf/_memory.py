"""Sizes that headers, designs and robots ask for, checked before memory is taken."""

import os
import pathlib

from ._errors import input_error
from ._text import number

_MEMORY = pathlib.Path("/proc/meminfo")
_GROUP = pathlib.Path("/sys/fs/cgroup")
_PROGRAM = 9e8  # bytes that Python, JAX and what it compiles take
_LEAST = 1e8
_UNKNOWN = 2**37  # bytes, where the system does not say


def available_memory() -> int:
    """Bytes that this process can still take: of the machine, its group and its own limit, the least."""
    return max(min(_of_machine(), _of_group(), _of_process()), 0)


def block_memory(limit: float | None) -> float:
    """Bytes that the blocks in work may take: what a limit for the whole process leaves beside the program itself, or,
    without one, half of what is free."""
    return available_memory() / 2 if limit is None else max(limit - _PROGRAM, _LEAST)


def check_memory(what: str, n_bytes: float, do: str) -> None:
    """Refuse what cannot fit into memory.

    **Raises:** `jaxfrf.InputError` with both sizes.
    """
    free = available_memory()
    if n_bytes > free:
        raise input_error(what, f"{size_text(n_bytes)} to hold", f"at most the {size_text(free)} that are free", do)


def size_text(n_bytes: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB", "TB"):
        if n_bytes < 1000 or unit == "TB":
            return f"{number(n_bytes)} {unit}"
        n_bytes = n_bytes / 1000
    raise AssertionError


def _of_machine() -> int:
    try:
        for line in _MEMORY.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError, AttributeError):
        return _UNKNOWN


def _of_group() -> int:
    try:
        limit = (_GROUP / "memory.max").read_text().strip()
        return _UNKNOWN if limit == "max" else int(limit) - int((_GROUP / "memory.current").read_text())
    except (OSError, ValueError):
        return _UNKNOWN


def _of_process() -> int:
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        used = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        return _UNKNOWN if limit == resource.RLIM_INFINITY else limit - used
    except (ImportError, OSError, ValueError):
        return _UNKNOWN
