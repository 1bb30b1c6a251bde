"""One thread of NumPy's BLAS while a verb runs, and its own number afterwards."""

import threading

import numpy as np  # noqa: F401 - loads the BLAS
import pytest
import threadpoolctl

from jaxfrf._threads import one_blas_thread


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
