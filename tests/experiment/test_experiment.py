"""The container of records: shapes that mean the same, what it refuses, periods, and joining."""

import dataclasses
import re

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, strategies as st

import jaxfrf as jf
from jaxfrf.experiment import seen_period

RNG = np.random.default_rng(0)


def signal(*shape):
    return RNG.standard_normal(shape)


def message(*args, **fields):
    with pytest.raises(jf.InputError) as caught:
        jf.Experiment(*args, **fields)
    text = str(caught.value)
    assert re.search(r"found .+; expected .+\. \S.+", text, re.DOTALL), text
    return text


@given(
    n_pos=st.integers(1, 3),
    n_exp=st.integers(1, 3),
    n_in=st.integers(1, 3),
    n_out=st.integers(1, 3),
    n_time=st.integers(4, 40),
)
def test_sizes(n_pos, n_exp, n_in, n_out, n_time):
    u, y = signal(n_pos, n_exp, n_time, n_in), signal(n_pos, n_exp, n_time, n_out)
    data = jf.Experiment(u, y, 10)
    assert (data.n_pos, data.n_exp, data.n_time, data.n_in, data.n_out) == (n_pos, n_exp, n_time, n_in, n_out)
    assert (data.fs, data.period, data.n_periods, data.r) == (10.0, 0, 0, None)
    assert data.u is u or np.shares_memory(data.u, u)


@pytest.mark.parametrize("shape", [(20,), (20, 1), (1, 20), (1, 20, 1), (1, 1, 20, 1)])
def test_shapes_that_mean_one_record(shape):
    u = signal(20)
    data = jf.Experiment(u.reshape(shape), u, 10.0)
    assert data.u.shape == (1, 1, 20, 1)
    np.testing.assert_array_equal(data.u.ravel(), u)


def test_integers_and_single_precision_become_double():
    data = jf.Experiment(np.arange(9, dtype=np.int16), np.arange(9, dtype=np.float32), 10.0)
    assert data.u.dtype == data.y.dtype == np.float64


@pytest.mark.parametrize(
    ("u", "says"),
    [
        (np.zeros((2, 20)), r"u: found 2 samples of 20 channels.*transpose"),
        (np.zeros((1, 1, 1, 20, 1)), r"u: found 5 dimensions"),
        (np.zeros((0, 2)), r"u: found no samples"),
        (np.zeros(20, complex), r"u: found complex numbers; expected real numbers"),
        (np.array(["a"] * 20), r"u: found <U1 data; expected real numbers"),
        (np.array([1.0, None] * 10), r"u: found object data"),
    ],
)
def test_wrong_signals(u, says):
    assert re.search(says, message(u, np.zeros(20), 10.0))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_not_finite(value):
    u = np.zeros((2, 3, 20, 2))
    u[1, 2, 7, 1] = value
    text = message(u, np.zeros((2, 3, 20, 1)), 10.0)
    assert "1 NaN or Inf samples, the first at position 1, experiment 2, sample 7, channel 1" in text


def test_opposite_infinities_and_huge_numbers():
    u = np.zeros((20, 2))
    u[3], u[4] = np.inf, -np.inf
    assert "4 NaN or Inf samples" in message(u, u, 10.0)
    assert "numbers up to 1e308" in message(np.full(20, 1e308), u, 10.0)  # their squares are not finite


def test_parts_of_a_period_show():
    with pytest.raises(jf.InputError, match=r"found 32768 samples, 4\.0005 periods of 8191; expected a whole number"):
        jf.Experiment(np.ones(32768), np.ones(32768), 10.0, 8191)


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"fs": 0}, r"fs: found 0; expected a positive number"),
        ({"fs": np.inf}, r"fs: found inf"),
        ({"fs": "fast"}, r"fs: found <U4"),
        ({"fs": [1.0, 2.0]}, r"fs: found float64 of shape \(2,\); expected one real number"),
        ({"period": 6}, r"period: found 20 samples, 3\.333 periods of 6; expected a whole number of periods"),
        ({"period": -5}, r"period: found -5; expected a whole number, 0 or more"),
        ({"period": 10, "transient_periods": 2}, r"transient_periods: found 2 of 2 periods"),
        ({"period": 10, "lines": [1, 5]}, r"lines: found 1 to 5; expected lines between 1 and 4"),
        ({"period": 10, "lines": [2, 1]}, r"lines: found a list that is not increasing"),
        ({"period": 10, "lines": ["a"]}, r"lines: found .*whole DFT line numbers"),
        ({"period": 10, "lines": []}, r"lines: found"),
        ({"q": np.zeros((2, 3))}, r"q: found 2 configurations; expected one for each of the 1 positions"),
        ({"q": [np.nan]}, r"q: found .*finite angles"),
        ({"q": ["a"]}, r"q: found <U1"),
        ({"r": np.zeros(19)}, r"r and u: found \(1, 1, 19\) and \(1, 1, 20\)"),
        ({"y_quantity": "speed"}, r"y_quantity: found 'speed'"),
        ({"r_quantity": "torque"}, r"r_quantity: found 'torque'"),
    ],
)
def test_wrong_fields(fields, says):
    assert re.search(says, message(np.zeros(20), np.zeros(20), **({"fs": 10.0} | fields)))


def test_select_periods():
    u = np.arange(60.0)
    data = jf.Experiment(u, 2 * u, 10.0, 10, r=3 * u, transient_periods=1)
    part = jf.select_periods(data, 1, 3)
    np.testing.assert_array_equal(part.u.ravel(), np.arange(20.0, 40.0))
    np.testing.assert_array_equal(part.r.ravel(), 3 * np.arange(20.0, 40.0))
    assert (part.n_periods, part.transient_periods) == (2, 0)
    np.testing.assert_array_equal(jf.select_periods(data, -1).u.ravel(), np.arange(50.0, 60.0))
    with pytest.raises(jf.InputError, match=r"periods: found 5:9; expected a part of the 5 steady periods"):
        jf.select_periods(data, 5, 9)
    with pytest.raises(jf.InputError, match="not periodic"):
        jf.select_periods(jf.Experiment(u, u, 10.0), 0)


def joined(n_exp=2, q=None, n_pos=1, name="a", **fields):
    u, y = signal(n_pos, n_exp, 20, 2), signal(n_pos, n_exp, 20, 1)
    given = {"fs": 10.0, "period": 10, "q": q, "sources": [jf.Source(name)], "y_quantity": "velocity"}
    return jf.Experiment(u, y, **(given | fields))


def test_concatenate_experiments_of_one_place():
    a, b = joined(2, q=[[0, 1]], warnings=["x"]), joined(3, q=[[0, 1]], name="b", warnings=["x", "y"])
    both = jf.concatenate([a, b])
    np.testing.assert_array_equal(both.u, np.concatenate([a.u, b.u], axis=1))
    np.testing.assert_array_equal(both.q, [[0, 1]])
    assert [s.name for s in both.sources] == ["a", "b"] and both.warnings == ("x", "y")


def test_concatenate_other_places():
    a, b = joined(q=[[0, 1]]), joined(q=[[2, 3], [4, 5]], n_pos=2)
    both = jf.concatenate([a, b])
    np.testing.assert_array_equal(both.y, np.concatenate([a.y, b.y]))
    np.testing.assert_array_equal(both.q, [[0, 1], [2, 3], [4, 5]])
    assert jf.concatenate([a]) is a


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"fs": 20.0}, r"b: fs: found 20\.0; expected 10\.0"),
        ({"period": 5}, r"b: period: found 5"),
        ({"transient_periods": 1}, r"b: (samples|transient_periods)"),
        ({"lines": [1]}, r"b: lines: found 1 lines"),
        ({"y_quantity": "position"}, r"b: y_quantity: found position; expected velocity"),
        ({"r": np.zeros((1, 2, 20, 2))}, r"b: references: found 2; expected 0"),
        ({"q": [[0, 1]]}, r"b: joints in q: found 2; expected 0"),
        ({"n_pos": 2}, r"positions: found \[1, 2\] without configurations q"),
    ],
)
def test_records_that_do_not_fit(fields, says):
    with pytest.raises(jf.InputError, match=says):
        jf.concatenate([joined(), joined(name="b", **fields)])


def test_other_numbers_of_experiments_at_other_places():
    with pytest.raises(jf.InputError, match=r"experiments: found \[2, 3\] at different positions"):
        jf.concatenate([joined(2, q=[[0]]), joined(3, q=[[1]])])
    with pytest.raises(jf.InputError, match="at least one record"):
        jf.concatenate([])


@pytest.mark.parametrize("u", ["step", "constant"])
def test_ringing_is_no_period(u):
    t = np.arange(8000)
    u = {"step": t > 500, "constant": t >= 0}[u] * 0.1
    rng = np.random.default_rng(0)
    ringing = scipy.signal.lfilter([0.1], [1, -1.93, 0.998], u)
    y = ringing + 0.01 * ringing.std() * rng.standard_normal(len(t))
    assert seen_period(None, None, y[None, None, :, None]) is not None
    assert seen_period(None, u[None, None, :, None], y[None, None, :, None]) is None


def test_the_period_of_an_output_counts_where_the_input_repeats_with_it():
    rng = np.random.default_rng(1)
    one = rng.standard_normal(500)
    y = np.tile(one, 6)
    u = y + 1.3 * rng.standard_normal(len(y))
    _, found = seen_period(None, u[None, None, :, None], y[None, None, :, None])
    assert found.period == 500


def test_a_quantity_that_nobody_states():
    x = np.random.default_rng(1).standard_normal((20, 1))
    silent = jf.Experiment(x, x, 100.0)
    assert silent.y_quantity == "velocity" and "nothing says what y is" in silent.warnings[0]
    assert dataclasses.replace(silent, fs=50.0).warnings == silent.warnings
    assert jf.Experiment(x, x, 100.0, y_quantity="position").warnings == ()
    by_unit = jf.Experiment(x, x, 100.0, y_unit="m/s^2")
    assert by_unit.y_quantity == "acceleration" and by_unit.warnings == ()
    odd = jf.Experiment(x, x, 100.0, y_quantity="velocity", y_unit="rad")
    assert odd.warnings == ("y: its unit rad is that of a position, y_quantity says velocity.",)
    assert dataclasses.replace(odd, fs=50.0).warnings == odd.warnings
    assert jf.Experiment(x, x, 100.0, y_unit="rad/s2").y_quantity == "acceleration"


@pytest.mark.parametrize("period", [1, 2, 3])
def test_periods_of_hardly_a_sample_are_refused(period):
    with pytest.raises(jf.InputError, match="4 samples or more"):
        jf.Experiment(np.zeros((12, 1)), np.zeros((12, 1)), 10.0, period)
