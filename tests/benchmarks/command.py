"""What the commands of the benchmarks share: how they are called, and how their tables look."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager


def parser(module: str, doc: str | None) -> argparse.ArgumentParser:
    """That of `python -m tests.benchmarks.MODULE`, which its docstring describes."""
    return argparse.ArgumentParser(prog=f"python -m tests.benchmarks{module and '.'}{module}", description=doc)


@contextmanager
def processes(workers: int) -> Iterator[Executor]:
    """A pool of so many processes, each of one thread: they are the parallelism."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # inherited
    with ProcessPoolExecutor(workers) as pool:
        yield pool


def markdown(head: Iterable[object], align: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table; align: "---" for a column of words, "---:" for one of numbers."""
    lines = [f"| {' | '.join(map(str, row))} |" for row in (head, *rows)]
    return "\n".join([lines[0], f"|{'|'.join(align)}|", *lines[1:]])
