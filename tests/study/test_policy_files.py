"""Files of policies: the same commands come out, and nothing in a file is executed."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from study.paper.presets import Cell
from study.paper.protocol import paper_model
from study.pipeline.population_task import policy_file, read_policy, write_policy
from sysid import InvalidInput
from tests.policies.random_policy import random_policy

CELLS = (Cell("main", 0, 0.0, 0), Cell("large_gap", 50, 0.1, 7))


@pytest.mark.parametrize(("names", "history"), [(CELLS, 0), (("4f2a", "77b0"), 2)])
def test_policies_command_the_same_after_reading(tmp_path, names, history):
    policies = [random_policy(history, seed=seed) for seed in (0, 1)]
    for name, policy in zip(names, policies, strict=True):
        write_policy(tmp_path, name, policy)
    read_back = [read_policy(tmp_path, name) for name in names]
    state = paper_model().initial_state(np.linspace(-3.0, 3.0, 9), np.linspace(-8.0, 8.0, 9))
    past = np.random.default_rng(2).uniform(-2.0, 2.0, (9, history))
    for before, after in zip(policies, read_back, strict=True):
        assert after.history == history
        assert np.array_equal(before(state, 0.0, past), after(state, 0.0, past))
    assert not np.array_equal(*(network(state, 0.0, past) for network in policies))


def test_a_file_that_would_run_code_or_is_none_is_refused(tmp_path):
    class Trap:
        def __reduce__(self):
            return (tmp_path.joinpath("sprung").touch, ())

    (tmp_path / "policies").mkdir()
    np.savez(policy_file(tmp_path, "pickled"), w0=np.array([Trap()], dtype=object), b0=np.ones(1), u_max=1, history=0)
    policy_file(tmp_path, "bare").write_bytes(pickle.dumps(SimpleNamespace()))
    policy_file(tmp_path, "cut").write_bytes(policy_file(tmp_path, "pickled").read_bytes()[:100])
    for name in ("pickled", "bare", "cut"):
        with pytest.raises(InvalidInput, match="not the file of a policy"):
            read_policy(tmp_path, name)
    assert read_policy(tmp_path, "missing") is None
    assert not (tmp_path / "sprung").exists()
