"""What the command line sets before it imports JAX, unless the user already did."""

import os
import pathlib

_THREADS = 64
"""At least, of XLA's thread pool. In jaxlib 0.10 a batched LAPACK call (`jax::ParallelBatchMap`, lapack_kernels.cc)
runs on one thread of the pool, hands its batch to the others and waits: with as many calls at a time as there are
threads, each waits for the others for ever (PyAutoFit #1530 found the same of FFTs; jax 0.11.2 builds without it). So
many calls are never ready together; threads that sleep cost nothing measurable."""


def prepare() -> None:
    """64 bit, a thread pool in which batched LAPACK calls cannot wait for each other for ever, a compilation cache."""
    cores = os.cpu_count() or 1
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache")) / "jaxfrf"
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for many small matrices its threads cost more than they give
    os.environ.setdefault("NPROC", str(max(_THREADS, cores)))
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
