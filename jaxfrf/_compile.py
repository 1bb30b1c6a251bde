"""Programs that XLA compiles in half of the time, for the processor's widest registers and for one core each."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
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

_OF_ESTIMATORS = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
}
"""Registers as wide as there are, of which XLA takes half by default: 4032 windows of JIO-LRM take 142 ms instead of
154.

None of the estimators' loops is shared out among cores: they are too short for it, and where there are several
operating points the cores have work already. On two cores JIO-LRM of 12 experiments stacked takes 19 ms instead of 51,
`auto` 73 instead of 172."""

_NEVER = 1e300


@functools.cache
def compiled(function):
    """`jax.jit` of a function that is called by the user's Python, not within another program: of all arrays among its
    arguments; what else there is, options of methods, is part of the program. As `equinox.filter_jit`, which takes
    .2 ms more to call: `H1` takes one."""

    def with_arrays(structure, others, arrays):
        arrays = iter(arrays)
        return function(*jax.tree.unflatten(structure, [next(arrays) if x is _ARRAY else x for x in others]))

    with_arrays.__name__ = function.__name__
    options = _known({**_OPTIONS, **_OF_ESTIMATORS})
    program = jax.jit(with_arrays, static_argnums=(0, 1), compiler_options=options)

    def call(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        arrays = [x for x in leaves if isinstance(x, jax.Array | np.ndarray)]
        others = tuple(_ARRAY if isinstance(x, jax.Array | np.ndarray) else x for x in leaves)
        return program(structure, others, arrays)

    return call


_ARRAY = object()  # in the place of one


def apart(function):
    """The function as a part of a program by itself: its result is written down before what follows reads it.

    XLA's processor backend otherwise works a small result out anew in every loop that reads it, and ignores
    `jax.lax.optimization_barrier` there. Where a version of XLA knows nothing of it, results are the same."""

    @functools.wraps(function)
    def itself(*arguments):
        with set_xla_metadata(inlineable="true"):  # not what it calls in turn
            return function(*arguments)

    called = jax.jit(itself)

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
    return _known(_OPTIONS)


def _known(options: dict) -> dict | None:
    """Those of the options that this version of XLA has."""
    if _are_known(options):
        return options
    return {name: value for name, value in options.items() if _are_known({name: value})} or None


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
