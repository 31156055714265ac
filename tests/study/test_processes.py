"""Worker processes: one that dies costs what it did since its checkpoint, and nobody else anything."""

import multiprocessing
import os
import signal
import time

import pytest

from study.pipeline.executor import DEATHS, SECOND, BriefTask, Processes, WorkerFailed
from tests.study.counting import Counting, Forgetful, MidSentence, done, run, saved_at_an_interrupt

SAVES_WHEN_ASKED = {"end": 10_000, "every": 10_000, "pause": 0.001}


@pytest.fixture(autouse=True)
def no_process_is_left():
    yield
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("workers", [1, 3])
def test_every_task_is_done_once_whatever_the_number_of_workers(tmp_path, workers):
    tasks = [Counting(f"task {k}", tmp_path) for k in range(5)]
    said = run(Processes(workers), *tasks)
    assert sorted(name for name, kind, _ in said if kind == "done") == [task.name for task in tasks]
    for task in tasks:
        assert task.attempts() == [0]
        assert [event[:2] for event in said].count((task.name, "saved")) == 4


def test_progress_is_told_once_a_second_at_most(tmp_path):
    said = run(Processes(1), Counting("fast", tmp_path, end=100), Counting("slow", tmp_path, end=3, pause=SECOND))
    assert [payload for name, kind, payload in said if (name, kind) == ("fast", "progress")] == [0.01]
    assert [payload for name, kind, payload in said if (name, kind) == ("slow", "progress")] == [1 / 3, 2 / 3, 1.0]


def where(seconds, progress):
    """The process that it runs in."""
    time.sleep(seconds)
    return os.getpid()


def test_a_process_goes_on_after_a_brief_task_and_ends_after_another(tmp_path):
    brief = [BriefTask(f"brief {k}", "waiting", 1.0, None, where, (0.3,)) for k in range(6)]
    said = run(Processes(2), *brief, Counting("long", tmp_path))
    pids = [payload for name, kind, payload in said if kind == "done" and name.startswith("brief")]
    assert len(pids) == 6 and len(set(pids)) == 2 and os.getpid() not in pids


def test_a_brief_task_whose_process_is_killed_is_done_by_another(tmp_path):
    marks = [tmp_path / f"mark {k}" for k in range(3)]
    brief = [BriefTask(f"brief {k}", "dying", 1.0, None, dies_once, (mark,)) for k, mark in enumerate(marks)]
    said = run(Processes(1), *brief)
    assert [(name, kind) for name, kind, _ in said] == [
        (task.name, kind) for task in brief for kind in ("died", "done")
    ]


def dies_once(mark, progress):
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("kind", [Counting, MidSentence])
def test_a_worker_that_dies_goes_on_from_its_checkpoint_by_itself(tmp_path, kind):
    said = run(Processes(2), kind("mortal", tmp_path, deaths=(0, 2, 2, 3)), Counting("other", tmp_path))
    why = [payload for _, kind, payload in said if kind == "died"]
    assert why == ["its process was ended by signal SIGKILL (out of memory?)"] * 4
    assert done(said) == {"mortal": [0, 0, 2, 2, 3], "other": [0]}


def test_a_task_that_gets_nowhere_ends_the_study_after_the_others_saved(tmp_path):
    slow = Counting("slow", tmp_path, **SAVES_WHEN_ASKED)
    message = r"^mortal failed: its worker died 3 times without a new checkpoint; .* SIGKILL .*$"
    with pytest.raises(WorkerFailed, match=message):
        run(Processes(2), slow, Counting("mortal", tmp_path, deaths=(1,) * 9))
    assert Counting("mortal", tmp_path).attempts() == [0, 1, 1]
    assert 0 < int(slow.checkpoint.read_text()) < slow.end


def test_what_has_no_checkpoint_is_tried_as_often(tmp_path):
    assert done(run(Processes(1), Forgetful("once", tmp_path, deaths=(3, 3)))) == {"once": [0, 0, 0]}
    with pytest.raises(WorkerFailed, match=r"never failed: its worker died 3 times; .*SIGKILL"):
        run(Processes(1), Forgetful("never", tmp_path, deaths=(3,) * DEATHS))


def test_an_error_ends_the_study_after_the_others_saved(tmp_path):
    slow = Counting("slow", tmp_path, **SAVES_WHEN_ASKED)
    with pytest.raises(WorkerFailed, match=r"^wrong failed: ValueError: cannot count on \(counting.py, line \d+\)$"):
        run(Processes(2), slow, Counting("wrong", tmp_path, raises_at=2))
    assert Counting("wrong", tmp_path).attempts() == [0]
    assert 0 < int(slow.checkpoint.read_text()) < slow.end


def test_an_interrupted_driver_hears_what_its_workers_saved(tmp_path):
    tasks = [Counting(f"task {k}", tmp_path, **SAVES_WHEN_ASKED) for k in range(2)]
    assert saved_at_an_interrupt(Processes(2), tasks) == {task.name for task in tasks}
    assert all(0 < int(task.checkpoint.read_text()) < task.end for task in tasks)
