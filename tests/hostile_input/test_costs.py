"""What would cost the machine more than it has is refused before anything is computed."""

import json

import pytest

from policies.__main__ import main as policies_main
from sysid.__main__ import main as sysid_main
from tests.hostile_input.answering import refused

COSTS = {
    "rollouts": ("experiment", "--rollouts", "1000000000"),
    "duration": ("experiment", "--duration", "1e6"),
    "duration beyond numbers": ("experiment", "--duration", "1e308"),
    "interval": ("fit", "--dt", "1e9"),
    "interval of nothing": ("fit", "--dt", "1e-300"),
}


@pytest.mark.parametrize("words", COSTS.values(), ids=COSTS.keys())
def test_what_would_cost_the_machine_is_refused(words, log, capsys):
    command, *options = words
    refused(sysid_main, [command, str(log / "log.csv"), "--model", str(log / "model.json"), *options], capsys)


@pytest.mark.parametrize(("name", "value"), [("dt", 1e-9), ("dt", 1e-5), ("substeps", 10**6), ("substeps", 10**9)])
def test_a_model_of_tiny_steps_is_refused(name, value, log, saved, tmp_path, capsys):
    for file, main, words in (
        (log / "model.json", sysid_main, ["fit", str(log / "log.csv"), "--model"]),
        (saved / "model.json", policies_main, ["train", "--out", str(tmp_path / "policy"), "--steps", "10"]),
        (saved / "model.json", policies_main, ["evaluate", str(saved / "policy"), "--model"]),
    ):
        model = json.loads(file.read_text())
        (model if name == "dt" else model["integrator"]["settings"])[name] = value
        (tmp_path / "model.json").write_text(json.dumps(model))
        refused(main, [*words, str(tmp_path / "model.json")], capsys)


TRAININGS = {
    "steps": ("--steps", "10000000000"),
    "layers": ("--hidden", "100000"),
    "a layer": ("--hidden", "1000000000"),
    "agents": ("--agents", "1000", "--hidden", "4096", "4096"),
    "seed": ("--seed", str(2**70)),
    "interval": ("--dt", "1e-9"),
}


@pytest.mark.parametrize("words", TRAININGS.values(), ids=TRAININGS.keys())
def test_a_training_that_would_cost_the_machine_is_refused(words, saved, tmp_path, capsys):
    out = tmp_path / "policy"
    refused(policies_main, ["train", str(saved / "model.json"), "-o", str(out), *words], capsys)
    assert not out.exists()


def test_episodes_that_would_cost_the_machine_are_refused(saved, capsys):
    refused(policies_main, ["evaluate", str(saved / "policy"), "--episodes", "1000000000"], capsys)
