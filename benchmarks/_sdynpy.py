"""Seconds that SDynPy's LRM takes, in an environment of its own (`bench_local.py --sdynpy`).

Argument: a file with U and Y (exp, freq, channel), width and order.
"""

import os
import sys
import time

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")  # it opens Qt when it is imported

import numpy as np
from sdynpy.signal_processing.sdynpy_lrm import frf_local_model

given = np.load(sys.argv[1])
lines = np.arange(given["U"].shape[1], dtype=float)  # its windows want evenly spaced lines; what they hold is the same
models = [[int(given["order"]), 0, int(given["order"])]]
began = time.perf_counter()
for U, Y in zip(given["U"], given["Y"], strict=True):
    frf_local_model(
        U.T,
        Y.T,
        lines,
        bandwidth=float(given["width"]),
        transient=False,
        modelset=models,
        export_ratio=1e-9,
        max_parallel=1,
        print_time=False,
    )
print(time.perf_counter() - began)
