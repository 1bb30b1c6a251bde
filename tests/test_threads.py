"""One thread of NumPy's BLAS while a verb runs, and its own number afterwards; XLA's pool; work side by side."""

import importlib.metadata
import os
import subprocess
import sys
import threading

import numpy as np  # noqa: F401 - loads the BLAS
import pytest
import threadpoolctl

from jaxfrf import _environment, _threads
from jaxfrf._threads import kept, one_blas_thread, shared


def threads():
    return {x["num_threads"] for x in threadpoolctl.threadpool_info() if x["user_api"] == "blas"}


@pytest.fixture
def three():
    with threadpoolctl.threadpool_limits(3, user_api="blas"):
        assert threads() == {3}
        yield
        assert threads() == {3}


@one_blas_thread
def inside(what):
    return threads(), what()


@pytest.mark.usefixtures("three")
def test_one_within_and_as_before_afterwards():
    assert inside(threads) == ({1}, {1})
    assert inside(lambda: inside(threads)) == ({1}, ({1}, {1}))
    with pytest.raises(ZeroDivisionError):
        inside(lambda: 1 / 0)


@pytest.mark.usefixtures("three")
def test_calls_in_several_threads():
    """Whoever ends first, the number comes back."""
    began, may_end = threading.Event(), threading.Event()
    other = threading.Thread(target=lambda: inside(lambda: (began.set(), may_end.wait(10.0))))

    def first():
        other.start()
        began.wait(10.0)

    inside(first)
    may_end.set()
    other.join()


@pytest.mark.parametrize(
    ("version", "stated", "at_once"),
    [("0.10.2", "64", 4), ("0.10.2", "16", 2), ("0.10.2", "1", 1), ("0.11.1rc1", "1", 1), ("0.12.0.1", "1", 4)],
)
def test_programs_at_once(monkeypatch, version, stated, at_once):
    """Until jaxlib 0.11.2 as many as the pool has room for; on four cores."""
    monkeypatch.setattr(importlib.metadata, "version", lambda name: version)
    monkeypatch.setattr(_threads, "cores", lambda: 4)
    monkeypatch.setattr(_threads, "lapack_waits", _environment.lapack_waits.__wrapped__)
    monkeypatch.setattr(_threads, "_pool", lambda: 0)  # as where the system does not tell it
    monkeypatch.setenv("NPROC", stated)
    assert _threads.lapack_threads() == at_once


LATE = """
import os, jax
jax.devices()
os.environ["NPROC"] = "64"
from jaxfrf import _threads
_threads.cores = lambda: 4
print(_threads._pool(), _threads.lapack_threads())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere the system does not tell the pool's size")
@pytest.mark.skipif(not _environment.lapack_waits(), reason="this jaxlib's LAPACK calls wait for nobody")
def test_a_pool_that_jax_made_before_it_was_told_a_size():
    """Programs that trusted the variable would wait for each other for ever."""
    done = subprocess.run(
        [sys.executable, "-c", LATE], env=os.environ | {"NPROC": "2"}, stdout=subprocess.PIPE, text=True, check=True
    )
    assert done.stdout.split() == ["2", "1"]


ONE_CORE = """
import os, sys
from jaxfrf import _environment
first = min(os.sched_getaffinity(0))
if sys.argv[1] == "bound":
    os.sched_setaffinity(0, [first])
_environment.prepare()
if sys.argv[1] == "worker":
    _environment.take_cores(0, len(os.sched_getaffinity(0)))
print(os.environ["NPROC"], len(os.sched_getaffinity(0)))
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no such calls here")
@pytest.mark.parametrize(("how", "stated", "pool"), [("bound", None, 1), ("bound", "8", 8), ("worker", None, 1)])
def test_one_core_has_one_thread(how, stated, pool):
    """Unless the user says otherwise; a worker has what its starter prepared for all cores."""
    environment = {name: value for name, value in os.environ.items() if name != "NPROC"}
    environment |= {} if stated is None else {"NPROC": stated}
    done = subprocess.run([sys.executable, "-c", ONE_CORE, how], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == [str(pool), "1"], done.stderr


def test_kept_is_worked_out_once_and_side_by_side():
    """Two objects' values at the same time: `functools.cached_property` has one after the other on Python 3.11."""
    meet, asked = threading.Barrier(2, timeout=20), []

    class Scene:
        @kept
        def value(self) -> int:
            """Of this scene."""
            asked.append(self)
            return meet.wait()

    scenes = [Scene(), Scene()]
    first = shared(lambda scene: scene.value, scenes, threads=2)
    assert sorted(first) == [0, 1] and [scene.value for scene in scenes] == first and len(asked) == 2
    assert Scene.value.__doc__ == "Of this scene."
