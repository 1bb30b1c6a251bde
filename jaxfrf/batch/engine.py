"""Pieces of work that know nothing of each other: one after the other, or on a Dask cluster."""

import contextlib
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx

from .._errors import input_error
from ..io._optional import require

_RETRIES = 2  # of a piece whose worker died, on other workers
_AHEAD = 4  # pieces of every worker that wait at the scheduler: it is told of thousands as others end


class Done(eqx.Module):
    """How a piece of work ended.

    **Fields:** `number`: its place among all. `result`: what it gave; `None` where `error` says why there is none (its
    worker died again and again, or the cluster was lost). `exception`: that was raised.
    """

    number: int
    result: Any
    error: str | None = None
    exception: Exception | None = None


def outcomes(
    work: Callable[[Any], Any],
    pieces: Sequence[Any],
    *,
    workers: int = 1,
    cluster: str | None = None,
    client=None,
    say: Callable[[str], None] | None = None,
) -> Iterator[Done]:
    """`work(piece)` of every piece, in the order in which they end.

    `work` catches what it can: an exception that it lets through ends the piece, not the others. On a cluster, `work`
    and the pieces are pickled, workers that die are replaced and their pieces done again on others.

    **Arguments:**

    - `workers`: processes on this machine; 1: this one.
    - `cluster`: address of a Dask scheduler that runs, e.g. `tcp://host:8786`. `client`: a `dask.distributed.Client`
      of one's own, before both.
    - `say`: told where the work can be watched.

    **Raises:** `jaxfrf.InputError` for a number of workers below 1, or a cluster that does not answer; `ImportError`
    where Dask is needed and not installed.
    """
    if workers != int(workers) or workers < 1:
        raise input_error("workers", f"{workers}", "a whole number, 1 or more", "One for each core is a good start.")
    if not pieces:
        return
    if client is None and cluster is None and workers == 1:
        yield from (_here(work, number, piece) for number, piece in enumerate(pieces))
        return
    with contextlib.ExitStack() as stack:
        if client is None:
            client = stack.enter_context(_client(min(workers, len(pieces)), cluster))
            if say is not None:
                say(f"watch the work at {client.dashboard_link}")
        yield from _there(client, work, pieces)


def _here(work, number: int, piece) -> Done:
    try:
        return Done(number, work(piece))
    except Exception as error:
        return _failed(number, error)


def _failed(number: int, error: Exception) -> Done:
    return Done(number, None, f"{type(error).__name__}: {error}", error)


@contextlib.contextmanager
def _client(workers: int, address: str | None):
    distributed = require("distributed", "batch")
    if address is not None:
        try:
            client = distributed.Client(address, timeout="10s")
        except (OSError, ValueError) as error:
            raise input_error(
                address, f"no Dask scheduler ({error})", "one that runs", "Start it with `dask scheduler`."
            ) from None
        with client:
            client.register_plugin(_prepared(distributed, None))
            yield client
        return
    # A process each: threads of one process share XLA's thread pool, and its locks.
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "dashboard_address": "127.0.0.1:0"}
    options["silence_logs"] = logging.ERROR
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        client.register_plugin(_prepared(distributed, workers))
        yield client


def _prepared(distributed, workers: int | None):
    """What every worker does before its first piece, and again after it was replaced: JAX's settings, and, of so many
    workers on one machine, each its own cores: the thread pools of all would share every core otherwise."""

    class Prepared(distributed.WorkerPlugin):
        name = "jaxfrf"

        def setup(self, worker):
            from jaxfrf import _environment

            _environment.prepare()
            if workers is not None and isinstance(worker.name, int):
                _environment.take_cores(worker.name, workers)

    return Prepared()


def _there(client, work, pieces) -> Iterator[Done]:
    distributed = require("distributed", "batch")
    waiting = iter(enumerate(pieces))
    ahead = _AHEAD * max(1, len(client.scheduler_info()["workers"]))
    number_of = {}

    def submitted():
        for number, piece in waiting:
            future = client.submit(work, piece, pure=False, retries=_RETRIES)
            number_of[future.key] = number
            return future
        return None

    under_way = distributed.as_completed([f for f in (submitted() for _ in range(ahead)) if f is not None])
    for future in under_way:
        error = future.exception()
        number = number_of.pop(future.key)
        yield _failed(number, error) if error else Done(number, future.result())
        future.release()
        following = submitted()
        if following is not None:
            under_way.add(following)
