"""Set before jax is imported: 64 bit, a compilation cache that survives runs, threads that cannot deadlock, and how
much XLA optimises; and how many processes share the tests."""

import gc
import os
import pathlib
import time

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("NPROC", "64")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(pathlib.Path(__file__).parents[1] / ".jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.05")
os.environ.setdefault("MPLBACKEND", "agg")

import pytest

from jaxfrf._environment import known_flags

gc.set_threshold(50_000, 20, 10)  # what tracing allocates stays: looking for garbage at every turn costs a tenth
WORKERS = min(4, os.cpu_count() or 1)  # each needs some 3 GB
BEGAN = time.monotonic()
MAPS = 15_000  # of the 65 530 that the system allows a process; some 2 GB of programs


def pytest_addoption(parser):
    text = "skip tests that would begin later, but those of real measurements: for slow machines with a time limit"
    parser.addoption("--within", type=float, metavar="MINUTES", help=text)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    minutes = item.config.getoption("--within")
    late = minutes is not None and time.monotonic() - BEGAN > 60 * minutes
    if late and item.get_closest_marker("data") is None:
        pytest.skip(f"{minutes:g} minutes are over (--within)")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """The whole suite is shared between processes, where pytest-xdist is there; files that are named are not."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    started_by_another = hasattr(config, "workerinput")  # a worker runs this hook, too, and must not start its own
    if not whole or started_by_another or config.option.usepdb or not config.pluginmanager.hasplugin("xdist"):
        return
    if config.option.numprocesses is None and config.option.dist == "no":
        config.option.numprocesses, config.option.dist = WORKERS, "loadfile"


def pytest_configure(config):
    """The quick tests mostly compile: XLA optimises little for them. The slow ones run what users run."""
    if "not slow" in config.option.markexpr:
        flags = ["--xla_backend_optimization_level=0", *known_flags()]
        os.environ.setdefault("XLA_FLAGS", " ".join(flags))


@pytest.fixture(scope="session")
def measured() -> pathlib.Path:
    """The folder of real measurements, $JAXFRF_DATA; tests that need it are skipped without (never in CI)."""
    folder = os.environ.get("JAXFRF_DATA")
    if folder is None:
        if os.environ.get("CI"):
            pytest.fail("JAXFRF_DATA is not set: the real-data tests must run in CI.")
        pytest.skip("JAXFRF_DATA is not set: `python tests/data.py` says where the real measurements are to be had.")
    return pathlib.Path(folder).resolve()


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled_programs():
    """Every program that XLA compiled for the CPU keeps memory maps, and XLA ends in a segmentation fault where the
    system allows no more of them."""
    yield
    maps = pathlib.Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MAPS:
        import jax

        jax.clear_caches()
        gc.collect()
