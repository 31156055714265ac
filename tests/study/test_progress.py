"""The time left: right at an even pace, also for a study that goes on from a checkpoint."""

import io

import pytest
from rich.console import Console

from study import progress


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
    with progress.Meter(Console(file=out, width=100), {"population 1 of 1": 300.0, "optimal": 100.0}) as meter:
        clock[0] = 20.0  # starting up does not count
        meter.update("population 1 of 1", start)
        clock[0] += 60.0
        meter.update("population 1 of 1", start + 0.2)  # 60 units of work in 60 s
        left = 400.0 - 300.0 * (start + 0.2)
        assert meter.left() == f"about {progress.duration(left)} left"
    assert out.getvalue().endswith(f"% done, about {progress.duration(left)} left\n")


def test_a_finished_task_counts_whole():
    with progress.Meter(Console(file=io.StringIO()), {"a": 30.0, "b": 10.0}) as meter:
        meter.update("a", 1.0)
        assert meter.done == 30.0


@pytest.mark.parametrize(
    ("names", "label"),
    [
        (["identification at main, seed 0"], "identification"),
        (["population 1 of 1", "optimal"], "training"),
        (["optimal", "lqr"], "references"),
    ],
)
def test_a_plain_line_says_what_is_going_on(monkeypatch, names, label):
    monkeypatch.setattr(progress, "PLAIN_SECONDS", 0.0)
    out = io.StringIO()
    with progress.Meter(Console(file=out, width=100), dict.fromkeys(names, 1.0)) as meter:
        meter.update(names[0], 0.5)
    assert f"  {label}: " in out.getvalue()
