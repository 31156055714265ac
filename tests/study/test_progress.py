"""The time left: right at an even pace, also for a study that goes on from a checkpoint."""

import io
from dataclasses import dataclass

import pytest
from rich.console import Console

from study.pipeline import stages as progress


@dataclass(frozen=True)
class Work:
    name: str
    work: float
    activity: str = "training"


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.0, "0 s"), (99.0, "99 s"), (360.0, "6 min"), (12_000.0, "3 h 20 min")]
)
def test_durations_read_as_people_say_them(seconds, words):
    assert progress.duration(seconds) == words


@pytest.mark.parametrize("start", [0.0, 0.5])
def test_time_left_is_right_at_an_even_pace(monkeypatch, start):
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    out = io.StringIO()
    with progress.Meter(
        Console(file=out, width=100), [Work("population 1 of 1", 300.0), Work("optimal", 100.0)]
    ) as meter:
        clock[0] = 20.0  # starting up does not count
        meter.update("population 1 of 1", start)
        clock[0] += 60.0
        meter.update("population 1 of 1", start + 0.2)  # 60 units of work in 60 s
        left = 400.0 - 300.0 * (start + 0.2)
        assert meter.left() == f"about {progress.duration(left)} left"
    assert out.getvalue().endswith(f"% done, about {progress.duration(left)} left\n")


def test_a_finished_task_counts_whole():
    with progress.Meter(Console(file=io.StringIO()), [Work("a", 30.0), Work("b", 10.0)]) as meter:
        meter.update("a", 1.0)
        assert meter.done == 30.0


@pytest.mark.parametrize(("share", "label"), [(0.5, "training"), (1.0, "references")])
def test_a_plain_line_says_what_is_going_on(monkeypatch, share, label):
    monkeypatch.setattr(progress, "PLAIN_SECONDS", 0.0)
    out = io.StringIO()
    tasks = [Work("population 1 of 1", 1.0), Work("optimal", 1.0, "references")]
    with progress.Meter(Console(file=out, width=100), tasks) as meter:
        meter.update("population 1 of 1", share)
    assert f"  {label}: " in out.getvalue()
