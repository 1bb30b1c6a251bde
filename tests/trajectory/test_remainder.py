"""How lines are weighed by what is left at them."""

'''

def test_a_line_at_the_end_weighs_as_one_of_the_middle():
    """A slow sine on the first line: its own remainder is 1/21 of its floor's square, as anywhere; where that share was
    11/21, the line that told friction lost its weight in every round."""
    noise = np.zeros((101, 1))
    for line in (1, 50, 100):
        left = np.full((2, 3, 101, 1), 1e-9 + 0j)
        left[:, :, line] = 21.0
        np.testing.assert_allclose(usual_size(left, noise)[line] ** 2, 0.5 * 21.0**2 / 21, rtol=1e-6)
'''
