"""Work that the cores share in threads of one process: XLA and NumPy leave Python's lock while they calculate."""

import concurrent.futures
import contextlib
import functools
import os
import pathlib
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, Generic, ParamSpec, TypeVar, overload

import jax
import threadpoolctl

from ._environment import cores, lapack_waits

_CALLS = 8  # batched LAPACK calls of one program that may run at the same time: fewer do

Given = ParamSpec("Given")
Item = TypeVar("Item")
Result = TypeVar("Result")


class kept(Generic[Result]):
    """A property that is worked out once and kept in the object, as `functools.cached_property`; without the lock that
    this has before Python 3.12, by which all objects of a class, and so the cores, wait for each other."""

    def __init__(self, work: Callable[[Any], Result]):
        self.work, self.name = work, work.__name__
        self.__doc__ = work.__doc__

    @overload
    def __get__(self, owner: None, kind: type) -> "kept[Result]": ...

    @overload
    def __get__(self, owner: object, kind: type | None = None) -> Result: ...

    def __get__(self, owner: object | None, kind: type | None = None) -> "kept[Result] | Result":
        return self if owner is None else owner.__dict__.setdefault(self.name, self.work(owner))


def lapack_threads() -> int:
    """Programs with batched LAPACK calls that may run at the same time: one for every core, while XLA's pool has
    threads for all of their calls.

    Until jaxlib 0.11.2 such a call waits in a thread of the pool for others of the pool, and programs that run at the
    same time can have some calls each: where there are as many as threads, they wait for ever
    (`jaxfrf._environment`)."""
    if not lapack_waits():
        return cores()
    stated = os.environ.get("NPROC", "")
    pool = _pool() or (int(stated) if stated.isdigit() else os.cpu_count() or 1)
    return max(1, min(cores(), pool // _CALLS))


_alone = threading.Lock()


@contextlib.contextmanager
def lapack_alone() -> Iterator[None]:
    """Within it batched LAPACK calls are those of one program: of several that run at the same time, where only some
    come to make any."""
    with _alone if lapack_waits() else contextlib.nullcontext():
        yield


@functools.cache
def _pool() -> int:
    """Threads that XLA's pool has, by their name; 0 where the system does not tell. JAX makes the pool at its first
    use: an `NPROC` that is set afterwards is not its size."""
    jax.devices()
    found = 0
    for path in pathlib.Path("/proc/self/task").glob("*/comm"):
        with contextlib.suppress(OSError):  # it has ended
            found += path.read_text() == "tf_XLAEigen\n"
    return found


def with_settings(work: Callable[[Item], Result]) -> Callable[[Item], Result]:
    """The same work in a thread of its own: JAX's settings of a thread are not those of the next."""
    settings: Any = jax.config  # its types know no flags
    wide, device = settings.jax_enable_x64, settings.jax_default_device

    def carried(item: Item) -> Result:
        with jax.enable_x64(wide), jax.default_device(device):
            return work(item)

    return carried


def shared(work: Callable[[Item], Result], items: Iterable[Item], threads: int | None = None) -> list[Result]:
    """Every item's result, in order; the first error is raised. `threads`: one for every core by default."""
    items, threads = list(items), threads or cores()
    if min(len(items), threads) < 2:
        return [work(item) for item in items]
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        return list(pool.map(with_settings(work), items))


_compiled: set[Hashable] = set()


def of_one_program(
    work: Callable[[Item], Result], items: Sequence[Item], threads: int, program: Hashable
) -> Iterator[Result]:
    """Every item's result, in order, as they come. `program`: which program `work` runs: the first item is worked on
    alone where it is not known to be compiled yet, so that not every thread compiles it."""
    first = 0 if program in _compiled else 1
    yield from map(work, items[:first])
    _compiled.add(program)
    if len(items) > first:
        with concurrent.futures.ThreadPoolExecutor(threads) as pool:
            yield from pool.map(with_settings(work), items[first:])


@functools.cache
def _libraries() -> threadpoolctl.ThreadpoolController:
    return threadpoolctl.ThreadpoolController()


@functools.cache
def _blas() -> list[Any]:
    return _libraries().select(user_api="blas").lib_controllers


def one_blas_thread(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """The function, during which NumPy's BLAS has one thread: for many small matrices more of them cost more than they
    give, and wait for each other wherever other work runs beside.

    Of several Python threads the first one decides, as `threadpoolctl` has it (from 3.8 on)."""

    @functools.wraps(function)
    def limited(*args: Given.args, **options: Given.kwargs) -> Result:
        if all(library.num_threads == 1 for library in _blas()):
            return function(*args, **options)
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **options)

    return limited
