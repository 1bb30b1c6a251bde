"""Programs that XLA compiles in half of the time, and that several threads run at once without hindering each other."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp

_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}
"""Loops by XLA's older code generator, which makes as fast ones: the programs of `frf` compile in 1.6 s where the newer
one takes 3.2, in 3.3 where it takes 6.1 (jaxlib 0.10.2).

One operation after the other: by default XLA lets small operations of one program run side by side, which takes more
processor time than it gains where they are as small as here. A simulation of 12 runs takes 1.40 s of processor instead
of 2.06, and two at once on two cores 1.5 s instead of 2.85."""

_NEVER = 1e300


@functools.cache
def compiled(function):
    """`equinox.filter_jit` of a function that is called by the user's Python, not within another program."""
    return eqx.filter_jit(function, compiler_options=_known_options())


def program(function):
    """The same as a decorator, by `jax.jit`: plain numbers are no part of the program. Compiled when it is called."""

    @functools.cache
    def made():
        return jax.jit(function, compiler_options=_known_options())

    @functools.wraps(function)
    def call(*arguments):
        return made()(*arguments)

    return call


@functools.cache
def _known_options() -> dict | None:
    """Those of the options that this version of XLA has."""
    if _are_known(_OPTIONS):
        return _OPTIONS
    return {name: value for name, value in _OPTIONS.items() if _are_known({name: value})} or None


def _are_known(options: dict) -> bool:
    try:
        jax.jit(lambda: 0, compiler_options=options)()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def after(x, done):
    """Arrays x, once the array `done` is there: what is made from x then waits for what makes `done`.

    In jaxlib 0.10 as many batched LAPACK calls at a time as XLA's pool has threads wait for each other for ever
    (`jaxfrf._environment`): those of one program that know nothing of each other have to take turns.
    """
    nothing = jnp.where(jnp.abs(done.ravel()[0]) > _NEVER, 1.0 / _NEVER, 0.0)  # what XLA cannot know to be zero
    return jax.tree.map(lambda leaf: leaf + nothing, x)
