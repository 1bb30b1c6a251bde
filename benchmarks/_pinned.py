"""Measurements in fresh processes that are pinned to their cores, and the machine that they run on."""

import json
import os
import pathlib
import platform
import subprocess
import sys
from collections.abc import Sequence

ROOT = pathlib.Path(__file__).resolve().parents[1]
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def available_cores() -> list[int]:
    """Numbers of the cores that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def pin_to(cores: Sequence[int]) -> None:
    """This process, and what it starts, to these cores, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


def run_pinned(script: str, cores: Sequence[int], threads: int, limit: float, request: dict) -> dict:
    """What `script --worker REQUEST` prints as JSON, in a fresh process on these cores.

    **Arguments:** `threads`: of BLAS. `limit`: s, after which the process is given up.
    """

    environment = os.environ | dict.fromkeys(_THREADS, str(threads))
    environment |= {"JAX_PLATFORMS": "cpu", "JAX_ENABLE_COMPILATION_CACHE": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, script, "--worker", json.dumps(request)]
    done = subprocess.run(
        command,
        env=environment,
        preexec_fn=lambda: pin_to(cores),
        stdout=subprocess.PIPE,
        text=True,
        timeout=limit,
        check=True,
    )
    return {"cores": len(cores), **json.loads(done.stdout)}


def machine() -> dict:
    """What a result depends on beside the code."""
    from importlib.metadata import version

    return {
        "processor": _processor(),
        "cores": len(available_cores()),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("numpy", "scipy", "jax")},
        "load_before": os.getloadavg(),
    }


def commit() -> str:
    """That a result is made with, "-dirty" behind it where files differ; "unknown" outside a clone."""
    call = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def _processor() -> str:
    info = pathlib.Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
    return names[0] if names else platform.processor()


def machine_text(about: dict) -> str:
    versions = ", ".join(f"{name} {text}" for name, text in about["versions"].items())
    return (
        f"{about['processor']}, {about['cores']} cores; Python {about['python']}, {versions}\n"
        f"load average: {load_text(about['load_before'])}"
    )


def load_text(load: Sequence[float]) -> str:
    return " ".join(f"{x:.1f}" for x in load)
