"""A policy as ONNX commands what the policy commands."""

import json

import numpy as np
import pytest

from sysid import InvalidInput
from tests.policies.random_policy import random_policy

onnx = pytest.importorskip("onnx", reason="the extra [onnx] is not installed")

from policies.storage import onnx_file  # noqa: E402


@pytest.mark.parametrize(("history", "hidden", "scale"), [(0, (16, 12), 1.0), (3, (64, 64), 0.1), (1, (5,), 3.0)])
def test_the_file_commands_what_the_policy_commands(tmp_path, history, hidden, scale):
    ours = random_policy(history, hidden, scale=scale)
    path = tmp_path / "policy.onnx"
    assert onnx_file.write_onnx(ours, 0.05, path) <= 1e-5
    x = np.random.default_rng(1).normal(size=(50, 3 + history)).astype(np.float32)
    model = onnx.load(path)
    (u,) = onnx.reference.ReferenceEvaluator(model).run(None, {"observation": x})
    assert u.shape == (50, 1)
    np.testing.assert_allclose(u[:, 0], ours.command(x), atol=1.7e-5)


def test_a_runtime_agrees(tmp_path):
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    ours, path = random_policy(), tmp_path / "policy.onnx"
    onnx_file.write_onnx(ours, 0.05, path)
    x = np.random.default_rng(1).normal(size=(50, 5)).astype(np.float32)
    (u,) = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(None, {"observation": x})
    np.testing.assert_allclose(u[:, 0], ours.command(x), atol=1.7e-5)


def test_what_a_controller_must_know_stands_in_the_file(tmp_path):
    onnx_file.write_onnx(random_policy(), 0.04, tmp_path / "policy.onnx")
    about = {entry.key: entry.value for entry in onnx.load(tmp_path / "policy.onnx").metadata_props}
    assert json.loads(about["observation"])[3:] == ["u[-1] / u_max", "u[-2] / u_max"]
    assert (float(about["dt"]), float(about["u_max"])) == (0.04, 1.7)


def test_a_graph_that_differs_is_not_written(tmp_path, monkeypatch):
    wrong = onnx_file.onnx_model(random_policy(scale=1.001), 0.05)
    monkeypatch.setattr(onnx_file, "onnx_model", lambda *_: wrong)
    with pytest.raises(InvalidInput, match=r"differs from the policy by .* nothing was written"):
        onnx_file.write_onnx(random_policy(), 0.05, tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_written_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="cannot write"):
        onnx_file.write_onnx(random_policy(), 0.05, tmp_path / "nowhere" / "policy.onnx")
