"""Many files by one command: each by itself, on all cores or on many machines, nothing lost.

    jaxfrf estimate 'logs/*.mat' --each -o results --workers 8

In Python, `jaxfrf.batch.each` does the same with any command's arguments, on a Dask client of one's own where it is
given one. And data sets of any size, some positions at a time: `estimate_to`, `simulate_to`.
"""

from typing import TYPE_CHECKING

from .each import Batch as Batch, each as each
from .engine import Done as Done, outcomes as outcomes
from .estimated import Chosen as Chosen, Estimated as Estimated, estimate_to as estimate_to

if TYPE_CHECKING:
    from .simulated import Simulated as Simulated, simulate_to as simulate_to

_EAGER = ("Batch", "Chosen", "Done", "Estimated", "each", "estimate_to", "outcomes")


def __getattr__(name: str):
    if name in ("Simulated", "simulate_to"):  # an estimate needs no simulation
        from . import simulated

        return getattr(simulated, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted([*_EAGER, "Simulated", "simulate_to"])
