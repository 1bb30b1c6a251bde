"""Screening finds what is wrong, says where and how much, and stays silent on clean records."""

import re

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.screening import screen

FS, PERIOD, PERIODS = 1000.0, 1000, 6
LINES = np.arange(5, 200, 2)


def multisine(seed, n_channels, rms=1.0):
    """One period of random-phase multisines: (period, channel)."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros((PERIOD // 2 + 1, n_channels), complex)
    spectrum[LINES] = np.exp(2j * np.pi * rng.uniform(size=(len(LINES), n_channels)))
    x = np.fft.irfft(spectrum, axis=0)
    return rms * x / x.std(axis=0)


def record(n_pos=1, n_exp=2, n_in=2, noise=1e-3, slow=0.0, n_periods=PERIODS, seed=0):
    """r, u, y of a closed-loop-like record: y follows r with a gain and a lag, u is another mixture."""
    rng = np.random.default_rng(seed)
    t = np.arange(PERIOD)[:, None]
    r = np.empty((n_pos, n_exp, n_periods * PERIOD, n_in))
    for pos, exp in np.ndindex(n_pos, n_exp):
        one = multisine(100 * pos + exp + seed, n_in) + slow * np.sin(2 * np.pi * 2 * t / PERIOD)
        r[pos, exp] = np.tile(one, (n_periods, 1))
    u = r @ rng.standard_normal((n_in, n_in))
    y = np.roll(r, 3, axis=2)
    return r, u + noise * rng.standard_normal(u.shape), y + noise * rng.standard_normal(y.shape)


def experiment(r, u, y, **fields):
    return jf.Experiment(u, y, FS, PERIOD, r=r, **fields)


def the_one(texts, *patterns):
    """The single sentence, which holds all patterns."""
    assert len(texts) == 1, texts
    for pattern in patterns:
        assert re.search(pattern, texts[0]), (pattern, texts[0])


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-2, 0.1])
@pytest.mark.parametrize("slow", [0.0, 10.0])
@pytest.mark.parametrize("n_periods", [1, 2, 3, 6])
def test_silent_on_clean_multisines(noise, slow, n_periods):
    assert screen(experiment(*record(noise=noise, slow=slow, n_periods=n_periods))) == ()


@pytest.mark.parametrize("seed", range(20))
def test_silent_on_noise_of_few_periods(seed):
    """In any unit, without an overflow."""
    r, u, y = record(n_pos=2, n_in=3, noise=0.2, n_periods=3, seed=seed)
    with np.errstate(over="raise"):
        assert screen(experiment(r, u, 1e12 * y)) == ()


@pytest.mark.parametrize(("signal", "unit"), [("y", "rev/min"), ("r", "degrees"), ("", "")])
def test_signals_that_follow_in_another_unit(signal, unit):
    """All channels by the same factor; behind gears of 8 and 50 they are not, nor where speeds follow torques."""
    r, u, y = record()
    factor = {"rev/min": 9.549, "degrees": 57.3, "": 1.0}[unit]
    said = screen(experiment(r * (factor if signal == "r" else 1.0), u, 0.9 * y * (factor if signal == "y" else 1.0)))
    if unit:
        the_one(said, rf"is {signal} in {unit}, and . in rad\? Say so \(--set {signal}_unit")
    else:
        assert not said and not screen(experiment(r, u, y * np.array([8.0, 50.0])))
        driven = 1e3 * np.cumsum(r - r.mean(axis=2, keepdims=True), axis=2) / FS
        assert not any("in rad?" in text for text in screen(experiment(r, u, driven)))


def test_samples_too_many_at_the_very_beginning_may_be_a_transient():
    """Some samples that come late at the beginning of the first used period, not where a period was left out."""
    r, u, y = record(noise=1e-4)
    y[0, 0, :60, 0] = np.roll(y[0, 0, :PERIOD, 0], 4)[:60]
    said = lambda first: [x for x in screen(experiment(r, u, y, transient_periods=first)) if "sample" in x]
    assert any("not steady there yet: --set transient_periods=1" in x for x in said(0))
    assert not said(1)


@pytest.mark.parametrize("seed", [74, 397])
def test_a_few_high_crests_are_no_limit(seed):
    u = np.tile(multisine(seed, 1), (4, 1))
    u = u + 1e-3 * np.random.default_rng(seed).standard_normal(u.shape)
    y = np.roll(u, 3, axis=0) + 1e-3 * np.random.default_rng(0).standard_normal(u.shape)
    assert not any("looks limited" in x for x in screen(jf.Experiment(u, y, FS, PERIOD)))


def test_silent_on_a_fine_quantiser_and_on_square_waves():
    r, u, y = record(slow=3.0, noise=0.02)
    assert screen(experiment(r, np.round(u * 100) / 100, np.round(y * 50) / 50)) == ()
    square = np.where(multisine(0, 1) > 0, 1.0, -1.0)
    square = np.tile(square, (PERIODS, 1))[None, None]
    assert screen(jf.Experiment(square, y[:1, :1, :, :1], FS)) == ()


def test_silent_on_quantised_slow_sines():
    """At its crest a quantised sine stays on one level for a while: no clipping."""
    t = np.arange(20 * PERIOD)[:, None]
    for levels in (8, 50, 300, 2000):
        u = np.round(levels * np.sin(2 * np.pi * t / PERIOD)) / levels
        assert screen(jf.Experiment(u, np.cos(2 * np.pi * t / PERIOD + 0.1), FS)) == ()


def test_one_axis_at_a_time_is_no_dead_channel():
    r, u, y = record(n_exp=2)
    for exp in range(2):
        r[:, exp, :, 1 - exp] = u[:, exp, :, 1 - exp] = y[:, exp, :, 1 - exp] = 0.0
    assert screen(experiment(r, u, y)) == ()


@pytest.mark.parametrize("level", [1.0, 2.0, 2.5])
def test_clipped_torque(level):
    r, u, y = record(n_exp=3)
    limit = level * u[0, 1, :, 0].std()
    u[0, 1, :, 0] = np.clip(u[0, 1, :, 0], -np.inf, limit)
    share = np.mean(u[0, 1, :, 0] == limit)
    the_one(
        screen(experiment(r, u, y)),
        rf"u: channel 0 \(position 0, experiment 1\) looks clipped: {share:.2g} of the samples",
        rf"at exactly {limit:g}\.",
    )


def test_clipped_at_the_bottom_of_several_experiments():
    r, u, y = record(n_exp=3)
    u = np.clip(u, -1.0, np.inf)
    share = np.mean(u == -1.0, axis=2)
    worst, places = share.max(), np.count_nonzero(share)
    assert places > 1
    the_one(
        screen(experiment(r, u, y)),
        f"clipped: {worst:.2g} of the samples stand at exactly -1",
        f"worst of {places} such",
    )


def test_dead_output():
    r, u, y = record(n_pos=2, n_exp=3)
    y[1, 2, :, 1] = 0.7
    the_one(
        screen(experiment(r, u, y)),
        r"y: channel 1 is constant \(0\.7\) in 1 of 6 experiments, first at position 1, experiment 2",
    )


@pytest.mark.parametrize("name", ["u", "y", "r"])
def test_dead_in_all_experiments(name):
    signals = dict(zip("ruy", record(n_exp=3), strict=True))
    signals[name][..., 1] = 0.0
    # Excited lines are given: they could not be found in a dead reference.
    texts = screen(experiment(**signals, lines=LINES))
    the_one(texts, rf"{name}: channel 1 is constant \(0\) in 3 of 3 experiments")


def test_drifting_mean():
    r, u, y = record(n_exp=2)
    n = y.shape[2]
    y[0, 1, :, 0] += 0.3 * np.arange(n) / n
    expected = 0.3 * (PERIODS - 1) / PERIODS  # between the means of the first and the last period
    the_one(
        screen(experiment(r, u, y)),
        rf"y: channel 0 \(position 0, experiment 1\) drifts: its mean moves by {expected:.2g}",
        r"over 6 periods",
    )


def test_first_period_not_steady():
    r, u, y = record()
    y[:, 1, :, 1] += 0.5 * np.exp(-np.arange(y.shape[2]) / 100.0) * np.sin(np.arange(y.shape[2]))
    texts = screen(experiment(r, u, y))
    the_one(texts, r"y: channel 1 \(position 0, experiment 1\) is not steady", r"--set transient_periods=1")
    assert screen(experiment(r, u, y, transient_periods=1)) == ()


@pytest.mark.parametrize("period", [1, 3, 5])
def test_one_other_period(period):
    r, u, y = record()
    samples = slice(period * PERIOD + 200, period * PERIOD + 400)
    y[0, 0, samples, 0] += 0.5
    called = "its last period" if period == 5 else f"steady period {period} of 0 to 5"
    the_one(
        screen(experiment(r, u, y)),
        rf"y: channel 0 \(position 0, experiment 0\) differs in {called} "
        rf"\(samples {period * PERIOD} to {(period + 1) * PERIOD - 1}\)",
    )


def test_one_sample_lost_shows_in_the_reference():
    r, u, y = record()
    r[0, 0, -1] = r[0, 0, -2]  # logged twice
    the_one(screen(experiment(r, u, y)), r"r: channel \d .* differs in its last period .* most at sample 5999")


def test_low_signal_to_noise_ratio():
    r, u, y = record(n_exp=24)  # so many that the ratio at a line is close to its mean
    rng = np.random.default_rng(5)
    y[..., 1] = 0.15 * y[..., 1] + 0.5 * rng.standard_normal(y.shape[:3])
    texts = screen(experiment(r, u, y))
    the_one(texts, r"y: channel 1 \(position 0\) has a median signal-to-noise ratio of only \d+\.\d dB")
    # Power of an excited line over that of the noise in the mean of 6 periods of 1000 samples.
    line = (0.15**2 / len(LINES)) / 2
    noise = 0.5**2 / (PERIOD * PERIODS)
    told = float(re.search(r"only (-?\d+\.\d) dB", texts[0])[1])
    assert abs(told - 10 * np.log10(line / noise)) < 0.5


def test_noise_alone():
    r, u, y = record(n_exp=2)
    y[..., 0] = np.random.default_rng(6).standard_normal(y.shape[:3])
    the_one(screen(experiment(r, u, y)), r"y: channel 0 .* ratio of only -10 or less dB|only -\d\.\d dB")


def test_coarse_quantisation():
    r, u, y = record()
    y[0, 1, :, 0] = np.round(y[0, 1, :, 0])
    the_one(screen(experiment(r, u, y)), r"y: channel 0 \(position 0, experiment 1\) .* in steps of 1,")


def test_records_without_periods():
    _, u, y = record()
    u[0, 0, :, 0] = np.clip(u[0, 0, :, 0], -0.5, 0.5)
    y[..., 1] = 3.0
    texts = screen(jf.Experiment(u, y, FS))
    assert len(texts) == 2
    assert any("looks clipped" in text for text in texts) and any("is constant (3)" in text for text in texts)


def test_one_sentence_a_kind():
    r, u, y = record(n_pos=3, n_exp=4, n_in=3)
    u = np.clip(u, -0.5, 0.5)
    y = y + np.linspace(0, 2, y.shape[2])[:, None]
    texts = screen(experiment(r, u, y))
    assert len(texts) == 2
    assert "This is the worst of 36 such places." in texts[0]
