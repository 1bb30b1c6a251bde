"""From records to spectra: known sines, the noise covariance, which lines are excited, parts and quantities."""

import dataclasses
import re

import numpy as np
import plants
import pytest
import scipy.signal

import jaxfrf as jf

FS, PERIOD = 500.0, 200
LINES = np.array([3, 5, 9, 21, 40])


def refused(call, *patterns):
    with pytest.raises(jf.InputError) as caught:
        call()
    text = str(caught.value)
    assert re.search(r"found .+; expected .+\. \S", text), text
    for pattern in patterns:
        assert re.search(pattern, text), f"no {pattern!r} in: {text}"


def time(n_periods=1, period=PERIOD):
    return np.arange(n_periods * period) / FS


def sines(amplitude, phase, lines=LINES, n_periods=1):
    """sum_k a_k cos(2 pi f_k t + phi_k): (time, channel) for a, phi (line, channel)."""
    omega = 2 * np.pi * np.asarray(lines) * FS / PERIOD
    return np.einsum("lc,tlc->tc", amplitude, np.cos(omega[:, None] * time(n_periods)[:, None, None] + phase))


def multisine(rng, lines, n_channel=1, n_exp=1, n_periods=1, amplitude=1.0):
    X = amplitude * plants.circular(rng, (n_exp, len(lines), n_channel))
    one = np.stack([plants.multisine_record(x, lines, PERIOD) for x in X])
    return np.tile(one, (1, n_periods, 1))[None]


# --- the discrete Fourier transform


def test_known_sines():
    """a cos(2 pi f t + phi) has the coefficient a/2 e^(j phi); a run-in, a mean and other lines do not matter."""
    rng = np.random.default_rng(0)
    amplitude, phase = rng.uniform(0.5, 2, (3, 5, 2)), rng.uniform(-np.pi, np.pi, (3, 5, 2))
    r, u, y = (sines(amplitude[i], phase[i], n_periods=4) for i in range(3))
    y = y + 7.0 + sines(np.ones((1, 2)), 0.0, lines=[4], n_periods=4)
    for x in (r, u, y):
        x[:PERIOD] += 10 * rng.standard_normal((PERIOD, 2))
    data = jf.Experiment(u, y, FS, PERIOD, r=r, lines=LINES, transient_periods=1, y_quantity="position")
    spectra = jf.dft(data)
    expected = amplitude / 2 * np.exp(1j * phase)
    for X, known in zip((spectra.R, spectra.U, spectra.Y), expected, strict=True):
        np.testing.assert_allclose(X[0, 0], known, atol=1e-13)
    np.testing.assert_allclose(spectra.frequency, LINES * 2.5)
    assert (spectra.n_periods, spectra.period, spectra.y_quantity, spectra.periodic) == (3, PERIOD, "position", True)
    np.testing.assert_allclose(spectra.noise, 0, atol=1e-26)


def test_a_single_period_has_no_noise_estimate():
    u = multisine(np.random.default_rng(0), LINES)
    assert jf.dft(jf.Experiment(u, u, FS, PERIOD, lines=LINES)).noise is None


def test_parseval():
    """All lines of one period hold its mean square: x(0)^2 + 2 sum |X(k)|^2."""
    x = np.random.default_rng(1).standard_normal((201, 2))
    spectra = jf.dft(jf.Experiment(x, x, FS, 201, lines=np.arange(1, 101)))
    power = x.mean(axis=0) ** 2 + 2 * np.sum(np.abs(spectra.Y[0, 0]) ** 2, axis=0)
    np.testing.assert_allclose(power, np.mean(x**2, axis=0), rtol=1e-13)


def test_noise_covariance_against_the_scatter_of_many_records():
    """Coloured noise in [y; u], correlated between the two: what one record says of its mean, on average over 3000
    records, is how the means of these records scatter. (Noise of neighbouring periods is nearly independent.)"""
    rng = np.random.default_rng(2)
    n_exp, n_periods = 3000, 4
    white = rng.standard_normal((n_exp, n_periods * PERIOD + 8, 3))
    mixed = white @ np.array([[1.0, 0.5, 0.0], [0.0, 0.8, -0.3], [0.2, 0.0, 0.6]])
    coloured = mixed[:, 8:] + 0.7 * mixed[:, 7:-1] - 0.4 * mixed[:, :-8]
    clean = multisine(rng, LINES, 3, n_periods=n_periods)
    signal = clean + coloured
    spectra = jf.dft(jf.Experiment(signal[..., 2:], signal[..., :2], FS, PERIOD, lines=LINES))
    Z = np.concatenate([spectra.Y, spectra.U], axis=-1)[0]
    deviation = Z - Z.mean(axis=0)
    scatter = np.einsum("efa,efb->fab", deviation, deviation.conj()) / (n_exp - 1)
    estimated = spectra.noise[0].mean(axis=0)
    size = np.abs(scatter).max(axis=(1, 2))[:, None, None]
    assert np.max(np.abs(estimated - scatter) / size) < 0.08  # 4 standard deviations of the scatter itself
    assert abs(np.mean(np.einsum("faa->f", estimated).real / np.einsum("faa->f", scatter).real) - 1) < 0.02
    # And both agree with theory: H M^T M H^* / (N P), up to the edges of the periods.
    z = np.exp(-2j * np.pi * LINES / PERIOD)
    shape = np.abs(1 + 0.7 * z - 0.4 * z**8) ** 2
    mix = np.array([[1.0, 0.5, 0.0], [0.0, 0.8, -0.3], [0.2, 0.0, 0.6]])
    theory = shape[:, None, None] * (mix.T @ mix) / (PERIOD * n_periods)
    assert np.max(np.abs(scatter - theory) / size) < 0.1


def test_what_repeats_with_the_period_is_no_noise():
    """A static nonlinearity distorts every period alike: not a trace of it in the noise covariance."""
    u = multisine(np.random.default_rng(3), LINES, n_periods=3, amplitude=3.0)
    spectra = jf.dft(jf.Experiment(u, u + 0.3 * u**3, FS, PERIOD, lines=LINES))
    assert np.abs(spectra.noise).max() < 1e-25 * np.abs(spectra.Y).max() ** 2


def test_not_periodic():
    data = jf.Experiment(np.random.default_rng(0).standard_normal((100, 1)), np.zeros((100, 1)), FS)
    refused(lambda: jf.dft(data), "period: found 0", "transient=2")


def test_lines_that_are_not_excited_at_all():
    """All lines wrong: the median line carries rounding only, so no line stands out as the silent one."""
    u = multisine(np.random.default_rng(4), np.arange(5, 61, 2), n_periods=2)
    refused(lambda: jf.dft(jf.Experiment(u, u, FS, PERIOD, lines=np.arange(4, 61, 2))), "no power .* 29 of the 29")
    refused(lambda: jf.dft(jf.Experiment(u, u, FS, PERIOD, lines=[5, 7, 8, 9])), r"1 of the 4 .*line 8 \(20 Hz\)")
    zero = np.zeros_like(u)
    refused(lambda: jf.dft(jf.Experiment(zero, u, FS, PERIOD, lines=[5, 7])), "u: found no power in channel 0 at 2 of")


def test_a_weak_line_is_no_silent_line():
    """80 dB below the others, with a slow sine 60 dB above them: still excited, still usable."""
    amplitude = np.array([1e-3, 1.0, 1.0, 1.0, 1.0, 1e-4])[:, None]
    amplitude[0] = 1e3
    lines = [1, *LINES]
    u = sines(amplitude, np.zeros((6, 1)), lines=lines, n_periods=2)
    spectra = jf.dft(jf.Experiment(u, 2 * u, FS, PERIOD, lines=LINES))
    np.testing.assert_allclose(spectra.Y / spectra.U, 2, rtol=1e-8)


# --- unexcited lines


def test_unexcited_spectra():
    """An even and an odd disturbance between the lines of an odd multisine, at their lines and nowhere else."""
    lines = np.arange(5, 40, 4)
    u = multisine(np.random.default_rng(5), lines, n_periods=2)
    y = u + sines(np.array([[0.2], [0.3]]), np.zeros((2, 1)), lines=[10, 15], n_periods=2)
    rest = jf.unexcited_spectra(jf.Experiment(u, y, FS, PERIOD, lines=lines))
    assert list(rest.lines) == sorted(set(range(5, 38)) - set(lines))
    level = dict(zip(rest.lines, np.abs(rest.Y[0, 0, :, 0]), strict=True))
    assert abs(level.pop(10) - 0.1) < 1e-12 and abs(level.pop(15) - 0.15) < 1e-12
    assert max(level.values()) < 1e-12
    wide = jf.unexcited_spectra(jf.Experiment(u, y, FS, PERIOD, lines=lines), band=(0.0, 250.0))
    assert list(wide.lines) == sorted(set(range(1, 100)) - set(lines))


def test_no_unexcited_line():
    u = multisine(np.random.default_rng(6), np.arange(5, 20))
    refused(lambda: jf.unexcited_spectra(jf.Experiment(u, u, FS, PERIOD)), "every line from 12.5 to 47.5 Hz is excited")


# --- finding the excited lines

ODD = np.arange(7, 80, 2)


@pytest.mark.parametrize("with_reference", [True, False])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 3e-2])
def test_lines_of_a_multisine(with_reference, noise):
    rng = np.random.default_rng(7)
    u = multisine(rng, ODD, 2, n_exp=2, n_periods=3)
    noisy = u + noise * rng.standard_normal(u.shape)
    data = jf.Experiment(noisy, noisy, FS, PERIOD, r=u if with_reference else None)
    np.testing.assert_array_equal(jf.excited_lines(data), ODD)
    np.testing.assert_array_equal(jf.dft(data).lines, ODD)


def test_slow_sines_make_no_lines():
    """One slow sine per axis, far stronger than the multisine: no axis but its own is excited there."""
    rng = np.random.default_rng(8)
    slow = sines(30.0 * np.eye(3), np.zeros((3, 3)), lines=[1, 2, 3], n_periods=2)
    r = multisine(rng, ODD, 3, n_exp=3, n_periods=2) + slow
    y = r + 1e-2 * rng.standard_normal(r.shape)
    np.testing.assert_array_equal(jf.excited_lines(jf.Experiment(r, y, FS, PERIOD, r=r)), ODD)


def test_a_slow_sine_on_a_single_axis():
    """With one axis nothing tells the slow sine from the excitation: its line is excited, and counted."""
    rng = np.random.default_rng(9)
    r = multisine(rng, ODD, n_periods=2) + sines(np.array([[30.0]]), 0.0, lines=[2], n_periods=2)
    np.testing.assert_array_equal(jf.excited_lines(jf.Experiment(r, r, FS, PERIOD, r=r)), [2, *ODD])


def test_axes_of_very_different_strength():
    rng = np.random.default_rng(10)
    r = multisine(rng, ODD, 2, n_exp=2) * np.array([1e-3, 1e2])
    np.testing.assert_array_equal(jf.excited_lines(jf.Experiment(r, r, FS, PERIOD)), ODD)


def test_position_reference_is_weighed_as_a_speed():
    """The integral of a flat multisine falls by 20 dB a decade; the speed that it stands for does not."""
    rng = np.random.default_rng(11)
    lines = np.arange(1, 98, 2)
    X = plants.circular(rng, (1, len(lines), 1)) / (2j * np.pi * lines * FS / PERIOD)[:, None]
    r = np.tile(plants.multisine_record(X[0], lines, PERIOD), (2, 1))
    u = r + 1e-9 * rng.standard_normal(r.shape)
    found = jf.excited_lines(jf.Experiment(u, u, FS, PERIOD, r=r, r_quantity="position"))
    np.testing.assert_array_equal(found, lines)


def test_smoothly_decaying_spectra():
    """No gap of 10 dB anywhere: the lines within 40 dB of the strongest count, noise far below does not."""
    lines = np.arange(1, 100)
    X = 10 ** (-0.75 * (lines - 1) / 20)[:, None] * np.exp(2j * np.pi * np.random.default_rng(12).random((99, 1)))
    u = plants.multisine_record(X, lines, PERIOD)
    found = jf.excited_lines(jf.Experiment(u, u, FS, PERIOD))
    assert list(found) == list(lines[0.75 * (lines - 1) <= 40])


def test_given_lines_go_first():
    u = multisine(np.random.default_rng(13), ODD, n_periods=2)
    assert list(jf.dft(jf.Experiment(u, u, FS, PERIOD, lines=ODD[3:6])).lines) == list(ODD[3:6])


def test_nothing_excited():
    zero = np.zeros((1, 1, 400, 2))
    refused(lambda: jf.excited_lines(jf.Experiment(zero, zero, FS, PERIOD)), "u: found no power at any line")
    half = multisine(np.random.default_rng(14), ODD, 2, n_periods=2) * np.array([1.0, 0.0])
    refused(lambda: jf.excited_lines(jf.Experiment(half, half, FS, PERIOD)), "every channel")


# --- records that are not periodic


def test_record_spectra_are_those_of_the_whole_record():
    rng = np.random.default_rng(15)
    u, y = rng.standard_normal((2, 1, 2, 301, 2))
    spectra = jf.record_spectra(jf.Experiment(u, y, FS), band=(100.0, 200.0))
    k = np.arange(1, 151)
    k = k[(k * FS / 301 >= 100) & (k * FS / 301 <= 200)]
    np.testing.assert_allclose(spectra.frequency, k * FS / 301)
    np.testing.assert_allclose(spectra.Y[0, 1], np.fft.fft(y[0, 1], axis=0)[k] / 301, atol=1e-14)
    assert not spectra.periodic and spectra.noise is None


def test_record_spectra_choose_the_band_with_power():
    """A reference band-limited to lines 40..60 of the record (others 60 dB below): those are taken, without gaps."""
    rng = np.random.default_rng(16)
    X = 1e-3 * plants.circular(rng, (99, 1))
    X[39:60] = np.exp(2j * np.pi * rng.random((21, 1)))
    r = plants.multisine_record(X, np.arange(1, 100), PERIOD)
    u = rng.standard_normal(r.shape)
    assert list(jf.record_spectra(jf.Experiment(u, u, FS, r=r)).lines) == list(range(40, 61))


@pytest.mark.parametrize("kind", ["linear", "logarithmic"])
def test_record_spectra_end_where_a_sweep_ends(kind):
    """Beyond its last frequency a sweep leaks from the ends of the record: 40 dB below, and no excitation."""
    t = np.arange(10_000) / FS
    u = scipy.signal.chirp(t, 0.5, t[-1], 100.0, method=kind)
    for signal in (u, u[::-1]):
        frequency = jf.record_spectra(jf.Experiment(signal, signal, FS)).frequency
        assert frequency[0] < 0.5 and 99.0 < frequency[-1] < 108.0
        assert len(frequency) > 0.999 * (frequency[-1] - frequency[0]) * t[-1]


def test_record_spectra_of_an_impact():
    """All of it stands at an end of the record, and is excitation."""
    u = np.zeros(2000)
    u[:6] = np.hanning(8)[1:-1]
    frequency = jf.record_spectra(jf.Experiment(u, u, FS)).frequency
    assert np.sum(frequency < 60.0) >= 0.95 * 60.0 * len(u) / FS


def test_record_spectra_say_where_the_power_is():
    t = time(5)[:, None]
    u = np.sin(2 * np.pi * 11.0 * t) + 0.02 * np.sin(2 * np.pi * 99.3 * t)
    (warning,) = jf.record_spectra(jf.Experiment(u, u, FS, y_quantity="velocity"), (0.0, 250.0)).warnings
    assert "not periodic" in warning and "lies below 11 Hz" in warning


def test_record_spectra_need_a_band_with_lines():
    u = np.random.default_rng(17).standard_normal((100, 1))
    refused(lambda: jf.record_spectra(jf.Experiment(u, u, FS), (7.0, 8.0)), "band: found 7 to 8 Hz", "5 and 250 Hz")


def test_leakage_is_refused_without_a_transient_term():
    rng = np.random.default_rng(18)
    u, y = rng.standard_normal((2, 1, 3, 400, 1))
    spectra = jf.record_spectra(jf.Experiment(u, y, FS), (0.0, 250.0))
    for method in (jf.H1(), jf.H2(), jf.Hv(), jf.LogMean(), jf.JointInputOutput()):
        refused(lambda method=method: jf.estimate(dataclasses.replace(spectra, R=spectra.U), method), "transient=2")
    jf.estimate(spectra, jf.LPM(transient=2))


# --- parts and quantities


def some(n_pos=3, seed=19):
    rng = np.random.default_rng(seed)
    u, y, r = rng.standard_normal((3, n_pos, 2, 3 * PERIOD, 2))
    return jf.dft(jf.Experiment(u, y, FS, PERIOD, r=r, lines=LINES, q=rng.standard_normal((n_pos, 4))))


def test_select_band():
    spectra = some()
    part = jf.select_band(spectra, 12.5, 60.0)  # lines 5, 9, 21 are at 12.5, 22.5, 52.5 Hz
    assert list(part.lines) == [5, 9, 21]
    for name in ("U", "Y", "R", "noise"):
        np.testing.assert_array_equal(getattr(part, name), getattr(spectra, name)[:, :, 1:4])
    refused(lambda: jf.select_band(spectra, 13.0, 14.0), "no excited line between 13 and 14 Hz", "7.5 to 100 Hz")


@pytest.mark.parametrize("chosen", [[2, 0], slice(1, 3)])
def test_select_positions(chosen):
    spectra = some()
    part = jf.select_positions(spectra, chosen)
    for name in ("U", "Y", "R", "noise", "q"):
        np.testing.assert_array_equal(getattr(part, name), getattr(spectra, name)[chosen])
    np.testing.assert_array_equal(part.frequency, spectra.frequency)


QUANTITIES = ("position", "velocity", "acceleration")


def of_quantity(quantity):
    """The same motion, measured as position, velocity or acceleration: derivatives of sines by hand."""
    rng = np.random.default_rng(20)
    times = QUANTITIES.index(quantity)
    omega = (2 * np.pi * LINES * FS / PERIOD)[:, None]
    periods = []
    for _ in range(4):
        amplitude, phase = rng.uniform(0.5, 2, (5, 2)), rng.uniform(-np.pi, np.pi, (5, 2))
        periods.append(sines(amplitude * omega**times, phase + times * np.pi / 2))
    y = np.concatenate(periods)
    u = np.random.default_rng(21).standard_normal(y.shape)
    return jf.dft(jf.Experiment(u, y, FS, PERIOD, lines=LINES, y_quantity=quantity))


@pytest.mark.parametrize("before", QUANTITIES)
@pytest.mark.parametrize("after", QUANTITIES)
def test_output_quantities(before, after):
    """Spectra and noise covariance of one quantity, turned into those of another one."""
    turned, known = jf.with_output_quantity(of_quantity(before), after), of_quantity(after)
    assert turned.y_quantity == after
    np.testing.assert_array_equal(turned.U, known.U)
    np.testing.assert_allclose(turned.Y, known.Y, rtol=1e-10)
    size = np.sqrt(np.einsum("pefaa->pefa", known.noise).real)
    scale = size[..., :, None] * size[..., None, :]
    np.testing.assert_allclose(turned.noise / scale, known.noise / scale, atol=1e-9)
    np.testing.assert_allclose(
        jf.differentiate(of_quantity("position").Y, 2 * np.pi * known.frequency, QUANTITIES.index(after)),
        of_quantity(after).Y,
        rtol=1e-10,
    )


def test_unknown_quantity():
    refused(lambda: jf.with_output_quantity(some(), "speed"), "quantity: found 'speed'", "velocity")


def test_shapes_that_do_not_fit():
    spectra = some()
    with pytest.raises(ValueError, match=r"Y has shape \(3, 2, 4, 2\)"):
        dataclasses.replace(spectra, Y=spectra.Y[:, :, :4])
    with pytest.raises(ValueError, match="U holds 5 lines, `lines` 4"):
        dataclasses.replace(spectra, lines=LINES[:4])


def test_blocks():
    """n_real counts whole blocks of n_in experiments."""
    rng = np.random.default_rng(22)
    U = plants.circular(rng, (1, 7, 5, 3))
    assert plants.spectra(U, U, lines=LINES).n_real == 2
