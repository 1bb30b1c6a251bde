"""Options of XLA that this version may not have, and programs that are compiled when they are called."""

import jax.numpy as jnp
import pytest

from jaxfrf import _compile


@pytest.fixture
def options(monkeypatch):
    def these(**values):
        monkeypatch.setattr(_compile, "_OPTIONS", values)
        return _compile._known_options()

    _compile._known_options.cache_clear()
    yield these
    _compile._known_options.cache_clear()


def test_options_that_are_not_known_are_left_out(options):
    assert options(xla_cpu_enable_fast_math=False, xla_cpu_no_such_thing=1) == {"xla_cpu_enable_fast_math": False}


def test_without_any_option(options):
    assert options(xla_cpu_no_such_thing=1) is None
    assert _compile.program(lambda x: 2.0 * x)(jnp.ones(2)).tolist() == [2.0, 2.0]


def test_numbers_are_no_part_of_a_program():
    traced = []

    @_compile.program
    def doubled(tree):
        traced.append(tree)
        return 2.0 * tree["x"]

    assert [float(doubled({"x": x})) for x in (1.0, 2.0, 3.0)] == [2.0, 4.0, 6.0]
    assert len(traced) == 1 and doubled.__name__ == "doubled"


def test_estimators_have_options_of_their_own():
    def halved(x):
        return x / 2.0

    assert _compile.compiled(halved) is _compile.compiled(halved)
    assert _compile.compiled(halved)(jnp.ones(2)).tolist() == [0.5, 0.5]
    assert _compile._known(_compile._OF_ESTIMATORS) == _compile._OF_ESTIMATORS
