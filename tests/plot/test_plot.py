"""Pictures: confidence bands that cover, lines that do not lie, and files that are whole."""

import sys

import matplotlib.figure
import numpy as np
import pytest
import scipy.stats

from jaxfrf import FRF, Experiment, InputError, Status, dft, unexcited_spectra
from jaxfrf.plot._style import breaks, pieces, save
from jaxfrf.plot.bode import bode, confidence_radius
from jaxfrf.plot.coherence import coherence
from jaxfrf.plot.spectrum import spectrum


def make_frf(G, frequency=None, std=None, dof=8.0, status=None, **fields) -> FRF:
    """An FRF whose elements err independently with the standard deviations `std`."""
    G = np.asarray(G, complex)
    n_pos, n_freq, n_out, n_in = G.shape
    std = np.full(G.shape, np.nan) if std is None else np.broadcast_to(std, G.shape)
    variance = std.swapaxes(-1, -2).reshape(n_pos, n_freq, -1) ** 2  # columns of G stacked
    return FRF(
        G=G,
        frequency=np.arange(1.0, n_freq + 1) if frequency is None else np.asarray(frequency, float),
        cov=variance[..., None] * np.eye(n_out * n_in, dtype=complex),
        dof=np.broadcast_to(np.asarray(dof, float), (n_pos, n_freq)),
        status=np.zeros((n_pos, n_freq), int) if status is None else np.asarray(status),
        window=np.ones((n_pos, n_freq)),
        **fields,
    )


def paper_lines():
    """336 odd lines on a logarithmic grid, quantised: 4 to 79 Hz."""
    return np.unique(2 * np.floor(np.geomspace(112, 2240, 366) / 2) + 1)[:-1] / 28


# --- confidence ---


@pytest.mark.parametrize(("level", "dof"), [(0.95, 1), (0.95, 7), (0.5, 3), (0.99, 40)])
def test_radius_against_the_closed_form_of_the_f_quantile(level, dof):
    """F(2, 2 dof) has the distribution 1 - (1 + x/dof)^-dof."""
    std = np.arange(1.0, 7.0).reshape(2, 3)
    radius = confidence_radius(make_frf(np.ones((2, 4, 2, 3)), std=std, dof=dof), level)
    quantile = dof * ((1 - level) ** (-1 / dof) - 1)
    np.testing.assert_allclose(radius, np.broadcast_to(std * np.sqrt(quantile), radius.shape), rtol=1e-9)


@pytest.mark.parametrize("dof", [2, 10])
def test_coverage_by_monte_carlo(dof):
    """The disc covers as often as it says, the magnitude alone as often as Student's distribution says."""
    n, level = 40_000, 0.9
    rng = np.random.default_rng(dof)
    truth, sigma = 50.0 * np.exp(0.7j), 1.0
    residuals = rng.standard_normal((n, dof, 2)) * sigma / np.sqrt(2)
    std = np.sqrt(np.mean(np.sum(residuals**2, axis=-1), axis=-1))
    G = truth + (rng.standard_normal(n) + 1j * rng.standard_normal(n)) * sigma / np.sqrt(2)
    radius = confidence_radius(make_frf(G[None, :, None, None], std=std[None, :, None, None], dof=dof), level)
    radius = radius[0, :, 0, 0]

    disc = np.mean(np.abs(G - truth) <= radius)
    magnitude = np.mean(np.abs(np.abs(G) - np.abs(truth)) <= radius)
    phase = np.mean(np.abs(np.angle(G / truth)) <= np.arcsin(radius / np.abs(G)))
    quantile = scipy.stats.f.ppf(level, 2, 2 * dof)
    alone = 2 * scipy.stats.t.cdf(np.sqrt(2 * quantile), 2 * dof) - 1

    def tolerance(p):
        return 4 * np.sqrt(p * (1 - p) / n)

    assert abs(disc - level) < tolerance(level)
    assert abs(magnitude - alone) < tolerance(alone)
    assert abs(phase - alone) < tolerance(alone)


def test_no_radius_without_covariance_or_freedom():
    assert np.isnan(confidence_radius(make_frf(np.ones((1, 3, 1, 1))))).all()
    assert np.isnan(confidence_radius(make_frf(np.ones((1, 3, 1, 1)), std=1.0, dof=0))).all()
    with pytest.raises(InputError, match="between 0 and 1"):
        confidence_radius(make_frf(np.ones((1, 3, 1, 1))), 95)


# --- which points a line may join ---

LINEAR = np.arange(1.0, 101.0)
WITHOUT_GAP = {
    "linear": LINEAR,
    "linear from zero": LINEAR - 1,
    "one line missing": np.delete(LINEAR, 50),
    "logarithmic": np.geomspace(1, 100, 40),
    "three a decade": np.geomspace(0.1, 1000, 13),
    "the paper's lines": paper_lines(),
    "coarser above 100 Hz": np.concatenate([LINEAR, np.arange(110.0, 400, 10)]),
    "two": np.array([3.0, 50.0]),
    "one": np.array([3.0]),
}
WITH_GAP = {
    "two lines missing": (np.delete(LINEAR, [50, 51]), [49]),
    "at the beginning": (np.delete(LINEAR, [2, 3, 4]), [1]),
    "at the end": (np.delete(LINEAR, [96, 97]), [95]),
    "logarithmic": (np.delete(np.geomspace(1, 100, 40), [20, 21]), [19]),
    "three a decade": (np.delete(np.geomspace(0.1, 1000, 13), [6, 7]), [5]),
    "the paper's lines": (np.delete(paper_lines(), [99, 100, 200, 201, 202]), [98, 197]),
    "two bands": (np.concatenate([LINEAR, LINEAR + 300]), [99]),
    "a point alone": (np.array([1.0, 2, 3, 10, 20, 21, 22]), [2, 3]),
}


@pytest.mark.parametrize("case", WITHOUT_GAP)
def test_regular_grids_are_joined(case):
    assert not breaks(WITHOUT_GAP[case]).any()


@pytest.mark.parametrize("case", WITH_GAP)
def test_gaps_are_not_bridged(case):
    frequency, gaps = WITH_GAP[case]
    np.testing.assert_array_equal(np.flatnonzero(breaks(frequency)), gaps)


def test_pieces_leave_out_what_may_not_be_joined():
    sound = np.ones(10, bool)
    sound[[3, 9]] = False
    runs = pieces(np.r_[1.0:6.0, 11.0:16.0], sound)
    assert [(r.start, r.stop) for r in runs] == [(0, 3), (4, 5), (5, 9)]


# --- the Bode matrix ---


def strokes(axes):
    """Every straight stroke that is drawn: (n, 2, 2), points (x, y) of its ends."""
    found = []
    for line in axes.lines:
        if line.get_linestyle() != "None":
            points = np.column_stack([line.get_xdata(), line.get_ydata()])
            found.append(np.stack([points[:-1], points[1:]], axis=1))
    ends = np.concatenate(found)
    return ends[np.isfinite(ends).all(axis=(1, 2))]


def points(axes, face=None):
    """Every marker that is drawn, (n, 2); `face`: only those of this face colour."""
    lines = [x for x in axes.lines if x.get_linestyle() == "None" and face in (None, x.get_markerfacecolor())]
    return np.concatenate([np.column_stack([x.get_xdata(), x.get_ydata()]) for x in lines])


def delayed(frequency):
    """Two masses with a delay of 20 ms: the phase winds several times."""
    s = 2j * np.pi * frequency
    G = (s**2 + 3 * s + 1e5) / (s * (s**2 + 5 * s + 2e5)) * np.exp(-0.02 * s)
    return G[None, :, None, None]


def test_every_line_is_a_point_and_gaps_stay_open():
    frequency = np.delete(np.arange(0.5, 200, 0.5), np.r_[100:120])
    status = np.zeros((1, len(frequency)), int)
    status[0, 30:33] = Status.RANK_DEFICIENT
    status[0, :5] = Status.EDGE_WINDOW
    frf = make_frf(delayed(frequency), frequency, std=1e-6, status=status)
    _, axes = bode(frf)
    for axis in axes[0, 0]:
        np.testing.assert_array_equal(np.sort(points(axis)[:, 0]), frequency)
        np.testing.assert_array_equal(np.sort(points(axis, "white")[:, 0]), frequency[30:33])
        ends = strokes(axis)[:, :, 0]
        assert (np.diff(ends) < 0.6).all()
        assert not np.isin(ends, frequency[30:33]).any()
        assert np.isin(frequency[:5], ends).all()
    np.testing.assert_allclose(
        points(axes[0, 0, 0], "#0072B2")[:, 1],
        20 * np.log10(np.abs(frf.G[0, status[0] < 8, 0, 0])),
        rtol=1e-12,
    )


def test_phase_is_wrapped_without_vertical_lines():
    frequency = np.arange(0.5, 200, 0.5)
    _, axes = bode(make_frf(delayed(frequency), frequency, std=1e-6))
    phase = axes[0, 0, 1]
    assert (np.abs(points(phase)[:, 1]) <= 180).all()
    assert (np.abs(np.diff(strokes(phase)[:, :, 1])) < 120).all()
    low, high = phase.get_ylim()
    inside = strokes(phase)[((strokes(phase)[:, :, 1] > low) & (strokes(phase)[:, :, 1] < high)).any(axis=1)]
    np.testing.assert_array_equal(np.unique(inside[:, 0, 0]), frequency[:-1])  # no stroke is missing


def test_a_phase_that_is_unknown_is_neither_joined_nor_banded():
    frequency = np.arange(1.0, 41.0)
    std = np.where((frequency > 10) & (frequency <= 20), 10.0, 1e-3)[None, :, None, None]
    _, axes = bode(make_frf(np.ones((1, 40, 1, 1)), frequency, std=std))
    ends = strokes(axes[0, 0, 1])[:, :, 0]
    assert not ((ends > 10) & (ends <= 20)).any()
    assert len(points(axes[0, 0, 1])) == 40
    for band in axes[0, 0, 1].collections:
        x = np.concatenate([path.vertices[:, 0] for path in band.get_paths()])
        assert not ((x > 10) & (x <= 20)).any()


def test_bands_are_those_of_the_disc():
    frf = make_frf(np.full((1, 30, 1, 1), 2j), std=0.1, dof=5)
    radius = 0.1 * np.sqrt(5 * (0.1 ** (-1 / 5) - 1))
    _, axes = bode(frf, confidence=0.9)
    edges = [np.unique(x.collections[0].get_paths()[0].vertices[:, 1]) for x in axes[0, 0]]
    np.testing.assert_allclose(edges[0], 20 * np.log10([2 - radius, 2 + radius]), rtol=1e-9)
    half = np.degrees(np.arcsin(radius / 2))
    np.testing.assert_allclose(edges[1], [90 - half, 90 + half], rtol=1e-9)
    _, axes = bode(frf, confidence=None)
    assert not axes[0, 0, 0].collections and not axes[0, 0, 1].collections


def test_matrix_choice_and_several_estimates():
    rng = np.random.default_rng(0)
    G = rng.standard_normal((2, 20, 3, 2)) + 1j
    frf, other = make_frf(G, std=0.01, method="H1()"), make_frf(G[:, ::2], np.arange(1.0, 21, 2), std=0.01)
    figure, axes = bode([frf, other], position=1)
    assert axes.shape == (3, 2, 2)
    assert axes[2, 1, 0].get_title() == "$G_{32}$"
    np.testing.assert_allclose(points(axes[2, 1, 0])[:20, 1], 20 * np.log10(np.abs(G[1, :, 2, 1])))
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["H1()", "estimate 2", "95 % confidence"]
    _, axes = bode(frf, elements=[(0, 0), (2, 1), (1, 0), (0, 1)])
    assert axes.shape == (2, 2, 2)
    assert axes[0, 1, 0].get_title() == "$G_{32}$"


def test_given_axes_are_used_and_their_number_is_checked():
    figure = matplotlib.figure.Figure()
    mine = figure.subplots(2, 1)
    returned, axes = bode(make_frf(np.ones((1, 5, 1, 1))), axes=mine)
    assert returned is figure and axes[0, 0, 1] is mine[1]
    with pytest.raises(InputError, match=r"2 axes.*\(2, 1, 2\)"):
        bode(make_frf(np.ones((1, 5, 2, 1))), axes=mine)


def test_nothing_estimated_is_an_empty_picture():
    status = np.full((1, 5), Status.NOT_FINITE.value)
    figure, axes = bode(make_frf(np.full((1, 5, 1, 1), np.nan), status=status))
    assert len(axes[0, 0, 0].get_title()) and figure is axes[0, 0, 0].figure


def test_pictures_leave_no_trace_in_pyplot():
    bode(make_frf(np.ones((1, 5, 1, 1))))
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or pyplot.get_fignums() == []


WRONG = {
    "element": (dict(elements=[(0, 1)]), r"\(0, 1\).*\(0, 0\) to \(1, 0\)"),
    "position": (dict(position=1), "position: found 1"),
    "labels": (dict(labels=["a", "b"]), "labels: found 2"),
    "label": (dict(labels=5), "labels: found 5"),
    "confidence": (dict(confidence=1.0), "confidence"),
    "size": (dict(size=(0.5, 0.5)), "size"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_requests(case):
    options, words = WRONG[case]
    with pytest.raises(InputError, match=words):
        bode(make_frf(np.ones((1, 5, 2, 1))), **options)


def test_estimates_of_different_systems_do_not_share_a_picture():
    with pytest.raises(InputError, match="2 x 1 of velocity beside 1 x 1"):
        bode([make_frf(np.ones((1, 5, 1, 1))), make_frf(np.ones((1, 5, 2, 1)))])
    with pytest.raises(InputError, match="frfs: found none"):
        bode([])


# --- coherence and spectra ---


def test_coherence_of_every_output():
    values = np.linspace(0, 1, 60).reshape(2, 10, 3)
    figure, axes = coherence(np.arange(1.0, 11), values, position=1)
    assert len(points(axes)) == 30
    np.testing.assert_array_equal(points(axes)[10:20, 1], values[1, :, 1])
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["$y_{1}$", "$y_{2}$", "$y_{3}$"]
    with pytest.raises(InputError, match=r"\(1, 10, 3\) with 9"):
        coherence(np.arange(9.0), values[0])
    with pytest.raises(InputError, match="position: found 2"):
        coherence(np.arange(10.0), values, position=2)


def record(noise=0.0, r=True):
    """Four periods, two channels: cosines at lines 5, 7, 11, and smaller ones at lines 8 and 9 of y."""
    n, periods = 64, 4
    rng = np.random.default_rng(0)
    t = np.arange(n * periods)
    tones = {5: 1.0, 7: 0.5, 11: 0.25}
    u = sum(a * np.cos(2 * np.pi * k * t / n) for k, a in tones.items())
    y = 2 * u + 0.01 * np.cos(2 * np.pi * 8 * t / n) + 0.02 * np.cos(2 * np.pi * 9 * t / n)
    signal = lambda x: np.stack([x, 3 * x], -1) + noise * rng.standard_normal((len(t), 2))
    lines = np.array(sorted(tones))
    return Experiment(signal(u), signal(y), 64.0, n, r=np.stack([u, u], -1) if r else None, lines=lines)


def curve(axes, colour):
    """The points of one colour as {frequency: level}."""
    line = next(x for x in axes.lines if x.get_linestyle() == "None" and x.get_color() == colour)
    return dict(zip(line.get_xdata(), line.get_ydata(), strict=True))


def test_levels_of_excitation_and_distortion():
    data = record()
    figure, axes = spectrum(dft(data), unexcited_spectra(data, (6.0, 10.0)))
    assert axes.shape == (3, 2)
    excited, odd, even = (curve(axes[2, 1], c) for c in ("#0072B2", "#D55E00", "#E69F00"))
    for k, amplitude in {5: 1.0, 7: 0.5, 11: 0.25}.items():  # a cosine of amplitude a has coefficients a/2
        assert excited[k] == pytest.approx(20 * np.log10(3 * 2 * amplitude / 2), abs=1e-9)
    assert even[8.0] == pytest.approx(20 * np.log10(3 * 0.01 / 2), abs=1e-6)
    assert odd[9.0] == pytest.approx(20 * np.log10(3 * 0.02 / 2), abs=1e-6)
    assert set(even) == {6.0, 8.0, 10.0} and set(odd) == {9.0}
    labels = [t.get_text() for t in figure.legends[0].get_texts()]
    assert labels[:3] == ["excited lines", "unexcited odd lines", "unexcited even lines"]
    assert axes[2, 0].get_ylabel() == "dB re 1 rad/s"
    only_excited = [x.get_color() for x in axes[0, 0].lines]  # the reference's other lines are rounding
    assert only_excited == ["#0072B2"]


def test_noise_level_is_the_scatter_between_periods():
    data = record(noise=0.1)
    _, axes = spectrum(dft(data))
    per_period = np.fft.fft(data.y[0, 0, :, 1].reshape(4, 64))[:, [5, 7, 11]] / 64
    expected = 20 * np.log10(np.std(per_period, axis=0, ddof=1) / 2)
    np.testing.assert_allclose(list(curve(axes[2, 1], "#777777").values()), expected, rtol=1e-9)


def test_spectrum_without_reference_and_of_chosen_channels():
    data = record(r=False)
    _, axes = spectrum(dft(data), channels=[1])
    assert axes.shape == (2, 1)
    assert axes[0, 0].get_title() == "$u_{2}$"
    with pytest.raises(InputError, match=r"channels: found \[2\].*0 to 1"):
        spectrum(dft(data), channels=[2])
    with pytest.raises(InputError, match="position"):
        spectrum(dft(data), position=1)


# --- files ---


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_save_by_suffix(tmp_path, suffix, start):
    figure, _ = bode(make_frf(np.ones((1, 5, 1, 1)), std=0.1))
    save(figure, tmp_path / f"bode{suffix}")
    assert (tmp_path / f"bode{suffix}").read_bytes().startswith(start)
    assert len(list(tmp_path.iterdir())) == 1


def test_save_refuses_unknown_formats_and_folders(tmp_path):
    figure, _ = coherence(np.arange(3.0), np.ones(3))
    with pytest.raises(InputError, match=r"\.xyz.*\.pdf.*\.png"):
        save(figure, tmp_path / "bode.xyz")
    with pytest.raises(InputError, match="no folder"):
        save(figure, tmp_path / "nowhere" / "bode.png")
    assert not list(tmp_path.iterdir())
