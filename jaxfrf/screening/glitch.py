"""Single places where a record that cannot be compared with another period breaks its own habit."""

from collections.abc import Iterator

import numpy as np
import scipy.linalg

from .._text import number
from .finding import Finding, Severity
from .levels import _leave_out
from .record import Channel, of_channels

_ORDER = 16
_SIZE = 60.0  # times the usual innovation around it
_ALONE = 0.35  # of the largest, that no other place may reach: friction and backlash do it again and again
_NEAR = 2 * _ORDER  # samples that belong to one place
_SPAN = 64  # parts of the record over which the usual is taken


@of_channels("uy")
def glitch(c: Channel) -> Iterator[Finding]:
    """A jump or spike that nothing before it announces, once in a record of one period or none.

    The signal is predicted from its 16 last samples (autoregression over the whole record); a place counts where the
    error is 60 times the usual one around it, and no other place comes near. A blow that is the input is none.
    """
    if c.record.data.n_periods < 2 and (found := _place(c)) is not None and not _struck(c, found[0]):
        at, size = found
        yield c.finding(
            "glitch",
            Severity.WARNED,
            size,
            f"breaks at sample {at}: it departs there from what its last {_ORDER} samples announce by "
            f"{number(size, 2)} times the usual, and nowhere else. Samples lost or doubled, a spike, a blow? Keep "
            f"the part before or after it ({_leave_out(c, at, at + 1)}).",
            sure=size,
            samples=(at, at + 1),
        )


def _struck(c: Channel, at: int) -> bool:
    """Whether most of what an input does in the run stands around a sample."""
    u = np.asarray(c.record.data.u)[c.pos, c.exp]
    power = (u - np.median(u, axis=0)) ** 2
    return bool(np.any(power[max(at - _NEAR, 0) : at + _NEAR].sum(axis=0) > 0.5 * power.sum(axis=0)))


def _place(c: Channel) -> tuple[int, float] | None:
    x = c.x[c.first :] - c.x[c.first :].mean()
    n = len(x)
    if n < 20 * _ORDER:
        return None
    together = np.array([x[: n - lag] @ x[lag:] for lag in range(_ORDER + 1)])
    together[0] *= 1 + 1e-10
    try:
        a = scipy.linalg.solve_toeplitz(together[:-1], together[1:])
    except np.linalg.LinAlgError:
        return None
    error = np.abs(np.convolve(x, np.concatenate([[1.0], -a]), mode="valid"))
    width = max(n // _SPAN, 4 * _ORDER)
    count = len(error) // width
    usual = np.median(error[: count * width].reshape(count, width), axis=1)
    usual = np.maximum(np.repeat(usual, width), np.median(usual))
    usual = np.pad(usual, (0, len(error) - len(usual)), mode="edge") + 1e-9 * x.std()
    ratio = error / usual
    at = int(np.argmax(ratio))
    away = np.ones(len(ratio), bool)
    away[max(at - _NEAR, 0) : at + _NEAR] = False
    if ratio[at] < _SIZE or ratio[away].max(initial=0.0) > _ALONE * ratio[at]:
        return None
    return c.first + _ORDER + at, float(ratio[at])
