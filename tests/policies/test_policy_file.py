"""Policies on disk: the same commands come out, nothing in a file is executed, and what is not one is refused."""

import hashlib
import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load, save

from policies.evaluation import evaluate, fresh_start_states
from policies.storage.policy_file import DESCRIPTION, SCHEMA, WEIGHTS, load_policy, save_policy
from sysid import Coulomb, Delay, InvalidInput, Model, RodPendulum
from tests.policies.random_policy import random_policy

MODEL = Model(RodPendulum(2.0, 1.5), (Delay(T=0.12), Coulomb(0.2)), dt=0.04, u_max=1.7)


@pytest.fixture
def folder(tmp_path):
    save_policy(random_policy(), MODEL, tmp_path / "policy", {"seeds": [0]})
    return tmp_path / "policy"


@pytest.mark.parametrize("history", [0, 2])
def test_a_policy_commands_the_same_after_reading(tmp_path, history):
    before = random_policy(history)
    save_policy(before, MODEL, tmp_path / "policy", {"seeds": [3]})
    saved = load_policy(tmp_path / "policy")
    assert (saved.policy.u_max, saved.policy.history, saved.about["seeds"]) == (1.7, history, [3])
    start = fresh_start_states(0, 5)
    ours, theirs = evaluate(before, MODEL, *start).returns, evaluate(saved.policy, saved.model, *start).returns
    assert np.array_equal(ours, theirs)
    assert {path.name for path in (tmp_path / "policy").iterdir()} == {DESCRIPTION, WEIGHTS}
    assert "numpy" in saved.about["versions"]


def test_a_policy_is_read_and_judged_without_torch(folder):
    code = (
        "import sys; from policies.storage.policy_file import load_policy; from policies.evaluation import *;"
        "s = load_policy(sys.argv[1]); evaluate(s.policy, s.model, *fresh_start_states(0, 2));"
        "print('torch' in sys.modules)"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code, folder], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def changed(folder, **entries):
    """Other entries in policy.json."""
    data = json.loads((folder / DESCRIPTION).read_text()) | entries
    (folder / DESCRIPTION).write_text(json.dumps(data))


def reweighed(folder, content):
    """Other weights, with the hash that belongs to them."""
    (folder / WEIGHTS).write_bytes(content)
    changed(folder, weights={"file": WEIGHTS, "sha256": hashlib.sha256(content).hexdigest()})


def arrays(folder, **others):
    return load((folder / WEIGHTS).read_bytes()) | others


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"schema": "gapfinder/policy/9"}, f'"schema": \'gapfinder/policy/9\': this version reads "{SCHEMA}"'),
        (
            {"observation": ["theta", "theta_dot"]},
            "trained for another observation .+'theta_dot'.+: this version gives",
        ),
        ({"history": 1}, "another observation"),
        ({"history": -1}, "expected a whole number"),
        ({"history": None}, "expected a number"),
        ({"dt": 0.05}, r"its model has dt = 0\.04, u_max = 1\.7, the policy 0\.05 and 1\.7"),
        ({"dt": float("nan")}, "expected a number"),
        ({"u_max": 0.0}, "expected positive numbers"),
        ({"u_max": "two"}, "'u_max' is 'two': expected a number"),
        ({"model": {"schema": "gapfinder/model/9"}}, "its schema is"),
        ({"model": 3}, "'model' is 3: expected an object"),
        ({"about": None}, "'about' is None: expected an object"),
        ({"weights": {}}, "it has no 'sha256'"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(folder, entries, message):
    changed(folder, **entries)
    with pytest.raises(InvalidInput, match=message):
        load_policy(folder)


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"w0": np.zeros((3, 8), np.float32)}, r"layer 0 has shapes \(3, 8\)"),
        ({"b1": np.zeros(7, np.float32)}, "layer 1 has shapes"),
        ({"w2": np.zeros((6, 2), np.float32), "b2": np.zeros(2, np.float32)}, "layer 2 has shapes"),
        ({"b0": np.zeros(8)}, "layer 0 holds other numbers than finite float32"),
        ({"b0": np.full(8, np.nan, np.float32)}, "finite float32"),
        ({"extra": np.zeros(1, np.float32)}, "expected w0, b0, w1"),
    ],
)
def test_weights_that_do_not_fit_are_refused(folder, others, message):
    reweighed(folder, save(arrays(folder, **others)))
    with pytest.raises(InvalidInput, match=message):
        load_policy(folder)


def test_weights_of_another_policy_are_noticed(folder, tmp_path):
    save_policy(random_policy(seed=1), MODEL, tmp_path / "other", {})
    (folder / WEIGHTS).write_bytes((tmp_path / "other" / WEIGHTS).read_bytes())
    with pytest.raises(InvalidInput, match=r"policy\.safetensors is not the file that policy\.json was written with"):
        load_policy(folder)


def test_a_file_that_would_run_code_is_refused(folder, tmp_path):
    class Trap:
        def __reduce__(self):
            return (tmp_path.joinpath("sprung").touch, ())

    reweighed(folder, pickle.dumps(Trap()))
    with pytest.raises(InvalidInput, match="no safetensors file"):
        load_policy(folder)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("content", ["", "[1, 2]", "{", "[" * 100_000, '{"schema": 3}'])
def test_what_is_no_description_is_refused(folder, content):
    (folder / DESCRIPTION).write_text(content)
    with pytest.raises(InvalidInput, match=r"policy\.json (is not JSON|has \"schema\")"):
        load_policy(folder)


def test_what_is_not_there_and_what_cannot_be_written_are_named(folder, tmp_path):
    with pytest.raises(InvalidInput, match=r"no such file: .+policy\.json: expected the folder that a training wrote"):
        load_policy(tmp_path / "nowhere")
    (folder / WEIGHTS).unlink()
    with pytest.raises(InvalidInput, match=r"no such file: .+policy\.safetensors"):
        load_policy(folder)
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInput, match="cannot write"):
        save_policy(random_policy(), MODEL, tmp_path / "file", {})
