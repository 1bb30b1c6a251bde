"""Lines of a record for a diagnosis: the noise of the angle, whatever was logged."""

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.robot.quantity import derivatives
from jaxfrf.trajectory.measured import measured

FS, PERIOD, LEVEL = 1000.0, 4000, 3e-3
TIME = np.arange(PERIOD) / FS
LINES = np.arange(17, 240, 2)


def log(quantity, periods=1, positions=2, experiments=3, shaped=lambda e: e, lines=LINES, seed=0):
    """Noise alone in `y`, white before `shaped`; the angle is known to stand still."""
    rng = np.random.default_rng(seed)
    y = shaped(LEVEL * rng.standard_normal((positions, experiments, periods * PERIOD, 1)))
    signal = np.zeros_like(y)
    q = np.zeros((positions, 1))
    return jf.Experiment(u=signal, y=y, r=signal, q=q, fs=FS, period=PERIOD, lines=lines, y_quantity=quantity)


@pytest.mark.parametrize("periods", [1, 4])
@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration"])
def test_white_noise_of_a_log(quantity, periods):
    """Its lines have LEVEL/sqrt(N) of rms, less over several periods; the angle's are that over omega^n: against the
    lines that the diagnosis itself is given."""
    found = measured(log(quantity, periods, positions=4, experiments=8))
    omega = 2 * np.pi * found.frequency[1:]
    expected = LEVEL / np.sqrt(PERIOD * periods) / omega ** derivatives(quantity)
    np.testing.assert_allclose(found.noise[1:, 0], expected, rtol=0.2)
    given = np.sqrt(np.mean(np.abs(found.Y[:, :, 1:, 0]) ** 2, axis=(0, 1)))
    ratio = given / found.noise[1:, 0]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.1)
    assert found.noise[0, 0] == 0.0  # the mean position is left out


def test_a_speed_that_was_made_from_angles():
    """White noise of an angle, differentiated: white again once it is back, though the speed's rises with frequency."""

    def differentiated(e):
        s = 2j * np.pi * np.fft.rfftfreq(e.shape[2], 1 / FS)[:, None]
        return np.fft.irfft(s * np.fft.rfft(e, axis=2), n=e.shape[2], axis=2)

    found = measured(log("velocity", shaped=differentiated, experiments=8))
    np.testing.assert_allclose(found.noise[1:, 0], LEVEL / np.sqrt(PERIOD), rtol=0.2)


def test_lines_that_leave_no_band_for_the_noise():
    with pytest.raises(jf.InputError, match=r"lines up to 450 Hz in a single period.*two or more steady periods"):
        measured(log("velocity", lines=np.array([1799, 1801]) - 1))
    assert measured(log("velocity", periods=2, lines=np.array([1798, 1800]))).frequency[-1] == 450.0


def test_lines_beyond_nyquist_are_not_made_up():
    """Without a list of lines those are taken that the reference excites."""
    data = log("position", periods=2, lines=None)
    k = np.arange(1, PERIOD // 2, 2)
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, len(k))
    period = np.cos(2 * np.pi * np.outer(np.arange(PERIOD), k) / PERIOD + phases).sum(axis=1)
    r = np.broadcast_to(np.tile(period, 2)[:, None], data.u.shape)
    slow = jf.Experiment(u=data.u, y=data.y, r=r, q=data.q, fs=100.0, period=PERIOD, y_quantity="position")
    assert measured(slow).frequency[-1] == pytest.approx(50.0 - 100.0 / PERIOD)
