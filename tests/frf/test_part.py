"""Lines of one operating point that cores share: the same estimate as of all lines at once."""

import dataclasses
import importlib

import jax
import numpy as np
import plants
import pytest
from marks import slow

import jaxfrf as jf
from jaxfrf.frf import Signals
from jaxfrf.frf.part import Part, joined, parts_of

module = importlib.import_module("jaxfrf.frf.estimate")  # where its function hides it
LINES = np.arange(41, 41 + 2 * 77, 2)  # not a whole number of groups


@pytest.fixture(scope="module")
def spectra():
    loop = plants.two_mass_loop(2)
    return plants.steady_spectra(loop, LINES, 1000, 2, process_noise=0.02, measurement_noise=0.003).spectra()


@pytest.mark.parametrize(("n_line", "n_part"), [(77, 2), (80, 2), (77, 3), (5, 2), (16, 5)])
def test_parts_are_all_lines_once(n_line, n_part):
    parts = parts_of(n_line, n_part)
    assert len(parts) <= n_part and len({part.count for part in parts}) == 1
    found = joined([np.asarray(part.lines(n_line))[None] for part in parts], n_line, axis=1)
    np.testing.assert_array_equal(found[0], np.arange(n_line))


@pytest.mark.parametrize(
    ("method", "side_by_side", "n_pos"),
    [
        (jf.Auto(), True, 1),
        (jf.LogMean(jf.LRM(width=13)), False, 1),
        slow(jf.Auto(), False, 3),
        slow(jf.Auto(stages=1, use_reference=False), True, 1),
        slow(jf.LogMean(), True, 1),
        slow(jf.LogMean(jf.LRM(width=13)), True, 3),
        slow(jf.ArithmeticMean(jf.MisoLRM(width=17, transient=1)), True, 1),
        slow(jf.CommonDenominatorLRM(), True, 1),
        slow(jf.JointInputOutput(jf.LRM(width=13)), True, 1),
    ],
)
def test_estimate_in_parts(monkeypatch, spectra, method, side_by_side, n_pos):
    monkeypatch.setattr("jaxfrf.frf.window._MANY", 1 if side_by_side else 1000)
    many = dataclasses.replace(
        spectra, **{name: np.repeat(getattr(spectra, name), n_pos, axis=0) for name in ("U", "Y", "R")}, noise=None
    )
    jax.clear_caches()
    whole, shared = method.estimate(many), method.estimate(many, 3)
    jax.clear_caches()
    np.testing.assert_array_equal(shared.status, whole.status)
    for name in ("G", "dof", "window"):
        np.testing.assert_allclose(getattr(shared, name), getattr(whole, name), rtol=1e-9)
    np.testing.assert_allclose(np.asarray(shared.cov), np.asarray(whole.cov), rtol=1e-7, atol=1e-18)


def test_part_of_a_line_alone(spectra):
    """Within a program of the user's, its first line is a number that the program is given."""
    method, arrays = jf.LRM(width=13), (spectra.U[0], spectra.Y[0], None, None, spectra.frequency)
    whole = jax.jit(lambda: method.at_point(Signals(*arrays)).G)()
    some = jax.jit(lambda first: method.at_point(Signals(*arrays, part=Part(first, 10))).G)
    for first in (0, 33, 67):
        np.testing.assert_allclose(some(first), whole[first : first + 10], rtol=1e-9)


@pytest.mark.parametrize(
    ("method", "parts"),
    [
        (jf.Auto(), 4),
        (jf.LogMean(jf.LRM()), 1),  # 4 x 77 windows
        (jf.H1(), 1),
        (jf.RobustMean(jf.LRM()), 1),  # blocks are weighed by neighbouring lines
    ],
)
def test_who_shares_lines(monkeypatch, spectra, method, parts):
    monkeypatch.setattr(module, "_SHARED", 400)
    assert module._part_count(spectra, method, 4) == parts


def test_methods_of_the_users_share_nothing():
    class Own(jf.LRM):
        def at_point(self, signals, lines=None):
            return super().at_point(signals, lines)

    assert jf.LRM().shares_lines and not Own().shares_lines and not jf.JointInputOutput(Own()).shares_lines


@pytest.mark.parametrize(
    ("method", "calls"),
    [
        (jf.Auto(), False),
        (jf.JointInputOutput(jf.MisoLRM()), False),
        (jf.JointInputOutput(), False),
        (jf.ArithmeticMean(jf.LPM()), False),
        (jf.LogMean(jf.LRM()), False),
        (jf.LogMean(elementwise=True), False),
        (jf.CommonDenominatorLRM(), True),
        (jf.H2(), True),
    ],
    ids=lambda x: type(x).__name__,
)
def test_which_programs_call_lapack(spectra, method, calls):
    """Any number of those that say that they do not may run at the same time."""
    signals = Signals(spectra.U[0], spectra.Y[0], spectra.R[0], None, spectra.frequency)
    assert method.calls_lapack(spectra) == calls
    assert ("lapack" in jax.jit(method.at_point).lower(signals).as_text()) == calls


def test_large_windows_are_for_lapack(spectra):
    many = dataclasses.replace(spectra, U=np.repeat(spectra.U, 13, -1), Y=np.repeat(spectra.Y, 13, -1), noise=None)
    assert jf.LogMean(jf.LPM(order=0)).calls_lapack(many)  # for eigenvalues
    assert jf.LRM(order=20).calls_lapack(spectra)
    assert jf.Auto(jf.LRM(transient=1)).calls_lapack(spectra)
