"""Runs that begin and end at rest: nothing leaks, whatever was between.

What leaks from a run that is cut out of a longer motion is what the plant's state at its end and at its beginning
differ by. After a blow, a burst or a sweep that is recorded from rest to rest both are nothing, and Y = G U holds as if
the run were one period.
"""

import numpy as np

from ..experiment import Experiment

_START = 2  # samples: where u begins with the record, y moves soon
_END, _LEAST = 0.02, 8  # of a record; samples
_PARTS = 20  # of a record, the loudest of which the start is held against
_QUIET = 1e-3  # mean square at an end over that of the whole: at most 1-2 % of Y leak then, at resonances
_NOISY = 1e-2  # the same where it is no longer falling: noise
_FALLING = 0.6  # of the last twentieth over the one before; noise of 200 samples stays above it (2.9 deviations)
_INPUT = 0.1  # of u: its own noise does not leak
_BLOCK = 12  # lines, of narrow windows
_SMOOTH = 0.3  # part of the power in such a block that a parabola leaves: .75 of noise, sweeps, steps at random


def at_rest(data: Experiment) -> bool:
    """Whether every run of a record without a period begins and ends at rest.

    That y says, and u at the end; at the beginning it may start at once."""
    if data.n_time < _PARTS * _LEAST:
        return False
    return _inputs_end(data) and bool(_rests(np.asarray(data.y)).all())


def _inputs_end(data: Experiment) -> bool:
    """Whether inputs and references stop before the runs end, where they came from."""
    return all(_stops(np.asarray(x)).all() for x in (data.u, data.r) if x is not None)


def _stops(x) -> np.ndarray:
    """(pos, exp, channel)."""
    parts, _ = _parts(x)
    loud = np.mean(parts**2, axis=3)
    returned = parts[:, :, 0].mean(axis=2) ** 2 <= _INPUT * loud.max(axis=2)
    return returned & (np.var(_end(x), axis=2) <= _INPUT * loud.mean(axis=2))


def _rests(y) -> np.ndarray:
    """(pos, exp, channel)."""
    parts, level = _parts(y)
    loud, last = np.mean(parts**2, axis=3), np.var(_end(y), axis=2)
    whole, steady = loud.mean(axis=2), np.var(parts[:, :, -1], axis=2) >= _FALLING * np.var(parts[:, :, -2], axis=2)
    started = np.mean((y[:, :, :_START] - level) ** 2, axis=2) <= _NOISY * loud.max(axis=2)
    return started & ((last <= _QUIET * whole) | ((last <= _NOISY * whole) & steady))


def _parts(x):
    """Parts of a signal, (pos, exp, part, time, channel), about the level at its end, and that."""
    n = x.shape[2] // _PARTS
    level = _end(x).mean(axis=2, keepdims=True)
    return (x - level)[:, :, -_PARTS * n :].reshape(*x.shape[:2], _PARTS, n, x.shape[3]), level


def _end(x) -> np.ndarray:
    return x[:, :, x.shape[2] - max(int(_END * x.shape[2]), _LEAST) :]


def left_at_end(data: Experiment) -> float:
    """rms of y at the end of a run over that of the whole run, of the channel that has the most left."""
    y = np.asarray(data.y)
    y = y - np.median(y, axis=2, keepdims=True)
    last = np.mean(_end(y) ** 2, axis=2)
    whole = np.mean(y**2, axis=2)
    return float(np.sqrt(np.max(last / np.where(whole > 0, whole, np.inf))))


def is_short(data: Experiment, X) -> bool:
    """Whether the excitation X, (pos, exp, freq, channel), is as smooth over some neighbouring lines as what leaks, and
    ends with the runs.

    That of a blow or a short burst is: T would take all of G U, and leave the noise of X to tell G."""
    if data.n_time < _PARTS * _LEAST or not _inputs_end(data):
        return False
    X = np.asarray(X)
    count = X.shape[2] // _BLOCK
    if count == 0:
        return False
    blocks = np.moveaxis(X[:, :, : count * _BLOCK].reshape(*X.shape[:2], count, _BLOCK, X.shape[3]), 3, -1)
    powers = np.linspace(-1.0, 1.0, _BLOCK)[:, None] ** np.arange(3)
    Q, _ = np.linalg.qr(powers)
    whole = np.sum(np.abs(blocks) ** 2, axis=(1, 3, 4))
    taken = np.sum(np.abs(blocks @ Q) ** 2, axis=(1, 3, 4))
    left = 1.0 - taken / np.where(whole > 0, whole, np.inf)
    return bool(np.median(left) < _SMOOTH)
