"""The glossary of axis names, and the 64-bit check.

Axes, in every public signature:

    pos     operating point (arm configuration)      freq    excited line
    exp     experiment at one operating point        out     plant output
    real    realisation (block of n_in experiments)  in      plant input
    period  excitation period                        ref     reference
    time    sample                                   sig     [output; input], stacked
    joint   joint of the arm                         vec     out*in, columns of G stacked

Signals are (pos, exp, time, channel), spectra (pos, exp, freq, channel), FRFs (pos, freq, out, in).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int, PyTree

Array = jax.Array | np.ndarray

Signal = Float[Array, "pos exp time channel"]
Response = Complex[Array, "pos freq out in"]
Covariance = Complex[Array, "pos freq vec vec"]
Frequency = Float[Array, "freq"]
Lines = Int[Array, "freq"]


def require_x64(what: str) -> None:
    """Raise if JAX works in 32 bit: a local least-squares problem squares rounding away in single precision."""
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise ValueError(
            f"{what} needs 64-bit numbers, but JAX is set to 32 bit. jaxfrf never changes that setting for you: "
            'set the environment variable JAX_ENABLE_X64=1, or call jax.config.update("jax_enable_x64", True) '
            "before the first array is made."
        )


def arrays(tree: PyTree) -> PyTree:
    """Leaves as JAX arrays, plain numbers too, whose type does not say that they were plain: trees that differ in their
    numbers alone then share what is compiled."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.result_type(x)), tree)


def traced(tree: PyTree) -> bool:
    """Whether a transformation of JAX looks on: some leaf is no number yet."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(tree))
