"""Programs that XLA compiles in half of the time."""

import functools

import equinox as eqx
import jax

_OPTIONS = {"xla_cpu_use_fusion_emitters": False}
"""Loops by XLA's older code generator, which makes as fast ones. Measured for the programs of `frf` with jaxlib 0.10.2:
1.6 s where the newer one takes 3.2, 3.3 s where it takes 6.1."""


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
