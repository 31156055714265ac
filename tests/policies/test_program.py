"""Training a few agents and keeping one: the choice is by start states of its own."""

import errno
import os

import numpy as np
import pytest
import torch

from policies.environments.randomization import Fixed
from policies.evaluation import evaluate, fresh_start_states
from policies.training import program
from policies.training.program import CHOICE, POPULATIONS, settings_for, train
from policies.training.sac import SACPopulation, SACSettings
from study.paper.protocol import paper_model
from sysid import InvalidInput, Model, RodPendulum

SHORT = SACSettings(hidden=(16, 16), batch=32, random_steps=50, steps=430)


def test_the_best_by_its_own_start_states_is_kept_and_the_curve_is_heard():
    model, heard = paper_model(0.3, 0.6), []
    training = train(model, Fixed(), SHORT, [0, 1, 2], 1, lambda *said: heard.append(said))
    population = SACPopulation(model, [Fixed()] * 3, [0, 1, 2], SHORT, history=1)
    population.train(430)
    starts = fresh_start_states(0, CHOICE, block=1)
    returns = [evaluate(policy, model, *starts).mean for policy in population.policies()]
    assert training.chosen == tuple(returns)
    assert training.best == int(np.argmax(returns))
    np.testing.assert_array_equal(training.policy.layers[0][0], population.policies()[training.best].layers[0][0])
    assert [steps for steps, returns, *_ in heard if returns] == list(range(43, 431, 43))
    (first,) = (said for said in heard if not said[1])
    assert first[0] == 150 and first[2] + first[3] > 0.0 and heard[-1][3] == 0.0
    assert [[step for step, _ in curve] for curve in training.curves] == [[200, 400]] * 3
    means = [said[1] for said in heard if said[1] and np.isfinite(said[1][0])]
    np.testing.assert_allclose(np.transpose(means), [[value for _, value in curve] for curve in training.curves])
    assert not set(starts[0]) & set(fresh_start_states(0, 200)[0])


def test_the_discount_is_the_same_per_second():
    for algorithm in POPULATIONS:
        at = {
            dt: settings_for(Model(RodPendulum(), dt=dt, u_max=1.0), algorithm=algorithm) for dt in (0.05, 0.025, 0.1)
        }
        assert at[0.05].gamma == 0.99
        assert at[0.025].gamma ** 2 == pytest.approx(0.99) and at[0.1].gamma == pytest.approx(0.99**2)
    assert settings_for(paper_model(), algorithm="sac").random_steps == 1000
    assert settings_for(paper_model(), steps=30, algorithm="sac").random_steps == 3


def test_a_window_of_shac_is_as_long_in_seconds():
    at = {dt: settings_for(Model(RodPendulum(), dt=dt, u_max=1.0)) for dt in (0.05, 0.04, 0.1, 0.002)}
    assert {dt: settings.horizon for dt, settings in at.items()} == {0.05: 16, 0.04: 20, 0.1: 8, 0.002: 32}
    assert at[0.1].decay == pytest.approx(at[0.05].decay ** 2)
    assert at[0.1].steps == 2000 * 64 * 8


def test_a_training_that_is_stopped_goes_on_with_the_same_numbers(tmp_path, monkeypatch):
    """Wherever it is stopped; the checkpoint is gone when it is done."""
    model, file = paper_model(0.3, 0.6), tmp_path / "new" / "training.checkpoint"
    whole = train(model, Fixed(), SHORT, [0, 1])

    def stops(population, steps):
        go_on(population, steps)
        if population.steps_done >= 240:
            raise KeyboardInterrupt

    go_on = SACPopulation.train
    monkeypatch.setattr(SACPopulation, "train", stops)
    with pytest.raises(KeyboardInterrupt):
        train(model, Fixed(), SHORT, [0, 1], checkpoint=file)
    monkeypatch.setattr(SACPopulation, "train", go_on)
    resumed = train(model, Fixed(), SHORT, [0, 1], checkpoint=file)
    assert resumed.chosen == whole.chosen and resumed.curves == whole.curves
    for ours, theirs in zip(resumed.policy.layers, whole.policy.layers, strict=True):
        assert all(map(np.array_equal, ours, theirs))
    assert not file.exists()


def test_a_full_disk_ends_a_training_with_a_sentence(tmp_path, monkeypatch):
    def full(content, file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(torch, "save", full)
    monkeypatch.setattr(program, "CHECKPOINT_SECONDS", 0.0)
    with pytest.raises(InvalidInput, match=r"training.checkpoint cannot be written \(No space left"):
        train(paper_model(0.3, 0.6), Fixed(), SHORT, [0, 1], checkpoint=tmp_path / "new" / "training.checkpoint")
