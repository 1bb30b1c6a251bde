"""Whether an HDF5 file can be walked through: its library trusts what a damaged file states of itself, and has then run
for ever or brought the process down. Another process tries it first."""

import pathlib
import subprocess
import sys

from .._errors import input_error

_START = 30.0  # s to import h5py on a busy machine
_RATE = 20e6  # bytes/s that every disk reads
_WALK = """
import sys, h5py

seen = 0

def look(name, node):
    global seen
    seen += 1
    for key in node.attrs:
        node.attrs[key]
    if not isinstance(node, h5py.Dataset):
        return
    [len(d) for d in node.dims] if "DIMENSION_LIST" in node.attrs else None
    if node.chunks and node.size and node.id.get_num_chunks():
        node[tuple(slice(0, 1) for _ in node.shape)]
    elif node.size and node.size < 1000:
        node[()]

try:
    with h5py.File(sys.argv[1], "r") as file:
        file.visititems(look)
        for key in file.attrs:
            file.attrs[key]
except Exception as error:
    sys.exit(f"{type(error).__name__}: {error}")
"""


def check_walkable(path: pathlib.Path) -> None:
    """Walk through all objects, attributes and beginnings of arrays of an HDF5 file, in a process of its own.

    **Raises:** `jaxfrf.InputError` where that fails, ends the process, or takes for ever.
    """
    if not sys.executable:  # embedded: nothing to try it with
        return
    limit = _START + path.stat().st_size / _RATE
    try:
        done = subprocess.run(
            [sys.executable, "-c", _WALK, str(path)], capture_output=True, text=True, errors="replace", timeout=limit
        )
    except subprocess.TimeoutExpired:
        raise _damaged(path, f"an HDF5 file that cannot be walked through in {limit:.0f} s") from None
    if done.returncode < 0:
        raise _damaged(path, f"an HDF5 file that ends the process that opens it (signal {-done.returncode})")
    lines = done.stderr.strip().splitlines()
    if done.returncode and not (lines and "No module named" in lines[-1]):
        raise _damaged(path, f"an HDF5 file that cannot be read ({lines[-1][:200] if lines else 'no message'})")


def _damaged(path: pathlib.Path, found: str):
    return input_error(
        str(path),
        found,
        "a whole file",
        "It may be truncated, damaged, still being written, or have the wrong extension: copy or export it again.",
    )
