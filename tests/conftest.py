"""Every process of the tests has one thread: pytest-xdist starts a process a core, and small matrices gain nothing from
more. Two threads in each of two processes on two cores wait for each other, and take six times the processor time."""

import os

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # read when numpy and torch are loaded, which is later


def pytest_collection_modifyitems(items):
    """Files with laws that take many seconds come first, so that no process is left with one when the others are done.

    pytest-xdist keeps this order where it is told `--no-loadscope-reorder`, as the Makefile does.
    """
    long = {item.path for item in items if item.get_closest_marker("long")}
    items.sort(key=lambda item: item.path not in long)
