"""An executor that stays in this process: what runners and drivers are tried with."""

from __future__ import annotations


class Inline:
    """Runs tasks one after the other in this process, and remembers them."""

    workers = 1

    def __init__(self):
        self.tasks = []

    def execute(self, tasks, heard):
        for task in tasks:
            self.tasks.append(task)
            heard(task, "done", task.run(self))

    def progress(self, done):
        assert 0.0 <= done <= 1.0

    def saved(self):
        """Nobody else has to know."""

    def stop_asked(self):
        return False
