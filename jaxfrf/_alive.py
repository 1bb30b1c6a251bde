"""A sign that long work advances, for whoever waits for it in another process."""

import contextlib
import contextvars
import time
from collections.abc import Callable, Iterator

_EVERY = 1.0  # s between two signs
_tell: contextvars.ContextVar[Callable[[], None] | None] = contextvars.ContextVar("tell", default=None)


def alive() -> None:
    """Something was finished; nothing happens where nobody waits for it."""
    tell = _tell.get()
    if tell is not None:
        tell()


@contextlib.contextmanager
def telling(tell: Callable[[], None]) -> Iterator[None]:
    """`tell` is called at the beginning, and, once a second at most, with every sign from within the block."""
    last = -float("inf")

    def now_and_then() -> None:
        nonlocal last
        if time.monotonic() - last >= _EVERY:
            last = time.monotonic()
            tell()

    before = _tell.set(now_and_then)
    try:
        now_and_then()
        yield
    finally:
        _tell.reset(before)
