"""Wrong input gets one clear error: what was found, what was expected, what to do."""

import dataclasses
import re

import numpy as np
import plants
import pytest

import jaxfrf as jf

N_FREQ = 30


def random_spectra(n_exp=4, n_in=2, n_out=2, n_freq=N_FREQ, with_reference=True, **fields):
    rng = np.random.default_rng(0)
    U, R = (plants.circular(rng, (1, n_exp, n_freq, n_in)) for _ in range(2))
    Y = plants.circular(rng, (1, n_exp, n_freq, n_out))
    return plants.spectra(U, Y, R if with_reference else None, **fields)


def message(spectra, method):
    """The text of the InputError, which must have the shape of every error here: found, expected, advice."""
    with pytest.raises(jf.InputError) as caught:
        jf.estimate(spectra, method)
    text = str(caught.value)
    assert re.search(r"found .+; expected .+\. \S.+", text, re.DOTALL), text
    return text


def assert_says(text, *patterns):
    for pattern in patterns:
        assert re.search(pattern, text, re.IGNORECASE), f"no {pattern!r} in: {text}"


@pytest.mark.parametrize(
    "method",
    [
        jf.H1(),
        jf.H2(),
        jf.ArithmeticMean(),
        jf.LogMean(),
        jf.LogMean(elementwise=True),
        jf.JointInputOutput(),
    ],
    ids=repr,
)
def test_fewer_experiments_than_inputs(method):
    text = message(random_spectra(n_exp=2, n_in=3, n_out=3), method)
    assert_says(text, r"\b2\b.*experiment", r"\b3\b", r"local|lrm|lpm")


@pytest.mark.parametrize("method", [jf.H1(), jf.ArithmeticMean(), jf.LogMean()], ids=repr)
def test_experiments_that_repeat_one_another(method):
    """The same excitation twice: two experiments, one direction."""
    spectra = random_spectra(n_exp=1)
    doubled = dataclasses.replace(spectra, U=np.repeat(spectra.U, 2, 1), Y=np.repeat(spectra.Y, 2, 1), R=None)
    assert_says(message(doubled, method), r"rank", r"\b1\b", r"excit|phase|realisation")


def test_reference_that_repeats():
    spectra = random_spectra(n_exp=2)
    repeated = dataclasses.replace(spectra, R=np.repeat(spectra.R[:, :1], 2, 1))
    assert_says(message(repeated, jf.JointInputOutput()), r"rank", r"reference|\br\b", r"excit|phase|realisation")


@pytest.mark.parametrize("method", [jf.LPM(order=2, width=12), jf.LRM(order=2, width=20)], ids=repr)
def test_input_channel_that_stands_still(method):
    spectra = random_spectra(n_exp=1)
    U = np.array(spectra.U)
    U[..., 1] = 0
    assert_says(message(dataclasses.replace(spectra, U=U), method), r"rank|power|excit")


@pytest.mark.parametrize("method", [jf.JointInputOutput(), jf.JointInputOutput(jf.LRM(order=2, width=20))], ids=repr)
def test_no_reference(method):
    text = message(random_spectra(with_reference=False), method)
    assert_says(text, r"reference|\br\b", r"h1|lrm|log|record")


@pytest.mark.parametrize(
    "method, n_exp, fewest",
    [
        (jf.LPM(order=2, width=5), 1, 6),
        (jf.MisoLRM(order=2, width=7), 1, 8),
        (jf.LRM(order=2, width=9), 1, 10),
        (jf.LRM(order=2, width=4), 2, 5),
        (jf.JointInputOutput(jf.LRM(order=2, width=9)), 1, 10),
        (jf.LogMean(jf.LRM(order=2, width=9)), 4, 10),
        (jf.LPM(order=2, width=8, transient=2), 1, 9),
    ],
    ids=repr,
)
def test_window_narrower_than_its_unknowns(method, n_exp, fewest):
    """w_min = (R+1) n_u for LPM, + R with a denominator per output, + R n_y for the full matrix fraction."""
    text = message(random_spectra(n_exp=n_exp), method)
    inner = getattr(method, "method", method)
    assert_says(text, rf"\b{inner.width}\b", rf"\b{fewest}\b", r"wid|order|experiment")


@pytest.mark.parametrize("method", [jf.LPM(order=2, width=31), jf.LRM(order=2, width=31)], ids=repr)
def test_window_wider_than_the_band(method):
    assert_says(message(random_spectra(n_exp=1), method), r"\b31\b", r"\b30\b", r"line", r"narrow|lower|reduce|width")


@pytest.mark.parametrize("method", [jf.LogMean(), jf.LogMean(jf.LRM(order=2, width=20))], ids=repr)
def test_matrix_logarithm_of_what_is_not_square(method):
    text = message(random_spectra(n_exp=4, n_in=2, n_out=3), method)
    assert_says(text, r"\b3\b", r"\b2\b", r"square|as many", r"element|arithmetic")


@pytest.mark.parametrize(
    "method",
    [jf.H1(), jf.H2(), jf.Hv(), jf.ArithmeticMean(), jf.LogMean(), jf.JointInputOutput()],
    ids=repr,
)
def test_a_record_that_is_not_periodic(method):
    text = message(random_spectra(n_exp=4, periodic=False), method)
    assert_says(text, r"periodic", r"transient")


def test_a_local_method_with_a_transient_takes_what_is_not_periodic():
    found = jf.estimate(random_spectra(n_exp=1, periodic=False), jf.LPM(order=2, width=15, transient=2))
    assert np.all(np.isfinite(np.asarray(found.G)))


@pytest.mark.parametrize("method", [jf.LPM(order=2), jf.MisoLRM(order=2), jf.LRM(order=2), jf.LPM(order=2, width=8)])
def test_one_frequency_only(method):
    assert_says(message(random_spectra(n_exp=1, n_freq=1), method), r"\b1\b.*line", r"excite|line|h1")


@pytest.mark.parametrize("method", [jf.LPM, jf.MisoLRM, jf.LRM, jf.CommonDenominatorLRM])
@pytest.mark.parametrize(
    "options, word", [({"order": -1}, "order"), ({"width": 0}, "width"), ({"variable": "log"}, "variable")]
)
def test_impossible_options(method, options, word):
    with pytest.raises(ValueError, match=word):
        method(**options)


@pytest.mark.parametrize("method, touched", [(jf.H1(), [7]), (jf.LPM(order=2, width=9), range(12))], ids=repr)
def test_not_a_number_at_one_line(method, touched):
    """No exception inside a batch: the lines whose window holds it say so, the others are as they were."""
    spectra = random_spectra()
    Y = np.array(spectra.Y)
    Y[0, 0, 7, 0] = np.nan
    good, bad = (jf.estimate(s, method) for s in (spectra, dataclasses.replace(spectra, Y=Y)))
    flagged = np.flatnonzero(np.asarray(bad.status[0]) & jf.Status.NOT_FINITE)
    assert list(flagged) == list(touched)
    others = np.setdiff1d(np.arange(N_FREQ), flagged)
    np.testing.assert_allclose(bad.G[:, others], good.G[:, others], rtol=1e-9)


def test_something_that_is_no_method():
    with pytest.raises((TypeError, ValueError), match=r"str|method"):
        jf.estimate(random_spectra(), "h1")
