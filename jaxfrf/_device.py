"""Where programs run, as far as their shape depends on it."""

from typing import Any

import jax

_BYTES = 4e9  # that a program may take on an accelerator for what it solves at once
_COPIES = 4  # of a Gram matrix that a window needs: itself, its factor, what its columns leave, the covariance


def on_accelerator() -> bool:
    """Whether what is traced now runs on a GPU rather than on the processor, by JAX's default device.

    A processor wants few windows at a time, which stay in its cache; a GPU all of them, as every tile is a row of
    kernels to be launched."""
    settings: Any = jax.config  # its types know no flags
    chosen = settings.jax_default_device or jax.devices()[0]
    return (chosen if isinstance(chosen, str) else chosen.platform) != "cpu"


def at_once(n_column: int) -> int:
    """Windows of so many columns, that an accelerator solves at once."""
    return max(1, int(_BYTES / (16 * _COPIES * n_column**2)))
