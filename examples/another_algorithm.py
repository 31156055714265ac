"""Another algorithm on a fitted model: TorchRL's TD3, on a machine whose commands act late.

    python examples/another_algorithm.py                     a rod with a delay of 0.1 s
    python examples/another_algorithm.py model.json 2.0      a model that sysid wrote, torque up to 2 N m

Ten pendulums are one environment, and one agent learns from all of them. It observes the commands under way.
"""

import sys

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.utils import step_mdp
from torchrl.modules import MLP, TanhModule, ValueOperator
from torchrl.objectives import SoftUpdate, TD3Loss, ValueEstimators

import sysid
from policies import BatchedPendulums, Fixed, NetworkPolicy, evaluate, fresh_start_states
from policies.environments.machine import machine_of, past_commands_needed

PENDULUMS, HIDDEN = 10, [64, 64]


def train(machine: sysid.Model, steps: int) -> NetworkPolicy:
    """The policy after so many steps of each pendulum, by one update a step."""
    history = past_commands_needed(machine)
    env = BatchedPendulums(machine, [Fixed()] * PENDULUMS, range(PENDULUMS), history=history)
    network = MLP(in_features=3 + history, out_features=1, num_cells=HIDDEN, activation_class=nn.ReLU)
    spec = env.action_spec_unbatched
    actor = TensorDictSequential(
        TensorDictModule(network, ["observation"], ["loc"]), TanhModule(in_keys=["loc"], out_keys=["action"], spec=spec)
    )
    critic = ValueOperator(MLP(4 + history, 1, num_cells=HIDDEN, activation_class=nn.ReLU), ["observation", "action"])
    loss = TD3Loss(actor, critic, action_spec=spec)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.99)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(100_000), batch_size=256)
    update, optimizer = SoftUpdate(loss, tau=0.005), torch.optim.Adam(loss.parameters(), 1e-3)
    now = env.reset()
    for k in range(steps):
        with torch.no_grad():
            acted = actor(now.clone()) if k > 100 else env.rand_action(now)
        acted["action"] = (acted["action"] + 0.1 * torch.randn(PENDULUMS, 1)).clamp(-1.0, 1.0)
        moved = env.step(acted)
        replay.extend(moved)
        now, losses = env.reset() if moved["next", "done"].all() else step_mdp(moved), loss(replay.sample())
        optimizer.zero_grad()
        (losses["loss_qvalue"] + losses["loss_actor"] if k % 2 else losses["loss_qvalue"]).backward()
        optimizer.step()
        update.step()
    layers = [(layer.weight.detach().T.numpy(), layer.bias.detach().numpy()) for layer in list(network)[::2]]
    return NetworkPolicy(tuple(layers), machine.u_max, history)


if __name__ == "__main__":
    torch.manual_seed(0)
    late = sysid.Model(sysid.RodPendulum(), (sysid.Delay(T=0.1),), dt=0.05, u_max=2.0)
    given = machine_of(sysid.load(sys.argv[1]).model, float(sys.argv[2])) if len(sys.argv) > 2 else late
    print(evaluate(train(given, 3000), given, *fresh_start_states(0, 100)))
