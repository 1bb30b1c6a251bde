"""Corrections until they converge: fixed points that are known, and fits that lost a parameter on the way."""

import types

import numpy as np

import jaxfrf as jf
from jaxfrf.graybox import Coordinates, Correction
from jaxfrf.graybox.corrections import next_point, settled, updated

NAMES = ("k", "l", "m")
COORDINATES = Coordinates({name: jf.Parameter(2.0) for name in NAMES})


def fit_at(x, names=NAMES, std=0.01):
    """What the functions ask of a fit."""
    x = np.asarray(x, float)
    known = dict(zip(names, np.exp(x), strict=True))
    return types.SimpleNamespace(
        x=x,
        values={name: known.get(name, 2.0) for name in NAMES},
        coordinates=types.SimpleNamespace(names=names),
        uncertainty=types.SimpleNamespace(information=np.eye(len(names)) / std**2, std=np.full(len(names), std)),
    )


def corrected(step, x, rounds):
    """Rounds about the fixed point of a map, and how far each was off it."""
    history = []
    for _ in range(rounds):
        history.append(Correction(x, step(x), 0.0, 0.0))
        x = next_point(history, COORDINATES, fit_at(history[-1].update))
    return history


class TestNextPoint:
    def test_faster_than_plain_iteration(self):
        """x -> A x + b with a contraction of .7: twelve plain rounds leave 2 % of the way."""
        rng = np.random.default_rng(0)
        V = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        A, b = V @ np.diag([0.7, 0.3, -0.4]) @ V.T, 0.1 * rng.standard_normal(3)
        fixed = np.linalg.solve(np.eye(3) - A, b)
        last = corrected(lambda x: A @ x + b, fixed + 0.1, 12)[-1]
        assert np.abs(last.x - fixed).max() < 1e-4 * 0.1

    def test_a_step_is_limited(self):
        there = next_point(
            [Correction(np.zeros(3), np.array([5.0, 1.0, 0.0]), 0.0, 0.0)], COORDINATES, fit_at([0, 0, 0])
        )
        np.testing.assert_allclose(there, [0.7, 0.14, 0.0])

    def test_a_worse_round_is_taken_back(self):
        good, bad = (Correction(np.full(3, x), np.full(3, x + 0.2), gap, 1.0) for x, gap in ((0.0, 1.0), (0.2, 1.2)))
        np.testing.assert_allclose(next_point([good, bad], COORDINATES, fit_at([0, 0, 0])), 0.1)


class TestLostParameters:
    def test_update(self):
        np.testing.assert_allclose(updated(COORDINATES, fit_at([0.1, 0.2, 0.3])), [0.1, 0.2, 0.3])
        lost = fit_at([0.1, 0.3], ("k", "m"))
        np.testing.assert_allclose(updated(COORDINATES, lost), [0.1, np.log(2.0), 0.3])

    def test_it_stays_whatever_is_lost(self):
        x = np.array([0.1, 0.5, 0.3])
        lost = fit_at([0.1 + 5e-4, 0.3 + 5e-3], ("k", "m"))
        round_ = Correction(x, updated(COORDINATES, lost), 0.0, 0.0)
        np.testing.assert_array_equal(settled(round_, COORDINATES, lost), [True, True, False])

    def test_the_next_round(self):
        """Without the metric of the lost parameter a round is still made."""
        lost = fit_at([0.1, 0.3], ("k", "m"))
        history = [
            Correction(np.zeros(3), np.full(3, 0.2), 0.0, 0.0),
            Correction(np.full(3, 0.2), np.full(3, 0.3), 0.0, 0.0),
        ]
        assert np.isfinite(next_point(history, COORDINATES, lost)).all()
