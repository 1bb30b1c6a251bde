"""Many files by one command: each by itself, on all cores or on many machines, nothing lost.

    jaxfrf estimate 'logs/*.mat' --each -o results --workers 8

In Python, `jaxfrf.batch.each` does the same with any command's arguments, on a Dask client of one's own where it is
given one.
"""

from .each import Batch as Batch, each as each
from .engine import Done as Done, outcomes as outcomes
