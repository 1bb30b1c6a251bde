"""What the command line sets before it imports JAX, unless the user already did."""

import ctypes
import functools
import gc
import importlib.metadata
import os
import pathlib

_THREADS = 64
"""At least, of XLA's thread pool. Until jaxlib 0.11.2 a batched LAPACK call (`jax::ParallelBatchMap`,
lapack_kernels.cc) runs on one thread of the pool, hands its batch to the others and waits: with as many calls at a time
as there are threads, each waits for the others for ever (PyAutoFit #1530 found the same of FFTs). So many calls are
never ready together; threads that sleep cost nothing measurable.

On a single core the pool has one thread, on which such a call hands nothing over and waits for nobody."""

_INLINE = 0, 11, 2  # jaxlib, from which on such a call does its batch by itself

_LOOPS = "--xla_cpu_use_fusion_emitters"
"""Loops by XLA's older code generator: two thirds of the processor time of compiling (a simulation 9.9 instead of
15.6 s, the Gram matrix of a fit 15.0 instead of 20.5 s), the same speed. XLA ends a program whose flags it does not
know, therefore only where it is known to know it."""

_TRIM, _OWN_PAGES, _ARENAS = -1, -3, -8  # glibc's names: M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX
_LARGE = 2**22
"""Bytes of an array that gets pages of its own, which go back to the system with it. By itself glibc raises this to
32 MB, and keeps smaller ones in a heap for every thread: what is left between them makes long work grow."""

_SELDOM = (20_000, 20, 20)
"""Objects between two looks for garbage in cycles, and looks of one generation between two of the next: programs that
JAX traces are millions of objects that stay. By Python's own (700, 10, 10) that is 2 % of a diagnosis."""


def prepare() -> None:
    """64 bit, a thread pool in which batched LAPACK calls cannot wait for each other for ever, a compilation cache,
    programs that compile sooner, memory that goes back to the system, and garbage that is looked for seldom."""
    _give_memory_back()
    gc.set_threshold(*_SELDOM)
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache")) / "jaxfrf"
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for many small matrices its threads cost more than they give
    os.environ.setdefault("NPROC", str(max(_THREADS, cores())) if cores() > 1 else "1")
    flags = os.environ.get("XLA_FLAGS", "")
    added = [flag for flag in known_flags() if flag.partition("=")[0] not in flags]
    if added:
        os.environ["XLA_FLAGS"] = " ".join([flags, *added]).strip()
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def known_flags() -> list[str]:
    """Those of XLA that are wanted, as far as the installed version is known to have them."""
    return [f"{_LOOPS}=false"] if importlib.metadata.version("jaxlib").startswith("0.10.") else []


@functools.cache
def lapack_waits() -> bool:
    """Whether a batched LAPACK call of this jaxlib hands its batch to the pool and waits."""
    numbers = importlib.metadata.version("jaxlib").split(".")[: len(_INLINE)]
    return not all(n.isdigit() for n in numbers) or tuple(map(int, numbers)) < _INLINE


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _give_memory_back() -> None:
    if any(name.startswith("MALLOC_ARENA") or name == "GLIBC_TUNABLES" for name in os.environ):
        return  # the user says how
    try:
        library = ctypes.CDLL(None)
        for option, value in ((_OWN_PAGES, _LARGE), (_TRIM, 4 * _LARGE), (_ARENAS, max(2, os.cpu_count() or 1))):
            library.mallopt(option, value)
    except (OSError, TypeError, AttributeError):  # another C library
        return


def take_cores(number: int, count: int) -> None:
    """Bind this process to its share of the cores, as number `number` of `count` alike; nothing where there are fewer
    cores than processes, or the system has no such calls. XLA's pool, whose size came from a process with all of them,
    has one thread on one core: before JAX makes it."""
    if not hasattr(os, "sched_setaffinity"):
        return
    every = sorted(os.sched_getaffinity(0))
    if count > len(every):
        return
    mine = every[number % count :: count]
    if len(mine) == 1:
        os.environ["NPROC"] = "1"
    for thread in os.listdir("/proc/self/task") if os.path.isdir("/proc/self/task") else ["0"]:
        try:
            os.sched_setaffinity(int(thread), mine)
        except OSError:  # it has ended
            continue
