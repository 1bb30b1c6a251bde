"""Cases of a parametrised test that the default run leaves out: one of every kind is enough there."""

import pytest


def slow(*case):
    """A case for `-m slow`, its values as `pytest.mark.parametrize` takes them."""
    return pytest.param(*case, marks=pytest.mark.slow)
