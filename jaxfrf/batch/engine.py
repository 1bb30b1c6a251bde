"""Pieces of work that know nothing of each other: one after the other, or on a Dask cluster."""

import contextlib
import importlib
import itertools
import logging
import queue
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx

from .._alive import telling
from .._errors import InputError, input_error
from ..io._optional import require

_RETRIES = 2  # of a piece whose worker died or hung, on other workers
_AHEAD = 4  # pieces of every worker that wait at the scheduler: it is told of thousands as others end
_PATIENCE = 1800.0  # s without a sign of a worker
_LOOKS = 10  # at the workers, in the time that they are given
_RESTART = 30.0  # s for a worker to end


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
    client: Any = None,
    patience: float | None = None,
    say: Callable[[str], None] | None = None,
) -> Iterator[Done]:
    """`work(piece)` of every piece, in the order in which they end.

    `work` catches what it can: an exception that it lets through ends the piece, not the others. On a cluster, `work`
    and the pieces are pickled; workers that die or hang are replaced and their pieces done again, twice at most.

    **Arguments:**

    - `work`: called with a piece. `pieces`: one for each call.
    - `workers`: processes on this machine; 1: this one.
    - `cluster`: address of a Dask scheduler that runs, e.g. `tcp://host:8786`. `client`: a `dask.distributed.Client`
      of one's own, before both.
    - `patience`: seconds after which a worker that has given no sign (a step of a long run, or the end of a piece) is
      taken for hung; half an hour by default. Nobody can tell so in one process.
    - `say`: told where the work can be watched, and of workers that hang.

    **Returns:** an iterator of `Done`.

    **Raises:** `jaxfrf.InputError` for a number of workers below 1, no patience, or a cluster that does not answer;
    `ImportError` where Dask is needed and not installed.
    """
    if patience is not None and not patience > 0:
        raise input_error("patience", f"{patience:g} s", "more than 0", "Take longer than a piece of work lasts.")
    with crew(len(pieces), workers=workers, cluster=cluster, client=client, say=say) as client:
        if client is None:
            yield from (_here(work, number, piece) for number, piece in enumerate(pieces))
        else:
            yield from _there(client, work, pieces, patience or _PATIENCE, say or (lambda text: None))


@contextlib.contextmanager
def crew(
    count: int,
    *,
    workers: int = 1,
    cluster: str | None = None,
    client: Any = None,
    say: Callable[[str], None] | None = None,
) -> Iterator[Any]:
    """The client of the workers that `count` pieces are shared among, as of `outcomes`; `None`: this process does it
    all. For those who have something else to do while workers start."""
    if workers != int(workers) or workers < 1:
        raise input_error("workers", f"{workers}", "a whole number, 1 or more", "One for each core is a good start.")
    if client is not None or count == 0 or (cluster is None and workers == 1):
        yield client
        return
    with _client(min(workers, count), cluster) as client:
        if say is not None:
            say(f"watch the work at {client.dashboard_link}")
        yield client


def raised(outcome: Done, piece: str) -> Any:
    """What came of a piece of work, named in words.

    **Raises:** what `work` returned as an `InputError`, or let through; `OSError` where no worker survived it.
    """
    if isinstance(outcome.result, InputError):
        raise outcome.result
    if outcome.error is None:
        return outcome.result
    if isinstance(outcome.exception, TimeoutError):
        why = str(outcome.exception)
    elif type(outcome.exception).__name__ == "KilledWorker":
        why = "the processes that worked on it died one after the other. Was the memory too small?"
    else:
        raise outcome.exception or OSError(outcome.error)
    raise OSError(f"{piece}: {why}")


def positions_text(piece: range) -> str:
    return f"position {piece.start}" if len(piece) == 1 else f"positions {piece.start} to {piece.stop - 1}"


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
            importlib.import_module("jaxfrf.frf")  # what every piece needs, while its giver prepares

    return Prepared()


def _there(client, work, pieces, patience: float, say) -> Iterator[Done]:
    waiting = iter(enumerate(pieces))
    under_way: dict[str, tuple[int, Any]] = {}
    ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
    ahead = _AHEAD * max(1, len(client.scheduler_info()["workers"]))

    def submit() -> None:
        for number, piece in itertools.islice(waiting, ahead - len(under_way)):
            future = client.submit(_telling, work, piece, number, watch.topic, pure=False, retries=_RETRIES)
            under_way[future.key] = number, future
            future.add_done_callback(ended.put)

    with _watching(client, patience, say) as watch:
        submit()
        while under_way:
            with contextlib.suppress(queue.Empty):
                future = ended.get(timeout=patience / _LOOKS)
                if future.key in under_way:
                    number, _ = under_way.pop(future.key)
                    error = future.exception()
                    yield _failed(number, error) if error else Done(number, future.result())
                    future.release()
            for number in watch.replace_hung():
                yield from _given_up(number, under_way, patience)
            submit()


def _telling(work, piece, number: int, topic: str):
    """On a worker: the work, with signs that it advances."""
    worker = require("distributed", "batch").get_worker()
    with telling(lambda: worker.log_event(topic, {"worker": worker.address, "number": number})):
        return work(piece)


def _given_up(number: int, under_way: dict, patience: float) -> Iterator[Done]:
    for key, (which, future) in list(under_way.items()):
        if which == number:
            del under_way[key]
            future.cancel()
            yield _failed(number, TimeoutError(f"{_RETRIES + 1} workers gave no sign for {patience:g} s each"))


class _Watch:
    """When every worker that has something to do last gave a sign."""

    def __init__(self, client, patience: float, say):
        self.topic = f"jaxfrf-{uuid.uuid4().hex}"
        self._client, self._patience, self._say = client, patience, say
        self._last: dict[str, float] = {}
        self._doing: dict[str, int] = {}
        self._ended: dict[int, int] = {}  # workers, by the piece that they hung at
        self._next = 0.0

    def sign(self, event) -> None:
        _, about = event
        self._last[about["worker"]], self._doing[about["worker"]] = time.monotonic(), about["number"]

    def replace_hung(self) -> list[int]:
        """Numbers of pieces that workers have hung at too often; looks now and then."""
        now, too_often = time.monotonic(), []
        if now < self._next:
            return []
        self._next = now + self._patience / _LOOKS
        busy = {address for address, keys in self._client.processing().items() if keys}
        for address in set(self._last) - busy:
            self._last.pop(address, None)
        for address in busy:
            if now - self._last.setdefault(address, now) < self._patience:
                continue
            number = self._doing.pop(address, None)
            self._say(
                f"no sign of the worker at {address} for {self._patience:g} s: it is replaced, its work done again"
            )
            self._client.run_on_scheduler(_replaced, address=address)
            self._last.pop(address, None)
            if number is not None:
                self._ended[number] = self._ended.get(number, 0) + 1
                if self._ended[number] > _RETRIES:
                    too_often.append(number)
        return too_often


async def _replaced(address: str, dask_scheduler=None) -> None:
    """End a worker; its nanny starts another one. Where there is none, others do its work."""
    await dask_scheduler.restart_workers(
        [address], timeout=_RESTART, wait_for_workers=False, on_error="return", stimulus_id="jaxfrf: no sign of it"
    )


@contextlib.contextmanager
def _watching(client, patience: float, say) -> Iterator[_Watch]:
    watch = _Watch(client, patience, say)
    client.subscribe_topic(watch.topic, watch.sign)
    try:
        yield watch
    finally:
        client.unsubscribe_topic(watch.topic)
