"""A task that counts, saves now and then, and dies where it is told: what executors are tried on."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

from study.pipeline.executor import Stopped


@dataclass(frozen=True)
class Counting:
    """Counts from its checkpoint to `end` and saves `every` so many counts.

    Its k-th attempt is killed at the count deaths[k], before that is saved. `name`.begun holds a line an attempt: where
    it began. Returns the attempts.
    """

    name: str
    folder: Path
    end: int = 4
    every: int = 1
    deaths: tuple[int, ...] = ()
    raises_at: int = -1
    pause: float = 0.0
    gpus: int = 0
    work: float = 1.0
    saves: ClassVar[bool] = True

    @property
    def checkpoint(self):
        return self.folder / f"{self.name}.checkpoint"

    def attempts(self):
        return [int(line) for line in (self.folder / f"{self.name}.begun").read_text().split()]

    def run(self, link):
        start = int(self.checkpoint.read_text()) if self.checkpoint.exists() else 0
        with (self.folder / f"{self.name}.begun").open("a") as file:
            file.write(f"{start}\n")
        attempt = len(self.attempts()) - 1
        for count in range(start, self.end):
            if attempt < len(self.deaths) and count == self.deaths[attempt]:
                self.die(link)
            if count == self.raises_at:
                raise ValueError("cannot count on")
            time.sleep(self.pause)
            link.progress((count + 1) / self.end)
            stop = link.stop_asked()
            if stop or (count + 1) % self.every == 0:
                self.save(count + 1, link)
            if stop:
                raise Stopped
        return self.attempts()

    def save(self, count, link):
        partial = self.checkpoint.with_suffix(".partial")
        partial.write_text(str(count))
        partial.replace(self.checkpoint)
        link.saved()

    def die(self, link):
        os.kill(os.getpid(), signal.SIGKILL)


class MidSentence(Counting):
    """Is killed in the middle of a message: of a thousand bytes four arrive."""

    def die(self, link):
        os.write(link.connection.fileno(), (1000).to_bytes(4, "big") + b"half")
        super().die(link)


@dataclass(frozen=True)
class Forgetful(Counting):
    """Has no checkpoint."""

    saves: ClassVar[bool] = False

    def save(self, count, link):
        """Nothing."""


def run(executor, *tasks):
    """What was heard, in order, as (name, kind, payload)."""
    said = []
    executor.execute(tasks, lambda task, kind, payload: said.append((task.name, kind, payload)))
    return said


def done(said):
    """What each task returned."""
    return {name: payload for name, kind, payload in said if kind == "done"}


def saved_at_an_interrupt(executor, tasks):
    """The tasks that an executor hears have saved when it is interrupted once all of them have begun."""
    begun, saved = set(), set()

    def heard(task, kind, payload):
        begun.add(task.name)
        if kind == "saved":
            saved.add(task.name)
        elif len(begun) == len(tasks):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        executor.execute(tasks, heard)
    return saved
