"""Every process of the tests has one thread: pytest-xdist starts a process a core, and small matrices gain nothing from
more. Two threads in each of two processes on two cores wait for each other, and take six times the processor time."""

import os

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # read when numpy and torch are loaded, which is later
