"""Progress of a study: a bar with the time left on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

if TYPE_CHECKING:
    from study.pipeline.executor import Task

DRAW_SECONDS = 0.2
"""Least time between two looks at all tasks, of which there may be thousands."""

PLAIN_SECONDS = 30.0
"""Least time between two plain lines."""


def duration(seconds: float) -> str:
    """As a person would say it: "40 s", "6 min", "3 h 20 min"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


class Meter:
    """Shows how much of the expected work is done; a context manager.

    time left = work left / (work done here / time passed)
    """

    def __init__(self, console: Console, tasks: Sequence[Task]) -> None:
        self.console, self.tasks = console, {task.name: task for task in tasks}
        self.total = max(sum(task.work for task in tasks), 1e-9)
        self.share = dict.fromkeys(self.tasks, 0.0)
        self.first: dict[str, float] = {}
        self.begin = self.said = time.monotonic()
        self.drawn = -math.inf
        about, percent = TextColumn("{task.description}"), TextColumn("{task.percentage:>3.0f} %")
        columns = about, BarColumn(bar_width=32), percent, TextColumn("[dim]{task.fields[left]}")
        self.bar = Progress(*columns, console=console, disable=not console.is_terminal)
        self.row = self.bar.add_task("starting", total=self.total, left="")

    def __enter__(self) -> Meter:
        self.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._draw()
        self.bar.stop()

    def update(self, task: str, share: float) -> None:
        """`share` (0 to 1) of a task is done. Where a resumed task starts is not counted as speed."""
        if not self.first:
            self.begin = time.monotonic()
        self.first.setdefault(task, share if share < 1.0 else 0.0)
        self.share[task] = share
        if time.monotonic() - self.drawn >= DRAW_SECONDS:
            self.drawn = time.monotonic()
            self._draw()

    def _draw(self) -> None:
        """A look at the bar, or a plain line; what goes on is what the first task does that is not done."""
        ahead = [task for name, task in self.tasks.items() if self.share[name] < 1.0] or list(self.tasks.values())
        label, now = ahead[0].activity, time.monotonic()
        self.bar.update(self.row, description=label, completed=self.done, left=self.left())
        if not self.console.is_terminal and now - self.said >= PLAIN_SECONDS:
            self.said, percent = now, 100.0 * self.done / self.total
            line = f"{time.strftime('%H:%M:%S')}  {label}: {percent:.0f} % done, {self.left()}"
            self.console.print(line, highlight=False)

    @property
    def done(self) -> float:
        """Work that is done [s]."""
        return sum(task.work * self.share[name] for name, task in self.tasks.items())

    def left(self) -> str:
        """The time left in words; empty until it can be told."""
        passed = time.monotonic() - self.begin
        here = sum(self.tasks[name].work * (self.share[name] - first) for name, first in self.first.items())
        if passed < 5.0 or here <= 0.0:
            return ""
        return f"about {duration((self.total - self.done) * passed / here)} left"
