"""How lines are weighed by what is left at them."""

import numpy as np

from jaxfrf.trajectory.remainder import usual_size


def test_a_line_at_the_end_weighs_as_one_of_the_middle():
    """A slow sine on the first line: its own remainder is 1/21 of its floor's square, as anywhere; where that share was
    11/21, the line that told friction lost its weight in every round."""
    noise = np.zeros((101, 1))
    for line in (1, 50, 100):
        left = np.full((2, 3, 101, 1), 1e-9 + 0j)
        left[:, :, line] = 21.0
        np.testing.assert_allclose(usual_size(left, noise)[line] ** 2, 0.5 * 21.0**2 / 21, rtol=1e-6)


def test_few_lines_are_one_window():
    left = np.arange(1.0, 8.0).reshape(1, 1, 7, 1) + 0j
    expected = np.sqrt(0.5 * np.mean(np.arange(2.0, 8.0) ** 2))
    np.testing.assert_allclose(usual_size(left, np.zeros((7, 1)))[1:], expected)
