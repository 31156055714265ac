"""A trained policy on disk: weights as safetensors, everything else as JSON; loading executes nothing.

    save_policy(policy, machine, "policy", about={...})      # policy/policy.json, policy/policy.safetensors
    saved = load_policy("policy")
    evaluate(saved.policy, saved.model, *fresh_start_states(0, 200))

policy.json:

    {"schema": "gapfinder/policy/1",
     "observation": ["cos theta", "sin theta", "theta_dot [rad/s]", "u[-1] / u_max"], "history": 1,
     "dt": 0.05, "u_max": 2.0,
     "weights": {"file": "policy.safetensors", "sha256": "..."},
     "model": {the model that it was trained on, as model.json has it},
     "about": {settings, randomization, seeds, learning curve, expected return, versions}}

policy.safetensors holds the actor, float32: w0 (in, out), b0 (out), w1, ...; u = u_max tanh(loc), loc the output of
linear layers with ReLU between them. The policies of a population could stand in the same arrays with a leading axis.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from policies.environments import task
from policies.environments.machine import check_episode
from policies.limits import LAYER_WIDTH, LAYERS
from policies.network_policy import NetworkPolicy
from sysid import InvalidInput, Model
from sysid.data.files import file_errors, read_file, save_file
from sysid.data.json_file import count, mapping, number_in, read_json, sequence, text
from sysid.errors import excerpt
from sysid.estimation.saved_model import from_dict, to_dict
from sysid.limits import check_size
from sysid.version import installed_versions

SCHEMA = "gapfinder/policy/1"
DESCRIPTION, WEIGHTS = "policy.json", "policy.safetensors"
LONGEST_HISTORY = 100
"""Past commands that a policy may observe."""
LARGEST_WEIGHTS = 1 << 30
"""Bytes of the weights' file."""


@dataclass(frozen=True, eq=False)
class SavedPolicy:
    """What a policy's folder holds.

    Attributes
    ----------
    policy : NetworkPolicy
        The policy.
    model : Model
        The machine that it was trained on.
    about : dict
        How it came about.
    """

    policy: NetworkPolicy
    model: Model
    about: dict[str, Any]


def save_policy(policy: NetworkPolicy, model: Model, folder: str | PathLike[str], about: Mapping[str, Any]) -> None:
    """Write a policy that was trained on the model into a folder, in place of one that is there.

    Parameters
    ----------
    policy : NetworkPolicy
        The policy.
    model : Model
        The model that it was trained on.
    folder : str or path
        The folder, which is made where it is not there.
    about : mapping
        How the policy came about, as plain data; the versions of the packages are added to it.

    Raises
    ------
    InvalidInput
        Where the folder cannot be written, and for a plant or an integrator that is not ours.
    """
    from safetensors.numpy import save

    arrays = {}
    for i, (w, b) in enumerate(policy.layers):
        arrays[f"w{i}"], arrays[f"b{i}"] = np.ascontiguousarray(w), np.ascontiguousarray(b)
    weights = save(arrays, metadata={"schema": SCHEMA})
    described = {
        "schema": SCHEMA,
        "observation": list(task.observation_names(policy.history)),
        "history": policy.history,
        "dt": model.dt,
        "u_max": policy.u_max,
        "weights": {"file": WEIGHTS, "sha256": hashlib.sha256(weights).hexdigest()},
        "model": to_dict(model),
        "about": {**about, "versions": installed_versions(("gapfinder", "numpy", "torch"))},
    }
    folder = Path(folder)
    with file_errors(folder, "write"):
        folder.mkdir(parents=True, exist_ok=True)
    save_file(folder / WEIGHTS, weights)
    save_file(folder / DESCRIPTION, json.dumps(described, indent=1, allow_nan=False) + "\n")


def load_policy(folder: str | PathLike[str]) -> SavedPolicy:
    """Read a policy's folder; a user's own effects must have been loaded (`sysid.load_effects`) before.

    Parameters
    ----------
    folder : str or path
        The folder that a training or `save_policy` wrote.

    Returns
    -------
    SavedPolicy
        The policy, the machine that it was trained on, and how it came about.

    Raises
    ------
    InvalidInput
        In one sentence, for anything that is not a policy of this version, and for one whose observation this version
        does not make.
    """
    folder = Path(folder)
    file = folder / DESCRIPTION
    data = read_json(file, "the folder that a training wrote")
    weights = read_file(folder / WEIGHTS, "the weights that a training wrote", LARGEST_WEIGHTS)
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        came = data.get("schema") if isinstance(data, dict) else None
        raise InvalidInput(f'{file} has "schema": {excerpt(came)}: this version reads "{SCHEMA}"')
    try:
        return _policy(data, weights)
    except InvalidInput as error:
        raise InvalidInput(f"{folder}: {error}") from None


def _policy(data: Mapping[str, Any], weights: bytes) -> SavedPolicy:
    history, dt, u_max = count(data, "history"), number_in(data, "dt"), number_in(data, "u_max")
    if history > LONGEST_HISTORY:
        raise InvalidInput(f"it observes {history:,} past commands: expected at most {LONGEST_HISTORY}")
    names = list(task.observation_names(history))
    if sequence(data, "observation") != names:
        came = excerpt(data["observation"])
        raise InvalidInput(f"it was trained for another observation ({came}): this version gives {', '.join(names)}")
    if not (0.0 < dt < math.inf and 0.0 < u_max < math.inf):
        raise InvalidInput(f"dt = {dt} and u_max = {u_max}: expected positive numbers")
    if hashlib.sha256(weights).hexdigest() != text(mapping(data, "weights"), "sha256"):
        raise InvalidInput(f"{WEIGHTS} is not the file that {DESCRIPTION} was written with: train again, or copy both")
    model = from_dict(mapping(data, "model")).model
    check_episode(model.dt, model.integrator.substeps)
    if (model.dt, model.u_max) != (dt, u_max):
        raise InvalidInput(f"its model has dt = {model.dt}, u_max = {model.u_max}, the policy {dt} and {u_max}")
    return SavedPolicy(NetworkPolicy(_layers(weights, 3 + history), u_max, history), model, mapping(data, "about"))


def _layers(weights: bytes, inputs: int) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        arrays = load(weights)
    except SafetensorError as error:
        raise InvalidInput(f"{WEIGHTS} is no safetensors file ({error})") from None
    depth = len(arrays) // 2
    check_size(f"{WEIGHTS} holds layers:", depth, LAYERS)
    if depth == 0 or set(arrays) != {f"{kind}{i}" for i in range(depth) for kind in "wb"}:
        raise InvalidInput(f"{WEIGHTS} holds {', '.join(sorted(arrays)) or 'nothing'}: expected w0, b0, w1, ...")
    layers = tuple((arrays[f"w{i}"], arrays[f"b{i}"]) for i in range(depth))
    width = inputs
    for i, (w, b) in enumerate(layers):
        out = 1 if i == depth - 1 else b.size
        if w.shape != (width, out) or b.shape != (out,):
            raise InvalidInput(f"layer {i} has shapes {w.shape} and {b.shape}: expected {(width, out)} and {(out,)}")
        if w.dtype != np.float32 or b.dtype != np.float32 or not (np.isfinite(w).all() and np.isfinite(b).all()):
            raise InvalidInput(f"layer {i} holds other numbers than finite float32")
        check_size(f"layer {i} has a width of", out, LAYER_WIDTH)
        width = out
    return layers
