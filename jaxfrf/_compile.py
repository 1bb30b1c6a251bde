"""Programs that XLA compiles in half of the time."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp

_OPTIONS = {"xla_cpu_use_fusion_emitters": False}
"""Loops by XLA's older code generator, which makes as fast ones. Measured for the programs of `frf` with jaxlib 0.10.2:
1.6 s where the newer one takes 3.2, 3.3 s where it takes 6.1."""

_NEVER = 1e300


@functools.cache
def compiled(function):
    """`equinox.filter_jit` of a function that is called by the user's Python, not within another program."""
    return eqx.filter_jit(function, compiler_options=_known_options())


@functools.cache
def _known_options() -> dict | None:
    """The options, where this version of XLA has them."""
    try:
        jax.jit(lambda: 0, compiler_options=_OPTIONS)()
    except jax.errors.JaxRuntimeError:
        return None
    return _OPTIONS


def after(x, done):
    """Arrays x, once the array `done` is there: what is made from x then waits for what makes `done`.

    In jaxlib 0.10 as many batched LAPACK calls at a time as XLA's pool has threads wait for each other for ever
    (`jaxfrf._environment`): those of one program that know nothing of each other have to take turns.
    """
    nothing = jnp.where(jnp.abs(done.ravel()[0]) > _NEVER, 1.0 / _NEVER, 0.0)  # what XLA cannot know to be zero
    return jax.tree.map(lambda leaf: leaf + nothing, x)
