"""What the command line sets before it imports JAX, unless the user already did."""

import os
import pathlib


def prepare() -> None:
    """64 bit, a thread pool in which batched LAPACK calls cannot wait for each other for ever, a compilation cache."""
    cores = os.cpu_count() or 1
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache")) / "jaxfrf"
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for many small matrices its threads cost more than they give
    os.environ.setdefault("NPROC", str(max(4, cores)))
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
