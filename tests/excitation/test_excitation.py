"""Line grids, phases, orthogonal multisines and references, against closed forms and sums written out."""

import dataclasses
import re

import jax
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxfrf import InputError, excitation as ex

PAPER_LINES = (112, 2240, 366)
QUICK = settings(max_examples=25, deadline=None)


def sum_of_sines(lines, coefficients, period):
    """x(t) = sum_k 2 Re(X_k exp(2 pi j k t/N)), written out: (time, channel)."""
    t = np.arange(period)[:, None]
    return 2 * np.real(np.exp(2j * np.pi * (t * lines % period) / period) @ coefficients)


# --- lines


def test_paper_lines():
    lines = ex.log_odd_lines(*PAPER_LINES)
    assert len(lines) == 336
    assert np.all(lines % 2 == 1)
    assert np.round(lines[[0, -1]] / 28, 3).tolist() == [4.036, 79.321]
    assert len(ex.odd_lines(112, 2240)) == 1064
    odd, even = ex.detection_lines(lines, 112, 2240)
    assert len(odd) == 728
    assert len(even) == 1065


def test_band_in_hertz():
    band = ex.band_lines(4.0, 80.0, 2000.0, 56000)
    assert band == (112, 2240)
    assert len(ex.log_odd_lines(*band, 366)) == 336
    assert ex.band_lines(0.0, 5.0, 10.0, 10) == (1, 4)  # neither the mean nor half the sampling frequency
    with pytest.raises(InputError, match="half the sampling frequency"):
        ex.band_lines(0.0, 5.1, 10.0, 10)


@given(first=st.integers(1, 500), width=st.integers(0, 700), group=st.integers(2, 9), seed=st.integers(0, 9))
@QUICK
def test_grids(first, width, group, seed):
    last = first + 1 + width
    expected = [k for k in range(first, last + 1) if k % 2]
    odd = ex.odd_lines(first, last)
    assert odd.tolist() == expected
    assert ex.full_lines(first, last).tolist() == list(range(first, last + 1))
    kept = ex.random_odd_lines(first, last, group=group, key=jr.key(seed))
    whole = len(odd) // group * group
    per_group = np.isin(odd[:whole].reshape(-1, group), kept).sum(axis=1)
    assert np.all(per_group == group - 1)
    assert np.all(np.isin(odd[whole:], kept))
    assert np.all(np.isin(kept, odd))
    silent_odd, silent_even = ex.detection_lines(kept, first, last) if kept.size else (odd, [])
    assert sorted([*kept, *silent_odd]) == expected
    assert all(k % 2 == 0 for k in silent_even)


@given(first=st.integers(1, 400), factor=st.floats(1.5, 50), points=st.integers(1, 200))
@QUICK
def test_log_lines_follow_the_logarithmic_axis(first, factor, points):
    last = int(first * factor) + 2
    lines = ex.log_odd_lines(first, last, points)
    assert np.all(lines % 2 == 1)
    assert np.all(np.diff(lines) > 0)
    assert first <= lines[0] and lines[-1] <= last
    ideal = first * (last / first) ** (np.arange(points) / max(points - 1, 1))
    assert np.all(np.min(np.abs(lines[:, None] - ideal), axis=1) <= 1 + 1e-9)


def test_random_lines_are_uniform_within_their_group():
    odd = ex.odd_lines(1, 8000)
    left_out = np.setdiff1d(odd, ex.random_odd_lines(1, 8000, group=4, key=jr.key(3)))
    places = np.bincount((left_out - 1) // 2 % 4, minlength=4)
    assert np.all(np.abs(places - 250) < 4 * np.sqrt(1000 * 0.25 * 0.75))


# --- phases


def test_random_phases_do_not_depend_on_precision():
    drawn = ex.random_phases((3, 500), jr.key(1))
    with jax.enable_x64(False):
        assert np.array_equal(ex.random_phases((3, 500), jr.key(1)), drawn)
    assert drawn.dtype == np.float64
    assert 0 <= drawn.min() and drawn.max() < 2 * np.pi
    assert abs(np.mean(np.exp(1j * drawn))) < 4 / np.sqrt(drawn.size)


def test_schroeder_rule_on_consecutive_lines():
    n = np.arange(1, 33)
    closed_form = -np.pi * n * (n - 1) / 32
    phases = ex.schroeder_phases(np.ones(32), n)
    assert np.allclose(np.exp(1j * phases), np.exp(1j * closed_form), atol=1e-11)
    # Odd lines, one line only: the same rule per line.
    assert np.allclose(ex.schroeder_phases(np.ones(32), 2 * n + 5), phases)
    assert ex.schroeder_phases([2.0], [7]).tolist() == [0.0]


def crest(lines, phases, **options):
    design = ex.Multisine(1000.0, 4000, lines, phases=phases, **options)
    return ex.reference_levels(ex.reference(design)).crest


@pytest.mark.parametrize("n", [64, 100, 250])
def test_schroeder_crest_factor(n):
    """4.6 dB for many lines (Boyd, IEEE Trans. Circuits Syst. 33 (1986): Newman phases, shifted in time)."""
    assert crest(np.arange(1, n + 1), ex.SchroederPhases()).item() == pytest.approx(10 ** (4.6 / 20), rel=0.02)


@pytest.mark.parametrize("lines", [np.arange(1, 40), np.arange(31, 231, 2), ex.log_odd_lines(20, 200, 60)])
def test_optimised_crest_factor_is_lower(lines):
    optimised = crest(lines, ex.CrestOptimisedPhases()).item()
    assert optimised < crest(lines, ex.SchroederPhases()).item() - 0.1
    assert optimised < crest(lines, ex.RandomPhases()).item() - 0.1
    assert optimised < 1.85


def test_optimised_crest_factors_of_a_block():
    """All nine signals of three inputs come down, and the block stays orthogonal."""
    options = {"n_in": 3, "seed": 4}
    lines = np.arange(21, 141, 2)
    assert crest(lines, ex.CrestOptimisedPhases(), **options).max() < crest(lines, ex.RandomPhases(), **options).min()
    design = ex.Multisine(1000.0, 4000, lines, phases=ex.CrestOptimisedPhases(), **options)
    _assert_orthogonal(design)


def test_crest_factor_of_known_signals():
    t = np.arange(1000)[:, None] / 1000
    sine, square = np.sin(2 * np.pi * 3 * (t + 1 / 12)), np.sign(np.sin(2 * np.pi * (t + 1e-4)))
    assert ex.crest_factor(np.hstack([sine, square])) == pytest.approx([np.sqrt(2), 1.0], rel=1e-4)


# --- multisines


def _assert_orthogonal(design):
    R = ex.reference_spectra(design).reshape(design.blocks, design.n_in, len(design.lines), design.n_in)
    for block in R:
        matrix = block.transpose(1, 2, 0)  # (freq, in, exp)
        power = matrix @ matrix.conj().swapaxes(1, 2)
        A = np.sqrt(design.n_in) / 2 * design.amplitude
        expected = A[:, :, None] ** 2 * np.eye(design.n_in)
        assert np.max(np.abs(power - expected)) <= 1e-13 * np.max(expected)


@pytest.mark.parametrize("n_in", [1, 2, 3, 6, 7])
@pytest.mark.parametrize("phases", [ex.RandomPhases(), ex.SchroederPhases()])
def test_orthogonal(n_in, phases):
    lines = ex.odd_lines(5, 60)
    amplitude = np.random.default_rng(0).uniform(0.1, 3, (len(lines), n_in))
    blocks = 3 if phases.random else 1
    _assert_orthogonal(ex.Multisine(1000.0, 200, lines, amplitude=amplitude, blocks=blocks, phases=phases))


@given(n_in=st.integers(1, 5), blocks=st.integers(1, 3), period=st.integers(40, 90), seed=st.integers(0, 2**31))
@QUICK
def test_rms_in_time_is_that_of_the_spectrum(n_in, blocks, period, seed):
    rms = np.linspace(1, 3, n_in)
    design = ex.Multisine(100.0, period, ex.odd_lines(3, 19), rms=rms, blocks=blocks, seed=seed)
    played = ex.reference(design)
    assert played.r.shape == (blocks * n_in, period, n_in)
    assert np.allclose(ex.rms(played.r), rms, rtol=1e-12)
    assert np.allclose(np.sqrt(ex.line_power(played.spectra).sum(axis=1)), rms, rtol=1e-12)
    assert np.allclose(design.rms, rms, rtol=1e-12)


def test_signals_are_the_sum_of_sines():
    slow = ex.SlowSine([3, 5], [10.0, 20.0])
    design = ex.Multisine(100.0, 120, [11, 15, 27], rms=[1.0, 2.0], slow=slow, blocks=2, periods=2)
    played = ex.reference(design)
    R = ex.reference_spectra(design)
    t = np.arange(120)
    sines = np.stack([10 * np.cos(2 * np.pi * 3 * t / 120), 20 * np.cos(2 * np.pi * 5 * t / 120)], axis=1)
    for exp in range(4):
        expected = sum_of_sines(design.lines, R[exp], 120) + sines
        assert np.allclose(played.r[exp], np.tile(expected, (2, 1)), atol=1e-12)
    assert np.allclose(played.spectra, R, atol=1e-13)


def test_position_differentiates_back_to_the_speed():
    """Every sine of the position, differentiated by hand, is the sine of the speed; and the mean is zero."""
    slow = ex.SlowSine([1, 2], [30.0, 0.0])
    design = ex.Multisine(50.0, 101, [7, 9, 30], amplitude=np.array([[1, 2], [3, 4], [5, 6.0]]), slow=slow)
    played = ex.reference(design)
    lines = np.array([1, 7, 9, 30])
    omega = 2 * np.pi * lines * 50.0 / 101
    Q = np.fft.fft(played.position, axis=1)[:, lines] / 101
    velocity = np.stack([sum_of_sines(lines, 1j * omega[:, None] * q, 101) for q in Q])
    assert np.allclose(velocity, played.r, atol=1e-11)
    assert np.allclose(played.position.mean(axis=1), 0, atol=1e-13)


def test_slow_sine_alone():
    """The position of a cos(w t) is a/w sin(w t)."""
    tiny = ex.Multisine(2000.0, 2000, [101], rms=1e-12, slow=ex.SlowSine([3], [30.0]))
    played = ex.reference(tiny)
    omega = 2 * np.pi * 3
    t = played.time
    assert np.allclose(played.r[0, :, 0], 30 * np.cos(omega * t), atol=1e-9)
    assert np.allclose(played.position[0, :, 0], 30 / omega * np.sin(omega * t), atol=1e-9)


def test_ramp_starts_from_rest_and_leaves_the_steady_periods_alone():
    design = ex.Multisine(1000.0, 1000, ex.odd_lines(9, 41), n_in=2, slow=ex.SlowSine([1, 3], [5.0, 5.0]))
    design = dataclasses.replace(design, transient_periods=1, periods=2)
    plain = ex.reference(design)
    faded = ex.reference(dataclasses.replace(design, ramp=0.5))
    assert np.array_equal(faded.r[:, 500:], plain.r[:, 500:])
    assert np.array_equal(faded.position[:, 500:], plain.position[:, 500:])
    assert not np.any(faded.r[:, 0]) and not np.any(faded.position[:, 0])
    # Central differences of the position: error h^2/6 times the third derivative.
    speed = (faded.position[:, 2:] - faded.position[:, :-2]) * 500.0
    bound = 1e-6 / 6 * np.sum(design.amplitude[:, 0]) * (2 * np.pi * 41) ** 2
    assert np.max(np.abs(speed - faded.r[:, 1:-1])) < bound


def test_blocks_are_independent_and_can_be_continued():
    design = ex.Multisine(100.0, 200, ex.odd_lines(3, 95), n_in=2, seed=5)
    more = dataclasses.replace(design, blocks=40)
    R = ex.reference_spectra(more)
    assert np.array_equal(R[:2], ex.reference_spectra(design))
    assert np.array_equal(ex.reference_spectra(design, key=jr.key(5)), R[:2])
    assert np.array_equal(ex.reference(design, key=6).r, ex.reference(dataclasses.replace(design, seed=6)).r)
    assert not np.allclose(ex.reference_spectra(design, key=jr.key(6)), R[:2])
    blocks = R.reshape(40, 2, -1) / np.abs(R).reshape(40, 2, -1)
    mean = blocks.mean(axis=0)  # unit phasors of independent, uniform phase
    assert np.sqrt(np.mean(np.abs(mean) ** 2)) == pytest.approx(1 / np.sqrt(40), rel=0.25)


def test_rms_scales_a_shape():
    shape = np.array([4.0, 2.0, 1.0])
    design = ex.Multisine(100.0, 100, [5, 9, 21], amplitude=shape, rms=[1.0, 10.0])
    ratio = design.amplitude / shape[:, None]
    assert np.allclose(ratio, ratio[0])
    assert np.allclose(ratio[0] ** 2 * (16 + 4 + 1) / 2, [1.0, 100.0])
    unscaled = ex.Multisine(100.0, 100, [5, 9, 21], amplitude=shape, n_in=2)
    assert np.array_equal(unscaled.amplitude, np.stack([shape, shape], axis=1))
    assert ex.Multisine(100.0, 100, [5, 9, 21]).rms == pytest.approx(1.0)


def test_shaped_amplitude_is_straight_on_logarithmic_axes():
    f = np.array([1.0, 10.0, 20.0, 40.0, 80.0])
    falling = ex.shaped_amplitude(f, [10.0, 40.0], [1.0, 0.25])
    assert np.allclose(falling, [1.0, 1.0, 0.5, 0.25, 0.25])
    both = ex.shaped_amplitude(f, [10.0, 40.0], [[1.0, 0.25], [3.0, 3.0]])
    assert np.allclose(both, np.stack([falling, np.full(5, 3.0)], axis=1))


def test_levels_of_a_known_signal():
    """One sine a = 2 rad/s at 5 Hz on a slow one of 10 rad/s at 1 Hz."""
    design = ex.Multisine(2000.0, 2000, [5], amplitude=[2.0], slow=ex.SlowSine([1], [10.0]))
    level = ex.reference_levels(ex.reference(design))
    assert level.rms.item() == pytest.approx(np.sqrt(2))
    assert level.crest.item() == pytest.approx(np.sqrt(2), rel=1e-4)
    assert 10 < level.velocity.item() <= 12
    fast, slow = 2 * 2 * np.pi * 5, 10 * 2 * np.pi
    assert fast < level.acceleration.item() <= fast + slow
    assert 10 / (2 * np.pi) - 2 / (10 * np.pi) < level.position.item() <= 10 / (2 * np.pi) + 2 / (10 * np.pi)


@pytest.mark.parametrize(
    ("name", "of", "unit"),
    [
        ("velocity_limit", lambda x: x.r, "rad/s"),
        ("travel_limit", lambda x: x.position, "rad"),
        ("acceleration_limit", lambda x: np.gradient(x.r, 1 / x.fs, axis=1)[:, 1:-1], "rad/s^2"),
    ],
)
def test_limits(name, of, unit):
    design = ex.Multisine(1000.0, 1000, ex.odd_lines(1, 9), rms=[1.0, 2.0], **{name: [500.0, 500.0]})
    peak = 1.001 * np.max(np.abs(of(ex.reference(design))), axis=(0, 1))
    assert ex.reference(dataclasses.replace(design, **{name: peak})).n_exp == 2
    less = dataclasses.replace(design, **{name: peak * [1.0, 0.8]})
    with pytest.raises(
        InputError, match=rf"{name}: found a peak of .* {re.escape(unit)} in .*, channel 1; "
    ) as refused:
        ex.reference(less)
    share = float(re.search(r"to ([\d.]+) of what they are", str(refused.value))[1])
    assert 0.79 < share <= 0.801
    ex.reference(dataclasses.replace(less, amplitude=share * less.amplitude))


BAD_DESIGNS = [
    ({"fs": -1.0}, "fs: found -1.0; expected one positive number"),
    ({"fs": "2000"}, "fs: found '2000'; expected finite numbers"),
    ({"fs": np.nan}, "fs: found nan; expected finite numbers"),
    ({"period": 100.5}, "period: found 100.5; expected a whole number, 3 or more"),
    ({"lines": []}, "lines: found .*; expected finite numbers"),
    ({"lines": [5, 60]}, "lines: found 5 to 60; expected lines between 1 and 49"),
    ({"lines": [0, 5]}, "lines: found 0 to 5; expected lines between 1 and 49"),
    ({"lines": [9, 5]}, "lines: found a list that is not increasing"),
    ({"lines": [5, 5]}, "lines: found a list that is not increasing"),
    ({"lines": [5.5]}, "lines: found .*; expected whole numbers"),
    ({"blocks": 0}, "blocks: found 0; expected a whole number, 1 or more"),
    ({"blocks": True}, "blocks: found True"),
    ({"periods": 0}, "periods: found 0; expected a whole number, 1 or more"),
    ({"transient_periods": -1}, "transient_periods: found -1; expected a whole number, 0 or more"),
    ({"seed": 0.5}, "seed: found 0.5; expected a whole number"),
    ({"rms": [1.0, 0.0]}, r"rms: found \[1.0, 0.0\]; expected one positive number"),
    ({"rms": [1.0, np.inf]}, "rms: found .*; expected finite numbers"),
    (
        {"rms": [1.0, 2.0], "n_in": 3},
        "channels: found 3 in n_in, 2 in rms; expected the same number everywhere",
    ),
    ({"amplitude": [1.0]}, r"amplitude: found shape \(1,\) for 2 lines; expected \(freq,\) or \(freq, in\)"),
    ({"amplitude": [1.0, 0.0]}, "amplitude: found 1 values that are not positive; expected power at every"),
    ({"amplitude": [[1.0], [1.0, 2.0]]}, "amplitude: found .*; expected finite numbers"),
    ({"phases": "random"}, "phases: found 'random'; expected a choice of phases"),
    (
        {"phases": ex.SchroederPhases(), "blocks": 2},
        "blocks: found 2 with schroeder phases, .*; expected one block",
    ),
    ({"slow": ex.SlowSine([5], [1.0])}, "slow sine lines: found line 5, which the multisine excites as well"),
    ({"slow": ex.SlowSine([70], [1.0])}, "slow sine lines: found 70 to 70; expected lines between 1 and 49"),
    (
        {"ramp": 2.0, "transient_periods": 1},
        r"ramp: found 2 s with 1 transient periods \(1 s\); expected 0 to 1 s",
    ),
    ({"velocity_limit": -5.0}, r"velocity_limit: found -5.0; expected one positive number"),
]


@pytest.mark.parametrize(("change", "message"), BAD_DESIGNS)
def test_bad_designs(change, message):
    good = {"fs": 100.0, "period": 100, "lines": [5, 9]}
    ex.Multisine(**good)
    with pytest.raises(InputError, match=message):
        ex.Multisine(**(good | change))


def test_bad_lines():
    with pytest.raises(InputError, match=r"band: found 5 to 4 Hz with lines every 1 Hz; expected a band that holds"):
        ex.band_lines(5.0, 4.0, 100.0, 100)
    with pytest.raises(InputError, match=r"band: found 4.2 to 4.8 Hz"):
        ex.band_lines(4.2, 4.8, 100.0, 100)
    with pytest.raises(InputError, match=r"band: found 60 to 80 Hz"):
        ex.band_lines(60.0, 80.0, 100.0, 100)
    with pytest.raises(InputError, match="first and last line: found 0 and 5; expected whole numbers with 1 <= first"):
        ex.full_lines(0, 5)
    with pytest.raises(InputError, match="lines: found no odd line from 4 to 4; expected at least one"):
        ex.odd_lines(4, 4)
    with pytest.raises(InputError, match="group: found 1; expected a whole number, 2 or more"):
        ex.random_odd_lines(1, 99, group=1, key=jr.key(0))
    with pytest.raises(InputError, match="points: found 0; expected 1 or more"):
        ex.log_odd_lines(1, 99, 0)


def test_bad_slow_sine_and_spectrum():
    with pytest.raises(InputError, match=r"slow sine: found lines of shape .* expected one line and one amplitude"):
        ex.SlowSine([1, 3], [1.0])
    with pytest.raises(InputError, match=r"slow sine amplitude: found .* expected finite numbers of at least 0"):
        ex.SlowSine([1], [-1.0])
    with pytest.raises(InputError, match=r"spectrum: found frequencies .* expected positive, increasing frequencies"):
        ex.shaped_amplitude(np.ones(3), [2.0, 1.0], [1.0, 1.0])
    with pytest.raises(InputError, match=r"spectrum amplitude: found shape \(3,\) for 2 frequencies"):
        ex.shaped_amplitude(np.ones(3), [1.0, 2.0], [1.0, 1.0, 1.0])


# --- picture


def test_picture_shows_the_spectrum():
    figure = pytest.importorskip("matplotlib.figure").Figure()
    from jaxfrf.plot.excitation import multisine

    slow = ex.SlowSine([1, 3], [10.0, 0.0])
    design = ex.Multisine(100.0, 400, ex.odd_lines(9, 121)[::2], rms=[1.0, 2.0], slow=slow, transient_periods=1)
    axes = multisine(ex.reference(design))
    markers = [line for line in axes[1].lines if line.get_marker() == "."]
    for channel, line in enumerate(markers):
        assert line.get_linestyle() == "None"  # nothing is drawn between excited lines
        assert np.allclose(line.get_xdata(), design.frequency)
        assert np.allclose(line.get_ydata(), design.amplitude[:, channel])
    slow_markers = [line for line in axes[1].lines if line.get_marker() == "^"]
    assert [(line.get_xdata().item(), line.get_ydata().item()) for line in slow_markers] == [(0.25, 10.0)]
    assert "crest" in axes[1].get_legend().get_texts()[0].get_text()
    assert len(axes[0].lines[0].get_xdata()) == 400
    own = figure.subplots(2)
    assert multisine(ex.reference(design), channels=[1], axes=own) is own


def test_picture_of_what_is_not_there():
    pytest.importorskip("matplotlib")
    from jaxfrf.plot.excitation import multisine

    played = ex.reference(ex.Multisine(100.0, 100, [5]))
    with pytest.raises(InputError, match="experiment: found 1; expected 0 to 0"):
        multisine(played, experiment=1)
    with pytest.raises(InputError, match="channels: found 3; expected 0 to 0"):
        multisine(played, channels=[3])
