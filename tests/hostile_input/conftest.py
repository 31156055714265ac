"""A short log, and a model and a policy as files."""

import math

import numpy as np
import pytest

import sysid
from policies.network_policy import NetworkPolicy
from policies.storage.policy_file import save_policy
from tests.hostile_input.answering import MODEL


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A model.json as data, and the folder of a policy."""
    path = tmp_path_factory.mktemp("saved")
    sysid.save(MODEL, path / "model.json")
    layers = (
        (np.ones((3, 4), np.float32), np.ones(4, np.float32)),
        (np.ones((4, 1), np.float32), np.ones(1, np.float32)),
    )
    save_policy(NetworkPolicy(layers, 2.0, 0), MODEL, path / "policy", {})
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A short log with noise, of a model that has its rate."""
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("log")
    u = np.repeat(rng.uniform(-2.0, 2.0, 20), 10)
    model = sysid.Model(sysid.RodPendulum(g=9.81), dt=0.02)
    truth = sysid.simulate(model, u, math.pi, 0.0)
    sysid.write_csv(sysid.Sensor(theta=0.003, theta_dot=0.05).measure(truth, rng)[0], path / "log.csv")
    sysid.save(sysid.fit(model, sysid.read(path / "log.csv"), sysid.Sensor(0.003, 0.05)), path / "model.json")
    return path
