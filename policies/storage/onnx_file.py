"""A policy as ONNX, for a controller that knows nothing of Python: observation (batch, O) -> u (batch, 1) [N m].

    u = u_max tanh(W_n relu(... relu(x W_0 + b_0) ...) + b_n)

What the observation is, u_max and the time between two commands stand in the file's metadata. Needs the extra [onnx].
"""

from __future__ import annotations

import json
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from policies.environments import task
from policies.network_policy import NetworkPolicy
from sysid import InvalidInput
from sysid.data.files import check_installed, save_file

if TYPE_CHECKING:
    from onnx import ModelProto

ONNX_TOLERANCE = 1e-5
"""Largest difference from the original that still counts as the same policy, relative to u_max."""
OPSET = 13


def write_onnx(policy: NetworkPolicy, dt: float, path: str | PathLike[str]) -> float:
    """Write a policy that gives a command every dt [s]; returns the largest difference found, relative to u_max.

    The graph is run by ONNX's reference evaluator on observations of all sizes before it is written. Raises
    InvalidInput where it differs from the original by more than 1e-5, where the file cannot be written, and without the
    package onnx.
    """
    check_installed("onnx", "onnx", "writing ONNX")
    model = onnx_model(policy, dt)
    difference = largest_difference(policy, model)
    if not difference <= ONNX_TOLERANCE:
        raise InvalidInput(f"the ONNX graph differs from the policy by {difference:.2g} u_max: nothing was written")
    save_file(path, model.SerializeToString())
    return difference


def onnx_model(policy: NetworkPolicy, dt: float) -> ModelProto:
    """The policy as an ONNX model, checked to be a valid one."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    constants, nodes, x = [], [], "observation"
    for i, (w, b) in enumerate(policy.layers):
        constants += [numpy_helper.from_array(w, f"w{i}"), numpy_helper.from_array(b, f"b{i}")]
        nodes.append(helper.make_node("MatMul", [x, f"w{i}"], [f"product{i}"]))
        nodes.append(helper.make_node("Add", [f"product{i}", f"b{i}"], [f"sum{i}"]))
        x = f"relu{i}"
        if i < len(policy.layers) - 1:
            nodes.append(helper.make_node("Relu", [f"sum{i}"], [x]))
    constants.append(numpy_helper.from_array(np.array(policy.u_max, dtype=np.float32), "u_max"))
    nodes.append(helper.make_node("Tanh", [f"sum{len(policy.layers) - 1}"], ["share"]))
    nodes.append(helper.make_node("Mul", ["share", "u_max"], ["u"]))
    names = task.observation_names(policy.history)
    body = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", len(names)])],
        [helper.make_tensor_value_info("u", TensorProto.FLOAT, ["batch", 1])],
        constants,
    )
    model = helper.make_model(body, producer_name="gapfinder", opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = 8  # the newest that runtimes of the last years read
    about = {"observation": json.dumps(names), "u_max": repr(policy.u_max), "dt": repr(dt), "unit of u": "N m"}
    helper.set_model_props(model, about)
    onnx.checker.check_model(model)
    return model


def largest_difference(policy: NetworkPolicy, model: ModelProto) -> float:
    """max |u_onnx - u| / u_max over 1000 observations, speeds up to 100 rad/s."""
    from onnx.reference import ReferenceEvaluator

    rng = np.random.default_rng(0)
    theta = rng.uniform(-np.pi, np.pi, 1000)
    speed = rng.uniform(-1.0, 1.0, 1000) * 10.0 ** rng.uniform(-1.0, 2.0, 1000)
    past = rng.uniform(-1.0, 1.0, (1000, policy.history))
    x = np.column_stack((np.cos(theta), np.sin(theta), speed, past)).astype(np.float32)
    answered = ReferenceEvaluator(model).run(None, {"observation": x})[0]
    return float(np.max(np.abs(answered[:, 0] - policy.command(x)))) / policy.u_max
