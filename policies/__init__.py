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

import lazy_loader
from gymnasium.envs.registration import register, registry

from policies.environments.task import HORIZON

ENV_ID = "gapfinder/Pendulum-v0"
_NAMES = {
    "environments.batched_pendulums": "BatchedPendulums",
    "environments.gymnasium_env": "PendulumEnv",
    "environments.randomization": "Band Fixed Mixture Posterior RandomForce Randomization Ranges SingleEffect",
    "evaluation": "Evaluation Policy evaluate fresh_start_states start_states",
    "network_policy": "NetworkPolicy",
    "control.lqr": "LQR design_lqr",
    "control.dynamic_programming": "Optimal",
    "control.swing_up": "SwingUp design_swing_up",
    "training.cpu_settings": "tune_cpu",
    "training.population": "Population",
    "training.sac": "SACSettings SACPopulation",
    "training.shac": "SHACSettings SHACPopulation",
    "storage.policy_file": "SavedPolicy load_policy save_policy",
}
_attached = {module: names.split() for module, names in _NAMES.items()}
__getattr__, __dir__, _lazy = lazy_loader.attach(__name__, submod_attrs=_attached)
__all__ = ["ENV_ID", "HORIZON", *_lazy]  # noqa: PLE0604

if ENV_ID not in registry:
    register(ENV_ID, entry_point="policies.environments.gymnasium_env:make_pendulum")
