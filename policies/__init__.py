"""Controllers for the pendulum: environments, training and references, over the models of sysid.

environments   a model as gymnasium.Env and as TorchRL's EnvBase; task and randomization
training       populations of agents, by the gradient through the model or by SAC, and the program of one policy
control        LQR, energy swing-up and dynamic programming
evaluation     what a policy is worth on a model
storage        a policy as a file, and as ONNX         cli   the command line

The names load their modules on first use, so that `import policies` stays cheap and does not load torch.
`gymnasium.make("policies:gapfinder/Pendulum-v0", model="model.json")` imports it by itself.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from gymnasium.envs.registration import register, registry

from policies.environments.task import HORIZON

ENV_ID = "gapfinder/Pendulum-v0"

_MODULES = {
    "BatchedPendulums": "environments.batched_pendulums",
    "PendulumEnv": "environments.gymnasium_env",
    "Band": "environments.randomization",
    "Fixed": "environments.randomization",
    "Mixture": "environments.randomization",
    "Posterior": "environments.randomization",
    "PriorRange": "environments.randomization",
    "RandomForce": "environments.randomization",
    "Randomization": "environments.randomization",
    "Ranges": "environments.randomization",
    "SingleEffect": "environments.randomization",
    "Evaluation": "evaluation",
    "Policy": "evaluation",
    "evaluate": "evaluation",
    "fresh_start_states": "evaluation",
    "start_states": "evaluation",
    "NetworkPolicy": "network_policy",
    "LQR": "control.lqr",
    "design_lqr": "control.lqr",
    "Optimal": "control.dynamic_programming",
    "SwingUp": "control.swing_up",
    "design_swing_up": "control.swing_up",
    "CpuSettings": "training.cpu_settings",
    "tune_cpu": "training.cpu_settings",
    "Population": "training.population",
    "SACPopulation": "training.sac_population",
    "SACSettings": "training.sac",
    "SHACPopulation": "training.shac_population",
    "SHACSettings": "training.shac",
    "SavedPolicy": "storage.policy_file",
    "load_policy": "storage.policy_file",
    "save_policy": "storage.policy_file",
}

__all__ = ["ENV_ID", "HORIZON", *_MODULES]  # noqa: PLE0604

if ENV_ID not in registry:
    register(ENV_ID, entry_point="policies.environments.gymnasium_env:make_pendulum")


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"policies.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'policies' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
