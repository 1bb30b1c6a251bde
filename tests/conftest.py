"""Set before jax is imported: 64 bit, a compilation cache that survives runs, and threads that cannot deadlock."""

import gc
import os
import pathlib

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("NPROC", "4")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(pathlib.Path(__file__).parents[1] / ".jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
os.environ.setdefault("MPLBACKEND", "agg")

import pytest


@pytest.fixture(scope="session")
def measured() -> pathlib.Path:
    """The folder of real measurements, $JAXFRF_DATA; tests that need it are skipped without (never in CI)."""
    folder = os.environ.get("JAXFRF_DATA")
    if folder is None:
        if os.environ.get("CI"):
            pytest.fail("JAXFRF_DATA is not set: the real-data tests must run in CI.")
        pytest.skip("JAXFRF_DATA is not set: no real measurements here.")
    return pathlib.Path(folder).resolve()


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled_programs():
    """Every program that XLA compiled for the CPU keeps memory maps; the system allows a process some 65 thousand, and
    XLA ends in a segmentation fault beyond them. So each module of tests starts without those of the last."""
    yield
    import jax

    jax.clear_caches()
    gc.collect()
