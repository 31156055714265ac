"""A population on a disk that fails it: what it has is kept, and it says what is wrong."""

import dataclasses
import errno
import os

import pytest
import torch

from study.paper.presets import SMOKE
from study.paper.sweep import SweepPopulation
from study.pipeline.executor import Stopped

TINY = dataclasses.replace(SMOKE, steps=300, random_steps=100, batch=8, episodes=2)
(CELLS, _) = TINY.populations()


class Link:
    """A driver that asks to stop at the look number `patience`."""

    def __init__(self, patience=10**9):
        self.patience = patience

    def progress(self, done):
        pass

    def saved(self):
        pass

    def stop_asked(self):
        self.patience -= 1
        return self.patience < 0


def task(folder):
    return SweepPopulation(TINY, 0, CELLS, ((1.0, 1.0), (2.0, 1.4)), folder=folder)


def numbers(runs):
    return [dataclasses.replace(run, seconds=0.0) for run in runs]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    return numbers(task(tmp_path_factory.mktemp("undisturbed")).run(Link()))


@pytest.fixture
def stopped(tmp_path):
    """A task with a checkpoint in the midst of learning."""
    with pytest.raises(Stopped):
        task(tmp_path).run(Link(patience=8))
    return task(tmp_path)


def test_a_checkpoint_is_gone_on_from(stopped, undisturbed, capsys):
    assert numbers(stopped.run(Link())) == undisturbed
    assert capsys.readouterr().err == ""


DAMAGES = {
    "empty": lambda whole: b"",
    "cut": lambda whole: whole[: len(whole) // 2],
    "text": lambda whole: b"no checkpoint at all",
    "flipped bits": lambda whole: bytes(byte ^ (k % 997 == 0) for k, byte in enumerate(whole)),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_checkpoint_costs_its_minutes_and_not_the_study(stopped, undisturbed, damage, capsys):
    stopped.checkpoint.write_bytes(damage(stopped.checkpoint.read_bytes()))
    assert numbers(stopped.run(Link())) == undisturbed
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("population 1 begins anew: ")
    assert str(stopped.checkpoint) in said


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), RuntimeError("write failed")])
def test_a_full_disk_ends_with_a_sentence_and_keeps_the_last_checkpoint(stopped, undisturbed, error, monkeypatch):
    before = stopped.checkpoint.read_bytes()

    def full(content, file):
        file.write(b"the beginning of it")
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(torch, "save", full)
        with pytest.raises(OSError, match=r"population_1.checkpoint cannot be written \((No space left|write failed)"):
            dataclasses.replace(stopped, checkpoint_seconds=0.0).run(Link())
    assert [path.name for path in stopped.folder.iterdir()] == ["population_1.checkpoint"]
    assert stopped.checkpoint.read_bytes() == before
    assert numbers(stopped.run(Link())) == undisturbed
