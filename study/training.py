"""A population trained to its end by a task: progress said, checkpoints written, a wish to stop heard."""

from __future__ import annotations

import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from study.executors.executor import Link, Stopped
from sysid import InvalidInput
from sysid.files import partial

if TYPE_CHECKING:
    from policies import Population

CHUNK = 20
"""Training steps between two looks at the clock and at the driver."""


def resume(population: Population, checkpoint: Path, name: str) -> None:
    """Go on from the checkpoint where there is one; a spoilt one costs its minutes, not the study."""
    if checkpoint.exists():
        try:
            population.resume(checkpoint)
        except InvalidInput as error:
            print(f"{name} begins anew: {error}", file=sys.stderr)


def finish(
    population: Population, checkpoint: Path, link: Link, checkpoint_seconds: float, seconds_before: float
) -> float:
    """Train all steps that are left; returns the seconds that training took, those before the checkpoint included.

    Raises Stopped once a checkpoint is written on request, and OSError where it cannot be written.
    """
    steps = population.settings.steps
    begin = saved = time.monotonic()
    while population.steps_done < steps:
        population.train(CHUNK)
        link.progress(population.steps_done / steps)
        now = time.monotonic()
        stop = link.stop_asked()
        if stop or now - saved >= checkpoint_seconds:
            _save(population, checkpoint)
            saved = time.monotonic()
            link.saved(seconds_before + saved - begin)
        if stop:
            raise Stopped
    return seconds_before + time.monotonic() - begin


def discard(checkpoint: Path) -> None:
    """Remove a checkpoint and what a process leaves that dies while it writes one."""
    for path in (checkpoint, partial(checkpoint)):
        path.unlink(missing_ok=True)


def work(agents: int, steps: int, hidden: tuple[int, ...]) -> float:
    """About how many seconds a population takes on one core; only the time left is computed from it."""
    weights = sum(a * b for a, b in pairwise(hidden))
    return steps * agents * (0.5e-3 + 5.5e-8 * weights)


def _save(population: Population, checkpoint: Path) -> None:
    """Write a checkpoint. What the system says of a full disk may stand behind another error of the writer."""
    try:
        population.save(checkpoint)
    except (OSError, RuntimeError) as error:
        partial(checkpoint).unlink(missing_ok=True)
        found: BaseException | None = error
        while found is not None and not isinstance(found, OSError):
            found = found.__context__
        reason = found.strerror if found else error
        raise OSError(f"the checkpoint {checkpoint} cannot be written ({reason})") from error
