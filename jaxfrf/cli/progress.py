"""One line about long work, the same for all commands."""

import json
import sys
import time

from .._alive import alive

_EVERY = 0.2  # s between two changes of the line
_EVENTS = 1.0  # s between two events
_under_way: "Progress | None" = None


class Progress:
    """What is done of a command's work and how long the rest takes, on standard error.

    On a terminal it is one line that changes; elsewhere nothing is printed; with `--json` it is an event a second, a
    JSON object a line: `{"event": "progress", "command": ..., "done": 0.25, "seconds_left": 12.0, "says": ...}`, of
    which `done` and `seconds_left` are null where they are not known.

        with Progress("simulate", given.json) as progress:
            simulate(..., progress=progress)

    The time that is left counts from the first thing that was done: compiling happens once, before it.
    """

    def __init__(self, command: str, as_json: bool, stream=None):
        self._command, self._json, self._stream = command, as_json, stream
        self._first: tuple[float, float] | None = None
        self._told, self._shown = -float("inf"), False
        self._began = time.monotonic()

    def __enter__(self) -> "Progress":
        global _under_way
        self._around, _under_way = _under_way, self
        return self

    def __exit__(self, *error) -> None:
        global _under_way
        self.wipe()
        _under_way = self._around

    def __call__(self, done: float, says: str = "") -> None:
        """A part from 0 to 1 is done."""
        alive()
        now = time.monotonic()
        left = self._left(done, now)
        if done < 1 and now - self._told < (_EVENTS if self._json else _EVERY):
            return
        self._told = now
        what = f"{self._command}: {100 * done:.0f} %{f', {says}' if says else ''}"
        self._show({"done": round(done, 4), "seconds_left": left, "says": says}, f"{what}{_clock(left)}")

    def say(self, text: str) -> None:
        """Where the work has come to, in words."""
        alive()
        self._show({"done": None, "seconds_left": None, "says": text}, text)

    def wipe(self) -> None:
        """Clear the line, for something else to be printed."""
        if self._shown:
            print("\r\x1b[K", end="", file=self._out, flush=True)
            self._shown = False

    @property
    def _out(self):
        return self._stream or sys.stderr

    def _left(self, done: float, now: float) -> float | None:
        if self._first is None:
            self._first = (done, now)
        first, then = self._first
        if done <= first:
            return None if done <= 0 else round((now - self._began) * (1 - done) / done, 1)
        return round((now - then) * (1 - done) / (done - first), 1)

    def _show(self, event: dict, text: str) -> None:
        if self._json:
            print(json.dumps({"event": "progress", "command": self._command, **event}), file=self._out, flush=True)
        elif self._out.isatty():
            print(f"\r\x1b[K{text}", end="", file=self._out, flush=True)
            self._shown = True


def _clock(seconds: float | None) -> str:
    if not seconds:
        return ""
    for unit, size in (("h", 3600), ("min", 60)):
        if seconds > 1.5 * size:
            return f", {seconds / size:.1f} {unit} left" if unit == "h" else f", {seconds / size:.0f} {unit} left"
    return f", {seconds:.0f} s left"


def wipe_progress() -> None:
    """Before anything else is printed."""
    if _under_way is not None:
        _under_way.wipe()
