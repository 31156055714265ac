"""Controllers for the pendulum: environments, training and references, over the models of sysid.

The names load their modules on first use, so that `import policies` stays cheap and does not load torch. Importing
registers "gapfinder/Pendulum-v0" with gymnasium. The function `evaluate` lives in the module of that name:
`from policies.evaluate import evaluate`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import gymnasium

from policies.task import HORIZON

ENV_ID = "gapfinder/Pendulum-v0"

_HOME = {
    "BatchedPendulum": "learning.batched_env",
    "Evaluation": "evaluate",
    "Policy": "evaluate",
    "start_states": "evaluate",
    "LQR": "control.lqr",
    "design_lqr": "control.lqr",
    "Optimal": "control.optimal",
    "PendulumEnv": "pendulum_env",
    "Pendulums": "learning.pendulums",
    "NetworkPolicy": "network_policy",
    "Population": "learning.population",
    "CpuTuning": "learning.processor",
    "tune_cpu": "learning.processor",
    "Band": "randomization",
    "Fixed": "randomization",
    "OneOf": "randomization",
    "Posterior": "randomization",
    "PriorRange": "randomization",
    "Randomization": "randomization",
    "Ranges": "randomization",
    "Shaken": "randomization",
    "SavedPolicy": "policy_file",
    "load_policy": "policy_file",
    "save_policy": "policy_file",
    "SAC": "learning.sac",
    "SACSettings": "learning.sac",
    "SwingUp": "control.swing_up",
    "design_swing_up": "control.swing_up",
}

__all__ = ["ENV_ID", "HORIZON", *_HOME]  # noqa: PLE0604

if ENV_ID not in gymnasium.registry:
    gymnasium.register(ENV_ID, entry_point="policies.pendulum_env:PendulumEnv", max_episode_steps=HORIZON)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"policies.{_HOME[name]}"), name)
    raise AttributeError(f"module 'policies' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
