"""Progress of a study: a bar with the time left on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from types import TracebackType
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
        self.console = console
        self.work = {task.name: task.work for task in tasks}
        self.activity = {task.name: task.activity for task in tasks}
        self.share = dict.fromkeys(self.work, 0.0)
        self.begin = self.said = time.monotonic()
        self.drawn = -math.inf
        self.first: dict[str, float] = {}
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=32),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("[dim]{task.fields[left]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self.row = self.bar.add_task("starting", total=max(sum(self.work.values()), 1e-9), left="")

    def __enter__(self) -> Meter:
        self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._draw()
        self.bar.stop()

    def update(self, task: str, share: float) -> None:
        """`share` (0 to 1) of a task is done. Where a resumed task starts is not counted as speed."""
        if not self.first:
            self.begin = time.monotonic()
        self.first.setdefault(task, share if share < 1.0 else 0.0)
        self.share[task] = share
        now = time.monotonic()
        if now - self.drawn >= DRAW_SECONDS:
            self.drawn = now
            self._draw()

    def _draw(self) -> None:
        label = self._label()
        self.bar.update(self.row, description=label, completed=self.done, left=self.left())
        self._say_plainly(label)

    def _label(self) -> str:
        """What is going on: what the first task that is not done does."""
        ahead = [name for name, share in self.share.items() if share < 1.0]
        return self.activity[(ahead or list(self.work))[0]]

    @property
    def done(self) -> float:
        return sum(self.work[name] * share for name, share in self.share.items())

    def left(self) -> str:
        """The time left in words; empty until it can be told."""
        passed = time.monotonic() - self.begin
        here = sum(self.work[name] * (self.share[name] - first) for name, first in self.first.items())
        if passed < 5.0 or here <= 0.0:
            return ""
        return f"about {duration((sum(self.work.values()) - self.done) * passed / here)} left"

    def _say_plainly(self, label: str) -> None:
        now = time.monotonic()
        if self.console.is_terminal or now - self.said < PLAIN_SECONDS:
            return
        self.said = now
        percent = 100.0 * self.done / max(sum(self.work.values()), 1e-9)
        self.console.print(
            f"{time.strftime('%H:%M:%S')}  {label}: {percent:.0f} % done, {self.left()}", highlight=False
        )
