"""Programs that XLA compiles in half of the time, and that several threads run at once without hindering each other."""

import contextlib
import contextvars
import functools
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata

_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}
"""Loops by XLA's older code generator, which makes as fast ones: the programs of `frf` compile in 1.6 s where the newer
one takes 3.2, in 3.3 where it takes 6.1 (jaxlib 0.10.2).

One operation after the other: by default XLA lets small operations of one program run side by side, which takes more
processor time than it gains where they are as small as here. A simulation of 12 runs takes 1.40 s of processor instead
of 2.06, and two at once on two cores 1.5 s instead of 2.85."""

_BESIDE_OTHERS = {"xla_disable_hlo_passes": "cpu-parallel-task-assigner"}
"""For a program that several threads run at once: none of its loops is shared out among the cores, which have work
already. On two cores 4032 windows of JIO-LRM take 174 ms instead of 216, of MISO 169 instead of 213. A program that
runs alone would be slower by a tenth."""

_NEVER = 1e300
_beside_others = contextvars.ContextVar("beside_others", default=False)


def compiled(function):
    """`equinox.filter_jit` of a function that is called by the user's Python, not within another program."""
    return _compiled(function, _beside_others.get())


@functools.cache
def _compiled(function, beside_others):
    options = (_known_options() or {}) | (_known_beside_others() if beside_others else {})
    return eqx.filter_jit(function, compiler_options=options or None)


@contextlib.contextmanager
def beside_others(true: bool = True) -> Iterator[None]:
    """What is `compiled` here, in this thread, is meant to run while other threads do."""
    before = _beside_others.set(true)
    try:
        yield
    finally:
        _beside_others.reset(before)


def apart(function):
    """The function as a part of a program by itself: its result is written down before what follows reads it.

    XLA's processor backend otherwise works a small result out anew in every loop that reads it, and ignores
    `jax.lax.optimization_barrier` there. Where a version of XLA knows nothing of it, results are the same."""
    called = jax.jit(function)

    @functools.wraps(function)
    def call(*arguments):
        with set_xla_metadata(inlineable="false"):
            return called(*arguments)

    return call


def program(function):
    """`compiled` as a decorator, by `jax.jit`: plain numbers are no part of the program. Compiled when it is called."""

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


@functools.cache
def _known_beside_others() -> dict:
    return _BESIDE_OTHERS if _are_known(_BESIDE_OTHERS) else {}


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
