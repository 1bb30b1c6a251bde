"""Gram matrices of neighbouring windows, and of windows one by one, against the columns written out in NumPy."""

import jax
import numpy as np
import pytest

from jaxfrf.frf import window
from jaxfrf.frf.gram import Columns
from jaxfrf.frf.neighbours import over_neighbours
from jaxfrf.frf.window import windows

N_LINE = 43
COLUMNS = {  # of signals 0 to 3, -1 for a column of zeros
    "one order": Columns((0, 1, 2, 0, 1, 2, 0, 0), (0, 0, 0, 1, 1, 1, 2, -1)),
    "orders of their own": Columns((3, 0, 1, 2, 1, 0), (0, 1, 2, 0, 2, 3)),
    "no order": Columns((0, 0), (0, 1)),
}


def written_out(signals, x, start, width: int, line: int, columns: Columns):
    """K^H K with the local variable scaled to 1 at the farthest line."""
    near = slice(start, start + width)
    local = x[near] - x[line]
    local = local / max(np.abs(local).max(), 1e-300)
    zero = np.zeros_like(signals[:, near, 0])
    K = [
        local**p * (signals[:, near, s] if s >= 0 else zero) for p, s in zip(columns.power, columns.signal, strict=True)
    ]
    K = np.stack(K, axis=-1).reshape(-1, len(columns.power))
    return K.conj().T @ K


@pytest.mark.parametrize("over", [over_neighbours, window._one_by_one], ids=["side by side", "one by one"])
@pytest.mark.parametrize("columns", COLUMNS.values(), ids=COLUMNS.keys())
@pytest.mark.parametrize("widths", [(1, 6, 9, 13, 40), (N_LINE,)], ids=["several", "all lines"])
def test_against_columns(over, columns, widths):
    rng = np.random.default_rng(len(widths))
    signals = rng.normal(size=(3, N_LINE, 4)) + 1j * rng.normal(size=(3, N_LINE, 4))
    x = np.cumsum(rng.uniform(0.2, 3.0, N_LINE)) + 40.0
    several = [windows(x, width) for width in widths]
    every = np.arange(len(columns.power))

    def looked_at(A, number):
        return A.block(every, every).by_window, A.power.T

    found, power = jax.jit(lambda signals: over(looked_at, signals, several, columns))(signals)
    assert found.shape == (len(widths), N_LINE, len(every), len(every))
    for k, each in enumerate(several):
        for line in range(N_LINE):
            K = written_out(signals, x, int(each.start[line]), widths[k], line, columns)
            np.testing.assert_allclose(found[k, line], K, atol=3e-14 * widths[k])
            np.testing.assert_allclose(power[k, line], np.diagonal(K).real, rtol=1e-12)
